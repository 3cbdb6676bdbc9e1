"""One robot in a pybullet world: body, drive, encoders, laser and cameras."""

from __future__ import annotations

import math
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pybullet as p

from hitchhike_ros.core.datatypes import CameraInfo, Contact, FloatArray, LaserScan, Marker, Odometry, Pose2D, Twist2D
from hitchhike_ros.core.errors import RobotModelError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy, pose_from_matrix
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.core.robot_model import RobotLimits, fixed_transforms
from hitchhike_ros.simulation.physics.camera import Camera, CameraParameters, DepthCamera, DepthCameraParameters
from hitchhike_ros.simulation.physics.drive import BaseController, DriveParameters, OdometryParameters, WheelOdometry
from hitchhike_ros.simulation.physics.laser import Laser, LaserParameters
from hitchhike_ros.simulation.physics.tags import write_tag
from hitchhike_ros.simulation.world_file import RobotEntry

# Bits of pybullet's collision filter: wheels and casters touch the floor alone, everything else also its like. Rays
# are in group 1.
SOLID_GROUP, FLOOR_GROUP, ROLLING_GROUP = 1, 2, 4

_WHEELS = ("wheel_left", "wheel_right")
_TAG_LINK = """<robot>
<joint name="tag_joint" type="fixed"><parent link="marker"/><child link="tag"/></joint>
<link name="tag">
<inertial><mass value="0.001"/><inertia ixx="1e-6" ixy="0" ixz="0" iyy="1e-6" iyz="0" izz="1e-6"/></inertial>
<visual><geometry><mesh filename="{black}"/></geometry>
<material name="tag_black"><color rgba="0 0 0 1"/></material></visual>
<visual><geometry><mesh filename="{white}"/></geometry>
<material name="tag_white"><color rgba="1 1 1 1"/></material></visual>
</link></robot>"""


@dataclass(frozen=True)
class Engine:
    """What a robot uses of its world: pybullet's client, the simulated clock and how to sense."""

    client: int
    now: Callable[[], float]
    seed: int
    renderer: int
    ray_threads: int


