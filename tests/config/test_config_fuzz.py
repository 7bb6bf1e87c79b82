"""Randomly damaged configs are either planned or refused with a plain message."""

import random
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from sweeping import HEAD, ROW

from configs import GOOD
from rattlesweep.config.body_sources import SdSource
from rattlesweep.config.read import load_config
from rattlesweep.design.plan import make_plan
from rattlesweep.design.plausible import check_physics
from rattlesweep.words.errors import ConfigError

JARGON = (
    "Traceback",
    "pydantic",
    "ruamel",
    "http",
    "<class",
    "object at",
    "<text>",
    "<other>",
)
TEXTS = [
    *GOOD.values(),
    GOOD["sd"].replace("  target:", "  # target:"),
    "bodies:\n  source: table\n  path: t.csv\n"
    "spin: {n_i: [0.1, -0.1], omega_xy0: 0.01}\n"
    "model: reduced\nintegrator: {accuracy: draft}\nseed: 3\n",
    "bodies:\n  source: grid\n  base:\n    preset: GH\n  axes:\n    theta:\n"
    "      linspace: [0.6, 0.9, 1000]\n    phi:\n      logspace: [0.01, 0.1, 1000]\n"
    "spin:\n  n_i:\n    - 0.1\n    - -0.1\n  omega_xy0: 1e-3\nseed: 7\n",
]
KEYS = sorted(
    {*re.findall(r"[A-Za-z_]\w*(?=:)", " ".join(TEXTS)), "alpha", "K_p", "xi"}
)
WILD = [
    *(
        "",
        "~",
        "null",
        "true",
        "no",
        "0",
        "-0",
        "-0.0",
        "1e308",
        "1e-308",
        "5e-324",
        "1e999",
    ),
    *(".nan", ".inf", "-.inf", "9223372036854775807", "9223372036854775808", "1e15"),
    *("1000000000000", "0x7f", "0o17", "0b2", "1_000", "1e3", "+1.", ".5", "12:30:45"),
    *("2001-12-14", "2001-12-14t21:59:43Z", '"1"', "'x", '"\\U0001F600"', '"\\uD800"'),
    *(
        '"\\x00"',
        "\u00e9",
        "\u2028",
        "\u202e",
        "\u65e5\u672c",
        "\U0001f600",
        "*a",
        "&a 1",
        "&a",
    ),
    *(
        "!!int 1",
        "!x",
        "!!int x",
        "!!python/object:os.system x",
        "!!binary aGk=",
        "<<: *a",
    ),
    *(
        "{<<: {a: 1}}",
        "{}",
        "[]",
        "[[]]",
        "{a: {b: {c: 1}}}",
        "[1, 2",
        "{a: 1",
        "]",
        "? a",
        "- 1",
    ),
    *(
        "|",
        ">",
        "| \n  a\n",
        "@",
        "`",
        "%",
        "#",
        "a: b: c",
        "a #b",
        "[" * 40,
        "{a: " * 40,
    ),
    *("[" * 3000, "- " * 2000, "x" * 100_000, "9" * 5000, "[" + "1, " * 5_000 + "1]"),
    *("0." + "1" * 5000, "1e" + "9" * 50),
    *("{linspace: [0, 1, 1000000000000]}", "{linspace: [0.1, 0.2, 1000000]}"),
    *("{linspace: [0.1, 0.1000000001, 1000000]}", "{linspace: [-1e308, 1e308, 3]}"),
    *(
        "{logspace: [1, 0, 3]}",
        "[0.5, 0.5]",
        "[0.1, 0.2]",
        "[0.2, 0.1]",
        "[0, 0]",
        "sd",
        "rk4",
    ),
    *(
        "[1e-300, 1e-299]",
        "[0.999999999, 0.9999999999]",
        "{t: 1e-300}",
        "{t_rgh: 1e300}",
    ),
    *("{method: rk4, dt: 1e-300}", "{method: rk4, dt: 1e300}"),
]
KINDS = [*3 * ["number"], *2 * ["value"], "key", "twice", "drop", "more", "alien"]


