"""Checks of steps that measure, and their values in SI: before anything is read."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import DataError, Example
from metrosep.core.limits import FORM_OF_SYMBOL
from metrosep.core.options import KINDS, Option, checked
from metrosep.core.profile import Profile
from metrosep.core.readable import did_you_mean, nearest, said_value
from metrosep.core.regions import SHAPES, check_region, in_pixels
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.recipe.schema import DIMENSIONS

if TYPE_CHECKING:
    from metrosep.parameters.table import ParameterTable

USUAL_OF_MAPS = ("PV", "RMS", "Sa", "Sq", "Sz", "Ssk", "Sku")
USUAL_OF_PROFILES = ("a", "q", "z", "t", "sk", "ku")
"""Parameters that are evaluated where none are named; those of profiles behind P, W or R."""

EVALUATING = ("parameters", "psd", "step_height", "surface_profile", "line_profile")
"""Steps that leave the map or profile as it is."""

SPECTRUM = "PSD"
"""Metric of a step `psd`: its verdict is that of the bands, so a check of it has no limits."""

OF_STEP: Mapping[str, Mapping[str, str]] = {
    "psd": {SPECTRUM: "1"},
    "step_height": {"d": "m", "h": "m"},
    "surface_profile": {"t": "m"},
    "line_profile": {"t": "m"},
}
"""Metrics of steps that make the same ones always, with their units."""

Check = Callable[[Mapping[str, Any]], None]


class StepError(DataError):
    """A step that cannot be run as it is written, or not on this kind of data."""

    def __init__(self, message: str, key: str | None = None) -> None:
        super().__init__(message)
        self.key = key


def normal_values(
    given: Mapping[str, Any], keys: Mapping[str, Option], what: str
) -> dict[str, Any]:
    """Return the values of a step in SI."""
    values: dict[str, Any] = {}
    for name, value in given.items():
        if name not in keys:
            hint = did_you_mean(name, keys)
            raise StepError(
                f'unknown key "{name}" in {what}; known: {", ".join(keys)}.{hint}', str(name)
            )
        key = keys[name]
        choices = key.choices
        if choices and (value not in choices or isinstance(value, bool)):
            known = ", ".join(str(c) for c in choices)
            raise StepError(f"{name} = {said_value(value)} is not one of {known}", name)
        if name == "centre" and not key.required and key.kind == "any":
            values[name] = _centre(value, "length" if "form" in keys else "lateral")
        elif key.inner:
            if not isinstance(value, Mapping):
                raise StepError(
                    f"{name} is a table, such as {{ {next(iter(key.inner))} = ... }}", name
                )
            try:
                values[name] = normal_values(value, key.inner, f"{name} of {what}")
            except StepError as exc:
                raise StepError(str(exc), name) from None
        else:
            values[name] = _normal(value, key, name)
    for name, key in keys.items():
        if key.required and name not in given:
            raise StepError(f'{what} needs the key "{name}"')
    return values


def _normal(value: Any, key: Option, name: str) -> Any:
    try:
        return checked(replace(key, choices=()), value, "value")
    except DataError as exc:
        raise StepError(f"{name} = {said_value(value)}: {exc}", name) from None


def _centre(value: Any, kind: str) -> Any:
    if value == "fit":
        return "fit"
    if isinstance(value, str) or not isinstance(value, list | tuple) or not 1 <= len(value) <= 2:
        raise StepError(
            f'centre = {said_value(value)}: "fit", or x and y such as ["5 mm", "5 mm"] are needed here',
            "centre",
        )
    try:
        return tuple(KINDS[kind].check(v, "value", True) for v in value)
    except DataError as exc:
        raise StepError(f"centre = {list(value)!r}: {exc}", "centre") from None


def form_options(options: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the ideal form of a step, and the options of its fit."""
    from metrosep.forms.catalogue import form_from_text

    try:
        ideal = form_from_text(options["form"])
    except DataError as exc:
        raise StepError(str(exc), "form") from None
    rest = {k: v for k, v in options.items() if k in ("robust", "tilt", "direction")}
    if "free" in options:
        rest["free"] = tuple(options["free"])
    for key, name in (("fix", "fixed"), ("start", "start")):
        if key in options:
            rest[name] = _form_numbers(options[key], ideal, key)
    if "centre" in options:
        centre = tuple(options["centre"])
        if len(centre) > 2:
            raise StepError(f"centre has x and y, got {len(centre)} values", "centre")
        rest["centre"] = (*centre, 0.0)[:2]
    return ideal, rest


