"""`check_file`: what is odd about a measurement file, and what to do about it.

Reading answers what a file says; checking asks whether it can be true: a lateral scale that was
never set, a detector at its limit, a unit that makes a mirror a metre high, an angle that wraps.
Nothing is changed. The thresholds are named below; each is a habit of instruments, not a standard.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, MetrosepError, ReadError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.runset import Run, RunSet
from metrosep.core.surface import Surface
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.core.units import format_length
from metrosep.io._roles import runs_in, targets_in
from metrosep.io.containers.hdf5 import saved_object
from metrosep.io.findings import Finding, Level, height_findings
from metrosep.io.own_runs import run_table
from metrosep.io.read import read_any, read_one, recognise
from metrosep.io.registry import principal
from metrosep.io.runs import runs_of
from metrosep.io.several_runs import table_advice
from metrosep.io.source import RawFile, open_file
from metrosep.io.text.table import Table, read_table

MANY_INVALID = 0.05
"""Share of points not measured from which it is worth a finding; from half on it is an error."""

AT_THE_LIMIT = 0.005
"""Share of samples at exactly the largest or the smallest value that tells a limit from an extreme."""

OFF_CENTRE = 0.05
"""Distance of the window's centre from the camera's, as a share of the camera, that is a finding."""

_LEFT_OUT = ("preamble", "repeated header", "footer", "set aside")
"""Classes of lines that might have been rows; comments and blank lines are not."""

_TURNS = {"rad": 2.0 * math.pi, "": 360.0}


def check_file(path: str | os.PathLike[str], **options: Any) -> tuple[Finding, ...]:
    """Return what is unusual about a file; a file that cannot be read is one error.

    Parameters
    ----------
    path : str or path
        The file.
    **options
        As for `metrosep.io.read.read`.

    Returns
    -------
    tuple of Finding
        Errors first; empty when nothing is odd.
    """
    try:
        obj = read_any(path, **options)
        if isinstance(obj, RunSet):
            return _own_runs(path, obj)
    except FormatMismatchError as exc:
        found = _text_runs(path, options)
        return (_unreadable(exc),) if found is None else found
    except MetrosepError as exc:
        if not isinstance(exc, ReadError) and not isinstance(exc, ValueError):
            raise
        return (_unreadable(exc),)
    return check_object(obj)


def _unreadable(exc: MetrosepError) -> Finding:
    problem, _, fix = str(exc).partition("; ")
    return Finding("error", problem or str(exc), fix if problem else "see the message", True)


def _text_runs(
    path: str | os.PathLike[str], options: Mapping[str, Any]
) -> tuple[Finding, ...] | None:
    """Return the findings on a table of several runs, ``None`` where it is none."""
    file = open_file(path)
    text = {k: v for k, v in options.items() if k in TEXT_OPTIONS}
    try:
        description = recognise(file, options.get("format"), options)
        if not description.is_table:
            return None
        table = read_table(file, **text)
        found = runs_in(table)
        if found is None:
            targets = targets_in(table)
            fix = table_advice(path, targets)
            return (Finding("note", "holds a list of targets", fix),) if targets else None
        source = (file, table, description.id)
        runs = runs_of([source], found.specs(), angles=True) if found.is_known() else None
    except MetrosepError as exc:
        return (_unreadable(exc),)
    findings = [Finding("note", f"{found}", found.advice(path, text))]
    findings += _of_reader({"warnings": table.warnings, "lines": table.ledger})
    return _sorted([*findings, *_of_each(runs or ())])


def _sorted(findings: list[Finding]) -> tuple[Finding, ...]:
    order = ("error", "warning", "note")
    return tuple(sorted(findings, key=lambda f: order.index(f.level)))


def _own_runs(path: str | os.PathLike[str], runs: RunSet) -> tuple[Finding, ...]:
    """Return the findings on a file that metrosep wrote with its runs."""
    findings = []
    if (found := runs_in(run_table(runs))) is not None:
        found = replace(found, is_own=True)
        findings = [Finding("note", f"{found}", found.advice(path))]
    return _sorted([*findings, *_of_reader(runs.metadata), *_of_each(runs)])


def _of_each(runs: Iterable[Run]) -> Iterator[Finding]:
    for run in runs:
        for f in _values(run.z, ""):
            yield Finding(f.level, f"run {run.run_id!r}: {f.problem}", f.fix)


def check_object(obj: Surface | Profile | Recording) -> tuple[Finding, ...]:
    """Return what is unusual about a measurement."""
    found = [*_of_reader(obj.metadata)]
    if isinstance(obj, Recording):
        found += _clock(obj)
        for name, values in obj.channels.items():
            found += _values(values, f"channel {name!r}: ")
            found += _wrapped(obj, name)
    else:
        found += _values(obj.z.ravel(), "")
        found += height_findings(obj)
        found += _lateral(obj)
        found += _window(obj.metadata)
    return _sorted(found)


def _of_reader(metadata: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield what the reader noticed while it read, and how many lines of a text are no rows."""
    counts = metadata.get("lines") or {}
    aside = {k: n for k, n in counts.items() if k in _LEFT_OUT and n}
    if aside:
        listed = "; ".join(
            f"{kind}: {n} (line {counts['listed'][kind]['numbers']})" for kind, n in aside.items()
        )
        yield Finding(
            "note",
            f"{counts.get('data', 0)} of {counts['total']} lines are rows; omitted were {listed}",
            "nothing, if none of these lines is a measurement",
        )
    for sentence in metadata.get("warnings", ()):
        problem, _, fix = sentence.partition("; ")
        yield Finding(
            "warning", problem, fix or "compare with what the instrument's own program shows"
        )


