#!/usr/bin/python3
"""teleop in a real terminal: keys, dead man, joystick, screen, and the terminal as it was, however it ends."""

import contextlib
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
import time
import unittest
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rospy
import rostest
from geometry_msgs.msg import Twist
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, String

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.protocol.status import GoalCommand, Status, encode_status

ROBOT, WAIT_S, REPEAT_S = "/robot", 30.0, 0.1
COMMAND = ["rosrun", "hitchhike_ros", "teleop", f"__ns:={ROBOT}", "__name:=teleop"]
GOAL = GoalCommand("1", 5.0, 0.0, 0.0)


class Terminal:
    """teleop in a pseudo-terminal that is its controlling one, as a shell's would be."""

    def __init__(self, *arguments: str) -> None:
        self.master, self.slave = pty.openpty()
        self.before = termios.tcgetattr(self.slave)
        self.shown = b""
        command = ["setsid", "--ctty", *COMMAND, *arguments]
        self.process = subprocess.Popen(command, stdin=self.slave, stdout=self.slave, stderr=self.slave)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while data := os.read(self.master, 4096):
                self.shown += data

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def screen(self) -> list[str]:
        """The newest text of the lines that change in place."""
        text = re.sub(r"\x1b\[\d*A", "", self.shown.decode(errors="replace"))
        return [line.split("\x1b[K")[-1].strip() for line in text.split("\n")][-4:-1]

    def restored(self) -> bool:
        return termios.tcgetattr(self.slave) == self.before

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        os.close(self.master)
        os.close(self.slave)


