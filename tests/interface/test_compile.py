"""Kernels ahead of their first use, and what is said while one is being compiled."""

import io
import re
import sys
import time

import pytest
from sweeping import CONFIGS, invoke

from rattlesweep.cli.common import progress
from rattlesweep.integrate import cache
from rattlesweep.integrate.compiling import compiling, listening
from rattlesweep.integrate.tableau import METHODS

WORDS = "compiling the kernel for this machine, once (about "


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_sees_a_clock_that_ticks(monkeypatch):
    shown = Terminal()
    monkeypatch.setattr(sys, "stderr", shown)
    with listening(progress.CompileNotice(tick=0.001)), compiling("dop853/full"):
        end = time.monotonic() + 60
        while shown.getvalue().count(WORDS) < 4 and time.monotonic() < end:
            time.sleep(0.01)
    assert len(re.findall(rf"{re.escape(WORDS)}\d+ s\): \d\d:\d\d", shown.getvalue())) >= 4
    # The line is gone when the kernel is there.
    assert shown.getvalue().split("\r")[-2].strip() == ""


def test_two_at_a_time_have_one_clock_that_goes_on(monkeypatch):
    shown, bars = Terminal(), []
    monkeypatch.setattr(sys, "stderr", shown)
    made = progress.new_bar
    monkeypatch.setattr(progress, "new_bar", lambda **how: bars.append(made(**how)) or bars[-1])
    notice = progress.CompileNotice(tick=0.001)
    with listening(notice):
        with compiling("step"), compiling("search"):
            assert len(bars) == 1
            bars[0].start_t -= 3600
            notice._spent = 3600.0
        notice._spent = 3600.0
        with compiling("later"):
            assert len(bars) == 2
    assert "1:00:00" in shown.getvalue().split(WORDS)[-1]


def test_elsewhere_it_is_one_line_or_none(capfd):
    notice = progress.CompileNotice()
    for listener in (notice, notice, None):
        with listening(listener), compiling("dop853/full"):
            pass
    with compiling("dop853/full"):
        pass
    assert capfd.readouterr().err.count(WORDS) == 1


def test_compilation_is_no_part_of_the_rate(monkeypatch):
    clock, shown = [0.0], []
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    meter = progress.Meter()
    monkeypatch.setattr(meter, "show", lambda *words: shown.append(words))
    report = meter.counting("integrating")
    for clock[0], fraction in ((30.0, 0.1), (40.0, 0.2)):
        report(fraction)
    assert shown == [(0.1, "integrating", 30, None), (0.2, "integrating", 40, pytest.approx(80))]


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A cache directory in which nothing is, and loading that takes no time."""
    path = tmp_path / "cache" / cache.source_hash(cache.__file__)
    path.mkdir(parents=True)
    monkeypatch.setattr(cache, "directory", lambda *file: path)
    there: set[str] = set()

    def load(*words: object) -> None:
        if str(words) not in there:
            there.add(str(words))
            cache.KernelCache.compilations += 1

    for name in (
        "sweeps.blocks.block.load_kernel",
        "sweeps.cases.sampler.draw_bodies",
        "integrate.follow.kernels.load_all",
    ):
        monkeypatch.setattr(f"rattlesweep.{name}", load)
    return path


def lines(*args: object) -> list[list[str]]:
    result = invoke("compile", *args)
    assert result.exit_code == 0
    return [line.split("  ", 1) for line in result.stdout.splitlines()]


def test_a_line_a_kernel(place):
    assert [name for name, _ in lines(CONFIGS / "gh.yaml")] == ["sweep dop853 full"]
    first, again = lines(), lines()
    assert [name for name, _ in first] == ["bodies", "sweep dop853 full"]
    assert [words.strip() for _, words in first] == ["0.0 s"] * 2
    assert [words.strip() for _, words in again] == ["already there"] * 2
    names = [name for name, _ in lines("--all")]
    assert len(set(names)) == len(names)
    assert {f"sweep {method} full" for method in METHODS} <= set(names)
    assert {"sweep dop853 reduced", "sweep dop853 full lyapunov", "bodies"} <= set(names)
    assert {"trajectory dop853 reduced", "trajectory dop853 full"} <= set(names)
    assert {words.strip() for _, words in lines("--all")} == {"already there"}


def test_the_closed_form_needs_none(place, tmp_path):
    config = tmp_path / "closed.yaml"
    config.write_text("bodies: {source: preset, name: GH}\nspin: {n_i: 0.1, omega_xy0: 0.01}\n"
                      "model: gh\n")  # fmt: skip
    assert lines(config) == []


def test_kernels_of_other_versions_are_removed(place):
    root = place.parent
    old = [root / ("0" * 16), root / f"{'1' * 16}-{'2' * 8}"]
    kept = [place, root / ("3" * 16), root / "else", root / f"{place.name[:16]}-{'4' * 8}"]
    for path in (*old, *kept[1:]):
        path.mkdir()
        (path / "f.kernel").write_bytes(b"code")
    (kept[1] / "of others").touch()
    assert "removed: 2 directories of other versions" in invoke("compile").stderr
    assert sorted(root.iterdir()) == sorted(kept)


def test_no_place_to_keep_kernels_is_said(monkeypatch):
    monkeypatch.setattr(cache, "directory", lambda *file: None)
    result = invoke("compile")
    assert (result.exit_code, result.stdout) == (1, "")
    assert "there is no directory in which kernels can be kept" in result.stderr
