"""3D maps: a wall is where it stands, the way to it is free, and a .bt file is read by all that read it."""

from __future__ import annotations

import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from hitchhike_ros.core.datatypes import CameraInfo, FloatArray
from hitchhike_ros.core.errors import MapFileError, ParameterError, SensorDataError
from hitchhike_ros.core.geometry import matrix_from_xyz_rpy
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.mapping.octree import OccupancyOctree, OctreeParameters, depth_points, read_voxels, save

INFO = CameraInfo(64, 48, np.array([[60.0, 0.0, 31.5], [0.0, 60.0, 23.5], [0.0, 0.0, 1.0]]))
RESOLUTION = 0.1
PARAMS = OctreeParameters(resolution_m=RESOLUTION, max_range_m=4.0, stride=2)
# An optical frame (z forward, x right, y down) 0.55 m above the floor that looks along +x of the map, or along +y.
_OPTICAL = matrix_from_xyz_rpy((0.0, 0.0, 0.0), (-math.pi / 2, 0.0, -math.pi / 2))


def looking(x: float, y: float, yaw: float) -> FloatArray:
    return matrix_from_xyz_rpy((x, y, 0.55), (0.0, 0.0, yaw)) @ _OPTICAL


def wall(distance_m: float) -> FloatArray:
    return np.full((48, 64), distance_m, np.float32)


def mapped(*views: tuple[FloatArray, FloatArray]) -> OccupancyOctree:
    tree = OccupancyOctree(PARAMS)
    for depth, T in views:
        tree.insert(depth, INFO, T)
    return tree


def test_points_are_where_the_pinhole_model_says() -> None:
    depth = np.full((48, 64), np.nan, np.float32)
    depth[10, 50], depth[0, 0], depth[1, 1], depth[2, 2] = 2.0, 0.0, -1.0, np.inf
    np.testing.assert_allclose(depth_points(depth, INFO), [[(50 - 31.5) * 2 / 60, (10 - 23.5) * 2 / 60, 2.0]])


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, 2.0])
def test_a_wall_is_where_it_stands_and_the_way_there_is_free(yaw: float) -> None:
    voxels = read_voxels(mapped((wall(3.04), looking(1.0, -2.0, yaw))).file())
    assert voxels.resolution_m == RESOLUTION
    ahead = (voxels.centres[:, :2] - (1.0, -2.0)) @ (math.cos(yaw), math.sin(yaw))
    across = (voxels.centres[:, :2] - (1.0, -2.0)) @ (-math.sin(yaw), math.cos(yaw))
    half = voxels.sides / 2.0 * (abs(math.cos(yaw)) + abs(math.sin(yaw)))
    assert np.all(np.abs(ahead - 3.04) <= half + 1e-6), "no voxel that the wall does not go through"
    width, height = 3.04 * 64 / 60, 3.04 * 48 / 60
    for side in (-1.0, 1.0):
        assert (side * across).max() == pytest.approx(width / 2, abs=0.2)
        assert (side * (voxels.centres[:, 2] - 0.55)).max() == pytest.approx(height / 2, abs=0.2)
    # As much of it as its area: no holes.
    assert np.sum(voxels.sides**2) >= 0.9 * width * height


def test_what_is_gone_is_freed_and_what_is_far_is_not_there() -> None:
    here = looking(0.0, 0.0, 0.0)
    assert read_voxels(mapped((wall(2.0), here)).file()).centres[:, 0].max() < 2.2
    later = read_voxels(mapped((wall(2.0), here), *[(wall(3.5), here)] * 9).file())
    assert later.centres[:, 0].min() > 3.3
    assert len(read_voxels(mapped((wall(4.5), here)).file()).sides) == 0


def test_the_same_images_give_the_same_file_and_the_tree_goes_on_after_it() -> None:
    rng = np.random.default_rng(1)
    views = [(rng.uniform(0.5, 3.9, (48, 64)).astype(np.float32), looking(0.3 * i, 0.0, 0.2 * i)) for i in range(6)]
    whole = mapped(*views).file()
    again = OccupancyOctree(PARAMS)
    for depth, T in views:
        again.file()
        again.insert(depth, INFO, T)
    assert again.file() == whole
    assert mapped(*views[:-1]).file() != whole


def test_no_reading_is_no_map() -> None:
    tree = mapped((wall(math.nan), looking(0.0, 0.0, 0.0)))
    assert (len(tree), len(read_voxels(tree.file()).sides)) == (0, 0)


@pytest.mark.parametrize(
    ("depth", "info", "T", "text"),
    [
        (np.ones((10, 10), np.float32), INFO, looking(0, 0, 0), r"shape \(10, 10\), expected \(48, 64\)"),
        (wall(1.0), CameraInfo(64, 48, np.zeros((3, 3))), looking(0, 0, 0), "expected fx and fy > 0"),
        (wall(1.0), CameraInfo(64, 48, np.full((3, 3), np.nan)), looking(0, 0, 0), "expected fx and fy > 0"),
        (wall(1.0), INFO, np.full((4, 4), np.nan), "not finite"),
        (wall(1.0), INFO, looking(1e9, 0, 0), "not within the tree"),
        (wall(3e38), INFO, looking(0, 0, 0), "not within the tree"),
    ],
)
def test_senseless_images_are_refused(depth: FloatArray, info: CameraInfo, T: FloatArray, text: str) -> None:
    tree = OccupancyOctree(PARAMS)
    with pytest.raises(SensorDataError, match=text):
        tree.insert(depth, info, T)
    assert len(tree) == 0