def _form_numbers(given: Mapping[str, Any], ideal: Any, key: str) -> dict[str, float]:
    from metrosep.forms.base import RIGID
    from metrosep.forms.catalogue import parameter_value

    units = {**RIGID, **ideal.units_of()}
    found = {}
    for name, value in given.items():
        if name not in units:
            raise StepError(f"{key}: {name} is none of {', '.join(units)}", key)
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise StepError(
                f"{key}: {name} = {said_value(value)} is not a number with a unit", key
            )
        pure = units[name] in ("1", "")
        if not isinstance(value, str) and not pure:
            raise StepError(
                f'{key}: {name} = {said_value(value)} needs its unit, such as {name} = "{value} mm", or '
                f'"{value} SI"',
                key,
            )
        try:
            found[name] = parameter_value(str(value), units[name], name)
        except DataError as exc:
            raise StepError(f"{key}: {exc}", key) from None
    return found


FILTER_KEYS: Mapping[str, tuple[str, ...]] = {
    "gaussian": (
        "lambda_s",
        "lambda_c",
        "profile",
        "sections",
        "core_filter",
        "cutoff",
        "band",
        "end",
        "refilter",
    ),
    "spline": ("cutoff", "band", "end", "tension", "refilter"),
    "robust": ("cutoff", "band", "order", "refilter"),
    "closing": ("radius", "length", "band", "refilter"),
    "opening": ("radius", "length", "band", "refilter"),
}


def _check_filter(options: Mapping[str, Any]) -> None:
    kind = options.get("kind", "gaussian")
    given = {k for k in options if k not in ("op", "enabled", "kind")}
    stray = next((k for k in options if k in given - set(FILTER_KEYS[kind])), None)
    if stray is not None:
        raise StepError(f"{stray} does not belong to kind = {kind!r}", stray).hinting(
            **{stray: None}
        )
    if options.get("band") == "stop":
        _check_stop(kind, options)
    if kind in ("closing", "opening"):
        if len(given & {"radius", "length"}) != 1:
            raise (
                StepError(f'{kind} needs radius = "5 um", or length = "10 um"', "kind")
                .hinting(radius=Example("5 um"))
                .hinting(length=Example("10 um"))
            )
        return
    pair = given & {"lambda_s", "lambda_c"}
    if kind != "gaussian" and "cutoff" not in given:
        raise StepError(f'kind = {kind!r} needs cutoff = "25 um"', "kind").hinting(
            cutoff=Example("25 um")
        )
    if bool(pair) == ("cutoff" in given):
        raise StepError(
            'a gaussian filter needs lambda_s, lambda_c or both, or cutoff = "25 um" with a band',
            "cutoff" if pair else "op",
        ).hinting(cutoff=None if pair else Example("25 um"))
    if pair and options.get("band") != "stop":
        for key in ("band", "refilter"):
            if key in given:
                raise StepError(
                    f"{key} goes with cutoff, not with lambda_s and lambda_c", key
                ).hinting(**{key: None})
    for key in ("profile", "sections", "core_filter"):
        if key in given and "lambda_c" not in given:
            raise StepError(f'{key} goes with lambda_c = "0.8 mm"', key).hinting(
                lambda_c=Example("0.8 mm")
            )
    ends = (
        ("natural", "closed") if kind == "spline" else ("moment", "renormalise", "cut", "closed")
    )
    if options.get("end", ends[0]) not in ends:
        raise StepError(f"end of a {kind} filter is one of {', '.join(ends)}", "end")
    low, high = options.get("lambda_s"), options.get("lambda_c")
    if low is not None and high is not None and not low < high:
        raise StepError("lambda_s must be shorter than lambda_c", "lambda_s")
    for key in ("sections",):
        if options.get(key, 1) < 1:
            raise StepError(f"{key} is a whole number from 1", key)


