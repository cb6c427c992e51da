"""Marks on the disk: where a unit's results lie, whether it is done, why it failed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrosep._version import __version__
from metrosep.batch.units import Unit
from metrosep.core.atomic import atomic_write
from metrosep.recipe.document_text import document_text

__all__ = [
    "FAILED",
    "FAILED_SCHEMA",
    "RESULT",
    "Identity",
    "failed_document",
    "read_mark",
    "short_version",
    "unit_record",
    "write_mark",
]

RESULT, FAILED = "result.json", "failed.json"
FAILED_SCHEMA = "metrosep.failed/1"


def short_version(version: str = __version__) -> str:
    """Return major and minor of a version: results of another one are not taken over."""
    return ".".join(version.split(".")[:2])


@dataclass(frozen=True, slots=True)
class Identity:
    """What a result depends on; where all is equal, nothing need be done again."""

    # SHA-256 of the input's bytes; of several files, of their names and hashes. Empty where they
    # could not be read
    input_hash: str
    recipe_hash: str  # of `metrosep.recipe.outputs.recipe_hash`
    version: str  # major and minor of metrosep
    name: str  # of the unit: equal content under two names has two results

    @property
    def digest(self) -> str:
        """SHA-256 over all of it."""
        parts = (self.input_hash, self.recipe_hash, self.version, self.name)
        return hashlib.sha256("\n".join(parts).encode("utf-8", "surrogateescape")).hexdigest()

    def folder(self, out: Path, unit: Unit) -> Path:
        """Return where the results of a unit belong."""
        return out / unit.key / self.digest[:8]


def unit_record(unit: Unit, identity: Identity) -> dict[str, Any]:
    """Return what a result says of its unit."""
    return {
        "name": unit.name,
        "key": unit.key,
        "groups": dict(unit.groups),
        "input_sha256": identity.input_hash,
        "recipe_sha256": identity.recipe_hash,
        "version": identity.version,
        "hash": identity.digest,
    }


def failed_document(
    record: Mapping[str, Any], *, status: str, code: int, kind: str, reason: str, again: bool
) -> dict[str, Any]:
    """Return the content of failed.json."""
    return {
        "schema": FAILED_SCHEMA,
        "metrosep": __version__,
        "unit": dict(record),
        "status": status,
        "exit_code": code,
        "error": kind,
        "reason": reason,
        "again": again,
    }


def write_mark(folder: Path, name: str, document: Mapping[str, Any]) -> None:
    """Write a mark; it appears whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    text = document_text(document) + "\n"
    atomic_write(folder / name, text.encode("utf-8", "surrogateescape"))


def read_mark(folder: Path, name: str) -> dict[str, Any] | None:
    """Return a mark, None where there is none that counts."""
    try:
        found = json.loads((folder / name).read_bytes())
    except (OSError, ValueError):
        return None
    if not isinstance(found, dict) or not isinstance(found.get("unit"), dict):
        return None
    return found
