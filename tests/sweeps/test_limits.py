"""Numbers beyond which the model means nothing are refused by name, at every door."""

import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep import ConfigError

GH = rs.Rattleback.gh()
PARAMETERS = ("alpha", "beta", "gamma", "theta", "phi", "xi")
ROW = {name: getattr(GH, name) for name in PARAMETERS} | {"n_i": 0.1, "omega_xy0": 0.01}
STONE = {
    "mass": 0.085, "height": 0.01, "radii": (0.5, 0.015), "axes_angle": 0.03,
    "inertia": (6e-6, 9e-5, 9.2e-5),
}  # fmt: skip
SPIN = {"n_i": 0.1, "omega_xy0": 0.01}
FAST, PUSH = SPIN | {"n_i": -1001.0}, SPIN | {"omega_xy0": 1001.0}
TURN = {"omega": (0.0, 0.1, 1001.0)}


@pytest.mark.parametrize("function", [rs.simulate, rs.trajectory])
@pytest.mark.parametrize(
    ("launch", "name"), [(FAST, "n_i"), (PUSH, "omega_xy0"), (TURN, "omega")], ids=["n", "xy", "u"]
)
def test_speeds_of_calls(function, launch, name):
    with pytest.raises(ConfigError, match=rf"{name}.* -?1000"):
        function(GH, **launch, t_end=1e-3)


def test_speeds_of_arrays_and_theory():
    with pytest.raises(ConfigError, match=r"n_i\[1\] 1e\+06: from -1000 to 1000 sqrt"):
        rs.simulate(GH, n_i=[0.1, 1e6], omega_xy0=0.01, t_end=1)
    with pytest.raises(ConfigError, match="n_i 1e\\+06: from -1000 to 1000"):
        rs.reversal_time_gh(GH, 1e6, 0.01)


@pytest.mark.parametrize(
    "section", [{"spin": FAST}, {"spin": PUSH}, {"launch": {"omega": [0, 0.1, -1001]}}]
)
def test_speeds_of_configs(section, tmp_path):
    config = {"bodies": {"source": "preset", "name": "GH"}} | section
    with pytest.raises(
        ConfigError, match=r"1001(\.0)? is out of range; it must be at (most|least) -?1"
    ):
        rs.sweep(config, output=tmp_path)


@pytest.mark.parametrize("name", ["n_i", "omega_xy0"])
def test_speeds_of_tables(name, tmp_path):
    with pytest.raises(ConfigError, match=f"row 1: {name} is 1001; from .* to 1000"):
        rs.sweep(pd.DataFrame([ROW | {name: 1001.0}]), output=tmp_path, horizon={"t": 1})


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("gravity", 1e30, "gravity: 1e\\+30 m/s\\^2 is out of range; from 1e-06 to 1e\\+06"),
        ("radii", (1e300, 0.015), "radii: 1e\\+300 m is out of range"),
        ("mass", "1e300 kg", "mass: 1e\\+300 kg is out of range"),
        ("inertia", (6e30, 9e31, 9.2e31), "the moment of inertia 1.08.*e\\+37 M a\\^2 is out of"),
    ],
)
def test_sizes_of_bodies(key, value, sentence):
    with pytest.raises(ValueError, match=sentence):
        rs.Rattleback.from_si(**(STONE | {key: value}))


def test_energies_of_the_reduced_model():
    with pytest.raises(ConfigError, match="e_p0 1e\\+300: from 0 to 1e\\+06 M g a is allowed"):
        rs.trajectory(GH, **SPIN, t_end=1, model="reduced", e_p0=1e300, e_r0=1.0)


def test_what_is_just_allowed():
    run = rs.simulate(GH, n_i=-1000, omega_xy0=1.0, t_end=0.01)
    assert run.status == "ok"
    assert abs(run.energy_drift) < 1e-9
