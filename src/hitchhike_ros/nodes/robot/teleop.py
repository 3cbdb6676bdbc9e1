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
    /diagnostics (diagnostic_msgs/DiagnosticArray): joystick messages and statuses that were refused
Parameters:
    ~config (path, default none), sections ``teleop`` (control.teleop.TeleopParameters) and ``teleop_terminal``
    (control.teleop_screen.TerminalParameters), also as private parameters, e.g.
    ~rate (Hz, 10)
    ~keyboard (bool, true): false: by joystick alone, without a terminal
TF: none.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from functools import partial

import rospy

from hitchhike_ros.control.teleop import HELP, KeyReader, TeleopParameters
from hitchhike_ros.control.teleop_screen import Screen, TerminalParameters
from hitchhike_ros.core.errors import TeleopError
from hitchhike_ros.modules.module import Outputs
from hitchhike_ros.modules.teleoperation import HumanLeaves, KeysPressed, Teleoperation, TeleopOutputs
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.outlets import outlets
from hitchhike_ros.ros_io.parameters import node_parameters


class TeleopNode:
    """One loop reads the keys, steps the module and draws; it ends with the terminal as it was."""

    def __init__(self) -> None:
        self._params = node_parameters(TerminalParameters, "teleop_terminal")
        keyboard = self._params.keyboard
        if keyboard and not sys.stdin.isatty():
            raise TeleopError("standard input is no terminal; keys come from one, _keyboard:=false does without")
        params = node_parameters(TeleopParameters, "teleop")
        self._module = Teleoperation(params, rospy.resolve_name("hhike_msg/status"))
        said = {self._module.name: outlets(self._module.name)}
        self._lines: tuple[str, ...] = ()
        self._host = ModuleHost(Single(self._module), said, also=self._take, start=False)
        rospy.on_shutdown(self._leave)
        with _terminal() if keyboard else contextlib.nullcontext():
            try:
                self._loop(keyboard, Screen(self._params.draw_period_s) if keyboard and sys.stdout.isatty() else None)
            except rospy.ROSException:
                if not rospy.is_shutdown():  # a signal closes topics at any moment
                    raise
        rospy.signal_shutdown("the human has left")

    def _take(self, _name: str, outputs: Outputs) -> None:
        if isinstance(outputs, TeleopOutputs):
            self._lines = outputs.lines

    def _loop(self, keyboard: bool, screen: Screen | None) -> None:
        reader = KeyReader()
        if screen is not None:
            print(*HELP, sep="\n", flush=True)
        while not rospy.is_shutdown():
            data = _read(self._params.look_s) if keyboard else _nothing(self._params.look_s)
            keys = () if data is None else reader.feed(data)
            if data is None or "quit" in keys:
                return
            if keys:
                self._sense(KeysPressed(tuple(keys)))
            self._host.turn(rospy.get_time())
            if screen is not None:
                columns = os.get_terminal_size(sys.stdout.fileno()).columns
                sys.stdout.write(screen.draw(self._lines, columns, time.monotonic()))
                sys.stdout.flush()

    def _sense(self, x: KeysPressed | HumanLeaves) -> None:
        self._host.post(partial(self._module.sense, x, rospy.get_time()))

    def _leave(self) -> None:
        """Before the publishers are gone: the robot stands, and is its own again."""
        self._sense(HumanLeaves())
        self._host.turn(rospy.get_time())
        time.sleep(self._params.leave_s)


def _read(timeout_s: float) -> bytes | None:
    """Bytes that have come, after a moment; None when the terminal is gone."""
    try:
        ready, _, _ = select.select([sys.stdin], [], [], timeout_s)
        return (os.read(sys.stdin.fileno(), 256) or None) if ready else b""
    except InterruptedError:
        return b""
    except OSError:
        return None


def _nothing(seconds: float) -> bytes:
    time.sleep(seconds)
    return b""


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
