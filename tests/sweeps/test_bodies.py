"""Where bodies come from: random numbers, the four sources, and what they refuse."""

from __future__ import annotations

import math
import pickle
from decimal import Decimal
from typing import Any

import numpy as np
import pandas as pd
import pytest
import sweeping
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.stats import qmc
from sweeping import prepared, rows

import rattlesweep as rs
from rattlesweep.errors import ConfigError
from rattlesweep.physics import theory
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.sweeps.bodies import sources, tablefile
from rattlesweep.sweeps.bodies.philox import uniforms
from rattlesweep.sweeps.bodies.sampler import draw_bodies
from rattlesweep.sweeps.bodies.sources import CHUNK
from rattlesweep.sweeps.config.read import parse_config, physics_hash
from rattlesweep.sweeps.config.schema import Target
from rattlesweep.sweeps.launches import prepare

SPIN = {"n_i": -0.1, "omega_xy0": 0.01}
TABLE_I = {
    "gamma": [5, 15], "f_sd": [0.05, 0.15], "theta": [0.6, 0.95], "phi": [0.01, 0.1],
    "minus_xi_deg": [0, 6],
}  # fmt: skip
RANGES = np.array(list(TABLE_I.values()), dtype=float)
GH = "13.04,1.522,12.28,0.6429,0.036,-0.03"
HEAD = ",".join(PARAMETERS)
PRESET = {"source": "preset", "name": "GH"}
GRID = {"source": "grid", "base": {"preset": "GH"}}


def plan(bodies: dict[str, Any], spin: dict[str, Any] | None = SPIN, **others: Any) -> Any:
    data = {"bodies": bodies, **others}
    return sweeping.plan_of(data if spin is None else {**data, "spin": spin})


def drawn(samples: int = 0, **bodies: Any) -> dict[str, Any]:
    return {"source": "sd", "samples": samples, **bodies}


def columns(bodies: Any) -> np.ndarray:
    return np.array([getattr(bodies, name) for name in PARAMETERS])


def bodies_of(plan: Any, target: float = math.nan, samples: Any = None) -> np.ndarray:
    """Parameters of a plan's bodies, of the shape (6, samples)."""
    some = np.arange(plan.samples) if samples is None else np.asarray(samples)
    return columns(plan.source.bodies(target, some))


def refusals(bodies: dict[str, Any], spin: Any = SPIN) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        plan(bodies, spin).source.check_targets()
    return caught.value.messages


def refusal(bodies: dict[str, Any], spin: Any = SPIN) -> str:
    (line,) = refusals(bodies, spin)
    assert "\n" not in line
    assert len(line) < 500
    return line


# -- random numbers ----------------------------------------------------------------------------

words = st.integers(0, 2**63 - 1) | st.integers(0, 3) | st.integers(2**63 - 3, 2**63 - 1)
signed = st.integers(-(2**63), 2**63 - 1)


@settings(max_examples=200, deadline=None)
@given(words, signed, words, st.integers(0, 2**61) | st.integers(0, 3))
@example(0, 0, 0, 0)
@example(2**63 - 1, -(2**63), 2**63 - 1, 2**61)
def test_the_bits_are_those_of_numpys_philox(seed, word, sample, draw):
    # As one 256-bit integer: a list with numbers above 2^63 would become floats.
    key, counter = seed + (word % 2**64 << 64), 2 * draw + (sample << 64)
    generator = np.random.Generator(np.random.Philox(key=key, counter=counter))
    assert uniforms(seed, word, sample, draw) == tuple(generator.random(8))


