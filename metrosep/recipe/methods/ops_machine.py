"""Steps of recipes with the model of a machine: rank, identify, wavefront."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from metrosep.core.errors import DataError, UnitError
from metrosep.core.methods import Method
from metrosep.core.options import Option
from metrosep.core.provenance import Step
from metrosep.core.readable import did_you_mean
from metrosep.core.surface import Surface
from metrosep.core.units import parse_quantity
from metrosep.recipe.schema import file_of_curve


def form_of(text: str) -> Any:
    """Return the ideal surface that a key of a step describes, all parameters known."""
    from metrosep.forms import form_from_text

    form = form_from_text(text)
    missing = [k for k, v in form.parameters.items() if v is None]
    if missing:
        raise DataError(f'form = "{text}" has no value for {", ".join(missing)}; give all of them')
    return form


PRESET_NEEDS = {
    "fts_lathe": ("radius", "20 mm", "radius of the part"),
    "five_axis": ("pivot_height", "80 mm", "height of its table"),
}
"""Key without which a preset is not a machine, with an example and what it is."""


def machine_of(options: dict[str, Any], radius: float | None) -> Any:
    """Take the keys of a machine out of options and return its chain."""
    from metrosep.machine import Chain, presets

    name = str(options.pop("machine"))
    own, errors = options.pop("machine_radius", None), options.pop("spindle_errors", None)
    height = options.pop("pivot_height", None)
    if Path(name).suffix == ".toml" or Path(name).is_file():
        if not Path(name).is_file():
            raise DataError(f"machine = {name!r}: there is no such file")
        if own is not None or errors is not None or height is not None:
            raise DataError(
                "machine_radius, spindle_errors and pivot_height belong to a preset; write them into "
                "the file"
            )
        return Chain.from_toml(name)
    if name not in presets():
        raise DataError(
            f"machine = {name!r} is neither a file of TOML nor a preset; presets are "
            f"{', '.join(presets())}.{did_you_mean(name, presets())}"
        )
    parameters: dict[str, Any] = {}
    if name == "fts_lathe":
        parameters["radius"] = radius if own is None else own
    if height is not None or name == "five_axis":
        parameters["pivot_height"] = height
    key, example, what = PRESET_NEEDS.get(name, ("", "", ""))
    if key and parameters[key] is None:
        raise DataError(f'{name} needs the {what}: {key} = "{example}"')
    if errors is not None:
        parameters["spindle_errors"] = errors
    return presets(name, **parameters)


# ---- keys that several of these steps take -----------------------------------------------------

MACHINE: Mapping[str, Option] = {
    "machine": Option(
        "file",
        required=True,
        help="a preset (five_axis, fts_lathe, mill_xyz, sts_lathe) or a file of TOML (docs/how-to/describe-a-machine.md)",
    ),
    "machine_radius": Option(
        "size", help="of the preset fts_lathe, where it is not that of the part"
    ),
    "pivot_height": Option(
        "length", help="of the C table above the axis of A, for the preset five_axis"
    ),
    "spindle_errors": Option(
        "text",
        choices=("co-rotating", "fixed"),
        help="whether the errors of the spindle turn with the part or stand still, where a preset is named",
    ),
}
_LIGHT: Mapping[str, Option] = {
    "mode": Option(
        "text", choices=("reflect", "refract"), help="what the surface does to a plane wave"
    ),
    "n": Option("number", help="refractive index of the material, to refract"),
}
_TOOL = Option("lengths", help="tool point x, y, z in the frame of the last element of its branch")
_AT = Option(
    "table",
    help='where axes of rotation are locked while the part is cut, { A = "0 deg", C = "30 deg" }; one that '
    "carries the part and is not named turns it, as a spindle does",
)
_THRESHOLD = Option("number", help="terms whose shapes are more alike than this are a group")
_INNER_RADIUS = Option("size", help="of the part, where it has a hole")
CENTRE = Option("lengths", help="x and y of the axis in the coordinates of the map")


class Ranking(Method):
    """`rank` by its name."""

    name: ClassVar[str] = "rank"
    what: ClassVar[str] = "error terms of a machine, ranked by what they do to a part"
    reads: ClassVar = "nothing"
    arguments: ClassVar[Mapping[str, Option]] = {
        **MACHINE,
        "radius": Option(
            "size", required=True, help='of the part, from its axis to the rim, "20 mm"'
        ),
        "inner_radius": _INNER_RADIUS,
        "removed": Option(
            "text", help="none, piston, plane, plane+defocus, rigid, or names with commas"
        ),
        "tool": _TOOL,
        "at": _AT,
        "form": Option(
            "text",
            required=True,
            help='the nominal surface with all its parameters, "sphere: R=50 mm"',
        ),
        "errors": Option(
            "table",
            help='a table, { EXZ = "1 um", EZX = "wave 8 mm 1 um", EZC = "2 upr 50 nm", EYX = "random 1 um length 5 mm", EXX = "table x.csv" }',
        ),
        "all_lengths": Option(
            "size", help='magnitude of every other term that is a length, "1 um"'
        ),
        "all_angles": Option(
            "angle", help='magnitude of every other term that is an angle, "1 arcsec"'
        ),
        "response": Option(
            "text",
            choices=("form", "wavefront"),
            help="deviation of the surface, or change of the optical path",
        ),
        "direction": Option(
            "text", choices=("vertical", "normal"), help="of the deviation of the form"
        ),
        "distribution": Option(
            "text",
            choices=("normal", "uniform"),
            help="whether a magnitude is a standard uncertainty or a half-width",
        ),
        "threshold": _THRESHOLD,
        **_LIGHT,
    }

    @classmethod
    def from_inputs(cls, data: Any, options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.machine import rank

        rest = dict(options)
        radius = rest.pop("radius")
        _check_radius(radius)
        form = form_of(rest.pop("form"))
        chain = machine_of(rest, radius)
        errors, read = errors_of(chain, rest)
        rest = {**rest, **_tool(rest)}
        _lock(chain, rest)
        found = rank(chain, form, radius=radius, errors=errors, **rest)
        return replace(found, messages=(*found.messages, *read)) if read else found


_LARGEST_RADIUS = 5.0
_LARGEST = {"length": (1e-2, "10 mm"), "angle": (0.1, "0.1 rad")}
"""Errors beyond these are typing errors; the model is linear in them besides."""


def _check_radius(radius: float | None) -> None:
    if radius is not None and radius > _LARGEST_RADIUS:
        raise DataError(
            f"radius = {radius:g} m is larger than any machine turns; is its unit mm or um?"
        )


def _checked_size(term: str, value: float | str, *, is_angle: bool) -> None:
    """Refuse a magnitude of the wrong dimension, or one that no machine has; name its term."""
    from metrosep.machine.ranking import curve_text

    dimension = "angle" if is_angle else "length"
    curve = curve_text(value) if isinstance(value, str) else None
    size = abs(
        parse_quantity(value if curve is None else curve["size"], dimension=dimension, name=term)
    )
    most, words = _LARGEST[dimension]
    if size > most:
        raise DataError(
            f"{term} = {value} is beyond {words}; errors of a machine are smaller, and the model is "
            "linear in them: check the unit"
        )


def errors_of(chain: Any, rest: dict[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Take the magnitudes of the terms out of the options, how names were read, and what readers of files warn of."""
    from metrosep.machine import from_paper
    from metrosep.machine.terms import is_angle

    given = rest.pop("errors", {})
    lengths, angles = rest.pop("all_lengths", None), rest.pop("all_angles", None)
    found: dict[str, Any] = {}
    for term in chain.terms:
        value = angles if is_angle(term) else lengths
        if value is not None:
            found[term] = value
    names: dict[str, str] = {}
    said: list[str] = []
    for key, value in given.items():
        name = key if key in chain.terms else _paper_name(key, from_paper)
        if name in names:
            raise DataError(f"errors names {name} twice, as {names[name]} and as {key}")
        names[name] = key
        file = file_of_curve(value)
        if file is not None:
            value = _curve(chain, name, file, said)  # noqa: PLW2901
        elif name in chain.terms:
            try:
                _checked_size(key, value, is_angle=is_angle(name))
            except UnitError as error:
                raise UnitError(f"error of {key}: {error}") from None
        found[name] = value
    if not found:
        raise DataError(
            'no error is given: name each with its size, such as EXX = "1 um" and EAC = "0.2 arcsec", '
            "or give all_lengths and all_angles"
        )
    read = [f"{key} is a name of the paper: {name} of ISO 230-1" for name, key in names.items()]
    told = (text for text, (name, key) in zip(read, names.items(), strict=True) if name != key)
    return found, (*told, *dict.fromkeys(said))


