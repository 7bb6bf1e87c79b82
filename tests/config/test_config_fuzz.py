"""Whatever is done to a config, it is either planned or refused in plain sentences.

``-m slow`` takes thousands of changed configs.
"""

import json
import random
import re
import tempfile
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML
from sweeping import invoke
from test_config import GOOD

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.load import load_config, parse_config, physics_hash, resolved
from rattlesweep.sweeps.plausible import check_physics

JARGON = ("Traceback", "pydantic", "Input should", "ruamel", "http", "<class", "object at")
QUICK = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
GH = "alpha,beta,gamma,theta,phi,xi\n13.04,1.522,12.28,0.6429,0.036,-0.03\n"
TEXTS = [
    *GOOD.values(),
    GOOD["sd"].replace("  target:", "  # target:"),
    "bodies:\n  source: table\n  path: t.csv\nspin: {n_i: [0.1, -0.1], omega_xy0: 0.01}\n"
    "model: reduced\nintegrator: {accuracy: draft}\nseed: 3\n",
    "bodies:\n  source: grid\n  base:\n    preset: GH\n  axes:\n    theta:\n"
    "      linspace: [0.6, 0.9, 1000000]\n    phi:\n      logspace: [0.01, 0.1, 1000000]\n"
    "spin:\n  n_i:\n    - 0.1\n    - -0.1\n  omega_xy0: 1e-3\nblock_size: 7\n",
]
KEYS = sorted({*re.findall(r"[A-Za-z_]\w*(?=:)", " ".join(TEXTS)), "alpha", "K_p", "xi"})
WILD = [
    *("", "~", "null", "true", "no", "0", "-0", "-0.0", "1e308", "1e-308", "5e-324", "1e999"),
    *(".nan", ".inf", "-.inf", "9223372036854775807", "9223372036854775808", "1e15"),
    *("1000000000000", "0x7f", "0o17", "1_000", "1e3", "+1.", ".5", "12:30:45", "2001-12-14"),
    *("2001-12-14t21:59:43Z", '"1"', "'x", '"\\U0001F600"', '"\\uD800"', '"\\x00"', "\u00e9"),
    *("\u2028", "\u202e", "\u65e5\u672c", "\U0001f600", "*a", "&a 1", "&a", "!!int 1", "!x"),
    *("!!python/object:os.system x", "!!binary aGk=", "<<: *a", "{<<: {a: 1}}", "{}", "[]", "[[]]"),
    *("{a: {b: {c: 1}}}", "[1, 2", "{a: 1", "]", "? a", "- 1", "|", ">", "| \n  a\n", "@", "`"),
    *("%", "#", "a: b: c", "a #b", "[" * 40, "{a: " * 40, "[" * 3000, "- " * 2000, "x" * 100_000),
    *("9" * 5000, "[" + "1, " * 5_000 + "1]", "0." + "1" * 5000, "1e" + "9" * 50),
    *("{linspace: [0, 1, 1000000000000]}", "{linspace: [0.1, 0.2, 1000000]}"),
    *("{linspace: [0.1, 0.1000000001, 1000000]}", "{linspace: [-1e308, 1e308, 3]}"),
    *("{logspace: [1, 0, 3]}", "[0.5, 0.5]", "[0.1, 0.2]", "[0.2, 0.1]", "[0, 0]", "sd", "rk4"),
    *("[1e-300, 1e-299]", "[0.999999999, 0.9999999999]", "{t: 1e-300}", "{t_rgh: 1e300}"),
    *("{method: rk4, dt: 1e-300}", "{method: rk4, dt: 1e300}"),
]  # fmt: skip
BYTES = [
    b"\t", b"\x00", b"\xef\xbb\xbf", b"\xff\xfe", b"\xc3", b"\xed\xa0\x80", b"\x85", b"\r", b"\r\n",
    b"\x1b[2J", b"---\n", b"...\n", b"%YAML 1.1\n---\n", b"\x7f", b" " * 500, b"#" * 100_000,
    b"\n" * 5000,
]  # fmt: skip
# Real keys, so that pieces end up where others are wanted.
keys = st.sampled_from(KEYS)
scalars = (
    st.none() | st.booleans() | st.integers() | st.integers(-2, 3) | st.floats()
    | st.sampled_from([0.5, -0.1, 1e-9, "1e-9", "1_000", "sd", "GH", "rk4", "grid", "relevant"])
    | st.text(max_size=12)
)  # fmt: skip
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(keys | st.text(max_size=5), inner, max_size=4)
    ),
    max_leaves=8,
)


