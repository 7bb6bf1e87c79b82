"""Words and tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence


def align(lines: Sequence[Sequence[str]], sides: str = ">") -> str:
    """Lay cells out in columns, on their sides ``<`` or ``>``, the last for all further columns."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides = sides.ljust(len(widths), sides[-1])
    shapes = [f"{side}{width}" for side, width in zip(sides, widths, strict=False)]
    rows = (map(format, line, shapes) for line in lines)
    return "\n".join("  ".join(row).rstrip() for row in rows)


def counted(number: int, noun: str) -> str:
    """Return such as ``1 run`` or ``6,000 runs``."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