def _curve(chain: Any, name: str, file: str, notes: list[str]) -> Any:
    """Return the table of a term from a file: ``x_mm,EXX_um``."""
    from metrosep.io.term_files import read_term_table

    kinds = chain.dimensions
    held = read_term_table(file, kinds, notes)
    if name not in held:
        raise DataError(
            f"{file}: holds {', '.join(held)}, not {name}; name the file that holds it"
        )
    return held[name][0]


def _paper_name(key: str, from_paper: Any) -> str:
    """Return the ISO name of a term of the paper, or the key where it is none."""
    try:
        return str(from_paper(key))
    except DataError:
        return key  # the chain refuses it and lists what it knows


def _lock(chain: Any, rest: dict[str, Any]) -> None:
    """Put the places of locked axes in the options as positions, in SI."""
    kinds = chain.dimensions
    if "at" in rest:
        rest["positions"] = {
            axis: parse_quantity(value, dimension=kinds[axis], name=f"at: {axis}")
            if axis in kinds
            else value
            for axis, value in rest.pop("at").items()
        }


def _tool(rest: dict[str, Any]) -> dict[str, Any]:
    if "tool" not in rest:
        return {}
    if len(rest["tool"]) != 3:
        raise DataError(f"tool is three lengths x, y, z, got {len(rest['tool'])}")
    return {"tool": tuple(rest["tool"])}


