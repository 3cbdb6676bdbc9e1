"""The host of pure modules in a ROS node: it subscribes, converts, steps and publishes, and decides nothing.

Callbacks put messages away and wake one thread. That thread alone touches the module: it hands on what has arrived,
steps the module while it is due, and publishes what comes out.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeVar

import rospy
from geometry_msgs.msg import Twist
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

from hitchhike_ros.core.errors import MessageError, SensorDataError
from hitchhike_ros.modules.module import Level, Module, Order, Outputs, Refused
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.ros_io.inlets import INLETS, Inlet
from hitchhike_ros.ros_io.node import Diagnostics, LockstepAnswer
from hitchhike_ros.ros_io.outlets import Outlet
from hitchhike_ros.ros_io.parameters import resolve

T = TypeVar("T")

# The thread looks so often, in wall time, whether the node is to end (chosen).
_LONGEST_WAIT_S = 0.5
# Refused messages of one topic and sender are logged once in so long, in s of ROS time.
_LOG_PERIOD_S = 10.0


class Steppable(Protocol):
    """A module, or all modules of a robot, as a host sees them; :class:`modules.module.Module` says what each means."""

    def listens(self) -> frozenset[type]: ...
    def sense(self, x: object, now: float) -> None: ...
    def order(self, order: Order, now: float) -> None: ...
    def next_due(self, now: float) -> float: ...
    def step(self, now: float) -> Sequence[tuple[str, Outputs]]:
        """The outputs of the modules that were stepped, by name."""


class Single:
    """One module, stepped as if it were a robot's only one."""

    def __init__(self, module: Module[Any]) -> None:
        self.module = module
        self.listens, self.sense, self.order, self.next_due = (
            module.listens,
            module.sense,
            module.order,
            module.next_due,
        )

    def step(self, now: float) -> Sequence[tuple[str, Outputs]]:
        """As :meth:`Steppable.step`."""
        return [(self.module.name, self.module.step(now))]


@dataclass(frozen=True)
class _Arrived:
    """A message and when it came, in s of ROS time."""

    inlet: Inlet
    msg: Any
    at: float


