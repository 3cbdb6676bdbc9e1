"""Inflation: what is forbidden, what is dear, and how regions are joined."""

from __future__ import annotations

import numpy as np
import pytest

from hitchhike_ros.core.errors import ParameterError
from hitchhike_ros.core.parameters import convert
from hitchhike_ros.core.robot_model import RobotLimits
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.planning.costmap import CostmapParameters, build_costmap, label_regions

LIMITS = RobotLimits(0.3, 0.1, 0.2, 0.3, 0.25, 1.0, 2.0)  # inscribed radius 0.2 m
PARAMS = CostmapParameters(margin_m=0.1, inflation_m=1.0, clearance_weight=2.0)


def wall_at_column(column: int, value: int = 100, width: int = 40) -> OccupancyGrid:
    data = np.zeros((5, width), dtype=np.int8)
    data[:, column] = value
    return OccupancyGrid(data, 0.1)


def test_clearance_counts_from_the_edge_of_the_obstacle():
    costmap = build_costmap(wall_at_column(0), LIMITS, PARAMS)
    np.testing.assert_allclose(costmap.clearance[2, :4], [-0.05, 0.05, 0.15, 0.25], atol=1e-6)


def test_cells_nearer_than_inscribed_radius_and_margin_are_forbidden():
    costmap = build_costmap(wall_at_column(0), LIMITS, PARAMS)
    assert costmap.lethal_m == pytest.approx(0.3)
    assert np.isinf(costmap.cost[2, :4]).all()  # clearance to 0.25 m
    assert np.isfinite(costmap.cost[2, 4:]).all()


def test_cost_falls_quadratically_to_one_at_the_inflation_radius():
    cost = build_costmap(wall_at_column(0), LIMITS, PARAMS).cost[2]
    assert cost[4] == pytest.approx(1 + 2 * (1 - 0.35) ** 2)
    assert cost[8] == pytest.approx(1 + 2 * (1 - 0.75) ** 2)
    assert (np.diff(cost[4:11]) < 0).all()
    assert (cost[11:] == 1).all()


def test_cost_beyond_the_footprint_is_the_same_for_every_robot():
    small = RobotLimits(0.2, 0.03, 0.1, 0.1, 0.1, 0.7, 3.0, radius_m=0.1)
    big, little = (build_costmap(wall_at_column(0), limits, PARAMS).cost for limits in (LIMITS, small))
    both = np.isfinite(big)
    np.testing.assert_array_equal(big[both], little[both])
    assert np.isfinite(little).sum() > both.sum()


@pytest.mark.parametrize(("value", "obstacle"), [(100, True), (65, True), (64, False), (1, False), (-1, True)])
def test_what_counts_as_an_obstacle(value, obstacle):
    assert np.isinf(build_costmap(wall_at_column(20, value), LIMITS, PARAMS).cost[2, 20]) == obstacle


def test_unknown_may_be_allowed():
    params = CostmapParameters(allow_unknown=True)
    assert np.isfinite(build_costmap(wall_at_column(20, -1), LIMITS, params).cost).all()


def test_an_empty_map_costs_nothing_extra():
    costmap = build_costmap(OccupancyGrid(np.zeros((4, 4)), 0.1), LIMITS, PARAMS)
    assert (costmap.cost == 1).all()


def test_regions_do_not_join_across_a_corner():
    cost = np.array([[1, np.inf], [np.inf, 1]], dtype=np.float32)
    regions = label_regions(cost)
    assert regions[0, 0] != regions[1, 1]
    assert regions[0, 1] == regions[1, 0] == 0
    joined = label_regions(np.array([[1, 1], [np.inf, 1]], dtype=np.float32))
    assert joined[0, 0] == joined[1, 1] != 0


@pytest.mark.parametrize("wrong", [{"margin_m": -0.1}, {"inflation_m": 0}, {"occupied_percent": 101}, {"radius": 1}])
def test_senseless_parameters_are_refused(wrong):
    with pytest.raises(ParameterError, match=next(iter(wrong))):
        convert(wrong, CostmapParameters, "robot.yaml", "costmap")
