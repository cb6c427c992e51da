"""The present result beside another one: values, what differs in the recipe, the difference."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from metrosep.app.evaluations import Evaluations
from metrosep.app.export_answers import full_result, made_of, result_of
from metrosep.app.opening import Opened
from metrosep.app.separations import MethodResults, Separations
from metrosep.app.sessions import Session
from metrosep.app.wire import (
    Answer,
    Arrays,
    Cancel,
    Message,
    Tell,
    number_or_none,
    plain,
    text_of,
)
from metrosep.core.errors import DataError, MetrosepError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.recipe.result import Result, load_document

if TYPE_CHECKING:
    from metrosep.app.pyramid import MapPyramid

_MOST = 6
"""Pinned results: each may hold a map of hundreds of megabytes."""
_LONGEST = 60
_NM, _MM = 1e-9, 1e-3


@dataclass(frozen=True, slots=True)
class _Side:
    """A result, with the map or profile that it left where there is one."""

    name: str
    document: Mapping[str, Any]
    obj: Surface | Profile | None = None


_PINS: WeakKeyDictionary[Session, dict[str, _Side]] = WeakKeyDictionary()
_LOCK = threading.Lock()


def compare(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``compare``."""
    session.need()
    if "pin" in message:
        _pin(session, text_of(message, "pin"), cancel, tell)
    elif "unpin" in message:
        _unpin(session, text_of(message, "unpin"))
    if "against" not in message:
        return {"pins": _pins(session)}, {}
    opened, document = session.need()
    recipe = document.recipe
    a = _other(session, opened, recipe, message["against"], cancel, tell)
    b = _side("present", result_of(opened, recipe, cancel, tell))
    if "picture" in message:
        return _picture(opened, a, b, message["picture"] or {})
    return _compared(session, a, b)


# ---- what is pinned --------------------------------------------------------------------------


def _pins(session: Session) -> list[str]:
    with _LOCK:
        return list(_PINS.get(session, {}))


def _pin(session: Session, label: str, cancel: Cancel, tell: Tell) -> None:
    label = label.strip()
    if not label or len(label) > _LONGEST or not label.isprintable():
        raise DataError(f"a label has 1 to {_LONGEST} characters, got {label[:80]!r}")
    if label in _pins(session):
        raise DataError(f"{label}: a result is pinned under this label; choose another label")
    if len(_pins(session)) >= _MOST:
        raise DataError(f"{_MOST} results are pinned, no more are kept; remove one first")
    side = _side(label, full_result(session, cancel, tell))
    with _LOCK:
        _PINS.setdefault(session, {})[label] = side


def _unpin(session: Session, label: str) -> None:
    with _LOCK:
        if _PINS.get(session, {}).pop(label, None) is None:
            raise DataError(f"{label}: no result is pinned under this label")


def _side(name: str, result: Result) -> _Side:
    obj = getattr(result.produced, "obj", None)
    return _Side(name, result.document, obj if isinstance(obj, Surface | Profile) else None)


_UNCHOSEN = (
    "nothing is chosen to compare with; choose a pinned result, a result.json or another file"
)


# ---- the other one ---------------------------------------------------------------------------


def _other(
    session: Session, opened: Opened, recipe: Any, against: Any, cancel: Cancel, tell: Tell
) -> _Side:
    if not isinstance(against, Mapping) or len(against) != 1:
        raise DataError(_UNCHOSEN)
    ((how, what),) = against.items()
    if how == "pin":
        with _LOCK:
            side = _PINS.get(session, {}).get(str(what))
        if side is None:
            known = ", ".join(_pins(session)) or "none"
            raise DataError(f"{what}: no result is pinned under this label; there are {known}")
        return side
    if how == "result":
        path = session.places.readable(text_of(against, "result"))
        return _Side(f"{path.parent.name}/{path.name}", load_document(path))
    if how != "files" or not isinstance(what, list) or not what:
        raise DataError(_UNCHOSEN)
    files = [session.places.readable(str(f)) for f in what]
    key = "\n".join(f"{f} {f.stat().st_mtime_ns} {f.stat().st_size}" for f in files)

    def make() -> _Side:
        return _evaluated(opened, recipe, files, cancel, tell)

    found: _Side = made_of(
        opened.material, "against", f"{key}\n{recipe.recorded['text']}", make, most=2
    )
    return found


