"""Mapping: what the same drives as of ``bench avoidance`` put on the robot's map, boxes and nothing else."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.experiments.bench.avoidance import drives_of
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scoring.figures import Figure

_BOX_M = 0.08


def run(options: Options, progress: Progress) -> Findings:
    """Drive, unless ``bench avoidance`` has done so in the same run, and compare maps at the goal with the truth."""
    drives = drives_of(options, progress)
    boxes = sum(drive.boxes for drive in drives)
    place, size = [drive.place_error_m for drive in drives], [drive.size_error_m for drive in drives]
    figures = [
        Figure("boxes that stood there", boxes, ""),
        Figure("boxes found", sum(drive.found for drive in drives), "", float(boxes), "higher"),
        Figure("people and phantoms on the map", sum(len(drive.phantoms) for drive in drives), "", 0.0),
        Figure("box place error, worst", max(place), "m", _BOX_M),
        Figure("box size error, worst", max(size), "m", _BOX_M),
        Figure("worst box of a drive, place error, median", float(np.median(place)), "m"),
        Figure("worst box of a drive, size error, median", float(np.median(size)), "m"),
    ]
    return Findings(figures)
