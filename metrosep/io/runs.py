"""`read_runs`: repeated runs of an axis from column text, one run per file or many in one.

Nothing is assumed about units: position, reading, feed and time carry theirs in the header or
from the caller. Feed, time, position and direction are checked against each other, since a feed
typed in the wrong unit or a run labelled the wrong way would bend the separated error.
"""

from __future__ import annotations

import itertools
import math
import os
import shlex
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    AmbiguousFormatError,
    DataError,
    FormatMismatchError,
    InvalidSamplesError,
    ReadOptionError,
    UnitError,
    UnknownFormatError,
)
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.core.runset import FORWARD, REVERSE, SAME_FEED, Run, RunSet
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.core.units import (
    Unit,
    parse_quantity,
    parse_unit,
)
from metrosep.io import registry
from metrosep.io._roles import (
    ColumnSpec,
    gap_in,
    jumps_back,
    numbering,
    pick,
    runs_beside,
    runs_in,
    sensitivity,
    since_first_row,
    time_told,
    to_si,
)
from metrosep.io.own_notes import is_marked
from metrosep.io.own_runs import own_columns, own_runs, run_table
from metrosep.io.several_runs import BLOCKS, COLUMNS, SeveralRunsError
from metrosep.io.source import RawFile, open_file, rate_of
from metrosep.io.text.dialect import header_unit
from metrosep.io.text.table import (
    Column,
    Table,
    interruption,
    read_table,
    refuse_row_gap,
    text_of,
    without_empty_rows,
)

FeedSpec: TypeAlias = ColumnSpec | float | Sequence[float | str] | None
"""A column, a number in m/s, text such as ``"7200 mm/min"``, or a list with one per file."""


def read_runs(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    x: ColumnSpec | None = None,
    z: ColumnSpec | None = None,
    feed: FeedSpec = None,
    run: str | None = None,
    direction: str | None = None,
    time: ColumnSpec | None = None,
    sampling_rate: float | str | None = None,
    scale: float | str | None = None,
    angles: bool = False,
    **layout: Any,
) -> RunSet:
    """Read repeated runs from text, from recordings of loggers, or from metrosep's own files.

    Parameters
    ----------
    paths : path or iterable of paths
        One or several files; without `run`, each is one run.
    x, z : str or tuple of (str, str)
        Columns (or channels) of the position and of the reading: a name whose header carries the
        unit (``"x_mm"``), ``"name:unit"`` or ``("name", "unit")``. A file that metrosep wrote with
        its runs needs none, nor does one whose names and units tell run, position and reading.
    feed : column, float (m/s), str with unit, or list of either, optional
        Column of the feedrate, or one feed for all runs (``"7200 mm/min"``), or a list with one
        per file. Its sign is not needed: the direction follows from the positions.
    run : str, optional
        Column that tells the runs of one file apart; ``"blocks"`` where there is none and a run
        begins where the position jumps back; ``"columns"`` where the runs are columns beside each
        other, called alike but for a number: `z` names one of them.
    direction : str, optional
        Column with ``fwd``/``rev``, ``forward``/``backward``, ``+1``/``-1``; it must agree with the
        travel. A run that holds both directions becomes two.
    time : column, optional
        Column of time; a recording has its own, and without a feed so has a table in which one
        column has the name and the unit of a time.
    sampling_rate : float (Hz) or str, optional
        Rate of the samples, where there is no column of time.
    scale : float (m/V) or str, optional
        Sensitivity of the sensor where `z` is a voltage, such as ``"-2.5 um/V"``; the sign is kept.
    angles : bool, optional
        Whether positions and readings may be angles, of an axis that turns; the metadata then name
        their units.
    **layout
        How the text is written, where that is not clear: ``separator``, ``decimal``, ``thousands``,
        ``encoding``, ``comment``, ``skip_rows``, ``skip_lines``, ``missing``.

    Returns
    -------
    RunSet
        Runs in the order of the files. Time comes from its column, else from the sampling rate,
        else from feed and mean step. The history holds one step ``read`` per file, with SHA-256.

    Raises
    ------
    ReadError
        If a file cannot be read, or a column is missing (the message lists those that there are).
    UnitError
        If a unit is missing or of the wrong dimension.
    DataError
        If a run is not monotonic, has no reading at all, its feed varies, or its label, feed, time
        and travel contradict each other.

    Notes
    -----
    A row without a reading keeps its place with z = NaN; a row without a position is refused, since
    dropping it would shift the time of those after it.
    """
    files = [paths] if isinstance(paths, (str, os.PathLike)) else list(paths)
    if not files:
        raise FormatMismatchError("read_runs got no file; name at least one")
    feeds = _feed_per_file(feed, len(files))
    if time is not None and sampling_rate is not None:
        raise FormatMismatchError(
            "both time= and sampling_rate= are given; keep the column of time and leave the rate out"
        )
    for name in layout:
        if name not in TEXT_OPTIONS:
            raise ReadOptionError(
                f"read_runs takes no option {name!r}; for the layout of the text there are "
                f"{', '.join(TEXT_OPTIONS)}"
            )
    if x is None and z is None:
        given = {
            "run": run,
            "direction": direction,
            "time": time,
            "sampling_rate": sampling_rate,
            "scale": scale,
            **layout,
        }
        stated = {k: v for k, v in given.items() if v is not None}
        return _told(files, stated, feeds, angles=angles)
    if x is None or z is None:
        raise FormatMismatchError("read_runs needs both x= and z=; name the two columns")
    request = _Request(x, z, run, direction, time, sampling_rate, scale, len(files), angles)
    return _runs_from((columns_of(open_file(path), layout) for path in files), feeds, request)


