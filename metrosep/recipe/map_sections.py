"""Tables ``[[section]]``: lines, circles, distances and angles on the map that is judged, as numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.options import Option
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.regions import in_pixels, needs_scale, not_round
from metrosep.core.sections import (
    angle_at,
    circle_section,
    circle_through,
    distance,
    extremes_in,
    harmonics,
    height_at,
    is_calibrated,
    section_profile,
)
from metrosep.core.surface import Surface
from metrosep.core.units import PIXEL, Pixels, format_length
from metrosep.recipe.pipeline import lost_pixels
from metrosep.recipe.schema import Place

MOST_SECTIONS = 64
"""Of a recipe; each is read anew from the whole map."""

_FEW = 0.01
"""Of the pixels of a step or groove that may be missing in a verdict: its height is a mean over all of them."""

_POINT = 'x and y, "1.2 mm, 0.3 mm"'
_DEGREE = Option(
    "integer", choices=(1, 2), default=1, help="of the faces: 2 where they are bowed from a to b"
)
_OWN: Mapping[str, Mapping[str, Option]] = {
    "line": {
        "a": Option("point", required=True, help=f"where it begins: {_POINT}"),
        "b": Option("point", required=True, help="where it ends"),
        "width": Option(
            "extent", help="mean of parallel lines across this band; one line if omitted"
        ),
    },
    "circle": {
        "centre": Option("point", required=True, help=_POINT),
        "radius": Option("extent", required=True, help="of the circle"),
        "harmonics": Option(
            "integers", help="orders whose amplitudes are numbers too, such as [1, 2, 3]"
        ),
    },
    "distance": {
        "a": Option("point", required=True, help=f"from here: {_POINT}"),
        "b": Option("point", required=True, help="to here"),
    },
    "angle": {
        "a": Option("point", required=True, help=f"on the first leg: {_POINT}"),
        "b": Option("point", required=True, help="corner of the angle"),
        "c": Option("point", required=True, help="on the second leg"),
    },
    "circle3": {
        "a": Option("point", required=True, help=f"on the circle: {_POINT}"),
        "b": Option("point", required=True, help="on the circle"),
        "c": Option("point", required=True, help="on the circle"),
    },
    "step": {
        "a": Option("point", required=True, help=f"on the first face: {_POINT}"),
        "b": Option("point", required=True, help="on the second face; the edge between them"),
        "width": Option("extent", required=True, help="of the band, along the edge"),
        "degree": _DEGREE,
    },
    "groove": {
        "a": Option("point", required=True, help=f"at one edge of the groove or ridge: {_POINT}"),
        "b": Option("point", required=True, help="at its other edge"),
        "width": Option("extent", required=True, help="of the band, along the groove"),
        "bottom": Option(
            "text", choices=("flat", "round"), default="flat", help="types A1 and A2 of ISO 5436-1"
        ),
        "degree": _DEGREE,
    },
    "extremes": {
        "centre": Option("point", required=True, help=f"of the circle that is searched: {_POINT}"),
        "radius": Option("extent", required=True, help="of the circle that is searched"),
    },
}

SECTIONS: Mapping[str, Mapping[str, Option]] = {
    kind: {
        "kind": Option("text", required=True, choices=tuple(_OWN), help="what is drawn"),
        "name": Option("text", required=True, help="its numbers are section.NAME.Pt and the like"),
        **own,
    }
    for kind, own in _OWN.items()
}
"""Keys of a section, by its kind."""

_METRICS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "line": {
        "Pt": ("m", "P-V of the heights along the line"),
        "Pq": ("m", "RMS of the heights along the line about their mean"),
    },
    "circle": {
        "Pt": ("m", "P-V of the heights along the circle"),
        "Pq": ("m", "RMS of the heights along the circle about their mean"),
    },
    "distance": {
        "lateral": ("m", "distance of b from a in the plane of the map"),
        "distance": ("m", "distance of b from a in space"),
        "height": ("m", "height of b over a"),
        "azimuth": ("rad", "direction of b seen from a, from x to y"),
        "slope": ("rad", "slope from a to b, positive where b is higher"),
    },
    "angle": {"angle": ("rad", "angle at b between a and c")},
    "circle3": {
        "diameter": ("m", "diameter of the circle through a, b and c"),
        "x": ("m", "x of the centre of the circle through a, b and c"),
        "y": ("m", "y of the centre of the circle through a, b and c"),
    },
    "step": {
        "h": ("m", "height of the face at b over the face at a"),
        "d": ("m", "height of the step, without its sign"),
    },
    "groove": {
        "h": ("m", "height of the middle over the faces beside it, negative for a groove"),
        "d": ("m", "depth of the groove or height of the ridge"),
    },
    "extremes": {
        "Pt": ("m", "height of the peak over the valley"),
        "peak": ("m", "height of the highest pixel in the circle"),
        "valley": ("m", "height of the lowest pixel in the circle"),
        "peak_x": ("m", "x of the peak"),
        "peak_y": ("m", "y of the peak"),
        "valley_x": ("m", "x of the valley"),
        "valley_y": ("m", "y of the valley"),
    },
}
_LATERAL = ("lateral", "diameter", "x", "y", "peak_x", "peak_y", "valley_x", "valley_y")
"""Numbers in the plane of the map: of a section that is drawn in px, in px."""
_SPATIAL = ("distance", "slope")
"""Numbers of height and plane together, which a section in px has not."""
_SLANTING = ("circle", "circle3", "extremes", "angle")
"""Kinds that hold for square pixels only; so does a distance that lies askew."""
_FITS = ("step", "groove")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


@dataclass(frozen=True, slots=True)
class MapSection:
    """What one section of a recipe gave."""

    name: str
    kind: str
    found: Mapping[str, Quantity]  # by metric, ``section.NAME.Pt``
    messages: tuple[str, ...] = ()
    profile: Profile | None = None  # heights along a line or a circle
    keys: Mapping[str, Any] = field(default_factory=dict)  # of the recipe, in SI
    missing: str = ""  # why no check of these numbers can pass or fail

    @property
    def unsure(self) -> dict[str, str]:
        """By metric, why it cannot be judged; what follows from the points alone can."""
        lost = (
            self.found
            if self.kind != "distance"
            else {k: q for k, q in self.found.items() if np.isnan(q.value)}
        )
        return dict.fromkeys(lost, self.missing) if self.missing else {}


def section_metrics(section: Mapping[str, Any]) -> dict[str, str]:
    """Return the metrics that a section makes, with their SI units.

    Examples
    --------
    >>> section_metrics({"kind": "circle", "name": "rim", "harmonics": (2,)})
    {'section.rim.Pt': 'm', 'section.rim.Pq': 'm', 'section.rim.harmonic_2': 'm'}
    """
    units = {k: unit for k, (unit, _) in _METRICS[section["kind"]].items()}
    if _counts_pixels(section):
        units = {
            k: PIXEL if k in _LATERAL else unit for k, unit in units.items() if k not in _SPATIAL
        }
    units |= {f"harmonic_{n}": "m" for n in section.get("harmonics", ())}
    return {f"section.{section['name']}.{k}": unit for k, unit in units.items()}


def _counts_pixels(section: Mapping[str, Any]) -> bool:
    """Return whether a section is drawn in px."""
    drawn = (section.get(k) for k in ("a", "b", "c", "centre", "radius", "width"))
    return in_pixels(f"section {section['name']}", *drawn)


def check_sections(
    sections: Sequence[Mapping[str, Any]], place_of: Any, *, measures: bool
) -> None:
    """Refuse sections of a recipe without a map, equal names, and points that are not a section."""
    if len(sections) > MOST_SECTIONS:
        raise place_of(MOST_SECTIONS).error(
            f"a recipe has {MOST_SECTIONS} sections at most", "kind"
        )
    names: set[str] = set()
    for i, section in enumerate(sections):
        place: Place = place_of(i)
        if not measures:
            raise place.error("a section goes with steps that measure a map", "kind")
        name = section["name"]
        if not _NAME.fullmatch(name):
            raise place.error(
                f'name = "{name}": begin with a letter, then letters, digits, _ and -; it is part of '
                "the names of its numbers",
                "name",
            )
        if name in names:
            raise place.error(f'two sections are called "{name}"; give another name', "name")
        names.add(name)
        orders = section.get("harmonics", ())
        if len(set(orders)) < len(orders) or any(n < 1 for n in orders):
            raise place.error("harmonics are different whole numbers from 1", "harmonics")
        try:
            _counts_pixels(section)
            _of_points(section)
        except DataError as exc:
            raise place.error(str(exc), "b") from None
        if section["kind"] in ("line", *_FITS) and section["a"] == section["b"]:
            raise place.error("a and b are the same point: the section has no length", "b")


def section_of(
    obj: Any, section: Mapping[str, Any], *, behind: Sequence[Mapping[str, Any]] = ()
) -> MapSection:
    """Return the numbers of one section of the map that the steps `behind` it left."""
    name = section["name"]
    lost = lost_pixels(behind, section)
    if lost:
        raise DataError(lost)
    if not isinstance(obj, Surface):
        raise DataError(f'section "{name}" is cut through a map, and this is a profile')
    pixels = _counts_pixels(section)
    if not pixels and not is_calibrated(obj):
        key = next(k for k in ("centre", "a") if k in section)
        raise needs_scale(f'section "{name}"', f'{key} = "120 px, 30 px"')
    found = _section_of(obj, section)
    return (
        replace(found, messages=(*found.messages, *_pixel_notes(obj, section)))
        if pixels
        else found
    )


def _pixel_notes(obj: Surface, section: Mapping[str, Any]) -> list[str]:
    """Return what a reader of a section in px has to know of the pixels."""
    kind, name = section["kind"], section["name"]
    sides = [abs(p - q) for p, q in zip(section.get("a", ()), section.get("b", ()), strict=False)]
    askew = kind in _SLANTING or (kind == "distance" and all(sides))
    said = [not_round(obj, f"section {name}")] if askew else []
    if kind == "distance" and obj.dx is not None and obj.dy is not None:
        length = math.hypot(sides[0] * obj.dx, sides[1] * obj.dy)
        said.append(
            f"section {name}: {format_length(Pixels(math.hypot(*sides)))} are {format_length(length)} on this map"
        )
    return [m for m in said if m]


def _section_of(obj: Surface, section: Mapping[str, Any]) -> MapSection:
    """Return the numbers of a section that lies in the map."""
    name, kind = section["name"], section["kind"]
    values, profile = _of_points(section), None
    messages: tuple[str, ...] = ()
    missing = ""
    if kind == "distance":
        values, missing = _distance_on(obj, section)
    elif kind in _FITS:
        return _fitted(obj, section)
    elif kind == "extremes":
        values, missing = _extremes_in(obj, section)
    elif kind in ("line", "circle"):
        profile = heights_along(obj, section)
        assert profile is not None  # noqa: S101
        values, messages = _of_profile(profile, section)
        missing = _missing(name, profile)
    if missing and profile is None:
        messages = (missing,)
    return MapSection(
        name,
        kind,
        _quantities(section, values),
        messages,
        profile,
        section,
        missing=missing,
    )


def _quantities(section: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Quantity]:
    """Return values with their units and definitions."""
    units, words = section_metrics(section), _METRICS[section["kind"]]
    found = {}
    for key, value in values.items():
        metric = f"section.{section['name']}.{key}"
        if metric not in units:  # of a section in px
            continue
        what = words[key][1] if key in words else f"amplitude of harmonic {key.split('_')[1]}"
        found[metric] = Quantity(
            value, units[metric], f"{what}, section {section['name']}", symbol=metric
        )
    return found


def _fitted(obj: Surface, section: Mapping[str, Any]) -> MapSection:
    """Return the height of a step or groove with the u of its fit; NaN where its faces were not measured."""
    from metrosep.parameters.grooves import step_between

    name, kind = section["name"], section["kind"]
    fit: Literal["A1", "A2", "step"] = "A2" if section.get("bottom") == "round" else "A1"
    try:
        found = step_between(
            obj,
            section["a"],
            section["b"],
            width=section["width"],
            kind="step" if kind == "step" else fit,
            degree=section.get("degree", 1),
        )
    except TooFewSamplesError as exc:
        missing = f"section {name}: {exc}"
        lost = _quantities(section, dict.fromkeys(_METRICS[kind], np.nan))
        return MapSection(name, kind, lost, (missing,), keys=section, missing=missing)
    values = {}
    for key in _METRICS[kind]:
        quantity = found.to_quantity(signed=key == "h")
        metric = f"section.{name}.{key}"
        values[metric] = replace(
            quantity, symbol=metric, definition=f"{quantity.definition}, section {name}"
        )
    text = (
        f"section {name}: {found.n_used} pixels, RMS {format_length(found.rms)} about the fit; u from what "
        "the fit leaves, its correlation counted; scale and reference of the instrument are not in it"
    )
    wrong = [f"section {name}: {m}" for m in found.messages]
    said = [text]
    share = found.n_missing / (found.n_used + found.n_missing)
    if share > _FEW:
        wrong.insert(0, _lost(name, share))
    elif share > 0.0:
        said.append(f"{100.0 * share:.2g} % of section {name} was not measured and is omitted")
    return MapSection(name, kind, values, (*said, *wrong), keys=section, missing="; ".join(wrong))


def _extremes_in(obj: Surface, section: Mapping[str, Any]) -> tuple[dict[str, float], str]:
    """Return the highest and lowest pixel in a circle, and what prevents a verdict."""
    name = section["name"]
    found = extremes_in(obj, section["centre"], section["radius"])
    if found is None:
        why = f"section {name}: nothing was measured in its circle; move it onto the map"
        return dict.fromkeys(_METRICS["extremes"], np.nan), why
    values: dict[str, float] = {"Pt": found.peak[2] - found.valley[2]}
    for which, (x, y, z) in (("peak", found.peak), ("valley", found.valley)):
        values |= {which: z, f"{which}_x": x, f"{which}_y": y}
    ordered = {k: values[k] for k in _METRICS["extremes"]}
    if found.is_whole:
        return ordered, ""
    why = (
        f"section {name}: a part of its circle was not measured or lies outside the map, where a higher or "
        "a lower place may be; draw it where the map was measured"
    )
    return ordered, why


def _missing(name: str, profile: Profile | None) -> str:
    """Return why the heights along a section are not known well enough for a verdict."""
    gaps = 0.0 if profile is None else float(np.isnan(profile.z).mean())
    return _lost(name, gaps) if gaps else ""


def _lost(name: str, share: float) -> str:
    return (
        f"{100.0 * share:.3g} % of section {name} was not measured or lies outside the map, so that its "
        "heights there are not known; draw it where the map was measured"
    )


def _of_points(section: Mapping[str, Any]) -> dict[str, float]:
    """Return what follows from the points alone, whatever the heights are."""
    kind = section["kind"]
    if kind == "angle":
        return {"angle": angle_at(section["a"], section["b"], section["c"])}
    if kind == "circle3":
        (x, y), diameter = circle_through(section["a"], section["b"], section["c"])
        return {"diameter": diameter, "x": x, "y": y}
    if kind == "distance":
        found = distance((*section["a"], 0.0), (*section["b"], 0.0))
        return {"lateral": found.lateral, "azimuth": found.azimuth}
    return {}


def _distance_on(obj: Surface, section: Mapping[str, Any]) -> tuple[dict[str, float], str]:
    """Return a distance, NaN where it needs a height that was not measured, and which height that is."""
    ends = [(*section[k], height_at(obj, section[k])) for k in ("a", "b")]
    found = distance(*ends)
    values = {k: getattr(found, k) for k in _METRICS["distance"]}
    missing = [k for k, end in zip("ab", ends, strict=True) if np.isnan(end[2])]
    if not missing:
        return values, ""
    return values, (
        f"section {section['name']}: the height at {' and '.join(missing)} was not measured, so that "
        "only the distance in the plane and its direction are known"
    )


def heights_along(obj: Surface, section: Mapping[str, Any]) -> Profile | None:
    """Return the heights along a section; of a groove from its one face to its other; None of points."""
    if section["kind"] == "circle":
        return circle_section(obj, section["centre"], section["radius"])
    if section["kind"] not in ("line", *_FITS):
        return None
    a, b = section["a"], section["b"]
    if section["kind"] == "groove":
        number = Pixels if _counts_pixels(section) else float
        a, b = (
            tuple(number(2.0 * p - q) for p, q in zip(one, other, strict=True))
            for one, other in ((a, b), (b, a))
        )
    return section_profile(obj, a, b, width=section.get("width"))


def _of_profile(
    profile: Profile, section: Mapping[str, Any]
) -> tuple[dict[str, float], tuple[str, ...]]:
    name, valid = section["name"], profile.z[~np.isnan(profile.z)]
    if not valid.size:
        raise TooFewSamplesError(
            f'section "{name}" lies wholly outside of what was measured; move it onto the map'
        )
    messages = []
    share = valid.size / profile.z.size
    if share < 1.0:
        messages.append(
            f"section {name}: {100.0 * (1.0 - share):.3g} % of its samples were not measured; its "
            "numbers are of the others, and no check of them passes"
        )
    step = profile.history[-1].parameters
    if step["bilinear_share"] > 0.0:
        messages.append(
            f"section {name}: {100.0 * step['bilinear_share']:.3g} % of its samples lie beside a gap or "
            "the rim and are interpolated between four pixels, which damps waves of a few pixels"
        )
    if "lines" in step:
        part, across = step["lines_share"], format_length(section["width"])
        fewer = f"; {100.0 * part:.3g} % of them, in pairs, were measured" if part < 1.0 else ""
        messages.append(f"section {name}: mean of {step['lines']} lines across {across}{fewer}")
    values = {"Pt": float(np.ptp(valid)), "Pq": float(valid.std())}
    orders = section.get("harmonics", ())
    if orders:
        amplitudes = harmonics(profile, orders)[0]
        values |= {f"harmonic_{n}": float(a) for n, a in zip(orders, amplitudes, strict=True)}
    return values, tuple(messages)
