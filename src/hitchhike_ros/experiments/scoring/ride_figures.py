"""The figures of a ride: times from the status of both robots, errors against ground truth, boxes against the world.

Times are those of :mod:`rides`. Errors on the way are taken from ``riding`` to ``decoupling``, pulling away and
stopping included.
"""

from __future__ import annotations

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.experiments.scenarios.paper import PAPER_RIDES, PAPER_TIMES
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.experiments.scoring.boxes import match_boxes
from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.node_costs import node_costs, real_time_factor
from hitchhike_ros.experiments.scoring.rides import Ride, find_ride
from hitchhike_ros.experiments.scoring.tracks import (
    distances_from_trail,
    gap_errors,
    handover_error,
    metres_driven,
    poses_at,
    track_of,
    trail_of,
)

# Bounds of a ride in simulation.
MAX_COUPLE_S, MAX_DECOUPLE_S = 15.0, 17.0
MAX_GAP_RMS_M = 0.10
MAX_BOX_ERROR_M = 0.10
MAX_HANDOVER_M, MAX_HANDOVER_DEG, MAX_HANDOVER_SIGMA = 0.15, 5.0, 3.0
MIN_REAL_TIME_FACTOR = 0.5
MAX_RIDE_DEVIATION_PERCENT = 2.0


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
    if ride is not None and ride.driver is not None:
        driver = record.robots[ride.driver]
        if ride.window is not None:
            ridden = metres_driven(driver, ride.window)
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
    if ride is not None and ride.window is not None and ride.driver is not None:
        window = ride.window
        driver, hitchhiker = record.robots[ride.driver], record.robots[ride.hitchhiker]
        gap = gap_errors(driver, hitchhiker, window)
        lateral = distances_from_trail(trail_of(hitchhiker.truth, window), trail_of(driver.truth, window))
        estimates = track_of(driver.estimates, window)
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


def _rms(errors: FloatArray) -> float | None:
    return float(np.sqrt(np.mean(np.square(errors)))) if errors.size else None


def _max(errors: object) -> float | None:
    values = np.abs(np.asarray(errors, dtype=float))
    return float(values.max()) if values.size else None
