"""History and metadata as JSON that gives the same Python values back.

Tuples, NaN and infinities are marked, since JSON has none; whatever else JSON lacks becomes text.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.provenance import Step, history_as_dicts

__all__ = ["decode_history", "decode_mapping", "encode_history", "encode_mapping"]

_TUPLE, _NUMBER = "__tuple__", "__number__"


def encode_mapping(values: Mapping[str, Any]) -> bytes:
    """Return a mapping as UTF-8 JSON with sorted keys."""
    return json.dumps(_encode(values), sort_keys=True, allow_nan=False).encode()


def decode_mapping(data: bytes) -> dict[str, Any]:
    """Return the mapping of `encode_mapping`."""
    found = _decode(json.loads(data))
    if not isinstance(found, dict):
        raise ValueError("a mapping was expected")  # noqa: TRY004  (one error for the reader)
    return found


def encode_history(history: tuple[Step, ...]) -> bytes:
    """Return a history as UTF-8 JSON."""
    return json.dumps(_encode(history_as_dicts(history)), sort_keys=True, allow_nan=False).encode()


def decode_history(data: bytes) -> tuple[Step, ...]:
    """Return the history of `encode_history`."""
    entries = _decode(json.loads(data))
    return tuple(Step(str(e["step"]), e["parameters"], str(e["version"])) for e in entries)


def _encode(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _encode(v) for k, v in value.items()}
    if isinstance(value, tuple):
        return {_TUPLE: [_encode(v) for v in value]}
    if isinstance(value, list):
        return [_encode(v) for v in value]
    if isinstance(value, np.ndarray):
        return _encode(value.tolist())
    if isinstance(value, np.generic):
        return _encode(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return {_NUMBER: repr(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)


def _decode(value: Any) -> Any:
    if isinstance(value, list):
        return [_decode(v) for v in value]
    if not isinstance(value, dict):
        return value
    if value.keys() == {_TUPLE}:
        return tuple(_decode(v) for v in value[_TUPLE])
    if value.keys() == {_NUMBER}:
        return float(value[_NUMBER])
    return {k: _decode(v) for k, v in value.items()}
