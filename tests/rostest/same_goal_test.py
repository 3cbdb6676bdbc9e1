#!/usr/bin/python3
"""Both robots want the same place (P17 §3.1): both actions end in success, and nothing is driven after the ride."""

import sys
import unittest
from pathlib import Path

import rospy
import rostest
from actionlib_msgs.msg import GoalStatus
from move_base_msgs.msg import MoveBaseActionResult
from std_msgs.msg import String

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.core.geometry import distance
from hitchhike_ros.protocol.messages import Accept
from hitchhike_ros.simulation.world_file import load_world

DRIVER, RIDER = "p3dx", "turtlebot"
RESULTS = {robot: f"/{robot}/move_base/result" for robot in (DRIVER, RIDER)}
DEADLINE_S = 300.0  # of wall time
# The camera and the marker are the gap of 0.8 m apart, and about 0.4 m ahead of and behind the robots' middles.
BEHIND_M = (0.9, 1.6)


class SameGoalTest(unittest.TestCase):
    def test_the_driver_has_the_goal_and_the_hitchhiker_ends_behind_it(self) -> None:
        goal = load_world(rospy.get_param("~world")).robots[RIDER].goal
        assert goal is not None
        watch = Watch(DRIVER, RIDER)
        touched: list[str] = []
        watch.subscribe("/simulator/contacts", String, lambda msg: touched.append(msg.data))
        for topic in RESULTS.values():
            watch.subscribe(topic, MoveBaseActionResult)
        watch.until(lambda: watch.state(RIDER) == "settling", DEADLINE_S, "they ride to the goal")
        set_down = watch.truth(RIDER)
        watch.until(lambda: all(topic in watch.newest for topic in RESULTS.values()), DEADLINE_S, "both actions end")
        results = {robot: watch.newest[topic].status for robot, topic in RESULTS.items()}
        print(*((robot, result.status, result.text) for robot, result in results.items()), sep="\n")
        for robot, result in results.items():
            self.assertEqual(GoalStatus.SUCCEEDED, result.status, (robot, result.text))
        self.assertEqual("Goal reached", results[DRIVER].text)
        watch.until(lambda: abs(watch.speed(DRIVER)) < 0.01 and abs(watch.speed(RIDER)) < 0.01, 60, "both stand")

        driver_at, rider_at = watch.truth(DRIVER), watch.truth(RIDER)
        away_m = distance(rider_at, goal)
        self.assertLessEqual(distance(driver_at, goal), 0.15)
        self.assertTrue(BEHIND_M[0] <= distance(rider_at, driver_at) <= BEHIND_M[1], (rider_at, driver_at))
        said = results[RIDER].text
        self.assertTrue(said.startswith(f"goal taken by {DRIVER}, ") and said.endswith(" m before it"), said)
        self.assertAlmostEqual(away_m, float(said.split()[4]), delta=0.2)
        self.assertLessEqual(distance(rider_at, set_down), 0.15, "nothing is driven after the ride")
        # Before the ride the hitchhiker is told that the driver will stand there.
        offered = watch.of_type(Accept)[-1].goal
        assert offered is not None
        self.assertLessEqual(distance(offered, goal), 1e-6)
        self.assertEqual([], touched)


if __name__ == "__main__":
    rospy.init_node("same_goal_test")
    rostest.rosrun("hitchhike_ros", "same_goal", SameGoalTest)
