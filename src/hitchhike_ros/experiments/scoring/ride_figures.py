"""How a ride is scored: times from the status of both robots, errors against ground truth, boxes against the world.

Times are simulated seconds, as P17 Table 2 counts them:

    wait                first ``requesting`` of the hitchhiker to the driver's ``offering``
    couple              the driver starts ``aligning`` to the hitchhiker's ``riding``
    decouple            the driver starts ``decoupling`` to the hitchhiker's return to its own navigation
    driver delay        couple + decouple
    hitchhiker delay    driver delay + wait

Errors on the way are taken from ``riding`` to ``decoupling``, pulling away and stopping included.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Obstacle, Pose2D
from hitchhike_ros.core.geometry import compose, distance, path_length, wrap_angle
from hitchhike_ros.experiments.scenarios.ride_record import (
    ClockSample,
    CpuSample,
    RideRecord,
    RobotRecord,
    TimedEstimate,
    TimedPose,
)
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.protocol.status import ModuleSwitches, Status

# Bounds of a ride in simulation.
MAX_COUPLE_S, MAX_DECOUPLE_S = 15.0, 17.0
MAX_GAP_RMS_M = 0.10
MAX_BOX_ERROR_M = 0.10
MAX_HANDOVER_M, MAX_HANDOVER_DEG, MAX_HANDOVER_SIGMA = 0.15, 5.0, 3.0
MIN_REAL_TIME_FACTOR = 0.5
MAX_RIDE_DEVIATION_PERCENT = 2.0

# A found box belongs to a true one when their centres are nearer than this (chosen: less than any two boxes' distance).
_BOX_MATCH_M = 0.5
# Trails are thinned to steps of this length, so that a robot that stands neither adds metres nor counts more (chosen).
_TRAIL_STEP_M = 0.05


@dataclass(frozen=True)
class PaperTimes:
    """A row of P17 Table 2, in seconds."""

    couple_s: float
    decouple_s: float
    wait_s: float
    driver_delay_s: float
    hitchhiker_delay_s: float


@dataclass(frozen=True)
class PaperRide:
    """Ride and award of one of P17's experiments."""

    ride_m: float
    points: float


# P17 Table 2, by world and whether there are new boxes.
PAPER_TIMES = {
    ("p17_exp1", False): PaperTimes(15.00, 17.67, 19.33, 32.67, 52.00),
    ("p17_exp1", True): PaperTimes(15.33, 22.00, 21.67, 37.33, 59.00),
    ("p17_exp2", False): PaperTimes(33.00, 19.00, 11.33, 52.00, 63.33),
    ("p17_exp2", True): PaperTimes(35.00, 21.67, 10.67, 56.67, 67.33),
}
PAPER_RIDES = {"p17_exp1": PaperRide(20.4, 8.2), "p17_exp2": PaperRide(28.82, 11.5)}


@dataclass(frozen=True)
class Ride:
    """Who rode with whom, and when each step began; None where it was not reached."""

    hitchhiker: str
    driver: str | None = None
    requested_at: float | None = None
    offered_at: float | None = None
    aligning_at: float | None = None
    riding_at: float | None = None
    decoupling_at: float | None = None
    released_at: float | None = None

    @property
    def wait_s(self) -> float | None:
        return _difference(self.offered_at, self.requested_at)

    @property
    def couple_s(self) -> float | None:
        return _difference(self.riding_at, self.aligning_at)

    @property
    def decouple_s(self) -> float | None:
        return _difference(self.released_at, self.decoupling_at)

    @property
    def driver_delay_s(self) -> float | None:
        return _sum(self.couple_s, self.decouple_s)

    @property
    def hitchhiker_delay_s(self) -> float | None:
        return _sum(self.driver_delay_s, self.wait_s)


@dataclass(frozen=True)
class BoxMatch:
    """A true box beside the one in the hitchhiker's map, None where it has none there.

    ``place_m`` is the distance of the centres, ``size_m`` the larger of both differences of width and breadth.
    """

    true: Obstacle
    found: Obstacle | None
    place_m: float | None = None
    size_m: float | None = None


@dataclass(frozen=True)
class CpuUse:
    """CPU seconds that one node used in some time, and how long that was on both clocks."""

    cpu_s: float
    sim_s: float
    wall_s: float


@dataclass(frozen=True)
class NodeCost:
    """CPU of one node: in all, and in those phases of the run (see :func:`phases`) that have samples."""

    node: str
    cpu_s: float
    memory_mb: float
    phases: dict[str, CpuUse]


