"""The result document: everything a report, a table or another program needs, as JSON.

Schema ``metrosep.result/1``: keys sorted, SI with unit suffixes in the keys, no NaN (null instead),
no clock and no folder in it, so that the same input gives the same bytes.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.atomic import atomic_write, read_plain
from metrosep.core.errors import CorruptFileError, DataError, FileMissingError, ReadError
from metrosep.core.provenance import Step
from metrosep.core.public import PublicObject, shortened
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import Pixels

if TYPE_CHECKING:
    from metrosep.separation.runs.base import ErrorEstimate


SCHEMA = "metrosep.result/1"
POSITIONING = "iso230_2"
"""The method whose cycles are the errors of an axis along itself."""
_MM, _NM = 1e-3, 1e-9
_CURVE_POINTS = 601
_MAX_POINTS = 2000
_CELLS = 2001
"""Of a stored run: as many as the positions at which a dry-run compares."""
_MOST_BYTES = 2**30


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Result(PublicObject):
    """What a recipe produced.

    Parameters
    ----------
    document : mapping
        Content of result.json.
    produced : ErrorEstimate, Separation or what else the method returns
        The result as an object.
    files : tuple of Path
        Files that were written, result.json last.
    """

    document: Mapping[str, Any]
    produced: Any
    files: tuple[Path, ...] = field(default=())

    @property
    def estimate(self) -> ErrorEstimate:
        """The separated error of repeated runs.

        Raises
        ------
        DataError
            If the recipe separated something else; that is in `produced`.
        """
        from metrosep.separation.runs.base import ErrorEstimate

        if isinstance(self.produced, ErrorEstimate):
            return self.produced
        raise DataError(
            f"this result is a {type(self.produced).__name__}, not the error of an axis over "
            "repeated runs; take .produced"
        )

    @property
    def verdict(self) -> str | None:
        """Verdict over all checks; None without checks."""
        return self.document["verdict"]  # type: ignore[no-any-return]

    def __repr__(self) -> str:
        found = self.document.get("characteristics") or []
        verdict = self.document.get("verdict")
        return shortened(
            f"Result({type(self.produced).__name__}, {len(found)} "
            f"characteristic{'' if len(found) == 1 else 's'}, "
            f"{'nothing judged' if verdict is None else f'verdict {verdict}'}, "
            f"{len(self.files)} file{'' if len(self.files) == 1 else 's'})"
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Save the result: as its document where the name ends in ``.json``, else with every bit.

        Parameters
        ----------
        path : str or path
            ``result.json``, or an HDF5 file.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        DataError
            If `produced` holds something that cannot be saved.
        WriteError
            If the file cannot be written.
        """
        if os.fspath(path).lower().endswith(".json"):
            return self.write(path)
        return PublicObject.save(self, path)

    def to_json(self) -> bytes:
        """Return the document as bytes.

        Returns
        -------
        bytes
            UTF-8, sorted keys, no spaces, no NaN: the same bytes at every door.
        """
        text = document_text(clean(self.document))
        return (text + "\n").encode("utf-8")

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the document; it appears whole or not at all.

        Parameters
        ----------
        path : str or path
            File.

        Returns
        -------
        Path
            The file.
        """
        return atomic_write(path, self.to_json())


_AS_THEY_ARE = {float, int, bool, str, type(None)}
"""Kinds that JSON knows; of them only a float may be no number."""


def clean(value: Any) -> Any:
    """Return a value as JSON knows it: NaN and infinities become None, tuples lists, px texts."""
    if isinstance(value, dict | Mapping):
        return {str(k): clean(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        # most of a document are long lists of numbers; a finite sum holds neither NaN nor infinity
        kinds = set(map(type, value))
        if kinds == {float} and math.isfinite(sum(value)):
            return list(value)
        if kinds <= _AS_THEY_ARE:
            return [None if type(v) is float and not math.isfinite(v) else v for v in value]
        return [clean(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Pixels):
        return str(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return value.name
    return value


def load_document(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the content of a result.json."""
    target = Path(path)
    if target.is_dir():
        target = target / "result.json"
    try:
        content = json.loads(read_plain(target, _MOST_BYTES).decode("utf-8"))
    except FileNotFoundError:
        raise FileMissingError(f"{target}: no such file; check the name", str(target)) from None
    except OSError as exc:
        raise ReadError(
            f"{target}: cannot be read ({exc.strerror or exc}); check the name"
        ) from None
    except ValueError as exc:
        raise CorruptFileError(
            target, f"not JSON ({exc})", hint="run the separation again"
        ) from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        found = content.get("schema") if isinstance(content, dict) else type(content).__name__
        raise CorruptFileError(
            target,
            "not a result of metrosep",
            field="schema",
            expected=SCHEMA,
            found=found,
            hint="give the result.json that 'metrosep separate' or 'metrosep run' wrote",
        )
    return content


