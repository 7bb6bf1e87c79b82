"""The spectrum in sweeps: its columns, regimes, dimensions, charts, and rules."""

import numpy as np
import pytest
from sweeping import invoke, plan_of

import rattlesweep as rs
from rattlesweep.rows.regimes import kaplan_yorke, regime_codes, significant
from rattlesweep.store.decide import wanted_runs
from rattlesweep.store.rows import open_stored
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.names import REGIMES
from rattlesweep.work.verify import verify

# A body of Gonchenko and others (2013), with a strange attractor at an energy of 6.52.
CELTIC = {"alpha": 7.0, "beta": 3.0, "gamma": 7.0, "theta": 0.25, "phi": 1 / 9}
CHART = {
    "bodies": {
        "source": "grid",
        "base": CELTIC | {"xi": -0.1},
        "axes": {"minus_xi_deg": {"linspace": [50, 88, 9]}},
        "refine": {"levels": 1, "by": "regime"},
    },
    "spin": {"n_i": 0, "omega_xy0": {"linspace": [0.2, 1.4, 9]}, "psi": 45},
    "horizon": {"t": 2000},
    "integrator": {"tol": 1e-6},
    "record": ["spectrum"],
}


@pytest.mark.parametrize(
    ("exponents", "dimension"),
    [
        ([0.906, 0, -14.572], 2 + 0.906 / 14.572),  # Lorenz's attractor
        ([-1, 0, -2, -3], 1),
        ([0, -1, 0, -2], 2),
        ([1, 0, 0, -1], 4),
        ([0, 0, 0, 0], 4),
        ([-1, -2, -3, -4], 0),
        ([0.02, 0, -0.01, -0.03], 3 + 1 / 3),
    ],
)
def test_dimension_of_kaplan_and_yorke(exponents, dimension):
    assert kaplan_yorke(np.array([exponents], float)) == pytest.approx([dimension])


@pytest.mark.parametrize(
    ("third", "last", "regime"),
    [
        ([-10, -10, -20, -20], [-10, -10, -20, -20], "steady"),
        ([0.5, -10, -10, -30], [-0.5, -10, -10, -30], "periodic"),
        ([0.4, -0.4, 0, 0], [0.3, -0.3, 0, 0], "quasi-periodic"),
        ([10, 0, -10, -30], [9, 0, -12, -31], "attractor"),
        ([10, 0, 0, -10.1], [10, 0, 0, -10.1], "conservative"),
        # The slow mode decays by e^4, or the sum of the zeros keeps its sense.
        ([0, -10, -10, -2], [0, -10, -10, -2], "undecided"),
        ([-0.8, 0, 0, 0], [-0.1, -0.8, 0, 0], "undecided"),
        # Two modes decay and two stay, as on the way to something else.
        ([0.4, -9, -9, -0.4], [0.3, -9, -9, -0.3], "undecided"),
        # Differences grew in one quarter and shrank in the other.
        ([30, 0, -30, 0], [-10, 0, 10, 0], "undecided"),
        ([0, -30, -30, -30], [0, 10, 10, 10], "undecided"),
        # The volume grows, or its rate is not known.
        ([20, 20, -10, 0], [20, 20, -10, 0], "undecided"),
        ([10, 0, 0, -20], [10, 0, 0, -1], "undecided"),
    ],
)
def test_regimes_follow_from_growths_and_their_change(third, last, regime):
    (code,) = regime_codes(np.array([third], float), np.array([last], float))
    assert REGIMES[code] == regime
    nothing = np.full((1, 4), np.nan)
    assert regime_codes(nothing, nothing) == [-1]


@pytest.mark.slow
def test_a_motion_that_dies_out_at_once_is_steady():
    # Its flow falls below the smallest numbers within the first of 64 windows.
    body = rs.Rattleback(13, 2.5, 12, 0.9, 0.05, -0.7)
    launch = {"n_i": -1.5, "record": "spectrum"}
    run = rs.simulate(body, **launch, omega_xy0=1e-115, t_end=45_000)
    late = np.array(run.lyapunov_spectrum_late)
    assert run.regime == "steady"
    assert run.kaplan_yorke == 0
    # The exponents are those of a motion that is followed all the time.
    like = rs.simulate(body, **launch, omega_xy0=0.01, t_end=2000)
    assert late == pytest.approx(like.lyapunov_spectrum_late, abs=2e-3)


def test_a_spin_about_to_leave_its_plateau_is_undecided():
    # Along an unstable spin the volume grows, which it cannot do for ever.
    launch = {"n_i": 0.1, "omega_xy0": 1e-100, "t_end": 1000}
    run = rs.simulate("GH", **launch, record="spectrum")
    assert sum(run.lyapunov_spectrum_late) > run.lyapunov_spectrum_late[0] > 0
    assert run.regime == "undecided"


def test_small_exponents_count_as_zero():
    late = np.array([[0.011, 0.009, -0.009, -0.011]])
    assert significant(late, np.array([2000.0])).tolist() == [[0.011, 0, 0, -0.011]]


