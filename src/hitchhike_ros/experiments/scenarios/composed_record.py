"""A composed ride, recorded as one of nodes is, so that both are scored alike."""

from __future__ import annotations

from collections.abc import Iterator

from hitchhike_ros.core.geometry import pose_from_matrix
from hitchhike_ros.core.robot_model import fixed_transforms
from hitchhike_ros.experiments.scenarios.ride_record import Contact, RideRecord, RobotRecord, TimedEstimate, TimedPose
from hitchhike_ros.simulation.composed import ComposedRide
from hitchhike_ros.simulation.physics.robot import robot_files


class ComposedRecorder:
    """Steps a ride and keeps the truth, every change of a status, what was handed over and what was earned."""

    def __init__(self, ride: ComposedRide, seed: int) -> None:
        self._ride = ride
        robots = {}
        for name, entry in ride.world.file.robots.items():
            mounts = fixed_transforms(robot_files(entry.model, ride.package)[0])
            camera, marker = (pose_from_matrix(mounts[link]) for link in ("camera", "marker"))
            robots[name] = RobotRecord(camera, marker, entry.goal is not None)
        file = ride.world.file
        self.record = RideRecord(file.path.name.split(".")[0], seed, file.boxes, robots)

    def run(self, limit_s: float) -> Iterator[float]:
        """Step until ``limit_s`` of simulated time; what it yields, the time, is after each frame."""
        world, record = self._ride.world, self.record
        while world.now < limit_s:
            self._ride.step()
            now = world.now
            for name, robot in self._ride.robots.items():
                pose, _ = world.robots[name].ground_truth()
                record.robots[name].truth.append(TimedPose(now, pose.x, pose.y, pose.theta))
                record.robots[name].add_status(robot.status)
                record.robots[name].awards = list(robot.awards)
                record.robots[name].obstacles = robot.mapper.obstacles
                record.robots[name].initial_poses = [TimedEstimate.of(estimate) for estimate in robot.taken]
            record.contacts = [Contact(c.stamp, c.robot, c.other, c.x, c.y) for c in world.contacts()]
            yield now
