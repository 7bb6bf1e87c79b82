"""Configs: which are accepted, which are refused, and with which messages."""

import json
import os
import pickle
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml

from configs import EXAMPLE, GOOD, changed, variants
from rattlesweep.config import read
from rattlesweep.config.read import load_config, parse_config, physics_hash, resolved
from rattlesweep.config.schema import ACCURACIES
from rattlesweep.config.values import as_written
from rattlesweep.words.errors import ConfigError

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))
SD = {"bodies": {"source": "sd"}, "spin": {"n_i": 0.1, "omega_xy0": 0.01}}


@pytest.fixture
def path(tmp_path):
    """The example as a file."""
    path = tmp_path / "c.yaml"
    path.write_text(EXAMPLE)
    return path


def messages(path, *overrides):
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    return [line.replace(str(path), "c.yaml") for line in caught.value.messages]


@pytest.mark.parametrize(
    "name", [*GOOD, *CONFIGS], ids=lambda name: getattr(name, "stem", name)
)
def test_configs_round_trip_and_fit_the_schema(name, path):
    path.write_text(GOOD[name] if name in GOOD else name.read_text())
    config = load_config(path)
    data = resolved(config)
    again = parse_config(json.loads(json.dumps(data, allow_nan=False)))
    assert list(resolved(again).items()) == list(data.items())
    assert physics_hash(again) == physics_hash(config)
    # Workers receive configs by pickling; equality ignores lines and --set texts.
    sets = ["seed=1", f"seed={config.seed}"]
    assert pickle.loads(pickle.dumps(config)) == config == load_config(path, sets)
    # PyYAML follows YAML 1.1, in which 1e-9 is text.
    assert (
        parse_config({"name": config.name} | yaml.safe_load(path.read_text())) == config
    )
    for plain in (data, read.read_yaml(path.read_text())[0]):
        jsonschema.Draft202012Validator(read.config_json_schema()).validate(plain)


def test_settings_are_yaml_1_2_and_the_last_one_wins(path):
    for text in ("1e-9", '"1e-9"', "0.000_000_001", "+1E-9", "&x 1e-9"):
        assert load_config(path, [f"integrator.tol={text}"]).integrator.tol == 1e-9
    for text, seed in {"017": 17, "0o17": 15, "0x1f": 31, "'7'": 7}.items():
        assert load_config(path, [f"seed={text}"]).seed == seed
    path.write_text(
        EXAMPLE.replace("name: steady-kr-quick\n", "").replace("output: ", "# ")
    )
    config = load_config(
        path, ["bodies.samples=10", "bodies.samples=20", "bodies.target=null"]
    )
    assert (config.bodies.samples, config.bodies.target) == (20, None)
    # Without a name, a sweep is named after its file.
    assert config.directory == "out/c"
    assert load_config(path, ["name=other"]).directory == "out/other"


@pytest.mark.parametrize(("law", "middle"), [("linspace", 0.0505), ("logspace", 0.01)])
def test_values_are_spaced_where_they_can_be(law, middle):
    def spaced(*ends):
        grid = {
            "source": "grid",
            "base": {"preset": "GH"},
            "axes": {"phi": {law: ends}},
        }
        return parse_config({**SD, "bodies": grid}).bodies.varying["phi"]

    assert spaced(0.1, 0.1, 1) == [0.1]
    assert spaced(0.001, 0.1, 3) == pytest.approx([0.001, middle, 0.1], rel=1e-14)
    for ends in (
        (0.1, 0.2, 1),
        (0.1, 0.1, 2),
        (0.1, 0.2),
        (0.1, 0.2, 2.5),
        (0.1, 0.2, np.inf),
    ):
        with pytest.raises(ConfigError, match=r"write .linspace"):
            spaced(*ends)


