import math
import time
from pathlib import Path

import numpy as np
import pytest

from hitchhike_ros.core.errors import RobotModelError
from hitchhike_ros.core.robot_model import RobotLimits, fixed_transforms, mount

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
