"""Which files a result was made of: name, hash, size, format, and when they were measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from metrosep.core.provenance import Step
from metrosep.io.own_notes import measured_at
from metrosep.io.source import RawFile
from metrosep.recipe.schema import Field

__all__ = ["input_records", "named_files"]


def input_records(history: Iterable[Step], objects: Iterable[Any] = ()) -> list[dict[str, Any]]:
    """Return name, hash, size and format of the files that were read."""
    records: list[dict[str, Any]] = []
    for step in history:
        if step.name not in ("read", "read_columns"):
            continue
        facts = step.parameters
        record = {k: facts.get(k) for k in ("sha256", "size", "format")}
        record = {"name": facts.get("file"), **record}
        if step.name == "read_columns":
            none: dict[str, Any] = {}
            named = next((r for r in reversed(records) if "beside" not in r), none)
            record |= {"format": named.get("format"), "beside": named.get("name")}
        records.append(record)
    for metadata in (getattr(o, "metadata", None) or {} for o in objects):
        when = measured_at(metadata)
        for record in records if when is not None else ():
            if record["sha256"] == metadata.get("sha256"):
                record["measured_at"] = when
    return records


def named_files(options: Mapping[str, Any], fields: Mapping[str, Field]) -> list[dict[str, Any]]:
    """Return name, hash and size of the files that keys of a step name."""
    files = {k: Path(v) for k, v in options.items() if fields[k].kind == "file"}
    opened = {k: RawFile(f) for k, f in sorted(files.items()) if f.is_file()}
    return [
        {"name": f.name, "sha256": f.sha256, "size": f.size, "format": f"named by {key}"}
        for key, f in opened.items()
    ]
