#!/usr/bin/python3
"""A ride through the Willow Garage by the demo's front door for other worlds."""

import json
import subprocess
import tempfile
import unittest
from pathlib import Path

import rospkg
import rostest

TESTS = Path(rospkg.RosPack().get_path("hitchhike_ros")) / "tests" / "rostest"
MAP = TESTS.parents[2] / "shared" / "data" / "maps" / "willow-2010-02-18-0.10.pgm"
DEADLINE_S = 800
# What is left of a wall's roughness at 0.10 m a cell must not become a box either.
HOLDS = (
    "couple",
    "decouple",
    "gap_error_rms",
    "handover_position_error",
    "handover_heading_error",
    "false_boxes",
    "contacts",
)


class WillowTest(unittest.TestCase):
    def test_ride(self) -> None:
        if not MAP.is_file():
            print(f"SKIPPED: {MAP.name} is not beside the project, in ../shared/data/maps")
            self.skipTest("no map")
        with tempfile.TemporaryDirectory() as folder:
            world = TESTS / "willow.world.yaml"
            command = ["rosrun", "hitchhike_ros", "ride_demo", "--world", str(world), "--output", folder]
            command += ["--rviz", "false"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
            self.assertEqual(0, done.returncode, done.stdout + done.stderr)
            ride = json.loads((Path(folder) / "ride.json").read_text(encoding="utf-8"))
        self.assertTrue(ride["completed"])
        figures = {figure["name"]: figure for figure in ride["figures"]}
        self.assertGreater(figures["ride"]["value"], 20.0)
        for name in HOLDS:
            self.assertTrue(figures[name]["ok"], figures[name])


if __name__ == "__main__":
    rostest.rosrun("hitchhike_ros", "willow", WillowTest)
