"""What P17 measured on its own rides, for the figures to stand beside."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperTimes:
    """A row of P17 Table 2, in seconds."""

    couple_s: float
    decouple_s: float
    wait_s: float
    driver_delay_s: float
    hitchhiker_delay_s: float


@dataclass(frozen=True)
class PaperRide:
    """Ride and award of one of P17's experiments."""

    ride_m: float
    points: float


# P17 Table 2, by world and whether there are new boxes.
PAPER_TIMES = {
    ("p17_exp1", False): PaperTimes(15.00, 17.67, 19.33, 32.67, 52.00),
    ("p17_exp1", True): PaperTimes(15.33, 22.00, 21.67, 37.33, 59.00),
    ("p17_exp2", False): PaperTimes(33.00, 19.00, 11.33, 52.00, 63.33),
    ("p17_exp2", True): PaperTimes(35.00, 21.67, 10.67, 56.67, 67.33),
}

PAPER_RIDES = {"p17_exp1": PaperRide(20.4, 8.2), "p17_exp2": PaperRide(28.82, 11.5)}
