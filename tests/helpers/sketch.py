"""A figure that costs nothing, in a module that the process which draws can import."""

import os
from pathlib import Path

from rattlesweep.errors import OutputError
from rattlesweep.analysis.style import new_figure


def draw(tables):
    figure = new_figure(2, 1)
    figure.add_subplot().plot(tables["values"]["x"])
    return figure


def hang(tables):
    """As a picture that takes for ever; a file says which process is at it."""
    Path(tables["values"]["path"][0].as_py()).write_text(str(os.getpid()))
    while True:
        pass


def refuse(tables):
    raise OutputError("cannot write x.svg: no space left on device")


def fail(tables):
    raise ValueError("a mistake of ours")
