"""Compiled kernels on disk: found again by a fresh process, each method its own."""

import errno
import fcntl
import json
import multiprocessing
import os
import pickle
import pwd
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import kernels
import llvmlite
import numba
import numpy as np
import oracle
import pytest

from rattlesweep.integrate import SettingError, loading
from rattlesweep.integrate import cache as storage
from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.cache import cached, directory, source_hash, specialise
from rattlesweep.integrate.lanes import build as built
from rattlesweep.integrate.model import MODELS
from rattlesweep.integrate.tableau import METHODS

# The reduced model compiles fastest; what is cached and how is the same.
MODEL = "reduced"
NAMES = ("rk4", "dop853")


def states(name, model=MODEL):
    if model == MODEL:
        batch = kernels.reduced_batch(oracle.GH, [0.1, -0.2, 0.3], [1e-3, 1e-4, 1e-5], 1e-4, 50.0)
    else:
        batch = kernels.full_batch(oracle.GH, [0.1, -0.2, 0.3], t_end=50.0)
    out = integrate(batch, METHODS[name], MODELS[model], tol=1e-5, dt=0.5, threads=1)
    return {"y_end": out.y_end.tobytes().hex(), "n_steps": out.n_steps.tolist()}


def child(names):
    """Run in a fresh process: what the kernels give and where they came from."""
    report = {name: states(name) for name in names}
    for name, found in report.items():
        stats = loading.loaded(built.attempt, name, MODEL).stats
        counts = (sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
        found |= {"counts": counts, "path": stats.cache_path}
    print(json.dumps(report))


def python(code, **environment):
    """Run code in a fresh process that can import this file."""
    path = os.pathsep.join(sys.path)
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=900,
        env={**os.environ, "PYTHONPATH": path, **environment}, check=False,
    )  # fmt: skip


def run(home, names):
    done = python(
        f"import test_kernel_cache as t; t.child({names!r})", XDG_CACHE_HOME=str(home),
        NUMBA_CACHE_DIR="", PYTHONWARNINGS="error",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def first(home):
    return run(home, NAMES)


@pytest.mark.slow
def test_every_process_runs_the_kernel_that_a_child_compiled(home, first):
    files = sorted(home.rglob("*.kernel"))
    assert [len([p for p in files if f"attempt_{n}_{MODEL}" in p.name]) for n in NAMES] == [1, 1]
    # One driver for all of them; what is around the step is that of all methods with error control.
    shared = ("drive-", f"work_{MODEL}-", f"work_{MODEL}_fixed-", "settle-", "settle_fixed-")
    assert [len([p for p in files if f".{n}" in p.name]) for n in shared] == [1] * 5
    assert len(files) == 7
    # In the other order: the first to come must not give its kernel to the second.
    second = run(home, NAMES[::-1])
    for name in NAMES:
        for found in (first[name], second[name]):
            assert found["counts"] == [1, 0]
            assert Path(found["path"]).is_relative_to(home)
        assert second[name]["n_steps"] == first[name]["n_steps"]
        assert second[name]["y_end"] == first[name]["y_end"]
    assert sorted(home.rglob("*.kernel")) == files


@pytest.mark.slow
def test_a_kernel_compiled_again_gives_the_same_bits_and_methods_are_not_mixed_up(first, tmp_path):
    again = run(tmp_path, NAMES)
    ends = []
    for name in NAMES:
        assert again[name]["y_end"] == first[name]["y_end"] == states(name)["y_end"]
        assert first[name]["n_steps"] == states(name)["n_steps"]
        ends.append(np.frombuffer(bytes.fromhex(first[name]["y_end"])))
    assert 1e-9 < np.abs(ends[0] - ends[1]).max() < 1e-3


def _template(x):
    return _inner(x) + OFFSET


OFFSET = 1
_inner = abs


@pytest.fixture
def place(monkeypatch, tmp_path):
    """A new cache directory for this process, and its user's other ones out of reach."""
    home = tmp_path / "cache"
    home.mkdir(mode=0o700)
    use(monkeypatch, home, tmp_path / "other")
    yield home
    directory.cache_clear()


def use(monkeypatch, numba_dir, user_dir):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(numba_dir))
    monkeypatch.setenv("XDG_CACHE_HOME", str(user_dir))
    directory.cache_clear()


def test_specialised_copies_see_their_own_globals(place):
    one = specialise(_template, "one", OFFSET=10)
    two = specialise(_template, "two", OFFSET=20, _inner=float)
    assert (_template(-3), one(-3), two(-3)) == (4, 13, 17.0)
    compiled = [cached(f) for f in (one, two)]
    assert [f(-3) for f in compiled] == [13, 17.0]
    assert {p.name.split("-")[0] for p in place.rglob("*.kernel")} == {
        "test_kernel_cache.one",
        "test_kernel_cache.two",
    }


