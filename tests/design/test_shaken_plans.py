"""A plane that shakes in configs, tables and calls: cases, units, columns, messages."""

import math

import numpy as np
import pandas as pd
import pytest
import sweeping

import rattlesweep as rs
from rattlesweep.analysis.derived import derived
from rattlesweep.api.arguments import columns_of_base
from rattlesweep.physics.driven import (
    driven_spin,
    growth_of_drive,
    growth_of_push,
    spin_of_push,
)
from rattlesweep.words.errors import ConfigError

GH = {"source": "preset", "name": "GH"}
ALONG = {"frequency": 1.4, "acceleration": 0.1, "direction": "horizontal"}
TAP = {"n_i": 0, "omega_xy0": 1e-4}
STONE = {
    "source": "shape",
    "shape": "half_ellipsoid",
    "length": "12 cm",
    "width": "3 cm",
    "height": "12 mm",
    "mass": "60 g",
    "skew": "3 deg",
}


def plan(base, bodies=GH, **others):
    config = {"bodies": bodies, "spin": TAP, "horizon": {"t": 100}, "base": base}
    if bodies is STONE:
        config["spin"] = {"n_i": 0, "omega_xy0": "1 rpm"}
        config["horizon"] = {"t": "5 s"}
    return sweeping.plan_of(config | others)


def losses(base, **others):
    """Return the constants of the runs of a config."""
    launches, _ = sweeping.prepared(plan(base, **others))
    return launches.losses


def refusal(base, **others):
    with pytest.raises(ConfigError) as caught:
        plan(base, **others)
    return str(caught.value)


def test_lists_are_cases_with_a_column_for_each_constant():
    base = {"frequency": [2.5, 2.9], "acceleration": [0.02, 0.05, 0.1], "phase_deg": 90}
    found = plan(base)
    assert len(found.cases) == 6
    names = found.schema.names
    drives = ["base_frequency", "base_acceleration", "base_phase", "base_work"]
    assert [name for name in names if name.startswith("base_")] == drives
    runs = losses(base)
    assert runs["base_frequency"].tolist() == [2.5, 2.5, 2.5, 2.9, 2.9, 2.9]
    assert runs["base_acceleration"].tolist() == [0.02, 0.05, 0.1] * 2
    assert runs["base_phase"] == pytest.approx(np.full(6, math.pi / 2))
    text = sweeping.plan_of(plan(base).config.model_dump(mode="json"))
    assert text.cases == found.cases


def test_azimuths_of_a_plane_that_shakes_along_itself_are_cases():
    found = plan(ALONG | {"azimuth_deg": [0, 30, -90]})
    assert len(found.cases) == 3
    assert "base_azimuth" in found.schema.names
    launches, batch = sweeping.prepared(found)
    azimuth = np.radians([0.0, 30.0, -90.0])
    assert launches.losses["base_azimuth"] == pytest.approx(azimuth)
    assert launches.full_model == "full_swayed"
    # Along the body's axes, of which x and y are seen from below.
    directions = np.stack([np.cos(azimuth), -np.sin(azimuth), 0 * azimuth], axis=1)
    assert batch.y0[:, -3:] == pytest.approx(directions)
    text = sweeping.plan_of(found.config.model_dump(mode="json"))
    assert text.cases == found.cases
    without = losses(ALONG)
    assert without["base_azimuth"].tolist() == [0.0]
    assert "base_azimuth" not in plan(ALONG | {"direction": "vertical"}).schema.names


def test_an_amplitude_stands_for_an_acceleration():
    runs = losses({"frequency": [2.0, 3.0], "amplitude": 0.01})
    assert runs["base_acceleration"] == pytest.approx([0.04, 0.09])
    assert "base_amplitude" not in runs


def test_hertz_are_cycles_and_millimetres_need_a_size():
    base = {"frequency": "25 Hz", "amplitude": "0.1 mm"}
    found = plan(base, bodies=STONE)
    launches, _ = sweeping.prepared(found)
    omega = 2 * math.pi * 25
    assert launches.losses["base_acceleration"] == pytest.approx(1e-4 * omega**2 / 9.81)
    time = launches.bodies.units.time
    assert launches.losses["base_frequency"] == pytest.approx(omega * time)
    assert "25 Hz needs bodies with a size" in refusal(base)
    message = refusal({"frequency": 25, "acceleration": 0.1}, bodies=STONE)
    assert "base.frequency: 25 has no unit" in message
    assert "25 Hz" in message
    # The names of these keys have their unit.
    angles = {"direction": "horizontal", "phase_deg": 90, "azimuth_deg": [0, 90]}
    launches, _ = sweeping.prepared(plan(base | angles, bodies=STONE))
    assert launches.losses["base_phase"] == pytest.approx([math.pi / 2] * 2)
    assert launches.losses["base_azimuth"] == pytest.approx([0.0, math.pi / 2])


