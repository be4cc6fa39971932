"""What the report shows of elastic joints: responses, resonances, amplitude sweeps."""

from __future__ import annotations

import numpy as np

from strainwave.formatting import percent, plus_minus
from strainwave.physical.two_inertia import joint_of, state_space
from strainwave.records import (
    ComplexArray,
    FloatArray,
    FrequencyResponse,
    Identification,
    JointModel,
    Mode,
    RecordModel,
    Sweep,
)
from strainwave.report.figures import MEASURED, MODEL, RESIDUAL, Figure, rounded

_POINTS = 400  # of a model's curve
_OUTSIDE = 3.0  # how far a response is drawn beyond the band of the fit
_NOISY = 0.3  # relative deviation from which a measured point is left out


def response(joint: JointModel, gear_ratio: float, measured: FrequencyResponse | None) -> Figure:
    """Motor torque to motor velocity: the physical model, and the nonparametric response.

    Parameters
    ----------
    joint : JointModel
    gear_ratio : float
    measured : FrequencyResponse or None

    Returns
    -------
    dict
        A plotly figure, magnitude above phase.
    """
    low, high = joint.band_hz[0] / _OUTSIDE, joint.band_hz[1] * _OUTSIDE
    f: FloatArray = np.geomspace(low, high, _POINTS)
    data = []
    if measured is not None:
        inside = (measured.frequencies_hz >= low) & (measured.frequencies_hz <= high)
        G = measured.response[inside, 0, 0]
        if measured.noise_variance is not None:
            std = np.sqrt(measured.noise_variance[inside, 0, 0])
            sure = std < _NOISY * np.abs(G)
        else:
            sure = np.ones(len(G), dtype=bool)
        at = measured.frequencies_hz[inside][sure]
        data += _curve(at, G[sure], "measured", {"mode": "markers", "marker": _dots(MEASURED)})
    line = {"mode": "lines", "line": {"color": MODEL, "width": 1.5}}
    data += _curve(f, _model(joint, gear_ratio, f), "physical model", line)
    edges = [
        {
            "type": "line",
            "xref": "x",
            "yref": "paper",
            "x0": edge,
            "x1": edge,
            "y0": 0,
            "y1": 1,
            "line": {"color": RESIDUAL, "width": 1, "dash": "dot"},
        }
        for edge in joint.band_hz
    ]
    return {
        "data": data,
        "layout": {
            "xaxis": {"type": "log", "title": {"text": "frequency [Hz]"}, "anchor": "y2"},
            "yaxis": {"title": {"text": "[dB re rad/s/(N m)]"}, "domain": [0.42, 1.0]},
            "yaxis2": {"title": {"text": "phase [deg]"}, "domain": [0.0, 0.36], "dtick": 90},
            "shapes": edges,
        },
    }


def _model(joint: JointModel, gear_ratio: float, f: FloatArray) -> ComplexArray:
    """G11 of the physical model."""
    A, B, C = state_space(joint_of(np.array(list(joint.values.values())[:6]), gear_ratio))
    s = 2j * np.pi * f[:, None, None]
    return np.asarray((C @ np.linalg.solve(s * np.eye(3) - A, B.astype(complex)))[:, 0, 0])


def _dots(colour: str) -> Figure:
    return {"color": colour, "size": 4}


def _curve(f: FloatArray, G: ComplexArray, name: str, style: Figure) -> list[Figure]:
    """Magnitude and phase of one response."""
    common = {"type": "scatter", "name": name, "legendgroup": name, "x": rounded(f), **style}
    phase = np.rad2deg(np.angle(G))
    return [
        {**common, "y": rounded(20.0 * np.log10(np.abs(G)))},
        {**common, "y": rounded(phase), "yaxis": "y2", "showlegend": False},
    ]


def stiffness(sweep: Sweep) -> Figure:
    """Equivalent stiffness over the amplitude, with 95 % bars.

    Parameters
    ----------
    sweep : Sweep

    Returns
    -------
    dict
    """
    x = np.array([point.amplitude for point in sweep.points])
    y = np.array([point.gear_stiffness for point in sweep.points])
    bars = 1.96 * np.array([point.gear_stiffness_std for point in sweep.points])
    return {
        "data": [
            {
                "type": "scatter",
                "mode": "markers",
                "name": "equivalent stiffness",
                "x": rounded(x),
                "y": rounded(y),
                "error_y": {"type": "data", "array": rounded(bars), "color": MEASURED},
                "marker": {"color": MEASURED, "size": 8},
            }
        ],
        "layout": {
            "xaxis": {"title": {"text": "amplitude of excitation [V]"}},
            "yaxis": {"title": {"text": "k [N m/rad]"}},
        },
    }


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
    rows += [_row(r.physical, _name(r)) for r in identification.records if r.physical]
    return sorted(rows, key=lambda row: row[0])


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
