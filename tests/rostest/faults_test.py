#!/usr/bin/python3
"""Sensors that fail under way: the robot is told to stand within 0.5 s, /diagnostics says why, and it recovers."""

import sys
import unittest
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist

sys.path.insert(0, str(Path(__file__).resolve().parent))
from tamper import Tamper, empty_calibration, holey_scan, nan_odometry, nan_scan, nothing
from watch import Watch

ROBOT = "turtlebot"
STOP_S = 0.5


class FaultTest(unittest.TestCase):
    """What both suites do: break a sensor of a robot that drives, see it stand and say why, heal, see it drive."""

    __test__ = False

    def setUp(self) -> None:
        self.watch = Watch(ROBOT)
        self.tamper = Tamper(ROBOT)
        self.commands: list[tuple[float, float]] = []  # time, speed
        self.watch.subscribe(f"/{ROBOT}/cmd_vel", Twist, self.keep)

    def keep(self, msg: Twist) -> None:
        self.commands.append((rospy.get_time(), abs(msg.linear.x) + abs(msg.angular.z)))

    def drives(self, deadline_s: float = 90.0) -> None:
        self.watch.until(lambda: self.watch.speed(ROBOT) > 0.2, deadline_s, "the robot drives")

    def stands_because(self, topic: str, how: Callable[[Any], Any], module: str, *words: str) -> None:
        """Spoil ``topic`` and see the robot stand in time with a diagnosis that has one of ``words``."""
        self.tamper.spoil(topic, how)

        def diagnosed() -> bool:
            level, text, _ = self.watch.diagnostic(f"{ROBOT}: {module}")
            return level == DiagnosticStatus.ERROR and any(word in text for word in words)

        self.watch.until(diagnosed, 30, f"{module} says one of {words}")
        self.watch.until(lambda: abs(self.watch.speed(ROBOT)) < 0.02, 30, "the wheels stand")
        # The first zero after the last motion, on the simulated clock; a robot that stood already proves nothing, but a
        # fault may meet one of its pauses.
        commands, last_good = list(self.commands), self.tamper.last_good[topic]
        last_motion = max((i for i, (_, speed) in enumerate(commands) if speed > 0.0), default=-1)
        self.assertLess(last_motion + 1, len(commands), f"the robot is told to stand after {topic} failed")
        stood = commands[last_motion + 1][0]
        period = 0.1  # of the sensor: the fault begins when the next message should have come
        self.assertLessEqual(stood - (last_good + period), STOP_S, topic)
        self.tamper.heal(topic)


class Driving(FaultTest):
    def test_laser_and_wheels(self) -> None:
        self.tamper.spoil("scan", holey_scan)
        self.drives()
        self.tamper.heal("scan")
        self.watch.until(lambda: "scan" in self.tamper.last_good, 30, "a whole scan comes")
        for topic, how, module, words in (
            ("scan", nan_scan, "obstacle_avoidance", ("NaN",)),
            ("odom", nan_odometry, "obstacle_avoidance", ("not finite",)),
            ("scan", nothing, "obstacle_avoidance", ("no scan",)),
            ("odom", nothing, "obstacle_avoidance", ("odometry", "pose")),
        ):
            self.drives()
            self.stands_because(topic, how, module, *words)
        self.drives()


class Following(FaultTest):
    def setUp(self) -> None:
        super().setUp()
        self.lead = rospy.Publisher("/p3dx/cmd_vel", Twist, queue_size=1)
        command = Twist()
        command.linear.x = 0.25
        self.pull = rospy.Timer(rospy.Duration(0.2), lambda _event: self.lead.publish(command))
        self.addCleanup(self.pull.shutdown)

    def test_camera_laser_and_wheels(self) -> None:
        self.tamper.spoil("camera/camera_info", nothing)

        def uncalibrated() -> bool:
            level, text, _ = self.watch.diagnostic(f"{ROBOT}: visual_servoing")
            return level == DiagnosticStatus.ERROR and "camera_info" in text

        self.watch.until(uncalibrated, 60, "visual_servoing misses camera_info")
        self.assertLess(abs(self.watch.speed(ROBOT)), 0.02)
        self.tamper.heal("camera/camera_info")
        for topic, how, words in (
            ("camera/image_raw", nothing, ("no image",)),
            ("odom", nan_odometry, ("not finite",)),
            ("scan", nan_scan, ("NaN",)),
            ("scan", nothing, ("no scan",)),
            ("camera/camera_info", empty_calibration, ("K",)),
        ):
            self.drives()
            self.stands_because(topic, how, "visual_servoing", *words)
        self.drives()


if __name__ == "__main__":
    rospy.init_node("faults_test")
    suite = next(cls for cls in (Driving, Following) if cls.__name__ in sys.argv)
    rostest.rosrun("hitchhike_ros", f"faults_{suite.__name__.lower()}", suite)