# -- what is loaded is whole, and ours -------------------------------------------------------------


def small(name):
    """As kernels have it: a function not yet compiled, and arguments to call it with."""
    if name == "wrong":
        raise ValueError("this one does not compile")
    return cached(specialise(_template, name, OFFSET=10)), (-3,)


def used():
    """Result of a function in the cache, and whether it was found there."""
    compiled, arguments = small("small")
    return compiled(*arguments), bool(compiled.stats.cache_hits)


def only(place):
    (path,) = place.rglob("*.kernel")
    return path


class Planted:
    """A pickle that makes a file when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def flip(path, blob):
    path.write_bytes(blob[:2000] + bytes([blob[2000] ^ 1]) + blob[2001:])


def link(path, blob):
    path.rename(path.with_name("moved")).with_name(path.name).symlink_to("moved")


DAMAGES = {
    "empty": lambda path, blob: path.write_bytes(b""),
    "short": lambda path, blob: path.write_bytes(blob[:-100]),
    "only a checksum": lambda path, blob: path.write_bytes(blob[:32]),
    "a flipped bit": flip,
    "not ours to read": lambda path, blob: path.write_bytes(
        pickle.dumps(Planted(path.with_name("executed")))
    ),
    "a pipe": lambda path, blob: (path.unlink(), os.mkfifo(path)),
    "another's link": link,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_compiled_again(damage, place):
    assert used() == (13, False)
    assert used() == (13, True)
    path = only(place)
    whole = path.read_bytes()
    DAMAGES[damage](path, whole)
    assert used() == (13, False)
    assert used() == (13, True)
    assert path.is_file()
    assert not path.is_symlink()
    assert not path.with_name("executed").exists()


def test_code_of_another_function_is_not_taken(place):
    assert used() == (13, False)
    mine = only(place)
    other, arguments = small("larger")
    other(*arguments)
    (theirs,) = set(place.rglob("*.kernel")) - {mine}
    theirs.rename(mine)
    assert used() == (13, False)


def plant(path):
    """Put a well-formed file in place that is executed if it is loaded; what that would make."""
    mark = path.with_name("executed")
    path.write_bytes(storage._sealed(path.name, pickle.dumps(Planted(mark))))
    return mark


def give_away(path):
    if os.geteuid() != 0:
        pytest.skip("only root can give a file to another user")
    os.chown(path, 65534, 65534)


@pytest.mark.parametrize("whose", ["all may write", "a group may write", "another user's"])
@pytest.mark.parametrize("what", ["file", "directory"])
def test_what_others_can_change_is_not_loaded(whose, what, place, monkeypatch):
    used()
    path = only(place)
    mark = plant(path)
    # Ours would be executed.
    with pytest.raises(TypeError):
        used()
    mark.unlink()
    target = path if what == "file" else path.parent
    if whose == "another user's":
        give_away(target)
    else:
        target.chmod(0o777 if whose.startswith("all") else 0o770)
        # A group that no user has to himself.
        os.chown(target, -1, 65534) if os.geteuid() == 0 else None
        if os.geteuid() and whose.startswith("a group"):
            pytest.skip("only root can choose the group")
    directory.cache_clear()
    assert used() == (13, False)
    assert not mark.exists()
    # It works somewhere else, or in place of the foreign file.
    assert used() == (13, True)


def test_a_sticky_directory_for_all_is_shared_safely(place, monkeypatch, tmp_path):
    place.chmod(0o1777)
    used()
    found = only(place)
    assert found.parent.stat().st_mode & 0o777 == 0o700
    # Somebody else was there first.
    give_away(found.parent)
    directory.cache_clear()
    assert used() == (13, False)
    assert directory(__file__) == tmp_path / "other" / "rattlesweep" / source_hash(__file__)


def test_a_directory_in_which_all_can_rename_is_not_used(place, monkeypatch, tmp_path):
    (place / "mine").mkdir(mode=0o700)
    place.chmod(0o777)
    use(monkeypatch, place / "mine", place / "too")
    assert directory(__file__) is None
    assert not (place / "too").exists()


def test_root_leaves_the_home_of_another_user_alone(place, monkeypatch):
    # As under sudo, which keeps HOME.
    give_away(place)
    use(monkeypatch, "", place / ".cache")
    assert directory(__file__) is None
    assert not list(place.iterdir())


def test_odd_homes_lead_to_no_odd_places(monkeypatch, tmp_path):
    home = os.path.join(pwd.getpwuid(os.geteuid()).pw_dir, ".cache")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    for odd in ("", "relative"):
        monkeypatch.setenv("HOME", odd)
        assert storage._user_directory() == home
    monkeypatch.setenv("HOME", str(tmp_path))
    assert storage._user_directory() == str(tmp_path / ".cache")
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    assert storage._user_directory() == "/caches"


def test_on_a_full_disk_code_stays_in_memory(place, monkeypatch):
    def fail(*args, **kwargs):
        raise OSError(errno.ENOSPC, "refused")

    monkeypatch.setattr(tempfile, "mkstemp", fail)
    assert used() == (13, False)
    assert not list(place.rglob("*.kernel"))


@pytest.mark.parametrize("what", ["no locks", "read-only"])
def test_where_nothing_can_be_kept_it_works_all_the_same(what, place, monkeypatch, tmp_path):
    def fail(*args, **kwargs):
        raise OSError(errno.ENOLCK, "refused")

    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    if what == "no locks":
        monkeypatch.setattr(fcntl, "flock", fail)
    else:
        use(monkeypatch, "/proc/nowhere", "/proc/nowhere")
        assert directory(__file__) is None
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    compiled = loading.loaded(small, what.replace(" ", "_").replace("-", "_"))
    assert compiled(-3) == 13
    assert (len(compiled.stats.cache_hits), len(compiled.stats.cache_misses)) == (1, 0)
    assert len(list(place.rglob("*.kernel"))) == (what == "no locks")
    assert not list(temporary.iterdir())


def test_a_kernel_that_does_not_compile_says_so(place, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    with (
        pytest.raises(RuntimeError, match=r"(?s)kernel wrong could not be .*this one"),
        loading.Pool().compiler() as compiler,
    ):
        compiler(small, ("wrong",))


def test_a_process_that_ends_while_it_compiles_is_said(place):
    compiler = loading.Compiler()
    compiler._process.kill()
    with pytest.raises(RuntimeError, match="could not be compiled:\nits process ended with -9"):
        compiler(small, ("small",))


def test_code_of_other_versions_has_other_names(place, monkeypatch):
    compiled, (argument,) = small("small")
    context = compiled.targetctx
    context.refresh()

    def name():
        return compiled._cache.name((numba.typeof(argument),), context)

    names = {name()}
    for module, key in ((sys, "version"), (numba, "__version__"), (llvmlite, "__version__")):
        with monkeypatch.context() as patch:
            patch.setattr(module, key, "3.14")
            names.add(name())
    with monkeypatch.context() as patch:
        patch.setattr(numba.config, "CPU_NAME", "generic")
        names.add(name())
    assert len(names) == 5


# -- processes and threads -------------------------------------------------------------------------


def pool(layer):
    """In a fresh process: results before a fork, and of a pool of forked processes."""
    before = states("dop853", "full")
    assert numba.threading_layer() == layer
    with multiprocessing.get_context("fork").Pool(2) as workers:
        after = workers.starmap(states, [("dop853", "full")] * 4)
    assert after == [before] * 4
    assert states("dop853", "full") == before


def side_by_side():
    """In a fresh process: several threads that integrate."""
    whole, found = states("dop853", "full"), []
    threads = [
        threading.Thread(target=lambda: found.extend(states("dop853", "full") for _ in range(20)))
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [whole] * 80


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize("layer", ["omp", pytest.param("workqueue", marks=pytest.mark.slow)])
def test_threads_and_a_pool_that_is_forked_after_the_first_use_integrate(layer):
    code = f"import test_kernel_cache as t; t.side_by_side(); t.pool({layer!r})"
    done = python(code, NUMBA_THREADING_LAYER=layer)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_threading_layer_that_cannot_be_is_one_sentence(monkeypatch):
    def fail():
        raise ValueError("The threading layer requested 'none' is unknown to Numba.\nHints follow.")

    monkeypatch.setattr(numba, "get_num_threads", fail)
    monkeypatch.setattr(numba.config, "THREADING_LAYER", "none")
    with pytest.raises(SettingError, match=r"^NUMBA_THREADING_LAYER=none: The .* to Numba; leave"):
        built.parallel()


THREADS = "it must be a whole number from 1 to 4096"


@pytest.mark.parametrize(
    ("setting", "said"),
    [("NUMBA_NUM_THREADS=0", THREADS)]
    + [pytest.param(*case, marks=pytest.mark.slow) for case in (
        ("NUMBA_NUM_THREADS=many", THREADS),
        ("NUMBA_THREADING_LAYER=nonsense", "The threading layer requested 'nonsense' is unknown"),
    )],
)  # fmt: skip
def test_a_setting_that_cannot_be_is_one_sentence(setting, said, tmp_path):
    config = Path(__file__).parents[2] / "configs" / "quickstart.yaml"
    code = (
        f"import sys; sys.argv = ['rattlesweep', 'run', {str(config)!r}, '--output', "
        f"{str(tmp_path / 'out')!r}, '-q']; from rattlesweep.cli import main; main()"
    )
    done = python(code, **dict([setting.split("=")]))
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"error: {setting}: ")
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
