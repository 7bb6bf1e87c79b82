"""Command line: a command loads, calls and prints.

``--help`` imports all of these modules, so commands import what they call inside their functions.
"""

from rattlesweep.cli import results, single, sweeps
from rattlesweep.cli.command import main

__all__ = ["main", "results", "single", "sweeps"]
