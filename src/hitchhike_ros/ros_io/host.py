"""The host of pure modules in a ROS node: it subscribes, converts, steps and publishes, and decides nothing.

Callbacks queue messages and wake one thread, unless no module is in a hurry for them. Only that thread touches the
module: it converts and hands on what has arrived, steps the module while it is due, and publishes its outputs.
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
from sensor_msgs.msg import CompressedImage, Image

from hitchhike_ros.core.errors import MessageError, SensorDataError
from hitchhike_ros.modules.module import Level, Module, Order, Outputs, Refused
from hitchhike_ros.protocol.status import Status
from hitchhike_ros.ros_io.inlets import Inlet, inlet_of
from hitchhike_ros.ros_io.node import Diagnostics, DiagnosticsUpdater, LockstepAnswer
from hitchhike_ros.ros_io.outlets import Outlet
from hitchhike_ros.ros_io.parameters import resolve

T = TypeVar("T")

# After at most this time, in s of wall time, the thread looks whether the node is to end (chosen).
_LONGEST_WAIT_S = 0.5
# Refused messages of one topic and sender are logged at most once in this time, in s of ROS time.
_LOG_PERIOD_S = 10.0


class Steppable(Protocol):
    """A module, or all modules of a robot, as a host sees them; :class:`modules.module.Module` says what each means."""

    def listens(self) -> frozenset[type]: ...
    def patient(self) -> frozenset[type]: ...
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

    def patient(self) -> frozenset[type]:
        """What never makes the module due."""
        return self.module.patient

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
    """Hosts one module, or all modules of a robot.

    Args:
        robot: the module or modules to step.
        outlets: by the name of a module, which of its outputs are published, and how.
        orders: whether orders come as messages. A robot with hitchhike_comm gives its own orders, and its host ignores
            the messages that its own node has published.
        also: called with the name and the outputs of each module that was stepped, for outputs that no topic carries.
        updater: publishes the health of the modules together with that of the node's other parts.
        start: whether the thread is started; a test calls :meth:`turn` instead.
    """

    def __init__(
        self,
        robot: Steppable,
        outlets: Mapping[str, Iterable[Outlet]],
        *,
        orders: bool = True,
        also: Callable[[str, Outputs], None] = lambda _name, _outputs: None,
        updater: DiagnosticsUpdater | None = None,
        start: bool = True,
    ) -> None:
        self._robot, self._also = robot, also
        self._outlets = {name: list(of_module) for name, of_module in outlets.items()}
        self.failure: Exception | None = None
        self._changed = threading.Condition()
        self._arrived: deque[_Arrived | Callable[[], None]] = deque()
        self._waiting: dict[Inlet, int] = {}
        self.hurries = False
        """Whether the thread is to look at once at what has arrived."""
        self._kept: dict[Outlet, Any] = {}
        self._publishers = {outlet: self._publisher(outlet) for outlets in self._outlets.values() for outlet in outlets}
        updater = updater or DiagnosticsUpdater()
        self._diagnostics = {name: Diagnostics(name, updater) for name in self._outlets}
        self._answers = {name: LockstepAnswer(name) for name in self._outlets}
        self._due = -float("inf")
        self._logged: dict[tuple[str, str], float] = {}
        self._orders: frozenset[type] = frozenset({Status}) if orders else frozenset()
        self._listened, self._patient = frozenset[type](), frozenset[type]()
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
        """Queue a message for the thread; where the queue is full, the oldest message in it is dropped.

        The thread is woken unless no module is in a hurry for the message. A queue that is to lose none wakes it when
        it is half full.
        """
        if not self._orders and _sender(msg) == rospy.get_name():
            return
        with self._changed:
            if self._waiting.get(inlet, 0) >= inlet.queue_size:
                self._arrived.remove(next(a for a in self._arrived if isinstance(a, _Arrived) and a.inlet is inlet))
                self._waiting[inlet] -= 1
            self._waiting[inlet] = self._waiting.get(inlet, 0) + 1
            self._arrived.append(_Arrived(inlet, msg, rospy.get_time()))
            if inlet.what not in self._patient or 1 < inlet.queue_size <= 2 * self._waiting[inlet]:
                self.hurries = True
                self._changed.notify_all()

    def call(self, function: Callable[[], T], timeout_s: float = 5.0) -> T:
        """Run ``function`` on the thread that steps the module, as services do, and return or raise what it does.

        Raises:
            TimeoutError: the thread did not come to it within ``timeout_s`` of wall time.
        """
        future: Future[T] = Future()
        self.post(lambda: _answer(future, function))
        return future.result(timeout_s)

    def post(self, function: Callable[[], None]) -> None:
        """Queue ``function`` for the thread that steps the module."""
        with self._changed:
            self._arrived.append(function)
            self.hurries = True
            self._changed.notify_all()

    def order(self, order: Order) -> None:
        """Give the module an order. Call this on the thread that steps it."""
        self._robot.order(order, rospy.get_time())

    def _on_tick(self, msg: Clock) -> None:
        if msg.clock.to_sec() >= self._due:
            with self._changed:
                self._changed.notify_all()

    # On the thread.

    def turn(self, now: float) -> None:
        """Hand on what has arrived, step while something is due at ``now`` in s of ROS time, and publish."""
        with self._changed:
            arrived, self._arrived, self._waiting, self.hurries = self._arrived, deque(), {}, False
        for item in arrived:
            if isinstance(item, _Arrived):
                self._hand_on(item)
            else:
                item()
        while (due := self._robot.next_due(now)) <= now:
            for name, outputs in self._robot.step(now):
                self._publish(name, outputs)
        self._due, self._patient = due, self._robot.patient()
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
        """Wait until a message in a hurry has arrived or a step is due, or the longest wait is over."""
        with self._changed:
            end = time.monotonic() + _LONGEST_WAIT_S
            while not self.hurries and (due_in := self._due - rospy.get_time()) > 0.0:
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
        """Publish the last output once more, to a node that has subscribed since."""
        if outlet in self._kept:
            for msg in outlet.convert(self._kept[outlet]):
                publish(msg)

    def _listen(self) -> None:
        """Subscribe to what the modules take now and to no more, so that a module that is off costs next to nothing."""
        wanted = self._robot.listens() | self._orders
        if wanted == self._listened:
            return
        self._listened = wanted
        for what in self._subscribers.keys() - wanted:
            self._subscribers.pop(what).unregister()
        for what in wanted - self._subscribers.keys():
            inlet = inlet_of(what)
            self._subscribers[what] = rospy.Subscriber(
                resolve(inlet.topic),
                inlet.cls,
                partial(self.receive, inlet),
                queue_size=inlet.queue_size,
                buff_size=_buffer_of(inlet.cls),
                tcp_nodelay=True,
            )

    def _log(self, topic: str, sender: str, text: str, now: float) -> None:
        """Log a refused message, once per topic, sender and period. Time may have jumped back."""
        last = self._logged.get((topic, sender))
        if last is None or not 0.0 <= now - last < _LOG_PERIOD_S:
            self._logged[topic, sender] = now
            rospy.logwarn("%s from %s refused: %s", topic, sender, text)

    def _stop(self, exc: Exception) -> None:
        """Stop the base and say why in diagnostics and log."""
        rospy.logfatal("%s", "".join(traceback.format_exception(exc)))
        for outlet, publisher in self._publishers.items():
            if outlet.cls is Twist:
                publisher.publish(Twist())
        for diagnostics in self._diagnostics.values():
            diagnostics.set(Level.ERROR, f"ended by {type(exc).__name__}: {exc}")


class _Latecomers(rospy.SubscribeListener):
    """Calls back for each new subscriber, with the function that publishes to that subscriber alone."""

    def __init__(self, callback: Callable[[Callable[[Any], None]], None]) -> None:
        super().__init__()
        self._callback = callback

    def peer_subscribe(self, _topic: str, _publish: Any, peer_publish: Callable[[Any], None]) -> None:
        """Called by rospy for each new subscriber."""
        self._callback(peer_publish)


def _sender(msg: Any) -> str:
    """The name of the node that published a message; ``?`` where it is not known."""
    return str((getattr(msg, "_connection_header", None) or {}).get("callerid", "?"))


def _stamp(msg: Any) -> float | None:
    """The stamp of a message's header in s; None where it has no header."""
    return msg.header.stamp.to_sec() if hasattr(msg, "header") else None


def _answer(future: Future[Any], function: Callable[[], Any]) -> None:
    """Run what another thread waits for, and pass on its result or its exception."""
    try:
        future.set_result(function())
    except Exception as exc:  # noqa: BLE001  (it is raised where it was asked for)
        future.set_exception(exc)


def _buffer_of(cls: type) -> int:
    """How many bytes rospy reads from a socket at once. With fewer than an image has, images wait there and grow old.
    rospy allocates all of them for each message, so other topics get fewer."""
    return 1 << 22 if cls in (CompressedImage, Image) else 1 << 16
