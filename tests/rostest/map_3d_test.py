#!/usr/bin/python3
"""The driver's depth camera maps a corridor; the hitchhiker gets the map bit for bit over a bad network; off is off."""

import hashlib
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import msgspec
import numpy as np
import rosgraph
import rospy
import rostest
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Odometry
from scipy.spatial import cKDTree
from sensor_msgs.msg import Image
from std_msgs.msg import String, UInt8MultiArray
from visualization_msgs.msg import MarkerArray

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.mapping.grid import OCCUPIED
from hitchhike_ros.mapping.map_file import load_map
from hitchhike_ros.mapping.octree import Voxels, read_voxels
from hitchhike_ros.protocol.map_transfer import Transfer
from hitchhike_ros.protocol.status import ModuleSwitches, RideStatus, Status, encode_status

DRIVER, RIDER = "p3dx", "turtlebot"
NOTHING_ON = ModuleSwitches(PP=False, OBS=False, LZN=False, MAP=False, VS=False)
RIDE = RideStatus("ride-1", DRIVER, RIDER)
CORRIDOR = (4.6, 6.84)  # y of its walls
SENSORS = {f"/{DRIVER}/{name}" for name in ("camera/depth/image_raw", "camera/depth/camera_info", "amcl_pose")}
EARS = {robot: f"/{robot}/hhike_msg/network_in" for robot in (DRIVER, RIDER)}


def subscribed(robot: str) -> set[str]:
    """What the robot's node subscribes now, but for its status and the clock."""
    _, subscriptions, _ = rosgraph.Master("/map_3d_test").getSystemState()
    topics = {topic for topic, nodes in subscriptions if f"/{robot}/mapping_3d" in nodes}
    return topics - {"/clock", f"/{robot}/hhike_msg/status"}


