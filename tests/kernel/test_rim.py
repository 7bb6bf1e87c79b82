"""Runs end where the contact passes the rim of the body."""

import numpy as np
import pytest
import stone_oracle
from natural import natural
from scipy.optimize import brentq
from sweeping import invoke

import rattlesweep as rs
from rattlesweep.physics import full
from rattlesweep.physics.body import PARAMETERS

STONE = {"length": "12 cm", "height": "12 mm", "mass": "60 g", "skew": "3 deg"}


def oracle_time(body, n_i, push, psi, t_end):
    """Return when SciPy's solution has a horizontal vertical axis, or None."""
    oracle_body = {name: getattr(body, name) for name in (*PARAMETERS, "c")}
    angle = np.radians(psi)
    omega = push * np.array([np.cos(angle), np.sin(angle), 0]) - [0, 0, n_i]
    found = stone_oracle.follow(oracle_body, np.array([0, 0, -1.0]), omega, t_end)
    return stone_oracle.first_zero(found, lambda y: y[2])


def taps(count, seed):
    """Return half ellipsoids with pushes that may roll them over."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        sizes = {
            "length": f"{rng.uniform(0.08, 0.16)!r} m",
            "width": f"{rng.uniform(0.024, 0.03)!r} m",
            "height": f"{rng.uniform(0.01, 0.013)!r} m",
            "skew": rng.uniform(0.02, 0.14),
        }
        body = rs.Rattleback.half_ellipsoid(**STONE | sizes)
        yield body, rng.choice([0, 0.2, -0.3]), rng.uniform(0.9, 1.2), 10.0


@pytest.mark.parametrize(
    ("count", "seed"), [(1, 1), pytest.param(20, 2, marks=pytest.mark.slow)]
)
def test_half_ellipsoids_end_at_their_rims(count, seed):
    ended = 0
    for body, n_i, push, psi in taps(count, seed):
        launch = natural(n_i=n_i, omega_xy0=push, t_end=12) | {"psi": psi}
        run = rs.simulate(body, **launch, record="reversals", tol=1e-11)
        path = rs.trajectory(body, **launch, tol=1e-11, channels=["t", "contact_z"])
        exact = oracle_time(body, n_i, push, psi, 12)
        assert path.t_end == run.t_end
        assert path.status == run.status == ("ok" if exact is None else "rim")
        assert run.t_end == pytest.approx(exact or 12, abs=1e-6)
        # The flat side is 1 - c below the centre of mass.
        assert path.table["contact_z"].min() >= 1 - body.c
        if exact is not None:
            assert run.type is None
            ended += 1
        free = rs.simulate(body.replace(rim=None), **launch)
        assert free.status == "ok"
    assert ended >= count / 2


@pytest.mark.slow
def test_a_body_that_slides_ends_at_its_rim():
    body = rs.Rattleback.half_ellipsoid(**STONE, width="24.2 mm")
    launch = natural(n_i=0, omega_xy0=1.1, t_end=20) | {"psi": "roll", "mu": 0.9}
    run = rs.simulate(body, **launch)
    path = rs.trajectory(body, **launch)
    beyond = rs.trajectory(body.replace(rim=None), **launch, section="u_z=0")
    assert path.status == run.status == "rim"
    assert path.t_end == run.t_end
    assert run.t_end == pytest.approx(beyond.section["t"][0], rel=1e-12)


def rise_of(body, path):
    """Return the height of the contact of a paraboloid over its lowest point."""
    _, _, _, cxx, cxy, cyy = full.constants(*(getattr(body, x) for x in PARAMETERS))
    p = path["u_x"] / path["u_z"]
    q = path["u_y"] / path["u_z"]
    return ((1 + cxx) * p**2 + 2 * cxy * p * q + (1 + cyy) * q**2) / 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "mu",
    [
        pytest.param({}, id="rolls"),
        pytest.param({"mu": 0.35}, id="slides", marks=pytest.mark.slow),
    ],
)
def test_a_low_rim_is_passed_in_slopes(mu):
    # As of a body from a mesh, whose surface ends below the equator.
    gh = rs.Rattleback.gh()
    rows = {"channels": ["t", "u_x", "u_y", "u_z"]}
    launch = {"n_i": 0.3, "omega_xy0": 0.2, "t_end": 40} | mu
    path = rs.trajectory(gh, **launch, **rows, dt=0.002)
    rise = rise_of(gh, path).to_numpy()
    rim = 0.5 * rise.max()
    run = rs.simulate(gh.replace(rim=rim), **launch)
    first = int(np.argmax(rise > rim))

    def left(time):
        at = rs.trajectory(gh, **launch, **rows, times=[time, launch["t_end"]])
        return rim - rise_of(gh, at)[0]

    exact = brentq(left, path["t"][first - 1], path["t"][first], xtol=1e-13)
    assert run.status == "rim"
    assert run.t_end == pytest.approx(exact, abs=1e-9)
    if mu:
        assert 0 < run.t_slide < run.t_end
    # A body without a rim has the same bits beside one with a rim.
    columns = ["t_end", "t_r", "n_end", "n_steps", "status"]
    both = rs.simulate([gh.replace(rim=rim), gh], **launch)[columns]
    alone = rs.simulate([gh], **launch)[columns]
    assert both[1:].reset_index(drop=True).equals(alone)


@pytest.mark.slow
def test_a_launch_beyond_the_rim_ends_at_once():
    body = rs.Rattleback.gh().replace(rim=0.1)
    state = {"omega": (0, 0, 0.1), "u": (0, 0.6, -0.8), "t_end": 50}
    run = rs.simulate(body, **state)
    assert (run.status, run.t_end, run.t_r) == ("rim", 0, None)
    path = rs.trajectory(body, **state)
    assert (path.status, path.t_end) == ("rim", 0)


def test_sweeps_and_tables_keep_the_rim(tmp_path):
    config = {
        "bodies": {"source": "shape", "shape": "half_ellipsoid", **STONE}
        | {"width": ["23 mm", "26 mm"], "samples": 3},
        "spin": {"n_i": [0], "omega_xy0": ["300 rpm", "350 rpm"], "psi": "roll"},
        "horizon": {"t": "1 s"},
    }
    runs = rs.sweep(config, output=tmp_path / "shapes", progress=False).read()
    assert (runs["rim"] == runs["c"]).all()
    assert (runs["status"] == "rim").any()
    assert invoke("verify", tmp_path / "shapes").exit_code == 0
    one = runs.index[runs["status"] == "rim"][0]
    keys = runs.loc[one, ["case", "sample"]].astype(int)
    replayed = rs.replay(tmp_path / "shapes", *keys)
    assert (replayed.status, replayed.t_end) == ("rim", runs.loc[one, "t_end"])
    # The rows as a table of bodies: their t_end is no horizon.
    table = {"source": "table", "path": str(tmp_path / "shapes" / "runs")}
    again = rs.sweep(
        {"bodies": table | {"surface": "ellipsoid"}, "horizon": {"t": "1 s"}},
        output=tmp_path / "again",
        progress=False,
    ).read()
    same = ["status", "t_end", "n_end", "rim"]
    assert again[same].equals(runs[same])
    bodies = runs.drop(columns=["t_end", "t_r"])
    simulated = rs.simulate(bodies, t_end="1 s")
    assert simulated["status"].equals(runs["status"])


def test_other_bodies_have_no_rim():
    launch = natural(n_i=0.1, omega_xy0=0.01, t_end=1)
    assert rs.Rattleback.kl().rim is None
    assert not hasattr(rs.simulate("KL", **launch), "rim")
    both = [rs.Rattleback.half_ellipsoid(**STONE, width="3 cm"), rs.Rattleback.kl()]
    rims = rs.simulate(both, **launch)["rim"]
    assert rims[0] == both[0].c
    assert np.isnan(rims[1])
    for wrong in (0, -1, float("nan")):
        with pytest.raises(
            ValueError, match=r"rim is .*; it must be positive and finite"
        ):
            rs.Rattleback.gh().replace(rim=wrong)
