"""Kinds, laws, effects and sensors of a test in the tables of the package."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from strainwave.domain.arm import gear_laws, link_sensors


@contextmanager
def added(entries: dict[str, Any], entry: Any) -> Iterator[None]:
    """Add an entry to a table such as `gear_laws.LAWS`."""
    caches = (gear_laws.gear_parameters, link_sensors.sensor_constants)
    entries[entry.name] = entry
    for cached in caches:
        cached.cache_clear()
    yield
    del entries[entry.name]
    for cached in caches:
        cached.cache_clear()
