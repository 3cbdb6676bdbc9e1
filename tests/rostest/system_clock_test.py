#!/usr/bin/python3
"""The beginning of a ride on the system's clock: stamps, the count of late steps, and robots that couple and ride."""

import sys
import time
import unittest
from itertools import pairwise
from pathlib import Path

import rosgraph
import rospy
import rostest
from sensor_msgs.msg import LaserScan

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.core.geometry import distance

DEADLINE_S = 240
# With a greater share of late steps the machine is too busy to judge the ride: then they only have to be counted.
MOST_LATE = 0.02
PERIOD_S = 0.1
# So far the rider goes before the test ends.
RIDDEN_M = 1.0


class SystemClockTest(unittest.TestCase):
    """The robots drive once, before the tests."""

    watch: Watch
    scans: list[tuple[float, float]]  # when they came, and their stamps
    riding: str  # why they do not ride, or nothing
    steps: dict[str, float]  # what the simulator counts

    @classmethod
    def setUpClass(cls) -> None:
        cls.watch, cls.scans, cls.riding = Watch("p3dx", "turtlebot"), [], ""
        cls.watch.subscribe(
            "/p3dx/scan", LaserScan, lambda msg: cls.scans.append((time.time(), msg.header.stamp.to_sec()))
        )
        try:
            cls.watch.until(lambda: cls.ridden_m() > RIDDEN_M, DEADLINE_S, "a ride")
        except AssertionError as exc:
            cls.riding = str(exc)
        _, _, values = cls.watch.diagnostic(": simulator")
        cls.steps = {name: float(values[name]) for name in ("steps", "late_steps", "late_share", "real_time_factor")}
        print(f"{cls.steps['late_steps']:.0f} of {cls.steps['steps']:.0f} steps were late; {cls.riding or 'they ride'}")

    @classmethod
    def ridden_m(cls) -> float:
        """How far the driver says that they have ridden."""
        statuses = cls.watch.statuses["p3dx"]
        ride = statuses[-1].ride if statuses else None
        return ride.ridden_m if ride is not None and cls.watch.state("turtlebot") == "riding" else 0.0

    def test_the_system_has_the_time(self) -> None:
        self.assertFalse(rospy.get_param("/use_sim_time"))
        published = [topic for topic, _type in rosgraph.Master(rospy.get_name()).getPublishedTopics("")]
        self.assertIn("/p3dx/odom", published)
        self.assertNotIn("/clock", published)

    def test_scans_have_stamps_of_the_system_and_none_of_its_future(self) -> None:
        self.assertGreater(len(self.scans), 100)
        self.assertGreaterEqual(min(came - stamp for came, stamp in self.scans), -0.01)
        steps = [after - before for (_, before), (_, after) in pairwise(self.scans)]
        self.assertGreaterEqual(min(steps), PERIOD_S - 1e-6)

    def test_late_steps_are_counted(self) -> None:
        self.assertGreaterEqual(self.steps["steps"], len(self.scans) - 30)  # the count comes once a second
        self.assertLessEqual(self.steps["late_steps"], self.steps["steps"])
        self.assertAlmostEqual(self.steps["late_share"], self.steps["late_steps"] / self.steps["steps"], places=4)
        self.assertEqual(1.0, self.steps["real_time_factor"])

    def test_they_ride(self) -> None:
        if self.riding and self.steps["late_share"] > MOST_LATE:
            self.skipTest(f"{100.0 * self.steps['late_share']:.1f} % of the steps were late; {self.riding}")
        self.assertEqual("", self.riding)
        self.assertLess(distance(self.watch.truth("p3dx"), self.watch.truth("turtlebot")), 2.0)
        self.assertEqual("driving", self.watch.state("p3dx"))


if __name__ == "__main__":
    rospy.init_node("system_clock_test")
    rostest.rosrun("hitchhike_ros", "system_clock", SystemClockTest)
