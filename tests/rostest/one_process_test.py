#!/usr/bin/python3
"""P17 Experiment 1 with boxes, all modules of a robot in one process: each bound holds as with a node each."""

import sys
from pathlib import Path

import rosnode
import rospy
import rostest

sys.path.insert(0, str(Path(__file__).resolve().parent))
from ride_test import RideTest


class OneProcessTest(RideTest):
    """The ride of a node each, looked at alike; what is about nodes of their own is left out."""

    test_modules_that_are_off_cost_nothing = None
    test_the_composed_ride_is_the_same = None

    def test_a_robot_is_one_node(self) -> None:
        names = set(rosnode.get_node_names())
        for robot in ("p3dx", "turtlebot"):
            self.assertIn(f"/{robot}/robot", names)
            for module in ("slam", "path_planning", "visual_servoing", "velocity_mux"):
                self.assertNotIn(f"/{robot}/{module}", names)

    def test_every_module_says_how_it_is(self) -> None:
        for module in ("slam", "path_planning", "obstacle_avoidance", "visual_servoing", "hitchhike_comm"):
            self.watch.until(lambda module=module: f"p3dx: {module}" in self.watch.diagnostics, 30, module)


if __name__ == "__main__":
    rospy.init_node("one_process_test")
    rostest.rosrun("hitchhike_ros", "one_process", OneProcessTest)
