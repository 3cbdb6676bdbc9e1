import math
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


def test_radii_of_a_rectangular_footprint() -> None:
    limits = RobotLimits(0.3, 0.09, front_m=0.2, rear_m=0.3, half_width_m=0.4, max_speed_mps=1.0, max_yaw_rate_rps=1.0)
    assert limits.inscribed_m == 0.2
    assert limits.circumscribed_m == pytest.approx(0.5)


def test_radii_of_a_round_footprint() -> None:
    limits = RobotLimits(0.23, 0.035, 0.18, 0.18, 0.18, max_speed_mps=0.7, max_yaw_rate_rps=math.pi, radius_m=0.176)
    assert limits.inscribed_m == limits.circumscribed_m == 0.176
