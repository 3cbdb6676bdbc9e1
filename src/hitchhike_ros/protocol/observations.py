"""``visual_servoing/observations``: the markers of one image as JSON, in the robot's base_footprint, and what following
makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from hitchhike_ros.core.datatypes import MarkerObservation, Pose2D
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.messages import Covariance, covariance_rows


@dataclass(frozen=True)
class _Marker:
    marker_id: int
    x: float
    y: float
    theta: float
    covariance: Covariance


@dataclass(frozen=True)
class _Observations:
    stamp: float
    markers: tuple[_Marker, ...]
    following: str = ""


@dataclass(frozen=True, eq=False)
class Observations:
    """What servoing says of the image of time ``stamp`` in s; an image without markers is said too.

    ``following`` is what it does with the driver: following, coasting, looking, turning or searching; stopped where it
    cannot; nothing while it only observes.
    """

    stamp: float = 0.0
    markers: tuple[MarkerObservation, ...] = ()
    following: str = ""


_DECODER = msgspec.json.Decoder(_Observations)  # made once, as in status.py


def encode_observations(observations: Observations) -> str:
    """As JSON."""
    markers = tuple(
        _Marker(o.marker_id, o.pose.x, o.pose.y, o.pose.theta, covariance_rows(o.covariance))
        for o in observations.markers
    )
    return msgspec.json.encode(_Observations(observations.stamp, markers, observations.following)).decode()


def decode_observations(text: str) -> Observations:
    """Raises MessageError where the text is none."""
    try:
        seen = _DECODER.decode(text)
    except msgspec.MsgspecError as exc:
        raise MessageError(f"visual_servoing/observations: {exc}") from exc
    markers = tuple(
        MarkerObservation(seen.stamp, m.marker_id, Pose2D(m.x, m.y, m.theta), np.array(m.covariance))
        for m in seen.markers
    )
    return Observations(seen.stamp, markers, seen.following)