@pytest.mark.parametrize("unit", ["", " rpm", " sqrt(g/a)"])
def test_a_range_has_the_decimals_that_were_meant(unit):
    """The values are the decimals of exact sums, and the middle of a range is zero."""

    def spaced(law, low, high, count):
        ends = [f"{low}{unit}", f"{high}{unit}", count]
        bodies = {"source": "preset", "name": "KL" if unit else "GH"}
        push = "1 rpm" if unit else 0.01
        spin = {"n_i": {law: ends}, "omega_xy0": push}
        values = parse_config({"bodies": bodies, "spin": spin}).spin.n_i
        return [float(str(as_written(value)).removesuffix(unit)) for value in values]

    for low in range(-10, 11):
        for high in range(low + 1, 11):
            for count in (3, 5, 11):
                exact = [
                    (Decimal(low) * (count - 1 - k) + Decimal(high) * k)
                    / (10 * (count - 1))
                    for k in range(count)
                ]
                assert spaced("linspace", low / 10, high / 10, count) == [
                    float(value) for value in exact
                ]
    assert spaced("logspace", 0.001, 1000, 7) == [0.001, 0.01, 0.1, 1, 10, 100, 1000]


def test_an_empty_setting_is_refused_and_an_empty_name_is_that_of_the_file(path):
    for text in ("seed=", "bodies.samples= ", "name=", "seed=# no"):
        with pytest.raises(ConfigError, match="has no value; give one, or null"):
            load_config(path, [text])
    assert load_config(path, ["seed=null"]).seed == 0
    for text in ("name:\n", "name: null\n"):
        path.write_text(text + GOOD["preset"])
        assert load_config(path).name == path.stem


def test_json_with_characters_beyond_the_first_plane_is_a_config(path):
    data = {"name": "\U0001f600", "output": "out/\U00020bb7", "model": "gh"}
    data |= {"bodies": {"source": "preset", "name": "GH"}}
    data |= {"spin": {"n_i": 0.1, "omega_xy0": 0.01}}
    path.write_text(json.dumps(data))
    assert (load_config(path).name, load_config(path).output) == (
        data["name"],
        data["output"],
    )
    data["spin"]["n_i"] = "1 \ud83d"
    with pytest.raises(ConfigError, match="half of a character"):
        parse_config(data)
    path.write_text(GOOD["preset"] + 'model: "f\\ud83d"\n')
    with pytest.raises(
        ConfigError, match=r"c\.yaml:3: model: the text has half of a character"
    ):
        load_config(path)
    data["spin"]["n_i"] = "1 \U0001f600"
    path.write_text(json.dumps(data))
    with pytest.raises(
        ConfigError, match=r"n_i: \S1 \U0001f600\S has the unit \U0001f600"
    ):
        load_config(path)


def test_values_with_units_stay_as_they_are_written(path):
    path.write_text(GOOD["shape"])
    config = load_config(
        path, ["spin.n_i={linspace: [30 rpm, 90 rpm, 3]}", "horizon.t=20   s"]
    )
    assert config.spin.n_i == pytest.approx([np.pi, 2 * np.pi, 3 * np.pi])
    data = resolved(pickle.loads(pickle.dumps(config)))
    assert data["spin"]["n_i"] == ["30.0 rpm", "60.0 rpm", "90.0 rpm"]
    assert (data["horizon"]["t"], data["bodies"]["mass"]) == ("20 s", ["80 g", "90 g"])


def test_whole_numbers_may_have_exponents_and_one_word_stands_for_a_list(path):
    config = load_config(path, ["bodies.samples=1e5", "seed=2e3", "record=energy"])
    assert (config.bodies.samples, config.seed, config.record) == (
        100_000,
        2000,
        ["energy"],
    )
    assert isinstance(config.bodies.samples, int)
    (line,) = messages(path, "bodies.samples=1.5")
    assert line.endswith("1.5 is given; a whole number is needed")


def test_units_without_a_size_are_refused_before_any_body_is_drawn(path):
    """A target out of reach would take a million draws to notice."""
    sets = ["bodies.target={K_p: [1.0e-9]}", "spin={n_i: 60 rpm, omega_xy0: 1 rpm}"]
    lines = messages(path, *sets)
    assert [line.split(" needs bodies with a size")[0] for line in lines] == [
        f"--set {sets[1]}: spin.n_i: 60 rpm",
        f"--set {sets[1]}: spin.omega_xy0: 1 rpm",
    ]


