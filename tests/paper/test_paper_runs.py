"""The command `paper`: single runs (Figs. 4, 5b, 6b, 8), Lyapunov exponents, their claims."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace

import numpy as np
import oracle
import pandas as pd
import pyarrow as pa
import pytest

import rattlesweep as rs
from rattlesweep.integrate.follow.lyapunov import growth_along
from rattlesweep.paper.claims.long import force_words
from rattlesweep.paper.claims.sweeps import swing
from rattlesweep.paper.claims.table import CLAIMS, judge
from rattlesweep.paper.figures import examples, fig4, fig5, fig8
from rattlesweep.paper.figures import fig8_lyapunov as lyapunov
from rattlesweep.paper.figures.registry import FIGURES
from rattlesweep.paper.follow import forces, thin
from rattlesweep.paper.settings import load_paper
from rattlesweep.paper.sweeps import Place, carry_out
from rattlesweep.paper.workers import side_by_side
from rattlesweep.sweeps.config.load import parse_config
from rattlesweep.sweeps.tables.chaos import is_chaotic

GH = rs.Rattleback.gh()
# Long enough for three reversals of either model at each theta.
SHORT_8 = {"t_end": 1.7e4, "tol": 1e-12}


def quiet(fraction, words):
    assert 0 <= fraction <= 1 + 1e-12
    assert words


def place(tmp_path, **changed):
    paper = load_paper()
    sections = {
        name: getattr(paper, name).model_copy(update=values) for name, values in changed.items()
    }
    return Place(paper.model_copy(update=sections), tmp_path, 2)


@pytest.fixture(scope="module")
def four(tmp_path_factory):
    return fig4.compute(place(tmp_path_factory.mktemp("4")), quiet)


@pytest.fixture(scope="module")
def eight(tmp_path_factory):
    return fig8.compute(place(tmp_path_factory.mktemp("8"), fig8=SHORT_8), quiet)


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    settings = {"t_end": 2000.0, "tol": [1e-8, 1e-10]}
    here = place(tmp_path_factory.mktemp("g"), fig8_lyapunov=settings)
    return here, lyapunov.compute(here, quiet)


# --------------------------------------------------------------------------------- helpers


def test_a_thinned_curve_keeps_ends_and_extremes_of_every_stretch():
    values = np.random.default_rng(1).normal(size=10_007)
    chosen = thin(values, 100)
    assert (np.diff(chosen) > 0).all()
    assert (chosen[0], chosen[-1]) == (0, len(values) - 1)
    assert len(chosen) <= 202
    kept = np.zeros(len(values), dtype=bool)
    kept[chosen] = True
    for part in np.array_split(np.arange(len(values)), 50):
        # Any stretch of the double length holds a whole one.
        assert kept[part].any()
        assert values[part][kept[part]].max() >= np.sort(values[part])[-100]
    assert values[chosen].max() == values.max()
    np.testing.assert_array_equal(thin(values[:150], 100), np.arange(150))


def test_forces_are_judged_only_while_the_body_presses_down():
    table = pd.DataFrame(
        {"t": [0.0, 1.0, 2.0, 3.0], "F_normal": [1.0, 0.5, -0.1, 0.9],
         "F_tangential": [0.1, 0.2, 5.0, 0.3]}
    )  # fmt: skip
    row = forces("x", table)
    assert (row["ratio_max"], row["ratio_t"]) == (0.4, 1.0)
    assert (row["normal_min"], row["normal_t"], row["t_end"]) == (-0.1, 2.0, 3.0)
    assert (row["slip_t"], row["open_t"]) == (None, 2.0)
    assert "would be lost at t = 2.0" in force_words(row)


def test_maxima_of_a_modulus_and_their_frequency():
    t = np.arange(0, 60, 0.02)
    times, sizes = fig4.maxima(t, 0.3 * np.cos(1.44 * t + 0.4))
    exact = (np.pi * np.arange(1, len(times) + 1) - 0.4) / 1.44
    np.testing.assert_allclose(times, exact, atol=1e-5)
    np.testing.assert_allclose(sizes, 0.3, rtol=1e-6)
    assert fig4.frequency(times, 30.0, 10.0) == pytest.approx(1.44, rel=1e-6)
    assert fig4.frequency(times, None, 10.0) is None
    assert fig4.frequency(times, 500.0, 10.0) is None


def test_zeros_near_each_other_are_one_reversal():
    groups = fig8.reversals([1.0, 2.0, 5.0, 50.0, 100.0, 103.0], 10.0)
    assert [list(g) for g in groups] == [[1.0, 2.0, 5.0], [50.0], [100.0, 103.0]]
    assert fig8.reversals([], 10.0) == []


def test_tasks_run_side_by_side_and_keep_their_order():
    begun = []

    def task(k):
        def work():
            begun.append(k)
            time.sleep(0.01 * (5 - k))
            return k

        return work

    shares = []
    assert side_by_side([task(k) for k in range(5)], 3, shares.append) == list(range(5))
    assert sorted(begun) == list(range(5))
    assert shares[-1] == 1
    assert side_by_side([], 3, shares.append) == []


def test_a_stop_or_an_error_ends_what_runs_side_by_side():
    begun, gate = [], threading.Event()

    def slow():
        begun.append(1)
        gate.wait(10)

    def stop(share):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        side_by_side([slow] * 20, 2, stop)
    gate.set()
    time.sleep(0.2)
    assert len(begun) <= 4

    def fail():
        raise ArithmeticError("no step")

    with pytest.raises(ArithmeticError, match="no step"):
        side_by_side([fail, lambda: 1], 1, lambda share: None)

    # Nor does the other thread go on when one has failed.
    failed, begun = threading.Event(), []

    def fail_first():
        failed.set()
        raise ArithmeticError("no step")

    def later():
        begun.append(1)
        failed.wait(10)
        time.sleep(0.05)

    with pytest.raises(ArithmeticError):
        side_by_side([later, fail_first] + [later] * 200, 2, lambda share: None)
    time.sleep(0.2)
    assert len(begun) < 10


# ---------------------------------------------------------------------------------- Fig. 4


def test_reversals_of_fig_4_are_those_of_another_integrator(four):
    rows = {row["run"]: row for row in four["runs"].to_pylist()}
    assert rows["unsteady"]["n_i"] == 0.1
    y0 = oracle.launch(oracle.GH, 0.1, 0.01, oracle.relevant_psi(oracle.GH, 0.1))
    t_r = oracle.first_zero(oracle.GH, y0, 150.0, rtol=1e-10, atol=1e-13)[0]
    assert rows["unsteady"]["t_r"] == pytest.approx(t_r, abs=1e-5)
    modes = oracle.modes(oracle.GH)
    assert rows["steady"]["omega_relevant"] == pytest.approx(modes["omega_r"], rel=1e-12)
    # The paper's Eq. (56) [trgh-p].
    n_0 = math.sqrt(0.01 + 1e-4 * _inertia("unsteady", four) / 12.28)
    t_rgh = math.log((n_0 + 0.1) / (n_0 - 0.1)) / (n_0 * modes["K_p"])
    assert rows["unsteady"]["t_rgh"] == pytest.approx(t_rgh, rel=1e-9)


def _inertia(name, tables):
    psi = oracle.relevant_psi(oracle.GH, 0.1 if name == "unsteady" else -0.1)
    return 13.04 * math.cos(psi) ** 2 + 1.522 * math.sin(psi) ** 2


def test_claims_of_fig_4_follow_the_series(four):
    claims = {c.id: c for c in judge({"fig4": four}, theory=False)}
    assert {name: c.verdict for name, c in claims.items()} == {
        "G1": "agree", "G2": "agree", "G3": "agree",
    }  # fmt: skip
    assert claims["G3"].value > 2
    rows = four["runs"].to_pylist()
    late = [row | {"t_r": 2 * row["t_r"]} for row in rows]
    changed = four | {"runs": pa.Table.from_pylist(late, schema=fig4.RUNS)}
    claims = {c.id: c.verdict for c in judge({"fig4": changed}, theory=False)}
    assert claims == dict.fromkeys(("G1", "G2", "G3"), "disagree")
    # With x and y exchanged every statement on them is wrong.
    frame = four["extrema"].to_pandas()
    frame["component"] = frame["component"].map({"omega_x": "omega_y", "omega_y": "omega_x"})
    changed = four | {"extrema": pa.Table.from_pandas(frame, preserve_index=False)}
    swapped = {c.id: c for c in judge({"fig4": changed}, theory=False)}["G3"]
    assert swapped.verdict == "disagree"
    assert swapped.score == "1 of 6"


def test_claims_of_other_runs_are_not_made(four):
    rows = [row | {"n_i": 2 * row["n_i"]} for row in four["runs"].to_pylist()]
    changed = four | {"runs": pa.Table.from_pylist(rows, schema=fig4.RUNS)}
    assert judge({"fig4": changed}, theory=False) == []


def test_a_large_mode_alone_swings_as_it_does_at_the_reversal(four):
    rows = {row["run"]: row for row in four["runs"].to_pylist()}
    assert rows["unsteady"]["frequency_free"] / rows["unsteady"]["omega_relevant"] < 0.97
    assert rows["steady"]["frequency_free"] / rows["steady"]["omega_relevant"] > 1.03
    small = fig4.free_frequency(1e-4, "omega_x", 80.0, 1e-10)
    assert small == pytest.approx(oracle.modes(oracle.GH)["omega_p"], rel=1e-5)


# ------------------------------------------------------------------------- Figs. 5(b), 6(b)

STEADY = {
    "name": "steady",
    "seed": 5,
    "bodies": {"source": "sd", "samples": 12, "target": {"K_r": [0.02, 0.05], "rel_tol": 1e-2}},
    "spin": {"n_i": [-0.3, -0.5], "omega_xy0": [0.001, 0.1]},
    "horizon": {"t_rgh": 5},
}
CHOICE = {
    "examples": {
        "ss": {"n_i": -0.5, "omega_xy0": 0.001},
        "sw": {"n_i": -0.3, "omega_xy0": 0.1},
        "chaotic": {"K_r": 0.02, "n_i": -0.5},
        "t_end": 1e5,
    },
    "rk4": {"samples": 1, "dt": 0.002},
    "basin": {"n_i": -0.5, "omega_xy0": [0.1]},
    "lyapunov": 100,
}


@pytest.fixture(scope="module")
def chosen(tmp_path_factory):
    paper = load_paper()
    settings = type(paper.fig6).model_validate(CHOICE)
    here = Place(paper.model_copy(update={"fig6": settings}), tmp_path_factory.mktemp("6"), 2)
    sweep = carry_out(parse_config(STEADY), here.directory / "own", 2, quiet)
    return here, sweep, examples.compute(here, sweep, quiet)


def test_examples_are_runs_of_the_sweep_by_their_rule(chosen):
    _, sweep, tables = chosen
    rows = {row["example"]: row for row in tables["examples"].to_pylist()}
    assert {"spin_ss", "spin_sw"} <= set(rows)
    runs = pd.concat(
        [own.assign(K_r=case.target) for case, own in sweep.cases(
            ("sample", "n_i", "omega_xy0", "n_end", "n_departure", "type", "t_end"))]
    )  # fmt: skip
    for name, kind, by, n_i, size in (("spin_ss", "SS", "n_end", -0.5, 0.001),
                                      ("spin_sw", "SW", "n_departure", -0.3, 0.1)):  # fmt: skip
        own = runs[(runs["n_i"] == n_i) & (runs["omega_xy0"] == size) & (runs["type"] == kind)]
        row = rows[name]
        match = own[(own["K_r"] == row["K_r"]) & (own["sample"] == row["sample"])]
        assert len(match) == 1
        if kind == "SS":
            below = (own[by] < match[by].iloc[0]).sum()
            assert below == (len(own) - 1) // 2
        # The trace is that run: it ends where the sweep's does.
        spin = tables[name].to_pandas()
        assert spin["t"].iloc[0] == 0
        assert spin["n"].iloc[0] == n_i
        assert spin["t"].iloc[-1] == pytest.approx(match["t_end"].iloc[0], abs=0.05)
        assert spin["n"].iloc[-1] == pytest.approx(match["n_end"].iloc[0], rel=0.02)


def test_lyapunov_exponents_are_those_of_every_wobbling_run(chosen):
    _, sweep, tables = chosen
    rows = tables["chaos"].to_pandas()
    wobbling = sum((own["type"] == "SW").sum() for _, own in sweep.cases(("type",)))
    assert len(rows) == wobbling > 0
    np.testing.assert_array_equal(rows["chaotic"], is_chaotic(rows["lyapunov_late"], rows["t_end"]))
    assert rows.loc[~rows["chaotic"], "growth_longer"].isna().all()
    # The other way to the same number: one run alone, by its own driver.
    calm = rows[~rows["chaotic"]].iloc[0]
    run = examples.stored(sweep, calm.to_dict())
    constants, y0 = examples.launch(sweep, run)
    t_end = calm["t_end"]
    alone = growth_along(constants, y0, [t_end], tol=1e-10)[0]
    assert calm["lyapunov"] * t_end == pytest.approx(alone, abs=0.5)


def wobbling(slow=0, fast=40, total=1000):
    rows = [
        {"K_r": k, "n_i": n, "omega_xy0": 0.01, "chaotic": False, "growth_longer": np.nan}
        for n in (-0.3, -0.5) for k in (0.005, 0.08) for _ in range(total // 2)
    ]  # fmt: skip
    frame = pd.DataFrame(rows)
    frame.loc[frame.index[:slow], ["chaotic", "growth_longer"]] = [True, 50.0]
    fast_small = frame.index[(frame["n_i"] == -0.5) & (frame["K_r"] == 0.005)][:fast]
    frame.loc[fast_small, "chaotic"] = True
    return frame


def s5(runs):
    """The only claim that the runs settle, without the types of the sweep."""
    tables = {"fig6": {"chaos": pa.Table.from_pandas(runs, preserve_index=False)}}
    return next(claim for claim in CLAIMS if claim.id == "S5").judge(tables)


def test_one_chaotic_slow_run_is_enough_for_partly():
    assert s5(wobbling()).verdict == "agree"
    one = s5(wobbling(slow=1))
    assert one.verdict == "partly"
    assert one.low < one.value == 0.001 < one.high < 0.01
    assert "The 1 chaotic ones" in one.evidence
    assert s5(wobbling(slow=100, fast=0)).verdict == "disagree"
    assert s5(wobbling().query("n_i == -0.5")) is None


def test_the_fast_run_of_gh_swings_at_twice_the_frequency_of_the_pitch(tmp_path):
    here = place(tmp_path, fig5={"t_end": 60.0})
    small = {**STEADY, "name": "unsteady", "spin": {"n_i": [0.1], "omega_xy0": [0.01]},
             "bodies": {"source": "sd", "samples": 2, "target": {"K_p": [0.5]}}}  # fmt: skip
    here.paper = here.paper.model_copy(update={"unsteady": parse_config(small)})
    tables = fig5.compute(here, quiet)
    spin = tables["spin"].to_pandas()
    late = spin[spin["t"] > 30]
    # Once up through the middle each period.
    periods = [(np.diff(np.sign(late[c] - late[c].rolling(100, center=True).mean())) > 0).sum()
               for c in ("n", "omega_x")]  # fmt: skip
    assert periods[0] == pytest.approx(2 * periods[1], abs=2)
    assert swing(tables["spin"])[0] == pytest.approx(2, abs=0.1)
    press = tables["forces"].to_pylist()[0]
    assert press["ratio_max"] > 0.5


# ---------------------------------------------------------------------------------- Fig. 8


def test_the_reduced_model_begins_as_the_caption_says(eight):
    """E_p(0) is the launch's, E_r(0) is given: C_I and E_tot follow, and with them the period."""
    rows = eight["invariants"].to_pandas().query("model == 'reduced'")
    energy = 0.5 * 1e-4 * _inertia("unsteady", eight)
    modes = oracle.modes(oracle.GH)
    c_i = oracle.reduced_C_I([0.1, energy, 3e-5], modes["K_p"], modes["K_r"])
    own = rows[rows["theta"] == 0.6429].iloc[0]
    assert own["casimir_low"] == pytest.approx(c_i, rel=1e-8)
    assert own["casimir_high"] == pytest.approx(c_i, rel=1e-8)


