"""How well and how honestly a robot knows where it is: a real robot's log, simulated routes, kidnapping.

The routes are those of both robots of P17 Experiment 1, driven in the simulated world with its boxes and the other
robot, which the map does not have (`experiments.drives`); sensors' noise differs from seed to seed, the way does not.

NEES has 3 degrees of freedom, so 3 is expected. Estimates of one run hang together over seconds, therefore a run counts
as one sample: the 95 % band is that of N samples, chi-square with 3 N degrees of freedom by N (2.02 to 4.16 for 20
runs), although each run's value is the mean over moments 5 s apart.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from hitchhike_ros.datatypes import FloatArray, Pose2D, PoseEstimate
from hitchhike_ros.experiments.benchmark import Options, Progress
from hitchhike_ros.experiments.drives import Drive, record
from hitchhike_ros.experiments.figures import Figure
from hitchhike_ros.experiments.mrclam import evaluate, read_run
from hitchhike_ros.localization.ekf import mahalanobis_squared, pose_error
from hitchhike_ros.localization.localizer import LocalizerParameters
from hitchhike_ros.localization.methods import Method, make_localizer
from hitchhike_ros.parameters import load_parameters
from hitchhike_ros.simulation.world_file import load_world

METHODS: tuple[Method, ...] = ("ekf", "particle")
# Standard deviations of the error of the first pose, as an operator gives it.
START_SIGMA = np.array([0.05, 0.05, 0.03])
# The first seconds are those in which that error vanishes.
_SETTLED = 20
_APART = 50
_KIDNAPPED_M = 5.0
_BACK_WITHIN_M, _BACK_WITHIN_S, _STAYS_S = 0.3, 20.0, 2.0


@dataclass(frozen=True, eq=False)
class Track:
    """Scores of one run, by scan: errors (N, 3), NEES (N,), CPU time (N,) in s of the scan's update."""

    errors: FloatArray
    nees: FloatArray
    cpu_s: FloatArray


def follow(drive: Drive, method: Method, seed: int, shown: slice, kidnapped: int | None = None) -> Track:
    """Localize over the scans ``shown`` of a drive; after scan ``kidnapped`` the robot is elsewhere on its way.

    Kidnapping leaves out a stretch of the drive that leads 5 m away, and the odometry says nothing of it.
    """
    parameters = load_parameters(LocalizerParameters, "localization", drive.config)
    localizer = make_localizer(method, drive.grid, drive.markers, parameters, drive.T_base_laser)
    moments = list(drive.moments(seed))
    order = list(range(len(moments)))[shown]
    if kidnapped is not None:
        before = moments[order[kidnapped]].truth
        away = [math.hypot(moments[k].truth.x - before.x, moments[k].truth.y - before.y) for k in order]
        landed = next(k for k in range(kidnapped, len(order)) if away[k] >= _KIDNAPPED_M)
        order = order[: kidnapped + 1] + order[landed:]
    rng, first = np.random.default_rng([seed, 2]), moments[order[0]]
    start = np.array([first.truth.x, first.truth.y, first.truth.theta]) + START_SIGMA * rng.standard_normal(3)
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


def run(options: Options, progress: Progress) -> Sequence[Figure]:
    """All figures of localization."""
    figures = _mrclam(options, progress)
    world = load_world(options.package / "maps" / "p17_exp1.world.yaml")
    seeds = range(options.seed, options.seed + (2 if options.quick else 20))
    robots = ("p3dx",) if options.quick else ("p3dx", "turtlebot")
    drives = {}
    for done, robot in enumerate(robots):
        progress("drives through the world", done, len(robots))
        drives[robot] = record(world, robot, options.package, limit_s=45.0 if options.quick else 120.0)
    for robot, drive in drives.items():
        for method in METHODS:
            tracks = []
            for done, seed in enumerate(seeds):
                progress(f"{robot} by {method}", done, len(seeds))
                tracks.append(follow(drive, method, seed, slice(0, 250 if options.quick else None)))
            figures += _accuracy(f"{robot}, {method}", tracks)
    drive = drives["p3dx"]
    returns = []
    for done, seed in enumerate(seeds):
        progress("kidnapped", done, len(seeds))
        # Somewhere else on the way for each seed; the way goes on after it.
        begin = 60 + (seed * 37) % 120
        track = follow(drive, "particle", seed, slice(begin, begin + 350), kidnapped=50)
        returns.append(back_after(track.errors[51:]))
    figures.append(
        Figure(
            "kidnapped by 5 m, particle: runs back to 0.3 m within 20 s",
            sum(t <= _BACK_WITHIN_S for t in returns) / len(returns),
            "of runs",
            0.9,
            "higher",
        )
    )
    figures.append(Figure("kidnapped by 5 m, particle: median time to come back", float(np.median(returns)), "s"))
    return figures


def _mrclam(options: Options, progress: Progress) -> list[Figure]:
    """Peer of each is dead reckoning; no value where the data is missing."""
    folder, name = options.data / "mrclam", "MRCLAM robot 1: mean position error"
    cases = (("known", "known landmarks", 0.15), ("signature", "most likely by range, bearing, barcode", 0.25))
    more = (*cases, ("blind", "most likely by range and bearing", 0.25))
    if not folder.is_dir():
        return [Figure(f"{name}, {text} (no data)", None, "m") for _, text, _ in more]
    progress("MRCLAM", 0, len(more))
    log = read_run(folder)
    lost = evaluate(log, "none").mean_position_error_m
    figures = []
    for done, (association, text, bound) in enumerate(more, 1):
        score = evaluate(log, association)  # type: ignore[arg-type]
        figures.append(Figure(f"{name}, {text}", score.mean_position_error_m, "m", bound, peer=lost))
        progress("MRCLAM", done, len(more))
    return figures


def _accuracy(what: str, tracks: Sequence[Track]) -> list[Figure]:
    errors = np.array([track.errors[_SETTLED:] for track in tracks])
    nees = float(np.mean([track.nees[_SETTLED::_APART] for track in tracks]))
    low, high = nees_band(len(tracks))
    position = math.sqrt(float((errors[:, :, :2] ** 2).sum(axis=2).mean()))
    heading = math.degrees(math.sqrt(float((errors[:, :, 2] ** 2).mean())))
    cpu_ms = 1e3 * float(np.median([track.cpu_s[_SETTLED:] for track in tracks]))
    return [
        Figure(f"{what}: RMSE of the position", position, "m", 0.05),
        Figure(f"{what}: RMSE of the heading", heading, "deg", 1.0),
        Figure(f"{what}: average NEES, not above its 95 % band", nees, "", high),
        Figure(f"{what}: average NEES, not below its 95 % band", nees, "", low, "higher"),
        Figure(f"{what}: CPU time of a scan, median", cpu_ms, "ms", 20.0),
    ]
