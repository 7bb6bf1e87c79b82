"""What people look at: pictures, reports, single runs, speed against accuracy."""

import os
import sys
from contextlib import suppress


def _import_matplotlib() -> None:
    """Import Matplotlib although MPLBACKEND names a backend that is not installed.

    Notebooks set it for all that they start.  Pictures here are drawn without it.
    """
    named = os.environ.get("MPLBACKEND")
    if not named or "matplotlib" in sys.modules:
        return
    # Without the name the import cannot fail, and what has failed cannot be repeated.
    del os.environ["MPLBACKEND"]
    try:
        import matplotlib as mpl
    finally:
        os.environ["MPLBACKEND"] = named
    with suppress(ValueError):
        mpl.rcParams["backend"] = named


_import_matplotlib()
