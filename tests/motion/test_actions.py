"""Actions: what they are composed to, by name, and a sum of further ones."""

from dataclasses import replace
from math import cos, sqrt

import kernels
import numpy as np
import pytest
from exact import exactly, followed

from rattlesweep.kernel.batch import by_own_model, with_model
from rattlesweep.motion.action import (
    ACTIONS,
    PIVOTING,
    ROLLING,
    VISCOUS,
    Action,
    numbered,
)
from rattlesweep.motion.chart import ANYWHERE, SLOPES
from rattlesweep.motion.model import ELLIPSOID, FULL, compose, find_model
from rattlesweep.physics.body import PARAMETERS
from rattlesweep.physics.full import scalar
from rattlesweep.words.quantities import ACTING, LOSSES, law_of


def test_each_constant_of_dissipation_belongs_to_an_action():
    for name, loss in LOSSES.items():
        if name != "mu":  # of sliding, which is another motion
            assert name in ACTIONS[loss.action].constants
    for action in ACTIONS.values():
        for name in action.constants:
            assert name in ACTING or name in action.fixed


@pytest.mark.parametrize("name", kernels.MODEL_NAMES)
def test_a_model_is_composed_again_from_its_name(name):
    model = find_model(name)
    assert model.name == name
    assert find_model(name) is model
    if model.chart is not None:
        slides = model.slide is not None
        same = compose(
            model.chart,
            model.surface,
            reversed(model.actions),
            slides=slides,
            tangents=model.n_tangents,
        )
        assert same is model


def test_the_viscous_torque_accompanies_the_others_and_pivoting_is_the_last():
    assert numbered([PIVOTING, ROLLING]) == (VISCOUS, ROLLING, PIVOTING)
    assert numbered([]) == ()
    anywhere = find_model("ellipsoid_pivoting").anywhere
    assert anywhere is compose(ANYWHERE, ELLIPSOID, [PIVOTING])
    assert anywhere.constants[7:] == (
        "sigma",
        "rolling",
        "smoothing",
        "pivot",
        "sense",
    )
    assert law_of(["sigma"]) == "viscous"
    assert law_of(["mu", "pivot", "rolling"]) == "rolling_pivoting"
    assert law_of(["mu"]) == ""


def test_runs_have_the_models_of_the_constants_that_are_not_zero():
    model = find_model("ellipsoid_rolling_pivoting")
    rolling = np.array([0.0, 1e-3, 0.0, 1e-3])
    pivot = np.array([0.0, 0.0, 2e-3, 2e-3])
    k = np.array([0.5, 0.0, 0.5, 0.0])
    body = dict(zip(PARAMETERS, (13.0, 1.5, 12.3, 0.6, 0.04, -0.03), strict=True))
    batch = kernels.full_batch(body, [0.1, 0.2, 0.3, 0.4])
    values = {"k": k, "sigma": 0.0, "rolling": rolling, "pivot": pivot} | model.fixed
    names = model.constants[6:]
    further = [np.broadcast_to(values[name], 4) for name in names]
    constants = np.column_stack([batch.constants, *further])
    y0 = np.hstack([batch.y0, np.zeros((4, 2))])
    runs = replace(batch, y0=y0, constants=constants)
    found = {}
    for rows, own in by_own_model(runs, model):
        part = with_model(kernels.take(runs, rows), model, own)
        assert part.y0.shape == (1, own.n_state)
        assert part.constants.shape == (1, own.n_constants)
        found[int(rows[0])] = own.name
    assert found == {
        0: "ellipsoid_viscous",
        1: "full_rolling",
        2: "ellipsoid_pivoting",
        3: "full_rolling_pivoting",
    }


@scalar
def _drag(place, own):
    (share,) = own
    x, y, z = place.velocity
    return -share * x, -share * y, -share * z


@scalar
def _more_weight(place, own):
    size, _, phase = own
    return size * cos(phase)


@scalar
def _phase_rate(place, own):
    _, rate, _ = own
    return (rate,)


@pytest.mark.parametrize("chart", [SLOPES, ANYWHERE], ids=lambda chart: chart.name)
def test_energy_minus_the_work_of_a_drag_and_of_a_plane_that_shakes(chart):
    """With all others beside them, in either chart."""
    drag = Action("drag", ("drag",), force=_drag)
    shaken = Action(
        "shaken",
        ("size", "rate"),
        weight=_more_weight,
        components=("phase",),
        rates=_phase_rate,
        own_work="work of the plane",
    )
    model = compose(chart, ELLIPSOID, [drag, shaken, PIVOTING, ROLLING])
    works = "work", "pivot work", "work of the plane"
    assert model.components == (*chart.place, *works, "phase")
    shape = {"ix": 12.0, "iy": 0.5, "iz": 12.3, "cxx": 20.0, "cxy": 0.3, "cyy": 0.5}
    values = shape | {"k": 0.5, "sigma": 1e-3, "rolling": 1e-3, "drag": 0.01}
    values |= {"size": 0.05, "rate": 2.0, "pivot": 2e-3} | model.fixed
    q = tuple(values[name] for name in model.constants)
    rhs = exactly(model.rhs, sqrt)
    energy = exactly(model.energy, sqrt)
    place = (0.05, 0.02) if chart is SLOPES else (-0.05, -0.02, -1.0)
    y = np.array([*place, 0.03, 0.04, -0.3, 0.0, 0.0, 0.0, 0.3])
    before = energy(tuple(y), q)
    y = followed(rhs, y, q, 0.005, 800)
    assert energy(tuple(y), q) == pytest.approx(before, rel=1e-8)
    total, pivoted, plane, phase = y[len(chart.place) :]
    assert total < pivoted < 0
    assert abs(plane) > 1e-4
    assert phase == pytest.approx(0.3 + 2.0 * 4.0)


def test_a_drag_takes_what_it_does_to_a_body_without_spin():
    """Near rest the velocity of the centre is that of the pendulum."""
    drag = Action("drag", ("drag",), force=_drag)
    model = compose(SLOPES, ELLIPSOID, [drag])
    shape = 12.0, 0.5, 12.3, 20.0, 0.0, 0.5, 0.5
    rhs = exactly(model.rhs, sqrt)
    a = 1e-6
    state = 0.0, 0.0, a, 0.0, 0.0, 0.0
    *_, power = rhs(state, (*shape, 0.0, 0.01))
    assert power == pytest.approx(-0.01 * a * a)
    _, _, rate, *_ = rhs(state, (*shape, 0.0, 0.01))
    assert rate == pytest.approx(-0.01 * a / 13.0)
    assert FULL.actions == ()