@dataclass(frozen=True)
class ModuleChange:
    """From ``stamp`` on these modules of the robot are on."""

    stamp: float
    robot: str
    state: str
    modules: ModuleSwitches


def find_ride(record: RideRecord) -> Ride | None:
    """The first ride that was coupled, else the newest that was asked for, None when nobody asked."""
    rides = find_rides(record)
    return next((ride for ride in rides if ride.riding_at is not None), rides[-1] if rides else None)


def find_rides(record: RideRecord) -> list[Ride]:
    """Every ride that was coupled, and of each robot what it asked for last; by robot, then in order of time."""
    found: list[Ride] = []
    for name, robot in record.robots.items():
        asked_at: float | None = None
        asked: Ride | None = None
        coupled: set[str] = set()
        for i, status in enumerate(robot.statuses):
            if status.role != "hitchhiker":
                asked_at = None
                continue
            asked_at = status.time_stamp if asked_at is None else asked_at
            if status.ride is not None and status.ride.ride_id in coupled:
                continue
            asked = _ride_of(record, name, asked_at, robot.statuses[i:])
            if asked.riding_at is not None and status.ride is not None:
                coupled.add(status.ride.ride_id)
                found.append(asked)
                asked = None
        if asked is not None:
            found.append(asked)
    return found


def _ride_of(record: RideRecord, hitchhiker: str, asked_at: float, statuses: Sequence[Status]) -> Ride:
    """The ride that the first of the hitchhiker's ``statuses`` is about."""
    ride = statuses[0].ride
    if ride is None or ride.driver not in record.robots:
        return Ride(hitchhiker, requested_at=asked_at)
    driven = [
        s
        for s in record.robots[ride.driver].statuses
        if hitchhiker in s.convoy or (s.ride is not None and s.ride.ride_id == ride.ride_id)
    ]
    riding_at = statuses[0].time_stamp if statuses[0].state == "riding" else None
    on_board = ("riding", "seeking", "locating", "catching_up", "recoupling", "parting", "settling", "relocalizing")
    released = (s.time_stamp for s in statuses if s.role != "hitchhiker" or s.state not in on_board)
    return Ride(
        hitchhiker=hitchhiker,
        driver=ride.driver,
        requested_at=asked_at,
        offered_at=_first(driven, "offering", "aligning"),
        aligning_at=_first(driven, "aligning", "aligned"),
        riding_at=riding_at,
        decoupling_at=_decoupling(driven, _first(statuses, "settling")),
        released_at=next(released, None) if riding_at is not None else None,
    )


def _decoupling(driven: Sequence[Status], settled_at: float | None) -> float | None:
    """When the driver began to hand over to the one that settled; in a convoy others may have left before.

    Which of the two is stamped first is not asked: robots' stamps may be a tick of the clock apart.
    """
    began = [s.time_stamp for s in driven if s.state == "decoupling"]
    return min(began, key=lambda stamp: abs(stamp - settled_at) if settled_at is not None else stamp, default=None)


def ride_figures(record: RideRecord) -> list[Figure]:
    """Every figure of the run; those of steps that were not reached have no value."""
    ride = find_ride(record)
    return [
        *time_figures(record, ride),
        *distance_figures(record, ride),
        *following_figures(record, ride),
        *handover_figures(record, ride),
        *box_figures(record, ride),
        *run_figures(record, ride),
    ]


def time_figures(record: RideRecord, ride: Ride | None) -> list[Figure]:
    """The columns of P17 Table 2, beside the paper's where it has the experiment."""
    ours, theirs = ride or Ride(""), PAPER_TIMES.get((record.scenario, bool(record.true_boxes)))
    bounds = {"couple": MAX_COUPLE_S, "decouple": MAX_DECOUPLE_S}
    return [
        Figure(name, getattr(ours, f"{name}_s"), "s", bounds.get(name), peer=getattr(theirs, f"{name}_s", None))
        for name in ("couple", "decouple", "wait", "driver_delay", "hitchhiker_delay")
    ]


def distance_figures(record: RideRecord, ride: Ride | None) -> list[Figure]:
    """Metres that the driver drove with its rider, by ground truth, and the points it got for them."""
    paper = PAPER_RIDES.get(record.scenario)
    ridden, points = None, None
    window = _window(ride)
    if ride is not None and ride.driver is not None:
        driver = record.robots[ride.driver]
        if window is not None:
            ridden = metres_driven(driver, window)
        if driver.awards:
            points = driver.awards[-1].points
    figures = [
        Figure("ride", ridden, "m", better="higher", peer=paper.ride_m if paper else None),
        Figure("award", points, "points", better="higher", peer=paper.points if paper else None),
    ]
    if paper is not None:
        for name, value, expected in (("ride", ridden, paper.ride_m), ("award", points, paper.points)):
            deviation = None if value is None else 100.0 * abs(value / expected - 1.0)
            figures.append(Figure(f"{name}_deviation", deviation, "%", MAX_RIDE_DEVIATION_PERCENT))
    return figures


