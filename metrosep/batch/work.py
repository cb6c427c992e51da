"""One unit of a batch, carried out by a worker: read, measure, judge, write, mark as done."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import secrets
import shutil
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep._version import __version__
from metrosep.batch import units
from metrosep.batch.index import row_of
from metrosep.batch.units import (
    FAILED,
    RESULT,
    Identity,
    Unit,
    files_read,
    former_title,
    is_utf8,
    one_line_name,
    unit_record,
)
from metrosep.core import errors, exit_codes
from metrosep.core._arrays import FloatArray
from metrosep.core._thumbnails import colour_png, profile_thumbnail
from metrosep.core.blas import one_thread
from metrosep.core.errors import MetrosepError, ReadError, RecipeError, WriteError
from metrosep.recipe.describe.charts import decimated, display_limits

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

DISK_FULL = "disk full"
"""Status of a row that stops the whole batch."""

STAGE = ".metrosep-"


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker needs to know; small, so that sending it costs nothing."""

    text: str  # of the recipe, as `Recipe.parse` takes them
    name: str
    folder: str
    recipe_hash: str  # what the recipe must come to; another one was changed meanwhile
    out: str  # output folder
    workers: int  # how many share the memory
    resume: bool = True  # whether what is done stays
    stated: Mapping[str, Any] | None = (
        None  # fields of the report beside the recipe, `Recipe.typed`
    )


def do_unit(task: Task, unit: Unit) -> dict[str, Any]:
    """Run the recipe on one unit; the outcome is on the disk when this returns.

    Notes
    -----
    Nothing is raised: whatever fails is a row. result.json comes last, by one rename, so a unit
    that has it is done.
    """
    began = time.perf_counter()
    identity = Identity("", task.recipe_hash, units.short_version(), unit.name)
    try:
        before = _stamps(unit)
        identity = Identity(input_hash(unit), task.recipe_hash, units.short_version(), unit.name)
        done = earlier_row(task, unit, identity)
        if done is not None:
            return {**done, "seconds": time.perf_counter() - began, "skipped": True}
        _require_utf8(unit)
        refusal = _memory_refusal(task, unit)
        if refusal is not None:
            row = record_failure(task, unit, refusal, status="refused", identity=identity)
        else:
            with one_thread():
                row = _carry_out(task, unit, identity, before)
    except Exception as exc:  # every failure of a unit becomes its row
        row = record_failure(task, unit, exc, identity=identity)
    return {**row, "seconds": time.perf_counter() - began, "skipped": False}


def record_failure(
    task: Task,
    unit: Unit,
    error: BaseException,
    *,
    status: str = "failed",
    identity: Identity | None = None,
) -> dict[str, Any]:
    """Write failed.json of a unit and return its row."""
    if identity is None:
        with contextlib.suppress(OSError, MetrosepError):
            identity = Identity(
                input_hash(unit), task.recipe_hash, units.short_version(), unit.name
            )
    identity = identity or Identity("", task.recipe_hash, units.short_version(), unit.name)
    folder = identity.folder(Path(task.out), unit)
    document = units.failed_document(
        unit_record(unit, identity),
        status=status,
        code=exit_code_of(error),
        kind=type(error).__name__,
        reason=as_reason(error, unit),
        again=status == "refused" or worth_another_try(error),
    )
    row = row_of(document, _link(folder, task, FAILED))
    if is_disk_full(error):
        return {**row, "status": DISK_FULL}
    try:
        units.write_mark(folder, FAILED, document)
    except (WriteError, OSError) as exc:
        if is_disk_full(exc):
            return {**row, "status": DISK_FULL}
        reason = f"{row['reason']} (and failed.json cannot be written: {exc})"
        return {**row, "reason": reason, "link": None}
    return row


def input_hash(unit: Unit) -> str:
    """Return the SHA-256 of a unit's input."""
    hashes = []
    files = files_read(unit)
    for file in files:
        with open(file, "rb") as handle:  # noqa: PTH123
            hashes.append(hashlib.file_digest(handle, "sha256").hexdigest())
    if files == (unit.target,):
        return hashes[0]
    names = [os.path.relpath(f, unit.target) for f in files]
    lines = "".join(f"{n}\0{h}\n" for n, h in zip(names, hashes, strict=True))
    return hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest()