@pytest.mark.parametrize(
    ("base", "words"),
    [
        ({"frequency": 2.0}, "give acceleration or amplitude"),
        (
            {"frequency": 2.0, "acceleration": 0.1, "amplitude": 0.1},
            "give acceleration or amplitude, and not both",
        ),
        ({"acceleration": 0.1}, "frequency"),
        (
            {"frequency": 2.0, "acceleration": 0.1, "azimuth_deg": 3},
            "has no azimuth; leave azimuth_deg out",
        ),
        ({"frequency": 2.0, "acceleration": 0.1, "direction": "up"}, "vertical"),
        (
            ALONG | {"azimuth_deg": "table"},
            "needs source: table",
        ),
        (ALONG | {"azimuth_deg": [0, 400]}, "base.azimuth_deg"),
        ({"frequency": -2.0, "acceleration": 0.1}, "base.frequency"),
        ({"frequency": 2.0, "acceleration": "table"}, "needs source: table"),
    ],
)
def test_a_plane_that_is_not_described_is_refused(base, words):
    assert words in refusal(base)


def test_what_needs_a_plane_at_rest_is_refused():
    base = {"frequency": 2.0, "acceleration": 0.1}
    assert "the plane of the model reduced" in refusal(base, model="reduced")
    assert "lyapunov needs" in refusal(base, record=["lyapunov"])
    assert "early needs" in refusal(base, classify={"early": True})
    assert "the plane of the model reduced" in refusal(ALONG, model="reduced")
    with pytest.raises(ConfigError) as caught:
        rs.simulate("GH", **TAP, t_end=1, base=(2.0, 0.1), record="error")
    message = str(caught.value)
    assert "errors are not calibrated for paraboloid with base" in message
    assert "leave out error or base" in message


def test_a_plane_at_rest_adds_no_column():
    found = plan({"frequency": 2.0, "acceleration": 0})
    assert not [name for name in found.schema.names if name.startswith("base_")]


def test_a_table_has_the_drive_row_by_row(tmp_path):
    gh = rs.Rattleback.gh()
    names = ("alpha", "beta", "gamma", "theta", "phi", "xi")
    body = {name: [getattr(gh, name)] * 2 for name in names}
    drive = {
        "base_frequency": [2.0, 3.0],
        "base_acceleration": [0.1, 0.1],
        "base_phase": [0.5, 0.25],
    }
    path = tmp_path / "bodies.csv"
    pd.DataFrame(body | drive).to_csv(path, index=False)
    source = {"source": "table", "path": str(path)}
    found = plan(None, bodies=source)
    launches, batch = sweeping.prepared(found)
    for name, values in drive.items():
        assert launches.losses[name].tolist() == values
    assert batch.y0[:, -1] == pytest.approx(np.array([0.5, 0.25]) / (2 * math.pi))
    pd.DataFrame(body | drive | {"base_azimuth": [0.0, 1.5]}).to_csv(path, index=False)
    launches, _ = sweeping.prepared(plan(None, bodies=source))
    assert launches.full_model == "full_swayed"
    assert launches.losses["base_azimuth"].tolist() == [0.0, 1.5]
    pd.DataFrame(body | {"base_acceleration": [0.1, 0.2]}).to_csv(path, index=False)
    with pytest.raises(ConfigError, match="needs the column base_frequency"):
        plan(None, bodies=source)


def test_calls_take_a_pair_or_the_keys_of_a_config():
    pair = columns_of_base((2.0, 0.1))
    assert {name: float(x) for name, x in pair.items()} == {
        "base_frequency": 2.0,
        "base_acceleration": 0.1,
        "base_phase": 0.0,
    }
    mapped = columns_of_base({"frequency": 2.0, "amplitude": 0.1, "phase_deg": 180})
    assert float(mapped["base_acceleration"]) == pytest.approx(0.4)
    assert float(mapped["base_phase"]) == pytest.approx(math.pi)
    along = columns_of_base(ALONG | {"azimuth_deg": [0, 180]})
    assert along["base_azimuth"] == pytest.approx([0.0, math.pi])
    assert columns_of_base(ALONG)["base_azimuth"] == 0
    refused = (
        ALONG | {"direction": "up"},
        ALONG | {"direction": "vertical", "azimuth_deg": 3},
    )
    for wrong in (3.0, (1.0,), {"frequency": 2.0}, {"speed": 1}, *refused):
        with pytest.raises(ConfigError, match="base"):
            columns_of_base(wrong)


def test_theory_of_a_drive():
    """The growth at rest, and the spin at which losses balance it."""
    gh = rs.Rattleback.gh()
    modes = rs.modes(gh)
    omega = modes.omega_p
    assert growth_of_drive(omega, 2 * omega, 0.02) == pytest.approx(0.02 * omega / 4)
    assert growth_of_drive(omega, 2.02 * omega, 0.02) == 0
    damping = 0.01 / 2 / 12.054362
    spin = driven_spin(0.02 * omega / 4, damping, modes.K_p)
    expected = -(2 / modes.K_p) * (0.02 * omega / 4 - damping)
    assert spin == pytest.approx(expected)
    assert np.isnan(driven_spin(1e-3, 2e-3, modes.K_p))
    drive = {"base_frequency": 2 * omega, "base_acceleration": 0.02}
    told = derived(gh, 0.1, 0.01, sigma=0.01, **drive)
    values = {each.name: each.value for each in told}
    assert values["base_frequency_pitch"] == pytest.approx(2 * omega)
    assert values["base_frequency_roll"] == pytest.approx(2 * modes.omega_r)
    assert values["n_base_pitch"] == pytest.approx(expected, rel=1e-6)
    assert values["n_base"] == pytest.approx(expected, rel=1e-6)
    # The roll is damped by more than this drive gives it.
    assert values["n_base_roll"] is None