class SimulatedRobot:
    """A robot of a :class:`hitchhike_ros.simulation.physics.world.World`, which makes and steps it."""

    def __init__(self, name: str, entry: RobotEntry, package: Path, engine: Engine) -> None:
        """Load the model and place it at its start.

        Raises:
            RobotModelError: the URDF lacks links or joints that the simulator needs.
            ParameterError: the parameter file cannot be used.
        """
        urdf, config = robot_files(entry.model, package)
        self.name, self.entry, self.limits = name, entry, load_parameters(RobotLimits, "robot", config)
        self._engine, self._client = engine, engine.client
        self._drive_params = load_parameters(DriveParameters, "simulated_drive", config)
        self._odometry_params = load_parameters(OdometryParameters, "simulated_odometry", config)
        self._laser_params = load_parameters(LaserParameters, "simulated_laser", config)
        self._camera_params = load_parameters(CameraParameters, "simulated_camera", config)
        self._depth_params = load_parameters(DepthCameraParameters, "simulated_depth_camera", config)

        mounts = fixed_transforms(urdf)
        for link in ("base_link", "laser", "camera_optical", "marker"):
            if link not in mounts:
                raise RobotModelError(urdf, "link", link, "a link on fixed joints below base_footprint")
        T_base_footprint = np.linalg.inv(mounts["base_link"])
        self._T_footprint_base = mounts["base_link"]
        self._mounts = {link: T_base_footprint @ T for link, T in mounts.items()}  # from base_link
        self.has_depth_camera = "depth_camera_optical" in mounts

        marker = None if entry.marker is None else Marker(entry.marker, 0.0, 0.0, 0.0, 0.0)
        self.body = _load_body(self._client, urdf, marker)
        _, _, _, position, quaternion, *_ = p.getDynamicsInfo(self.body, -1, physicsClientId=self._client)
        self._T_base_com = _matrix(position, quaternion)
        self._T_com_base = np.linalg.inv(self._T_base_com)
        self._wheels = self._prepare_links(urdf)
        self.reset()

    def reset(self) -> None:
        """Back to the start, at rest, with the noise streams of a fresh robot."""
        start = self.entry.start
        T_world_footprint = matrix_from_xyz_rpy((start.x, start.y, 0.0), (0.0, 0.0, start.theta))
        T_world_com = T_world_footprint @ self._T_footprint_base @ self._T_base_com
        quaternion = p.getQuaternionFromEuler([0.0, 0.0, start.theta])
        p.resetBasePositionAndOrientation(
            self.body, T_world_com[:3, 3].tolist(), quaternion, physicsClientId=self._client
        )
        p.resetBaseVelocity(self.body, [0.0] * 3, [0.0] * 3, physicsClientId=self._client)
        for wheel in self._wheels:
            p.resetJointState(self.body, wheel, 0.0, 0.0, physicsClientId=self._client)
        self._motor_speeds = (math.nan, math.nan)
        self._controller = BaseController(self.limits, self._drive_params)
        self._encoders = WheelOdometry(self.limits, self._odometry_params, self._rng("odometry"), self._engine.now())
        self._laser = Laser(self._laser_params, self._rng("laser"))
        self._camera = Camera(self._camera_params, self._engine.renderer)
        self._depth_camera = DepthCamera(self._depth_params, self._engine.renderer, self._rng("depth"))
        self.contact_log: list[Contact] = []

    # What a robot's own computer can do and see.

    def command(self, twist: Twist2D, now: float) -> None:
        """Drive ``twist`` until the next command or the watchdog; ``now`` is when the command came."""
        self._controller.command(twist, now)

    def odometry(self) -> Odometry:
        """Pose since the start in ``odom`` and twist, as of the latest reading of the encoders."""
        return self._encoders.odometry

    def wheel_angles(self) -> tuple[float, float]:
        """Angles in rad that the left and the right wheel have turned."""
        left, right = p.getJointStates(self.body, self._wheels, physicsClientId=self._client)
        return left[0], right[0]

    def wheel_mounts(self) -> dict[str, FloatArray]:
        """T_base_link_wheel (4, 4) of both wheels, by the names of their links."""
        T_link_world = np.linalg.inv(self.T_world("base_link"))
        states = p.getLinkStates(self.body, self._wheels, computeForwardKinematics=True, physicsClientId=self._client)
        return {name: T_link_world @ _matrix(s[4], s[5]) for name, s in zip(_WHEELS, states, strict=True)}

    def scan(self) -> LaserScan:
        """The laser's view now, in frame ``laser``."""
        engine = self._engine
        return self._laser.scan(engine.client, self.T_world("laser"), engine.now(), engine.ray_threads)

    def camera(self) -> npt.NDArray[np.uint8]:
        """Colour image (H, W, 3) in frame ``camera_optical``."""
        return self._camera.rgb(self._client, self.T_world("camera_optical"))

    @property
    def camera_info(self) -> CameraInfo:
        """Calibration of the colour camera."""
        return self._camera.info

    def depth(self) -> npt.NDArray[np.float32]:
        """Depth image (H, W) in m in frame ``depth_camera_optical``; NaN where there is no reading (REP 118).

        Raises:
            RobotModelError: the robot has no depth camera.
        """
        if not self.has_depth_camera:
            raise RobotModelError(self.name, "link", "depth_camera_optical", "a robot with a depth camera")
        return self._depth_camera.measured_depth(self._client, self.T_world("depth_camera_optical"))

    @property
    def depth_info(self) -> CameraInfo:
        """Calibration of the depth camera."""
        return self._depth_camera.info

    # The truth, for scoring.

    def ground_truth(self) -> tuple[Pose2D, Twist2D]:
        """Pose of ``base_footprint`` in ``map`` and its twist."""
        T_world_base = self._T_world_base()
        linear, angular = p.getBaseVelocity(self.body, physicsClientId=self._client)
        # pybullet gives the velocity of the centre of mass.
        to_com = T_world_base[:3, :3] @ self._T_base_com[:3, 3]
        velocity = np.array(linear) - np.cross(angular, to_com)
        return pose_from_matrix(T_world_base), Twist2D(float(velocity @ T_world_base[:3, 0]), angular[2])

    def true_distances(self) -> FloatArray:
        """Distances (N,) in m that a perfect laser of this make would measure; inf where there is nothing."""
        return self._laser.distances(self._client, self.T_world("laser"), self._engine.ray_threads)

    def contacts(self) -> tuple[Contact, ...]:
        """Everything touched since the start, floor excepted; a touch that lasts is one contact."""
        return tuple(self.contact_log)

    def T_world(self, link: str) -> FloatArray:
        """T_world_link (4, 4) of a link on fixed joints, as the body stands, with its slight tilt."""
        return self._T_world_base() @ self._mounts[link]

    # What the world does with it.

    def drive(self, dt: float) -> None:
        """Set the wheels' motors for the next physics step of ``dt`` seconds."""
        self._controller.step(self._engine.now(), dt)
        speeds = self._controller.wheel_speeds()
        if speeds != self._motor_speeds:
            self._motor_speeds = speeds
            p.setJointMotorControlArray(
                self.body,
                self._wheels,
                p.VELOCITY_CONTROL,
                targetVelocities=speeds,
                forces=[self._drive_params.max_wheel_torque_nm] * 2,
                physicsClientId=self._client,
            )

    def read_encoders(self) -> None:
        """Integrate the odometry up to now."""
        self._encoders.update(self._engine.now(), np.array(self.wheel_angles()))

    def _T_world_base(self) -> FloatArray:
        position, quaternion = p.getBasePositionAndOrientation(self.body, physicsClientId=self._client)
        return _matrix(position, quaternion) @ self._T_com_base

    def _rng(self, stream: str) -> np.random.Generator:
        """A stream of its own for each robot and sensor: one sensor's use does not change another's noise."""
        return np.random.default_rng([self._engine.seed, zlib.crc32(f"{self.name}/{stream}".encode())])

    def _prepare_links(self, urdf: Path) -> list[int]:
        """Set friction, damping and collision groups of all links; the joint indices of both wheels."""
        client, body = self._client, self.body
        links = {"base_link": -1}
        joints = {}
        for i in range(p.getNumJoints(body, physicsClientId=client)):
            info = p.getJointInfo(body, i, physicsClientId=client)
            links[info[12].decode()] = i
            joints[info[1].decode()] = i
        # Matte: a highlight on a marker would hide it.
        for shape in p.getVisualShapeData(body, physicsClientId=client):
            p.changeVisualShape(body, shape[1], specularColor=[0.0] * 3, physicsClientId=client)
        for name, link in links.items():
            rolling = name.startswith(("wheel", "caster"))
            friction = 1.0 if name in _WHEELS else 0.0 if rolling else 0.3
            p.changeDynamics(
                body, link, lateralFriction=friction, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
                physicsClientId=client,
            )  # fmt: skip
            group = ROLLING_GROUP if rolling else SOLID_GROUP
            mask = FLOOR_GROUP if rolling else FLOOR_GROUP | SOLID_GROUP
            p.setCollisionFilterGroupMask(body, link, group, mask, physicsClientId=client)
        for wheel in _WHEELS:
            if f"{wheel}_joint" not in joints:
                raise RobotModelError(urdf, "joint", f"{wheel}_joint", "the joint of a wheel below base_link")
        return [joints[f"{wheel}_joint"] for wheel in _WHEELS]


