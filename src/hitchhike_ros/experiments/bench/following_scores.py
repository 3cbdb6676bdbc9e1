"""Rides along the courses of :mod:`following_rides`, driven and scored against ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hitchhike_ros.core.datatypes import PoseEstimate
from hitchhike_ros.core.geometry import path_length
from hitchhike_ros.experiments.scenarios.composed_record import ComposedRecorder
from hitchhike_ros.experiments.scenarios.following_rides import DRIVER, RIDER, SIGMA, Course, build, changes_of
from hitchhike_ros.experiments.scenarios.ride_record import RideRecord
from hitchhike_ros.experiments.scoring.rides import find_ride
from hitchhike_ros.experiments.scoring.tracks import distances_from_trail, gap_errors, track_of, trail_of
from hitchhike_ros.simulation.composed import ComposedRide
from hitchhike_ros.simulation.physics.world import World


@dataclass(frozen=True)
class RideResult:
    """One ride, by ground truth, from coupling to the driver's stop at the end."""

    seed: int
    end: str
    ridden_m: float
    gap_rms_m: float | None
    lateral_rms_m: float | None
    lateral_max_m: float | None
    lost: int
    contacts: tuple[str, ...]

    @property
    def completed(self) -> bool:
        """Whether the pair rode to the end and the pose was handed over."""
        return self.end == "" and self.gap_rms_m is not None


def ride(package: Path, course: Course, seed: int) -> RideResult:
    """One ride along a course, until it ends."""
    with World(build(course, package, seed), seed, package=package) as world:
        composed = ComposedRide(world, package, changes=changes_of(course))
        recorder = ComposedRecorder(composed, seed)
        starts = {name: PoseEstimate(0.0, entry.start, SIGMA) for name, entry in world.file.robots.items()}
        composed.start(starts, course.doors)
        recorder.run_ride(RIDER, course.limit_s)
        return score_ride(recorder.record, seed, composed.robots[RIDER].status.reason)


def score_ride(record: RideRecord, seed: int, end: str) -> RideResult:
    """Errors from coupling to decoupling; a ride that does not come so far has none."""
    found = find_ride(record)
    contacts = tuple(map(str, record.contacts))
    lost = sum(status.state == "seeking" for status in record.robots[RIDER].statuses)
    if found is None or found.window is None:
        return RideResult(seed, end or "no ride", 0.0, None, None, None, lost, contacts)
    driver, rider, window = record.robots[DRIVER], record.robots[RIDER], found.window
    gap, driven = gap_errors(driver, rider, window), trail_of(driver.truth, window)
    lateral = distances_from_trail(track_of(rider.truth, window)[:, 1:3], driven)
    rms = float(np.sqrt(np.mean(np.square(lateral))))
    return RideResult(
        seed, end, path_length(driven), float(np.sqrt(np.mean(gap**2))), rms, float(lateral.max()), lost, contacts
    )
