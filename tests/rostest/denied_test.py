#!/usr/bin/python3
"""A ride that is not given (P17 §7.3): the driver says why, nobody couples, and both go on alone."""

import sys
import unittest
from pathlib import Path

import rospy
import rostest

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.protocol.messages import Accept, Deny, Lock, Request


class DeniedTest(unittest.TestCase):
    """~reason: the denial that is expected once the driver has come to the hitchhiking point."""

    def test_denied_with_reason_and_both_go_on_alone(self) -> None:
        reason = rospy.get_param("~reason")
        watch = Watch("p3dx", "turtlebot")
        watch.until(lambda: watch.of_type(Request), 90, "a request")
        watch.until(lambda: [m for m in watch.of_type(Deny) if m.reason == reason], 120, f"denial '{reason}'")
        watch.until(lambda: watch.state("turtlebot") == "navigating", 120, "the hitchhiker drives alone")
        start = watch.truth("turtlebot")
        watch.until(lambda: watch.truth("turtlebot").x > start.x + 0.5, 60, "the hitchhiker moves")

        self.assertEqual([], watch.of_type(Accept))
        self.assertEqual([], watch.of_type(Lock))
        asked = [s.state for s in watch.statuses["turtlebot"]]
        self.assertNotIn("riding", asked)
        first, last = watch.of_type(Request)[0], watch.of_type(Request)[-1]
        waited = last.time_stamp - first.time_stamp
        self.assertLessEqual(waited, rospy.get_param("/turtlebot/hitchhiking/max_wait_s"))
        driver_states = {s.state for s in watch.statuses["p3dx"]}
        self.assertLessEqual(driver_states, {"idle", "navigating"})


if __name__ == "__main__":
    rospy.init_node("denied_test")
    rostest.rosrun("hitchhike_ros", "denied", DeniedTest)
