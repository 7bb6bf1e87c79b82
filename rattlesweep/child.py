"""Processes that serve this one: they do one kind of work, line by line from standard input."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Literal

PACKAGE = Path(__file__).resolve().parent


def start(
    module: str, on_interrupt: Literal["SIG_DFL", "SIG_IGN"], **environment: str
) -> subprocess.Popen[bytes]:
    """Begin a process of this package that runs the function ``serve`` of one of its modules.

    A Ctrl-C that the whole group is sent ends it without a word, or is left to the process that
    waits.  Its three streams are pipes, and it does not look for garbage: that would take an
    eighth of the time of compiling, and a sixth of drawing.
    """
    path = os.pathsep.join(filter(None, [str(PACKAGE.parent), os.environ.get("PYTHONPATH")]))
    call = (
        f"import gc, signal; gc.disable(); signal.signal(signal.SIGINT, signal.{on_interrupt}); "
        f"from {module} import serve; serve()"
    )
    return subprocess.Popen(
        # -P: a package of this name in the working directory is another one.
        [sys.executable, "-P", "-c", call],
        env=os.environ | environment | {"PYTHONPATH": path},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
