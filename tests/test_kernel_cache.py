"""Compiled kernels on disk: found again by a fresh process, each method its own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import kernels
import numpy as np
import oracle
import pytest

from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.cache import cached, directory, source_hash, specialise
from rattlesweep.integrate.kernels import compile_in_child
from rattlesweep.integrate.model import MODELS
from rattlesweep.integrate.tableau import METHODS

# The reduced model compiles fastest; what is cached and how is the same.
MODEL = "reduced"
NAMES = ("rk4", "dop853")


def batch():
    return kernels.reduced_batch(oracle.GH, [0.1, -0.2, 0.3], [1e-3, 1e-4, 1e-5], 1e-4, 50.0)


def states(name):
    out = integrate(batch(), METHODS[name], MODELS[MODEL], tol=1e-5, dt=0.5, threads=1)
    return {"y_end": out.y_end.tobytes().hex(), "n_steps": out.n_steps.tolist()}


def child(names):
    """Run in a fresh process: what the kernels give and where they came from."""
    from rattlesweep.integrate.kernels import kernel

    report = {}
    for name in names:
        found = states(name)
        stats = kernel(name, MODEL).stats
        found["hits"] = sum(stats.cache_hits.values())
        found["misses"] = sum(stats.cache_misses.values())
        found["path"] = stats.cache_path
        report[name] = found
    print(json.dumps(report))


def numbers(found):
    return np.frombuffer(bytes.fromhex(found["y_end"]))


def run(home, names, **environment):
    env = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    env |= {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(Path(__file__).parent), **environment}
    code = f"import test_kernel_cache as t; t.child({names!r})"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], env=env, capture_output=True, text=True,
        timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def first(home):
    return run(home, NAMES)


def test_every_process_runs_the_kernel_that_a_child_compiled(home, first):
    files = sorted(p for p in home.rglob("*.nb*") if p.is_file())
    assert [len([p for p in files if f"drive_{n}_{MODEL}" in p.name]) for n in NAMES] == [2, 2]
    # In the other order: the first to come must not give its kernel to the second.
    second = run(home, NAMES[::-1])
    for name in NAMES:
        for found in (first[name], second[name]):
            assert (found["hits"], found["misses"]) == (1, 0)
            assert Path(found["path"]).is_relative_to(home)
        assert second[name]["n_steps"] == first[name]["n_steps"]
        assert second[name]["y_end"] == first[name]["y_end"]
    assert sorted(p for p in home.rglob("*.nb*") if p.is_file()) == files


@pytest.mark.slow
def test_a_kernel_compiled_again_gives_the_same_bits(first, tmp_path):
    again = run(tmp_path, NAMES)
    for name in NAMES:
        assert again[name]["y_end"] == first[name]["y_end"]


def test_methods_are_not_mixed_up(first):
    difference = np.abs(numbers(first["rk4"]) - numbers(first["dop853"])).max()
    assert 1e-9 < difference < 1e-3
    for name in NAMES:
        here = states(name)
        assert first[name]["n_steps"] == here["n_steps"]
        assert here["y_end"] == first[name]["y_end"]


def test_a_kernel_that_does_not_compile_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    directory.cache_clear()
    with pytest.raises(RuntimeError, match="the kernel nonsense/full could not be compiled"):
        compile_in_child("nonsense", "full")
    assert not list(tmp_path.rglob("*.compiled"))
    directory.cache_clear()


def test_numba_cache_dir_is_respected(home, tmp_path):
    # Of a kernel that is not compiled here: only the place is asked for.
    code = (
        "from rattlesweep.integrate import cache; print(cache.directory(cache.__file__));"
        "import numba; print(numba.config.CACHE_DIR)"
    )
    env = {**os.environ, "XDG_CACHE_HOME": str(home), "NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    ours, theirs = done.stdout.split()
    assert Path(ours).parent == tmp_path / "numba" == Path(theirs)


def test_an_unwritable_home_is_no_obstacle(monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a directory")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    path = directory.__wrapped__(__file__)
    assert path.is_dir()
    assert not path.is_relative_to(tmp_path)
    path.rmdir()


def test_the_hash_depends_on_the_file_itself():
    assert source_hash(__file__) != source_hash(kernels.__file__)
    assert source_hash(__file__) == source_hash.__wrapped__(__file__)
    assert directory(__file__).name == source_hash(__file__)


def _template(x):
    return _inner(x) + OFFSET


OFFSET = 1
_inner = abs


def test_specialised_copies_see_their_own_globals(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    directory.cache_clear()
    one = specialise(_template, "one", OFFSET=10)
    two = specialise(_template, "two", OFFSET=20, _inner=float)
    assert (_template(-3), one(-3), two(-3)) == (4, 13, 17.0)
    compiled = [cached(f) for f in (one, two)]
    assert [f(-3) for f in compiled] == [13, 17.0]
    assert {p.name.split("-")[0] for p in tmp_path.rglob("*.nbi")} == {
        "test_kernel_cache.one",
        "test_kernel_cache.two",
    }
    directory.cache_clear()
