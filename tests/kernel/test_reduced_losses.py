"""The reduced model with losses: against SciPy, in a mirror, without losses."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

import rattlesweep as rs
from rattlesweep.physics import theory

SLOW = pytest.mark.slow
GH = rs.Rattleback.gh()
MODES = theory.modes(GH.alpha, GH.beta, GH.theta, GH.phi, GH.xi)
EPS = 1e-4  # below it rolling resistance is viscous
LAUNCH = {"n_i": 0.1, "omega_xy0": 0.01, "psi": 20.0}


class Reference:
    """The averaged equations in plain numbers, with spins that are held at zero."""

    def __init__(self, sigma=0.0, rolling=0.0, pivot=0.0, creep=0.0, viscous=0.0):
        self.sigma, self.rolling, self.lever = sigma, rolling, pivot
        self.K = float(MODES.K_p), float(MODES.K_r)
        psi = np.array([MODES.psi_p, MODES.psi_r])
        omega = np.array([MODES.omega_p, MODES.omega_r])
        self.J = GH.alpha * np.cos(psi) ** 2 + GH.beta * np.sin(psi) ** 2
        self.G = sigma / self.J
        if viscous:
            self.G += omega**2 / (viscous * self.J)
        self.C = np.zeros(2)
        if creep:
            c = 128 * omega**2 / (9 * np.pi**2 * self.J)
            self.C = c * pivot / creep**2

    def resisted(self, energies):
        """Return what rolling resistance takes of a mode that oscillates alone."""
        taken = np.zeros(2)
        for mode, energy in enumerate(energies):
            size = np.sqrt(2 * max(energy, 0.0) / self.J[mode])
            if self.rolling and size > 0:
                mean, _ = quad(
                    lambda a, size=size: (
                        (size * np.sin(a)) ** 2 / np.hypot(size * np.sin(a), EPS)
                    ),
                    0,
                    np.pi / 2,
                    epsabs=1e-14,
                    limit=200,
                )
                taken[mode] = self.rolling * mean * 2 / np.pi
        return taken

    def drive(self, y):
        return self.K[1] * y[2] - self.K[0] * y[1]

    def rates(self, y, sense):
        n, p, r = y
        resisted = self.resisted((p, r))
        turned = self.drive(y) - self.sigma * n - self.lever * sense
        return np.array(
            [
                turned / GH.gamma if sense else 0.0,
                (self.K[0] * n - self.G[0] - abs(n) * self.C[0]) * p - resisted[0],
                (-self.K[1] * n - self.G[1] - abs(n) * self.C[1]) * r - resisted[1],
            ]
        )

    def run(self, y, t_end):
        """Return the times of reversals and of the first rest, and the last state."""
        t, sense, side = 0.0, np.sign(y[0]), np.sign(y[0])
        turns, held = [], None
        while t < t_end:

            def zero(t, y, sense=sense):
                if sense:
                    return y[0]
                return abs(self.drive(y)) - self.lever

            zero.terminal = True
            # A little time away from the zero from which it starts.
            zero.direction = -sense if sense else 1
            part = solve_ivp(
                lambda t, y, sense=sense: self.rates(y, sense),
                (t, t_end),
                y,
                method="DOP853",
                rtol=1e-11,
                # Energies fall far before they grow again.
                atol=[1e-13, 1e-60, 1e-60],
                events=zero,
            )
            t, y = part.t[-1], part.y[:, -1].copy()
            if part.status == 0:
                break
            y[0] = 0.0
            drive = self.drive(y)
            if sense and abs(drive) <= self.lever:
                sense = 0
                held = t if held is None else held
                continue
            sense = np.sign(drive)
            if sense != side:
                turns.append(t)
                side = sense
        return turns, held, y


def energies_at(omega_xy0, psi_deg):
    """Return the energies of pitch and roll of a push."""
    push = omega_xy0 * np.array([np.cos(psi_deg), np.sin(psi_deg)])
    moments = np.array([GH.alpha, GH.beta])
    found = []
    for psi in (MODES.psi_p, MODES.psi_r):
        mode = np.array([np.cos(psi), np.sin(psi)])
        found.append(0.5 * (push @ (moments * mode)) ** 2 / (mode @ (moments * mode)))
    return found


@pytest.mark.parametrize(
    ("n_i", "given"),
    [
        (0.1, {"sigma": 0.002}),
        (-0.1, {"sigma": 0.0005}),
        pytest.param(0.1, {"pivot": 1e-4}, marks=SLOW),
        pytest.param(-0.1, {"pivot": 2e-4, "creep": 0.3}, marks=SLOW),
        pytest.param(0.1, {"sigma": 3e-3, "pivot": 5e-4, "creep": 0.2}, marks=SLOW),
        pytest.param(0.1, {"pivot": 3e-3}, marks=SLOW),
        (0.1, {"viscous": 200.0}),
        (-0.2, {"viscous": 500.0, "sigma": 1e-4}),
    ],
)
def test_losses_follow_the_averaged_equations(n_i, given):
    launch = LAUNCH | {"n_i": n_i}
    run = rs.simulate(
        GH, **launch, **given, model="reduced", t_end=3000.0, record=["reversals"]
    )
    start = [n_i, *energies_at(0.01, np.radians(20))]
    turns, held, last = Reference(**given).run(start, run.t_end)
    assert run.status == "ok"
    # Turns count from a quarter of the spin to a quarter on the other side.
    count = run.n_turns
    assert run.turn_times == pytest.approx(turns[:count], rel=1e-7)
    assert run.n_end == pytest.approx(last[0], abs=1e-7)
    at_launch = 0.5 * GH.gamma * n_i**2 + sum(start[1:])
    left = 0.5 * GH.gamma * last[0] ** 2 + sum(last[1:])
    assert run.energy_left == pytest.approx(left / at_launch, abs=1e-7)
    assert abs(run.energy_drift) < 1e-9
    if "pivot" in given:
        if held is None:
            assert run.t_held is None
        else:
            assert run.t_held == pytest.approx(held, rel=1e-7)


@pytest.mark.parametrize("rolling", [1e-5, 3e-4])
def test_rolling_resistance_of_one_mode_is_its_mean(rolling):
    launch = {"n_i": 0.1, "omega_xy0": 0.01, "psi": "pitch"}
    run = rs.simulate(GH, **launch, rolling=rolling, model="reduced", t_end=60.0)
    pitch = energies_at(0.01, MODES.psi_p)[0]
    _, _, last = Reference(rolling=rolling).run([0.1, pitch, 0.0], 60.0)
    lost = 0.5 * GH.gamma * 0.01 + pitch - 0.5 * GH.gamma * last[0] ** 2 - last[1]
    at_launch = 0.5 * GH.gamma * 0.01 + pitch
    assert 1 - run.energy_left == pytest.approx(lost / at_launch, rel=2e-3)


@pytest.mark.slow
def test_a_held_spin_is_released_or_stays_held():
    # A push without spin: the drive is below the lever until the end.
    held = rs.simulate(
        GH, n_i=0, omega_xy0=0.01, model="reduced", pivot=1e-3, t_end=300.0
    )
    assert (held.type, held.n_end, held.t_held) == ("D", 0.0, 0.0)
    assert held.held_time == pytest.approx(300.0)
    # Damping is no reason to spin, and a larger push turns it.
    spun = rs.simulate(
        GH, n_i=0, omega_xy0=0.1, model="reduced", pivot=1e-3, t_end=300.0
    )
    assert spun.t_held is None
    assert spun.n_end < -0.05


@pytest.mark.slow
def test_mirrored_bodies_lose_the_same():
    given = {"sigma": 0.001, "pivot": 1e-4, "creep": 0.3, "rolling": 1e-5}
    one = rs.simulate(GH, **LAUNCH, **given, model="reduced")
    other = rs.simulate(
        GH.mirrored(), n_i=-0.1, omega_xy0=0.01, psi=-20.0, **given, model="reduced"
    )
    # The directions of its modes are rounded in another way.
    assert other.t_r == pytest.approx(one.t_r, rel=1e-10)
    assert other.creep_work == pytest.approx(one.creep_work, rel=1e-10)
    assert one.creep_work > 0
    assert other.K_r_creep == pytest.approx(-one.K_r_creep, rel=1e-12)


@pytest.mark.parametrize(
    "zero", [{"sigma": 0.0}, pytest.param({"pivot": 0.0, "creep": 0.0}, marks=SLOW)]
)
def test_without_losses_all_bits_are_those_of_the_reduced_model(zero, tmp_path):
    name = next(iter(zero))
    values = [0.0, 1e-3]
    plain = rs.simulate(GH, **LAUNCH, model="reduced", t_end=3000.0)
    frame = rs.simulate(
        GH, **LAUNCH, model="reduced", t_end=3000.0, **(zero | {name: values})
    )
    first = frame.iloc[0]
    assert (first.t_r, first.n_end, first.n_steps) == (
        plain.t_r,
        plain.n_end,
        plain.n_steps,
    )
    assert frame.t_r[1] != plain.t_r


def test_sliding_is_refused_with_a_sentence():
    with pytest.raises(rs.ConfigError, match="mu: the reduced model has no contact"):
        rs.simulate(GH, **LAUNCH, model="reduced", mu=0.3)


@pytest.mark.slow
def test_trajectories_and_channels_show_the_losses():
    channels = ["t", "n", "E_p", "E_r", "energy", "work", "held", "pivot_torque"]
    course = rs.trajectory(
        GH, **LAUNCH, model="reduced", pivot=3e-3, t_end=500.0, channels=channels
    )
    table = course.table
    energy = 0.5 * GH.gamma * table.n**2 + table.E_p + table.E_r
    assert np.abs(energy - table.energy).max() < 1e-9
    assert np.abs(table.energy - table.work - energy[0]).max() < 1e-9
    is_held = table.held == 1
    assert is_held.any()
    assert np.abs(table.n[is_held]).max() < 1e-12
    balance = MODES.K_p * table.E_p - MODES.K_r * table.E_r
    assert np.abs(table.pivot_torque - balance)[is_held].max() < 1e-15
    assert (table.pivot_torque[~is_held] == -3e-3 * np.sign(table.n[~is_held])).all()


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["sigma", "rolling", "pivot", "creep"])
def test_full_dynamics_agree_in_the_limit_of_small_spin_and_push(loss):
    """Halve spin and push; losses scale so that their share of the motion stays."""

    def difference(scale):
        square = scale * scale
        given = {
            "sigma": {"sigma": 0.03 * scale},
            "rolling": {"rolling": 0.004 * square},
            "pivot": {"pivot": 0.01 * square},
            "creep": {"pivot": 0.01 * square, "creep": 0.3},
        }[loss]
        launch = {"n_i": 0.2 * scale, "omega_xy0": 0.02 * scale}
        end = 600.0 / scale
        full = rs.simulate(GH, **launch, **given, t_end=end)
        averaged = rs.simulate(GH, **launch, **given, t_end=end, model="reduced")
        if loss == "creep":
            return abs(averaged.creep_work / full.creep_work - 1)
        if loss == "rolling":
            return abs(averaged.energy_left - full.energy_left)
        return abs(averaged.t_r / full.t_r - 1)

    differences = [difference(scale) for scale in (1.0, 0.5, 0.25)]
    assert differences[1] < 0.6 * differences[0]
    assert differences[2] < 0.6 * differences[1]


@pytest.mark.parametrize(
    ("given", "named"),
    [
        pytest.param({"pivot": 1e-3}, "pivot", marks=SLOW),
        ({"sigma": 0.001, "rolling": 1e-3}, "rolling"),
    ],
)
def test_errors_that_are_not_calibrated_are_refused(given, named):
    words = f"not calibrated for the reduced model with .*leave out error or {named}"
    with pytest.raises(rs.ConfigError, match=words):
        rs.simulate(GH, **LAUNCH, **given, model="reduced", record=["error"])
