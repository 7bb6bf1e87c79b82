"""The job script of `rattlesweep slurm`, run under a stand-in for Slurm's environment."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hardship import wait_until
from refusal import assert_refused
from sweeping import PROGRAM, content_hash, invoke, proved, sweep

from rattlesweep.integrate.compile import cache_folder
from rattlesweep.sweeps.slurm import limit_of, margin_of, memory_of

SHELLCHECK = Path(sys.executable).with_name("shellcheck")
# Eight blocks of which each takes a moment: a fixed step and nothing that ends early.
SWEEP = """\
name: an array
seed: 5
bodies: {source: sd, samples: 40}
spin: {n_i: [-0.1, 0.2], omega_xy0: 0.01}
horizon: {t: 300}
integrator: {method: rk4, dt: 0.001}
block_size: 10
"""


@pytest.fixture
def home(tmp_path):
    """A directory with a name that must be quoted, and a config in it."""
    place = tmp_path / "it's here"
    place.mkdir()
    (place / "sweep.yaml").write_text(SWEEP)
    return place


def asked(home: Path, *options: Any) -> Any:
    """The command, with options of which the last of a name counts."""
    given = ("--shards", 3, "--mem", "1G", "--output", home / "out", *options)
    return invoke("slurm", home / "sweep.yaml", *given)


def script(home: Path, *options: Any) -> str:
    result = asked(home, *options)
    assert result.exit_code == 0, result.output
    return str(result.stdout)


class Cluster:
    """What a task finds around it: variables, a node's disk, and a `scontrol` that takes notes."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.tools = place / "tools"
        self.tools.mkdir()
        self.notes = place / "scontrol.log"
        self.notes.touch()
        self.put("scontrol", f'echo "$*" >> {self.notes}\n')

    def put(self, name: str, text: str) -> Path:
        """A program in bash."""
        path = self.tools / name
        path.write_text("#!/bin/bash\n" + text)
        path.chmod(0o755)
        return path

    def stub(self, text: str, body: str) -> str:
        """The script with another program in place of rattlesweep, whose output is seen."""
        version = invoke("--version").stdout.strip()
        told = f'[[ $1 == --version ]] && {{ echo "{version}"; exit; }}\n'
        path = self.put("rattlesweep", told + body)
        assert str(PROGRAM) in text
        return text.replace(str(PROGRAM), str(path)).replace("--quiet >/dev/null", "--quiet")

    def start(self, text: str, index: int | None, **variables: str) -> subprocess.Popen[str]:
        """A task, as the node's daemon starts it: from a copy of the script, in a group."""
        copy = self.place / "slurm_script"
        copy.write_text(text)
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("SLURM", "NUMBA"))}
        environment |= {
            "PATH": f"{self.tools}:/usr/bin:/bin",
            "SLURM_ARRAY_JOB_ID": "100",
            "SLURM_JOB_ID": "104",
            "SLURM_CPUS_PER_TASK": "2",
            "SLURM_TMPDIR": str(self.place),
            **({} if index is None else {"SLURM_ARRAY_TASK_ID": str(index)}),
            **variables,
        }
        return subprocess.Popen(
            ["/bin/bash", copy], env=environment, cwd=self.place, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    def run(self, text: str, index: int | None = 0, **variables: str) -> tuple[int, str]:
        """Exit code and log of a task."""
        task = self.start(text, index, **variables)
        log = task.communicate(timeout=120)[0]
        return task.returncode, log

    def signal(self, text: str, number: int, ready: Any) -> tuple[int, str]:
        """Exit code and log of a task that gets a signal, to the script alone, once it is ready."""
        task = self.start(text, 0)
        wait_until(ready, 120, task)
        task.send_signal(number)
        log = task.communicate(timeout=60)[0]
        return task.returncode, log

    def requeued(self) -> list[str]:
        """What `scontrol` was told."""
        return self.notes.read_text().splitlines()


@pytest.fixture
def cluster(tmp_path):
    return Cluster(tmp_path)


# -- the text ----------------------------------------------------------------------------------


def test_script_asks_for_what_it_was_told_and_is_clean(home, cluster):
    text = script(home, "--cpus", 16, "--time", "1-02:30:00", "--partition", "short",
                  "--set", "seed=7", "--shards", 8)  # fmt: skip
    head = [line.removeprefix("#SBATCH ") for line in text.splitlines() if "#SBATCH" in line]
    assert head == [
        "--job-name=an-array", "--array=0-7", "--ntasks=1", "--cpus-per-task=16", "--mem=1024M",
        "--time=1-02:30:00", "--signal=B:USR1@150", "--requeue", "--open-mode=append",
        "--output=an-array-%A_%a.log", "--partition=short",
    ]  # fmt: skip
    assert text.startswith("#!/bin/bash\n#SBATCH")
    # Slurm may warn up to a minute early; the run stops by itself before even that.
    assert f"--max-time {26 * 3600 + 1800 - 300}s" in text
    assert "--set seed=7" in text
    command = [SHELLCHECK, "-o", "all", "-e", "SC2250,SC2310,SC2312", cluster.put("script", text)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout + done.stderr == ""


def test_memory_comes_from_a_pilot_if_nothing_is_said(home):
    text = invoke("slurm", home / "sweep.yaml", "--shards", 3, "--output", home / "out").stdout
    line = next(line for line in text.splitlines() if "--mem" in line)
    # An interpreter with everything loaded takes 150 MB or more.
    assert 300 < int(line.split("=")[1].removesuffix("M")) < 4000


def test_limits_and_sizes_are_read_as_slurm_reads_them():
    for text, seconds in (
        ("90", 5400), ("4:00:00", 14400), ("30:30", 1830), ("2-0", 172800), ("1-02:30", 95400),
        ("1-02:30:05", 95405),
    ):  # fmt: skip
        assert limit_of(text) == seconds
        assert 0 < margin_of(seconds) <= 300
    for text in ("", "-1", "1:2:3:4", "x", "0"):
        with pytest.raises(ValueError, match=r"is no time limit|is too short"):
            limit_of(text)
    sizes = {"4G": 4 << 30, "800M": 800 << 20, "512": 512 << 20, "2t": 2 << 40, "3GB": 3 << 30}
    assert {text: memory_of(text) for text in sizes} == sizes


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--time", "4h"), "--time 4h: is no time limit; write it as Slurm does"),
        (("--time", "1"), "--time 1: is too short"),
        (("--mem", "much"), "--mem much: is no size of memory"),
        (("--mem", "0"), "--mem 0: is no size of memory"),
        (("--shards", "9"), "--shards 9: is more than the 8 blocks there are"),
        (("--partition", "a b"), "--partition a b: is no name of a partition"),
        (("--set", "bodies.samples=-1"), "bodies.samples"),
        (("--set", "spin.n_i=0.1\n"), "with a line break cannot stand in a script"),
        (("--output", ""), "--output: the directory has no name"),
    ],
)
def test_what_is_wrong_is_said_before_a_script_is_printed(options, sentence, home):
    assert_refused(asked(home, *options), 2, sentence)


