"""Runs of stone files, which describe a body, its launch and its dissipation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rattlesweep.api.single import LAUNCH_ARGUMENTS, prepare_launch
from rattlesweep.words.quantities import LOSSES

if TYPE_CHECKING:
    from rattlesweep.analysis.onerun.course import PreparedRun


def prepare_stone(
    stone: Mapping[str, Any], defaults: Mapping[str, Any], **launch: Any
) -> PreparedRun:
    """Return the run of a stone file, as the arguments of a fit, with its values.

    Standard errors are left out.  What is in `launch` replaces the values of the file,
    and `defaults` stand for a spin or an oscillation that neither has.
    """
    from rattlesweep.analysis.fit.measured import separate

    losses = {name: stone[name] for name in LOSSES if stone.get(name) is not None}
    values, _ = separate({**stone["launch"], **losses})
    values = {name: values[name] for name in values if name in LAUNCH_ARGUMENTS}
    values["base"] = stone.get("base")
    values |= launch
    if "omega" not in values:
        values = {**defaults, **values}
    return prepare_launch(stone["body"].body, **values)
