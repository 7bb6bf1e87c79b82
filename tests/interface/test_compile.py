"""The notice that kernels are being compiled."""

import io
import re
import sys
import time

import pytest

from rattlesweep.cli.common import progress
from rattlesweep.integrate.compile import compiling, listening

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
