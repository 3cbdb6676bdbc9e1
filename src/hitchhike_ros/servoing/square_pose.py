"""The pose of a square from its corners: projection, Jacobians, and its posterior where it is seen nearly square-on.

A square that is turned by ``yaw`` looks narrower by yaw² / 2. Nearly square-on that is less than the noise of the
corners, so the least-squares pose is thrown to either side, of which its linearised covariance knows nothing. There
the posterior over yaw says what the corners tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from hitchhike_ros.datatypes import FloatArray

# Corners (4, 3) of a marker of side 2 in its frame, in the order in which they are detected.
UNIT_CORNERS = np.array([[0.0, -1.0, -1.0], [0.0, 1.0, -1.0], [0.0, 1.0, 1.0], [0.0, -1.0, 1.0]])
# Yaws of the grid in units of flat_yaw: its ends are beyond doubt for whatever lies in [-1, 1].
_GRID = np.linspace(-1.5, 1.5, 61)
_ITERATIONS = 3
# From the pose that fits best with the same noise for all corners, it is not far to the one with theirs.
_REFINEMENTS = 2
# Of 4 degrees of freedom; 1 upright marker in 20 000 has more (chosen).
_CHI2_MAX = 25.0
# Two optima are two poses if what lies between them is this much less likely, -2 log (chosen).
_RIDGE = 2.0


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
        """Every coordinate of the corners has independent noise of ``sigma``."""
        return cls(points, np.eye(8) / sigma, size_m)

    @classmethod
    def with_covariance(
        cls, points: FloatArray, covariance: FloatArray, size_m: float, size_sigma: float = 0.0
    ) -> SquareView:
        """The corners' errors have a covariance (8, 8)."""
        return cls(points, np.linalg.inv(np.linalg.cholesky(covariance)), size_m, size_sigma)

    @property
    def sigma(self) -> float:
        """Noise of a coordinate, as the geometric mean over all directions."""
        return float(np.exp(-np.log(np.abs(np.diag(self.whitening))).mean()))

    def misfit(self, T_camera_marker: FloatArray) -> FloatArray:
        """Whitened residuals (..., 8) of the corners of markers at (..., 4, 4)."""
        apart = project_corners(T_camera_marker, self.size_m) - self.points
        return apart.reshape(*apart.shape[:-2], 8) @ self.whitening.T

    def size_covariance(self, T_camera_marker: FloatArray) -> FloatArray:
        """What the size is off by, the place is off by along the line of sight: of the pose, (6, 6)."""
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
    """Corners (..., 4, 2) of markers at (..., 4, 4) in normalised image coordinates."""
    points = _arms(T_camera_marker, size_m) + T_camera_marker[..., None, :3, 3]
    return points[..., :2] / points[..., 2:]


def corner_jacobian(T_camera_marker: FloatArray, size_m: float) -> FloatArray:
    """d(corners)/d(pose), (..., 8, 6), of :func:`project_corners`.

    Rows are x, y of each corner; columns a translation and a rotation vector about the marker's centre, both along
    the axes of the camera: T -> [exp(w) R, t + dt].
    """
    arms = _arms(T_camera_marker, size_m)
    x, y, z = np.moveaxis(arms + T_camera_marker[..., None, :3, 3], -1, 0)
    J = np.zeros((*z.shape, 2, 6))
    J[..., 0, 0] = J[..., 1, 1] = 1.0 / z
    J[..., 0, 2], J[..., 1, 2] = -x / z**2, -y / z**2
    # arm x row of the translation, written out: np.cross is slow.
    a, b, c = (arms[..., None, i] for i in range(3))
    jx, jy, jz = (J[..., i] for i in range(3))
    J[..., 3], J[..., 4], J[..., 5] = b * jz - c * jy, c * jx - a * jz, a * jy - b * jx
    return J.reshape(*z.shape[:-1], 8, 6)


def least_squares(view: SquareView, start: FloatArray) -> PoseSolution | None:
    """The pose near ``start`` (4, 4) that fits best (Gauss-Newton); None where the corners do not determine it."""
    T = start.copy()
    for _ in range(_REFINEMENTS):
        A = view.whitening @ corner_jacobian(T, view.size_m)
        information = A.T @ A
        if not np.linalg.cond(information) < 1e12:
            return None
        d = -np.linalg.solve(information, A.T @ view.misfit(T))
        T[:3, :3] = cv2.Rodrigues(d[3:])[0] @ T[:3, :3]
        T[:3, 3] += d[:3]
    if not T[2, 3] > 0.0:
        return None
    covariance = np.linalg.inv(information) + view.size_covariance(T)
    return PoseSolution(T, covariance, float((view.misfit(T) ** 2).sum()))


def flat_yaw(view: SquareView, depth_m: float) -> float:
    """Yaw in rad below which a square's width tells little of it: there it is narrower by five sigma (chosen)."""
    return math.sqrt(10.0 * view.sigma * depth_m / view.size_m)