def plot_data(runs: RunSet, estimate: ErrorEstimate) -> dict[str, Any]:
    """Return the curves that a report draws."""
    low, high = estimate.fit_range
    x = np.linspace(low, high, _CURVE_POINTS)
    names = {1: "forward", -1: "reverse", 0: "both"}
    return {
        "start_mm": estimate.start / _MM,
        "stop_mm": estimate.stop / _MM,
        "fit_low_mm": low / _MM,
        "fit_high_mm": high / _MM,
        "x_mm": (x / _MM).tolist(),
        "estimate_nm": (estimate.evaluate(x) / _NM).tolist(),
        "sd_nm": (estimate.sd(x) / _NM).tolist(),
        "directions": [
            {
                "direction": names[d],
                "estimate_nm": (estimate.evaluate(x, direction=d or None) / _NM).tolist(),
                "sd_nm": (estimate.sd(x, direction=d or None) / _NM).tolist(),
            }
            for d in estimate.directions
        ],
        "feeds": _feeds(runs, estimate),
    }


def _feeds(runs: RunSet, estimate: ErrorEstimate) -> list[dict[str, Any]]:
    from metrosep.separation.runs.design import mean_runs

    entries = []
    for mean in mean_runs(runs, estimate):
        xs, pair = _thinned(mean.x, np.stack([mean.before, mean.after]))
        entries.append(
            {
                "feed_mm_min": math.nan if mean.feed is None else mean.feed * 6e4,
                "direction": "forward" if mean.direction > 0 else "reverse",
                "n_runs": mean.n_runs,
                "x_mm": (xs / _MM).tolist(),
                "before_nm": (pair[0] / _NM).tolist(),
                "after_nm": (pair[1] / _NM).tolist(),
            }
        )
    return entries


