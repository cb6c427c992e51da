"""What the results of planes share: frozen mappings, plain values, copies and the table for notebooks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from metrosep.core.provenance import freeze_mapping
from metrosep.separation._methods import StoredResult
from metrosep.separation._readings import plain


class PlainResult(StoredResult):
    """A result, as a frozen dataclass, whose fields are plain values, curves, maps or results."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for name, value in _of(self).items():
            if isinstance(value, Mapping):
                object.__setattr__(self, name, freeze_mapping(value))

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None.

        Returns
        -------
        dict
            One key for each field; profiles as ``x``, ``z``; surfaces with steps and origin.
        """
        return {name: _plain(value) for name, value in _of(self).items()}


def _of(result: Any) -> dict[str, Any]:
    return {f.name: getattr(result, f.name) for f in fields(result)}


def _plain(value: Any) -> Any:
    if isinstance(value, PlainResult) or (
        isinstance(value, Mapping) and hasattr(value, "to_dict")
    ):
        return plain(value.to_dict())  # a positioning test is a mapping of its values, too
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return plain(value)
