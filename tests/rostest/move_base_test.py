#!/usr/bin/python3
"""The action of move_base, by an unmodified client: arrival, preemption, cancel, aborts that say why, make_plan."""

import math
import sys
import unittest
from pathlib import Path

import actionlib
import rospy
import rostest
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionResult, MoveBaseFeedback, MoveBaseGoal
from nav_msgs.srv import GetPlan
from std_msgs.msg import String

sys.path.insert(0, str(Path(__file__).resolve().parent))
from watch import Watch

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.geometry import compose, distance, wrap_angle
from hitchhike_ros.ros_io.conversions import pose_from_msg, pose_stamped

RESULT = "/turtlebot/move_base/result"
DEADLINE_S = 200.0  # of wall time, for a way of a few metres and for giving up


def goal(x: float, y: float, theta: float = 0.0, frame: str = "map") -> MoveBaseGoal:
    return MoveBaseGoal(target_pose=pose_stamped(Pose2D(x, y, theta), rospy.Time.now().to_sec(), frame))


class MoveBaseTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls) -> None:
        cls.watch = Watch("turtlebot")
        cls.touched: list[str] = []
        cls.watch.subscribe("/simulator/contacts", String, lambda msg: cls.touched.append(msg.data))
        cls.watch.subscribe(RESULT, MoveBaseActionResult)
        cls.client = actionlib.SimpleActionClient("/turtlebot/move_base", MoveBaseAction)
        cls.watch.until(lambda: "/turtlebot/ground_truth" in cls.watch.newest, 120, "the simulation runs")
        assert cls.client.wait_for_server(rospy.Duration(60))
        cls.feedback: list[MoveBaseFeedback] = []

    def send(self, where: MoveBaseGoal) -> None:
        self.feedback.clear()
        self.watch.newest.pop(RESULT, None)
        self.client.send_goal(where, feedback_cb=self.feedback.append)

    def result(self) -> tuple[int, str]:
        """Status and text of the next result."""
        status = self.watch.until(lambda: self.watch.newest.get(RESULT), DEADLINE_S, "a result").status
        return status.status, status.text

    def assert_there(self, x: float, y: float, theta: float) -> None:
        truth = self.watch.truth("turtlebot")
        self.assertLessEqual(distance(truth, Pose2D(x, y)), 0.15)
        self.assertLessEqual(abs(wrap_angle(truth.theta - theta)), math.radians(7))

    def assert_stops(self) -> None:
        """Within what braking takes: a metre at most, and half a second of reaction."""
        before = self.watch.truth("turtlebot")
        self.watch.until(lambda: abs(self.watch.speed("turtlebot")) < 0.01, 60, "the robot stands")
        self.assertLess(distance(before, self.watch.truth("turtlebot")), 1.0)
        self.assertEqual("idle", self.watch.state("turtlebot"))

    def drive_on(self, speed: float = 0.3) -> None:
        self.watch.until(lambda: self.watch.speed("turtlebot") > speed, DEADLINE_S, "the robot drives")

    def test_1_a_goal_is_reached_with_feedback_on_the_way(self) -> None:
        self.send(goal(4.0, 5.5, math.pi / 2))
        self.assertEqual(GoalStatus.SUCCEEDED, self.result()[0])
        self.assert_there(4.0, 5.5, math.pi / 2)
        places = [pose_from_msg(f.base_position.pose) for f in self.feedback]
        self.assertGreater(len(places), 20)
        self.assertEqual("map", self.feedback[-1].base_position.header.frame_id)
        self.assertLess(distance(places[0], Pose2D(2.0, 5.72)), 0.3)
        self.assertLess(distance(places[-1], Pose2D(4.0, 5.5)), 0.15)

    def test_2_a_new_goal_preempts_and_is_driven_to(self) -> None:
        self.send(goal(15.0, 5.72))
        self.drive_on()
        self.send(goal(5.0, 5.5, math.pi))
        self.assertEqual(GoalStatus.PREEMPTED, self.result()[0])
        self.watch.until(lambda: self.watch.newest[RESULT].status.status == GoalStatus.SUCCEEDED, DEADLINE_S, "arrival")
        self.assert_there(5.0, 5.5, math.pi)

    def test_3_a_cancel_stops_the_robot(self) -> None:
        self.send(goal(2.0, 5.6))
        self.drive_on()
        self.client.cancel_goal()
        self.assertEqual(GoalStatus.PREEMPTED, self.result()[0])
        self.assert_stops()

    def test_4_the_plain_goal_topic_is_an_action_too(self) -> None:
        topic = rospy.Publisher("/turtlebot/move_base_simple/goal", PoseStamped, queue_size=1)
        self.watch.until(topic.get_num_connections, 60, "a subscriber")
        self.watch.newest.pop(RESULT, None)
        topic.publish(goal(6.0, 5.5).target_pose)
        self.drive_on()
        self.client.cancel_all_goals()
        self.assertEqual(GoalStatus.PREEMPTED, self.result()[0])
        self.assert_stops()

    def test_4b_a_goal_in_another_frame_is_where_that_frame_has_it(self) -> None:
        start = self.watch.truth("turtlebot")
        self.send(goal(0.6, 0.0, frame="turtlebot/base_footprint"))
        self.assertEqual(GoalStatus.SUCCEEDED, self.result()[0])
        ahead = compose(start, Pose2D(0.6))
        self.assert_there(ahead.x, ahead.y, ahead.theta)

    def test_5_aborts_say_why(self) -> None:
        for where, why in (
            (goal(10.0, 4.5), "to the nearest obstacle"),  # in the wall
            (goal(-5.0, 4.5), "outside the map"),
            (goal(4.0, 5.5, frame="cellar"), "frame 'cellar', expected 'map' or one that TF connects with it"),
            (goal(4.0, 5.5, math.nan), "expected finite numbers"),
        ):
            self.send(where)
            status, text = self.result()
            self.assertEqual(GoalStatus.ABORTED, status)
            self.assertIn(why, text)
        self.assertLess(abs(self.watch.speed("turtlebot")), 0.01)

    def test_6_make_plan_answers(self) -> None:
        rospy.wait_for_service("/turtlebot/make_plan", 30)
        make_plan = rospy.ServiceProxy("/turtlebot/make_plan", GetPlan)
        start, end = goal(2.0, 5.72).target_pose, goal(20.0, 5.72).target_pose
        poses = make_plan(start, end, 0.0).plan.poses
        self.assertAlmostEqual(2.0, poses[0].pose.position.x, places=3)
        self.assertAlmostEqual(20.0, poses[-1].pose.position.x, places=3)
        self.assertEqual([], make_plan(start, goal(10.0, 4.5).target_pose, 0.0).plan.poses)
        for end_of_path in (start, end):
            end_of_path.pose.orientation.w = end_of_path.pose.orientation.z = 0.0  # nobody has said
        self.assertEqual(len(poses), len(make_plan(start, end, 0.0).plan.poses))

    def test_7_nothing_was_touched(self) -> None:
        self.assertEqual([], self.touched)


if __name__ == "__main__":
    rospy.init_node("move_base_test")
    rostest.rosrun("hitchhike_ros", "move_base", MoveBaseTest)
