"""Sobol' indices: of functions for which they are known, and of sweeps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from refusal import assert_refused
from scipy.stats import sobol_indices

from rattlesweep.cli import main
from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.cases.quasi import Sequence
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.engines.run import run_sweep
from rattlesweep.sweeps.inspect import sensitivity as indices
from rattlesweep.sweeps.inspect.content_hash import content_hash
from rattlesweep.sweeps.inspect.sensitivity import (
    Sensitivity,
    bins_of,
    from_bins,
    from_design,
    sensitivity,
)

GROUP, GROUPS = 7, 2048
PARAMETERS = ("gamma", "f_sd", "theta", "phi", "minus_xi_deg")
CONFIG: dict[str, Any] = {
    "seed": 4,
    "bodies": {"source": "sd", "samples": GROUP * GROUPS, "draw": "saltelli"},
    "spin": {"n_i": [-0.1, 0.2], "omega_xy0": 0.01},
    "model": "gh",
    "horizon": {"t": 2000},
}


def sweep(output: Path, **changes: Any) -> Path:
    run_sweep(make_plan(parse_config(CONFIG | changes)), output)
    return output


# -- estimators ------------------------------------------------------------------------------------

A, B = 7.0, 0.1
"""Of Ishigami's function, whose indices are known (Ishigami and Homma, 1990)."""
VARIANCE = A**2 / 8 + B * np.pi**4 / 5 + B**2 * np.pi**8 / 18 + 0.5
FIRST = np.array([0.5 * (1 + B * np.pi**4 / 5) ** 2, A**2 / 8, 0]) / VARIANCE
TOTAL = FIRST + np.array([1, 0, 1]) * B**2 * np.pi**8 * (1 / 18 - 1 / 50) / VARIANCE


def ishigami(u: np.ndarray) -> np.ndarray:
    x = np.pi * (2 * u - 1)
    return np.sin(x[0]) + A * np.sin(x[1]) ** 2 + B * x[2] ** 4 * np.sin(x[0])


def test_a_design_gives_ishigamis_indices():
    points = Sequence(6, 1).points(np.arange(2**14))
    a, b = points[:3], points[3:]
    for k in range(3):
        ab = np.where(np.arange(3)[:, None] == k, b, a)
        found = from_design(ishigami(a), ishigami(b), ishigami(ab))
        assert found == pytest.approx((FIRST[k], TOTAL[k]), abs=0.01)


def test_a_design_gives_what_scipy_gives():
    random = np.random.default_rng(0)
    a, b = random.random((2, 3, 1024))
    swapped = np.array([np.where(np.arange(3)[:, None] == k, b, a) for k in range(3)])
    values = {"f_A": ishigami(a)[None], "f_B": ishigami(b)[None],
              "f_AB": np.array([ishigami(ab) for ab in swapped])[:, None]}  # fmt: skip
    theirs = sobol_indices(func=values, n=1024)
    for k in range(3):
        first, total = from_design(ishigami(a), ishigami(b), ishigami(swapped[k]))
        assert total == pytest.approx(float(theirs.total_order[k]), rel=1e-12)
        assert first == pytest.approx(float(theirs.first_order[k]), abs=1e-12)


def test_bins_give_ishigamis_first_order_indices():
    u = np.random.default_rng(0).random((3, 30_000))
    for k in range(3):
        first, total = from_bins(bins_of(u[k], ishigami(u)), ishigami(u))
        assert first == pytest.approx(FIRST[k], abs=0.02)
        assert np.isnan(total)


# -- designs ---------------------------------------------------------------------------------------


def test_seven_samples_differ_in_one_parameter_each():
    plan = make_plan(parse_config(CONFIG))
    b = plan.source.bodies(0, np.arange(7 * 40))
    values = np.array([b.gamma, b.f_sd, b.theta, b.phi, b.xi]).reshape(5, 40, 7)
    first, second, others = values[:, :, 0], values[:, :, 1], values[:, :, 2:]
    assert (first != second).all()
    for k in range(5):
        for p in range(5):
            assert np.array_equal(others[p, :, k], (second if p == k else first)[p])
    # Each by its number alone.
    some = np.array([3, 4, 5, 277, 8])
    assert np.array_equal(plan.source.bodies(0, some).theta, b.theta[some])


