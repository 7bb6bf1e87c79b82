"""The command line itself: help, exit codes, streams; `init`, `body`."""

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest
from packaging.requirements import Requirement
from refusal import assert_refused
from sweeping import PROGRAM, ROOT, invoke

import rattlesweep as rs
from rattlesweep import cli
from rattlesweep.analysis.plots import FIGURE_KINDS
from rattlesweep.config.read import load_config
from rattlesweep.config.schema import ACCURACIES
from rattlesweep.motion.model import find_model
from rattlesweep.physics.body import PRESETS
from rattlesweep.system import console, shipped
from rattlesweep.system.shipped import example_names
from rattlesweep.words.names import (
    ACCURACY_NAMES,
    MODEL_NAMES,
    PLOT_NAMES,
    PRESET_NAMES,
)

HEAVY = {
    "numpy",
    "numba",
    "scipy",
    "pandas",
    "pyarrow",
    "pydantic",
    "tqdm",
    "matplotlib",
}
COMMANDS = {
    "run",
    "classify",
    "body",
    "contact",
    "verdict",
    "trajectory",
    "tradeoff",
    "paper",
    "plan",
    "status",
    "docs",
    "verify",
    "merge",
    "replay",
    "show",
    "orbit",
    "branch",
    "export",
    "plot",
    "table",
    "report",
    "slurm",
    "schema",
    "compare",
    "sensitivity",
    "init",
    "film",
    "stl",
    "fit",
}


@pytest.mark.parametrize("quiet", [False, True])
def test_a_quiet_command_prints_no_warning_of_its_body(tmp_path, quiet):
    """A body of equal radii, whose axes of curvature are badly known."""
    mesh = tmp_path / "round.stl"
    made = invoke("stl", "--half-ellipsoid", "5cm,4.9cm,1cm", "--output", mesh, "-q")
    assert made.exit_code == 0, made.stderr
    again = tmp_path / "again.json"
    options = ["--mesh", mesh, "--mass", "20g", "--n-i", 0, "--omega-xy0", "6 rpm"]
    given = [*options, "--t-end", "1 ms", "--output", again, *(["-q"] if quiet else [])]
    done = invoke("export", *given)
    assert done.exit_code == 0, done.stderr
    assert ("warning: the radii" in done.stderr) is not quiet
    assert not quiet or not done.stderr


def test_help_lists_every_command_with_a_whole_sentence():
    sections = invoke("--help").stdout.split("--help ")[1].split("To begin with:")[0]
    assert set(re.findall(r"^  (\w+) ", sections, re.MULTILINE)) == COMMANDS
    assert set(cli.main.commands) == COMMANDS
    assert "..." not in sections
    for name in COMMANDS:
        assert re.search(
            rf"Examples?:\n +rattlesweep {name}\b", invoke(name, "--help").stdout
        )
        flags = {flag: p for p in cli.main.commands[name].params for flag in p.opts}
        for short, long in (("-o", "--output"), ("-j", "--threads"), ("-q", "--quiet")):
            assert flags.get(long) is flags.get(short), (name, long)


def test_help_and_refusals_load_nothing_heavy():
    code = f"""if True:
        import sys, rattlesweep as rs
        rs.__version__, dir(rs)
        from rattlesweep import cli
        for line in ("--help", "run c.yaml -j 0", "run c.yaml --thread"):
            try:
                cli.main(line.split())
            except SystemExit as end:
                assert end.code == (0 if line == "--help" else 2)
        assert not {HEAVY} & set(sys.modules)
        from rattlesweep import sweep  # a function, and not a room of this name
        assert callable(sweep)
    """
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)


def test_what_is_stored_is_read_without_numba():
    code = """if True:
        import sys
        import rattlesweep.rows.columns
        import rattlesweep.store.classify
        import rattlesweep.store.progress
        import rattlesweep.store.summary
        assert not {"numba", "llvmlite"} & set(sys.modules)
    """
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)


