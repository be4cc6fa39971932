"""Flat lists of numbers: JSON, and a C header that compiles beside <math.h>."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import exports
from c_programs import output_of_c
from strainwave.domain import Parameter, Prbs
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, simulate
from strainwave.export import IdentifiedArm
from strainwave.export.flat import HEADER_PREFIX, entries, to_c_header, to_json


@pytest.fixture
def arm(tmp_path: Path) -> IdentifiedArm:
    """The rig under gravity, without friction offsets."""
    study = exports.two_links(tmp_path, gravity=9.81)
    arm = exports.arm_of(study, exports.values_of(study))
    nulled = [
        replace(p, value=None, std=None, unit="*/ boo") if p.name == "friction_offset" else p
        for p in arm.parameters
    ]
    return replace(arm, parameters=tuple(nulled))


def test_names_carry_the_joint_and_a_unit(arm: IdentifiedArm) -> None:
    document = json.loads(to_json(arm).data)
    assert document["values"]["motor_inertia_2"] == 0.5e-4
    assert document["units"]["motor_inertia_2"] == "kg m^2"
    assert document["stds"]["motor_inertia_2"] == pytest.approx(0.5e-6)
    assert document["values"]["friction_offset_1"] is None
    known = {"link_length": 0.35, "gravity": 9.81, "gear_ratio_1": 0.01, "torque_per_volt_2": 0.03}
    assert known.items() <= document["values"].items()
    assert not known.keys() & document["stds"].keys()
    assert document["values"].keys() == document["units"].keys()


def test_a_single_joint_has_only_the_numbers_of_its_study(tmp_path: Path) -> None:
    study, values = exports.single(tmp_path)
    names = [entry.name for entry in entries(exports.arm_of(study, values)) if entry.known]
    assert names == ["gear_ratio_1"]


def compiled(header: bytes, source: str, folder: Path) -> str:
    """Output of a C program that includes the header twice, and <math.h>."""
    (folder / "arm.h").write_bytes(header)
    includes = '#include <math.h>\n#include <stdio.h>\n#include "arm.h"\n#include "arm.h"\n'
    return output_of_c(includes + source, folder)


def test_a_program_with_the_header_has_the_numbers(arm: IdentifiedArm, tmp_path: Path) -> None:
    assert "gamma" in dict(name for name, _ in arm.values.items())  # a function of <math.h>
    check_numbers(arm, tmp_path)


def test_a_program_with_the_header_of_a_chain_has_the_numbers(tmp_path: Path) -> None:
    check_numbers(exports.arm_of(*exports.chain(tmp_path, coupling=exports.COUPLING)), tmp_path)


def check_numbers(arm: IdentifiedArm, tmp_path: Path) -> None:
    """A compiled program prints every number of the header with all digits."""
    reported = [entry for entry in entries(arm) if entry.value is not None]
    prints = "".join(f'printf("%.17g\\n", {HEADER_PREFIX}{entry.name});' for entry in reported)
    source = f"int main(void) {{ {prints} return 0; }}\n"
    printed = compiled(to_c_header(arm).data, source, tmp_path)
    assert [float(line) for line in printed.split()] == [entry.value for entry in reported]


# The arm (1), (2), (3) by the classical Runge-Kutta method; voltages are held for a millisecond.
_SIMULATION = """
#define P(name) strainwave_##name
static const double n[2] = {P(gear_ratio_1), P(gear_ratio_2)};
static const double e[2] = {P(torque_per_volt_1), P(torque_per_volt_2)};
static const double m[2] = {P(motor_inertia_1), P(motor_inertia_2)};
static const double dm[2] = {P(motor_viscous_friction_1), P(motor_viscous_friction_2)};
static const double dl[2] = {P(link_viscous_friction_1), P(link_viscous_friction_2)};
static const double k[2] = {P(gear_stiffness_1), P(gear_stiffness_2)};
static const double dg[2] = {P(gear_damping_1), P(gear_damping_2)};

/* x: motor angles, link angles, motor velocities, link velocities */
static void derivative(const double *x, const double *u, double *dx) {
  double tau[2];
  for (int i = 0; i < 2; i++) {
    double gear = k[i] * (n[i] * x[i] - x[2 + i]) + dg[i] * (n[i] * x[4 + i] - x[6 + i]);
    dx[i] = x[4 + i];
    dx[2 + i] = x[6 + i];
    dx[4 + i] = (e[i] * u[i] - dm[i] * x[4 + i] - n[i] * gear) / m[i];
    tau[i] = gear - dl[i] * x[6 + i];
  }
  double c = P(gamma) * cos(x[3]), s = P(gamma) * sin(x[3]);
  double M11 = P(alpha) + P(beta) + 2.0 * c, M12 = P(beta) + c, M22 = P(beta);
  double r1 = tau[0] + s * x[7] * (2.0 * x[6] + x[7]), r2 = tau[1] - s * x[6] * x[6];
  double determinant = M11 * M22 - M12 * M12;
  dx[6] = (M22 * r1 - M12 * r2) / determinant;
  dx[7] = (M11 * r2 - M12 * r1) / determinant;
}