def test_draws_fill_the_ranges_uniformly_and_independently():
    n = 20_000
    gamma, f_sd, theta, phi, xi, alpha, beta = draw_bodies(2017, np.arange(n), RANGES)[0]
    low, high = RANGES.T[:, :, None]
    unit = (np.array([gamma, f_sd, theta, phi, -np.degrees(xi)]) - low) / (high - low)
    assert 0 <= unit.min() <= unit.max() <= 1 + 1e-15
    assert (unit.min(axis=1) < 1e-3).all()
    assert (unit.max(axis=1) > 1 - 1e-3).all()
    assert min(stats.kstest(values, "uniform").pvalue for values in unit) > 1e-3
    assert np.abs(np.corrcoef(unit) - np.eye(5)).max() < 4 / math.sqrt(n)
    # The draw 1 - u lies in (0, 1]: the angle is never zero.
    assert (xi < 0).all()
    assert np.array_equal(alpha, (1 - f_sd) * gamma + 1)
    assert np.array_equal(beta, f_sd * gamma + 1)


def sobol(samples: Any, seed: int = 7) -> np.ndarray:
    """Points of the unit cube behind bodies that are drawn by a sequence."""
    b = plan(drawn(20_000, draw="sobol"), seed=seed).source.bodies(math.nan, np.asarray(samples))
    low, high = RANGES.T[:, :, None]
    points = (np.stack([b.gamma, b.f_sd, b.theta, b.phi, -np.degrees(b.xi)]) - low) / (high - low)
    points[4] = 1 - points[4]
    return points


def test_a_sequence_is_scipys_and_fills_every_cell_equally():
    theirs = qmc.Sobol(5, rng=np.random.default_rng((7, 0))).random(64).T
    np.testing.assert_allclose(sobol(range(64)), theirs, atol=1e-12)
    # 2^k points have one in each of 2^k equal parts of every range, which random ones do not.
    cells = np.sort(np.floor(256 * sobol(range(256))), axis=1)
    assert np.array_equal(cells, np.tile(np.arange(256), (5, 1)))


def test_points_of_a_sequence_depend_on_seed_and_number_alone():
    every = sobol(range(2 * CHUNK + 50))
    for samples in ([5], [0, 1, 9], [CHUNK + 3, 3, 2 * CHUNK + 10], [8000, 8001, 0, 1]):
        assert np.array_equal(sobol(samples), every[:, samples])
    assert not np.array_equal(sobol([0, 1]), sobol([0, 1], seed=8))
    # The default way to draw is no part of the hash.
    hashes = [physics_hash(parse_config({"bodies": drawn(9, **draw), "spin": SPIN}))
              for draw in ({}, {"draw": "random"}, {"draw": "sobol"})]  # fmt: skip
    assert hashes[0] == hashes[1] != hashes[2]


# -- shell-dumbbell bodies ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values"), [("K_r", [0.0041, 0.03, 0.1]), ("K_p", [0.05, 0.45, 2.34])]
)
def test_targets_are_met(name, values):
    made = plan(drawn(100, target={name: values, "rel_tol": 2e-3}))
    for value in values:
        b = made.source.bodies(value, np.arange(100))
        found = getattr(theory.modes(b.alpha, b.beta, b.theta, b.phi, b.xi), name)
        assert (np.abs(found - value) <= 2e-3 * value * (1 + 1e-12)).all()
        assert np.ptp(found) > 1e-3 * value
        for values_, (low, high) in zip((b.gamma, b.f_sd, b.theta, b.phi), RANGES, strict=False):
            assert low <= values_.min() <= values_.max() <= high


def test_cases_of_one_target_share_their_bodies():
    spin = {"n_i": [-0.1, -0.5], "omega_xy0": [0.001, 0.1]}
    made = plan(drawn(7, target={"K_r": [0.03, 0.1], "rel_tol": 0.05}), spin)
    cases = columns(prepared(made)[0].bodies).T.reshape(8, 7, 6)
    assert (cases.reshape(2, 4, 7, 6) == cases[::4, None]).all()
    assert not np.isin(cases[0], cases[4]).any()
    # Targets first, then spins, then oscillations: the order of the config.
    order = [(case.n_i, case.omega_xy0) for case in made.cases]
    assert order == [(-0.1, 0.001), (-0.1, 0.1), (-0.5, 0.001), (-0.5, 0.1)] * 2


