"""Pictures of the grid simulator: its state as PNG, a run as an animated GIF."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.animation import PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle

from hitchhike_ros.mapping.grid import FREE
from hitchhike_ros.protocol.phase import Phase
from hitchhike_ros.simulation.grid.robot import GridRobot
from hitchhike_ros.simulation.grid.world import GridWorld

# The colour-blind can tell these apart too (Okabe and Ito).
_ALONE, _DRIVER, _RIDER, _SEEKER, _IDLE, _DEAD = "#56B4E9", "#0072B2", "#D55E00", "#E69F00", "#999999", "#000000"
# Colours of rides, so that those next to each other differ.
_PAIRS = ("#CC79A7", "#009E73", "#0072B2", "#E69F00", "#D55E00", "#56B4E9")
_SITE, _WALL = "#F0E442", "0.72"
_KINDS = {
    "alone": (_ALONE, "under way alone"),
    "driver": (_DRIVER, "driver of a ride"),
    "seeker": (_SEEKER, "hitchhiker before its ride"),
    "rider": (_RIDER, "rider"),
    "idle": (_IDLE, "at rest"),
    "dead": (_DEAD, "crashed"),
}
_WIDTH_IN, _LEFT_IN, _RIGHT_IN, _TOP_IN, _BOTTOM_IN = 12.0, 0.6, 0.15, 0.4, 0.85
# With up to so many robots their names are written beside them, and their paths are drawn.
_NAMED, _WITH_PATHS = 12, 30


@dataclass(frozen=True)
class Glyph:
    """One robot as it is drawn; ``leader`` is the index of the robot it follows."""

    name: str
    x: float
    y: float
    theta: float
    kind: str
    leader: int | None
    path: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Frame:
    """All robots at one time."""

    time: float
    robots: tuple[Glyph, ...]


def frame(world: GridWorld) -> Frame:
    """All robots as they are now."""
    robots = list(world.robots.values())
    for robot in robots:
        robot.body.advance(world.now)
    at = {id(robot.body): robot.index for robot in robots}
    few = len(robots) <= _WITH_PATHS
    glyphs = []
    for robot in robots:
        body = robot.body
        leader = at[id(body.leader)] if body.leader is not None and robot.coupled else None
        path = tuple(body.path) if few and body.leader is None and body.speed_mps > 0.0 else ()
        glyphs.append(Glyph(robot.name, body.x, body.y, body.theta, _kind(robot), leader, path))
    return Frame(world.now, tuple(glyphs))


class Recorder:
    """Keeps a frame of a running world every ``period_s``, as long as something happens in it."""

    def __init__(self, world: GridWorld, period_s: float) -> None:
        self.frames: list[Frame] = []
        self._world, self._period_s = world, period_s
        self._take()

    def _take(self) -> None:
        self.frames.append(frame(self._world))
        if not self._world.idle() or len(self.frames) == 1:
            self._world.at(self._world.now + self._period_s, self._take)


def draw_state(path: Path, world: GridWorld, title: str = "") -> None:
    """Write the state now as PNG to ``path``."""
    figure, axes = _canvas(world)
    _draw_frame(axes, frame(world), title)
    FigureCanvasAgg(figure).print_png(str(path))


def animate(path: Path, world: GridWorld, frames: Sequence[Frame], title: str = "", rate_hz: float = 10.0) -> None:
    """Write frames as an animated GIF to ``path``; it is as wide as a page of text, and repeats."""
    figure, axes = _canvas(world)
    FigureCanvasAgg(figure)
    writer = PillowWriter(fps=rate_hz)
    drawn: list = []
    with writer.saving(figure, str(path), dpi=75):
        for each in frames:
            for artist in drawn:
                artist.remove()
            drawn = _draw_frame(axes, each, title)
            writer.grab_frame()


def _kind(robot: GridRobot) -> str:
    status = robot.status
    if not robot.alive:
        return "dead"
    if status.state == "idle":
        return "idle"
    if status.role == "driver":
        return "driver"
    if status.phase is Phase.ALONE:
        return "alone"
    return "rider" if robot.coupled else "seeker"


def _canvas(world: GridWorld) -> tuple[Figure, Axes]:
    """The map with what stands still, and room for a legend below."""
    grid = world.grid
    wide, high = grid.width * grid.resolution, grid.height * grid.resolution
    width = _WIDTH_IN - _LEFT_IN - _RIGHT_IN
    height = width * high / wide
    tall = height + _TOP_IN + _BOTTOM_IN
    figure = Figure(figsize=(_WIDTH_IN, tall))
    axes = figure.add_axes((_LEFT_IN / _WIDTH_IN, _BOTTOM_IN / tall, width / _WIDTH_IN, height / tall))
    extent = (grid.origin.x, grid.origin.x + wide, grid.origin.y, grid.origin.y + high)
    grey = np.where(grid.data == FREE, 1.0, float(_WALL))
    axes.imshow(grey, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=extent, interpolation="nearest")
    for point in world.sites.hitchhiking_points:
        axes.add_patch(Polygon(point.area, facecolor=_SITE, alpha=0.35, edgecolor="none", zorder=1))
    for box in world.boxes:
        axes.add_patch(Rectangle((box.x, box.y), box.w, box.b, facecolor="#8B4513", edgecolor="none", zorder=1))
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", xlabel="x in map (m)", ylabel="y in map (m)")
    handles = [Line2D([], [], marker="o", linestyle="", color=colour, label=label) for colour, label in _KINDS.values()]
    handles.append(Line2D([], [], color=_PAIRS[0], linewidth=5, alpha=0.6, label="ride"))
    handles.append(Line2D([], [], color=_SITE, linewidth=8, alpha=0.6, label="hitchhiking point"))
    if world.boxes:
        handles.append(Line2D([], [], color="#8B4513", marker="s", linestyle="", label="new box"))
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False, columnspacing=1.2)
    return figure, axes


def _draw_frame(axes: Axes, shown: Frame, title: str) -> list:
    """Draw what moves; the artists, so that they can be removed again."""
    robots = shown.robots
    size = float(np.interp(len(robots), [10, 1000], [90.0, 12.0]))
    artists: list = []
    ahead = [np.array(r.path) for r in robots if len(r.path) > 1]
    colours = [_KINDS[r.kind][0] for r in robots if len(r.path) > 1]
    artists.append(axes.add_collection(LineCollection(ahead, colors=colours, linewidths=1.0, alpha=0.6, zorder=2)))
    rides = [(r, robots[r.leader]) for r in robots if r.leader is not None]
    links = [np.array([(a.x, a.y), (b.x, b.y)]) for a, b in rides]
    pairs = [_PAIRS[a.leader % len(_PAIRS)] for a, _ in rides if a.leader is not None]
    halo = math.sqrt(size) * 1.9
    artists.append(
        axes.add_collection(
            LineCollection(links, colors=pairs, linewidths=halo, alpha=0.55, capstyle="round", zorder=3)
        )
    )
    xy = np.array([(r.x, r.y) for r in robots]).reshape(-1, 2)
    artists.append(axes.scatter(*xy.T, s=size, c=[_KINDS[r.kind][0] for r in robots], linewidths=0, zorder=4))
    tick = math.sqrt(size) * 0.13
    noses = [np.array([(r.x, r.y), (r.x + tick * math.cos(r.theta), r.y + tick * math.sin(r.theta))]) for r in robots]
    artists.append(axes.add_collection(LineCollection(noses, colors="black", linewidths=0.9, zorder=5)))
    if len(robots) <= _NAMED:
        for r in robots:
            artists.append(axes.annotate(r.name, (r.x, r.y), (5, 6), textcoords="offset points", fontsize=9, zorder=6))
    riding = len(rides)
    text = f"{title + ': ' if title else ''}{shown.time:.0f} s, {len(robots)} robots, {riding} riding"
    artists.append(axes.text(0.0, 1.01, text, transform=axes.transAxes, fontsize=11))
    return artists