def _evaluated(
    opened: Opened, recipe: Any, files: list[Path], cancel: Cancel, tell: Tell
) -> _Side:
    """Return what the present recipe makes of other files."""
    from dataclasses import replace

    if recipe.reads_nothing:
        raise DataError(
            "this recipe reads no file: change it and compare with what was pinned before"
        )
    name = files[0].name + (f" and {len(files) - 1} more" if len(files) > 1 else "")
    tell({"k": "progress", "words": f"reading {name}"})
    material: Evaluations | Separations | MethodResults
    if isinstance(opened.material, Evaluations):
        material = Evaluations(_read_like(opened, recipe, files))
    elif isinstance(opened.material, Separations):
        material = Separations(files)
    else:
        material = MethodResults(files)
    other = replace(opened, files=tuple(files), material=material)
    return _side(name, result_of(other, recipe, cancel, tell))


def _read_like(opened: Opened, recipe: Any, files: list[Path]) -> Surface | Profile:
    from metrosep.io.read import read_for_recipe as read
    from metrosep.recipe.schema import reading_options

    if len(files) > 1:
        raise DataError(f"this recipe measures one file at a time, got {len(files)}; name one")
    obj = read(files[0], **reading_options(recipe.input))
    kind = "map" if isinstance(obj, Surface) else "profile" if isinstance(obj, Profile) else "set"
    if not isinstance(obj, Surface | Profile) or kind != opened.kind:
        raise DataError(
            f"{files[0].name}: holds a {type(obj).__name__}, and this recipe works on a {opened.kind}"
        )
    return obj


# ---- side by side ----------------------------------------------------------------------------


def _compared(session: Session, a: _Side, b: _Side) -> Answer:
    from metrosep.report.compare import compare_documents

    found = compare_documents(a.document, b.document).to_dict()
    for row in found["rows"]:
        row["message"] = _called(row["message"], a, b)
    found["inputs"] = [_called(line, a, b) for line in found["inputs"]]
    shown, refused, arrays = _shown(a, b)
    header = {
        "pins": _pins(session),
        "names": [a.name, b.name],
        "verdicts": [a.document.get("verdict"), b.document.get("verdict")],
        **{k: v for k, v in found.items() if k not in ("schema", "kind")},
        "shown": shown,
        "maps": isinstance(a.obj, Surface) and isinstance(b.obj, Surface),
        "refused": refused,
    }
    return plain(header), arrays


def _called(words: str, a: _Side, b: _Side) -> str:
    """Return words about A or B with their names."""
    for letter, side in (("A", a), ("B", b)):
        words = words.replace(f" in {letter}:", f" in {side.name}:")
        if words.endswith(f" in {letter}"):
            words = words[:-1] + side.name
    return words


def _shown(a: _Side, b: _Side) -> tuple[str | None, str, Arrays]:
    """Return which picture the two have, why there is none, and the curves."""
    if isinstance(b.obj, Surface):
        if a.obj is None:
            return None, f"{a.name}: {_NO_SAMPLES}", {}
        try:
            difference_of(a.obj, b.obj)
        except MetrosepError as exc:
            return None, str(exc), {}
        return "map", "", {}
    if isinstance(b.obj, Profile):
        if a.obj is None:
            return None, f"{a.name}: {_NO_SAMPLES}", {}
        if not isinstance(a.obj, Profile):
            return None, _words(a.obj, b.obj), {}
        arrays = _lines("a", a.obj) | _lines("b", b.obj)
        reason = _words(a.obj, b.obj)
        if not reason:
            difference = difference_of(a.obj, b.obj)
            if isinstance(difference, Profile):
                arrays |= _lines("difference", difference)
        return "curves", reason, arrays
    curves = [_curves(side.document) for side in (a, b)]
    if not all(curves):
        return None, "" if not any(curves) else "only one of them holds curves", {}
    return _overlaid(*curves)


