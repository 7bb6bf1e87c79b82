"""Valid configs, changed at random: each is planned, or refused in sentences that name the file.

``-m slow`` takes thousands of them.
"""

from __future__ import annotations

import random
import re
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st
from test_config import EXAMPLE, GRID, PRESET, SHELL
from test_run import invoke

from rattlesweep.errors import ConfigError
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.config.bodies import SdSource
from rattlesweep.sweeps.config.load import load_config
from rattlesweep.sweeps.sense.sense import check_physics

GH = "alpha,beta,gamma,theta,phi,xi\n13.04,1.522,12.28,0.6429,0.036,-0.03\n"
GOOD = {
    "target": EXAMPLE,
    "sd": EXAMPLE.replace("  target:", "  # target:"),
    "preset": PRESET,
    "grid": GRID,
    "shell": SHELL,
    "table": "bodies:\n  source: table\n  path: t.csv\nspin: {n_i: [0.1, -0.1], omega_xy0: 0.01}\n"
    "model: reduced\nintegrator: {accuracy: draft}\nseed: 3\n",
    "long": "bodies:\n  source: grid\n  base:\n    preset: GH\n  axes:\n    theta:\n"
    "      linspace: [0.6, 0.9, 1000000]\n    phi:\n      logspace: [0.01, 0.1, 1000000]\n"
    "spin:\n  n_i:\n    - 0.1\n    - -0.1\n  omega_xy0: 1e-3\nblock_size: 7\n",
}
KEYS = sorted(set(re.findall(r"[A-Za-z_]\w*(?=:)", " ".join(GOOD.values()))))
WILD = [
    *("", "~", "null", "true", "no", "0", "-0", "-0.0", "1e308", "1e-308", "5e-324", "1e999"),
    *(".nan", ".inf", "-.inf", "9223372036854775807", "9223372036854775808", "1e15"),
    *("1000000000000", "0x7f", "0o17", "1_000", "1e3", "+1.", ".5", "12:30:45", "2001-12-14"),
    *("2001-12-14t21:59:43Z", '"1"', "'x", '"\\U0001F600"', '"\\uD800"', '"\\x00"', "\u00e9"),
    *("\u2028", "\u202e", "\u65e5\u672c", "\U0001f600", "*a", "&a 1", "&a", "!!int 1", "!x"),
    *("!!python/object:os.system x", "!!binary aGk=", "<<: *a", "{<<: {a: 1}}", "{}", "[]", "[[]]"),
    *(
        "{a: {b: {c: 1}}}",
        "[1, 2",
        "{a: 1",
        "]",
        "? a",
        "- 1",
        "|",
        ">",
        "| \n  a\n",
        "@",
        "`",
        "%",
    ),
    *("#", "a: b: c", "a #b", "[" * 40, "{a: " * 40, "[" * 3000, "- " * 2000, "x" * 100_000),
    *("9" * 5000, "[" + "1, " * 5_000 + "1]", "0." + "1" * 5000, "1e" + "9" * 50),
    *("{linspace: [0, 1, 1000000000000]}", "{linspace: [0.1, 0.2, 1000000]}"),
    *("{linspace: [0.1, 0.1000000001, 1000000]}", "{linspace: [-1e308, 1e308, 3]}"),
    *("{logspace: [1, 0, 3]}", "[0.5, 0.5]", "[0.1, 0.2]", "[0.2, 0.1]", "[0, 0]", "sd", "rk4"),
    *("[1e-300, 1e-299]", "[0.999999999, 0.9999999999]", "{t: 1e-300}", "{t_rgh: 1e300}"),
    *("{method: rk4, dt: 1e-300}", "{method: rk4, dt: 1e300}"),
]
BYTES = [
    *(
        b"\t",
        b"\x00",
        b"\xef\xbb\xbf",
        b"\xff\xfe",
        b"\xc3",
        b"\xed\xa0\x80",
        b"\x85",
        b"\r",
        b"\r\n",
    ),
    *(b"\x1b[2J", b"---\n", b"...\n", b"%YAML 1.1\n---\n", b"\x7f", b" " * 500, b"#" * 100_000),
    b"\n" * 5000,
]
SECONDS = 2.0