def earlier_row(task: Task, unit: Unit, identity: Identity) -> dict[str, Any] | None:
    """Return the row of what an earlier run finished."""
    if not task.resume:
        return None
    folder = identity.folder(Path(task.out), unit)
    for name in (RESULT, FAILED):
        found = units.read_mark(folder, name)
        if found is None or found["unit"].get("hash") != identity.digest:
            continue
        if name == RESULT and found["unit"].get("report_sha256", "") != _report_hash(task, unit):
            continue  # the numbers stay, the report would name something else
        if name == FAILED and (found.get("again", True) or found.get("metrosep") != __version__):
            continue
        return {**row_of(found, _link(folder, task, name)), **former_title(found, task.text)}
    return None


def _require_utf8(unit: Unit) -> None:
    if not is_utf8(unit):
        raise ReadError(f"{unit.name}: the name is not UTF-8; rename the file")


def _memory_refusal(task: Task, unit: Unit) -> MemoryError | None:
    free = available_bytes()
    wanted = wanted_bytes(files_read(unit))
    share = None if free is None else free // task.workers
    if share is None or wanted <= share:
        return None
    return _TooLargeError(
        f"{unit.name}: its input wants about {wanted / 1e9:.3g} GB of memory, and each of "
        f"{task.workers} worker(s) has {share / 1e9:.3g} GB; use fewer workers (--workers 1) or a "
        "larger machine"
    )


class _TooLargeError(MetrosepError, MemoryError):
    """A unit that was not begun since it would not fit."""


def _carry_out(
    task: Task, unit: Unit, identity: Identity, before: Mapping[str, tuple[int, int]]
) -> dict[str, Any]:
    from metrosep.recipe.outputs import table_names
    from metrosep.recipe.run import run_recipe
    from metrosep.recipe.step_help import in_recipe_words

    recipe = _stated_recipe(task)
    folder = identity.folder(Path(task.out), unit)
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob(f"{STAGE}*"):  # of a worker that was killed
        shutil.rmtree(stale, ignore_errors=True)
    stage = folder / f"{STAGE}{secrets.token_hex(6)}"
    stage.mkdir()
    try:
        inside = stage if recipe.outputs else None
        record = unit_record(unit, identity, _report_hash(task, unit))
        told = {"unit": record}  # in the reports too: made again, same bytes
        with in_recipe_words(recipe):
            done = run_recipe(
                recipe, unit.target, out=inside, progress=None, with_result=False, more=told
            )
        document = done.document
        picture = thumbnail(document)
        if picture is not None:
            (stage / THUMB).write_bytes(picture)
        _require_unchanged(unit, before, identity, document)
        _keep_tables(stage, folder, table_names(recipe), fresh=not task.resume)
        (folder / RESULT).unlink(missing_ok=True)
        for file in sorted(stage.iterdir()):
            file.replace(folder / file.name)
        units.write_mark(folder, RESULT, document)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    (folder / FAILED).unlink(missing_ok=True)
    return row_of(document, _link(folder, task, RESULT))


def _keep_tables(stage: Path, folder: Path, names: list[str], *, fresh: bool) -> None:
    """Keep tables that are replaced because all is done again; otherwise refuse to replace them."""
    from metrosep.recipe.outputs import keep_replaced

    try:
        keep_replaced(stage, folder, names, overwrite=fresh)
    except WriteError as exc:
        exc.args = (str(exc).replace("say overwrite", "do all again (--fresh)"),)
        raise


def _stated_recipe(task: Task) -> Recipe:
    """Return the recipe with the fields of a report that were typed beside it."""
    recipe = _recipe(task.text, task.name, task.folder, task.recipe_hash)
    return replace(recipe, typed=task.stated) if task.stated else recipe


def _report_hash(task: Task, unit: Unit) -> str:
    from metrosep.recipe.report_fields import report_hash

    return report_hash(_stated_recipe(task), [Path(file) for file in unit.files])


