"""The program for friction, as it slides, against exact motions and other programs."""

import json
import math
from pathlib import Path

import contact_mechanics
import exact_slide
import friction_oracle
import numpy as np
import oracle
import pytest
import regularised_oracle
import stone_oracle
from contact_mechanics import Body, Stone
from friction_oracle import Oracle
from mpmath import mp, mpf

import rattlesweep as rs
from rattlesweep.physics import full

EXACT = json.loads((Path(__file__).parent / "exact_slide.json").read_text())
GH = rs.Rattleback.gh()
# A homogeneous ball of radius 1 whose lowest point is 1 below its centre.
BALL = Stone(inertia=(0.4, 0.4, 0.4), radii=(1.0, 0.0, 1.0), c=1.0, mu=0.3)
# Where an ellipsoid is after 595.4 units of time, by the oracle itself.
GRAZING = (
    (-0.846143604544448, 0.1438769668137502, -0.5131670477239195),
    (0.043288533699205795, -0.34766341549250585, 0.0742080650693702),
)
DOWN = np.array([0.0, 0.0, -1.0])


def launched(body, n_i, push, **options):
    """Return the oracle's run of a launch."""
    y = oracle.launch(body, n_i, push, oracle.relevant_psi(body, n_i))
    return friction_oracle.run(body, y[:3], y[3:], **options)


@pytest.mark.parametrize("omega", [(0.0, 0.0, 0.0), (0.3, -0.7, 2.0)])
def test_ball_slides_and_then_rolls(omega):
    """The slip falls by 7/2 mu g a unit of time and keeps its direction in space."""
    slip = np.array([0.6, -0.8, 0.0])
    follower = Oracle(BALL, 10.0)
    run = follower.run(DOWN, omega, slip)
    (slide,) = run.slides
    assert slide.begin == 0
    assert slide.end == pytest.approx(1 / (3.5 * BALL.mu), abs=1e-10)
    # The centre starts with slip - omega x r, with r = -up, and friction takes 2/7 of
    # the slip from it.
    centre = slip - np.cross(omega, [0.0, 0.0, 1.0])
    rolling = centre - 2 / 7 * slip
    speed = np.linalg.norm(np.cross(run.at_end.y[:3], run.at_end.y[3:6]))
    assert speed == pytest.approx(np.linalg.norm(rolling), abs=1e-10)
    assert run.at_end.y[:3] @ run.at_end.y[3:6] == pytest.approx(
        DOWN @ omega, abs=1e-10
    )
    # Friction took the slip's share of the energy.
    assert -run.at_end.works[0] == pytest.approx(0.5 * 2 / 7, abs=1e-10)
    assert slide.work == pytest.approx(1 / 7, abs=1e-10)


def test_ball_that_is_pushed():
    """A ball without spin keeps 5/7 of its speed, after 2 v / (7 mu g)."""
    run = Oracle(BALL, 10.0).run(DOWN, (0, 0, 0), np.array([1.0, 0, 0]))
    speed = np.linalg.norm(np.cross(run.at_end.y[:3], run.at_end.y[3:6]))
    assert speed == pytest.approx(5 / 7, abs=1e-10)
    assert run.slides[0].end == pytest.approx(2 / (7 * BALL.mu), abs=1e-10)
    assert run.at_end.energy == pytest.approx(0.7 * (5 / 7) ** 2, abs=1e-10)


@pytest.mark.parametrize("c", [None, 1.7])
def test_rates_are_those_of_the_packages_oracle(c):
    rng = np.random.default_rng(5)
    body = oracle.GH | {"c": c}
    stone = contact_mechanics.stone_of(Body(**body), 0.3, 0.02)
    for _ in range(20):
        u = np.append(rng.uniform(-0.4, 0.4, 2), -1)
        u /= np.linalg.norm(u)
        omega = rng.uniform(-1, 1, 3)
        y = np.array([*u, *omega, 0.0, 0.0, 0.0])
        wanted, force, power = stone_oracle.forces(y[:7], body, 0.02)
        rates = exact_slide.rolling(stone, y)
        np.testing.assert_allclose(rates[3:6], wanted, atol=1e-12)
        assert rates[7] == pytest.approx(power, abs=1e-14)
        forces = contact_mechanics.rolling_forces(stone, u, omega, 0)
        normal, along = contact_mechanics.parts(u, forces.force)
        assert normal == pytest.approx(force @ u, abs=1e-12)
        np.testing.assert_allclose(along, force - (force @ u) * u, atol=1e-12)
        assert contact_mechanics.energy(stone, y) == pytest.approx(
            stone_oracle.energy(y[:7], body), abs=1e-13
        )


def test_parameters_are_those_of_the_package():
    stone = contact_mechanics.stone_of(GH, 0.3)
    wanted = full.constants(*(getattr(GH, name) for name in oracle.PARAMETERS))
    bxx, bxy, byy = stone.radii
    np.testing.assert_allclose([*stone.inertia, bxx - 1, bxy, byy - 1], wanted, 1e-14)


@pytest.mark.slow
def test_known_run():
    """An earlier program, which is lost, found 41.348655134 for a push along x."""
    y = oracle.launch(GH, 0.3, 0.1, 0.0)
    run = friction_oracle.run(GH, y[:3], y[3:], 60, mu=0.3, rtol=1e-11, through=False)
    assert run.t_r == pytest.approx(41.348655134, abs=2e-9)
    assert abs(run.at_end.energy_error) < 1e-10


