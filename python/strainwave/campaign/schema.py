"""Columns of the tables of a store, with types that do not depend on the values."""

from __future__ import annotations

import pyarrow as pa

TIMED_PARTS = ("read", "consistency", "rigid", "decoupled", "tuned", "checks")
"""Parts of a run whose time has a column, `read_s` and so on."""

RUNS_SCHEMA = pa.schema(
    [
        ("run", pa.string()),  # hash of case, inputs, options and version
        ("study", pa.string()),  # path or URL
        ("study_sha256", pa.string()),
        ("inputs_sha256", pa.string()),  # of the logs that the study names
        ("options_sha256", pa.string()),  # of stages and options
        ("version", pa.string()),
        ("campaign", pa.string()),
        ("stages", pa.string()),  # rigid,decoupled,tuned
        ("status", pa.string()),
        ("exit_code", pa.int32()),
        ("message", pa.string()),  # why it is not determined
        ("started", pa.timestamp("us")),  # UTC
        ("seconds", pa.float64()),
        ("worker", pa.string()),  # host:process
        ("result", pa.string()),  # path of result.json in the store
        ("identified", pa.list_(pa.string())),
        ("not_identified", pa.list_(pa.string())),
        ("rejected", pa.list_(pa.string())),
        ("validated_rigid", pa.bool_()),
        ("validated_elastic", pa.bool_()),
        ("suspected", pa.list_(pa.string())),  # codes
        ("warnings", pa.list_(pa.string())),  # codes
        *((f"{part}_s", pa.float64()) for part in TIMED_PARTS),
        ("classes", pa.string()),  # JSON: properties of a virtual arm
    ]
)
"""One row per run."""

PARAMETERS_SCHEMA = pa.schema(
    [
        ("run", pa.string()),
        ("study", pa.string()),
        ("name", pa.string()),
        ("joint", pa.int32()),  # null: of the arm
        ("value", pa.float64()),  # null: not identified
        ("std", pa.float64()),
        ("ci95_low", pa.float64()),
        ("ci95_high", pa.float64()),
        ("unit", pa.string()),
        ("stage", pa.string()),
        ("true_value", pa.float64()),  # of virtual arms
        ("error_percent", pa.float64()),  # 100 (value - true_value) / |true_value|
    ]
)
"""One row per parameter of a run."""
