"""Shared fixtures: profiles of Hypothesis, and the measured data if they are present.

By default pytest draws the same cases in every run. `make test` uses the profile "fresh" with a new
seed, which it prints. A failure also prints the case as a decorator.
"""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from strainwave.numerics.parallel import configure_process

configure_process()  # as the command does

settings.register_profile("project", derandomize=True, deadline=None)
settings.register_profile(
    "fresh", derandomize=False, deadline=None, print_blob=True, max_examples=30
)
settings.load_profile("project")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

WHOLE_ARM = "tests/identification/whole_arm"
LONGEST = (
    "tests/workbench/browser/test_estimate.py",
    f"{WHOLE_ARM}/selection/test_causes.py",
    "tests/workbench/test_server.py",
    "tests/input_check/test_obeyed_remedies.py",
    "tests/fleet/campaign/test_kills.py",
    "tests/input_check/test_consistency.py",
    "tests/benchmarks/test_causes.py",
    "tests/test_cli.py",
    "tests/identification/position_servo/test_position_servo.py",
    "tests/workbench/browser/test_study.py",
    "tests/test_api.py",
    "tests/fleet/campaign/test_cluster.py",
    "tests/workbench/browser/test_signals.py",
    "tests/workbench/browser/test_virtual.py",
    "tests/test_pipeline.py",
    f"{WHOLE_ARM}/test_few_sensors.py",
    f"{WHOLE_ARM}/test_record_effects.py",
    "tests/input_check/test_remedies.py",
    "tests/fleet/campaign/test_local.py",
    f"{WHOLE_ARM}/problem/test_effect_unknowns.py",
    f"{WHOLE_ARM}/test_whole_arm.py",
    f"{WHOLE_ARM}/test_mounting.py",
    "tests/workbench/test_bad_requests.py",
    "tests/workbench/test_drawn_items.py",
    "tests/reproduction/test_claims.py",
    f"{WHOLE_ARM}/selection/test_sensor_mounts.py",
    "tests/test_options.py",
    "tests/tune/test_tune_command.py",
    "tests/identification/rigid/test_rigid.py",
    "tests/excite/test_experiment_design.py",
    f"{WHOLE_ARM}/test_given_start.py",
    "tests/report/document/test_browser.py",
    "tests/fleet/campaign/test_store.py",
    "tests/tune/test_design.py",
    "tests/identification/rigid/test_rigid_terms.py",
    "tests/test_payload.py",
    "tests/fleet/monitoring/test_comparison.py",
    "tests/workbench/test_by_hand.py",
    f"{WHOLE_ARM}/inference/test_agreement.py",
    "tests/workbench/test_files.py",
)
"""Files that take more than 10 s of processor time each, with that of their processes, the longest first."""

SHARED_FITS = {
    f"{WHOLE_ARM}/inference/test_residual_analysis.py": f"{WHOLE_ARM}/selection/test_causes.py",
    "tests/reproduction/test_page.py": "tests/reproduction/test_claims.py",
    "tests/test_docs.py": "tests/test_cli.py",
    "tests/test_small_arm.py": "tests/test_api.py",
}
"""Files that use the same cached results as another file, and that other file."""


def _unit(nodeid: str) -> str:
    """File that stands for all files that share fits with the file of a test."""
    file = nodeid.split("::", maxsplit=1)[0]
    return SHARED_FITS.get(file, file)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the longest files first, so that no worker waits at the end for another."""

    def rank(item: pytest.Item) -> int:
        file = _unit(item.nodeid)
        return LONGEST.index(file) if file in LONGEST else len(LONGEST)

    items.sort(key=rank)


def pytest_collection_finish() -> None:
    """Exempt what the collection has left from every later run of the garbage collector."""
    gc.collect()
    gc.freeze()


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


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder and output of the demonstration; copy the folder before you change it."""
    from command_line import run_apart

    folder = tmp_path_factory.mktemp("demo") / "out"
    process = run_apart("demo", "--out", str(folder))
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    return folder, process.stdout