def following_figures(record: RideRecord, ride: Ride | None) -> list[Figure]:
    """How well the hitchhiker keeps its distance and its driver's trail, and how well the driver knows its place.

    The gap is from camera to marker along the line between them; the lateral error is the hitchhiker's distance from
    the trail that the driver has left since coupling.
    """
    gap, lateral, localization = (np.empty(0) for _ in range(3))
    window = _window(ride)
    if window is not None and ride is not None and ride.driver is not None:
        driver, hitchhiker = record.robots[ride.driver], record.robots[ride.hitchhiker]
        gap = gap_errors(driver, hitchhiker, window)
        trail = _thinned(_cut(_track(driver.truth), window)[:, 1:3])
        lateral = distances_from_trail(_thinned(_cut(_track(hitchhiker.truth), window)[:, 1:3]), trail)
        estimates = _cut(_track(driver.estimates), window)
        localization = np.linalg.norm((estimates[:, 1:] - poses_at(driver.truth, estimates[:, 0]))[:, :2], axis=1)
    return [
        Figure("gap_error_rms", _rms(gap), "m", MAX_GAP_RMS_M),
        Figure("gap_error_max", _max(gap), "m"),
        Figure("lateral_error_rms", _rms(lateral), "m"),
        Figure("lateral_error_max", _max(lateral), "m"),
        Figure("driver_pose_error_rms", _rms(localization), "m"),
    ]


def handover_figures(record: RideRecord, ride: Ride | None) -> list[Figure]:
    """The pose that the hitchhiker took over against where it stood, also in units of its own covariance."""
    place, heading, sigmas, taken = None, None, None, None
    if ride is not None and ride.riding_at is not None:
        since = ride.riding_at
        taken = next((p for p in record.robots[ride.hitchhiker].initial_poses if p.stamp > since), None)
    if taken is not None and ride is not None:
        place, heading, sigmas = handover_error(record.robots[ride.hitchhiker], taken)
    return [
        Figure("handover_position_error", place, "m", MAX_HANDOVER_M),
        Figure("handover_heading_error", heading, "deg", MAX_HANDOVER_DEG),
        Figure("handover_mahalanobis", sigmas, "sigma", MAX_HANDOVER_SIGMA),
    ]


def box_figures(record: RideRecord, ride: Ride | None) -> list[Figure]:
    """The new boxes in the hitchhiker's map, at the end, beside those of the world."""
    found = record.robots[ride.hitchhiker].obstacles if ride is not None else ()
    matches = match_boxes(record.true_boxes, found)
    matched = [m for m in matches if m.found is not None]
    figures = [Figure("false_boxes", float(len(found) - len(matched)), "", 0.0)]
    if record.true_boxes:
        count = float(len(record.true_boxes))
        figures = [
            Figure("boxes_found", float(len(matched)), "", count, "higher", count),
            *figures,
            Figure("box_place_error", _max([m.place_m for m in matched]), "m", MAX_BOX_ERROR_M),
            Figure("box_size_error", _max([m.size_m for m in matched]), "m", MAX_BOX_ERROR_M),
        ]
    return figures


def run_figures(record: RideRecord, ride: Ride | None) -> list[Figure]:
    """Contacts, speed of the simulation, and what the hitchhiker's modules cost on the ride and alone."""
    figures = [
        Figure("contacts", float(len(record.contacts)), "", 0.0),
        Figure("real_time_factor", real_time_factor(record, ride), "", MIN_REAL_TIME_FACTOR, "higher"),
    ]
    for phase in ("riding", "alone"):
        uses = [
            cost.phases[phase]
            for cost in node_costs(record, ride)
            if ride is not None and cost.node.startswith(f"/{ride.hitchhiker}/") and phase in cost.phases
        ]
        # CPU seconds per simulated second, all nodes of the hitchhiker together.
        share = sum(use.cpu_s / use.sim_s for use in uses) if uses else None
        figures.append(Figure(f"hitchhiker_cpu_{phase}", share, "s/s"))
    return figures


