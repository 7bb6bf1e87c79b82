"""Runs that slide under Coulomb's law: against exact motions, limits and an oracle."""

from dataclasses import replace
from functools import cache

import kernels
import numpy as np
import oracle
import pytest
from numba import njit
from samples import mapping, table_one

from rattlesweep.arrays import take
from rattlesweep.kernel import recipes
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.follow import Follower
from rattlesweep.kernel.method.collocation import radau
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.state.fields import LANES
from rattlesweep.kernel.state.status import Status
from rattlesweep.kernel.state.ways import SLIDING as SLIDING_MODE
from rattlesweep.kernel.step import slots
from rattlesweep.motion.anywhere import from_slopes
from rattlesweep.motion.model import FULL, FULL_ELLIPSOID, find_model
from rattlesweep.physics import full
from rattlesweep.physics.friction.sliding import cos_sin
from rattlesweep.physics.readings import Shape, placed_contact

GH = oracle.GH
DOP853 = METHODS["dop853"]


def with_mu(batch, mu):
    """Return a batch for a model that slides."""
    mu = np.broadcast_to(np.asarray(mu, float), len(batch))
    return replace(batch, constants=np.column_stack([batch.constants, mu]))


def slide(batch, mu, model="full", **settings):
    return integrate(
        with_mu(batch, mu), DOP853, find_model(f"{model}_sliding"), **settings
    )


def in_friction(batch, k=0.0, sigma=0.0, rolling=0.0, eps=1e-4):
    """Return a batch for the models of ellipsoids and of friction."""
    loss = np.tile([k, sigma, rolling, eps], (len(batch), 1))
    return replace(
        batch,
        y0=np.column_stack([batch.y0, np.zeros(len(batch))]),
        constants=np.hstack([batch.constants, loss]),
    )


@pytest.mark.parametrize("stages", [3, 5])
def test_collocation_is_exact_for_polynomials(stages):
    method = radau(stages)
    assert method.points[-1] == 1
    for power in range(stages):
        integral = method.integrals @ method.points**power
        exact = method.points ** (power + 1) / (power + 1)
        assert integral == pytest.approx(exact, abs=1e-15)
    # The weights of the end are exact up to degree 2 s - 2, and no further.
    degrees = np.arange(2 * stages)
    powers = method.points[:, None] ** degrees
    errors = method.integrals[-1] @ powers - 1 / (degrees + 1)
    assert np.abs(errors[:-1]).max() < 1e-15
    assert abs(errors[-1]) > 1e-7


def test_cosine_and_sine_by_sums():
    angles = np.concatenate([np.linspace(-7, 7, 2001), [0.0, 100.0, -3000.5]])
    python = getattr(cos_sin, "py_func", cos_sin)
    found = np.array([python(angle) for angle in angles])
    exact = np.column_stack([np.cos(angles), np.sin(angles)])
    assert np.abs(found - exact).max() < 3e-16


class Slider:
    """One lane that starts with a speed of its contact point, in tests alone."""

    def __init__(self, batch, speed, angle, tol):
        model = find_model("ellipsoid_sliding")
        self._slide = njit(slots.slide_lanes, error_model="numpy")
        self.problem = recipes.problem_of(model)
        self.w = recipes.workspace(DOP853, model, 1)[0]
        self.cells = self.w.reshape(-1, LANES)[:, 0]
        self.scale = tol**-2
        self.set("y", batch.y0[0])
        self.set("constants", batch.constants[0, :-1])
        self.set("mu", batch.constants[0, -1])
        self.set("slip", [speed, angle, 0])
        self.set("swing", 1.0)
        self.set("mode", SLIDING_MODE)
        self.t = 0.0

    def rows(self, name):
        first, kind = self.problem.layout.fields[name]
        return slice(first, first + (len(kind) if hasattr(kind, "__len__") else 1))

    def set(self, name, value):
        self.cells[self.rows(name)] = value

    def get(self, name):
        return self.cells[self.rows(name)].copy()

    def run(self, longest):
        """Take steps until the body rolls."""
        while self.get("slip")[0] > 0:
            self.set("h", longest)
            self._slide(self.problem, self.w, self.scale, False, 0)
            assert self.get("error")[0] <= 1
            self.t += self.get("h")[0]
            self.set("y", self.get("y1"))
            self.set("slip", self.get("slip1"))