def test_runs_of_fig_8_are_the_papers(eight):
    full = eight["reversals"].to_pandas().query("model == 'full'")
    first = full.groupby("theta")["t"].first()
    assert first[0.6429] == pytest.approx(112.0939, abs=1e-3)
    # "the second spin reversal around 3000"
    assert full[full["theta"] == 0.82]["t"].iloc[1] == pytest.approx(3000, rel=0.01)
    reduced = eight["reversals"].to_pandas().query("model == 'reduced'")
    for _, own in reduced.groupby("theta"):
        gaps = np.diff(own["t"])
        np.testing.assert_allclose(gaps, gaps[0], rtol=1e-9)
    spin = eight["spin"].to_pandas()
    for _, own in spin.groupby("theta"):
        assert (np.diff(own["t"]) > 0).all()
        assert own["n"].abs().max() < 0.11
        assert own["n_reduced"].abs().max() < 0.11


def test_the_casimir_invariant_of_averaged_energies():
    t = np.arange(0, 100, 0.01)
    period = 10.0
    swing = np.cos(2 * np.pi * t / period)
    table = pd.DataFrame({"t": t, "E_p": 2e-3 * (1 + 0.9 * swing), "E_r": 5e-3 * (1 - 0.5 * swing)})
    found = fig8.averaged_casimir(type("T", (), {"table": table}), 0.55, 0.1, period)
    inside = (t > period) & (t < 90)
    wanted = math.log(2e-3) / 0.55 + math.log(5e-3) / 0.1
    np.testing.assert_allclose(found[inside], wanted, atol=0.02)


