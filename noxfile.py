"""Sessions that try rattlesweep with other versions: `nox`, or `nox -s lowest`.

Each has an environment of its own, made by uv if it is installed.  Sessions for Pythons
that are missing are skipped.
"""

import shutil
import tempfile
from pathlib import Path

import nox

nox.needs_version = ">=2025.2.9"
nox.options.default_venv_backend = "uv|virtualenv"
# The versions in the classifiers.
PYTHONS = nox.project.python_versions(nox.project.load_toml("pyproject.toml"))
# The golden sweep, and one command of each kind.
SHORT = ("tests/work/test_golden.py", "tests/interface/test_transcripts.py")
AVX512 = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL X86_V4"


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """Run the quick tests, or what is given after `--`."""
    session.install("-e", ".[test]")
    session.run("pytest", "-q", *session.posargs)
    _compare_golden(session)


@nox.session(python=PYTHONS, default=False)
def short(session: nox.Session) -> None:
    """Run the golden sweep and one command of each kind."""
    session.install("-e", ".[test]")
    session.run("pytest", "-q", "-n", "1", *SHORT)
    _compare_golden(session)


@nox.session(python=PYTHONS[0], venv_backend="uv")
def lowest(session: nox.Session) -> None:
    """Run the short tests with the lowest versions that pyproject.toml allows."""
    session.install("--resolution", "lowest-direct", "-e", ".[test]")
    # Old packages warn of what new ones have deprecated.
    session.run("pytest", "-q", "-n", "1", "-W", "ignore", *SHORT, *session.posargs)
    _compare_golden(session)


@nox.session(python=PYTHONS[0])
def lint(session: nox.Session) -> None:
    """Check style, and which rooms import which."""
    session.install("-e", ".[test]")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("lint-imports")


@nox.session(python=PYTHONS[0])
def types(session: nox.Session) -> None:
    """Check types."""
    session.install("-e", ".[test]")
    session.run("mypy")


@nox.session(python=PYTHONS[0])
def site(session: nox.Session) -> None:
    """Build the documentation."""
    session.install("-e", ".[docs]")
    session.run("mkdocs", "build", "--strict")


@nox.session(python=PYTHONS[0], default=False)
def release(session: nox.Session) -> None:
    """Build both archives, check them, and try them in empty folders."""
    archives = Path("dist").resolve()
    shutil.rmtree(archives, ignore_errors=True)
    session.install("build", "twine")
    session.run("python", "-m", "build", "--outdir", str(archives))
    [wheel] = archives.glob("*.whl")
    [source] = archives.glob("*.tar.gz")
    session.run("twine", "check", "--strict", str(wheel), str(source))

    session.install(f"rattlesweep[test] @ {wheel.as_uri()}")
    with tempfile.TemporaryDirectory() as folder, session.chdir(folder):
        session.run("rattlesweep", "init", "mine.yaml")
        session.run("rattlesweep", "run", "mine.yaml", "--set", "bodies.samples=5")
    with tempfile.TemporaryDirectory() as folder, session.chdir(folder):
        shutil.unpack_archive(source, folder, filter="data")
        [unpacked] = Path(folder).iterdir()
        # The tests must find the installed package alone.
        shutil.rmtree(unpacked / "rattlesweep")
        session.chdir(unpacked)
        session.run("pytest", "-q", "-n", "1", *SHORT)


def _compare_golden(session: nox.Session) -> None:
    """Print the versions, and which bits of the golden sweep they give.

    It was made without AVX-512, with which NumPy rounds some angles otherwise.
    """
    session.run(
        "python",
        "-W",
        "ignore",  # versions of NumPy differ in the names of features
        "tests/golden/make.py",
        "--compare",
        env={"NPY_DISABLE_CPU_FEATURES": AVX512},
    )
