"""The award ledger of a node: where it is, and what becomes of awards while it cannot be written."""

from __future__ import annotations

import math
import time
from collections import deque
from pathlib import Path

import rospkg
import rospy

from hitchhike_ros.core.errors import CreditError, LedgerError, ParameterError
from hitchhike_ros.protocol.award_ledger import FILE_NAME, AwardLedger, Credit
from hitchhike_ros.protocol.events import Award
from hitchhike_ros.ros_io.parameters import given

# Wall time. A robot does not stand still for a ledger that is busy: it tries again.
_BUSY_S, _RETRY_S = 0.2, 10.0


def default_ledger() -> Path:
    """``$ROS_HOME/hitchhike_awards.sqlite``; ROS_HOME is ``~/.ros`` where it is not set."""
    return Path(rospkg.get_ros_home()) / FILE_NAME


class AwardKeeper:
    """Credits what one driver earns in the file ``~awards``; with an empty name nothing is kept.

    A file that cannot be written stops no robot: ``trouble`` says why, and the awards wait for the next try.
    """

    def __init__(self, driver: str) -> None:
        name = given("awards", str(default_ledger()))
        if not isinstance(name, str):
            raise ParameterError(rospy.get_name(), "~awards", name, "the path of a file, or nothing")
        self.trouble = ""
        self._driver = driver
        self._ledger = AwardLedger(Path(name).expanduser(), _BUSY_S) if name else None
        # Simulated clocks all begin at 0, so that rides of two runs may have one id.
        run = str(rospy.get_param("/run_id", "")) if rospy.get_param("/use_sim_time", False) else ""
        self._prefix = f"{run[:8]}/" if run else ""
        self._waiting: deque[Credit] = deque()
        self._next_try = -math.inf
        if self._ledger is not None:
            self._try(self._ledger)

    @property
    def waiting(self) -> int:
        """How many awards are not written to the file yet."""
        return len(self._waiting)

    def credit(self, award: Award) -> None:
        """Write an award to the file, now or as soon as that is possible."""
        if self._ledger is None:
            return
        ride_id = f"{self._prefix}{award.ride_id}"
        self._waiting.append(Credit(self._driver, award.hitchhiker, ride_id, award.ride_m, award.points, time.time()))
        self._try(self._ledger)

    def step(self) -> None:
        """Try again if the time has come. Call this often."""
        if self._ledger is not None and self.trouble and time.monotonic() >= self._next_try:
            self._try(self._ledger)

    def _try(self, ledger: AwardLedger) -> None:
        """Write the awards that wait. What prevents it is logged when it changes."""
        trouble = ""
        try:
            ledger.check()
            while self._waiting:
                try:
                    ledger.credit(self._waiting[0])
                except CreditError as exc:
                    rospy.logerr("an award is not written down: %s", exc)
                self._waiting.popleft()
        except LedgerError as exc:
            trouble = str(exc)
            self._next_try = time.monotonic() + _RETRY_S
        if trouble != self.trouble:
            self.trouble = trouble
            if trouble:
                rospy.logerr("awards are not written down: %s", trouble)
            else:
                rospy.loginfo("awards are written down again")
