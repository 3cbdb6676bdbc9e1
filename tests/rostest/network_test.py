#!/usr/bin/python3
"""Garbage, truncated, foreign-version and replayed messages are dropped and counted; what is good is still heard.

That no award can be written down is said, and stops nobody.
"""

import sys
import unittest
from pathlib import Path

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import String

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.protocol.messages import Beacon, Deny, Request, encode

ROBOT = "turtlebot"


class NetworkTest(unittest.TestCase):
    def test_bad_messages(self) -> None:
        watch = Watch(ROBOT)
        network = rospy.Publisher("/hhike_msg/network", String, queue_size=50)
        request = watch.until(lambda: watch.of_type(Request), 90, "a request")[-1]
        watch.until(lambda: network.get_num_connections() >= 2, 30, "the robot listens")
        good = encode(Beacon(robot_id="ghost", seq=7, state="idle", profile=50.0, priority=10))
        unreadable = (
            "",
            "}{ garbage \x00",
            good[: len(good) // 2],
            "[1, 2, 3]",
            good.replace('"version":1', '"version":99'),
            good.replace('"type":"status"', '"type":"spell"'),
            good.replace('"profile":50.0', '"profile":"nan"'),
            good.replace('"profile":50.0', '"profile":1000'),
        )
        for text in (good, *unreadable, good):
            network.publish(String(text))

        def counts() -> dict[str, str]:
            return watch.diagnostic(f"{ROBOT}: hitchhike_comm")[2]

        expected = str(len(unreadable))
        watch.until(lambda: counts().get("dropped_unreadable") == expected, 30, f"{expected} unreadable messages")
        watch.until(lambda: counts().get("dropped_replayed") == "1", 30, "one replayed message")

        self.assertEqual("requesting", watch.state(ROBOT))
        level, text, _ = watch.diagnostic(f"{ROBOT}: award_ledger")
        self.assertEqual(DiagnosticStatus.WARN, level)
        self.assertIn("awards are not written down: /dev/null/awards.sqlite is 'below /dev/null, which", text)
        denial = Deny(robot_id="ghost", to=ROBOT, ride_id=request.ride_id, seq=8, reason="Path too short")
        network.publish(String(encode(denial)))
        watch.until(lambda: watch.statuses[ROBOT][-1].reason == "Path too short", 30, "a good message is heard")


if __name__ == "__main__":
    rospy.init_node("network_test")
    rostest.rosrun("hitchhike_ros", "network", NetworkTest)
