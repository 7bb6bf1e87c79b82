"""Orbits that return: against numbers of an independent program, and laws they obey."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from oracle import advance
from sweeping import invoke

import rattlesweep as rs

# Body A of docs/literature.md: an orbit at the energy 6.52, by an independent program.
BODY_A = rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -0.485)
OMEGA = (1.0206680058370952, 1.1862835371113298, -0.2808288454552757)
U = (-0.28968568739593215, -0.16170733226503464, -0.9433625714483652)
PERIOD = 7.921360271861
ENERGIES = {
    6.52: (PERIOD, (0.96606133, -0.66472089, -1.31264684)),
    7.0: (8.4425022246, (0.93007015, -0.37397066, -2.4221215)),
    6.47: (7.8238250040, (0.97370632, -0.92169018 + 0.12532467j, None)),
}


@pytest.fixture(scope="module")
def orbit():
    return rs.orbit(BODY_A, omega=OMEGA, u=U, period=7.9, energy=6.52)


@pytest.fixture(scope="module")
def family(orbit):
    return rs.branch(orbit, "energy", to=6.3, steps=60)


@pytest.mark.parametrize("energy", ENERGIES)
def test_orbits_of_an_independent_program(energy):
    period, multipliers = ENERGIES[energy]
    found = rs.orbit(BODY_A, omega=OMEGA, u=U, period=period - 0.01, energy=energy)
    assert found.period == pytest.approx(period, abs=1e-9)
    assert found.energy == pytest.approx(energy, abs=1e-12)
    for multiplier in filter(None, multipliers):
        assert np.abs(found.multipliers - multiplier).min() < 1e-6
    assert found.closure < 1e-12
    assert (found.errors < 1e-8).all()
    assert found.period_error < 1e-9


def test_the_state_is_that_of_an_independent_program(orbit):
    # The period of the start is only roughly right, but the state lies on the orbit.
    assert np.abs(np.array(orbit.omega) - OMEGA).max() < 1e-9
    assert np.abs(np.array(orbit.u) - U).max() < 1e-9
    y = np.array([*orbit.u, *orbit.omega])
    assert np.abs(advance(BODY_A, y, orbit.period) - y).max() < 1e-9


def test_the_product_of_the_multipliers_is_the_growth_of_the_volume(orbit):
    growth = np.exp(orbit.period * orbit.volume_rate)
    assert np.prod(orbit.multipliers) == pytest.approx(growth, rel=1e-10)


def test_the_reversed_orbit_has_reciprocal_multipliers(orbit):
    back = rs.orbit(
        BODY_A, omega=-np.array(orbit.omega), u=orbit.u, period=orbit.period
    )
    inverse = 1 / back.multipliers
    for multiplier in orbit.multipliers:
        assert np.abs(inverse - multiplier).min() < 1e-9
    assert back.n_mean == pytest.approx(-orbit.n_mean, abs=1e-10)


def test_kinds_are_words_for_the_multipliers(orbit):
    assert orbit.kind == "doubling"
    lower = rs.orbit(BODY_A, omega=OMEGA, u=U, period=7.82, energy=6.47)
    assert lower.kind == "stable"
    assert "multiplier" in repr(lower)
    assert "stable" in repr(lower)


def test_the_least_period_is_found(orbit):
    for times in (2, 3):
        found = rs.orbit(
            BODY_A, omega=orbit.omega, u=orbit.u, period=times * orbit.period
        )
        assert found.period == pytest.approx(orbit.period, abs=1e-9)


def test_the_turn_is_that_of_the_run(orbit):
    run = rs.trajectory(
        BODY_A,
        omega=orbit.omega,
        u=orbit.u,
        t_end=orbit.period,
        channels=["yaw"],
        times=[orbit.period],
    )
    assert np.degrees(run["yaw"][0]) == pytest.approx(orbit.turn, abs=1e-5)


def test_special_points_lie_where_the_multipliers_say(family):
    table = family.table
    assert table["point"].dropna().tolist() == ["doubling", "fold"]
    doubling = table[table["point"] == "doubling"].iloc[0]
    fold = table[table["point"] == "fold"].iloc[0]
    # By a second program (SciPy's DOP853 in vectors, with derivatives by differences)
    # the doubling is at 6.4778555938; the fold is found in a second way below.
    assert doubling["energy"] == pytest.approx(6.4778555937, abs=1e-8)
    assert fold["energy"] == pytest.approx(6.4007155548, abs=1e-8)
    assert (table["accuracy"].dropna() < 1e-8).all()
    at = family.orbit(int(doubling.name))
    assert np.abs(at.multipliers + 1).min() < 1e-8
    at = family.orbit(int(fold.name))
    assert np.abs(at.multipliers - 1).min() < 1e-5
    # The family turns back there, and is stable on one side.
    kinds = table["kind"].tolist()
    assert set(kinds[int(doubling.name) + 1 : int(fold.name)]) == {"stable"}
    assert set(kinds[int(fold.name) + 1 :]) == {"saddle"}
    assert table["energy"].min() == pytest.approx(fold["energy"], abs=1e-9)


def test_a_branch_is_written_with_units(family, tmp_path):
    family.save(tmp_path / "family.parquet")
    schema = pq.read_schema(tmp_path / "family.parquet")
    assert schema.field("period").metadata[b"unit"] == b"sqrt(a/g)"
    assert schema.field("energy").metadata[b"unit"] == b"M g a"
    family.save(tmp_path / "family.csv")
    head = (tmp_path / "family.csv").read_text().splitlines()
    assert head[0].startswith("energy,period,n_mean")
    assert len(head) == 1 + len(family.table)
    family.plot(tmp_path / "family.svg", y="n_mean")
    assert (tmp_path / "family.svg").stat().st_size > 1000


def test_a_doubling_leads_to_the_doubled_orbit(family):
    doubled = family.doubled()
    row = family.table[family.table["point"] == "doubling"].iloc[0]
    assert doubled.period == pytest.approx(2 * row["period"], rel=1e-3)
    assert doubled.kind == "stable"
    assert doubled.closure < 1e-12
    back = rs.branch(doubled, "energy", to=6.46, steps=8)
    assert "half its period" in repr(back)
    assert back.table["energy"].iloc[-1] == pytest.approx(row["energy"], abs=1e-7)
    # After half of its period it is elsewhere.
    y = np.array([*doubled.u, *doubled.omega])
    assert np.abs(advance(BODY_A, y, doubled.period / 2) - y).max() > 1e-3


def test_a_branch_along_a_parameter_keeps_the_energy(orbit):
    found = rs.branch(orbit, "xi", to=-0.4, steps=8)
    table = found.table
    assert table["xi"].iloc[-1] == pytest.approx(-0.4, abs=1e-12)
    assert np.abs(table["energy"] - 6.52).max() < 1e-10
    last = found.orbit(len(table) - 1)
    again = rs.orbit(
        rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -0.4),
        omega=last.omega,
        u=last.u,
        period=last.period,
    )
    assert again.period == pytest.approx(last.period, abs=1e-9)


def test_a_search_finds_the_orbit_that_a_run_ends_on():
    stable = rs.orbit(BODY_A, omega=OMEGA, u=U, period=7.82, energy=6.47)
    x, y, z = stable.omega
    omega = (x - 0.002, y - 0.001, z)
    (found,) = rs.find_orbits(BODY_A, omega=omega, u=stable.u, t_end=600)
    assert found.kind == "stable"
    assert found.period == pytest.approx(7.82, abs=0.05)


def test_a_symmetric_orbit_is_found_by_half_a_period():
    found = rs.orbit("GH", u=(0.6716, 0.0407, -0.7398), period=9.1, symmetric=True)
    assert found.closure < 1e-12
    # At rest twice in a period, and reciprocal with itself.
    y = np.array([*found.u, *found.omega])
    assert found.omega == (0.0, 0.0, 0.0)
    gh = rs.Rattleback.gh()
    half = advance(gh, y, found.period / 2)
    assert np.abs(half[3:]).max() < 1e-9
    assert np.abs(half[:3] - y[:3]).max() > 0.1
    assert np.abs(advance(gh, half, found.period / 2) - y).max() < 1e-8
    for multiplier in found.multipliers:
        assert np.abs(found.multipliers - 1 / multiplier).min() < 1e-8
    assert abs(found.n_mean) < 1e-10


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"omega": OMEGA, "u": U, "period": 3.0}, "leads to no orbit"),
        ({"omega": (0, 0, -0.3), "u": (0, 0, -1), "period": 3.0}, "steady spin"),
        ({"omega": OMEGA, "u": U}, "period"),
        ({"omega": OMEGA, "u": (0, 0, -2), "period": 3.0}, "length 1"),
        ({"u": U, "period": 3.0, "energy": 6.0, "symmetric": True}, "leave"),
    ],
)
def test_a_start_that_leads_nowhere_is_one_sentence(start, message):
    with pytest.raises(rs.ConfigError, match=message) as error:
        rs.orbit(BODY_A, **start)
    assert len(error.value.messages) == 1


OF_BODY_A = (
    "--alpha 7 --beta 3 --gamma 7 --theta .25 --phi .1111111111111111 --xi -.485"
)
NEAR = "--omega 1.02,1.19,-0.28 --u -0.2898,-0.1618,-0.9433 --period 7.9 --energy 6.52"


def test_the_commands_print_what_the_calls_return(tmp_path):
    output = tmp_path / "orbit.csv"
    given = [*OF_BODY_A.split(), *NEAR.split()]
    result = invoke("orbit", *given, "--output", str(output))
    assert result.exit_code == 0
    assert "7.92136027" in result.stdout
    assert "doubling" in output.read_text()
    result = invoke("branch", *given, "--to", "6.47", "--steps", "5")
    assert result.exit_code == 0
    assert "doubling at energy 6.47785559" in result.stdout


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("--search --period 3", "--period"),
        ("--omega 0,0,-0.3", "--search"),
        ("--n-i -0.3", "--n-i"),
        ("out/nowhere", "--search"),
        ("--case 1", "--search"),
    ],
)
def test_wrong_commands_say_what_would_be_right(more, message):
    result = invoke("orbit", *OF_BODY_A.split(), *more.split())
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("error:") == 1


@pytest.mark.slow
def test_the_fold_is_the_least_energy_of_the_family(orbit):
    # Another way: a polynomial through the energies beside the fold, over the period.
    table = rs.branch(orbit, "energy", to=6.3, steps=200).table
    fold = int(np.flatnonzero(table["point"] == "fold")[0])
    beside = [*range(fold - 5, fold), *range(fold + 1, fold + 6)]
    centre = table["period"][fold]
    width = np.ptp(table["period"][beside]) / 2
    x = (table["period"][beside] - centre) / width
    energies = np.polynomial.Polynomial.fit(x, table["energy"][beside] - 6.4, 8)
    roots = energies.deriv().roots()
    (lowest,) = roots[(np.abs(roots) < 0.3) & (np.abs(roots.imag) < 1e-9)].real
    assert 6.4 + energies(lowest) == pytest.approx(table["energy"][fold], abs=1e-8)


@pytest.mark.slow
def test_periodic_runs_of_a_sweep_end_on_orbits(tmp_path):
    body = {"alpha": 7, "beta": 3, "gamma": 7, "theta": 0.25, "phi": 1 / 9}
    sweep = rs.sweep(
        {
            "name": "periodic",
            "bodies": {
                "source": "grid",
                "base": body | {"xi": -0.1},
                "axes": {"minus_xi_deg": [54.75, 69.0]},
            },
            "spin": {"n_i": 0, "omega_xy0": 1.4, "psi": 45},
            "horizon": {"t": 2000},
            "integrator": {"tol": 1e-6},
            "record": ["spectrum"],
        },
        output=tmp_path / "sweep",
        progress=False,
    )
    wanted = sweep.runs.query('regime == "periodic"')
    assert len(wanted)
    found = sweep.find_orbits()
    assert found["case"].tolist() == wanted["case"].tolist()
    assert (found["kind"] == "stable").all()
    assert found.attrs["units"]["period"] == "sqrt(a/g)"


@pytest.mark.slow
def test_an_ellipsoid_that_is_nearly_a_paraboloid_has_its_orbit(orbit):
    # Its tangents are differences, as those of ellipsoids have no formula.
    flat = rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -0.485, c=1e9)
    found = rs.orbit(
        flat, omega=orbit.omega, u=orbit.u, period=orbit.period, energy=6.52
    )
    assert found.period == pytest.approx(orbit.period, abs=1e-7)
    assert np.abs(found.multipliers - orbit.multipliers).max() < 1e-6
    curved = rs.Rattleback(7, 3, 7, 1 / 4, 1 / 9, -0.485, c=2000)
    found = rs.orbit(
        curved, omega=orbit.omega, u=orbit.u, period=orbit.period, energy=6.52
    )
    growth = np.exp(found.period * found.volume_rate)
    assert np.prod(found.multipliers) == pytest.approx(growth, rel=1e-8)
