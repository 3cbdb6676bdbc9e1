#!/usr/bin/python3
"""No driver within T_hwait (P17 Algorithm 2, line 6): the hitchhiker reaches its goal by itself."""

import math
import sys
import unittest
from pathlib import Path

import rospy
import rostest
from std_msgs.msg import String

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import distance, wrap_angle
from hitchhike_ros.protocol.messages import Accept, Request

GOAL = Pose2D(25.0, 2.5, -math.pi / 2)  # as in the world file


class NoDriverTest(unittest.TestCase):
    def test_waits_asks_and_drives_alone(self) -> None:
        watch = Watch("turtlebot")
        touched: list[str] = []
        watch.subscribe("/simulator/contacts", String, lambda msg: touched.append(msg.data))
        watch.until(lambda: watch.of_type(Request), 90, "a request")
        watch.until(lambda: watch.state("turtlebot") == "navigating", 120, "T_hwait passes")
        requests = watch.of_type(Request)
        self.assertGreaterEqual(len(requests), 9)
        self.assertAlmostEqual(10.0, requests[-1].time_stamp - requests[0].time_stamp, delta=1.5)
        self.assertEqual([], watch.of_type(Accept))

        watch.until(lambda: watch.state("turtlebot") == "idle", 350, "the goal is reached")
        self.assertEqual("Goal reached", watch.statuses["turtlebot"][-1].reason)
        truth = watch.truth("turtlebot")
        self.assertLessEqual(distance(truth, GOAL), 0.15)
        self.assertLessEqual(abs(wrap_angle(truth.theta - GOAL.theta)), math.radians(7))
        self.assertEqual([], touched)


if __name__ == "__main__":
    rospy.init_node("no_driver_test")
    rostest.rosrun("hitchhike_ros", "no_driver", NoDriverTest)
