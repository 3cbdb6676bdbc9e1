#!/usr/bin/python3
"""A ride is completed and credited once although three messages in ten are lost and others late, twice or overtaken."""

import json
import math
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from typing import Any

import rospy
import rostest

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch, credits_of_this_run

from hitchhike_ros.protocol.messages import Message
from hitchhike_ros.simulation.world_file import load_world

DEADLINE_S = 800
DRIVER, RIDER = "p3dx", "turtlebot"


class LossyRideTest(unittest.TestCase):
    """One ride, driven before the tests."""

    watch: Watch
    ride: dict[str, Any]

    @classmethod
    def setUpClass(cls) -> None:
        cls.watch = Watch(DRIVER, RIDER)
        with tempfile.TemporaryDirectory() as folder:
            command = ["rosrun", "hitchhike_ros", "ride_monitor", "__name:=ride_monitor"]
            command += [f"_world:={rospy.get_param('~world')}", f"_output:={folder}"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
            print(done.stdout, done.stderr)
            assert done.returncode == 0, done.stdout + done.stderr
            cls.ride = json.loads((Path(folder) / "ride.json").read_text(encoding="utf-8"))

    def test_the_ride_was_completed_without_a_touch(self) -> None:
        self.assertTrue(self.ride["completed"])
        figures = {figure["name"]: figure["value"] for figure in self.ride["figures"]}
        self.assertEqual(0, figures["contacts"])

    def test_both_are_at_their_goals(self) -> None:
        for name, entry in load_world(rospy.get_param("~world")).robots.items():
            truth, goal = self.watch.truth(name), entry.goal
            assert goal is not None
            self.assertLessEqual(math.hypot(truth.x - goal.x, truth.y - goal.y), 0.15, name)
            self.assertEqual("Goal reached", self.watch.statuses[name][-1].reason, name)

    def test_the_award_was_credited_once(self) -> None:
        (credit,) = credits_of_this_run()
        self.assertEqual((DRIVER, RIDER), (credit.driver, credit.hitchhiker))
        self.assertAlmostEqual(20.4, credit.ride_m, delta=0.02 * 20.4)
        self.assertAlmostEqual(0.4 * credit.ride_m, credit.points)

    def test_the_network_lost_and_doubled_messages(self) -> None:
        values = self.watch.until(lambda: self.watch.diagnostic(": network_model")[2], 30, "the network's counts")
        print(values)
        counts = {key: int(value) for key, value in values.items() if value.isdecimal()}
        for pair in (f"{DRIVER}_to_{RIDER}", f"{RIDER}_to_{DRIVER}"):
            sent = counts[f"sent_{pair}"]
            self.assertGreater(sent, 100)
            # Five standard deviations of what 30 % and 0.7 * 10 % of so many messages are in the mean.
            self.assertAlmostEqual(0.3, counts[f"lost_{pair}"] / sent, delta=5.0 * math.sqrt(0.21 / sent))
            self.assertAlmostEqual(0.07, counts[f"doubled_{pair}"] / sent, delta=5.0 * math.sqrt(0.065 / sent))
        arrived = counts["sent"] - counts["lost"] + counts["doubled"]
        self.assertEqual(arrived, counts["delivered"] + counts["waiting"])
        self.assertEqual(0, counts["overflowed"])

    def test_what_is_late_or_comes_again_is_dropped(self) -> None:
        for name in (DRIVER, RIDER):
            values = self.watch.diagnostic(f"{name}: hitchhike_comm")[2]
            self.assertGreater(int(values["dropped_replayed"]), 0, name)
            self.assertNotIn("dropped_unreadable", values)

    def test_everything_that_is_said_is_on_the_common_topic(self) -> None:
        said = [(message.robot_id, message.seq) for message in self.watch.of_type(Message)]
        self.assertEqual({DRIVER, RIDER}, {robot for robot, _ in said})
        self.assertEqual(len(said), len(set(said)), "and once")


if __name__ == "__main__":
    rospy.init_node("lossy_ride_test")
    rostest.rosrun("hitchhike_ros", "lossy_ride", LossyRideTest)