def test_a_sweep_loads_neither_pandas_nor_matplotlib(tmp_path):
    (tmp_path / "c.yaml").write_text(
        "bodies: {source: preset, name: GH}\n"
        "spin: {n_i: [0.1, -0.1], omega_xy0: 0.1}\nmodel: gh\noutput: out\n"
    )
    code = """if True:
        import sys
        from rattlesweep import cli
        commands = (
            "run c.yaml",
            "run c.yaml --set seed=0",
            "status out",
            "verify out --recompute 1",
            "classify out",
            "merge out --output merged",
            "plan c.yaml",
        )
        for line in commands:
            try:
                cli.main(line.split())
            except SystemExit as end:
                assert end.code == 0, line
            loaded = {"pandas", "matplotlib", "tqdm"} & set(sys.modules)
            assert not loaded, (line, loaded)
        # What needs pandas still gets it.
        import pyarrow
        assert pyarrow.table({"a": [1]}).to_pandas().a.tolist() == [1]
    """
    command = [sys.executable, "-c", code]
    subprocess.run(command, cwd=tmp_path, capture_output=True, check=True)


@pytest.mark.skipif(sys.platform != "linux", reason="threads are counted in /proc")
def test_a_command_starts_no_threads_for_matrices():
    # Each would reserve memory, which an address space with a limit may not have.
    code = (
        "import os\n"
        "from rattlesweep.cli import main\n"
        "try:\n"
        "    main(['--version'])\n"
        "except SystemExit:\n"
        "    import scipy.linalg\n"
        "    print(len(os.listdir('/proc/self/task')))\n"
    )
    environment = {
        name: value
        for name, value in os.environ.items()
        if name != "OPENBLAS_NUM_THREADS"
    }
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        check=True,
        text=True,
        env=environment,
    )
    assert done.stdout.split()[-1] == "1"


def test_choices_are_those_of_the_registries():
    *models, closed_formula = MODEL_NAMES
    assert [find_model(name).name for name in models] == models
    assert closed_formula == "gh"
    assert list(PLOT_NAMES) == list(FIGURE_KINDS)
    assert list(PRESET_NAMES) == list(PRESETS)
    assert list(ACCURACY_NAMES) == list(ACCURACIES)


@pytest.mark.parametrize("too_old", ["pint 0.24.3", "matplotlib 3.8"])
def test_versions_that_fail_are_not_installed(too_old):
    """They refuse a text with an error of their own, or need NumPy 1."""
    name, version = too_old.split()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    bounds = {bound.name: bound for bound in map(Requirement, project["dependencies"])}
    assert version not in bounds[name].specifier


def test_version():
    told = invoke("--version", "--verbose").stdout.split("\n", 1)
    assert {"numpy", "numba", "llvmlite", "cpu"} <= json.loads(told[1]).keys()
    for program in ([PROGRAM], [sys.executable, "-m", "rattlesweep"]):
        said = subprocess.run(
            [*program, "--version"], capture_output=True, text=True
        ).stdout
        assert said == f"{told[0]}\n" == f"rattlesweep, version {rs.__version__}\n"


def test_a_wrong_environment_is_one_sentence(monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "many")
    assert_refused(invoke("schema"), 2, "NUMBA_NUM_THREADS=many: it must be a whole")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no such device")
def test_a_standard_output_that_takes_nothing_is_one_sentence():
    command = f"{PROGRAM} body --preset GH > /dev/full"
    done = subprocess.run(
        command, shell=True, capture_output=True, text=True, check=False
    )
    told = "error: cannot write to standard output: No space left on device\n"
    assert (done.returncode, done.stderr) == (1, told)