def _values(values: FloatArray, where: str) -> Iterator[Finding]:
    """Yield findings on one set of numbers: missing, at a limit, without any relief."""
    valid = values[~np.isnan(values)]
    share = 1.0 - valid.size / values.size
    if share > MANY_INVALID:
        level: Level = "error" if share > 0.5 else "warning"
        yield Finding(
            level,
            f"{where}{share:.1%} of {values.size} points were not measured",
            "mask them on purpose, or measure again with more light, less slope or less vibration",
        )
    if valid.size < 20:
        return
    low, high = float(valid.min()), float(valid.max())
    if low == high:
        yield Finding(
            "error",
            f"{where}every valid value is {low:g}",
            "check the cable, the range and the export",
        )
        return
    for value, side in ((high, "largest"), (low, "smallest")):
        at = float(np.count_nonzero(valid == value)) / valid.size
        if at > max(AT_THE_LIMIT, 4.0 / valid.size) and _alone(valid, value, at):
            yield Finding(
                "warning",
                f"{where}{at:.1%} of the values are exactly the {side}, {value:g}: clipped or saturated",
                "measure again with a larger range or less light; extremes and P-V are too small",
            )


def _alone(valid: FloatArray, value: float, share: float) -> bool:
    """Return whether an extreme value is more frequent than its neighbours: coarse steps are not."""
    distinct, counts = np.unique(valid[:: max(1, valid.size // 200_000)], return_counts=True)
    if distinct.size < 10:
        return False
    typical = float(np.median(counts)) / counts.sum()
    return bool(share > 10.0 * typical)


def _lateral(obj: Surface | Profile) -> Iterator[Finding]:
    if isinstance(obj, Profile):
        steps = np.diff(obj.x)
        if steps.size and not obj.is_uniform and steps.max() > 10.0 * np.median(steps):
            yield Finding(
                "warning",
                f"a gap of {format_length(float(steps.max()))} in the positions, where the usual step is "
                f"{format_length(float(np.median(steps)))}",
                "cut the profile there, or measure it again",
            )
        return
    if obj.dx is None or obj.dy is None:
        yield Finding(
            "warning",
            "the lateral scale is not calibrated: slopes, wavelengths and areas are unknown",
            "give --lateral-step 'DX um' as measured on a standard",
        )
    elif max(obj.dx, obj.dy) > 2.0 * min(obj.dx, obj.dy):
        yield Finding(
            "note",
            f"pixels are not square: {format_length(obj.dx)} by {format_length(obj.dy)}",
            "nothing, if the instrument scans by lines; else check the lateral calibration",
        )
    if obj.metadata.get("lateral_step_override_m") is not None:
        own = obj.metadata.get("lateral_step_in_file_m")
        yield Finding(
            "note",
            f"the file's own lateral step {own} m was replaced",
            "nothing, if that was meant",
        )


def _window(metadata: Mapping[str, Any]) -> Iterator[Finding]:
    origin, camera = metadata.get("window_origin_px"), metadata.get("camera_px")
    size = metadata.get("window_px")
    if not (origin and camera and size) or min(camera) < 1:
        return
    off = [o + 0.5 * s - 0.5 * c for o, s, c in zip(origin, size, camera, strict=True)]
    if max(abs(d) / c for d, c in zip(off, camera, strict=True)) > OFF_CENTRE:
        yield Finding(
            "warning",
            f"the window is not centred in the camera: its centre lies {off[0]:+.1f} px, {off[1]:+.1f} px "
            "off (x, y from the top)",
            "use window_origin_px when maps are averaged, rotated or stitched",
        )


def _clock(obj: Recording) -> Iterator[Finding]:
    steps = np.diff(obj.t)
    if steps.size < 3:
        return
    usual = float(np.median(steps))
    late = int(np.count_nonzero(steps > 1.5 * usual))
    if 0 < late < 0.1 * steps.size:
        first = float(obj.t[int(np.argmax(steps > 1.5 * usual))])
        yield Finding(
            "warning",
            f"{late} gap(s) in the clock: the longest is {float(steps.max()) / usual:.1f} steps, the first "
            f"after t = {first:.6g} s",
            "samples were lost; cut the recording there or lower the sampling rate",
        )
    index = np.arange(obj.t.size) - (obj.t.size - 1) / 2.0
    off = obj.t - obj.t.mean()
    step = float(index @ off / (index @ index))
    off -= step * index
    rms = float(off.std())
    if (
        rms > _JITTER * step
        and np.abs(off).max() < 0.5 * step
        and abs(steps / step - 1.0).max() < 0.5
    ):
        yield Finding(
            "note",
            f"the clock jitters by {100.0 * rms / step:.2g} % of a step (RMS {rms:.3g} s), and no sample is lost",
            f"a sine of f Hz is wrong by {math.sqrt(2.0) * math.pi * rms:.3g} f of its amplitude (RMS) if the stamps "
            "jitter and the samples do not",
        )


_JITTER = 1e-3
"""RMS of the departure from a uniform clock, in steps, from which it is stated: 0.2 % of a sine of half the rate."""


def _wrapped(obj: Recording, name: str) -> Iterator[Finding]:
    turn = _TURNS.get(obj.units.get(name, ""))
    values = obj.channels[name]
    if turn is None or values.size < 20:
        return
    jumps = np.abs(np.diff(values))
    jumps = jumps[~np.isnan(jumps)]
    n = int(np.count_nonzero(np.abs(jumps - turn) < 0.05 * turn))
    in_range = float(np.nanmax(values) - np.nanmin(values)) <= 1.01 * turn
    if n and in_range and np.median(jumps) < 0.05 * turn:
        yield Finding(
            "warning",
            f"channel {name!r}: the angle wraps {n} time(s) by {turn:.4g}",
            "unwrap it (numpy.unwrap with period=) before it is subtracted, filtered or resampled",
        )


# ---- `describe`: what is in a file, as plain values for ``metrosep info`` and its JSON ---------
# Unlike `read` it also answers for a table of repeated runs or of unnamed columns, by listing the
# columns instead of making an object of them.


def describe(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002
    **options: Any,
) -> dict[str, Any]:
    """Return what a file holds as plain values that JSON can carry."""
    file = open_file(path)
    if format is None:
        file = principal(file)
    description = recognise(file, format, options)
    try:
        if description.id in ("metrosep-h5", "hdf5") and not options:
            own = (
                saved_object(file)
                if description.id == "hdf5"
                else description.load_reader().read(file)
            )
            if isinstance(own, RunSet):
                return _of_runs(file, own)
        obj = read_one(file.path, format=description.id, **options)
    except FormatMismatchError as exc:
        if not description.is_table or options.keys() - TEXT_OPTIONS.keys():
            raise
        reason = str(exc).removeprefix(f"{file.path}: ")
        return _of_table(file, read_table(file, **options), description.id, reason)
    facts: dict[str, Any] = {}
    if isinstance(obj, Recording):
        samples = list(obj.channels.values())
        shape = [len(obj), len(samples)]
        facts = {
            "channels": {name: obj.units.get(name, "") for name in obj.channels},
            "duration_s": obj.duration,
            "time_step_s": float(np.median(np.diff(obj.t))) if len(obj) > 1 else 0.0,
        }
    else:
        samples = [obj.z]
        shape = list(obj.z.shape)
        facts = {"pv": obj.peak_to_valley(), "sq": obj.rms(), "mean": float(np.nanmean(obj.z))}
        if isinstance(obj, Surface) or (obj.is_uniform and obj.lateral_unit == "m"):
            facts |= {"dx_m": obj.dx, "dy_m": obj.dy if isinstance(obj, Surface) else None}
    kind = type(obj).__name__.lower()
    return _listed(file, description.id, kind, shape, samples, obj.metadata, **facts)


def _listed(
    file: RawFile,
    format_id: str,
    kind: str,
    shape: list[int],
    samples: Iterable[FloatArray],
    metadata: Mapping[str, Any],
    *,
    pv: float = math.nan,
    sq: float = math.nan,
    mean: float = math.nan,
    dx_m: float | None = None,
    dy_m: float | None = None,
    **more: Any,
) -> dict[str, Any]:
    """Return what is known of any object, None for what it has not."""
    heights = {"pv_nm": pv, "sq_nm": sq, "mean_nm": mean}
    return {
        **more,
        "format": format_id,
        "kind": kind,
        "shape": shape,
        "dx_m": dx_m,
        "dy_m": dy_m,
        "n_invalid": sum(int(np.isnan(values).sum()) for values in samples),
        **{name: v * 1e9 if math.isfinite(v) else None for name, v in heights.items()},
        "sha256": file.sha256,
        "metadata": _plain(metadata),
    }


def _of_runs(file: RawFile, runs: RunSet) -> dict[str, Any]:
    z = np.concatenate([run.z for run in runs])
    return _listed(
        file,
        "metrosep-h5",
        "runs",
        [len(runs), int(z.size)],
        [z],
        {**runs.metadata, "feeds_m_s": runs.feeds},
        pv=float(np.nanmax(z) - np.nanmin(z)),
        sq=float(np.nanstd(z)),
        mean=float(np.nanmean(z)),
    )


def _of_table(file: RawFile, table: Table, format_id: str, reason: str) -> dict[str, Any]:
    columns = [
        {
            "name": c.name,
            "unit": None if c.unit is None else c.unit.name,
            "type": "label" if c.values is None else "number",
        }
        for c in table.columns
    ]
    header = {k: v for k, v in table.header.items() if k != "columns"}
    metadata = {
        "columns": columns,
        "warnings": table.warnings,
        "header": header,
        "lines": table.ledger,
    }
    numbers = [c.values for c in table.columns if c.values is not None]
    shape = [len(table), len(table.columns)]
    return _listed(file, format_id, "table", shape, numbers, metadata, reason=reason)


def _plain(value: Any) -> Any:
    """Return a value that strict JSON can carry: no NaN, no tuples, no numpy."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return str(value)
