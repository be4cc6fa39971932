"""Values of a rig from the text of another study."""

from __future__ import annotations

import pytest

from strainwave.init.rig_values import is_study_of

STUDY = """
[arm]
kind = "serial"
urdf = "robot.urdf"
[[experiment]]
name = "swing"
file = "swing.csv"
steps = [{ kind = "merge", file = "part2.csv" }]
"""
FILES = ("robot.urdf", "swing.csv", "part2.csv")


def test_a_text_is_the_study_of_a_folder_that_has_all_its_files() -> None:
    assert is_study_of(STUDY, FILES)


@pytest.mark.parametrize("missing", FILES)
def test_a_text_whose_log_urdf_or_merged_log_is_missing_has_values_only(missing: str) -> None:
    assert not is_study_of(STUDY, [name for name in FILES if name != missing])