def robot_files(model: str, package: Path) -> tuple[Path, Path]:
    """URDF and parameter file of a model."""
    return package / "urdf" / f"{model}.urdf", package / "config" / f"{model}.yaml"


def _load_body(client: int, urdf: Path, marker: Marker | None) -> int:
    """Load a URDF, with the rear marker on its back; the body's id.

    Bare frames are left out: pybullet would take them for bodies of 1 kg.
    """
    root = ElementTree.parse(urdf).getroot()
    frames = {link.get("name") for link in root.findall("link") if link.find("inertial") is None}
    for link in root.findall("link"):
        if link.get("name") in frames:
            root.remove(link)
    for joint in root.findall("joint"):
        ends = {end.get("link") for tag in ("parent", "child") if (end := joint.find(tag)) is not None}
        if ends & frames:
            root.remove(joint)
    with tempfile.TemporaryDirectory() as folder:
        if marker is not None:
            black, white = write_tag(marker, Path(folder))
            root.extend(ElementTree.fromstring(_TAG_LINK.format(black=black, white=white)))
        file = Path(folder) / urdf.name
        file.write_bytes(ElementTree.tostring(root))
        flags = p.URDF_USE_INERTIA_FROM_FILE | p.URDF_USE_IMPLICIT_CYLINDER
        try:
            return int(p.loadURDF(str(file), flags=flags, physicsClientId=client))
        except p.error as exc:
            raise RobotModelError(urdf, "", str(exc), "a URDF that pybullet can load") from exc


def _matrix(position: tuple[float, float, float], quaternion: tuple[float, float, float, float]) -> FloatArray:
    """T (4, 4) of a position and a quaternion (x, y, z, w)."""
    T = np.eye(4)
    T[:3, :3] = np.reshape(p.getMatrixFromQuaternion(quaternion), (3, 3))
    T[:3, 3] = position
    return T
