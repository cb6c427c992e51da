"""The index of a batch: every result of its output folder in one table, JSON and CSV.

Schema ``metrosep.index/1``; other formats come by entry points of the group ``metrosep.indexes``:
``writer(document, path)``.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__
from metrosep.batch.left_out import LeftOut, sentences
from metrosep.batch.marks import FAILED, RESULT, read_mark, short_version
from metrosep.batch.rows import STATUSES, row_of
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, RecipeError
from metrosep.recipe.index_rows import index_columns, index_rows
from metrosep.recipe.result import clean

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["SCHEMA", "build_index", "format_error", "index_formats", "write_index"]

SCHEMA = "metrosep.index/1"
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def build_index(
    recipe: Recipe,
    out: str | os.PathLike[str],
    *,
    recipe_hash: str,
    present: Mapping[str, str | None] | None = None,
    known: Mapping[str, Mapping[str, Any]] | None = None,
    waiting: Collection[str] = (),
    left_out: Sequence[LeftOut] = (),
) -> dict[str, Any]:
    """Return the index of an output folder, made from its marks only.

    Parameters
    ----------
    recipe : Recipe
        Whose results count.
    out : str or path
        Output folder of batches.
    recipe_hash : str
        Of the recipe.
    present : mapping of str to (str or None), optional
        Hash of the unit by name for the inputs that are there now (None: not looked into): other
        results of these names are of former contents, those of other names are gone. Without it
        all count.
    known : mapping of str to mapping, optional
        Rows of this batch, by anything: each stands for its folder, whatever marks lie there.
    waiting : collection of str, optional
        Names of units that were found and not looked at, since the batch was stopped.
    left_out : sequence of LeftOut, optional
        What is no input.

    Returns
    -------
    dict
        Schema ``metrosep.index/1``: ``rows``, ``counts`` by status, ``apart`` (results of another
        recipe, another version, former contents, of inputs that are gone or cannot be read),
        ``complete`` (whether each unit was looked at), ``not_begun`` (``count`` and ``units`` that
        have no row), ``left_out``, ``notes`` (the same in words), ``trend``, ``order``, ``groups``,
        ``recipe``, ``title``.

    Notes
    -----
    No clock and no folder in it.
    """
    rows: list[dict[str, Any]] = []
    apart: Counter[str] = Counter()
    unread = {r["unit"] for r in (known or {}).values() if not r["input_sha256"]}
    for row in _rows(Path(out), known or {}):
        if row["recipe_sha256"] != recipe_hash:
            apart["other_recipe"] += 1
        elif row["version"] != short_version():
            apart["other_version"] += 1
        elif present is not None and row["unit"] not in present:
            apart["gone"] += 1
        elif present is not None and present[row["unit"]] not in (None, row["hash"]):
            if row["input_sha256"]:  # otherwise a failure to read it, of which nothing is left
                apart["unreadable" if row["unit"] in unread else "former_content"] += 1
        else:
            rows.append({k: v for k, v in row.items() if k not in ("seconds", "skipped")})
    rows.sort(key=lambda r: (r["unit"], r["hash"]))
    counts = Counter(r["status"] for r in rows)
    missing = sorted(set(waiting) - {r["unit"] for r in rows})
    records = [item.record() for item in left_out]
    document: dict[str, Any] = clean(
        {
            "schema": SCHEMA,
            "metrosep": __version__,
            "title": recipe.title,
            "recipe": {
                "name": recipe.name,
                "text": recipe.text,
                "sha256": recipe.sha256,
                "meaning_sha256": recipe_hash,
            },
            "groups": list(recipe.batch_options.get("groups") or ()),
            "trend": list(recipe.batch_options.get("trend") or ()),
            "order": recipe.batch_options.get("order") or "name",
            "counts": {"total": len(rows), **{s: counts.get(s, 0) for s in STATUSES}},
            "apart": {
                k: apart[k]
                for k in ("other_recipe", "other_version", "former_content", "gone", "unreadable")
            },
            "complete": not waiting,
            "not_begun": {"count": len(missing), "units": missing},
            "left_out": records,
            "notes": [
                *_waiting_notes(len(missing), len(set(waiting)) - len(missing)),
                *sentences(records, "the input folder"),
            ],
            "rows": rows,
        }
    )
    return document


def _waiting_notes(missing: int, earlier: int) -> Iterator[str]:
    if missing:
        yield f"incomplete: {missing} not begun; start the same batch again, it goes on from here"
    if earlier:
        yield (
            f"{earlier} unit(s) show the result of an earlier run: the batch was stopped before it "
            "looked at their files again"
        )


def _rows(out: Path, known: Mapping[str, Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """Yield the rows of this batch, then one for each other folder with a mark."""
    yield from known.values()
    done = {f"{r['key']}/{r['hash'][:8]}" for r in known.values()}
    for key in sorted(_folders(out)):
        for folder in sorted(_folders(Path(key))):
            if Path(folder).relative_to(out).as_posix() in done:
                continue
            for name in (RESULT, FAILED):
                found = read_mark(Path(folder), name)
                if found is not None:
                    yield row_of(found, (Path(folder) / name).relative_to(out).as_posix())
                    break


def _folders(place: Path) -> list[str]:
    try:
        with os.scandir(place) as entries:
            return [e.path for e in entries if e.is_dir() and not e.name.startswith(".")]
    except OSError:
        return []


def index_formats() -> dict[str, Any]:
    """Return what writes an index, by format."""
    others = {entry.name: entry for entry in entry_points(group="metrosep.indexes")}
    return {**others, "json": _write_json, "csv": _write_csv}


def format_error(recipe: Recipe) -> RecipeError | None:
    """Return what is wrong with ``[batch] index``."""
    known = index_formats()
    for name in recipe.batch_options.get("index") or ():
        if name not in known:
            return recipe.place("[batch]").error(_unknown(name, known), "index")
    return None


def _unknown(name: str, known: Mapping[str, Any]) -> str:
    return (
        f"index format {name!r} is written by nothing that is installed; there are "
        f"{', '.join(sorted(known))}"
    )


def write_index(document: Mapping[str, Any], path: Path, name: str) -> Path:
    """Write an index."""
    known = index_formats()
    if name not in known:
        raise DataError(_unknown(name, known))
    writer = known[name]
    writer = writer.load() if hasattr(writer, "load") else writer
    writer(document, path)
    return path


def _write_json(document: Mapping[str, Any], path: Path) -> None:
    text = json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"
    atomic_write(path, text.encode("utf-8"))


def _write_csv(document: Mapping[str, Any], path: Path) -> None:
    """Write the long form: one line for each characteristic, one for each unit without any."""
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\r\n")
    writer.writerow(index_columns(document))
    writer.writerows(_cells(row) for row in index_rows(document))
    atomic_write(path, buffer.getvalue().encode("utf-8", "backslashreplace"))


def _cells(values: Sequence[Any]) -> list[Any]:
    """Return cells that no table program takes for a formula."""
    return [f"'{v}" if isinstance(v, str) and v.startswith(_FORMULA) else v for v in values]
