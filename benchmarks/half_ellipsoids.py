"""How often the two rules of docs/one_way.md are right for random half ellipsoids.

Each stone is 8 to 16 cm long, with a width of 0.2 to 0.4 of its length, a height of 0.3
to 0.6 of its width and a skew of 1 to 10 degrees.  It is of one of five materials and
lies on glass or wood.  Its lever is that of Hertz's patch.  Each is launched once a
direction with a spin of 0.1 to 0.8, with creep and without.  All are drawn uniformly.

    python benchmarks/half_ellipsoids.py
"""

from __future__ import annotations

import argparse
import math
from itertools import pairwise

import numpy as np
import pandas as pd

import rattlesweep as rs

RULE = 0.65  # ratio of the first rule above which a body reverses
DENSITIES = {"PLA": 1240, "wood": 700, "glass": 2500, "steel": 7850, "brass": 8500}
PLANES = ("glass", "wood")
LEVELS = (0.05, 0.5, 0.95)  # of the quantiles that are printed
SPINS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8)
DIRECTIONS = {"steady": -1, "unsteady": 1}  # with the sign of the spin
GROUPS = {"all": (0.1, 0.8), "below 0.4": (0.1, 0.4)}
GROUPS |= {f"{low} to {high}": (low, high) for low, high in pairwise(SPINS)}


def drawn(generator: np.random.Generator, mu: float) -> tuple[rs.Rattleback, float]:
    """Return a stone in units of its own, and its lever in these units."""
    length = generator.uniform(0.08, 0.16)
    width = length * generator.uniform(0.2, 0.4)
    height = width * generator.uniform(0.3, 0.6)
    skew = generator.uniform(1, 10)
    material = str(generator.choice(list(DENSITIES)))
    plane = str(generator.choice(PLANES))
    mass = DENSITIES[material] * math.pi / 6 * length * width * height
    stone = rs.Rattleback.half_ellipsoid(
        length=f"{length!r} m",
        width=f"{width!r} m",
        height=f"{height!r} m",
        mass=f"{mass!r} kg",
        skew=f"{skew!r} deg",
    )
    lever = rs.contact_patch(stone, (material, plane), mu=mu).pivot
    return stone.replace(units=None), lever


def ratio_of_rule(runs: pd.DataFrame, growing: np.ndarray) -> np.ndarray:
    """Return the ratio of the first rule with a coefficient of growth; see the page."""
    lever = runs["pivot"].to_numpy()
    push = (runs["gamma"] * (runs["n_0"] ** 2 - runs["n_i"] ** 2) / 2).to_numpy()
    start = runs["K_r"].to_numpy() * push / lever
    have = growing * (runs["gamma"] * runs["n_i"] ** 2).to_numpy() / (2 * lever)
    return np.where(start < 1, have / (1 - start - np.log(start)), np.inf)


def percent(hits: pd.Series) -> str:
    """Return a share with its interval."""
    if len(hits) == 0:
        return "no runs"
    low, high = rs.wilson(hits.sum(), len(hits))
    return (
        f"{100 * hits.mean():5.1f} % ({100 * low:.0f} to {100 * high:.0f}) "
        f"of {len(hits)}"
    )


def launched(
    stones: list[rs.Rattleback],
    levers: np.ndarray,
    n_i: np.ndarray,
    creep: float,
    options: argparse.Namespace,
) -> pd.DataFrame:
    """Return the runs of a direction, with the ratio of the rule and what became."""
    t_rgh = rs.reversal_time_gh(stones, n_i=n_i, omega_xy0=options.push)
    runs = rs.simulate(
        stones,
        n_i=n_i,
        omega_xy0=options.push,
        t_end=options.horizon * np.asarray(t_rgh),
        pivot=levers,
        creep=creep,
        record="energy",
    )
    runs["growing"] = runs["K_r_creep"] if creep else runs["K_r"]
    runs["above"] = ratio_of_rule(runs, runs["growing"].to_numpy()) > RULE
    runs["above_without"] = ratio_of_rule(runs, runs["K_r"].to_numpy()) > RULE
    runs["reverses"] = runs["type"] == "R"
    runs["right"] = runs["reverses"] == runs["above"]
    return runs


