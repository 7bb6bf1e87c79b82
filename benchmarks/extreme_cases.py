"""The extremes: a table of named cases, and rattlesweep's results for them.

Each case is run as in a sweep, from a row of a table of bodies and a config.
"""

import math
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import extrapolation as reference
import numpy as np
import pandas as pd
import theory_mp
from mpmath import mp
from oracle import GH
from sweeping import prepared

from rattlesweep.integrate.batch import kernel
from rattlesweep.physics import full, theory
from rattlesweep.sweeps.block import columns_of, run_batch
from rattlesweep.sweeps.config.read import parse_config
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.types import TYPES


def shell_dumbbell(gamma=10.0, f_sd=0.1, theta=0.8, phi=0.05, xi=-3.0):
    """A shell-dumbbell body, xi in degrees."""
    return {
        "alpha": (1 - f_sd) * gamma + 1,
        "beta": f_sd * gamma + 1,
        "gamma": gamma,
        "theta": theta,
        "phi": phi,
        "xi": math.radians(xi),
    }


@dataclass(frozen=True)
class Case:
    """One run at an extreme.

    ``angle`` is the reference's step in radians; ``error`` the largest relative error
    allowed at tol 1e-9 and at tol 1e-12, of t_r or, without a reversal, of the state
    relative to its oscillation.
    """

    name: str
    body: dict
    n_i: float
    omega_xy0: float = 0.01
    t_end: float = 100.0
    angle: float = 1.0
    error: tuple = (1e-6, 1e-9)


def gh(**changes):
    """GH with other parameters; ``xi`` in degrees."""
    if "xi" in changes:
        changes["xi"] = math.radians(changes["xi"])
    return {**GH, **changes}


def _k_r(value):
    """GH with the skew angle that makes K_r small: K_r is proportional to it."""
    tiny = 1e-6
    body = gh(xi=-tiny)
    k_r = theory.modes(*(body[x] for x in ("alpha", "beta", "theta", "phi", "xi"))).K_r
    return gh(xi=-tiny * value / float(k_r))


NEAR = gh(beta=13.04 - 1e-9)
FLAT, LONG_ROLL = gh(theta=1 - 1e-9), gh(phi=1e-4)
SD, OVERDAMPED = shell_dumbbell(), gh(xi=-45.0)

# Cases for the longdouble reference, with launches (n_i, omega_xy0, horizon, other
# settings).  The second launch is in the steady direction; the reference is too slow
# for longer horizons.
REFERENCE = tuple(
    Case(name + suffix, body, *launch)
    for name, body, *launches in (
        ("GH", gh(), (0.1, 0.01, 130), (-0.1, 0.3, 200)),
        ("phi 1e-4", LONG_ROLL, (0.1, 0.01, 7), (-0.1, 0.1, 8)),
        ("phi 1e-3", gh(phi=1e-3), (0.1, 0.01, 12)),
        ("theta 1 - 1e-6", gh(theta=1 - 1e-6), (0.1, 0.01, 150)),
        ("theta 1 - 1e-9", FLAT, (0.1, 0.01, 150), (-0.1, 0.1, 150)),
        ("xi -1e-8 deg", gh(xi=-1e-8), (0.1, 0.01, 150), (-0.1, 0.01, 150)),
        ("xi -1e-3 deg", gh(xi=-1e-3), (0.1, 0.1, 60)),
        ("xi -45 deg", OVERDAMPED, (0.1, 0.1, 8), (-0.1, 0.3, 60)),
        ("xi -89 deg", gh(xi=-89.0), (0.1, 0.5, 30, 0.5), (-0.1, 0.3, 60)),
        ("alpha - beta 1e-9", NEAR, (0.1, 0.1, 60), (-0.1, 0.1, 100)),
        ("f_sd 0.05", shell_dumbbell(f_sd=0.05), (0.1, 0.1, 40), (-0.1, 0.5, 150)),
        ("f_sd 0.15", shell_dumbbell(f_sd=0.15), (0.1, 0.1, 80), (-0.1, 0.5, 150)),
        ("f_sd 1e-3", shell_dumbbell(f_sd=1e-3), (0.1, 0.1, 30), (-0.1, 0.3, 150)),
        ("f_sd 0.499", shell_dumbbell(f_sd=0.499), (0.1, 0.1, 60), (-0.1, 0.1, 100)),
        *(
            (f"n_i {n}", gh(), (float(n), *rest))
            for n, *rest in (
                ("1e-6", 0.01, 10),
                ("-1e-6", 0.01, 10),
                ("1e-3", 0.01, 50),
                ("-1e-4", 0.01, 200),
                ("1", 0.01, 60),
                ("-1", 0.01, 200),
                ("5", 0.01, 20),
                ("-5", 0.01, 30),
                ("50", 0.001, 2),
                ("-50", 0.001, 3),
            )
        ),
        ("omega_xy0 1e-12", gh(), (0.5, 1e-12, 300), (-0.5, 1e-12, 150)),
        ("omega_xy0 1e-6", gh(), (0.5, 1e-6, 200)),
        ("omega_xy0 1", gh(), (0.5, 1.0, 20), (-0.5, 1.0, 80)),
        ("omega_xy0 3", gh(), (0.5, 3.0, 10), (-0.5, 3.0, 8)),
        ("omega_xy0 3, n_i 5", gh(), (5.0, 3.0, 5, 1.0, (1e-4, 1e-6))),
    )
    for suffix, launch in zip(("", ", steady direction"), launches, strict=False)
)