def gap_errors(driver: RobotRecord, hitchhiker: RobotRecord, window: tuple[float, float]) -> FloatArray:
    """True distance from camera to marker minus the gap that was ordered, (N,) m, at the hitchhiker's truths."""
    track = _cut(_track(hitchhiker.truth), window)
    order = next((s.servo.gap_m for s in hitchhiker.statuses if s.state == "riding" and s.servo is not None), None)
    if order is None or not driver.truth:
        return np.empty(0)
    camera = _mounted(track[:, 1:], hitchhiker.camera)
    marker = _mounted(poses_at(driver.truth, track[:, 0]), driver.marker)
    return np.linalg.norm(marker - camera, axis=1) - order


def metres_driven(robot: RobotRecord, window: tuple[float, float]) -> float:
    """How far the robot truly went."""
    return path_length(_thinned(_cut(_track(robot.truth), window)[:, 1:3]))


def handover_error(robot: RobotRecord, taken: TimedEstimate) -> tuple[float | None, float | None, float | None]:
    """A pose that the robot took over against where it was: m, degrees, and in units of its own covariance."""
    if not robot.truth:
        return None, None, None
    error = np.array([taken.x, taken.y, taken.theta]) - poses_at(robot.truth, np.array([taken.stamp]))[0]
    error[2] = wrap_angle(error[2])
    place, heading = float(np.hypot(error[0], error[1])), float(np.degrees(abs(error[2])))
    return place, heading, mahalanobis(error, np.array(taken.sigma))


def gap_now(record: RideRecord, ride: Ride) -> float | None:
    """The newest true distance from the hitchhiker's camera to the driver's marker in m."""
    if ride.driver is None:
        return None
    driver, hitchhiker = record.robots[ride.driver], record.robots[ride.hitchhiker]
    if not driver.truth or not hitchhiker.truth:
        return None
    camera = compose(hitchhiker.truth[-1].pose, hitchhiker.camera)
    return distance(camera, compose(driver.truth[-1].pose, driver.marker))


def distances_from_trail(points: FloatArray, trail: FloatArray) -> FloatArray:
    """Distance in m of each of points (N, 2) from the polyline trail (M, 2), without the points before its start."""
    if len(trail) < 2:
        return np.empty(0)
    start, along = trail[:-1], np.diff(trail, axis=0)
    offset = points[:, None, :] - start  # (N, M - 1, 2)
    fraction = np.einsum("nmk,mk->nm", offset, along) / np.einsum("mk,mk->m", along, along)
    before = (np.argmin(np.linalg.norm(offset, axis=2), axis=1) == 0) & (fraction[:, 0] < 0.0)
    nearest = start + np.clip(fraction, 0.0, 1.0)[:, :, None] * along
    distances = np.linalg.norm(points[:, None, :] - nearest, axis=2).min(axis=1)
    return distances[~before]


def mahalanobis(error: FloatArray, covariance: FloatArray) -> float | None:
    """sqrt(eᵀ Σ⁻¹ e) of an error (n,), None where Σ (n, n) is not positive definite."""
    try:
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), error)
    except np.linalg.LinAlgError:
        return None
    return float(np.linalg.norm(whitened))


def match_boxes(true: Iterable[Obstacle], found: Iterable[Obstacle]) -> list[BoxMatch]:
    """Each true box with the found one whose centre is nearest, nearest pairs first; no box is used twice."""
    true, found = list(true), list(found)
    pairs = sorted(
        (float(np.linalg.norm(_centre(t) - _centre(f))), i, j) for i, t in enumerate(true) for j, f in enumerate(found)
    )
    partner: dict[int, tuple[int, float]] = {}
    for off, i, j in pairs:
        if off <= _BOX_MATCH_M and i not in partner and j not in {other for other, _ in partner.values()}:
            partner[i] = (j, off)
    matches = []
    for i, box in enumerate(true):
        if i not in partner:
            matches.append(BoxMatch(box, None))
            continue
        j, off = partner[i]
        size = max(abs(box.w - found[j].w), abs(box.b - found[j].b))
        matches.append(BoxMatch(box, found[j], off, size))
    return matches


def real_time_factor(record: RideRecord, ride: Ride | None) -> float | None:
    """Simulated by wall seconds, from the request (or else from the start) to the end."""
    since = ride.requested_at if ride is not None else None
    clock = [c for c in record.clock if since is None or c.stamp >= since]
    if len(clock) < 2 or clock[-1].wall_s <= clock[0].wall_s:
        return None
    return (clock[-1].stamp - clock[0].stamp) / (clock[-1].wall_s - clock[0].wall_s)