def test_no_drive_is_said_to_lead_beyond_the_spin_at_which_the_other_mode_grows():
    """The spins are those of runs: see the study in docs/shaken.md."""

    def told(frequency, acceleration, **losses):
        drive = {"base_frequency": frequency, "base_acceleration": acceleration}
        values = derived(rs.Rattleback.gh(), 0.1, 0.01, **losses, **drive)
        return {each.name: each.value for each in values}

    modes = rs.modes(rs.Rattleback.gh())
    pitch = 2 * modes.omega_p
    strong = told(pitch, 0.1, sigma=0.01)
    assert strong["n_base"] == strong["n_base_pitch"] == strong["n_growth_roll"]
    assert strong["n_base_roll"] == strong["n_growth_pitch"]
    assert told(2 * modes.omega_r, 0.1, sigma=0.01)["n_base"] == pytest.approx(
        0.0015, 0.01
    )
    # Without losses the pitch turns the body once, and a roll to no lasting spin.
    free = told(pitch, 0.01)
    assert free["n_base"] == pytest.approx(-0.0260, abs=1e-4)
    assert free["n_base_roll"] is None
    assert told(pitch, 0.1, sigma=0.01, viscous=50.0)["n_base"] is None


def test_theory_of_a_drive_along_the_plane():
    """Growth by resonance, and the spin that solves the balance of the closed form."""
    assert growth_of_push(12.0, math.pi / 6, 0.1) == pytest.approx(0.1 / 48)
    omega, inertia, damping, coefficient = 1.44, 12.0, 4e-4, 0.55
    of_mode = inertia, damping, coefficient
    detuning = np.array([-0.1, 0.0, 0.05])
    spin = spin_of_push(omega, omega + detuning, 0.02, *of_mode)
    assert (spin < 0).all()
    slowed = damping - coefficient * spin / 2
    near = [slowed**2 + (detuning + sign * spin) ** 2 for sign in (1, -1)]
    energy = 0.02**2 / (32 * inertia) * sum(1 / each for each in near)
    assert 2 * damping * inertia * -spin == pytest.approx(coefficient * energy)
    # Tuned, and much faster than the loss.
    cube = coefficient * 0.02**2 / (32 * inertia**2 * damping)
    cube = cube / (1 + coefficient**2 / 4)
    assert spin[1] == pytest.approx(-np.cbrt(cube), rel=5e-3)
    other_way = spin_of_push(omega, omega, 0.02, inertia, damping, -coefficient)
    assert other_way == -spin[1]
    assert np.isnan(spin_of_push(omega, omega, 0.02, inertia, 0.0, coefficient))
    gh = rs.Rattleback.gh()
    drive = {"base_frequency": 1.4, "base_acceleration": 0.02, "base_azimuth": 0.3}
    values = {x.name: x.value for x in derived(gh, 0.1, 0.01, sigma=0.01, **drive)}
    modes = rs.modes(gh)
    assert values["base_frequency_pitch"] == pytest.approx(modes.omega_p)
    assert values["n_base_pitch"] == pytest.approx(-0.04734, abs=1e-5)
    # The pitch would grow.
    assert values["n_base_roll"] is None
    assert values["n_base"] == pytest.approx(-0.0647, abs=1e-3)
    strong = derived(gh, 0.1, 0.01, sigma=0.01, **drive | {"base_acceleration": 0.05})
    values = {x.name: x.value for x in strong}
    assert values["n_base_pitch"] == values["n_growth_roll"]


def test_the_command_body_says_where_a_stone_spins_up():
    stone = (
        *("--half-ellipsoid", "12cm,3cm,12mm", "--mass", "60g", "--skew", "3deg"),
        *("--base", "25Hz,0.1mm"),
    )
    found = sweeping.invoke("body", *stone)
    assert found.exit_code == 0
    assert "19.459  Hz" in found.stdout
    along = sweeping.invoke("body", *stone[:-1], "10Hz,0.1mm,90deg")
    assert along.exit_code == 0
    assert "9.7296  Hz" in along.stdout
    refused = sweeping.invoke("body", "--gamma", "10", "--base", "10Hz,0.1mm,up")
    assert refused.exit_code == 2
    assert "has no azimuth in degrees" in refused.stderr
    refused = sweeping.invoke("body", "--gamma", "10", "--base", "25Hz")
    assert refused.exit_code == 2
    assert "as in 2.88,0.02 or 25Hz,0.1mm" in refused.stderr
