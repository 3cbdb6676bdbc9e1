"""Whether a hitchhiker got its driver's 3D map (P17 §7.4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hitchhike_ros.experiments.scoring.figures import Figure
from hitchhike_ros.experiments.scoring.network_rides import NetworkRide


def octomap_figures(maps: Mapping[str, bytes], rides: Sequence[NetworkRide]) -> list[Figure]:
    """Whether each hitchhiker has its driver's OctoMap bit for bit. ``maps`` are the newest of each robot."""
    equal = [maps.get(ride.hitchhiker) == maps.get(ride.driver) is not None for ride in rides]
    size = min((len(maps.get(ride.hitchhiker, b"")) for ride in rides), default=0)
    return [
        Figure("octomap_equal", float(bool(equal) and all(equal)), "", 1.0, "higher"),
        Figure("octomap_size", size / 1e3, "kB"),
    ]
