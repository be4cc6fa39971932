"""What the report says of elastic joints: resonances, amplitude sweeps, judged models."""

from __future__ import annotations

import numpy as np

from strainwave.domain import Delay, Identification, JointModel, Mode, RecordModel, Sweep
from strainwave.domain.formatting import percent, plus_minus
from strainwave.presentation.figures import MEASURED, Axis, Figure, Markers, Panel


def stiffness(sweep: Sweep) -> Figure:
    """Equivalent stiffness over the amplitude, with 95 % bars.

    Parameters
    ----------
    sweep : Sweep

    Returns
    -------
    Figure
    """
    x = np.array([point.amplitude for point in sweep.points])
    y = np.array([point.gear_stiffness for point in sweep.points])
    bars = 1.96 * np.array([point.gear_stiffness_std for point in sweep.points])
    points = Markers(x, y, "equivalent stiffness", MEASURED, size=8.0, error=bars)
    panel = Panel(Axis("k_G [N m/rad]"), (points,))
    return Figure(Axis("amplitude of excitation [V]"), (panel,))


def resonance_rows(identification: Identification) -> list[tuple[str, ...]]:
    """Rows of the table of resonances: all records of a joint at once, then one by one.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    list of tuple of str
        Joint, records, anti-resonance, its damping, resonance, its damping, stiffness.
    """
    rows = [_row(joint, "all, at once") for joint in identification.joints]
    for record in identification.records:
        if record.joint_model is not None:
            rows.append(_row(record.joint_model, _name(record)))
    return sorted(rows, key=lambda row: row[0])


def link_rows(identification: Identification) -> list[tuple[str, ...]]:
    """Rows of the table of the links' motion: sources, fusion and delays, record by record.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    list of tuple of str
        Joint, record, source, bias, error of the fusion (10), delays of link sensor and of drive.
    """
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
    """In milliseconds; nothing where the record does not show it."""
    return "" if delay is None else " ± ".join(plus_minus(1e3 * delay.value, 1e3 * delay.std))


def judgement_rows(identification: Identification) -> list[tuple[str, ...]]:
    """Rows of the table of state-space models on data that were not fitted.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    list of tuple of str
        Joint, record, fits one step ahead of motor and link velocity, then each test's verdict.
    """
    rows: list[tuple[str, ...]] = []
    for record in identification.records:
        check = record.check
        if check is not None:
            fits = " / ".join(percent(fit) for fit in check.prediction_fit_percent)
            verdicts = "; ".join(test.message for test in check.tests)
            rows.append((str(record.signals.joint), _name(record), fits, verdicts))
    return rows


def _name(record: RecordModel) -> str:
    return record.signals.experiment.name


def _row(joint: JointModel, name: str) -> tuple[str, ...]:
    names = list(joint.values)
    k = names.index("gear_stiffness")
    spread = float(np.sqrt(joint.covariance[k, k]))
    return (
        str(joint.joint),
        name,
        *_cells(joint.anti_resonance),
        *_cells(joint.resonance),
        " ± ".join(plus_minus(joint.values["gear_stiffness"], spread)),
    )


def _cells(mode: Mode | None) -> tuple[str, str]:
    if mode is None:
        return "none", ""
    return (
        " ± ".join(plus_minus(mode.frequency_hz, mode.frequency_std_hz)),
        " ± ".join(plus_minus(mode.damping, mode.damping_std)),
    )
