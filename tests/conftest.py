"""Shared fixtures: profiles of Hypothesis, and the measured data if they are present.

By default pytest draws the same cases in every run. `make test` uses the profile "fresh" with a new
seed, which it prints. A failure also prints the case as a decorator.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

settings.register_profile("project", derandomize=True, deadline=None)
settings.register_profile(
    "fresh", derandomize=False, deadline=None, print_blob=True, max_examples=50
)
settings.load_profile("project")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

FITS = "tests/identification/whole_arm"
CAUSES = f"{FITS}/selection/test_causes.py"
LONGEST = (
    CAUSES,
    "tests/signals/consistency/test_obeyed_remedies.py",
    "tests/test_pipeline.py",
    "tests/identification/rigid/test_rigid.py",
    f"{FITS}/test_whole_arm.py",
    "tests/identification/rigid/test_rigid_terms.py",
    "tests/test_api.py",
    "tests/experiment_design/test_experiment_design.py",
    "tests/campaign/test_cluster.py",
    "tests/campaign/test_kills.py",
    "tests/test_determinism.py",
    "tests/signals/consistency/test_consistency.py",
    "tests/signals/consistency/test_remedies.py",
    "tests/test_docs.py",
    f"{FITS}/test_given_start.py",
    "tests/identification/test_torsion.py",
    "tests/identification/joint_model/test_physical_lab.py",
    "tests/benchmarks/test_causes.py",
    "tests/campaign/test_command.py",
    "tests/identification/rigid/test_drive_gains.py",
)
"""Files that take the most processor time, the longest first."""

SHARED_FITS = {
    f"{FITS}/problem/test_effect_unknowns.py": CAUSES,
    f"{FITS}/inference/test_residual_analysis.py": CAUSES,
    f"{FITS}/selection/test_sensor_mounts.py": CAUSES,
    "tests/domain/effects/test_effects.py": CAUSES,
    "tests/paper/test_page.py": "tests/paper/test_claims.py",
}
"""Files that use the same cached fits as another file, and that other file."""


def _unit(nodeid: str) -> str:
    """File that stands for all files that share fits with the file of a test."""
    file = nodeid.split("::", maxsplit=1)[0]
    return SHARED_FITS.get(file, file)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the longest files first, so that no worker waits at the end for another."""
    root = Path(__file__).parents[1]
    missing = [file for file in (*LONGEST, *SHARED_FITS) if not (root / file).is_file()]
    assert not missing, f"LONGEST and SHARED_FITS name files that do not exist: {missing}"

    def rank(item: pytest.Item) -> int:
        file = _unit(item.nodeid)
        return LONGEST.index(file) if file in LONGEST else len(LONGEST)

    items.sort(key=rank)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With --dist loadfile, run files that share fits on one worker, in the order above."""
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class LoadSharedFits(LoadFileScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            return _unit(nodeid)

    config.option.loadscopereorder = False  # by the number of tests
    return LoadSharedFits(config, log)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with logs of known arms and real measurements, which is not part of the project."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no ../shared/data beside the project: the measured data are not here")
    return SHARED_DATA