def _check_stop(kind: str, options: Mapping[str, Any]) -> None:
    if kind != "gaussian":
        raise StepError(
            'band = "stop" goes with lambda_s and lambda_c, without a kind', "band"
        ).hinting(kind="gaussian")
    if not {"lambda_s", "lambda_c"} <= options.keys():
        raise StepError(
            'band = "stop" needs lambda_s and lambda_c, the ends of what is removed', "band"
        )
    for key in ("profile", "sections", "core_filter", "refilter", "end"):
        if key in options:
            raise StepError(f'{key} does not go with band = "stop"', key).hinting(**{key: None})


def _check_form(options: Mapping[str, Any]) -> None:
    form_options(options)


def _check_mask(options: Mapping[str, Any]) -> None:
    aperture = options["aperture"]
    try:
        check_region(aperture["shape"], aperture, is_profile="height" not in aperture)
    except DataError as exc:
        raise StepError(str(exc), "aperture") from None


def _check_outliers(options: Mapping[str, Any]) -> None:
    from metrosep.forms.catalogue import form_from_text
    from metrosep.recipe.pipeline_mask import SMOOTH

    if options.get("threshold", 6.0) <= 0.0:
        raise StepError("threshold must be more than zero", "threshold")
    window = options.get("window", 5)
    if window < 3 or window % 2 == 0:
        raise StepError(f"window is an odd number of samples from 3, got {window}", "window")
    text = options.get("form", SMOOTH)
    if text.strip().lower() != SMOOTH:
        try:
            form_from_text(text)
        except DataError as exc:
            raise StepError(str(exc), "form") from None


def _check_parameters(options: Mapping[str, Any]) -> None:
    names = options.get("names")
    if names is not None and (not names or not all(n.strip() for n in names)):
        raise StepError('names lists symbols such as ["Sa", "PV"], or "all"', "names")
    from metrosep.parameters.symbol_units import wrong_call

    if (said := wrong_call(names or ())) is not None:
        raise StepError(said, "names")
    if options.get("sections", 1) < 1:
        raise StepError("sections is a whole number from 1", "sections")


def _check_psd(options: Mapping[str, Any]) -> None:
    from metrosep.parameters.psd_limits import psd_limit

    try:
        psd_limit(options["limit"])
    except DataError as exc:
        raise StepError(f"limit: {exc}", "limit") from None
    if not 0.0 <= options.get("max_filled", 0.1) <= 1.0:
        raise StepError("max_filled is a share from 0 to 1", "max_filled")
    if options.get("estimate") == "slopes" and options.get("detrend") == "mean":
        raise StepError(
            'estimate = "slopes" goes with detrend = "plane" or "quadratic"', "estimate"
        ).hinting(detrend="plane")


def _check_step_height(options: Mapping[str, Any]) -> None:
    groove = [k for k in ("width", "middle") if k in options]
    regions = [k for k in ("upper", "lower") if k in options]
    if groove and regions:
        raise StepError(
            f"{groove[0]} is of a groove, and {regions[0]} a region of a map; give one of them",
            groove[0],
        )
    for given, both in ((groove, ("width", "middle")), (regions, ("upper", "lower"))):
        if len(given) == 1:
            missing = next(k for k in both if k not in given)
            raise StepError(f'needs the key "{missing}" beside {given[0]}', given[0])
    try:
        in_pixels("the groove", *(options[k] for k in groove))
    except DataError as exc:
        raise StepError(str(exc), groove[0]) from None
    if not groove and not regions:
        raise StepError(
            "a step height needs width and middle of a groove, or upper and lower, two regions of a map"
        )
    if regions:
        for key in ("kind", "axis"):
            if key in options:
                raise StepError(f"{key} is of a groove, not of two regions; leave it out", key)
    for key in regions:
        region = options[key]
        try:
            check_region(region["shape"], region, is_profile=False)
        except DataError as exc:
            raise StepError(f"{key}: {exc}", key) from None
        if "points" not in region and region.get("centre", "fit") == "fit":
            raise StepError(f'{key}: a {region["shape"]} needs its centre = ["5 mm", "3 mm"]', key)


def _check_nothing(options: Mapping[str, Any]) -> None:
    """Kinds and choices say all."""