def mutated(pick):
    """One of the good configs with one to four changes."""
    text, raw = pick.choice(TEXTS), b""
    for _ in range(pick.choice([1, 1, 1, 2, 2, 3, 4])):
        lines = text.split("\n")
        place = pick.randrange(len(lines))
        words = list(re.finditer(r"(?<!\w)[A-Za-z_]\w*+(?=:)", text)) or [re.match("", text)]
        values = list(re.finditer(r"(?<=: )[^,}\]\n]+|(?<=[\[ ])[-\d.e]+", text)) or words
        word, value = pick.choice(words), pick.choice(values)
        old = value[0]

        def put(new, at, text=text):
            return text[: at.start()] + new + text[at.end() :]

        kinds = "number number number number value value key twice drop move more alien bytes"
        match pick.choice(kinds.split()):
            case "number" if re.fullmatch(r"-?\d*\.?\d+(e-?\d+)?", old):
                text = put(f"{float(old) * 10 ** pick.uniform(-1.5, 1.5):.3g}", value)
            case "value":
                text = put(pick.choice(WILD), value)
            case "key":
                key, i = word[0], pick.randrange(len(word[0]) + 1)
                near = [key[:i] + key[i + 1 :], key[:i] + "x" + key[i:], key.upper(), key[::-1]]
                text = put(pick.choice(KEYS + near), word)
            case "twice":
                text = "\n".join([*lines[:place], lines[place], *lines[place:]])
            case "drop" | "move" as kind:
                line = lines.pop(place)
                if kind == "move":
                    indent = " " * pick.randrange(5)
                    lines.insert(pick.randrange(len(lines) + 1), indent + line.strip())
                text = "\n".join(lines)
            case "more":
                text += f"{pick.choice([*KEYS, 'zzz', *WILD])}: {pick.choice(WILD)}\n"
            case "alien":
                text = put(f"{pick.choice(KEYS)}: {old}, {word[0]}", word)
            case "bytes":
                raw = pick.choice(BYTES)
    # The yaml of some wild values is not text, which is what the reader must find out.
    whole = text.encode("utf-8", "surrogatepass")
    if raw == b"\r\n":
        return whole.replace(b"\n", b"\r\n")
    place = pick.choice([0, len(whole), pick.randrange(len(whole) + 1)])
    return whole[:place] + raw + whole[place:]


def in_plain_words(lines):
    assert 0 < len(lines) <= 21
    for line in lines:
        assert line.isprintable(), line
        assert len(line) < 700, line
        # What the user wrote may say anything: it stands in quotes, or in front as --set or key.
        own_words = "".join(line.split('"')[::2])
        assert not any(word in own_words for word in JARGON), line
        line.encode()


def check(read):
    """The lines of a refusal, if it is one."""
    try:
        config = read()
    except ConfigError as error:
        in_plain_words(error.messages)
        return error.messages
    data = resolved(config)
    assert resolved(parse_config(json.loads(json.dumps(data, allow_nan=False)))) == data
    assert len(physics_hash(config)) == 64
    return []


@pytest.fixture(scope="module")
def directory():
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "t.csv").write_text(GH)
        yield Path(name)


def judge(path):
    """Plan a config; whether it was refused."""
    try:
        config = load_config(path)
        # As `checked_plan`, but for the sampler, which may rightly take long for a target.
        with config.locating():
            plan = make_plan(config, path.parent)
        lines = check_physics(plan)
        assert plan.runs > 0
        if not (isinstance(config.bodies, SdSource) and config.bodies.target):
            assert len(plan.source.bodies(np.nan, plan.runs_of(plan.block(0))[1][:1]).theta) == 1
        refused = False
    except ConfigError as error:
        lines, refused = error.messages, True
    if lines or refused:
        in_plain_words(lines)
        assert all(line.startswith(str(path)) for line in lines), lines
    return refused


SLOW = pytest.mark.slow


@pytest.mark.parametrize(("start", "count"), [(0, 120), pytest.param(1000, 6000, marks=SLOW)])
def test_changed_configs(directory, start, count):
    path = directory / "c.yaml"
    refused = 0
    for number in range(start, start + count):
        path.write_bytes(mutated(random.Random(number)))
        try:
            refused += judge(path)
        except Exception as error:
            raise AssertionError(f"config {number}: {path.read_bytes()[:3000]!r}") from error
    # Either alone would be no test.
    assert refused > count / 3
    assert count - refused > count / 10


