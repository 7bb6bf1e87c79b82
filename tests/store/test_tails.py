"""Reversal times without a mean: t_r goes as 1/xi, and skews may begin at zero."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest
import sweeping

from rattlesweep.statistics.tails import median_error, tail_index
from rattlesweep.store.decide import FIRST_WAVE
from rattlesweep.store.rows import open_stored
from rattlesweep.store.summary import MOST_KEPT, Sample, doubts_of_means

# The closed form, with the paper's range of skews, which begins at zero.
ENDLESS: dict[str, Any] = {
    "seed": 11,
    "model": "gh",
    "bodies": {"source": "sd", "samples": 3000},
    "spin": {"n_i": 0.1, "omega_xy0": 0.01},
}


@pytest.mark.parametrize("index", [0.7, 1.0, 3.0])
def test_the_tail_index_of_powers_of_uniform_numbers(index):
    # u^(-1/alpha) of uniform u is Pareto's distribution with the index alpha.
    uniform = np.random.default_rng(3).random((200, 2000))
    estimates = np.array([tail_index(row ** (-1 / index)) for row in uniform])
    assert estimates.mean() == pytest.approx(index, rel=0.03)
    # Hill's standard error is the index over the root of 67 largest values.
    assert estimates.std() == pytest.approx(index / np.sqrt(67), rel=0.2)


def test_few_or_equal_values_have_no_heavy_tail():
    assert np.isnan(tail_index(np.arange(1.0, 100.0)))
    assert tail_index(np.ones(200)) == np.inf


def test_intervals_of_medians_contain_the_true_median():
    sets = 1 / np.random.default_rng(5).random((1000, 500))  # median 2, no mean
    half = np.array([median_error(row, 1.96) for row in sets])
    medians = np.median(sets, axis=1)
    inside = np.abs(medians - 2) <= half * medians
    assert 0.93 < inside.mean() < 0.98
    assert median_error(np.array([1.0, 2.0]), 1.96) == np.inf


def test_a_case_without_a_mean_runs_all_samples_and_says_so(tmp_path):
    result = sweeping.sweep(tmp_path, ENDLESS | {"stop": {"t_r": 0.2}})
    assert result.runs == 3000
    assert result.summary is not None
    assert 0.7 < result.summary.column("t_r_tail")[0].as_py() < 1.5
    assert "may not exist" in str(doubts_of_means(result.summary))
    runs = open_stored(tmp_path).read(["t_r"]).to_pandas()
    median = result.summary.column("t_r_median")[0].as_py()
    assert median == runs.t_r.median()


def test_the_median_is_known_well_enough_before_all_samples_are_done(tmp_path):
    sweeping.sweep(tmp_path, ENDLESS | {"stop": {"t_r_median": 0.1}})
    runs = pd.read_parquet(tmp_path / "runs")
    assert FIRST_WAVE <= len(runs) < 3000
    assert median_error(runs.t_r.to_numpy(), 1.96) <= 0.1


def test_samples_are_the_first_values_however_they_are_split():
    random = np.random.default_rng(7)
    cell = random.integers(0, 2, 3 * MOST_KEPT)
    values = random.random(len(cell))
    whole = Sample(3)
    whole.add(cell, values)
    pieces = Sample(3)
    for part in np.array_split(np.arange(len(cell)), 11):
        pieces.add(cell[part], values[part])
    first = [values[cell == number][:MOST_KEPT].sum() for number in (0, 1)]
    for sample in (whole, pieces):
        assert sample.each(np.sum)[:2].tolist() == first
        assert np.isnan(sample.each(np.sum)[2])
