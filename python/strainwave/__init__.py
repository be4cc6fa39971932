"""Identify the physical model of a robot arm with elastic joints from its logs.

The stages are modules, each with one main function from records to a record; `pipeline.identify`
runs them in order. Importing this package is cheap: what is heavy is imported where it is used.
"""

from __future__ import annotations

from strainwave.display import Display, register

__version__ = "0.1.0"


def _notebook() -> Display:
    from strainwave.presentation import notebook

    return notebook


register(_notebook)