@pytest.mark.parametrize("field", ["resolution_m", "max_range_m", "stride"])
def test_senseless_parameters_are_refused(field: str) -> None:
    with pytest.raises(ParameterError, match=field):
        load_parameters(OctreeParameters, "octree", overrides={field: 0})


def _files() -> dict[str, bytes]:
    rng = np.random.default_rng(2)
    noise = rng.uniform(0.5, 3.9, (48, 64)).astype(np.float32)
    return {
        "wall": mapped((wall(3.0), looking(0.0, 0.0, 0.0))).file(),
        "noise": mapped((noise, looking(-7.0, 3.0, 1.0)), (wall(2.5), looking(5.0, 5.0, 2.0))).file(),
        "empty": OccupancyOctree(PARAMS).file(),
    }


FILES = _files()


@pytest.mark.parametrize("name", ["wall", "noise"])
def test_octomap_tools_read_the_same_voxels(name: str, tmp_path: Path) -> None:
    voxels = save(FILES[name], tmp_path / "map.bt")
    assert (tmp_path / "map.bt").read_bytes() == FILES[name]
    subprocess.run(["bt2vrml", "map.bt"], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    centre = re.compile(r"translation (\S+) (\S+) (\S+)")
    text = (tmp_path / "map.bt.wrl").read_text(encoding="ascii")
    theirs = np.array([match.groups() for match in centre.finditer(text)], dtype=float)
    assert len(theirs) > 0
    assert sorted(np.round(theirs, 2).tolist()) == sorted(np.round(voxels.centres, 2).tolist())


@pytest.mark.parametrize("name", ["wall", "noise"])
def test_the_library_reads_a_file_and_writes_the_same(name: str, tmp_path: Path) -> None:
    save(FILES[name], tmp_path / "map.bt")
    subprocess.run(["convert_octree", "map.bt", "again.bt"], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    assert (tmp_path / "again.bt").read_bytes() == FILES[name]


def test_a_file_that_was_cut_or_changed_is_refused() -> None:
    content = FILES["noise"]
    for end in [*range(200), *range(200, len(content), 37), len(content) - 1]:
        with pytest.raises(MapFileError):
            read_voxels(content[:end])
    for more in (b"\0", b"\n", content):
        with pytest.raises(MapFileError, match="goes on after"):
            read_voxels(content + more)


def test_random_damage_never_harms_the_reader() -> None:
    rng = np.random.default_rng(3)
    for _ in range(2000):
        damaged = bytearray(FILES["noise"])
        for at in rng.integers(0, len(damaged), rng.integers(1, 5)):
            damaged[at] = rng.integers(256)
        try:
            voxels = read_voxels(bytes(damaged))
        except MapFileError:
            continue
        assert np.isfinite(voxels.centres).all()


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ((b"size ", b"size 1"), "size"),
        ((b"res 0.1", b"res nan"), "begins with"),
        ((b"res 0.1", b"res 0"), "metres a voxel is wide"),
        ((b"res 0.1", b"res 1e9"), "metres a voxel is wide"),
        ((b"res 0.1", b"res --1"), "metres a voxel is wide"),
        ((b"id OcTree", b"id ColorOcTree"), "begins with"),
        ((b"# Octomap", b"# Oktomap"), "begins with"),
    ],
)
def test_a_bad_header_is_named(changed: tuple[bytes, bytes], text: str) -> None:
    assert changed[0] in FILES["wall"]
    with pytest.raises(MapFileError, match=text):
        read_voxels(FILES["wall"].replace(*changed, 1))


def test_a_tree_without_end_is_refused_before_it_fills_the_stack() -> None:
    """OctoMap's own reader calls itself for each level, however many."""
    header = FILES["wall"].split(b"size")[0]
    bottomless = header + b"size 400001\nres 0.1\ndata\n" + b"\x03\x00" * 400_000
    with pytest.raises(MapFileError, match="deeper than 16 levels"):
        read_voxels(bottomless)
    with pytest.raises(MapFileError, match="as 4 bytes of them follow"):
        read_voxels(header + b"size 0\nres 0.1\ndata\n" + b"\0\0\0\0")


def test_the_empty_map_is_one() -> None:
    assert len(read_voxels(FILES["empty"]).sides) == 0


def test_saving_leaves_no_part_of_a_file(tmp_path: Path) -> None:
    with pytest.raises(MapFileError):
        save(FILES["wall"][:-1], tmp_path / "map.bt")
    (tmp_path / "folder.bt").mkdir()
    for path in (tmp_path / "folder.bt", tmp_path / "missing" / "map.bt"):
        with pytest.raises(MapFileError, match="can be written"):
            save(FILES["wall"], path)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.bt"]