@pytest.mark.slow
@pytest.mark.parametrize("spin", [0.0, 0.7])
def test_a_sphere_slides_and_then_rolls(spin):
    # v = 5/7 v_0 after 2 v_0 / (7 mu g), whatever the spin; the direction stays.
    body = {"alpha": 1.4, "beta": 1.4, "gamma": 0.4, "theta": 1, "phi": 1, "xi": 0}
    constants = np.append(full.constants(**body), [1.0, 0.2])  # k = 1: a sphere
    runs = kernels.full_batch(GH, 0.3)
    runs = replace(runs, y0=np.array([[0, 0, 0, 0, -spin]]), constants=constants[None])
    slider = Slider(runs, 0.5, 0.4, tol=1e-11)
    slider.run(0.05)
    assert slider.t == pytest.approx(2 * 0.5 / (7 * 0.2), abs=1e-10)
    # The velocity is u x omega, of which 5/7 of the first is left.
    p, q, *omega = slider.get("y")
    u = -np.array([p, q, 1.0]) / np.sqrt(1 + p * p + q * q)
    velocity = np.cross(omega, u)
    assert np.linalg.norm(velocity) == pytest.approx(5 / 7 * 0.5, abs=1e-10)
    assert u @ omega == pytest.approx(spin, abs=1e-10)
    work = 0.5 * (0.5**2 * (1 - (5 / 7) ** 2) - 0.4 * (5 / 7 * 0.5) ** 2)
    assert slider.get("slip")[2] == pytest.approx(-work, abs=1e-10)


@cache
def sliding_sweep():
    """Bodies of the paper's ranges whose runs slide."""
    rng = np.random.default_rng(8)
    body = mapping(table_one(40, seed=8))
    n_i = rng.choice([0.2, -0.2, 0.3, -0.3, 0.5, -0.5], 40)
    return kernels.full_batch(body, n_i, rng.choice([0.01, 0.1], 40), t_end=150.0)


@cache
def slid(mu):
    return slide(sliding_sweep(), mu)


@pytest.mark.parametrize("mu", [0.2, 0.3, 0.5])
def test_energy_minus_work_is_kept(mu):
    out = slid(mu)
    assert set(out.status) <= {Status.OK, Status.LIFTS_OFF}
    ok = out.status == Status.OK
    assert ok.sum() > 30
    assert (out.n_slides[ok] > 0).sum() > 5
    assert np.abs(out.energy_drift[ok]).max() < 1e-8
    assert (out.slide_work >= 0).all()
    slides_only = out.n_slides > 0
    assert (np.isfinite(out.t_slide) == slides_only).all()
    assert ((out.slide_time > 0) == slides_only).all()


def test_no_slide_takes_more_than_a_few_hundred_steps():
    rolling = integrate(sliding_sweep(), DOP853, FULL)
    for mu in (0.2, 0.3, 0.5):
        out = slid(mu)
        several = np.maximum(out.n_slides, 1)
        assert ((out.n_steps - 2 * rolling.n_steps) / several).max() < 300


def test_a_plane_that_holds_everything_is_the_limit():
    held = integrate(sliding_sweep(), DOP853, FULL)
    out = slide(sliding_sweep(), 1e6)
    assert (out.n_slides == 0).all()
    assert np.isnan(out.t_slide).all()
    assert np.array_equal(out.t_r, held.t_r, equal_nan=True)
    assert np.array_equal(out.y_end, held.y_end)
    assert np.array_equal(out.n_steps, held.n_steps)