class TeleopTest(unittest.TestCase):
    def setUp(self) -> None:
        self.watch = Watch()
        self.commands: list[tuple[float, Twist]] = []
        self.in_hand: list[bool] = []
        self.watch.subscribe(f"{ROBOT}/cmd_vel/teleop", Twist, lambda m: self.commands.append((time.monotonic(), m)))
        self.watch.subscribe(f"{ROBOT}/cmd_vel", Twist)
        self.watch.subscribe(f"{ROBOT}/teleop/active", Bool, lambda m: self.in_hand.append(m.data))
        self.status = rospy.Publisher(f"{ROBOT}/hhike_msg/status", String, queue_size=1, latch=True)
        self.say()
        self.terminals: list[Terminal] = []

    def tearDown(self) -> None:
        for terminal in self.terminals:
            terminal.close()

    def say(self, state: str = "idle", goal: GoalCommand | None = None, role: str = "none", reason: str = "") -> None:
        status = Status(rospy.get_time(), "robot", role, state, reason, goal=goal)
        self.status.publish(String(encode_status(status)))

    def start(self, *arguments: str) -> Terminal:
        terminal = Terminal(*arguments)
        self.terminals.append(terminal)
        self.watch.until(lambda: b"says:" in terminal.shown, WAIT_S, "a screen")
        publisher = rospy.Publisher(f"{ROBOT}/joy", Joy, queue_size=1)
        self.until(lambda: publisher.get_num_connections() > 0, "teleop hears the joystick")
        self.joy = publisher
        # Its commands arrive here.
        self.in_hand.clear()
        self.until(lambda: self.heard(terminal), "its commands arrive", every_s=0.2)
        return terminal

    def heard(self, terminal: Terminal) -> bool:
        if self.in_hand and self.commands:
            return True
        terminal.press(" ")
        return False

    def until(self, condition: Callable[[], Any], what: str, every_s: float = 1.0) -> None:
        self.watch.until(condition, WAIT_S, what, every_s)

    def hold(self, terminal: Terminal, condition: Callable[[], Any], what: str) -> None:
        """Holds w, which repeats about ten times a second, until a condition is true."""
        again = 0.0

        def held() -> Any:
            nonlocal again
            if time.monotonic() >= again:
                again = time.monotonic() + REPEAT_S
                terminal.press("w")
            return condition()

        self.until(held, what, every_s=REPEAT_S)

    def hold_in_vain(self, terminal: Terminal, what: str) -> None:
        """Holds w for a second, in which the robot never drives."""
        end = time.monotonic() + 1.0

        def over() -> bool:
            self.assertFalse(self.drives(), what)
            return time.monotonic() >= end

        self.hold(terminal, over, what)

    def drives(self) -> bool:
        return bool(self.watch.newest[f"{ROBOT}/cmd_vel"].linear.x > 0.3)

    def silent(self) -> bool:
        return time.monotonic() - self.commands[-1][0] > 1.0

    def newest(self) -> tuple[float, float]:
        twist = self.commands[-1][1]
        return round(twist.linear.x, 3), round(twist.angular.z, 3)

    def test_keys_drive_and_silence_stops(self) -> None:
        terminal = self.start()
        self.assertIn(b"space: stop", terminal.shown)
        terminal.press("w")
        pressed = time.monotonic()
        self.until(lambda: self.newest() == (0.5, 0.0), "ahead")
        self.assertTrue(self.in_hand[-1])
        self.until(lambda: self.newest() == (0.0, 0.0), "the dead man stops")
        self.assertGreater(self.commands[-1][0] - pressed, 0.7)
        self.until(self.silent, "silence")
        terminal.press("\x1b[A")
        self.until(lambda: self.newest() == (0.5, 0.0), "ahead by an arrow")
        terminal.press("\x1b[D")
        self.until(lambda: self.newest() == (0.5, 0.5), "a curve")
        terminal.press(" ")
        self.until(lambda: self.newest() == (0.0, 0.0), "stop")
        terminal.press("qqs")
        self.until(lambda: self.newest() == (-0.3, 0.0), "slowly back")
        self.until(lambda: "speed 0.3 m/s" in terminal.screen()[0], "the speed on the screen")

    def test_a_held_key_is_said_ten_times_a_second(self) -> None:
        terminal = self.start()

        def ahead() -> list[float]:
            return [at for at, twist in self.commands if twist.linear.x == 0.5]

        self.hold(terminal, lambda: len(ahead()) >= 30, "thirty commands")
        self.assertGreater(ahead()[29] - ahead()[0], 2.0, "not more often")

    def test_the_screen_says_what_the_robot_does(self) -> None:
        terminal = self.start()
        self.until(lambda: "it has no goal" in terminal.screen()[2], "no goal")
        self.say("driving", GOAL, "driver", "Riders move up")
        self.until(lambda: "robot: driving (Riders move up)" in terminal.screen()[1], "state and reason")
        self.until(lambda: "within its limits" in terminal.screen()[2], "that it may be driven")
        self.say("aligning", GOAL, "driver")
        self.until(lambda: "only space works" in terminal.screen()[2], "that it acts by itself")

    def test_the_mux_passes_what_the_protocol_allows(self) -> None:
        terminal = self.start()
        self.hold(terminal, self.drives, "a robot without a goal is driven")
        for state, goal in (("driving", GOAL), ("aligned", None), ("waiting_for_rider", None), ("aligning", GOAL)):
            self.say(state, goal, "driver")
            self.until(lambda: self.watch.newest[f"{ROBOT}/cmd_vel"].linear.x == 0.0, f"it stands: {state}")
            self.hold_in_vain(terminal, state)
        self.say()
        self.hold_in_vain(terminal, "a key that is still held does not drive on")
        self.until(lambda: self.newest() == (0.0, 0.0), "let go")
        self.until(self.silent, "silence, so that the mux has heard it too")
        self.hold(terminal, self.drives, "it is driven again")

    def test_it_gives_the_robot_back(self) -> None:
        terminal = self.start()
        terminal.press("w")
        self.until(lambda: self.in_hand[-1], "in hand")
        terminal.press("x")
        self.until(lambda: not self.in_hand[-1], "given back")

    def test_a_joystick_drives(self) -> None:
        self.start()

        def half_left() -> bool:
            self.joy.publish(Joy(axes=[0.5, 1.0], buttons=[0, 0, 0, 0, 1]))
            return self.newest() == (0.5, 0.25)

        self.until(half_left, "half left", every_s=REPEAT_S)
        self.joy.publish(Joy(axes=[0.5, 1.0], buttons=[0, 0, 0, 0, 0]))
        self.until(lambda: self.newest() == (0.0, 0.0), "the button is let go")

    def test_the_terminal_is_as_it_was(self) -> None:
        for how in ("Ctrl-C", "Ctrl-D", "SIGTERM"):
            terminal = self.start()
            self.assertFalse(terminal.restored(), "keys come one by one")
            terminal.press("w")
            self.until(lambda: self.newest() == (0.5, 0.0), "ahead")
            if how == "SIGTERM":
                os.killpg(terminal.process.pid, signal.SIGTERM)
            else:
                terminal.press("\x03" if how == "Ctrl-C" else "\x04")
            terminal.process.wait(WAIT_S)
            self.until(terminal.restored, f"restored after {how}")
            self.until(lambda: self.newest() == (0.0, 0.0) and not self.in_hand[-1], f"given back after {how}")
            self.assertNotIn(b"Traceback", terminal.shown, how)

    def test_bad_parameters_leave_the_terminal_alone(self) -> None:
        self.addCleanup(rospy.delete_param, f"{ROBOT}/teleop/speed_mps")
        terminal = Terminal("_speed_mps:=-1")
        self.terminals.append(terminal)
        self.assertEqual(1, terminal.process.wait(WAIT_S))
        self.assertTrue(terminal.restored())
        self.assertIn(b"speed_mps", terminal.shown)

    def test_without_a_terminal_it_says_so(self) -> None:
        done = subprocess.run(
            COMMAND, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=WAIT_S, check=False
        )
        self.assertEqual(1, done.returncode)
        self.assertIn("standard input is no terminal", done.stderr)
        self.assertNotIn("Traceback", done.stderr)


if __name__ == "__main__":
    rospy.init_node("teleop_test")
    rostest.rosrun("hitchhike_ros", "teleop", TeleopTest)