def exponents(growth):
    rows = [
        {"theta": theta, "tol": tol, "t_end": 1e5, "exponent": g / 5e4, "error": 1e-5, "growth": g}
        for theta, g in zip((0.6429, 0.82, 0.9), growth, strict=True) for tol in (1e-11, 1e-13)
    ]  # fmt: skip
    return pa.Table.from_pylist(rows, schema=lyapunov.EXPONENTS)


@pytest.mark.parametrize(
    ("growth", "verdict"),
    [((1, 100, 1), "agree"), ((1, 100, 20), "partly"), ((1, 1, 1), "disagree")],
)
def test_verdict_on_chaos_follows_the_exponents(eight, growth, verdict):
    figures = {"fig8": eight, "fig8_lyapunov": {"exponents": exponents(growth)}}
    claims = {c.id: c for c in judge(figures, theory=False)}
    assert claims["L1"].verdict == verdict
    assert (claims["L2"].verdict, claims["L3"].verdict) == ("agree", "agree")
    assert 0.18 < claims["L3"].value < 0.22
    assert ("narrow" in claims["L1"].evidence) == (growth[2] > 10)


def test_too_few_reversals_settle_nothing(eight):
    few = eight["reversals"].to_pandas().groupby(["theta", "model"]).head(2)
    figures = {"fig8": eight | {"reversals": pa.Table.from_pandas(few, preserve_index=False)}}
    assert judge(figures, theory=False) == []


