"""Ellipsoids and dissipation from the config to the tables: bodies, columns, types, bad
input.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import stone_oracle
from stones import kl_state, random_bodies
from sweeping import HEAD, ROW, plan_of

import rattlesweep as rs
from rattlesweep.physics.body import PARAMETERS

SPIN = {"n_i": ["0.2 sqrt(g/a)"], "omega_xy0": ["0.05 sqrt(g/a)"]}
GH = {"source": "preset", "name": "GH"}
GRID = {"source": "grid", "base": {"preset": "GH"}}


def c_of(bodies: dict[str, Any], **others: Any) -> Any:
    plan = plan_of({"bodies": bodies, "spin": SPIN, **others})
    return plan.source.bodies(np.nan, np.arange(plan.samples)).further.get("c")


def test_drawn_bodies_have_semi_axes_from_their_range_and_stay_the_same_otherwise():
    source = {"source": "sd", "samples": 300}
    c = c_of(source | {"c": [1.5, 4]})
    assert 1.5 <= c.min() < 1.6 < 3.9 < c.max() < 4
    assert len(set(c.tolist())) == 300
    assert set(c_of(source | {"c": 3}).tolist()) == {3}
    whole, flat = (
        plan_of({"bodies": s, "spin": SPIN}).source.bodies(np.nan, np.arange(300))
        for s in (source | {"c": [1.5, 4]}, source)
    )
    for name in PARAMETERS:
        assert np.array_equal(getattr(whole, name), getattr(flat, name))


def test_presets_grids_and_tables(tmp_path):
    kl = {"source": "preset", "name": "KL"}
    grid = GRID | {"axes": {"theta": [0.6, 0.7]}}
    (tmp_path / "b.csv").write_text(f"{HEAD},c\n{ROW},\n{ROW},1.5\n")
    table = {"source": "table", "path": str(tmp_path / "b.csv")}
    for source, expected in (
        (kl, [2.0]),
        (kl | {"c": 3.0}, [3.0]),
        (GH | {"surface": "ellipsoid", "c": 1.5}, [1.5]),
        (grid | {"c": [1, 2, 4]}, [1, 2, 4, 1, 2, 4]),
        (grid | {"c": 5}, [5, 5]),
        (grid | {"c": {"logspace": [1, 4, 3]}}, [1, 2, 4, 1, 2, 4]),
        (grid | {"axes": {"c": [1, 2]}}, [1, 2]),
        (table | {"surface": "ellipsoid"}, [np.nan, 1.5]),
        (table | {"c": 9}, [9, 1.5]),
    ):
        np.testing.assert_array_equal(c_of(source), expected)
    for source in (
        kl | {"surface": "paraboloid"},
        grid,
        table | {"surface": "paraboloid"},
    ):
        assert c_of(source) is None


@pytest.mark.slow
def test_runs_against_mechanics():
    scenes = []
    for k, (body, u, omega, sigma, rolling) in enumerate(random_bodies(12, 11)):
        # Tilts and rates of a stone that stays on the table.
        u = np.array([0.2 * u[0], 0.2 * u[1], 0])
        u[2] = -math.sqrt(1 - u @ u)
        losses = (sigma * (k % 3 > 0), 0.3 * rolling * (k % 2))
        scenes.append((body, u, omega * [0.3, 0.3, 1], *losses))
    bodies, u, omega, sigma, rolling = zip(*scenes, strict=True)
    runs = rs.simulate(
        [rs.Rattleback(**body) for body in bodies],
        u=u,
        omega=omega,
        t_end=15.0,
        sigma=sigma,
        rolling=rolling,
        tol=1e-13,
    )
    assert 0 < runs.t_r.notna().sum() < 12
    for (body, u, omega, *losses), run in zip(scenes, runs.itertuples(), strict=True):
        end = stone_oracle.follow(body, u, omega, run.t_end, *losses).y[:, -1]
        assert run.n_end == pytest.approx(end[:3] @ end[3:6], abs=1e-9)


def test_kane_and_levinsons_stone_reverses_when_theirs_does():
    """The spin's first zero after their launch: 2.684647045 s; the paraboloid's: 2.6597
    s.
    """
    u, omega, second = kl_state(-5.0)
    plain = rs.Rattleback.kl().replace(units=None)
    both = [plain, replace(plain, c=None)]
    t_r = rs.simulate(both, u=u, omega=omega, t_end=200.0, tol=1e-13).t_r / second
    assert t_r[0] == pytest.approx(2.684647045, abs=1e-8)
    assert t_r[1] == pytest.approx(2.6597, abs=1e-4)
