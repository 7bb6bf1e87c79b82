"""Tables as text for a terminal."""

from __future__ import annotations

from collections.abc import Sequence


def align(lines: Sequence[Sequence[str]], sides: str = ">") -> str:
    """Cells as lines of columns, each as wide as its widest cell.

    Parameters
    ----------
    lines
        Cells of each line, as many in all.
    sides
        Where the cells of each column stand, ``<`` or ``>``; the last is that of the columns left.
    """
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    sides += sides[-1] * (len(widths) - len(sides))
    return "\n".join(
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(line, sides, widths, strict=True)
        ).rstrip()
        for line in lines
    )
