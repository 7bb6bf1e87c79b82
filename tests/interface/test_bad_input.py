"""What is wrong is said in a sentence, with the right exit code, and leaves nothing behind."""

import json
import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sweeping import PROGRAM, invoke, tree
from test_config import GRID, PRESET, changed, variants

HEAD = "alpha,beta,gamma,theta,phi,xi"
GH = "13.04,1.522,12.28,0.6429,0.036,-0.03"
BODIES = f"{HEAD}\n{GH}\n13,1.5,12.3,0.5,0.6,-0.1\n"
TABLE = "bodies: {source: table, path: t.csv}\nspin: {n_i: 0.1, omega_xy0: 0.01}\n"

# One for each place where a config is refused, whose own tests have every message: `test_config`,
# `test_config_physics`, `test_bodies`.
BAD = r"""
sd | model: full | seed: 1 | repeated (first in line 2)
sd | samples: | sampels: | did you mean "samples"?
preset | theta: 0.82 | phi: 0.7 | is not below theta
grid | 0.036] | 0.7] | phi 0.7 is not below theta
grid | theta: {linspace: [0.6, 0.99, 200]}, phi: [0.02, 0.036] | phi: [0.02, 0.7] | phi 0.7 is not below theta
sd | K_r: [0.01, 0.03, 0.1] | K_r: 7, max_draws: 100000 | 7 is out of reach: in 65536 bodies drawn from the ranges
bad rows | t.csv | nowhere.csv | no such file
bad rows | + |  | row 2: phi 0.6 is not below
bad rows | spin: {n_i: 0.1, omega_xy0: 0.01}\n | \n | spin: missing; the table has no
preset | + | model: gh\nrecord: [energy] | no 'energy'
"""  # noqa: E501


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(result, code, words):
    assert (result.exit_code, result.stdout) == (code, ""), result.output
    lines = result.stderr.splitlines()
    assert lines
    for line in lines:
        assert line.startswith("error: ")
        assert line.isprintable()
        assert len(line) < 600
    assert any(words in line for line in lines), lines


@pytest.mark.parametrize(("text", "words"), variants(BAD, **{"bad rows": TABLE}))
def test_a_bad_config_ends_with_2_and_leaves_nothing(text, words, here):
    (here / "c.yaml").write_text(text)
    row = 2 if "row 2" in words else 1
    (here / "t.csv").write_text("\n".join(BODIES.splitlines()[: row + 1]) + "\n")
    before = tree(here)
    told = []
    for command in (["run", "c.yaml"], ["run", "c.yaml", "--dry-run"], ["validate", "c.yaml"]):
        result = invoke(*command)
        refused(result, 2, words)
        told.append(result.stderr)
        assert tree(here) == before
    assert told == [told[0]] * 3
    assert told[0].count("\n") == 1


def test_a_valid_config_is_told_with_its_runs_and_its_warnings(here):
    (here / "c.yaml").write_text(GRID)
    before = tree(here)
    result = invoke("validate", "c.yaml", "--set", "spin.n_i=[0.1, 0.2]")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout == "c.yaml is valid: 2 cases x 400 samples = 800 runs\n"
    result = invoke("validate", "c.yaml", "--set", "horizon.t=3")
    assert result.exit_code == 0
    assert result.stdout == "c.yaml is valid: 1 cases x 400 samples = 400 runs\n"
    assert result.stderr.startswith("warning: --set horizon.t=3: horizon.t: the horizon of 3 is ")
    assert tree(here) == before


WRONG = r"""
run . | is a directory
run c.yaml --set bodies.samples | is not KEY=VALUE
run c.yaml --set integrator.max_steps=0 | 0 is out of range
run c.yaml --set 'bodies={source: sd, samples: 100000000000}' | block_size: 100000000000 runs make 25000000 blocks of 4000 runs, each a file; at
run c.yaml --output '' | --output: the directory has no name
run c.yaml --output o\udcff | --output o\udcff: the name is not UTF-8; give
merge c --output o\udcff | --output o\udcff: the name is not UTF-8; give
classify c.yaml | is not an output directory
run c.yaml --shard 1 | --shard 1: is not I/N; write it as in --shard 0/4
run c.yaml --max-time 3 | --max-time 3: is no length of time
run c.yaml --max-time 0s | --max-time 0s: is out of range
plan c.yaml --budget x | --budget x: is no length of time
plot c --size 7 | --size 7: give width and height in inches
plot c --xlim 3,1 | --xlim 3,1: give the lower and the upper end
plot c --kind mpa | --kind: "mpa" is not one of fractions, times, ratio
plot c -o p.gif | --output p.gif: the name must end in .svg, .png or .pdf
report c -o p.pdf | --output p.pdf: the name must end in .html or .htm
trajectory --method rk5 | not one of dop853, dopri5, verner98, rk4; did you
trajectory --psi up | --psi: "up" is not one of relevant, pitch, roll
trajectory --model ful | --model: "ful" is not one of full, reduced, gh; did
"""  # noqa: E501
USAGE = ("", "run", "run c.yaml --thread", "run c.yaml --threads 100000", "run c.yaml d.yaml",
         "body --xi a")  # fmt: skip


