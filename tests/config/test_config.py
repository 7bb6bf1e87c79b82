"""Configs: what is accepted, what is refused, and in which words."""

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from pydantic import Field, create_model

from rattlesweep.errors import ConfigError
from rattlesweep.integrate.defaults import MAX_STEPS
from rattlesweep.sweeps.config.schema import Base
from rattlesweep.sweeps.config.schema import ACCURACIES, Integrator
from rattlesweep.sweeps.config.read import (
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
TABLE = "bodies: {source: table, path: bodies.csv}\n"
GOOD = {"sd": EXAMPLE, "preset": PRESET, "table": TABLE, "grid": GRID, "shell": SHELL}
BODY_OF_SD = {"bodies": {"source": "sd"}}


@pytest.fixture
def path(tmp_path):
    """The example as a file."""
    path = tmp_path / "c.yaml"
    path.write_text(EXAMPLE)
    return path


def messages(path, *overrides):
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    assert str(caught.value) == "\n".join(caught.value.messages)
    return [line.replace(str(path), "c.yaml") for line in caught.value.messages]


def changed(old, new, text=EXAMPLE):
    assert old in text
    return text.replace(old, new)


# -- what is accepted ---------------------------------------------------------------------------


def test_the_example_of_the_contract_means_what_it_says(path):
    config = load_config(path)
    assert config.bodies.ranges.minus_xi_deg == [0, 6]
    assert (config.bodies.target.name, config.bodies.target.values) == ("K_r", [0.01, 0.03, 0.1])
    assert config.spin.n_i == [-0.1, -0.3, -0.5]
    assert (config.integrator.tol, config.integrator.dt) == (1e-9, None)
    assert (config.horizon.t_rgh, config.horizon.t) == (5, None)
    assert config.block_size == 4_000


def test_defaults_are_table_one_and_the_papers_own_step():
    found = resolved(parse_config({**BODY_OF_SD, "spin": {"n_i": 0.1, "omega_xy0": 0.01}}))
    ranges = {"gamma": [5, 15], "f_sd": [0.05, 0.15], "theta": [0.6, 0.95], "phi": [0.01, 0.1],
              "minus_xi_deg": [0, 6]}  # fmt: skip
    defaults = {
        "name": "sweep",
        "seed": 0,
        "bodies": {"source": "sd", "samples": 1000, "ranges": ranges},
        "spin": {"n_i": [0.1], "omega_xy0": [0.01], "psi": "relevant"},
        "model": "full",
        "horizon": {"t_rgh": 5},
        "integrator": {"method": "dop853", "tol": 1e-9, "max_steps": 100_000_000},
        "classify": {"ss_growth": 1e-3, "sw_departure": 0.05, "early": False},
        "record": [],
        "block_size": 4_000,
        "output": "out/sweep",
    }
    rk4 = parse_config({**found, "integrator": {"method": "rk4"}}).integrator
    assert (rk4.dt, rk4.tol) == (0.002, None)
    # A key that came later has a default of its own.
    for part in ("bodies", "classify"):
        found[part] = {key: found[part][key] for key in defaults[part]}
    assert {key: found[key] for key in defaults} == defaults


@pytest.mark.parametrize("name", GOOD)
def test_resolved_round_trips_and_fits_the_schema(name, path):
    path.write_text(GOOD[name])
    config = load_config(path)
    data = resolved(config)
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    again = parse_config(json.loads(json.dumps(data, sort_keys=True)))
    assert list(resolved(again).items()) == list(data.items())
    assert physics_hash(again) == physics_hash(config)
    jsonschema.Draft202012Validator(config_json_schema()).validate(data)


@pytest.mark.parametrize("word", ACCURACIES)
def test_an_accuracy_is_another_spelling_of_a_method_and_its_tol(word, path):
    preset = ACCURACIES[word]
    short = load_config(path, [f"integrator={{accuracy: {word}, max_steps: 7}}"])
    spelled = {"method": preset.method, "tol": preset.tol, "max_steps": 7}
    assert short == load_config(path, [f"integrator={json.dumps(spelled)}"])
    assert resolved(short)["integrator"] == spelled
    description = config_json_schema()["$defs"]["Integrator"]["properties"]["accuracy"]
    assert f"{word}: {preset.words}" in description["description"]
    assert f"{preset.p99:.0e}" in preset.words


def test_the_standard_accuracy_is_the_default_and_better_ones_are_better(path):
    path.write_text(changed("integrator: {method: dop853, tol: 1e-9}\n", ""))
    default = load_config(path)
    for same in ("integrator.accuracy=standard", "integrator={accuracy: null, tol: null}"):
        assert load_config(path, [same]) == default
    assert load_config(path, ["integrator={accuracy: draft, tol: null}"]).integrator.tol == 1e-6
    for column in ("tol", "median", "p99"):
        values = [getattr(accuracy, column) for accuracy in ACCURACIES.values()]
        assert values == sorted(values, reverse=True)


@pytest.mark.parametrize("method", ["", "method: dop853, ", "method: verner98, "])
def test_an_error_that_is_asked_for_replaces_tol(method, path):
    asked = f"integrator={{{method}accuracy: {{t_r: 1.0e-6}}}}"
    config = load_config(path, [asked])
    data = resolved(config)
    assert data["integrator"] == {
        "method": config.integrator.method, "accuracy": {"t_r": 1e-6}, "max_steps": MAX_STEPS
    }  # fmt: skip
    assert data["record"] == ["error"]
    assert config.parts == ["error", "tol"]
    jsonschema.Draft202012Validator(config_json_schema()).validate(data)
    # What is implied may be said.
    for same in (parse_config(data), load_config(path, [asked, "record=[error]"])):
        assert physics_hash(same) == physics_hash(config)
    others = ([], ["record=[error]"], [asked.replace("e-6", "e-7")])
    assert len({physics_hash(load_config(path, sets)) for sets in (*others, [asked])}) == 4


@pytest.mark.parametrize("law", ["linspace", "logspace"])
@pytest.mark.parametrize(
    ("ends", "values"),
    [([0.1, 0.1, 1], [0.1]), ([0.1, 0.2, 2], [0.1, 0.2]), ([0.1, 0.2, 1], None),
     ([0.1, 0.1, 2], None), ([0.1, 0.10000000000000002, 2], None), ([0.1, 0.2], None),
     ([0.001, 0.1, 3], {"linspace": [0.001, 0.0505, 0.1], "logspace": [0.001, 0.01, 0.1]})],
)  # fmt: skip
def test_values_are_spaced_where_they_can_be(law, ends, values):
    grid = {"source": "grid", "base": {"preset": "GH"}, "axes": {"phi": {law: ends}}}
    for data in (
        {**BODY_OF_SD, "spin": {"n_i": {law: ends}, "omega_xy0": 0.1}},
        {"bodies": grid, "spin": {"n_i": 1, "omega_xy0": 0.1}},
    ):
        if values is None:
            with pytest.raises(ConfigError, match=r"space|differ|give at least 3"):
                parse_config(data)
            continue
        config = parse_config(data)
        found = config.bodies.axes.values()["phi"] if data["bodies"] is grid else config.spin.n_i
        assert found == (pytest.approx(values[law], rel=1e-15) if len(found) == 3 else values)


def test_the_hash_is_of_the_physics_alone(path):
    def hashed(*sets):
        return physics_hash(load_config(path, sets))

    same = ["name=x", "output=y", "classify.ss_growth=0.5", "spin.psi=relevant", "block_size=5"]
    assert hashed(*same, "classify.early=false") == hashed()
    early = "classify.early=true"
    assert hashed("classify={early: true, ss_growth: 0.5}") == hashed(early)
    others = ("seed=1", "integrator.tol=1e-8", "record=[energy]", "model=gh", early)
    assert len({hashed(), *map(hashed, others)}) == 6
    assert hashed("record=[energy, contact]") == hashed("record=[contact,energy]")
    axes = ("{theta: [0.7], phi: [0.1]}", "{phi: [0.1], theta: [0.7]}")
    grids = [f"bodies={{source: grid, base: {{preset: GH}}, axes: {a}}}" for a in axes]
    assert hashed(grids[0]) == hashed(grids[1])


def test_differences_name_keys_and_both_values(path):
    a = resolved(load_config(path))
    b = resolved(load_config(path, ["bodies.samples=10", "integrator={method: rk4, dt: 0.002}"]))
    assert differences(a, a) == []
    assert differences(a, b) == [
        "bodies.samples: 1000 against 10",
        'integrator.method: "dop853" against "rk4"',
        "integrator.tol: 1e-09 against not set",
        "integrator.dt: not set against 0.002",
    ]


def test_python_data_may_hold_tuples_and_numpy_numbers():
    config = parse_config({
        "bodies": {"source": "sd", "samples": np.int64(7), "ranges": {"gamma": (5, 6)}},
        "spin": {"n_i": np.float64(0.1), "omega_xy0": tuple(np.array([0.1, 0.2]))},
    })  # fmt: skip
    assert config.bodies.samples == 7
    assert config.spin.omega_xy0 == [0.1, 0.2]


def test_set_takes_yaml_values_and_the_last_one_wins(path):
    sets = ["bodies.samples=10", "bodies.samples=20", "spin.n_i=[1e-2, 0.5]", "bodies.target="]
    config = load_config(path, sets)
    assert (config.bodies.samples, config.bodies.target) == (20, None)
    assert config.spin.n_i == [0.01, 0.5]


# -- what is refused ----------------------------------------------------------------------------

# One case of each kind of mistake, and of each message of one key; the limits of every key are in
# tests/net/schema.json.  A config of `GOOD` | what is changed | into what | what is said of it.
REFUSED = r"""
sd | samples: 1000 | sampels: 1000 | 5:3: bodies.sampels: unknown key "sampels"; did you mean "samples"?
sd | model: full | zzz: full | 12:1: zzz: unknown key "zzz"; the keys allowed here are name, seed, bodies, stop, launch
sd | tol: 1e-9 | tolerance: 1e-9 | 14:30: integrator.tolerance: unknown key "tolerance"; did you mean "tol"?
sd | samples: 1000 | theta: [0.6, 0.95] | 5:3: bodies.theta: unknown key "theta" here; it belongs under bodies.ranges
preset | overrides: {theta: 0.82} | theta: 0.82 | 1:36: bodies.theta: unknown key "theta" here; it belongs under bodies.overrides
sd | psi: relevant | model: full | 11:3: spin.model: unknown key "model" here; it belongs at the top level
sd | method: dop853, tol: 1e-9 | accuracy: {tr: 1e-6} | 14:25: integrator.accuracy.tr: unknown key "tr"; did you mean "t_r"?
sd | source: sd | souce: sd | 4:3: bodies.souce: unknown key "souce"; did you mean "source"?
sd | omega_xy0: | omega_xyO: | 10:3: spin.omega_xyO: unknown key "omega_xyO"; did you mean "omega_xy0"?
sd | model: full | model: redused | 12:1: model: "redused" is not one of full, reduced
sd | method: dop853, tol: 1e-9 | method: RK4 | did you mean "rk4"?
sd | psi: relevant | psi: relevent | 11:3: spin.psi: "relevent" is not one of relevant, pitch, roll; did you mean "relevant"?
sd | source: sd | source: sdd | 4:3: bodies.source: "sdd" is not one of sd, preset, table, grid; did you mean "sd"
sd | method: dop853, tol: 1e-9 | accuracy: drft | 14:14: integrator.accuracy: "drft" is not one of draft, standard, reference; did
preset | source: preset, name: GH, overrides: {theta: 0.82} | [a]: 1 | 1:10: bodies: a list, mapping or alias found where a key should be; write a name
preset | source: preset, name: GH, overrides: {theta: 0.82} | samples: 3 | 1:1: bodies.source: the key is missing; it must be one of sd, preset, table, grid
sd | method: dop853, tol: 1e-9 | accuracy: {} | 14:14: integrator.accuracy.t_r: the key is missing; add it
sd | model: full | seed: 3 | 12:1: seed: the key is repeated (first in line 2); keep one of the two
sd | samples: 1000 | samples: many | 5:3: bodies.samples: "many" (text) is given here; write a whole number
sd | samples: 1000 | samples: | 5:3: bodies.samples: nothing (null) is given here; write a whole number
sd | samples: 1000 | samples: 1.5 | 5:3: bodies.samples: 1.5 is given here; write a whole number
sd | classify: {} | classify: [] | 15:1: classify: a list is given here; write a mapping
sd | classify: {} | stop: 0.1 | 15:1: stop: 0.1 is given here; write a mapping
sd | psi: relevant | psi: {} | 11:3: spin.psi: a mapping is given here; write a number
sd | classify: {} | classify: {early: yes} | 15:12: classify.early: "yes" (text) is given here; write true or false
sd | output: out/steady-kr-quick | output: 12 | 17:1: output: 12 is a number; put it in quotes to make it text
sd | method: dop853, tol: 1e-9 | accuracy: 1e-6 | 14:14: integrator.accuracy: 1e-06 is a number; write {t_r: 1e-06} for the error
sd | tol: 1e-9 | tol: "1e-9" | 14:30: integrator.tol: "1e-9" is text; remove the quotes
sd | tol: 1e-9 | tol: .nan | 14:35: integrator.tol: .nan is not a finite number of 64 bits; write one below
sd | 0.001, 0.01, 0.1] | 0.001, 1e999] | 10:22: spin.omega_xy0[1]: 1e999 is not a finite number of 64 bits; write one below
sd | seed: 2017 | seed: 36893488147419103232 | 2:7: seed: the integer 36893488147419103232 does not fit into 64 bits; write
sd | n_i: [-0.1, | n_i: [-1e7, | 9:9: spin.n_i[0]: -10000000.0 is out of range; it must be at least -1000000
sd | 0.01, 0.1]\n | -0.01]\n | 10:22: spin.omega_xy0[1]: -0.01 is out of range; it must be above 0
sd | t_rgh: 5 | t_rgh: 1e300 | 13:11: horizon.t_rgh: 1e+300 is out of range; it must be at most 1e+30
sd | t_rgh: 5 |  | 13:1: horizon: neither t_rgh nor t is given; give one of them, or both
sd | gamma: [5, 15] | gamma: [15, 5] | 6:12: bodies.ranges.gamma: the range [15, 5] is reversed; write [5, 15]
sd | gamma: [5, 15] | gamma: [] | 6:12: bodies.ranges.gamma: the list has 0 values; give at least 2
sd | theta: [0.6, 0.95] | theta: [0.6, 1.2] | 6:61: bodies.ranges.theta[1]: 1.2 is out of range; it must be below 1
sd | phi: [0.01, 0.1] | phi: [0.01, 0.7] | 6:68: bodies.ranges.phi: phi >= theta is possible, as phi goes up to 0.7 and theta down to 0.6; the ranges must not meet
sd | theta: [0.6, 0.95], phi: [0.01, 0.1] | theta: [0.05, 0.5] | 6:3: bodies.ranges.phi: phi >= theta is possible
sd | minus_xi_deg: [0, 6] | minus_xi_deg: [0, 0] | 6:86: bodies.ranges.minus_xi_deg: the range leaves only xi = 0
sd | K_r: [0.01, 0.03, 0.1], rel_tol: 1e-3 | rel_tol: 0.1 | 7:3: bodies.target: neither K_r nor K_p is given; give one of them
sd | n_i: [-0.1, | n_i: [-0.3, | 9:3: spin.n_i: -0.3 is repeated; give each value once
sd | name: steady-kr-quick | name: a/b | 1:1: name: the name has a slash or a control character; write a plain word
sd | spin: | launch: {omega: [0, 0, -1]}\nspin: | 9:1: spin: spin and launch are both given; keep one of them
preset | spin: {n_i: -0.1, omega_xy0: 0.01} | launch: {omega: [0, 1]} | launch.omega: the list has 2 values; give at least 3
preset | spin: {n_i: -0.1, omega_xy0: 0.01} | launch: {omega: [0, 0, 1], u: [0, 0, 1]} | launch.u: u_z is 1; it must be negative, as
preset | spin: {n_i: -0.1, omega_xy0: 0.01} | launch: {omega: [0, 0, 1], u: [0.1, 0, -1]} | launch.u: its length is 1.00499; give a un
preset | spin: {n_i: -0.1, omega_xy0: 0.01} | launch: {omega: [0, 0, 0]} | launch: the body stands upright and at rest; give it an
sd | method: dop853 | method: rk4 | 14:27: integrator.tol: rk4 has steps of one size and takes no tol; leave it out
sd | tol: 1e-9 | dt: 0.1 | 14:30: integrator.dt: dop853 chooses its own steps and takes no dt; leave
sd | dop853, tol: 1e-9 | rk4, accuracy: draft | 14:27: integrator.accuracy: draft stands for a method and its tol, and
sd | method: dop853 | accuracy: {t_r: 1e-6} | 14:37: integrator.tol: accuracy {t_r: 1e-06} stands in its place; keep one of the
sd | method: dop853, tol: 1e-9 | dt: 0.1, accuracy: {t_r: 1e-6} | 14:14: integrator.dt: accuracy {t_r: 1e-06} stands in its place; keep one of the
sd | dop853, tol: 1e-9 | rk4, accuracy: {t_r: 1e-6} | 14:27: integrator.accuracy: rk4 has steps of one size, which follow no error; choose
preset | bodies: {source: preset, name: GH, overrides: {theta: 0.82}}\n |  | 1:1: bodies: the key is missing; say with it where
preset | + | model: gh\nintegrator: {accuracy: {t_r: 1e-6}} | 4:1: integrator: the model gh is a closed form whose t_r has no error to limit;
preset | + | model: gh\nclassify: {early: true} | 4:1: classify: early is for the model full, and the model gh has no stable spin by which a run could be certain to be SS; leave early out
preset | + | record: [reversals, error] | 3:1: record: error compares runs at their first reversal, behind which
preset | + | record: [reversals]\nintegrator: {accuracy: {t_r: 1e-6}} | 3:1: record: integrator.accuracy of t_r compares runs at their first reversal,
preset | + | record: [reversals]\nclassify: {early: true} | 3:1: record: reversals are those of a run up to its horizon, and classify.early
sd | classify: {}\nrecord: [] | classify: {early: true}\nrecord: [lyapunov] | 16:1: record: lyapunov is the exponent of a run up to its horizon, and
sd | samples: 1000 | draw: sobol | 7:3: bodies.target: bodies that are redrawn until they meet a target do not fill
preset | source: preset, name: GH, overrides: {theta: 0.82} | source: sd, draw: sobol, samples: 2000000000 | 1:22: bodies.draw: the sequence has 1073741824 points; take fewer samples
sd | classify: {} | stop: {} | 15:1: stop: neither fraction nor t_r is given; give one of them, or both
preset | + | stop: {fraction: 0.1} | 3:1: stop: bodies of source preset are no samples of which there could be more;
grid | [0.6, 0.99, 200] | [0.6, 0.60000000000001, 1000] | 1000 values from 0.6 to 0.60000000000001 cannot be spaced so that all differ; give
grid | 0.99, 200 | 1.0, 200 | 1:51: bodies.axes.theta: the value 1 is out of range; it must be below 1
grid | phi: [0.02 | f_sd: [0.02 | 1:44: bodies.axes: f_sd cannot vary over this base; f_sd is for a shell-dumbbell
grid | axes: {theta: {linspace: [0.6, 0.99, 200]}, phi: [0.02, 0.036]} | axes: {} | 1:44: bodies.axes: no parameter varies; give at least one axis
grid | 0.036]} | 0.036]}, refine: {levels: 4, by: typ} | bodies.refine.by: "typ" is not one of type, t_r, n_end,
grid | 0.99, 200 | 0.99, 2.5 | bodies.axes.theta.linspace: n is 2.5; it must be a whole number from 1 to 1000000
shell | xi_deg: -3 | xi_deg: -3, xi: -0.1 | bodies.base: both xi and xi_deg are given; keep one of them
sd | seed: 2017 | seed: !!int 7 | 2:7: seed: tags (!name) are not
"""  # noqa: E501
WHOLE = {
    "bodies: {source: sd}\nspin:\n  n_i: %s\n  omega_xy0: %s\n" % (2 * (list(range(1, 402)),)):
        "c.yaml:2:1: spin: 160801 cases (targets x n_i x omega_xy0); at most 100000 are possible",
    "a: &x [1, 2]\nb: *x\n": "c.yaml:2:4: b: aliases (*name) are not supported; write the value",
    "bodies:\n\tsource: sd\n": "c.yaml:2:1: a tab found where YAML requires spaces",
    "a: [1, 2\nb: 3\n": "c.yaml:2:2: not valid YAML (",
    EXAMPLE + "---\na: 1\n": "c.yaml:18:1: a second YAML document begins; keep",
    "# nothing\n": "c.yaml:1:1: the file is empty; it needs at least bodies and spin",
    "- 1\n": "c.yaml:1:1: a list found where a mapping is needed; write key: value",
    "record: [" + "1, " * 30_000 + "]":
        "more than 20000 values up to here; a config is a short YAML file, and long lists of",
    "a: " + "[" * 500: "more than 30 levels are nested",
    'a: "\\UFFFFFFFF"\n': "the text is not valid YAML (OverflowError",
    "a: 1\nb: \x01\n": "c.yaml:2:4: the character U+0001 is not allowed",
}  # fmt: skip


def variants(table, **more):
    """Rows ``config of GOOD | what is changed, or + | into what | ...``: texts, and the rest."""
    found = []
    for line in table.strip().splitlines():
        name, old, new, *rest = line.replace(r"\n", "\n").split(" | ")
        text = (GOOD | more)[name]
        text = text + new + "\n" if old == "+" else changed(old, new, text)
        found.append(pytest.param(text, *rest, id=rest[-1]))
    return found


@pytest.mark.parametrize(("text", "words"), [*variants(REFUSED), *WHOLE.items()])
def test_a_bad_config_is_told_where_what_and_what_instead(text, words, path):
    path.write_text(text)
    lines = messages(path)
    # One mistake makes one message; an alias needs an anchor, and that text has no bodies as well.
    assert len(lines) == 1 or "aliases" in words
    assert any(words in line for line in lines), lines
    assert all(line.startswith("c.yaml:") and ";" in line for line in lines)


def test_all_mistakes_are_told_at_once_in_the_order_of_the_file_and_counted(path):
    text = changed("seed: 2017", "seed: x").replace("tol: 1e-9", "tol: 5")
    path.write_text(text.replace("gamma: [5, 15]", "gamma: [15, 5]").replace("model:", "seed:"))
    assert [line.split(":")[1] for line in messages(path)] == ["2", "6", "12", "14"]
    keys = "".join(f"zzz{i}: 1\n" for i in range(50))
    path.write_text(changed("seed: 2017", "seed: x") + keys)
    lines = messages(path)
    assert len(lines) == 21
    assert lines[0].startswith("c.yaml:2:1: seed: ")
    assert lines[1].startswith('c.yaml:18:1: zzz0: unknown key "zzz0"; the keys allowed here are')
    assert lines[19].startswith("c.yaml:36:1: zzz18: ")
    assert lines[20] == "c.yaml: and 31 more; fix these first"
    path.write_text(EXAMPLE + "seed: 1\n" * 30 + keys)
    repeated = messages(path)
    assert repeated[-1] == "c.yaml: and 60 more; fix these first"
    assert repeated[0].startswith("c.yaml:18:1: seed: the key is repeated")


def test_errors_of_others_get_the_place_of_their_key(path):
    read = load_config(path, ["spin.psi=pitch"])
    in_memory = parse_config(resolved(read))
    for config, message, place in (
        (read, "bodies.target.K_r: no", f"{path}:7:12: bodies.target.K_r: no"),
        (read, "bodies.target.max_draws: no", f"{path}:7:3: bodies.target.max_draws: no"),
        (read, "spin.omega_xy0[1]: no", f"{path}:10:22: spin.omega_xy0[1]: no"),
        (read, "spin.psi: no", "--set spin.psi=pitch: spin.psi: no"),
        (read, "bodies.path: a.csv: row 1: no", f"{path}:3:1: bodies.path: a.csv: row 1: no"),
        (read, "steady: it holds runs", "steady: it holds runs"),
        (read, "no key at all", "no key at all"),
        (in_memory, "seed: no", "seed: no"),
    ):
        with pytest.raises(ConfigError) as caught, config.model_copy().locating():
            raise ConfigError(message)
        assert caught.value.messages == [place]


NO_PAIR = "is not KEY=VALUE; write it as in bodies.samples=10"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("bodies.samples", NO_PAIR),
        ("=3", NO_PAIR),
        ("bodies..samples=3", NO_PAIR),
        ("bodies.samples=-1", "bodies.samples: -1 is out of range; it must be at least 1"),
        ("bodies.sampels=1", 'bodies.sampels: unknown key "sampels"; did you mean "samples"?'),
        ("spin.n_i.x=1", "spin.n_i is not a mapping; set it as a whole"),
        ("seed=[1", "seed: not valid YAML (expected ',' or ']', but got the end of the text"),
        ("seed=.inf", "seed: .inf is not a finite number of 64 bits; write one below 1.8e308"),
    ],
)
def test_a_bad_set_is_named_in_place_of_a_line(override, words, path):
    (line,) = messages(path, override)
    assert line.startswith(f"--set {override}: {words}")


