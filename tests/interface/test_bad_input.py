"""What is wrong is said in a sentence, with the right exit code, and leaves nothing
behind.
"""

import shlex
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from refusal import refused
from sweeping import HEAD, ROW, invoke, tree

CONFIG = (
    "bodies: {source: preset, name: GH}\nspin: {n_i: 0.1, omega_xy0: 0.01}\nmodel: gh\n"
)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text(CONFIG)
    (tmp_path / "t.csv").write_text(f"{HEAD}\n{ROW}\n13,1.5,12.3,0.5,0.6,-0.1\n")
    (tmp_path / "s.yaml").write_text("body: {gamma: 3}\nfree: [n_i]\n")
    return tmp_path


WRONG = r"""
run . | Is a directory; give the path of a config
run c.yaml --set nmae=1 | nmae
run c.yaml --set 'bodies={source: table, path: t.csv}' | row 2: phi 0.6 is not bel
run c.yaml --set 'bodies={source: sd, target: {K_r: 7}}' | 7 is out of reach
plan c.yaml --set 'bodies={source: sd, target: {K_r: 7}}' | 7 is out of reach
run c.yaml --set bodies.samples | is not KEY=VALUE
run c.yaml --set integrator.max_steps=0 | 0 is given; a value of at least 1
run c.yaml --set 'bodies={source: sd, samples: 100000000000}' | runs; at most 1e+09 are possible
run c.yaml --output '' | --output: the directory has no name
run c.yaml --scheduler tcp://host:8786 | --scheduler ADDRESS: works only with --executor dask
run c.yaml --shard 1 | --shard 1: is not I/N
run c.yaml --max-time 3 | --max-time 3: is not a duration
classify c.yaml | is not an output directory
status none | none is not an output directory: there is no such
trajectory --method rk5 | is not one of
trajectory --preset GH --output run.xlsx | the name must end in .parquet or .csv
trajectory --preset GH --size 3,2 | --size: there is no figure; add --figure FILE
trajectory --preset GH --style ggplot | --style: there is no figure; add --figure FILE
trajectory --preset GH --figure run.jpg | the name must end in .svg or .png or .pdf
trajectory --preset GH --accuracy draft --tol 1e-7 | --tol: accuracy: draft sets the method and its tol; leave --tol out
trajectory --preset GH --dt-step 0.5 | --dt-step: dop853 takes tol alone; leave --dt-step out
trajectory --preset GH --omega 1,2 | --omega 1,2: has 2 numbers, and 3 are needed, as in 0,0,-1
trajectory --preset GH --omega 1,x,2 | --omega 1,x,2: give 3 numbers from
trajectory --preset GH --omega 0,0,1 --n-i 0.1 | n_i given with a full state
trajectory --preset GH --viscous 99 --pivot 0.001 | --viscous: pivoting is that of a foot
body --preset GH --viscous 99 --pivot 0.001 | --viscous: pivoting is that of a foot
verdict --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 3deg --viscous 2N*s/m --pivot 0.01mm | --viscous: pivoting is that of a foot
body --preset GH --viscous 99 --mu 0.3 | --viscous: with viscous friction the foot slips
rnu | no such command
run | missing argument 'CONFIG' (see `main run --help`)
run c.yaml d.yaml | got unexpected extra argument (d.yaml) (see
body --xi a | invalid value for '--xi': 'a' is not a valid float
verify c -j 99999 | --threads 99999: give a whole number from 1 to 4096
verify c --recompute x | --recompute x: give a whole number from 0
compare c c --allow x | --allow x: give a number from 0 to 1
slurm c.yaml --shards 1 --mem lots | --mem lots: is not a size of memory; write it as in 4G
fit s.yaml t.csv | body: alpha is missing; add it, or give preset, shape, mesh, mass or f_sd
body | --alpha is missing; add it, or give --preset, --half-ellipsoid, --mesh, --mass or --f-sd
body --mass 60g --xi-deg 3 --inertia 2,16,17kg*cm^2 --height 1cm --radii 1,2cm | --xi-deg does not go with --mass; leave one of them out
body --preset GH --mass 60g | --mass does not go with --preset; leave one of them out
body --half-ellipsoid 12cm,3cm,12mm --mass 60g --skew 95deg | skew is 95deg; from -89.95 to 89.95 deg is allowed
body --mass '85 gr' | --mass 85 gr: has the unit gr: it would be read as a grain; a mass is needed, such as 85 g
body --half-ellipsoid 12px,3px,1px --mass 60g | has the unit px: it would be read as a css pixel
trajectory --preset GH --points 0 | points: 0 is given; a whole number of at least 2 is needed
body --preset KL --n-i 60 | --n-i: 60 has no unit, and the body has a size; give a spin with its unit, such as 60 rpm
body --preset KL --n-i 0.1 | --n-i: 0.1 has no unit
trajectory --preset KL --n-i 60rpm --t-end 20 | --t-end: 20 has no unit
trajectory --preset KL --n-i 60rpm --sigma 1e-4 | --sigma: 0.0001 has no unit
trajectory --preset KL --n-i 60rpm --dt 1 | --dt: 1 has no unit
body --half-ellipsoid 12cm,3cm,12mm --mass 60 | --mass 60: has no unit
body --mass 1kg --height 1cm --inertia '2,16,17 kg cm^2' --radii '200,4.5 cm' --c 2 | --c: 2 has no unit
trajectory --preset KL --n-i 60rpm --section n=1 | section: 1 has no unit
trajectory --preset GH --section t=3 | section: t has none: it only grows
trajectory --preset GH --channels '' | --channels: give at least one name
run c.yaml --set 'bodies={source: sd, target: {}}' | neither K_r nor K_p is given
body --mass '12 mm' | --mass 12 mm: is a length; a mass is needed, such as 85 g
body --preset GH --n-i 60rpm | n_i: 60rpm has a unit, but the body has no size
body --mass 1kg --height 1cm --inertia '1,2 kg m^2' | has 2 numbers, not 3 or 4 or 5 or 6
body --preset GH --phi 0.7 | phi 0.7 is not below theta 0.6429
init mine.txt | the name of a config ends in .yaml
"""  # noqa: E501


