"""Simulated cameras: markers where the calibration says, upright and with the right id; depth; both renderers."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.errors import RobotModelError, VisionError
from hitchhike_ros.servoing.tag_cells import tag_cells
from hitchhike_ros.simulation.physics.camera import CameraParameters, egl_works
from hitchhike_ros.simulation.physics.robot import SimulatedRobot
from hitchhike_ros.simulation.physics.world import World, WorldParameters
from simulated_room import TINY, make_world, robot

DETECTOR = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
# Corners of the black square as a viewer sees them, from the top left clockwise; z up, y to the viewer's right.
CORNERS = 0.08 * np.array([[0, -1, 1], [0, 1, 1], [0, 1, -1], [0, -1, -1]])


def detect(body: SimulatedRobot) -> dict[int, FloatArray]:
    """Corners (4, 2) in pixels by marker id."""
    corners, ids, _ = DETECTOR.detectMarkers(cv2.cvtColor(body.camera(), cv2.COLOR_RGB2GRAY))
    return {} if ids is None else {int(i): c.reshape(4, 2) for i, c in zip(ids.ravel(), corners, strict=True)}


def project(body: SimulatedRobot, points: FloatArray) -> FloatArray:
    """Points (N, 3) in the world as pixels (N, 2)."""
    T = np.linalg.inv(body.T_world("camera_optical"))
    uvw = (points @ T[:3, :3].T + T[:3, 3]) @ body.camera_info.K.T
    return uvw[:, :2] / uvw[:, 2:]


def pair(folder: Path, renderer: str) -> World:
    """Each robot looks at the other's back, 1 m away; p3dx looks at marker 10 on the wall besides."""
    robots = {
        "hitchhiker": robot("turtlebot", 1.0, 2.0, marker=1),
        "driver": robot("p3dx", 2.421, 2.05, math.radians(8.0), marker=0),
        "other": robot("p3dx", 0.3, 2.1, marker=7),
    }
    markers = [{"id": 10, "x": 6.0, "y": 2.6, "z": 0.34, "yaw": math.pi}]
    return make_world(folder, robots, params=WorldParameters(renderer=renderer), markers=markers)  # type: ignore[arg-type]


@pytest.mark.parametrize("renderer", ["tiny", "egl"])
def test_markers_are_seen_where_they_are(renderer: str, tmp_path: Path) -> None:
    if renderer == "egl" and not egl_works():
        pytest.skip("the EGL renderer does not load here")
    with pair(tmp_path, renderer) as world:
        world.run(0.2)
        bodies = world.robots
        assert bodies["driver"].T_world("marker")[2, 3] == pytest.approx(0.34, abs=1e-3)
        for viewer, seen, marker_id in (("hitchhiker", "driver", 0), ("other", "hitchhiker", 1)):
            T = bodies[seen].T_world("marker")
            expected = project(bodies[viewer], CORNERS @ T[:3, :3].T + T[:3, 3])
            found = detect(bodies[viewer])
            assert found[marker_id] == pytest.approx(expected, abs=1.2)
        assert bodies["hitchhiker"].T_world("marker")[0, 0] == pytest.approx(-1.0)  # its normal points backwards
        far = detect(bodies["driver"])
        assert set(far) == {10}
        wall = np.array([6.0, 2.6, 0.34]) + CORNERS * [1, -1, 1] - [0.005, 0, 0]
        assert far[10] == pytest.approx(project(bodies["driver"], wall), abs=1.2)


def test_both_renderers_see_the_same(tmp_path: Path) -> None:
    if not egl_works():
        pytest.skip("the EGL renderer does not load here")
    edges = []
    for renderer in ("tiny", "egl"):
        with pair(tmp_path, renderer) as world:
            body, T = world.robots["hitchhiker"], world.robots["driver"].T_world("marker")
            (left, top), _, (right, bottom), _ = project(body, CORNERS @ T[:3, :3].T + T[:3, 3]).astype(int)
            edges.append(body.camera()[top - 9 : bottom + 9, left - 9 : right + 9, 0] < 100)
    assert np.mean(edges[0] != edges[1]) < 0.01


def test_calibration_is_that_of_the_picture() -> None:
    info = CameraParameters().info
    f = 320 / math.tan(math.radians(30))
    assert (info.width, info.height) == (640, 480)
    assert np.allclose(info.K, [[f, 0, 319.5], [0, f, 239.5], [0, 0, 1]])
    assert not info.D.any()


def test_depth_is_the_distance_of_the_wall(tmp_path: Path) -> None:
    with make_world(tmp_path, {"r": robot("p3dx", 3.0, 2.0), "s": robot("turtlebot", 1.0, 1.0)}) as world:
        body = world.robots["r"]
        depth, info = body.depth(), body.depth_info
        wall = 6.0 - body.T_world("depth_camera_optical")[0, 3]
        assert (depth.shape, depth.dtype) == ((240, 320), np.float32)
        patch = depth[100:140, 140:180]
        assert np.mean(patch) == pytest.approx(wall, abs=0.01)
        assert 0.2 < np.std(patch) / (0.0015 * wall**2) < 2.0
        row = 230  # the floor, by the camera's height over the slope of the ray
        floor = body.T_world("depth_camera_optical")[2, 3] / ((row - info.K[1, 2]) / info.K[1, 1])
        assert np.median(depth[row]) == pytest.approx(floor, rel=0.02)
        with pytest.raises(RobotModelError, match="depth_camera_optical"):
            world.robots["s"].depth()


def test_depth_outside_the_limits_is_not_a_number(tmp_path: Path) -> None:
    with make_world(tmp_path, {"r": robot("p3dx", 5.75, 2.0), "s": robot("p3dx", 0.5, 1.0)}, params=TINY) as world:
        assert np.all(np.isnan(world.robots["r"].depth()[60:180, 60:260]))  # 0.17 m from the wall
        assert np.isnan(world.robots["s"].depth()[120, 160])  # 5.4 m


def test_tags_are_those_of_the_family() -> None:
    cells = tag_cells("36h11", 3)
    assert cells.shape == (12, 12)
    assert cells[:2].all()
    assert not cells[2, 2:10].any()
    picture = cv2.resize(cells.astype(np.uint8) * 255, None, fx=10, fy=10, interpolation=cv2.INTER_NEAREST)
    assert DETECTOR.detectMarkers(picture)[1].ravel().tolist() == [3]
    for family, tag_id in (("qr", 0), ("36h11", 587), ("36h11", -1)):
        with pytest.raises(VisionError, match=r"expected"):
            tag_cells(family, tag_id)