def _check_form_profile(options: Mapping[str, Any]) -> None:
    ideal, _ = form_options(options)
    missing = [n for n, v in ideal.parameters.items() if v is None]
    if missing:
        raise StepError(
            f"form = {options['form']!r}: a nominal form has all its parameters, {', '.join(missing)} is "
            'not given; write them such as "sphere: R=50 mm"',
            "form",
        )


CHECKS: Mapping[str, Check] = {
    "psd": _check_psd,
    "step_height": _check_step_height,
    "surface_profile": _check_form_profile,
    "line_profile": _check_form_profile,
    "mask": _check_mask,
    "outliers": _check_outliers,
    "form": _check_form,
    "filter": _check_filter,
    "parameters": _check_parameters,
}


def known_unit(
    steps: Sequence[Mapping[str, Any]], metric: str, more: Mapping[str, str] | None = None
) -> str | None:
    """Return the SI unit that a metric has, where the steps tell it without data.

    Examples
    --------
    >>> steps = [{"op": "form", "form": "sphere"}, {"op": "parameters"}]
    >>> [known_unit(steps, name) for name in ("Sku", "R", "tilt_x", "thing")]
    ['1', 'm', 'rad', None]
    """
    if more and metric in more:  # of a section: its unit
        return more[metric]
    symbol = metric.partition("#")[0]
    carried_out = (s for s in steps if s.get("enabled", True))
    found = {u for s in carried_out if (u := _unit_in(s, symbol)) is not None}
    return found.pop() if len(found) == 1 else None


def makes_metric(
    steps: Sequence[Mapping[str, Any]], metric: str, more: Collection[str] = ()
) -> tuple[str, str | None] | None:
    """Return why no step makes a metric, as far as that shows without data, and the nearest that one makes.

    Examples
    --------
    >>> makes_metric([{"op": "parameters", "names": ["Sq"]}], "Sa")
    ('metric = "Sa" is made by no step; did you mean "Sq"?', 'Sq')
    """
    if metric in more:
        return None
    symbol, _, number = metric.partition("#")
    carried_out = [s for s in steps if s.get("enabled", True)]
    n = sum(_makes(s, symbol) for s in carried_out)
    if n >= (int(number) if number.isdecimal() else 1):
        return None
    known = sorted({*more, *(name for s in carried_out for name in _named(s))})
    if n:
        return f'metric = "{metric}": {symbol} is made {n} time{"s" if n > 1 else ""} only', None
    near, hint = nearest(symbol, known, 0.4), f"there are {', '.join(known) or 'none'}"
    if any(s["op"] == "parameters" and "all" in s.get("names", ()) for s in carried_out):
        from metrosep.parameters.symbol_units import beside_all

        near, hint = beside_all(symbol, known)
    hint = f'did you mean "{near}"?' if near else hint
    return f'metric = "{metric}" is made by no step; {hint}', near or None


def _makes(step: Mapping[str, Any], symbol: str) -> bool:
    named = _named(step)
    if step["op"] != "parameters" or symbol in named:
        return symbol in named
    from metrosep.parameters.symbol_units import is_of_all, same_parameter

    if "all" in step.get("names", ()):
        return is_of_all(symbol)
    return any(same_parameter(symbol, name) for name in named)


def _named(step: Mapping[str, Any]) -> set[str]:
    """Return the metrics that a step makes, in one spelling; with "all" some are left out."""
    if step["op"] == "parameters":
        usual = {*USUAL_OF_MAPS, *(k + s for k in "PWR" for s in USUAL_OF_PROFILES)}
        return set(step.get("names") or usual) - {"all"}
    if step["op"] in OF_STEP:
        return set(OF_STEP[step["op"]])
    if step["op"] != "form":
        return set()
    return set(_units_of_form(step))


def _unit_in(step: Mapping[str, Any], symbol: str) -> str | None:
    if step["op"] == "parameters":
        from metrosep.parameters.symbol_units import unit_of_symbol

        return unit_of_symbol(symbol)
    if step["op"] in OF_STEP:
        return OF_STEP[step["op"]].get(symbol)
    if step["op"] != "form":
        return None
    return _units_of_form(step).get(symbol)


