"""Derive all quantities of one body, with units and words."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

from rattlesweep.errors import ConfigError
from rattlesweep.physics import full, steady, theory
from rattlesweep.physics.body import PARAMETERS, PRESETS, Rattleback
from rattlesweep.physics.launch import direction, garcia_hubbard

FREQUENCY, TIME = "sqrt(g/a)", "sqrt(a/g)"
SPINS = ("n_c1", "n_i", "n_0")
"""Quantities that are given in turns a minute."""
SI_NAMES = ("mass", "height", "inertia", "radii")


class Quantity(NamedTuple):
    """A number with its unit and what it is; None where there is none."""

    name: str
    value: float | None
    unit: str
    description: str
    in_si: tuple[float, str] | None  # with an SI unit, of a body that was given in such


def make_body(given: dict[str, Any]) -> Rattleback:
    """Return the body of the options of the command line; None stands for not given."""
    given = {name: value for name, value in given.items() if value is not None}
    if isinstance(given.get("c"), str) and "height" not in given:
        raise ConfigError(
            f"--c has a unit, but the body has no size; give it with {_options(SI_NAMES)}, or a "
            "number in a"
        )
    if "xi" in given and "xi_deg" in given:
        raise ConfigError("--xi and --xi-deg are both given; keep one of them")
    if "xi_deg" in given:
        given["xi"] = math.radians(given.pop("xi_deg"))
    preset = given.pop("preset", None)
    try:
        if {"half_ellipsoid", "skew", "weights", "at"} & given.keys():
            return _half_ellipsoid(given | ({} if preset is None else {"preset": preset}))
        if measured := {*SI_NAMES, "axes_angle", "z_up"} & given.keys():
            return _from_si(given, preset, measured)
        if preset is not None:
            if "f_sd" in given:
                raise ConfigError("--f-sd does not go with --preset; give alpha and beta instead")
            return replace(PRESETS[preset](), **given)
        if "f_sd" in given and ("alpha" in given or "beta" in given):
            raise ConfigError("--f-sd replaces --alpha and --beta; keep one way")
        dumbbell = ("gamma", "f_sd", "theta", "phi", "xi")
        wanted = dumbbell if "f_sd" in given else PARAMETERS
        missing = [f"--{name.replace('_', '-')}" for name in wanted if name not in given]
        if missing:
            raise ConfigError(
                f"{', '.join(missing)} missing; give --preset GH or KL, all six parameters, or "
                "gamma, f-sd, theta, phi and xi"
            )
        c = given.pop("c", None)
        body = Rattleback.shell_dumbbell(**given) if "f_sd" in given else Rattleback(**given)
        return replace(body, c=c)
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _from_si(given: dict[str, Any], preset: str | None, measured: set[str]) -> Rattleback:
    """Return the body of options in SI units."""
    given = given | ({} if preset is None else {"preset": preset})
    others = [name for name in given if name not in {*SI_NAMES, "axes_angle", "z_up", "c"}]
    if others:
        raise ConfigError(
            f"{_options(others)} given beside {_options(measured)}; keep a body in SI units or one "
            "without"
        )
    if missing := [name for name in SI_NAMES if name not in given]:
        raise ConfigError(f"{_options(missing)} missing; a body in SI units has all of "
                          f"{_options(SI_NAMES)}")  # fmt: skip
    if (c := given.get("c")) is not None and not isinstance(c, str):
        given["c"] = c * given["height"]
    return Rattleback.from_si(**given)


def _half_ellipsoid(given: dict[str, Any]) -> Rattleback:
    """Return the body of the options of a half ellipsoid."""
    own = {"half_ellipsoid", "mass", "skew", "weights", "at"}
    if missing := {"half_ellipsoid", "mass"} - given.keys():
        raise ConfigError(f"{_options(missing)} missing; a half ellipsoid has --half-ellipsoid, "
                          "--mass, and --skew or --weights and --at")  # fmt: skip
    if others := given.keys() - own:
        raise ConfigError(f"{_options(others)} given beside --half-ellipsoid, which has "
                          "--mass, --skew, --weights and --at alone")  # fmt: skip
    sizes = dict(zip(("length", "width", "height"), given.pop("half_ellipsoid"), strict=True))
    return Rattleback.half_ellipsoid(**sizes, **given)


def _options(names: Iterable[str]) -> str:
    return ", ".join(f"--{name.replace('_', '-')}" for name in sorted(names))


def _check(n_i: float, omega_xy0: float, sigma: float, rolling: float) -> None:
    """Refuse a launch without spin or without oscillation, and losses that are none."""
    for name, value in (("--sigma", sigma), ("--rolling", rolling)):
        if not (math.isfinite(value) and value >= 0):
            raise ConfigError(f"{name} {value:g}: the dissipation must be finite and not negative")
    if not (math.isfinite(n_i) and n_i != 0):
        raise ConfigError(f"--n-i {n_i:g}: the initial spin must be finite and not zero")
    if not (math.isfinite(omega_xy0) and omega_xy0 > 0):
        raise ConfigError(f"--omega-xy0 {omega_xy0:g}: the oscillation must be finite and positive")


def derived(
    body: Rattleback, n_i: float, omega_xy0: float, sigma: float = 0.0, rolling: float = 0.0
) -> list[Quantity]:
    """Return everything theory says of a body and a launch along the relevant mode."""
    _check(n_i, omega_xy0, sigma, rolling)
    b, m = body, theory.modes(body.alpha, body.beta, body.theta, body.phi, body.xi)
    psi = direction(m, n_i, "relevant")
    gh = garcia_hubbard(b, m, n_i, omega_xy0, psi)
    n_c1 = float(theory.bondi_threshold(b.alpha, b.beta, b.gamma, b.theta, b.phi))
    constants = full.constants(b.alpha, b.beta, b.gamma, b.theta, b.phi, b.xi)
    pitch, roll = steady.growth(constants, n_i, sigma)
    small_pitch, small_roll = theory.growth_rates(m.K_p, m.K_r, n_i)
    damping = theory.damping_rates(b.alpha, b.beta, m, sigma)
    small_pitch, small_roll = small_pitch - damping[0], small_roll - damping[1]
    losses: list[tuple[str, Any, str, str]] = []
    if sigma > 0 or rolling > 0:
        # Threshold and growth of a spin that stays; under rolling resistance nothing small grows.
        n_c1, known = math.nan, math.nan if rolling > 0 else 1.0
        pitch, roll, small_pitch, small_roll = (
            known * rate for rate in (pitch, roll, small_pitch, small_roll)
        )
        losses = [
            ("sigma", sigma, "M a^2 sqrt(g/a)", "dissipation: torque -sigma omega"),
            ("rolling", rolling, "a", "dissipation: lever of the rolling resistance"),
            ("spin_decay", sigma / b.gamma, FREQUENCY, "rate at which an upright spin falls"),
            ("n_growth_pitch", known * 2 * damping[0] / m.K_p, FREQUENCY,
             "spin above which the pitch grows, small spin"),
            ("n_growth_roll", known * -2 * damping[1] / m.K_r, FREQUENCY,
             "spin below which the roll grows, small spin"),
        ]  # fmt: skip
    shape = [] if b.c is None else [("c", b.c, "a", "body: vertical semi-axis of the ellipsoid")]
    rows: list[tuple[str, Any, str, str]] = [
        *((name, getattr(b, name), "rad" if name == "xi" else "1", "body") for name in PARAMETERS),
        *shape,
        ("omega_p", m.omega_p, FREQUENCY, "frequency of the pitch (the faster mode)"),
        ("omega_r", m.omega_r, FREQUENCY, "frequency of the roll (the slower mode)"),
        ("omega_p0", m.omega_p0, FREQUENCY, "frequency of the pitch at zero skew angle"),
        ("omega_r0", m.omega_r0, FREQUENCY, "frequency of the roll at zero skew angle"),
        ("psi_p", m.psi_p, "rad", "direction of the pitch from the x axis"),
        ("psi_r", m.psi_r, "rad", "direction of the roll from the x axis"),
        ("K_p", m.K_p, "1", "asymmetric torque coefficient of the pitch"),
        ("K_r", m.K_r, "1", "asymmetric torque coefficient of the roll"),
        ("n_c1", -n_c1 if b.xi > 0 else n_c1, FREQUENCY, "Bondi's threshold of the steady spin"),
        ("n_i", n_i, FREQUENCY, "initial spin"),
        ("omega_xy0", omega_xy0, FREQUENCY, "initial oscillation"),
        ("psi", psi, "rad", "direction of the launch: the relevant mode"),
        ("n_0", gh.n_0, FREQUENCY, "spin if all energy were spin"),
        ("t_rgh", gh.t_rgh, TIME, "Garcia and Hubbard's reversal time in the spin's direction"),
        ("growth_pitch", small_pitch, FREQUENCY, "growth rate of the pitch, small spin"),
        ("growth_roll", small_roll, FREQUENCY, "growth rate of the roll, small spin"),
        ("growth_pitch_exact", pitch, FREQUENCY, "growth rate of the pitch at n_i"),
        ("growth_roll_exact", roll, FREQUENCY, "growth rate of the roll at n_i"),
        *losses,
    ]
    sizes = {} if b.units is None else b.units.sizes
    found = []
    for name, number, unit, text in rows:
        value = float(number) if math.isfinite(float(number)) else None
        size, si_unit = sizes.get(unit, (math.nan, ""))
        if name in SPINS:
            size, si_unit = size * 30 / math.pi, "rpm"
        in_si = (value * size, si_unit) if value is not None and unit in sizes else None
        found.append(Quantity(name, value, unit, text, in_si))
    return found
