"""Whether hitchhikers have their drivers' maps."""

from __future__ import annotations

import pytest

from hitchhike_ros.experiments.scoring.network_rides import NetworkRide, network_rides
from hitchhike_ros.experiments.scoring.octomap_scores import octomap_figures
from synthetic_ride import synthetic_ride


@pytest.fixture
def rides() -> list[NetworkRide]:
    return network_rides(synthetic_ride(), {0: "p3dx"})


@pytest.mark.parametrize(
    ("maps", "equal", "kilobytes"),
    [
        ({"p3dx": b"x" * 500, "turtlebot": b"x" * 500}, 1.0, 0.5),
        ({"p3dx": b"x" * 500, "turtlebot": b"x" * 499}, 0.0, 0.499),
        ({"p3dx": b"x"}, 0.0, 0.0),
        ({}, 0.0, 0.0),
    ],
)
def test_the_maps_are_equal_bit_for_bit(
    rides: list[NetworkRide], maps: dict[str, bytes], equal: float, kilobytes: float
) -> None:
    same, size = octomap_figures(maps, rides)
    assert (same.value, same.ok, size.value) == (equal, equal == 1.0, kilobytes)


def test_without_a_ride_there_is_nothing_to_be_equal() -> None:
    assert octomap_figures({"p3dx": b"x", "turtlebot": b"x"}, [])[0].ok is False
