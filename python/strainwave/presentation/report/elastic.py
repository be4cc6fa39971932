"""Tables of the elastic joints: resonances, link motion, and tests of state-space models."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Delay, Identification, JointModel, Mode, RecordModel
from strainwave.domain.formatting import percent, plus_minus


def resonance_rows(identification: Identification) -> list[tuple[str, ...]]:
    """Joint, records, anti-resonance and its damping, resonance and its damping, stiffness.

    The model of all records of a joint comes first, then one row for each record.
    """
    rows = [_resonance_row(joint, "all records") for joint in identification.joints]
    for record in identification.records:
        if record.joint_model is not None:
            rows.append(_resonance_row(record.joint_model, _name(record)))
    return sorted(rows, key=lambda row: row[0])


def link_rows(identification: Identification) -> list[tuple[str, ...]]:
    """Joint, record, source, bias, fusion error (10), delays of link sensor and of drive."""
    return [
        (
            str(link.joint),
            link.experiment,
            link.source,
            f"{link.bias:.2g}" if link.source == "accelerometer" else "",
            f"{link.fusion_error:.2g}" if link.fusion is not None else "none",
            _delay(link.sensor_delay),
            _delay(link.drive_delay),
        )
        for link in identification.links
    ]


def _delay(delay: Delay | None) -> str:
    """In milliseconds; empty if the record does not determine it."""
    return "" if delay is None else " ± ".join(plus_minus(1e3 * delay.value, 1e3 * delay.std))


def validation_rows(identification: Identification) -> list[tuple[str, ...]]:
    """Joint, record, one-step fits of motor and link velocity, and the p-value of each test."""
    rows: list[tuple[str, ...]] = []
    for record in identification.records:
        check = record.check
        if check is not None:
            fits = (percent(fit) for fit in check.prediction_fit_percent)
            tests = {test.name: test for test in check.tests}
            names = ("white", "independent-of-past-inputs", "no-feedback")
            values = (
                f"{_p_value(tests[name].p_value)} ({'pass' if tests[name].passed else 'fail'})"
                if name in tests
                else ""
                for name in names
            )
            rows.append((str(record.signals.joint), _name(record), " / ".join(fits), *values))
    return rows


def _p_value(p: float) -> str:
    return f"{p:.2g}" if p >= 1e-3 else "< 0.001"


def _name(record: RecordModel) -> str:
    return record.signals.experiment.name


def _resonance_row(joint: JointModel, name: str) -> tuple[str, ...]:
    k = list(joint.values).index("gear_stiffness")
    std = float(np.sqrt(joint.covariance[k, k]))
    return (
        str(joint.joint),
        name,
        *_mode_cells(joint.anti_resonance),
        *_mode_cells(joint.resonance),
        " ± ".join(plus_minus(joint.values["gear_stiffness"], std)),
    )


def _mode_cells(mode: Mode | None) -> tuple[str, str]:
    if mode is None:
        return "none", ""
    return (
        " ± ".join(plus_minus(mode.frequency_hz, mode.frequency_std_hz)),
        " ± ".join(plus_minus(mode.damping, mode.damping_std)),
    )