@pytest.mark.parametrize("target", [None, {"K_r": [0.03, 0.1], "rel_tol": 0.05}])
def test_a_body_depends_on_seed_target_and_sample_alone(target):
    """Not on the chunk in which it is drawn, nor on the order in which it is asked for."""
    n = CHUNK + 50
    config, rng = drawn(n, **({"target": target} if target else {})), np.random.default_rng(1)
    for value in target["K_r"] if target else [math.nan]:
        fresh, whole = plan(config, seed=3), bodies_of(plan(config, seed=3), value)
        for picks in ([n - 1], [0], rng.choice(n, 200)):
            assert np.array_equal(bodies_of(fresh, value, picks), whole[:, picks])
    more = bodies_of(plan(config | {"samples": 2 * n}, seed=3), value, np.arange(n))
    assert np.array_equal(more, whole)
    assert not np.isin(bodies_of(plan(config | {"samples": 20}, seed=4), value), whole).any()


@pytest.mark.parametrize("semi_axis", [{}, {"c": [1.5, 4]}], ids=["seven", "eight with c"])
def test_samples_of_a_group_differ_in_one_parameter_each(semi_axis):
    """Saltelli's design: a point, another, and each parameter of the first taken from the other."""
    names = ["gamma", "f_sd", "theta", "phi", "xi", *semi_axis]
    n, group = len(names), len(names) + 2
    made = plan(drawn(group * 512, draw="saltelli", **semi_axis))
    b = made.source.bodies(math.nan, np.arange(group * 40))
    values = np.array([getattr(b, name) for name in names]).reshape(n, 40, group)
    first, second, others = values[:, :, 0], values[:, :, 1], values[:, :, 2:]
    assert (first != second).all()
    for k in range(n):
        for p in range(n):
            assert np.array_equal(others[p, :, k], (second if p == k else first)[p])


def test_targets_in_front_or_between_leave_the_draws_of_the_others():
    def of(*values: float, name: str = "K_r") -> dict[float, bytes]:
        made = plan(drawn(40, target={name: values, "rel_tol": 0.05}))
        return {value: bodies_of(made, value).tobytes() for value in values}

    two, more = of(0.03, 0.1), of(0.02, 0.03, 0.05, 0.1)
    assert all(more[value] == two[value] for value in two)
    assert len(set(more.values())) == 4


def test_the_two_coefficients_have_draws_of_their_own():
    # Every body meets a target of such a tolerance, so that the first draws are compared.
    ranges = np.array([[10, 12], [0.1, 0.12], [0.7, 0.8], [0.05, 0.06], [2.0, 2.1]])
    firsts = []
    for name, place in (("K_p", 2), ("K_r", 3)):
        _, _, *shape, alpha, beta = draw_bodies(1, np.arange(3), ranges)[0]
        value = float(theory.torque_coefficients(alpha, beta, *shape)[place][0])
        aim = Target(**{name: [value], "rel_tol": 0.5})
        firsts.append(draw_bodies(1, np.arange(3), ranges, aim, value))
    assert [draws.tolist() for _, draws in firsts] == [[1, 1, 1]] * 2
    assert not np.isin(firsts[0][0], firsts[1][0]).any()


@pytest.mark.parametrize("draw", [{}, {"draw": "sobol"}, {"target": {"K_r": [0.1]}}])
def test_a_source_is_pickled_without_what_it_has_drawn(draw):
    made = plan(drawn(300, **draw))
    fresh = pickle.dumps(made.source)
    bodies = bodies_of(made, 0.1)
    assert pickle.dumps(made.source) == fresh
    there = pickle.loads(fresh).bodies(0.1, np.arange(300))
    assert np.array_equal(columns(there), bodies)


