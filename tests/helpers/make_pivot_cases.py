"""Make `tests/physics/pivot_cases.json`: runs that rub, by `friction_oracle` alone.

Run ``python tests/helpers/make_pivot_cases.py FILE``; it takes a few minutes.  A run is
kept if two tolerances agree to `ACCEPTED` in every number, which is stored with its
error.  Numbers are taken at the reversal, if there is one, and at the horizon.
"""

import math
import sys
from pathlib import Path

import friction_oracle
import numpy as np
import oracle
from contact_mechanics import Body
from make_slide_cases import keep

SEED = 46
LEVERS = (5e-4, 1e-3, 2e-3, 6e-3)
TOLERANCES = (1e-11, 1e-12)
ACCEPTED = 1e-9  # relative for t_r
ACCEPTED_SLIDING = 1e-7
# Bodies, spin, push, psi, lever and horizon.
# fmt: off
CROWDED = (
    (5.8497834356185425, 1.4694161812728757, 5.319199616891418, 0.8880751663590318,
     0.042978131454888296, -0.017305118710683985,
     0.3, 0.01, -0.06997273515623523, 0.002, 185.0),
    (14.512139306145432, 1.8306808978621427, 14.342820204007575, 0.7339897963744044,
     0.0819068245965201, -0.02533283335059677,
     0.3, 0.01, -0.2551990385878244, 0.002, 172.0),
    (6.621855920221321, 1.3184963985097964, 5.940352318731118, 0.8880608374159337,
     0.09172299450757342, -0.056646107203958976,
     0.3, 0.1, -0.2915961243590241, 0.0005, 60.0),
)
# fmt: on
PARAMETERS = "alpha", "beta", "gamma", "theta", "phi", "xi"
NUMBERS = (
    "t",
    "t_held",
    "held_time",
    "slide_time",
    "slide_work",
    "pivot_work",
    "energy_left",
)


def case(body, n_i, push, pivot, t_end, psi=None, **friction):
    """Return a launch as a record; without ``psi`` along the relevant mode."""
    if psi is None:
        psi = oracle.relevant_psi(body, n_i)
    elif isinstance(psi, str):
        psi = oracle.modes(body)["psi_" + psi]
    dissipation = {"pivot": pivot, "mu": None, "sigma": 0.0, "rolling": 0.0}
    return {
        "body": dict(body) | {"c": body.get("c")},
        "launch": {"n_i": n_i, "omega_xy0": push, "psi": psi},
        "dissipation": dissipation | friction,
        "t_end": float(t_end),
    }


def known():
    """Yield the launches of Garcia and Hubbard's body."""
    horizons = {(0.1, 0.01): 120, (-0.2, 0.1): 222}
    for (n_i, push), t_end in horizons.items():
        for lever in (5e-4, 2e-3, 6e-3):
            yield case(oracle.GH, n_i, push, lever, t_end)
    for lever, t_end in ((5e-4, 884), (2e-3, 600), (6e-3, 210)):
        yield case(oracle.GH, -0.1, 0.01, lever, t_end)


def taps():
    """Yield launches without spin, held from the start or not."""
    for push, mode, lever in (
        (0.01, "p", 5e-4),
        (0.01, "r", 2e-3),
        (0.1, "r", 2e-3),
        (0.1, "p", 6e-3),
        (0.3, "p", 2e-3),
        (0.3, "r", 6e-3),
    ):
        yield case(oracle.GH, 0.0, push, lever, 30, psi=mode)