@pytest.mark.parametrize("line", [*WRONG.strip().splitlines(), *USAGE])
def test_wrong_arguments(line, here):
    (here / "c.yaml").write_text(PRESET)
    before = tree(here)
    command, _, words = line.partition(" | ")
    result = invoke(*shlex.split(command.replace(r"\udcff", "\udcff")))
    if words:
        refused(result, 2, words)
    else:
        assert (result.exit_code, result.stdout) == (2, "")
        assert "Usage: " in result.stderr
    assert tree(here) == before


def test_a_config_whose_name_is_not_utf_8(here, monkeypatch):
    name = os.fsdecode(b"c\xff.yaml")
    (here / name).write_text(PRESET + "model: gh\n")
    monkeypatch.setattr(sys, "argv", ["rattlesweep", "run", name, "-q"])
    done = invoke(*sys.argv[1:])
    assert (done.exit_code, done.output) == (0, "")
    (manifest,) = here.glob("out/*/manifest.json")
    assert json.loads(manifest.read_bytes())["command"][2] == r"c\udcff.yaml"


# -- directories that cannot be written --------------------------------------------------------


# name: (a file that is there before, --output, words)
NO_PLACE = {
    "a file": ("file", "file", "a file is in the way"),
    "below a file": ("file", "file/below/deeper", "a file is in the way"),
    "a file for runs": ("out/runs", "out", "a file is in the way"),
    # Not even root can write there.
    "proc": (None, "/proc/rattlesweep/out", "cannot write in /proc/rattlesweep/out: "),
    "sys": (None, "/sys/rattlesweep", "cannot write in /sys/rattlesweep: "),
    "read only": ("locked/x", "locked", "Permission denied"),
}


@pytest.mark.parametrize("name", NO_PLACE)
def test_a_directory_that_cannot_be(name, here):
    file, output, words = NO_PLACE[name]
    if name == "read only" and os.geteuid() == 0:
        pytest.skip("root writes everywhere")
    if name in ("proc", "sys") and not Path("/", name).is_dir():
        pytest.skip("no such file system")
    (here / "c.yaml").write_text(PRESET)
    if file:
        (here / file).parent.mkdir(exist_ok=True)
        (here / file).write_text("precious")
    if name == "read only":
        (here / "locked").chmod(0o500)
    before = tree(here)
    refused(invoke("run", "c.yaml", "--output", output), 1, words)
    assert tree(here) == before


def test_a_manifest_that_is_rebuilt_is_told(here):
    """Disks that are full or refuse, and all ways to damage a manifest: tests/store."""
    (here / "c.yaml").write_text(PRESET + "model: gh\n")
    assert invoke("run", "c.yaml", "--output", "out", "-q").exit_code == 0
    (here / "out" / "manifest.json").write_bytes(b"")
    result = invoke("run", "c.yaml", "--output", "out", "-q")
    assert result.exit_code == 0
    assert "it is rebuilt from the blocks" in result.stderr


def test_the_program_itself_shows_no_traceback(here):
    (here / "c.yaml").write_text(changed("samples: 1000", "samples: many"))
    done = subprocess.run(
        [PROGRAM, "run", "c.yaml"], capture_output=True, text=True, timeout=60, check=False
    )
    words = 'error: c.yaml:5: bodies.samples: "many" (text) is given here; write a whole number\n'
    assert (done.returncode, done.stdout, done.stderr) == (2, "", words)


# -- anything at all ---------------------------------------------------------------------------


NUMBER = st.floats(1e-6, 2) | st.floats(-2, 2) | st.floats(1e-300, 1e300)
GOOD_BODY = st.builds(
    lambda g, f, theta, k, xi: (1 + (1 - f) * g, 1 + f * g, g, theta, theta * k, xi),
    st.floats(1.01, 50), st.floats(0.001, 0.499), st.floats(1e-3, 0.999), st.floats(1e-3, 0.999),
    st.floats(-1.5, -1e-6) | st.floats(1e-6, 1.5),
)  # fmt: skip
GOOD_SPIN = st.floats(-3, 3).filter(bool)


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.sampled_from(["full", "reduced", "gh"]),
    st.tuples(st.lists(GOOD_BODY, min_size=1, max_size=3), GOOD_SPIN, st.floats(1e-12, 3)).map(
        lambda launched: (True, *launched)
    )
    | st.tuples(
        st.just(False), st.lists(st.tuples(*[NUMBER] * 6), min_size=1, max_size=3), NUMBER, NUMBER
    ),
)
def test_any_possible_body_runs_and_others_are_refused(here, model, table):
    """Tables are checked by row; what passes the check is integrated, and no number is not one."""
    possible, bodies, n_i, omega = table
    lines = [HEAD, GH, *(",".join(map(repr, body)) for body in bodies)]
    (here / "t.csv").write_text("\n".join(lines) + "\n")
    (here / "c.yaml").write_text(
        f"bodies: {{source: table, path: t.csv}}\nspin: {{n_i: {n_i!r}, omega_xy0: {omega!r}}}\n"
        f"horizon: {{t: 9}}\nmodel: {model}\nintegrator: {{max_steps: 200000}}\n"
    )
    with tempfile.TemporaryDirectory() as directory:
        result = invoke("run", "c.yaml", "--output", Path(directory) / "out", "-q")
        assert result.exit_code in ((0, 3) if possible else (0, 2, 3))
        if result.exit_code == 2:
            refused(result, 2, "")
            assert not list(Path(directory).iterdir())
