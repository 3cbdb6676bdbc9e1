"""What every node shares: a clean end on bad input, timers, diagnostics and the answers of lock-step."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import diagnostic_updater
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Header

from hitchhike_ros.core.errors import HitchhikeError
from hitchhike_ros.ros_io.conversions import to_stamp

# For so long, in wall time, nobody says that simulated time does not begin (chosen: a simulator has to start).
_CLOCK_TIMEOUT_S = 5.0
_NO_CLOCK = (
    f"/clock: nothing for {_CLOCK_TIMEOUT_S:g} s though use_sim_time is true, expected a simulator or a bag; "
    "nothing is done before"
)
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def run(name: str, build: Callable[[], object]) -> None:
    """Start node ``name``, build it and spin. Bad input ends it with one clear line and exit status 1.

    ``--help`` on the command line prints the docstring of the module that defines ``build``.
    """
    if {"-h", "--help"} & set(rospy.myargv(sys.argv)[1:]):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # a pager may be left before the end
        print(sys.modules[build.__module__].__doc__)
        return
    rospy.init_node(name)
    try:
        node = build()
    except HitchhikeError as exc:
        rospy.logfatal("%s: %s", rospy.get_name(), exc)
        print(f"{rospy.get_name()}: {exc}", file=sys.stderr)
        rospy.signal_shutdown(str(exc))
        sys.exit(1)
    rospy.spin()
    if getattr(node, "failure", None) is not None:
        sys.exit(1)


def every(period_s: float, callback: Callable[[], object]) -> rospy.Timer:
    """Call back every ``period_s`` of ROS time. An exception ends the node; rospy would end the timer in silence."""

    def call(_event: rospy.timer.TimerEvent) -> None:
        try:
            callback()
        except BaseException as exc:
            rospy.signal_shutdown(f"{type(exc).__name__}: {exc}")
            raise

    return rospy.Timer(rospy.Duration.from_sec(period_s), call, reset=True)


class DiagnosticsUpdater(diagnostic_updater.Updater):
    """Publishes the health of all parts of a node on ``/diagnostics``, in one message at 1 Hz.

    A part is named after the robot and not after the node: a module is called the same in every process. The period is
    in wall time, since people watch it; simulated time may be faster or stand still.
    """

    def __init__(self) -> None:
        super().__init__()
        self._clockless_since: float | None = None
        self._clockless = False
        self.setHardwareID(rospy.get_name())
        threading.Thread(target=self._repeat, name="diagnostics", daemon=True).start()

    def publish(self, msg: Any) -> None:
        """Publish one status or a list of them."""
        statuses = msg if isinstance(msg, list) else [msg]
        robot = rospy.get_namespace().strip("/")
        for status in statuses:
            status.name = f"{robot}: {status.name}"
            if self._clockless:
                status.level, status.message = WARN, _NO_CLOCK
        self.publisher.publish(DiagnosticArray(Header(stamp=rospy.Time.now()), statuses))

    def _repeat(self) -> None:
        while not rospy.is_shutdown():
            self.watch_clock(time.monotonic())
            self.force_update()
            rospy.rostime.wallsleep(1.0)

    def watch_clock(self, wall_s: float) -> None:
        """Notice at ``wall_s``, in s of wall time, that simulated time does not begin, or that it has begun."""
        waits = not rospy.rostime.is_wallclock() and rospy.get_time() == 0.0
        if not waits:
            self._clockless_since, self._clockless = None, False
            return
        if self._clockless_since is None:
            self._clockless_since = wall_s
        if not self._clockless and wall_s - self._clockless_since >= _CLOCK_TIMEOUT_S:
            self._clockless = True
            rospy.logwarn("%s", _NO_CLOCK)


class Diagnostics:
    """The health of one part of a node: the level and message last set, and counters."""

    def __init__(self, name: str, updater: DiagnosticsUpdater | None = None) -> None:
        """``updater`` publishes the part together with the node's other parts; without one it publishes itself."""
        self._level, self._message = OK, "starting"
        self._values: dict[str, object] = {}
        self._updater = updater or DiagnosticsUpdater()
        self._updater.add(name, self._report)

    def set(self, level: int, message: str, **values: object) -> None:
        """Set what is published from now on. A change of level is published at once."""
        changed = level != self._level
        self._level, self._message = level, message
        self._values.update(values)
        if changed:
            self._updater.force_update()

    def count(self, what: str, by: int = 1) -> int:
        """Add to a counter that is published, and return the new count."""
        total = int(str(self._values.get(what, 0))) + by
        self._values[what] = total
        return total

    def _report(self, status: diagnostic_updater.DiagnosticStatusWrapper) -> diagnostic_updater.DiagnosticStatusWrapper:
        status.summary(self._level, self._message)
        for key, value in list(self._values.items()):
            status.add(key, str(value))
        return status


class LockstepAnswer:
    """Tells the simulator that a sensor frame has been worked on, when ``/lockstep`` is true."""

    def __init__(self, module: str) -> None:
        self._module = module
        self._publisher = (
            rospy.Publisher("lockstep/answer", Header, queue_size=20, tcp_nodelay=True)
            if rospy.get_param("/lockstep", False)
            else None
        )

    def __call__(self, stamp: float) -> None:
        if self._publisher is not None:
            self._publisher.publish(Header(stamp=to_stamp(stamp), frame_id=self._module))
