"""Words and tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence


def align(lines: Sequence[Sequence[str]], sides: str = ">") -> str:
    """Lay cells out in columns, each as wide as its widest cell.

    Parameters
    ----------
    lines
        Cells of each line, equally many in all.
    sides
        Side on which the cells of each column stand, ``<`` or ``>``; the last is that of all
        further columns.
    """
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides += sides[-1] * (len(widths) - len(sides))
    return "\n".join(
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(line, sides, widths, strict=True)
        ).rstrip()
        for line in lines
    )


def counted(number: int, noun: str) -> str:
    """Return such as ``1 run`` or ``6,000 runs``."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