def test_files_that_cannot_be_read(path):
    assert "there is no such file" in messages(path.with_name("no.yaml"))[0]
    assert "is a directory" in messages(path.parent)[0]
    path.write_bytes(b"name: caf\xe9\n")
    assert messages(path) == [
        "c.yaml:1:10: byte 0xe9 is not UTF-8 text; a config is a YAML file in UTF-8"
    ]
    path.write_bytes(b"# " + b"x" * 2_000_000)
    assert "is larger than 250 kB" in messages(path)[0]
    path.write_bytes(b"\xef\xbb\xbf" + EXAMPLE.encode())
    assert load_config(path).seed == 2017


def test_python_data_is_refused_without_file_or_line():
    with pytest.raises(ConfigError) as caught:
        parse_config({"bodies": {"source": "sd", "samples": float("nan")}, "spn": 1})
    assert caught.value.messages == [
        "bodies.samples: nan is not a finite number of 64 bits; write one below 1.8e308",
        'spn: unknown key "spn"; did you mean "spin"?',
    ]
    with pytest.raises(ConfigError, match="give a dict"):
        parse_config([])
    endless = {}
    endless["a"] = endless
    with pytest.raises(ConfigError, match="nested too deeply"):
        parse_config(endless)


# -- the schema ---------------------------------------------------------------------------------


