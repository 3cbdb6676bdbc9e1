"""The states of a robot as the one who rides, with their phases."""

from __future__ import annotations

from hitchhike_ros.protocol.phase import Phase, RoleState


class HitchhikerState(RoleState):
    """Where the ride stands for the one who rides."""

    IDLE = "idle", Phase.ALONE
    REQUESTING = "requesting", Phase.ASKING
    LOCKING = "locking", Phase.ASKING
    AWAITING_ALIGNED = "awaiting_aligned", Phase.MEETING
    COUPLING = "coupling", Phase.COUPLING
    RIDING = "riding", Phase.COUPLED
    SEEKING = "seeking", Phase.COUPLED
    LOCATING = "locating", Phase.RETURNING
    CATCHING_UP = "catching_up", Phase.RETURNING
    RECOUPLING = "recoupling", Phase.RETURNING
    PARTING = "parting", Phase.PARTING
    SETTLING = "settling", Phase.HANDING_OVER
    RELOCALIZING = "relocalizing", Phase.PARTING