def test_a_body_does_not_depend_on_threads_or_neighbours():
    target = Target(K_r=[0.05], rel_tol=0.01)
    one, *others = (
        draw_bodies(1, np.arange(301), RANGES, target, 0.05, threads=threads)
        for threads in (1, 2, 3)
    )
    for other in others:
        assert [part.tobytes() for part in other] == [part.tobytes() for part in one]
    # Whichever runs are asked for together, and in whatever order.
    made = plan(drawn(33, target={"K_r": [0.01, 0.1], "rel_tol": 0.1}))
    whole = prepared(made)[0]
    order = np.random.default_rng(5).permutation(66)
    mixed = prepare(made, *np.divmod(order, 33))
    assert np.array_equal(columns(mixed.bodies), columns(whole.bodies)[:, order])
    assert np.array_equal(mixed.gh.t_rgh, whole.gh.t_rgh[order])


@pytest.mark.parametrize(("name", "value"), [("K_r", 5.0), ("K_p", 1e-9)])
def test_an_impossible_target_says_how_close_the_ranges_get(name, value):
    line = refusal(drawn(10**6, target={name: [0.1, value], "max_draws": 20_000}))
    assert line.startswith(f"bodies.target.{name}: {value:g} was not met to 0.001 in 20000 draws")
    nearest = float(line.split("the nearest being ")[1].split(";")[0])
    b = draw_bodies(0, np.arange(200_000), RANGES)[0]
    every = getattr(theory.modes(b[5], b[6], b[2], b[3], b[4]), name)
    # The nearest of 20,000 draws of one sample: of the order of the nearest of all.
    assert abs(math.log(nearest / (every.max() if value > 1 else every.min()))) < 5
    assert every.min() < nearest < every.max() * 1.5


# -- presets and grids -------------------------------------------------------------------------


def test_a_preset_is_one_body_with_what_was_replaced():
    gh = rs.Rattleback.gh()
    made = plan(PRESET | {"overrides": {"theta": 0.82, "xi_deg": -2}})
    expected = [[gh.alpha], [gh.beta], [gh.gamma], [0.82], [gh.phi], [math.radians(-2)]]
    assert bodies_of(made).tolist() == expected
    assert np.isnan(made.source.bodies(math.nan, np.array([0])).f_sd).all()


def test_a_grid_goes_through_its_axes_the_first_one_slowest():
    axes = {"theta": {"linspace": [0.6, 0.9, 4]}, "phi": [0.02, 0.036], "xi_deg": [-1, -3]}
    made = plan(GRID | {"axes": axes})
    b = bodies_of(made)
    grid = np.meshgrid([0.6, 0.7, 0.8, 0.9], [0.02, 0.036], np.radians([-1, -3]), indexing="ij")
    np.testing.assert_allclose(b[3:], [values.ravel() for values in grid], rtol=1e-15)
    assert (b[0] == 13.04).all()
    assert np.array_equal(bodies_of(made, samples=[3, 9]), b[:, [3, 9]])


def test_a_grid_over_a_shell_dumbbell_body_remakes_its_inertia():
    base = {"gamma": 10, "f_sd": 0.1, "theta": 0.7, "phi": 0.05, "xi_deg": -3}
    axes = {"gamma": [8, 10], "f_sd": [0.1, 0.2], "minus_xi_deg": {"logspace": [0.01, 1, 3]}}
    b = plan(GRID | {"base": base, "axes": axes}).source.bodies(math.nan, np.arange(12))
    # The axes in the order in which a body lists its parameters.
    assert b.gamma.tolist() == [8.0] * 6 + [10.0] * 6
    assert b.f_sd.tolist() == ([0.1] * 3 + [0.2] * 3) * 2
    np.testing.assert_allclose(-np.degrees(b.xi), [0.01, 0.1, 1] * 4, rtol=1e-14)
    assert np.array_equal(b.beta, b.f_sd * b.gamma + 1)
    assert np.array_equal(b.alpha, (1 - b.f_sd) * b.gamma + 1)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"overrides": {"theta": 1.2}}, "theta: 1.2 is given; it should be less than 1"),
        ({"overrides": {"theta": 0.03}}, "phi 0.036 is not below theta 0.03"),
        ({"overrides": {"phi": 0.7}}, "phi 0.7 is not below theta 0.6429"),
        ({"overrides": {"beta": 14}}, "alpha 13.04 is not above beta 14"),
        ({"overrides": {"alpha": 20}},
         "no body has this inertia: I_xx = alpha - 1 = 19 exceeds"),
        ({"overrides": {"gamma": 13}}, "no body has this inertia: I_zz = gamma = 13 exceeds"),
        ({"overrides": {"xi": 0.1}}, "xi: 0.1 is given; it should be less than 0"),
        # gamma 13 exceeds I_xx + I_yy = 12.562 of GH's alpha and beta, but only there.
        ({"axes": {"theta": [0.7, 0.8], "gamma": [12, 12.28, 13]}},
         "at alpha 13.04, beta 1.522, gamma 13, theta 0.7, phi 0.036, xi -0.0300197: no body has "
         "this inertia: I_zz = gamma = 13 exceeds I_xx + I_yy = 12.562"),
        ({"axes": {"phi": [0.02, 0.7]}}, "phi 0.7 is not below theta 0.6429"),
    ],
)  # fmt: skip
def test_impossible_presets_and_corners_of_grids_are_named(source, words):
    line = refusal((GRID if "axes" in source else PRESET) | source)
    assert line.startswith("bodies.axes: at alpha " if "axes" in source else "bodies.overrides")
    assert words in line


