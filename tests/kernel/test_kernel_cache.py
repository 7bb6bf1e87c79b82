"""Kernels on disk: where they are stored, who may write there, who finds them."""

import errno
import json
import os
import shutil
import signal
import stat
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import compiler
import fresh
import numba
import numpy as np
import pytest
from small_kernel import again, broken, forget_folders, load_small
from sweeping import CONFIGS

from rattlesweep.compiling import loading
from rattlesweep.compiling.intrinsics import INNER, apart
from rattlesweep.kernel import recipes
from rattlesweep.system.console import Bar, _warn_once
from rattlesweep.system.lockfile import LockFile

CONFIG = CONFIGS / "quickstart.yaml"


@pytest.fixture
def place(monkeypatch, tmp_path):
    """An empty cache, with this process' own kernels forgotten."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    monkeypatch.setattr(loading, "_loaded", {})
    forget_folders()
    yield tmp_path / "cache"
    forget_folders()


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A cache in which the small kernel is stored."""
    cache = tmp_path_factory.mktemp("filled") / "cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_CACHE_DIR", str(cache))
        patch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        patch.setattr(loading, "_loaded", {})
        assert again() == (13, False)
    forget_folders()
    return cache


@pytest.fixture
def stored(place, filled):
    """A cache in which the small kernel is stored, of this test's own."""
    shutil.copytree(filled, place)
    return place


def test_a_kernel_is_compiled_by_another_process_and_found_again(place):
    heard = []
    with loading.listening(heard.append):
        assert again() == (13, False)
    # The listener hears that it is stored.
    assert heard == [True]
    # This process has loaded it, and compiled nothing.
    compiled = load_small()
    assert (len(compiled.stats.cache_hits), len(compiled.stats.cache_misses)) == (1, 0)
    files = {path: path.read_bytes() for path in place.rglob("*.nb?")}
    with loading.listening(heard.append):
        assert again() == (13, True)
    assert heard == [True]
    assert {path: path.read_bytes() for path in place.rglob("*.nb?")} == files
    assert len(files) == 2
    assert stat.S_IMODE(loading.cache_folder().stat().st_mode) == 0o700


FOUND = """
import json
from rattlesweep.compiling import loading
from rattlesweep.compiling.intrinsics import INNER, apart
from rattlesweep.kernel.recipes import threaded_kernel
heard = []
with loading.listening(heard.append):
    threaded_kernel("dop853", "full")
hits = {
    order[0].__name__: len(compiled.stats.cache_hits)
    for order, compiled in loading._loaded.items()
}
print(json.dumps([heard, hits]))
"""


@numba.njit(**INNER)
def one_more(x):
    apart()
    return x + 1.0


def twice(x):
    return 2.0 * one_more(x)


def test_what_a_kernel_links_in_is_its_own():
    kernel = loading.Kernel(twice, (1.0,), {})
    compiled = loading._typed(numba.njit(twice), kernel)
    assert compiled(3.0) == 8.0
    (whole,) = compiled.overloads.values()
    (linked,) = one_more.overloads.values()
    name = linked.fndesc.llvm_func_name
    code = whole.library.get_llvm_str()
    (line,) = [
        line for line in code.splitlines() if f"@{name}(" in line and "define" in line
    ]
    # Not one of the process, which the next kernel with such a name would use.
    assert line.startswith("define internal ")
    # A function of others is compiled as ever.
    assert numba.njit([numba.float64(numba.float64)])(twice)(3.0) == 8.0
    assert linked.library.get_pointer_to_function(name) != 0


def test_a_kernel_that_cannot_be_compiled_leaves_no_lock(place):
    with pytest.raises(numba.TypingError):
        loading.compile_orders([("small_kernel", "broken", ["any"])])
    lock = LockFile(Path(f"{loading._place(broken, 'any')}.lock"))
    assert lock.acquire(0.0)
    lock.release()


def test_a_compiler_that_cannot_start_does_not_hold_up_the_next_order(monkeypatch):
    def fail():
        raise OSError("no more processes")

    monkeypatch.setattr(compiler, "_start", fail)
    tests_own = compiler.Compiler()
    for _ in range(2):
        with pytest.raises(OSError, match="no more processes"):
            tests_own.start([])


def test_the_next_process_finds_all_parts_of_a_kernel():
    recipes.threaded_kernel("dop853", "full")
    heard, hits = json.loads(python(FOUND).stdout)
    assert heard == []
    assert {"work_recipe", "attempt_recipe", "drive_recipe"} <= hits.keys()
    assert set(hits.values()) == {1}


