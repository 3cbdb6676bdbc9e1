"""How well and how honestly a robot knows where it is: a real robot's log, simulated routes, kidnapping.

The routes are those of all robots of the papers' worlds (``maps/p1*.world.yaml``) that have a goal, driven among boxes
and the other robots, which the map does not have (`experiments.drives`); sensors' noise differs from seed to seed, the
way does not.

NEES has 3 degrees of freedom, so 3 is expected. Estimates of one run hang together over seconds, therefore a run counts
as one sample: the 95 % band is that of N samples, chi-square with 3 N degrees of freedom by N (2.02 to 4.16 for 20
runs), although each run's value is the mean over moments 5 s apart.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import distance
from hitchhike_ros.core.parameters import load_parameters
from hitchhike_ros.experiments.bench.mrclam import evaluate, read_run
from hitchhike_ros.experiments.bench.registry import Findings, Options
from hitchhike_ros.experiments.scenarios.drives import Drive, Moment, record
from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.localization.ekf import mahalanobis_squared, pose_error
from hitchhike_ros.localization.localizer import Localizer, LocalizerParameters
from hitchhike_ros.localization.methods import Method, make_localizer
from hitchhike_ros.simulation.world_file import load_world

METHODS: tuple[Method, ...] = ("ekf", "particle")
# Standard deviations of the error of the first pose, as an operator gives it.
START_SIGMA = np.array([0.05, 0.05, 0.03])
# The first seconds are those in which that error vanishes.
_SETTLED = 20
_APART = 50
_KIDNAPPED_M = 5.0
# A kidnapped robot drives for 5 s before, and for as long as it takes to be 5 m away and 20 s after.
_KIDNAPPED_AT, _KIDNAP_SCANS = 50, 450
_BACK_WITHIN_M, _BACK_WITHIN_S, _STAYS_S = 0.3, 20.0, 2.0


@dataclass(frozen=True, eq=False)
class Track:
    """Scores of one run, by scan: errors (N, 3), NEES (N,), CPU time (N,) in s of the scan's update."""

    errors: FloatArray
    nees: FloatArray
    cpu_s: FloatArray


def follow(localizer: Localizer, moments: Sequence[Moment], seed: int, kidnapped: int | None = None) -> Track:
    """Localize over a stretch of a drive; after moment ``kidnapped`` the robot is elsewhere on its way.

    Kidnapping leaves out a stretch of the drive that leads 5 m away, and the odometry shows nothing of it.
    """
    order = list(range(len(moments)))
    if kidnapped is not None:
        before = moments[kidnapped].truth
        landed = next(k for k in order[kidnapped:] if distance(moments[k].truth, before) >= _KIDNAPPED_M)
        order = order[: kidnapped + 1] + order[landed:]
    rng, first = np.random.default_rng([seed, 2]), moments[0]
    start = np.array([first.truth.x, first.truth.y, first.truth.theta]) + START_SIGMA * rng.standard_normal(3)
    localizer.restart()
    localizer.initialise(
        PoseEstimate(first.odometry[-1].stamp, Pose2D(*start.tolist()), np.diag(np.square(START_SIGMA)))
    )
    errors, nees, cpu_s = [], [], []
    for i, k in enumerate(order):
        moment = moments[k]
        if i and k != order[i - 1] + 1:
            estimate = localizer.estimate
            localizer.restart()
            localizer.predict(moments[k - 1].odometry[-1])
            stamp = moments[k - 1].odometry[-1].stamp
            localizer.initialise(PoseEstimate(stamp, estimate.pose, estimate.covariance))
        for odometry in moment.odometry:
            localizer.predict(odometry)
        begun = time.process_time()
        localizer.update_scan(moment.scan)
        estimate = localizer.estimate_at(moment.scan.stamp)
        cpu_s.append(time.process_time() - begun)
        errors.append(pose_error(estimate.pose, moment.truth))
        nees.append(mahalanobis_squared(errors[-1], estimate.covariance))
    return Track(np.array(errors), np.array(nees), np.array(cpu_s))


def nees_band(runs: int) -> tuple[float, float]:
    """95 % band of the average NEES of a pose over ``runs`` independent samples."""
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    return float(low), float(high)


def back_after(errors: FloatArray, period_s: float = 0.1) -> float:
    """Seconds until the position is within 0.3 m and stays so for 2 s; infinite where it never is."""
    near = np.hypot(errors[:, 0], errors[:, 1]) <= _BACK_WITHIN_M
    stays = round(_STAYS_S / period_s)
    held = np.convolve(near, np.ones(stays), mode="valid") >= stays
    return float(np.argmax(held) * period_s) if held.any() else math.inf


