"""A result as plain data and arrays: JSON holds the one, an npz the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    PlainSerializer,
    PlainValidator,
    SerializationInfo,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)

Arrays = dict[str, NDArray[Any]]


def _store(array: NDArray[Any], info: SerializationInfo) -> str:
    """Set an array apart, and return what no text of a result is in its place."""
    context: Any = info.context
    mark = f"\0{len(context)}"
    context[mark] = np.asarray(array)
    return mark


def _fetch(value: Any, info: ValidationInfo) -> NDArray[Any]:
    """Return an array by its name."""
    arrays: Any = info.context or {}
    if isinstance(value, np.ndarray):
        return value
    if isinstance(value, str) and value in arrays:
        found: NDArray[Any] = arrays[value]
        return found
    raise ValueError(f"must be the name of an array of the npz, got {value!r}")


Array = Annotated[NDArray[Any], PlainValidator(_fetch), PlainSerializer(_store)]
"""A field of a result that is kept in the npz beside the JSON, by the name of its place."""


def packed(kind: type, result: Any) -> tuple[dict[str, Any], Arrays]:
    """Return a result of a type as plain data, and its arrays by the names that stand for them."""
    stored: Arrays = {}
    data = TypeAdapter(kind).dump_python(result, mode="json", context=stored)
    named: Arrays = {}
    return _name(data, (), stored, named), named


def unpacked(kind: type, data: Mapping[str, Any], arrays: Arrays) -> Any:
    """Return a result from what `packed` made of it, or raise ValueError at the first flaw."""
    try:
        return TypeAdapter(kind).validate_python(data, context=arrays)
    except ValidationError as error:
        said = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in said["loc"]) or "it"
        raise ValueError(f"{place}: {said['msg'][:1].lower()}{said['msg'][1:]}") from None


def _name(value: Any, place: tuple[str, ...], stored: Arrays, named: Arrays) -> Any:
    """Return plain data in which each array is called by its place, and collect the arrays."""
    if isinstance(value, str) and value in stored:
        name = "/".join(place)
        named[name] = stored[value]
        return name
    if isinstance(value, dict):
        return {key: _name(x, (*place, key), stored, named) for key, x in value.items()}
    if isinstance(value, list):
        return [_name(x, (*place, str(k)), stored, named) for k, x in enumerate(value)]
    return value