def test_the_motion_of_a_mirrored_body_is_mirrored():
    runs = kernels.full_batch(GH, [0.3, 0.4], 0.1, t_end=60.0)
    mirrored = GH | {"xi": -GH["xi"]}
    # Mirrored in the plane of x and z: q, a and c change sign, and so does the spin.
    sign = np.array([1, -1, -1, 1, -1])
    other = replace(
        runs,
        y0=runs.y0 * sign,
        constants=np.tile(full.constants(**mirrored), (2, 1)),
    )
    one = slide(runs, 0.25)
    two = slide(other, 0.25)
    assert one.n_slides.min() > 0
    assert two.t_r == pytest.approx(one.t_r, rel=1e-11, nan_ok=True)
    assert two.y_end == pytest.approx(one.y_end * sign, abs=1e-10)
    assert two.slide_work == pytest.approx(one.slide_work, rel=1e-10)


@pytest.mark.slow
def test_all_models_slide_alike():
    runs = kernels.full_batch(GH, 0.3, 0.1, t_end=100.0)
    damped = in_friction(runs, sigma=1e-3, rolling=2e-3)
    one = slide(damped, 0.3, "full_rolling")
    assert one.n_slides > 0
    model = find_model("ellipsoid_rolling_sliding")
    y0, constants = from_slopes(model, damped.y0, with_mu(damped, 0.3).constants)
    anywhere = replace(damped, y0=y0, constants=constants)
    two = integrate(anywhere, DOP853, find_model("vectors_sliding"))
    assert two.t_r == pytest.approx(one.t_r, rel=1e-9)
    assert two.slide_work == pytest.approx(one.slide_work, rel=1e-8)
    lossless = in_friction(runs)
    # The model of a torque has no constants of rolling resistance.
    few = find_model("full_viscous").n_constants
    lossless = replace(lossless, constants=lossless.constants[:, :few])
    free = slide(lossless, 0.3, "full_viscous")
    assert free.t_r == pytest.approx(slide(runs, 0.3).t_r, rel=1e-12)


def test_slides_do_not_depend_on_those_beside_them():
    runs = with_mu(sliding_sweep(), 0.1)
    together = integrate(runs, DOP853, find_model("full_sliding"))
    chosen = np.argsort(-together.n_slides)[:5]
    for k in chosen:
        alone = integrate(take(runs, [k]), DOP853, find_model("full_sliding"))
        assert alone.n_slides == together.n_slides[k]
        assert alone.t_end == together.t_end[k]
        assert (alone.y_end == together.y_end[k]).all()
        assert alone.slide_work == together.slide_work[k]


def test_observations_do_not_change_a_run():
    runs = with_mu(kernels.full_batch(GH, [0.3, 0.4], 0.1, t_end=60.0), 0.3)
    plain = integrate(runs, DOP853, find_model("full_sliding"))
    watched = integrate(
        runs,
        DOP853,
        find_model("full_sliding"),
        record=frozenset(["contact", "energy", "windows"]),
    )
    assert np.array_equal(plain.t_r, watched.t_r, equal_nan=True)
    assert np.array_equal(plain.y_end, watched.y_end)
    # The plane exerts no more than mu times the normal force.
    assert watched.extreme("contact_ratio_max") == pytest.approx([0.3, 0.3], abs=1e-9)
    assert (watched.extreme("contact_normal_min") > 0).all()
    assert watched.energy_drift_max.max() < 1e-8
    further = integrate(
        runs, DOP853, find_model("full_sliding"), record=frozenset(["reversals"])
    )
    assert further.t_r == pytest.approx(plain.t_r, rel=1e-12, nan_ok=True)
    assert (further.slide_time > plain.slide_time).any()


