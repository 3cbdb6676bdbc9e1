"""Timers, and nodes that doze while they have none.

To hear one tick of a simulated clock costs a process more than most of what is done at it. So timers are called by the
tick itself, instead of waking at each one to see whether they are due; and a node whose module is off need not hear
them all. On the clock of the system there are no ticks, and nothing of this happens.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import rospy
from rosgraph_msgs.msg import Clock

# Of a node that dozes, timers with at least this period do not keep it awake; ticks are then heard this far apart, in
# wall time, and who wakes it waits so long at most to know the time (chosen).
_SLOW_S, _DOZE_S, _WAKE_S = 0.5, 0.25, 0.2


class ClockEar:
    """Where this process hears a simulated clock. rospy keeps the newest tick of those that came while it dozed."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._needed_by = self._ticks = 0
        self._subscriber: rospy.Subscriber | None = None

    def doze(self) -> None:
        """From now on hear ticks now and then only, while nobody needs each of them."""
        if not rospy.rostime.is_wallclock():
            self._subscriber = rospy.Subscriber("/clock", Clock, self._on_tick, queue_size=1)

    def need(self) -> None:
        """Hear every tick, until :meth:`release`; on return ROS time is that of the newest tick."""
        with self._changed:
            self._needed_by += 1
            if self._subscriber is not None and self._needed_by == 1:
                before = self._ticks
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._ticks > before, _WAKE_S)

    def release(self) -> None:
        """One less needs it."""
        with self._changed:
            self._needed_by -= 1

    def _on_tick(self, _msg: Clock) -> None:
        with self._changed:
            self._ticks += 1
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._needed_by > 0, _DOZE_S)


clock = ClockEar()


class Timer:
    """Calls back every ``period_s`` of ROS time, one call at a time; what was missed is not made up for.

    On a simulated clock the thread that hears it calls back: time stands still in this process until that has returned.
    """

    def __init__(self, period_s: float, callback: Callable[[], object]) -> None:
        self._callback, self._period = callback, rospy.Duration.from_sec(period_s)
        self._wakes = period_s < _SLOW_S
        if self._wakes:
            clock.need()
        self._due = rospy.Time.now() + self._period
        self._stop: Callable[[], None]
        if rospy.rostime.is_wallclock():
            self._stop = rospy.Timer(self._period, lambda _event: callback(), reset=True).shutdown
        else:
            self._stop = rospy.Subscriber("/clock", Clock, self._tick, queue_size=1).unregister

    def shutdown(self) -> None:
        """Call back no more; to be called once."""
        self._stop()
        if self._wakes:
            clock.release()

    def _tick(self, msg: Clock) -> None:
        now, period = msg.clock, self._period
        if self._due - period <= now < self._due:
            return
        in_time = self._due <= now < self._due + period
        # It keeps its rate, unless a turn has been missed or time has jumped back.
        self._due = (self._due if in_time else now) + period
        self._callback()
