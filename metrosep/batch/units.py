"""Units of a batch: which files of a folder belong together, and what they are called."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import lru_cache, partial
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import MetrosepError, ReadError, RecipeError, WriteError
from metrosep.core.methods import METHODS
from metrosep.core.runset import feed_groups
from metrosep.io.registry import FOLDERS_VARIABLE, formats
from metrosep.recipe.result import document_text

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe


@dataclass(frozen=True, slots=True)
class Unit:
    r"""What one result is made of.

    Parameters
    ----------
    name : str
        Path of the file, or of the folder of a set, below the input folder; parts joined by ``/``,
        bytes that are not UTF-8 as ``\xff``.
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
    """Units of a folder, and what was omitted.

    Parameters
    ----------
    units : tuple of Unit
        By name.
    messages : tuple of str
        In plain words.
    apart : tuple of LeftOut
        What is not an input, one for each reason.
    """

    units: tuple[Unit, ...]
    messages: tuple[str, ...] = ()
    apart: tuple[LeftOut, ...] = ()

    def names(self, what: str) -> tuple[str, ...]:
        """Return what was omitted for a reason."""
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
        """Output folders of other batches; what lies in them is not an input."""
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
        Output folder; what lies in it is not an input.

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
    Pipes, sockets and devices are not files: reading one would wait for ever.
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
        ("case", "are not plain files, or fit 'files' of [input] only in another case,", cased),
        ("odd", "are not plain files (a pipe, a socket or a device)", odd),
        ("outputs", f"are output folders of batches ({n} files)", outputs or []),
    )
    apart = tuple(LeftOut(w, why, tuple(sorted(names))) for w, why, names in reasons if names)
    return Found(
        tuple(sorted(units, key=lambda u: u.name)),
        tuple(sentences([a.record() for a in apart], str(root))),
        apart,
    )


def _is_output(root: Path) -> bool:
    """Return whether an input folder is an output folder; refuse what is not a folder, or closed."""
    try:
        if root.is_dir():
            return is_output_folder(root)
        what = "is a file, not a folder" if root.exists() else "does not exist"
    except OSError as exc:
        raise ReadError(
            f"{root}: the folder cannot be read ({exc.strerror or exc}); check its name and its rights"
        ) from None
    raise ReadError(f"{root}: {what}; a batch needs the folder of its inputs")


def one_file_each(recipe: Recipe) -> bool:
    """Return whether each file is a unit: a pipeline, or a method that takes one map or table."""
    if recipe.is_pipeline or recipe.batch_options.get("each") == "file":
        return True
    method = recipe.method
    if method is None or recipe.batch_options.get("each") == "folder":
        return False
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
            raise ReadError(
                f"{root}: the folder cannot be read ({exc.strerror or exc}); check its name and its rights"
            )
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
        apart = None
        is_stated = recipe.batch_options.get("each") == "folder"
        if not is_stated and (recipe.method is None or recipe.method.reads == "runs"):
            apart = dict(recipe.input)
        return partial(_sets, patterns or ("*.csv",), cased, apart)
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
    patterns: tuple[str, ...],
    cased: list[str],
    apart: dict[str, Any] | None,
    place: Path,
    names: list[str],
    root: Path,
) -> Iterator[tuple[Path, list[Path]]]:
    """Yield the files of a folder together; those that hold several runs of their own alone.

    `apart` is how runs are read; None where files belong together whatever they hold.
    """
    files = sorted({f for p in patterns for f in place.glob(p) if f.is_file()})
    cased += [
        _relative(place / n, root)
        for n in names
        if place / n not in files and any("/" not in p and _matches(n, p) for p in patterns)
    ]
    held = {} if apart is None else {f: _feeds_held(f, apart) for f in files}
    own = [f for f, feeds in held.items() if feeds is not None and len(feeds) != 1]
    one = {f: feeds[0] for f, feeds in held.items() if feeds is not None and len(feeds) == 1}
    if len(feed_groups(list(one.values()))) < len(one):  # else a set is one file for each feedrate
        own = sorted([*own, *one])
    for file in own:
        yield file, [file]
    if len(files) > len(own):
        yield place, [f for f in files if f not in own]


_LOOKED: dict[tuple[str, int, int, str], tuple[float, ...] | None] = {}
"""What was found in files of that size and time: a batch that watches looks again and again."""


def _feeds_held(file: Path, reading: dict[str, Any]) -> tuple[float, ...] | None:
    """Return the feedrates, m/s, of a file in which a column tells several runs of one direction apart.

    Empty where they are not known, None of another file.
    """
    from metrosep.io.runs import read_runs, told_columns
    from metrosep.recipe.schema import reading_options

    try:
        state = file.stat()
        key = (str(file), state.st_size, state.st_mtime_ns, repr(reading))
        if key not in _LOOKED:
            given = {k: v for k, v in reading_options(reading).items() if v is not None}
            told = given if "x" in given else told_columns(file, given)
            runs = read_runs(file, angles=True, **given) if told.get("run") else None
            ways = [r.direction for r in runs or ()]
            is_set = max(ways.count(1), ways.count(-1)) > 1
            feeds = tuple(feed for feed, _ in runs.by_feed()) if runs is not None else ()
            _LOOKED[key] = feeds if is_set else None
        return _LOOKED[key]
    except (MetrosepError, OSError, TypeError, ValueError):  # said where the unit is read
        return None


