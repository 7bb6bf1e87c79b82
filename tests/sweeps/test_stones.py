"""Ellipsoids and dissipation from the config to the tables: bodies, columns, types, bad input."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
import stone_oracle
from refusal import assert_refused
from sweeping import invoke, plan_of, prepared
from test_stone import kl_state, random_bodies

import rattlesweep as rs
from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.model import FRICTION
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.physics import full, stone
from rattlesweep.physics.body import PARAMETERS

SPIN = {"n_i": [0.2], "omega_xy0": [0.05]}
GH = {"source": "preset", "name": "GH"}
GRID = {"source": "grid", "base": {"preset": "GH"}}
HEAD = ",".join(PARAMETERS)
ROW = "13.04,1.522,12.28,0.6429,0.036,-0.03"


def c_of(bodies: dict[str, Any], **others: Any) -> Any:
    plan = plan_of({"bodies": bodies, "spin": SPIN, **others})
    return plan.source.bodies(np.nan, np.arange(plan.samples)).c


@pytest.mark.parametrize("draw", ["random", "sobol"])
def test_drawn_bodies_have_semi_axes_from_their_range_and_stay_the_same_otherwise(draw):
    source = {"source": "sd", "samples": 300, "draw": draw}
    c = c_of(source | {"c": [1.5, 4]})
    assert 1.5 <= c.min() < c.max() < 4
    assert 2.6 < c.mean() < 2.9
    assert len(set(c.tolist())) == 300
    assert c_of(source | {"c": [1.5, 4]}, seed=1).tolist() != c.tolist()
    assert set(c_of(source | {"c": 3}).tolist()) == {3}
    if draw == "random":
        whole, flat = (plan_of({"bodies": s, "spin": SPIN}).source.bodies(np.nan, np.arange(300))
                       for s in (source | {"c": [1.5, 4]}, source))  # fmt: skip
        for name in PARAMETERS:
            assert np.array_equal(getattr(whole, name), getattr(flat, name))
    # Each target draws its own.
    aimed = {"source": "sd", "samples": 20, "target": {"K_r": [0.05, 0.1], "rel_tol": 0.05}}
    plan = plan_of({"bodies": aimed | {"c": [1, 2]}, "spin": SPIN})
    first, second = (plan.source.bodies(value, np.arange(20)).c for value in (0.05, 0.1))
    assert first.tolist() != second.tolist()


def test_presets_grids_and_tables(tmp_path):
    kl, grid = {"source": "preset", "name": "KL"}, GRID | {"axes": {"theta": [0.6, 0.7]}}
    (tmp_path / "b.csv").write_text(f"{HEAD},c\n{ROW},\n{ROW},1.5\n")
    table = {"source": "table", "path": str(tmp_path / "b.csv")}
    for source, expected in (
        (kl, [2.0]), (kl | {"c": 3.0}, [3.0]), (GH | {"surface": "ellipsoid", "c": 1.5}, [1.5]),
        (grid | {"c": [1, 2, 4]}, [1, 2, 4, 1, 2, 4]), (grid | {"c": 5}, [5, 5]),
        (grid | {"c": {"logspace": [1, 4, 3]}}, [1, 2, 4, 1, 2, 4]),
        (grid | {"axes": {"c": [1, 2]}}, [1, 2]),
        (table | {"surface": "ellipsoid"}, [np.nan, 1.5]), (table | {"c": 9}, [9, 1.5]),
    ):  # fmt: skip
        np.testing.assert_array_equal(c_of(source), expected)
    for source in (kl | {"surface": "paraboloid"}, grid, table | {"surface": "paraboloid"}):
        assert c_of(source) is None


ALONE = "is for paraboloids without dissipation; leave it out"
SIGMA = {"dissipation": {"sigma": 0.1}}
# name: (bodies over those of the preset, the rest of the config, words)
REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "c below the curvature": ({"c": 0.6}, {}, "c 0.6 is not above theta 0.6429: "
                              "the ellipsoid would rather lie"),
    "below that in a corner": (GRID | {"axes": {"theta": [0.6, 0.9]}, "c": [0.8, 2]}, {},
                               "bodies.axes: at alpha 13.04, beta 1.522, gamma 12.28, theta 0.9"),
    "no c": ({"surface": "ellipsoid"}, {},
             "an ellipsoid needs c, its vertical semi-axis over a; give c: 2"),
    "reduced model": ({}, SIGMA | {"model": "reduced"},
                      "dissipation: the model reduced conserves energy; take model: full"),
    "exponents of an ellipsoid": ({"c": 2}, {"record": ["lyapunov"]}, f"record: lyapunov {ALONE}"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_makes_no_sense_is_refused_in_a_sentence(name, tmp_path):
    bodies, rest, words = REFUSED[name]
    file, output = tmp_path / "c.yaml", tmp_path / "out"
    bodies = bodies if "source" in bodies else GH | bodies
    file.write_text(json.dumps({"bodies": bodies, "spin": SPIN} | rest))
    assert_refused(invoke("run", file, "--output", output), 2, words)
    assert not output.exists()


# -- against mechanics -------------------------------------------------------------------------


def kernel_of_everything(bodies, states, losses, t_end, tol=1e-13):
    """Outcomes by the kernel that has all losses, of lists of bodies, launches and losses."""
    y0, constants = [], []
    for body, (u, omega), (sigma, rolling) in zip(bodies, states, losses, strict=True):
        y0.append([*full.from_vectors(u, omega), 0.0])
        shape = full.constants(*(body[name] for name in PARAMETERS))
        constants.append(
            [*shape, stone.inverse_semi_axis(body["c"]), sigma, rolling, stone.SMOOTHING]
        )
    plan = plan_of({"bodies": GH | {"c": 2}, "spin": SPIN, "dissipation": {"rolling": 1}})
    _, like = prepared(plan)
    n = len(y0)
    batch = type(like)(
        **{name: np.repeat(values, n, axis=0) for name, values in vars(like).items()}
        | {"y0": np.array(y0), "constants": np.array(constants, float),
           "t_end": np.full(n, t_end), "window": np.full(n, t_end), "first_mark": np.full(n, t_end)}
    )  # fmt: skip
    return integrate(batch, METHODS["dop853"], FRICTION["ellipsoid", "rolling"], tol=tol)


@pytest.mark.parametrize(
    ("count", "seed", "t_end"),
    [(12, 11, 6.0), pytest.param(300, 12, 15.0, marks=pytest.mark.slow)],
)
def test_runs_against_mechanics(count, seed, t_end):
    bodies, states, losses = [], [], []
    for k, (body, u, omega, sigma, rolling) in enumerate(random_bodies(count, seed)):
        # Tilts and rates of a stone that stays on the table.
        u = np.array([0.2 * u[0], 0.2 * u[1], 0])
        u[2] = -math.sqrt(1 - u @ u)
        bodies.append(body)
        states.append((u, omega * [0.3, 0.3, 1]))
        losses.append((sigma * (k % 3 > 0), 0.3 * rolling * (k % 2)))
    out = kernel_of_everything(bodies, states, losses, t_end)
    ok = np.flatnonzero(out.status == 0)
    for k in ok:
        end = stone_oracle.follow(bodies[k], *states[k], out.t_end[k], *losses[k]).y[:, -1]
        got_u, got_omega = full.to_vectors(out.y_end[k, :5])
        scale = max(1.0, np.abs(end[3:6]).max())
        np.testing.assert_allclose(got_u, end[:3], rtol=0, atol=1e-9, err_msg=str(k))
        np.testing.assert_allclose(got_omega, end[3:6], rtol=0, atol=1e-9 * scale, err_msg=str(k))
        np.testing.assert_allclose(out.y_end[k, 5], end[6], rtol=0, atol=1e-9)
        if np.isfinite(out.t_r[k]):
            # The spin is zero there, to what the state is known to.
            assert abs(end[:3] @ end[3:6]) < 1e-9
    assert len(ok) > 0.9 * count


def test_kane_and_levinsons_stone_reverses_when_theirs_does():
    """The spin's first zero after their launch: 2.684647045 s; the paraboloid's: 2.6597 s."""
    body = {name: getattr(rs.Rattleback.kl(), name) for name in (*PARAMETERS, "c")}
    u, omega, second = kl_state(-5.0)
    out = kernel_of_everything([body, body | {"c": None}], [(u, omega)] * 2, [(0, 0)] * 2, 200.0)
    assert out.t_r[0] / second == pytest.approx(2.684647045, abs=1e-8)
    assert out.t_r[1] / second == pytest.approx(2.6597, abs=1e-4)