def test_defaults_are_table_one_and_the_papers_own_step():
    ranges = {
        "gamma": [5, 15],
        "f_sd": [0.05, 0.15],
        "theta": [0.6, 0.95],
        "phi": [0.01, 0.1],
        "minus_xi_deg": [0, 6],
    }
    expected = {
        "name": "sweep",
        "seed": 0,
        "model": "full",
        "horizon": {"t_rgh": 5},
        "record": [],
        "bodies": {"source": "sd", "samples": 1000, "ranges": ranges, "draw": "random"},
        "spin": {"n_i": [0.1], "omega_xy0": [0.01], "psi": "relevant"},
        "dissipation": {
            "sigma": [0],
            "rolling": [0],
            "pivot": [0],
            "creep": [0],
            "viscous": [0],
        },
        "output": "out/sweep",
        "integrator": {"method": "dop853", "tol": 1e-9, "max_steps": 100_000_000},
        "classify": {
            "ss_growth": 1e-3,
            "sw_departure": 0.05,
            "early": False,
            "dead_energy": 0.01,
        },
    }
    # Null means not given; tuples and NumPy's numbers are accepted.
    spin = {"n_i": (np.float64(0.1),), "omega_xy0": np.array([0.01])}
    spelled_out = SD | {"stop": None, "seed": np.int64(0), "spin": spin}
    assert resolved(parse_config(SD)) == resolved(parse_config(spelled_out)) == expected
    assert parse_config({**SD, "integrator": {"method": "rk4"}}).integrator.dt == 0.002


def test_an_accuracy_is_a_method_and_its_tol_or_an_error_that_replaces_tol(path):
    for word, (method, tol) in ACCURACIES.items():
        short = resolved(
            load_config(path, [f"integrator={{accuracy: {word}, max_steps: 7}}"])
        )
        assert short["integrator"] == {"method": method, "tol": tol, "max_steps": 7}
    asked = "integrator={method: verner98, accuracy: {t_r: 1.0e-6}}"
    config = load_config(path, [asked])
    data = resolved(config)
    assert data["integrator"].keys() == {"method", "accuracy", "max_steps"}
    assert (config.integrator.goal, data["record"]) == (1e-6, ["error"])
    assert config.parts == ["error", "tol"]
    # Implied values may be given.
    same = [asked, "record=[error]", "output=" + data["output"]]
    assert parse_config(data) == load_config(path, same)