def test_the_schema_is_one_and_describes_every_key():
    schema = config_json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    for name, model in {"Config": schema, **schema["$defs"]}.items():
        assert model["description"], name
        assert model["additionalProperties"] is False
        for key, node in model["properties"].items():
            described = (node, *(n for n in node.get("anyOf", ()) if isinstance(n, dict)))
            assert any("description" in n for n in described), f"{name}.{key}"
    assert "rk4" in schema["$defs"]["Integrator"]["properties"]["method"]["enum"]


def test_the_schema_refuses():
    validator = jsonschema.Draft202012Validator(config_json_schema())
    good = {**BODY_OF_SD, "integrator": {"accuracy": "draft"}}
    assert validator.is_valid(good)
    bad = [{"bodies": {"source": "sdd"}}, {"sede": 3}, {"launch": {"omega": [0, 1]}},
           {"integrator": {"method": "euler"}},
           {"integrator": {"accuracy": {"t_r": 0.1}}}]  # fmt: skip
    for accuracy in ("draft", {"t_r": 1e-6}):
        for other in ({"method": "rk4"}, {"tol": 1e-9}, {"dt": 0.1}):
            bad.append({"integrator": {"accuracy": accuracy, **other}})
    assert [changes for changes in bad if validator.is_valid(good | changes)] == []


# -- hashes that stay; their values are kept in tests/net ----------------------------------------

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))


class _Wind(Base):
    speed: float = 0.0
    gust: float = 0.0


@pytest.mark.parametrize("file", CONFIGS, ids=lambda file: file.stem)
def test_a_key_that_is_added_changes_no_hash_while_it_has_its_default(file):
    """On every level: a number, a word, a mapping of its own."""
    integrator = create_model("Integrator", __base__=Integrator, safety=(float, 0.9))
    later = create_model(
        "Config",
        __base__=Config,
        integrator=(integrator, Field(default_factory=integrator)),
        ground=(str, "flat"),
        wind=(_Wind, Field(default_factory=_Wind)),
    )
    today = load_config(file)
    data = resolved(today)

    def hashed(given):
        return physics_hash(later.model_validate(data | given))

    for same in ({}, {"ground": "flat"}, {"wind": {"speed": 0.0}}):
        assert hashed(same) == physics_hash(today)
    others = ({"ground": "rough"}, {"wind": {"speed": 0.1}}, {"wind": {"gust": 0.1}},
              {"integrator": data["integrator"] | {"safety": 0.8}})  # fmt: skip
    assert len({*map(hashed, others)} - {physics_hash(today)}) == len(others)
