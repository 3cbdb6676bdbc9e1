"""One run of P18 §8.1 each: which robots, with or without a network, and how long the hitchhiker waited for what.

A run is a scenario file with something varied, so that a job is a few words that any worker can be sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path
from typing import Any

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.protocol.parameters import Mode
from hitchhike_ros.protocol.reasons import Reason
from hitchhike_ros.simulation.grid.scenario import Scenario, build, load_scenario
from hitchhike_ros.simulation.grid.world import GridWorld

HITCHHIKER = "H"
DRIVERS = ("D1", "D2", "D3")
# Offers are waited for until they can have come: there, back, and this much more for ticks (chosen).
_WINDOW_S = 2.0


@dataclass(frozen=True)
class Job:
    """One run: of which file in ``maps/``, how, and what is varied in it."""

    maps: str
    experiment: str
    mode: Mode
    seed: int = 0
    delay_s: float | None = None  # of the network; None: the scenario's
    driver: str | None = None  # the only one that is there
    factor: float | None = None  # of velocity tuning
    places: tuple[int, ...] = ()  # which of the places D1, D2 and D3 have, 0 the nearest
    profiles: tuple[int, ...] = ()  # whose profile is the best, second and worst: 0 is D1


@dataclass(frozen=True)
class WaitOutcome:
    """What became of the hitchhiker. Times are seconds since it was given its goal, None where it did not happen.

    ``wait_s`` is the paper's wait: until it is denied by all, gives up, or has its driver before it.
    """

    job: Job
    wait_s: float
    denied_s: float | None
    left_s: float | None
    met_s: float | None
    driver: str | None
    ridden_m: float
    arrived: bool
    messages: int
    duration_s: float


def run(job: Job) -> WaitOutcome:
    """Simulate it.

    Raises:
        WorldFileError: its scenario cannot be used.
    """
    world = make_world(job)
    scenario = scenario_of(job)
    world.run(scenario.duration_s, world.idle)
    robot = world.robots[HITCHHIKER]
    asked = robot.trips[0].began_s
    denials = [time - asked for time, report in robot.reports if report.reason is Reason.HIGH_PRIORITY]
    left = next((time - asked for time, state, _ in robot.history if state == "navigating"), None)
    met = next((time - asked for time, state, _ in robot.history if state == "coupling"), None)
    drivers = [name for name, other in world.robots.items() if other.awards]
    over = [time for time in (left, met) if time is not None]
    # In a network it leaves once all have denied; without, the paper counts until the only one to come has denied.
    wait = min([*over, *(denials if job.mode == "local" else [])])
    return WaitOutcome(
        job=job,
        wait_s=wait,
        denied_s=denials[-1] if denials else None,
        left_s=left,
        met_s=met,
        driver=drivers[0] if drivers else None,
        ridden_m=robot.ridden_m,
        arrived=all(trip.reached for other in world.robots.values() for trip in other.trips),
        messages=world.messages,
        duration_s=world.now,
    )


def scenario_of(job: Job) -> Scenario:
    """The scenario of a job, varied.

    Raises:
        WorldFileError: the file cannot be used.
    """
    scenario = load_scenario(Path(job.maps) / f"p18_grid_{job.experiment}.scenario.yaml")
    how: Mapping[str, Any] = scenario.settings[job.mode]
    scenario = scenario.changed(how.get("network"), how.get("hitchhiking")).seeded(job.seed)
    if job.delay_s is not None:
        window = {"offer_window_s": 2.0 * job.delay_s + _WINDOW_S, "confirm_timeout_s": 2.0 * job.delay_s + 3.0}
        scenario = scenario.changed({"delay_s": job.delay_s}, window)
    if job.factor is not None:
        cruise = float(scenario.hitchhiking["cruise_speed_mps"])
        scenario = scenario.changed(hitchhiking={"safe_speed_mps": job.factor * cruise})
    robots = dict(scenario.robots)
    if job.driver is not None:
        robots = {name: robot for name, robot in robots.items() if name in (HITCHHIKER, job.driver)}
    for k, place in enumerate(job.places):
        at = scenario.settings["places"][place]
        name = DRIVERS[k]
        score = scenario.settings["profiles"][job.profiles.index(k)]
        hitchhiking = {**robots[name].hitchhiking, "profile": score}
        robots[name] = replace(robots[name], start=Pose2D(at["x"], at["y"]), hitchhiking=hitchhiking)
    return scenario.changed(robots=robots)


def make_world(job: Job) -> GridWorld:
    """Its world at time 0."""
    return build(scenario_of(job))


def orders() -> tuple[tuple[int, ...], ...]:
    """All orders of three, in that of the paper's Table 1."""
    return tuple(permutations(range(3)))
