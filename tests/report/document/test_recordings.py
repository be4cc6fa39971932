"""Raw records and rig constants: units, panels, peaks, and missing values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import exports
from elastic_results import elastic_identification, log, study
from figure_parts import line, names
from strainwave.domain import ArmDescription, Imu, Joint
from strainwave.domain.arm.kinds import planar_two_link
from strainwave.report.document.blocks import Block, Facts, Fold, Plot, Table
from strainwave.report.document.predictions import recording_figure, recordings
from strainwave.report.document.rig import rig_constants
from virtual_arms import rigid_drive


def test_each_quantity_has_a_panel_with_its_unit() -> None:
    figure = recording_figure(log("prbs-j1"), study().arm.joints, 600)
    titles = [panel.axis.title for panel in figure.panels]
    assert titles == ["voltage [V]", "motor velocity [rad/s]", "acceleration [m/s²]"]
    assert names(figure) == ["joint 1", "joint 2"]


def test_peaks_survive_decimation() -> None:
    spiked = log("prbs-j1")
    voltage = spiked.channels["u1"].copy()
    voltage[1234] = 99.0
    spiked = replace(spiked, channels=dict(spiked.channels) | {"u1": voltage})
    figure = line(recording_figure(spiked, (), 300), "joint 1")
    assert figure.y.max() == 99.0
    assert len(figure.y) <= 300


def test_a_velocity_that_is_not_logged_is_the_slope_of_the_angle() -> None:
    one = log("prbs-j1")
    ramp = dict(one.channels) | {"theta_m1": 3.0 * one.time, "ref1": 0.0 * one.time}
    figure = recording_figure(replace(one, channels=ramp), (), 300)
    assert line(figure, "joint 1", 1).y == pytest.approx(3.0)
    assert "reference 1" in names(figure, 1)
    logged = dict(one.channels) | {"omega_m1": 5.0 + 0.0 * one.time}
    figure = recording_figure(replace(one, channels=logged), (), 300)
    assert line(figure, "joint 1", 1).y == pytest.approx(5.0)


def test_records_are_folded_if_there_are_results() -> None:
    one = elastic_identification()
    (fold,) = recordings(one, 600)
    assert isinstance(fold, Fold)
    bare = replace(one, rigid=None, joints=(), whole_arm=None)
    (plot,) = recordings(bare, 600)
    assert isinstance(plot, Plot)
    assert "4000 samples, 3.999 s, sample time 1 ms" in plot.words


def rows(arm: ArmDescription) -> dict[str, list[str]]:
    blocks: list[Block] = list(rig_constants(arm))
    cells: dict[str, list[str]] = {}
    for block in blocks:
        if isinstance(block, Table):
            for row in block.rows:
                assert isinstance(row, tuple)
                cells[row[0].text] = [cell.text for cell in row[1:]]
        elif isinstance(block, Facts):
            cells |= {term: [fact] for term, fact in block.items}
    return cells


def test_the_rig_constants_have_values_units_and_keys() -> None:
    table = rows(study().arm)
    ratio = ["0.01 (1:100)", "0.01 (1:100)", "link turns per motor turn", "gear_ratio"]
    assert table["gear ratio n"] == ratio
    assert table["torque per volt e"] == ["0.08", "0.03", "N m/V", "torque_per_volt"]
    assert table["link length, axis 1 to axis 2"] == ["0.35 m"]
    assert table["servo, proportional gain"][-1] == "servo.kp"


def test_constants_that_no_joint_has_are_left_out() -> None:
    table = rows(rigid_drive().arm)
    assert table["gear ratio n"][0] == "0.5 (1:2)"
    assert not {"torque per volt e", "gyro bandwidth", "servo period"} & set(table)
    joints = (Joint("linear", 0.013, torque_per_volt=0.1), Joint("linear", 0.01, imu=Imu()))
    table = rows(planar_two_link(joints, 0.3))
    assert table["torque per volt e"][:2] == ["0.1", "not given"]
    assert table["gear ratio n"][0] == "0.013"
    assert table["IMU position"][:2] == ["not given", "estimated"]
    assert np.size(table["gravity in the plane of motion"]) == 1


def test_placed_joints_have_frames_and_the_vector_of_gravity() -> None:
    table = rows(exports.chain(Path("nowhere"), coupling=exports.COUPLING)[0].arm)
    assert table["position"][1:] == ["0.06, 0.02, 0.14", "0.4, 0, -0.05", "m", "origin.xyz"]
    assert table["orientation"][1] == "-1.5, 0.2, 0"
    assert table["axis"][1] == "0, 0.6, 0.8"
    assert table["gear ratio n"][1] == "-0.0125 (1:-80)"
    assert table["gravity"] == ["0.4, -0.7, -9.6 m/s²"]
    assert table["transmission, weights of the motors in joint 3"] == ["0, -0.6, 1"]