# A config of `GOOD` | the text to replace, or + to append | the new text | line, key
# and message.
REFUSED = r"""
sd | samples: 1000 | sampels: 1000 | 5: bodies.sampels: unknown key "sampels"; did you mean "samples"?
sd | model: full | zzz: full | 12: zzz: unknown key "zzz"; allowed are name, seed, bodies, stop, launch, spin, model, horizon,
sd | method: dop853, tol: 1e-9 | accuracy: {t_r: 1e-6, tr: 1} | 14: integrator.accuracy.tr: unknown key "tr"; did you mean "t_r"?
sd | model: full | model: redused | 12: model: "redused" is not one of full, reduced, gh; did you mean "reduced"?
sd | source: sd | source: sdd | 4: bodies.source: "sdd" is not one of sd, preset, table, grid, shape, mesh; did you mean "sd"?
sd | method: dop853, tol: 1e-9 | accuracy: drft | 14: integrator.accuracy: "drft" is not one of draft, standard, reference; did you mean "draft"?
preset | bodies: {source: preset, name: GH, overrides: {theta: 0.82}}\n |  | 1: bodies: the key is missing; add it
sd | model: full | seed: 3 | 12: seed: the key is repeated (first in line 2); keep one
preset | omega_xy0: 0.01 | omega_xy0: -1 | 2: spin.omega_xy0: -1 is given; a value of at least 1e-140 is needed
sd | samples: 1000 | samples: many | 5: bodies.samples: "many" is given; a whole number is needed
sd | t_rgh: 5 |  | 13: horizon: no key is given; add one of t_rgh, t, t_decay
sd | gamma: [5, 15] | gamma: [15, 5] | 6: bodies.ranges.gamma: the range is reversed; write [low, high]
sd | theta: [0.6, 0.95] | theta: [0.6, 1.2] | 6: bodies.ranges.theta[1]: 1.2 is given; a value below 1 is needed
sd | minus_xi_deg: [0, 6] | minus_xi_deg: [0, 0] | 6: bodies.ranges.minus_xi_deg: only xi = 0 is possible, which never reverses
sd | n_i: [-0.1, | n_i: [-0.3, | 9: spin.n_i: a value is repeated; give each once
sd | name: steady-kr-quick | name: a/b | 1: name: "a/b" is not a plain word; leave out slashes and control characters
sd | spin: | launch: {omega: [0, 0, -1]}\nspin: | 9: spin: spin and launch are both given; keep one of them
preset | spin: {n_i: -0.1, omega_xy0: 0.01} | launch: {omega: [0, 0, 1], u: [0, 0, 1]} | 2: launch.u: u must be a vector of length 1 with u_z below 0
sd | tol: 1e-9 | dt: 0.1 | 14: integrator.dt: dop853 takes tol alone; leave dt out
sd | method: dop853 | accuracy: draft | 14: integrator.tol: accuracy: draft sets the method and its tol; leave tol out
preset | + | model: gh\nintegrator: {accuracy: {t_r: 1e-6}} | 4: integrator: accuracy {t_r: ...} excludes model gh and record reversals, spectrum or late; keep
sd | samples: 1000 | draw: sobol | 7: bodies.target: only random draws can meet a target; take draw: random
preset | + | stop: {fraction: 0.1} | 3: stop: source preset draws no samples; take source: sd
preset | + | horizon: {t_decay: 3} | 3: horizon.t_decay: it is in units of gamma/sigma, and sigma is 0; give dissipation.sigma
grid | phi: [0.02 | f_sd: [0.02 | 1: bodies.axes: f_sd cannot vary: f_sd stands in place of alpha and beta
grid | {preset: GH} | {preset: GH, phi: 0.1} | 1: bodies.base: give a preset alone, or gamma theta phi xi with alpha beta or with f_sd
shell | xi_deg: -3 | xi_deg: -3, xi: -0.1 | 1: bodies.base: xi, xi_deg and minus_xi_deg exclude each other; keep one
preset | overrides: {theta: 0.82} | surface: ellipsoid | 1: bodies.surface: an ellipsoid needs its vertical semi-axis; give c, such as c: 2
preset | overrides: {theta: 0.82}}\n | c: 2}\nrecord: [lyapunov]\n | 2: record: lyapunov needs paraboloids without dissipation; leave
shape | n_i: [60 rpm, 0.1 sqrt(g/a)] | n_i: 60 mm | 2: spin.n_i: "60 mm" is a length; a spin is needed, such as 60 rpm
shape | n_i: [60 rpm, 0.1 sqrt(g/a)] | n_i: 60 rmp | 2: spin.n_i: "60 rmp" has the unit rmp: 'rmp' is not defined in the unit registry; a spin
shape | n_i: [60 rpm, 0.1 sqrt(g/a)] | n_i: {linspace: [1 rpm, 2 Hz, 3]} | 2: spin.n_i: write {linspace: [low, high, n]} or
sd | horizon: {t_rgh: 5} | horizon: 5 | 13: horizon: 5 is given; a section is needed, such as horizon: {t_rgh: 5}
sd | integrator: {method: dop853, tol: 1e-9} | integrator: rk4 | 14: integrator: "rk4" is given; a section is needed, such as integrator: {method: rk4}
preset | n_i: -0.1 | n_i: fast | 2: spin.n_i: "fast" is not a number; give a number in sqrt(g/a), or one with a unit, such as 60 rpm
preset | n_i: -0.1 | n_i: -0,1 | 2: spin.1: unknown key "1"; if this is a decimal comma, write a decimal point
preset | omega_xy0: 0.01 | omega_xy0: "0,01" | 2: spin.omega_xy0: "0,01" has a decimal comma; write 0.01
shape | n_i: [60 rpm, 0.1 sqrt(g/a)] | n_i: "0,5 rpm" | 2: spin.n_i: "0,5 rpm" has a decimal comma; write 0.5 rpm
sd | rel_tol: 1e-3 | rel_tol: "0,5" | 7: bodies.target.rel_tol: "0,5" is given; write 0.5 with a decimal point
sd | n_i: [-0.1, -0.3, -0.5] | n_i: 60 rpm | 9: spin.n_i: 60 rpm needs bodies with a size; give a number without a unit, or take source: shape, the preset KL,
sd | model: full | samples: 5 | 12: samples: unknown key "samples"; did you mean bodies.samples?
sd | model: full | tol: 1e-8 | 12: tol: unknown key "tol"; did you mean bodies.refine.tol or integrator.tol?
preset | overrides: {theta: 0.82} | samples: 5 | 1: bodies.samples: unknown key "samples" of this source; it goes with source sd or shape
preset | name: GH | name: HG | 1: bodies.name: "HG" is not one of GH, KL; choose one of them
sd | record: [] | record: energies | 16: record: "energies" is not one of energy, contact, windows, lyapunov,
grid | {linspace: [0.6, 0.99, 200]} | [] | 1: bodies.axes.theta: a list is given; it has 0 values, and 1 are needed
preset | + | classify: {early: !!bool yes} | 3: classify.early: "yes" is given; true or false is needed
preset | bodies: | %YAML 1.1\n---\nclassify: {early: on}\nbodies: | 3: classify.early: "on" is given; true or false is needed
preset | + | horizon: !!null 5 | 3: horizon: 5 is given; a section is needed
preset | name: GH | <<: {name: GH} | 1: bodies.<<: YAML 1.2 has no merge keys; write the keys themselves
preset | + | dissipation: {mu: 1e6} | 3: dissipation.mu: 1000000.0 is given; a value below 1e+06 is needed
grid | phi: [0.02, 0.036] | phii: [0.02] | 1: bodies.axes.phii: unknown key "phii"; did you mean "phi"?
grid | theta: { | tetha: { | 1: bodies.axes.tetha: unknown key "tetha"; did you mean "theta"?
shape | width: 30 mm | width: 12 px | 1: bodies.width: "12 px" has the unit px: it would be read as a css pixel
shape | 0.1 sqrt(g/a) | 0.1 | 2: spin.n_i: 0.1 has no unit, and the body has a size; give a spin with its unit, such as 60 rpm, or in units of the body, as in '0.1 sqrt(g/a)'
shape | 0.1 sqrt(g/a) | 0.1 sqrt(a/g) | 2: spin.n_i[1]: "0.1 sqrt(a/g)" is a time; a spin is needed, such as 60 rpm
shape | length: 12cm | length: 12 | 1: bodies.length: 12 has no unit, and the body has a size; give a length with its unit, such as 12 mm
shape | mass: [80 g, 90 g] | mass: [80 g, 90] | 1: bodies.mass[1]: 90 has no unit, and the body has a size; give a mass
shape | height: 12 mm | height: 12 mm, wall: 12 mm | 1: bodies.wall: the wall is not thinner than the stone, which has 12 mm from its middle to its surface; leave wall
shape | skew: -3 deg | skew: 95 deg | 1: bodies.skew: "95 deg" is out of range; from -89.95 to 89.95 deg is allowed
shape | mass: [80 g, 90 g] | mass: 80 g | 1: bodies.samples: no key is a range, so all bodies are equal; leave
"""  # noqa: E501
WHOLE = {
    "bodies: {source: sd}\nspin:\n  n_i: %s\n  omega_xy0: %s\n"
    % (
        2 * (list(range(1, 402)),)
    ): "2: spin: the lists make 160801 cases; at most 100000 are possible",
    "bodies:\n\tsource: sd\n": "2: cannot be read as YAML (found character '\\t' that",
    EXAMPLE + "---\na: 1\n": "18: cannot be read as YAML (but found another document);",
    "# nothing\n": "1: the file holds nothing; write key: value lines",
    "a: &a [*a]\n": "1: cannot be read as YAML (maximum recursion depth",
    "record: ["
    + "1, " * 200_000
    + "]": "1: more than 20000 values; use linspace, logspace or a table",
    "".join(
        f"key{n}: 1\n" for n in range(50_000)
    ): "1: more than 20000 values; use linspace, logspace or a table",
    "a: &a [1,1,1,1,1,1,1,1,1]\n"
    + "".join(
        f"{b}: &{b} [{9 * f'*{a}, '}]\n" for a, b in pairwise("abcdefghi")
    ): "1: cannot be read as YAML (more than 20000 values);",
    "{" * 600: "1: cannot be read as YAML (maximum recursion depth",
}


