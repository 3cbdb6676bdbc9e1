"""Each critic of the dynamic window: what it says of a motion, and that without it another one would be chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flat_world import P3DX
from hitchhike_ros.control import trajectory_critics as critics
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.core.datatypes import FloatArray, Twist2D
from hitchhike_ros.core.polyline import Polyline

PARAMS, STAND = LocalPlannerParameters(), Twist2D()
POSES = 10
WAY = Polyline([(0.0, 0.0), (5.0, 0.0)])


def motions(
    ends: list[tuple[float, float, float]],
    clearance: FloatArray | None = None,
    omega: tuple[float, ...] = (0.0, 0.0),
    last: Twist2D = STAND,
) -> critics.Motions:
    """Straight motions from the robot to each of ``ends`` (x, y, theta), in ten steps of 0.2 s."""
    shares = np.arange(1, POSES + 1)[:, None] / POSES
    poses = np.stack([shares * (x, y, 0.0) + (0.0, 0.0, theta) for x, y, theta in ends])
    velocities = np.zeros((len(ends), POSES, 2))
    velocities[..., 0] = np.hypot(poses[:, -1, 0], poses[:, -1, 1])[:, None] / (0.2 * POSES)
    targets = np.column_stack([velocities[:, -1, 0], omega[: len(ends)]])
    far = np.full((len(ends), POSES), 2.0)
    clear = far if clearance is None else clearance
    return critics.judge(targets, last, poses, velocities, 0.2, clear, PARAMS.margin_m, WAY, 0.5)


def steps(*values: float) -> FloatArray:
    """Clearance (K, P) of motions that keep it all along."""
    return np.repeat(np.array(values)[:, None], POSES, axis=1)


def hits_after(*free: int) -> FloatArray:
    """Clearance (K, P) of motions that touch something after so many poses."""
    return np.where(np.arange(POSES) < np.array(free)[:, None], 2.0, 0.0)


# Of two motions the first is chosen because of the one critic that is named; without it the second would be.
SCENES = {
    "progress": motions([(0.96, 0.0, 0.0), (0.12, 0.0, 0.0)], omega=(0.05, 0.0)),
    "lateral": motions([(0.90, 0.0, 0.0), (0.96, 0.24, 0.0)]),
    "heading": motions([(0.90, 0.0, 0.0), (0.96, 0.0, 0.6)]),
    "clearance": motions([(0.90, 0.0, 0.0), (0.96, 0.0, 0.0)], steps(0.5, 0.1)),
    "contact": motions([(0.60, 0.06, 0.0), (0.96, 0.0, 0.0)], hits_after(10, 8)),
    "smoothness": motions([(0.90, 0.0, 0.0), (0.96, 0.0, 0.0)], omega=(0.5, -0.5), last=Twist2D(0.4, 0.5)),
}


@pytest.mark.parametrize("critic", SCENES)
def test_without_a_critic_another_motion_is_chosen(critic: str) -> None:
    weight = f"{critic}_weight"
    assert getattr(PARAMS, weight) > 0.0
    without = replace(PARAMS, **{weight: 0.0})
    if critic == "contact":  # nothing else tells of a motion that ends in an obstacle
        without, params = replace(without, clearance_weight=0.0), replace(PARAMS, clearance_weight=0.0)
    else:
        params = PARAMS
    assert int(np.argmin(critics.costs(SCENES[critic], P3DX, params))) == 0
    assert int(np.argmin(critics.costs(SCENES[critic], P3DX, without))) == 1


def test_progress_is_the_share_of_the_possible_way() -> None:
    found = critics.progress(motions([(0.96, 0.0, 0.0), (0.48, 0.0, 0.0), (0.0, 0.0, 0.0)], omega=(0.0, 0.0, 0.0)))
    assert found == pytest.approx([1.0 - 0.96, 1.0 - 0.48, 1.0])


def test_lateral_is_the_mean_square_beside_the_way_and_no_more_than_four() -> None:
    beside = critics.lateral(motions([(0.9, 0.3, 0.0), (0.9, 3.0, 0.0)]))
    assert beside[0] == pytest.approx((0.4**2 + 0.7**2 + 1.0**2) / 3.0, rel=1e-2)
    assert beside[1] == pytest.approx(4.0)


def test_heading_is_off_the_direction_of_the_way() -> None:
    off = critics.heading(motions([(0.9, 0.0, 0.0), (0.9, 0.0, np.pi / 2)]))
    assert off == pytest.approx([0.0, 1.0])


def test_clearance_costs_within_the_comfort_alone() -> None:
    close = critics.clearance(motions([(0.9, 0.0, 0.0), (0.9, 0.0, 0.0)], steps(0.35, 0.175)), 0.35)
    assert close == pytest.approx([0.0, 0.25])


def test_contact_costs_the_more_the_sooner_it_comes() -> None:
    hits = critics.contact(motions([(0.9, 0.0, 0.0)] * 3, hits_after(10, 8, 2), omega=(0.0, 0.0, 0.0)))
    assert hits == pytest.approx([0.0, 0.2, 0.8])


def test_smoothness_is_the_square_of_the_change_of_the_yaw_rate() -> None:
    swing = critics.smoothness(motions([(0.9, 0.0, 0.0)] * 2, omega=(0.5, -0.5), last=Twist2D(0.4, 0.5)), 2.0)
    assert swing == pytest.approx([0.0, 0.25])
