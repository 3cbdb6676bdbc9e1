"""A real robot's log: the filter with the papers' landmarks, and its reader."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hitchhike_ros.core.errors import InputFileError
from hitchhike_ros.experiments.bench.mrclam import MrclamParameters, evaluate, read_run


@pytest.fixture(scope="module")
def run(shared_data):
    log = read_run(shared_data / "mrclam")
    return replace(log, truth=log.truth[::10])  # known 60 times a second; scored less often, for the time it takes


@pytest.mark.parametrize(("association", "bound_m"), [("known", 0.15), ("signature", 0.25), ("blind", 0.25)])
def test_mean_position_error(run, association, bound_m):
    score = evaluate(run, association)
    assert score.mean_position_error_m <= bound_m
    assert score.used < score.seen  # barcodes of robots, unknown ones and outliers are left out


# Chi-square quantiles at 90 and 99.9 %.
@pytest.mark.parametrize(("blind_gate", "noise"), [(4.61, 0.7), (13.82, 1.5)])
def test_without_barcodes_no_lucky_gate_is_needed(run, blind_gate, noise):
    p = MrclamParameters()
    changed = replace(
        p,
        blind_gate=blind_gate,
        range_sigma_m=noise * p.range_sigma_m,
        range_sigma_ratio=noise * p.range_sigma_ratio,
        bearing_sigma_rad=noise * p.bearing_sigma_rad,
    )
    assert evaluate(run, "blind", changed).mean_position_error_m <= 0.25


def test_dead_reckoning_alone_is_lost(run):
    assert evaluate(run, "none").mean_position_error_m > 1.0


def test_only_landmarks_are_taken_for_landmarks(run):
    assert len(run.landmarks) == 15
    assert run.landmarks.signatures[0] == 63
    np.testing.assert_allclose(run.landmarks.positions[0], [0.588, -4.283], atol=1e-3)


@pytest.mark.parametrize("text", ["1 2 3\n", "1 x\n", "1 nan\n"])
def test_a_bad_file_is_named(tmp_path, text):
    (tmp_path / "Barcodes.dat").write_text(text)
    with pytest.raises(InputFileError, match="Barcodes"):
        read_run(tmp_path)
