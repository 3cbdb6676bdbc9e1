"""What every node shares."""

from __future__ import annotations

from typing import Any

import pytest
import rospy

from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from hitchhike_ros.ros_io.node import every


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
