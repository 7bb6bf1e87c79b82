"""A command: its place in `--help`, its examples, and what goes wrong as a sentence and a code."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Literal, NoReturn

import click

from rattlesweep.cli.common.output import FAILED, INTERRUPTED, TERMINATED, WRONG, say
from rattlesweep.cli.common.progress import CompileNotice
from rattlesweep.errors import ConfigError, OutputError
from rattlesweep.integrate import SettingError, check_settings
from rattlesweep.integrate.compile import listening

# In the order of `--help`.
Section = Literal["Sweeps", "One run", "Pictures and pages", "Study"]


class Terminated(BaseException):
    """SIGTERM arrived."""


class Command(click.Command):
    """A command that turns what can go wrong into one sentence and an exit code."""

    def __init__(self, *args: Any, section: Section, resumes: bool, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.section, self._resumes = section, resumes

    def make_context(self, *args: Any, **kwargs: Any) -> click.Context:
        """Read the options; what is wrong with one of them is said as everything else is."""
        with _sentences(self._resumes):
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: click.Context) -> None:
        """Call the function, which returns the exit code, or None if all is done."""
        signal.signal(signal.SIGTERM, _terminate)
        with _sentences(self._resumes):
            check_settings()
            with listening(None if ctx.params.get("quiet") else CompileNotice()):
                code = super().invoke(ctx)
        if code:
            _leave(code)


def command(
    section: Section, *examples: str, resumes: bool = False
) -> Callable[[Callable[..., Any]], Command]:
    """Make a function a :class:`Command`.

    ``section`` is where `--help` lists it, ``examples`` are command lines that end its own help,
    and ``resumes`` says whether the same command resumes where it was stopped.
    """
    head = "Examples" if len(examples) > 1 else "Example"
    epilog = "\n  ".join([f"\b\n{head}:", *examples])
    return click.command(cls=Command, section=section, resumes=resumes, epilog=epilog)


def _terminate(number: int, frame: Any) -> NoReturn:
    raise Terminated


@contextmanager
def _sentences(resumes: bool) -> Iterator[None]:
    """Say what goes wrong, and leave with the exit code it has."""
    try:
        yield
    except (KeyboardInterrupt, Terminated) as error:
        # A second Ctrl-C is obeyed at once.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        term = isinstance(error, Terminated)
        what = "terminated" if term else "interrupted"
        kept = "; ".join(getattr(error, "__notes__", ())) or "completed work is kept"
        say(f"{what}; {kept}, and the same command resumes from there" if resumes else what)
        _leave(TERMINATED if term else INTERRUPTED)
    except BrokenPipeError:
        # The reader of standard output has gone; there is nobody to tell.
        _leave(FAILED)
    except (ConfigError, SettingError, OutputError) as error:
        for line in getattr(error, "messages", [str(error)]):
            say(f"error: {line}")
        _leave(FAILED if isinstance(error, OutputError) else WRONG)
    except OSError as error:
        # Such as a full disk behind standard output.
        say(f"error: {error.filename or 'cannot write'}: {error.strerror or error}")
        _leave(FAILED)


def _leave(code: int) -> NoReturn:
    """End the process; at once where a kernel still compiles and would hold up the exit."""
    try:
        sys.stdout.flush()
    except OSError:
        # What could not be written before cannot be now: Python would try again, and fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.stderr.flush()
    # Ours by name: an embedding program, such as a test runner, may have daemons of its own.
    if any(t.name.startswith("rattlesweep-") for t in threading.enumerate()):
        os._exit(code)
    raise SystemExit(code)
