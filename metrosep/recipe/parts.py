"""Parts of a result as files: curves as tables of text or HDF5, maps and profiles as objects."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import by_number
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.core.provenance import Step
from metrosep.io.own_notes import measured_at, moment_of
from metrosep.io.source import RawFile
from metrosep.recipe.describe.description import Description
from metrosep.recipe.preflight import output_name
from metrosep.recipe.schema import Field, named_in
from metrosep.separation.runs.base import ErrorEstimate

if TYPE_CHECKING:
    from metrosep.core.profile import Profile
    from metrosep.core.surface import Surface
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.schema import Place


_TEXT = ("", ".csv", ".txt", ".dat")
_HDF5 = ".h5"


def write_parts(
    recipe: Recipe,
    described: Description,
    folder: Path,
    tell: Callable[[str], None],
    document: Mapping[str, Any] | None = None,
) -> list[str]:
    """Write the parts that the outputs of a recipe ask for."""
    written: list[str] = []
    for i, output in enumerate(recipe.outputs):
        if output["kind"] != "parts":
            continue
        usual = "parts.h5" if described.maps else "parts.csv"
        place = recipe.place("[[output]]", i)
        name = Path(output_name(output.get("path", usual), place))
        tell(f"writing {name}")
        if not described.maps and not described.tables and not described.files:
            raise DataError("this result has no parts that can be written; leave this output out")
        for text in sorted(set(described.files) - set(written)):
            atomic_write(folder / text, described.files[text].encode("utf-8"))
            written.append(text)
        written += _write_objects(described.maps, folder, name, place)
        suffix = name.suffix.lower()
        if described.profiles and suffix not in _TEXT:
            written += _write_objects(described.profiles, folder, name, place)
            continue
        in_hdf5 = suffix == _HDF5 and "path" in output
        if described.tables and not described.maps and not in_hdf5 and suffix not in _TEXT:
            raise place.error(
                f"path: tables are written as .csv or {_HDF5}, not as {name.suffix}", "path"
            )
        kind = _HDF5 if in_hdf5 else ".csv" if described.maps else name.suffix or ".csv"
        for table, columns in described.tables.items():
            file = f"{name.stem}-{table}{kind}" if table else f"{name.stem}{kind}"
            data = _hdf5(columns, document or {}) if in_hdf5 else _csv(columns)
            atomic_write(folder / file, data)
            written.append(file)
    return written


def write_arrays(
    recipe: Recipe,
    estimate: ErrorEstimate,
    document: Mapping[str, Any],
    folder: Path,
    tell: Callable[[str], None],
) -> list[str]:
    """Write the curve and the tables of a separation of runs, where outputs of kind "parts" ask."""
    if not any(o["kind"] == "parts" for o in recipe.outputs):
        return []
    return write_parts(recipe, arrays_of(estimate), folder, tell, document)


def _csv(columns: Mapping[str, Any]) -> bytes:
    import pandas as pd

    text: str = pd.DataFrame(dict(columns)).to_csv(index=False, lineterminator="\n")
    return text.encode("utf-8")


def _hdf5(columns: Mapping[str, Any], document: Mapping[str, Any]) -> bytes:
    from metrosep.io.containers.native import table_bytes

    recipe = document.get("recipe") or {}
    provenance = {
        "inputs_json": json.dumps(document.get("inputs") or [], sort_keys=True),
        "history_json": json.dumps(document.get("provenance") or [], sort_keys=True),
        "recipe": str(recipe.get("text") or ""),
        "recipe_sha256": str(recipe.get("sha256") or ""),
    }
    return table_bytes(columns, provenance)


def _write_objects(
    objects: Mapping[str, Surface] | Mapping[str, Profile], folder: Path, name: Path, place: Place
) -> list[str]:
    from metrosep.io.write import write

    written = []
    for part, each in objects.items():
        file = f"{name.stem}-{part}{name.suffix or _HDF5}"
        try:
            write(each, folder / file)
        except UnsupportedFeatureError as exc:
            problem = str(exc).removeprefix(f"{folder / file}: ")
            raise place.error(f"path: {problem}", "path") from None
        written.append(file)
    return written


# ---- the arrays of a separation of repeated runs, as tables that an output of kind "parts" writes ----

POINTS = 2001
"""Positions of the curve, evenly over the evaluation range: the estimate is a function of x."""


def arrays_of(estimate: ErrorEstimate) -> Description:
    """Return the tables of an estimate."""
    x = np.linspace(estimate.start, estimate.stop, POINTS)
    curve: dict[str, Any] = {"x_m": x}
    wanted: list[tuple[int | None, str]] = [(None, "error")]
    if len(estimate.directions) > 1:
        wanted += [(1, "error_forward"), (-1, "error_reverse")]
    for direction, name in wanted:
        curve[f"{name}_m"] = estimate.evaluate(x, direction=direction)
        curve[f"u_{name}_m"] = estimate.sd(x, direction=direction)
    frames = {n: getattr(estimate, n) for n in ("spectrum", "feed_spectra", "residual_psd")}
    frames["evidence"] = estimate.evidence
    tables = {n: {k: f[k].tolist() for k in f.columns} for n, f in frames.items() if len(f)}
    return Description(tables={"": curve, **tables})


# ---- the order of the parts of a batch in charts, drifts and correlations; one order for all of them ----

Document = Mapping[str, Any]

_CLOCKS = {"time": "measured_at", "file_time": "file_time"}
_WORDS = {
    "name": "in the order of their names, not of time",
    "time": "in the order of measuring, as their files state it",
    "file_time": "in the order in which their files were last changed",
}


def order_of(document: Document) -> str:
    """Return what orders the parts."""
    order = str(document.get("order") or "name")
    if not order.isidentifier():
        raise DataError(
            f"the order of the parts in this index is damaged ({order[:40]!r}); write the index again"
        )
    return order


def order_words(document: Document) -> str:
    """Return the order of the parts in words."""
    order = order_of(document)
    return _WORDS.get(order, f"in the order of {order}, which their names state")


def parts_in_order(document: Document) -> list[int]:
    """Return the places of the rows of an index in the order of the parts."""
    rows = document.get("rows") or []
    if order_of(document) == "name":
        return sorted(range(len(rows)), key=lambda i: by_number(str(rows[i].get("unit"))))
    places = {i: _place(row, order_of(document)) for i, row in enumerate(rows)}
    known = [i for i, place in places.items() if place is not None]
    return sorted(known, key=lambda i: (places[i], by_number(str(rows[i].get("unit")))))


def order_notes(document: Document) -> list[str]:
    """Return what is to be known about the order: parts without a place, clocks that differ."""
    order = order_of(document)
    rows = [r for r in document.get("rows") or [] if r.get("characteristics")]
    if order == "name" or not rows:
        return []
    notes = []
    lost = sum(_place(r, order) is None for r in rows)
    if lost:
        why, cure = _MISSING.get(
            order, (f'have no "{order}" in their names', "check the pattern of [batch]")
        )
        which = "all parts" if lost == len(rows) else f"{lost} of {len(rows)} parts"
        notes.append(
            f'[batch] order = "{order}": {which} {why} and are not in charts and drifts; {cure}'
        )
    zoned = {_has_offset(str(r["measured_at"])) for r in rows if r.get("measured_at")}
    if order == "time" and len(zoned) > 1:
        notes.append(
            '[batch] order = "time": some files state the offset of their clock and others do not; the first '
            "are ordered by UTC and the others as written, so that both may be hours apart"
        )
    return notes


_NOT_ASKED = (
    'name a group of the pattern, or ask for order = "file_time"; results of a metrosep that did not '
    "look for it are made again by --fresh"
)
_MISSING = {
    "time": ("state no date of measuring", _NOT_ASKED),
    "file_time": ("have no time of their file", "run the batch to its end"),
}


def _place(row: Document, order: str) -> Any:
    """Return what sorts a row, None where it does not tell it."""
    if order in _CLOCKS:
        text = row.get(_CLOCKS[order])
        try:
            return None if not text else moment_of(str(text))
        except ValueError:
            return None
    groups = row.get("groups")
    text = groups.get(order) if isinstance(groups, Mapping) else None
    return by_number(str(text)) if text else None


def _has_offset(text: str) -> bool:
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


# ---- which files a result was made of: name, hash, size, format, and when they were measured ----


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
    files = sorted(named_in(options, fields))
    opened = [(k, RawFile(Path(f))) for k, f in files if Path(f).is_file()]
    return [
        {"name": f.name, "sha256": f.sha256, "size": f.size, "format": f"named by {key}"}
        for key, f in opened
    ]
