"""A result as plain data, kept in JSON, and arrays, kept in an npz."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainSerializer, PlainValidator, SerializationInfo, ValidationInfo

from afl_mujoco.files import as_plain, parse_json

Arrays = dict[str, NDArray[Any]]


def _store(array: NDArray[Any], info: SerializationInfo) -> str:
    """Return a placeholder that differs from any text of a result."""
    context: Any = info.context
    mark = f"\0{len(context)}"
    context[mark] = np.asarray(array)
    return mark


def _fetch(value: Any, info: ValidationInfo) -> NDArray[Any]:
    arrays: Any = info.context or {}
    if not isinstance(value, str) or value not in arrays:
        raise ValueError(f"must be the name of an array of the npz, got {value!r}")
    found: NDArray[Any] = arrays[value]
    if found.dtype.kind not in "biuf":
        raise ValueError(f"must be an array of numbers, has type {found.dtype}")
    return found


Array = Annotated[NDArray[Any], PlainValidator(_fetch), PlainSerializer(_store)]
"""A field of a result that is kept in the npz beside the JSON, under its path in the result."""


def packed(result: object) -> tuple[dict[str, Any], Arrays]:
    """Return a result as plain data, and its arrays by the names that replace them."""
    stored: Arrays = {}
    data = as_plain(result, stored)
    named: Arrays = {}
    return _name(data, (), stored, named), named


def unpacked(kind: type, data: Mapping[str, Any], arrays: Arrays) -> Any:
    """Return a result of a type from the output of `packed`, or raise ValueError."""
    return parse_json(json.dumps(data), kind, arrays)


def _name(value: Any, place: tuple[str, ...], stored: Arrays, named: Arrays) -> Any:
    """Return plain data with each array replaced by its path, and collect the arrays."""
    if isinstance(value, str) and value in stored:
        name = "/".join(place)
        named[name] = stored[value]
        return name
    if isinstance(value, dict):
        return {key: _name(x, (*place, key), stored, named) for key, x in value.items()}
    if isinstance(value, list):
        return [_name(x, (*place, str(k)), stored, named) for k, x in enumerate(value)]
    return value