def _thinned(x: FloatArray, curves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Keep the smallest and largest sample of the first curve in each cell: nothing is hidden."""
    if x.size <= _MAX_POINTS:
        return x, curves
    keep: set[int] = set()
    for cell in np.array_split(np.arange(x.size), _MAX_POINTS // 2):
        for curve in curves:
            if np.isnan(curve[cell]).all():
                keep.add(int(cell[0]))
                continue
            keep.update(
                (int(cell[np.nanargmin(curve[cell])]), int(cell[np.nanargmax(curve[cell])]))
            )
    index = np.array(sorted(keep))
    return x[index], curves[:, index]


def run_records(runs: RunSet) -> list[dict[str, Any]]:
    """Return runs as a result stores them: as they were measured, not levelled, in full digits."""
    unit = runs.metadata.get("unit", "m")
    return [_run_record(r, unit, runs.metadata.get("z_unit", unit)) for r in runs]


def _run_record(run: Run, unit: str, z_unit: str) -> dict[str, Any]:
    x, z, counts = run.x, run.z, None
    if x.size > _CELLS:
        x, z, counts = _cell_means(run)
    return {
        "id": run.run_id,
        "direction": "forward" if run.direction > 0 else "reverse",
        "feed_mm_min": None if run.feed is None else run.feed * 6e4,
        f"x_{unit}": x.tolist(),
        f"z_{z_unit}": z.tolist(),
        **({} if run.t is None or counts is not None else {"t_s": run.t.tolist()}),
        **({} if counts is None else {"n": counts.tolist(), "sha256": run.sha256}),
    }


def _cell_means(run: Run) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Return mean position, mean reading and count of each cell that holds a sample.

    Where some readings of a cell are missing, position and reading are those of the others.
    """
    share = (run.x - run.x[0]) / (run.x[-1] - run.x[0])
    cell = np.minimum((share * _CELLS).astype(np.int64), _CELLS - 1)
    if np.unique(cell).size < 3:  # nearly all samples at one place: cells of equal count instead
        cell = np.arange(run.x.size) * _CELLS // run.x.size
    known = ~np.isnan(run.z)
    n_all, n = (np.bincount(cell, weights=w, minlength=_CELLS) for w in (None, known))
    x_all = np.bincount(cell, weights=run.x, minlength=_CELLS)
    x = np.bincount(cell, weights=np.where(known, run.x, 0.0), minlength=_CELLS)
    z = np.bincount(cell, weights=np.where(known, run.z, 0.0), minlength=_CELLS)
    with np.errstate(invalid="ignore"):
        means = np.where(n > 0, x / n, x_all / n_all), np.where(n > 0, z / n, np.nan)
    there = n_all > 0
    return means[0][there], means[1][there], n.astype(np.int64)[there]


def is_positioning(document: Mapping[str, Any]) -> bool:
    """Return whether a result holds the cycles of a positioning test, of which a table can be made."""
    return (document.get("separation") or {}).get("op") in (POSITIONING, "runs_over_angle")


def measured_runs(document: Mapping[str, Any]) -> RunSet:
    """Return the runs of a result as they were measured, to dry-run a table against."""
    if not document.get("runs"):
        raise CorruptFileError(
            "result.json",
            "it does not hold the runs as they were measured, which a dry-run needs",
            field="runs",
            hint="run the separation again with this version",
        )
    try:
        steps = document["provenance"] if is_positioning(document) else ()
        history = [Step(s["step"], s["parameters"], s["version"]) for s in steps]
        unit = "rad" if "x_rad" in document["runs"][0] else "m"  # of an axis that turns
        z_unit = "rad" if "z_rad" in document["runs"][0] else "m"
        runs = [_stored_run(entry, unit, z_unit) for entry in document["runs"]]
        known = {"unit": unit, "z_unit": z_unit}
        known |= {"no_folds": str(document["no_folds"])} if "no_folds" in document else {}
        return RunSet(runs, metadata=known, history=tuple(history))
    except (AttributeError, KeyError, TypeError, ValueError, DataError) as exc:
        raise _damaged("runs", exc) from None


def stored_estimate(document: Mapping[str, Any]) -> ErrorEstimate:
    """Return the separated error of a result."""
    other = document.get("separation") if document.get("estimate") is None else None
    if isinstance(other, Mapping) and not other.get("covariance"):
        raise DataError(
            f"this is a result of {other.get('op')}; the error of an axis comes from 'separate' "
            "(joint, kono or mean), or from a reversal of two such results"
        )
    if isinstance(other, Mapping):
        from metrosep.separation.contract import Separation
        from metrosep.separation.lines.reversals import slide_error

        return slide_error(Separation.from_dict(other))
    from metrosep.separation.runs.base import ErrorEstimate

    try:
        return ErrorEstimate.from_dict(document["estimate"])
    except (AttributeError, KeyError, TypeError, ValueError, DataError) as exc:
        raise _damaged("estimate", exc) from None


def _stored_run(entry: Mapping[str, Any], unit: str, z_unit: str) -> Run:
    z = [math.nan if v is None else v for v in entry[f"z_{z_unit}"]]
    feed = entry["feed_mm_min"]
    run = Run(
        entry[f"x_{unit}"],
        z,
        t=entry.get("t_s"),
        feed=None if feed is None else feed / 6e4,
        run_id=str(entry["id"]),
        # means of cells of a run that made the estimate are known by what they are means of
        metadata={"cells_of_sha256": entry["sha256"]} if "sha256" in entry else None,
    )
    if entry["direction"] != ("forward" if run.direction > 0 else "reverse"):
        raise ValueError(f"run {run.run_id!r} is {entry['direction']}, its positions are not")
    return run


def _damaged(field: str, cause: Exception) -> CorruptFileError:
    return CorruptFileError(
        "result.json",
        f"a part of it is missing or damaged ({type(cause).__name__}: {cause})",
        field=field,
        hint="run the separation again",
    )


def versions() -> dict[str, str]:
    """Return the versions that a result depends on."""
    import numpy as np
    import scipy

    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


# ---- a document as JSON text: the bytes of `json.dumps`, but long lists of numbers in a third of the time ----
# Most of a result are maps for the pictures, rounded to four digits. There are few such numbers, so
# their texts are kept in tables, one for each decade.

_SHORTEST = 256
"""Numbers of a list from which the tables pay."""

_DIGITS = 4
_FULL = 10**_DIGITS
_DECIMALS = 22
"""10 to this power is a float without error, and so is a whole number of four digits: their quotient is
the float nearest to the decimal number, which is what its text reads back to."""

_POWERS = np.array([float(f"1e{k}") for k in range(_DECIMALS + 1)])
_MARK = "\0numbers {}\0"
_FOUND = re.compile(r'"\\u0000numbers (\d+)\\u0000"')
_PLAIN = ({float}, {float, type(None)})
_SCALARS = frozenset({float, int, str, bool, type(None)})


def document_text(document: Mapping[str, Any]) -> str:
    """Return a document as JSON with sorted keys, without spaces: half the size, several times as fast.

    Examples
    --------
    >>> document_text({"b": [1.5, None], "a": 2})
    '{"a":2,"b":[1.5,null]}'
    """
    lists: list[str] = []
    swapped = _swapped(document, lists)
    text = _dumps(swapped)
    if not lists:
        return text
    parts = _FOUND.split(text)
    marks = [int(k) for k in parts[1::2]]
    if sorted(marks) != list(range(len(lists))):  # a text of the document looks like a mark
        return _dumps(document)
    parts[1::2] = [lists[k] for k in marks]
    return "".join(parts)


def _dumps(value: Any) -> str:
    return json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"))


def _swapped(value: Any, lists: list[str]) -> Any:
    """Return a value with marks in place of long lists of numbers, whose texts go to `lists`."""
    if isinstance(value, dict | Mapping):
        return {k: _swapped(v, lists) for k, v in value.items()}
    if not isinstance(value, list | tuple):
        return value
    if len(value) >= _SHORTEST and set(map(type, value)) in _PLAIN:
        lists.append(_joined(_texts(value)))
    elif _is_table(value):
        n = len(value[0])
        texts = _texts(list(chain.from_iterable(value)))
        lists.append(_joined(_joined(texts[i : i + n]) for i in range(0, len(texts), n)))
    else:
        return [v if type(v) in _SCALARS else _swapped(v, lists) for v in value]
    return _MARK.format(len(lists) - 1)


def _is_table(value: list[Any] | tuple[Any, ...]) -> bool:
    """Return whether a value is rows of equal length with numbers and None only, and many of them."""
    if not value or set(map(type, value)) != {list}:
        return False
    n = len(value[0])
    if n * len(value) < _SHORTEST or set(map(len, value)) != {n}:
        return False
    return set(map(type, chain.from_iterable(value))) in _PLAIN


def _joined(texts: Iterable[str]) -> str:
    return f"[{','.join(texts)}]"


def _texts(values: list[float | None] | tuple[float | None, ...]) -> list[str]:
    """Return the JSON text of each number: from a table where it has four digits."""
    array = np.array(values, dtype=np.float64)  # None becomes NaN
    size = np.abs(array)
    with np.errstate(divide="ignore", invalid="ignore"):
        decimals = _DIGITS - 1 - np.floor(np.log10(size))
        usual = (decimals >= 0) & (decimals <= _DECIMALS)
        power = _POWERS[np.where(usual, decimals, 0).astype(np.intp)]
        digits = np.rint(size * power)
        usual &= (digits < _FULL) & (digits / power == size)
    digits += np.where(array < 0, _FULL, 0)
    texts = np.empty(array.size, dtype=object)
    left = np.ones(array.size, dtype=np.bool_)
    whole = np.where(usual, decimals, -1).astype(np.int8)
    for k in np.flatnonzero(np.bincount(whole + 1, minlength=1)[1:] >= _FULL // 10):
        these = np.flatnonzero(whole == k)
        texts[these] = _table(int(k))[digits[these].astype(np.intp)]
        left[these] = False
    for i in np.flatnonzero(left).tolist():
        texts[i] = _text(values[i])
    return texts.tolist()


def _text(value: float | None) -> str:
    if value is None:
        return "null"
    if value - value != 0.0:
        raise ValueError(f"Out of range float values are not JSON compliant: {value!r}")
    return float.__repr__(value)


@lru_cache(maxsize=16)
def _table(decimals: int) -> NDArray[np.object_]:
    """Return the texts of four digits at so many decimals; the negative ones follow."""
    known = [float.__repr__(v) for v in (np.arange(_FULL) / _POWERS[decimals]).tolist()]
    return np.array(known + [f"-{text}" for text in known], dtype=object)
