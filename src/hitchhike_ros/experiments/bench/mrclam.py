"""The papers' filter on a real robot: UTIAS MRCLAM, one robot that sees barcodes at surveyed places.

Leung, Halpern, Barfoot, Liu: The UTIAS multi-robot cooperative localization and mapping dataset, IJRR 30(8), 2011. The
ground truth gives the first pose and scores the others; nothing is fitted to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, Pose2D, Positive, Twist2D
from hitchhike_ros.core.errors import InputFileError
from hitchhike_ros.core.geometry import move, wrap_angle
from hitchhike_ros.experiments.bench.hypotheses import Hypotheses, HypothesesParameters
from hitchhike_ros.localization.ekf import Ekf, EkfParameters, LandmarkObservation, Landmarks
from hitchhike_ros.localization.motion import MotionNoise

Association = Literal["none", "known", "signature", "blind"]

# Subjects 1-5 are robots, the others landmarks (Barcodes.dat).
_FIRST_LANDMARK = 6
# Chi-square quantiles at 95 %, as is usual for association (Neira and Tardos, 2001), for range and bearing alone and
# with a signature.
_GATE_2, _GATE_3 = 5.99, 7.81
# Sightings in one picture are stamped within a millisecond or two of each other; pictures are 0.1 s and more apart.
_SAME_PICTURE_S = 0.005


@dataclass(frozen=True)
class MrclamParameters:
    """Noise in round numbers, chosen from what kind of robot and camera these are.

    The odometry of this dataset is commanded velocities: within each second they are off by a tenth (v) and a fifth
    (omega) of themselves, and the robot turns a little while it drives straight. A barcode a few pixels wide gives its
    range to some percent and its bearing to some pixels of a wide image. Noise between half and twice as large changes
    the errors by a few centimetres where barcodes are read.

    Without barcodes, one false sighting (of another robot, say) is expected in two pictures, each of 1 rad and 8 m, and
    pictures within ``look_s`` share one look's information, because their errors are alike (chosen). Sightings 0.7 to
    1.5 times as noisy do not matter then either, at gates of 90 to 99.9 %. Odometry 1.5 times as noisy does at 99 % and
    beyond: a robot that drives ahead for twenty seconds is then taken for a landmark, and the filter is lost for a
    minute.
    """

    motion: MotionNoise = field(
        default_factory=lambda: MotionNoise(alpha_1=0.01, alpha_2=0.0001, alpha_3=0.04, alpha_4=0.04, period_s=1.0)
    )
    range_sigma_m: Positive = 0.05
    range_sigma_ratio: Positive = 0.05  # grows with the range, in quadrature
    bearing_sigma_rad: Positive = 0.03
    signature_sigma: Positive = 0.1  # barcodes are whole numbers: another one is never the same landmark
    gate: Positive = _GATE_3
    blind_gate: Positive = _GATE_2
    clutter_density: Positive = 0.5 / (8.0 * 1.0)
    look_s: Positive = 2.0
    max_hold_s: Positive = 2.0  # a velocity is taken to last until the next reading, but no longer


@dataclass(frozen=True, eq=False)
class MrclamRun:
    """One robot's log. Times in s.

    ``odometry`` (N, 3): time, v, omega. ``measurements`` (M, 4): time, barcode, range in m, bearing in rad. ``truth``
    (K, 4): time, x, y, theta. ``landmarks`` in the frame of the truth, whose signature is their barcode.
    """

    odometry: FloatArray
    measurements: FloatArray
    truth: FloatArray
    landmarks: Landmarks


@dataclass(frozen=True, eq=False)
class MrclamScore:
    """Errors (K, 3) in m and rad at the times of the truth, and how many of the measurements were used."""

    errors: FloatArray
    used: int
    seen: int

    @property
    def mean_position_error_m(self) -> float:
        """Mean distance from the truth."""
        return float(np.hypot(self.errors[:, 0], self.errors[:, 1]).mean())


def read_run(folder: Path, robot: int = 1) -> MrclamRun:
    """One robot's files of a dataset.

    Raises:
        InputFileError: a file is missing or is no table.
    """
    barcodes, landmarks = _table(folder / "Barcodes.dat", 2), _table(folder / "Landmark_Groundtruth.dat", 5)
    barcode_of = {int(subject): barcode for subject, barcode in barcodes if subject >= _FIRST_LANDMARK}
    signatures = np.array([barcode_of[int(subject)] for subject in landmarks[:, 0]])
    return MrclamRun(
        _table(folder / f"Robot{robot}_Odometry.dat", 3),
        _table(folder / f"Robot{robot}_Measurement.dat", 4),
        _table(folder / f"Robot{robot}_Groundtruth.dat", 4),
        Landmarks(landmarks[:, 1:3], signatures),
    )


def evaluate(run: MrclamRun, association: Association, parameters: MrclamParameters | None = None) -> MrclamScore:
    """Run the filter over the log and score it wherever there is ground truth.

    Args:
        run: the log.
        association: ``known`` takes the barcode for the landmark's name and leaves out barcodes that no landmark has.
            ``signature`` gives every measurement, of robots and of misread barcodes too, to the most likely landmark
            by range, bearing and barcode (P18 Eqs. 14-18), or to none outside the gate. ``blind`` knows range and
            bearing alone and follows several hypotheses. ``none`` is dead reckoning.
        parameters: noise and gate.
    """
    p = parameters or MrclamParameters()
    truth = run.truth[run.truth[:, 0] >= run.odometry[0, 0]]
    index_of = {int(barcode): k for k, barcode in enumerate(run.landmarks.signatures)}
    pose, covariance = Pose2D(*truth[0, 1:]), np.eye(3) * 1e-4
    estimator: Ekf | Hypotheses = (
        Hypotheses(pose, covariance, HypothesesParameters(p.motion, p.clutter_density, p.blind_gate))
        if association == "blind"
        else Ekf(pose, covariance, EkfParameters(p.motion, p.gate))
    )
    # Times at which the velocity changes, a picture is taken or the truth is known, in this order at one moment.
    changes = np.flatnonzero(np.abs(np.diff(run.odometry[:, 1:], axis=0, prepend=np.nan)).sum(axis=1) != 0.0)
    gaps = np.flatnonzero(np.diff(run.odometry[:, 0]) > p.max_hold_s)
    stops = np.column_stack([run.odometry[gaps, 0] + p.max_hold_s, np.zeros((len(gaps), 2))])
    events = [
        *((row[0], 0, row) for row in (*run.odometry[changes], *stops)),
        *((picture[-1, 0], 1, picture) for picture in _pictures(run.measurements)),
        *((row[0], 2, row) for row in truth),
    ]
    now = float(truth[0, 0])
    started = run.odometry[run.odometry[:, 0] <= now][-1]
    twist = Twist2D(started[1], started[2])
    errors, used, seen, looked = [], 0, 0, -math.inf
    for stamp, kind, row in sorted((e for e in events if now <= e[0] <= truth[-1, 0]), key=lambda e: e[:2]):
        dt = stamp - now
        if kind == 2:
            pose = move(estimator.pose, twist, dt)
            errors.append((pose.x - row[1], pose.y - row[2], wrap_angle(pose.theta - row[3])))
            continue
        if dt > 0.0:
            estimator.predict(twist, dt)
        now = stamp
        if kind == 0:
            twist = Twist2D(row[1], row[2])
        elif association != "none":
            picture = [_observation(sighting, p) for sighting in row]
            seen += len(picture)
            if isinstance(estimator, Hypotheses):
                share, looked = min(1.0, (stamp - looked) / p.look_s), stamp
                given = estimator.correct(picture, run.landmarks.positions, share)
                used += sum(index is not None for index in given)
                continue
            for observation in picture:
                index = index_of.get(int(observation.signature)) if association == "known" else None
                if index is not None or association != "known":
                    used += estimator.update_landmark(observation, run.landmarks, index) is not None
    return MrclamScore(np.array(errors), used, seen)


def _pictures(measurements: FloatArray) -> list[FloatArray]:
    """The measurements (M, 4), rising in time, of one picture each (K, 4)."""
    return np.split(measurements, np.flatnonzero(np.diff(measurements[:, 0]) > _SAME_PICTURE_S) + 1)


def _observation(sighting: FloatArray, p: MrclamParameters) -> LandmarkObservation:
    """One row of the measurements, with its noise."""
    _, barcode, range_m, bearing_rad = sighting.tolist()
    range_sigma_m = math.hypot(p.range_sigma_m, p.range_sigma_ratio * range_m)
    return LandmarkObservation(range_m, bearing_rad, barcode, range_sigma_m, p.bearing_sigma_rad, p.signature_sigma)


def _table(file: Path, columns: int) -> FloatArray:
    try:
        table = np.loadtxt(file, comments="#", ndmin=2)
    except (OSError, ValueError) as exc:
        raise InputFileError(file, "", str(exc), "a readable table of numbers") from exc
    if table.shape[1] != columns or not np.isfinite(table).all():
        raise InputFileError(file, "columns", table.shape[1], f"{columns} columns of finite numbers")
    return table
