"""Single frames of robots' cameras, kept as pictures: subscribed for one frame, and then no longer."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import cv2
import rospy
from sensor_msgs.msg import Image

from hitchhike_ros.core.errors import SensorDataError
from hitchhike_ros.experiments.report.ride_frames import FOLDER, KeptFrameParameters, frame_name
from hitchhike_ros.ros_io.images import rgb_from_msg


class CameraFrames:
    """One robot's camera. :meth:`take` orders a frame, :meth:`step` keeps it when it has come.

    A simulated camera renders only while somebody subscribes it, so that between orders nobody does.
    """

    def __init__(self, robot: str, folder: Path) -> None:
        """Frames go to ``folder/frames``, from which this robot's earlier ones are removed."""
        self._robot, self._folder, self._params = robot, folder / FOLDER, KeptFrameParameters()
        for old in self._folder.glob(f"*-{robot}-*.jpg"):
            old.unlink()
        self._lock = threading.Lock()
        self._image: Image | None = None
        self._subscriber: rospy.Subscriber | None = None
        self._state, self._deadline = "", 0.0

    @property
    def busy(self) -> bool:
        """Whether a frame is on its way."""
        return self._subscriber is not None

    def take(self, state: str) -> None:
        """Order the next frame, for the name of a state."""
        self._state, self._deadline = state, time.monotonic() + self._params.timeout_s
        topic = f"/{self._robot}/camera/image_raw"
        self._subscriber = rospy.Subscriber(topic, Image, self._on_image, queue_size=1, buff_size=2**22)

    def step(self) -> None:
        """Keep the frame that was ordered, if it has come; give it up after a while."""
        if self._subscriber is None:
            return
        with self._lock:
            image, self._image = self._image, None
        if image is None and time.monotonic() < self._deadline:
            return
        self._subscriber.unregister()
        self._subscriber = None
        if image is not None:
            try:
                self._write(image)
            except SensorDataError as exc:
                rospy.logwarn_throttle(10.0, "%s's camera: %s", self._robot, exc)

    def _on_image(self, msg: Image) -> None:
        with self._lock:
            self._image = self._image or msg  # the first

    def _write(self, msg: Image) -> None:
        picture = cv2.cvtColor(rgb_from_msg(msg), cv2.COLOR_RGB2BGR)
        small = cv2.resize(picture, self._params.size(picture.shape), interpolation=cv2.INTER_AREA)
        self._folder.mkdir(exist_ok=True)
        path = self._folder / frame_name(msg.header.stamp.to_sec(), self._robot, self._state)
        cv2.imwrite(str(path), small, [cv2.IMWRITE_JPEG_QUALITY, self._params.quality])