def _units_of_form(step: Mapping[str, Any]) -> dict[str, str]:
    """Return the unit of each value that the fit of a form finds; a radius also as a curvature."""
    from metrosep.forms.base import RIGID
    from metrosep.forms.conic import curvature_name

    ideal = form_options(step)[0]
    bent = dict.fromkeys((curvature_name(n) for n in ideal.radii), "1/m")
    left = dict.fromkeys(("residual.pv", "residual.rms"), "m")
    return {**left, **RIGID, **ideal.units_of(), **bent}


# ---- the keys of steps that measure: kind, default and plain words, from which a form can be made ----


def described_keys(keys: Mapping[str, Option]) -> list[dict[str, Any]]:
    """Return keys as plain values for JSON."""
    return [
        {
            "name": name,
            "kind": key.kind,
            "required": key.required,
            "choices": list(key.choices),
            "default": key.default,
            "dimension": DIMENSIONS.get(key.kind),
            "help": key.help,
            "keys": described_keys(key.inner),
        }
        for name, key in keys.items()
    ]


APERTURE: Mapping[str, Option] = {
    "shape": Option("text", required=True, choices=tuple(SHAPES), help="of the aperture"),
    "diameter": Option("extent", help="outer diameter of a circle or a ring"),
    "inner_diameter": Option("extent", help="hole of a ring"),
    "width": Option("extent", help="of a rectangle along x; the length of a piece of a profile"),
    "height": Option("extent", help="of a rectangle along y"),
    "angle": Option("angle", help="that a rectangle is turned, from x to y", default="0 deg"),
    "radius": Option("extent", help="of a brush: all that lies so near to its line"),
    "points": Option(
        "corners", help='corners of a polygon, or of the line of a brush: ["1.2 mm, 0.3 mm", ...]'
    ),
    "centre": Option(
        "any",
        help='x and y in the coordinates of the map, ["5 mm", "5 mm"]; fit: the middle of what was measured',
        default="fit",
    ),
}

MASK: Mapping[str, Option] = {
    "aperture": Option("table", required=True, help="what is kept", inner=APERTURE),
    "outside": Option(
        "flag", help="true: what lies outside is removed; false: what lies inside", default=True
    ),
}

OUTLIERS: Mapping[str, Option] = {
    "threshold": Option(
        "number",
        help="largest distance from the neighbours, in robust standard deviations",
        default=6.0,
    ),
    "window": Option(
        "integer", help="samples across the neighbourhood, odd: 5 for a map, 11 for a profile"
    ),
    "form": Option(
        "text",
        help="taken off for judging only: smooth, a polynomial of degree 8, or a form such as sphere",
        default="smooth",
    ),
}

FORM: Mapping[str, Option] = {
    "form": Option(
        "text",
        required=True,
        help='plane, sphere, "conic: R=50 mm, k=-1", "polynomial: degree=5", "zernike: terms=36"; what has no value is fitted',
    ),
    "free": Option(
        "texts",
        help="what may move: piston, tilt_x, tilt_y, shift_x, shift_y, rotation_z, and parameters of the form; piston and tilts if omitted",
    ),
    "fix": Option("table", help='held at a value: { R = "50 mm" }'),
    "start": Option("table", help='where the fit begins: { R = "50 mm" }'),
    "robust": Option("text", choices=("tukey", "huber"), help="weigh outliers down"),
    "tilt": Option(
        "text",
        choices=("plane", "rotation"),
        help="add a plane, or turn the form as a body",
        default="plane",
    ),
    "direction": Option(
        "text", choices=("vertical", "normal"), help="of the deviation", default="vertical"
    ),
    "centre": Option(
        "lengths",
        help='origin of the form in the data, ["1.5 mm", "2 mm"]; the middle of what was measured on a map without origin',
    ),
}

