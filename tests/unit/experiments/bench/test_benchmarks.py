"""Benchmarks: each name has its module, and the one of the searches sees a wrong length and does without its peers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hitchhike_ros.experiments.bench import planning as bench_planning
from hitchhike_ros.experiments.bench.registry import BENCHMARKS, EXPERIMENTS, load
from hitchhike_ros.experiments.scoring.figures import Figure

MAP = "type octile\nheight 3\nwidth 4\nmap\n....\n.@@.\n....\n"


def problems(folder: Path, *lengths: float) -> list:
    """From the left end of the middle row to its right end, around the wall: 5 steps."""
    (folder / "wall.map").write_text(MAP)
    lines = [f"0\twall.map\t4\t3\t0\t1\t3\t1\t{length}" for length in lengths]
    (folder / "wall.map.scen").write_text("\n".join(["version 1", *lines]))
    return bench_planning._problems(folder)


def silent(step: str, done: int, of: int) -> None:
    assert 1 <= done <= of, step


def by_name(figures: list[Figure]) -> dict[str, Figure]:
    return {figure.name: figure for figure in figures}


@pytest.mark.parametrize("name", [*BENCHMARKS, *EXPERIMENTS])
def test_every_name_has_its_module(name):
    assert callable(load(name).run)


def test_lengths_are_held_against_the_file(tmp_path):
    figures = by_name(bench_planning._optimal(problems(tmp_path, 5.0, 5.004, 5.1), silent))
    for name in ("astar", "dstar_lite"):
        assert figures[f"{name}_optimal_scenarios"].value == 2
        assert figures[f"{name}_optimal_scenarios"].bound == 3
        assert figures[f"{name}_optimal_scenarios"].ok is False
        assert figures[f"{name}_length_error_max"].value == pytest.approx(0.1)
    assert all(figure.ok for figure in bench_planning._optimal(problems(tmp_path, 5.0), silent))


def test_a_missing_peer_is_left_out_and_said(tmp_path, monkeypatch, capsys):
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(bench_planning.importlib, "import_module", missing)
    figures = by_name(bench_planning._beside_peers(problems(tmp_path, 5.0), silent))
    assert figures["astar_query_median"].value > 0
    for name in ("mcp_geometric", "pyastar2d"):
        assert (figures[f"astar_time_by_{name}"].value, figures[f"astar_time_by_{name}"].ok) == (None, None)
    assert "pyastar2d is not installed" in capsys.readouterr().err


def test_changes_are_near_the_robot_and_leave_it_and_the_goal_alone():
    cost = np.ones((30, 30), dtype=np.float32)
    cells = bench_planning._near(np.random.default_rng(0), cost, (2, 3), (2, 5))
    assert len(set(map(tuple, cells))) == 20
    assert not {(2, 3), (2, 5)} & set(map(tuple, cells.tolist()))
    assert (np.abs(cells - [2, 3]) <= 10).all()
    assert (cells >= 0).all()
