"""Tables and figures of records in notebooks."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure

from elastic_runs import log_of, prbs_run, rig
from joint_records import case
from results import arm_model, identification, prediction
from strainwave import display
from strainwave.display import Displayed
from strainwave.domain import (
    Diagnostic,
    FrequencyResponse,
    JointModel,
    Place,
    RecordModel,
    Sweep,
    SweepPoint,
)
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput
from strainwave.identification import frequency
from strainwave.identification import joint_model as physical


@cache
def joint_model() -> JointModel:
    record_case = case(1)
    return physical.identify_joint(
        record_case.records, record_case.model, Arm.of(record_case.study.arm)
    )


@cache
def sweep() -> Sweep:
    points = tuple(
        SweepPoint(f"at-{size}", float(size), 6000.0 + 50.0 * size, 20.0, 24000.0 + size, 80.0)
        for size in (2, 5, 10)
    )
    return Sweep(1, points, 50.0, 3.0, "hardening")


NAMES = (
    "log",
    "rigid",
    "decoupled",
    "joint",
    "record",
    "response",
    "sweep",
    "tuned",
    "prediction",
    "identification",
)


@cache
def examples() -> dict[str, tuple[Displayed, list[str]]]:
    """Records by name, and the texts that their tables must have."""
    rigid = identification().rigid
    assert rigid is not None
    record_case = case(1)
    return {
        "log": (log_of(prbs_run(rig())), ["theta_m2", "0.25 ms"]),
        "rigid": (rigid, ["partly-determined", "0.02010", "not identified", "kg m^2"]),
        "decoupled": (
            record_case.decoupled,
            ["joint 1, decoupled", record_case.decoupled.checks[0].message[:12]],
        ),
        "joint": (joint_model(), ["gear_stiffness", "anti-resonance", "determined"]),
        "record": (
            RecordModel(record_case.decoupled, joint_model(), None, None, None),
            ["gear_damping"],
        ),
        "response": (
            frequency.estimate_response([record_case.decoupled]),
            ["frequency response by", "averages"],
        ),
        "sweep": (sweep(), ["hardening", "24002 ± 80"]),
        "tuned": (arm_model(rigid.parameters, np.eye(2)), ["converged after 7", "0.00020"]),
        "prediction": (prediction("check", 91.25, float("nan")), ["91.2 %", "not known"]),
        "identification": (identification("<b>"), ["&lt;b&gt;", "<code>saturated</code>"]),
    }


@pytest.mark.parametrize("name", NAMES)
def test_a_table_has_the_contents_of_the_record(name: str) -> None:
    record, texts = examples()[name]
    html = record._repr_html_()
    assert [text for text in texts if text not in html] == []
    assert html.count("<td") == html.count("</td>")


@pytest.mark.parametrize("name", [name for name in NAMES if name != "joint"])
def test_a_figure_has_lines_and_titled_axes(name: str) -> None:
    axes = examples()[name][0].plot().axes
    assert any(ax.lines or ax.containers for ax in axes)
    assert axes[0].get_ylabel()


def test_a_joint_is_drawn_with_the_measured_response() -> None:
    record_case = case(1)
    alone = joint_model().plot(gear_ratio=0.01)
    both = joint_model().plot(
        gear_ratio=0.01, measured=frequency.estimate_response([record_case.decoupled])
    )
    assert [ax.get_ylabel() for ax in both.axes][2:] == ["coherence"]
    for one, other in zip(alone.axes, both.axes, strict=False):
        names = [set(ax.get_legend_handles_labels()[1]) for ax in (one, other)]
        assert "measured" in names[1] - names[0]


def test_a_prediction_shows_the_channel_with_the_lowest_fit_by_default() -> None:
    check_prediction = prediction("check", 91.0, 55.0)
    assert "torque2" in title(check_prediction.plot())
    assert "torque1" in title(check_prediction.plot(channel="torque1"))
    with pytest.raises(InvalidInput, match="choose one of torque1, torque2"):
        check_prediction.plot(channel="a1")


def test_a_response_shows_the_reliable_points_of_the_selection() -> None:
    response = frequency.estimate_response([case(1).decoupled])
    first, second = response.plot(band_hz=(5.0, 60.0)), response.plot(output=1)
    assert "input 0 to output 1" in title(second)
    figure = np.asarray(first.axes[0].lines[0].get_xdata(), dtype=float)
    assert 5.0 <= figure.min() < figure.max() <= 60.0
    assert response.noise_variance is not None
    is_certain = np.sqrt(response.noise_variance / 2.0)[:, 1, 0] < 0.3 * np.abs(
        response.response[:, 1, 0]
    )
    assert (
        0
        < len(np.asarray(second.axes[0].lines[0].get_xdata()))
        == is_certain.sum()
        < is_certain.size
    )
    with pytest.raises(InvalidInput, match="no point"):
        response.plot(band_hz=(1e6, 2e6))


def test_the_response_of_a_model_has_the_band_of_its_covariance() -> None:
    f = np.geomspace(1.0, 100.0, 30)
    response = np.asarray(10.0 / (1.0 + 1j * f), dtype=np.complex128)[:, None, None]
    spread = 1e-4 * np.abs(response[..., None, None]) ** 2 * np.eye(2)
    certain_response = FrequencyResponse(f, response, covariance=spread)
    assert len(certain_response.plot().axes[0].collections) == 1
    assert len(replace(certain_response, covariance=None).plot().axes[0].collections) == 0
    with pytest.raises(InvalidInput, match="no point"):
        replace(certain_response, covariance=1e4 * spread).plot()


def test_a_record_without_a_model_has_its_warnings_and_no_figure() -> None:
    warnings = (Diagnostic("grey-box-failed", Place.in_records("prbs"), reason="the motor stands"),)
    empty = RecordModel(case(1).decoupled, None, None, None, None, warnings=warnings)
    assert "the motor stands" in empty._repr_html_()
    with pytest.raises(InvalidInput, match="no physical model to draw"):
        empty.plot()


def test_without_matplotlib_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InvalidInput, match="pip install matplotlib"):
        prediction("check", 91.0).plot()


def test_a_record_without_a_view_raises_an_error() -> None:
    class Other(Displayed):
        pass

    with pytest.raises(TypeError, match="Other"):
        Other()._repr_html_()
    with pytest.raises(TypeError, match="Other"):
        Other().plot()


def test_the_last_registered_displays(monkeypatch: pytest.MonkeyPatch) -> None:
    class Bare:
        def table_of(self, record: object) -> str:
            return f"<p>{type(record).__name__}</p>"

        def picture_of(self, record: object, **which: object) -> Figure:
            return Figure(label=f"{type(record).__name__} {which}")

    monkeypatch.setattr(display, "_loaders", [])
    display.register(Bare)
    assert sweep()._repr_html_() == "<p>Sweep</p>"
    assert sweep().plot(joint=1).get_label() == "Sweep {'joint': 1}"


def test_importing_the_pipeline_does_not_load_the_views() -> None:
    code = "import strainwave.pipeline, sys; print('strainwave.report.notebook' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_parameters_without_a_size_are_not_drawn() -> None:
    rigid = identification().rigid
    assert rigid is not None
    nothing = replace(rigid, parameters=rigid.parameters[1:]).plot()
    assert len(nothing.axes[0].lines[0].get_xdata(orig=True)) == 0  # type: ignore[arg-type]


def title(figure: Figure) -> str:
    return figure.get_suptitle()
