"""Times as ROS carries them: whole seconds and nanoseconds."""

from __future__ import annotations

import math

_NANO = 1_000_000_000


def split(seconds: float) -> tuple[int, int]:
    """Whole seconds and the nearest nanoseconds of a time in s.

    They are taken apart first, as the nanoseconds since 1970 are more than a float can count.

    >>> split(2.0 / 3.0)
    (0, 666666667)
    """
    whole = math.floor(seconds)
    nanoseconds = round((seconds - whole) * _NANO)
    return (whole + 1, 0) if nanoseconds == _NANO else (whole, nanoseconds)


def carried(seconds: float) -> float:
    """The time that is read from a message which was stamped with ``seconds``.

    It stays the same from then on, however often it is carried.

    >>> carried(2.0 / 3.0)
    0.666666667
    """
    whole, nanoseconds = split(seconds)
    return whole + nanoseconds / _NANO