class Map3DTest(unittest.TestCase):
    """One ride, driven before the tests."""

    watch: Watch
    before: dict[str, set[str]]
    on_the_way: dict[str, set[str]]

    @classmethod
    def setUpClass(cls) -> None:
        watch = cls.watch = Watch(DRIVER, RIDER)
        cls.statuses = {
            robot: rospy.Publisher(f"/{robot}/hhike_msg/status", String, queue_size=1, latch=True)
            for robot in (DRIVER, RIDER)
        }
        cls.said: dict[str, Status] = {}
        cls.repeats = rospy.Timer(rospy.Duration(1.0), cls.repeat, reset=True)
        cls.poses = rospy.Publisher(f"/{DRIVER}/amcl_pose", PoseWithCovarianceStamped, queue_size=5)
        wheels = rospy.Publisher(f"/{DRIVER}/cmd_vel", Twist, queue_size=1)
        images = rospy.Publisher(f"/{DRIVER}/camera/depth/image_raw", Image, queue_size=1)
        noise = rospy.Publisher(EARS[RIDER], String, queue_size=50)
        watch.subscribe(f"/{DRIVER}/ground_truth", Odometry, cls.localize)
        for robot in (DRIVER, RIDER):
            watch.subscribe(f"/{robot}/octomap_binary", UInt8MultiArray)
            watch.subscribe(f"/{robot}/map_3d/transfer", String)
        cls.say(DRIVER, "driver", "aligned", RIDE)
        cls.say(RIDER, "hitchhiker", "coupling", RIDE)
        watch.until(lambda: len(watch.diagnostics) >= 4, 60, "every node says how it is")
        cls.before = {robot: subscribed(robot) for robot in (DRIVER, RIDER)}

        cls.say(DRIVER, "driver", "driving", RIDE)
        cls.say(RIDER, "hitchhiker", "riding", RIDE)
        forward = Twist()
        forward.linear.x = 0.4

        def pull(_event: object) -> None:
            wheels.publish(forward)

        pulling = rospy.Timer(rospy.Duration(0.1), pull, reset=True)
        watch.until(lambda: int(cls.count("images")) >= 10, 90, "ten images are in the map")
        cls.on_the_way = {robot: subscribed(robot) for robot in (DRIVER, RIDER)}
        strange = Image(encoding="rgb8", height=1, width=1, step=3, data=b"abc")

        def bad_image() -> bool:
            strange.header.stamp = rospy.Time.now()
            images.publish(strange)
            return int(cls.count("bad_images")) > 0

        watch.until(bad_image, 60, "an image that is none is counted")
        watch.until(lambda: watch.truth(DRIVER).x > 13.0, 90, "the driver has gone 6 m")
        pulling.shutdown()
        cls.say(RIDER, "hitchhiker", "settling", RIDE)
        cls.say(DRIVER, "driver", "decoupling", RIDE)
        cls.say(RIDER, "hitchhiker", "idle", None)
        cls.say(DRIVER, "none", "navigating", None)
        watch.until(noise.get_num_connections, 30, "the rider listens")
        for text in ('{"map_', '{"version":1,"type":"map_piece","map_id":"x"}', '{"version":1,"type":"map_spell"}'):
            noise.publish(String(text))
        watch.until(lambda: all(cls.transfer(robot).over for robot in (DRIVER, RIDER)), 90, "the transfer is over")
        watch.until(lambda: f"/{RIDER}/octomap_binary" in watch.newest, 30, "the rider publishes its map")

    @classmethod
    def say(cls, robot: str, role: str, state: str, ride: RideStatus | None) -> None:
        convoy = (RIDER,) if robot == DRIVER and ride is not None else ()
        status = Status(rospy.get_time(), robot, role, state, modules=NOTHING_ON, ride=ride, convoy=convoy)
        cls.said[robot] = status
        cls.statuses[robot].publish(String(encode_status(status)))

    @classmethod
    def repeat(cls, _event: object) -> None:
        """Orders have an age, so hitchhike_comm repeats them."""
        for robot, status in dict(cls.said).items():
            cls.statuses[robot].publish(String(encode_status(status)))

    @classmethod
    def localize(cls, truth: Odometry) -> None:
        """As slam would, ten times a second."""
        if round(truth.header.stamp.to_sec() * 20) % 2 == 0:
            pose = PoseWithCovarianceStamped(header=truth.header)
            pose.pose.pose = truth.pose.pose
            cls.poses.publish(pose)

    @classmethod
    def count(cls, name: str) -> str:
        return cls.watch.diagnostic(f"{DRIVER}: mapping_3d")[2].get(name, "0")

    @classmethod
    def transfer(cls, robot: str) -> Transfer:
        said = cls.watch.newest.get(f"/{robot}/map_3d/transfer")
        return (
            Transfer("driver", "waiting", "", "", "") if said is None else msgspec.json.decode(said.data, type=Transfer)
        )

    def file(self, robot: str) -> bytes:
        return bytes(self.watch.newest[f"/{robot}/octomap_binary"].data)

    def voxels(self) -> Voxels:
        return read_voxels(self.file(RIDER))

    def test_the_map_arrived_bit_for_bit(self) -> None:
        self.assertEqual(self.file(DRIVER), self.file(RIDER))
        self.assertGreater(len(self.file(RIDER)), 5_000)

    def test_both_sides_say_so_and_count_the_same(self) -> None:
        sent, got = self.transfer(DRIVER), self.transfer(RIDER)
        print(sent, got)
        self.assertEqual(("arrived", "arrived"), (sent.state, got.state))
        self.assertEqual(("driver", "hitchhiker"), (sent.side, got.side))
        self.assertEqual(hashlib.sha256(self.file(RIDER)).hexdigest(), got.map_id)
        for name in ("map_id", "map_bytes", "packed_bytes", "pieces", "ride_id"):
            self.assertEqual(getattr(sent, name), getattr(got, name), name)
        self.assertEqual(len(self.file(RIDER)), got.map_bytes)
        self.assertLess(got.packed_bytes, got.map_bytes)
        self.assertGreaterEqual(got.pieces, 5)
        self.assertGreater(sent.messages, sent.pieces, "some were lost")
        self.assertEqual(0, got.bad)
        self.assertLess(got.seconds, 60.0)

    def test_the_walls_are_where_they_stand(self) -> None:
        centres = self.voxels().centres
        walls = centres[(centres[:, 2] > 0.2) & (centres[:, 0] > 8.0) & (centres[:, 0] < 14.0)]
        # Of the true map: the corridor has pillars besides its walls.
        grid = load_map(rospy.get_param("~map"))
        rows, columns = np.nonzero(grid.data == OCCUPIED)
        true = np.column_stack((columns + 0.5, rows + 0.5)) * grid.resolution + (grid.origin.x, grid.origin.y)
        off, _ = cKDTree(true).query(walls[:, :2])
        self.assertGreater(len(walls), 500)
        self.assertLess(np.quantile(off, 0.98), 0.1)
        # It sees 29 degrees to each side, so the walls from 2.1 m ahead on; a pillar shades 0.4 m behind it.
        for y in CORRIDOR:
            parts = {int(x * 5) for x in walls[np.abs(walls[:, 1] - y) < 0.3, 0] if x > 9.6}
            self.assertGreaterEqual(len(parts), 19, f"of the 22 pieces of 0.2 m of the wall at {y}")

    def test_the_floor_is_there_and_the_way_is_free(self) -> None:
        centres = self.voxels().centres
        on_the_way = (np.abs(centres[:, 1] - 5.72) < 0.3) & (centres[:, 0] > 9.0) & (centres[:, 0] < 13.0)
        self.assertGreater(np.sum(on_the_way & (np.abs(centres[:, 2]) < 0.1)), 100)
        self.assertEqual(0, np.sum(on_the_way & (centres[:, 2] > 0.15)))

    def test_off_is_off(self) -> None:
        self.assertEqual({DRIVER: set(), RIDER: set()}, self.before)
        self.assertEqual({DRIVER: SENSORS, RIDER: set()}, self.on_the_way)
        self.watch.until(lambda: subscribed(DRIVER) == set(), 30, "the driver's node is off again")

    def test_noise_is_dropped_and_counted(self) -> None:
        _, _, values = self.watch.diagnostic(f"{RIDER}: mapping_3d")
        self.assertEqual("3", values.get("dropped"), values)

    def test_a_late_viewer_sees_the_voxels(self) -> None:
        topic = f"/{RIDER}/occupied_cells_vis_array"
        self.watch.subscribe(topic, MarkerArray)
        self.watch.until(lambda: topic in self.watch.newest, 30, "markers")
        markers = self.watch.newest[topic].markers
        self.assertEqual(len(self.voxels().sides), sum(len(marker.points) for marker in markers))
        self.assertTrue(all(len(marker.points) == len(marker.colors) for marker in markers))
        self.assertEqual({"map"}, {marker.header.frame_id for marker in markers})

    def test_octomap_saver_writes_what_octomap_tools_read(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "ride.bt"
            command = [
                "rosrun",
                "hitchhike_ros",
                "octomap_saver",
                str(file),
                f"octomap_binary:=/{RIDER}/octomap_binary",
            ]
            subprocess.run(command, check=True, timeout=90)
            self.assertEqual(self.file(RIDER), file.read_bytes())
            subprocess.run(["bt2vrml", "ride.bt"], cwd=folder, check=True, capture_output=True, timeout=60)
            boxes = (file.parent / "ride.bt.wrl").read_text(encoding="ascii").count("geometry Box")
            self.assertEqual(len(self.voxels().sides), boxes)
            lost = Path(folder) / "missing" / "ride.bt"
            failed = subprocess.run([*command[:3], str(lost), command[4]], capture_output=True, timeout=90, check=False)
            self.assertEqual(1, failed.returncode)
            self.assertIn(b"a file that can be written", failed.stderr)


if __name__ == "__main__":
    rospy.init_node("map_3d_test")
    rostest.rosrun("hitchhike_ros", "map_3d", Map3DTest)