def _runs_from(
    sources: Iterator[Source], feeds: Sequence[ColumnSpec | float | None], request: _Request
) -> RunSet:
    """Return the runs of files whose columns come one file at a time, each with its feed."""
    runs: list[Run] = []
    history: list[Step] = []
    ledgers: list[Mapping[str, Any]] = []
    warnings: list[str] = []
    zero: Decimal | None = None  # of the clock, where it counts from a date
    counted = request.sampling_rate is not None
    for file_feed in feeds:
        file, table, format_id = next(sources)
        clocked = request
        is_clocked = TIME in table.names and "separator" not in table.header
        if is_clocked and request.time is None and not counted:
            clocked = replace(request, time=TIME)
        elif file_feed is None and request.time is None and not counted:
            clocked = replace(request, time=time_told(table))
        if not counted:
            table = without_empty_rows(table)
        if clocked.time is not None:
            table, zero = from_first_row(file, table, clocked.time, zero)
        said = (
            *table.warnings,
            *(interruption(table) if clocked.time is None else ()),
            *_other_places(file, table, clocked),
            *(_gaps(table, clocked, file_feed) if clocked.time is None else ()),
        )
        warnings.extend(f"{file.name}: {w}" for w in said)
        ledgers.append(table.ledger)
        held = [table]
        del table  # what was read is given up as soon as the runs hold it
        if request.run == COLUMNS and COLUMNS not in held[0].names:
            runs.extend(_runs_beside(file, held, clocked, file_feed))
        else:
            runs.extend(_runs_of(file, held, clocked, file_feed))
        facts = {"x": request.x, "z": request.z, "feed": file_feed, "scale": request.scale}
        history.extend(file.history(format_id, {k: str(v) for k, v in facts.items()}))
    units = {(r.metadata.get("unit", "m"), r.metadata.get("z_unit", "m")) for r in runs}
    if len(units) > 1:
        raise UnitError("some files hold angles and others lengths: read them one kind at a time")
    unit, z_unit = units.pop()
    metadata = {
        **({} if (unit, z_unit) == ("m", "m") else {"unit": unit, "z_unit": z_unit}),
        "files": tuple(
            {"file": s.parameters["file"], "sha256": s.parameters["sha256"], "lines": ledger}
            for s, ledger in zip(history, ledgers, strict=True)
        ),
        "warnings": tuple(warnings),
    }
    return RunSet(runs, metadata=metadata, history=tuple(history))


