"""Runs with pivoting friction against those of an independent program."""

import json
import math
from pathlib import Path

import pytest

import rattlesweep as rs

TESTS = Path(__file__).parents[1]
CASES = json.loads((TESTS / "physics" / "pivot_cases.json").read_text())
NUMBERS = ("t_held", "held_time", "pivot_work", "energy_left")


def model_of(case):
    """Return the surface and the law of a case, which have a kernel together."""
    surface = "paraboloid" if case["body"]["c"] is None else "ellipsoid"
    if case["dissipation"]["mu"]:
        return surface, "sliding"
    return surface, "rolling" if case["dissipation"]["rolling"] else "pivoting"


def simulate(case, **integrator):
    body = {k: v for k, v in case["body"].items() if v is not None}
    losses = {k: v for k, v in case["dissipation"].items() if v}
    launch = dict(case["launch"])
    psi = math.degrees(launch.pop("psi"))
    return rs.simulate(
        rs.Rattleback(**body),
        **launch,
        psi=psi,
        t_end=case["t_end"],
        **losses,
        **integrator,
    )


@pytest.mark.parametrize(
    "model",
    [
        ("paraboloid", "pivoting"),
        pytest.param(("paraboloid", "rolling"), marks=pytest.mark.slow),
        pytest.param(("paraboloid", "sliding"), marks=pytest.mark.slow),
        pytest.param(("ellipsoid", "pivoting"), marks=pytest.mark.slow),
        pytest.param(("ellipsoid", "rolling"), marks=pytest.mark.slow),
    ],
)
def test_runs_are_those_of_the_oracle(model):
    """The worst differences at the default tolerance are 4e-9; 2e-8 with slides."""
    cases = [x for x in CASES if model_of(x) == model]
    assert cases
    for case in cases:
        result = case["result"]
        # A run ends at its reversal.
        wanted = result["at_reversal"] or result["at_end"]
        run = simulate(case)
        assert run.status == "ok"
        expected = {"t_r": result["t_r"]} | {name: wanted[name] for name in NUMBERS}
        for name, value in expected.items():
            if value is None:
                assert run[name] is None, name
            else:
                assert run[name] == pytest.approx(value, rel=1e-7, abs=1e-7), name


@pytest.mark.parametrize("tol", [1e-8, 1e-10, 1e-12])
def test_short_rests_at_any_tolerance(tol):
    """A body that rocks is held and released again and again."""
    for number in (9, 11):
        case = CASES[number]
        assert case["result"]["n_holds"] > 1
        run = simulate(case, tol=tol)
        assert run.status == "ok"
        wanted = case["result"]["at_end"]["held_time"]
        assert run.held_time == pytest.approx(wanted, abs=1e-7)