def test_other_sources_have_another_folder(place, monkeypatch, tmp_path):
    package = tmp_path / "package"
    for room in ("compiling", "kernel", "motion", "physics"):
        shutil.copytree(loading.PACKAGE / room, package / room)
    monkeypatch.setattr(loading, "PACKAGE", package)
    copied = loading.source_hash.__wrapped__()
    assert copied != loading.source_hash()  # another checkout
    assert loading.source_hash.__wrapped__() == copied
    source = package / "physics" / "full.py"
    source.write_text(source.read_text() + "\n")
    assert loading.source_hash.__wrapped__() != copied


UNSAFE = {
    "a group may write": lambda folder: folder.chmod(0o770),
    "all may rename": lambda folder: folder.parent.chmod(0o777),
    "a group may rename": lambda folder: folder.parent.chmod(0o775),
    "it is a link": lambda folder: link_to(folder.rename(folder.with_name("x"))),
}


def link_to(folder):
    """Put a link to the folder that was moved where it had been."""
    folder.with_name(loading.source_hash()).symlink_to(folder)


@pytest.mark.parametrize("unsafe", UNSAFE)
def test_an_unsafe_folder_is_neither_read_nor_written(unsafe, stored):
    assert again() == (13, True)
    folder = loading.cache_folder()
    # Files that must stay as they are.
    files = list(folder.rglob("*.nb?"))
    before = [path.read_bytes() for path in files]
    UNSAFE[unsafe](folder)
    assert again() == (13, False)
    folder = loading.cache_folder()
    # The user's own cache is used instead of the one that was named.
    assert folder.parent == stored.parent / "user" / "rattlesweep"
    assert [path.read_bytes() for path in files] == before
    assert again() == (13, True)


def test_a_private_folder_may_pass_its_group_on(stored):
    loading.cache_folder().chmod(0o2700)
    assert stat.S_IMODE(loading.cache_folder().stat().st_mode) == 0o2700
    assert again() == (13, True)
    assert loading.cache_folder().parent == stored


def test_what_was_checked_is_what_is_loaded(stored, monkeypatch):
    folder = loading.cache_folder()
    is_private = loading.is_private

    def exchange(checked):
        # Another's folder takes the place of the one that has just been checked.
        private = is_private(checked)
        if folder == checked and folder.is_dir():
            monkeypatch.setattr(loading, "is_private", is_private)
            folder.rename(folder.with_name("mine"))
            shutil.copytree(folder.with_name("mine"), folder)
            for path in folder.rglob("*.nb?"):
                path.write_bytes(b"another's code")
        return private

    loading._loaded.clear()
    monkeypatch.setattr(loading, "is_private", exchange)
    compiled = load_small()
    # The kernel of the folder that was checked is loaded, and not compiled anew.
    assert (compiled(-3), len(compiled.stats.cache_hits)) == (13, 1)


def test_sources_in_a_zip_are_hashed(monkeypatch, tmp_path):
    def packed(more):
        path = tmp_path / "package.zip"
        with zipfile.ZipFile(path, "w") as archive:
            for room in ("compiling", "kernel", "motion", "physics"):
                for file in (package / room).rglob("*.py"):
                    inside = f"rattlesweep/{file.relative_to(package).as_posix()}"
                    archive.writestr(inside, file.read_bytes() + more)
        monkeypatch.setattr(loading, "PACKAGE", path / "rattlesweep")
        hashes = loading.source_hash, loading.program_hash
        return [function.__wrapped__() for function in hashes]

    package = loading.PACKAGE
    plain = packed(b"")
    assert packed(b"") == plain
    changed = packed(b"# another line\n")
    assert changed[0] != plain[0]
    assert changed[1] != plain[1]


def test_a_private_temporary_folder_is_removed_with_its_process(tmp_path):
    nowhere = "/proc/nowhere"
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    env = {
        "NUMBA_CACHE_DIR": nowhere,
        "XDG_CACHE_HOME": nowhere,
        "TMPDIR": str(temporary),
    }
    code = (
        "import small_kernel as s; "
        "print(s.again(), s.load_small()(-4), s.loading.cache_folder())"
    )
    done = python(code, **env)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"(13, False) 14 {temporary}/rattlesweep-")
    assert not list(temporary.iterdir())