def test_a_folder_that_is_gone_is_told(tmp_path):
    (tmp_path / "c.yaml").write_text(
        "model: gh\nbodies: {source: preset, name: GH}\n"
        "spin: {n_i: 0.1, omega_xy0: 0.1}\n"
    )
    (tmp_path / "gone").mkdir()
    command = f"cd gone; rmdir ../gone; {PROGRAM} plan '{tmp_path}/c.yaml'"
    done = subprocess.run(
        command, shell=True, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    told = "error: the current folder is gone; change to one that exists\n"
    assert (done.returncode, done.stderr) == (1, told)


def test_a_command_that_prints_nothing_needs_no_standard_output(tmp_path):
    (tmp_path / "c.yaml").write_text(
        "model: gh\nbodies: {source: preset, name: GH}\n"
        "spin: {n_i: 0.1, omega_xy0: 0.1}\noutput: out\n"
    )
    command = f"{PROGRAM} run c.yaml -q >&- 2>&-"
    assert (
        subprocess.run(command, shell=True, cwd=tmp_path, check=False).returncode == 0
    )
    assert (tmp_path / "out" / "summary.parquet").exists()


def test_a_reader_that_has_gone_is_told_nothing():
    command = f"{PROGRAM} schema | head -1; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) in (
        ("{\n1\n", ""),
        ("{\n0\n", ""),
    )  # it may be quicker


def test_a_bar_is_shown_in_a_terminal_only(monkeypatch, capfd):
    monkeypatch.setattr(console, "DELAY", 0)
    for terminal, quiet in ((True, False), (False, False), (True, True)):
        monkeypatch.setattr("sys.stderr.isatty", lambda terminal=terminal: terminal)
        with console.Bar.of_command(quiet) as bar:
            bar.counting("integrating")(0.5)
        assert ("integrating" in capfd.readouterr().err) == (terminal and not quiet)


def test_a_log_that_is_no_terminal_gets_a_line_a_minute(monkeypatch, capfd):
    now = [0.0]
    monkeypatch.setattr("sys.stderr.isatty", lambda: False)
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.Bar.of_command() as bar:
        for second in range(200):
            now[0] = float(second)
            bar(SimpleNamespace(fraction=second / 200, runs=10 * second, left=7.0))
    assert capfd.readouterr().err.splitlines() == [
        "30.0 %, 600 runs done, 1:00 so far, 0:07 left",
        "60.0 %, 1,200 runs done, 2:00 so far, 0:07 left",
        "90.0 %, 1,800 runs done, 3:00 so far, 0:07 left",
    ]


GH = (
    "bodies: {source: preset, name: GH}\nspin: {n_i: 0.1, omega_xy0: 0.1}\n"
    "record: [error]\noutput: out\n"
)


def test_compile_only_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.yaml").write_text(GH)
    done = invoke("run", "c.yaml", "--compile-only")
    assert (done.exit_code, done.stdout) == (0, "")
    assert done.stderr.endswith("the kernels are compiled\n")
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]


