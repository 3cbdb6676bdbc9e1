"""robot: all modules of a robot in one process, in place of a node each; less CPU and memory for the same topics.

Sensors, orders, services and the action are those of slam, path_planning, obstacle_avoidance, visual_servoing,
hitchhike_comm, velocity_mux and, with ~map_3d, mapping_3d (``rosrun hitchhike_ros NODE --help``). What a module says to
another one is handed over in the process, and published too where somebody else subscribes.

Parameters:
    ~config, ~urdf, ~world (paths), ~robot_id, ~network_in, ~network_out, ~awards, ~initial_pose_x, ~initial_pose_y,
        ~initial_pose_a, ~method: as of those nodes
    ~map_3d (bool, false): whether the depth camera makes a 3D map of each ride that the robot gives, and the robot gets
        that of each ride that it takes
    ~map (path, default none): map_server YAML file, which the node then serves itself, as original_map,
        original_map_metadata and static_map; without it another node's static_map is asked for the map
    SECTION/FIELD in the robot's namespace, as hitchhiking/profile: replaces a field of a component's section of ~config
TF: as of slam.
"""

from __future__ import annotations

from hitchhike_ros.modules.path_planning import PathPlanning
from hitchhike_ros.modules.robot import build as build_robot
from hitchhike_ros.modules.slam import Slam
from hitchhike_ros.nodes.robot.hitchhike_comm import Surroundings
from hitchhike_ros.nodes.robot.map_server import MapServer
from hitchhike_ros.nodes.robot.path_planning import serve_make_plan
from hitchhike_ros.nodes.robot.slam import localization_method, serve_global_localization, start_from_parameters
from hitchhike_ros.ros_io.host import ModuleHost
from hitchhike_ros.ros_io.node import DiagnosticsUpdater, run
from hitchhike_ros.ros_io.node_files import NodeFiles
from hitchhike_ros.ros_io.outlets import outlets
from hitchhike_ros.ros_io.parameters import given, is_given, parameter


def build() -> ModuleHost:
    """The node's host."""
    files = NodeFiles()
    map_3d = parameter("map_3d", bool, False)
    robot = build_robot(files, localization_method(), map_3d=map_3d)
    slam, planning = robot.modules["slam"], robot.modules["path_planning"]
    assert isinstance(slam, Slam)
    assert isinstance(planning, PathPlanning)
    start_from_parameters(slam)
    updater = DiagnosticsUpdater()
    surroundings = Surroundings(files.robot_id, updater)
    said = {name: outlets(name) for name in robot.modules}
    host = ModuleHost(robot, said, orders=False, also=surroundings.take, updater=updater)
    if is_given("map"):
        MapServer(str(given("map")), files.grid, updater, "original_map")  # its topics and its service keep it
    surroundings.serve(host)
    serve_make_plan(host, planning)
    serve_global_localization(host, slam)
    return host


def main() -> None:
    """Entry point of ``rosrun hitchhike_ros robot``."""
    run("robot", build)
