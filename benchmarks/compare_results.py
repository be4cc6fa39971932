"""Compare results of two versions: `python -m benchmarks.compare_results BEFORE AFTER`.

Both are result.json files, or folders with files of that name at the same places. Dates, times,
the version, paths and the order of keys are not compared. A number that has a standard deviation
may differ by 0.01 of it, every other number by 1e-6 of its size. Exit code 1 if results differ.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_IGNORED = {"created", "timing_s", "version", "path", "seconds"}
_MAX_STDS = 0.01  # difference of a number from the same data, in its standard deviations
_MAX_RELATIVE = 1e-6  # difference of a number without one; single-precision rounding
_MAX_LINES = 20  # differences that are printed of one result


def differences(before: Any, after: Any, place: str = "", std: float = 0.0) -> Iterator[str]:
    """Places and values of what differs; `std` is the standard deviation of the numbers here."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted({*before, *after} - _IGNORED):
            if (key in before) != (key in after):
                yield f"{place}.{key}: only {'before' if key in before else 'after'}"
                continue
            spread = before.get("std") if key in ("value", "std", "ci95") else None
            yield from differences(before[key], after[key], f"{place}.{key}", spread or 0.0)
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for k, (one, other) in enumerate(zip(before, after, strict=True)):
            yield from differences(one, other, f"{place}[{k}]", std)
    elif isinstance(before, float) and isinstance(after, float | int):
        tolerance = max(_MAX_STDS * std, _MAX_RELATIVE * abs(before))
        if not math.isclose(before, after, rel_tol=0.0, abs_tol=tolerance):
            yield f"{place}: {before!r} became {after!r}"
    elif before != after:
        yield f"{place}: {str(before)[:300]!r} became {str(after)[:300]!r}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    options = parser.parse_args()
    files = [options.before]
    if options.before.is_dir():
        files = sorted(options.before.rglob("result.json"))
    count = 0
    for file in files:
        other = options.after / file.relative_to(options.before)
        if not other.is_file():
            print(f"{file}: no result after")
            count += 1
            continue
        found = list(differences(*(json.loads(path.read_text()) for path in (file, other))))
        print(f"{file}: {len(found) or 'no'} difference(s)", *found[:_MAX_LINES], sep="\n  ")
        count += len(found)
    return 1 if count or not files else 0


if __name__ == "__main__":
    sys.exit(main())
