"""Units of a batch: which files of a folder belong together, and what they are called."""

from __future__ import annotations

import functools
import json
import os
import re
import stat
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from metrosep.batch.left_out import CLOSED, LeftOut, sentences
from metrosep.batch.names import safe_name, utf8_name
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import ReadError, RecipeError, WriteError
from metrosep.core.methods import METHODS
from metrosep.io.registry import FOLDERS_VARIABLE, formats

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = [
    "Found",
    "Unit",
    "files_read",
    "find_units",
    "one_file_each",
    "record_source",
    "require_own_source",
    "safe_name",
]


@dataclass(frozen=True, slots=True)
class Unit:
    r"""What one result is made of.

    Parameters
    ----------
    name : str
        Path of the file, or of the folder of a set, below the input folder; parts joined by ``/``,
        bytes that are no UTF-8 as ``\xff``.
    target : str
        Absolute path of the file or folder that the recipe is given.
    files : tuple of str
        Absolute paths of all that is read.
    key : str
        Safe name of its output folder.
    groups : mapping of str to str
        What the named groups of the pattern found.
    """

    name: str
    target: str
    files: tuple[str, ...]
    key: str
    groups: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Found:
    """Units of a folder, and what was left out.

    Parameters
    ----------
    units : tuple of Unit
        By name.
    messages : tuple of str
        In plain words.
    apart : tuple of LeftOut
        What is no input, one for each reason.
    """

    units: tuple[Unit, ...]
    messages: tuple[str, ...] = ()
    apart: tuple[LeftOut, ...] = ()

    def names(self, what: str) -> tuple[str, ...]:
        """Return what was left out for a reason.

        Parameters
        ----------
        what : str
            Of `LeftOut`.

        Returns
        -------
        tuple of str
            Names below the input folder.
        """
        return next((a.names for a in self.apart if a.what == what), ())

    @property
    def left_out(self) -> tuple[str, ...]:
        """Files or folders that do not fit the pattern of ``[batch]``."""
        return self.names("pattern")

    @property
    def closed(self) -> tuple[str, ...]:
        """Folders that cannot be read."""
        return self.names(CLOSED)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Output folders of other batches; what lies in them is no input."""
        return self.names("outputs")


def find_units(
    recipe: Recipe, folder: str | os.PathLike[str], *, out: Path | None = None
) -> Found:
    """Return the units of a folder and its subfolders.

    Parameters
    ----------
    recipe : Recipe
        With ``[input] files`` (patterns such as ``*.x3p``) and ``[batch]``.
    folder : str or path
        Input folder.
    out : Path, optional
        Output folder; what lies in it is no input.

    Returns
    -------
    Found
        A unit for each file; for a recipe that takes several files together, one for each folder
        that holds some.

    Raises
    ------
    ReadError
        If the folder is none, cannot be read, or is itself the output folder of a batch.
    RecipeError
        If the recipe reads no input, or ``files`` holds a whole path.

    Notes
    -----
    Hidden files (``.name``), folders behind links, the output folder and, unless the recipe works on
    results, those of other batches are not looked into. Upper
    and lower case are the same, so that ``R.X3P`` is a ``*.x3p``; only where the files of a folder
    belong together the recipe's own reading counts, and a message names what it will not take.
    Pipes, sockets and devices are no files: reading one would wait for ever.
    Where the recipe states neither files nor a pattern, every file counts whose suffix is one of a
    known format.
    """
    root = Path(folder)
    if recipe.reads_nothing:
        raise RecipeError(
            f"{recipe.name}: this recipe reads no inputs, so there is no batch of it; use 'run'"
        )
    method = METHODS.get(recipe.steps[0]["op"])
    of_results = method is not None and method.reads == "results"
    if _is_output(root) and not of_results:
        raise ReadError(
            f"{root}: is the output folder of a batch, and its results would be taken for inputs; give "
            "the folder of the measured files"
        )
    pattern = recipe.batch_options.get("pattern")
    regex = re.compile(pattern) if pattern is not None else None
    cased: list[str] = []
    odd: list[str] = []
    members = _files_of(recipe, cased, any_file=regex is not None)
    units: list[Unit] = []
    left: list[str] = []
    links: list[str] = []
    closed: list[str] = []
    outputs: list[str] | None = None if of_results else []
    for place, names in _walk(root, out, links, closed, outputs):
        for target, files in members(place, names, root):
            if _is_odd(target):
                odd.append(_relative(target, root))
                continue
            unit = _unit(target, files, root, recipe, regex)
            if unit is None:
                left.append(_relative(target, root))
            else:
                units.append(unit)
    n = sum(count_files(root / name) for name in outputs or ())
    reasons = (
        ("pattern", "do not fit the pattern of [batch]", left),
        ("links", "are links to folders", links),
        (CLOSED, "are folders that cannot be read", closed),
        ("case", "are no plain files, or fit 'files' of [input] only in another case,", cased),
        ("odd", "are no plain files (a pipe, a socket or a device)", odd),
        ("outputs", f"are output folders of batches ({n} files)", outputs or []),
    )
    apart = tuple(LeftOut(w, why, tuple(sorted(names))) for w, why, names in reasons if names)
    return Found(
        tuple(sorted(units, key=lambda u: u.name)),
        tuple(sentences([a.record() for a in apart], str(root))),
        apart,
    )


def _is_output(root: Path) -> bool:
    """Return whether an input folder is an output folder; refuse what is no folder, or closed."""
    try:
        if root.is_dir():
            return is_output_folder(root)
        what = "is a file, not a folder" if root.exists() else "does not exist"
    except OSError as exc:
        raise ReadError(f"{root}: the folder cannot be read ({exc.strerror or exc})") from None
    raise ReadError(f"{root}: {what}; a batch needs the folder of its inputs")


def one_file_each(recipe: Recipe) -> bool:
    """Return whether each file is a unit: a pipeline, or a method that takes one map or table."""
    if recipe.is_pipeline or recipe.batch_options.get("each") == "file":
        return True
    if not recipe.is_method or recipe.batch_options.get("each") == "folder":
        return False
    method = METHODS[recipe.steps[0]["op"]]
    if method.reads == "maps":
        return len(method.readings) == 1
    if method.reads == "curves":
        n = len(recipe.input["readings"])
        return n >= len(method.readings) if method.readings else n > 1 or "repeat" in recipe.input
    return method.reads == "table"


def _walk(
    root: Path, out: Path | None, links: list[str], closed: list[str], outputs: list[str] | None
) -> Iterator[tuple[Path, list[str]]]:
    """Yield each folder with its files; note those behind links, closed ones, and outputs."""
    avoid = None if out is None else out.resolve()

    def refuse(exc: OSError) -> None:
        if exc.filename is None or Path(exc.filename) == root:
            raise ReadError(f"{root}: the folder cannot be read ({exc.strerror or exc})")
        closed.append(_relative(Path(exc.filename), root))

    for place, folders, files in os.walk(root, onerror=refuse):
        here = Path(place)
        kept = []
        for name in (n for n in sorted(folders) if not n.startswith(".")):
            inside = here / name
            if inside.is_symlink():
                links.append(_relative(inside, root))
                continue
            if avoid is not None and inside.resolve() == avoid:
                continue
            try:
                is_output = is_output_folder(inside)
            except OSError:  # its files may not be looked at, even where it can be listed
                closed.append(_relative(inside, root))
                continue
            if is_output and outputs is not None:
                outputs.append(_relative(inside, root))
            else:
                kept.append(name)
        folders[:] = kept
        yield here, sorted(n for n in files if not n.startswith("."))


Members = Callable[[Path, list[str], Path], Iterator[tuple[Path, list[Path]]]]


def _is_odd(path: Path) -> bool:
    """Return whether something is neither file nor folder; a link to nothing is a file that failed."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