int main(void) {
  const double h = 1e-5;
  double x[8] = {0.0};
  for (int sample = 0; sample < SAMPLES; sample++) {
    printf("%.17g %.17g\\n", x[4], x[5]);
    for (int step = 0; step < 100; step++) {
      double slope[4][8], at[8];
      for (int stage = 0; stage < 4; stage++) {
        double part = stage == 0 ? 0.0 : stage == 3 ? h : 0.5 * h;
        for (int i = 0; i < 8; i++) at[i] = x[i] + (stage ? part * slope[stage - 1][i] : 0.0);
        derivative(at, u[sample], slope[stage]);
      }
      for (int i = 0; i < 8; i++)
        x[i] += h / 6.0 * (slope[0][i] + 2.0 * (slope[1][i] + slope[2][i]) + slope[3][i]);
    }
  }
  return 0;
}
"""


def test_an_arm_programmed_in_c_moves_as_the_simulation(tmp_path: Path) -> None:
    """Without Coulomb friction; both integrators are exact to far below the tolerance."""
    study = exports.two_links(tmp_path)
    values = exports.values_of(study)
    for joint in (1, 2):
        values["motor_coulomb_friction", joint] = values["friction_offset", joint] = 0.0
    sequence = excitation.prbs(Prbs(8, 1e-3, 1, 8.0))[:200]
    voltage = np.column_stack([sequence, np.roll(sequence, 60)])
    still = (0.0, 0.0)
    drive = Drive(
        1e-3, voltage, 0.0 * voltage, (False,) * 2, still, still, link_angle=still,
        link_velocity=still,
    )  # fmt: skip
    simulated = simulate(
        Arm.of(study.arm),
        values,
        drive,
        sample_time=1e-3,
        samples=len(voltage),
        record=["motor_velocity"],
    )["motor_velocity"]
    rows = ", ".join(f"{{{row[0]!r}, {row[1]!r}}}" for row in voltage.tolist())
    source = f"#define SAMPLES {len(voltage)}\nstatic const double u[SAMPLES][2] = {{{rows}}};\n"
    header = to_c_header(exports.arm_of(study, values)).data
    printed = compiled(header, source + _SIMULATION, tmp_path)
    velocities = np.array([line.split() for line in printed.splitlines()], dtype=float)
    assert np.ptp(velocities, axis=0).min() > 10.0
    np.testing.assert_allclose(velocities, simulated, atol=1e-6 * np.abs(simulated).max())


def test_a_parameter_of_one_record_has_a_plain_name(arm: IdentifiedArm) -> None:
    one = Parameter("friction_change[prbs-j1]", 1, 0.1, 0.01, "1", "tuned")
    listed = entries(replace(arm, parameters=(*arm.parameters, one)))
    assert listed[-1].name == "friction_change_prbs_j1_1"


def test_a_header_marks_missing_values(arm: IdentifiedArm) -> None:
    text = to_c_header(arm).data.decode()
    assert "/* strainwave_friction_offset_1 [* / boo] is not identified */" in text
    assert "friction_offset_1 =" not in text
    assert "strainwave_motor_inertia_1 = 0.00015; /* [kg m^2], std 1.5e-06 */" in text
    assert "strainwave_gravity = 9.81; /* [m/s^2], known */" in text


def test_a_chain_lists_its_placement_coupling_and_bodies(tmp_path: Path) -> None:
    study, values = exports.chain(tmp_path, coupling=exports.COUPLING)
    export = to_json(exports.arm_of(study, values))
    document = json.loads(export.data)
    known = {
        "gravity_y": -0.7,
        "origin_x_2": 0.06,
        "origin_roll_2": -1.5,
        "axis_z_2": 0.8,
        "coupling_3_2": -0.6,
        "gear_ratio_2": -0.0125,
    }
    assert known.items() <= document["values"].items()
    for (name, joint), value in values.items():
        assert document["values"][f"{name}_{joint}"] == value
    assert document["units"]["link_first_moment_x_3"] == "kg m"
    assert document["stds"]["link_mass_1"] is None
    assert any("one of many sets with the same motion" in note for note in export.notes)


def test_bodies_replace_estimates_of_single_parameters(tmp_path: Path) -> None:
    """So that the listed parameters of a link belong to one body; the errors are the estimates'."""
    arm = exports.arm_of(*exports.chain(tmp_path))
    estimate = Parameter("link_inertia_zz", 3, 0.5, 0.01, "kg m^2", "tuned")
    (entry,) = (
        entry
        for entry in entries(replace(arm, parameters=(*arm.parameters, estimate)))
        if entry.name == "link_inertia_zz_3"
    )
    assert (entry.value, entry.std) == (arm.standard["link_inertia_zz", 3], 0.01)
