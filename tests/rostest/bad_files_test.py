#!/usr/bin/python3
"""Missing and malformed map, world, parameter and model files, given to the nodes as a person would give them."""

import subprocess
import tempfile
import unittest
from pathlib import Path

import rospkg
import rostest

PACKAGE = Path(rospkg.RosPack().get_path("hitchhike_ros"))
MAP, WORLD = PACKAGE / "maps/p17_exp1.yaml", PACKAGE / "maps/p17_exp1.world.yaml"
CONFIG, URDF = PACKAGE / "config/turtlebot.yaml", PACKAGE / "urdf/turtlebot.urdf"
DEADLINE_S = 60


class BadFilesTest(unittest.TestCase):
    runs = 0

    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def file(self, name: str, text: str) -> Path:
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        return path

    def refuses(self, node: str, arguments: list[str], *expected: str) -> None:
        """Run ``node``; it has to exit non-zero and to say all of ``expected``."""
        # A name of its own each time: private parameters stay on the master.
        self.__class__.runs += 1
        command = ["rosrun", "hitchhike_ros", node, *arguments, f"__name:={node}_{self.runs}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
        said = done.stdout + done.stderr
        self.assertNotEqual(0, done.returncode, f"{command}: {said}")
        for words in expected:
            self.assertIn(words, said, f"{command}")
        self.assertNotIn("Traceback", said)

    def parameters(self, **changed: object) -> list[str]:
        given = {"robot_id": "turtlebot", "config": CONFIG, "urdf": URDF, "world": WORLD, **changed}
        return [f"_{name}:={value}" for name, value in given.items()]

    def test_map(self) -> None:
        missing = self.folder / "no.yaml"
        self.refuses("map_server", [str(missing)], str(missing), "expected")
        broken = self.file("broken.yaml", "image: [a\n")
        self.refuses("map_server", [str(broken)], str(broken), "valid YAML")
        text = MAP.read_text(encoding="utf-8")
        no_image = self.file("no_image.yaml", text.replace("p17_exp1.pgm", "gone.pgm"))
        self.refuses("map_server", [str(no_image)], str(no_image), "image", "gone.pgm")
        flat = self.file("flat.yaml", text.replace("resolution: 0.04", "resolution: 0.0"))
        self.refuses("map_server", [str(flat)], str(flat), "resolution", "0")

    def test_world(self) -> None:
        missing = self.folder / "no.world.yaml"
        for node in ("slam", "hitchhike_comm"):
            self.refuses(node, self.parameters(world=missing), "world", str(missing), "expected")
        self.refuses("simulator", [f"_world:={missing}"], "world", str(missing), "expected")
        bad = self.file("bad.world.yaml", f"map: {MAP}\nmarkers: [{{id: 1, x: left, y: 0, z: 0, yaw: 0}}]\n")
        for node in ("slam", "hitchhike_comm"):
            self.refuses(node, self.parameters(world=bad), str(bad), "markers[0].x", "left", "expected")
        self.refuses("simulator", [f"_world:={bad}"], str(bad), "robots", "expected")

    def test_parameters(self) -> None:
        text = CONFIG.read_text(encoding="utf-8")
        missing = self.folder / "no.yaml"
        listed = self.file("list.yaml", "- robot\n")
        negative = self.file("negative.yaml", text.replace("wheel_radius_m: 0.035", "wheel_radius_m: -1"))
        unknown = self.file("unknown.yaml", text.replace("wheel_radius_m", "wheel_radios_m"))
        for node in ("path_planning", "obstacle_avoidance", "velocity_mux", "hitchhike_comm"):
            self.refuses(node, self.parameters(config=missing), str(missing), "expected")
        self.refuses("slam", self.parameters(config=listed), str(listed), "mapping")
        self.refuses("visual_servoing", self.parameters(config=negative), str(negative), "wheel_radius_m", "-1")
        self.refuses("velocity_mux", self.parameters(config=unknown), str(unknown), "robot.wheel_radios_m", "one of")
        self.refuses("hitchhike_comm", [*self.parameters(), "_profile:=900"], "profile", "900", "expected")

    def test_model(self) -> None:
        broken = self.file("broken.urdf", "<robot>")
        for node in ("slam", "obstacle_avoidance", "visual_servoing", "hitchhike_comm"):
            self.refuses(node, self.parameters(urdf=broken), str(broken), "URDF")

    def test_name(self) -> None:
        """Started without a namespace, nobody knows what the robot is called."""
        self.refuses("hitchhike_comm", self.parameters(robot_id="''"), "~robot_id", "expected a robot's name", "__ns:=")


if __name__ == "__main__":
    rostest.rosrun("hitchhike_ros", "bad_files", BadFilesTest)