# -- tables ------------------------------------------------------------------------------------


def table(directory: Any, text: str) -> dict[str, Any]:
    (directory / "b.csv").write_text(text, encoding="utf-8")
    return {"source": "table", "path": str(directory / "b.csv")}


def test_tables_are_csv_or_parquet_and_found_beside_their_config(tmp_path, monkeypatch):
    source = table(tmp_path, f"{HEAD},comment\n{GH},first\n9.3,2.1,9.4,0.81,0.07,-0.02,second\n")
    b = bodies_of(plan(source))
    assert b.T.tolist() == [[float(x) for x in GH.split(",")], [9.3, 2.1, 9.4, 0.81, 0.07, -0.02]]
    path = tmp_path / "b.parquet"
    pd.read_csv(tmp_path / "b.csv").to_parquet(path)
    assert np.array_equal(bodies_of(plan({"source": "table", "path": str(path)})), b)
    (tmp_path / "c.yaml").write_text(
        "bodies: {source: table, path: b.csv}\nspin: {n_i: 0.1, omega_xy0: 0.01}\nmodel: gh\n"
    )
    monkeypatch.chdir("/")
    assert len(rs.sweep(tmp_path / "c.yaml", output=tmp_path / "out").runs) == 2


def test_launches_and_horizons_of_a_table_replace_those_of_the_config(tmp_path):
    text = f"{HEAD},n_i,omega_xy0,t_end\n{GH},0.1,0.01,30\n{GH},-0.2,0.001,40\n"
    config = {"bodies": table(tmp_path, text), "integrator": {"tol": 1e-6}}
    made = rs.sweep(config, output=tmp_path / "out")
    found = made.runs[["n_i", "omega_xy0", "t_end"]].to_numpy().tolist()
    assert found == [[0.1, 0.01, 30], [-0.2, 0.001, 40]]
    assert len(made.summary) == 1
    assert made.summary[["n_i", "omega_xy0"]].isna().all(axis=None)


