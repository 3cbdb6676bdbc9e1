"""What every node shares."""

from __future__ import annotations

from typing import Any

import pytest
import rospy

from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from hitchhike_ros.ros_io.node import WARN, Diagnostics, DiagnosticsUpdater, every


def test_an_exception_in_a_timer_ends_the_node(ros: FakeRos, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    made: list[tuple[float, Any]] = []
    monkeypatch.setattr(rospy, "Timer", lambda period, callback, reset: made.append((period.to_sec(), callback)))
    called: list[int] = []

    def work() -> None:
        called.append(1)
        if len(called) > 1:
            raise KeyError("gone")

    every(0.25, work)
    ((period_s, call),) = made
    assert period_s == 0.25
    call(None)
    assert ros.shut_down == []
    with pytest.raises(KeyError):
        call(None)
    assert ros.shut_down == ["KeyError: 'gone'"]


@pytest.mark.parametrize("simulated", [False, True])
def test_a_node_without_a_clock_says_so_once_it_has_waited(
    simulated: bool,
    ros: FakeRos,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: not simulated)
    updater = DiagnosticsUpdater()
    Diagnostics("slam", updater)
    for wall_s in (100.0, 104.9):
        updater.watch_clock(wall_s)
    updater.force_update()
    assert ros.said("slam")[1] == "starting"
    for wall_s in (105.0, 106.0):
        updater.watch_clock(wall_s)
    updater.force_update()
    if not simulated:
        assert ros.said("slam")[1] == "starting"
        return
    level, message, _ = ros.said("slam")
    assert level == WARN
    assert "/clock: nothing for 5 s" in message
    assert len(ros.warnings) == 1
    ros.now = 0.1
    updater.watch_clock(107.0)
    updater.force_update()
    assert ros.said("slam")[1] == "starting"