def test_directory_of_another_config_is_found_when_the_script_is_made(home):
    sweep(home / "out", home / "sweep.yaml", "seed=6", "model=gh")
    assert_refused(asked(home), 2, "it holds the runs of another config")


def test_arrays_larger_than_slurm_takes_are_remarked(home):
    many = ("--set", "bodies.samples=2000", "--set", "block_size=1", "--shards")
    for count, remarked in ((1001, False), (1002, True)):
        result = asked(home, *many, count)
        assert f"--array=0-{count - 1}\n" in result.stdout
        assert ("MaxArraySize" in result.stderr) == remarked


# -- what it does, with a stand-in for the program ---------------------------------------------


def test_program_gets_its_share_threads_and_time(home, cluster):
    text = script(home, "--time", "1:00:00", "--set", "name=x'y z")
    code, log = cluster.run(cluster.stub(text, 'printf "%s\\n" "$@"; env >&2\n'), 2)
    assert code == 0
    lines = log.splitlines()
    at = lines.index("run")
    assert lines[at : at + 13] == [
        "run", str(home / "sweep.yaml"), "--output", str(home / "out"), "--set", "name=x'y z",
        "--shard", "2/3", "--threads", "2", "--max-time", "3300s", "--quiet",
    ]  # fmt: skip
    assert "NUMBA_NUM_THREADS=2" in lines
    assert f"NUMBA_CACHE_DIR={cluster.place}/rattlesweep-{os.getuid()}" in lines
    assert cluster.requeued() == []
    text = script(home, "--own-directories")
    assert "{0..2} --output" in text
    assert f"{home}/out-1\n" in cluster.run(cluster.stub(text, 'echo "$4"\n'), 1)[1]
    assert (home / "out-1").is_dir()