def show(title: str, runs: pd.DataFrame, steady: bool) -> None:
    """Print what became of the runs, and in the steady direction how right rules are.

    A run past the rim is left out: it ends before it can show what the rules say.
    """
    print(f"\n{title}: {len(runs)} runs, {runs['status'].value_counts().to_dict()}")
    print("  largest error of energy", runs["energy_drift"].abs().max())
    runs = runs[runs["status"] == "ok"]
    if steady:
        ruled_out = runs["reverses"][runs["growing"] <= 0]
        print("  the second rule rules out", len(ruled_out), "of them, right", end=" ")
        print(percent(~ruled_out))
    for name, (low, high) in GROUPS.items():
        own = runs[runs["n_i"].abs().between(low, high, inclusive="left")]
        print(f"  {name:12} reverse {percent(own['reverses'])}", end="")
        if steady:
            missed = own[own["above"] & ~own["reverses"]]
            print("; right", percent(own["right"]), end="; ")
            print(f"{own['above'].sum()} above the rule", end=", of them ")
            print(f"{missed['t_held'].notna().sum()} held, and", end=" ")
            print(missed["type"][missed["t_held"].isna()].value_counts().to_dict())
            print(f"    {(own['reverses'] & ~own['above']).sum()} below it", end=" ")
            print("reverse; with K_r right", end=" ")
            print(percent(own["reverses"] == own["above_without"]), end="")
        print()


def compare(without: pd.DataFrame, runs: pd.DataFrame) -> None:
    """Print what creep changes for the stones that stay within their rim."""
    ok = (without["status"] == "ok") & (runs["status"] == "ok")
    before, after = without["reverses"][ok], runs["reverses"][ok]
    print(
        f"  creep takes {(before & ~after).sum()} of {before.sum()} reversals", end=""
    )
    print(f" and adds {(after & ~before).sum()}; it takes of K_r", end=" ")
    print(np.quantile(1 - runs["K_r_creep"] / runs["K_r"], LEVELS))
    delay = runs["t_r"][ok] / without["t_r"][ok] - 1
    print("  delay of those that stay", np.quantile(delay[before & after], LEVELS))


def show_ways(
    title: str,
    stones: list[rs.Rattleback],
    levers: np.ndarray,
    options: argparse.Namespace,
) -> None:
    """Print which way stones turn that are spun both ways as in the page's table."""
    turns = []
    for sign in DIRECTIONS.values():
        runs = rs.simulate(
            stones,
            n_i=0.3 * sign,
            omega_xy0=options.push,
            t_end=5000.0,
            pivot=levers,
            creep=options.mu,
            record="reversals",
        )
        print(title, runs["status"].value_counts().to_dict())
        turns.append(runs["n_turns"] > 0)
    steady, unsteady = turns
    print("  turn from the unsteady direction only", percent(unsteady & ~steady))
    print("  both", percent(unsteady & steady))
    print("  neither", percent(~unsteady & ~steady))
    print("  from the steady direction only", percent(steady & ~unsteady))


def main() -> None:
    """Draw, run, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--stones", type=int, default=4000)
    parser.add_argument("--seed", type=int, default=57)
    parser.add_argument("--mu", type=float, default=0.3)
    parser.add_argument("--push", type=float, default=0.01)
    parser.add_argument("--horizon", type=float, default=5.0, help="in t_rgh")
    parser.add_argument("--ways", action="store_true", help="turns at a spin of 0.3")
    options = parser.parse_args()
    generator = np.random.default_rng(options.seed)
    pairs = [drawn(generator, options.mu) for _ in range(options.stones)]
    stones = [stone for stone, _ in pairs]
    levers = np.array([lever for _, lever in pairs])
    spins = generator.uniform(SPINS[0], SPINS[-1], options.stones)
    print("quantiles at", LEVELS)
    print("levers", np.quantile(levers, LEVELS))
    print("K_r", np.quantile(rs.modes(stones).K_r, LEVELS))
    if options.ways:
        for title, own in {
            "Hertz": levers,
            "0.005": np.full(len(levers), 0.005),
        }.items():
            show_ways(f"lever {title}", stones, own, options)
        return
    for direction, sign in DIRECTIONS.items():
        steady = direction == "steady"
        without = launched(stones, levers, sign * spins, 0.0, options)
        show(f"{direction}, without creep", without, steady)
        runs = launched(stones, levers, sign * spins, options.mu, options)
        show(f"{direction}, with creep", runs, steady)
        compare(without, runs)


if __name__ == "__main__":
    main()