def _files_of(recipe: Recipe, cased: list[str], *, any_file: bool) -> Members:
    """Return what gives, folder by folder, each unit and its files."""
    patterns = tuple(recipe.input.get("files", ()))
    for pattern in patterns:
        if Path(pattern).is_absolute():
            raise recipe.place("[input]").error(
                f"files = {pattern!r} is a whole path; a batch looks for patterns such as "
                '"*.csv" in the folder that it is given',
                "files",
            )
    if not one_file_each(recipe):
        return partial(_sets, patterns or ("*.csv",), cased)
    return partial(_singles, patterns or _usual(recipe, any_file=any_file))


def _singles(
    patterns: tuple[str, ...], place: Path, names: list[str], root: Path
) -> Iterator[tuple[Path, list[Path]]]:
    for name in names:
        file = place / name
        if any(_matches(_relative(file, root) if "/" in p else name, p) for p in patterns):
            yield file, [file]


def _matches(name: str, pattern: str) -> bool:
    return fnmatchcase(name.lower(), pattern.lower())


def _sets(
    patterns: tuple[str, ...], cased: list[str], place: Path, names: list[str], root: Path
) -> Iterator[tuple[Path, list[Path]]]:
    files = sorted({f for p in patterns for f in place.glob(p) if f.is_file()})
    cased += [
        _relative(place / n, root)
        for n in names
        if place / n not in files and any("/" not in p and _matches(n, p) for p in patterns)
    ]
    if files:
        yield place, files