STATE = f"{HEAD},omega_x,omega_y,omega_z,u_x,u_y,u_z"
BAD_TABLES = {
    "missing column": ("alpha,beta,gamma,theta,phi\n1,2,3,4,5\n", "the column xi is missing"),
    "text cell": (f"{HEAD}\n{GH}\n13,1.5,12,abc,0.1,-0.1\n", "row 2: theta is 'abc'; a finite"),
    "empty cell": (f"{HEAD}\n{GH}\n13,1.5,12,,0.1,-0.1\n", "row 2: theta is empty; a finite"),
    "impossible body": (f"{HEAD}\n{GH}\n{GH}\n13,1.5,12.3,1.2,0.1,-0.1\n", "row 3: theta is 1.2;"),
    "no skew": (f"{HEAD}\n13,1.5,12.3,0.5,0.2,0\n", "row 1: xi is 0 rad"),
    "n_i alone": (f"{HEAD},n_i\n{GH},0.1\n", "n_i stands alone; give both"),
    "no u": (f"{HEAD},omega_x,omega_y,omega_z\n{GH},0,0,1\n", "the column u_x is missing; a full"),
    "u too long": (f"{STATE}\n{GH},0,0,1,0,0.5,-1\n",
                   "row 1: u: its length is 1.11803; give a unit"),
    "at rest": (f"{STATE}\n{GH},0,0,0,0,0,-1\n",
                "row 1: the body stands upright and at rest; give"),
    "another spin": (f"{STATE},n_i,omega_xy0\n{GH},0,0,1,0,0,-1,1,0.1\n",
                     "row 1: n_i is 1, and the spin of the full state -1; leave n_i and omega_xy0"),
    "horizon of 0": (f"{HEAD},t_end\n{GH},0\n", "row 1: t_end is 0; it must be positive"),
    "repeated": (f"{HEAD},theta\n{GH},0.7\n", "there are 2 columns theta; keep one of them"),
    "a cell more in each row": (f"{HEAD}\n{GH},\n{GH},\n",
                                "cannot be read as a table (Error tokenizing data. C error"),
    "no rows": (f"{HEAD}\n", "the table has no rows; give at least one body"),
    "degrees": (f"{HEAD},n_i,omega_xy0,psi\n{GH},1,0.1,30\n",
                "row 1: psi is 30; an angle from -2 pi to 2 pi in radians is allowed; a column in "
                "degrees is called psi_deg"),
}  # fmt: skip


NO_TABLES = {
    "b.parquet": b"PAR1 this is not one PAR1", "latin.csv": b"alpha,\xe9\n1,2\n",
    "zero.csv": b"\0" * 100, "notes.docx": b"PK\x03\x04" + bytes(range(256)), "empty": None,
}  # fmt: skip


@pytest.mark.parametrize("name", [*BAD_TABLES, *NO_TABLES])
def test_a_bad_table_is_told_by_its_row_and_what_is_none_by_its_name(name, tmp_path):
    text, words = BAD_TABLES.get(name, (None, name))
    source = table(tmp_path, text or "")
    if text is None:
        path, content = tmp_path / name, NO_TABLES[name]
        path.mkdir() if content is None else path.write_bytes(content)
        source["path"] = str(path)
    line = refusal(source)
    assert line.startswith("bodies.path: ")
    assert words in line


def test_the_first_bad_rows_are_told_together(tmp_path):
    bad = [GH, GH.replace("0.6429", "1.2"), GH, GH.replace("1.522", "0.5")]
    lines = refusals(table(tmp_path, "\n".join([HEAD, *bad * 2])))
    assert [line.split(": ")[2] for line in lines] == ["row 2", "row 4", "row 6", "row 8"]
    assert "theta is 1.2" in lines[0]
    assert "beta is 0.5" in lines[3]
    *five, last = refusals(table(tmp_path, "\n".join([HEAD, *[bad[1]] * 9])))
    assert len(five) == 5
    assert last.endswith("there are more bad rows")


def test_a_table_that_is_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(tablefile, "MAX_ROWS", 5)
    monkeypatch.setattr(tablefile, "MAX_COLUMNS", 7)
    frame = pd.DataFrame([[float(x) for x in GH.split(",")]] * 6, columns=list(PARAMETERS))
    wide = frame.iloc[:2].assign(a=1, b=2)
    for large, words in ((frame, "the table has more than 5 rows"), (wide, "has 8 columns; at mo")):
        large.to_parquet(tmp_path / "b.parquet")
        assert words in refusal({"source": "table", "path": str(tmp_path / "b.parquet")})
        assert words in refusal(table(tmp_path, large.to_csv(index=False)))
        with pytest.raises(ConfigError, match=words):
            rs.sweep(large, output=tmp_path / "out", spin=SPIN)


