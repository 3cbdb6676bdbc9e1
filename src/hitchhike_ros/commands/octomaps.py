"""The OctoMaps of a ride, from its bag: what the driver had, and what its hitchhiker got (P17 §7.4)."""

from __future__ import annotations

from pathlib import Path

import rosbag

from hitchhike_ros.core.errors import InputFileError


def newest_octomaps(bag: Path) -> dict[str, bytes]:
    """The last .bt file that each robot published; robots without one are missing.

    Raises:
        InputFileError: the bag cannot be read.
    """
    found: dict[str, bytes] = {}
    try:
        with rosbag.Bag(str(bag)) as opened:
            topics = [topic for topic in opened.get_type_and_topic_info().topics if topic.endswith("/octomap_binary")]
            for topic, message, _ in opened.read_messages(topics=topics) if topics else ():
                found[topic.split("/")[1]] = bytes(message.data)
    except (OSError, rosbag.ROSBagException) as exc:
        raise InputFileError(bag, "", str(exc), "the bag of a ride") from exc
    return found
