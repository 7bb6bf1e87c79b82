"""What a user sees, as data: `python tests/net/make.py --check`, or `--write`, or with `--slow`.

Commands are run on small inputs through the public command line, and what they print, write and
exit with is kept beside this file: `commands.txt` (transcripts, figures' data, pages' text),
`help.txt`, `schema.json`, `columns.json` and `hashes.json` (each column of small sweeps to the last
bit, figures' bytes, config hashes).  Nothing inside the package is imported, so that everything in
it can be moved.  `--slow` adds the methods and models that compile kernels of their own, the
trade-off study and the paper, in `slow.txt` and `slow.json`.

A difference on purpose is named by writing the data in a commit that says so.  Numbers are kept to
six digits, hashes hold on one type of processor and one set of versions (`made_on`); elsewhere
hashes are not compared, and transcripts without their numbers.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import html
import json
import os
import re
import shlex
import sys
import tempfile
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from click.testing import CliRunner

from rattlesweep.cli import main

HERE = Path(__file__).resolve().parent
CONFIGS = HERE.parents[1] / "configs"
VERSIONS = ("numpy", "numba", "llvmlite", "scipy", "matplotlib")

SD = "bodies: {source: sd, samples: 3, target: {K_r: [0.02, 0.1], rel_tol: 1e-2}}"
SPIN = "spin: {n_i: [-0.3, 0.4], omega_xy0: [0.01, 0.1]}"
CAPPED = "horizon: {t_rgh: 5, t: 2000}"
GH = "bodies: {source: preset, name: GH}"
SMALL = {
    "sd": f"{SD}\n{SPIN}\n{CAPPED}",
    "free": "bodies: {source: sd, samples: 4}\nspin: {n_i: [-0.5, 0.1], omega_xy0: 0.01, psi: 30}\n"
    "horizon: {t: 500}\nrecord: [energy, contact, windows]",
    "unsteady": "bodies: {source: sd, samples: 4, target: {K_p: [0.2, 1.0]}}\n"
    "spin: {n_i: [0.1, 0.4], omega_xy0: 0.01}",
    "preset": f"{GH}\nspin: {{n_i: [0.1, -0.1], omega_xy0: 0.01}}\nrecord: [energy]",
    "grid": "bodies: {source: grid, base: {preset: GH}, "
    "axes: {theta: {linspace: [0.6, 0.95, 5]}}}\n"
    "spin: {n_i: [-0.4, -0.2, 0.2, 0.4], omega_xy0: 0.1}\nhorizon: {t: 300}",
    "table": "bodies: {source: table, path: bodies.csv}",
    "failing": f"{SD}\n{SPIN}\nintegrator: {{tol: 1e-7, max_steps: 1500}}",
    "formula": f"{SD}\n{SPIN}\nmodel: gh",
    "errors": f"{SD}\n{SPIN}\n{CAPPED}\nintegrator: {{tol: 1e-5}}\n"
    "record: [energy, contact, windows, error]",
}  # fmt: skip
SLOW = {
    **{name: f"{SD}\n{SPIN}\n{CAPPED}\n{rest}" for name, rest in {
        "rk4": "integrator: {method: rk4, dt: 0.02}",
        "dopri5": "integrator: {method: dopri5, tol: 1e-7}",
        "verner98": "integrator: {accuracy: reference}",
        "draft": "integrator: {accuracy: draft}",
        "reduced": "model: reduced",
        "lyapunov": "record: [lyapunov]",
    }.items()},
}  # fmt: skip
# Shipped configs with a kernel that nothing quick has, and with draws that take long.
SLOW_CONFIGS = ("damping", "million")
BODIES = """alpha,beta,gamma,theta,phi,xi,n_i,omega_xy0,t_end
13.04,1.522,12.28,0.82,0.036,-0.03,0.1,0.01,200
13.04,1.522,12.28,0.7,0.05,-0.05,-0.2,0.1,400
"""
BAD = "nmae: x\nbodies: {source: sd, samples: -1}\nspin: {n_i: [0.1, oops], omega_xy0: 0.01}\n"

COMMANDS = """
body --preset GH
body --gamma 10 --f-sd 0.1 --theta 0.8 --phi 0.05 --xi-deg -3 --n-i -0.3 --json
body --preset HG
body --preset GH --theta 1.5
run bad.yaml
validate bad.yaml
validate sd.yaml
run none.yaml
run sd.yaml --set spin.psi=up
run sd.yaml --shard 3/2
run sd.yaml --threads 0
run sd.yaml --dry-run
plan sd.yaml --threads 1 --shards 2 --budget 0.3s
plan sd.yaml --json --budget 0.3s
run sd.yaml --output shard-0 --shard 0/2
run sd.yaml --output shard-1 --shard 1/2
merge shard-0 --output part
merge shard-0 shard-1 --output merged
merge shard-0 out/grid --output wrong
run sd.yaml -q -v
run sd.yaml --set spin.n_i=[-0.2]
run failing.yaml --retry-failed
status out/sd
status out/sd --json
status out/failing
status out/errors
status nowhere
verify out/sd --recompute 3 --seed 1
verify shard-0
verify nowhere
classify out/failing --set classify.sw_departure=0.001
classify out/sd --set classify.sw=1
compare out/sd out/sd
compare out/sd shard-0
compare out/sd out/free
slurm sd.yaml --shards 2 --mem 2G --time 1:00:00
slurm sd.yaml --shards 99
plot out/sd --data plot.csv --output plot.svg
plot out/sd --kind ratio --data plot.csv --output plot.svg
plot out/sd --kind times --select n_i=-0.3 --data plot.csv --output plot.svg --title A,B --size 6,4
plot out/unsteady --kind ratio --data plot.csv --output plot.svg --log
plot out/free --kind distribution
plot out/grid --data plot.csv --output plot.svg
plot out/grid --kind fractions --x n_i --data plot.csv --output plot.svg
plot out/failing --data plot.csv --output plot.svg
plot out/errors --kind times --data plot.csv --output plot.svg
plot out/sd --kind map --data plot.csv --output plot.svg
plot out/sd --select n_i=0.77
report out/sd
report out/grid --output report.html --title A&B
report out/failing --output report.html
report out/errors --output report.html
trajectory --preset GH --t-end 150 --points 4 --channels t,n,E_p,E_r,energy,F_normal
trajectory --preset GH --n-i -0.1 --t-end 50 --dt 25 --figure run.svg
trajectory --preset GH --channels list
trajectory --preset GH --channels t,foo
trajectory --preset GH --model gh --t-end 150 --points 4
trajectory --preset GH --tol -1
replay out/preset --case 1 --sample 0 --points 3 --channels t,n
replay out/sd --where "type = 'R' and n_i > 0" --first 2 --points 5 --output run-{case}-{sample}.csv
replay out/errors --where "t_r_error > 1e-6 * t_r and type_sure = true" --points 3 --channels t,n
replay out/sd --where "tpye = 'R'"
show --preset GH --t-end 20 --output page.html
show --from out/preset --case 0 --sample 0 --n-i 0.1 --output page.html
paper --only fig99
paper --quick --only theory --output paper -q
tradeoff --threads 999
nonsense
--version
"""
SLOW_COMMANDS = """
trajectory --preset GH --model reduced --t-end 150 --points 4
tradeoff --quick --samples 2 --output tradeoff --json
paper --quick --output paper
"""
MASKS = (
    (r"\d{4}-\d\d-\d\d[T ][\d:.]+(\+[\d:]+|Z)?", "DATE"),
    (r"\b\d+(\.\d+)?(e[-+]\d+)? (ns|us|µs|ms|s|min|h|d)\b", "TIME"),
    (r"(?<=\n)\d+:\d\d(:\d\d)?\b", "TIME"),
    (r"[\d.]+ (runs a second|[kMG]?B\b)", r"N \1"),
    (r"\b(python|numpy|numba|llvmlite|scipy|matplotlib|pandas|pyarrow) \d[\w.+]*", r"\1 V"),
    (r"machine \w+, cpu .*, processors \d+", "machine M, cpu C, processors N"),
    (r"(?<=\n)[\de+.,]+( of integration\nruns per second\n)[\de+.,]+", r"N\1N"),
    (r"(?<=DATE\n)(.*\n.*\n).*\n\d+\n(\d+\n)[\d.]+\n", r"\1HOST\nN\n\2N\n"),
    (r"\b[0-9a-f]{64}\b", "HASH"),
    (r"of the \d+ processors", "of the N processors"),
)
# Lines that are forecasts of this machine's speed, or say what machine it is.
MEASURED = re.compile(
    r'^ *(time |done at|integrated|disk|memory|1e6 runs|pilot|.*"(seconds|low|high|memory|bytes|'
    r"units?_?\w*|\w*us_per_\w+|median|p99|threads|processors|machine|cpu|pilot\w*|shard_seconds|elapsed|began?|updated|"
    r'ended|million|billion|expected\w*|\w*seconds|\w*rate|cost\w*|speed\w*|errors?\w*)":).*',
    re.M,
)


def machine() -> dict[str, str]:
    """What the last bits depend on."""
    cpu = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
    return {
        "cpu": cpu[1] if cpu else "",
        **{name: version(name) for name in VERSIONS},
    }


def normal(text: str, folder: Path) -> str:
    """A text without this run's times, paths, versions and last digits."""
    # The environment may stand inside the repository, so its programs come first.
    for path, word in ((folder, "DIR"), (sys.executable, "PYTHON"),
                       (Path(sys.executable).parent, "BIN"), (CONFIGS.parent, "REPO")):  # fmt: skip
        text = text.replace(str(path), word)
    text = MEASURED.sub("(measured)", text)
    for pattern, word in MASKS:
        text = re.sub(pattern, word, text)
    return re.sub(r"-?\d+\.\d{5,}(e[-+]?\d+)?", lambda m: f"{float(m[0]):.6g}", text)