FILTER: Mapping[str, Option] = {
    "kind": Option(
        "text",
        choices=("gaussian", "spline", "robust", "closing", "opening"),
        help="of the filter; closing and opening are morphological",
        default="gaussian",
    ),
    "lambda_s": Option("size", help="S-filter: shorter waves go (gaussian)"),
    "lambda_c": Option(
        "size",
        help="L-filter: longer waves go (gaussian); a profile becomes its roughness, of kind R",
    ),
    "profile": Option(
        "text",
        choices=("R", "W"),
        help="what lambda_c leaves of a profile: R roughness, W waviness",
        default="R",
    ),
    "core_filter": Option(
        "text",
        choices=("gaussian", "13565-1", "robust"),
        help="how lambda_c makes roughness: 13565-1 and robust do not follow deep valleys, for the Rk family",
        default="gaussian",
    ),
    "cutoff": Option("size", help="one cut-off wavelength, in place of lambda_s and lambda_c"),
    "band": Option(
        "text",
        choices=("long", "short", "stop"),
        help="what stays: waves longer or shorter than cutoff; stop: all but lambda_s to lambda_c, with sharp edges",
        default="long",
    ),
    "end": Option(
        "text",
        choices=("moment", "renormalise", "cut", "closed", "natural"),
        help="at ends and gaps (gaussian; natural or closed: spline)",
    ),
    "order": Option(
        "integer", choices=(0, 1, 2), help="degree of the local polynomial (robust)", default=2
    ),
    "tension": Option("number", help="0 to 1 (spline)", default=0.0),
    "radius": Option("size", help="of the ball or disc (closing, opening)"),
    "length": Option("size", help="of the flat element (closing, opening)"),
    "sections": Option(
        "integer", help="section lengths of lambda_c that a roughness profile keeps"
    ),
    "refilter": Option("flag", help="filter once more what was filtered already", default=False),
}

INTERMEDIATE = Option(
    "flag",
    help="true: later steps change the map or profile, and this is what it was before them",
    default=False,
)

PSD: Mapping[str, Option] = {
    "limit": Option(
        "text",
        required=True,
        help='"A = 0.02 um^3, B = 2 from 0.1 mm to 5 mm", or "rms = 5 nm from 0.1 mm to 5 mm"; checked by metric = "PSD"',
    ),
    "detrend": Option(
        "text",
        choices=("mean", "plane", "quadratic"),
        help="taken off before the spectrum",
        default="plane",
    ),
    "estimate": Option(
        "text",
        choices=("auto", "heights", "slopes"),
        help="what is transformed; auto takes the slopes where the spectrum falls faster than 1/f",
        default="auto",
    ),
    "max_filled": Option(
        "number", help="largest share of holes inside the outline that is closed", default=0.1
    ),
    "intermediate": INTERMEDIATE,
}

STEP_HEIGHT: Mapping[str, Option] = {
    "width": Option(
        "extent",
        help="W of the groove or ridge between its edges; the data reach 3/2 W to both sides of its middle",
    ),
    "middle": Option("lateral", help="where its middle is, in the coordinates of the data"),
    "kind": Option(
        "text",
        choices=("A1", "A2"),
        help="A1: flat bottom; A2: round bottom, depth of its vertex",
        default="A1",
    ),
    "axis": Option("text", choices=("x", "y"), help="of a map: across the groove", default="x"),
    "degree": Option(
        "integer",
        choices=(1, 2),
        help="1: straight faces; 2: a bow of the faces is fitted",
        default=1,
    ),
    "upper": Option(
        "table",
        help="of a map, instead of width and middle: the region whose height over lower is wanted",
        inner=APERTURE,
    ),
    "lower": Option("table", help="of a map: the other region", inner=APERTURE),
    "intermediate": INTERMEDIATE,
}

FORM_PROFILE: Mapping[str, Option] = {
    "form": Option(
        "text",
        required=True,
        help='nominal form with all its parameters: "sphere: R=50 mm", "conic: R=50 mm, k=-1"',
    ),
    "datum": Option(
        "text",
        choices=("none", "frame"),
        help="none: the data may move as a body (minimax fit); frame: they are judged where they lie",
        default="none",
    ),
    "centre": FORM["centre"],
    "u_reading": Option(
        "uncertainty", help="standard uncertainty of one height, independent of the others"
    ),
    "intermediate": INTERMEDIATE,
}

AREAL_EDITIONS = ("ISO 25178-2:2021", "ISO 25178-2:2012")

