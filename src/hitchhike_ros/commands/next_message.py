"""One message of a topic, for commands that want no more."""

from __future__ import annotations

from typing import Any

import rospy

from hitchhike_ros.core.errors import HitchhikeError


def wait_for(topic: str, cls: type, what: str, timeout_s: float) -> Any:
    """The next message of a topic; a node has been initialised.

    Raises:
        HitchhikeError: none comes within ``timeout_s`` of wall time.
    """
    name = rospy.resolve_name(topic)
    print(f"waiting for a {what} on {name}", flush=True)
    try:
        return rospy.wait_for_message(topic, cls, timeout_s)
    except rospy.ROSException as exc:
        raise HitchhikeError(f"no {what} on {name} within {timeout_s:g} s") from exc