@pytest.mark.parametrize("line", WRONG.strip().splitlines())
def test_wrong_arguments(line, here):
    before = tree(here)
    command, _, words = line.partition(" | ")
    refused(invoke(*shlex.split(command)), 2, words)
    assert tree(here) == before


def test_a_file_that_cannot_be(here):
    command = invoke(
        "trajectory", "--preset", "GH", "--output", "/proc/nowhere/run.csv"
    )
    refused(command, 1, "cannot write in /proc/nowhere")
    # A folder whose name may be mistyped is not made.
    before = tree(here)
    command = invoke("trajectory", "--preset", "GH", "--figure", "nowhere/run.svg")
    refused(command, 1, "cannot write in nowhere: there is no such folder; make it")
    assert tree(here) == before


@pytest.mark.parametrize(
    ("file", "output", "code", "words"),
    [
        ("file", "file", 2, "file: is a file; give the path of a directory"),
        ("out/runs", "out", 2, "holds other files, such as runs"),
        (None, "/proc/rattlesweep/out", 1, "cannot write in /proc/rattlesweep/out: "),
    ],
)
def test_a_directory_that_cannot_be(file, output, code, words, here):
    if file:
        (here / file).parent.mkdir(exist_ok=True)
        (here / file).write_text("precious")
    refused(invoke("run", "c.yaml", "--output", output), code, words)
    assert not file or (here / file).read_text() == "precious"
    assert not list(here.rglob("manifest.json"))


NUMBER = st.floats(1e-6, 2) | st.floats(-2, 2) | st.floats(1e-300, 1e300)
SHARE = st.floats(1e-3, 0.999)
SKEW = st.floats(-1.5, -1e-6) | st.floats(1e-6, 1.5)
GOOD_BODY = st.builds(
    lambda g, f, theta, k, xi: (1 + (1 - f) * g, 1 + f * g, g, theta, theta * k, xi),
    st.floats(1.01, 50),
    st.floats(0.001, 0.499),
    SHARE,
    SHARE,
    SKEW,
)
POSSIBLE = st.tuples(
    st.just(True), GOOD_BODY, st.floats(-3, 3).filter(bool), st.floats(1e-12, 3)
)
ANY = st.tuples(st.just(False), st.tuples(*[NUMBER] * 6), NUMBER, NUMBER)


@settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.sampled_from(["full", "reduced", "gh"]), POSSIBLE | ANY)
def test_any_possible_body_runs_and_others_are_refused(here, model, table):
    """Tables are checked by row; what passes the check is integrated, and no number is
    not one.
    """
    possible, body, n_i, omega = table
    (here / "t.csv").write_text(f"{HEAD}\n{','.join(map(repr, body))}\n")
    (here / "c.yaml").write_text(
        "bodies: {source: table, path: t.csv}\n"
        f"spin: {{n_i: {n_i!r}, omega_xy0: {omega!r}}}\n"
        f"horizon: {{t: 9}}\nmodel: {model}\nintegrator: {{max_steps: 200000}}\n"
    )
    with tempfile.TemporaryDirectory() as directory:
        result = invoke("run", "c.yaml", "--output", Path(directory) / "out", "-q")
        assert result.exit_code in ((0, 3) if possible else (0, 2, 3))
        if result.exit_code == 2:
            refused(result, 2, "")
            assert not list(Path(directory).iterdir())