def visible(page: str) -> str:
    """The words of an HTML page, an element a line."""
    page = re.sub(r"<(script|style|svg)\b.*?</\1>", "", page, flags=re.S)
    words = html.unescape(re.sub(r"<[^>]*>", "\n", page)).split("\n")
    return "\n".join(" ".join(w.split()) for w in words if w.strip())


def digest(data: bytes) -> str:
    """Few characters that tell two contents apart."""
    return hashlib.sha256(data).hexdigest()[:12]


def columns_of(path: Path) -> dict[str, str]:
    """A digest of each column's values, all bits, in the order of (case, sample)."""
    table = pq.read_table(path)
    keys = [(name, "ascending") for name in ("case", "sample") if name in table.column_names]
    table = table.sort_by(keys)
    return {f.name: digest(repr((str(f.type), table[f.name].to_pylist())).encode())
            for f in table.schema}  # fmt: skip


def fields_of(path: Path) -> dict[str, list[str]]:
    """Type, unit and description of each column."""
    words = lambda f: [f.metadata[k].decode() for k in (b"unit", b"description")]  # noqa: E731
    return {f.name: [str(f.type), *words(f)] for f in pq.read_schema(path)}


class Net:
    """Commands in a temporary folder, and what is kept of them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hashes: dict[str, Any] = {}

    def call(self, line: str) -> tuple[str, str]:
        """Standard output of a command, and its transcript."""
        for name in ("plot.csv", "plot.svg", "run.svg", "report.html", "page.html"):
            (self.folder / name).unlink(missing_ok=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            done = CliRunner().invoke(main, shlex.split(line), prog_name="rattlesweep")
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        # Lines of progress come once a minute, on a machine that is slow or compiles.
        extra = re.compile(r"[\d.]+ %, | *\d+ s  |compiling the kernel ")
        lines = (t for t in done.stderr.splitlines() if not extra.match(t))
        said = "".join(f"! {text}\n" for text in lines)
        end = f"exit {done.exit_code}\n" if done.exit_code else ""
        shown = normal(f"$ rattlesweep {line}\n{done.stdout}{said}{end}", self.folder)
        for path in map(Path, ("plot.csv", *sorted(self.folder.glob("run-*.csv")))):
            if path.exists():
                shown += f"-- {path.name}\n{normal(path.read_text(), self.folder)}"
                path.unlink()
        for path in map(Path, ("report.html", "out/sd/report.html", "page.html")):
            if path.exists():
                shown += f"-- {path}\n{normal(visible(path.read_text()), self.folder)}\n"
                path.unlink()
        for path in map(Path, ("plot.svg", "run.svg")):
            if path.exists():
                self.hashes.setdefault("figures", {})[line] = digest(path.read_bytes())
        return done.stdout, shown

    def sweeps(self, configs: dict[str, str]) -> str:
        """Run small sweeps; keep their columns' digests."""
        text = ""
        for name, config in configs.items():
            Path(f"{name}.yaml").write_text(f"name: {name}\n{config}\n")
            text += self.call(f"run {name}.yaml --output out/{name}")[1]
            self.keep(name)
        return text

    def keep(self, name: str) -> None:
        """Keep the digests of a sweep's columns."""
        out = Path("out", name)
        found = {part: columns_of(out / part) for part in ("runs", "summary.parquet")}
        self.hashes.setdefault("sweeps", {})[name] = found

    def config_hash(self, config: Path) -> str:
        """The identity of a config, from the manifest of a sweep stopped at once."""
        out = f"stopped-{config.stem}"
        self.call(f"run {config} --output {out} --max-time 0.001s -q")
        manifest = json.loads(Path(out, "manifest.json").read_text())
        return str(manifest["config_hash"])


