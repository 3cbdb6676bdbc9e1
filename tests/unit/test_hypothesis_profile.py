"""Property tests run without time limits, and none of them brings its own."""

from hypothesis import HealthCheck, settings

from repository import ROOT


def test_no_time_limit_is_set() -> None:
    assert settings().deadline is None
    assert HealthCheck.too_slow in settings().suppress_health_check


def test_no_test_sets_one_of_its_own() -> None:
    files = [path for path in (ROOT / "tests" / "unit").rglob("test_*.py") if path.name != "test_hypothesis_profile.py"]
    assert [path.name for path in files if "deadline=" in path.read_text(encoding="utf-8")] == []
    assert len(files) > 50
