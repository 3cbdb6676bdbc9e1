"""Map files: compatible with map_server, exact on a round trip, clear about what is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import MapFileError
from hitchhike_ros.mapping.grid import OccupancyGrid
from hitchhike_ros.mapping.map_file import load_map, save_map, trinary
from repository import ROOT

FIELDS = {
    "image": "map.png",
    "resolution": 0.05,
    "origin": "[-1.0, 2.0, 0.5]",
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}


def write(folder: Path, pixels: np.ndarray | None = None, **changes: object) -> Path:
    """A map in ``folder``; a change to None leaves the field out."""
    fields = {**FIELDS, **changes}
    path = folder / "map.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in fields.items() if value is not None))
    if pixels is None:
        pixels = np.array([[254, 205, 0]], dtype=np.uint8)
    cv2.imwrite(str(folder / Path(str(fields["image"])).name), pixels)
    return path


def values(folder: Path, pixels: list, **changes: object) -> list:
    return load_map(write(folder, np.array(pixels, dtype=np.uint8), **changes)).data.tolist()


def test_the_lowest_row_of_the_picture_is_the_first_of_the_grid(tmp_path):
    assert values(tmp_path, [[254, 254, 0], [205, 0, 254]]) == [[-1, 100, 0], [0, 0, 100]]


def test_resolution_and_rotated_origin(tmp_path):
    grid = load_map(write(tmp_path))
    assert (grid.resolution, grid.origin) == (0.05, Pose2D(-1.0, 2.0, 0.5))


def test_negate_makes_white_occupied(tmp_path):
    assert values(tmp_path, [[255, 50, 0]], negate=1) == [[100, -1, 0]]
    assert values(tmp_path, [[255, 50, 0]], negate="true") == [[100, -1, 0]]


def test_thresholds_are_exclusive(tmp_path):
    # 255 - 51 is 0.2 of 255, 255 - 204 is 0.8: neither is above or below its threshold.
    assert values(tmp_path, [[204, 51, 205, 50]], occupied_thresh=0.8, free_thresh=0.2) == [[-1, -1, 0, 100]]


def test_scale_spreads_what_is_between_over_1_to_99(tmp_path):
    # Occupancy 0.2 … 0.8 between thresholds 0.1 and 0.9: 1 + 98 (occ - 0.1) / 0.8, cut to an integer.
    found = values(tmp_path, [[255, 204, 102, 51, 0]], mode="scale", occupied_thresh=0.9, free_thresh=0.1)
    assert found == [[0, 13, 62, 86, 100]]


def test_transparent_is_unknown_in_scale_mode_where_colour_does_not_decide(tmp_path):
    pixels = [[[128, 128, 128, 0], [128, 128, 128, 255], [0, 0, 0, 0], [255, 255, 255, 0]]]
    assert values(tmp_path, pixels, mode="scale") == [[-1, 1 + int(98 * (127 / 255 - 0.196) / 0.454), 100, 0]]


def test_trinary_averages_alpha_as_map_server_does(tmp_path):
    # (0 + 0 + 0 + 255) / 4 = 63.75: occupancy 0.75, while colour alone would give 1.0
    assert values(tmp_path, [[[0, 0, 0, 255]]], occupied_thresh=0.9) == [[-1]]


def test_raw_takes_the_pixel(tmp_path):
    assert values(tmp_path, [[0, 42, 100, 101, 255]], mode="raw") == [[0, 42, 100, -1, -1]]


@pytest.mark.parametrize("suffix", ["pgm", "png", "bmp"])
def test_formats_and_colours_agree(tmp_path, suffix):
    grey = np.array([[254, 205, 0], [0, 254, 205]], dtype=np.uint8)
    expected = [[100, 0, -1], [0, -1, 100]]
    assert load_map(write(tmp_path, grey, image=f"map.{suffix}")).data.tolist() == expected
    if suffix != "pgm":
        colour = np.repeat(grey[:, :, None], 3, axis=2)
        assert load_map(write(tmp_path, colour, image=f"map.{suffix}")).data.tolist() == expected


def test_sixteen_bits_a_pixel_mean_the_same(tmp_path):
    pixels = np.array([[254, 205, 0]], dtype=np.uint16) * 257
    assert load_map(write(tmp_path, pixels)).data.tolist() == [[0, -1, 100]]


def test_absolute_and_relative_image_paths(tmp_path):
    (tmp_path / "images").mkdir()
    cv2.imwrite(str(tmp_path / "images" / "map.png"), np.array([[0]], dtype=np.uint8))
    for image in (tmp_path / "images" / "map.png", "images/map.png"):
        path = write(tmp_path, image=image)
        assert load_map(path).data.tolist() == [[100]]


def test_a_trinary_grid_comes_back_and_its_files_are_the_same_bytes(tmp_path):
    data = np.random.default_rng(1).choice(np.array([-1, 0, 100], dtype=np.int8), size=(13, 17))
    grid = OccupancyGrid(data, 0.04, Pose2D(-3.25, 0.1, -1.2345678901234567))
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir(), second.mkdir()
    save_map(grid, first / "map.yaml")
    again = load_map(first / "map.yaml")
    np.testing.assert_array_equal(again.data, data)
    assert (again.resolution, again.origin) == (grid.resolution, grid.origin)
    save_map(again, second / "map.yaml")
    for name in ("map.yaml", "map.pgm"):
        assert (first / name).read_bytes() == (second / name).read_bytes()


def test_a_grid_with_values_between_loses_nothing(tmp_path):
    grid = OccupancyGrid(np.arange(-1, 101, dtype=np.int8).reshape(6, 17), 0.1)
    save_map(grid, tmp_path / "map.yaml")
    np.testing.assert_array_equal(load_map(tmp_path / "map.yaml").data, grid.data)


def test_what_map_saver_makes_of_probabilities():
    grid = OccupancyGrid(np.array([[-1, 0, 25, 26, 64, 65, 100]], dtype=np.int8), 0.1, Pose2D(1.0, 2.0, 0.5))
    assert trinary(grid).data.tolist() == [[-1, 0, 0, -1, -1, 100, 100]]
    assert trinary(grid, 0, 26).data.tolist() == [[-1, 0, -1, 100, 100, 100, 100]]
    assert (trinary(grid).resolution, trinary(grid).origin) == (grid.resolution, grid.origin)


@pytest.mark.parametrize("name", ["#1.yaml", "a: b.yaml", "größer.yaml", "map.v2.yaml", "x" * 120 + " y.yaml"])
def test_any_name_can_be_read_again(tmp_path, name):
    save_map(OccupancyGrid(np.zeros((2, 3)), 0.1), tmp_path / name)
    assert load_map(tmp_path / name).width == 3


def test_the_packages_own_map_is_what_the_saver_writes(tmp_path):
    maps = ROOT / "maps"
    save_map(load_map(maps / "p17_exp1.yaml"), tmp_path / "p17_exp1.yaml")
    for name in ("p17_exp1.yaml", "p17_exp1.pgm"):
        assert (tmp_path / name).read_bytes() == (maps / name).read_bytes()


def test_a_map_that_cannot_be_written(tmp_path):
    with pytest.raises(MapFileError, match=r"missing/map\.pgm"):
        save_map(OccupancyGrid(np.zeros((2, 2)), 0.1), tmp_path / "missing" / "map.yaml")


@pytest.mark.parametrize(
    ("changes", "field", "value"),
    [
        ({"resolution": 0.0}, "resolution", 0.0),
        ({"resolution": -0.05}, "resolution", -0.05),
        ({"resolution": ".inf"}, "resolution", math.inf),
        ({"resolution": ".nan"}, "resolution", None),
        ({"resolution": "fine"}, "resolution", "fine"),
        ({"resolution": None}, "resolution", None),
        ({"occupied_thresh": 0.1}, "free_thresh", 0.196),
        ({"free_thresh": 1.5}, "free_thresh", 1.5),
        ({"origin": "[0.0, 0.0]"}, "origin", [0.0, 0.0]),
        ({"origin": "[0.0, 0.0, .nan]"}, "origin", None),
        ({"origin": "here"}, "origin", "here"),
        ({"negate": 2}, "negate", 2),
        ({"mode": "binary"}, "mode", "binary"),
        ({"image": None}, "image", None),
        ({"image": '""'}, "image", ""),
    ],
)
def test_a_bad_field_is_named_with_its_value(tmp_path, changes, field, value):
    path = write(tmp_path)
    path.write_text("".join(f"{k}: {v}\n" for k, v in {**FIELDS, **changes}.items() if v is not None))
    with pytest.raises(MapFileError) as error:
        load_map(path)
    assert error.value.field.startswith(field)
    assert str(path) in str(error.value)
    assert error.value.expected
    if value is not None:
        assert error.value.value == value


def test_files_that_are_no_maps(tmp_path):
    path = tmp_path / "map.yaml"
    with pytest.raises(MapFileError, match="No such file"):
        load_map(path)
    path.write_text("image: [")
    with pytest.raises(MapFileError, match="valid YAML"):
        load_map(path)
    path.write_text("- a\n- list\n")
    with pytest.raises(MapFileError, match="mapping"):
        load_map(path)
    write(tmp_path)
    (tmp_path / "map.png").unlink()
    with pytest.raises(MapFileError, match=r"image is .map\.png."):
        load_map(path)
    (tmp_path / "map.png").write_bytes(b"P5 not a picture")
    with pytest.raises(MapFileError, match="PGM, PNG or BMP"):
        load_map(path)
    cv2.imwrite(str(tmp_path / "map.tiff"), np.zeros((2, 2), dtype=np.float32))
    (tmp_path / "map.tiff").replace(tmp_path / "map.png")
    with pytest.raises(MapFileError, match="8 or 16 bits"):
        load_map(path)


def test_willow_garage(shared_data, tmp_path):
    path = shared_data / "maps" / "willow-2010-02-18-0.10.yaml"
    if not path.exists():
        pytest.skip("the Willow Garage map is not there")
    grid = load_map(path)
    assert (grid.height, grid.width, grid.resolution) == (608, 566, 0.1)
    assert {value: int((grid.data == value).sum()) for value in (-1, 0, 100)} == {-1: 234377, 0: 109207, 100: 544}
    save_map(grid, tmp_path / "willow.yaml")
    np.testing.assert_array_equal(load_map(tmp_path / "willow.yaml").data, grid.data)
