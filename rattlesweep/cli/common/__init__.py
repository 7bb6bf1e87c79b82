"""What the commands share, each thing once."""

from rattlesweep.cli.common.command import Command, Section, command
from rattlesweep.cli.common.output import print_summary, probe, say, to_json
from rattlesweep.cli.common.progress import Meter

__all__ = ["Command", "Meter", "Section", "command", "print_summary", "probe", "say", "to_json"]
