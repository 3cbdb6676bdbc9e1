"""The pose of a square from its corners: projection, Jacobians, and its posterior where it is seen nearly square-on.

A square that is turned by ``yaw`` looks narrower by yaw² / 2. Nearly square-on that is less than the noise of the
corners, so the least-squares pose is thrown to either side, of which its linearised covariance knows nothing. There
the posterior over yaw says what the corners tell. ``src/square_pose.cpp`` computes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hitchhike_ros import _visp_tracker
from hitchhike_ros.core.datatypes import FloatArray


@dataclass(frozen=True, eq=False)
class SquareView:
    """What is measured of one marker.

    ``points`` are its corners (4, 2) in normalised image coordinates; ``whitening`` (8, 8) makes their errors, x
    and y in turn, independent with variance 1; ``size_m`` is its side, known to a share ``size_sigma`` of itself.
    """

    points: FloatArray
    whitening: FloatArray
    size_m: float
    size_sigma: float = 0.0

    @classmethod
    def with_sigma(cls, points: FloatArray, sigma: float, size_m: float) -> SquareView:
        """A view whose corners' coordinates all have independent noise of ``sigma``."""
        return cls(points, np.eye(8) / sigma, size_m)

    @classmethod
    def with_covariance(
        cls, points: FloatArray, covariance: FloatArray, size_m: float, size_sigma: float = 0.0
    ) -> SquareView:
        """A view whose corners' errors have a covariance (8, 8)."""
        return cls(points, _visp_tracker.whitening(covariance), size_m, size_sigma)

    @property
    def sigma(self) -> float:
        """Noise of a coordinate, as the geometric mean over all directions."""
        return float(np.exp(-np.log(np.abs(np.diag(self.whitening))).mean()))

    def size_covariance(self, T_camera_marker: FloatArray) -> FloatArray:
        """Covariance (6, 6) that the error of the size adds to the pose: along the line of sight, in proportion."""
        shift = np.concatenate([self.size_sigma * T_camera_marker[:3, 3], np.zeros(3)])
        return np.outer(shift, shift)


@dataclass(frozen=True, eq=False)
class PoseSolution:
    """One pose that a marker may have.

    ``covariance`` is 6 x 6, of translation (m) and rotation vector (rad), both along the axes of the camera;
    ``chi2`` is the corners' squared distance in units of their variance (of the mode, where the pose is a mean).
    """

    T_camera_marker: FloatArray
    covariance: FloatArray
    chi2: float


def project_corners(T_camera_marker: FloatArray, size_m: float) -> FloatArray:
    """Corners (4, 2) of a marker at (4, 4) in normalised image coordinates."""
    return _visp_tracker.project_corners(T_camera_marker, size_m)


def corner_jacobian(T_camera_marker: FloatArray, size_m: float) -> FloatArray:
    """d(corners)/d(pose), (8, 6), of :func:`project_corners`.

    Rows are x, y of each corner; columns a translation and a rotation vector about the marker's centre, both along
    the axes of the camera: T -> [exp(w) R, t + dt].
    """
    return _visp_tracker.corner_jacobian(T_camera_marker, size_m)


def solve(view: SquareView) -> tuple[PoseSolution, ...]:
    """The one or two least-squares poses, the better one first; none where the corners do not determine one."""
    return tuple(_solution(view, *found) for found in _visp_tracker.solve(view.points, view.whitening, view.size_m))


def flat_yaw(view: SquareView, depth_m: float) -> float:
    """Yaw in rad below which a square's width tells little of it: there it is narrower by five sigma (chosen)."""
    return math.sqrt(10.0 * view.sigma * depth_m / view.size_m)


def square_on_poses(
    view: SquareView, start: FloatArray, T_base_camera: FloatArray, upright_sigma_rad: float
) -> tuple[PoseSolution, ...]:
    """Means and covariances of the posterior's one or two modes near ``start``; none unless that is upright and
    square-on.

    The posterior is the corners' likelihood times a normal prior on roll and pitch of the marker. It is a mixture over
    a grid of yaws: for each the other five parameters at their optimum (Gauss-Newton) and their covariance there.

    Args:
        view: what is seen.
        start: least-squares T_camera_marker, (4, 4).
        T_base_camera: camera (optical frame) in ``base_footprint``, whose z axis points up, (4, 4).
        upright_sigma_rad: sigma of the marker's roll and of its pitch.
    """
    place = start[:3, 3]
    flat = flat_yaw(view, float(place[2]))
    cosine = -float(start[:3, 0] @ place) / math.sqrt(place @ place)
    if math.acos(min(cosine, 1.0)) > flat:  # turned or leaning by so much it is well determined
        return ()
    modes = _visp_tracker.square_on_poses(
        view.points, view.whitening, view.size_m, start, T_base_camera, upright_sigma_rad, flat
    )
    return tuple(_solution(view, *mode) for mode in modes)


def _solution(view: SquareView, T_camera_marker: FloatArray, covariance: FloatArray, chi2: float) -> PoseSolution:
    return PoseSolution(T_camera_marker, covariance + view.size_covariance(T_camera_marker), chi2)
