"""Every option changes the result of its stage, and a run passes each option to its stage."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elastic_runs import log_of, prbs_run, rig
from joint_records import case
from strainwave import pipeline
from strainwave.domain import (
    Experiment,
    FrequencyOptions,
    Joint,
    LinearOptions,
    LinkOptions,
    Options,
    PhysicalOptions,
    Prbs,
    RigidOptions,
    Servo,
    Study,
    WholeArmOptions,
)
from strainwave.domain.arm.kinds import single_joint
from strainwave.domain.study import PUBLISHED_OPTIONS
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import SensorNoise
from strainwave.identification import frequency, rigid, whole_arm
from strainwave.identification import joint_model as physical
from strainwave.io import results as result
from strainwave.io.logs import read_logs
from strainwave.io.study import AS_PUBLISHED, read_study
from strainwave.report.document import render
from strainwave.signals import link_motion as links
from strainwave.signals import motor as signals
from strainwave.virtual.experiments import simulate_study
from virtual_arms import ELASTIC_JOINT, motion_log, rigid_two_link, values_of

JOINT = Joint(
    spring="linear",
    gear_ratio=0.01,
    torque_per_volt=0.08,
    encoder_counts=8192,
    accelerometer_distance=0.3,
    accelerometer_hz=300.0,
)
TRUE = ELASTIC_JOINT


def excited(name: str, use: Any, amplitude: float) -> Experiment:
    prbs = Prbs(9, 1e-3, 3, amplitude)
    return Experiment(name, f"{name}.parquet", use, ("open",), joint=1, prbs=prbs)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Study file of a single elastic joint: motion, two PRBS records, a sweep and a step record."""
    folder = tmp_path_factory.mktemp("small")
    study = Study(
        path=folder / "study.toml",
        sha256="",
        arm=single_joint(
            JOINT,
            servo=Servo("pi-velocity", period=1e-3, kp=(0.12,), ki=(1.5,), limit=10.0),
        ),
        experiments=(
            Experiment("motion", "motion.parquet", "motion", ("servo",)),
            excited("prbs", "frequency", 10.0),
            excited("again", "frequency", 9.0),
            excited("slow", "sweep", 6.0),
            Experiment("step", "step.parquet", "tuning", ("servo",), joint=1),
        ),
    )
    simulate_study(study, TRUE, folder, noise=SensorNoise(), as_recorded=False)
    return folder / "study.toml"


@cache
def motion() -> tuple[Study, Any]:
    study = rigid_two_link()
    return study, signals.prepare_motor_signals(
        motion_log(study, values_of(study, 1), 1, 5.0), Arm.of(study.arm)
    )


def rigid_with(options: RigidOptions) -> Any:
    study, motor_record = motion()
    return rigid.fit_rigid([motor_record], Arm.of(study.arm), options).solution


def links_with(options: LinkOptions) -> Any:
    study = rig()
    return links.prepare_link_signals(_log(), Arm.of(study.arm), options).link_velocity


@cache
def _log() -> Any:
    return log_of(prbs_run(rig()), seed=1)


def responses_with(options: FrequencyOptions) -> Any:
    return frequency.estimate_response([case(1, 1).decoupled], options).response


def state_space_with(options: LinearOptions) -> Any:
    model = physical.state_space_of(case(1, 1).decoupled, options)
    return np.concatenate([model.A.ravel(), model.B.ravel(), model.C.ravel(), [model.sample_time]])


def physical_with(options: PhysicalOptions) -> Any:
    record = case(1, 1)
    record_options = physical.RecordOptions(options, state_space=False)
    identification = physical.identify_record(
        record.signals, record.decoupled, record.model, Arm.of(record.study.arm), record_options
    )
    assert identification.joint_model is not None
    return np.array(list(identification.joint_model.values.values()))


