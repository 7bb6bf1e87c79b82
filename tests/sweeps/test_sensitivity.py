"""Sobol' indices: of functions for which they are known, and of sweeps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sweeping
from refusal import assert_refused
from scipy.stats import sobol_indices
from sweeping import changed, content_hash, invoke, plan_of

from rattlesweep.errors import ConfigError
from rattlesweep.physics import launch, theory
from rattlesweep.sweeps.bodies.quasi import Sequence
from rattlesweep.sweeps.bodies.sampler import bodies_of
from rattlesweep.sweeps.bodies.protocol import Bodies
from rattlesweep.sweeps.old import sensitivity as indices
from rattlesweep.sweeps.old.sensitivity import bins_of, from_bins, from_design, sensitivity

GROUP, GROUPS = 7, 2048
PARAMETERS = ("gamma", "f_sd", "theta", "phi", "minus_xi_deg")
CONFIG: dict[str, Any] = {
    "seed": 4,
    "bodies": {"source": "sd", "samples": GROUP * GROUPS, "draw": "saltelli"},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 2000},
}


def sweep(output: Path, **bodies: Any) -> Path:
    sweeping.sweep(output, changed(CONFIG, bodies=bodies))
    return output


# -- estimators --------------------------------------------------------------------------------

A, B = 7.0, 0.1
"""Of Ishigami's function, whose indices are known (Ishigami and Homma, 1990)."""
VARIANCE = A**2 / 8 + B * np.pi**4 / 5 + B**2 * np.pi**8 / 18 + 0.5
FIRST = np.array([0.5 * (1 + B * np.pi**4 / 5) ** 2, A**2 / 8, 0]) / VARIANCE
TOTAL = FIRST + np.array([1, 0, 1]) * B**2 * np.pi**8 * (1 / 18 - 1 / 50) / VARIANCE


def ishigami(u: np.ndarray) -> np.ndarray:
    x = np.pi * (2 * u - 1)
    return np.sin(x[0]) + A * np.sin(x[1]) ** 2 + B * x[2] ** 4 * np.sin(x[0])


def test_a_design_gives_ishigamis_indices_and_what_scipy_gives():
    a, b = Sequence(6, 1).points(0, 2**14).reshape(2, 3, -1)
    swapped = np.array([np.where(np.arange(3)[:, None] == k, b, a) for k in range(3)])
    values = {"f_A": ishigami(a)[None], "f_B": ishigami(b)[None],
              "f_AB": np.array([ishigami(ab) for ab in swapped])[:, None]}  # fmt: skip
    theirs = sobol_indices(func=values, n=2**14)
    for k in range(3):
        first, total = from_design(ishigami(a), ishigami(b), ishigami(swapped[k]))
        assert (first, total) == pytest.approx((FIRST[k], TOTAL[k]), abs=0.01)
        assert total == pytest.approx(float(theirs.total_order[k]), rel=1e-12)
        assert first == pytest.approx(float(theirs.first_order[k]), abs=1e-12)


def test_bins_give_ishigamis_first_order_indices():
    u = np.random.default_rng(0).random((3, 30_000))
    for k in range(3):
        first, total = from_bins(bins_of(u[k], ishigami(u)), ishigami(u))
        assert first == pytest.approx(FIRST[k], abs=0.02)
        assert np.isnan(total)


# -- designs -----------------------------------------------------------------------------------


@pytest.mark.parametrize("semi_axis", [{}, {"c": [1.5, 4]}], ids=["seven", "eight with c"])
def test_samples_of_a_group_differ_in_one_parameter_each(semi_axis):
    names = ["gamma", "f_sd", "theta", "phi", "xi", *semi_axis]
    n, group = len(names), len(names) + 2
    plan = plan_of(changed(CONFIG, bodies={"samples": group * 512} | semi_axis))
    assert plan.config.bodies.group == group
    b = plan.source.bodies(np.nan, np.arange(group * 40))
    values = np.array([getattr(b, name) for name in names]).reshape(n, 40, group)
    first, second, others = values[:, :, 0], values[:, :, 1], values[:, :, 2:]
    assert (first != second).all()
    for k in range(n):
        for p in range(n):
            assert np.array_equal(others[p, :, k], (second if p == k else first)[p])
    # Each by its number alone.
    some = np.array([3, 4, 5, 277, 8])
    assert np.array_equal(plan.source.bodies(np.nan, some).theta, b.theta[some])


def test_grows_like_others(tmp_path):
    grown = sweep(sweep(tmp_path / "grown", samples=50), samples=210)
    assert content_hash(grown) == content_hash(sweep(tmp_path / "whole", samples=210))


# -- sweeps ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def designed(tmp_path_factory) -> Path:
    return sweep(tmp_path_factory.mktemp("designed") / "out")


@pytest.fixture(scope="module")
def told(designed) -> Any:
    return sensitivity(designed)


@pytest.fixture
def few_replicates(monkeypatch):
    """Intervals of nothing that a test looks at."""
    monkeypatch.setattr(indices, "REPLICATES", 20)