def test_a_kernel_stays_in_memory_where_the_disk_is_full(place, monkeypatch):
    def fail(*args, **kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    # The processes that compile fail as well: their command ends at once.
    monkeypatch.setattr(loading, "CODE", "raise SystemExit(1)")
    monkeypatch.setattr(numba.core.caching.IndexDataCacheFile, "save", fail)
    assert again() == (13, False)
    assert not list(place.rglob("*.nb?"))


def test_a_kernel_is_compiled_where_no_other_process_starts(place, monkeypatch):
    def fail(*args, **kwargs):
        raise OSError(errno.ENOEXEC, "Exec format error")

    monkeypatch.setattr(subprocess, "Popen", fail)
    assert again() == (13, False)
    assert again() == (13, True)


def test_a_user_without_a_home_compiles_into_a_temporary_folder(place, monkeypatch):
    def nowhere(*args):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setattr("platformdirs.user_cache_dir", nowhere)
    heard = []
    with loading.listening(heard.append):
        assert again() == (13, False)
    assert loading.cache_folder().parent.name.startswith("rattlesweep-")
    # The listener hears that later runs will not find the kernel.
    assert heard == [False]


def test_a_cache_that_a_group_may_write_is_told_of_once(
    place, monkeypatch, tmp_path, capfd
):
    # As `~/.cache` is where new folders are open to a group (umask 002).
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / ".cache"))
    (tmp_path / ".cache").mkdir()
    (tmp_path / ".cache").chmod(0o775)
    _warn_once.cache_clear()
    for _ in range(2):
        with loading.listening(Bar.of_call(progress=False).compiling):
            assert again() == (13, False)
    said = capfd.readouterr().err
    assert said.count("compiling a kernel") == 1
    assert "run `chmod go-w ~/.cache`, or name such a folder by NUMBA_CACHE_DIR" in said
    _warn_once.cache_clear()
    # A quiet command says nothing.
    Bar.of_command(quiet=True).compiling(stored=False)
    assert capfd.readouterr().err == ""
    (tmp_path / ".cache").chmod(0o755)
    assert again() == (13, False)
    assert again() == (13, True)


def test_an_error_of_numba_is_not_hidden_by_a_slow_start(place, monkeypatch):
    def fail(*args, **kwargs):
        raise AttributeError("this version of Numba has no such method")

    monkeypatch.setattr(loading, "CODE", "raise SystemExit(1)")
    monkeypatch.setattr(numba.core.caching.FunctionCache, "save_overload", fail)
    with pytest.raises(AttributeError, match="no such method"):
        again()


def test_a_damaged_file_is_compiled_again(stored):
    (path,) = stored.rglob("*.nbc")
    path.write_bytes(path.read_bytes()[:1000])
    assert again()[0] == 13


def python(code, **environment):
    """Run code in a fresh process that can import this file."""
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment,
    )


def test_ctrl_c_ends_a_command_that_compiles_and_its_processes(tmp_path):
    cache = tmp_path / "cache"
    command = [
        sys.executable,
        "-m",
        "rattlesweep",
        "run",
        str(CONFIG),
        "--output",
        "out",
    ]
    with subprocess.Popen(
        command,
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
    ) as process:
        said = ""
        while "compiling a kernel" not in said:
            said = process.stderr.readline()
            assert said
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
    assert process.returncode == 130
    assert "interrupted" in rest
    assert "Traceback" not in rest

    def compiling():
        return [
            path
            for path in Path("/proc").glob("[0-9]*/environ")
            if str(cache) in text(path)
        ]

    for _ in range(600):
        if not compiling():
            break
        time.sleep(0.05)
    assert not compiling()


def text(path):
    try:
        return path.read_text()
    except OSError:
        return ""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize(
    "layer", ["omp", pytest.param("workqueue", marks=pytest.mark.slow)]
)
def test_threads_and_forked_processes_integrate(layer):
    done = python(f"import fresh; fresh.fork({layer!r})", NUMBA_THREADING_LAYER=layer)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("NUMBA_NUM_THREADS=0", "it must be a whole number from 1 to 4096"),
        ("NUMBA_THREADING_LAYER=nonsense", "layer requested 'nonsense' is unknown"),
    ],
)
def test_an_impossible_setting_is_reported_in_one_sentence(setting, said, tmp_path):
    code = (
        f"import sys; sys.argv = ['rattlesweep', 'run', {str(CONFIG)!r}, '--output', "
        f"{str(tmp_path / 'out')!r}, '-q']; from rattlesweep.cli import main; main()"
    )
    done = python(code, **dict([setting.split("=")]))
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"error: {setting.split('=')[0]}")
    assert said in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_run_can_be_stepped_through_in_python():
    plain = python("import fresh; print(fresh.both())", NUMBA_DISABLE_JIT="1")
    assert plain.returncode == 0, plain.stderr
    numbers, *steps = json.loads(fresh.both())
    plain_numbers, *same_steps = json.loads(plain.stdout)
    assert same_steps == steps
    np.testing.assert_allclose(plain_numbers, numbers, rtol=0, atol=1e-12)
