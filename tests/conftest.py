"""What all tests share: a fixed Hypothesis profile, and the measured data where it is there."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("project", derandomize=True, deadline=None)
settings.load_profile("project")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Logs of known arms and real measurements, kept beside the project and not in it."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no ../shared/data beside the project: the measured data are not here")
    return SHARED_DATA
