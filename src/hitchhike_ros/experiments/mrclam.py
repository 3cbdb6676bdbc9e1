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

from hitchhike_ros.datatypes import FloatArray, Pose2D, Positive, Twist2D
from hitchhike_ros.errors import InputFileError
from hitchhike_ros.geometry import wrap_angle
from hitchhike_ros.localization.ekf import Ekf, EkfParameters, LandmarkObservation, Landmarks
from hitchhike_ros.localization.motion import MotionNoise, move

Association = Literal["none", "known", "signature", "blind"]

# Subjects 1-5 are robots, the others landmarks (Barcodes.dat).
_FIRST_LANDMARK = 6
# Chi-square quantiles at 95 %, as is usual for association (Neira and Tardos, 2001), for range and bearing alone and
# with a signature.
_GATE_2, _GATE_3 = 5.99, 7.81


@dataclass(frozen=True)
class MrclamParameters:
    """Noise in round numbers, chosen from what kind of robot and camera these are.

    The odometry of this dataset is commanded velocities: within each second they are off by a tenth (v) and a fifth
    (omega) of themselves, and the robot turns a little while it drives straight. A barcode a few pixels wide gives its
    range to some percent and its bearing to some pixels of a wide image. Noise between half and twice as large changes
    the errors by a few centimetres.
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
            The others give every measurement, of robots and of misread barcodes too, to the most likely landmark, or
            to none outside the gate: ``signature`` by range, bearing and barcode (P18 Eqs. 14-18), ``blind`` by range
            and bearing alone. ``none`` is dead reckoning.
        parameters: noise and gate.
    """
    p = parameters or MrclamParameters()
    blind = association == "blind"
    landmarks = Landmarks(run.landmarks.positions, np.zeros(len(run.landmarks))) if blind else run.landmarks
    index_of = {int(barcode): k for k, barcode in enumerate(run.landmarks.signatures)}
    truth = run.truth[run.truth[:, 0] >= run.odometry[0, 0]]
    gate = p.blind_gate if blind else p.gate
    ekf = Ekf(Pose2D(*truth[0, 1:]), np.eye(3) * 1e-4, EkfParameters(p.motion, gate))
    # Times at which the velocity changes, a measurement is made or the truth is known, in this order at one moment.
    changes = np.flatnonzero(np.abs(np.diff(run.odometry[:, 1:], axis=0, prepend=np.nan)).sum(axis=1) != 0.0)
    gaps = np.flatnonzero(np.diff(run.odometry[:, 0]) > p.max_hold_s)
    stops = np.column_stack([run.odometry[gaps, 0] + p.max_hold_s, np.zeros((len(gaps), 2))])
    events = [
        *((row[0], 0, row) for row in (*run.odometry[changes], *stops)),
        *((row[0], 1, row) for row in run.measurements),
        *((row[0], 2, row) for row in truth),
    ]
    now = float(truth[0, 0])
    started = run.odometry[run.odometry[:, 0] <= now][-1]
    twist = Twist2D(started[1], started[2])
    errors, used, seen = [], 0, 0
    for stamp, kind, row in sorted((e for e in events if now <= e[0] <= truth[-1, 0]), key=lambda e: e[:2]):
        dt = stamp - now
        if kind == 2:
            pose = move(ekf.pose, twist, dt)
            errors.append((pose.x - row[1], pose.y - row[2], wrap_angle(pose.theta - row[3])))
            continue
        if dt > 0.0:
            ekf.predict(twist, dt)
        now = stamp
        if kind == 0:
            twist = Twist2D(row[1], row[2])
        elif association != "none":
            seen += 1
            sigma = math.hypot(p.range_sigma_m, p.range_sigma_ratio * row[2])
            signature = 0.0 if blind else row[1]
            observation = LandmarkObservation(row[2], row[3], signature, sigma, p.bearing_sigma_rad, p.signature_sigma)
            index = index_of.get(int(row[1])) if association == "known" else None
            if index is not None or association != "known":
                used += ekf.update_landmark(observation, landmarks, index) is not None
    return MrclamScore(np.array(errors), used, seen)


def _table(file: Path, columns: int) -> FloatArray:
    try:
        table = np.loadtxt(file, comments="#", ndmin=2)
    except (OSError, ValueError) as exc:
        raise InputFileError(file, "", str(exc), "a readable table of numbers") from exc
    if table.shape[1] != columns or not np.isfinite(table).all():
        raise InputFileError(file, "columns", table.shape[1], f"{columns} columns of finite numbers")
    return table
