"""As a human wants: what teleoperation asks for, slower where the robot could not brake before contact."""

from __future__ import annotations

import numpy as np

from hitchhike_ros.control.leg import Decision, Leg, ProgressCheck, Scene
from hitchhike_ros.control.local_planner_parameters import LocalPlannerParameters
from hitchhike_ros.control.safe_motion import SafeMotion
from hitchhike_ros.core.datatypes import FloatArray, Twist2D

# Shares of the speed that is asked for, of which the largest that is safe is driven.
_SHARES = np.array([1.0, 0.8, 0.6, 0.4, 0.2, 0.0])


class GuidedDriving:
    """Drives as it is told, with a path to come back to."""

    def __init__(self, params: LocalPlannerParameters, motion: SafeMotion) -> None:
        self._params, self._motion = params, motion

    def step(self, scene: Scene, leg: Leg, wanted: Twist2D) -> Decision:
        """The nearest safe motion to ``wanted``; blocked is only the path, from too far beside it."""
        # It goes where and when the human wants: that is no lack of progress.
        leg.progress = ProgressCheck(scene.now, scene.pose, scene.now)
        leg.detour, leg.turning = None, False
        if self._motion.touches(scene):
            return Decision(Twist2D(), "blocked", scene.touched)
        targets = self._targets(scene, wanted)
        safe = self._motion.can_stop(scene, targets)
        chosen = int(np.argmax(safe)) if safe.any() else -1
        command = Twist2D()  # brake as hard as the base can
        if safe.any():
            command = self._motion.towards(scene, Twist2D(float(targets[chosen, 0]), float(targets[chosen, 1])))
        leg.s, off_path = leg.path.project(scene.pose.x, scene.pose.y)
        if off_path > self._params.max_off_path_m:  # path_planning plans anew
            return Decision(command, "blocked", f"driven by hand, {off_path:.2f} m off the path")
        held = chosen != 0 and wanted != Twist2D()
        return Decision(command, "driving", "driven by hand" + (", held back by an obstacle" if held else ""))

    def _targets(self, scene: Scene, wanted: Twist2D) -> FloatArray:
        """Velocities (K, 2), best first; the last one stands."""
        limits = scene.limits
        # Not backwards: what is behind was seen a while ago, if ever, and the human does not see it either.
        v = min(max(wanted.v, 0.0), limits.max_speed_mps) * _SHARES
        omega = np.clip(np.full_like(v, wanted.omega), -limits.max_yaw_rate_rps, limits.max_yaw_rate_rps)
        if scene.gentle:
            in_view = self._params.in_view_rps(v)
            omega = np.clip(omega, -in_view, in_view)
        return np.vstack([np.stack([v, omega], axis=1), np.zeros(2)])
