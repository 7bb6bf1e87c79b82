"""Runs that slide against those of an independent program, `friction_oracle`."""

import json
import math
from dataclasses import replace
from pathlib import Path

import kernels
import numpy as np
import pytest

import rattlesweep as rs
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.motion.model import find_model
from rattlesweep.physics import full

TESTS = Path(__file__).parents[1]
EXACT = json.loads((TESTS / "physics" / "exact_slide.json").read_text())
CASES = json.loads((TESTS / "physics" / "slide_cases.json").read_text())


def assert_is_that_of_the_oracle(case, **losses):
    """Run a case, and compare it; the worst differences are those of docs/design.md."""
    result = case["result"]
    body = {name: value for name, value in case["body"].items() if value is not None}
    if case["sigma"]:
        losses["sigma"] = case["sigma"]
    out = rs.simulate(
        rs.Rattleback(**body),
        n_i=case["n_i"],
        omega_xy0=case["omega_xy0"],
        psi=math.degrees(case["psi"]),
        t_end=case["t_end"],
        mu=[case["mu"]],
        tol=1e-9,
        **losses,
    )
    run = out.iloc[0]
    assert run.status == "ok"
    assert run.n_slides == result["n_slides"]
    t_r = np.nan if result["t_r"] is None else result["t_r"]
    assert run.t_r == pytest.approx(t_r, rel=3e-10, nan_ok=True)
    assert run.t_end == pytest.approx(result["t_end"], rel=3e-10)
    t_slide = np.nan if result["t_slide"] is None else result["t_slide"]
    assert run.t_slide == pytest.approx(t_slide, abs=1e-7, nan_ok=True)
    assert run.slide_time == pytest.approx(result["slide_time"], abs=1e-7)
    assert run.slide_work == pytest.approx(result["slide_work"], abs=2e-9)
    return out


def cases_of(*, ellipsoids, sigma):
    """Return the numbers of the cases that end as they should."""
    return [
        k
        for k, case in enumerate(CASES)
        if (case["body"]["c"] is not None) == ellipsoids
        and bool(case["sigma"]) == sigma
        and case["result"]["status"] == "ok"
    ]


PARABOLOIDS = cases_of(ellipsoids=False, sigma=False)
ELLIPSOIDS = cases_of(ellipsoids=True, sigma=False)
ROLL_OVER = [11, 22]  # onto their side, in a kernel of their own


def test_runs_are_those_of_the_oracle():
    assert len(PARABOLOIDS) >= 8
    for k in PARABOLOIDS:
        assert_is_that_of_the_oracle(CASES[k])


UPRIGHT = [k for k in ELLIPSOIDS if k not in ROLL_OVER]


def test_ellipsoids_are_those_of_the_oracle():
    assert len(UPRIGHT) >= 10
    for k in UPRIGHT:
        assert_is_that_of_the_oracle(CASES[k])


@pytest.mark.slow
def test_ellipsoids_in_the_kernel_of_all_laws():
    """A lever far below rounding errors changes nothing."""
    for k in UPRIGHT:
        out = assert_is_that_of_the_oracle(CASES[k], pivot=[1e-30, 1e-3])
        # Its torque is felt where there is a lever.
        assert out.iloc[1].pivot_work > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("lever", [1e-30, 1e-12])
def test_a_spin_that_changes_while_the_foot_begins_to_slide(lever):
    """The speed first grows as the spin does, so the first step needs both."""
    assert_is_that_of_the_oracle(CASES[57], pivot=[lever, 1e-3])


@pytest.mark.slow
@pytest.mark.parametrize("k", cases_of(ellipsoids=False, sigma=True))
def test_paraboloids_with_another_loss(k):
    assert_is_that_of_the_oracle(CASES[k])


@pytest.mark.slow
@pytest.mark.parametrize("k", [*ROLL_OVER, *cases_of(ellipsoids=True, sigma=True)])
def test_ellipsoids_in_other_kernels(k):
    """A lever of zero beside another changes nothing."""
    out = assert_is_that_of_the_oracle(CASES[k], pivot=[0.0, 1e-3])
    assert out.iloc[1].pivot_work > 1e-3


@pytest.mark.parametrize(("tol", "error"), [(1e-9, 2e-9), (1e-11, 2e-11)])
def test_a_slide_in_many_digits(tol, error):
    """Begin and end of one slide, and its work, are those in 50 digits."""
    start = np.array(EXACT["start"])
    runs = kernels.full_batch(EXACT["body"], 0.3, 0.1, t_end=2.0)
    state = full.from_vectors(start[:3], start[3:])
    constants = np.append(runs.constants[0], EXACT["mu"])
    runs = replace(runs, y0=state[None], constants=constants[None])
    out = integrate(runs, METHODS["dop853"], find_model("full_sliding"), tol=tol)
    slide = {name: float(value) for name, value in EXACT["slide"].items()}
    assert out.n_slides == 1
    assert out.t_slide == pytest.approx([slide["begin"]], abs=error)
    duration = slide["end"] - slide["begin"]
    assert out.slide_time == pytest.approx([duration], abs=error)
    energy = full.energy(tuple(state), tuple(runs.constants[0, :6]))
    assert out.slide_work * energy == pytest.approx([-slide["work"]], abs=error)
