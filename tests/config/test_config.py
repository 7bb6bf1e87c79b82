"""Configs: what is accepted, what is refused, and in which words."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from pydantic import Field, create_model

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.defaults import MAX_STEPS
from rattlesweep.sweeps.config.bodies import GridSource, SdSource
from rattlesweep.sweeps.config.fields import Base
from rattlesweep.sweeps.config.integrator import ACCURACIES, Integrator
from rattlesweep.sweeps.config.load import (
    config_json_schema,
    differences,
    load_config,
    parse_config,
    physics_hash,
    resolved,
)
from rattlesweep.sweeps.config.schema import Config

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
PRESET = "bodies: {source: preset, name: GH, overrides: {theta: 0.82}}\n" + SPIN
TABLE = "bodies: {source: table, path: bodies.csv}\n"
GRID = (
    "bodies: {source: grid, base: {preset: GH}, "
    "axes: {theta: {linspace: [0.6, 0.99, 200]}, phi: [0.02, 0.036]}}\n" + SPIN
)
SHELL = (
    "bodies: {source: grid, base: {gamma: 10, f_sd: 0.1, theta: 0.7, phi: 0.05, xi_deg: -3}, "
    "axes: {f_sd: [0.1, 0.2], minus_xi_deg: {logspace: [0.01, 1, 3]}}}\n"
    "spin: {n_i: [0.1, -0.1], omega_xy0: 0.01, psi: 30}\n"
    "integrator: {method: rk4, dt: 0.002}\nhorizon: {t: 3.0e4}\nrecord: [contact, energy]\n"
)
GOOD = {"sd": EXAMPLE, "preset": PRESET, "table": TABLE, "grid": GRID, "shell": SHELL}


def write(directory: Path, text: str) -> Path:
    path = directory / "c.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def messages(path: Path, overrides: tuple[str, ...] = ()) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    assert str(caught.value) == "\n".join(caught.value.messages)
    return [line.replace(str(path), "c.yaml") for line in caught.value.messages]


def changed(old: str, new: str) -> str:
    assert old in EXAMPLE
    return EXAMPLE.replace(old, new)


# -- what is accepted ---------------------------------------------------------------------------


def test_the_example_of_the_contract_means_what_it_says(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, EXAMPLE))
    assert isinstance(config.bodies, SdSource)
    assert config.bodies.ranges.minus_xi_deg == [0, 6]
    assert config.bodies.target is not None
    assert config.bodies.target.name == "K_r"
    assert config.bodies.target.values == [0.01, 0.03, 0.1]
    assert config.spin is not None
    assert config.spin.n_i == [-0.1, -0.3, -0.5]
    assert config.integrator.tol == 1e-9
    assert config.integrator.dt is None
    assert config.horizon.t_rgh == 5
    assert config.horizon.t is None
    assert config.block_size == 4_000


def test_defaults_are_table_one_and_the_papers_own_step() -> None:
    config = parse_config({"bodies": {"source": "sd"}, "spin": {"n_i": 0.1, "omega_xy0": 0.01}})
    found = resolved(config)
    defaults = {
        "name": "sweep",
        "seed": 0,
        "bodies": {
            "source": "sd",
            "samples": 1000,
            "ranges": {
                "gamma": [5, 15],
                "f_sd": [0.05, 0.15],
                "theta": [0.6, 0.95],
                "phi": [0.01, 0.1],
                "minus_xi_deg": [0, 6],
            },
        },
        "spin": {"n_i": [0.1], "omega_xy0": [0.01], "psi": "relevant"},
        "model": "full",
        "horizon": {"t_rgh": 5},
        "integrator": {"method": "dop853", "tol": 1e-9, "max_steps": 100_000_000},
        "classify": {"ss_growth": 1e-3, "sw_departure": 0.05, "early": False},
        "record": [],
        "block_size": 4_000,
        "output": "out/sweep",
    }
    # A key that came later has a default of its own.
    for part in ("bodies", "classify"):
        found[part] = {key: found[part][key] for key in defaults[part]}
    assert {key: found[key] for key in defaults} == defaults
    rk4 = parse_config({**resolved(config), "integrator": {"method": "rk4"}})
    assert rk4.integrator.dt == 0.002
    assert rk4.integrator.tol is None


@pytest.mark.parametrize("name", GOOD)
def test_resolved_round_trips_and_fits_the_schema(name: str, tmp_path: Path) -> None:
    config = load_config(write(tmp_path, GOOD[name]))
    data = resolved(config)
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    again = parse_config(json.loads(json.dumps(data, sort_keys=True)))
    assert resolved(again) == data
    assert list(resolved(again)) == list(data)
    assert physics_hash(again) == physics_hash(config)
    jsonschema.Draft202012Validator(config_json_schema()).validate(data)


@pytest.mark.parametrize("word", ACCURACIES)
def test_an_accuracy_is_another_spelling_of_a_method_and_its_tol(word: str, tmp_path: Path) -> None:
    path = write(tmp_path, EXAMPLE)
    preset = ACCURACIES[word]
    short = load_config(path, [f"integrator={{accuracy: {word}, max_steps: 7}}"])
    spelled = f"integrator={{method: {preset.method}, tol: {preset.tol}, max_steps: 7}}"
    long = load_config(path, [spelled])
    assert short == long
    assert resolved(short)["integrator"] == {
        "method": preset.method, "tol": preset.tol, "max_steps": 7
    }  # fmt: skip
    assert physics_hash(short) == physics_hash(long)
    description = config_json_schema()["$defs"]["Integrator"]["properties"]["accuracy"]
    assert f"{word}: {preset.words}" in description["description"]
    assert f"{preset.p99:.0e}" in preset.words


@pytest.mark.parametrize("method", ["", "method: dop853, ", "method: verner98, "])
def test_an_error_that_is_asked_for_replaces_tol(method: str, tmp_path: Path) -> None:
    path = write(tmp_path, EXAMPLE)
    asked = f"integrator={{{method}accuracy: {{t_r: 1.0e-6}}}}"
    config = load_config(path, [asked])
    data = resolved(config)
    assert data["integrator"] == {
        "method": config.integrator.method, "accuracy": {"t_r": 1e-6}, "max_steps": MAX_STEPS
    }  # fmt: skip
    assert data["record"] == ["error"]
    assert config.parts == ["error", "tol"]
    jsonschema.Draft202012Validator(config_json_schema()).validate(data)
    again = parse_config(data)
    assert again == config
    # What is implied may be said.
    for same in (again, load_config(path, [asked, "record=[error]"])):
        assert physics_hash(same) == physics_hash(config)
    others = ([], ["record=[error]"], [asked.replace("e-6", "e-7")])
    hashes = {physics_hash(load_config(path, list(sets))) for sets in others}
    assert len(hashes | {physics_hash(config)}) == 4


def test_the_standard_accuracy_is_the_default_and_better_ones_are_better(tmp_path: Path) -> None:
    path = write(tmp_path, changed("integrator: {method: dop853, tol: 1e-9}\n", ""))
    default = load_config(path)
    for same in ("integrator.accuracy=standard", "integrator={accuracy: null, tol: null}"):
        assert load_config(path, [same]) == default
    assert load_config(path, ["integrator={accuracy: draft, tol: null}"]).integrator.tol == 1e-6
    for column in ("tol", "median", "p99"):
        values = [getattr(accuracy, column) for accuracy in ACCURACIES.values()]
        assert values == sorted(values, reverse=True)


def test_grid_axes_give_their_values(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, GRID))
    assert isinstance(config.bodies, GridSource)
    values = config.bodies.axes.values()
    assert list(values) == ["theta", "phi"]
    np.testing.assert_allclose(values["theta"], np.linspace(0.6, 0.99, 200), rtol=1e-15)
    assert (values["theta"][0], values["theta"][-1]) == (0.6, 0.99)
    shell = load_config(write(tmp_path, SHELL))
    assert isinstance(shell.bodies, GridSource)
    np.testing.assert_allclose(shell.bodies.axes.values()["minus_xi_deg"], [0.01, 0.1, 1])


@pytest.mark.parametrize("law", ["linspace", "logspace"])
@pytest.mark.parametrize(
    ("ends", "values"),
    [([0.1, 0.1, 1], [0.1]), ([0.1, 0.2, 2], [0.1, 0.2]), ([0.1, 0.2, 1], None),
     ([0.1, 0.1, 2], None), ([0.1, 0.10000000000000002, 2], None), ([0.1, 0.2], None)],
)  # fmt: skip
def test_values_are_spaced_where_they_can_be(law: str, ends: list[float], values: Any) -> None:
    axes = {"phi": {law: ends}}
    data: dict[str, Any]
    for data in (
        {"bodies": {"source": "preset", "name": "GH"}, "spin": {"n_i": {law: ends}}},
        {"bodies": {"source": "grid", "base": {"preset": "GH"}, "axes": axes}, "spin": {"n_i": 1}},
    ):
        data["spin"]["omega_xy0"] = 0.1
        if values is None:
            with pytest.raises(ConfigError, match=r"space|differ|three numbers"):
                parse_config(data)
            continue
        config = parse_config(data)
        assert config.spin is not None
        found = config.bodies.axes.values()["phi"] if "axes" in data["bodies"] else config.spin.n_i
        assert found == values


def test_the_hash_is_of_the_physics_alone(tmp_path: Path) -> None:
    path = write(tmp_path, EXAMPLE)
    base = physics_hash(load_config(path))
    same = ["name=x", "output=y", "classify.ss_growth=0.5", "spin.psi=relevant", "block_size=5"]
    assert physics_hash(load_config(path, [*same, "classify.early=false"])) == base
    early = physics_hash(load_config(path, ["classify.early=true"]))
    assert physics_hash(load_config(path, ["classify={early: true, ss_growth: 0.5}"])) == early
    for other in ("seed=1", "integrator.tol=1e-8", "record=[energy]", "model=gh",
                  "classify.early=true"):  # fmt: skip
        assert physics_hash(load_config(path, [other])) != base
    energy_first = load_config(path, ["record=[energy, contact]"])
    assert physics_hash(energy_first) == physics_hash(
        load_config(path, ["record=[contact,energy]"])
    )


def test_axes_in_another_order_are_the_same_grid() -> None:
    def grid(axes: dict[str, list[float]]) -> Config:
        bodies = {"source": "grid", "base": {"preset": "GH"}, "axes": axes}
        return parse_config({"bodies": bodies, "spin": {"n_i": 0.1, "omega_xy0": 0.01}})

    one, two = grid({"theta": [0.7], "phi": [0.1]}), grid({"phi": [0.1], "theta": [0.7]})
    assert one == two
    assert physics_hash(one) == physics_hash(two)


def test_differences_name_keys_and_both_values(tmp_path: Path) -> None:
    path = write(tmp_path, EXAMPLE)
    a = resolved(load_config(path))
    b = resolved(load_config(path, ["bodies.samples=10", "integrator={method: rk4, dt: 0.002}"]))
    assert differences(a, a) == []
    assert differences(a, b) == [
        "bodies.samples: 1000 against 10",
        'integrator.method: "dop853" against "rk4"',
        "integrator.tol: 1e-09 against not set",
        "integrator.dt: not set against 0.002",
    ]


def test_python_data_may_hold_tuples_and_numpy_numbers() -> None:
    config = parse_config(
        {
            "bodies": {"source": "sd", "samples": np.int64(7), "ranges": {"gamma": (5, 6)}},
            "spin": {"n_i": np.float64(0.1), "omega_xy0": tuple(np.array([0.1, 0.2]))},
        }
    )
    assert isinstance(config.bodies, SdSource)
    assert config.bodies.samples == 7
    assert config.spin is not None
    assert config.spin.omega_xy0 == [0.1, 0.2]


def test_set_takes_yaml_values_and_the_last_one_wins(tmp_path: Path) -> None:
    path = write(tmp_path, EXAMPLE)
    config = load_config(
        path, ["bodies.samples=10", "bodies.samples=20", "spin.n_i=[1e-2, 0.5]", "bodies.target="]
    )
    assert isinstance(config.bodies, SdSource)
    assert config.bodies.samples == 20
    assert config.bodies.target is None
    assert config.spin is not None
    assert config.spin.n_i == [0.01, 0.5]


# -- what is refused ----------------------------------------------------------------------------

BODIES = "bodies:\n  source: sd\n"


def drawn(rest: str) -> str:
    return f"bodies: {{source: sd, {rest}}}\n{SPIN}"


def stop(rule: str) -> str:
    return f"bodies: {{source: sd}}\nstop: {rule}\n{SPIN}"


def refine(rule: str) -> str:
    return GRID.replace("phi: [0.02, 0.036]}", f"phi: [0.02, 0.036]}}, refine: {rule}")


BAD = {
    "unknown key": (changed("samples: 1000", "sampels: 1000"),
     'c.yaml:5:3: bodies.sampels: unknown key "sampels"; did you mean "samples"?'),
    "unknown key like no other": (changed("model: full", "zzz: full"),
     'c.yaml:12:1: zzz: unknown key "zzz"; the keys allowed here are name, seed, bodies, stop, '),
    "unknown key drawn out": (changed("tol: 1e-9", "tolerance: 1e-9"),
     'c.yaml:14:30: integrator.tolerance: unknown key "tolerance"; did you mean "tol"?'),
    "key of a deeper section": (changed("samples: 1000", "theta: [0.6, 0.95]"),
     'c.yaml:5:3: bodies.theta: unknown key "theta" here; it belongs under bodies.ranges'),
    "key of another source": (PRESET.replace("overrides: {theta: 0.82}", "theta: 0.82"),
     'c.yaml:1:36: bodies.theta: unknown key "theta" here; it belongs under bodies.overrides'),
    "key of the top level": (changed("psi: relevant", "model: full"),
     'c.yaml:11:3: spin.model: unknown key "model" here; it belongs at the top level'),
    "source misspelt": (changed("source: sd", "souce: sd"),
     'c.yaml:4:3: bodies.souce: unknown key "souce"; did you mean "source"?'),
    "missing because misspelt": (changed("omega_xy0:", "omega_xyO:"),
     'c.yaml:10:3: spin.omega_xyO: unknown key "omega_xyO"; did you mean "omega_xy0"?'),
    "model misspelt": (changed("model: full", "model: redused"),
     'c.yaml:12:1: model: "redused" is not one of full, reduced'),
    "method in capitals": (changed("method: dop853, tol: 1e-9", "method: RK4"),
     'did you mean "rk4"?'),
    "list as a key": ("bodies: {[a]: 1}\n" + SPIN,
     "c.yaml:1:10: bodies: a list, mapping or alias found where a key should be; write a name"),
    "too many cases": (
        f"bodies: {{source: sd}}\nspin:\n  n_i: {list(range(1, 402))}\n"
        f"  omega_xy0: {list(range(1, 402))}\n",
     "c.yaml:2:1: spin: 160801 cases (targets x n_i x omega_xy0); at most 100000 are possible"),
    "too fast": (changed("n_i: [-0.1,", "n_i: [-1e7,"),
     "c.yaml:9:9: spin.n_i[0]: -10000000.0 is out of range; it must be at least -1000000"),
    "values too close": (GRID.replace("[0.6, 0.99, 200]", "[0.6, 0.60000000000001, 1000]"),
     "1000 values from 0.6 to 0.60000000000001 would not all differ; give"),
    "repeated key": (changed("model: full", "seed: 3"),
     "c.yaml:12:1: seed: the key is repeated (first in line 2); keep one of the two"),
    "wrong type": (changed("samples: 1000", "samples: many"),
     'c.yaml:5:3: bodies.samples: "many" (text) is given here; write a whole number'),
    "null for a number": (changed("samples: 1000", "samples:"),
     "c.yaml:5:3: bodies.samples: nothing (null) is given here; write a whole number"),
    "list for a mapping": (changed("classify: {}", "classify: []"),
     "c.yaml:15:1: classify: a list is given here; write a mapping"),
    "early of the closed form": (changed("model: full", "model: gh").replace(
        "classify: {}", "classify: {early: true}"),
     "c.yaml:15:1: classify: early is for the model full, and the model gh has no stable spin by "
     "which a run could be certain to be SS; leave early out"),
    "early and exponents": (changed("classify: {}", "classify: {early: true}").replace(
        "record: []", "record: [lyapunov]"),
     "c.yaml:16:1: record: lyapunov is the exponent of a run up to its horizon, and "),
    "yes for true": (changed("classify: {}", "classify: {early: yes}"),
     'c.yaml:15:12: classify.early: "yes" (text) is given here; write true or false'),
    "number for text": (changed("output: out/steady-kr-quick", "output: 12"),
     "c.yaml:17:1: output: 12 is a number; put it in quotes to make it text"),
    "fraction of a sample": (changed("samples: 1000", "samples: 1.5"),
     "c.yaml:5:3: bodies.samples: 1.5 is given here; write a whole number"),
    "quoted number": (changed("tol: 1e-9", 'tol: "1e-9"'),
     'c.yaml:14:30: integrator.tol: "1e-9" is text; remove the quotes'),
    "nan": (changed("tol: 1e-9", "tol: .nan"),
     "c.yaml:14:35: integrator.tol: .nan is not a finite number of 64 bits; write one below"),
    "overflow": (changed("0.001, 0.01, 0.1]", "0.001, 1e999]"),
     "c.yaml:10:22: spin.omega_xy0[1]: 1e999 is not a finite number of 64 bits; write one below"),
    "65 bits": (changed("seed: 2017", "seed: 36893488147419103232"),
     "c.yaml:2:7: seed: the integer 36893488147419103232 does not fit into 64 bits; write"),
    "reversed range": (changed("gamma: [5, 15]", "gamma: [15, 5]"),
     "c.yaml:6:12: bodies.ranges.gamma: the range [15, 5] is reversed; write [5, 15]"),
    "empty range": (changed("gamma: [5, 15]", "gamma: []"),
     "c.yaml:6:12: bodies.ranges.gamma: a range has two numbers, [low, high], and not 0"),
    "theta of one": (changed("theta: [0.6, 0.95]", "theta: [0.6, 1.2]"),
     "c.yaml:6:61: bodies.ranges.theta[1]: 1.2 is out of range; it must be below 1"),
    "phi above theta": (changed("phi: [0.01, 0.1]", "phi: [0.01, 0.7]"),
     "c.yaml:6:68: bodies.ranges.phi: phi >= theta is possible, as phi goes up to 0.7 and "
     "theta down to 0.6; the ranges must not meet"),
    "phi of Table I above theta": (BODIES + "  ranges: {theta: [0.05, 0.5]}\n" + SPIN,
     "c.yaml:3:3: bodies.ranges.phi: phi >= theta is possible"),
    "no skew": (changed("minus_xi_deg: [0, 6]", "minus_xi_deg: [0, 0]"),
     "c.yaml:6:86: bodies.ranges.minus_xi_deg: the range leaves only xi = 0"),
    "target with neither": (changed("K_r: [0.01, 0.03, 0.1], rel_tol: 1e-3", "rel_tol: 0.1"),
     "c.yaml:7:3: bodies.target: neither K_r nor K_p is given; give one of them"),
    "negative omega": (changed("0.01, 0.1]\n  psi", "-0.01]\n  psi"),
     "c.yaml:10:22: spin.omega_xy0[1]: -0.01 is out of range; it must be above 0"),
    "spin and launch": (changed("spin:", "launch: {omega: [0, 0, -1]}\nspin:"),
     "c.yaml:9:1: spin: spin and launch are both given; keep one of them"),
    "state of two": (PRESET.replace(SPIN, "launch: {omega: [0, 1]}"),
     "launch.omega: 2 components are no vector; give three, x, y, z"),
    "state upside down": (PRESET.replace(SPIN,
     "launch: {omega: [0, 0, 1], u: [0, 0, 1]}"), "launch.u: u_z is 1; it must be negative, as"),
    "u too long": (PRESET.replace(SPIN,
     "launch: {omega: [0, 0, 1], u: [0.1, 0, -1]}"), "launch.u: its length is 1.00499; give a un"),
    "state of rest": (PRESET.replace(SPIN,
     "launch: {omega: [0, 0, 0]}"), "launch: the body stands upright and at rest; give it an"),
    "launch with a stranger": (PRESET.replace(SPIN, "launch: {omega: [0.1, 0, 1], v: 1}"),
     'c.yaml:2:30: launch.v: unknown key "v"; the keys allowed here are omega, u'),
    "the same spin twice": (changed("n_i: [-0.1,", "n_i: [-0.3,"),
     "c.yaml:9:3: spin.n_i: -0.3 is repeated; give each value once"),
    "psi misspelt": (changed("psi: relevant", "psi: relevent"),
     'c.yaml:11:3: spin.psi: "relevent" is not one of relevant, pitch, roll; '
     'did you mean "relevant"?'),
    "psi of several": (changed("psi: relevant", "psi: {}"),
     "c.yaml:11:3: spin.psi: a mapping is given here; write a number"),
    "missing bodies": (SPIN, "c.yaml:1:1: bodies: the key is missing; say with it where"),
    "missing source": ("bodies: {samples: 3}\n" + SPIN,
     "c.yaml:1:1: bodies.source: the key is missing; it must be one of sd, preset, table, grid"),
    "wrong source": (changed("source: sd ", "source: sdd "),
     'c.yaml:4:3: bodies.source: "sdd" is not one of sd, preset, table, grid; did you mean "sd"'),
    "tol with rk4": (changed("method: dop853", "method: rk4"),
     "c.yaml:14:27: integrator.tol: rk4 has steps of one size and takes no tol; leave it out"),
    "dt with dop853": (changed("tol: 1e-9", "dt: 0.1"),
     "c.yaml:14:30: integrator.dt: dop853 chooses its own steps and takes no dt; leave"),
    "unknown accuracy": (changed("method: dop853, tol: 1e-9", "accuracy: drft"),
     'c.yaml:14:14: integrator.accuracy: "drft" is not one of draft, standard, reference; did'),
    "accuracy and a method": (changed("method: dop853, tol: 1e-9", "method: rk4, accuracy: draft"),
     "c.yaml:14:27: integrator.accuracy: draft stands for a method and its tol, and"),
    "an error and a tol": (changed("method: dop853, tol: 1e-9", "accuracy: {t_r: 1e-6}, tol: 1e-9"),
     "c.yaml:14:37: integrator.tol: accuracy {t_r: 1e-06} stands in its place; keep one of the"),
    "an error and a dt": (changed("method: dop853, tol: 1e-9", "dt: 0.1, accuracy: {t_r: 1e-6}"),
     "c.yaml:14:14: integrator.dt: accuracy {t_r: 1e-06} stands in its place; keep one of the"),
    "an error and fixed steps": (changed("method: dop853, tol: 1e-9",
     "method: rk4, accuracy: {t_r: 1e-6}"),
     "c.yaml:14:27: integrator.accuracy: rk4 has steps of one size, which follow no error; choose"),
    "an error too small": (changed("method: dop853, tol: 1e-9", "accuracy: {t_r: 1e-15}"),
     "c.yaml:14:25: integrator.accuracy.t_r: 1e-15 is out of range; it must be at least 1e-12"),
    "an error that is none": (changed("method: dop853, tol: 1e-9", "accuracy: {t_r: 0.1}"),
     "c.yaml:14:25: integrator.accuracy.t_r: 0.1 is out of range; it must be at most 0.001"),
    "an error of what": (changed("method: dop853, tol: 1e-9", "accuracy: {}"),
     "c.yaml:14:14: integrator.accuracy.t_r: the key is missing; add it"),
    "an error of something else": (changed("method: dop853, tol: 1e-9", "accuracy: {tr: 1e-6}"),
     'c.yaml:14:25: integrator.accuracy.tr: unknown key "tr"; did you mean "t_r"?'),
    "an error by itself": (changed("method: dop853, tol: 1e-9", "accuracy: 1e-6"),
     "c.yaml:14:14: integrator.accuracy: 1e-06 is a number; write {t_r: 1e-06} for the error"),
    "an error of a closed form": (changed("method: dop853, tol: 1e-9", "accuracy: {t_r: 1e-6}")
     .replace("model: full", "model: gh"),
     "c.yaml:14:1: integrator: the model gh is a closed form whose t_r has no error to limit;"),
    "an error of later reversals": (PRESET + "record: [reversals, error]\n",
     "c.yaml:3:1: record: error compares runs at their first reversal, behind which"),
    "an error asked for of later reversals": (
     PRESET + "record: [reversals]\nintegrator: {accuracy: {t_r: 1e-6}}\n",
     "c.yaml:3:1: record: integrator.accuracy of t_r compares runs at their first reversal,"),
    "later reversals and an early end": (
     PRESET + "record: [reversals]\nclassify: {early: true}\n",
     "c.yaml:3:1: record: reversals are those of a run up to its horizon, and classify.early"),
    "draw of another kind": (drawn("draw: halton"),
     'c.yaml:1:22: bodies.draw: "halton" is not one of random, sobol, saltelli; choose one'),
    "even draws of a target": (drawn("draw: sobol, target: {K_r: 0.1}"),
     "c.yaml:1:35: bodies.target: bodies that are redrawn until they meet a target do not fill"),
    "too many even draws": (drawn("draw: sobol, samples: 2000000000"),
     "c.yaml:1:22: bodies.draw: the sequence has 1073741824 points; take fewer samples"),
    "stop at nothing": (stop("{}"),
     "c.yaml:2:1: stop: neither fraction nor t_r is given; give one of them, or both"),
    "stop at any fraction": (stop("{fraction: 0.7}"),
     "c.yaml:2:8: stop.fraction: 0.7 is out of range; it must be below 0.5"),
    "stop at no error": (stop("{t_r: 0}"),
     "c.yaml:2:8: stop.t_r: 0 is out of range; it must be above 0"),
    "stop at a stranger": (stop("{frac: 0.1}"),
     'c.yaml:2:8: stop.frac: unknown key "frac"; did you mean "fraction"?'),
    "stop at a number": (stop("0.1"),
     "c.yaml:2:1: stop: 0.1 is given here; write a mapping"),
    "stop where nothing is drawn": (PRESET + "stop: {fraction: 0.1}\n",
     "c.yaml:3:1: stop: bodies of source preset are no samples of which there could be more;"),
    "refine no level": (refine("{levels: 0}"),
     "c.yaml:1:118: bodies.refine.levels: 0 is out of range; it must be at least 1"),
    "refine by a stranger": (refine("{levels: 4, by: typ}"),
     'c.yaml:1:129: bodies.refine.by: "typ" is not one of type, t_r, n_end, '),
    "refine any bend": (refine("{tol: 2}"),
     "c.yaml:1:118: bodies.refine.tol: 2 is out of range; it must be below 1"),
    "refine misspelt": (refine("{level: 2}"),
     'c.yaml:1:118: bodies.refine.level: unknown key "level"; did you mean "levels"?'),
    "refine by a number": (refine("4"),
     "c.yaml:1:109: bodies.refine: 4 is given here; write a mapping"),
    "horizon without end": (changed("t_rgh: 5", "t_rgh: 1e300"),
     "c.yaml:13:11: horizon.t_rgh: 1e+300 is out of range; it must be at most 1e+30"),
    "no horizon": (changed("t_rgh: 5", ""),
     "c.yaml:13:1: horizon: neither t_rgh nor t is given; give one of them, or both"),
    "name with a slash": (changed("name: steady-kr-quick", "name: a/b"),
     "c.yaml:1:1: name: the name has a slash or a control character; write a plain word"),
    "axis out of limits": (GRID.replace("0.99, 200", "1.0, 200"),
     "c.yaml:1:51: bodies.axes.theta: the value 1 is out of range; it must be below 1"),
    "axis of no base": (GRID.replace("phi: [0.02", "f_sd: [0.02"),
     "c.yaml:1:44: bodies.axes: f_sd cannot vary over this base; f_sd is for a shell-dumbbell"),
    "axis with one value too many": (GRID.replace("0.99, 200", "0.99, 2.5"),
     "bodies.axes.theta.linspace: n is 2.5; it must be a whole number from 1 to 1000000"),
    "two skew angles": (SHELL.replace("xi_deg: -3", "xi_deg: -3, xi: -0.1"),
     "bodies.base: both xi and xi_deg are given; keep one of them"),
    "alias": ("a: &x [1, 2]\nb: *x\n",
     "c.yaml:2:4: b: aliases (*name) are not supported; write the value out"),
    "tag": (changed("seed: 2017", "seed: !!int 7"), "c.yaml:2:7: seed: tags (!name) are not"),
    "tab": ("bodies:\n\tsource: sd\n", "c.yaml:2:1: a tab found where YAML requires spaces"),
    "syntax": ("a: [1, 2\nb: 3\n", "c.yaml:2:2: not valid YAML ("),
    "YAML 1.1": ("%YAML 1.1\n---\n" + EXAMPLE, "c.yaml:2:1: the %YAML line asks for another"),
    "two documents": (EXAMPLE + "---\na: 1\n", "c.yaml:18:1: a second YAML document begins; keep"),
    "empty": ("# nothing\n", "c.yaml:1:1: the file is empty; it needs at least bodies and spin"),
    "a list": ("- 1\n", "c.yaml:1:1: a list found where a mapping is needed; write key: value"),
    "endless": ("record: [" + "1, " * 30_000 + "]",
     "c.yaml:1:60001: more than 20000 keys and values up to here; a config is a short YAML"),
    "deep": ("a: " + "[" * 500, "more than 30 levels are nested"),
    "escape": ('a: "\\UFFFFFFFF"\n', "the text is not valid YAML (OverflowError"),
    "control character": ("a: 1\nb: \x01\n", "c.yaml:2:4: the character U+0001 is not allowed"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_config_is_told_where_what_and_what_instead(name: str, tmp_path: Path) -> None:
    text, expected = BAD[name]
    lines = messages(write(tmp_path, text))
    # One mistake makes one message; an alias needs an anchor, and that text has no bodies as well.
    assert len(lines) == 1 or name == "alias"
    assert any(expected in line for line in lines), lines
    for line in lines:
        assert line.startswith("c.yaml:")
        assert ";" in line


def test_all_mistakes_are_told_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = changed("seed: 2017", "seed: x").replace("tol: 1e-9", "tol: 5")
    text = text.replace("gamma: [5, 15]", "gamma: [15, 5]").replace("model: full", "seed: 1")
    places = [line.split(":")[1] for line in messages(write(tmp_path, text))]
    assert places == ["2", "6", "12", "14"]


def test_many_mistakes_are_counted(tmp_path: Path) -> None:
    keys = "".join(f"zzz{i}: 1\n" for i in range(50))
    lines = messages(write(tmp_path, EXAMPLE.replace("seed: 2017", "seed: x") + keys))
    assert len(lines) == 21
    assert lines[0].startswith("c.yaml:2:1: seed: ")
    assert lines[1].startswith('c.yaml:18:1: zzz0: unknown key "zzz0"; the keys allowed here are')
    assert lines[19].startswith("c.yaml:36:1: zzz18: ")
    assert lines[20] == "c.yaml: and 31 more; fix these first"
    repeated = messages(write(tmp_path, EXAMPLE + "seed: 1\n" * 30 + keys))
    assert repeated[-1] == "c.yaml: and 60 more; fix these first"
    assert repeated[0].startswith("c.yaml:18:1: seed: the key is repeated")


def test_errors_of_others_get_the_place_of_their_key(tmp_path: Path) -> None:
    path = write(tmp_path, EXAMPLE)
    config = load_config(path, ["spin.psi=pitch"])
    for message, place in {
        "bodies.target.K_r: no": f"{path}:7:12: bodies.target.K_r: no",
        "bodies.target.max_draws: no": f"{path}:7:3: bodies.target.max_draws: no",
        "spin.omega_xy0[1]: no": f"{path}:10:22: spin.omega_xy0[1]: no",
        "spin.psi: no": "--set spin.psi=pitch: spin.psi: no",
        "bodies.path: a.csv: row 1: no": f"{path}:3:1: bodies.path: a.csv: row 1: no",
        "steady: it holds runs": "steady: it holds runs",
        "no key at all": "no key at all",
    }.items():
        with pytest.raises(ConfigError) as caught, config.model_copy().locating():
            raise ConfigError(message)
        assert caught.value.messages == [place]
    with pytest.raises(ConfigError) as caught, parse_config(resolved(config)).locating():
        raise ConfigError("seed: no")
    assert caught.value.messages == ["seed: no"]


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("bodies.samples", "is not KEY=VALUE; write it as in bodies.samples=10"),
        ("=3", "is not KEY=VALUE; write it as in bodies.samples=10"),
        ("bodies..samples=3", "is not KEY=VALUE; write it as in bodies.samples=10"),
        ("bodies.samples=-1", "bodies.samples: -1 is out of range; it must be at least 1"),
        ("bodies.sampels=1", 'bodies.sampels: unknown key "sampels"; did you mean "samples"?'),
        ("spin.n_i.x=1", "spin.n_i is not a mapping; set it as a whole"),
        ("seed=[1", "seed: not valid YAML (expected ',' or ']', but got the end of the text"),
        ("seed=.inf", "seed: .inf is not a finite number of 64 bits; write one below 1.8e308"),
    ],
)
def test_a_bad_set_is_named_in_place_of_a_line(
    override: str, expected: str, tmp_path: Path
) -> None:
    lines = messages(write(tmp_path, EXAMPLE), (override,))
    assert lines[0].startswith(f"--set {override}: {expected}")
    assert len(lines) == 1


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert "there is no such file" in messages(tmp_path / "no.yaml")[0]
    assert "is a directory" in messages(tmp_path)[0]
    path = tmp_path / "c.yaml"
    path.write_bytes(b"name: caf\xe9\n")
    assert messages(path) == [
        "c.yaml:1:10: byte 0xe9 is not UTF-8 text; a config is a YAML file in UTF-8"
    ]
    path.write_bytes(b"# " + b"x" * 2_000_000)
    assert "is larger than 250 kB" in messages(path)[0]
    path.write_bytes(b"\xef\xbb\xbf" + EXAMPLE.encode())
    assert load_config(path).seed == 2017


def test_python_data_is_refused_without_file_or_line() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_config({"bodies": {"source": "sd", "samples": float("nan")}, "spn": 1})
    assert caught.value.messages == [
        "bodies.samples: nan is not a finite number of 64 bits; write one below 1.8e308",
        'spn: unknown key "spn"; did you mean "spin"?',
    ]
    with pytest.raises(ConfigError, match="give a dict"):
        parse_config([])  # type: ignore[arg-type]
    endless: dict[str, object] = {}
    endless["a"] = endless
    with pytest.raises(ConfigError, match="nested too deeply"):
        parse_config(endless)


# -- the schema ---------------------------------------------------------------------------------


def test_the_schema_is_one_and_describes_every_key() -> None:
    schema = config_json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    json.dumps(schema)

    def described(node: dict[str, object]) -> bool:
        inner = [n for n in node.get("anyOf", []) if isinstance(n, dict)]  # type: ignore[attr-defined]
        return "description" in node or any("description" in n for n in inner)

    models = {"Config": schema, **schema["$defs"]}
    for name, model in models.items():
        assert model["description"], name
        assert model["additionalProperties"] is False
        for key, node in model["properties"].items():
            assert described(node), f"{name}.{key}"
    assert "rk4" in schema["$defs"]["Integrator"]["properties"]["method"]["enum"]


@pytest.mark.parametrize(
    "changes",
    [
        {"bodies": {"source": "sdd"}},
        {"sede": 3},
        {"launch": {"omega": [0, 1]}},
        {"integrator": {"method": "euler"}},
        *({"integrator": {"accuracy": "draft", **other}}
          for other in ({"method": "rk4"}, {"tol": 1e-9}, {"dt": 0.1})),
        *({"integrator": {"accuracy": {"t_r": 1e-6}, **other}}
          for other in ({"method": "rk4"}, {"tol": 1e-9}, {"dt": 0.1})),
        {"integrator": {"accuracy": {"t_r": 0.1}}},
    ],
)  # fmt: skip
def test_the_schema_refuses(changes: dict[str, object]) -> None:
    validator = jsonschema.Draft202012Validator(config_json_schema())
    good = {"bodies": {"source": "sd"}, "integrator": {"accuracy": "draft"}}
    assert validator.is_valid(good)
    assert not validator.is_valid(good | changes)


def test_reading_a_config_loads_nothing_heavy() -> None:
    code = (
        "import sys, rattlesweep.sweeps.config.load;"
        "print([m for m in ('numpy', 'numba', 'scipy', 'pandas', 'pyarrow') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


# -- hashes that stay; their values are kept in tests/net ----------------------------------------

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))


class _Wind(Base):
    speed: float = 0.0
    gust: float = 0.0


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_a_key_that_is_added_changes_no_hash_while_it_has_its_default(path: Path) -> None:
    """On every level: a number, a word, a mapping of its own."""
    integrator = create_model("Integrator", __base__=Integrator, safety=(float, 0.9))
    later = create_model(
        "Config",
        __base__=Config,
        integrator=(integrator, Field(default_factory=integrator)),
        ground=(str, "flat"),
        wind=(_Wind, Field(default_factory=_Wind)),
    )
    today = load_config(path)
    data = resolved(today)
    for given in ({}, {"ground": "flat"}, {"wind": {"speed": 0.0}}):
        assert physics_hash(later.model_validate(data | given)) == physics_hash(today)
    others = [
        {"ground": "rough"},
        {"wind": {"speed": 0.1}},
        {"wind": {"gust": 0.1}},
        {"integrator": data["integrator"] | {"safety": 0.8}},
    ]
    hashes = {physics_hash(later.model_validate(data | given)) for given in others}
    assert len(hashes - {physics_hash(today)}) == len(others)
