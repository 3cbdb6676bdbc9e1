#!/usr/bin/python3
"""map_server and map_saver as a person would run them: what is served is what the file says, and comes back from it."""

import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
from nav_msgs.msg import MapMetaData, OccupancyGrid
from nav_msgs.srv import GetMap

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.mapping import grid as grids
from hitchhike_ros.mapping.map_file import save_map
from hitchhike_ros.ros_io.conversions import grid_from_msg

DEADLINE_S = 60


class MapsTest(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def serve(self, name: str, path: Path) -> None:
        """A map_server in namespace ``name``; it ends with the test."""
        command = ["rosrun", "hitchhike_ros", "map_server", str(path), f"__ns:=/{name}"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        self.addCleanup(process.wait, DEADLINE_S)
        self.addCleanup(process.terminate)

    def save(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        command = ["rosrun", "hitchhike_ros", "map_saver", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)

    def test_served_and_saved_again(self) -> None:
        data = np.random.default_rng(1).choice(np.array([-1, 0, 100], dtype=np.int8), size=(30, 40))
        grid = grids.OccupancyGrid(data, 0.05, Pose2D(-3.25, 0.1, -1.25))
        save_map(grid, self.folder / "map.yaml")
        self.serve("round", self.folder / "map.yaml")
        rospy.wait_for_service("/round/static_map", DEADLINE_S)
        served = rospy.ServiceProxy("/round/static_map", GetMap)().map
        self.assertEqual("map", served.header.frame_id)
        latched = rospy.wait_for_message("/round/map", OccupancyGrid, DEADLINE_S)
        self.assertEqual(served.data, latched.data)
        metadata = rospy.wait_for_message("/round/map_metadata", MapMetaData, DEADLINE_S)
        self.assertEqual(served.info, metadata)
        found = grid_from_msg(served)
        np.testing.assert_array_equal(data, found.data)
        np.testing.assert_allclose((-3.25, 0.1, -1.25), (found.origin.x, found.origin.y, found.origin.theta))
        (self.folder / "again").mkdir()
        done = self.save("-f", str(self.folder / "again" / "map"), "map:=/round/map")
        self.assertEqual(0, done.returncode, done.stderr)
        self.assertEqual((self.folder / "map.pgm").read_bytes(), (self.folder / "again" / "map.pgm").read_bytes())
        text = (self.folder / "again" / "map.yaml").read_text(encoding="utf-8")
        self.assertIn("resolution: 0.05\n", text)
        self.assertIn("image: map.pgm\n", text)

    def test_thresholds_of_the_saver(self) -> None:
        save_map(grids.OccupancyGrid(np.array([[0, 30, 60, 100]], dtype=np.int8), 0.1), self.folder / "map.yaml")
        self.serve("scale", self.folder / "map.yaml")
        saved = self.folder / "saved"
        done = self.save("-f", str(saved), "--occ", "60", "--free", "29", "map:=/scale/map")
        self.assertEqual(0, done.returncode, done.stderr)
        self.assertEqual([254, 205, 0, 0], list((self.folder / "saved.pgm").read_bytes()[-4:]))

    def test_what_it_refuses(self) -> None:
        for arguments, words in (
            (["--timeout", "1", "map:=/nobody"], "no map on /nobody within 1 s"),
            (["--occ", "20"], "0 <= free < occ <= 100"),
            (["--occ", "many"], "--occ"),
        ):
            done = self.save(*arguments)
            self.assertNotEqual(0, done.returncode, arguments)
            self.assertIn(words, done.stdout + done.stderr)
            self.assertNotIn("Traceback", done.stderr)


if __name__ == "__main__":
    rospy.init_node("maps_test")
    rostest.rosrun("hitchhike_ros", "maps", MapsTest)