@lru_cache(maxsize=4)
def _recipe(text: str, name: str, folder: str, expected: str) -> Recipe:
    """Return the recipe, made once in each worker."""
    from metrosep.recipe.outputs import recipe_hash
    from metrosep.recipe.recipe import Recipe

    recipe = Recipe.parse(text, name=name, folder=folder)
    if recipe_hash(recipe) != expected:
        raise RecipeError(
            f"{name}: a file that it names changed during the batch; start the batch again"
        )
    return recipe


def _stamps(unit: Unit) -> dict[str, tuple[int, int]]:
    stamps = {}
    for file in files_read(unit):
        found = os.stat(file)  # noqa: PTH116
        stamps[file] = (found.st_size, found.st_mtime_ns)
    return stamps


def _require_unchanged(
    unit: Unit,
    before: Mapping[str, tuple[int, int]],
    identity: Identity,
    document: Mapping[str, Any],
) -> None:
    try:
        after = _stamps(unit)
    except OSError as exc:
        raise ChangedError(
            f"{unit.name}: vanished while it was read ({exc.strerror or exc}); copy it again"
        ) from None
    grown = [f for f in sorted({**before, **after}) if after.get(f) != before.get(f)]
    name = Path(unit.target).name  # a reader may turn to a file beside it, which has another hash
    read = {i.get("sha256") for i in document.get("inputs", ()) if i.get("name") == name} - {None}
    single = tuple(before) == (unit.target,)
    if grown or (single and read and identity.input_hash not in read):
        name = Path(grown[0]).name if grown else name
        raise ChangedError(
            f"{unit.name}: {name} changed while it was read; wait until the instrument has written "
            "it, then resume"
        )


def _link(folder: Path, task: Task, name: str) -> str:
    return (folder / name).relative_to(task.out).as_posix()


# ---- why a unit failed, in one sentence, and with which exit code ``run`` would have ended -----


class ChangedError(errors.ReadError):
    """An input vanished, grew or was replaced while it was read."""


class WorkerDiedError(errors.MetrosepError, RuntimeError):
    """A worker process ended while it worked on a unit alone."""


_MORE: exit_codes.Codes = ((WorkerDiedError, 4), (OSError, 4), (MemoryError, 4))
"""Besides those of every command: a batch goes on, and such an input is a row that cannot be used."""


def exit_code_of(error: BaseException) -> int:
    """Return the exit code that ``run`` ends with for an error."""
    return exit_codes.exit_code_of(error, _MORE)


def is_disk_full(error: BaseException) -> bool:
    """Return whether an error comes from a disk or a quota that is full."""
    full = (errno.ENOSPC, errno.EDQUOT) if hasattr(errno, "EDQUOT") else (errno.ENOSPC,)
    return any(isinstance(e, OSError) and e.errno in full for e in _chain(error))


def worth_another_try(error: BaseException) -> bool:
    """Return whether the same bytes may pass when the batch is resumed."""
    outside = (
        ChangedError, WorkerDiedError, errors.WriteError, errors.UnsupportedFeatureError, MemoryError,
    )  # fmt: skip
    if isinstance(error, outside) or not isinstance(error, errors.MetrosepError):
        return True
    return any(isinstance(e, OSError | MemoryError) for e in _chain(error)) or _no_formats()


def _no_formats() -> bool:
    """Return whether this installation cannot tell what a file is, whatever its content."""
    from metrosep.io.registry import formats

    try:
        formats()
    except errors.ReadError:
        return True
    return False


def as_reason(error: BaseException, unit: Unit) -> str:
    """Return an error as one sentence without machine paths."""
    if isinstance(error, errors.MetrosepError):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = f"{unit.name}: the memory did not suffice; use fewer workers"
    elif isinstance(error, OSError):
        text = (
            f"{unit.name}: cannot be read ({error.strerror or error}); check that it is there, that "
            "you may read it and that no other program holds it"
        )
    else:
        text = f"internal error ({type(error).__name__}: {error}); this is a bug in metrosep: report it"
    shown = one_line_name(unit.name)
    text = text.replace(unit.name, shown)
    for file in sorted({*unit.files, unit.target}, key=len, reverse=True):
        tail = file.removeprefix(unit.target).lstrip("/\\")
        base = "" if unit.name == "." else shown
        text = text.replace(file, "/".join(p for p in (base, tail) if p) or ".")
    if unit.files == (unit.target,):  # a file beside it, such as the second one of a pair
        here = unit.name.rpartition("/")[0]
        place = os.path.join(os.path.dirname(unit.target), "")  # noqa: PTH118, PTH120
        text = text.replace(place, f"{here}/" if here else "") if len(place) > 1 else text
    return " ".join(text.split())


