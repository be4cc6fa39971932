"""Files read back by their target's reader: agreement, differences, rejected files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import exports
from command_line import run_here
from strainwave.export import export_arm
from strainwave.export.read_back import ReadBack, by_mujoco, compare, rotation_of


def test_values_agree_to_rounding_and_sizes_must_agree() -> None:
    exact = np.array([1.0, 1e-12, 3.0])
    same = compare("reader", [("a", exact, exact * (1.0 + 1e-11)), ("b", 0.0, 0.0)])
    assert same == ReadBack("reader", 4)
    assert same.text == "read back by reader: 4 values agree"
    assert same.warnings == ()
    other = compare("reader", [("gear1 stiffness", 2.0, 2.0001), ("c", [1.0, 2.0], [1.0])])
    assert other.differences[0] == "gear1 stiffness: 2 in the file, 2.0001 read"
    assert len(other.differences) == 2
    assert other.text == "read back by reader: 2 of 3 values differ"
    assert "gear1 stiffness: 2 in the file" in other.warnings[0].message


def test_rotations_are_those_of_rpy() -> None:
    """The columns of R = R_z R_y R_x for quarter turns."""
    quarter = np.pi / 2.0
    assert np.allclose(rotation_of(np.array([quarter, 0.0, 0.0]))[:, 1], [0, 0, 1])
    assert np.allclose(rotation_of(np.array([0.0, quarter, 0.0]))[:, 0], [0, 0, -1])
    assert np.allclose(rotation_of(np.array([quarter, 0.0, quarter]))[:, 2], [1, 0, 0])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('damping="20.0"', 'damping="21.0"'),
        ('coef="0.01"', 'coef="0.011"'),
        ('gear="1.0"', 'gear="2.0"'),
        ('<body name="link2" pos="', '<body name="link2" pos="1'),
        ("<inertial ", '<inertial quat="1 0 0 0.1" '),
    ],
)
def test_mujoco_is_compared_with_the_file(old: str, new: str, tmp_path: Path) -> None:
    """A file that MuJoCo reads otherwise: the reader has the altered copy."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra: bench)")
    study = exports.two_links(tmp_path)
    out = tmp_path / "arm.xml"
    exported = export_arm(exports.arm_of(study, exports.values_of(study)), out)
    assert exported.read_back is not None
    assert exported.read_back.differences == ()
    text = out.read_text()
    assert old in text
    altered = tmp_path / "altered.xml"
    altered.write_text(text.replace(old, new, 1))
    load = mujoco.MjModel.from_xml_path
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "mujoco.MjModel", type("M", (), {"from_xml_path": lambda _: load(str(altered))})
        )
        read = by_mujoco(out)
    assert read is not None
    assert read.differences or read.problem


@pytest.mark.parametrize("name", ["arm.urdf", "arm.srdf"])
def test_pinocchio_reads_links_friction_frames_and_rotors(name: str, tmp_path: Path) -> None:
    pytest.importorskip("pinocchio", reason="Pinocchio is not installed (extra: bench)")
    study, values = exports.chain(tmp_path)
    out = tmp_path / name
    export = export_arm(exports.arm_of(study, values), out)
    assert export.read_back is not None
    assert export.read_back.differences == ()
    # three links of 10 values, friction of two, frames of 12, rotors of SRDF
    assert export.read_back.n_values == 3 * (10 + 2 + 12 + (name == "arm.srdf"))
    assert export.check is not None
    out.write_text(out.read_text().replace('damping="', 'damping="1', 1))
    altered = export.check(out)
    assert altered is not None
    assert altered.differences[0].startswith("joint1 damping")
    out.write_text("<robot>")
    rejected = export.check(out)
    assert rejected is not None
    assert rejected.problem


def test_without_the_reader_nothing_is_claimed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("strainwave.export.read_back.find_spec", lambda name: None)
    study = exports.two_links(tmp_path)
    result = exports.write(study, exports.values_of(study))
    for name in ("arm.xml", "arm.urdf"):
        done = run_here("export", str(result), "--out", str(tmp_path / name))
        assert done.returncode == 0
        assert "read back" not in done.stdout
