"""Walls from maps: rectangles that cover the occupied cells once, and prisms that face outwards."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.simulation.physics.walls import merge_cells, wall_mesh, wall_meshes


@given(arrays(bool, st.tuples(st.integers(1, 12), st.integers(1, 12))))
def test_rectangles_cover_the_mask_once(mask: np.ndarray) -> None:
    covered = np.zeros(mask.shape, dtype=int)
    for row, column, end_row, end_column in merge_cells(mask):
        covered[row:end_row, column:end_column] += 1
    assert np.array_equal(covered, mask)


def test_a_block_is_one_rectangle() -> None:
    mask = np.zeros((50, 60), dtype=bool)
    mask[10:20, 5:45] = True
    assert merge_cells(mask).tolist() == [[10, 5, 20, 45]]


def test_the_mesh_stands_where_the_map_says() -> None:
    """On a turned map: volume, base and outward faces of two blocks."""
    data = np.zeros((20, 30), dtype=np.int8)
    data[2:5, 3:9] = data[10:12, 20:21] = 100
    data[15, 15] = -1
    grid = OccupancyGrid(data, 0.1, Pose2D(1.0, -2.0, 0.7))
    vertices, normals, triangles = wall_mesh(grid, 2.0)
    a, b, c = vertices[triangles].swapaxes(0, 1)
    face = np.cross(b - a, c - a)
    assert np.all((face * normals[triangles[:, 0]]).sum(axis=1) > 0)
    # The bottom, which nobody sees, lies at z = 0 and adds nothing to the volume by the divergence theorem.
    assert np.isclose((a * face).sum() / 6.0, (18 + 2) * 0.01 * 2.0)
    assert set(vertices[:, 2].tolist()) == {0.0, 2.0}
    cells = grid.world_to_cell(vertices[:, :2].mean(axis=0)[None])  # between the two blocks
    assert data[tuple(cells[0])] == 0
    corner = grid.cell_to_world([[1.5, 2.5]])[0]
    assert np.isclose(np.abs(vertices[:, :2] - corner).sum(axis=1).min(), 0.0)


def test_an_empty_map_has_no_walls() -> None:
    assert all(len(part) == 0 for part in wall_mesh(OccupancyGrid(np.zeros((3, 3)), 0.1), 1.0))


def test_many_walls_come_in_parts_that_pybullet_takes():
    data = np.zeros((200, 120))
    data[::2, ::2] = 100  # 6,000 pillars
    grid = OccupancyGrid(data, 0.1)
    parts, whole = list(wall_meshes(grid, 1.0)), wall_mesh(grid, 1.0)
    assert max(len(vertices) for vertices, _, _ in parts) <= 131_072 < len(whole[0]) + 20_000
    assert sum(len(triangles) for _, _, triangles in parts) == len(whole[2])
    points = np.concatenate([vertices[triangles].reshape(-1, 3) for vertices, _, triangles in parts])
    expected = whole[0][whole[2]].reshape(-1, 3)
    np.testing.assert_array_equal(points[np.lexsort(points.T)], expected[np.lexsort(expected.T)])
    assert list(wall_meshes(OccupancyGrid(np.zeros((3, 3)), 0.1), 1.0)) == []