class ModuleHost:
    """Hosts what ``robot`` is: one module or several.

    Args:
        robot: is stepped.
        outlets: by module, what is published of its outputs.
        orders: whether orders come as messages. A robot with hitchhike_comm makes its own, and does not take what its
            node published itself for something new.
        also: is called with each module's name and outputs, for what is no topic.
        start: whether its thread runs; a test calls :meth:`turn` instead.
    """

    def __init__(
        self,
        robot: Steppable,
        outlets: Mapping[str, Iterable[Outlet]],
        *,
        orders: bool = True,
        also: Callable[[str, Outputs], None] = lambda _name, _outputs: None,
        start: bool = True,
    ) -> None:
        self._robot, self._also = robot, also
        self._outlets = {name: list(of_module) for name, of_module in outlets.items()}
        self.failure: Exception | None = None
        self._changed = threading.Condition()
        self._arrived: deque[_Arrived | Callable[[], None]] = deque()
        self._waiting: dict[Inlet, int] = {}
        self._kept: dict[Outlet, Any] = {}
        self._publishers = {outlet: self._publisher(outlet) for outlets in self._outlets.values() for outlet in outlets}
        self._diagnostics = {name: Diagnostics(name) for name in self._outlets}
        self._answers = {name: LockstepAnswer(name) for name in self._outlets}
        self._due = -float("inf")
        self._logged: dict[tuple[str, str], float] = {}
        self._orders: frozenset[type] = frozenset({Status}) if orders else frozenset()
        self._subscribers: dict[type, rospy.Subscriber] = {}
        self._clock: rospy.Subscriber | None = None
        self._thread = threading.Thread(target=self._run, name="modules", daemon=True)
        self._listen()
        if start:
            if not rospy.rostime.is_wallclock():
                self._clock = rospy.Subscriber("/clock", Clock, self._on_tick, queue_size=1)
            self._thread.start()

    # From any thread.

    def receive(self, inlet: Inlet, msg: Any) -> None:
        """Put a message away until the thread comes to it; the oldest of a full queue is dropped."""
        if not self._orders and _sender(msg) == rospy.get_name():
            return
        with self._changed:
            if self._waiting.get(inlet, 0) >= inlet.queue_size:
                self._arrived.remove(next(a for a in self._arrived if isinstance(a, _Arrived) and a.inlet is inlet))
                self._waiting[inlet] -= 1
            self._waiting[inlet] = self._waiting.get(inlet, 0) + 1
            self._arrived.append(_Arrived(inlet, msg, rospy.get_time()))
            self._changed.notify_all()

    def call(self, function: Callable[[], T], timeout_s: float = 5.0) -> T:
        """Run ``function`` on the thread that steps the module, as services do; what it raises is raised here.

        Raises:
            TimeoutError: the thread did not come to it within ``timeout_s`` of wall time.
        """
        future: Future[T] = Future()
        self.post(lambda: _answer(future, function))
        return future.result(timeout_s)

    def post(self, function: Callable[[], None]) -> None:
        """Have the thread that steps the module run ``function`` when it comes to it."""
        with self._changed:
            self._arrived.append(function)
            self._changed.notify_all()

    def order(self, order: Order) -> None:
        """Hand the module an order; to be called on the thread that steps it."""
        self._robot.order(order, rospy.get_time())

    def _on_tick(self, msg: Clock) -> None:
        if msg.clock.to_sec() >= self._due:
            with self._changed:
                self._changed.notify_all()

    # On the thread.

    def turn(self, now: float) -> None:
        """Hand on what has arrived, step while something is due at ``now`` in s of ROS time, and publish."""
        with self._changed:
            arrived, self._arrived, self._waiting = self._arrived, deque(), {}
        for item in arrived:
            if isinstance(item, _Arrived):
                self._hand_on(item)
            else:
                item()
        while self._robot.next_due(now) <= now:
            for name, outputs in self._robot.step(now):
                self._publish(name, outputs)
        self._due = self._robot.next_due(now)
        self._listen()

    def _run(self) -> None:
        try:
            while not rospy.is_shutdown():
                self._wait()
                self.turn(rospy.get_time())
        except Exception as exc:
            self.failure = exc
            self._stop(exc)
            raise
        finally:
            rospy.signal_shutdown("modules ended")

    def _wait(self) -> None:
        """Until something has arrived or is due, or the longest wait is over."""
        with self._changed:
            end = time.monotonic() + _LONGEST_WAIT_S
            while not self._arrived and (due_in := self._due - rospy.get_time()) > 0.0:
                left = end - time.monotonic()
                if left <= 0.0:
                    return
                self._changed.wait(min(left, due_in) if rospy.rostime.is_wallclock() else left)

    def _hand_on(self, arrived: _Arrived) -> None:
        inlet = arrived.inlet
        try:
            x = inlet.convert(arrived.msg)
        except (SensorDataError, MessageError) as exc:
            sender = _sender(arrived.msg)
            self._log(inlet.topic, sender, str(exc), arrived.at)
            self._robot.sense(Refused(inlet.what, str(exc), sender, _stamp(arrived.msg)), arrived.at)
            return
        if isinstance(x, Status):
            self._robot.order(x, arrived.at)
        else:
            self._robot.sense(x, arrived.at)

    def _publish(self, name: str, outputs: Outputs) -> None:
        for outlet in self._outlets[name]:
            value = getattr(outputs, outlet.field) if outlet.field else outputs
            if value is None or (isinstance(value, tuple) and not value):
                continue
            if outlet.on_demand:
                self._kept[outlet] = value
            publisher = self._publishers[outlet]
            if outlet.latch or publisher.get_num_connections():
                for msg in outlet.convert(value):
                    publisher.publish(msg)
        self._also(name, outputs)
        health = outputs.health
        self._diagnostics[name].set(health.level, health.reason, **health.counters)
        if outputs.answered is not None:
            self._answers[name](outputs.answered)

    def _publisher(self, outlet: Outlet) -> rospy.Publisher:
        late = _Latecomers(lambda publish: self.post(lambda: self._show(outlet, publish)))
        return rospy.Publisher(
            resolve(outlet.topic),
            outlet.cls,
            subscriber_listener=late if outlet.on_demand else None,
            latch=outlet.latch,
            queue_size=outlet.queue_size,
            tcp_nodelay=True,
        )

    def _show(self, outlet: Outlet, publish: Callable[[Any], None]) -> None:
        """Make what was said last for one who has subscribed since."""
        if outlet in self._kept:
            for msg in outlet.convert(self._kept[outlet]):
                publish(msg)

    def _listen(self) -> None:
        """Subscribe to what the modules take now and to no more, so that a module that is off costs next to nothing."""
        wanted = self._robot.listens() | self._orders
        for what in self._subscribers.keys() - wanted:
            self._subscribers.pop(what).unregister()
        for what in wanted - self._subscribers.keys():
            inlet = INLETS[what]
            self._subscribers[what] = rospy.Subscriber(
                resolve(inlet.topic),
                inlet.cls,
                partial(self.receive, inlet),
                queue_size=inlet.queue_size,
                buff_size=_buffer_of(inlet.cls),
                tcp_nodelay=True,
            )

    def _log(self, topic: str, sender: str, text: str, now: float) -> None:
        """Once per topic and sender in a while; time may have jumped back."""
        last = self._logged.get((topic, sender))
        if last is None or not 0.0 <= now - last < _LOG_PERIOD_S:
            self._logged[topic, sender] = now
            rospy.logwarn("%s from %s refused: %s", topic, sender, text)

    def _stop(self, exc: Exception) -> None:
        """Nothing that this node drives moves on; its diagnosis and its log say why."""
        rospy.logfatal("%s", "".join(traceback.format_exception(exc)))
        for outlet, publisher in self._publishers.items():
            if outlet.cls is Twist:
                publisher.publish(Twist())
        for diagnostics in self._diagnostics.values():
            diagnostics.set(Level.ERROR, f"ended by {type(exc).__name__}: {exc}")


class _Latecomers(rospy.SubscribeListener):
    """Calls back with what publishes to one new subscriber alone."""

    def __init__(self, callback: Callable[[Callable[[Any], None]], None]) -> None:
        super().__init__()
        self._callback = callback

    def peer_subscribe(self, _topic: str, _publish: Any, peer_publish: Callable[[Any], None]) -> None:
        """As rospy calls it."""
        self._callback(peer_publish)


def _sender(msg: Any) -> str:
    """The node that published a message, as far as that is known."""
    return str((getattr(msg, "_connection_header", None) or {}).get("callerid", "?"))


def _stamp(msg: Any) -> float | None:
    """Of its header, in s."""
    return msg.header.stamp.to_sec() if hasattr(msg, "header") else None


def _answer(future: Future[Any], function: Callable[[], Any]) -> None:
    """Run what another thread waits for, and hand it what comes of it."""
    try:
        future.set_result(function())
    except Exception as exc:  # noqa: BLE001  (it is raised where it was asked for)
        future.set_exception(exc)


def _buffer_of(cls: type) -> int:
    """Bytes that rospy takes from a socket at once. With less than an image, images wait there and grow old; with more
    than needed, all of it is allocated for each message."""
    return 1 << 22 if cls is Image else 1 << 16
