"""A resolved config as the YAML that would make it again, short enough to read."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from rattlesweep.sweeps.config.fields import Linspace, Logspace

# A list at least this long is written as an axis if it is one to the last bit.
LONG = 8


def config_yaml(config: Mapping[str, Any]) -> str:
    """YAML text of a resolved config; long lists of evenly spaced numbers become axes."""
    yaml = YAML()
    yaml.width = 96
    buffer = io.StringIO()
    yaml.dump(_shaped(config, 0), buffer)
    return buffer.getvalue()


def _shaped(value: Any, depth: int) -> Any:
    if isinstance(value, Mapping):
        mapping = CommentedMap((key, _shaped(v, depth + 1)) for key, v in value.items())
        for name in ("linspace", "logspace"):
            if name in mapping:
                low, high, count = mapping[name]
                mapping[name] = _flow([low, high, int(count)])
        if depth and not any(isinstance(v, CommentedMap) for v in mapping.values()):
            mapping.fa.set_flow_style()
        return mapping
    if isinstance(value, list):
        if len(value) >= LONG and (axis := _axis(value)):
            return _shaped(axis, 1)
        return _flow(value)
    return value


def _flow(values: Sequence[Any]) -> CommentedSeq:
    sequence = CommentedSeq(values)
    sequence.fa.set_flow_style()
    return sequence


def _axis(values: Sequence[Any]) -> dict[str, list[float]] | None:
    if not all(isinstance(value, float) for value in values):
        return None
    ends = [values[0], values[-1], float(len(values))]
    for kind, name in ((Linspace, "linspace"), (Logspace, "logspace")):
        try:
            if kind.model_validate({name: ends}).values() == list(values):
                return {name: [ends[0], ends[1], len(values)]}
        except ValueError:
            continue  # no ratio leads from one end to the other
    return None