def bodies(count, seed):
    """Yield bodies of the paper's Table I; every third is an ellipsoid."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        gamma = rng.uniform(5, 15)
        share = rng.uniform(0.05, 0.15)
        yield {
            "alpha": (1 - share) * gamma + 1,
            "beta": share * gamma + 1,
            "gamma": gamma,
            "theta": rng.uniform(0.6, 0.95),
            "phi": rng.uniform(0.01, 0.1),
            "xi": -math.radians(rng.uniform(2, 6)),
            "c": rng.uniform(1.2, 3) if k % 3 == 2 else None,
        }


def drawn():
    """Yield launches of random bodies, some with other losses and some that slide."""
    rng = np.random.default_rng(SEED)
    for k, body in enumerate(bodies(14, SEED + 1)):
        n_i = float(rng.choice([0.1, 0.2])) * (1 if k % 2 else -1)
        losses = {}
        if k % 4 == 1:
            losses["sigma"] = 1e-3
        if k % 4 == 2:
            losses["rolling"] = 1e-4
        yield case(body, n_i, 0.1, float(rng.choice(LEVERS)), 100, **losses)
    for k, body in enumerate(bodies(8, SEED + 2)):
        n_i = 0.2 if k % 2 else -0.2
        mu = (0.1, 0.2, 0.3)[k % 3]
        yield case(body, n_i, 0.3, float(rng.choice(LEVERS)), 30, mu=mu)


def mirrored():
    """Yield mirror images of two launches."""
    image = oracle.GH | {"xi": -oracle.GH["xi"]}
    for n_i, push, mu in ((0.1, 0.01, None), (0.3, 0.1, 0.3)):
        psi = oracle.relevant_psi(oracle.GH, n_i)
        yield case(oracle.GH, n_i, push, 2e-3, 115 if mu is None else 45, psi, mu=mu)
        yield case(image, -n_i, push, 2e-3, 115 if mu is None else 45, -psi, mu=mu)


def heavy_taps():
    """Yield taps whose foot begins to slide while the spin is held."""
    for mode, push, mu, lever, t_end in (
        ("r", 0.2, 0.05, 0.05, 12),
        ("r", 0.2, 0.1, 0.05, 12),
        ("r", 0.3, 0.15, 0.05, 12),
        ("p", 0.3, 0.1, 0.1, 6),
    ):
        yield case(oracle.GH, 0.0, push, lever, t_end, psi=mode, mu=mu)


def crowded():
    """Yield launches with a slide that begins where the spin is small.

    In the second and third one, the spin and the friction that is left change their
    signs soon after each other.
    """
    for row in CROWDED:
        body = dict(zip(PARAMETERS, row[:6], strict=True))
        n_i, push, psi, lever, t_end = row[6:]
        yield case(body, n_i, push, lever, t_end, psi=psi, mu=0.3)


def every():
    return [*known(), *taps(), *drawn(), *mirrored(), *heavy_taps(), *crowded()]


def numbers(snapshot):
    """Return the numbers of a `Snapshot`, with the spin and the angular velocity."""
    if snapshot is None:
        return None
    values = {name: getattr(snapshot, name) for name in NUMBERS}
    return values | {"n_slides": snapshot.n_slides, "state": snapshot.y.tolist()}


def followed(case, rtol):
    """Return the results of a launch at a tolerance."""
    launch = case["launch"]
    y = oracle.launch(case["body"], launch["n_i"], launch["omega_xy0"], launch["psi"])
    losses = dict(case["dissipation"])
    losses["mu"] = math.inf if losses["mu"] is None else losses["mu"]
    run = friction_oracle.run(
        Body(**case["body"]), y[:3], y[3:], case["t_end"], rtol=rtol, **losses
    )
    return {
        "status": run.status,
        "t_r": run.t_r,
        "n_holds": len(run.holds),
        "at_reversal": numbers(run.at_reversal),
        "at_end": numbers(run.at_end),
    }


def difference(a, b):
    """Return the largest difference of two results; infinite if they are not alike."""
    if isinstance(a, dict) and isinstance(b, dict):
        return max(difference(a[name], b[name]) for name in a)
    if isinstance(a, list) and isinstance(b, list):
        return max(map(difference, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) / max(1.0, abs(b))
    return 0.0 if a == b else math.inf


def judged(case):
    """Return a case with its result and its error, or None."""
    try:
        rough, fine = (followed(case, rtol) for rtol in TOLERANCES)
    except ArithmeticError as error:
        print(error, case, file=sys.stderr)
        return None
    error = difference(rough, fine)
    accepted = ACCEPTED if case["dissipation"]["mu"] is None else ACCEPTED_SLIDING
    if error > accepted:
        print(f"differs by {error:.1e}:", case, file=sys.stderr)
        return None
    return case | {"result": fine, "error": error}


if __name__ == "__main__":
    keep(Path(sys.argv[1]), every(), judged)