def mutated(pick: random.Random) -> bytes:
    """One of the good configs with one to four changes."""
    text = pick.choice(list(GOOD.values()))
    raw = b""
    for _ in range(pick.choice([1, 1, 1, 2, 2, 3, 4])):
        lines = text.split("\n")
        place = pick.randrange(len(lines))
        line = lines[place]
        kind = pick.randrange(13)
        words = list(re.finditer(r"(?<!\w)[A-Za-z_]\w*+(?=:)", text))
        values = list(re.finditer(r"(?<=: )[^,}\]\n]+|(?<=[\[ ])[-\d.e]+", text))
        if kind == 0 and words:
            word = pick.choice(words)
            old = word[0]
            i = pick.randrange(len(old) + 1)
            new = pick.choice(
                [*KEYS, old[:i] + old[i + 1 :], old[:i] + "x" + old[i:], old.upper(), old[::-1]]
            )
            text = text[: word.start()] + new + text[word.end() :]
        elif kind in (1, 10, 11, 12) and values:
            # Still a number, but another.
            value = pick.choice(values)
            new = value[0]
            if re.fullmatch(r"-?[\d.]+(e-?\d+)?", new) and new.count(".") < 2:
                new = f"{float(new) * 10 ** pick.uniform(-1.5, 1.5):.3g}"
            text = text[: value.start()] + new + text[value.end() :]
        elif kind in (2, 3) and values:
            value = pick.choice(values)
            text = text[: value.start()] + pick.choice(WILD) + text[value.end() :]
        elif kind == 4:
            text = "\n".join([*lines[:place], line, *lines[place:]])
        elif kind == 5:
            text = "\n".join([*lines[:place], *lines[place + 1 :]])
        elif kind == 6:
            rest = lines[:place] + lines[place + 1 :]
            rest.insert(pick.randrange(len(rest) + 1), " " * pick.randrange(5) + line.strip())
            text = "\n".join(rest)
        elif kind == 7:
            text += f"{pick.choice([*KEYS, 'zzz', *WILD])}: {pick.choice(WILD)}\n"
        elif kind == 8 and words and values:
            # One section's key and value in another.
            word, value = pick.choice(words), pick.choice(values)
            text = f"{text[: word.start()]}{pick.choice(KEYS)}: {value[0]}, {text[word.start() :]}"
        else:
            raw = pick.choice(BYTES)
    # The yaml of some wild values is not text, which is what the reader must find out.
    whole = text.encode("utf-8", "surrogatepass")
    if raw == b"\r\n":
        return whole.replace(b"\n", b"\r\n")
    place = pick.choice([0, len(whole), pick.randrange(len(whole) + 1)])
    return whole[:place] + raw + whole[place:]


@pytest.fixture(scope="module")
def directory() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "t.csv").write_text(GH)
        yield Path(name)


def judge(path: Path) -> bool:
    """Plan a config; whether it was refused."""
    start = time.process_time()
    try:
        config = load_config(path)
        # As `checked_plan`, but for the sampler, which may rightly take long for a target.
        with config.locating():
            plan = make_plan(config, path.parent)
        warnings = check_physics(plan)
        assert plan.runs > 0
        if not (isinstance(config.bodies, SdSource) and config.bodies.target):
            assert len(plan.source.bodies(0, plan.runs_of(plan.block(0))[1][:1]).theta) == 1
        lines, refused = warnings, False
    except ConfigError as error:
        lines, refused = error.messages, True
        assert lines
    # Of the processor, and so the same on a busy machine.
    seconds = time.process_time() - start
    assert seconds < SECONDS, (seconds, path.read_bytes()[:2000])
    assert len(lines) <= 21
    for line in lines:
        assert line.startswith(str(path)), line
        assert line.isprintable(), line
        assert len(line) < 700, line
        line.encode()
    return refused


def many(directory: Path, start: int, count: int) -> tuple[int, int]:
    path = directory / "c.yaml"
    refused = 0
    for number in range(start, start + count):
        path.write_bytes(mutated(random.Random(number)))
        try:
            refused += judge(path)
        except Exception as error:
            raise AssertionError(f"config {number}: {path.read_bytes()[:3000]!r}") from error
    return refused, count - refused