def test_eight_where_the_semi_axis_has_a_range(tmp_path):
    """Which changes nothing in the closed form, and shows as that."""
    bodies = CONFIG["bodies"] | {"samples": 8 * 512, "c": [1.5, 4]}
    plan = make_plan(parse_config(CONFIG | {"bodies": bodies}))
    b = plan.source.bodies(0, np.arange(8 * 40))
    values = np.array([b.gamma, b.f_sd, b.theta, b.phi, b.xi, b.c]).reshape(6, 40, 8)
    first, second, others = values[:, :, 0], values[:, :, 1], values[:, :, 2:]
    assert (first != second).all()
    for k in range(6):
        for p in range(6):
            assert np.array_equal(others[p, :, k], (second if p == k else first)[p])
    found = sensitivity(sweep(tmp_path / "out", bodies=bodies))
    assert found.parameters == (*PARAMETERS, "c")
    rows = [row for row in found.rows if row.parameter == "c"]
    assert {row.of for row in rows} >= {"t_r", "P(R)"}
    assert {row.total for row in rows} == {0}
    assert {row.total for row in found.rows if row.parameter == "phi"} != {0}
    text = CliRunner().invoke(main, ["sensitivity", str(tmp_path / "out"), "--figure",
                                     str(tmp_path / "f.svg")])  # fmt: skip
    assert text.exit_code == 0, text.output
    assert text.stdout.splitlines()[0].split()[-2:] == ["minus_xi_deg", "c"]


@pytest.mark.parametrize("draw", ["saltelli", "sobol"])
def test_a_semi_axis_without_a_range_has_no_index(tmp_path, draw):
    bodies = {"source": "sd", "samples": 7 * 128, "draw": draw, "c": 3}
    assert parse_config(CONFIG | {"bodies": bodies}).bodies.group == 7
    found = sensitivity(sweep(tmp_path / "out", bodies=bodies))
    assert {row.parameter for row in found.rows} == set(PARAMETERS)
    ranged = sensitivity(sweep(tmp_path / "ranged", bodies=bodies | {"c": [2, 3]}))
    assert {row.parameter for row in ranged.rows} == {*PARAMETERS, "c"}


def test_grows_like_others(tmp_path):
    small = {"source": "sd", "samples": 50, "draw": "saltelli"}
    grown = sweep(tmp_path / "grown", bodies=small)
    sweep(grown, bodies=small | {"samples": 210})
    whole = sweep(tmp_path / "whole", bodies=small | {"samples": 210})
    assert content_hash(grown) == content_hash(whole)


# -- sweeps ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sweep(tmp_path_factory.mktemp("designed") / "out")


@pytest.fixture(scope="module")
def told(designed: Path) -> Sensitivity:
    return sensitivity(designed)


@pytest.fixture
def few_replicates(monkeypatch):
    """Intervals of nothing that a test looks at."""
    monkeypatch.setattr(indices, "REPLICATES", 20)


