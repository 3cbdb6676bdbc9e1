"""teleop: a human drives one robot by keys in a terminal, or by joystick (P18 §7). Run it in the robot's namespace.

The first key that moves or stops the robot takes it in hand: it then does not drive by itself, until the human gives it
back or leaves. On the way to its goal, alone or with riders, its obstacle_avoidance follows what the human wants within
the protocol's limits; where a driver aligns, waits or hands over, it does so by itself.

Keys: w or up straight on, s or down back (not on the way to a goal), a or left and d or right a curve (on the spot
where the robot stands), space stop, e or + faster, q or - slower, x gives the robot back to its own navigation, Ctrl-C
or Ctrl-D too and ends.
A motion ends when no key has come for the dead-man time.

Subscribed:
    joy (sensor_msgs/Joy): drives while its dead-man button is held
    hhike_msg/status (std_msgs/String): for the screen
Published:
    cmd_vel/teleop (geometry_msgs/Twist): at ``~rate`` while something is wanted, then for a moment a stand, then none
    teleop/active (std_msgs/Bool): true at 2 Hz while the robot is in hand, false once when it is given back
    /diagnostics (diagnostic_msgs/DiagnosticArray): joystick messages that were refused
Parameters:
    ~config (path, default none), section ``teleop`` (control.teleop.TeleopParameters, also as private parameters)
    ~keyboard (bool, true): false: by joystick alone, without a terminal
    ~rate (Hz, 10)
TF: none.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator

import rospy
from geometry_msgs.msg import Twist
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

from hitchhike_ros.control.teleop import HELP, Key, KeyReader, Teleop, TeleopParameters
from hitchhike_ros.core.datatypes import Positive, Twist2D
from hitchhike_ros.core.errors import TeleopError
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.ros_io.conversions import twist_to_msg
from hitchhike_ros.ros_io.node import OK, WARN, Diagnostics, StatusListener, run
from hitchhike_ros.ros_io.parameters import node_parameters

# A tick of the clock that is early by so little is in time.
_EARLY_S = 0.001
_LOOK_S = 0.02  # wall time: how long a key may wait
_ACTIVE_PERIOD_S = 0.5
_DRAW_PERIOD_S = 0.2  # wall time
_LEAVE_S = 0.3  # wall time: for its last words to be on their way before topics are closed
_HANDS = {
    "free": "it has no goal: you drive it directly",
    "guided": "you drive it, within its limits",
    "off": "it acts by itself: only space works",
}


class TeleopNode:
    """One loop reads the keys, steps the core and publishes; it ends with the terminal as it was."""

    def __init__(self) -> None:
        keyboard = convert(rospy.get_param("~keyboard", True), bool, rospy.get_name(), "~keyboard")
        if keyboard and not sys.stdin.isatty():
            raise TeleopError("standard input is no terminal; keys come from one, _keyboard:=false does without")
        self._teleop = Teleop(node_parameters(TeleopParameters, "teleop"))
        self._period_s = 1.0 / convert(rospy.get_param("~rate", 10.0), Positive, rospy.get_name(), "~rate")
        self._lock = threading.RLock()  # a signal comes while the loop has it
        self._keys = KeyReader()
        self._status: Status | None = None
        self._said: Twist2D | None = None
        self._said_at = self._active_at = -1e9
        self._was_taken = False
        self._diagnostics = Diagnostics("teleop")
        self._diagnostics.set(OK, "ready")
        self._commands = rospy.Publisher("cmd_vel/teleop", Twist, queue_size=10, tcp_nodelay=True)
        self._active = rospy.Publisher("teleop/active", Bool, queue_size=10, tcp_nodelay=True)
        self._subscriber = rospy.Subscriber("joy", Joy, self._on_joy, queue_size=1, tcp_nodelay=True)
        self._listener = StatusListener(self._on_status, self._diagnostics)
        rospy.on_shutdown(self._leave)
        with _terminal() if keyboard else contextlib.nullcontext():
            try:
                self._loop(_Screen() if keyboard and sys.stdout.isatty() else None, keyboard)
            except rospy.ROSException:
                if not rospy.is_shutdown():  # a signal closes topics at any moment
                    raise
        rospy.signal_shutdown("the human has left")

    # Callbacks store.

    def _on_joy(self, msg: Joy) -> None:
        with self._lock:
            usable = self._teleop.joy(msg.axes, msg.buttons, rospy.get_time())
        if not usable:
            self._diagnostics.count("bad_joy")
            self._diagnostics.set(WARN, "joystick without the axes and the button of the parameters")

    def _on_status(self, status: Status) -> None:
        self._status = status

    def _loop(self, screen: _Screen | None, keyboard: bool) -> None:
        while not rospy.is_shutdown():
            if keyboard:
                keys = self._read()
                if keys is None or "quit" in keys:
                    return
            else:
                keys = []
                time.sleep(_LOOK_S)
            now = rospy.get_time()
            with self._lock:
                for key in keys:
                    self._teleop.press(key, now)
                self._speak(now)
            if screen is not None:
                screen.draw(self._lines())

    def _read(self) -> list[Key] | None:
        """Keys that have come, after a moment; None when the terminal is gone."""
        try:
            ready, _, _ = select.select([sys.stdin], [], [], _LOOK_S)
            data = os.read(sys.stdin.fileno(), 256) if ready else None
        except InterruptedError:
            return []
        except OSError:
            return None
        return [] if data is None else self._keys.feed(data) if data else None

    def _speak(self, now: float) -> None:
        twist, taken = self._teleop.step(now), self._teleop.taken
        since = now - self._said_at
        if twist is not None and (twist != self._said or not 0.0 <= since < self._period_s - _EARLY_S):
            self._commands.publish(twist_to_msg(twist))
            in_time = twist == self._said and self._period_s - _EARLY_S <= since < 2.0 * self._period_s
            self._said_at = self._said_at + self._period_s if in_time else now
        self._said = twist
        if taken != self._was_taken or (taken and not 0.0 <= now - self._active_at < _ACTIVE_PERIOD_S):
            self._active.publish(Bool(taken))
            self._active_at, self._was_taken = now, taken

    def _leave(self) -> None:
        """Before the publishers are gone: the robot stands, and is its own again."""
        with self._lock:
            if self._was_taken:
                self._commands.publish(twist_to_msg(Twist2D()))
                self._active.publish(Bool(False))
                self._teleop.press("release", rospy.get_time())
                self._was_taken = False
                time.sleep(_LEAVE_S)

    def _lines(self) -> list[str]:
        """State for the screen."""
        teleop, status, said = self._teleop, self._status, self._said
        wanted = "nothing" if said is None else f"{said.v:+.2f} m/s {said.omega:+.2f} rad/s"
        hand = f"in your hand ({teleop.source or 'no key'})" if teleop.taken else "not in your hand"
        speed = f"speed {teleop.speed_mps:.1f} m/s, {teleop.yaw_rate_rps:.2f} rad/s"
        lines = [f"{speed}   {hand}   says: {wanted}"]
        if status is None:
            return [*lines, f"{rospy.get_namespace()}hhike_msg/status: nothing yet", ""]
        reason = f" ({status.reason})" if status.reason else ""
        limit = f", at most {status.speed_limit_mps:.2f} m/s" if status.speed_limit_mps and status.goal else ""
        riders = f", with {', '.join(status.convoy)}" if status.convoy else ""
        lines.append(f"{status.robot_id}: {status.state}{reason}{riders}{limit}")
        return [*lines, _HANDS[status.teleop_mode]]


class _Screen:
    """Help above, and below it lines that change in place."""

    def __init__(self) -> None:
        self._drawn: list[str] = []
        self._drawn_at = -1e9
        print(*HELP, sep="\n", flush=True)

    def draw(self, lines: list[str]) -> None:
        if lines == self._drawn or time.monotonic() - self._drawn_at < _DRAW_PERIOD_S:
            return
        columns = os.get_terminal_size(sys.stdout.fileno()).columns or 80
        up = f"\x1b[{len(self._drawn)}A" if self._drawn else ""
        sys.stdout.write(up + "".join(f"\r\x1b[K{line[: columns - 1]}\n" for line in lines))
        sys.stdout.flush()
        self._drawn, self._drawn_at = lines, time.monotonic()


@contextlib.contextmanager
def _terminal() -> Iterator[None]:
    """Keys come one by one and are not shown; afterwards the terminal is as it was."""
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd)
        yield
    finally:
        with contextlib.suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(fd, termios.TCSANOW, before)


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros teleop``."""
    run("teleop", TeleopNode)
