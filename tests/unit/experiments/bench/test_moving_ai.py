"""Moving AI files: rows from the top become rows from the bottom, and what is wrong is named with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from hitchhike_ros.core.errors import MapFileError
from hitchhike_ros.experiments.bench.moving_ai import SearchProblem, load_moving_ai_map, load_problems
from hitchhike_ros.mapping.grid import FREE, OCCUPIED

MAP = "type octile\nheight 2\nwidth 3\nmap\n.G@\nOT.\n"
SCENARIOS = "version 1\n0\tmaps/a.map\t3\t2\t0\t0\t2\t1\t2.41421356\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "file"
    path.write_text(text)
    return path


def test_the_last_line_is_the_first_row(tmp_path):
    grid = load_moving_ai_map(write(tmp_path, MAP), 0.5)
    assert grid.data.tolist() == [[OCCUPIED, OCCUPIED, FREE], [FREE, FREE, OCCUPIED]]
    assert grid.resolution == 0.5


def test_scenarios_are_cells_of_that_grid(tmp_path):
    assert load_problems(write(tmp_path, SCENARIOS)) == [SearchProblem("maps/a.map", (1, 0), (0, 2), 2.41421356)]
    assert load_problems(write(tmp_path, SCENARIOS.replace("version 1", "version 1.0") + "\n\n"))


@pytest.mark.parametrize(
    ("old", "new", "field", "value"),
    [
        ("octile", "tile", "type", "tile"),
        ("type octile\n", "", "type", "height 2"),
        ("height 2", "height two", "height", "two"),
        ("width 3", "width 0", "width", "0"),
        ("width 3", "width -3", "width", "-3"),
        ("width 3\n", "", "width", "map"),
        ("height 2", "height 3", "map", "2 rows"),
        ("OT.", "OT", "line 6", "2 cells"),
        (".G@", ".S@", "line 5", "S"),
        (MAP, "type octile\n", "", "1 lines"),
        (MAP, "", "", "0 lines"),
    ],
)
def test_a_map_that_is_wrong(tmp_path, old, new, field, value):
    path = write(tmp_path, MAP.replace(old, new))
    with pytest.raises(MapFileError) as error:
        load_moving_ai_map(path)
    assert (error.value.file, error.value.field, error.value.value) == (str(path), field, value)


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("version 1", "version 2", "line 1"),
        (SCENARIOS, "", "line 1"),
        ("\t2\t1\t", "\t2\t", "line 2"),
        ("\t2\t1\t", "\t2\tone\t", "line 2"),
        ("\t2\t1\t", "\t2\t2\t", "line 2"),
        ("\t2\t1\t", "\t-1\t1\t", "line 2"),
        ("2.41421356", "nan", "line 2"),
        ("2.41421356", "-1", "line 2"),
    ],
)
def test_a_scenario_that_is_wrong(tmp_path, old, new, field):
    path = write(tmp_path, SCENARIOS.replace(old, new, 1))
    with pytest.raises(MapFileError) as error:
        load_problems(path)
    assert error.value.field == field
    assert error.value.expected


def test_files_that_cannot_be_read(tmp_path):
    for load in (load_moving_ai_map, load_problems):
        with pytest.raises(MapFileError, match="No such file"):
            load(tmp_path / "none")
        (tmp_path / "picture").write_bytes(b"\x89PNG\xff")
        with pytest.raises(MapFileError, match="ASCII"):
            load(tmp_path / "picture")


@pytest.mark.parametrize(("name", "free", "count"), [("arena", 2054, 160), ("32room_000", 240671, 1900)])
def test_the_real_files(shared_data, name, free, count):
    file = shared_data / "movingai" / f"{name}.map"
    if not file.exists():
        pytest.skip(f"{file} is not there")
    grid, scenarios = load_moving_ai_map(file), load_problems(file.with_suffix(".map.scen"))
    assert (grid.data == FREE).sum() == free
    assert len(scenarios) == count
    assert all(grid.data[s.start] == grid.data[s.goal] == FREE for s in scenarios)