# Oscillations so small that the linear motion is exact over the whole run.
LINEAR = (
    Case("K_r 1e-7, to 1e6", _k_r(1e-7), -0.1, 1e-12, 1e6),
    Case("K_r 1e-7, to 1e6, n_i > 0", _k_r(1e-7), 0.1, 1e-12, 1e6),
    Case("xi -1e-8 deg, to 1e6", gh(xi=-1e-8), -0.1, 1e-12, 1e6),
    Case("xi -1e-8 deg, to 1e6, n_i > 0", gh(xi=-1e-8), 0.1, 1e-12, 1e6),
    Case("alpha - beta 1e-9, to 1e6", NEAR, -0.1, 1e-12, 1e6),
    Case("f_sd 0.499, to 5e5", shell_dumbbell(f_sd=0.499), 0.1, 1e-12, 5e5),
    Case("theta 1 - 1e-9, to 1e5", FLAT, -0.1, 1e-12, 1e5),
    Case("phi 1e-4, n_i 0.01", LONG_ROLL, 0.01, 1e-12, 8),
    Case("n_i -50, to 1e4", gh(), -50.0, 1e-12, 1e4),
    Case("roll decays by 1e-24", gh(), -2.0, 1e-12, 1e4),
    Case("roll decays by 1e-65", gh(), -3.0, 1e-12, 1e4),
)

# Beyond Bondi's threshold both modes decay, here by 1e-30 and more: SS.
DECAY = (
    Case("GH, n_i -2, to 1e5", gh(), -2.0, 0.01, 1e5),
    Case("GH, n_i -3, to 1e5", gh(), -3.0, 0.01, 1e5),
    Case("GH, n_i -10, to 1e5", gh(), -10.0, 1e-12, 1e5),
    Case("mirrored GH, n_i 2, to 1e5", gh(xi=1.72), 2.0, 0.01, 1e5),
    Case("SD, n_i -1, to 1e5", SD, -1.0, 0.01, 1e5),
    Case("SD, n_i -3, to 1e6", SD, -3.0, 1e-12, 1e6),
    Case("theta 1 - 1e-9, n_i -1, to 1e6", FLAT, -1.0, 0.01, 1e6),
    Case("phi 1e-4, n_i -2, to 2e4", LONG_ROLL, -2.0, 0.01, 2e4),
)
# The roll is overdamped and far below the pitch, which decays slowly.
OVERDAMPED_ROLL = tuple(
    Case(f"xi -45 deg, n_i {n:g}, omega_xy0 {w:g}", OVERDAMPED, n, w, 2000.0)
    for n in (-1.7, -10.0)
    for w in (1e-12, 1e-6)
)
# The amplitude saturates within the first of 64 windows, and the spin wobbles ever
# after.
SATURATED = tuple(
    Case(f"GH, n_i -1, to {t:g}", gh(), -1.0, 0.01, t) for t in (1e3, 1e4, 1e5)
)

