"""The keys of steps that measure: kind, default and plain words, from which a form can be made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field as new_field
from typing import Any

from metrosep.recipe.key_values import DIMENSIONS
from metrosep.recipe.schema import Field

__all__ = ["APERTURE", "FILTER", "FORM", "MASK", "OUTLIERS", "PARAMETERS", "Key", "described_keys"]


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a step, with everything that a form needs."""

    field: Field  # kind, choices, whether it must be there
    help: str  # what it does, in plain words
    # what counts where it is left out, as it is typed; None where nothing does
    default: Any = None
    # mapping of str to Key: keys of a table
    inner: Mapping[str, Key] = new_field(default_factory=dict)


def described_keys(keys: Mapping[str, Key]) -> list[dict[str, Any]]:
    """Return keys as plain values for JSON."""
    return [
        {
            "name": name,
            "kind": key.field.kind,
            "required": key.field.required,
            "choices": list(key.field.choices),
            "default": key.default,
            "dimension": DIMENSIONS.get(key.field.kind),
            "help": key.help,
            "keys": described_keys(key.inner),
        }
        for name, key in keys.items()
    ]


def _text(help: str, *choices: str, default: Any = None, required: bool = False) -> Key:  # noqa: A002
    return Key(Field("text", required=required, choices=choices), help, default)


APERTURE: Mapping[str, Key] = {
    "shape": _text("of the aperture", "circle", "ring", "rectangle", required=True),
    "diameter": Key(Field("size"), "outer diameter of a circle or a ring"),
    "inner_diameter": Key(Field("size"), "hole of a ring"),
    "width": Key(Field("size"), "of a rectangle along x; the length of a piece of a profile"),
    "height": Key(Field("size"), "of a rectangle along y"),
    "centre": Key(
        Field("any"),
        'x and y in the coordinates of the map, ["5 mm", "5 mm"]; fit: the middle of what was '
        "measured",
        "fit",
    ),
}

MASK: Mapping[str, Key] = {
    "aperture": Key(Field("table", required=True), "what is kept", None, APERTURE),
    "outside": Key(
        Field("flag"), "true: what lies outside is taken out; false: what lies inside", True
    ),
}

OUTLIERS: Mapping[str, Key] = {
    "threshold": Key(
        Field("number"), "largest distance from the neighbours, in robust standard deviations", 6.0
    ),
    "window": Key(
        Field("integer"), "samples across the neighbourhood, odd: 5 for a map, 11 for a profile"
    ),
    "form": _text(
        "taken off for judging only: smooth, a polynomial of degree 8, or a form such as sphere",
        default="smooth",
    ),
}

FORM: Mapping[str, Key] = {
    "form": _text(
        'plane, sphere, "conic: R=50 mm, k=-1", "polynomial: degree=5", "zernike: terms=36"; '
        "what has no value is fitted",
        required=True,
    ),
    "free": Key(
        Field("texts"),
        "what may move: piston, tilt_x, tilt_y, shift_x, shift_y, rotation_z, and parameters of "
        "the form; piston and tilts if left out",
    ),
    "fix": Key(Field("table"), 'held at a value: { R = "50 mm" }'),
    "start": Key(Field("table"), 'where the fit begins: { R = "50 mm" }'),
    "robust": _text("weigh outliers down", "tukey", "huber"),
    "tilt": _text("add a plane, or turn the form as a body", "plane", "rotation", default="plane"),
    "direction": _text("of the deviation", "vertical", "normal", default="vertical"),
    "centre": Key(
        Field("lengths"),
        'origin of the form in the data, ["1.5 mm", "2 mm"]; the middle of what was measured on a map without origin',
    ),
}

FILTER: Mapping[str, Key] = {
    "kind": _text(
        "of the filter; closing and opening are morphological",
        "gaussian",
        "spline",
        "robust",
        "closing",
        "opening",
        default="gaussian",
    ),
    "lambda_s": Key(Field("size"), "S-filter: shorter waves go (gaussian)"),
    "lambda_c": Key(
        Field("size"),
        "L-filter: longer waves go (gaussian); a profile becomes its roughness, of kind R",
    ),
    "profile": _text(
        "what lambda_c leaves of a profile: R roughness, W waviness", "R", "W", default="R"
    ),
    "cutoff": Key(Field("size"), "one cut-off wavelength, in place of lambda_s and lambda_c"),
    "band": _text(
        "what stays with cutoff: waves longer, or shorter than it", "long", "short", default="long"
    ),
    "end": _text(
        "at ends and gaps (gaussian; natural or closed: spline)",
        "moment",
        "renormalise",
        "cut",
        "closed",
        "natural",
    ),
    "order": Key(
        Field("integer", choices=(0, 1, 2)), "degree of the local polynomial (robust)", 2
    ),
    "tension": Key(Field("number"), "0 to 1 (spline)", 0.0),
    "radius": Key(Field("size"), "of the ball or disc (closing, opening)"),
    "length": Key(Field("size"), "of the flat element (closing, opening)"),
    "sections": Key(
        Field("integer"), "section lengths of lambda_c that a roughness profile keeps"
    ),
    "refilter": Key(Field("flag"), "filter once more what was filtered already", False),
}

PARAMETERS: Mapping[str, Key] = {
    "names": Key(
        Field("texts"),
        'symbols such as "Sa", "PV", "Ra", "FLTt"; "all"; a usual set for a map or a profile if '
        "left out",
    ),
    "kind": _text("which profile it is; else as the file or the filter says", "P", "W", "R"),
    "edition": _text(
        "whose definitions of profile parameters",
        "ISO 21920-2:2021",
        "ISO 4287:1997",
        default="ISO 21920-2:2021",
    ),
    "intermediate": Key(
        Field("flag"),
        "true: later steps change the map or profile, and this is what it was before them",
        False,
    ),
    "sections": Key(
        Field("integer"), "section lengths of a profile; as many as there are cut-offs, else 5"
    ),
    "centre": Key(Field("flag"), "subtract the mean of a profile again", False),
    "line": _text("core line of the Rk and Sk family", "lsq", "secant", default="lsq"),
    "reference": _text(
        "of straightness STRt, flatness FLTt, roundness RONt",
        "MZ",
        "LS",
        "EP",
        "MC",
        "MI",
        default="MZ",
    ),
}