def test_exponents_are_growth_over_time(grown):
    here, tables = grown
    growth, rows = tables["growth"].to_pandas(), tables["exponents"].to_pylist()
    assert len(rows) == 6
    body = replace(GH, theta=0.9)
    modes = rs.modes(body)
    assert modes.omega_r < modes.omega_p
    for row in rows:
        own = growth[(growth["theta"] == row["theta"]) & (growth["tol"] == row["tol"])]
        assert (np.diff(own["t"]) > 0).all()
        np.testing.assert_allclose(own["exponent"], own["growth"] / own["t"])
        end = own["growth"].iloc[-1] - own["growth"].iloc[own["t"].searchsorted(1000.0)]
        assert row["growth"] == pytest.approx(end)
        assert row["exponent"] == pytest.approx(end / 1000.0)
        assert row["error"] > 0
    assert here.paper.fig8_lyapunov.quick().t_end == 1000


# -------------------------------------------------------------------------------- pictures


def test_pictures_of_the_runs(four, eight, grown):
    for name, tables, panels in (("fig4", four, 6), ("fig8", eight, 3),
                                 ("fig8_lyapunov", grown[1], 1)):  # fmt: skip
        figure = FIGURES[name].draw(tables)
        assert len(figure.axes) == panels
        for axis in figure.axes:
            for line in axis.lines:
                x = np.asarray(line.get_xdata(), dtype=float)
                assert np.isfinite(x).all()
    first = FIGURES["fig4"].draw(four).axes[0]
    assert len(first.lines) == 4