def phases(record: RideRecord, ride: Ride | None) -> dict[str, tuple[float, float]]:
    """From when to when: ``coupling`` (request to riding), ``riding``, and ``alone`` (the hitchhiker, afterwards)."""
    if ride is None:
        return {}
    end = record.clock[-1].stamp if record.clock else None
    ends = {
        "coupling": (ride.requested_at, ride.riding_at),
        "riding": (ride.riding_at, ride.decoupling_at),
        "alone": (ride.released_at, end),
    }
    return {name: (a, b) for name, (a, b) in ends.items() if a is not None and b is not None and b > a}


def node_costs(record: RideRecord, ride: Ride | None) -> list[NodeCost]:
    """CPU of every node, those of one robot together."""
    costs = []
    for node in sorted({sample.node for sample in record.cpu}):
        samples = [sample for sample in record.cpu if sample.node == node]
        uses = {name: cpu_use(samples, record.clock, window) for name, window in phases(record, ride).items()}
        known = {name: use for name, use in uses.items() if use is not None}
        costs.append(NodeCost(node, samples[-1].cpu_s, max(s.memory_mb for s in samples), known))
    return costs


def cpu_use(samples: Sequence[CpuSample], clock: Sequence[ClockSample], window: tuple[float, float]) -> CpuUse | None:
    """CPU seconds between two simulated times, interpolated between samples; None where samples do not reach."""
    start, end = max(window[0], samples[0].stamp), min(window[1], samples[-1].stamp)
    if end <= start or not clock:
        return None
    used = np.interp([start, end], [s.stamp for s in samples], [s.cpu_s for s in samples])
    wall = np.interp([start, end], [c.stamp for c in clock], [c.wall_s for c in clock])
    return CpuUse(float(used[1] - used[0]), end - start, float(wall[1] - wall[0]))


def module_changes(record: RideRecord) -> list[ModuleChange]:
    """Which modules were on over time, all robots in order of time (P17 Table 3)."""
    changes = []
    for name, robot in record.robots.items():
        last: ModuleSwitches | None = None
        for status in robot.statuses:
            if status.modules != last:
                changes.append(ModuleChange(status.time_stamp, name, status.state, status.modules))
            last = status.modules
    return sorted(changes, key=lambda change: change.stamp)


def poses_at(truth: Sequence[TimedPose], stamps: FloatArray) -> FloatArray:
    """Poses (N, 3) at the times (N,), interpolated, theta unwrapped."""
    track = _track(truth)
    return np.column_stack([np.interp(stamps, track[:, 0], track[:, k]) for k in (1, 2, 3)])


def _track(poses: Sequence[TimedPose]) -> FloatArray:
    """(N, 4): stamp, x, y, theta unwrapped; in order of time."""
    track = np.array([(p.stamp, p.x, p.y, p.theta) for p in poses], dtype=float).reshape(-1, 4)
    track = track[np.argsort(track[:, 0], kind="stable")]
    track[:, 3] = np.unwrap(track[:, 3])
    return track


def _cut(track: FloatArray, window: tuple[float, float]) -> FloatArray:
    return track[(track[:, 0] >= window[0]) & (track[:, 0] <= window[1])]


def _thinned(points: FloatArray) -> FloatArray:
    """Of points (N, 2) those that are a step from the one kept before, and the last."""
    kept: list[FloatArray] = []
    for point in points:
        if not kept or np.hypot(*(point - kept[-1])) >= _TRAIL_STEP_M:
            kept.append(point)
    if len(points) and not np.array_equal(kept[-1], points[-1]):
        kept.append(points[-1])
    return np.array(kept).reshape(-1, 2)


def _mounted(poses: FloatArray, mount: Pose2D) -> FloatArray:
    """Position (N, 2) in ``map`` of something mounted on a robot at poses (N, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return poses[:, :2] + np.column_stack([c * mount.x - s * mount.y, s * mount.x + c * mount.y])


def _window(ride: Ride | None) -> tuple[float, float] | None:
    if ride is None or ride.riding_at is None or ride.decoupling_at is None:
        return None
    return ride.riding_at, ride.decoupling_at


def _centre(box: Obstacle) -> FloatArray:
    return np.array([box.x + box.w / 2, box.y + box.b / 2])


def _first(statuses: Iterable[Status], *states: str) -> float | None:
    return next((s.time_stamp for s in statuses if s.state in states), None)


def _difference(later: float | None, earlier: float | None) -> float | None:
    return None if later is None or earlier is None else later - earlier


def _sum(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a + b


def _rms(errors: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(np.square(errors)))) if errors.size else None


def _max(errors: object) -> float | None:
    values = np.abs(np.asarray(errors, dtype=float))
    return float(values.max()) if values.size else None