# (case, type by the reference, steps of RK4)
COARSE = (
    (
        Case("GH", gh(), 0.1, 0.01, 130.0),
        "R",
        (0.1, 0.3, 0.5, 0.8, 1.0, 1.5, 2.0, 2.5, 5.0, 20.0),
    ),
    (
        Case("GH, steady direction", gh(), -0.1, 0.01, 1000.0),
        "R",
        (0.1, 0.3, 0.5, 0.8, 1.0, 1.5, 1.9, 2.0, 2.5, 5.0, 20.0),
    ),
    (
        Case("GH, n_i 0.5", gh(), 0.5, 0.001, 200.0),
        "R",
        (0.1, 0.3, 0.5, 0.8, 1.0, 1.5, 1.9, 2.5, 5.0),
    ),
    (
        Case("GH, n_i -2", gh(), -2.0, 0.01, 1000.0),
        "SS",
        (0.1, 0.3, 0.5, 0.8, 1.0, 1.5, 5.0),
    ),
    (
        Case("phi 1e-4", LONG_ROLL, 0.1, 0.01, 7.0),
        "R",
        (0.002, 0.01, 0.03, 0.07, 0.1, 0.2, 1.0),
    ),
)

# Bodies launched so that the spin swings through zero: the first touches are searched
# for.
GRAZING = (
    ("GH", gh(), 0.1, 1),
    ("GH, steady direction", gh(), 0.3, -1),
    ("SD", SD, 0.1, 1),
    ("theta 0.95", gh(theta=0.95), 0.1, 1),
    ("xi -20 deg", gh(xi=-20.0), 0.1, 1),
)


def touches(body, omega_xy0, direction, count=2, t_end=20.0):
    """Initial spins at which the spin just touches zero, by a scan and nested searches.

    Below a touch, the first reversal is the first of a close pair of zeros; above it,
    the pair is gone and the reversal comes a swing later.
    """

    def late(n_i):
        cases = [Case("", body, direction * n, omega_xy0, t_end) for n in n_i]
        t = np.array([a.t_r for a in ask(cases, {"tol": 1e-13})])
        return np.flatnonzero(np.diff(np.where(np.isnan(t), 2 * t_end, t)) > 0.2)

    n_i = np.logspace(-3.5, -1.5, 400)
    found = []
    for k in late(n_i)[:count]:
        low, high = n_i[k], n_i[k + 1]
        while high - low > 4e-16 * high:
            grid = np.linspace(low, high, 201)
            j = late(grid)[0]
            low, high = grid[j], grid[j + 1]
        found.append(direction * low)
    return found


@dataclass
class Answer:
    """Rattlesweep's result for a case: columns of ``runs`` and the final state."""

    row: dict
    y_end: np.ndarray
    probe: np.ndarray
    seconds: float

    def __getattr__(self, name):
        return self.row[name]


def ask(cases, integrator=None, max_steps=100_000_000):
    """Run cases as one block; ``integrator`` as in a config."""
    frame = pd.DataFrame(
        [
            {**c.body, "n_i": c.n_i, "omega_xy0": c.omega_xy0, "t_end": c.t_end}
            for c in cases
        ],
        dtype=float,
    )
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "cases.parquet"
        frame.to_parquet(path)
        config = parse_config(
            {
                "bodies": {"source": "table", "path": str(path)},
                "spin": {"n_i": [1.0], "omega_xy0": [1.0]},
                "horizon": {"t": 1.0},
                "integrator": {**(integrator or {}), "max_steps": max_steps},
            }
        )
        plan = make_plan(config)
    kernel(config.integrator.method, config.model)  # compiled before the clock runs
    launches, batch = prepared(plan)
    begin = time.perf_counter()
    outcome = run_batch(config, batch, threads=1)
    columns = columns_of(config, launches, batch, outcome)
    seconds = time.perf_counter() - begin
    answers = []
    codes, status = columns["type"][0], columns["status"]
    for k, case in enumerate(cases):
        for name in (*reference.PARAMETERS, "n_i", "omega_xy0"):
            wanted = case.body[name] if name in case.body else getattr(case, name)
            assert columns[name][k] == wanted
        row = {
            name: value[k].item()
            for name, value in columns.items()
            if isinstance(value, np.ndarray)
        }
        row["type"] = TYPES[codes[k]] if codes[k] >= 0 else None
        row["status"] = status[1][int(status[0][k])]
        probe = batch.probe[k, :4] + 1j * batch.probe[k, 4:]
        answers.append(Answer(row, outcome.y_end[k], probe, seconds))
    return answers


# --- references
# -----------------------------------------------------------------------------------


def refer(cases, answers, share=1.0, exact=False):
    """Return the reference's results; the direction of the launch is rattlesweep's."""
    return reference.integrate(
        [[c.body[name] for name in reference.PARAMETERS] for c in cases],
        [c.n_i for c in cases],
        [c.omega_xy0 for c in cases],
        [a.psi for a in answers],
        [c.t_end for c in cases],
        angle=[share * c.angle for c in cases],
        exact=exact,
    )


