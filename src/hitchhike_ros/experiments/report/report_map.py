"""The map of a run in the report: walls as a picture, everything else as shapes over it, and poses to replay.

Shapes are in metres with y downward, as SVG has it: a point (x, y) in ``map`` is drawn at (x, -y).
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import cv2
import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Obstacle
from hitchhike_ros.experiments.report.driven_area import driven_area
from hitchhike_ros.experiments.report.report_plots import TimeAxis, state_text
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.experiments.scoring.network_rides import NetworkRide
from hitchhike_ros.experiments.scoring.tracks import poses_at
from hitchhike_ros.mapping.grid import FREE, OCCUPIED, OccupancyGrid
from hitchhike_ros.mapping.sites import Sites

_MIN_SIDE_M = 5.0
# Of a replay (chosen): smooth to the eye, and small.
_REPLAY_STEP_S, _REPLAY_STEPS = 0.2, 800
_TRACK_POINTS = 1000
# Grey, alpha: seen on white and on black.
_WALL, _UNKNOWN = (112, 255), (128, 70)


@dataclass(frozen=True)
class Background:
    """The picture of the walls: a data URI, and where it lies in its own frame and in the map."""

    uri: str
    width: float
    height: float
    transform: str


@dataclass(frozen=True)
class MapTrack:
    """Where a robot went; ``aboard`` are the parts of it on which it rode."""

    robot: str
    index: int
    points: str
    aboard: tuple[str, ...]
    start: tuple[float, float]
    end: tuple[float, float]


@dataclass(frozen=True)
class Rectangle:
    """A box of the world, or one in a hitchhiker's map."""

    x: float
    y: float
    width: float
    height: float
    title: str


@dataclass(frozen=True)
class MapPicture:
    """Everything of a run that has a place."""

    view: tuple[float, float, float, float]  # x, y, width, height of the viewBox
    background: Background | None
    areas: tuple[str, ...]  # hitchhiking points
    markers: tuple[tuple[float, float], ...]
    true_boxes: tuple[Rectangle, ...]
    found_boxes: tuple[Rectangle, ...]
    tracks: tuple[MapTrack, ...]
    contacts: tuple[tuple[float, float], ...]


def map_picture(
    record: RideRecord, rides: Sequence[NetworkRide], grid: OccupancyGrid | None, sites: Sites
) -> MapPicture | None:
    """The map of a run; None when there is neither a map nor a place where anything was."""
    view = _view(record, grid)
    if view is None:
        return None
    riders = dict.fromkeys(ride.hitchhiker for ride in rides) or dict.fromkeys(record.robots)
    markers = [sites.marker(point.marker) for point in sites.hitchhiking_points if point.marker is not None]
    return MapPicture(
        view,
        None if grid is None else _background(grid),
        tuple(_points(np.array(point.area, dtype=float)) for point in sites.hitchhiking_points),
        tuple((round(m.x, 2), round(-m.y, 2)) for m in markers if m is not None),
        tuple(_rectangle(box, f"box {box.id}") for box in record.true_boxes),
        tuple(_rectangle(b, f"{b.id} in {name}'s map") for name in riders for b in record.robots[name].obstacles),
        tuple(_track(record, i, name, rides) for i, name in enumerate(record.robots) if record.robots[name].truth),
        tuple((round(c.x, 2), round(-c.y, 2)) for c in record.contacts),
    )


def replay(record: RideRecord, axis: TimeAxis) -> dict[str, object]:
    """Poses of all robots at common times, and their states, for the script that moves them over the map."""
    step = max(_REPLAY_STEP_S, axis.span / _REPLAY_STEPS)
    stamps = np.arange(axis.start, axis.end + 1e-6, step)
    robots = []
    for i, (name, robot) in enumerate(record.robots.items()):
        if not robot.truth:
            continue
        poses = poses_at(robot.truth, stamps)
        degrees = np.degrees(poses[:, 2])
        states = [[round(s.time_stamp, 2), f"{s.role}: {state_text(s)}".removeprefix("none: ")] for s in robot.statuses]
        robots.append(
            {
                "name": name,
                "index": i,
                "x": np.round(poses[:, 0], 2).tolist(),
                "y": np.round(-poses[:, 1], 2).tolist(),
                "a": np.round(-degrees).tolist(),
                "states": states,
            }
        )
    return {"start": round(axis.start, 3), "end": round(axis.end, 3), "step": step, "robots": robots}


def _view(record: RideRecord, grid: OccupancyGrid | None) -> tuple[float, float, float, float] | None:
    """What is shown, as an SVG's viewBox."""
    area = driven_area(record, grid)
    if area is None:
        return None
    low, high = area
    grow = np.maximum(0.0, _MIN_SIDE_M - (high - low)) / 2.0
    low, high = low - grow, high + grow
    width, height = high - low
    return round(float(low[0]), 2), round(float(-high[1]), 2), round(float(width), 2), round(float(height), 2)


def _background(grid: OccupancyGrid) -> Background:
    grey = np.zeros((*grid.data.shape, 4), dtype=np.uint8)
    for mask, (value, alpha) in ((grid.data == OCCUPIED, _WALL), ((grid.data != FREE) & ~grid.occupied, _UNKNOWN)):
        grey[mask] = (value, value, value, alpha)
    _, png = cv2.imencode(".png", np.flipud(grey), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    origin = grid.origin
    return Background(
        data_uri(png.tobytes(), "image/png"),
        round(grid.width * grid.resolution, 3),
        round(grid.height * grid.resolution, 3),
        f"translate({origin.x:.3f} {-origin.y:.3f}) rotate({-np.degrees(origin.theta):.3f})",
    )


def data_uri(content: bytes, kind: str) -> str:
    """A file's content in the place of its address."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _track(record: RideRecord, index: int, name: str, rides: Sequence[NetworkRide]) -> MapTrack:
    truth = sorted(record.robots[name].truth, key=lambda p: p.stamp)
    track = np.array([(p.stamp, p.x, p.y) for p in truth])
    own = [ride for ride in rides if ride.hitchhiker == name]
    aboard = []
    for ride in own:
        end = track[-1, 0] if ride.released_at is None else ride.released_at
        part = track[(track[:, 0] >= ride.riding_at) & (track[:, 0] <= end)]
        aboard.append(_points(part[:, 1:]))
    start, end_at = (round(track[0, 1], 2), round(-track[0, 2], 2)), (round(track[-1, 1], 2), round(-track[-1, 2], 2))
    return MapTrack(name, index, _points(track[:, 1:]), tuple(part for part in aboard if part), start, end_at)


def _points(points: FloatArray) -> str:
    """Points (N, 2) in ``map`` as SVG has them, a robot that stands once."""
    step = max(1, len(points) // _TRACK_POINTS)
    thinned = [*points[::step], *points[-1:]]
    texts = [f"{x:.2f},{-y:.2f}" for x, y in thinned]
    return " ".join(text for text, _ in groupby(texts))


def _rectangle(box: Obstacle, title: str) -> Rectangle:
    return Rectangle(round(box.x, 3), round(-box.y - box.b, 3), round(box.w, 3), round(box.b, 3), title)
