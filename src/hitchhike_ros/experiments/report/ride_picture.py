"""A picture of a ride: the map with both trajectories, the boxes of world and hitchhiker, and where robots coupled."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.transforms import Affine2D

from hitchhike_ros.core.datatypes import HitchhikingPoint, Obstacle
from hitchhike_ros.experiments.report.driven_area import driven_area
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord, RobotRecord
from hitchhike_ros.experiments.scoring.rides import Ride
from hitchhike_ros.experiments.scoring.tracks import poses_at
from hitchhike_ros.mapping.grid import FREE, OCCUPIED, OccupancyGrid
from hitchhike_ros.mapping.sites import Sites

_DRIVER, _HITCHHIKER, _BOX = "#0072B2", "#D55E00", "#009E73"  # told apart by the colour-blind too (Okabe and Ito)
# The picture's width, and what is beside the axes for labels, title and legend.
_WIDTH_IN, _LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 14.0, 0.7, 0.2, 0.5, 1.1


def draw_ride(path: Path, record: RideRecord, ride: Ride | None, grid: OccupancyGrid, sites: Sites, title: str) -> None:
    """Write the picture as PNG to ``path``."""
    area = driven_area(record, grid)
    if area is None:  # nothing was driven, and nothing in the map is free
        return
    (x0, y0), (x1, y1) = area.tolist()
    width, height = _WIDTH_IN - _LEFT_IN - _RIGHT_IN, (y1 - y0) / (x1 - x0) * (_WIDTH_IN - _LEFT_IN - _RIGHT_IN)
    tall = height + _BOTTOM_IN + _TOP_IN
    figure = Figure(figsize=(_WIDTH_IN, tall))
    place = (_LEFT_IN / _WIDTH_IN, _BOTTOM_IN / tall, width / _WIDTH_IN, height / tall)
    axes = figure.add_axes(place)
    _draw_map(axes, grid)
    for point in sites.hitchhiking_points:
        _draw_hitchhiking_point(axes, point, sites)
    _draw_boxes(axes, record.true_boxes, "boxes of the world", facecolor="none", edgecolor="black", linestyle="--")
    if ride is not None:
        found = record.robots[ride.hitchhiker].obstacles
        _draw_boxes(axes, found, f"boxes in {ride.hitchhiker}'s map", facecolor=_BOX, alpha=0.55, edgecolor="none")
    for name, robot in record.robots.items():
        _draw_trajectory(axes, name, robot, ride)
    if ride is not None:
        _draw_events(axes, record, ride)
    axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal", xlabel="x in map (m)", ylabel="y in map (m)", title=title)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=6, frameon=False)
    FigureCanvasAgg(figure).print_png(str(path))


def _draw_map(axes: Axes, grid: OccupancyGrid) -> None:
    grey = np.full(grid.data.shape, 0.80)
    grey[grid.data == FREE] = 1.0
    grey[grid.data == OCCUPIED] = 0.25
    extent = (0.0, grid.width * grid.resolution, 0.0, grid.height * grid.resolution)
    image = axes.imshow(grey, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=extent, interpolation="nearest")
    c, s = np.cos(grid.origin.theta), np.sin(grid.origin.theta)
    from_grid = np.array([[c, -s, grid.origin.x], [s, c, grid.origin.y], [0.0, 0.0, 1.0]])
    image.set_transform(Affine2D(from_grid) + axes.transData)


def _draw_hitchhiking_point(axes: Axes, point: HitchhikingPoint, sites: Sites) -> None:
    area = Polygon(
        point.area, facecolor="#F0E442", alpha=0.25, edgecolor="none", label=f"hitchhiking point {point.name}"
    )
    axes.add_patch(area)
    marker = sites.marker(point.marker) if point.marker is not None else None
    if marker is not None:
        axes.plot(marker.x, marker.y, "s", color="black", markersize=6, label=f"marker {marker.id}")


def _draw_boxes(axes: Axes, boxes: Iterable[Obstacle], label: str, **style: object) -> None:
    for i, box in enumerate(boxes):
        axes.add_patch(Rectangle((box.x, box.y), box.w, box.b, label=label if i == 0 else None, zorder=3, **style))


def _draw_trajectory(axes: Axes, name: str, robot: RobotRecord, ride: Ride | None) -> None:
    if not robot.truth:
        return
    rides = ride is not None and name == ride.hitchhiker
    colour = _HITCHHIKER if rides else _DRIVER
    track = np.array([(p.stamp, p.x, p.y) for p in robot.truth])
    role = "" if ride is None else ", hitchhiker" if rides else ", driver"
    axes.plot(track[:, 1], track[:, 2], color=colour, linewidth=1.6, label=f"{name}{role}", zorder=4)
    if rides and ride is not None and ride.riding_at is not None:
        end = ride.released_at if ride.released_at is not None else track[-1, 0]
        aboard = track[(track[:, 0] >= ride.riding_at) & (track[:, 0] <= end)]
        axes.plot(aboard[:, 1], aboard[:, 2], color=colour, linewidth=6, alpha=0.25, label="riding", zorder=2)
    axes.plot(*track[0, 1:], "o", color=colour, markersize=6, zorder=5)
    axes.plot(*track[-1, 1:], "X", color=colour, markersize=9, zorder=5)


def _draw_events(axes: Axes, record: RideRecord, ride: Ride) -> None:
    for stamp, symbol, label in ((ride.riding_at, "^", "coupled"), (ride.decoupling_at, "v", "decoupled")):
        names = [name for name in (ride.hitchhiker, ride.driver) if name is not None and record.robots[name].truth]
        if stamp is None or not names:
            continue
        spots = np.vstack([poses_at(record.robots[name].truth, np.array([stamp])) for name in names])
        axes.plot(
            spots[:, 0],
            spots[:, 1],
            symbol,
            color="white",
            markeredgecolor="black",
            markersize=9,
            label=label,
            zorder=6,
        )
