"""What modules say, as messages."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
import rospy

from hitchhike_ros.core.datatypes import CameraInfo
from hitchhike_ros.mapping.octree import OccupancyOctree, OctreeParameters, read_voxels
from hitchhike_ros.protocol.map_transfer import Transfer
from hitchhike_ros.ros_io.outlets import MAPPING_3D, PATH_PLANNING


@pytest.fixture(autouse=True)
def _ros_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rospy, "get_time", lambda: 12.5)


def test_the_report_of_a_plan_is_published_before_it() -> None:
    assert [outlet.field for outlet in PATH_PLANNING] == ["report", "plan"]


def test_a_map_is_published_whole_and_as_voxels_on_demand() -> None:
    tree = OccupancyOctree(OctreeParameters(stride=1))
    tree.insert(np.ones((3, 4), np.float32), CameraInfo(4, 3, np.diag([5.0, 6.0, 1.0])), np.eye(4))
    by_topic = {outlet.topic: outlet for outlet in MAPPING_3D}
    file, cells = by_topic["octomap_binary"], by_topic["occupied_cells_vis_array"]
    assert (file.latch, cells.latch, cells.on_demand) == (True, False, True)
    (msg,) = file.convert(tree.file())
    assert bytes(msg.data) == tree.file()
    (markers,) = cells.convert(tree.file)
    assert sum(len(marker.points) for marker in markers.markers) == len(read_voxels(tree.file()).sides)
    assert {marker.header.stamp.to_sec() for marker in markers.markers} == {12.5}


def test_each_transfer_is_a_message() -> None:
    transfers = (Transfer("driver", "moving", "a", "b", "r"), Transfer("driver", "arrived", "a", "b", "r", seconds=2.5))
    by_topic = {outlet.topic: outlet for outlet in MAPPING_3D}
    said = [msgspec.json.decode(msg.data, type=Transfer) for msg in by_topic["map_3d/transfer"].convert(transfers)]
    assert said == list(transfers)
