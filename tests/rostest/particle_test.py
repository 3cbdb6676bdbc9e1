#!/usr/bin/python3
"""A robot that localizes by particles reaches its goal, and is where it says it is."""

import sys
import unittest
from pathlib import Path

import rospy
import rostest
from geometry_msgs.msg import PoseArray, PoseWithCovarianceStamped

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.core.geometry import distance
from hitchhike_ros.ros_io.conversions import estimate_from_msg


class ParticleTest(unittest.TestCase):
    def test_drives_to_its_goal(self) -> None:
        watch = Watch("turtlebot")
        clouds: list[int] = []
        poses: list[PoseWithCovarianceStamped] = []
        watch.subscribe("/turtlebot/particlecloud", PoseArray, lambda msg: clouds.append(len(msg.poses)))
        watch.subscribe("/turtlebot/amcl_pose", PoseWithCovarianceStamped, poses.append)
        watch.until(lambda: watch.state("turtlebot") == "navigating", 120, "T_hwait passes")
        watch.until(lambda: watch.state("turtlebot") == "idle", 400, "the goal is reached")
        self.assertEqual("Goal reached", watch.statuses["turtlebot"][-1].reason)
        truth = watch.truth("turtlebot")
        self.assertLessEqual(distance(truth, estimate_from_msg(poses[-1]).pose), 0.15)
        self.assertGreater(min(clouds), 100)


if __name__ == "__main__":
    rospy.init_node("particle_test")
    rostest.rosrun("hitchhike_ros", "particle", ParticleTest)
