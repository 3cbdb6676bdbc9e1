"""Fixtures that several tests use, and how Hypothesis runs the property tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# No property test depends on how fast the machine is: neither an example nor the drawing of examples has a time limit.
# Where CI is set the examples are the same each time, so that a change is judged and not the draw; elsewhere each run
# draws others.
settings.register_profile(
    "hitchhike_ros",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=bool(os.environ.get("CI")),
)
settings.load_profile("hitchhike_ros")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of third-party data beside the repository; a test that needs it is skipped where it is missing."""
    path = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    if not path.is_dir():
        pytest.skip(f"needs the data in {path}")
    return path