OF_STAGES: dict[str, Callable[[Any], Any]] = {
    "rigid": rigid_with,
    "links": links_with,
    "responses": responses_with,
    "statespace": state_space_with,
    "physical": physical_with,
}
CHANGES: dict[str, dict[str, Any]] = {
    "rigid": {"bandwidth_hz": 3.0},
    "links": {"time_constant": 0.05, "order": 1, "bandwidth_hz": 100.0},
    "responses": {"inputs": 1, "segment": 0.3, "transient_periods": 0},
    "statespace": {
        "order": 5,
        "outputs": "motor",
        "inputs": "motor",
        "method": "n4sid",
        "focus": "stability",
        "horizon": 12,
        "decimation": 8,
        "sample_time": 4e-3,
        "filter": "decimation",
        "band_hz": (4.0, 50.0),
    },
    "physical": {"route": "transfer-function", "band_hz": (5.0, 40.0), "use_rigid": False},
    "tuning": {
        "as_published": True,
        "ranges": {"gear_stiffness": (0.999, 1.001)},
        "hold": ("gear_damping",),
        "cutoff_hz": 40.0,
        "settling": True,
        "closed_loop": True,
        "least_deviation": 0.1,
        "max_iterations": 2,
        "rival_effort": 0.0,  # changes no value: tests/identification/whole_arm/test_causes.py
    },
}
BASIS: dict[tuple[str, str], Any] = {
    # options that have an effect only together with another option
    ("responses", "transient_periods"): FrequencyOptions(inputs=1),
    ("statespace", "focus"): LinearOptions(
        order=4, method="n4sid", decimation=8, filter="decimation"
    ),
    ("statespace", "horizon"): LinearOptions(method="n4sid"),
    ("statespace", "filter"): LinearOptions(decimation=8),
}


def test_every_option_is_tested() -> None:
    for stage in fields(Options):
        stage_options = getattr(Options(), stage.name)
        if stage.name == "accept":
            continue  # of all stages; tests/test_input_check.py
        assert {f.name for f in fields(stage_options)} == set(CHANGES[stage.name]), stage.name


@pytest.mark.parametrize(
    ("stage", "key"), [(stage, key) for stage in OF_STAGES for key in CHANGES[stage]]
)
def test_an_option_changes_the_result_of_its_stage(stage: str, key: str) -> None:
    before = BASIS.get((stage, key), getattr(Options(), stage))
    outputs = [
        OF_STAGES[stage](options)
        for options in (before, replace(before, **{key: CHANGES[stage][key]}))
    ]
    assert outputs[0].shape != outputs[1].shape or not np.allclose(
        outputs[0], outputs[1], rtol=1e-9
    )


@pytest.fixture(scope="module")
def begun(small: Path) -> Callable[[WholeArmOptions], whole_arm.Fit]:
    """Whole-arm fit of the small study, started from the results of the earlier stages."""
    before = pipeline.identify(small, stages=("rigid", "decoupled"))
    arguments = (read_logs(before.study), before.rigid, before.joints, Arm.of(before.study.arm))
    default_fit = whole_arm.fit_records(*arguments)

    def fit(options: WholeArmOptions) -> whole_arm.Fit:
        return (
            default_fit
            if options == WholeArmOptions()
            else whole_arm.fit_records(*arguments, options)
        )

    return fit


@pytest.mark.parametrize("key", [key for key in CHANGES["tuning"] if key != "rival_effort"])
def test_an_option_changes_the_whole_arm_fit(
    key: str, begun: Callable[[WholeArmOptions], whole_arm.Fit]
) -> None:
    outputs = []
    for options in (WholeArmOptions(), replace(WholeArmOptions(), **{key: CHANGES["tuning"][key]})):
        fit = begun(options)
        values = fit.values
        outputs.append(
            (len(fit.z), fit.end.is_minimum, [values[name] for name in sorted(TRUE, key=str)])
        )
    assert outputs[0][:2] != outputs[1][:2] or not np.allclose(
        outputs[0][2], outputs[1][2], rtol=1e-9
    )


def test_held_parameters_keep_their_values_and_ranges_bound_estimates(
    begun: Callable[[WholeArmOptions], whole_arm.Fit],
) -> None:
    free = begun(WholeArmOptions())
    start = begun(WholeArmOptions(max_iterations=1)).objective.space
    initial = start.values(np.zeros(len(start.unknowns)))
    k, d = ("gear_stiffness", 1), ("gear_damping", 1)
    constrained = begun(
        WholeArmOptions(ranges={"gear_stiffness 1": (0.9999, 1.0001)}, hold=(d[0],))
    )
    values = constrained.values
    assert values[d] == initial[d] != free.values[d]
    assert abs(values[k] / initial[k] - 1.0) <= 1.0001e-4
    assert d not in constrained.space.keys


