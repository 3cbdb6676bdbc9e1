"""A composed ride, recorded as one of nodes is, so that both are scored alike."""

from __future__ import annotations

from collections.abc import Iterator

from hitchhike_ros.experiments.scenarios.ride_recorder import RideRecorder
from hitchhike_ros.simulation.composed import ComposedRide


class ComposedRecorder:
    """Steps a ride and keeps the truth, every change of a status, what was handed over and what was earned."""

    def __init__(self, ride: ComposedRide, seed: int) -> None:
        self._ride = ride
        self._recorder = RideRecorder.of_world(ride.world.file, seed, ride.package)
        self.record = self._recorder.record

    def run(self, limit_s: float) -> Iterator[float]:
        """Step until ``limit_s`` of simulated time; what it yields, the time, is after each frame."""
        world, recorder = self._ride.world, self._recorder
        while world.now < limit_s:
            self._ride.step()
            for name, robot in self._ride.robots.items():
                pose, _ = world.robots[name].ground_truth()
                known = self.record.robots[name]
                recorder.truth(name, world.now, pose)
                recorder.status(name, robot.status)
                recorder.obstacles(name, robot.boxes)
                for award in robot.awards[len(known.awards) :]:
                    recorder.award(name, award)
                for estimate in robot.taken[len(known.initial_poses) :]:
                    recorder.initial_pose(name, estimate)
            for contact in world.contacts()[len(self.record.contacts) :]:
                recorder.contact(contact)
            yield world.now

    def run_ride(self, rider: str, limit_s: float) -> None:
        """Step until ``rider`` has ridden and rides no more, or until ``limit_s`` of simulated time."""
        rode = False
        for _ in self.run(limit_s):
            status = self._ride.robots[rider].status
            rode = rode or status.state == "riding"
            if rode and status.role != "hitchhiker":
                return
