"""JSON files of an output directory, opened by one door that checks all types.

Anyone may have changed them. What passes holds values of the types that are declared,
finite numbers and proper text, and nothing that is not declared.
"""

from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError


class Checked(BaseModel):
    """The declaration of a file: its keys and their types."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, extra="ignore")


_T = TypeVar("_T", bound=Checked)


def load_checked(declared: type[_T], data: bytes) -> dict[str, Any]:
    """Return the values of a file, or raise a ValueError that says what is wrong."""
    try:
        values = declared.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise ValueError(f"{place}: {first['msg']}".removeprefix(": ")) from None
    return values.model_dump(mode="json")