def state_error(body, y, vectors):
    """Error of a state (p, q, omega) relative to its oscillation; ``vectors`` is (u,
    omega).
    """
    vectors = np.array(
        [float(x) for x in vectors[:2] / vectors[2]] + [float(x) for x in vectors[3:]]
    )
    c = full.constants(**body)
    size = np.sqrt(full.oscillation(*vectors[:4], c[0], c[1], *c[3:]))
    off = np.asarray(y) - vectors
    return np.sqrt(full.oscillation(*off[:4], c[0], c[1], *c[3:])) / size


def errors(case, answer, found, k):
    """Relative errors of t_r (or of the state without a reversal) and of n_end."""
    t_r, reverses = float(found.t_r[k]), not np.isnan(float(found.t_r[k]))
    if reverses or np.isfinite(answer.t_r):
        return abs(answer.t_r / t_r - 1) if reverses else np.inf, 0.0
    n_end = float(found.n_end[k])
    return state_error(case.body, answer.y_end, found.y_end[:, k]), abs(
        answer.n_end / n_end - 1
    )


def linear(case, answer):
    """Growth exponent of the whole run at 50 digits, and the errors of amplitude and
    phase.

    The product of a left eigenvector with the state is exp(lambda t) times that at the
    start.
    """
    with mp.workdps(theory_mp.WORK):
        matrix = theory_mp.spin_matrix(
            *map(case.body.get, reference.PARAMETERS), case.n_i
        )
        roots = theory_mp._eigenvalues(matrix)
    grows = answer.K_p * case.n_i > 0
    root = roots[0 if grows else 1]
    start = (
        np.array([0, 0, math.cos(answer.psi), math.sin(answer.psi)]) * case.omega_xy0
    )
    with mp.workdps(40):
        wanted = root * mp.mpf(case.t_end)
        ratio = mp.mpc(
            complex(answer.probe @ answer.y_end[:4]) / complex(answer.probe @ start)
        )
        off = mp.log(ratio) - wanted
        phase = mp.fmod(off.imag, 2 * mp.pi)
        phase = min(abs(phase), abs(2 * mp.pi - abs(phase)))
        return float(wanted.real), float(off.real), float(phase)


# --- measurements
# ---------------------------------------------------------------------------------

TOLS = (1e-9, 1e-12)


def _at_tols(cases, one_by_one):
    return [
        [ask([c], {"tol": tol})[0] for c in cases]
        if one_by_one
        else ask(cases, {"tol": tol})
        for tol in TOLS
    ]


def against_reference(cases, one_by_one=False):
    """Rows (case, answers at TOLS, the reference's t_r, its own error, errors at
    TOLS).
    """
    answers = _at_tols(cases, one_by_one)
    coarse, fine = (refer(cases, answers[0], share) for share in (1.0, 0.5))
    rows = []
    for k, case in enumerate(cases):
        both = [found[k] for found in answers]
        if np.isnan(float(fine.t_r[k])):
            y = np.concatenate(
                [coarse.y_end[:2, k] / coarse.y_end[2, k], coarse.y_end[3:, k]]
            )
            own = state_error(case.body, y.astype(float), fine.y_end[:, k])
        else:
            own = abs(float(coarse.t_r[k] / fine.t_r[k] - 1))
        off = [errors(case, answer, fine, k) for answer in both]
        rows.append((case, both, float(fine.t_r[k]), own, off))
    return rows


def against_growth(cases, one_by_one=False):
    """Rows (case, answers at TOLS, exponent of the run, errors of amplitude and phase
    at TOLS).
    """
    rows = []
    for case, both in zip(
        cases, zip(*_at_tols(cases, one_by_one), strict=True), strict=True
    ):
        off = [linear(case, answer) for answer in both]
        rows.append((case, both, off[0][0], [x[1:] for x in off]))
    return rows


def against_fine(case, kind, dt):
    """RK4 with the step ``dt``: its answer, and ``agrees``, a status, or ``wrong``."""
    answer = ask([case], {"method": "rk4", "dt": dt})[0]
    if answer.status != "ok":
        return answer, answer.status
    good = answer.type == kind
    if kind == "R":
        good = good and abs(answer.t_r / ask([case], {"tol": 1e-12})[0].t_r - 1) < 0.01
    return answer, "agrees" if good else "wrong"