def _usual(recipe: Recipe, *, any_file: bool) -> tuple[str, ...]:
    """Return patterns for a recipe that states none."""
    if any_file:
        return ("*",)
    if not recipe.is_pipeline and METHODS[recipe.steps[0]["op"]].reads != "maps":
        return ("*.csv",)
    from metrosep.io.registry import formats

    suffixes = {s.lower() for f in formats() if f.reads for s in f.suffixes} - {".json", ".toml"}
    return tuple(f"*{s}" for s in sorted(suffixes))


def _unit(
    target: Path, files: list[Path], root: Path, recipe: Recipe, regex: re.Pattern[str] | None
) -> Unit | None:
    name = _relative(target, root)
    groups: dict[str, str] = {}
    if regex is not None:
        match = regex.fullmatch(target.name if name != "." else root.resolve().name)
        match = match or regex.fullmatch(name)
        if match is None:
            return None
        groups = {k: utf8_name(v or "") for k, v in match.groupdict().items()}
    keys = recipe.batch_options.get("key") or ()
    stem = target.stem if target == files[0] else target.name
    stem = stem if name != "." else root.resolve().name
    key = "_".join(safe_name(groups[k]) for k in keys) if keys else safe_name(stem)
    absolute = tuple(os.path.abspath(f) for f in files)  # noqa: PTH100  # links stay links
    return Unit(utf8_name(name), os.path.abspath(target), absolute, safe_name(key), groups)  # noqa: PTH100