@pytest.mark.parametrize(("text", "words"), [*variants(REFUSED), *WHOLE.items()])
def test_a_bad_config_is_told_where_and_what(text, words, path):
    path.write_text(text)
    [line] = messages(path)
    assert line.startswith(f"c.yaml:{words}"), line


def test_all_mistakes_are_told_at_once_in_the_order_of_the_file_and_counted(path):
    text = changed("seed: 2017", "seed: x").replace("tol: 1e-9", "tol: 5")
    path.write_text(
        text.replace("gamma: [5, 15]", "gamma: [15, 5]").replace("model:", "seed:")
    )
    lines = [
        line.split(": ")[:2] for line in messages(path, "horizon.t=0", "spin.psi=up")
    ]
    assert lines == [
        ["c.yaml:2", "seed"],
        ["c.yaml:6", "bodies.ranges.gamma"],
        ["c.yaml:12", "seed"],
        ["c.yaml:14", "integrator.tol"],
        ["--set spin.psi=up", "spin.psi"],
        ["--set horizon.t=0", "horizon.t"],
    ]
    path.write_text(EXAMPLE + "".join(f"zzz{i}: 1\n" for i in range(50)))
    lines = messages(path)
    assert len(lines) == 21
    assert lines[20] == "and 30 more"


def test_later_errors_get_the_place_of_their_key(path):
    read = load_config(path, ["spin.psi=pitch"])
    for message, place in (
        ("bodies.target.max_draws: no", f"{path}:7: "),
        ("spin.omega_xy0[1]: no", f"{path}:10: "),
        ("spin.psi: no", "--set spin.psi=pitch: "),
        ("steady: it holds runs", ""),
    ):
        with pytest.raises(ConfigError) as caught, read.locating():
            raise ConfigError(message)
        assert caught.value.messages == [place + message]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("bodies.samples", "is not KEY=VALUE, such as bodies.samples=10"),
        ("spin.n_i.x=1", "n_i is not a mapping; set all of it"),
        (
            "seed=[1",
            "cannot be read as YAML (expected ',' or ']', but got '<stream end>')",
        ),
        (
            "horizon.t=20 kg",
            'horizon.t: "20 kg" is a mass; a time is needed, such as 2.5 s',
        ),
    ],
)
def test_a_mistake_in_a_setting_names_the_setting(override, words, path):
    (line,) = messages(path, override)
    assert line.startswith(f"--set {override}: {words}")