def by_definition(n_i: float, inner: int = 300, outer: int = 300) -> list[float]:
    """First-order indices of P(R) as variances of means over all other parameters."""
    random, found = np.random.default_rng(1), []
    ranges = np.array(plan_of(CONFIG).config.bodies.ranges.ends())
    for k in range(5):
        u = random.random((5, outer, inner))
        u[k] = (np.arange(outer)[:, None] + 0.5) / outer
        gamma, f_sd, theta, phi, xi, alpha, beta = bodies_of(u.reshape(5, -1), ranges)
        b = Bodies(alpha, beta, gamma, theta, phi, xi, f_sd)
        modes = theory.modes(alpha, beta, theta, phi, xi)
        spin, omega = np.full(len(alpha), n_i), np.full(len(alpha), 0.01)
        psi = launch.direction(modes, spin, "relevant")
        t_rgh = launch.garcia_hubbard(b, modes, spin, omega, psi).t_rgh
        y = (t_rgh <= 2000).astype(float).reshape(outer, inner)
        noise = y.var(axis=1, ddof=1).mean() / inner
        found.append(float((y.mean(axis=1).var() - noise) / y.var()))
    return found


def test_indices_of_a_sweep_are_those_of_their_definition(told):
    rows = {row.parameter: row for row in told.rows if (row.case, row.of) == (0, "P(R)")}
    assert list(rows) == list(PARAMETERS)
    for row, value in zip(rows.values(), by_definition(-0.1), strict=True):
        assert row.first == pytest.approx(value, abs=0.05)
        assert row.first_low - 0.03 < value < row.first_high + 0.03
        assert row.total > row.first - 0.05
        assert (row.used, row.left_out) == (3 * GROUPS, 0)
    assert sum(row.first for row in rows.values()) < 1.05
    # Runs that do not reverse are left out and counted.
    times = [row for row in told.rows if (row.case, row.of) == (0, "t_r")]
    assert len(times) == 5
    for row in times:
        assert row.left_out > GROUPS / 2
        assert row.used + row.left_out == 3 * GROUPS
        assert row.first_low <= row.first <= row.first_high
        assert row.total_low <= row.total <= row.total_high


@pytest.mark.usefixtures("few_replicates")
def test_first_order_indices_of_random_bodies_are_those_of_the_design(told, tmp_path):
    sweep(tmp_path, samples=20_000, draw="random")
    plain = {(r.case, r.of, r.parameter): r for r in sensitivity(tmp_path).rows}
    for row in told.rows:
        if row.of == "P(R)":
            other = plain[row.case, row.of, row.parameter]
            assert other.first == pytest.approx(row.first, abs=0.07)
            assert np.isnan(other.total)


@pytest.mark.usefixtures("few_replicates")
@pytest.mark.parametrize("draw", ["saltelli", "sobol"])
def test_a_semi_axis_has_an_index_if_it_has_a_range(draw, tmp_path):
    """It changes nothing in the closed form, and shows as that."""
    fixed = sensitivity(sweep(tmp_path / "fixed", samples=7 * 128, draw=draw, c=3))
    assert {row.parameter for row in fixed.rows} == set(PARAMETERS)
    ranged = sensitivity(sweep(tmp_path / "ranged", samples=8 * 512, draw=draw, c=[1.5, 4]))
    assert ranged.parameters == (*PARAMETERS, "c")
    rows = [row for row in ranged.rows if row.parameter == "c"]
    assert {row.of for row in rows} >= {"t_r", "P(R)"}
    if draw == "saltelli":
        assert {row.total for row in rows} == {0}
        assert {row.total for row in ranged.rows if row.parameter == "phi"} != {0}


@pytest.mark.usefixtures("few_replicates")
def test_the_command_prints_and_draws(tmp_path):
    output = sweep(tmp_path / "out", samples=8 * 256, c=[1.5, 4])
    text = invoke("sensitivity", output, "--figure", tmp_path / "f.svg")
    assert text.exit_code == 0, text.output
    assert "first" in text.stdout
    assert "total" in text.stdout
    assert text.stdout.splitlines()[0].split()[-2:] == ["minus_xi_deg", "c"]
    assert (tmp_path / "f.svg").read_text().count("<svg") == 1
    data = json.loads(invoke("sensitivity", output, "--json").stdout)
    assert {row["parameter"] for row in data["indices"]} == {*PARAMETERS, "c"}
    assert data["draw"] == "saltelli"


def test_what_has_no_indices_is_refused(tmp_path):
    def refused(output: Path, code: int, words: str) -> None:
        assert_refused(invoke("sensitivity", output), code, words)

    few = {"source": "sd", "samples": 20}
    for name, bodies, code, words in (
        ("few", few, 1, "it takes more runs"),
        ("aimed", few | {"target": {"K_r": [0.1], "rel_tol": 0.5}}, 2, "depend on each other"),
        ("preset", {"source": "preset", "name": "GH"}, 2, "not drawn from ranges"),
    ):
        sweeping.sweep(tmp_path / name, CONFIG | {"bodies": bodies})
        refused(tmp_path / name, code, words)
    refused(tmp_path, 2, "is not an output directory")
    with pytest.raises(ConfigError, match="come seven at a time"):
        plan_of(CONFIG, stop={"fraction": 0.1})