def _relative(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix()


# ---- output folders of batches: how one is told from a folder of inputs, and whose results it holds ----

_LOCK, _SOURCE = ".metrosep-batch.lock", ".metrosep-batch.source"
_SCHEMA = b'"metrosep.index/1"'
_ENDS = 1 << 16
"""Bytes at both ends of an index.json that are looked at; the schema stands near one of them."""


def is_output_folder(folder: Path) -> bool:
    """Return whether a batch wrote a folder."""
    if any((folder / name).is_file() for name in (_LOCK, _SOURCE)):
        return True
    return _has_index(folder / "index.json") or _is_of_unit(folder)


def _has_index(file: Path) -> bool:
    try:
        with file.open("rb") as handle:
            size = os.fstat(handle.fileno()).st_size
            found = handle.read(_ENDS)
            if size > _ENDS:
                handle.seek(max(_ENDS, size - _ENDS))
                found += handle.read(_ENDS)
    except OSError:
        return False
    return _SCHEMA in found


def _is_of_unit(folder: Path) -> bool:
    from metrosep.batch.marks import FAILED, RESULT, read_mark

    if re.fullmatch("[0-9a-f]{8}", folder.name) is None:
        return False
    marks = (read_mark(folder, name) for name in (RESULT, FAILED))
    return any(str(m["unit"].get("hash")).startswith(folder.name) for m in marks if m is not None)


def count_files(folder: Path) -> int:
    """Return how many files lie in a folder and below, hidden ones left out."""
    return sum(not name.startswith(".") for _, _, files in os.walk(folder) for name in files)


def require_own_source(out: Path, source: Path) -> tuple[str, ...]:
    """Refuse an output folder that holds the results of another input folder.

    Notes
    -----
    The record stands in a hidden file of the output folder and leads from there, so that both may be
    moved together. Neither a result nor the index holds it.
    """
    record = out / _SOURCE
    if not record.is_file():
        return ()
    try:
        before = out.resolve() / json.loads(record.read_bytes())["inputs"]
    except (OSError, ValueError, KeyError, TypeError):
        raise WriteError(
            f"{record}: is damaged; it says which input folder the results are of: if it is {source}, "
            "delete this file, otherwise choose another output folder with -o"
        ) from None
    before = Path(os.path.normpath(before))
    if not os.path.isdir(before):  # noqa: PTH112  # False also where one may not look
        told = (
            f"the input folder of before, {before}, is not there any more; results of files that are "
            f"not in {source} are kept apart"
        )
        return (told,)
    if before.samefile(source):
        return ()
    raise WriteError(
        f"{out}: holds the results of another input folder, {before}, and has one index; give each "
        "input folder its own output folder (-o), or give the folder that holds both as the input"
    )


def record_source(out: Path, source: Path) -> None:
    """Note whose results an output folder holds."""
    there, here = source.resolve(), out.resolve()
    try:
        way = os.path.relpath(there, here)
    except ValueError:  # another drive
        way = str(there)
    text = json.dumps({"inputs": Path(way).as_posix()}) + "\n"
    target = out / _SOURCE
    if not target.is_file() or target.read_bytes() != text.encode("ascii"):
        atomic_write(target, text.encode("ascii"))


# ---- files that a reader opens beside the one that is named: a change of one is a change of the unit ----


def files_read(unit: Unit) -> tuple[str, ...]:
    """Return every file that a result of a unit may depend on.

    Notes
    -----
    All suffixes of all formats with ``sidecars`` count together. So one file too many may be taken,
    which costs a repetition; one too few would keep a verdict on other data.
    """
    family = _family(os.environ.get(FOLDERS_VARIABLE, ""))
    files = dict.fromkeys(unit.files)
    seen = {_same(Path(f)) for f in files}
    for name in unit.files:
        file = Path(name)
        if file.suffix.lower() not in family:
            continue
        for suffix in family:
            for beside in (file.with_suffix(suffix), file.with_suffix(suffix.upper())):
                if beside.is_file() and _same(beside) not in seen:
                    seen.add(_same(beside))
                    files[str(beside)] = None
    return tuple(files)


def _same(file: Path) -> object:
    """Return what two names of one file share, on a disk that ignores case."""
    try:
        found = file.stat()
    except OSError:
        return str(file)
    return (found.st_dev, found.st_ino) if found.st_ino else str(file)


@functools.lru_cache(maxsize=4)
def _family(_folders: str) -> tuple[str, ...]:
    found = set()
    for described in formats():
        sidecars = described.facts.get("sidecars", ())
        if sidecars:
            found |= {s.lower() for s in (*sidecars, *described.suffixes)}
    return tuple(sorted(found))