def test_a_table_is_known_by_its_content(tmp_path):
    """Not by the bytes of its file, but by all that goes into the runs."""
    text = f"{HEAD},n_i,omega_xy0,name\n{GH},0.1,0.02,one\n{GH},0.2,0.02,\n"
    csv = plan(table(tmp_path, text)).source
    pd.read_csv(tmp_path / "b.csv").to_parquet(tmp_path / "b.parquet")
    same = plan({"source": "table", "path": str(tmp_path / "b.parquet")}).source
    assert csv.carried_names == same.carried_names == ("name",)
    first = sources.content_hash(csv)
    assert (
        first == sources.content_hash(same) == sources.content_hash(pickle.loads(pickle.dumps(csv)))
    )
    for old, new in (("0.1", "0.3"), ("one", "two"), ("omega_xy0,name", "omega_xy0,label")):
        other = plan(table(tmp_path, text.replace(old, new))).source
        assert sources.content_hash(other) != first
    assert sources.content_hash(plan(PRESET).source) == ""


def test_a_table_without_launch_needs_a_spin(tmp_path):
    line = refusal(table(tmp_path, f"{HEAD}\n{GH}\n"), spin=None)
    assert line.startswith("spin: missing; the table has no columns n_i and omega_xy0")


def test_types_inside_parquet(tmp_path):
    path, three = tmp_path / "b.parquet", [float(x) for x in GH.split(",")]
    frame = pd.DataFrame([three] * 3, columns=list(PARAMETERS))
    source = {"source": "table", "path": str(path)}
    for values, words in (
        ({"theta": ["0.5", "x", "0.6"]}, "row 2: theta is 'x'; a finite number is needed"),
        ({"theta": [0.6, None, 0.6]}, "row 2: theta is empty"),
        ({"alpha": [pd.Timestamp("2020-01-01")] * 3}, "column alpha is of type timestamp[us]; num"),
        ({"alpha": [True, None, True]}, ": the column alpha is of type bool; numbers are wanted"),
    ):
        frame.assign(**values).to_parquet(path)
        assert words in refusal(source)
    # Any type of numbers is good, and columns that are not read may be of any type.
    good = frame.assign(alpha=[Decimal("13.5")] * 3, beta=np.float32(1.5), note=[True] * 3)
    good.assign(gamma=["12"] * 3).to_parquet(path)
    assert bodies_of(plan(source))[:3].T.tolist() == [[13.5, 1.5, 12.0]] * 3


@pytest.mark.parametrize("psi", ["relevant", 30.0])
def test_an_output_table_is_a_valid_input_and_gives_the_same_results(psi, tmp_path):
    """Runs that reversed keep the config's horizon, and the others end where they ended."""
    data = {
        "bodies": drawn(6, target={"K_r": [0.03, 0.1], "rel_tol": 0.05}),
        "spin": {"n_i": [-0.4, 0.1], "omega_xy0": 0.01, "psi": psi},
        "horizon": {"t_rgh": 3},
    }

    sweeping.sweep(tmp_path / "first", data)
    first, runs = rows(tmp_path / "first"), tmp_path / "first" / "runs"
    had = first.t_r.notna().to_numpy()
    assert 0 < had.sum() < len(first) == 24
    assert (first.t_end[had] == first.t_r[had]).all()

    def again(name: str, horizon: dict[str, float]) -> pd.DataFrame:
        config = {"bodies": {"source": "table", "path": str(runs)}, "horizon": horizon}
        sweeping.sweep(tmp_path / name, config)
        return rows(tmp_path / name)

    same = [c for c in first.columns if c not in ("case", "sample")]
    other = again("again", {"t_rgh": 3})
    pd.testing.assert_frame_equal(first[same], other[same], check_exact=True)
    # With a shorter horizon in the config, only rows that have a t_r are cut.
    cut = again("short", {"t": 10})
    assert (cut.t_end[had] <= 10).all()
    assert np.array_equal(cut.t_end[~had], first.t_end[~had])
