"""rospy without a master, for tests of hosts: topics that only this process hears, and a clock that the test sets."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import pytest
import rospy

from hitchhike_ros.ros_io.node import DiagnosticsUpdater


class FakeRos:
    """What nodes publish by topic, and who subscribes; ``now`` is ROS time in s."""

    def __init__(self, name: str = "/p3dx/node") -> None:
        self.name, self.now = name, 0.0
        self.params: dict[str, Any] = {}
        self.published: dict[str, list[Any]] = defaultdict(list)
        self.subscribers: dict[str, list[Callable[[Any], None]]] = defaultdict(list)
        self.listeners: set[str] = set()
        """Topics to which somebody else subscribes; all others have no connections."""
        self.latecomers: dict[str, Any] = {}
        """Who is called when somebody subscribes to a topic later."""
        self.warnings: list[str] = []
        self.shut_down: list[str] = []

    def send(self, topic: str, msg: Any, sender: str = "/other") -> None:
        """As if node ``sender`` had published ``msg``."""
        msg._connection_header = {"callerid": sender}
        for callback in list(self.subscribers[topic]):
            callback(msg)

    def join(self, topic: str) -> list[Any]:
        """Somebody subscribes to ``topic`` now; what is published to him alone."""
        received: list[Any] = []
        listener = self.latecomers[topic]
        if listener is not None:
            listener.peer_subscribe(topic, None, received.append)
        return received

    def said(self, name: str) -> Any:
        """The newest diagnosis called ``name``: level, message and values."""
        statuses = [s for array in self.published["/diagnostics"] for s in array.status if s.name.endswith(f": {name}")]
        return statuses[-1].level, statuses[-1].message, {v.key: v.value for v in statuses[-1].values}


class _Publisher:
    def __init__(self, ros: FakeRos, topic: str) -> None:
        self._ros, self._topic = ros, topic

    def publish(self, msg: Any) -> None:
        self._ros.published[self._topic].append(msg)

    def get_num_connections(self) -> int:
        return int(self._topic in self._ros.listeners)


class _Subscriber:
    def __init__(self, ros: FakeRos, topic: str, callback: Callable[..., None]) -> None:
        self._callbacks, self._callback = ros.subscribers[topic], callback
        self._callbacks.append(callback)

    def unregister(self) -> None:
        self._callbacks.remove(self._callback)


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> FakeRos:
    """A process that talks to nobody."""
    fake = FakeRos()

    def subscribe(topic: str, _cls: type, callback: Callable[..., None], **_: Any) -> _Subscriber:
        return _Subscriber(fake, topic, callback)

    def get_param(name: str, *default: Any) -> Any:
        return fake.params[name] if name in fake.params or not default else default[0]

    def publisher(topic: str, _cls: type, **options: Any) -> _Publisher:
        fake.latecomers[topic] = options.get("subscriber_listener")
        return _Publisher(fake, topic)

    replacements = {
        "Publisher": publisher,
        "Subscriber": subscribe,
        "get_param": get_param,
        "get_param_cached": get_param,
        "has_param": lambda name: name in fake.params,
        "get_time": lambda: fake.now,
        "get_name": lambda: fake.name,
        "get_namespace": lambda: fake.name.rpartition("/")[0] + "/",
        "is_shutdown": lambda: bool(fake.shut_down),
        "signal_shutdown": fake.shut_down.append,
        "logwarn": lambda text, *args: fake.warnings.append(text % args),
        "logerr": lambda text, *args: fake.warnings.append(text % args),
        "logfatal": lambda text, *args: fake.warnings.append(text % args),
        "loginfo": lambda *_: None,
    }
    for name, replacement in replacements.items():
        monkeypatch.setattr(rospy, name, replacement)
    # What changes is published at once all the same.
    monkeypatch.setattr(DiagnosticsUpdater, "_repeat", lambda _self: None)
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time.from_sec(fake.now)))
    return fake