def told_columns(
    path: str | os.PathLike[str], given: Mapping[str, Any], *, angles: bool = True
) -> dict[str, Any]:
    """Return what `read_runs` needs of a table that tells it by names and units, with what is given.

    The next `read_runs` of a file that is not too long takes what was read here.
    """
    return _told_specs(*_looked_at(path, given), given, angles=angles)


def names_of_columns(path: str | os.PathLike[str], given: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the columns of a file; the next `read_runs` takes what was read here."""
    return tuple(_looked_at(path, given)[1].names)


def are_over_an_angle(path: str | os.PathLike[str], given: Mapping[str, Any]) -> bool:
    """Return whether the positions of runs are angles; the next `read_runs` takes what was read here."""
    spec = given.get("x") or told_columns(path, given)["x"]
    file, table, _ = _looked_at(path, given)
    _, unit = pick(file, table, spec, role="x")
    return unit is not None and unit.dimension == "angle"


def _looked_at(path: str | os.PathLike[str], given: Mapping[str, Any]) -> Source:
    """Return the columns of a file, kept for the next reader if it is not too long."""
    layout = {k: v for k, v in given.items() if k in TEXT_OPTIONS and v is not None}
    file = open_file(path)
    content = _taken_or_read(file, layout)
    if file.size <= _MOST_AHEAD:
        with _LOCK:
            while sum(f.size for f, *_ in _AHEAD.values()) + file.size > _MOST_AHEAD:
                del _AHEAD[next(iter(_AHEAD))]
            _AHEAD[_key(file, layout)] = content
    return _as_columns(*content)


_AHEAD: dict[tuple[Any, ...], _Content] = {}
"""What was read to see what files hold, until it is taken."""
_MOST_AHEAD = 2**26
"""Bytes of files that may wait there; the oldest go first."""
_LOCK = threading.Lock()


def _key(file: RawFile, layout: Mapping[str, Any]) -> tuple[Any, ...]:
    state = file.path.stat()
    return (
        str(file.path.resolve()),
        state.st_size,
        state.st_mtime_ns,
        repr(sorted(layout.items())),
    )


def _told_specs(
    file: RawFile, table: Table, known_as: str, given: Mapping[str, Any], *, angles: bool
) -> dict[str, Any]:
    """Return the columns that names and units tell, with what is given; refused where they do not."""
    own = own_columns(table)
    is_own = known_as in (_OWN, "hdf5") or any(map(is_marked, table.header.get("comments", ())))
    if own and is_own and (angles or own["x"] != "x_rad"):
        return {**own, **given}
    found = runs_in(table) or runs_in(table, fewest=1)
    known = found is not None and (found.run != BLOCKS or given.get("run") == BLOCKS)
    if found is None or not known or not found.is_known(given):
        advice = "name them with x= and z=, such as x='x_mm'"
        if found is not None and found.n > 1:
            raise SeveralRunsError(file.path, found, dict(given))
        raise FormatMismatchError(f"{file.path}: holds columns, not runs; {advice}")
    timed = "sampling_rate" in given
    return {**{k: v for k, v in found.specs().items() if k != "time" or not timed}, **given}


def _told(
    files: Sequence[str | os.PathLike[str]],
    given: Mapping[str, Any],
    feeds: Sequence[ColumnSpec | float | None],
    *,
    angles: bool,
) -> RunSet:
    """Return the runs of files that metrosep wrote, or whose names and units tell what they hold."""
    parts = [
        _told_runs(
            path, given if feed is None else {**given, "feed": feed}, len(files), angles=angles
        )
        for path, feed in zip(files, feeds, strict=True)
    ]
    if len(parts) == 1:
        return parts[0]
    units = {(p.metadata.get("unit", "m"), p.metadata.get("z_unit", "m")) for p in parts}
    if len(units) > 1:
        raise UnitError("some files hold angles and others lengths: read them one kind at a time")
    history = tuple(step for part in parts for step in part.history)
    metadata = {
        **{k: parts[0].metadata[k] for k in ("unit", "z_unit") if k in parts[0].metadata},
        "files": tuple(f for part in parts for f in part.metadata.get("files", ())),
        "warnings": tuple(w for part in parts for w in part.metadata.get("warnings", ())),
    }
    return RunSet([run for part in parts for run in part], metadata=metadata, history=history)


def _told_runs(
    path: str | os.PathLike[str], given: Mapping[str, Any], n_files: int, *, angles: bool
) -> RunSet:
    """Return the runs of one file, which is read once."""
    layout = {k: v for k, v in given.items() if k in TEXT_OPTIONS}
    file = open_file(path)
    file, content, known = _taken_or_read(file, layout)
    own = content if not given and isinstance(content, RunSet) else None
    if not given and isinstance(content, Table):
        is_own = any(map(is_marked, content.header.get("comments", ())))
        own = own_runs(file, content) if is_own else None
    if own is not None:
        return own
    held = [_as_columns(file, content, known)]
    del content
    return runs_of(
        held, _told_specs(*held[0], given, angles=angles), angles=angles, n_files=n_files
    )


def runs_of(
    held: list[Source], specs: Mapping[str, Any], *, angles: bool = False, n_files: int = 1
) -> RunSet:
    """Return the runs in columns that were read, which are removed from the list that holds them."""
    asked = {k: v for k, v in specs.items() if k not in TEXT_OPTIONS}
    feed = asked.pop("feed", None)
    optional = dict.fromkeys(("run", "direction", "time", "sampling_rate", "scale"))
    request = _Request(**{**optional, **asked}, n_files=n_files, angles=angles)
    return _runs_from((held.pop() for _ in range(1)), [feed], request)


def from_first_row(
    file: RawFile, table: Table, time: ColumnSpec, zero: Decimal | None
) -> tuple[Table, Decimal | None]:
    """Return the table with a time that counts from a date counted from the first row of the first file, and that moment."""
    column, unit = pick(file, table, time, role="time")
    dated = since_first_row(table, column, unit)
    if dated is None or unit is None:
        return table, zero
    since, said, first = dated
    if zero is not None:
        since = since + float(first - zero) / unit.factor
        said = f"{said}, {float(first - zero):g} s behind the first such moment, from which all are counted"
    columns = tuple(replace(c, values=since) if c is column else c for c in table.columns)
    return replace(table, columns=columns, warnings=(*table.warnings, said)), zero or first


def _other_places(file: RawFile, table: Table, request: _Request) -> Iterator[str]:
    """Yield a warning for each further position across the travel, such as y_mm, that is not used."""
    specs = {"x": request.x, "z": request.z}
    used = {pick(file, table, spec, role=role)[0].name for role, spec in specs.items()}
    for c in table.numbers:
        bare = header_unit(c.name)[0].strip().casefold()
        if c.name in used or bare not in _AXES or c.values is None or c.unit is None:
            continue
        low, high = np.fmin.reduce(c.values), np.fmax.reduce(c.values)
        if c.unit.dimension == "length" and high > low:
            yield (
                f"column {c.name!r} goes from {low:g} to {high:g} {c.unit.name} and is not used; if that is where the "
                "runs lie beside each other, separate them one line at a time"
            )


_AXES = frozenset("xyz")


@dataclass(frozen=True, slots=True)
class _Request:
    x: ColumnSpec
    z: ColumnSpec
    run: str | None
    direction: str | None
    time: ColumnSpec | None
    sampling_rate: float | str | None
    scale: float | str | None  # sensitivity of the sensor
    n_files: int
    angles: bool
    named: str = ""  # name of the one run of a table


def _feed_per_file(feed: FeedSpec, n_files: int) -> list[ColumnSpec | float | None]:
    if feed is None or isinstance(feed, (str, float, int)):
        return [feed] * n_files
    if isinstance(feed, tuple) and len(feed) == 2 and all(isinstance(f, str) for f in feed):
        name, unit = feed
        return [(str(name), str(unit))] * n_files
    items = list(feed)
    if len(items) != n_files:
        raise FormatMismatchError(
            f"feed lists {len(items)} values for {n_files} file(s); give one for each file"
        )
    return [f if isinstance(f, str) else float(f) for f in items]


def _over_an_angle(file: RawFile, what: str, words: list[str]) -> UnitError:
    """Return the error of runs of an axis that turns where runs over a length are needed."""
    return UnitError(
        f"{file.path}: {what} is an angle, and runs are separated along a length; of an axis that turns the "
        f"mean of its runs makes the table: metrosep table {shlex.join([str(file.path), *words])} --axis C "
        "--compensates C --spacing SPACING -o FILE (SPACING such as '15 deg')"
    )


def _runs_of(
    file: RawFile, held: list[Table], request: _Request, feed: ColumnSpec | float | None
) -> Iterator[Run]:
    """Yield the runs of a table, which is taken out of the list that holds it."""
    table = held.pop()
    x_column, x_unit = pick(file, table, request.x, role="x")
    z_column, z_unit = pick(file, table, request.z, role="z")
    turns, turned = (u is not None and u.dimension == "angle" for u in (x_unit, z_unit))
    if turns and not request.angles:
        words = ["--x", x_column.name, "--z", z_column.name]
        words += ["--run", request.run] if request.run else []
        raise _over_an_angle(file, f"column {x_column.name!r} (x)", words)
    kinds = ("angle" if turns else "length", "angle" if turned and turns else "length")
    units = {"unit": "rad", "z_unit": "rad" if turned else "m"} if turns else {}
    timed = None
    if request.time is not None:
        timed = pick(file, table, request.time, role="time")
        if timed[0].name in table.header.get("undecided", ()):
            raise AmbiguousFormatError(table.header["undecided"][timed[0].name])
    fed = _feed_column(file, table, feed)
    signs = _direction_column(file, table, request.direction)
    counters = {} if request.sampling_rate is None else _counters(table, request, feed)
    scale = sensitivity(request.scale)
    x = to_si(file, x_column, x_unit, dimension=kinds[0], role="x")
    parts = _parts(file, table, request, x)
    if request.run is not None:  # else a message may have to look for runs in the columns
        table = replace(table, columns=())
    del x_column  # a long column is given up as soon as its numbers are in SI
    z = to_si(file, z_column, z_unit, dimension=kinds[1], role="z", scale=scale)
    z_column = replace(z_column, values=None)
    t = None if timed is None else to_si(file, *timed, dimension="time", role="time")
    del timed
    speeds = to_si(file, *fed, dimension="speed", role="feed") if isinstance(fed, tuple) else fed
    del fed
    for run_id, rows in _by_direction(parts, signs):
        where = f"{file.path}: run {run_id!r}"
        empty = np.flatnonzero(np.isnan(x[rows]))
        if empty.size:
            every = file.without_lines(*table.lines[rows[empty]].tolist())
            raise InvalidSamplesError(
                f"{where}: line {int(table.lines[rows[empty[0]]])} has no position ({empty.size} such "
                "row(s)); a reading without a position cannot be placed: leave those rows out with "
                f"{every}"
            )
        speed = speeds if isinstance(speeds, float) else _one_feed(speeds, x, rows, where)
        if np.isnan(z[rows]).all():
            out = file.without_lines(*table.lines[rows].tolist())
            out = "remove that column" if request.named else f"leave the run out with {out}"
            raise InvalidSamplesError(
                f"{where} holds no reading in column {z_column.name!r}; check the sensor, or {out}"
            )
        start, end = x[rows[0]], x[rows[-1]]
        if signs is not None and (end - start) * signs[rows[0]] < 0.0:
            raise InvalidSamplesError(
                f"{where}: is labelled {'forward' if signs[rows[0]] > 0 else 'reverse'}, but its position "
                f"goes from {_shown(start, turns)} to {_shown(end, turns)}; check the sign of the "
                "position column or the labels"
            )
        for name, numbers in counters.items():
            said = gap_in(name, numbers[rows], table.lines[rows])
            refuse_row_gap(file, said, "tell the parts before and behind it apart with run=")
        try:
            yield Run(
                x[rows],
                z[rows],
                t=_clock(t, rows, request),
                feed=speed,
                run_id=run_id,
                metadata={
                    "file": file.name,
                    "sha256": file.sha256,
                    "first_line": int(table.lines[rows[0]]),
                    "last_line": int(table.lines[rows[-1]]),
                    **units,
                },
            )
        except DataError as exc:
            raise type(exc)(f"{file.path}: {_with_hint(str(exc), request, table)}") from None


def _runs_beside(
    file: RawFile, held: list[Table], request: _Request, feed: ColumnSpec | float | None
) -> Iterator[Run]:
    """Yield the runs that are columns beside each other: the one that z names, and those called alike."""
    table = held.pop()
    column, unit = pick(file, table, request.z, role="z")
    place, _ = pick(file, table, request.x, role="x")
    alike = runs_beside(table, column.name, place.name)
    if len(alike) < 2:
        raise FormatMismatchError(
            f"{file.path}: no column is called like {column.name!r} but for a number, and run={COLUMNS!r} takes such "
            "columns as the runs; name one of several with z=, such as z='run 1'"
        )
    prefix = f"{file.path.stem}:" if request.n_files > 1 else ""
    for own in alike:
        own_unit = own.unit or (column.unit is None and unit) or None
        one = replace(
            request,
            z=own.name if own_unit is None else (own.name, own_unit.name),
            run=None,
            named=prefix + header_unit(own.name)[0],
        )
        yield from _runs_of(file, [table], one, feed)


def _counters(
    table: Table, request: _Request, feed: ColumnSpec | float | None
) -> dict[str, FloatArray]:
    """Return the columns that number the rows."""
    fed = None if isinstance(feed, (int, float)) else feed
    given = (request.x, request.z, request.run, request.direction, fed)
    found = numbering(table, given=given)
    return {c.name: c.values for c in found if c.values is not None}


def _gaps(table: Table, request: _Request, feed: ColumnSpec | float | None) -> Iterator[str]:
    """Yield a warning for each gap in the numbers of the rows of a run whose time follows from feed and mean step."""
    if request.run is None and request.sampling_rate is None and feed is not None:
        for name, numbers in _counters(table, request, feed).items():
            if said := gap_in(name, numbers, table.lines):
                yield f"{said}, and time follows from the feed and the mean step"


def _shown(position: float, turns: bool) -> str:
    """Return a position as a person reads it."""
    return f"{math.degrees(position):.6g} deg" if turns else f"{position * 1e3:.6g} mm"


def _with_hint(message: str, request: _Request, table: Table) -> str:
    if "monotonic" in message and request.run is None:
        found = runs_in(table)
        name = found.run if found is not None else "run"
        return f"{message}; if the file holds several runs, name their column with run={name!r}"
    return message


def _clock(t: FloatArray | None, rows: NDArray[np.intp], request: _Request) -> FloatArray | None:
    if t is not None:
        return None if np.isnan(t[rows]).all() and not np.isnan(t).all() else t[rows]
    if request.sampling_rate is None:
        return None
    return np.arange(rows.size) / rate_of(request.sampling_rate)


def _feed_column(
    file: RawFile, table: Table, feed: ColumnSpec | float | None
) -> tuple[Column, Unit | None] | float | None:
    """Return the column of the feed and its unit, or one feed for all in m/s, or None."""
    if feed is None:
        return None
    if isinstance(feed, (int, float)):
        return float(feed)
    if isinstance(feed, str) and feed.strip()[:1] in "0123456789.+-" and feed not in table.names:
        return parse_quantity(feed, dimension="speed", name="feed")
    return pick(file, table, feed, role="feed")


def _one_feed(
    speeds: FloatArray | None, x: FloatArray, rows: NDArray[np.intp], where: str
) -> float | None:
    if speeds is None:
        return None
    values = speeds[rows]
    known = values[~np.isnan(values)]
    if known.size == 0 and np.isnan(speeds).all():
        raise InvalidSamplesError(f"{where}: the feed column is empty; fill it or leave feed= out")
    if known.size == 0:
        return None  # a run whose feed is not known among others
    low, high = float(known.min()), float(known.max())
    if low == high:
        speed = low
    elif high - low <= SAME_FEED * max(abs(low), abs(high)):
        speed = float(known.mean())
    else:
        raise InvalidSamplesError(
            f"{where}: the feed varies from {low * 6e4:.6g} to {high * 6e4:.6g} mm/min; tell the runs "
            "apart with run=, or cut off acceleration and braking"
        )
    if speed < 0.0 and x[rows[-1]] > x[rows[0]]:
        raise InvalidSamplesError(
            f"{where}: the feed is {speed * 6e4:.6g} mm/min, but the positions rise; check the sign of "
            "feed and position"
        )
    return abs(speed)


def _direction_column(file: RawFile, table: Table, name: str | None) -> NDArray[np.int64] | None:
    if name is None:
        return None
    column, _ = pick(file, table, name, role="direction")
    signs = np.zeros(len(table), dtype=np.int64)
    for i, label in enumerate(_texts(column)):
        word = label.strip().casefold()
        if word not in FORWARD and word not in REVERSE:
            raise FormatMismatchError(
                f"{file.path}: line {int(table.lines[i])}: direction {label!r} is not known; use fwd and "
                "rev, forward and backward, or +1 and -1"
            )
        signs[i] = 1 if word in FORWARD else -1
    return signs


_Spans: TypeAlias = NDArray[np.int64]
"""Shape (n, 2): first row of each stretch of a run, and the one behind its last."""


def _parts(
    file: RawFile, table: Table, request: _Request, x: FloatArray
) -> list[tuple[str, _Spans]]:
    """Return the name and the rows of each part that the caller tells apart, in the order of the file."""
    stem, n = file.path.stem, len(table)
    if request.run is None:
        return [(request.named or stem, np.array([[0, n]]))]
    if request.run == BLOCKS and BLOCKS not in table.names:
        edges = [0, *jumps_back(x, table.lines), n]
        blocks = itertools.pairwise(edges)
        return [(f"{stem}:{k}", np.array([block])) for k, block in enumerate(blocks, start=1)]
    column, _ = pick(file, table, request.run, role="run")
    prefix = f"{stem}:" if request.n_files > 1 else ""
    return [(prefix + k, spans) for k, spans in _by_value(file, table, column)]


def _by_direction(
    parts: Iterable[tuple[str, _Spans]], signs: NDArray[np.int64] | None
) -> Iterator[tuple[str, NDArray[np.intp]]]:
    """Yield the name and the rows of each run: a part that holds both directions is two."""
    for name, spans in parts:
        rows = np.concatenate([np.arange(a, b) for a, b in spans])
        if signs is None or np.unique(signs[rows]).size == 1:
            yield name, rows
            continue
        for sign, word in ((1, "forward"), (-1, "reverse")):
            yield f"{name} {word}", rows[signs[rows] == sign]


def _by_value(file: RawFile, table: Table, column: Column) -> Iterator[tuple[str, _Spans]]:
    """Yield each entry of a column, and the stretches of rows that have it."""
    values: Any = np.array(column.labels) if column.labels is not None else column.values
    empty = np.flatnonzero(values == "" if values.dtype.kind == "U" else np.isnan(values))
    if empty.size:
        i = int(empty[0])
        raise FormatMismatchError(
            f"{file.path}: line {int(table.lines[i])} has no entry in the run column {column.name!r}"
        )
    begins = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1])
    spans = np.column_stack([begins, [*begins[1:], values.size]])
    found = values[begins]
    for value in dict.fromkeys(found.tolist()):
        yield value if isinstance(value, str) else _as_text(value), spans[found == value]


def _texts(column: Column) -> tuple[str, ...]:
    """Return each entry as text; whole numbers without a decimal point."""
    if column.labels is not None:
        return tuple(column.labels)
    values = () if column.values is None else column.values.tolist()
    return tuple("" if math.isnan(v) else _as_text(v) for v in values)


def _as_text(value: float) -> str:
    return str(int(value)) if value == int(value) else repr(value)


# ---- the columns from which runs are cut, whatever format the file is: text, logger or metrosep's own ----

TIME = "t_s"
"""Name of the column of time of a recording."""

_OWN = "metrosep-h5"
_TEXT = "delimited"
Source: TypeAlias = tuple[RawFile, Table, str]
"""A file as its messages name it, its columns, and the format that they were read as."""


def columns_of(file: RawFile, layout: dict[str, Any]) -> Source:
    """Return the file as its messages name it, its columns, and the format that they were read as."""
    return _as_columns(*_taken_or_read(file, layout, is_named=True))


_Content: TypeAlias = tuple[RawFile, Table | RunSet | Recording, str]


def _taken_or_read(file: RawFile, layout: dict[str, Any], *, is_named: bool = False) -> _Content:
    """Return what `_looked_at` read of the same file, else read it."""
    with _LOCK:
        ahead = None if file.in_memory else _AHEAD.pop(_key(file, layout), None)
    return ahead or _content(file, layout, is_named=is_named)


def _content(file: RawFile, layout: dict[str, Any], *, is_named: bool) -> _Content:
    """Return the file as its messages name it, the table, runs or recording in it, and its format."""
    known = _format(file) or _TEXT
    if registry.get(known).is_table:
        file = text_of(file, layout)
        return file, read_table(file, is_named=is_named, **layout), known
    if layout:
        raise FormatMismatchError(
            f"{file.path}: is recognised as {known}, which takes no {next(iter(layout))}; leave it out"
        )
    obj = registry.get(known).load_reader().read(file)
    if not isinstance(obj, RunSet | Recording):
        raise FormatMismatchError(
            f"{file.path}: holds a {type(obj).__name__.lower()}, not runs or channels over time ({known}); runs "
            "are cut from recordings and tables, and metrosep.read reads this"
        )
    return file, obj, known


def _as_columns(file: RawFile, obj: Table | RunSet | Recording, known: str) -> Source:
    if isinstance(obj, Table):
        return file, obj, known
    if isinstance(obj, RunSet):
        return file, run_table(obj), known
    columns = [Column(TIME, parse_unit("s"), obj.t)]
    for name, values in obj.channels.items():
        unit = obj.units.get(name)
        columns.append(Column(name, parse_unit(unit) if unit else None, values))
    warnings = tuple(obj.metadata.get("warnings", ()))
    lines = np.arange(1, len(obj) + 1, dtype=np.int64)
    return file, Table(tuple(columns), lines, {}, warnings), known


def _format(file: RawFile) -> str | None:
    try:
        return registry.find(file).id
    except (UnknownFormatError, AmbiguousFormatError):
        return None
