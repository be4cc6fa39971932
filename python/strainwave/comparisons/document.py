"""Comparisons -> comparisons.json."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from strainwave import __version__
from strainwave.records import Comparison

SCHEMA = "strainwave/comparisons/1"


def to_json(comparisons: Sequence[Comparison], seed: int) -> bytes:
    """Claims, verdicts and numbers, without the figures, as UTF-8 text that ends with a newline.

    Parameters
    ----------
    comparisons : sequence of Comparison
    seed : int

    Returns
    -------
    bytes
    """
    document = {
        "schema": SCHEMA,
        "version": __version__,
        "seed": seed,
        "comparisons": [
            {
                "figure": c.figure,
                "title": c.title,
                "claim": c.claim,
                "holds": c.holds,
                "values": {k: float(v) if math.isfinite(v) else None for k, v in c.values.items()},
                "message": c.message,
            }
            for c in comparisons
        ],
    }
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode()