def test_exit_codes_pass_on_and_what_ran_out_of_time_is_queued_again(home, cluster):
    text = script(home, "--restarts", 4)
    for code in (0, 1, 2, 3, 130, 137, 143):
        assert cluster.run(cluster.stub(text, f"exit {code}\n"))[0] == code
    assert cluster.requeued() == []
    text = cluster.stub(text, "exit 75\n")
    code, log = cluster.run(text, 1, SLURM_RESTART_COUNT="3")
    assert (code, cluster.requeued()) == (0, ["requeue 100_1"])
    assert "task 100_1 resumes after a restart" in log
    # Not for ever.
    code, log = cluster.run(text, 1, SLURM_RESTART_COUNT="4")
    assert (code, cluster.requeued()) == (75, ["requeue 100_1"])
    assert "error: task 100_1 is not done after 4 restarts; submit the script again" in log
    cluster.put("scontrol", "exit 1\n")
    code, log = cluster.run(text, 1)
    assert code == 75
    assert "could not be put into the queue again" in log


@pytest.mark.parametrize(("number", "code", "again"), [("USR1", 0, True), ("TERM", 143, False)])
def test_signals_reach_the_program_and_only_a_warning_means_again(
    number, code, again, home, cluster
):
    ready = cluster.place / "ready"
    body = f'trap "exit 143" TERM\ntouch {ready}\nwhile :; do sleep 0.05; done\n'
    text = cluster.stub(script(home), body)
    assert cluster.signal(text, getattr(signal, f"SIG{number}"), ready.exists)[0] == code
    assert cluster.requeued() == (["requeue 100_0"] if again else [])


@pytest.mark.parametrize(
    ("change", "code", "sentence"),
    [
        ((str(PROGRAM), "/no/such/rattlesweep"), 1, "does not see /no/such/rattlesweep"),
        ((str(PROGRAM), "/bin/false"), 1, "rattlesweep does not start on"),
        ((str(PROGRAM), "/bin/echo"), 2, "this script is of rattlesweep"),
        (("sweep.yaml", "gone.yaml"), 2, "gone.yaml"),
        (("/out", "/sweep.yaml/out"), 1, "cannot write in"),
        (None, 2, "this is a job array; hand it to sbatch"),
    ],
)
def test_environment_is_checked_before_anything_is_begun(change, code, sentence, home, cluster):
    text = script(home)
    if change is None:
        got, log = cluster.run(text, None)
    else:
        assert change[0] in text
        got, log = cluster.run(text.replace(*change))
    assert got == code
    assert sentence in log
    assert log.startswith("error: ")
    assert len(log.strip().splitlines()) == 1
    assert not [path for path in home.rglob("*") if path.name not in ("out", "sweep.yaml")]


def test_kernels_are_not_taken_from_a_directory_of_somebody_else(home, cluster):
    other = cluster.place / "elsewhere"
    other.mkdir()
    (cluster.place / f"rattlesweep-{os.getuid()}").symlink_to(other)
    text = cluster.stub(script(home), 'echo "cache $NUMBA_CACHE_DIR"\n')
    log = cluster.run(text, TMPDIR=str(cluster.place))[1]
    used = Path(next(line for line in log.splitlines() if line.startswith("cache "))[6:])
    assert used.parent == cluster.place
    assert used.name.startswith("tmp.")


# -- and with the program itself ---------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("own", [False, True], ids=["shared", "own"])
def test_array_with_a_warning_in_the_middle_comes_to_the_same_table(own, home, cluster):
    sweep(home / "plain", home / "sweep.yaml")
    # Kernels as on a node where they are compiled already: it takes 10 s each.
    node = cluster.place / f"rattlesweep-{os.getuid()}"
    shutil.copytree(cache_folder(), node / cache_folder().name)
    node.chmod(0o700)
    text = script(home, *(["--own-directories"] if own else []), "--shards", 2)
    places = [home / f"out-{i}" if own else home / "out" for i in range(2)]
    runs = places[0] / "runs"
    code, log = cluster.signal(text, signal.SIGUSR1, lambda: any(runs.glob("block-*.parquet")))
    assert code == 0
    assert cluster.requeued() == ["requeue 100_0"], log
    assert len(list(runs.glob("block-*.parquet"))) < 4
    codes = [cluster.run(text, 0, SLURM_RESTART_COUNT="1")[0], cluster.run(text, 1)[0]]
    assert codes == [0, 0]
    if own:
        assert invoke("merge", *places, "--output", home / "out").exit_code == 0
    assert proved(home / "out") == content_hash(home / "plain")
