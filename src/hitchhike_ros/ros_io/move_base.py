"""The interface of move_base: its action, and the plain goal topic that it forwards to the action."""

from __future__ import annotations

import actionlib
import rospy
from geometry_msgs.msg import PoseStamped
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseFeedback

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.protocol.machine import GoalCancelled, GoalGiven
from hitchhike_ros.ros_io.conversions import pose_from_msg, pose_stamped
from hitchhike_ros.ros_io.timer import Timer


class MoveBaseServer:
    """An action server that is polled, so that whoever steps the robot also says what became of its goal."""

    def __init__(self) -> None:
        # Its status comes at each change, and once a second from here: a timer of actionlib's wakes at every tick.
        rospy.set_param("~actionlib_status_frequency", 0.0)
        self._server = actionlib.SimpleActionServer("move_base", MoveBaseAction, auto_start=False)
        self._plain: PoseStamped | None = None
        self._forward = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=5)
        self._server.start()
        self._heartbeat = Timer(1.0, self._server.action_server.publish_status)
        self._subscriber = rospy.Subscriber("move_base_simple/goal", PoseStamped, self._on_plain, queue_size=1)

    @property
    def active(self) -> bool:
        """Whether a client waits for the end of a goal."""
        return bool(self._server.is_active())

    def poll(self) -> GoalGiven | GoalCancelled | None:
        """What a client wants since the last poll; a goal that replaces another one preempts it."""
        self._forward_plain()
        if self._server.is_new_goal_available():
            target = self._server.accept_new_goal().target_pose
            goal, frame = pose_from_msg(target.pose), target.header.frame_id
            if goal.is_finite() and frame.strip("/") in ("map", ""):
                return GoalGiven(goal)
            text = f"goal in frame {frame!r} at {goal}, expected finite and in 'map'"
            rospy.logwarn("move_base: %s", text)
            self._server.set_aborted(text=text)
            return GoalCancelled()  # the goal before it is preempted all the same
        if self.active and self._server.is_preempt_requested():
            self._server.set_preempted(text="Goal cancelled")
            return GoalCancelled()
        return None

    def feed_back(self, pose: Pose2D, stamp: float) -> None:
        """Tell the client where the robot is."""
        self._server.publish_feedback(MoveBaseFeedback(base_position=pose_stamped(pose, stamp, "map")))

    def finish(self, reached: bool, text: str) -> None:
        """End the goal."""
        if reached:
            self._server.set_succeeded(text=text)
        else:
            self._server.set_aborted(text=text)

    def _on_plain(self, msg: PoseStamped) -> None:
        self._plain = msg

    def _forward_plain(self) -> None:
        plain = self._plain
        if plain is not None and self._forward.get_num_connections():  # or the goal would be lost
            self._plain = None
            goal = MoveBaseActionGoal()
            goal.header.stamp = goal.goal_id.stamp = rospy.Time.now()
            goal.goal.target_pose = plain
            self._forward.publish(goal)