PARAMETERS: Mapping[str, Option] = {
    "names": Option(
        "texts",
        help='symbols such as "Sa", "PV", "Ra", "FLTt"; "all"; a usual set for a map or a profile if omitted',
    ),
    "kind": Option(
        "text",
        choices=("P", "W", "R"),
        help="which profile it is; else as the file or the filter says",
    ),
    "edition": Option(
        "text",
        choices=("ISO 21920-2:2021", "ISO 4287:1997", "ASME B46.1", *AREAL_EDITIONS),
        help="whose definitions; of a profile ISO 21920-2:2021, of a map ISO 25178-2:2021 if omitted",
    ),
    "intermediate": INTERMEDIATE,
    "sections": Option(
        "integer", help="section lengths of a profile; as many as there are cut-offs, else 5"
    ),
    "centre": Option("flag", help="subtract the mean of a profile again", default=False),
    "line": Option(
        "text", choices=("lsq", "secant"), help="core line of the Rk and Sk family", default="lsq"
    ),
    "reference": Option(
        "text",
        choices=("MZ", "LS", "EP", "MC", "MI"),
        help="of straightness STRt, flatness FLTt, roundness RONt",
        default="MZ",
    ),
}


# ---- filter and parameters of one map or profile, as recipes and the command ``measure`` ask for them ----

_INTERFEROMETRIC = ("PV", "RMS", "PVr", "PVq", "PV20")


@dataclass(frozen=True, slots=True)
class Evaluating:
    """Which parameters, and how they are evaluated."""

    names: tuple[str, ...] = ()  # symbols wanted; empty for all
    kind: str | None = None  # P, W or R; None takes what the file or the filter says, else P
    edition: str | None = None  # of the standard of profiles or of maps; None is the present one
    # sampling lengths; as many as there are cut-offs in a filtered profile, else 5
    sections: int | None = None
    centre: bool = False  # subtract means again
    line: str = "lsq"  # core line of the Rk and Sk family
    reference: str = "MZ"  # of form deviations


def iso_filtered(
    obj: Any,
    *,
    lambda_s: float | None,
    lambda_c: float | None,
    end: str = "moment",
    kind: str | None = None,
    sections: int | None = None,
    core_filter: str = "gaussian",
    stop: bool = False,
) -> Any:
    """Return an object after the S-filter and the L-filter, both Gaussian; or without the waves between."""
    from metrosep.filters import Band, band_stop, chain, gaussian

    if lambda_s is not None and lambda_c is not None and not lambda_s < lambda_c:
        raise DataError(
            f"lambda_s = {format_length(lambda_s)} must be shorter than lambda_c = "
            f"{format_length(lambda_c)}: the S-filter takes the short waves away, the L-filter the "
            "long ones"
        )
    if lambda_s is None and lambda_c is None:
        return obj
    if stop:
        return band_stop(obj, shortest=lambda_s or 0.0, longest=lambda_c or 0.0)
    options: dict[str, Any] = {"end": end}
    if isinstance(obj, Surface):
        return gaussian(obj, band=Band(shortest=lambda_s, longest=lambda_c), **options)
    if lambda_c is None:
        assert lambda_s is not None  # noqa: S101  # one of them is given
        return chain.primary(obj, lambda_s=lambda_s, **options)
    if kind == "W":
        return chain.waviness(obj, lambda_c=lambda_c, lambda_s=lambda_s, **options)
    if sections is not None:
        options["sections"] = sections
    if core_filter != "gaussian":
        options["core_filter"] = core_filter
    return chain.roughness(obj, lambda_c=lambda_c, lambda_s=lambda_s, **options)


def parameter_tables(obj: Surface | Profile, how: Evaluating) -> tuple[ParameterTable, ...]:
    """Return the parameters of an object, a table for each family."""
    if isinstance(obj, Surface):
        from metrosep.parameters.areal_heights import flat_within_rounding

        obj = flat_within_rounding(obj)
    tables = []
    for family, names in _families(obj, how.names).items():
        if family in FORM_OF_SYMBOL:
            tables.append(_form_table(obj, family, names, how))
        elif family == "interferometric":
            tables.append(_interferometric(obj, names))
        elif family == "S":
            tables.append(_areal(obj, names, how))
        else:
            tables.append(_profile(obj, family, names, how))
    return tuple(tables)


