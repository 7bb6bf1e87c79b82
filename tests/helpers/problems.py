"""Runs with known reversal times, by what makes their errors hard to estimate.

The times are those of independent programs (``tests/physics/*.json``), or those on
which `verner98` at 1e-14 and `dop853` at 1e-13 agree, or have 32 digits
(``benchmarks/double_double.py``).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rattlesweep as rs

PIVOT_CASES = Path(__file__).parents[1] / "physics" / "pivot_cases.json"


@dataclass(frozen=True)
class Problem:
    """A run, its reversal time, and what is hard about it."""

    name: str
    tags: frozenset[str]
    body: Mapping[str, float]
    launch: Mapping[str, Any]  # also its losses and its horizon
    t_r: float
    doubt: float  # of this time
    tols: tuple[float, ...] = field(default=(1e-6, 1e-9, 1e-11))

    def run(self, tol: float) -> rs.Run:
        """Return the run with its estimated error."""
        body = rs.Rattleback(**self.body)
        return rs.simulate(body, **self.launch, tol=tol, record=["error"])


def _of_program(number: int, *tags: str) -> Problem:
    """Return a case of the independent program for pivoting friction."""
    case = json.loads(PIVOT_CASES.read_text())[number]
    body = {name: value for name, value in case["body"].items() if value is not None}
    losses = {name: value for name, value in case["dissipation"].items() if value}
    launch = dict(case["launch"])
    launch["psi"] = math.degrees(launch["psi"])
    # The run ends at its reversal.
    launch |= losses | {"t_end": case["t_end"]}
    t_r = case["result"]["t_r"]
    return Problem(
        f"program-{number}", frozenset(tags), body, launch, t_r, case["error"]
    )


def _body(*values: float) -> dict[str, float]:
    names = ("alpha", "beta", "gamma", "theta", "phi", "xi")
    return dict(zip(names, values, strict=True))


PROBLEMS = (
    _of_program(0, "pivot", "unsteady"),
    _of_program(3, "pivot", "steady"),
    _of_program(13, "pivot", "tap"),
    _of_program(16, "pivot", "sigma"),
    _of_program(19, "pivot", "steady", "held"),
    Problem(
        "pulled-34",
        frozenset({"pivot", "sigma", "pulled"}),
        _body(
            10.717710837262207,
            3.8436681977702865,
            9.154054813716337,
            0.6316780216575905,
            0.01428925663498728,
            -0.09254164001801612,
        ),
        {
            "omega": (-0.4440514887227547, 0.14030754958498162, -0.33898639338291187),
            "u": (-0.27269978711818044, -0.05728367500707132, -0.9603923191505559),
            "sigma": 0.0014056068670749418,
            "pivot": 0.0024385479496210455,
            "t_end": 100.0,
        },
        34.198217848,
        doubt=2e-8,
    ),
    Problem(
        "pulled-11",
        frozenset({"pivot", "pulled"}),
        _body(
            8.713970373681944,
            2.588278762615312,
            6.551223788365462,
            0.938095995331268,
            0.010870500406080912,
            0.11965682362306988,
        ),
        {
            "omega": (0.19770966273235233, 0.08563888254163095, 0.29090767995980255),
            "u": (0.01968165799842062, -0.07424492212255088, -0.9970457982848379),
            "pivot": 0.0011108758542506436,
            "t_end": 100.0,
        },
        11.0276703265,
        doubt=1e-9,
    ),
    Problem(
        "pulled-48",
        frozenset({"pivot", "pulled"}),
        _body(
            4.451604671478585,
            1.5767870406143971,
            3.138244094800432,
            0.39801283272406707,
            0.011485135581335855,
            -0.2833915481050672,
        ),
        {
            "omega": (-0.3606341314013657, -0.2170963604871503, -0.01800283266078572),
            "u": (0.14397653774855734, -0.13976242289782528, -0.9796617894578045),
            "pivot": 0.0002127160167945655,
            "t_end": 100.0,
        },
        48.376929849,
        doubt=5e-8,
    ),
    Problem(
        "slides-4",
        frozenset({"mu", "slides", "tilted"}),
        _body(
            6.183955782923302,
            2.9906363552837956,
            6.428115655530523,
            0.4052056626995988,
            0.006661519150778335,
            0.4956710887691189,
        ),
        {
            "omega": (0.1868823449574357, 0.21014695793669744, 0.08712023788338258),
            "u": (-0.07225642599910723, -0.08647132854535122, -0.9936305743290297),
            "mu": 0.40868631461827165,
            "t_end": 100.0,
        },
        4.385597900435566,
        doubt=5e-10,
        tols=(1e-9, 1e-12),
    ),
    Problem(
        "slides-11",
        frozenset({"mu", "pivot", "slides", "tilted"}),
        _body(
            5.66026120229275,
            3.1855425001725637,
            2.705309686467566,
            0.6922412240188607,
            0.013907592956296273,
            0.4256179015626815,
        ),
        {
            "omega": (0.03468272774822857, -0.20714483780532614, 0.2388321409087342),
            "u": (0.08727310423598829, 0.15264753397536132, -0.9844196948701581),
            "mu": 0.904912420215279,
            "pivot": 0.0005963783186323213,
            "t_end": 100.0,
        },
        11.636578866838576,
        doubt=5e-10,
        tols=(1e-9, 1e-12),
    ),
    Problem(
        "slides-304",
        frozenset({"mu", "pivot", "sigma", "slides", "tilted"}),
        _body(
            9.166017611317198,
            3.941598969135735,
            10.681499213315536,
            0.9319391856276118,
            0.038153608151164836,
            -0.22612328477674265,
        ),
        {
            "omega": (0.07559316432209712, -0.15937431544704642, 0.10346191171194119),
            "u": (-0.019437088638150714, -0.28953516107337757, -0.9569700048002999),
            "sigma": 0.00036055362180242986,
            "mu": 0.864204586209015,
            "pivot": 0.00089084076935772,
            "t_end": 400.0,
        },
        304.5221994446269,
        doubt=1e-7,
        tols=(1e-6, 1e-9, 1e-12),
    ),
    Problem(
        "delayed",
        frozenset({"delayed instability"}),
        _body(
            7.878870827057267,
            1.672473618626555,
            7.551344445683823,
            0.6342951334607377,
            0.07268222085424973,
            -0.006448836432918283,
        ),
        {"n_i": -0.5, "omega_xy0": 0.01, "t_end": 4000.0},
        2467.883536,
        doubt=1e-6,
    ),
)


def tagged(tag: str) -> list[Problem]:
    """Return the problems with a tag."""
    return [problem for problem in PROBLEMS if tag in problem.tags]


def assert_honest(problem: Problem, tol: float) -> None:
    """Check that a reported error is not below the true one."""
    run = problem.run(tol)
    assert run.status == "ok"
    assert run.t_r is not None
    off = max(0.0, abs(run.t_r - problem.t_r) - problem.doubt)
    told = f"{problem.name} at {tol:g}: off by {off:.1e}, told {run.t_r_error:.1e}"
    assert off <= run.t_r_error, told
    # Honest is not enough: an error of the whole time would always be.
    if problem.name != "delayed":
        assert run.t_r_error < 0.02 * run.t_r, told
