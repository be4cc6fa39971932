"""What all tests share: profiles of Hypothesis, and the measured data where it is there.

By itself pytest draws the same cases in every run. `make test` takes the profile "fresh", which
draws others from the seed it prints; a failure also prints the case as a decorator.
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
    """Logs of known arms and real measurements, kept beside the project and not in it."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no ../shared/data beside the project: the measured data are not here")
    return SHARED_DATA
