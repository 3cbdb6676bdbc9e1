"""Figures of merit: a value with its bound and the value of a peer, alone or over several runs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Better = Literal["lower", "higher"]


@dataclass(frozen=True)
class Figure:
    """One number that is measured. ``value`` None means that it could not be had, which no bound forgives."""

    name: str
    value: float | None
    unit: str
    bound: float | None = None
    better: Better = "lower"
    peer: float | None = None
    ok: bool | None = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ok", self._holds())

    def _holds(self) -> bool | None:
        if self.bound is None:
            return None
        if self.value is None or not math.isfinite(self.value):
            return False
        return self.value <= self.bound if self.better == "lower" else self.value >= self.bound

    @property
    def ratio(self) -> float | None:
        """Value by peer, None where either is missing."""
        return self.value / self.peer if self.value is not None and self.peer else None


@dataclass(frozen=True)
class Summary:
    """One figure over several runs: ``value`` is the median, ``ok`` whether the bound holds in every run."""

    name: str
    value: float | None
    worst: float | None
    unit: str
    bound: float | None
    better: Better
    peer: float | None
    ok: bool | None
    runs: int
    failed: int


def all_hold(figures: Sequence[Figure] | Sequence[Summary]) -> bool:
    """Whether no bound is broken."""
    return all(figure.ok is not False for figure in figures)


def summarize(runs: Sequence[Sequence[Figure]]) -> list[Summary]:
    """Median and worst of every figure over the runs, in the order in which figures first appear.

    A run that lacks a figure, or has no value for it, counts as failed where there is a bound, and its median and
    worst are of the others.
    """
    names = list(dict.fromkeys(figure.name for run in runs for figure in run))
    return [_summary([next((f for f in run if f.name == name), None) for run in runs]) for name in names]


def _summary(figures: Sequence[Figure | None]) -> Summary:
    first = next(figure for figure in figures if figure is not None)
    values = [f.value for f in figures if f is not None and f.value is not None and math.isfinite(f.value)]
    worst = max if first.better == "lower" else min
    failed = 0 if first.bound is None else sum(f is None or f.ok is not True for f in figures)
    return Summary(
        name=first.name,
        value=float(np.median(values)) if values else None,
        worst=worst(values) if values else None,
        unit=first.unit,
        bound=first.bound,
        better=first.better,
        peer=first.peer,
        ok=None if first.bound is None else failed == 0,
        runs=len(figures),
        failed=failed,
    )


def median(values: Iterable[float]) -> float | None:
    """The value in the middle, None where there are none."""
    found = list(values)
    return float(np.median(found)) if found else None
