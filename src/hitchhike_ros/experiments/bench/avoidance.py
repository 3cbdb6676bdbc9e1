"""Obstacle avoidance: drives down a corridor with boxes that the map does not have and two people crossing the way."""

from __future__ import annotations

import math

from hitchhike_ros.experiments.bench.corridor_drives import DriveResult, corridor_drives
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scenarios.runs import write_results
from hitchhike_ros.experiments.scoring.figures import Figure, median

_DRIVES, _QUICK = 100, 4
# The goal tolerance, and what localization may be off by beside it.
_GOAL_M, _GOAL_DEG = 0.10 + 0.05, 5.0 + 1.0


def run(options: Options, progress: Progress) -> Findings:
    """Drive; ``bench mapping`` in the same run looks at the same drives."""
    drives = drives_of(options, progress)
    reached = [drive for drive in drives if drive.reached]
    worst_m = max((drive.goal_error_m for drive in reached), default=None)
    worst_deg = max((math.degrees(drive.goal_error_rad) for drive in reached), default=None)
    figures = [
        Figure("drives", len(drives), ""),
        Figure("contacts with boxes, people and walls", sum(len(drive.contacts) for drive in drives), "", 0.0),
        Figure("drives that reach their goal", len(reached), "", float(len(drives)), "higher"),
        Figure("goal error, worst", worst_m, "m", _GOAL_M),
        Figure("goal heading error, worst", worst_deg, "°", _GOAL_DEG),
        # Beside it: the straight way at cruise speed.
        Figure("time of a drive, median", median([d.duration_s for d in reached]), "s", peer=drives[0].straight_s),
        Figure("time of a drive, longest", max((d.duration_s for d in reached), default=None), "s"),
        Figure("time standing in a drive, longest", max(d.stood_s for d in drives), "s"),
    ]
    return Findings(figures)


def drives_of(options: Options, progress: Progress) -> tuple[DriveResult, ...]:
    """100 drives, or 4 when quick; each is a line of ``drives.json``."""
    seeds = range(options.seed, options.seed + (_QUICK if options.quick else _DRIVES))
    drives = corridor_drives(options.package, seeds, progress)
    write_results(options.output / "drives.json", {"drives along the corridor": drives})
    return drives