_NO_SAMPLES = (
    "a stored result holds no samples at full resolution, so there is no difference to show; compare "
    "with its file by the same recipe"
)


def _words(a: Surface | Profile, b: Surface | Profile) -> str:
    try:
        difference_of(a, b)
    except MetrosepError as exc:
        return str(exc)
    return ""


_COLUMNS = 2000


def _lines(name: str, profile: Profile) -> Arrays:
    from metrosep.app.view_tables import Extremes, profile_view

    view = profile_view(Extremes(profile), columns=_COLUMNS)
    return {f"{name}_x": view.x, f"{name}_low": view.low, f"{name}_high": view.high}


def _curves(document: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the separated curves of a document by direction: positions and values in m."""
    plots = document.get("plots") or {}
    if not plots.get("x_mm"):
        return {}
    x = np.asarray(plots["x_mm"], dtype=np.float64) * _MM
    lines = plots.get("directions") or [{"direction": "both", **plots}]
    return {
        str(line.get("direction")): (
            x,
            np.array([np.nan if v is None else v * _NM for v in line["estimate_nm"]]),
        )
        for line in lines
    }


def _overlaid(a: Any, b: Any) -> tuple[str | None, str, Arrays]:
    arrays: Arrays = {}
    reason = ""
    common = [d for d in b if d in a]
    if not common:
        return None, f"directions {', '.join(a)} and {', '.join(b)} have nothing in common", {}
    for direction in common:
        tail = "" if len(common) == 1 else f" {direction}"
        (xa, za), (xb, zb) = a[direction], b[direction]
        for name, x, z in (("a", xa, za), ("b", xb, zb)):
            arrays |= {f"{name}_x{tail}": x, f"{name}_low{tail}": z, f"{name}_high{tail}": z}
        if xa.shape == xb.shape and bool((xa == xb).all()):
            left = zb - za
            arrays |= {
                f"difference_x{tail}": xb,
                f"difference_low{tail}": left,
                f"difference_high{tail}": left,
            }
        else:
            reason = "the positions differ, so nothing is subtracted"
    return "curves", reason, arrays


def _picture(opened: Opened, a: _Side, b: _Side, wanted: Mapping[str, Any]) -> Answer:
    """Return the difference map in a window, with its own P-V and RMS; or one of both maps."""
    from metrosep.app.pyramid import build_pyramid

    if wanted.get("of") in ("a", "b"):
        return _side_by_side(opened, a, b, wanted)
    key = f"{id(a.document)} {id(b.document)}"

    def make() -> tuple[Any, Any, dict[str, Any]]:
        left = difference_of(a.obj, b.obj)
        if not isinstance(left, Surface):
            raise DataError("profiles have no difference map; they are drawn as curves")
        known = left.z[~np.isnan(left.z)]
        numbers = {
            "pv": float(np.ptp(known)),
            "rms": float(np.sqrt(np.mean((known - known.mean()) ** 2))),
            "mean": float(known.mean()),
            "share_valid": known.size / left.z.size,
        }
        level = Surface(left.z - known.mean(), left.dx, left.dy, origin=left.origin)
        # both documents are kept with it: their identity stays their own
        return build_pyramid(level), (a.document, b.document), numbers

    pyramid, _, numbers = made_of(opened.material, "difference", key, make, most=1)
    # the ends of the colours lie as far below the mean as above
    most = max(map(abs, pyramid.robust_range or (0.0, 0.0)))
    header, arrays = _window_of(
        pyramid, wanted, wanted.get("range") or ((-most, most) if most > 0.0 else None)
    )
    return header | {k: number_or_none(v) for k, v in numbers.items()}, arrays


def _window_of(pyramid: MapPyramid, wanted: Mapping[str, Any], limits: Any) -> Answer:
    """Return a map in the window that is asked for, at full resolution."""
    from metrosep.app.map_views import map_view

    view = map_view(
        pyramid,
        window=wanted.get("window"),
        pixels=wanted.get("pixels") or (512, 512),
        level="full",
        limits=limits,
    )
    return {
        "range": view.range,
        "window": view.window,
        "scale": view.scale,
        "unit": view.unit,
        "extent": pyramid.window,
    }, {"index": view.index}


def _side_by_side(opened: Opened, a: _Side, b: _Side, wanted: Mapping[str, Any]) -> Answer:
    """Return one of two maps in a window, in colours that both share."""
    from metrosep.app.pyramid import build_pyramid

    def pyramid_of(side: _Side, letter: str) -> MapPyramid:
        if not isinstance(side.obj, Surface):
            raise DataError("only maps stand side by side; profiles are drawn as curves")
        obj = side.obj
        made, _ = made_of(
            opened.material,
            f"map {letter}",
            str(id(obj)),
            lambda: (build_pyramid(obj), obj),
            most=1,
        )
        return made  # type: ignore[no-any-return]

    both = [pyramid_of(a, "a"), pyramid_of(b, "b")]
    ranges = [p.robust_range for p in both if p.robust_range is not None]
    shared = (min(r[0] for r in ranges), max(r[1] for r in ranges)) if ranges else None
    limits = shared if shared and shared[0] < shared[1] else None
    return _window_of(both[wanted["of"] == "b"], wanted, wanted.get("range") or limits)


# ---- differences of two measurements that lie on the same grid; nothing is interpolated --------

_SAME = 1e-6
"""Of a step: positions nearer than this are the same."""


def difference_of(a: Any, b: Any) -> Surface | Profile:
    """Return b minus a, sample by sample.

    Examples
    --------
    >>> difference_of(Surface([[1.0, 5.0]], 1.0, 1.0), Surface([[3.0, 5.0]], 1.0, 1.0)).z.tolist()
    [[2.0, 0.0]]
    """
    kinds = [type(v).__name__ for v in (a, b)]
    if kinds[0] != kinds[1] or not isinstance(a, Surface | Profile):
        raise DataError(
            f"one is a {kinds[0]} and the other a {kinds[1]}: they have no difference; take two maps "
            "or two profiles"
        )
    reason = grid_words(a, b)
    if reason:
        raise DataError(
            f"the grids differ, so nothing is subtracted: {reason}; measure on the same grid, or "
            "compare the numbers only"
        )
    z = b.z - a.z
    if np.isnan(z).all():
        raise TooFewSamplesError("no sample is measured in both: there is no difference to show")
    if isinstance(a, Surface):
        return Surface(z, b.dx, b.dy, origin=b.origin)
    return Profile(b.x, z)


def grid_words(a: Any, b: Any) -> str:
    """Return what differs between the grids of two measurements of one kind."""
    if a.z.shape != b.z.shape:
        sizes = (" x ".join(map(str, v.z.shape[::-1])) for v in (a, b))
        return "{} and {} samples".format(*sizes)
    if isinstance(a, Profile):
        apart = float(np.abs(b.x - a.x).max())
        step = float(np.abs(np.diff(a.x)).min()) if a.x.size > 1 else 1.0
        return "" if apart <= _SAME * step else f"positions up to {format_length(apart)} apart"
    for name, n in (("dx", a.z.shape[1]), ("dy", a.z.shape[0])):
        one, two = getattr(a, name), getattr(b, name)
        if (one is None) != (two is None):
            return f"{name} is known of one map only"
        if one is not None and abs(two - one) * n > _SAME * n * one:
            return f"{name} is {format_length(one)} and {format_length(two)}"
    for axis, step in ((0, a.dx), (1, a.dy)):
        apart = abs(b.origin[axis] - a.origin[axis])
        if apart > _SAME * (1.0 if step is None else step) * max(a.z.shape):
            return f"the {'xy'[axis]} of their first pixels is {format_length(apart)} apart"
    return ""