def square_on_poses(
    view: SquareView, start: FloatArray, T_base_camera: FloatArray, upright_sigma_rad: float
) -> tuple[PoseSolution, ...]:
    """Means and covariances of the posterior's one or two modes near ``start``; none unless that is upright and
    square-on.

    The posterior is the corners' likelihood times a normal prior on roll and pitch of the plate. It is a mixture over
    a grid of yaws: for each the other five parameters at their optimum (Gauss-Newton) and their covariance there.

    Args:
        view: what is seen.
        start: least-squares T_camera_marker, (4, 4).
        T_base_camera: camera (optical frame) in ``base_footprint``, whose z axis points up, (4, 4).
        upright_sigma_rad: sigma of the marker's roll and of its pitch.
    """
    T_base_marker = T_base_camera @ start
    sight = T_base_marker[:3, 3] - T_base_camera[:3, 3]
    square_on = math.atan2(-sight[1], -sight[0])
    flat = flat_yaw(view, float(start[2, 3]))
    cosine = -float(start[:3, 0] @ start[:3, 3]) / float(np.linalg.norm(start[:3, 3]))
    if math.acos(min(cosine, 1.0)) > flat:  # turned or leaning by so much it is well determined
        return ()
    upside = math.copysign(1.0, T_base_marker[2, 2])
    # Parameters (N, 6): translation along the camera's axes, then roll, pitch and yaw in the base frame.
    q = np.zeros((_GRID.size, 6))
    q[:, :3] = start[:3, 3]
    q[:, 3:5] = _lean(T_base_marker, upside)
    q[:, 5] = square_on + flat * _GRID
    for _ in range(_ITERATIONS):
        A, e = _residuals(q, view, T_base_camera, upside, upright_sigma_rad)
        A = A[:, :, :5]
        At = A.transpose(0, 2, 1)
        q[:, :5] -= np.linalg.solve(At @ A, At @ e)[:, :, 0]
    A, e = _residuals(q, view, T_base_camera, upside, upright_sigma_rad)
    chi2, of_corners = (e**2).sum(axis=(1, 2)), (e[:, :8] ** 2).sum(axis=(1, 2))
    if not chi2.min() < _CHI2_MAX:
        return ()
    C = np.zeros((_GRID.size, 6, 6))
    C[:, :5, :5] = np.linalg.inv(A[:, :, :5].transpose(0, 2, 1) @ A[:, :, :5])
    C[:, 5, 5] = (flat * (_GRID[1] - _GRID[0])) ** 2 / 12.0  # within a step of the grid
    solutions = []
    for mode in _modes(chi2):
        w = np.exp(-0.5 * (chi2[mode] - chi2[mode].min()))
        w /= w.sum()
        mean = w @ q[mode]
        d = q[mode] - mean
        covariance = np.einsum("k,kij->ij", w, C[mode]) + (d.T * w) @ d
        T, G = _poses(mean, T_base_camera, upside)
        covariance = G @ covariance @ G.T + view.size_covariance(T)
        solutions.append(PoseSolution(T, covariance, float(of_corners[mode][chi2[mode].argmin()])))
    return tuple(solutions)


def _modes(chi2: FloatArray) -> list[slice]:
    """The grid as one mode, or as two where the least of chi2 on either side of square-on have a ridge between them."""
    middle = chi2.size // 2
    left, right = int(chi2[: middle + 1].argmin()), middle + int(chi2[middle:].argmin())
    ridge = left + int(chi2[left : right + 1].argmax())
    if chi2[ridge] - max(chi2[left], chi2[right]) < _RIDGE:
        return [slice(None)]
    return [slice(None, ridge + 1), slice(ridge, None)]


def _lean(T_base_marker: FloatArray, upside: float) -> tuple[float, float]:
    """Roll and pitch of :func:`_poses` in rad."""
    across, up = upside * T_base_marker[2, 1:3]
    return math.atan2(across, up), -math.asin(max(-1.0, min(1.0, float(T_base_marker[2, 0]))))


def _residuals(
    q: FloatArray, view: SquareView, T_base_camera: FloatArray, upside: float, upright_sigma_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Jacobians (N, 10, 6) and residuals (N, 10, 1) of corners, roll and pitch, in units of their sigma."""
    T, G = _poses(q, T_base_camera, upside)
    A, e = np.zeros((len(q), 10, 6)), np.zeros((len(q), 10, 1))
    A[:, :8] = view.whitening @ corner_jacobian(T, view.size_m) @ G
    e[:, :8, 0] = view.misfit(T)
    A[:, 8, 3] = A[:, 9, 4] = 1.0 / upright_sigma_rad
    e[:, 8:, 0] = q[:, 3:5] / upright_sigma_rad
    return A, e


def _poses(q: FloatArray, T_base_camera: FloatArray, upside: float) -> tuple[FloatArray, FloatArray]:
    """T_camera_marker (..., 4, 4) of parameters (..., 6), and d(pose)/d(parameters) (..., 6, 6).

    The pose's perturbation is that of :func:`corner_jacobian`. A plate that hangs upside down (``upside`` -1) is
    turned half a turn about its normal before it rolls.
    """
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(q[..., 3:]), -1, 0), np.moveaxis(np.sin(q[..., 3:]), -1, 0)
    zero = np.zeros_like(cr)
    R = _matrices(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    # Roll turns about the normal, pitch about the level axis across it, yaw about the vertical.
    axes = _matrices([[cy * cp, -sy, zero], [sy * cp, cy, zero], [-sp, zero, zero + 1.0]])
    R_camera_base = T_base_camera[:3, :3].T
    T, G = np.zeros((2, *q.shape[:-1], 6, 6))
    T[..., :3, :3] = R_camera_base @ R * np.array([1.0, upside, upside])
    T[..., :3, 3], T[..., 3, 3] = q[..., :3], 1.0
    G[..., :3, :3] = np.eye(3)
    G[..., 3:, 3:] = R_camera_base @ axes
    return T[..., :4, :4], G


def _matrices(rows: list[list[FloatArray]]) -> FloatArray:
    """Matrices (..., 3, 3) of elements of shape (...)."""
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _arms(T_camera_marker: FloatArray, size_m: float) -> FloatArray:
    """From the marker's centre to its corners, (..., 4, 3), along the camera's axes."""
    return 0.5 * size_m * UNIT_CORNERS @ np.swapaxes(T_camera_marker[..., :3, :3], -1, -2)
