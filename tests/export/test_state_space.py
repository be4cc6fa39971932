"""Exported joint models have the frequency response of (17) in other programs."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

import exports
from strainwave.domain import ComplexArray, FloatArray, Prbs
from strainwave.domain.keys import Values
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.dynamics.two_inertia import NAMES, TwoInertia, coefficients, joint_of
from strainwave.errors import InvalidInput
from strainwave.export import state_space
from strainwave.export.linear_models import linear_arm, to_state_space
from strainwave.export.mjcf import to_mjcf
from strainwave.export.mjcf_drives import Target
from strainwave.export.source import Export, IdentifiedArm

OMEGA: FloatArray = np.geomspace(1.0, 1e3, 40)


def truth(values: Values, joint: int) -> TwoInertia:
    """A joint of the rig; the inertia of its link by (3)."""
    alpha, beta, gamma = (values[name, None] for name in ("alpha", "beta", "gamma"))
    known = values | {
        ("link_inertia", 1): alpha + beta + 2.0 * gamma,
        ("link_inertia", 2): beta,
    }
    return joint_of(np.array([known[name, joint] for name in NAMES]), 0.01)


def expected(p: TwoInertia) -> tuple[ComplexArray, ComplexArray]:
    """Responses to motor torque: velocity (17), link acceleration s n (k + d_G s)/k / a(s)."""
    s: ComplexArray = np.asarray(1j * OMEGA)
    b, a = coefficients(p)
    lag = np.polyval(a[::-1], s)
    torsion = p.gear_ratio * (1.0 + p.gear_damping / p.gear_stiffness * s)
    return np.polyval(b[::-1], s) / lag, s * torsion / lag


# SciPy warns of numerators with vanishing leading coefficients
@pytest.mark.filterwarnings("ignore::scipy.signal.BadCoefficients")
@pytest.mark.parametrize("joint", [1, 2])
def test_scipy_gives_the_transfer_functions(joint: int, tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    values = exports.values_of(study)
    A, B, C, D = state_space(exports.arm_of(study, values), joint)
    motor, link = expected(truth(values, joint))
    for output, wanted in enumerate((motor, link)):
        system = signal.StateSpace(A, B[:, :1], C[[output]], D[[output], :1])
        _, response = signal.freqresp(system, OMEGA)
        assert response == pytest.approx(wanted, rel=1e-8)


def test_python_control_gives_the_transfer_functions(tmp_path: Path) -> None:
    control = pytest.importorskip("control", reason="python-control is not installed")
    study = exports.two_links(tmp_path)
    values = exports.values_of(study)
    response = control.ss(*state_space(exports.arm_of(study, values), 1))(1j * OMEGA)
    for output, wanted in enumerate(expected(truth(values, 1))):
        assert response[output, 0] == pytest.approx(wanted, rel=1e-8)


def test_python_control_simulates_the_joint_as_the_core(tmp_path: Path) -> None:
    """Both are exact for held voltages, up to the integration error of 1e-9."""
    control = pytest.importorskip("control", reason="python-control is not installed")
    study, values = exports.single(tmp_path, spring="linear")
    offset = values["friction_offset", 1]
    torque = excitation.prbs(Prbs(8, 1e-3, 1, 5.0))
    still = (0.0,)
    drive = Drive(1e-3, torque[:, None], 0.0 * torque[:, None], (False,), still, still)
    ours = simulate(
        Arm.of(study.arm),
        values,
        drive,
        sample_time=1e-3,
        samples=len(torque),
        record=["motor_velocity"],
    )
    A, B, C, D = state_space(exports.arm_of(study, values), 1)
    sampled = control.c2d(control.ss(A, B[:, :1], C[:1], D[:1, :1]), 1e-3, "zoh")
    _, moved = control.forced_response(sampled, inputs=torque - offset)
    wanted = ours["motor_velocity"][:, 0]
    np.testing.assert_allclose(np.squeeze(moved), wanted, atol=1e-7 * np.abs(wanted).max())


def test_the_interaction_torque_accelerates_the_link_directly(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    values = exports.values_of(study)
    A, B, C, D = state_space(exports.arm_of(study, values), 2)
    assert D.tolist() == [[0.0, 0.0], [0.0, 1.0 / values["beta", None]]]
    # above all resonances the link is free; in steady state the velocity does not change
    s = 1e9
    G = C @ np.linalg.solve(s * np.eye(3) - A, B) + D
    assert G[1, 1] == pytest.approx(1.0 / values["beta", None], rel=1e-6)
    assert (C @ np.linalg.solve(-A, B) + D)[1] == pytest.approx(0.0, abs=1e-9)


def test_the_file_contains_the_matrices(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    arm = exports.arm_of(study, exports.values_of(study))
    export = to_state_space(arm)
    document = json.loads(export.data)
    assert export.warnings == ()
    assert document["notes"] == list(export.notes)
    assert export.notes[0].startswith("lost: motor_coulomb_friction (joint 1, 2), ")
    assert document["states"] == ["torsion", "motor_velocity", "link_velocity"]
    for joint in (1, 2):
        found = [document["joints"][joint - 1][name] for name in "ABCD"]
        assert found == [matrix.tolist() for matrix in state_space(arm, joint)]


def test_three_slopes_are_linearised_by_the_middle_one(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path, "three-slope")
    values = exports.values_of(study)
    arm = exports.arm_of(study, values)
    A = state_space(arm, 1)[0]
    assert A[1, 0] == -0.01 * values["gear_stiffness_k2", 1] / values["motor_inertia", 1]
    warnings = to_state_space(arm).warnings
    assert [(c.code, c.where) for c in warnings] == [
        ("linearised", "joint 1"),
        ("linearised", "joint 2"),
    ]


@pytest.mark.parametrize("render", [to_state_space, partial(to_mjcf, target=Target.of("3"))])
def test_a_cubic_gear_is_linearised_without_torsion(
    render: Callable[[IdentifiedArm], Export], tmp_path: Path
) -> None:
    study = exports.two_links(tmp_path, "cubic")
    values = exports.values_of(study) | {("gear_stiffness_cubic", j): 1e8 for j in (1, 2)}
    arm = exports.arm_of(study, values)
    warnings = render(arm).warnings
    assert [(c.code, c.where) for c in warnings] == [
        ("linearised", "joint 1"),
        ("linearised", "joint 2"),
    ]
    A = state_space(arm, 1)[0]
    assert A[1, 0] == -0.01 * values["gear_stiffness", 1] / values["motor_inertia", 1]


def test_a_reported_link_inertia_is_used(tmp_path: Path) -> None:
    study, values = exports.single(tmp_path, spring="linear")
    B = state_space(exports.arm_of(study, values), 1)[1]
    assert B[2, 1] == 1.0 / values["link_inertia", 1]


def test_rigid_gears_and_unknown_joints_are_refused(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path, "rigid")
    arm = exports.arm_of(study, exports.values_of(study))
    with pytest.raises(InvalidInput, match="joint 1 has a rigid gear"):
        state_space(arm, 1)
    for number in (0, 3):
        with pytest.raises(InvalidInput, match=f"there is no joint {number}"):
            state_space(arm, number)


def test_coupled_joints_are_refused(tmp_path: Path) -> None:
    study = exports.two_links(tmp_path)
    coupled = replace(study.arm, coupling=((1.0, 0.0), (-0.8, 1.0)))
    arm = exports.arm_of(study, exports.values_of(study))
    arm = replace(arm, study=replace(arm.study, arm=coupled))
    with pytest.raises(InvalidInput, match="the transmission couples joint 1 with others"):
        state_space(arm, 1)


def test_the_file_contains_the_whole_arm(tmp_path: Path) -> None:
    arm = exports.arm_of(*exports.chain(tmp_path, ("linear", "rigid", "linear")))
    document = json.loads(to_state_space(arm).data)
    assert [joint["joint"] for joint in document["joints"]] == [1, 3]
    whole, wanted = document["whole_arm"], linear_arm(arm)
    assert {name: whole[name] for name in "ABCD"} == {
        name: matrix.tolist() for name, matrix in wanted.matrices.items()
    }
    assert whole["states"] == list(wanted.states)


def test_coupled_joints_have_the_model_of_the_whole_arm_only(tmp_path: Path) -> None:
    arm = exports.arm_of(*exports.chain(tmp_path, coupling=exports.COUPLING))
    document = json.loads(to_state_space(arm).data)
    assert document["joints"] == []
    assert len(document["whole_arm"]["A"]) == 12


def test_a_missing_parameter_of_the_whole_arm_is_refused(tmp_path: Path) -> None:
    """`export_arm` completes the arm first."""
    study, values = exports.chain(tmp_path, coupling=exports.COUPLING)
    del values["gear_damping", 1]
    with pytest.raises(InvalidInput, match="gear_damping of joint 1 is missing"):
        to_state_space(exports.arm_of(study, values))
