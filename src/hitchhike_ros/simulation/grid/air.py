"""Who hears what, and when, in the grid simulator."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from hitchhike_ros.core.datatypes import FloatArray
from hitchhike_ros.core.errors import MessageError
from hitchhike_ros.protocol.messages import EVERYBODY, Beacon, Message, encode
from hitchhike_ros.simulation.grid.parameters import GridWorldParameters
from hitchhike_ros.simulation.grid.robot import GridRobot
from hitchhike_ros.simulation.grid.schedule import Schedule
from hitchhike_ros.simulation.radio import NetworkModel


class Air:
    """Brings messages from one robot to the others, and calls back when they are heard.

    ``hear`` takes a robot and a message that has come to it, ``hear_beacon`` a beacon and all robots to which it comes
    at the same moment, those that are silent included. ``messages`` counts what was sent, ``deliveries`` what arrived.
    """

    def __init__(
        self,
        network: NetworkModel,
        params: GridWorldParameters,
        schedule: Schedule,
        hear: Callable[[GridRobot, Message], None],
        hear_beacon: Callable[[Beacon, Sequence[GridRobot]], None],
    ) -> None:
        self.network = network
        self.messages = self.deliveries = 0
        self._params, self._schedule, self._hear, self._hear_beacon = params, schedule, hear, hear_beacon
        self._robots: list[GridRobot] = []
        self._by_name: dict[str, GridRobot] = {}
        self._map: tuple[float, FloatArray, Any] | None = None  # time, places (N, 2), tree of them
        n = network.params
        # Everybody in range hears everything once, after the same time, and in order.
        self._plain = n.loss == n.duplication == n.reordering == n.jitter_s == 0.0 and not n.partitions

    def join(self, robot: GridRobot) -> None:
        """From now on the robot hears and is heard; robots join in the order of their ``index``."""
        self._robots.append(robot)
        self._by_name[robot.name] = robot
        self._map = None

    def transmit(self, sender: GridRobot, message: Message) -> None:
        """Send a message to all in range, or to the one to whom it is addressed."""
        self.messages += 1
        now, name, push = self._schedule.now, sender.name, self._schedule.push
        sent: Message | str = encode(message) if self._params.json_messages else message
        if message.to != EVERYBODY:
            robot = self._by_name.get(message.to)
            if robot is not None and robot is not sender:
                body, other = sender.body, robot.body
                other.advance(now)
                body.advance(now)
                apart = math.hypot(other.x - body.x, other.y - body.y)
                for time in self.network.deliveries(now, name, robot.name, apart):
                    push(max(time, now), self._arrive, (sent, [robot]))
            return
        robots = self._in_range(sender)
        if self._plain:
            if robots:
                push(now + self.network.params.delay_s, self._arrive, (sent, robots))
            return
        arrivals: dict[float, list[GridRobot]] = {}
        places, _ = self._places()
        here = places[sender.index]
        for robot in robots:
            apart = float(np.hypot(*(places[robot.index] - here)))
            for time in self.network.deliveries(now, name, robot.name, apart):
                arrivals.setdefault(time, []).append(robot)
        for time, those in arrivals.items():
            push(max(time, now), self._arrive, (sent, those))

    def mean_in_range(self) -> float:
        """How many others a robot can hear now, on average."""
        reach, robots = self.network.params.range_m, len(self._robots)
        if math.isinf(reach):
            return robots - 1.0
        tree = self._places()[1]
        return float((tree.count_neighbors(tree, reach) - robots) / max(robots, 1))

    def _in_range(self, sender: GridRobot) -> list[GridRobot]:
        """Who may hear the robot, in the order in which they joined."""
        reach, robots, own = self.network.params.range_m, self._robots, sender.index
        if math.isinf(reach):
            return [robot for robot in robots if robot is not sender]
        places, tree = self._places()
        return [robots[k] for k in tree.query_ball_point(places[own], reach, return_sorted=True) if k != own]

    def _places(self) -> tuple[FloatArray, Any]:
        """Where all robots are (N, 2) in m, and a tree of that; as old as ``radio_refresh_s`` allows."""
        known, now = self._map, self._schedule.now
        if known is None or now - known[0] > self._params.radio_refresh_s:
            for robot in self._robots:
                if robot.body.moves:
                    robot.body.advance(now)
            flat = [value for robot in self._robots for value in (robot.body.x, robot.body.y)]
            places = np.array(flat).reshape(-1, 2)
            known = self._map = now, places, cKDTree(places)
        return known[1:]

    def _arrive(self, what: tuple[Message | str, list[GridRobot]]) -> None:
        """A message comes to all who hear it at the same moment."""
        sent, robots = what
        if isinstance(sent, Beacon):
            self._arrive_beacon(sent, robots)
            return
        for robot in robots:
            if not robot.alive:
                continue
            try:
                message = robot.inbox.receive(sent)  # type: ignore[arg-type]  # text or an object, as its inbox takes
            except MessageError:
                continue  # the inbox has counted it
            if message is not None:
                self.deliveries += 1
                self._hear(robot, message)

    def _arrive_beacon(self, beacon: Beacon, robots: Sequence[GridRobot]) -> None:
        """As an object; most messages are beacons, so this is kept short."""
        self.deliveries += len(robots)
        if not self._plain:
            sender, order = beacon.robot_id, (beacon.time_stamp, beacon.seq)
            robots = [robot for robot in robots if robot.alive and robot.inbox.is_new(sender, order)]  # type: ignore[union-attr]
        self._hear_beacon(beacon, robots)
