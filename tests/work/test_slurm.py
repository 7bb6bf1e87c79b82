"""The job script of `rattlesweep slurm`, run in an imitation of Slurm's environment."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import sweeping
from hardship import wait_until

import rattlesweep as rs
from rattlesweep.compiling import loading
from rattlesweep.config.read import load_config
from rattlesweep.design.plan import make_plan
from rattlesweep.words.errors import ConfigError
from rattlesweep.work.slurm import job_script, limit_of

PROGRAM, SHELLCHECK = (
    Path(sys.executable).with_name(n) for n in ("rattlesweep", "shellcheck")
)
SWEEP = """\
name: an array
seed: 5
bodies: {source: sd, samples: 40}
spin: {n_i: [-0.1, 0.2], omega_xy0: 0.01}
horizon: {t: 300}
integrator: {method: rk4, dt: 0.001}
"""
TASK = {
    "shards": 3,
    "own": False,
    "limit": 3600,
    "cpus": 2,
    "memory": "1024M",
    "restarts": 4,
}


@pytest.fixture
def home(tmp_path):
    """A directory with a config, whose name must be quoted."""
    place = tmp_path / "it's here"
    place.mkdir()
    (place / "sweep.yaml").write_text(SWEEP)
    return place


def script(home: Path, *overrides: str, **task: Any) -> str:
    config = home / "sweep.yaml"
    task = TASK | {"partition": None} | task
    return job_script(
        make_plan(load_config(config)), config, home / "out", overrides, **task
    )


class Cluster:
    """Environment of a task: variables, the disk of a node, a `scontrol` that logs its
    calls.
    """

    def __init__(self, place: Path) -> None:
        self.place = place
        self.notes = place / "scontrol.log"
        (place / "tools").mkdir()
        self.notes.touch()
        self.put("scontrol", f'echo "$*" >> {self.notes}\n')

    def put(self, name: str, text: str) -> Path:
        path = self.place / "tools" / name
        path.write_text("#!/bin/bash\n" + text)
        path.chmod(0o755)
        return path

    def stub(self, text: str, body: str) -> str:
        """Return the script with another program instead of rattlesweep, whose output
        is kept.
        """
        answer = f'echo "rattlesweep {rs.__version__}"'
        program = f"[[ $1 == --version ]] && {{ {answer}; exit; }}\n"
        path = self.put("rattlesweep", program + body)
        assert str(PROGRAM) in text
        return text.replace(str(PROGRAM), str(path)).replace("s >/dev/null &", "s &")

    def start(
        self, text: str, index: int = 0, **variables: str
    ) -> subprocess.Popen[str]:
        """Start a task as Slurm's daemon does: from a copy of the script, in its own
        session.
        """
        copy = self.place / "slurm_script"
        copy.write_text(text)
        environment = {
            k: v for k, v in os.environ.items() if not k.startswith(("SLURM", "NUMBA"))
        }
        environment |= {
            "PATH": f"{self.place}/tools:/usr/bin:/bin",
            "SLURM_ARRAY_JOB_ID": "100",
            "SLURM_CPUS_PER_TASK": "2",
            "SLURM_TMPDIR": str(self.place),
            "SLURM_ARRAY_TASK_ID": str(index),
            **variables,
        }
        return subprocess.Popen(
            ["/bin/bash", copy],
            env=environment,
            cwd=self.place,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, text: str, index: int = 0, **variables: str) -> tuple[int, str]:
        task = self.start(text, index, **variables)
        log = task.communicate(timeout=120)[0]
        return task.returncode, log

    def requeued(self) -> list[str]:
        return self.notes.read_text().splitlines()


@pytest.fixture
def cluster(tmp_path):
    return Cluster(tmp_path)


def test_script_asks_for_what_it_was_told_and_is_clean(home, cluster):
    text = script(
        home, "seed=7", shards=8, cpus=16, limit=26 * 3600 + 1800, partition="short"
    )
    head = [
        line.removeprefix("#SBATCH ") for line in text.splitlines() if "#SBATCH" in line
    ]
    assert head == [
        "--job-name=an-array",
        "--array=0-7",
        "--ntasks=1",
        "--cpus-per-task=16",
        "--time=26:30:00",
        "--signal=B:USR1@150",
        "--requeue",
        "--open-mode=append",
        "--output=an-array-%A_%a.log",
        "--mem=1024M",
        "--partition=short",
    ]
    # Slurm may warn up to a minute early; the run stops by itself before even that.
    assert f"--max-time {26 * 3600 + 1800 - 300}s" in text
    command = [
        SHELLCHECK,
        "-o",
        "all",
        "-e",
        "SC2250,SC2310,SC2312",
        cluster.put("script", text),
    ]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.stdout + done.stderr == ""
    with pytest.raises(ConfigError, match="a b: is not the name of a partition"):
        script(home, partition="a b")
    with pytest.raises(
        ConfigError, match="--mem lots: is not a size of memory; write it as in 4G"
    ):
        script(home, memory="lots")
    with pytest.raises(ConfigError, match="with a line break cannot stand in a script"):
        script(home, "spin.n_i=0.1\n")


def test_a_script_for_bodies_with_targets_needs_no_kernel(home, monkeypatch):
    """The login node may have another processor than those that run the sweep."""

    def load(recipe, *names):
        pytest.fail(f"{recipe.__name__} {names} is loaded")

    monkeypatch.setattr(loading, "_loaded", {})
    monkeypatch.setattr(loading, "_compile", lambda wanted: None)
    monkeypatch.setattr(loading, "_load", load)
    config = home / "sweep.yaml"
    targets = "bodies.target={K_r: [0.01, 0.1]}"
    done = sweeping.invoke("slurm", config, "--shards", 2, "--set", targets)
    assert done.exit_code == 0
    assert "#SBATCH --array=0-1" in done.stdout
    done = sweeping.invoke(
        "slurm", config, "--shards", 2, "--set", f"{targets[:-1]}, max_draws: 1}}"
    )
    assert done.exit_code == 2
    assert "bodies.target.K_r: 0.01 was not met to 0.001 in 1 draws" in done.stderr


def test_limits_are_read_as_slurm_reads_them():
    limits = {"90": 5400, "4:00:00": 14400, "1-02:30:05": 95405}
    assert {text: limit_of(text) for text in limits} == limits


def test_program_gets_its_shard_threads_and_time(home, cluster):
    text = script(home, "name=x'y z")
    code, log = cluster.run(cluster.stub(text, 'printf "%s\\n" "$@"; env >&2\n'), 2)
    lines = log.splitlines()
    at = lines.index("run")
    assert code == 0
    # Not quiet: the log says that kernels are compiled, and how far the task is.
    assert lines[at : at + 12] == [
        "run",
        str(home / "sweep.yaml"),
        "--output",
        str(home / "out"),
        "--set",
        "name=x'y z",
        "--shard",
        "2/3",
        "--threads",
        "2",
        "--max-time",
        "3300s",
    ]
    assert f"#   rattlesweep verify {shlex.quote(str(home / 'out'))} --complete" in text
    assert {
        f"NUMBA_CACHE_DIR={cluster.place}/rattlesweep-{os.getuid()}",
        "NUMBA_NUM_THREADS=2",
    } <= set(lines)
    text = script(home, own=True)
    assert "{0..2} --output" in text
    assert f"{home}/out-1\n" in cluster.run(cluster.stub(text, 'echo "$4"\n'), 1)[1]


def test_the_last_task_to_end_checks_the_sweep_in_the_folder_of_kernels_given(
    home, cluster
):
    missing = """case $1 in
