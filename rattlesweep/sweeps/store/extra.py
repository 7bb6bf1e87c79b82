"""Columns of runs that their bodies and launches bring along, as a manifest keeps them."""

from __future__ import annotations

from typing import Literal

import pyarrow as pa
from pydantic import BaseModel, ConfigDict

from rattlesweep.sweeps.tables import columns


class ExtraColumn(BaseModel):
    """A column of the runs that their bodies and launches bring along."""

    model_config = ConfigDict(strict=True, extra="allow")

    name: str
    type: Literal["double", "int64", "string"]
    unit: str
    description: str
    nullable: bool

    @classmethod
    def of(cls, field: pa.Field) -> ExtraColumn:
        """What is to be kept of it."""
        words = {key.decode(): text.decode() for key, text in field.metadata.items()}
        return cls.model_validate(
            {"name": field.name, "type": str(field.type), "nullable": field.nullable} | words
        )

    @property
    def field(self) -> pa.Field:
        """The column itself."""
        kind = pa.type_for_alias(self.type)
        return columns.field(self.name, kind, self.unit, self.description, nullable=self.nullable)
