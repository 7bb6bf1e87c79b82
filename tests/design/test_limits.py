"""Numbers outside the range of the model are refused by name, at every entry."""

import pandas as pd
import pytest

import rattlesweep as rs
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.words.errors import ConfigError

GH = rs.Rattleback.gh()
ROW = {name: getattr(GH, name) for name in PARAMETERS}
SPIN = {"n_i": 0.1, "omega_xy0": 0.01}
FAST = SPIN | {"n_i": -1001.0}
PUSH = SPIN | {"omega_xy0": 1001.0}
TURN = {"omega": (0.0, 0.1, 1001.0)}


@pytest.mark.parametrize(
    ("launch", "name"), [(FAST, "n_i"), (PUSH, "omega_xy0"), (TURN, "omega")]
)
def test_speeds_are_limited_in_calls_configs_and_tables(launch, name, tmp_path):
    for function in (rs.simulate, rs.trajectory):
        with pytest.raises(ConfigError, match=rf"{name}.* -?1000"):
            function(GH, **launch, t_end=1e-3)
    config = {"bodies": {"source": "preset", "name": "GH"}, "spin": launch}
    if name == "omega":
        config["launch"] = {"omega": [*launch["omega"]]}
        del config["spin"]
    with pytest.raises(ConfigError, match="1001"):
        rs.sweep(config, output=tmp_path)
    if name != "omega":
        with pytest.raises(
            ConfigError, match=f"row 1: {name} is -?1001; from .* to 1000"
        ):
            rs.sweep(pd.DataFrame([ROW | launch]), output=tmp_path, horizon={"t": 1})


def test_what_is_just_allowed():
    assert (
        abs(rs.simulate(GH, n_i=-1000, omega_xy0=1.0, t_end=0.01).energy_drift) < 1e-9
    )
    with pytest.raises(ConfigError, match=r"n_i\[1\] 1e\+06"):
        rs.simulate(GH, n_i=[0.1, 1e6], omega_xy0=0.01, t_end=1)
    with pytest.raises(ConfigError, match="e_p0"):
        rs.trajectory(GH, **SPIN, t_end=1, model="reduced", e_p0=1e300, e_r0=1.0)