run) env | grep NUMBA_CACHE ;;
status) exit 75 ;;
*) echo "and $*" ;;
esac
"""
    given = {"NUMBA_CACHE_DIR": str(cluster.place / "ours" / "kernels")}
    code, log = cluster.run(cluster.stub(script(home), missing), **given)
    assert (code, "and verify" in log) == (0, False)
    assert f"NUMBA_CACHE_DIR={given['NUMBA_CACHE_DIR']}\n" in log
    last = missing.replace("exit 75", "exit 3").replace('"and $*"', '"and $*"; exit 1')
    code, log = cluster.run(cluster.stub(script(home), last))
    assert (code, f"and verify {home}/out --complete" in log) == (1, True)
    # Shards in directories of their own are checked when they are merged.
    code, log = cluster.run(cluster.stub(script(home, own=True), last))
    assert (code, "and verify" in log) == (0, False)


def test_exit_codes_pass_on_and_what_ran_out_of_time_is_queued_again(home, cluster):
    text = script(home)
    for code in (0, 1, 3, 143):
        assert cluster.run(cluster.stub(text, f"exit {code}\n"))[0] == code
    assert cluster.requeued() == []
    text = cluster.stub(text, "exit 75\n")
    assert cluster.run(text, 1, SLURM_RESTART_COUNT="3")[0] == 0
    assert cluster.requeued() == ["requeue 100_1"]
    code, log = cluster.run(text, 1, SLURM_RESTART_COUNT="4")  # not for ever
    assert (code, len(cluster.requeued())) == (75, 1)
    assert (
        "error: task 100_1 is not done after 4 restarts; submit the script again" in log
    )
    cluster.put("scontrol", "exit 1\n")
    code, log = cluster.run(text, 1)
    assert code == 75
    assert "could not be put into the queue again" in log


@pytest.mark.parametrize(
    ("number", "code", "again"), [("USR1", 0, True), ("TERM", 143, False)]
)
def test_signals_reach_the_program_and_only_a_warning_means_again(
    number, code, again, home, cluster
):
    ready = cluster.place / "ready"
    body = f'trap "exit 143" TERM\ntouch {ready}\nwhile :; do sleep 0.05; done\n'
    task = cluster.start(cluster.stub(script(home), body))
    wait_until(ready.exists)
    task.send_signal(getattr(signal, f"SIG{number}"))
    task.communicate(timeout=60)
    assert task.returncode == code
    assert cluster.requeued() == (["requeue 100_0"] if again else [])


@pytest.mark.parametrize(
    ("there", "instead", "code", "sentence"),
    [
        (str(PROGRAM), "/no/such/rattlesweep", 1, "does not see /no/such/rattlesweep"),
        (str(PROGRAM), "/bin/echo", 2, "this script is of rattlesweep"),
        ("sweep.yaml", "gone.yaml", 2, "gone.yaml"),
        ("/out", "/sweep.yaml/out", 1, "cannot write in"),
    ],
)
def test_environment_is_checked_before_anything_is_begun(
    there, instead, code, sentence, home, cluster
):
    text = script(home).replace(there, instead)
    if there != str(PROGRAM):
        text = cluster.stub(text, "echo begun\n")
    got, log = cluster.run(text)
    assert (got, len(log.strip().splitlines())) == (code, 1)
    assert log.startswith("error: ")
    assert sentence in log