def test_files_and_data_that_cannot_be_read(path):
    assert "No such file or directory" in messages(path.with_name("no.yaml"))[0]
    assert "Is a directory" in messages(path.parent)[0]
    pipe = path.with_name("pipe.yaml")
    os.mkfifo(pipe)
    assert ": it is not a regular file; give the path of a config" in messages(pipe)[0]
    zeros = path.with_name("zeros.yaml")
    zeros.symlink_to("/dev/zero")
    assert "it is not a regular file" in messages(zeros)[0]
    path.write_text("# " + "x" * 1_000_000)
    assert messages(path)[0].startswith("c.yaml: it is larger than 1 MB; give")
    path.write_bytes(b"name: x\nname: caf\xe9\n")
    assert "can't decode byte 0xe9" in messages(path)[0]
    path.write_bytes(b"\xef\xbb\xbf" + EXAMPLE.encode())
    assert load_config(path).seed == 2017
    with pytest.raises(ConfigError, match=r'^spn: unknown key "spn"; did you mean'):
        parse_config({**SD, "spn": SD["spin"]})
    with pytest.raises(ConfigError, match="give a dict"):
        parse_config([])
    with pytest.raises(ConfigError, match="the config is not plain data"):
        parse_config({**SD, "seed": 10**5000})
    for number in (f"0x{'f' * 4300}", "9" * 4300, f"-0o{'7' * 5000}"):
        path.write_text(f"seed: {number}\n{EXAMPLE.replace('seed', '# seed')}")
        assert messages(path)[0].startswith("c.yaml:1: seed: ")


