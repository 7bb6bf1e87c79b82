"""Runs that slide against those of an independent program, `slide_oracle`."""

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
from rattlesweep.kernel.state.status import Status
from rattlesweep.motion.model import find_model
from rattlesweep.physics import full
from rattlesweep.physics.body import PARAMETERS

TESTS = Path(__file__).parents[1]
EXACT = json.loads((TESTS / "physics" / "exact_slide.json").read_text())
CASES = json.loads((TESTS / "physics" / "slide_cases.json").read_text())


def model_of(case):
    """Return the name of the model in which a case is integrated."""
    surface = "full" if case["body"]["c"] is None else "ellipsoid"
    return f"{surface}_viscous" if case["sigma"] else surface


def batch_of(cases, model):
    """Return the launches of cases."""
    body = {
        name: np.array([case["body"][name] for case in cases]) for name in PARAMETERS
    }
    n_i, push, psi, t_end, mu, sigma = (
        np.array([case[name] for case in cases])
        for name in ("n_i", "omega_xy0", "psi", "t_end", "mu", "sigma")
    )
    runs = kernels.full_batch(body, n_i, push, psi, t_end)
    k = np.array([1 / (case["body"]["c"] or np.inf) for case in cases])
    none = np.zeros(len(cases))
    constants = [runs.constants]
    if model != "full":
        constants.append(k[:, None])
    if model.endswith("viscous"):
        constants.append(np.column_stack([sigma, none, none + 1e-4]))
        runs = replace(runs, y0=np.column_stack([runs.y0, none]))
    return replace(runs, constants=np.hstack([*constants, mu[:, None]]))


@pytest.mark.parametrize(
    "model",
    [
        "full",
        pytest.param("ellipsoid", marks=pytest.mark.slow),
        pytest.param("full_viscous", marks=pytest.mark.slow),
    ],
)
def test_runs_are_those_of_the_oracle(model):
    """The worst differences are those of docs/design.md."""
    cases = [
        case
        for case in CASES
        if model_of(case) == model and case["result"]["status"] == "ok"
    ]
    assert len(cases) >= 8
    out = integrate(
        batch_of(cases, model),
        METHODS["dop853"],
        find_model(f"{model}_sliding"),
        tol=1e-9,
    )
    for k, case in enumerate(cases):
        result = case["result"]
        assert out.status[k] == Status.OK
        assert out.n_slides[k] == result["n_slides"]
        t_r = np.nan if result["t_r"] is None else result["t_r"]
        assert out.t_r[k] == pytest.approx(t_r, rel=3e-10, nan_ok=True)
        assert out.t_end[k] == pytest.approx(result["t_end"], rel=3e-10)
        if result["n_slides"]:
            assert out.t_slide[k] == pytest.approx(result["t_slide"], abs=1e-7)
        else:
            assert np.isnan(out.t_slide[k])
        assert out.slide_time[k] == pytest.approx(result["slide_time"], abs=1e-7)
        assert out.slide_work[k] == pytest.approx(result["slide_work"], abs=2e-9)


ELLIPSOIDS = [
    case
    for case in CASES
    if case["body"]["c"] is not None and case["result"]["status"] == "ok"
]


def test_ellipsoids_in_the_kernel_of_all_laws():
    """A lever of zero beside another is followed like others, and changes nothing.

    So one kernel, which test_invariance has too, serves for all cases.
    """
    assert len(ELLIPSOIDS) >= 12
    for case in ELLIPSOIDS:
        result = case["result"]
        out = rs.simulate(
            rs.Rattleback(**case["body"]),
            n_i=case["n_i"],
            omega_xy0=case["omega_xy0"],
            psi=math.degrees(case["psi"]),
            t_end=case["t_end"],
            mu=case["mu"],
            sigma=case["sigma"],
            pivot=[0.0, 1e-3],
            tol=1e-9,
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
        # Its torque is felt where there is a lever.
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