def test_hundreds_of_changed_configs(directory: Path) -> None:
    refused, planned = many(directory, 0, 300)
    # Either alone would be no test.
    assert refused > 100
    assert planned > 30


@pytest.mark.slow
def test_thousands_of_changed_configs(directory: Path) -> None:
    refused, planned = many(directory, 1000, 6000)
    assert refused > 2000
    assert planned > 600


def through_the_command(directory: Path, number: int) -> int:
    path = directory / "c.yaml"
    raw = mutated(random.Random(number))
    path.write_bytes(raw)
    target = re.search(rb"^ *target", raw, re.M)
    if target:
        return -1
    result = invoke("run", path, "--dry-run", "--output", directory / "out")
    assert result.exit_code in (0, 2), (number, raw[:2000], result.output)
    assert "Traceback" not in result.output
    lines = result.stderr.splitlines()
    assert bool(lines) or result.exit_code == 0
    for line in lines:
        assert line.startswith(("error: ", "warning: ")), (number, line)
        assert line.isprintable()
    if result.exit_code == 2:
        assert result.stdout == ""
        assert any(line.startswith("error: ") for line in lines)
    assert not (directory / "out").exists()
    return result.exit_code


def test_changed_configs_through_the_command(directory: Path) -> None:
    codes = [through_the_command(directory, number) for number in range(10_000, 10_080)]
    assert {0, 2} <= set(codes)


@pytest.mark.slow
def test_hundreds_of_changed_configs_through_the_command(directory: Path) -> None:
    codes = [through_the_command(directory, number) for number in range(20_000, 21_000)]
    assert {0, 2} <= set(codes)


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@seed(2017)
@given(st.integers(0, 2**32), st.lists(st.sampled_from(WILD + KEYS), min_size=1, max_size=3))
def test_settings_on_top(directory: Path, number: int, values: list[str]) -> None:
    """``--set`` with wild keys and values is refused under its own name, or under the file's."""
    pick = random.Random(number)
    path = directory / "c.yaml"
    path.write_text(pick.choice(list(GOOD.values())), encoding="utf-8")
    places = ["bodies", "spin.n_i", "horizon.t", "integrator", "bodies.ranges.phi", "record"]
    overrides = [f"{pick.choice(places + KEYS)}={value}" for value in values]
    try:
        load_config(path, overrides)
    except ConfigError as error:
        for line in error.messages:
            assert line.startswith(("--set ", str(path))), line
            assert line.isprintable()


@pytest.mark.parametrize(
    "text",
    {
        "keys": "".join(f"k{i}: 1\n" for i in range(25_000)),
        "repeated": "seed: 1\n" * 31_000,
        "numbers": "record: [" + "1.5, " * 49_000 + "1]",
        "infinities": "record: [" + ".inf, " * 40_000 + "1]",
        "spins": f"spin: {{n_i: {list(range(1, 9_000))}, omega_xy0: {list(range(1, 9_000))}}}\n"
        "bodies: {source: sd}\n",
        "comments": "#\n" * 120_000,
        "one line": "name: " + "x" * 249_000,
        "words": "name: " + "x " * 120_000,
        "one key": "x" * 249_000 + ": 1",
        "questions": "? " * 120_000,
        "braces": "{" * 249_000,
        "quotes": 'name: "' + "\\n" * 120_000 + '"',
        "aliases": "a: &a 1\n" + "".join(f"k{i}: *a\n" for i in range(20_000)),
        "flows": "bodies: {" + "a, " * 80_000 + "}",
        "lines of text": "name: |\n" + "  x\n" * 60_000,
        "folded": "name: >\n" + "  x\n" * 60_000,
    }.items(),
    ids=lambda item: item[0],
)
def test_the_largest_of_files_are_refused_in_seconds(
    text: tuple[str, str], directory: Path
) -> None:
    path = directory / "c.yaml"
    path.write_text(text[1])
    assert path.stat().st_size <= 250_000
    assert judge(path)