def test_runs_without_exponents_have_no_regime():
    # Too short for a second half, and a steady spin without any motion.
    short = {"n_i": -0.1, "omega_xy0": 0.01, "t_end": 15}
    still = {"omega": (0, 0, 0.5), "u": (0, 0, -1), "t_end": 900}
    for launch in (short, still):
        run = rs.simulate("GH", **launch, record="spectrum")
        assert run.status == "ok"
        assert run.lyapunov_spectrum_late is None
        assert run.kaplan_yorke is None
        assert run.regime is None
        assert run.chaotic is None


@pytest.mark.slow
def test_a_strange_attractor():
    body = rs.Rattleback(**CELTIC, xi=-0.485)
    record = ["lyapunov", "spectrum", "volume"]
    run = rs.simulate(
        body, n_i=1.0, omega_xy0=1.0, t_end=20_000, record=record, tol=1e-7
    )
    spectrum = np.array(run.lyapunov_spectrum_late)
    assert (np.diff(spectrum) <= 0).all()
    assert run.regime == "attractor"
    assert run.chaotic
    assert spectrum[0] == run.lyapunov_late
    # The flow and the energy.
    assert np.sort(np.abs(spectrum))[:2] == pytest.approx(0, abs=1e-4)
    assert spectrum.sum() < -10 * abs(spectrum[1])
    assert 3 < run.kaplan_yorke < 4
    assert run.t_end == 20_000


def test_columns_by_what_is_recorded():
    launch = {"n_i": -0.1, "omega_xy0": 0.01, "t_end": 900}
    both = rs.simulate(["GH"], **launch, record=["spectrum", "lyapunov"])
    names = list(both.columns)
    first = names.index("lyapunov")
    expected = ["lyapunov", "lyapunov_late", "lyapunov_spectrum"]
    expected += ["lyapunov_spectrum_late", "kaplan_yorke", "regime", "chaotic"]
    assert names[first : first + 7] == expected
    alone = rs.simulate(["GH"], **launch, record="spectrum")
    assert "lyapunov" not in alone
    assert alone["chaotic"].equals(both["chaotic"])
    # The first reversal is told, and the run goes on.
    assert alone["t_r"][0] == pytest.approx(809.857418)
    assert alone["t_end"][0] == 900


@pytest.mark.slow
def test_a_chart_is_refined_by_its_regimes(tmp_path):
    sweep = rs.sweep(CHART, output=tmp_path / "chart", progress=False)
    runs = sweep.read()
    assert len(runs) < 81
    assert {"attractor", "periodic", "quasi-periodic"} <= {*runs["regime"]}
    stored = open_stored(tmp_path / "chart")
    assert wanted_runs(stored, stored.find()).sum() == len(runs)
    assert verify(tmp_path / "chart").problems == []
    # Between points of the coarse grid whose regimes differ, the others are run.
    grid = runs.assign(
        x=(np.degrees(-runs["xi"]) - 50) / 4.75, y=(runs["omega_xy0"] - 0.2) / 0.15
    ).round({"x": 0, "y": 0})
    by_place = grid.set_index(["x", "y"])["regime"]
    for x in range(0, 8, 2):
        for y in range(0, 8, 2):
            corners = [by_place[x + dx, y + dy] for dx in (0, 2) for dy in (0, 2)]
            has_middle = (x + 1, y + 1) in by_place.index
            assert has_middle == (len({*corners}) > 1), (x, y)
    result = invoke("plot", tmp_path / "chart", "--data", tmp_path / "chart.csv")
    assert str(tmp_path / "chart" / "regimes.png") in result.stdout
    head = (tmp_path / "chart.csv").read_text().splitlines()[0]
    assert "fraction_attractor" in head.split(",")


@pytest.mark.slow
def test_a_replay_takes_the_steps_of_the_stored_run(tmp_path):
    config = {
        "bodies": {"source": "sd", "samples": 8},
        "spin": {"n_i": [-0.3, 0.3], "omega_xy0": 0.01},
        "horizon": {"t": 1000},
    }
    plain = rs.sweep(config, output=tmp_path / "plain", progress=False).read()
    output = tmp_path / "spectrum"
    sweep = rs.sweep(config | {"record": "spectrum"}, output=output, progress=False)
    runs = sweep.read()
    reverses = runs["t_r"].notna()
    assert reverses.sum() >= 8
    # The steps are shorter than without the spectrum.
    assert (runs["t_r"] != plain["t_r"])[reverses].any()
    for run in runs[reverses].itertuples():
        assert rs.replay(output, run.case, run.sample).zeros[0] == run.t_r


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"record": ["spectrum", "error"]}, "spectrum and error exclude each other"),
        ({"dissipation": {"sigma": 0.1}}, "spectrum needs paraboloids without"),
        ({"classify": {"early": True}}, "need whole runs"),
        ({"integrator": {"accuracy": {"t_r": 1e-6}}}, "reversals, spectrum or late"),
    ],
)
def test_rules(keys, words):
    with pytest.raises(ConfigError, match=words):
        plan_of(CHART, **keys)
