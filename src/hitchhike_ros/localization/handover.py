"""The pose that a hitchhiker takes over when it decouples (P17 §6.2, P18 Eqs. 20-22)."""

from __future__ import annotations

import math
from typing import Literal, get_args

import numpy as np

from hitchhike_ros.core.datatypes import FloatArray, MarkerObservation, Pose2D, PoseEstimate
from hitchhike_ros.core.geometry import compose, compose_jacobians, inverse, inverse_jacobian, wrap_angle

Method = Literal["paper", "measured"]


def handover(
    method: Method,
    driver: PoseEstimate,
    observation: MarkerObservation,
    T_driver_marker: Pose2D,
    mounting: FloatArray | None = None,
) -> PoseEstimate:
    """The hitchhiker's pose in ``map`` from its driver's and from the marker it sees on the driver's back.

    Args:
        method: ``paper`` takes both robots to be in line and copies the driver's covariance (P18 Eqs. 20-22);
            ``measured`` is T_map_h = T_map_d T_d_marker T_h_marker^-1 with the first-order covariance of all of it.
        driver: the driver's pose T_map_d with its covariance.
        observation: T_h_marker as the hitchhiker sees it, with its covariance.
        T_driver_marker: where the marker is mounted on the driver, in the driver's ``base_footprint``.
        mounting: covariance (3, 3) of that pose in (x, y, theta), exact unless given; only ``measured`` counts it.

    Returns:
        The hitchhiker's pose with its covariance (3, 3), stamped as the observation.

    Raises:
        ValueError: the method is unknown.
    """
    if method == "paper":
        # From base to base, though the camera measures to the marker on the driver's back.
        d = math.hypot(observation.pose.x, observation.pose.y) + math.hypot(T_driver_marker.x, T_driver_marker.y)
        theta = driver.pose.theta
        pose = Pose2D(driver.pose.x - d * math.cos(theta), driver.pose.y - d * math.sin(theta), wrap_angle(theta))
        return PoseEstimate(observation.stamp, pose, np.array(driver.covariance))
    if method == "measured":
        T_map_marker = compose(driver.pose, T_driver_marker)
        J_driver, J_mounted = compose_jacobians(driver.pose, T_driver_marker)
        T_marker_h = inverse(observation.pose)
        J_marker, J_inverse = compose_jacobians(T_map_marker, T_marker_h)
        A, B = J_marker @ J_driver, J_inverse @ inverse_jacobian(observation.pose)
        covariance = A @ driver.covariance @ A.T + B @ observation.covariance @ B.T
        if mounting is not None:
            C = J_marker @ J_mounted
            covariance = covariance + C @ mounting @ C.T
        return PoseEstimate(observation.stamp, compose(T_map_marker, T_marker_h), (covariance + covariance.T) / 2)
    raise ValueError(f"handover method {method!r}, expected one of {', '.join(get_args(Method))}")