@dataclass(frozen=True, slots=True, eq=False)
class PartCurves:
    """Error motions as curves from the maps of parts, and what they leave of each map."""

    found: Any
    residuals: Mapping[str, Surface]

    @property
    def messages(self) -> tuple[str, ...]:
        """What was not determined, and what the user should know."""
        return (*self.found.null, *self.found.messages)


class TermsIdentified(Method):
    """`identify` by its name."""

    name: ClassVar[str] = "identify"
    what: ClassVar[str] = "error terms of a machine that explain a measured part"
    reads: ClassVar = "maps"
    readings: ClassVar[tuple[str, ...]] = ("map",)
    spare: ClassVar[int] = 15  # with curves: a map of each part
    arguments: ClassVar[Mapping[str, Option]] = {
        **MACHINE,
        "radius": Option("size", help='of the part, from its axis to the rim, "20 mm"'),
        "inner_radius": _INNER_RADIUS,
        "removed": Option(
            "text",
            help="freedoms that an alignment takes out: none, piston, plane, rigid, mounting, zernike 11, or "
            "names with commas",
        ),
        "tool": _TOOL,
        "at": _AT,
        "form": Option(
            "text",
            help="the nominal surface with all its parameters; what the map holds if omitted",
        ),
        "terms": Option("texts", help="error terms that may be at work, EXX,EYX,B0Z"),
        "curves": Option(
            "table",
            help="terms that are curves over the travel, and how many orders or harmonics, "
            '{ EZX = 6, EZC = "auto" }; takes several maps',
        ),
        "forms": Option("texts", help="with curves, the nominal surface of each map"),
        "centre": CENTRE,
        "threshold": _THRESHOLD,
        "exact": Option("flag", help="true: the surface is cut anew, not linear in the errors"),
    }

    @classmethod
    def from_inputs(cls, data: tuple[Surface, ...], options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.machine import identify

        rest = dict(options)
        radius = rest.get("radius")
        _check_radius(radius)
        form = form_of(rest.pop("form")) if "form" in rest else None
        chain = machine_of(rest, radius)
        rest = {**rest, **_tool(rest)}
        _lock(chain, rest)
        if "centre" in rest:
            rest["centre"] = _pair(rest["centre"])
        forms = tuple(form_of(f) for f in rest.pop("forms", ()))
        if "curves" not in rest:
            if forms:
                raise DataError("forms goes with curves and several maps; give form")
            return identify(chain, one_map(data), form=form, **rest)
        if forms and form is not None:
            raise DataError("form is for all maps, forms for each; give one of them")
        found: Any = identify(chain, list(data), form=forms or form, **rest)
        left = {
            label: replace(m, z=found.residuals[label], history=(*m.history, Step("identify")))
            for label, m in zip(found.residuals, data, strict=True)
        }
        return PartCurves(found, left)


class WavefrontOfMap(Method):
    """`wavefront` by its name."""

    name: ClassVar[str] = "wavefront"
    what: ClassVar[str] = "wavefront that a measured surface makes of a plane wave"
    reads: ClassVar = "maps"
    readings: ClassVar[tuple[str, ...]] = ("map",)
    arguments: ClassVar[Mapping[str, Option]] = {
        **_LIGHT,
        "side": Option(
            "text",
            choices=("inside", "outside"),
            help="where the light comes from: outside the material, or inside",
        ),
        "radius": Option("size", help="of the pupil; of what was measured if omitted"),
        "inner_radius": _INNER_RADIUS,
        "centre": CENTRE,
        "form": Option(
            "text", help="the nominal surface that is taken off, with all its parameters"
        ),
        "terms": Option("integer", help="number of Zernike terms"),
        "order": Option("text", choices=("ansi", "noll", "fringe"), help="of the Zernike terms"),
        "wavelength": Option("size", help="in which the wavefront is given too"),
        "removed": Option("text", help="terms that are set-up: piston,tilt"),
        "vertex_height": Option("length", help="height of the vertex above the zero of the map"),
    }

    @classmethod
    def from_inputs(cls, data: tuple[Surface, ...], options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.optics import wavefront

        rest = dict(options)
        wanted = {k: rest.pop(k) for k in ("terms", "order", "wavelength", "removed") if k in rest}
        if "form" in rest:
            rest["form"] = form_of(rest["form"])
        if "centre" in rest:
            rest["centre"] = _pair(rest["centre"])
        front = wavefront(one_map(data), **rest)
        return WavefrontResult(front, **wanted)


class WavefrontResult:
    """A wavefront with what was asked of it."""

    def __init__(
        self,
        front: Any,
        terms: int = 15,
        order: str = "ansi",
        wavelength: float | None = None,
        removed: str = "piston, tilt",
    ) -> None:
        self.front = front
        self.wavelength = wavelength
        self.removed = tuple(v.strip() for v in removed.split(",") if v.strip())
        self.table = front.zernike(terms, order=order)
        self.rest = front.remove(self.removed)
        told = (*front.messages, *getattr(self.table, "messages", ()))
        self.messages = tuple(dict.fromkeys(told))


def one_map(maps: tuple[Surface, ...]) -> Surface:
    """Return the map of a step that takes one."""
    if len(maps) != 1:
        raise DataError(f"one map is needed, got {len(maps)}; take them one by one")
    return maps[0]


def _pair(values: tuple[float, ...]) -> tuple[float, float]:
    if len(values) != 2:
        raise DataError(f"centre is two lengths x, y, got {len(values)}")
    return values[0], values[1]
