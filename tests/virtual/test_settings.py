"""Settings of the built-in arm."""

from __future__ import annotations

from pathlib import Path

from strainwave.virtual import scara
from strainwave.virtual.settings import virtual_rig

SETTING = {"spring": "linear", "accelerometers": True, "gyros": False, "noise": True}


def test_settings_change_the_truth_and_the_study(tmp_path: Path) -> None:
    body = SETTING | {"disks": 2, "stiffness": 1.5, "friction": 0.5, "amplitude": 6.0}
    rig = virtual_rig(body, tmp_path)
    usual = scara.SOFT.parameters(2, "linear")
    assert rig.values["gear_stiffness", 1] == 1.5 * usual["gear_stiffness", 1]
    assert rig.values["motor_coulomb_friction", 2] == 0.5 * usual["motor_coulomb_friction", 2]
    assert rig.values["alpha", None] == usual["alpha", None]
    assert {e.prbs.amplitude for e in rig.study.experiments if e.prbs} == {6.0}
    assert rig.study.arm.joints[0].accelerometer_distance == scara.SOFT.accelerometer_distance[0]
    assert rig.study.arm.joints[0].gyro_hz is None


def test_knees_scale_and_encoders_are_set(tmp_path: Path) -> None:
    body = {"spring": "three-slope", "knees": 0.5, "encoder_bits": 16, "link_encoders": True}
    rig = virtual_rig(body, tmp_path)
    assert rig.values["gear_knee_t1", 1] == 0.5 * scara.SOFT.parameters()["gear_knee_t1", 1]
    joint = rig.study.arm.joints[1]
    assert (joint.encoder_counts, joint.link_encoder_counts) == (2**16, 2**20)
    assert joint.accelerometer_distance is None
    assert not rig.has_noise
