"""mapping_3d: the driver's OctoMap of a ride, and its way to the hitchhiker (P17 §7.4).

While the robot drives with a hitchhiker behind it, its depth camera fills an OctoMap. When the hitchhiker has left, it
asks for that map and gets it in checked pieces over the network, while both drive on. It arrives bit for bit, or not at
all. A robot without a depth camera only asks. Off, the node listens to hhike_msg/status and nothing else.

Subscribed:
    hhike_msg/status (std_msgs/String): whether the robot carries a rider, or rides
    camera/depth/image_raw (sensor_msgs/Image: 32FC1 in m or 16UC1 in mm, rectified), camera/depth/camera_info
        (sensor_msgs/CameraInfo), amcl_pose (geometry_msgs/PoseWithCovarianceStamped): only while it carries one
    /hhike_msg/network (std_msgs/String), or ~network_in: only from the end of a ride until it
        is known that the map has arrived, or that it does not
Published:
    /hhike_msg/network (std_msgs/String), or ~network_out: map_request, map_offer, map_piece, map_ack
    octomap_binary (std_msgs/UInt8MultiArray, latched): the newest map as a .bt file: of its own ride as a driver when
        that ends, or the one that has arrived
    occupied_cells_vis_array (visualization_msgs/MarkerArray): its occupied voxels, in map; for subscribers only
    map_3d/transfer (std_msgs/String, latched): JSON, protocol.map_transfer.Transfer, when it begins and how it ended
    /diagnostics (diagnostic_msgs/DiagnosticArray)
Parameters:
    ~config (path), sections ``mapping_3d`` (modules.mapping_3d.Mapping3DParameters), ``octree``
        (mapping.octree.OctreeParameters) and ``map_transfer`` (protocol.map_transfer.TransferParameters)
    ~period_s (s, 1): between images that are taken into the map
    ~resolution_m (m, 0.05), ~max_range_m (m, 4), ~stride (pixels, 4): of the map and its images
    ~piece_bytes (4096), ~window (pieces, 16), ~retry_s (s, 1), ~patience_s (s, 60), ~largest_packed (bytes, 2^24),
        ~largest_map (bytes, 2^26): of the transfer
    ~urdf (path): where the depth camera is (link ``depth_camera_optical``), if there is one
    ~robot_id (string, default: the namespace)
    ~network_in, ~network_out (string, /hhike_msg/network): topics where it hears the others and speaks to them
TF: none; the camera is where amcl_pose and ~urdf say that it is.
"""

from __future__ import annotations

from hitchhike_ros.modules.mapping_3d import Mapping3D
from hitchhike_ros.ros_io.host import ModuleHost, Single
from hitchhike_ros.ros_io.node import run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets


def build() -> ModuleHost:
    """The node's host."""
    module = Mapping3D.build(NodeFiles())
    return ModuleHost(Single(module), {module.name: outlets(module.name)})


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros mapping_3d``."""
    run("mapping_3d", build)
