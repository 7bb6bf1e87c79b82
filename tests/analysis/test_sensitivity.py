"""Sobol' indices: of functions for which they are known, and of sweeps."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from editing import edited, replaced
from refusal import assert_refused
from scipy.stats import sobol_indices
from sweeping import invoke, sweep

from rattlesweep.analysis.sensitivity import MOST_MISSING, indices, sensitivity
from rattlesweep.design.bodies.sources import sequence_points

GROUP = 7
GROUPS = 256
PARAMETERS = ("gamma", "f_sd", "theta", "phi", "minus_xi_deg")
CONFIG: dict[str, Any] = {
    "seed": 4,
    "bodies": {"source": "sd", "samples": GROUP * GROUPS, "draw": "saltelli"},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 1e5},
}
# Ishigami's function, whose indices are known (Ishigami and Homma, 1990).
A = 7.0
B = 0.1
VARIANCE = A**2 / 8 + B * np.pi**4 / 5 + B**2 * np.pi**8 / 18 + 0.5
FIRST = np.array([0.5 * (1 + B * np.pi**4 / 5) ** 2, A**2 / 8, 0]) / VARIANCE
TOTAL = FIRST + np.array([1, 0, 1]) * B**2 * np.pi**8 * (1 / 18 - 1 / 50) / VARIANCE


def ishigami(u: np.ndarray) -> np.ndarray:
    x = np.pi * (2 * u - 1)
    return np.sin(x[0]) + A * np.sin(x[1]) ** 2 + B * x[2] ** 4 * np.sin(x[0])


def test_a_design_gives_ishigamis_indices_within_their_intervals_and_those_of_scipy():
    a, b = sequence_points(6, 1, 0, 2**12).reshape(2, 3, -1)
    swapped = [np.where(np.arange(3)[:, None] == k, b, a) for k in range(3)]
    f = np.array([ishigami(a), ishigami(b), *map(ishigami, swapped)])
    found = indices(f)
    theirs = sobol_indices(
        func={"f_A": f[:1], "f_B": f[1:2], "f_AB": f[2:, None]}, n=2**12
    )
    first, total = ([row[name] for row in found] for name in ("first", "total"))
    np.testing.assert_allclose(
        first, theirs.first_order.ravel(), rtol=1e-10, atol=1e-14
    )
    np.testing.assert_allclose(total, theirs.total_order.ravel(), rtol=1e-10)
    for k, row in enumerate(found):
        assert (row["first"], row["total"]) == pytest.approx(
            (FIRST[k], TOTAL[k]), abs=0.03
        )
        assert row["first_low"] - 0.01 <= FIRST[k] <= row["first_high"] + 0.01
        assert row["total_low"] - 0.01 <= TOTAL[k] <= row["total_high"] + 0.01


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The closed form over the ranges: everything reverses by the horizon but for small
    skew.
    """
    output = tmp_path_factory.mktemp("design") / "out"
    sweep(output, CONFIG)
    return output


def test_the_command_prints_and_draws_what_theory_depends_on(design, tmp_path):
    text = invoke("sensitivity", design, "--figure", tmp_path / "f.svg")
    assert text.exit_code == 0, text.output
    assert {line.split()[6] for line in text.stdout.splitlines()[1:6]} == set(
        PARAMETERS
    )
    assert (tmp_path / "f.svg").read_text().count("<svg") == 1
    data = json.loads(invoke("sensitivity", design, "--json").stdout)
    rows = [
        row for row in data["indices"] if (row["case"], row["of"]) == (1, "log10 t_r")
    ]
    assert [row["parameter"] for row in rows] == list(PARAMETERS)
    by = {row["parameter"]: row["total"] for row in rows}
    # t_rGH goes as 1/K_p, which the skew and phi make.
    assert by["minus_xi_deg"] > by["phi"] > by["gamma"]
    assert by["theta"] < 0.05
    assert rows[0]["used"] + rows[0]["left_out"] == GROUP * GROUPS


def test_incomplete_groups_are_noted_and_too_many_refused(design, tmp_path):
    """A run that does not reverse takes its group away, and too many must not be
    lost.
    """

    def without(share: float, rows: Any) -> Any:
        sample = np.asarray(rows["sample"])
        lost = (sample // GROUP < share * GROUPS) & (sample % GROUP == 3)
        types = np.where(lost, "SW", rows["type"].to_numpy(zero_copy_only=False))
        return replaced(rows, "type", types.tolist())

    few, many = (
        sensitivity(
            edited(
                design, tmp_path / str(share), partial(without, share * MOST_MISSING)
            )
        )
        for share in (0.5, 2)
    )
    assert any((row["case"], row["of"]) == (1, "log10 t_r") for row in few["indices"])
    # Skews begin at 0, so the variance of t_r, which goes as 1/xi, does not exist.
    assert all(row["of"] != "t_r" for row in few["indices"])
    assert any("longest runs and may not exist" in note for note in few["notes"])
    assert {row["of"] for row in many["indices"] if row["case"] == 1} == {
        "P(R)",
        "P(SW)",
    }
    assert any("do not represent the ranges" in note for note in many["notes"])


@pytest.mark.parametrize(
    ("bodies", "code", "words"),
    [
        (
            {"source": "sd", "samples": 28, "draw": "saltelli"},
            1,
            "more runs are needed",
        ),
        ({"source": "sd", "samples": 20}, 2, "bodies.draw: saltelli"),
    ],
)
def test_what_has_no_indices_is_refused(tmp_path, bodies, code, words):
    sweep(tmp_path / "out", CONFIG | {"bodies": bodies})
    assert_refused(invoke("sensitivity", tmp_path / "out"), code, words)
