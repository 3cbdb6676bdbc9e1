"""One fleet in one grid world: what it costs to simulate, what robots send and receive, what riding gains and costs."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from hitchhike_ros.experiments.scenarios.progress import Progress
from hitchhike_ros.simulation.grid.scenario import Scenario, build
from hitchhike_ros.simulation.grid.world import GridWorld

# Robots in radio range are counted so often, and progress is reported as often (chosen).
_SAMPLE_S = 30.0
# New objects before the youngest, then younger, then all of them are searched for cycles (chosen).
_COLLECTIONS = (50_000, 20, 100)
# Trips that begin later than this before the end are left out, as only the short ones end in time (chosen).
_LAST_TRIPS_S = 400.0


@dataclass(frozen=True)
class FleetTrip:
    """A trip that was made both with rides allowed and forbidden. ``alone_s`` is how long it took without."""

    robot: str
    metres: float
    alone_s: float
    took_s: float
    driven_m: float
    ridden_m: float
    coupled_s: float
    asked_s: float

    @property
    def delay_s(self) -> float:
        return self.took_s - self.alone_s


@dataclass(frozen=True)
class FleetRun:
    """A fleet over ``duration_s``. Messages are a robot's and a second's."""

    robots: int
    duration_s: float
    processor_s: float
    in_range: float
    sent: float
    received: float
    events: int
    rides: int
    failed: int
    trips: tuple[FleetTrip, ...] = ()

    @property
    def real_time_factor(self) -> float:
        return self.duration_s / self.processor_s

    @property
    def processor_us(self) -> float:
        """Of a robot and a simulated second."""
        return 1e6 * self.processor_s / self.duration_s / self.robots

    @property
    def ridden_share(self) -> float:
        """Of all metres of the trips."""
        driven = sum(trip.driven_m for trip in self.trips)
        return sum(trip.ridden_m for trip in self.trips) / driven if driven else 0.0

    @property
    def delay_s(self) -> float:
        """Mean of all trips, of riders, drivers and those that met nobody."""
        return float(np.mean([trip.delay_s for trip in self.trips])) if self.trips else 0.0


def run_fleet(scenario: Scenario, progress: Progress) -> FleetRun:
    """Simulate with rides, and again without; what is timed is the first."""
    world, processor_s, in_range = _simulated(scenario, progress)
    alone, _, _ = _simulated(scenario.changed(hitchhiking={"may_ride": False}), progress)
    duration, robots = scenario.duration_s, len(world.robots)
    return FleetRun(
        robots=robots,
        duration_s=duration,
        processor_s=processor_s,
        in_range=in_range,
        sent=world.messages / robots / duration,
        received=world.deliveries / robots / duration,
        events=world.events,
        rides=sum(len(robot.awards) for robot in world.robots.values()),
        failed=sum(not t.reached for robot in world.robots.values() for t in robot.trips if t.ended_s is not None),
        trips=_trips(world, alone, duration - _LAST_TRIPS_S),
    )


def _simulated(scenario: Scenario, progress: Progress) -> tuple[GridWorld, float, float]:
    """The world at its end, the processor time of its events, and the mean number of robots in radio range."""
    world = build(scenario)
    processor, counts = 0.0, []
    with _rare_collections():
        while world.now < scenario.duration_s:
            until = min(world.now + _SAMPLE_S, scenario.duration_s)
            began = time.process_time()
            world.run(until)
            processor += time.process_time() - began
            counts.append(world.mean_in_range())
            progress(f"fleet of {len(world.robots)} (s)", int(world.now), int(scenario.duration_s))
    return world, processor, float(np.mean(counts))


@contextmanager
def _rare_collections() -> Iterator[None]:
    """Python looks for cycles among all objects again and again, and a world of many hardly makes any."""
    before = gc.get_threshold()
    gc.collect()
    gc.freeze()
    gc.set_threshold(*_COLLECTIONS)
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


def _trips(world: GridWorld, alone: GridWorld, until_s: float) -> tuple[FleetTrip, ...]:
    """Trips that were begun early enough, and ended in both worlds."""
    found = []
    for name, robot in world.robots.items():
        for trip, solo in zip(robot.trips, alone.robots[name].trips, strict=False):
            if trip.began_s > until_s or trip.ended_s is None or solo.ended_s is None:
                continue
            found.append(
                FleetTrip(
                    robot=name,
                    metres=solo.driven_m,
                    alone_s=solo.ended_s - solo.began_s,
                    took_s=trip.ended_s - trip.began_s,
                    driven_m=trip.driven_m,
                    ridden_m=trip.ridden_m,
                    coupled_s=trip.coupled_s,
                    asked_s=trip.asked_s,
                )
            )
    return tuple(found)
