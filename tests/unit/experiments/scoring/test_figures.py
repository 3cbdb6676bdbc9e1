"""Bounds of figures, and figures over several runs."""

from __future__ import annotations

from hitchhike_ros.experiments.scoring.figures import Figure, all_hold, summarize


def test_bounds_hold_in_the_direction_that_is_better() -> None:
    assert Figure("a", 1.0, "s", 1.0).ok is True
    assert Figure("a", 1.1, "s", 1.0).ok is False
    assert Figure("a", 1.0, "", 1.1, "higher").ok is False
    assert Figure("a", float("nan"), "", 1.1).ok is False
    assert Figure("a", 5.0, "").ok is None


def test_a_summary_has_median_worst_and_every_failure() -> None:
    runs = [
        [Figure("gap", value, "m", 0.1), Figure("rtf", factor, "", 0.5, "higher")]
        for value, factor in ((0.02, 0.9), (0.2, 0.6), (0.05, 0.7))
    ]
    gap, rtf = summarize([*runs, [Figure("gap", None, "m", 0.1)]])
    assert (gap.value, gap.worst, gap.ok, gap.failed, gap.runs) == (0.05, 0.2, False, 2, 4)
    assert (rtf.value, rtf.worst, rtf.ok, rtf.failed) == (0.7, 0.6, False, 1)
    assert not all_hold([gap])
