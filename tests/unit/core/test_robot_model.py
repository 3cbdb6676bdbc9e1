import math
import time
from pathlib import Path

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import LaserScan, Pose2D
from hitchhike_ros.core.errors import RobotModelError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy, transform_points
from hitchhike_ros.core.robot_model import LaserMount, RobotLimits, fixed_transforms, mount

URDF = """<robot name="r">
  <link name="base_footprint"/><link name="base_link"/><link name="mast"/><link name="camera"/><link name="wheel"/>
  <joint name="a" type="fixed"><parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.1"/></joint>
  <joint name="c" type="fixed">
    <parent link="mast"/><child link="camera"/><origin xyz="0.2 0 0" rpy="0 0 0"/>
  </joint>
  <joint name="b" type="fixed">
    <parent link="base_link"/><child link="mast"/><origin xyz="1 0 0.5" rpy="0 0 1.5707963267948966"/>
  </joint>
  <joint name="w" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
</robot>"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(URDF, encoding="utf-8")
    return path


def test_mounts_follow_the_chain_of_fixed_joints(urdf: Path) -> None:
    np.testing.assert_allclose(mount(urdf, "base_footprint"), np.eye(4))
    T = mount(urdf, "camera")
    np.testing.assert_allclose(T[:3, 3], [1.0, 0.2, 0.6])
    np.testing.assert_allclose(T[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_a_moving_link_has_no_mount(urdf: Path) -> None:
    assert "wheel" not in fixed_transforms(urdf)
    with pytest.raises(RobotModelError) as caught:
        mount(urdf, "wheel")
    assert (caught.value.file, caught.value.value) == (str(urdf), "wheel")
    assert "camera" in caught.value.expected


@pytest.mark.parametrize("text", ["not xml", '<robot name="r"><link name="base_link"/></robot>'])
def test_a_file_that_is_no_robot(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RobotModelError, match=r"robot\.urdf"):
        fixed_transforms(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotModelError, match=r"absent\.urdf.*expected a readable URDF"):
        fixed_transforms(tmp_path / "absent.urdf")


def model(folder: Path, joints: str, links: str = "") -> Path:
    path = folder / "robot.urdf"
    path.write_text(
        f'<robot name="r"><link name="base_footprint"/><link name="a"/><link name="b"/>{links}{joints}</robot>'
    )
    return path


def joint(name: str, parent: str, child: str, origin: str = "", kind: str = "fixed") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{origin}</joint>'


@pytest.mark.parametrize("key", ["xyz", "rpy"])
@pytest.mark.parametrize(
    "value", ["0.12 0", "", "1 2 3 4", "0,1,2", "0 0 nan", "inf 0 0", "1e9 0 0", "0 0 x", "1_0 0 0", "0 0 0x1"]
)
def test_an_origin_is_three_numbers(tmp_path: Path, key: str, value: str) -> None:
    for kind in ("fixed", "continuous"):
        path = model(tmp_path, joint("j", "base_footprint", "a", f'<origin {key}="{value}"/>', kind))
        with pytest.raises(RobotModelError) as caught:
            fixed_transforms(path)
        assert (caught.value.field, caught.value.value) == (f"joint j: origin {key}", value)
        assert "three numbers" in caught.value.expected


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        ([("1", "base_footprint", "a"), ("2", "a", "b"), ("3", "b", "base_footprint")], "a ring"),
        ([("1", "a", "b"), ("2", "b", "a")], "a ring"),
        ([("1", "a", "a")], "a ring"),
        ([("1", "base_footprint", "base_footprint")], "a ring"),
        ([("1", "base_footprint", "a"), ("2", "b", "a")], "no other joint leads to"),
        ([("1", "base_footprint", "c")], "one of the links"),
        ([("1", "c", "a")], "one of the links"),
    ],
)
@pytest.mark.parametrize("kind", ["fixed", "revolute"])
def test_joints_are_a_tree(tmp_path: Path, joints: list[tuple[str, str, str]], said: str, kind: str) -> None:
    path = model(tmp_path, "".join(joint(*ends, kind=kind) for ends in joints))
    with pytest.raises(RobotModelError, match=said):
        fixed_transforms(path)


def test_a_joint_without_ends_and_a_link_that_comes_twice(tmp_path: Path) -> None:
    with pytest.raises(RobotModelError, match="joint j: parent is None"):
        fixed_transforms(model(tmp_path, '<joint name="j" type="fixed"><child link="a"/></joint>'))
    with pytest.raises(RobotModelError, match="link is 'a', expected a name that no other"):
        fixed_transforms(model(tmp_path, "", '<link name="a"/>'))


def test_what_only_looks_like_joints_is_none(tmp_path: Path) -> None:
    more = '<transmission><joint name="j"/></transmission><gazebo><joint type="fixed"/></gazebo><!-- <xacro:x> -->'
    path = model(tmp_path, joint("j", "base_footprint", "a", '<origin xyz="1e-1 +.5 -2."/>') + more)
    np.testing.assert_allclose(mount(path, "a")[:3, 3], [0.1, 0.5, -2.0])


@pytest.mark.parametrize(
    "text",
    [
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="base_footprint"/><xacro:a/></robot>',
        '<robot><link name="base_footprint"/><xacro:wheel side="left"/></robot>',
        '<robot><link name="base_footprint"/><link name="${prefix}laser"/></robot>',
        '<robot><link name="base_footprint"/><link name="l"/>'
        '<joint name="j"><parent link="base_footprint"/><child link="l"/><origin xyz="${x} 0 0"/></joint></robot>',
    ],
)
def test_text_for_xacro_is_called_so(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(RobotModelError, match="xacro"):
        fixed_transforms(path)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x00\x01",
        b"<sdf/>",
        b"<robot",
        b'<?xml version="1.0" encoding="nonsense"?><robot/>',
        b'<?xml version="1.0" encoding="utf-7"?><robot/>',
        b"<robot>" + b"<a>" * 20_000,
        b'<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">'
        + b"".join(b'<!ENTITY a%d "%s">' % (i, (b"&a;" if i == 0 else b"&a%d;" % (i - 1)) * 10) for i in range(12))
        + b"]><robot>&a11;</robot>",
    ],
)
def test_a_file_that_is_no_urdf_is_refused_at_once(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "robot.urdf"
    path.write_bytes(content)
    started = time.process_time()
    with pytest.raises(RobotModelError, match=r"robot\.urdf"):
        fixed_transforms(path)
    assert time.process_time() - started < 1.0


def test_a_long_chain_takes_no_longer_than_its_text(tmp_path: Path) -> None:
    links = "".join(f'<link name="l{i}"/>' for i in range(5000))
    joints = "".join(joint(f"j{i}", f"l{i}", f"l{i + 1}") for i in range(4999))
    started = time.process_time()
    assert set(fixed_transforms(model(tmp_path, joints, links))) == {"base_footprint"}
    assert len(fixed_transforms(model(tmp_path, joints + joint("j", "base_footprint", "l0"), links))) == 5001
    assert time.process_time() - started < 2.0


def test_radii_of_a_rectangular_footprint() -> None:
    limits = RobotLimits(0.3, 0.09, front_m=0.2, rear_m=0.3, half_width_m=0.4, max_speed_mps=1.0, max_yaw_rate_rps=1.0)
    assert limits.inscribed_m == 0.2
    assert limits.circumscribed_m == pytest.approx(0.5)


def test_radii_of_a_round_footprint() -> None:
    limits = RobotLimits(0.23, 0.035, 0.18, 0.18, 0.18, max_speed_mps=0.7, max_yaw_rate_rps=math.pi, radius_m=0.176)
    assert limits.inscribed_m == limits.circumscribed_m == 0.176


# Mounts.

PI = math.pi


def described(folder: Path, link: str, rpy: str, xyz: str = "0.1 -0.05 0.2") -> Path:
    """A robot with one more link."""
    path = folder / "described.urdf"
    path.write_text(
        f'''<robot name="r"><link name="base_footprint"/><link name="{link}"/>
        <joint name="j" type="fixed"><parent link="base_footprint"/><child link="{link}"/>
        <origin xyz="{xyz}" rpy="{rpy}"/></joint></robot>''',
        encoding="utf-8",
    )
    return path


@pytest.mark.parametrize("roll", [0.0, PI, -PI, 0.03, PI - 0.03])
@pytest.mark.parametrize("pitch", [0.0, 0.03, PI])
@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5, PI])
def test_a_scan_is_projected_into_the_plane_of_the_base(tmp_path: Path, roll: float, pitch: float, yaw: float) -> None:
    """A laser that hangs upside down was once taken for an upright one, and left for right."""
    T = mount(described(tmp_path, "laser", f"{roll} {pitch} {yaw}"), "laser")
    laser = LaserMount.of(T)
    scan = LaserScan(0.0, -0.75 * PI, 0.05, 0.02, 8.0, np.linspace(0.5, 7.0, 95))
    angles, ranges = scan.angles(), scan.ranges.astype(float)
    beams = np.stack([ranges * np.cos(angles), ranges * np.sin(angles), 0.0 * angles, np.ones(95)])
    truth = (T @ beams)[:2].T
    upright = scan.mirrored() if laser.upside_down else scan
    angles, ranges = upright.angles(), upright.ranges.astype(float)
    found = transform_points(laser.pose, np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1))
    found = found[::-1] if laser.upside_down else found
    assert laser.upside_down == (T[2, 2] < 0.0)
    assert np.hypot(*(found - truth).T).max() < 0.002 * 7.0
    if max(min(abs(a), abs(PI - abs(a))) for a in (roll, pitch)) < 1e-9:
        assert np.hypot(*(found - truth).T).max() < 1e-5


def test_a_scan_that_is_mirrored_twice_is_the_same() -> None:
    scan = LaserScan(1.0, -0.5, 0.25, 0.02, 8.0, np.array([1.0, np.nan, np.inf, -np.inf, 0.3]))
    once = scan.mirrored()
    np.testing.assert_allclose(once.angles(), [-0.5, -0.25, 0.0, 0.25, 0.5])
    np.testing.assert_array_equal(once.ranges, scan.ranges[::-1])
    twice = once.mirrored()
    np.testing.assert_array_equal(twice.ranges, scan.ranges)
    assert twice.angle_min == pytest.approx(-0.5)


@pytest.mark.parametrize(
    ("link", "rpy", "value"),
    [
        ("laser", "0 0.06 0", "3.4°"),
        ("laser", "0.3 0 0", "17.2°"),
        ("laser", "3.0 0 1", "8.1°"),
        ("laser", "0 1.5707963 0", "90.0°"),
        ("laser", "1.5707963 0 0.4", "90.0°"),
        ("marker", "0 1.5707963 0", "-90.0°"),
        ("marker", "2 -1.0 0", "57.3°"),
        ("camera", "0 0.9 0", "-51.6°"),
        ("camera_optical", "0 0 0", "90.0°"),  # the optical frame forgotten: it would look at the ceiling
        ("camera_optical", "3.14159 0 0", "-90.0°"),
    ],
)
def test_a_mount_of_which_nothing_can_be_made_is_refused(tmp_path: Path, link: str, rpy: str, value: str) -> None:
    path = described(tmp_path, link, rpy)
    with pytest.raises(RobotModelError) as caught:
        mount(path, link)
    error = caught.value
    assert (error.file, error.value) == (str(path), value)
    assert link in error.field
    assert "expected" in str(error)


@pytest.mark.parametrize("link", ["laser", "camera_optical", "marker", "depth_camera_optical"])
def test_a_mount_that_is_far_from_the_robot_is_refused(tmp_path: Path, link: str) -> None:
    """Millimetres for metres."""
    rpy, xyz = "0 0 0", "120 0 200"
    with pytest.raises(RobotModelError, match=rf"mount of link {link} is"):
        mount(described(tmp_path, link, rpy, xyz), link)


@pytest.mark.parametrize(
    ("link", "rpy"),
    [
        ("marker", "0 0 3.14159265"),
        ("marker", "3.14159265 0 3.14159265"),
        ("marker", "1.5707963 0.3 3.0"),
        ("camera", "3.14159265 0 0"),
        ("camera", "0.2 0.6 0.1"),
        ("camera_optical", "-1.57079633 0 -1.57079633"),
        ("camera_optical", "1.57079633 0 -1.57079633"),
        ("camera_optical", "-2.1 0 -1.57079633"),
        ("depth_camera_optical", "3.14159 0 0"),
        ("mast", "0 1.57 0"),
    ],
)
def test_what_looks_about_level_may_be_turned_and_lean(tmp_path: Path, link: str, rpy: str) -> None:
    T = mount(described(tmp_path, link, rpy), link)
    roll, pitch, yaw = map(float, rpy.split())
    np.testing.assert_allclose(T, matrix_from_xyz_rpy((0.1, -0.05, 0.2), (roll, pitch, yaw)))


def test_a_laser_at_yaw_stays_where_it_is() -> None:
    laser = LaserMount.of(matrix_from_xyz_rpy((0.2, 0.1, 0.3), (0.0, 0.0, 0.5)))
    assert laser == LaserMount(Pose2D(0.2, 0.1, pytest.approx(0.5)), upside_down=False)
