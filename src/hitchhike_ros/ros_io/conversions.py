"""Converts ROS messages to datatypes and back; :mod:`.images` does so with those of cameras."""

from __future__ import annotations

import math

import numpy as np
import rospy
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    Twist,
    Vector3,
)
from nav_msgs.msg import MapMetaData, Path
from nav_msgs.msg import OccupancyGrid as OccupancyGridMsg
from nav_msgs.msg import Odometry as OdometryMsg
from rospy.numpy_msg import numpy_msg
from sensor_msgs.msg import LaserScan as LaserScanMsg
from std_msgs.msg import Header

from hitchhike_ros.core.datatypes import FloatArray, LaserScan, Odometry, Pose2D, PoseEstimate, Twist2D
from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.core.stamps import split
from hitchhike_ros.mapping.grid import OCCUPIED, UNKNOWN, OccupancyGrid

# Rows and columns of (x, y, yaw) in a ROS 6 x 6 covariance.
_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])


def to_stamp(seconds: float) -> rospy.Time:
    """A time in s, rounded to the nearest nanosecond: with ticks that are 1 ns short, timers miss every fourth one."""
    return rospy.Time(*split(seconds))


def header(stamp: float, frame_id: str) -> Header:
    return Header(stamp=to_stamp(stamp), frame_id=frame_id)


def yaw_from_quaternion(q: Quaternion) -> float:
    """Yaw in rad of a quaternion that need not be exactly normalised; NaN where it is senseless."""
    if not q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w > 1e-12:
        return math.nan
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), q.w * q.w + q.x * q.x - q.y * q.y - q.z * q.z)


def quaternion_from_yaw(yaw: float) -> Quaternion:
    return Quaternion(0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0))


def quaternion_from_rotation(R: FloatArray) -> Quaternion:
    """Quaternion of a rotation matrix (3, 3)."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415  (slow to import, and few nodes need it)

    return Quaternion(*Rotation.from_matrix(R).as_quat())


def transform_from_matrix(T: FloatArray) -> Transform:
    """A homogeneous matrix (4, 4) as a message."""
    return Transform(Vector3(*T[:3, 3].tolist()), quaternion_from_rotation(T[:3, :3]))


def pose_from_msg(msg: Pose) -> Pose2D:
    return Pose2D(msg.position.x, msg.position.y, yaw_from_quaternion(msg.orientation))


def pose_to_msg(pose: Pose2D) -> Pose:
    return Pose(Point(pose.x, pose.y, 0.0), quaternion_from_yaw(pose.theta))


def pose_stamped(pose: Pose2D, stamp: float, frame_id: str) -> PoseStamped:
    return PoseStamped(header(stamp, frame_id), pose_to_msg(pose))


def twist_from_msg(msg: Twist) -> Twist2D:
    return Twist2D(msg.linear.x, msg.angular.z)


def twist_to_msg(twist: Twist2D) -> Twist:
    return Twist(Vector3(twist.v, 0.0, 0.0), Vector3(0.0, 0.0, twist.omega))


def estimate_from_msg(msg: PoseWithCovarianceStamped) -> PoseEstimate:
    covariance = np.array(msg.pose.covariance, dtype=float).reshape(6, 6)[_PLANAR]
    return PoseEstimate(msg.header.stamp.to_sec(), pose_from_msg(msg.pose.pose), covariance)


def estimate_to_msg(estimate: PoseEstimate, frame_id: str = "map") -> PoseWithCovarianceStamped:
    covariance = np.zeros((6, 6))
    covariance[_PLANAR] = estimate.covariance
    msg = PoseWithCovarianceStamped(header=header(estimate.stamp, frame_id))
    msg.pose.pose = pose_to_msg(estimate.pose)
    msg.pose.covariance = covariance.ravel().tolist()
    return msg


def odometry_from_msg(msg: OdometryMsg) -> Odometry:
    """Raises SensorDataError when pose or twist is not finite."""
    pose, twist = pose_from_msg(msg.pose.pose), twist_from_msg(msg.twist.twist)
    odometry = Odometry(msg.header.stamp.to_sec(), pose, twist, msg.header.frame_id.strip("/"))
    if not (odometry.pose.is_finite() and odometry.twist.is_finite()):
        raise SensorDataError(f"odometry at {odometry.stamp:.2f} s is not finite")
    return odometry


def odometry_to_msg(odometry: Odometry, frame_id: str, child_frame_id: str) -> OdometryMsg:
    msg = OdometryMsg(header=header(odometry.stamp, frame_id), child_frame_id=child_frame_id)
    msg.pose.pose = pose_to_msg(odometry.pose)
    msg.twist.twist = twist_to_msg(odometry.twist)
    return msg


# The same message, read into arrays: a tuple of Python's numbers for each scan takes longer than what is done with it.
LaserScanArrayMsg = numpy_msg(LaserScanMsg)


# How much of the field of view the header may say too much or too little, as drivers count a beam more or less, and a
# turn of the mirror is not always as long; how far off a whole turn the field and the first beam may be (rad).
_FIELD_TOLERANCE, _TURN_TOLERANCE_RAD = 0.05, 0.3


def scan_from_msg(msg: LaserScanMsg) -> LaserScan:
    """A scan of whatever is legal; :class:`LaserScan` says what becomes of its beams.

    ``angle_min``, ``angle_increment``, of either sign, and the number of ranges say where the beams point, as for
    laser_geometry. ``angle_max`` has to agree with them to 5 %, unless it is not given (0 or not finite).

    Raises:
        SensorDataError: the scan is empty, or its angles or range limits are senseless: no beam of it is known.
    """
    ranges = np.array(msg.ranges, np.float32)
    if ranges.size == 0:
        raise SensorDataError("scan: ranges is empty, expected beams")
    first, step, last = float(msg.angle_min), float(msg.angle_increment), float(msg.angle_max)
    turn, field = 2.0 * math.pi + _TURN_TOLERANCE_RAD, step * (ranges.size - 1)
    if not abs(first) <= turn:
        raise SensorDataError(f"scan: angle_min is {first:.6g}, expected radians within one turn")
    if not (step != 0.0 and abs(field) <= turn and math.isfinite(step)):
        raise SensorDataError(
            f"scan: angle_increment is {step:.6g} with {ranges.size} ranges, expected radians, not 0, up to one turn"
        )
    if last != 0.0 and math.isfinite(last):
        # Some drivers of lasers that look all round keep angles within (-pi, pi].
        wraps = (0.0, 2.0 * math.pi, -2.0 * math.pi) if abs(field) > 1.5 * math.pi else (0.0,)
        apart = min(abs(first + field - last + wrap) for wrap in wraps)
        if apart > max(2.0 * abs(step), _FIELD_TOLERANCE * abs(field)):
            raise SensorDataError(
                f"scan: angle_max is {last:.6g}, expected {first + field:.6g}: "
                f"angle_min and {ranges.size - 1} increments"
            )
    low, high = float(msg.range_min), float(msg.range_max)
    low = 0.0 if low < 0.0 else low
    if not low < high:
        raise SensorDataError(f"scan: range_min is {low:.6g} and range_max {high:.6g}, expected range_min < range_max")
    return LaserScan(msg.header.stamp.to_sec(), first, step, low, high, ranges)


def scan_to_msg(scan: LaserScan, frame_id: str) -> LaserScanMsg:
    return LaserScanMsg(
        header=header(scan.stamp, frame_id),
        angle_min=scan.angle_min,
        angle_max=scan.angle_min + scan.angle_increment * (scan.ranges.size - 1),
        angle_increment=scan.angle_increment,
        range_min=scan.range_min,
        range_max=scan.range_max,
        ranges=scan.ranges,
    )


def path_from_msg(msg: Path) -> FloatArray:
    """Positions (N, 2) in the path's frame."""
    return np.array([(p.pose.position.x, p.pose.position.y) for p in msg.poses], dtype=float).reshape(-1, 2)


