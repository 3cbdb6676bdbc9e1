"""What a human operator typed and sent, as ``scripted_operator`` counts it, beside another run (P18 §7)."""

from __future__ import annotations

from pathlib import Path

import msgspec

from hitchhike_ros.core.errors import InputFileError
from hitchhike_ros.experiments.scoring.figures import Figure

NAME = "operator.json"
# One operator brings two robots over the ride with at most this share of what driving both takes.
MAX_SHARE = 0.5


class OperatorCounts(msgspec.Struct, frozen=True):
    """``commands`` are Twist messages to robots; ``bytes`` are of those and of the keys."""

    keys: int
    commands: int
    bytes: int
    completed: bool


def load_counts(folder: Path) -> OperatorCounts | None:
    """Of the run that left ``folder``; None where nobody teleoperated.

    Raises:
        InputFileError: the file is not what ``scripted_operator`` writes.
    """
    path = folder / NAME
    try:
        return msgspec.json.decode(path.read_bytes(), type=OperatorCounts)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError) as exc:
        raise InputFileError(path, "", str(exc), "what scripted_operator writes") from exc


def count_figures(counts: OperatorCounts) -> list[Figure]:
    """Of one run."""
    values = {"keys": counts.keys, "commands": counts.commands, "bytes": counts.bytes}
    return [Figure(f"operator_{name}", float(value), "") for name, value in values.items()]


def share_figures(with_ride: OperatorCounts, both: OperatorCounts) -> list[Figure]:
    """What teleoperating the driver of a ride takes, by what driving both robots takes."""
    pairs = {"commands": (with_ride.commands, both.commands), "bytes": (with_ride.bytes, both.bytes)}
    return [
        Figure(f"operator_{name}_ratio", ridden / driven if driven else None, "", MAX_SHARE)
        for name, (ridden, driven) in pairs.items()
    ]
