"""Texts of configs that are accepted, and changes to them."""

import pytest

EXAMPLE = """\
name: steady-kr-quick
seed: 2017                  # every draw depends on (seed, case, sample) and on nothing else
bodies:                     # where parameter sets come from
  source: sd                # sd | preset | table | grid
  samples: 1000             # per case
  ranges: {gamma: [5, 15], f_sd: [0.05, 0.15], theta: [0.6, 0.95], phi: [0.01, 0.1], minus_xi_deg: [0, 6]}
  target: {K_r: [0.01, 0.03, 0.1], rel_tol: 1e-3}   # optional
spin:                       # cases are targets x n_i x omega_xy0
  n_i: [-0.1, -0.3, -0.5]
  omega_xy0: [0.001, 0.01, 0.1]
  psi: relevant
model: full                 # full | reduced | gh
horizon: {t_rgh: 5}
integrator: {method: dop853, tol: 1e-9}
classify: {}
record: []
output: out/steady-kr-quick
"""  # noqa: E501


SPIN = "spin: {n_i: -0.1, omega_xy0: 0.01}\n"


GOOD = {
    "sd": EXAMPLE,
    "preset": "bodies: {source: preset, name: GH, overrides: {theta: 0.82}}\n" + SPIN,
    "table": "bodies: {source: table, path: bodies.csv}\n",
    "grid": "bodies: {source: grid, base: {preset: GH}, "
    "axes: {theta: {linspace: [0.6, 0.99, 200]}, phi: [0.02, 0.036]}}\n" + SPIN,
    "shell": "bodies: {source: grid, base: {gamma: 10, f_sd: 0.1, theta: 0.7, "
    "phi: 0.05, xi_deg: -3}, axes: {f_sd: [0.1, 0.2], "
    "minus_xi_deg: {logspace: [0.01, 1, 3]}}}\n"
    "spin: {n_i: [0.1, -0.1], omega_xy0: 0.01, psi: 30}\n"
    "integrator: {method: rk4, dt: 0.002}\nhorizon: {t: 3.0e4}\n"
    "record: [contact, energy]\n",
    "shape": "bodies: {source: shape, length: 12cm, width: 30 mm, height: 12 mm, "
    "mass: [80 g, 90 g], skew: -3 deg, samples: 4}\n"
    "spin: {n_i: [60 rpm, 0.1 sqrt(g/a)], omega_xy0: 6 rpm}\n",
}


def changed(old, new, text=EXAMPLE):
    assert old in text
    return text.replace(old, new)


def variants(table, **more):
    """Return the rows of a table like `REFUSED` as parameters: the changed config, and
    the rest.
    """
    found = []
    for line in table.strip().splitlines():
        name, old, new, *rest = line.replace(r"\n", "\n").split(" | ")
        text = (GOOD | more)[name]
        text = text + new + "\n" if old == "+" else changed(old, new, text)
        found.append(pytest.param(text, *rest, id=rest[-1]))
    return found
