import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hitchhike_ros.core import geometry
from hitchhike_ros.core.datatypes import FloatArray, Obstacle, Pose2D, Twist2D
from hitchhike_ros.core.geometry import distance_to_box, nearest_in_box

coordinates = st.floats(-1e3, 1e3)
angles = st.floats(-20.0, 20.0)
poses = st.builds(Pose2D, coordinates, coordinates, angles)
yaw_rates = st.one_of(st.floats(-3, 3), st.floats(-1e-7, 1e-7), st.just(0.0), st.sampled_from([0.0999, 0.1001, -0.1]))
twists = st.builds(Twist2D, st.floats(-1.5, 1.5), yaw_rates)
periods = st.floats(0.01, 0.5)


def as_array(pose: Pose2D) -> FloatArray:
    return np.array([pose.x, pose.y, pose.theta])


def assert_same_pose(a: Pose2D, b: Pose2D, tolerance: float = 1e-6) -> None:
    assert geometry.distance(a, b) < tolerance
    assert abs(geometry.wrap_angle(a.theta - b.theta)) < tolerance


def numerical_jacobian(function: Callable[[Pose2D], Pose2D], at: Pose2D, step: float = 1e-6) -> FloatArray:
    """Central differences, (3, 3); the angle's difference is wrapped."""
    columns = []
    for axis in np.eye(3) * step:
        ahead, behind = function(Pose2D(*(as_array(at) + axis))), function(Pose2D(*(as_array(at) - axis)))
        difference = as_array(ahead) - as_array(behind)
        difference[2] = geometry.wrap_angle(difference[2])
        columns.append(difference / (2 * step))
    return np.column_stack(columns)


def matrix(pose: Pose2D) -> FloatArray:
    """Homogeneous (3, 3) of a pose."""
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0, 0, 1]])


@given(st.floats(-1e6, 1e6))
def test_wrap_angle_keeps_the_direction_in_its_range(angle: float) -> None:
    wrapped = geometry.wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@pytest.mark.parametrize(
    ("angle", "wrapped"), [(math.pi, math.pi), (-math.pi, math.pi), (0.0, 0.0), (7.0, 7 - math.tau)]
)
def test_wrap_angle_at_its_ends(angle: float, wrapped: float) -> None:
    assert geometry.wrap_angle(angle) == pytest.approx(wrapped, abs=1e-15)


@given(st.lists(angles, min_size=1, max_size=8))
def test_wrap_angles_is_wrap_angle_of_each(values: list[float]) -> None:
    for one, wrapped in zip(values, geometry.wrap_angles(np.array(values)), strict=True):
        assert -math.pi < wrapped <= math.pi
        assert math.remainder(wrapped - one, math.tau) == pytest.approx(0.0, abs=1e-9)


@given(poses, poses)
def test_compose_is_the_product_of_matrices(a: Pose2D, b: Pose2D) -> None:
    np.testing.assert_allclose(matrix(geometry.compose(a, b)), matrix(a) @ matrix(b), atol=1e-9)


@given(poses, poses, poses)
def test_compose_is_associative(a: Pose2D, b: Pose2D, c: Pose2D) -> None:
    left, right = geometry.compose(geometry.compose(a, b), c), geometry.compose(a, geometry.compose(b, c))
    assert_same_pose(left, right)


@given(poses)
def test_identity_and_inverse(pose: Pose2D) -> None:
    assert_same_pose(geometry.compose(pose, Pose2D()), pose)
    assert_same_pose(geometry.compose(Pose2D(), pose), pose)
    assert_same_pose(geometry.compose(pose, geometry.inverse(pose)), Pose2D())
    assert_same_pose(geometry.compose(geometry.inverse(pose), pose), Pose2D())


@given(poses, poses)
def test_between_undoes_compose(T_a_b: Pose2D, T_b_c: Pose2D) -> None:
    assert_same_pose(geometry.between(T_a_b, geometry.compose(T_a_b, T_b_c)), T_b_c)


@given(poses, twists, periods)
def test_an_arc_is_the_limit_of_many_small_straight_steps(pose: Pose2D, twist: Twist2D, dt: float) -> None:
    x, y, n = pose.x, pose.y, 400
    for k in range(n):
        heading = pose.theta + twist.omega * dt * (k + 0.5) / n
        x += twist.v * dt / n * math.cos(heading)
        y += twist.v * dt / n * math.sin(heading)
    assert_same_pose(geometry.move(pose, twist, dt), Pose2D(x, y, pose.theta + twist.omega * dt))


@given(poses, twists, periods)
def test_the_twist_between_two_poses_leads_from_one_to_the_other(pose: Pose2D, twist: Twist2D, dt: float) -> None:
    found = geometry.twist_between(pose, geometry.move(pose, twist, dt), dt)
    assert (found.v, found.omega) == pytest.approx((twist.v, twist.omega), abs=1e-9 / dt)


def test_the_twist_to_a_pose_beside_the_robot_has_the_length_of_the_chord_along_its_arc() -> None:
    assert geometry.twist_between(Pose2D(), Pose2D(0.3, 0.4), 0.5) == Twist2D(0.6, 0.0)


