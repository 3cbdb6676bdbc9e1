#!/usr/bin/python3
"""A ride behind a driver that is driven by keys (P18 §8.3.4), with real nodes: against the truth."""

import json
import sys
from pathlib import Path
from typing import Any

import rospy
import rostest
from geometry_msgs.msg import Twist
from std_msgs.msg import Bool

sys.path.insert(0, str(Path(__file__).resolve().parent))
import network_ride_test
from network_ride_test import DRIVER, RIDER
from watch import Watch

COUNTED_S = 30
# P18 Exp. 1: the ride that is teleoperated too.
RIDE_M = 28.8
RIDE_SPEED_MPS = 0.5


def _whole(path: Path) -> bool:
    """Whether a JSON file has been written to its end."""
    return path.exists() and path.read_text(encoding="utf-8").endswith("}\n")


class TeleopRideTest(network_ride_test.NetworkRideTest):
    """What holds for rides by navigation holds for this one."""

    counts: dict[str, Any]
    commands: list[tuple[str, Twist]]

    @classmethod
    def setUpClass(cls) -> None:
        path = Path(rospy.get_param("~counts"))
        path.unlink(missing_ok=True)
        cls.commands, in_hand = [], []
        subscribers = [
            rospy.Subscriber(f"/{name}/cmd_vel/teleop", Twist, lambda msg, who=name: cls.commands.append((who, msg)))
            for name in (DRIVER, RIDER)
        ]
        subscribers.append(rospy.Subscriber(f"/{DRIVER}/teleop/active", Bool, lambda msg: in_hand.append(msg.data)))
        super().setUpClass()
        if not cls.trouble:
            try:
                Watch().until(lambda: _whole(path), COUNTED_S, "the operator has counted", every_s=0.1)
            except AssertionError as error:
                cls.trouble = str(error)
        if not cls.trouble:
            cls.counts = json.loads(path.read_text(encoding="utf-8"))
            cls.in_hand = in_hand
            print(cls.counts)
        for subscriber in subscribers:
            subscriber.unregister()

    def test_the_ride_is_that_of_the_paper(self) -> None:
        (ride,) = self.rides
        self.assertEqual((RIDER, DRIVER), (ride.hitchhiker, ride.driver))
        assert ride.ride_m is not None
        self.assertAlmostEqual(RIDE_M, ride.ride_m, delta=0.02 * RIDE_M)
        self.assert_met(ride, "west")

    def test_a_human_drove_the_whole_ride(self) -> None:
        """So many commands as ten a second are at the speed of a ride, but for the last metre and pulling away."""
        self.assertTrue(self.counts["completed"])
        driving = self.counts["states"]["driving"]
        self.assertGreater(driving["commands"], 0.8 * 10.0 * (RIDE_M - 1.0) / RIDE_SPEED_MPS)
        self.assertGreater(driving["keys"], 0.8 * 10.0 * (RIDE_M - 1.0) / RIDE_SPEED_MPS)
        self.assertEqual({"keys", "commands", "bytes"}, set(driving))
        self.assertEqual([DRIVER], list(self.counts["robots"]))

    def test_the_counts_are_what_was_sent(self) -> None:
        self.assertEqual({DRIVER}, {who for who, _ in self.commands})
        self.assertAlmostEqual(len(self.commands), self.counts["commands"], delta=5)
        self.assertEqual(self.counts["keys"] + 48 * self.counts["commands"], self.counts["bytes"])

    def test_the_human_took_the_robot_and_gave_it_back(self) -> None:
        self.assertEqual((True, False), (self.in_hand[0], self.in_hand[-1]))


if __name__ == "__main__":
    rospy.init_node("teleop_ride_test")
    rostest.rosrun("hitchhike_ros", "teleop_ride", TeleopRideTest)
