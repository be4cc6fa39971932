"""Shared fixtures: profiles of Hypothesis, and the measured data if they are present.

By default pytest draws the same cases in every run. `make test` uses the profile "fresh" with a new
seed, which it prints. A failure also prints the case as a decorator.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("project", derandomize=True, deadline=None)
settings.register_profile("fresh", derandomize=False, deadline=None, print_blob=True)
settings.load_profile("project")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with logs of known arms and real measurements, which is not part of the project."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no ../shared/data beside the project: the measured data are not here")
    return SHARED_DATA