@given(poses, twists, st.floats(-0.5, 1.5))
def test_interpolation_follows_a_constant_twist(pose: Pose2D, twist: Twist2D, share: float) -> None:
    joined = geometry.interpolate(pose, geometry.move(pose, twist, 0.4), share)
    assert_same_pose(joined, geometry.move(pose, twist, 0.4 * share))


@given(poses, poses, st.floats(0.0, 1.0))
def test_interpolation_ends_at_both_poses_and_is_the_same_from_either(a: Pose2D, b: Pose2D, share: float) -> None:
    assume(abs(geometry.between(a, b).theta) < 3.0)
    assert_same_pose(geometry.interpolate(a, b, 0.0), a)
    assert_same_pose(geometry.interpolate(a, b, 1.0), b)
    assert_same_pose(geometry.interpolate(a, b, share), geometry.interpolate(b, a, 1.0 - share))


@pytest.mark.parametrize("turn", [1e-2, -1e-2, 0.5, -2.0])
def test_the_arc_and_its_derivatives(turn: float) -> None:
    step = 1e-6
    s, c, ds, dc = geometry.arc(turn)
    assert (s, c) == pytest.approx((math.sin(turn) / turn, (1.0 - math.cos(turn)) / turn), abs=1e-12)
    ahead, behind = geometry.arc(turn + step), geometry.arc(turn - step)
    slopes = ((ahead[0] - behind[0]) / (2 * step), (ahead[1] - behind[1]) / (2 * step))
    assert (ds, dc) == pytest.approx(slopes, abs=1e-8)


@given(poses, poses)
def test_transform_points_agrees_with_compose(T_a_b: Pose2D, p: Pose2D) -> None:
    point = geometry.transform_points(T_a_b, np.array([[p.x, p.y]]))
    expected = geometry.compose(T_a_b, p)
    np.testing.assert_allclose(point, [[expected.x, expected.y]], atol=1e-9)


@given(poses, poses)
def test_jacobians_of_compose(a: Pose2D, b: Pose2D) -> None:
    J_a, J_b = geometry.compose_jacobians(a, b)
    np.testing.assert_allclose(J_a, numerical_jacobian(lambda pose: geometry.compose(pose, b), a), atol=1e-3)
    np.testing.assert_allclose(J_b, numerical_jacobian(lambda pose: geometry.compose(a, pose), b), atol=1e-3)


@given(poses)
def test_jacobian_of_inverse(pose: Pose2D) -> None:
    expected = numerical_jacobian(geometry.inverse, pose)
    np.testing.assert_allclose(geometry.inverse_jacobian(pose), expected, atol=1e-3)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_rpy_turns_about_fixed_axes(roll: float, pitch: float, yaw: float) -> None:
    R = geometry.rotation_from_rpy(roll, pitch, yaw)
    about_x, about_y, about_z = (
        geometry.rotation_from_rpy(*(angle if axis == i else 0.0 for i in range(3)))
        for axis, angle in enumerate((roll, pitch, yaw))
    )
    np.testing.assert_allclose(R, about_z @ about_y @ about_x, atol=1e-12)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_rpy_of_an_optical_frame() -> None:
    """REP 103: z of the optical frame looks along x of the body, its x to the right."""
    R = geometry.rotation_from_rpy(-math.pi / 2, 0.0, -math.pi / 2)
    np.testing.assert_allclose(R, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)


@given(poses)
def test_pose_from_matrix_is_the_planar_part(pose: Pose2D) -> None:
    T = geometry.matrix_from_xyz_rpy((pose.x, pose.y, 0.3), (0.0, 0.0, pose.theta))
    assert_same_pose(geometry.pose_from_matrix(T), pose)


def test_path_length() -> None:
    assert geometry.path_length(np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 5.0]])) == pytest.approx(6.0)
    assert geometry.path_length(np.array([[1.0, 1.0]])) == 0.0
    assert geometry.path_length(np.empty((0, 2))) == 0.0


L_SHAPE = ((0.0, 0.0), (4.0, 0.0), (4.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0))


@given(st.floats(-1, 5), st.floats(-1, 4))
def test_point_in_polygon_of_an_l(x: float, y: float) -> None:
    edges = (x in (0.0, 1.0, 4.0)) or (y in (0.0, 1.0, 3.0))
    assume(not edges)
    expected = (0 < x < 4 and 0 < y < 1) or (0 < x < 1 and 0 < y < 3)
    assert geometry.point_in_polygon(x, y, L_SHAPE) == expected
    assert geometry.point_in_polygon(x, y, L_SHAPE[::-1]) == expected


def test_distance_to_a_box_is_that_of_its_nearest_point() -> None:
    box = Obstacle("obs1", 9.24, 6.08, 0.28, 0.16)
    assert distance_to_box(9.3, 6.1, box) == 0.0
    assert nearest_in_box(9.3, 6.1, box) == (9.3, 6.1)
    assert distance_to_box(9.24 - 0.3, 6.24 + 0.4, box) == pytest.approx(0.5)
    assert nearest_in_box(9.24 - 0.3, 6.24 + 0.4, box) == pytest.approx((9.24, 6.24))
