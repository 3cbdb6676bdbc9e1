"""The host of modules: it subscribes, converts, steps when due, publishes, and stops the robot when a step fails."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest
from geometry_msgs.msg import Twist, Vector3
from nav_msgs.msg import Odometry as OdometryMsg
from std_msgs.msg import String

from fake_ros import FakeRos, ros  # noqa: F401  (a fixture)
from hitchhike_ros.core.datatypes import Odometry, Twist2D
from hitchhike_ros.modules.inputs import NavigationCommand, NetworkText
from hitchhike_ros.modules.module import Health, Level, Order, Outputs, Refused
from hitchhike_ros.protocol.status import Status, encode_status
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.outlets import Outlet


@dataclass(frozen=True, kw_only=True)
class EchoOutputs(Outputs):
    command: NavigationCommand | None = None
    texts: tuple[str, ...] = ()


class Echo:
    """Says what it has heard at its next step, once ``delay_s`` have passed."""

    name: ClassVar[str] = "echo"
    inputs: ClassVar[frozenset[type]] = frozenset({Odometry, NetworkText})
    patient: ClassVar[frozenset[type]] = frozenset({Odometry})

    def __init__(self) -> None:
        self.takes: frozenset[type] = self.inputs
        self.heard: list[object] = []
        self.due, self.delay_s = math.inf, 0.0
        self.fails = False

    def listens(self) -> frozenset[type]:
        return self.takes

    def sense(self, x: object, now: float) -> None:
        self.heard.append(x)
        self.due = now + self.delay_s

    def order(self, order: Order, now: float) -> None:
        self.sense(order, now)

    def next_due(self, now: float) -> float:
        return self.due

    def step(self, now: float) -> EchoOutputs:
        if self.fails:
            raise ZeroDivisionError("a fault of the module")
        heard, self.heard, self.due = self.heard, [], math.inf
        speeds = [x.twist.v for x in heard if isinstance(x, Odometry)]
        refused = [x.reason for x in heard if isinstance(x, Refused)]
        return EchoOutputs(
            health=Health(Level.WARN if refused else Level.OK, "; ".join(refused), {"heard": len(heard)}),
            answered=now,
            command=NavigationCommand(Twist2D(speeds[-1])) if speeds else None,
            texts=tuple(x.text for x in heard if isinstance(x, NetworkText)),
        )


def twists(command: NavigationCommand) -> Iterable[Twist]:
    yield Twist(linear=Vector3(x=command.twist.v))


OUTLETS = (
    Outlet("command", "cmd_vel/navigation", Twist, twists),
    Outlet("texts", "said", String, lambda texts: map(String, texts), latch=True),
)


def host(module: Echo, **options: Any) -> ModuleHost:
    return ModuleHost(Single(module), {"echo": OUTLETS}, start=False, **options)


def odometry(v: float) -> OdometryMsg:
    msg = OdometryMsg()
    msg.pose.pose.orientation.w, msg.twist.twist.linear.x = 1.0, v
    return msg


def test_a_message_is_converted_and_what_the_module_says_is_published(ros: FakeRos) -> None:  # noqa: F811
    ros.listeners.add("cmd_vel/navigation")
    ros.params["/lockstep"] = True
    node = host(Echo())
    ros.now = 7.0
    ros.send("odom", odometry(0.25))
    assert ros.published["cmd_vel/navigation"] == []
    node.turn(7.0)
    assert [msg.linear.x for msg in ros.published["cmd_vel/navigation"]] == [0.25]
    assert [msg.stamp.to_sec() for msg in ros.published["lockstep/answer"]] == [7.0]


def test_what_nobody_hears_is_not_made_unless_it_is_kept_for_who_comes_later(ros: FakeRos) -> None:  # noqa: F811
    node = host(Echo())
    ros.send("odom", odometry(0.25))
    ros.send("/hhike_msg/network", String("{}"))
    node.turn(0.0)
    assert ros.published["cmd_vel/navigation"] == []
    assert [msg.data for msg in ros.published["said"]] == ["{}"]


def test_what_is_made_on_demand_is_made_for_who_comes_later(ros: FakeRos) -> None:  # noqa: F811
    made = []

    def make(texts: tuple[str, ...]) -> list[String]:
        made.append(texts)
        return [String(text) for text in texts]

    outlets = (Outlet("texts", "shown", String, make, on_demand=True), *OUTLETS)
    node = ModuleHost(Single(Echo()), {"echo": outlets}, start=False)
    early = ros.join("shown")
    node.turn(0.0)
    assert early == []
    for text in "ab":
        ros.send("/hhike_msg/network", String(text))
        node.turn(1.0)
    node.turn(2.0)  # which says nothing new
    assert made == []
    late = ros.join("shown")
    assert made == [], "not on the thread of who subscribes"
    node.turn(3.0)
    assert [msg.data for msg in late] == ["b"]
    assert ros.published["shown"] == []
    ros.listeners.add("shown")
    ros.send("/hhike_msg/network", String("c"))
    node.turn(4.0)
    assert [msg.data for msg in ros.published["shown"]] == ["c"]
    assert ros.join("cmd_vel/navigation") == []


def test_a_module_is_stepped_only_when_it_is_due(ros: FakeRos) -> None:  # noqa: F811
    module = Echo()
    module.delay_s = 1.0
    node = host(module)
    ros.now = 5.0
    ros.send("/hhike_msg/network", String("a"))
    node.turn(5.0)
    node.turn(5.9)
    assert ros.published["said"] == []
    node.turn(6.0)
    assert len(ros.published["said"]) == 1


def test_a_message_that_cannot_be_converted_is_sensed_as_refused_and_logged_once_in_a_while(
    ros: FakeRos,  # noqa: F811
) -> None:
    node = host(Echo())
    for now in (1.0, 2.0, 12.0):
        ros.now = now
        ros.send("odom", odometry(math.nan), "/base")
        node.turn(now)
        level, message, _ = ros.said("echo")
        assert (level, "not finite" in message) == (Level.WARN, True)
    assert ros.said("echo")[2] == {"heard": "1"}
    assert len(ros.warnings) == 2
    assert ros.warnings[0].startswith("odom from /base refused: odometry at ")


def test_orders_come_by_the_status(ros: FakeRos) -> None:  # noqa: F811
    module = Echo()
    module.delay_s = 1.0
    node, status = host(module), Status(3.0, "p3dx")
    ros.send("hhike_msg/status", String(encode_status(status)))
    node.turn(0.0)
    assert module.heard == [status]
    alone = Echo()
    host(alone, orders=False)
    assert len(ros.subscribers["hhike_msg/status"]) == 1


def test_it_subscribes_to_what_the_module_takes_now_and_to_no_more(ros: FakeRos) -> None:  # noqa: F811
    module = Echo()
    node = host(module)
    module.takes = frozenset({NetworkText})
    node.turn(0.0)
    assert (len(ros.subscribers["odom"]), len(ros.subscribers["/hhike_msg/network"])) == (0, 1)
    module.takes = Echo.inputs
    node.turn(0.0)
    assert (len(ros.subscribers["odom"]), len(ros.subscribers["/hhike_msg/network"])) == (1, 1)


def test_what_is_patient_wakes_nobody_until_its_queue_is_half_full(ros: FakeRos) -> None:  # noqa: F811
    module = Echo()
    node = host(module)
    node.turn(0.0)
    for v in range(24):  # of 50
        ros.send("odom", odometry(v))
    assert not node.hurries
    ros.send("odom", odometry(24.0))
    assert node.hurries
    node.turn(1.0)
    assert not node.hurries
    ros.send("odom", odometry(25.0))
    assert not node.hurries
    ros.send("/hhike_msg/network", String("a"))
    assert node.hurries
    module.delay_s = math.inf
    node.turn(2.0)
    assert [x.twist.v for x in module.heard if isinstance(x, Odometry)] == [25.0], "in its turn, and none is lost"


def test_of_a_full_queue_the_oldest_message_is_dropped(ros: FakeRos) -> None:  # noqa: F811
    node = host(Echo())
    for i in range(203):  # the network's queue has room for 200
        ros.send("/hhike_msg/network", String(str(i)))
    node.turn(0.0)
    assert [msg.data for msg in ros.published["said"]] == [str(i) for i in range(3, 203)]


def test_a_robot_that_gives_its_own_orders_does_not_hear_itself(ros: FakeRos) -> None:  # noqa: F811
    node = host(Echo(), orders=False)
    ros.send("/hhike_msg/network", String("own"), sender=ros.name)
    ros.send("/hhike_msg/network", String("other"))
    node.turn(0.0)
    assert [msg.data for msg in ros.published["said"]] == ["other"]


def test_a_topic_may_be_named_by_a_parameter(ros: FakeRos) -> None:  # noqa: F811
    ros.params["~network_in"] = "elsewhere"
    host(Echo())
    assert len(ros.subscribers["elsewhere"]) == 1
    assert not ros.subscribers["/hhike_msg/network"]


def test_an_exception_in_a_step_stops_the_robot_is_said_and_ends_the_node(
    ros: FakeRos,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    raised = []
    monkeypatch.setattr(threading, "excepthook", lambda args: raised.append(args.exc_value))
    module = Echo()
    module.fails = True
    module.due = 0.0
    node = ModuleHost(Single(module), {"echo": OUTLETS})
    node._thread.join(30.0)
    assert not node._thread.is_alive()
    assert [msg.linear.x for msg in ros.published["cmd_vel/navigation"]] == [0.0]
    assert ros.said("echo")[:2] == (Level.ERROR, "ended by ZeroDivisionError: a fault of the module")
    assert "ZeroDivisionError: a fault of the module" in ros.warnings[0]
    assert ros.shut_down
    assert node.failure is not None
    assert raised == [node.failure]


def test_a_service_is_answered_by_the_thread_that_steps(ros: FakeRos) -> None:  # noqa: F811
    node = ModuleHost(Single(Echo()), {"echo": OUTLETS})
    try:
        assert node.call(lambda: threading.current_thread().name) == "modules"
        with pytest.raises(KeyError):
            node.call(lambda: {}["no"])
    finally:
        ros.shut_down.append("over")
        node._thread.join(30.0)
    with pytest.raises(TimeoutError):
        node.call(lambda: 1, timeout_s=0.01)