def mutated(pick):
    """Return one of the good configs with one to four changes."""
    text = pick.choice(TEXTS)
    for _ in range(pick.choice([1, 1, 1, 2, 2, 3, 4])):
        lines = text.split("\n")
        place = pick.randrange(len(lines))
        words = list(re.finditer(r"(?<!\w)[A-Za-z_]\w*+(?=:)", text)) or [
            re.match("", text)
        ]
        found = (
            list(re.finditer(r"(?<=: )[^,}\]\n]+|(?<=[\[ ])[-\d.e]+", text)) or words
        )
        word = pick.choice(words)
        value = pick.choice(found)

        def put(new, at, text=text):
            return text[: at.start()] + new + text[at.end() :]

        match pick.choice(KINDS):
            case "number" if re.fullmatch(r"-?\d*\.?\d+(e-?\d+)?", value[0]):
                text = put(
                    f"{float(value[0]) * 10 ** pick.uniform(-1.5, 1.5):.3g}", value
                )
            case "value":
                text = put(pick.choice(WILD), value)
            case "key":
                key = word[0]
                i = pick.randrange(len(word[0]) + 1)
                near = [
                    key[:i] + key[i + 1 :],
                    key[:i] + "x" + key[i:],
                    key.upper(),
                    key[::-1],
                ]
                text = put(pick.choice(KEYS + near), word)
            case "twice":
                text = "\n".join([*lines[:place], lines[place], *lines[place:]])
            case "drop":
                text = "\n".join([*lines[:place], *lines[place + 1 :]])
            case "more":
                text += f"{pick.choice([*KEYS, 'zzz', *WILD])}: {pick.choice(WILD)}\n"
            case "alien":
                text = put(f"{pick.choice(KEYS)}: {value[0]}, {word[0]}", word)
    return text.encode("utf-8", "surrogatepass")


def in_plain_words(lines, path):
    assert 0 < len(lines) <= 21
    for line in lines:
        assert line.startswith((str(path), "--set ", "and ")), lines
        assert line.isprintable(), line
        assert len(line) < 700, line
        # Words of the config, which may be anything, stand in quotes.
        unquoted = "".join(line.split('"')[::2])
        assert not any(word in unquoted for word in JARGON), line
        line.encode()


@pytest.fixture(scope="module")
def directory():
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "t.csv").write_text(f"{HEAD}\n{ROW}\n")
        yield Path(name)


def refused(path, *overrides):
    """Plan a config; return whether it was refused."""
    lines = []
    try:
        config = load_config(path, overrides)
        # As in `checked_plan`, but without the sampler, which may take long for a
        # target.
        with config.locating():
            plan = make_plan(config, path.parent)
        warnings = check_physics(plan)
        assert plan.runs > 0
        if not (isinstance(config.bodies, SdSource) and config.bodies.target):
            assert len(plan.source.bodies(np.nan, np.arange(1)).theta) == 1
    except ConfigError as error:
        lines = error.messages
    if lines or warnings:
        in_plain_words(lines or warnings, path)
    return bool(lines)


@pytest.mark.parametrize(
    ("start", "count"), [(2200, 50), pytest.param(0, 6000, marks=pytest.mark.slow)]
)
def test_changed_configs(directory, start, count):
    path = directory / "c.yaml"
    told = 0
    for number in range(start, start + count):
        pick = random.Random(number)
        path.write_bytes(mutated(pick))
        key = pick.choice(
            [*KEYS, "bodies.samples", "spin.n_i", "horizon.t", "integrator.tol"]
        )
        sets = [f"{key}{pick.choice(['=', '', ' = ', '.x='])}{pick.choice(WILD)}"]
        try:
            told += refused(path, *sets[: number % 8 == 0])
        except Exception as error:
            told_by = f"config {number}, --set {sets}: {path.read_bytes()[:3000]!r}"
            raise AssertionError(told_by) from error
    # A test needs both, accepted and refused configs.
    assert count / 3 < told < count * 9 / 10
