"""The interface of move_base: its action, and the topic of plain goals, which are forwarded to the action."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import actionlib
import rospy
from geometry_msgs.msg import PoseStamped
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseFeedback

from hitchhike_ros.core.datatypes import Pose2D
from hitchhike_ros.core.errors import FrameError
from hitchhike_ros.modules.hitchhike_comm import HitchhikeCommOutputs
from hitchhike_ros.protocol.events import GoalCancelled, GoalGiven
from hitchhike_ros.ros_io.conversions import pose_from_msg, pose_stamped
from hitchhike_ros.ros_io.frames import is_map, pose_in_map


class MoveBaseServer:
    """The action server of one robot.

    ``run`` runs a function on the thread that steps the robot: a goal is accepted there, so that the end of the one
    before it is never taken for its own. ``give`` hands the robot what a client wants, on that thread too.
    """

    def __init__(
        self, run: Callable[[Callable[[], None]], object], give: Callable[[GoalGiven | GoalCancelled], None]
    ) -> None:
        self._run, self._give = run, give
        rospy.set_param("~actionlib_status_frequency", 1.0)  # it also comes at each change
        self._server = actionlib.SimpleActionServer("move_base", MoveBaseAction, auto_start=False)
        self._server.register_goal_callback(lambda: run(self._accept))
        self._server.register_preempt_callback(lambda: run(self._preempt))
        self._plain: PoseStamped | None = None
        self._locates = False  # where the newest goal is: what the robot says is of the one before it
        self._forward = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=5)
        self._server.start()
        self._subscriber = rospy.Subscriber("move_base_simple/goal", PoseStamped, self._on_plain, queue_size=1)

    def tell(self, outputs: HitchhikeCommOutputs) -> None:
        """Tell the client after each step how its goal fares."""
        self._forward_plain()
        if not self._server.is_active():
            return
        if outputs.pose is not None:
            stamped = pose_stamped(outputs.pose.pose, outputs.pose.stamp, "map")
            self._server.publish_feedback(MoveBaseFeedback(base_position=stamped))
        if outputs.outcome is not None and not self._locates:
            finish = self._server.set_succeeded if outputs.outcome.reached else self._server.set_aborted
            finish(text=outputs.outcome.text)

    def _accept(self) -> None:
        if not self._server.is_new_goal_available():
            return  # a newer one has been accepted in its place
        target = self._server.accept_new_goal().target_pose
        if is_map(target.header.frame_id):
            self._take(pose_from_msg(target.pose))
            return
        self._locates = True
        self._give(GoalCancelled())  # the goal before it is preempted, whatever becomes of this one
        handle = self._server.current_goal
        threading.Thread(target=self._transform, args=(target, handle), name="goal", daemon=True).start()

    def _transform(self, target: PoseStamped, handle: Any) -> None:
        """Find out where a goal in another frame is, which may take a moment, and take it where it still counts."""
        try:
            goal, why = pose_in_map(target), ""
        except FrameError as exc:
            goal, why = Pose2D(math.nan), str(exc)

        def take() -> None:
            if self._server.is_active() and self._server.current_goal == handle:
                self._take(goal, why)

        self._run(take)

    def _take(self, goal: Pose2D, why: str = "") -> None:
        self._locates = False
        if goal.is_finite():
            self._give(GoalGiven(goal))
            return
        text = f"goal in {why}" if why else f"goal at {goal}, expected finite numbers"
        rospy.logwarn("move_base: %s", text)
        self._server.set_aborted(text=text)
        self._give(GoalCancelled())  # the goal before it is preempted all the same

    def _preempt(self) -> None:
        if (
            self._server.is_active()
            and self._server.is_preempt_requested()
            and not self._server.is_new_goal_available()
        ):
            self._server.set_preempted(text="Goal cancelled")
            self._give(GoalCancelled())

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
