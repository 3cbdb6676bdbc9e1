"""What a node does with awards while its ledger cannot be written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import rospy

from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.protocol.award_ledger import FILE_NAME, AwardLedger
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.ros_io.awards import AwardKeeper

FIRST, SECOND = (Award(f"turtlebot-{i}-9.0", "turtlebot", 20.4 * i, 8.16 * i) for i in (1, 2))
Build = Callable[..., AwardKeeper]


@pytest.fixture
def keeper(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Build:
    """A keeper whose node has these parameters."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path / "home"))

    def build(**params: object) -> AwardKeeper:
        names = {"awards": "~awards", "run_id": "/run_id", "use_sim_time": "/use_sim_time"}
        known = {names[key]: value for key, value in params.items()}
        monkeypatch.setattr(rospy, "has_param", known.__contains__)
        monkeypatch.setattr(rospy, "get_param", lambda name, default=None: known.get(name, default))
        return AwardKeeper("p3dx")

    return build


def rides(path: Path) -> list[str]:
    return [credit.ride_id for credit in AwardLedger(path).credits()]


def test_awards_are_written_down_once_in_ros_home(keeper: Build, tmp_path: Path) -> None:
    own = keeper()
    for award in (FIRST, SECOND, FIRST):
        own.credit(award)
    assert rides(tmp_path / "home" / FILE_NAME) == [FIRST.ride_id, SECOND.ride_id]
    assert (own.trouble, own.waiting) == ("", 0)


def test_an_empty_name_keeps_none(keeper: Build, tmp_path: Path) -> None:
    own = keeper(awards="")
    own.credit(FIRST)
    own.step()
    assert (own.trouble, own.waiting) == ("", 0)
    assert list(tmp_path.rglob("*.sqlite")) == []


def test_a_name_that_is_none_is_refused(keeper: Build) -> None:
    with pytest.raises(ParameterError, match="~awards is 7, expected"):
        keeper(awards=7)


def test_rides_of_two_simulations_are_not_one(keeper: Build, tmp_path: Path) -> None:
    path = tmp_path / "awards.sqlite"
    for run in ("3f2a91c0-e713-11f1", "47aa0001-e713-11f1", "3f2a91c0-e713-11f1"):
        keeper(awards=str(path), use_sim_time=True, run_id=run).credit(FIRST)
    keeper(awards=str(path), use_sim_time=False, run_id="3f2a91c0-e713-11f1").credit(FIRST)
    assert sorted(rides(path)) == [f"3f2a91c0/{FIRST.ride_id}", f"47aa0001/{FIRST.ride_id}", FIRST.ride_id]


def test_what_cannot_be_written_waits(keeper: Build, tmp_path: Path) -> None:
    hindrance = tmp_path / "folder"
    hindrance.touch()
    own = keeper(awards=str(hindrance / "awards.sqlite"))
    assert "expected a file that can be written" in own.trouble
    own.credit(FIRST)
    own.credit(SECOND)
    assert own.waiting == 2
    hindrance.unlink()
    own.step()
    assert own.waiting == 2, "it does not try all the time"
    own._next_try = 0.0
    own.step()
    assert (own.trouble, own.waiting) == ("", 0)
    assert rides(hindrance / "awards.sqlite") == [FIRST.ride_id, SECOND.ride_id]


def test_a_senseless_award_keeps_no_other_waiting(keeper: Build, tmp_path: Path) -> None:
    own = keeper(awards=str(tmp_path / "awards.sqlite"))
    own.credit(Award("turtlebot-0-1.0", "turtlebot", float("nan"), 0.0))
    own.credit(FIRST)
    assert (own.trouble, own.waiting) == ("", 0)
    assert rides(tmp_path / "awards.sqlite") == [FIRST.ride_id]