def test_tuning_as_published(small: Path) -> None:
    """Fits only step records in closed loop.

    Coulomb friction is held, and the other parameters stay between 0.5 and 2 times their start.
    """
    identification = pipeline.identify(small, options=["tuning.as_published=true"])
    arm, joint = identification.whole_arm, identification.joints[0]
    assert arm is not None
    assert set(arm.fit_percent) == {"step"}
    names = {p.name for p in arm.parameters}
    assert not names & {"motor_coulomb_friction", "friction_offset", "friction_settling_time"}
    coulomb = (
        identification.rigid.value("motor_coulomb_friction", 1) if identification.rigid else None
    )
    assert arm.values["motor_coulomb_friction", 1] == coulomb
    for name in ("motor_inertia", "link_inertia", "gear_stiffness", "gear_damping"):
        assert 0.4999 <= arm.values[name, 1] / joint.values[name] <= 2.0001, name
    assert arm.fit_percent["step"]["omega_m1"] > 95.0
    assert arm.values["motor_inertia", 1] == pytest.approx(1.5e-4, rel=0.05)
    # the result contains the held value, from the stage that estimated it
    held = next(p for p in identification.parameters if p.name == "motor_coulomb_friction")
    assert held.stage != "tuned"


def test_tuning_as_published_needs_steps(small: Path, tmp_path: Path) -> None:
    text = small.read_text().replace('use = "tuning"', 'use = "check"')
    study = tmp_path / "study.toml"
    study.write_text(text)
    for log in small.parent.glob("*.parquet"):
        (tmp_path / log.name).symlink_to(log)
    identification = pipeline.identify(study, options={"tuning": {"as_published": True}})
    assert identification.whole_arm is None
    reasons = [w.message for w in identification.warnings if w.code == "not-tuned"]
    assert any('use = "tuning"' in reason for reason in reasons)


def test_the_sample_time_sets_the_factor_of_each_record() -> None:
    by_factor, by_time, by_both = (
        state_space_with(LinearOptions(order=4, filter="decimation", **changes))
        for changes in (
            {"decimation": 8},
            {"sample_time": 2.1e-3},  # 8.4 samples of 0.25 ms
            {"decimation": 8, "sample_time": 1e-3},
        )
    )
    assert np.array_equal(by_factor, by_time)
    assert np.array_equal(by_factor, by_both)


def test_as_published_without_servo_keeps_the_values_of_the_joints(small: Path) -> None:
    study = read_study(small)
    study = replace(study, arm=replace(study.arm, servo=None))
    identification = pipeline.identify(study, options=AS_PUBLISHED)
    assert identification.whole_arm is None
    (reason,) = [w.message for w in identification.warnings if w.code == "not-tuned"]
    assert "closed loop, but the study has no [servo] table" in reason
    stiffness = next(p for p in identification.parameters if p.name == "gear_stiffness")
    assert stiffness.stage == "decoupled"
    assert stiffness.value == pytest.approx(25000.0, rel=0.1)
    assert "decoupled" in render(identification)


def test_as_published_is_the_whole_recipe(small: Path) -> None:
    """The recorded options are those of the source, and later ones override them."""
    study = read_study(small)
    joints = (replace(study.arm.joints[0], spring="three-slope", effects="auto"),)
    study = replace(study, arm=replace(study.arm, joints=joints))
    identification = pipeline.identify(study, options=[AS_PUBLISHED, "statespace.order=5"])
    linear = replace(PUBLISHED_OPTIONS.statespace, order=5)
    assert identification.study.options == replace(PUBLISHED_OPTIONS, statespace=linear)
    models = [record.state_space for record in identification.records if record.state_space]
    assert [model.order for model in models] == [5, 5, 5]
    assert [model.sample_time for model in models] == pytest.approx([2e-3] * 3)
    (joint,) = identification.joints
    assert joint.method == "transfer-function"
    assert identification.whole_arm is not None
    assert set(identification.whole_arm.fit_percent) == {"step"}
    stiffness = next(p for p in identification.parameters if p.name == "gear_stiffness")
    assert stiffness.stage == "tuned"
    assert stiffness.value == pytest.approx(25000.0, rel=0.1)