@pytest.mark.slow
def test_energy_with_a_couple_and_beyond_the_reversal():
    run = launched(GH, 0.3, 0.1, t_end=60, mu=0.3, sigma=2e-2, rtol=1e-9)
    assert run.t_r < 50
    assert run.at_end.t == 60
    assert len(run.slides) > 5
    assert run.at_end.works[1] < -0.01
    assert abs(run.at_end.energy_error) < 1e-9
    assert run.at_end.slide_work == pytest.approx(
        sum(slide.work for slide in run.slides) / run.energy_at_launch, rel=1e-12
    )


@pytest.mark.slow
def test_mirrored_body():
    """The mirror image in the plane of x and z moves as the image."""
    options = {"t_end": 30, "mu": 0.3, "rtol": 1e-10}
    y = oracle.launch(GH, 0.3, 0.1, oracle.relevant_psi(GH, 0.3))
    mirror = np.array([1, -1, 1, -1, 1, -1])
    run = friction_oracle.run(GH, y[:3], y[3:], **options)
    image = friction_oracle.run(
        GH.mirrored(), (mirror * y)[:3], (mirror * y)[3:], **options
    )
    assert len(run.slides) == len(image.slides) == 3
    assert image.slides[1].end == pytest.approx(run.slides[1].end, abs=1e-9)
    np.testing.assert_allclose(image.at_end.y, mirror * run.at_end.y, atol=1e-8)


@pytest.mark.slow
def test_much_friction_is_rolling():
    run = launched(GH, 0.3, 0.1, t_end=60, mu=1e6, rtol=1e-12, through=False)
    psi = oracle.relevant_psi(GH, 0.3)
    t_r, y = oracle.first_reversal(GH, 0.3, 0.1, psi, 60)
    assert not run.slides
    assert run.t_r == pytest.approx(t_r, abs=1e-9)
    np.testing.assert_allclose(run.at_end.y, y, atol=1e-9)


@pytest.mark.slow
def test_beginning_of_slides():
    """Half the first moment gives the same slide."""
    options = {"t_end": 22, "mu": 0.3, "rtol": 1e-11}
    first = launched(GH, 0.3, 0.1, **options)
    time = friction_oracle.FIRST_TIME / 2
    half = launched(GH, 0.3, 0.1, first_time=time, **options)
    (slide,) = first.slides
    assert half.slides[0].begin == slide.begin
    assert half.slides[0].end == pytest.approx(slide.end, abs=1e-10)
    assert half.slides[0].work == pytest.approx(slide.work, rel=1e-9)


def test_grazing_slide():
    """A foot whose force barely leaves the cone creeps, holds again and rolls on."""
    body = Body(9.1, 1.9, 9.0, 0.8, 0.05, -math.radians(4), c=2.0)
    run = friction_oracle.run(body, *GRAZING, 3.0, mu=0.3, rtol=1e-9)
    _, creep = run.slides
    assert 0.02 < creep.end - creep.begin < 0.06
    assert 0 < creep.fastest < 1e-6
    assert 0 < creep.work < 1e-8
    assert max(slide.steps for slide in run.slides) < 800


def test_slide_in_many_digits():
    """Begin, end and the state at the end are those in 50 digits."""
    stone = contact_mechanics.stone_of(Body(**EXACT["body"]), EXACT["mu"])
    u = EXACT["start"][:3]
    omega = EXACT["start"][3:]
    slide = EXACT["slide"]
    end = float(slide["end"])
    run = Oracle(stone, end + 1e-9, rtol=1e-12).run(u, omega)
    assert run.slides[0].begin == pytest.approx(float(slide["begin"]), abs=1e-12)
    assert run.slides[0].end == pytest.approx(end, abs=1e-11)
    wanted = [float(slide[name]) for name in exact_slide.NAMES[2:]]
    # The rest of 1e-9 changes the state by as much.
    found = [*run.at_end.y, run.at_end.works[0]]
    np.testing.assert_allclose(found, wanted, atol=2e-9)
    assert EXACT["error"] < 1e-17


@pytest.mark.slow
def test_slide_in_many_digits_again():
    """Fewer stages give the stored numbers to 1e-15."""
    with mp.workdps(exact_slide.DIGITS):
        numbers = exact_slide.followed(9)
        for name, number in zip(exact_slide.NAMES, numbers, strict=True):
            assert abs(number - mpf(EXACT["slide"][name])) < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize(("body", "n_i"), [(GH, 0.3), (GH.replace(c=1.7), 0.3)])
def test_regularised_law_converges_to_it(body, n_i):
    """Its error in the reversal time is of the order 1 in eps."""
    wanted = launched(body, n_i, 0.1, t_end=100, mu=0.3, rtol=1e-10, through=False).t_r
    y = oracle.launch(body, n_i, 0.1, oracle.relevant_psi(body, n_i))
    errors = []
    for eps in (1e-3, 1e-4, 1e-5):
        t_r = regularised_oracle.reversal(body, y[:3], y[3:], 100, 0.3, eps)
        errors.append(abs(t_r - wanted))
    orders = np.log10(np.array(errors[:-1]) / errors[1:])
    assert errors[-1] < 1e-3
    assert np.all((orders > 0.7) & (orders < 1.4)), (errors, orders)