def test_the_schema_describes_every_key_and_refuses_what_it_can():
    schema = read.config_json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    for model in (schema, *schema["$defs"].values()):
        assert model["description"]
        assert model["additionalProperties"] is False
        assert all(node["description"] for node in model["properties"].values())
    validator = jsonschema.Draft202012Validator(schema)
    assert validator.is_valid(SD)
    bad = (
        {"bodies": {"source": "sdd"}},
        {"sede": 3},
        {"launch": {"omega": [0, 1]}},
        {"integrator": {"method": "euler"}},
        {"integrator": {"accuracy": {"t_r": 0.1}}},
        {"bodies": {"source": "sd", "ranges": {"theta": [0.6, 1.2]}}},
        {"seed": -1},
        {"spin": {"n_i": {"linspce": [1, 2, 3]}, "omega_xy0": 1}},
    )
    assert [changes for changes in bad if validator.is_valid(SD | changes)] == []


def test_the_hash_changes_only_with_the_results_of_a_run(path):
    def hashed(*sets):
        return physics_hash(load_config(path, sets))

    same = (
        "name=x",
        "output=y",
        "classify.ss_growth=0.5",
        "stop={t_r: 0.1}",
        "spin.n_i=[1, 2]",
        "spin.omega_xy0=0.5",
        "bodies.samples=7",
        "bodies.target.K_r=[0.5]",
        "integrator.max_steps=5",
    )
    assert {hashed(change) for change in same} == {hashed()}
    others = (
        "seed=1",
        "integrator.tol=1e-8",
        "record=[energy]",
        "model=gh",
        "classify.early=true",
        "bodies.target={K_p: [0.01]}",
        "bodies.target=null",
        "bodies.target.rel_tol=0.1",
        "dissipation.sigma=0.1",
        "dissipation.rolling=0.1",
        "horizon.t=9",
        "spin.psi=pitch",
        "bodies.ranges.gamma=[5, 6]",
        "bodies.c=3",
    )
    assert len({hashed(), *map(hashed, others)}) == len(others) + 1
    assert hashed("dissipation.sigma=0.1") == hashed("dissipation.sigma=[0, 0.2]")
    assert hashed("record=[energy, contact]") == hashed("record=[contact,energy]")
    grid = "bodies={source: grid, base: {preset: GH}, axes: %s}"
    axes = ("{theta: [0.7], phi: [0.1]}", "{phi: [0.1], theta: [0.7]}")
    assert (
        hashed(grid % axes[0])
        == hashed(grid % axes[1])
        != hashed(grid % "{theta: [0.7]}")
    )


def test_differences_name_keys_and_both_values(path):
    one = load_config(path)
    two = load_config(
        path, ["bodies.samples=10", "integrator={method: rk4, dt: 0.002}"]
    )
    others = [
        'integrator.method: "dop853" against "rk4"',
        "integrator.tol: 1e-09 against not set",
        "integrator.dt: not set against 0.002",
    ]
    every = ["bodies.samples: 1000 against 10", *others]
    assert read.differences(resolved(one), resolved(two)) == every
    assert read.differences(read.fixed_part(one), read.fixed_part(two)) == others


@pytest.mark.parametrize("end", ["\n", "\r", "\r\n", "\x85", "\u2028"])
def test_values_are_counted_whatever_ends_a_line(end, tmp_path, monkeypatch):
    monkeypatch.setattr(read, "MAX_VALUES", 50)
    monkeypatch.setattr(read, "TOO_MANY", "too many values")
    path = tmp_path / "many.yaml"
    items = [f"- 0.{number}" for number in range(60)]
    path.write_bytes(end.join(["n_i:", *items]).encode())
    with pytest.raises(ConfigError, match="too many values"):
        read.load_config(path)
    path.write_bytes(end.join(["n_i:", *items[:40]]).encode())
    with pytest.raises(ConfigError) as refused:
        read.load_config(path)
    assert "too many values" not in str(refused.value)
