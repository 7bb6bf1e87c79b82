"""The formats of exported runs: endings, what they cannot have, and their writers."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from rattlesweep.analysis.engines.mjcf import check_model, to_mjcf

if TYPE_CHECKING:
    from rattlesweep.analysis.engines.case import EngineCase
    from rattlesweep.analysis.onerun.course import PreparedRun


class Exported(NamedTuple):
    """A format of files."""

    ending: str
    # check(run): raise a ConfigError if the format has no such body or friction
    check: Callable[[PreparedRun], None]
    # write(case, portable)
    write: Callable[[EngineCase, bool], str]


def _check_mjcf(run: PreparedRun) -> None:
    check_model(run, instead=", or choose the format json")


def _to_mjcf(case: EngineCase, portable: bool) -> str:
    return to_mjcf(case, portable=portable)


def _check_nothing(run: PreparedRun) -> None:
    """A document has any run."""


def _to_json(case: EngineCase, portable: bool) -> str:
    return case.to_json()


EXPORTED: dict[str, Exported] = {
    "mjcf": Exported(".xml", _check_mjcf, _to_mjcf),
    "json": Exported(".json", _check_nothing, _to_json),
}
"""The formats by name."""