def _chain(error: BaseException) -> Iterator[BaseException]:
    seen: set[int] = set()
    link: BaseException | None = error
    while link is not None and id(link) not in seen:
        seen.add(id(link))
        yield link
        link = link.__cause__ or link.__context__


# ---- how much memory there is, and how much the inputs of a unit will want ---------------------

FACTOR = 6
"""Bytes of memory for each byte of input: the map, its mask, a copy in work, spectra of it."""


def available_bytes() -> int | None:
    """Return the memory that may still be taken."""
    found = [n for n in (_of_system(), _of_group()) if n is not None]
    return min(found) if found else None


def wanted_bytes(files: Sequence[str]) -> int:
    """Return how much memory the files of a unit are expected to want."""
    return FACTOR * sum(max(os.stat(f).st_size, _unpacked(f)) for f in files)  # noqa: PTH116


def _unpacked(file: str) -> int:
    if not file.lower().endswith((".x3p", ".zip", ".al3d", ".plux", ".sur.gz", ".npz")):
        return 0
    try:
        with zipfile.ZipFile(file) as archive:
            return sum(entry.file_size for entry in archive.infolist())
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return 0  # the reader will say what is wrong with it


def _of_system() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return _of_windows()


def _of_windows() -> int | None:
    if os.name != "nt":
        return None
    import ctypes

    class Status(ctypes.Structure):
        _fields_ = (
            ("length", ctypes.c_ulong),
            ("load", ctypes.c_ulong),
            *((f"n{i}", ctypes.c_ulonglong) for i in range(7)),
        )

    status = Status()
    status.length = ctypes.sizeof(status)
    kernel = getattr(ctypes, "windll").kernel32  # noqa: B009  # not there on other systems
    return int(status.n1) if kernel.GlobalMemoryStatusEx(ctypes.byref(status)) else None


def _of_group() -> int | None:
    group = Path("/sys/fs/cgroup")
    try:
        most = (group / "memory.max").read_text(encoding="ascii").strip()
        used = (group / "memory.current").read_text(encoding="ascii").strip()
        return None if most == "max" else max(0, int(most) - int(used))
    except (OSError, ValueError):
        return None


# ---- the small picture of a result for the index: 96 pixels wide, at most 8 kB ---------------------

THUMB = "thumb.png"
_SIDES, _MOST_BYTES = (96, 80, 64, 48), 8192


def thumbnail(document: Mapping[str, Any]) -> bytes | None:
    """Return the picture of what was judged: the last map, else the first curve; None where there is neither.

    A pixel that stands out keeps its value, as in the pictures of a report.
    """
    charts = (document.get("separation") or {}).get("charts") or []
    maps = [c for c in charts if c.get("kind") == "maps" and c.get("parts")]
    if maps:
        rows = next(iter(maps[-1]["parts"].values()))
        z = _numbers(rows)
        if z.ndim == 2 and np.isfinite(z).any():
            return _map_thumbnail(z, maps[-1].get("limits"))
    for chart in charts:
        for panel in chart.get("panels") or []:
            for curve in panel.get("curves") or []:
                x, y = _numbers(curve["x"]), _numbers(curve["y"])
                if x.size > 1 and np.isfinite(y).any():
                    return profile_thumbnail(x, y)
    plots = document.get("plots") or {}
    if plots.get("x_mm"):
        return profile_thumbnail(_numbers(plots["x_mm"]), _numbers(plots["estimate_nm"]))
    return None


def _map_thumbnail(z: FloatArray, limits: Any) -> bytes:
    low, high = limits or display_limits(z)[:2]
    made = b""
    for side in _SIDES:
        made = colour_png(decimated(z, max(1, -(-max(z.shape) // side))), float(low), float(high))
        if len(made) <= _MOST_BYTES:
            break
    return made


def _numbers(values: Any) -> FloatArray:
    """Return numbers of a document, None as NaN."""
    return np.array(values, dtype=np.float64)