@pytest.mark.slow
def test_a_run_can_be_followed_through_its_slides():
    runs = with_mu(kernels.full_batch(GH, 0.3, 0.1, t_end=60.0), 0.3)
    out = integrate(runs, DOP853, find_model("full_sliding"))
    for attitude in (False, True):
        follower = Follower(runs, DOP853, find_model("full_sliding"), attitude=attitude)
        samples = follower.at(np.linspace(0, 60, 601))
        assert follower.zeros[0] == out.t_r[0]
        _, energy, normal, tangential, _ = follower.observe(samples)
        assert energy / follower.energy_0 - 1 == pytest.approx(0, abs=1e-8)
        does_slide = samples.slip[:, 0] > 0
        assert 50 < does_slide.sum() < 500
        ratio = tangential / normal
        assert ratio[does_slide] == pytest.approx(0.3, abs=1e-12)
        assert ratio[~does_slide].max() <= 0.3


@pytest.mark.slow
def test_the_place_of_the_foot_agrees_with_newton():
    runs = with_mu(kernels.full_batch(GH, 0.3, 0.1, t_end=24.0), 0.3)
    follower = Follower(
        runs, DOP853, find_model("full_sliding"), attitude=True, tol=1e-12
    )
    step = 2e-3
    samples = follower.at(np.arange(19.0, 24.0, step))
    _, _, _, tangential, _ = follower.observe(samples)
    # The centre of mass, from the contact point, in axes that do not turn.
    u, _ = full.to_vectors(samples.y.T)
    point = placed_contact(*samples.y.T[:2], Shape(*runs.constants[0, 3:6]))
    root = np.hypot(u[1], u[2])
    along = point[0] / root - u[0] * (u * point).sum(axis=0) / root
    across = (point[1] * u[2] - point[2] * u[1]) / root
    turned = samples.extra[:, 0]
    x = samples.extra[:, 1] - np.cos(turned) * along + np.sin(turned) * across
    y = samples.extra[:, 2] - np.sin(turned) * along - np.cos(turned) * across
    pull = np.hypot(np.diff(x, 2), np.diff(y, 2)) / step**2
    difference = np.abs(pull - tangential[1:-1])
    does_slide = samples.slip[:, 0] > 0
    assert 500 < does_slide.sum() < 2000
    # The force jumps where a slide ends.
    assert np.quantile(difference, 0.99) < 1e-3


def rises_in_flight(u, omega, constants):
    """Return the acceleration of the lowest point of a body that nothing holds."""
    moments = constants[:3]
    step = 1e-4

    def spun(omega):
        return np.cross(moments * omega, omega) / moments

    def height(shift):
        # Where the body's free rotation has brought the vertical, to second order.
        rate = np.cross(u, omega)
        bend = np.cross(rate, omega) + np.cross(u, spun(omega))
        vertical = u + shift * rate + 0.5 * shift**2 * bend
        vertical /= np.linalg.norm(vertical)
        p, q = vertical[:2] / vertical[2]
        shape = Shape(*constants[3:])
        return -placed_contact(np.array([p]), np.array([q]), shape)[:, 0] @ vertical

    bend = (height(step) - 2 * height(0.0) + height(-step)) / step**2
    return -1.0 - bend


def test_a_launch_from_which_the_body_flies_ends_at_once():
    rng = np.random.default_rng(1)
    constants = full.constants(**GH)
    count = 60
    u = np.column_stack([rng.normal(0, 0.3, count), rng.normal(0, 0.6, count)])
    u = np.column_stack([u, -np.ones(count)])
    u /= np.linalg.norm(u, axis=1)[:, None]
    omega = rng.normal(0, 2.5, (count, 3))
    runs = kernels.full_batch(GH, np.full(count, 0.3), t_end=0.05)
    runs = replace(runs, y0=full.from_vectors(u.T, omega.T).T)
    out = slide(runs, 0.3)
    gaps = [rises_in_flight(u[k], omega[k], constants) for k in range(count)]
    flies = np.array(gaps) > 0
    assert 3 < flies.sum() < 30
    assert (out.status[flies] == Status.LIFTS_OFF).all()
    assert (out.t_end[flies] == 0).all()
    assert (out.n_slides[flies] == 0).all()
    assert (out.t_end[~flies] > 0).all()
    # A slide that goes on never needs a plane that pulls.
    lasting = take(runs, ~flies)
    contact = slide(lasting, 0.3, record=frozenset(["contact"]))
    assert contact.extreme("contact_normal_min").min() > -1e-12


