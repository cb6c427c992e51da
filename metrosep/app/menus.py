"""What the page offers in menus: each form with a sentence and its fields, the filters with their keys.

Nobody need know how the recipe writes them: the fields become the text that `form_from_text` reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.forms.base import Form
from metrosep.forms.catalogue import form_from_text, form_names
from metrosep.recipe.pipeline_checks import FILTER_KEYS

_SENTENCES: Mapping[str, tuple[str, str]] = {
    "plane": ("plane", "A flat: height and tilts. What measuring leaves of the set-up."),
    "sphere": (
        "sphere",
        "A ball or a spherical lens; the radius is found, or held at its nominal.",
    ),
    "cylinder": ("cylinder", "A rod or a cylindrical lens, turned by an angle."),
    "conic": (
        "conic",
        "A surface of revolution with radius and conic constant: paraboloid, ellipsoid.",
    ),
    "asphere": ("asphere", "A conic with even and odd powers of the radius."),
    "biconic": ("biconic", "Two conics, one along x and one along y."),
    "toric": ("toric", "A barrel or a tyre: two radii at right angles."),
    "polynomial": (
        "polynomial",
        "Smooth shape without a nominal, up to a degree. Takes waviness too.",
    ),
    "zernike": ("Zernike", "Aberrations on a round aperture, term by term."),
    "qforbes": ("Q", "An asphere in the terms of Forbes, in a round aperture."),
    "sine_grid": ("sine grid", "Waves along x and y, as cut for test artefacts."),
    "expression": (
        "expression",
        "A formula of your own in x and y; its letters are found by the fit.",
    ),
}
"""Title and sentence of each form of the catalogue."""

_WORDS = {
    "R": "radius", "Rx": "radius along x", "Ry": "radius along y", "Rb": "radius of the base curve",
    "Rd": "radius of the turning", "k": "conic constant", "kx": "conic constant along x",
    "ky": "conic constant along y", "amplitude_y": "amplitude along y", "wavelength_y": "wavelength along y",
    "norm_radius": "radius of the powers",
}  # fmt: skip
_SIZES = {"amplitude": "50 nm", "wavelength": "0.1 mm"}
_ASKED = ("wavelength",)
"""No form guesses it: a fit needs it to begin."""
_HINTS = {"m": "50 mm", "rad": "0 deg", "1": "-1"}
_NUMBER = "found by the fit where it is left empty"


def described_menus() -> dict[str, Any]:
    """Return the forms with their fields, and which filter has which keys."""
    return {
        "forms": [
            {"name": name, "title": title, "what": what, "fields": _fields(name)}
            for name, (title, what) in _SENTENCES.items()
            if name in form_names()
        ],
        "filters": {kind: list(keys) for kind, keys in FILTER_KEYS.items()},
    }


_DEGREES = tuple(str(n) for n in range(1, 11))


def _fields(name: str) -> list[dict[str, Any]]:
    """Return what may be typed or chosen of a form; `of` says how it is written."""
    if name == "polynomial":
        return [
            _field("degree", "highest degree", value="2", required=True, choices=_DEGREES),
            _field(
                "kind",
                "degree counts",
                choices=("total", "tensor"),
                help_="total: i + j of x^i y^j up to the degree; tensor: i and j each up to it",
            ),
        ]
    if name == "zernike":
        return [
            _field("terms", "number of terms", value="36", required=True),
            _field("order", "order of the terms", choices=("ansi", "noll", "fringe")),
            _field(
                "radius", "radius of the aperture", hint="5 mm", help_="that of the data if empty"
            ),
        ]
    if name == "qforbes":
        return [
            _field("radius", "radius of the aperture", hint="10 mm", required=True),
            _field("terms", "number of terms", value="5", required=True),
            _field("kind", "kind", choices=("bfs", "con")),
            _field("R", "radius", hint="50 mm", help_=_NUMBER),
            _field("k", "conic constant", hint="-1", help_=_NUMBER),
        ]
    if name == "expression":
        return [
            _field("formula", "formula", hint="a*x**2 + b", required=True),
            _field(
                "letters",
                "letters",
                hint="a=1, b",
                required=True,
                help_="where the fit begins, SI",
            ),
        ]
    form = form_from_text(name)
    fields = [
        _field(
            key,
            _WORDS.get(key, key.replace("_", " ")),
            hint=_hint(key, unit, form),
            required=key in _ASKED,
            help_="where the fit begins"
            if key in _ASKED
            else _NUMBER
            if form.parameters[key] is None
            else "0 where it is left empty",
        )
        for key, unit in form.units.items()
    ]
    if name == "asphere":
        fields += [
            _field("terms", "powers that are found", hint="4 6 8"),
            _field("norm_radius", _WORDS["norm_radius"], hint="10 mm"),
        ]
    return fields


def _hint(key: str, unit: str, form: Form) -> str:
    """Return an example of what is typed."""
    if key in _SIZES:
        return _SIZES[key]
    return "0" if unit == "1" and form.parameters[key] is not None else _HINTS[unit]


def _field(
    name: str,
    label: str,
    *,
    value: str = "",
    hint: str = "",
    choices: tuple[str, ...] = (),
    required: bool = False,
    help_: str = "",
) -> dict[str, Any]:
    return {
        "name": name, "label": label, "value": value, "hint": hint, "choices": list(choices),
        "required": required, "help": help_,
    }  # fmt: skip
