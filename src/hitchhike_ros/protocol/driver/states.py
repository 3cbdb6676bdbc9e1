"""The states of a robot as the one who drives, with their phases."""

from __future__ import annotations

from hitchhike_ros.protocol.phase import Phase, RoleState


class DriverState(RoleState):
    """Where the robot stands as the one who drives, alone or with a rider."""

    IDLE = "idle", Phase.ALONE
    NAVIGATING = "navigating", Phase.ALONE
    YIELDING = "yielding", Phase.ALONE
    OFFERING = "offering", Phase.ASKING
    ALIGNING = "aligning", Phase.MEETING
    ALIGNED = "aligned", Phase.COUPLING
    DRIVING = "driving", Phase.COUPLED
    WAITING_FOR_RIDER = "waiting_for_rider", Phase.COUPLED
    DECOUPLING = "decoupling", Phase.HANDING_OVER