def test_the_published_route_runs_to_the_end(small: Path) -> None:
    """State-space models of all records, (15) to (18), then the whole-arm fit."""
    identification = pipeline.identify(small, options=["physical.route=transfer-function"])
    (joint,) = identification.joints
    assert joint.method == "transfer-function"
    assert joint.experiments == ("prbs", "again")
    assert all(record.physical is None and record.transfer for record in identification.records)
    for name in ("motor_inertia", "link_inertia", "gear_stiffness"):
        assert joint.values[name] == pytest.approx(TRUE[name, 1], rel=0.05), name
    assert identification.whole_arm is not None
    assert identification.whole_arm.values["gear_stiffness", 1] == pytest.approx(25000.0, rel=0.005)


def test_a_run_passes_options_to_every_stage(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    received: dict[str, Any] = {}

    def spy(module: Any, name: str, kind: type) -> None:
        original = getattr(module, name)

        def called(*given: Any, **named: Any) -> Any:
            for argument in (*given, *named.values()):
                if isinstance(argument, kind):
                    received[f"{name}"] = argument
            return original(*given, **named)

        monkeypatch.setattr(module, name, called)

    spy(rigid, "fit_rigid", RigidOptions)
    spy(links, "prepare_link_signals", LinkOptions)
    spy(frequency, "estimate_response", FrequencyOptions)
    spy(physical, "fit_joint", PhysicalOptions)
    spy(physical, "fit_record", physical.RecordOptions)
    spy(whole_arm, "fit_whole_arm", WholeArmOptions)
    run_options = Options(
        RigidOptions(4.0),
        LinkOptions(0.1),
        FrequencyOptions(segment=0.2),
        LinearOptions(order=4),
        PhysicalOptions(use_rigid=False),
        WholeArmOptions(max_iterations=1),
    )
    identification = pipeline.identify(small, options=run_options)
    assert received["fit_rigid"] == run_options.rigid
    assert received["prepare_link_signals"] == run_options.links
    assert received["estimate_response"] == run_options.responses
    assert received["fit_joint"] == run_options.physical
    assert received["fit_record"].linear == run_options.statespace
    assert received["fit_record"].physical == run_options.physical
    assert received["fit_whole_arm"] == run_options.tuning
    document = json.loads(result.to_json(result.to_document(identification)))
    assert document["options"]["rigid"] == {"bandwidth_hz": 4.0}
    assert document["options"]["tuning"]["max_iterations"] == 1
    assert document["stages"]["rigid"]["bandwidth_hz"] == 4.0


def test_sweep_records_have_models_responses_and_delays(small: Path) -> None:
    identification = pipeline.identify(small, stages=("rigid", "decoupled"))
    document = json.loads(result.to_json(result.to_document(identification)))
    slow = next(e for e in document["stages"]["decoupled"] if e["experiment"] == "slow")
    model = slow["state_space"]
    assert model["status"] == "converged"
    assert model["resonance_hz"] == pytest.approx(slow["resonance_hz"], rel=0.05)
    slow_responses = [r for r in document["stages"]["responses"] if r["experiments"] == ["slow"]]
    (response,) = slow_responses
    f = np.array(response["frequency_hz"])
    (channel,) = [c for c in response["channels"] if c["output"] == "motor_velocity"]
    for part in ("re", "im", "noise_variance"):
        assert len(channel[part]) == len(f)
    assert min(channel["noise_variance"]) > 0.0
    coherence = np.array(response["coherence"]["motor_velocity"])
    in_band = (f > 5.0) & (f < 40.0)
    assert np.median(coherence[in_band]) > 0.8
    # the minimum of the response is at the zeros of the model
    magnitude = np.abs(np.array(channel["re"]) + 1j * np.array(channel["im"]))
    near_zero = (f > 0.7 * slow["anti_resonance_hz"]) & (f < 1.3 * slow["anti_resonance_hz"])
    assert f[near_zero][np.argmin(magnitude[near_zero])] == pytest.approx(
        slow["anti_resonance_hz"], rel=0.15
    )
    link = next(e for e in document["stages"]["links"] if e["experiment"] == "slow")
    assert link["joint"] == 1
    assert link["source"] == "accelerometer"
    assert link["fusion"] == {"time_constant": 0.2, "order": 2}
    assert 0.0 < link["fusion_error"] < 0.1
    for delay in (link["sensor_delay"], link["drive_delay"]):
        assert delay is None or abs(delay["value"]) < 1e-3
