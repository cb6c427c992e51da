"""The index of a batch: every result of its output folder in one table, JSON and CSV.

Schema ``metrosep.index/1``; other formats come by entry points of the group ``metrosep.indexes``:
``writer(document, path)``.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__
from metrosep.batch.units import FAILED, RESULT, LeftOut, read_mark, sentences, short_version
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, RecipeError
from metrosep.core.limits import STATUS_OF_VERDICT
from metrosep.core.plugins import entries
from metrosep.core.public import PublicObject, shortened
from metrosep.core.readable import digits_of, readable_unit
from metrosep.io.own_notes import moment_of
from metrosep.recipe.index_rows import index_columns, index_rows
from metrosep.recipe.result import clean

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe


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
        What is not an input.

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
    return {**entries("metrosep.indexes"), "json": _write_json, "csv": _write_csv}


def format_error(recipe: Recipe) -> RecipeError | None:
    """Return what is wrong with ``[batch] index``."""
    known = index_formats()
    for name in recipe.batch_options.get("index") or ():
        if name not in known:
            return recipe.place("[batch]").error(_unknown(name, known), "index")
    return None


def _unknown(name: str, known: Mapping[str, Any]) -> str:
    return f"Unknown index format {name!r}. Available: {', '.join(sorted(known))}"


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


# ---- rows of the index: the little that a table of a thousand results shows of each ------------

STATUSES = ("accepted", "rejected", "inconclusive", "measured", "failed", "refused")
"""What can become of a unit; measured: there were no limits; refused: it was not begun."""

_SHOWN = (
    "name", "metric", "symbol", "value", "unit", "u", "lower", "upper", "U", "guard_factor", "verdict",
)  # fmt: skip


def row_of(document: Mapping[str, Any], link: str | None) -> dict[str, Any]:
    """Return the row of a result.json or a failed.json."""
    unit = document["unit"]
    verdict = document.get("verdict")
    failed = "reason" in document
    status = document["status"] if failed else STATUS_OF_VERDICT.get(verdict or "", "measured")
    return {
        "unit": unit["name"],
        "key": unit["key"],
        "groups": dict(unit["groups"]),
        "status": status,
        "verdict": verdict,
        "reason": document.get("reason") or reason_of(document.get("characteristics", ())),
        "exit_code": document["exit_code"] if failed else _code(status),
        "link": link,
        "characteristics": [
            {k: c[k] for k in _SHOWN if k in c} for c in document.get("characteristics", ())
        ],
        "messages": list(document.get("messages", ())),
        "hash": unit["hash"],
        "input_sha256": unit["input_sha256"],
        "recipe_sha256": unit["recipe_sha256"],
        "version": unit["version"],
        "measured_at": _measured_at(document),
        **({k: document.get(k) for k in ("error", "again")} if failed else {}),
    }


def _measured_at(document: Mapping[str, Any]) -> str | None:
    known = [i["measured_at"] for i in document.get("inputs") or () if i.get("measured_at")]
    return min(known, key=moment_of, default=None)


def _code(status: str) -> int:
    return {"rejected": 1, "inconclusive": 3}.get(status, 0)


def exit_code(rows: list[dict[str, Any]], *, closed: bool = False) -> int:
    """Return the exit code of a batch: 5, then 6, 1, 3; 0 where all is accepted.

    Examples
    --------
    >>> exit_code([{"status": "rejected", "exit_code": 1}, {"status": "failed", "exit_code": 4}])
    6
    """
    failed = [r for r in rows if r["status"] in ("failed", "refused")]
    if any(r["exit_code"] == 5 for r in failed):
        return 5
    if failed or closed:
        return 6
    statuses = {r["status"] for r in rows}
    return 1 if "rejected" in statuses else 3 if "inconclusive" in statuses else 0


# ---- `BatchReport`: what became of every unit of a batch ---------------------------------------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BatchReport(PublicObject):
    """What became of every unit of a batch.

    Parameters
    ----------
    rows : tuple of mapping
        One for each unit that was finished, by its name, as `metrosep.batch.index.row_of` gives
        it, with ``seconds`` and ``skipped``.
    counts : mapping of str to int
        By status; with ``total`` units found, ``skipped`` (done before) and ``open`` (not begun,
        since the batch was stopped).
    seconds : float, s
        Wall time.
    exit_code : int
        5 bug, 6 failed files, 1 rejected, 3 inconclusive, 0 accepted, 130 interrupted.
    messages : tuple of str
        What the user should know.
    out : Path, optional
        Output folder; None after a dry run.
    stopped : str, optional
        Why the batch ended early.
    document : mapping, optional
        Content of index.json.
    """

    rows: tuple[Mapping[str, Any], ...]
    counts: Mapping[str, int]
    seconds: float
    exit_code: int
    messages: tuple[str, ...] = ()
    out: Path | None = None
    stopped: str | None = None
    document: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        return shortened(f"BatchReport({self.summary()})")

    def summary(self) -> str:
        """Return one line: how many of which status, and how long it took.

        Returns
        -------
        str
            Such as ``1000 units: 970 accepted, 20 rejected, 10 failed; 41.2 s``.
        """
        n = self.counts
        words = [f"{n[s]} {s}" for s in STATUSES if n.get(s)]
        words += [f"{n['open']} not begun"] if n.get("open") else []
        text = f"{n['total']} unit{'s' if n['total'] != 1 else ''}: {', '.join(words) or 'none'}"
        if n.get("skipped"):
            text += f" ({n['skipped']} done before)"
        text += f"; {self.seconds:.1f} s"
        return text + (f"; {self.stopped}" if self.stopped else "")

    def index(self, path: str | os.PathLike[str]) -> Path:
        """Write the index once more.

        Parameters
        ----------
        path : str or path
            File; its suffix says which format: ``.json``, ``.csv``, or one that is installed.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        DataError
            If nothing that is installed writes this format, or after a dry run.
        WriteError
            If it cannot be written.
        """
        from metrosep.core.errors import DataError

        if not self.document:
            raise DataError(f"{path}: this batch has no index; it was a dry run")
        target = Path(path)
        return write_index(self.document, target, target.suffix.lstrip(".").lower())


# ---- why a part is not accepted, in words: value, limit and uncertainty of each check ----------

_DIGITS = 4
_MOST_DIGITS = {"reject": 15, "inconclusive": 7}
"""Of a value beside its limit: as many as tell the two apart."""


def reason_of(characteristics: Iterable[Mapping[str, Any]]) -> str | None:
    """Return which characteristics are not accepted and why.

    Examples
    --------
    >>> entry = {"name": "Sq", "unit": "m", "value": 1.42e-8, "upper": 1.2e-8, "U": 3e-10}
    >>> reason_of([{**entry, "verdict": "reject"}])
    'Sq 14.2 nm > 12 nm (U 0.3 nm): reject'
    """
    bad = (c for c in characteristics if c.get("verdict") in ("reject", "inconclusive"))
    return "; ".join(f"{_name(c)} {_words(c)}: {c['verdict']}" for c in bad) or None


def _name(entry: Mapping[str, Any]) -> str:
    name = entry.get("name")
    own = name if name and name != entry.get("definition") else None
    return str(own or entry.get("metric") or name)


def _words(entry: Mapping[str, Any]) -> str:
    value = entry.get("value")
    if entry.get("reason"):
        return str(entry["reason"])
    limits = [v for v in (entry.get("lower"), entry.get("upper")) if v is not None]
    if value is None or not math.isfinite(value):
        return "not known"
    limit = min(limits, key=lambda v: abs(value - v), default=None)
    if limit is None:
        return _texts([value], entry, _DIGITS)[0]
    is_outside = value > limit if limit == entry.get("upper") else value < limit
    tried = range(_DIGITS, _MOST_DIGITS[entry["verdict"]] + 1)
    texts = [_texts([value, limit], entry, n) for n in (tried if value != limit else tried[:1])]
    shown, bound = next((pair for pair in texts if pair[0] != pair[1]), texts[0])
    spread = _texts([entry.get("U") or 0.0], entry, _DIGITS)[0]
    if is_outside and (shown != bound or entry["verdict"] == "reject"):
        return f"{shown} {'>' if value > limit else '<'} {bound} (U {spread})"
    factor = entry.get("guard_factor")
    times = "" if factor in (None, 1.0) else f"{factor:g} "
    return f"{shown}, within {times}U of {bound} (U {spread})"


def _texts(values: list[float], entry: Mapping[str, Any], digits: int) -> list[str]:
    """Return numbers in the unit in which the limits read well."""
    limits = [v for v in (entry.get("lower"), entry.get("upper")) if v]
    unit, factor = readable_unit(limits or [entry.get("value")], str(entry.get("unit") or "1"))
    tail = "" if unit == "1" else f" {unit}"
    return [f"{digits_of(v / factor, digits)}{tail}" for v in values]
