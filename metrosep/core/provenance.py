"""Where a number came from: the source file with its hash, and every step since.

Every object carries a ``history``, a tuple of `Step`. An operator appends one; a reader starts it
with the SHA-256 of the file. The history travels into every table, report and exported file.
"""

from __future__ import annotations

import copyreg
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from metrosep.core.units import with_px


def freeze_mapping(items: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Return a read-only copy of a mapping."""
    return MappingProxyType(dict(items or {}))


def _copied_mapping(view: MappingProxyType[str, Any]) -> tuple[Any, tuple[dict[str, Any]]]:
    return freeze_mapping, (dict(view),)


# Python cannot copy a read-only view by itself; objects that hold one go to other processes.
copyreg.pickle(MappingProxyType, _copied_mapping)


def hash_bytes(data: bytes) -> str:
    """Return the SHA-256 of bytes as 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


@dataclass(frozen=True, slots=True)
class Source:
    """A file that data were read from."""

    name: str  # file name without its folder (a folder names a machine, not a measurement)
    sha256: str  # digest of the whole file
    size: int  # bytes
    format: str  # identifier of the format it was read as


@dataclass(frozen=True, slots=True)
class Step:
    """One operation that led to an object.

    Parameters
    ----------
    name : str
        Name of the operator, such as ``"read"`` or ``"separate"``.
    parameters : mapping, optional
        Its parameters in SI, plain Python values; pixels of a map as texts, "120 px".
    version : str, optional
        Version of metrosep that carried it out.
    """

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    version: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", freeze_mapping(with_px(self.parameters)))
        if not self.version:
            from metrosep._version import __version__

            object.__setattr__(self, "version", __version__)


def history_as_dicts(history: tuple[Step, ...]) -> list[dict[str, Any]]:
    """Return a history as plain dictionaries for JSON."""
    return [
        {"step": s.name, "parameters": dict(s.parameters), "version": s.version} for s in history
    ]