def helps(net: Net) -> str:
    """`--help` of the program and of each of its commands."""
    text, shown = net.call("--help")
    names = re.findall(r"^  (\w+) ", text.split("--help ")[1], re.M)
    return "\n".join([shown, *(net.call(f"{name} --help")[1] for name in names)])


def quick(net: Net) -> Iterator[tuple[str, str]]:
    """File names and contents of the quick part."""
    Path("bodies.csv").write_text(BODIES)
    Path("bad.yaml").write_text(BAD)
    yield "help.txt", helps(net)
    schema = json.loads(net.call("schema")[0])
    yield "schema.json", json.dumps(schema, indent=1, sort_keys=True)
    golden = HERE.parent / "golden" / "golden.yaml"
    text = net.call(f"run {golden} --output out/golden")[1]
    net.keep("golden")
    text += net.sweeps(SMALL)
    parts = ("runs/" + next(Path("out/errors/runs").glob("*.parquet")).name, "summary.parquet")
    yield (
        "columns.json",
        json.dumps(
            {part.split("/")[0]: fields_of(Path("out/errors", part)) for part in parts}, indent=1
        ),
    )
    yield "commands.txt", text + "".join(net.call(line)[1] for line in COMMANDS.split("\n")[1:-1])
    small = (path for path in sorted(CONFIGS.glob("*.yaml")) if path.stem not in SLOW_CONFIGS)
    net.hashes["configs"] = {path.stem: net.config_hash(path) for path in small}
    yield "hashes.json", json.dumps({"made_on": machine(), **net.hashes}, indent=1)


