"""What the commands share, each thing once."""

from rattlesweep.cli.common.command import Command, Section, command
from rattlesweep.cli.common.exits import (
    DONE,
    EARLY,
    FAILED,
    INTERRUPTED,
    SOME_FAILED,
    TERMINATED,
    WRONG,
)  # fmt: skip
from rattlesweep.cli.common.output import print_summary, say, to_json
from rattlesweep.cli.common.progress import Meter

__all__ = ["DONE", "EARLY", "FAILED", "INTERRUPTED", "SOME_FAILED", "TERMINATED", "WRONG",
           "Command", "Meter", "Section", "command", "print_summary", "say", "to_json"]  # fmt: skip
