"""Final table and verdict: precedence of stages, rejection of impossible values, status."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from results import arm_model, criticism
from strainwave.domain import (
    STAGES,
    Activity,
    AgreementTest,
    ArmModel,
    Criticism,
    Diagnostic,
    FloatArray,
    Identification,
    JointModel,
    Parameter,
    Place,
    Prediction,
    ResidualTest,
    RigidModel,
    SearchEnd,
    Stage,
    Study,
    Suspicion,
    half_width,
    is_physical,
)
from strainwave.domain.arm.description import unit_of
from strainwave.domain.messages import Clause
from strainwave.domain.results.identification import merge_by_cause, model_defects
from strainwave.virtual import scara
from virtual_arms import rigid_drive, rigid_two_link

ELASTIC = scara.STIFF.study(rigid_two_link().path, "linear")
TRUTH = scara.STIFF.parameters(spring="linear")
N = 0.01
RIGID = (
    ("rigid_inertia", 1),
    ("motor_inertia", 2),
    ("beta", None),
    ("gamma", None),
    *((name, j) for j in (1, 2) for name in ("total_viscous_friction", "motor_coulomb_friction")),
)
Sizes = dict[tuple[str, int | None], float | None]
OWN = ("motor_inertia", "motor_viscous_friction", "link_inertia", "link_viscous_friction")
JOINT = (*OWN, "gear_stiffness", "gear_damping", "motor_coulomb_friction")
WHOLE = (("alpha", None), ("beta", None), ("gamma", None), *((n, j) for j in (1, 2) for n in JOINT))


def true(name: str, joint: int | None) -> float:
    """True value of a parameter of the built-in arm, including derived parameters."""
    alpha, beta, gamma = (TRUTH[n, None] for n in ("alpha", "beta", "gamma"))
    if name == "rigid_inertia":
        return alpha + TRUTH["motor_inertia", 1] / N**2
    if name == "link_inertia":
        return alpha + beta + 2.0 * gamma if joint == 1 else beta
    if name == "total_viscous_friction":
        motor, link = (TRUTH[f"{w}_viscous_friction", joint] for w in ("motor", "link"))
        return motor + N**2 * link
    return TRUTH[name, joint]


def made(
    name: str, joint: int | None, stage: Stage, size: float | None = 1.0, spread: float = 0.01
) -> Parameter:
    """Parameter of `size` times its true value, with the relative standard deviation `spread`."""
    unit = "kg m^2" if joint is None else unit_of(name, ELASTIC.arm.joints[joint - 1])
    if size is None:
        return Parameter(name, joint, None, None, unit, stage)
    value, std = size * true(name, joint), spread * abs(true(name, joint))
    return Parameter(name, joint, value, std, unit, stage, (value - 1.96 * std, value + 1.96 * std))


def rigid_of(parameters: tuple[Parameter, ...]) -> RigidModel:
    return RigidModel(
        parameters=parameters,
        solution=np.array([p.value or 0.0 for p in parameters]),
        covariance=np.diag([(p.std or 0.0) ** 2 for p in parameters]),
        condition_number=5.0,
        fit_percent={"motion": {"u1": 97.0}},
        bandwidth_hz=5.0,
        decimation=4,
        n_rows=300,
        status="determined",
    )


def joint_of(
    number: int, parameters: tuple[Parameter, ...], status: str = "determined"
) -> JointModel:
    return JointModel(
        joint=number,
        experiments=(f"prbs-j{number}",),
        method="grey-box",
        parameters=parameters,
        values={p.name: p.value or 0.0 for p in parameters},
        covariance=np.eye(len(parameters)),
        anti_resonance=None,
        resonance=None,
        band_hz=(1.0, 50.0),
        fit_percent={},
        status=status,  # type: ignore[arg-type]
    )


def clean_fit(parameters: tuple[Parameter, ...]) -> ArmModel:
    """Fit with residuals at noise level."""
    return replace(arm_model(parameters, np.eye(len(parameters))), criticism=None)


ACTIVE = tuple(Activity(j, torque=0.4, velocity=30.0, acceleration=900.0) for j in (1, 2))


def run(
    rigid: Sizes | None = None,
    joints: Sizes | None = None,
    whole_arm: Sizes | None = None,
    *,
    stages: tuple[Stage, ...] = ("rigid", "decoupled", "tuned"),
    study: Study = ELASTIC,
) -> Identification:
    """Run that estimates the true values times the given sizes; None means not identified.

    The total viscous friction is the sum of its parts, as in the stages.
    """
    rigid, joints, whole_arm = rigid or {}, dict(joints or {}), dict(whole_arm or {})
    for sizes in (joints, whole_arm):
        for j in (1, 2):
            sizes.setdefault(("total_viscous_friction", j), _total(sizes, j))
    models = tuple(
        joint_of(
            j,
            tuple(
                made(name, j, "decoupled", joints.get((name, j), 1.0))
                for name in (*JOINT, "total_viscous_friction")
            ),
        )
        for j in (1, 2)
    )
    whole = [made(*key, "tuned", whole_arm.get(key, 1.0)) for key in WHOLE]
    whole += [
        made(name, j, "tuned", whole_arm.get((name, j), 1.0))
        for name, j in (("rigid_inertia", 1), *(("total_viscous_friction", j) for j in (1, 2)))
    ]
    return Identification(
        study=study,
        created="2026-01-01T00:00:00+00:00",
        version="0",
        stages=stages,
        rigid=rigid_of(tuple(made(*key, "rigid", rigid.get(key, 1.0)) for key in RIGID)),
        fitted=(),
        checks=(),
        stage_warnings=(),
        timing_s={},
        joints=models if "decoupled" in stages else (),
        whole_arm=clean_fit(tuple(whole)) if "tuned" in stages else None,
        activity=ACTIVE,
    )


def _total(sizes: Sizes, joint: int) -> float:
    """Sum d_M + n^2 d_L, relative to its true value; parts without a value have their true value."""
    total = 0.0
    for name, weight in (("motor_viscous_friction", 1.0), ("link_viscous_friction", N**2)):
        size = sizes.get((name, joint), 1.0)
        total += weight * true(name, joint) * (1.0 if size is None else size)
    return total / true("total_viscous_friction", joint)


def row(found: Identification, name: str, joint: int | None = None) -> Parameter:
    return next(p for p in found.parameters if (p.name, p.joint) == (name, joint))


def test_a_run_that_identifies_every_parameter_is_determined() -> None:
    for stages in (("rigid",), ("rigid", "decoupled"), ("rigid", "decoupled", "tuned")):
        verdict = run(stages=stages).verdict
        assert (verdict.status, verdict.exit_code) == ("determined", 0), verdict
        assert verdict.reasons == ()


def test_the_link_inertia_of_a_bent_arm_is_reported_at_zero_angles() -> None:
    result = run(stages=("rigid", "decoupled"))
    first, second = result.joints
    bend, gamma = 0.9, TRUTH["gamma", None]
    change = 2.0 * gamma * (1.0 - np.cos(bend))
    parameters = tuple(
        replace(p, value=(p.value or 0.0) - change) if p.name == "link_inertia" else p
        for p in first.parameters
    )
    bent = replace(first, parameters=parameters, posture=(0.2, bend))
    at_zero = replace(result, joints=(bent, second))
    for name, joint in (("link_inertia", 1), ("alpha", None), ("rigid_inertia", 1)):
        assert row(at_zero, name, joint).value == pytest.approx(true(name, joint)), name
    assert at_zero.verdict.status == "determined"


SIZES = st.one_of(st.none(), st.sampled_from((1.0, 0.9, -0.005, -3.0)), st.floats(-2.0, 2.0))


@settings(max_examples=150, deadline=None)
@given(
    rigid=st.dictionaries(st.sampled_from(RIGID), SIZES, max_size=4),
    joints=st.dictionaries(
        st.tuples(st.sampled_from(JOINT), st.sampled_from((1, 2))), SIZES, max_size=4
    ),
    whole_arm=st.dictionaries(st.sampled_from(WHOLE), SIZES, max_size=4),
    last=st.integers(1, 3),
)
def test_every_verdict_is_consistent_with_its_decisions(
    rigid: Sizes,
    joints: Sizes,
    whole_arm: Sizes,
    last: int,
) -> None:
    """The last stage decides, no impossible value is published, and the groups are disjoint."""
    stages = STAGES[:last]
    identification = run(rigid, joints, whole_arm, stages=stages)
    parameters, verdict = identification.parameters, identification.verdict
    keys = [(p.name, p.joint) for p in parameters]
    assert len(set(keys)) == len(keys)
    for p in parameters:
        is_at_zero = p.value == 0.0 and p.ci95 is not None and p.ci95[0] == 0.0
        assert p.value is None or is_at_zero or is_physical(p.name, p.value), p
    if last == 3:
        for key, size in whole_arm.items():
            if size is None:
                assert row(identification, *key).value is None
        assert {p.stage for p in parameters} == {"tuned"}
    else:  # before the whole-arm fit, sums equal their parts
        body = {p.name: p for p in parameters if p.stage == "decoupled"}
        if "alpha" in body and row(identification, "beta").value is not None:
            link, gamma = (
                row(identification, "link_inertia", 1).value,
                row(identification, "gamma").value,
            )
            alpha, beta = body["alpha"].value, row(identification, "beta").value
            if not {None, 0.0} & {link, alpha, beta, gamma}:  # zero is a bound, no estimate
                assert link == pytest.approx(alpha + beta + 2.0 * gamma)  # type: ignore[operator]
    for j in (1, 2) if last > 1 else ():
        motor, link, total = (
            row(identification, f"{what}_viscous_friction", j).value
            for what in ("motor", "link", "total")
        )
        if motor is not None and link is not None:
            assert total == pytest.approx(motor + N**2 * link)
    groups = (verdict.identified, verdict.not_identified, verdict.rejected)
    keys = [key for group in groups for key in group]
    assert len(set(keys)) == len(keys)
    assert {p.key for p in parameters} <= set(keys)
    for decision in identification.decisions:
        if decision.identified:
            assert decision.parameter.value is not None
            assert half_width(decision.parameter) is not None
        else:
            assert decision.parameter.key not in verdict.identified
        assert not decision.rejected or decision.parameter.value is None
    assert (verdict.exit_code == 0) == (verdict.status == "determined")
    assert (verdict.status == "determined") == (not verdict.reasons)


def test_a_parameter_that_the_whole_arm_fit_does_not_identify_is_not_identified() -> None:
    """Regression: the table had 11.71 +- 0.17 of the decoupled stage despite null of the fit."""
    split: Sizes = {("link_viscous_friction", 1): None, ("motor_viscous_friction", 1): None}
    result = run(joints={("link_viscous_friction", 1): 20.0}, whole_arm=split)
    assert row(result, "link_viscous_friction", 1).value is None
    assert row(result, "motor_viscous_friction", 1).value is None
    assert (
        result.verdict.status == "determined"
    )  # the parts of viscous friction are not primary parameters
    result = run(whole_arm={("gear_damping", 2): None})
    assert result.verdict.status == "partly-determined"
    assert result.verdict.not_identified == (("gear_damping", 2),)
    assert result.reason == "not identified: gear_damping 2"


def test_only_an_impossible_value_is_rejected() -> None:
    """All other values of the joint remain."""
    result = run(joints={("gear_damping", 2): -1.0}, stages=("rigid", "decoupled"))
    assert result.verdict.rejected == (("gear_damping", 2),)
    assert row(result, "gear_damping", 2).value is None
    assert row(result, "gear_stiffness", 2).value is not None
    (warning,) = [w for w in result.warnings if w.code == "rejected"]
    assert warning.where == "gear_damping of joint 2"
    assert "-4 N m s/rad is physically impossible" in warning.message


def test_decoupled_values_replace_rigid_values_and_determine_base_parameters() -> None:
    result = run(joints={("link_inertia", 2): 1.02}, stages=("rigid", "decoupled"))
    beta, alpha = row(result, "beta"), row(result, "alpha")
    assert beta.value == row(result, "link_inertia", 2).value
    assert (beta.stage, alpha.stage) == ("decoupled", "decoupled")
    rigid = row(result, "rigid_inertia", 1).value
    assert rigid is not None
    assert alpha.value is not None
    motor = row(result, "motor_inertia", 1).value
    assert motor is not None
    assert rigid == pytest.approx(alpha.value + motor / N**2)


def test_a_friction_with_a_negligible_interval_is_identified() -> None:
    """Limit of the half-width, 2 % of the torque: 0.008 N m (Coulomb), 2.7e-4 N m s/rad (viscous)."""
    for name, std, counts in (
        ("motor_coulomb_friction", 0.0040, True),
        ("motor_coulomb_friction", 0.0042, False),
        ("total_viscous_friction", 1.3e-4, True),
        ("total_viscous_friction", 1.4e-4, False),
    ):
        for value in (1e-6, -1e-6):
            result = run(stages=("rigid",))
            assert result.rigid is not None
            uncertain = Parameter(
                name, 1, value, std, "-", "rigid", (value - 1.96 * std, value + 1.96 * std)
            )
            others = [p for p in result.rigid.parameters if (p.name, p.joint) != (name, 1)]
            result = replace(result, rigid=rigid_of((*others, uncertain)))
            assert ((name, 1) in result.verdict.identified) == counts
            p = row(result, name, 1)
            if value < 0.0:
                assert p.value == 0.0
                assert p.ci95 == (0.0, value + 1.96 * std)


def test_an_indefinite_inertia_matrix_is_rejected() -> None:
    result = run(whole_arm={("gamma", None): 1.3})  # gamma^2 > alpha beta
    assert result.verdict.rejected == (("gamma", None),)
    assert result.verdict.status == "partly-determined"


def test_values_at_a_bound_are_rejected() -> None:
    result = run()
    assert result.whole_arm is not None
    bounded = replace(result.whole_arm, end=SearchEnd.BOUND, at_bounds=(("gear_damping", 1),))
    result = replace(result, whole_arm=bounded)
    assert result.verdict.rejected == (("gear_damping", 1),)
    secondary = replace(bounded, at_bounds=(("link_viscous_friction", 1),))
    assert replace(result, whole_arm=secondary).verdict.status == "determined"


def test_a_fit_that_did_not_converge_is_partly_determined() -> None:
    result = run()
    assert result.whole_arm is not None
    result = replace(result, whole_arm=replace(result.whole_arm, end=SearchEnd.EVALUATION_LIMIT))
    assert result.verdict.status == "partly-determined"
    assert result.reason == "the whole-arm fit did not converge"


def test_contradicting_stages_reject_the_affected_values() -> None:
    result = run()
    assert result.whole_arm is not None
    inertia_test = AgreementTest("inertias", None, 50.0, 4, 6.3)
    contradicted = replace(result, whole_arm=replace(result.whole_arm, agreement=(inertia_test,)))
    assert all(p.value is None for p in contradicted.parameters)
    assert (contradicted.verdict.status, contradicted.verdict.exit_code) == ("not-determined", 3)
    friction_test = AgreementTest("friction", 2, 50.0, 3, 6.5)
    differing = replace(result, whole_arm=replace(result.whole_arm, agreement=(friction_test,)))
    assert differing.verdict.status == "determined"  # the intervals contain the difference
    residual = ResidualTest(
        "prbs-j1",
        "omega_m1",
        2.0,
        0.1,
        np.zeros(1),
        np.zeros(1),
        np.zeros(1),
        0.0,
        0.0,
        1,
        0.0,
        0.0,
        1.0,
    )
    lacking = replace(
        result.whole_arm, agreement=(inertia_test,), criticism=Criticism((residual,), ())
    )
    assert not lacking.contradictions  # the model lacks an effect
    small_test = AgreementTest("inertias", None, 15.0, 4, 2.8)  # probability 0.005
    assert (
        replace(
            result, whole_arm=replace(result.whole_arm, agreement=(small_test,))
        ).verdict.exit_code
        == 0
    )


def check_of(
    channels: tuple[str, ...],
    *,
    unexplained: dict[str, float] | None = None,
    servo: bool = False,
) -> Prediction:
    """Validation record of the arm or of the drives that excites both gears."""
    time: FloatArray = 0.01 * np.arange(100, dtype=np.float64)
    motion = np.column_stack([np.sin(time) for _ in channels])
    return Prediction(
        "step-check",
        time,
        channels,
        motion,
        motion,
        dict.fromkeys(channels, 22.6),
        stiffness_effect={1: dict.fromkeys(channels, 0.5), 2: dict.fromkeys(channels, 0.5)},
        unexplained=unexplained or {},
        is_servo_at_fault=servo,
    )


@pytest.mark.parametrize("servo", [True, False])
def test_a_check_record_that_is_not_predicted_excludes_determined(*, servo: bool) -> None:
    """The reason contains record, channel, error and remedy; neither model is validated."""
    channel = "omega_m1"
    result = replace(run(), checks=(check_of((channel,)),))
    assert result.verdict.status == "determined"
    unpredicted_check = check_of((channel,), unexplained={channel: 41.0}, servo=servo)
    unpredicted = replace(result, checks=(unpredicted_check,))
    verdict = unpredicted.verdict
    assert (verdict.status, verdict.exit_code) == ("partly-determined", 3)
    assert not verdict.validated.rigid
    assert not verdict.validated.elastic
    (reason,) = verdict.reasons
    for part in ("step-check:", channel, "22.6 %", "41 times"):
        assert part in reason
    assert ("correct kp" in reason) == servo
    (warning,) = [w for w in unpredicted.warnings if w.code == "not-predicted"]
    assert warning.where == "step-check"


STEPS = ("step-check-j1", "step-check-j2")
UNVALIDATED: dict[str, tuple[tuple[str, ...], dict[str, str], Any, str]] = {
    "no check record": ((), {}, None, "the study has no check record; record"),
    "not simulated": (
        STEPS,
        dict.fromkeys(STEPS, "the study has no [servo] table"),
        None,
        "no simulation of step-check-j1 and step-check-j2: the study has no [servo] table; supply",
    ),
    "for two reasons": (
        STEPS,
        {STEPS[0]: "it diverges"},
        None,
        "no simulation of step-check-j1: it diverges;"
        " no simulation of step-check-j2: a defect of the data; supply",
    ),
    "one gear not loaded": (
        STEPS[:1],
        {},
        {1: {"omega_m1": 0.01, "a1": 0.031}, 2: {"a1": 0.2}},
        "20 % more gear stiffness of joint 1 changes no channel of a check record by 5 % of its"
        " standard deviation: most a1 of step-check-j1, by 3.1 %; supply",
    ),
    "no motion": (
        STEPS[:1],
        {},
        {1: {}, 2: {"a1": 0.2}},
        "no channel moves in the check records, so none depends on the gear of joint 1; supply",
    ),
}


@pytest.mark.parametrize(
    ("names", "reasons", "effects", "message"), UNVALIDATED.values(), ids=UNVALIDATED
)
def test_a_warning_says_why_no_check_record_validates_the_elastic_model(
    names: tuple[str, ...], reasons: dict[str, str], effects: Any, message: str
) -> None:
    result = run()
    kept = [e for e in result.study.experiments if e.use != "check" or e.name in names]
    check = replace(check_of(("omega_m1", "a1")), experiment=STEPS[0], stiffness_effect=effects)
    result = replace(
        result,
        study=replace(result.study, experiments=tuple(kept)),
        checks=(check,) if effects else (),
        not_simulated=reasons,
    )
    assert not result.verdict.validated.elastic
    (warning,) = [w for w in result.warnings if w.code == "elastic-not-validated"]
    assert warning.message.startswith(message)


def test_a_channel_is_reported_at_rest_if_no_check_record_moves_it() -> None:
    steps = replace(check_of(("u1", "u2")), fit_percent={"u1": 98.0, "u2": float("nan")})
    others = replace(steps, experiment="other", fit_percent={"u1": float("nan"), "u2": 97.0})
    result = replace(run(), checks=(steps,))
    (warning,) = [w for w in result.warnings if w.code == "nothing-to-predict"]
    assert (warning.where, "for u2" in warning.message) == ("step-check", True)
    both = replace(result, checks=(steps, others))
    assert "nothing-to-predict" not in {w.code for w in both.warnings}


@pytest.mark.parametrize("elastic", [True, False])
def test_torques_of_the_rigid_model_decide_only_if_all_joints_are_rigid(*, elastic: bool) -> None:
    """The rigid model omits the vibration of elastic gears."""
    result = replace(run(), checks=(check_of(("u1",), unexplained={"u1": 41.0}),))
    if not elastic:
        arm = result.study.arm
        rigid = tuple(replace(joint, spring="rigid") for joint in arm.joints)
        result = replace(result, study=replace(result.study, arm=replace(arm, joints=rigid)))
    defects = [defect.where for defect in model_defects(result) if defect.code == "not-predicted"]
    assert defects == ([] if elastic else ["step-check"])


@pytest.mark.parametrize(
    ("fit", "noise", "excluded"), [(61.0, 0.001, True), (61.0, 0.5, False), (99.0, 0.001, False)]
)
def test_residuals_far_above_the_noise_exclude_determined(
    fit: float, noise: float, *, excluded: bool
) -> None:
    """They must also be large relative to the signal."""
    result = run()
    assert result.whole_arm is not None
    residual = replace(criticism().residuals[0], deviation=1.0, noise=noise)
    whole_arm = replace(
        result.whole_arm,
        fit_percent={"prbs-j1": {"a1": fit}},
        criticism=Criticism((residual,), ()),
    )
    poor_fit = replace(result, whole_arm=whole_arm)
    assert (poor_fit.verdict.status != "determined") == excluded
    if excluded:
        (reason,) = poor_fit.verdict.reasons
        for part in ("a1", "prbs-j1:", "1e+03 times", "39 %"):
            assert part in reason
        checked = replace(poor_fit, checks=(check_of(("omega_m1",)),))
        assert not checked.verdict.validated.elastic  # a model that does not fit is not validated
        assert "elastic-not-validated" not in {w.code for w in checked.warnings}


def test_a_torque_constant_in_another_unit_excludes_determined() -> None:
    result = run(whole_arm=dict.fromkeys(WHOLE, 1000.0))
    joints = tuple(replace(j, torque_per_volt=90.0) for j in result.study.arm.joints)
    study = replace(result.study, arm=result.study.arm.with_joints(joints))
    wrong = replace(result, study=study)
    assert wrong.verdict.status == "partly-determined"
    assert "torque_per_volt 1 = 90 N m/V" in wrong.verdict.reasons[0]
    assert "written as torque_per_volt = 0.09" in wrong.verdict.reasons[0]
    codes = [w.where for w in wrong.warnings if w.code == "implausible-size"]
    assert codes == ["joint 1", "joint 2"]


@pytest.mark.parametrize(
    ("place", "code", "accepted_stages"),
    [
        (Place(channel="u1"), "wrong-unit", set()),
        (Place(joint=2, key="gear_ratio"), "wrong-gear-ratio", set()),
        (Place(channel="a1"), "wrong-unit", {"rigid"}),
        (Place(experiments=("prbs-j1",), channel="a2"), "misaligned", {"rigid"}),
        (Place(joint=1), "wrong-geometry", {"rigid"}),
        (Place.in_records("motion"), "clock-drift", set()),
        (Place.in_records("prbs-j1", "prbs-j2"), "clock-drift", {"rigid"}),
        (Place.in_records("step-j1"), "clock-drift", {"rigid", "decoupled"}),
        (Place.in_records("motion-check"), "clock-drift", {"tuned"}),
    ],
)
def test_a_fault_rejects_the_values_of_the_stages_that_it_affects(
    place: Place, code: str, accepted_stages: set[str]
) -> None:
    text = Clause("text", text="m")
    fault = Suspicion(code=code, places=(place,), clause=text, remedy_clause=text)
    result = replace(run(), suspected=(fault,))
    assert {p.stage for p in result.parameters if p.value is not None} == accepted_stages
    verdict = result.verdict
    assert (verdict.status, verdict.exit_code) == ("inconsistent-input", 3)
    assert verdict.suspected == (fault,)
    assert verdict.reasons[0] == "m"


def test_required_parameters_depend_on_springs_and_stages() -> None:
    """A rigid drive has no link parameters; only the whole-arm fit requires three slopes."""
    parameters = tuple(
        Parameter(name, 1, 1.0, 0.01, "-", "rigid", (0.98, 1.02))
        for name in ("inertia", "motor_viscous_friction", "motor_coulomb_friction")
    )
    drive = replace(
        run(), study=rigid_drive(), rigid=rigid_of(parameters), joints=(), whole_arm=None
    )
    assert drive.verdict.status == "determined"
    assert replace(drive, rigid=None).verdict.status == "not-determined"
    with_gravity = replace(drive, study=rigid_drive(9.81))
    assert with_gravity.verdict.not_identified == (("gravity_torque_1", None),)
    curved = scara.STIFF.study(ELASTIC.path, "three-slope")
    assert run(study=curved, stages=("rigid", "decoupled")).verdict.status == "determined"
    missing = run(study=curved).verdict.not_identified
    assert {key for key in missing if key[0].startswith("gear")} == {
        (name, j)
        for j in (1, 2)
        for name in (
            *(f"gear_stiffness_k{k}" for k in (1, 2, 3)),
            "gear_knee_t1",
            "gear_knee_t2",
        )
    }


def test_stages_that_were_not_reached_are_reported() -> None:
    result = replace(run(), whole_arm=None)
    assert result.verdict.status == "partly-determined"
    assert result.verdict.reasons == ("the whole-arm fit was not reached",)
    result = replace(result, joints=result.joints[:1])
    assert "the decoupled stage gave no model of joint 2" in result.verdict.reasons
    assert ("gear_stiffness", 2) in result.verdict.not_identified


def test_warnings_of_several_records_with_one_cause_are_merged() -> None:
    records = ("prbs-j1", "prbs-j2")
    delays = [
        Diagnostic(
            "misaligned",
            Place.in_records(name),
            channel=f"a{j}",
            delay=delay,
            std=1e-5,
            side="behind",
        )
        for name, delay in zip(records, (0.72e-3, 0.5e-3), strict=True)
        for j in (1, 2)
    ]
    beta = Place(parameter="beta")
    other = Diagnostic("at-bounds", beta, value=0.72, unit="kg m^2")
    first, second, third = merge_by_cause([*delays, other])
    assert first.where == "prbs-j1, prbs-j2"
    assert first.experiments == records
    assert first.message.startswith("a1 is 0.5 to 0.72 +- 0.01 ms behind the motor encoder; ")
    assert first.observation == "a1 is 0.5 to 0.72 +- 0.01 ms behind the motor encoder"
    assert "a2" in second.message
    assert third == other


def test_warnings_of_joints_in_several_records_are_merged() -> None:
    records = ("prbs-j1", "prbs-j1-servo", "prbs-j2")
    spectra = [
        Diagnostic("interaction-spectrum", Place.in_records(name, joint=j), share=share)
        for name, j, share in (("prbs-j1", 1, 0.2), ("prbs-j1-servo", 1, 0.35), ("prbs-j2", 2, 0.1))
    ]
    place = Place.in_records("prbs-j2", joint=2)
    amplitude = Diagnostic("interaction-amplitude", place, ratio=0.4)
    without_record = spectra[0].at(Place(file="other.csv"))
    merged, single, unmerged = merge_by_cause([*spectra, amplitude, without_record])
    assert merged.where == "prbs-j1 (joint 1), prbs-j1-servo (joint 1), prbs-j2 (joint 2)"
    assert merged.experiments == records
    assert merged.observation == "tau is above its noise in 10 to 35 % of the band"
    assert single == amplitude
    assert unmerged == without_record


def test_nested_measurements_are_merged() -> None:
    dependences = [Clause("follows-input", joint=1, delay=delay) for delay in (1e-3, 4e-3)]
    warnings = [
        Diagnostic(
            "residual-not-noise",
            Place.in_records(name),
            channel="a1",
            ratio=5.0,
            worst_hz=20.0,
            dependence=dependence,
            unexplained=None,
        )
        for name, dependence in zip("ab", dependences, strict=True)
    ]
    (merged,) = merge_by_cause(warnings)
    assert "joint 1's input by 1 to 4 ms" in merged.message


def test_a_later_stage_supersedes_warnings_of_an_earlier_one() -> None:
    early = Diagnostic(
        "implausible",
        Place(joint=1, parameter="gear_damping"),
        "rigid",
        value=-1.0,
        unit="N m s/rad",
    )
    result = replace(run(), stage_warnings=(early,))
    assert early not in result.warnings
    assert early in replace(result, whole_arm=None).warnings
    place = Place(joint=1, parameter="gear_stiffness")
    slope_warning = Diagnostic("equivalent-stiffness", place, records="prbs", note="one slope")
    assert result.whole_arm is not None
    slope = made("gear_stiffness", 1, "tuned")
    curve = tuple(replace(slope, name=f"gear_stiffness_k{k}") for k in (1, 2, 3))
    parameters = tuple(p for p in result.whole_arm.parameters if p.name != "gear_stiffness")
    whole_arm = replace(result.whole_arm, parameters=parameters + curve)
    arm = result.study.arm
    curved = arm.with_joints(replace(joint, spring="three-slope") for joint in arm.joints)
    study = replace(result.study, arm=curved)
    result = replace(result, study=study, whole_arm=whole_arm, stage_warnings=(slope_warning,))
    assert result.warnings == replace(result, stage_warnings=()).warnings
