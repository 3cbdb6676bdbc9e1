#!/usr/bin/python3
"""The network's node on a clock that the test sets: when and to whom it delivers, what it counts, what it refuses."""

import subprocess
import sys
import unittest
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

DEADLINE_S = 60
STEP_S = 0.25


def start(name: str, **params: object) -> subprocess.Popen[str]:
    private = [f"_{key}:={value}" for key, value in params.items()]
    command = ["rosrun", "hitchhike_ros", "network_model", f"__ns:=/{name}", *private]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


class NetworkModelTest(unittest.TestCase):
    """Each test has a network and robots of its own; the clock of all goes on."""

    now = 100.0

    @classmethod
    def setUpClass(cls) -> None:
        cls.clock = rospy.Publisher("/clock", Clock, queue_size=100, latch=True)
        cls.watch = Watch()

    def go_to(self, now: float) -> None:
        self.__class__.now = now
        self.clock.publish(Clock(rospy.Time.from_sec(now)))

    def until(self, condition: Callable[[], Any], what: str, ticking: bool = True) -> Any:
        """The first true value of ``condition``, while the clock goes on or stands."""

        def told() -> Any:
            value = condition()
            if ticking and not value:
                self.go_to(self.now + STEP_S)
            return value

        return self.watch.until(told, DEADLINE_S, what, every_s=0.02)

    def network(self, name: str, robots: str, **params: object) -> None:
        """Start a network; ``heard`` has what its robots hear, with the time on the clock, ``say`` speaks for them."""
        self.name = name
        node = start(name, robots=robots, **params)
        self.addCleanup(node.communicate, timeout=DEADLINE_S)
        self.addCleanup(node.terminate)
        self.heard: dict[str, list[tuple[str, float]]] = {robot: [] for robot in robots.split()}
        self.said: list[str] = []
        self.speakers = {
            robot: rospy.Publisher(f"/{robot}/hhike_msg/network_out", String, queue_size=200) for robot in self.heard
        }
        ears = [
            rospy.Subscriber(f"/{robot}/hhike_msg/network_in", String, self.note, robot, queue_size=200)
            for robot in self.heard
        ]
        ears.append(rospy.Subscriber("/hhike_msg/network", String, lambda msg: self.said.append(msg.data)))
        for ear in ears:
            self.addCleanup(ear.unregister)
        self.until(lambda: all(end.get_num_connections() for end in (*self.speakers.values(), *ears)), "connected")
        self.watch.diagnostics.pop(f"{name}: network_model", None)
        self.until(self.diagnostics, "diagnostics")

    def note(self, msg: String, robot: str) -> None:
        self.heard[robot].append((msg.data, self.now))

    def say(self, robot: str, *texts: str) -> None:
        """It says so, and the network has heard it."""
        before = len(self.said)
        for text in texts:
            self.speakers[robot].publish(String(text))
        self.until(lambda: len(self.said) >= before + len(texts), "it is heard", ticking=False)

    def texts(self, robot: str) -> list[str]:
        return [text for text, _ in self.heard[robot]]

    def diagnostics(self) -> dict[str, str]:
        return self.watch.diagnostic(f"{self.name}: network_model")[2]

    def counts(self, what: str, number: int) -> None:
        self.until(lambda: self.diagnostics().get(what) == str(number), f"{number} {what}: {self.diagnostics()}")

    def test_everybody_hears_what_another_says_at_once_and_in_order(self) -> None:
        self.network("plain", "a b c")
        texts = [str(i) for i in range(60)]
        self.say("a", *texts)
        self.say("b", "Grüße", "")
        self.until(lambda: len(self.heard["c"]) == 62 and len(self.heard["b"]) == 60, "all is heard", ticking=False)
        self.assertEqual([*texts, "Grüße", ""], self.texts("c"))
        self.assertEqual(texts, self.texts("b"))
        self.assertEqual(["Grüße", ""], self.texts("a"))
        self.assertEqual([*texts, "Grüße", ""], self.said)
        self.counts("sent_a_to_c", 60)
        self.counts("delivered", 124)
        for what in ("lost", "doubled", "out_of_reach", "overflowed", "waiting"):
            self.assertEqual("0", self.diagnostics()[what], what)

    def test_a_delay_is_simulated_time(self) -> None:
        self.network("slow", "slow_a slow_b", delay_s=20.0, duplication=1.0)
        began = self.now
        self.say("slow_a", "first", "second")
        self.counts("waiting", 4)
        self.assertLess(self.now, began + 19.0)
        self.go_to(began + 19.5)
        self.go_to(began + 20.5)
        self.until(lambda: len(self.heard["slow_b"]) == 4, "heard while the clock stands", ticking=False)
        self.assertEqual(
            [(text, began + 20.5) for text in ("first", "first", "second", "second")], self.heard["slow_b"]
        )
        self.counts("doubled_slow_a_to_slow_b", 2)
        self.counts("delivered", 4)

    def test_range(self) -> None:
        self.network("short", "near_a near_b near_c", range_m=10.0)
        places = {
            robot: rospy.Publisher(f"/{robot}/ground_truth", Odometry, queue_size=1, latch=True) for robot in self.heard
        }
        self.say("near_a", "Where are you?")
        self.counts("out_of_reach", 2)

        def put(robot: str, x: float) -> None:
            odometry = Odometry()
            odometry.pose.pose.position = Point(x, 3.0, 0.0)
            places[robot].publish(odometry)

        def hears(robot: str) -> bool:
            self.say("near_a", "Hello")
            return "Hello" in self.texts(robot)

        for robot, x in (("near_a", 0.0), ("near_b", 9.9), ("near_c", 10.1)):
            put(robot, x)
        self.until(lambda: hears("near_b"), "b hears")
        self.assertEqual([], self.heard["near_c"])
        put("near_c", -10.0)
        self.until(lambda: hears("near_c"), "c hears")

    def test_partitions(self) -> None:
        begin, end = self.now + 1000.0, self.now + 2000.0
        groups = f"[{{begin_s: {begin}, end_s: {end}, groups: [[part_a], [part_b]]}}]"
        self.network("parted", "part_a part_b part_c", partitions=groups)
        for now, text in ((begin - 100.0, "before"), (begin + 100.0, "meanwhile"), (end + 100.0, "after")):
            self.go_to(now)
            self.watch.diagnostics.pop("parted: network_model")
            self.until(self.diagnostics, "the time has come to the network")
            self.say("part_a", text)
            self.until(lambda text=text: text in self.texts("part_c"), f"c hears {text}")
        self.until(lambda: "after" in self.texts("part_b"), "b hears")
        self.assertEqual(["before", "after"], self.texts("part_b"))
        self.counts("out_of_reach_part_a_to_part_b", 1)

    def test_a_clock_that_begins_anew(self) -> None:
        self.network("again", "again_a again_b", delay_s=20.0)
        self.say("again_a", "old")
        self.counts("waiting", 1)
        self.go_to(10.0)
        self.until(lambda: self.diagnostics()["waiting"] == "0", "what was under way is forgotten")
        self.say("again_a", "new")
        self.until(lambda: self.heard["again_b"], "the new is heard")
        self.assertEqual(["new"], self.texts("again_b"))

    def test_too_much_under_way(self) -> None:
        self.network("full", "full_a full_b", delay_s=50.0, max_waiting=5)
        self.say("full_a", *"12345678")
        self.counts("overflowed", 3)
        self.assertEqual(DiagnosticStatus.WARN, self.watch.diagnostic("full: network_model")[0])
        self.until(lambda: len(self.heard["full_b"]) == 5, "five are heard")
        self.assertEqual(list("12345"), self.texts("full_b"))

    def test_bad_parameters(self) -> None:
        group = "{begin_s: 1, end_s: 2, groups: [[a]]}"
        cases: list[tuple[dict[str, object], tuple[str, ...]]] = [
            ({"robots": "a b", "loss": 1.5}, ("loss", "1.5", "expected")),
            ({"robots": "a b", "delay_s": -1}, ("delay_s", "-1", "expected")),
            ({"robots": "a b", "partitions": f"[{group}]"}, ("partitions[0].groups", "at least two")),
            ({"robots": "a b", "partitions": "[{begin_s: 1}]"}, ("partitions", "expected")),
            ({"robots": "a b/c!"}, ("~robots", "b/c!", "expected")),
            ({"world": "/nowhere.yaml"}, ("~world", "/nowhere.yaml", "expected")),
        ]
        nodes = [start(f"bad_{i}", **params) for i, (params, _) in enumerate(cases)]
        for node, (_, expected) in zip(nodes, cases, strict=True):
            said, _ = node.communicate(timeout=DEADLINE_S)
            self.assertEqual(1, node.returncode, said)
            for words in expected:
                self.assertIn(words, said)
            self.assertNotIn("Traceback", said)


if __name__ == "__main__":
    rospy.init_node("network_model_test")
    rostest.rosrun("hitchhike_ros", "network_model", NetworkModelTest)