def _families(obj: Surface | Profile, names: Sequence[str]) -> dict[str, list[str] | None]:
    """Return the wanted symbols by family; None is all of them."""
    if not names:
        return {"interferometric": None, "S": None} if isinstance(obj, Surface) else {"": None}
    families: dict[str, list[str] | None] = {}
    for name in names:
        family = _family(obj, name)
        families.setdefault(family, [])
        known = families[family]
        if known is not None:
            known.append(name)
    return families


def _family(obj: Surface | Profile, name: str) -> str:
    if name in _INTERFEROMETRIC:
        return "interferometric"
    if name[:3] in FORM_OF_SYMBOL:
        return name[:3]
    if isinstance(obj, Profile) and name in ("Mr1", "Mr2", "A1", "A2"):
        return "R"
    if isinstance(obj, Profile) and name[:1] in ("P", "W", "R"):
        return name[0]
    if isinstance(obj, Profile) and name.startswith("tp("):
        return ""  # ASME's name of mr, of any kind
    if isinstance(obj, Surface):
        if name[:1] in ("S", "V"):
            return "S"
        near = f"; did you mean S{name[1:]}?" if name[:1] in "spwrPWR" else ""
        raise DataError(f"a map has no parameter {name!r}: they are such as Sa, Sq, PV{near}")
    kind = {"S": "R"}.get(name[:1].upper(), name[:1].upper())
    near = f"; did you mean {kind}{name[1:]}?" if kind in ("P", "W", "R") else ""
    raise DataError(f"a profile has no parameter {name!r}: they are such as Ra, Pt, Wq{near}")


def _only(table: ParameterTable, names: Sequence[str]) -> ParameterTable:
    from metrosep.parameters.table import ParameterTable

    missing = [n for n in names if n not in table and n not in table.unavailable]
    if missing:
        raise DataError(f"no parameter {', '.join(missing)} among {', '.join(table)}")
    kept = {n: table.unavailable[n] for n in names if n in table.unavailable}
    return ParameterTable(
        [table[n] for n in names if n not in kept], table.context, unavailable=kept
    )


def _form_table(
    obj: Surface | Profile, family: str, names: list[str] | None, how: Evaluating
) -> ParameterTable:
    from metrosep.parameters import form_deviation

    kind: Any = FORM_OF_SYMBOL[family]
    reference: Any = how.reference
    return _only(form_deviation(obj, kind=kind, reference=reference).table, names or ())


def _interferometric(obj: Surface | Profile, names: list[str] | None) -> ParameterTable:
    from metrosep.parameters import interferometric_parameters

    if not isinstance(obj, Surface):
        raise DataError("PV, RMS, PVr and PVq are parameters of a map; ask a profile for Pt, Pq")
    return interferometric_parameters(obj, names=names)


def _areal(obj: Surface | Profile, names: list[str] | None, how: Evaluating) -> ParameterTable:
    from metrosep.parameters import areal_parameters

    if not isinstance(obj, Surface):
        raise DataError("S parameters belong to a map")
    line: Any = how.line
    edition: dict[str, Any] = {} if how.edition is None else {"edition": how.edition}
    return areal_parameters(obj, names=names, line=line, **edition)


def _profile(
    obj: Surface | Profile, family: str, names: list[str] | None, how: Evaluating
) -> ParameterTable:
    from metrosep.filters import profile_kind
    from metrosep.parameters import profile_parameters

    if not isinstance(obj, Profile):
        raise DataError(f"{family} parameters belong to a profile; a map has S parameters")
    if family and how.kind and family != how.kind:
        raise DataError(f"kind={how.kind!r} has no parameter {', '.join(names or ())}")
    kind: Any = family or how.kind or profile_kind(obj) or "P"
    edition = {} if how.edition is None else {"edition": how.edition}
    line: Any = how.line
    return profile_parameters(
        obj,
        kind=kind,
        sections=how.sections or _sections(obj),
        centre=how.centre,
        line=line,
        names=names,
        **edition,
    )


def _sections(profile: Profile) -> int:
    """Return how many cut-offs fit into a profile that metrosep or its file filtered, else 5."""
    from metrosep.parameters.sections import sections_that_fit

    cutoff = profile.metadata.get("lambda_c_m")
    if not isinstance(cutoff, float) or not profile.is_uniform:
        return 5
    return sections_that_fit(profile, cutoff)
