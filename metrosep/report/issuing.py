"""The register of issued reports, ``issue.json``: a number belongs to the bytes of one result for good."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrosep.core.atomic import RECIPE_BYTES, atomic_write, read_plain, take_lock
from metrosep.core.errors import CorruptFileError, RecipeError, WriteError

SCHEMA = "metrosep.issue/1"
NAME = "issue.json"
_LOCK = ".metrosep-issue.lock"


_OF_THE_ISSUE = ("number", "revision", "issued", "persons")


def _hash_of_fields(fields: Mapping[str, Any]) -> str:
    """Return the hash of what a report says beside its result: item, customer, instrument ..."""
    said = {k: v for k, v in fields.items() if k not in _OF_THE_ISSUE}
    text = json.dumps(said, sort_keys=True, ensure_ascii=False, default=str)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _is_there(place: Path, handle: int) -> bool:
    try:
        return os.path.samestat(place.stat(), os.fstat(handle))
    except FileNotFoundError:
        return False


@dataclass(frozen=True, slots=True)
class Register:
    """The reports that were issued into one folder, in the order of issue."""

    issued: tuple[Mapping[str, Any], ...] = ()

    @classmethod
    def load(cls, folder: Path) -> Register:
        """Return the register of a folder, an empty one where there is none."""
        place = folder / NAME
        try:
            content = json.loads(read_plain(place, RECIPE_BYTES))
        except FileNotFoundError:
            return cls()
        except (OSError, ValueError) as exc:
            raise CorruptFileError(
                place, f"it cannot be read ({exc})", hint="restore it from a backup"
            ) from None
        rows = content.get("issued") if isinstance(content, dict) else None
        if not isinstance(rows, list) or content.get("schema") != SCHEMA:
            raise CorruptFileError(
                place, "not a register of issued reports", hint="restore it from a backup"
            )
        return cls(tuple(rows))

    def with_issue(self, fields: Mapping[str, Any], sha256: str) -> Register:
        """Return the register with one report more; RecipeError where its number has other bytes."""
        new = {
            "number": fields["number"],
            "revision": int(fields.get("revision", 0)),
            "date": fields["issued"],
            "released": fields["persons"]["released"],
            "sha256": sha256,
            "fields_sha256": _hash_of_fields(fields),
        }
        for row in self.issued:
            if (row.get("number"), row.get("revision")) != (new["number"], new["revision"]):
                continue
            if row == new:  # again: last, as the one that is written
                return Register((*(r for r in self.issued if r != new), new))
            if row.get("sha256") != sha256:
                raise RecipeError(
                    f"report {new['number']} revision {new['revision']} was issued on {row.get('date')} for "
                    f"the result with SHA-256 {row.get('sha256')}, and this one has {sha256}; give another "
                    "number, or a revision with replaces, change and reason"
                )
            if row.get("fields_sha256", new["fields_sha256"]) != new["fields_sha256"]:
                raise RecipeError(
                    f"report {new['number']} revision {new['revision']} was issued on {row.get('date')} with "
                    "other fields (item, customer, instrument ...); give another number, or a revision with "
                    "replaces, change and reason"
                )
            raise RecipeError(
                f"report {new['number']} revision {new['revision']} was issued on {row.get('date')} by "
                f"{row.get('released')}; an issued report keeps its date and person"
            )
        return Register((*self.issued, new))

    @staticmethod
    @contextmanager
    def held(folder: Path) -> Iterator[None]:
        """Keep other processes from issuing into a folder, so that no row of theirs is lost."""
        place = folder / _LOCK
        try:
            handle = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as exc:
            raise WriteError(
                f"{folder}: the register cannot be written ({exc.strerror or exc}); choose another folder",
                exc,
            ) from None
        try:
            # one that is gone, or another one, is of a process that has just ended
            if not take_lock(handle) or not _is_there(place, handle):
                raise WriteError(
                    f"{folder}: another report is being issued into this folder; try again"
                )
            try:
                yield
            finally:
                with suppress(OSError):  # Windows keeps a file that is open
                    place.unlink()
        finally:
            os.close(handle)

    def write(self, folder: Path) -> Path:
        """Write the register; it appears whole or not at all."""
        content = {"schema": SCHEMA, "issued": list(self.issued)}
        text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
        return atomic_write(folder / NAME, text.encode("utf-8"))