def _usual(recipe: Recipe, *, any_file: bool) -> tuple[str, ...]:
    """Return patterns for a recipe that states none."""
    if any_file:
        return ("*",)
    if not recipe.is_pipeline and (recipe.method is None or recipe.method.reads != "maps"):
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

    if re.fullmatch("[0-9a-f]{8}", folder.name) is None:
        return False
    marks = (read_mark(folder, name) for name in (RESULT, FAILED))
    return any(str(m["unit"].get("hash")).startswith(folder.name) for m in marks if m is not None)


def count_files(folder: Path) -> int:
    """Return how many files lie in a folder and below, hidden ones omitted."""
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


# ---- names of files as they may stand in results, in an index and on a terminal ----------------

_LONGEST = 80
_RESERVED = {"con", "prn", "aux", "nul", *(f"{d}{n}" for d in ("com", "lpt") for n in range(10))}


def safe_name(text: str) -> str:
    """Return a text as the name of one folder that cannot lead elsewhere.

    Examples
    --------
    >>> safe_name("../../etc/passwd"), safe_name("part 7"), safe_name("")
    ('_.._etc_passwd', 'part_7', '_')
    """
    name = re.sub(r"[^\w.-]", "_", text)[:_LONGEST].lstrip(".").rstrip(".")
    if not name or name.split(".")[0].casefold() in _RESERVED or name[:6].casefold() == "index.":
        name = f"_{name}"
    return name


def utf8_name(name: str) -> str:
    r"""Return the name of a file as text that every format can hold.

    Examples
    --------
    >>> print(utf8_name("lens_\udcff.x3p"), utf8_name("übung.x3p"))
    lens_\xff.x3p übung.x3p
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raw = name.encode("utf-8", "surrogateescape" if os.name != "nt" else "backslashreplace")
        return raw.decode("utf-8", "backslashreplace")
    return name


def is_utf8(unit: Unit) -> bool:
    """Return whether the names below the input folder that lead to a unit can be written."""
    depth = 0 if unit.name == "." else unit.name.count("/") + 1
    names = PurePath(unit.target).parts[-depth:] if depth else ()
    own = (*names, *(PurePath(f).name for f in unit.files))
    return all(utf8_name(n) == n for n in own)


def one_line_name(text: str) -> str:
    r"""Return a text for one line of a terminal.

    Examples
    --------
    >>> print(one_line_name("part\n7 [31m ü.x3p"), one_line_name("a\x1b"))
    part\n7 [31m ü.x3p a\x1b
    """
    return "".join(
        c if c.isprintable() or c == "\u00a0" else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


# ---- what a batch leaves out of its input folder: told at the end, and in the index ------------

CLOSED = "closed"
"""Folders that cannot be read: nobody knows what is in them, so that such a batch is not a success."""

_SHOWN = 3


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Files or folders that are omitted for one reason.

    Parameters
    ----------
    what : str
        Which reason: "pattern", "links", `CLOSED`, "case", "odd" or "outputs".
    why : str
        The same as the end of a sentence about them.
    names : tuple of str
        Below the input folder, by name.
    """

    what: str
    why: str
    names: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """Return what the index says of them."""
        names = [utf8_name(n) for n in self.names]
        return {"what": self.what, "why": self.why, "count": len(names), "names": names}


def sentences(records: Iterable[Mapping[str, Any]], place: str) -> list[str]:
    """Return what was omitted as sentences.

    Examples
    --------
    >>> links = LeftOut("links", "are links to folders", ("again",))
    >>> sentences([links.record()], "the input folder")
    ['1 below the input folder are links to folders and are omitted: again']
    """
    told = []
    for item in records:
        names, n = item["names"], item["count"]
        shown = ", ".join(one_line_name(name) for name in names[:_SHOWN])
        told.append(
            f"{n} below {place} {item['why']} and are omitted: {shown}"
            + (" ..." if n > _SHOWN else "")
        )
    return told


# ---- marks on the disk: where a unit's results lie, whether it is done, why it failed ----------

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


def unit_record(unit: Unit, identity: Identity, report: str = "") -> dict[str, Any]:
    """Return what a result says of its unit."""
    return {
        **({"report_sha256": report} if report else {}),
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


# ---- titles of results that were done before: a new title alone does nothing again -------------


def former_title(document: Mapping[str, Any], text: str) -> dict[str, str]:
    """Return the title of a result, where the recipe has another one now."""
    recipe = document.get("recipe")
    before = recipe.get("text") if isinstance(recipe, Mapping) else None
    title = _title(before) if isinstance(before, str) else None
    return {} if title is None or title == _title(text) else {"former_title": title}


@lru_cache(maxsize=64)
def _title(text: str) -> str | None:
    """Return the title that a recipe with its record gives, None where it cannot be read."""
    from metrosep.recipe.written.extends import layers_of

    try:
        return str(layers_of(text, "", Path()).data.get("title", ""))
    except RecipeError:
        return None


def title_notes(rows: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Give the message that results have a former title."""
    titles = [r["former_title"] for r in rows if "former_title" in r]
    if titles:
        each = dict.fromkeys(f'"{t}"' if t else "none" for t in titles)
        shown = ", ".join(sorted(each)[:3]) + (", ..." if len(each) > 3 else "")
        yield (
            f"{len(titles)} result(s) were done before the title was changed and keep the former one "
            f"({shown}) in result.json and their reports; --fresh does them again with the new one"
        )
