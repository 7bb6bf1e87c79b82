"""Make `tests/physics/slide_cases.json`: runs that slide, by `friction_oracle` alone.

Run ``python tests/helpers/make_slide_cases.py FILE``; it takes about an hour.  A run is
kept if two tolerances agree to 1e-7 in the reversal time and in everything else to the
errors that are stored with it.
"""

import json
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import friction_oracle
import numpy as np
import oracle
from contact_mechanics import Body

SEED = 38
BODIES = 20
LAUNCHES = 3
SPINS = (0.2, -0.2, 0.3, -0.3, 0.5, -0.5)
TOLERANCES = (1e-10, 1e-11)
LONGEST = 300.0
ACCEPTED = 1e-7
NUMBERS = ("t_r", "t_slide", "slide_time", "slide_work", "energy")


def bodies():
    """Yield bodies of the paper's Table I; every fourth is an ellipsoid."""
    rng = np.random.default_rng(SEED)
    for k in range(BODIES):
        gamma = rng.uniform(5, 15)
        share = rng.uniform(0.05, 0.15)
        yield Body(
            alpha=(1 - share) * gamma + 1,
            beta=share * gamma + 1,
            gamma=gamma,
            theta=rng.uniform(0.6, 0.95),
            phi=rng.uniform(0.01, 0.1),
            xi=-math.radians(rng.uniform(2, 6)),
            c=rng.uniform(1.2, 3) if k % 4 == 3 else None,
        )


def cases():
    """Yield the launches, each body with three; every fifth body has a couple too."""
    rng = np.random.default_rng(SEED + 1)
    for k, body in enumerate(bodies()):
        for launch in range(LAUNCHES):
            n_i = SPINS[(LAUNCHES * k + launch) % len(SPINS)]
            # In the steady direction small oscillations take too long to grow.
            push = float(rng.choice([0.01, 0.1])) if n_i > 0 else 0.1
            yield {
                "body": vars(body),
                "n_i": n_i,
                "omega_xy0": push,
                "psi": oracle.relevant_psi(vars(body), n_i),
                "mu": float(rng.choice([0.2, 0.3, 0.5])),
                "sigma": 2e-3 if k % 5 == 4 else 0.0,
                "t_end": horizon(body, n_i, push),
            }


def horizon(body, n_i, push):
    """Return five times Garcia and Hubbard's time (Eq. 61), at most `LONGEST`."""
    modes = oracle.modes(vars(body))
    mode = "p" if n_i > 0 else "r"
    torque = modes["K_" + mode]
    moment = body.alpha * math.cos(modes["psi_" + mode]) ** 2
    moment += body.beta * math.sin(modes["psi_" + mode]) ** 2
    n_0 = math.sqrt(n_i**2 + moment * push**2 / body.gamma)
    time = math.log((n_0 + abs(n_i)) / (n_0 - abs(n_i))) / (abs(torque) * n_0)
    return min(5 * time, LONGEST)


def followed(case, rtol):
    """Return the results of a launch at a tolerance."""
    body = Body(**case["body"])
    y = oracle.launch(case["body"], case["n_i"], case["omega_xy0"], case["psi"])
    run = friction_oracle.run(
        *(body, y[:3], y[3:], case["t_end"]),
        mu=case["mu"],
        sigma=case["sigma"],
        rtol=rtol,
        through=False,
    )
    end = run.at_end
    return {
        "status": run.status,
        "t_end": end.t,
        "t_r": run.t_r,
        "n_slides": len(run.slides),
        "t_slide": run.slides[0].begin if run.slides else None,
        "slide_time": end.slide_time,
        "slide_work": end.slide_work,
        "energy": end.energy,
    }


def judged(case):
    """Return a case with its results and their errors, or None."""
    try:
        rough, fine = (followed(case, rtol) for rtol in TOLERANCES)
    except ArithmeticError as error:
        print(error, case, file=sys.stderr)
        return None
    errors = {}
    for name in NUMBERS:
        if (rough[name] is None) != (fine[name] is None):
            return None
        if fine[name] is not None:
            errors[name] = abs(rough[name] - fine[name])
    is_same = all(rough[name] == fine[name] for name in ("status", "n_slides"))
    end = abs(rough["t_end"] - fine["t_end"])
    if not is_same or max(end, errors.get("t_r", 0.0)) > ACCEPTED:
        return None
    return case | {"result": fine, "error": errors}


def keep(path, every, judge):
    """Write the cases that a judge keeps to a file, as they come."""
    kept = []
    with ProcessPoolExecutor(2) as pool:
        for case in pool.map(judge, every):
            if case is not None:
                kept.append(case)
                path.write_text(json.dumps(kept, indent=1) + "\n")
    print(f"{len(kept)} of {len(every)} runs kept", file=sys.stderr)


if __name__ == "__main__":
    keep(Path(sys.argv[1]), list(cases()), judged)
