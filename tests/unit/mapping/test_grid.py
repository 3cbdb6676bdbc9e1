"""Occupancy grids: cells and coordinates, boxes, distances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchhike_ros.core.datatypes import Obstacle, Pose2D
from hitchhike_ros.core.geometry import transform_points
from hitchhike_ros.mapping.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, distance_to


def empty(height: int = 20, width: int = 30, resolution: float = 0.1, origin: Pose2D | None = None) -> OccupancyGrid:
    return OccupancyGrid(np.zeros((height, width), dtype=np.int8), resolution, origin or Pose2D())


def occupied_cells(grid: OccupancyGrid) -> set[tuple[int, int]]:
    return {(int(row), int(column)) for row, column in np.argwhere(grid.occupied)}


def test_cells_are_row_column_counted_from_the_origin():
    grid = empty(origin=Pose2D(-1.0, 2.0))
    assert grid.world_to_cell([[-0.95, 2.05], [-0.75, 2.15], [-1.01, 1.99]]).tolist() == [[0, 0], [1, 2], [-1, -1]]
    np.testing.assert_allclose(grid.cell_to_world([[0, 0], [1, 2]]), [[-0.95, 2.05], [-0.75, 2.15]])


def test_a_quarter_turn_of_the_origin_makes_columns_run_along_y():
    grid = empty(origin=Pose2D(5.0, 0.0, math.pi / 2))
    np.testing.assert_allclose(grid.cell_to_world([[0, 3]]), [[5.0 - 0.05, 0.35]])


@given(
    st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-7, 7)),
    st.integers(0, 19),
    st.integers(0, 29),
    st.floats(0.01, 2.0),
)
def test_the_centre_of_a_cell_lies_in_it(origin, row, column, resolution):
    grid = empty(resolution=resolution, origin=Pose2D(*origin))
    assert grid.world_to_cell(grid.cell_to_world([[row, column]])).tolist() == [[row, column]]


def test_a_cells_own_lower_edge_belongs_to_it_despite_rounding():
    grid = empty(height=300, width=675, resolution=0.04)
    columns = np.arange(675)
    cells = grid.world_to_cell(np.column_stack([columns * 0.04, np.zeros(675)]))
    np.testing.assert_array_equal(cells[:, 1], columns)


def test_in_bounds():
    cells = [[0, 0], [19, 29], [20, 0], [0, 30], [-1, 0], [0, -1]]
    assert empty().in_bounds(cells).tolist() == [True, True, False, False, False, False]


@pytest.mark.parametrize("resolution", [0.04, float(np.float32(0.04))])
def test_the_papers_box_covers_exactly_its_cells(resolution):
    grid = empty(height=300, width=675, resolution=resolution)
    marked = np.argwhere(grid.with_obstacles([Obstacle("obs1", 9.24, 6.08, 0.28, 0.16)]).occupied)
    assert marked.min(axis=0).tolist() == [152, 231]
    assert marked.max(axis=0).tolist() == [155, 237]
    assert len(marked) == 7 * 4


def test_a_box_across_the_edge_keeps_what_is_on_the_map_and_one_outside_changes_nothing():
    grid = empty()
    boxes = [Obstacle("a", -1.0, -1.0, 1.15, 1.05), Obstacle("b", 10.0, 10.0, 1.0, 1.0)]
    assert occupied_cells(grid.with_obstacles(boxes)) == {(0, 0), (0, 1)}
    assert not occupied_cells(grid), "the grid itself must not change"


def test_a_box_without_extent_marks_where_it_is():
    assert (5, 3) in occupied_cells(empty().with_obstacles([Obstacle("post", 0.35, 0.55, 0.0, 0.0)]))
    assert occupied_cells(empty().with_obstacles([Obstacle("on an edge", 0.3, 0.5, 0.0, 0.0)]))


@given(st.floats(0, 6.3), st.floats(0.2, 1.5), st.floats(0.2, 1.5), st.floats(0.0, 0.5), st.floats(0.0, 0.5))
def test_on_a_rotated_grid_every_point_of_a_box_is_in_a_marked_cell(theta, x, y, w, b):
    corner = transform_points(Pose2D(0, 0, theta), np.array([[-3.0, -3.0]]))[0]
    grid = empty(height=60, width=60, origin=Pose2D(*corner, theta))
    marked = grid.with_obstacles([Obstacle("box", x, y, w, b)])

    def spread(length: float) -> np.ndarray:
        """Places along a side; less than a thousandth of a cell does not count as overlap, so not its very ends."""
        return np.linspace(min(0.001, length / 2), max(length - 0.001, length / 2), 7)

    u, v = np.meshgrid(x + spread(w), y + spread(b))
    cells = grid.world_to_cell(np.column_stack([u.ravel(), v.ravel()]))
    assert (marked.data[tuple(cells.T)] == OCCUPIED).all()
    reach = np.abs(marked.cell_to_world(np.argwhere(marked.occupied)) - [x + w / 2, y + b / 2])
    assert (reach <= np.array([w, b]) / 2 + 0.1).all(), "no cell is marked that lies a whole cell beside the box"


def test_grids_do_not_change_behind_the_back_of_a_cache():
    data = np.zeros((3, 3), dtype=np.int8)
    grid = OccupancyGrid(data, 1.0)
    data[1, 1] = OCCUPIED
    assert not grid.occupied.any()
    with pytest.raises(ValueError, match="read-only"):
        grid.data[0, 0] = OCCUPIED


@pytest.mark.parametrize(("shape", "resolution"), [((0, 3), 0.1), ((4,), 0.1), ((3, 3), 0.0), ((3, 3), math.nan)])
def test_senseless_grids_are_refused(shape, resolution):
    with pytest.raises(ValueError, match="expected"):
        OccupancyGrid(np.zeros(shape, dtype=np.int8), resolution)


def test_distance_is_metres_between_centres():
    mask = np.zeros((5, 7), dtype=bool)
    mask[2, 1] = True
    distance = distance_to(mask, 0.5)
    rows, columns = np.mgrid[0:5, 0:7]
    np.testing.assert_allclose(distance, 0.5 * np.hypot(rows - 2, columns - 1), rtol=1e-6)
    assert np.isinf(distance_to(np.zeros((2, 2), dtype=bool), 0.5)).all()


def test_distance_is_the_same_every_time():
    mask = np.random.default_rng(0).random((41, 61)) < 0.02
    first = distance_to(mask, 0.1)
    for _ in range(8):
        np.testing.assert_array_equal(distance_to(mask.copy(), 0.1), first)


def test_values_are_those_of_ros():
    """nav_msgs/OccupancyGrid: probabilities in percent, and -1."""
    assert (FREE, OCCUPIED, UNKNOWN) == (0, 100, -1)


@given(st.floats(0, 6.3), st.floats(-3.5, 3.5), st.floats(-3.5, 3.5), st.floats(0.0, 1.5), st.floats(0.0, 1.5))
def test_a_box_marks_the_cells_whose_bounding_squares_it_overlaps(theta, x, y, w, b):
    """Each cell of the whole grid is asked, also where the box lies partly or wholly beside it."""
    corner = transform_points(Pose2D(0, 0, theta), np.array([[-2.0, -3.0]]))[0]
    grid = empty(height=60, width=40, origin=Pose2D(*corner, theta))
    marked = grid.with_obstacles([Obstacle("box", x, y, w, b)]).occupied
    # Half the side of the square along the axes of the map that holds a turned cell.
    half = 0.05 * (abs(math.cos(theta)) + abs(math.sin(theta)))
    centres = grid.cell_to_world(np.argwhere(~marked | marked))
    apart = np.abs(centres - [x + w / 2, y + b / 2]) - [w / 2 + half, b / 2 + half]
    # A thousandth of a cell is no overlap, and a box is no smaller than four.
    surely, surely_not = (apart < -3e-4).all(axis=1), (apart > 3e-4).any(axis=1)
    assert marked.ravel()[surely].all()
    assert not marked.ravel()[surely_not].any()