def brute_force(n_i: float, inner: int = 400, outer: int = 400) -> dict[str, np.ndarray]:
    """First-order indices of P(R) and log t_r by their definition: variances of means."""
    random = np.random.default_rng(1)
    plan = make_plan(parse_config(CONFIG))
    ranges = np.array(plan.config.bodies.ranges.ends())
    from rattlesweep.physics import launch, theory
    from rattlesweep.sweeps.cases.sampler import bodies_of
    from rattlesweep.sweeps.cases.sources import Bodies

    firsts: dict[str, list[float]] = {"P(R)": []}
    for k in range(5):
        u = random.random((5, outer, inner))
        u[k] = (np.arange(outer)[:, None] + 0.5) / outer
        columns = bodies_of(u.reshape(5, -1), ranges)
        gamma, f_sd, theta, phi, xi, alpha, beta = columns
        b = Bodies(alpha, beta, gamma, theta, phi, xi, f_sd)
        modes = theory.modes(alpha, beta, theta, phi, xi)
        spin = np.full(len(alpha), n_i)
        psi = launch.direction(modes, spin, "relevant")
        gh = launch.garcia_hubbard(b, modes, spin, np.full(len(alpha), 0.01), psi)
        y = (gh.t_rgh <= 2000).astype(float).reshape(outer, inner)
        noise = y.var(axis=1, ddof=1).mean() / inner
        firsts["P(R)"].append(float((y.mean(axis=1).var() - noise) / y.var()))
    return {name: np.array(values) for name, values in firsts.items()}


def test_indices_of_a_sweep_are_those_of_their_definition(told):
    exact = brute_force(-0.1)["P(R)"]
    rows = {row.parameter: row for row in told.rows if (row.case, row.of) == (0, "P(R)")}
    assert list(rows) == list(PARAMETERS)
    for name, value in zip(PARAMETERS, exact, strict=True):
        row = rows[name]
        assert row.first == pytest.approx(value, abs=0.05)
        assert row.first_low - 0.03 < value < row.first_high + 0.03
        assert row.total > row.first - 0.05
        assert (row.used, row.left_out) == (3 * GROUPS, 0)
    assert sum(row.first for row in rows.values()) < 1.05


def test_runs_that_do_not_reverse_are_left_out_and_counted(told):
    rows = [row for row in told.rows if (row.case, row.of) == (0, "t_r")]
    assert len(rows) == 5
    for row in rows:
        assert row.left_out > GROUPS / 2
        assert row.used + row.left_out == 3 * GROUPS
        assert row.first_low <= row.first <= row.first_high
        assert row.total_low <= row.total <= row.total_high


@pytest.mark.usefixtures("few_replicates")
def test_first_order_indices_of_random_bodies_are_those_of_the_design(told, tmp_path):
    sweep(tmp_path, bodies={"source": "sd", "samples": 20_000})
    plain = {(r.case, r.of, r.parameter): r for r in sensitivity(tmp_path).rows}
    for row in told.rows:
        if row.of == "P(R)":
            other = plain[row.case, row.of, row.parameter]
            assert other.first == pytest.approx(row.first, abs=0.07)
            assert np.isnan(other.total)


@pytest.mark.usefixtures("few_replicates")
def test_the_command_prints_and_draws(designed, tmp_path):
    run = CliRunner().invoke
    text = run(main, ["sensitivity", str(designed), "--figure", str(tmp_path / "f.svg")])
    assert text.exit_code == 0, text.output
    assert "first" in text.stdout
    assert "total" in text.stdout
    assert (tmp_path / "f.svg").read_text().count("<svg") == 1
    data = json.loads(run(main, ["sensitivity", str(designed), "--json"]).stdout)
    assert {row["parameter"] for row in data["indices"]} == set(PARAMETERS)
    assert data["draw"] == "saltelli"


def test_what_has_no_indices_is_refused(tmp_path):
    def refused(output: Path, code: int, words: str) -> None:
        assert_refused(CliRunner().invoke(main, ["sensitivity", str(output)]), code, words)

    few = {"source": "sd", "samples": 20}
    refused(sweep(tmp_path / "few", bodies=few), 1, "it takes more runs")
    aimed = few | {"target": {"K_r": [0.1], "rel_tol": 0.5}}
    refused(sweep(tmp_path / "aimed", bodies=aimed), 2, "depend on each other")
    preset = {"source": "preset", "name": "GH"}
    refused(sweep(tmp_path / "preset", bodies=preset), 2, "not drawn from ranges")
    refused(tmp_path, 2, "is not an output directory")
    with pytest.raises(ConfigError, match="come seven at a time"):
        parse_config(CONFIG | {"stop": {"fraction": 0.1}})
