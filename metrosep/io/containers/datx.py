"""Zygo Mx ``.datx``: phase map of an interferometer or a white-light profiler, in HDF5.

The table ``/MetaData`` is a graph (source, link, destination) that leads from ``Root`` over the
measurement to its surface. Heights are in a length unit, or in fringes: then height in m is
``raw * S * O * wavelength`` with the interferometric scale factor S and the obliquity factor O. No
real file has been read yet: layout, sources and doubts are in ``data_formats/datx/SPEC.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.io.containers.hdf5_file import Hdf5File, look_into, open_hdf5
from metrosep.io.objects import (
    check_area,
    check_scale,
    lateral_or_none,
    make_surface,
    only_channels,
    scaled,
)
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["channels", "read", "sniff"]

FORMAT = "datx"

_SURFACES = "/Data/Surface/"
_UNITS = {"NanoMeters": 1e-9, "MicroMeters": 1e-6, "MilliMeters": 1e-3, "Meters": 1.0}
_WAVELENGTHS = (1e-8, 1e-3)

_RESOLUTION = "Data Context.Lateral Resolution:Value"
_SAME_STEP = 1e-3
"""Largest relative difference of the two places where the file states its step."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is an Mx file."""
    handle = look_into(file)
    return Match.YES if handle is not None and any(_paths(handle)) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return ``height``, or the identifiers of the surfaces where there are several."""
    with open_hdf5(file) as handle:
        return tuple(_surfaces(file, handle, []))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    max_pixels: int | None = None,
) -> Surface:
    """Return the height map of an Mx file."""
    refuse_options(file, "an Mx map with its own units", unit=unit)
    override = lateral_steps(lateral_step)
    warnings: list[str] = []
    with open_hdf5(file) as handle:
        surfaces = _surfaces(file, handle, warnings)
        path = surfaces[only_channels(file, "Mx", channel, tuple(surfaces))]
        own = handle.attributes(path)
        shape = handle.shape(path)
        if len(shape) != 2:
            raise CorruptFileError(
                file.path, "a map has two dimensions", field=path, expected="2", found=len(shape)
            )
        check_area(file, shape[1], shape[0], max_pixels=max_pixels)
        raw = handle.read(path, max_pixels=max_pixels)
        general = {n: v for n, v in handle.groups.items() if n.startswith("/Attributes/")}
    if raw.dtype.kind != "f":
        raise UnsupportedFeatureError(
            f"{file.path}: the heights are whole numbers ({raw.dtype}), whose scale is not known; "
            "export the map as XYZ or SUR"
        )
    scale, chain = _scale(file, own, warnings)
    marker = _marker(own, warnings)

    def invalid(block: Any) -> Any:
        return block >= marker if marker > 0.0 else block == marker

    steps = tuple(_step(file, own, f"{axis} Converter", warnings) for axis in "XY")
    _compare_steps(steps, general, warnings)
    return make_surface(
        file,
        FORMAT,
        scaled(raw, scale, invalid),
        (steps[0], steps[1]),
        row_order="top row first",
        header={"surface": own, **general},
        override=override,
        warnings=warnings,
        surface_path=path,
        **chain,
        row_order_is_assumed=True,
    )


def _surfaces(file: RawFile, handle: Hdf5File, warnings: list[str]) -> dict[str, str]:
    """Return channel name to path of each map; those that the graph leads to come first."""
    linked, others = _paths(handle)
    paths = [*linked, *others]
    if not paths:
        raise CorruptFileError(file.path, "holds no surface", expected=f"{_SURFACES}{{...}}")
    if len(paths) == 1:
        return {"height": paths[0]}
    if not linked:
        warnings.append(
            f"holds {len(paths)} surfaces and no link to one of them; their order is that of their "
            "identifiers: name one with channel="
        )
    return {path.rsplit("/", 1)[-1]: path for path in paths}


def _paths(handle: Hdf5File) -> tuple[list[str], list[str]]:
    """Return the maps that the graph leads to, and the others; none where the file is not of Mx."""
    if "/MetaData" not in handle and "/Attributes" not in handle:
        return [], []
    linked = [p for p in _linked(handle) if p in handle.datasets]
    return linked, sorted(
        p for p in handle.datasets if p.startswith(_SURFACES) and p not in linked
    )


def _linked(handle: Hdf5File) -> list[str]:
    """Return the paths that the graph gives: Root, Measurement, Surface, Path."""
    if "/MetaData" not in handle.datasets or handle.is_numeric("/MetaData"):
        return []
    graph: dict[tuple[str, str], list[str]] = {}
    for row in handle.rows("/MetaData"):
        source, link, destination = (*(map(str, row.values())), "", "", "")[:3]
        graph.setdefault((source, link), []).append(destination)
    nodes = ["Root"]
    for link in ("Measurement", "Surface"):
        nodes = [end for node in nodes for end in graph.get((node, link), ())]
    found: list[str] = []
    for node in nodes:
        found += graph.get((node, "Path"), [_SURFACES + node])
    return list(dict.fromkeys("/" + path.strip("/") for path in found))


def _number(value: Any) -> float:
    """Return a number, NaN for anything else."""
    known = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if known else float("nan")


def _scale(
    file: RawFile, own: dict[str, Any], warnings: list[str]
) -> tuple[float, dict[str, Any]]:
    """Return the height in m of one unit of the file, and the facts behind it."""
    unit = str(own.get("Unit"))[:40]
    base = _converter(own, "Z Converter")[1]
    if base not in ("", unit):
        warnings.append(f"Z Converter is for {base}, but Unit is {unit}: Unit was taken")
    if unit in _UNITS:
        return _UNITS[unit], {"unit_in_file": unit, "height_per_unit_m": _UNITS[unit]}
    if unit != "Fringes":
        raise UnsupportedFeatureError(
            f"{file.path}: the heights are in {unit!r}; known are {', '.join(_UNITS)} and Fringes: "
            "save the measurement in one of them"
        )
    low, high = _WAVELENGTHS
    ranges = {
        "Wavelength": (low, high),
        "Interferometric Scale Factor": (1e-3, 1e3),
        "Obliquity Factor": (1e-3, 1e3),
    }
    factors = {
        name: check_scale(file, name, _number(own.get(name)), low=bounds[0], high=bounds[1])
        for name, bounds in ranges.items()
    }
    wavelength, scale_factor, obliquity = factors.values()
    scale = scale_factor * obliquity * wavelength
    return scale, {
        "unit_in_file": unit,
        "wavelength_m": wavelength,
        "interferometric_scale_factor": scale_factor,
        "obliquity_factor": obliquity,
        "height_per_unit_m": scale,
    }


def _marker(own: dict[str, Any], warnings: list[str]) -> float:
    """Return the value that marks what was not measured; NaN where there is none."""
    if "No Data" not in own:
        warnings.append("the file does not say which value is not measured (No Data)")
    return _number(own.get("No Data"))


def _converter(own: dict[str, Any], name: str) -> tuple[str, str, Sequence[Any]]:
    """Return category, base unit and parameters; empty ones where the attribute is missing."""
    record = own.get(name)
    values = list(record.values()) if isinstance(record, dict) else []
    if len(values) < 3 or not isinstance(values[-1], list):
        return "", "", ()
    return str(values[0]), str(values[1]), values[-1]


def _step(file: RawFile, own: dict[str, Any], name: str, warnings: list[str]) -> float | None:
    """Return the step in m of one axis: the second parameter of its converter."""
    category, base, parameters = _converter(own, name)
    if (category, base) != ("LateralCat", "Pixels") or len(parameters) < 2:
        warnings.append(f"{name} is missing or of another kind: taken as not calibrated")
        return None
    return lateral_or_none(file, name, _number(parameters[1]), warnings)


def _compare_steps(
    steps: tuple[float | None, ...], general: dict[str, dict[str, Any]], warnings: list[str]
) -> None:
    """Warn when the general attributes state another step than the converters."""
    for attributes in general.values():
        stated = _number(attributes.get(_RESOLUTION))
        for axis, step in zip("XY", steps, strict=True):
            if step is not None and stated > 0.0 and abs(stated / step - 1.0) > _SAME_STEP:
                warnings.append(
                    f"{axis} Converter gives {step:g} m, Lateral Resolution {stated:g} m: the "
                    "converter was taken"
                )