@pytest.mark.parametrize(("start", "count"), [(10_000, 30), pytest.param(20_000, 1000, marks=SLOW)])
def test_changed_configs_and_settings_through_the_command(directory, start, count):
    codes, out = set(), f"output={directory / 'out'}"
    for number in range(start, start + count):
        pick = random.Random(number)
        raw = mutated(pick)
        if re.search(rb"^ *target", raw, re.M):
            continue  # its search takes as long as it is told to
        (directory / "c.yaml").write_bytes(raw)
        key, value = ".".join(pick.sample(KEYS, pick.choice([1, 2]))), pick.choice(WILD)
        sets = [] if pick.random() < 0.6 else ["--set", f"{key}={value}".replace("\x00", "")]
        result = invoke("validate", directory / "c.yaml", "--set", out, *sets)
        lines = result.stderr.splitlines()
        told = (number, raw[:2000], sets, result.output)
        assert result.exit_code in (0, 2), told
        assert all(line.startswith(("error: ", "warning: ")) for line in lines), told
        assert all(line.isprintable() for line in lines), told
        if result.exit_code == 2:
            assert result.stdout == "", told
            assert any(line.startswith("error: ") for line in lines), told
        codes.add(result.exit_code)
    assert codes == {0, 2}
    assert not (directory / "out").exists()


@QUICK
@given(st.sampled_from(TEXTS), st.data())
def test_settings(directory, text, data):
    """``--set`` with wild keys and values is refused under its own name, or under the file's."""
    path = directory / "c.yaml"
    path.write_text(text, encoding="utf-8")
    key = st.lists(keys | st.text(max_size=5), max_size=3).map(".".join)
    value = values.map(lambda v: json.dumps(v, default=str)) | st.sampled_from(WILD) | st.text()
    one = st.tuples(key, st.sampled_from(["=", "", " = "]), value).map("".join)
    overrides = data.draw(st.lists(one | st.text(max_size=20), min_size=1, max_size=4))
    lines = check(lambda: load_config(path, overrides))
    assert all(line.startswith(("--set ", str(path))) for line in lines)


@QUICK
@given(st.binary(max_size=200), st.sampled_from(TEXTS), st.integers(0, 400))
def test_bytes(directory, raw, text, place):
    path, old = directory / "c.yaml", text.encode()
    for content in (raw, old[:place] + raw + old[place:]):
        path.write_bytes(content)
        check(lambda: load_config(path))


def places(data, key=()):
    """Every key of nested data."""
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for name, value in items:
        yield (*key, name)
        if isinstance(value, dict | list):
            yield from places(value, (*key, name))


@QUICK
@given(st.sampled_from(sorted(GOOD.values())), st.data())
def test_broken_data(text, data):
    """Keys dropped, renamed or added, and values of other types, at any depth."""
    config: Any = YAML(typ="safe", pure=True).load(text)
    for _ in range(data.draw(st.integers(1, 3))):
        *outer, last = data.draw(st.sampled_from(list(places(config)) or [("a",)]))
        here = reduce(getitem, outer, config)
        change = data.draw(st.sampled_from(["drop", "rename", "replace", "replace", "add"]))
        if change == "replace" or config == {}:
            here[last] = data.draw(values)
        elif isinstance(here, dict):
            value = here[last] if change == "add" else here.pop(last)
            if change != "drop":
                here[data.draw(keys)] = value
        else:
            here.insert(last, data.draw(values))
    check(lambda: parse_config(config))


LARGE = {
    "keys": "".join(f"k{i}: 1\n" for i in range(25_000)),
    "repeated": "seed: 1\n" * 31_000,
    "numbers": "record: [" + "1.5, " * 49_000 + "1]",
    "infinities": "record: [" + ".inf, " * 40_000 + "1]",
    "spins": "bodies: {source: sd}\nspin: {n_i: %s, omega_xy0: %s}\n" % (2 * ([*range(1, 9_000)],)),
    "comments": "#\n" * 120_000,
    "one word": "name: " + "x" * 249_000,
    "words": "name: " + "x " * 120_000,
    "one key": "x" * 249_000 + ": 1",
    "questions": "? " * 120_000,
    "braces": "{" * 249_000,
    "quotes": 'name: "' + "\\n" * 120_000 + '"',
    "aliases": "a: &a 1\n" + "".join(f"k{i}: *a\n" for i in range(20_000)),
    "flows": "bodies: {" + "a, " * 80_000 + "}",
    "lines of text": "name: |\n" + "  x\n" * 60_000,
    "folded": "name: >\n" + "  x\n" * 60_000,
}
# The others differ little from these.
QUICK_LARGE = ("keys", "repeated", "spins", "comments", "words", "braces", "quotes", "aliases")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in QUICK_LARGE else [SLOW]) for n in LARGE]
)
def test_the_largest_of_files_are_refused_in_seconds(name, directory):
    path = directory / "c.yaml"
    path.write_text(LARGE[name])
    assert path.stat().st_size <= 250_000
    assert judge(path)
