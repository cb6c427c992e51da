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

__all__ = ["Source", "Step", "freeze_mapping", "hash_bytes", "history_as_dicts"]


def freeze_mapping(items: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Return a read-only copy of a mapping.

    Parameters
    ----------
    items : mapping or None
        What to copy; ``None`` gives an empty one.

    Returns
    -------
    mapping
        A view that cannot be changed.
    """
    return MappingProxyType(dict(items or {}))


def _copied_mapping(view: MappingProxyType[str, Any]) -> tuple[Any, tuple[dict[str, Any]]]:
    return freeze_mapping, (dict(view),)


# Python cannot copy a read-only view by itself; objects that hold one go to other processes.
copyreg.pickle(MappingProxyType, _copied_mapping)


def hash_bytes(data: bytes) -> str:
    """Return the SHA-256 of bytes as 64 hexadecimal digits.

    Parameters
    ----------
    data : bytes
        Content of a file.

    Returns
    -------
    str
        Digest.
    """
    return hashlib.sha256(data).hexdigest()


@dataclass(frozen=True, slots=True)
class Source:
    """A file that data were read from.

    Parameters
    ----------
    name : str
        File name without its folder (a folder names a machine, not a measurement).
    sha256 : str
        Digest of the whole file.
    size : int
        Bytes.
    format : str
        Identifier of the format it was read as.
    """

    name: str
    sha256: str
    size: int
    format: str


@dataclass(frozen=True, slots=True)
class Step:
    """One operation that led to an object.

    Parameters
    ----------
    name : str
        Name of the operator, such as ``"read"`` or ``"separate"``.
    parameters : mapping, optional
        Its parameters in SI, plain Python values.
    version : str, optional
        Version of metrosep that carried it out.
    """

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    version: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", freeze_mapping(self.parameters))
        if not self.version:
            from metrosep._version import __version__

            object.__setattr__(self, "version", __version__)


def history_as_dicts(history: tuple[Step, ...]) -> list[dict[str, Any]]:
    """Return a history as plain dictionaries for JSON.

    Parameters
    ----------
    history : tuple of Step
        From the source on.

    Returns
    -------
    list of dict
        Keys ``step``, ``parameters``, ``version``.
    """
    return [
        {"step": s.name, "parameters": dict(s.parameters), "version": s.version} for s in history
    ]