def slow(net: Net) -> Iterator[tuple[str, str]]:
    """File names and contents of the slow part."""
    text = net.sweeps(SLOW)
    text += "".join(net.call(line)[1] for line in SLOW_COMMANDS.split("\n")[1:-1])
    claims = pq.read_table("paper/claims.parquet").to_pylist()
    net.hashes["claims"] = {claim["id"]: claim["verdict"] for claim in claims}
    net.hashes["configs"] = {
        name: net.config_hash(CONFIGS / f"{name}.yaml") for name in SLOW_CONFIGS
    }
    yield "slow.txt", text
    yield "slow.json", json.dumps({"made_on": machine(), **net.hashes}, indent=1)


def make(part: Any, folder: Path) -> dict[str, str]:
    """Everything of a part, by file name, made in an empty folder."""
    before, argv = Path.cwd(), sys.argv
    os.chdir(folder)
    sys.argv = ["rattlesweep"]
    try:
        return {file: text.rstrip() + "\n" for file, text in part(Net(folder.resolve()))}
    finally:
        os.chdir(before)
        sys.argv = argv


def compare(found: dict[str, str]) -> list[str]:
    """Lines that differ from the data, as diffs have them."""
    kept = {name: (HERE / name).read_text() for name in found}
    hashes = next(name for name in found if name in ("hashes.json", "slow.json"))
    here = json.loads(kept[hashes])["made_on"] == machine()

    def lines(name: str, text: str) -> list[str]:
        if not here and name == hashes:
            text = json.dumps({k: v for k, v in json.loads(text).items() if k == "configs"})
        if not here and name.endswith(".txt"):
            text = re.sub(r"[ \t]+", " ", re.sub(r"-?\d[\d.e+-]*", "#", text))
        return text.splitlines(keepends=True)

    return [
        line
        for name, text in found.items()
        for line in difflib.unified_diff(
            lines(name, kept[name]), lines(name, text), f"{name} (kept)", f"{name} (now)", n=2
        )
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    choice = parser.add_mutually_exclusive_group(required=True)
    choice.add_argument("--check", action="store_true", help="print what differs; exit with 1")
    choice.add_argument("--write", action="store_true", help="keep what comes out today")
    parser.add_argument(
        "--slow", action="store_true", help="the slow part instead of the quick one"
    )
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        made = make(slow if given.slow else quick, Path(name))
    if given.write:
        for file, content in made.items():
            (HERE / file).write_text(content)
    else:
        differences = compare(made)
        sys.stdout.writelines(differences)
        sys.exit(bool(differences))