@pytest.mark.slow
def test_a_run_after_compile_only_compiles_nothing(tmp_path):
    """On a node, all kernels come from a cache that was filled elsewhere."""
    (tmp_path / "c.yaml").write_text(GH)
    cache = tmp_path / "cache"
    cache.mkdir(mode=0o700)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}

    def run(*options: str) -> tuple[str, dict[str, bytes]]:
        done = subprocess.run(
            [PROGRAM, "run", "c.yaml", *options],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        files = {str(p): p.read_bytes() for p in cache.rglob("*") if p.is_file()}
        return done.stderr, files

    said, compiled = run("--compile-only")
    assert console.COMPILING in said
    assert compiled
    for options in (("--compile-only",), ()):
        said, files = run(*options)
        assert console.COMPILING not in said
        assert files == compiled
    assert (tmp_path / "out" / "summary.parquet").exists()


@pytest.mark.parametrize("name", ["mine", "true", "a: b", "ä"])
def test_init_writes_a_config_that_is_valid(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written = invoke("init", f"{name}.yaml")
    assert (written.exit_code, written.stdout) == (0, f"{name}.yaml\n")
    assert load_config(f"{name}.yaml").name == name
    assert invoke("plan", f"{name}.yaml", "--check").exit_code == 0
    assert invoke("init", f"new/{name}.yaml").exit_code == 0
    assert_refused(invoke("init", f"{name}.yaml"), 2, "exists already; choose another")


def test_body_says_what_the_python_interface_says():
    found = json.loads(
        invoke("body", "--preset", "GH", "--n-i", "-0.1", "--json").stdout
    )
    assert vars(rs.modes("GH")).items() <= found.items()
    assert found["t_rgh"] == rs.reversal_time_gh("GH", -0.1, 0.01)


@pytest.mark.parametrize("name", example_names())
def test_an_example_is_written_and_its_paths_exist(name, tmp_path, monkeypatch):
    """Whoever has only the package gets the configs of the clone from it."""
    monkeypatch.chdir(tmp_path)
    written = invoke("init", "--example", name)
    assert written.exit_code == 0
    paths = written.stdout.split()
    for path in paths:
        text = Path(path).read_text()
        assert all(Path(p).exists() for p in re.findall(r"configs/[\w/.]+\w", text))
        assert not re.search(r"\bdocs/", text)
        comments = r"#.*|\s"  # and blanks, in which the columns of comments differ
        shipped = (ROOT / path).read_text()
        assert re.sub(comments, "", text) == re.sub(comments, "", shipped)
    if name == "fit":
        done = invoke("fit", *reversed(paths), "--json")
        assert json.loads(done.stdout)["rows"] > 300
    else:
        assert invoke("plan", *paths, "--check").exit_code == 0
    assert_refused(invoke("init", "--example", name), 2, "exists already")
    elsewhere = invoke("init", "--example", name, "mine/own.yaml").stdout.split()
    assert "mine/own.yaml" in elsewhere
    texts = [Path(path).read_text() for path in elsewhere]
    assert not any("configs/" in text for text in texts)


def test_every_config_of_the_clone_is_an_example():
    names = {path.stem for path in (ROOT / "configs").iterdir()}
    assert names == {shipped.ALIASES.get(name, name) for name in example_names()}
    assert {"quickstart", "steady", "unsteady", "map", "rolling", "fit"} <= set(
        example_names()
    )


def test_helps_name_only_what_a_user_of_the_package_has():
    """Configs and pages come with a command that writes or prints them."""
    pages = shipped.documentation()
    for name in ("", *COMMANDS):
        told = invoke(*name.split(), "--help").stdout
        configs = set(re.findall(r"configs/(\w+)", told))
        assert configs <= set(re.findall(r"init --example (\w+)", told))
        assert not re.search(r"docs/|https?://", told)
        assert set(re.findall(r"`rattlesweep docs (\w+)`", told)) <= pages.keys()


def test_pages_are_printed_without_internet():
    listed = invoke("docs").stdout
    assert "tutorial     Tutorial\n" in listed
    names = [line.split()[0] for line in listed.splitlines()]
    assert names == sorted(path.stem for path in (ROOT / "docs").glob("*.md"))
    page = (ROOT / "docs" / "types.md").read_text()
    assert invoke("docs", "types").stdout.strip() == page.strip()
    assert_refused(invoke("docs", "type"), 2, 'did you mean "types"?')


def test_a_script_can_ask_whether_runs_are_missing(tmp_path):
    config = tmp_path / "small.yaml"
    config.write_text(
        "model: gh\nbodies: {source: sd, samples: 4}\n"
        "spin: {n_i: -0.3, omega_xy0: 0.1}\n"
    )
    out = tmp_path / "out"
    for shard, missing in ((0, 75), (1, 0)):
        invoke("run", config, "--output", out, "--shard", f"{shard}/2", "-q")
        assert invoke("status", out, "--complete").exit_code == missing
        assert invoke("status", out).exit_code == 0


def test_links_of_the_long_description_are_absolute():
    """If this fails after a change of README.md, install the package again."""
    link = re.compile(r"\]\(([^)]*)\)")
    links = link.findall(metadata("rattlesweep")["Description"])
    assert len(links) == len(link.findall((ROOT / "README.md").read_text()))
    assert all(re.match(r"https?://[^/]+/", address) for address in links)