def path_to_msg(points: FloatArray, goal: Pose2D, stamp: float, frame_id: str = "map") -> Path:
    """Positions (N, 2) as a path whose poses look along it; the last one has the goal's heading."""
    headings = [math.atan2(d[1], d[0]) for d in np.diff(points, axis=0)]
    poses = [
        pose_stamped(Pose2D(float(p[0]), float(p[1]), theta), stamp, frame_id)
        for p, theta in zip(points, [*headings, goal.theta], strict=True)
    ]
    return Path(header=header(stamp, frame_id), poses=poses)


def grid_from_msg(msg: OccupancyGridMsg) -> OccupancyGrid:
    """The grid of a message. Values that mean nothing are unknown, and an orientation of zeros alone is none at all.

    Raises:
        SensorDataError: it has no cells or not as many as it says, or its size or place is senseless.
    """
    info, count = msg.info, len(msg.data)
    if info.width * info.height == 0 or info.width * info.height != count:
        raise SensorDataError(f"map has {info.width} x {info.height} cells and {count} values, expected one for each")
    q = info.origin.orientation
    place = Pose(info.origin.position, q if any((q.x, q.y, q.z, q.w)) else Quaternion(0.0, 0.0, 0.0, 1.0))
    origin, values = pose_from_msg(place), np.array(msg.data, dtype=np.int8).reshape(info.height, info.width)
    if not (0.0 < info.resolution < math.inf):
        raise SensorDataError(f"map has a resolution of {info.resolution}, expected a number of metres above 0")
    if not origin.is_finite():
        raise SensorDataError(f"map has its origin at {origin}, expected finite x, y and yaw")
    values[(values > OCCUPIED) | (values < UNKNOWN)] = UNKNOWN
    values.setflags(write=False)
    return OccupancyGrid(values, info.resolution, origin)


def map_info(grid: OccupancyGrid, stamp: float) -> MapMetaData:
    """Size and place of a map that was loaded at ``stamp``."""
    rows, columns = grid.data.shape
    return MapMetaData(to_stamp(stamp), grid.resolution, columns, rows, pose_to_msg(grid.origin))


def grid_to_msg(grid: OccupancyGrid, stamp: float, frame_id: str = "map") -> OccupancyGridMsg:
    return OccupancyGridMsg(header(stamp, frame_id), map_info(grid, stamp), grid.data.ravel().tolist())