def test_a_slide_whose_normal_force_grows_without_bound_is_jammed():
    # A body of the paper's ranges, on a plane with a coefficient of friction of 10.
    body = {
        "alpha": 14.956009613158221,
        "beta": 1.8301550393690584,
        "gamma": 14.78616465252728,
        "theta": 0.764968171364017,
        "phi": 0.04337782836920763,
        "xi": -0.0850127010072178,
    }
    runs = with_mu(
        kernels.full_batch(body, -0.5, 0.001, psi=1.476828925601111, t_end=500.0), 10.0
    )
    out = integrate(runs, DOP853, find_model("full_sliding"))
    assert out.status == Status.JAMMED
    assert out.t_slide < out.t_end < out.t_slide + 1
    follower = Follower(runs, DOP853, find_model("full_sliding"))
    normal = np.zeros(0)
    while not follower.ended:
        _, _, normal, _, _ = follower.observe(follower.steps())
    assert follower.status == Status.JAMMED
    assert normal[-1] > 10 * np.median(normal)


# Random bodies whose slides meet the singularity: in the first the speed falls to zero
# at the same moment, in the second the direction turns into it at rest.
SINGULAR = (
    (
        {
            "alpha": 7.397678073209623,
            "beta": 2.556547899455956,
            "gamma": 5.417263400217821,
            "theta": 0.6578928976007767,
            "phi": 0.30817981873437883,
            "xi": -0.365266917975235,
        },
        {"n_i": -0.7139673443452234, "omega_xy0": 1.0, "psi": 5.390548895343304},
        3.0,
    ),
    (
        {
            "alpha": 8.031238052445286,
            "beta": 1.190831191124435,
            "gamma": 7.0220752311031776,
            "theta": 0.7252908334814034,
            "phi": 0.39224112392972676,
            "xi": -0.29773810910034976,
        },
        {"n_i": 0.8296796925803049, "omega_xy0": 0.01, "psi": 3.48433037412639},
        10.0,
    ),
)


@pytest.mark.parametrize(("body", "launch", "mu"), SINGULAR)
def test_no_tolerance_lets_a_slide_pass_the_singularity(body, launch, mu):
    runs = with_mu(kernels.full_batch(body, t_end=60.0, **launch), mu)
    ends = []
    for tol in (1e-8, 1e-9, 1e-10, 1e-11, 1e-12):
        out = integrate(runs, DOP853, find_model("full_sliding"), tol=tol)
        assert out.status == Status.JAMMED, tol
        ends.append(out.t_end[0])
    assert ends == pytest.approx([ends[-1]] * 5, rel=1e-8)


def test_rounding_errors_of_a_long_slide_reject_no_step():
    # The direction turns by 320 radians in a slide of 120 units of time.
    body = {
        "alpha": 12.687952,
        "beta": 2.49131,
        "gamma": 13.179262,
        "theta": 0.766741,
        "phi": 0.011093,
        "xi": -0.051705,
    }
    runs = with_mu(kernels.full_batch(body, 0.3, 0.01, t_end=160.0), 0.1)
    times = []
    for tol in (1e-10, 1e-12, 1e-13, 1e-14):
        out = integrate(runs, DOP853, find_model("full_sliding"), tol=tol)
        assert out.status == Status.OK, tol
        times.append(out.t_r[0])
    assert times == pytest.approx([times[-1]] * 4, rel=1e-10)