def run(options: Options, progress: Progress) -> Findings:
    """All figures of localization."""
    figures = _mrclam(options, progress)
    worlds = {path.name.removesuffix(".world.yaml"): load_world(path) for path in sorted(_worlds(options.package))}
    routes = [(name, robot) for name, file in worlds.items() for robot, entry in file.robots.items() if entry.goal]
    routes = routes[:1] if options.quick else routes
    seeds = range(options.seed, options.seed + (2 if options.quick else 20))
    arrived, returns = 0, []
    cpu_s: dict[Method, list[FloatArray]] = {method: [] for method in METHODS}
    for number, (name, robot) in enumerate(routes):
        progress(f"{name}, {robot}: drive", number, len(routes))
        drive = record(worlds[name], robot, options.package, limit_s=45.0 if options.quick else 300.0)
        arrived += drive.arrived
        localizers = {method: _localizer(method, drive) for method in METHODS}
        tracks: dict[Method, list[Track]] = {method: [] for method in METHODS}
        for done, seed in enumerate(seeds):
            progress(f"{name}, {robot}: runs", done, len(seeds))
            moments = list(drive.moments(seed))
            for method in METHODS:
                tracks[method].append(follow(localizers[method], moments, seed))
            # One kidnapping a seed, spread over the routes and along the way.
            if seed % len(routes) == number:
                latest = max(len(moments) - _KIDNAP_SCANS, 0)
                begin = int(np.random.default_rng([seed, 3]).integers(latest + 1))
                track = follow(localizers["particle"], moments[begin : begin + _KIDNAP_SCANS], seed, _KIDNAPPED_AT)
                returns.append(back_after(track.errors[_KIDNAPPED_AT + 1 :]))
        for method in METHODS:
            figures += _accuracy(f"{name}, {robot}, {method}", tracks[method])
            cpu_s[method] += [track.cpu_s[_SETTLED:] for track in tracks[method]]
    for method in METHODS:
        median, peak = 1e3 * np.percentile(np.concatenate(cpu_s[method]), [50, 99])
        figures.append(Figure(f"{method}: CPU time of a scan, median", float(median), "ms", 20.0))
        figures.append(Figure(f"{method}: CPU time of a scan, 99 % of them below", float(peak), "ms"))
    if not options.quick:
        figures.append(Figure("drives that reached their goal untouched", arrived, "", len(routes), "higher"))
    back = sum(t <= _BACK_WITHIN_S for t in returns)
    figures.append(
        Figure("kidnapped by 5 m, particle: back to 0.3 m within 20 s", back, "", 0.9 * len(returns), "higher")
    )
    figures.append(Figure("kidnapped by 5 m, particle: median time to come back", float(np.median(returns)), "s"))
    return Findings(figures)


def _worlds(package: Path) -> Iterator[Path]:
    return (package / "maps").glob("p1*.world.yaml")


def _localizer(method: Method, drive: Drive) -> Localizer:
    parameters = load_parameters(LocalizerParameters, "localization", drive.config)
    return make_localizer(method, drive.grid, drive.markers, parameters, drive.T_base_laser)


def _mrclam(options: Options, progress: Progress) -> list[Figure]:
    """Peer of each is dead reckoning; no value where the data is missing."""
    folder, name = options.data / "mrclam", "MRCLAM robot 1, mean position error beside dead reckoning"
    cases = (("known", "known landmarks", 0.15), ("signature", "most likely by range, bearing, barcode", 0.25))
    more = (*cases, ("blind", "several hypotheses by range and bearing", 0.25))
    if not folder.is_dir():
        return [Figure(f"{name}: {text} (no data)", None, "m") for _, text, _ in more]
    progress("MRCLAM", 0, len(more))
    log = read_run(folder)
    lost = evaluate(log, "none").mean_position_error_m
    figures = []
    for done, (association, text, bound) in enumerate(more, 1):
        score = evaluate(log, association)  # type: ignore[arg-type]
        figures.append(Figure(f"{name}: {text}", score.mean_position_error_m, "m", bound, peer=lost))
        progress("MRCLAM", done, len(more))
    return figures


def _accuracy(what: str, tracks: Sequence[Track]) -> list[Figure]:
    errors = np.array([track.errors[_SETTLED:] for track in tracks])
    nees = float(np.mean([track.nees[_SETTLED::_APART] for track in tracks]))
    low, high = nees_band(len(tracks))
    position = math.sqrt(float((errors[:, :, :2] ** 2).sum(axis=2).mean()))
    heading = math.degrees(math.sqrt(float((errors[:, :, 2] ** 2).mean())))
    return [
        Figure(f"{what}: RMSE of the position", position, "m", 0.05),
        Figure(f"{what}: RMSE of the heading", heading, "deg", 1.0),
        Figure(f"{what}: average NEES, not above its 95 % band", nees, "", high),
        Figure(f"{what}: average NEES, not below its 95 % band", nees, "", low, "higher"),
    ]