def test_a_direction_may_turn_until_rest():
    # At the end of its seventh slide, it turns by a quarter while the speed falls from
    # 1e-6 to 1e-9; with a straight last step the drift was 1.2e-10 at any tolerance.
    body = {
        "alpha": 6.880238967115642,
        "beta": 1.8678517455613166,
        "gamma": 6.748090712676959,
        "theta": 0.9113106469345634,
        "phi": 0.09559243027396686,
        "xi": -0.08692778280630373,
    }
    runs = with_mu(kernels.full_batch(body, 0.5, 0.1, t_end=34.0), 0.3)
    for tol in (1e-12, 1e-14):
        out = integrate(runs, DOP853, find_model("full_sliding"), tol=tol)
        assert out.n_slides == 8, tol
        assert abs(out.energy_drift) < 1e-12, tol


def test_a_slide_begins_where_the_mobility_is_positive():
    # Newton's method finds a direction in which the force would pull; the reversal is
    # that of an independent program.
    body = {
        "alpha": 1.2595,
        "beta": 1.2551,
        "gamma": 0.010357,
        "theta": 0.818,
        "phi": 0.1257,
        "xi": -0.12,
    }
    u = np.array([0.4624, 0.2987, -0.8348])
    u /= np.linalg.norm(u)
    runs = kernels.full_batch(body, 0.01, t_end=2.0)
    state = full.from_vectors(u, np.array([-0.0015, 0.0082, -0.0076]))
    sign = np.copysign(0.01, u @ [-0.0015, 0.0082, -0.0076])
    runs = replace(runs, y0=state[None], scale=np.abs([sign]))
    out = slide(runs, 1.364)
    assert out.status == Status.OK
    assert out.t_r[0] == pytest.approx(0.52468, abs=1e-5)


def test_the_least_normal_force_is_that_between_steps_of_slides():
    runs = with_mu(sliding_sweep(), 0.2)
    out = integrate(
        runs, DOP853, find_model("full_sliding"), record=frozenset(["contact"])
    )
    chosen = np.flatnonzero((out.n_slides > 0) & (out.status == Status.OK))[:12]
    for k in chosen:
        follower = Follower(take(runs, [k]), DOP853, find_model("full_sliding"))
        samples = follower.at(np.linspace(0, out.t_end[k], 20_000))
        _, _, normal, _, _ = follower.observe(samples)
        assert out.extreme("contact_normal_min")[k] == pytest.approx(
            normal.min(), abs=2e-5
        )


@pytest.mark.parametrize(
    "slides_too", [False, pytest.param(True, marks=pytest.mark.slow)]
)
def test_a_paraboloid_beside_an_ellipsoid_keeps_its_bits(slides_too):
    runs = kernels.full_batch(GH, [0.3, 0.4, 0.3], 0.1, t_end=60.0)
    mixed = np.column_stack([runs.constants, [0.0, 0.5, 0.0]])
    beside = replace(runs, constants=mixed)
    flat, model = FULL, FULL_ELLIPSOID
    if slides_too:
        flat, model = find_model("full_sliding"), find_model("ellipsoid_sliding")
        runs = with_mu(runs, 0.3)
        beside = with_mu(beside, 0.3)
    alone = integrate(take(runs, [0, 2]), DOP853, flat)
    out = integrate(beside, DOP853, model)
    assert np.array_equal(out.y_end[[0, 2]], alone.y_end)
    assert np.array_equal(out.t_r[[0, 2]], alone.t_r)
    assert np.array_equal(out.n_steps[[0, 2]], alone.n_steps)
    of_ellipsoid = integrate(take(beside, [1]), DOP853, model)
    assert np.array_equal(out.y_end[[1]], of_ellipsoid.y_end)
    # So does the trajectory of such a run.
    follower = Follower(take(beside, [0]), DOP853, model)
    while not follower.ended:
        follower.steps()
    assert follower.zeros[:1] == alone.t_r[:1].tolist()
