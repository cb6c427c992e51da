"""Maps of interferometers in HDF5: Zygo Mx ``.datx`` and 4D Technology 4Sight ``.h5``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from metrosep.core.errors import UnitError, UnsupportedFeatureError
from metrosep.core.surface import Surface
from metrosep.core.units import parse_quantity
from metrosep.io.containers.hdf5_file import Hdf5File, look_into, open_hdf5
from metrosep.io.declared import Match
from metrosep.io.objects import Request, check_scale, lateral_or_none, map_reader, scaled
from metrosep.io.registry import BuiltIn, sniffer
from metrosep.io.source import RawFile

# ---- Zygo Mx ``.datx``: phase map of an interferometer or a white-light profiler, in HDF5
# The table ``/MetaData`` is a graph (source, link, destination) that leads from ``Root`` over the
# measurement to its surface. Heights are in a length unit, or in fringes: then height in m is
# ``raw * S * O * wavelength`` with the interferometric scale factor S and the obliquity factor O. No
# real file has been read yet: layout, sources and doubts are in ``data_formats/datx/SPEC.md``.

_DATX = "datx"

_SURFACES = "/Data/Surface/"
_UNITS = {"NanoMeters": 1e-9, "MicroMeters": 1e-6, "MilliMeters": 1e-3, "Meters": 1.0}
_WAVELENGTHS = (1e-8, 1e-3)

_RESOLUTION = "Data Context.Lateral Resolution:Value"
_SAME_STEP = 1e-3
"""Largest relative difference of the two places where the file states its step."""


def _datx_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is an Mx file."""
    handle = look_into(file)
    return Match.YES if handle is not None and any(_paths(handle)) else Match.NO


def _datx_channels(file: RawFile) -> tuple[str, ...]:
    """Return ``height``, or the identifiers of the surfaces where there are several."""
    with open_hdf5(file) as handle:
        return tuple(_surfaces(file, handle, []))


@map_reader(_DATX, "Mx", "an Mx map with its own units", several=True)
def _datx_read(asked: Request) -> Surface:
    """Return the height map of an Mx file."""
    file = asked.file
    warnings = asked.warnings
    with open_hdf5(file) as handle:
        surfaces = _surfaces(file, handle, warnings)
        path = surfaces[asked.choose(surfaces)]
        own = handle.attributes(path)
        raw = handle.read_map(path, asked.max_pixels)
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
    return asked.surface(
        scaled(raw, scale, invalid),
        (steps[0], steps[1]),
        row_order="top row first",
        header={"surface": own, **general},
        surface_path=path,
        **chain,
    )


def _surfaces(file: RawFile, handle: Hdf5File, warnings: list[str]) -> dict[str, str]:
    """Return channel name to path of each map; those that the graph leads to come first."""
    linked, others = _paths(handle)
    paths = [*linked, *others]
    if not paths:
        raise file.corrupt("holds no surface", expected=f"{_SURFACES}{{...}}")
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


datx = BuiltIn(_datx_sniff, _datx_channels, _datx_read)


# ---- 4D Technology 4Sight ``.h5``/``.4D``: maps of an interferometer in HDF5, one or several per file ----
# Height in m is ``data * wavelength * wedge``: data are waves, `wedge` is 0.5 where a wave of path is
# half a wave of surface. 3.4e38 (the largest float32) is not measured. The top row of the camera image
# comes first: maps of one part that was turned in the instrument fit together so, and not mirrored.
# Layout and sources are in ``data_formats/fourd/SPEC.md``.

_FOURD = "fourd"

_DATA = re.compile(r"/(measurement(\d+))/genraw/data")
_FIRST_INVALID = 1e38
"""Above every height in waves; the marker is 3.4028235e38."""

_DEFAULT_PIXEL = 0.00903e-3
"""Pixel of the camera in m, which the software writes until someone calibrates."""

_DEFAULT_RTOL = 2e-3
"""The default is written with three to six digits."""


_fourd_sniff = sniffer(_FOURD)


def _fourd_channels(file: RawFile) -> tuple[str, ...]:
    """Return the measurements, by number."""
    with open_hdf5(file) as handle:
        return _measurements(file, handle)


@map_reader(_FOURD, "4D", "a 4D map with its own units", several=True)
def _fourd_read(asked: Request) -> Surface:
    """Return one raw map of a 4Sight file; masks and fits of the software are not applied."""
    file = asked.file
    with open_hdf5(file) as handle:
        names = _measurements(file, handle)
        name = asked.choose(names)
        header = _header(handle, name)
        raw_attributes = header[f"/{name}/genraw"]
        data = f"/{name}/genraw/data"
        raw = handle.read_map(data, asked.max_pixels)
    wavelength, wedge = _fourd_scale(file, raw_attributes)
    warnings = asked.warnings
    steps = _steps(file, raw_attributes, warnings)
    _check_count(header, names, warnings)
    return asked.surface(
        scaled(raw, wavelength * wedge, lambda block: ~(abs(block) < _FIRST_INVALID)),
        steps,
        row_order="top row first",
        header=header,
        measurement=name,
        wavelength_m=wavelength,
        wedge=wedge,
        height_per_wave_m=wavelength * wedge,
    )


def _measurements(file: RawFile, handle: Hdf5File) -> tuple[str, ...]:
    names = _found(handle)
    if not names:
        raise file.corrupt("holds no map of 4Sight", expected="/measurement0/genraw/data")
    return names


def _found(handle: Hdf5File) -> tuple[str, ...]:
    """Return the measurements that have a raw map, by number."""
    matches = (_DATA.fullmatch(d) for d in handle.datasets)
    return tuple(name for _, name in sorted((int(m[2]), m[1]) for m in matches if m))


def _header(handle: Hdf5File, name: str) -> dict[str, Any]:
    """Return the attributes of every group that belongs to the measurement, by path."""
    groups = {
        path: dict(values)
        for path, values in handle.groups.items()
        if path in ("/", "/4D") or f"{path}/".startswith(f"/{name}/")
    }
    groups.setdefault(f"/{name}/genraw", {})
    return groups


def _quantity(file: RawFile, attributes: dict[str, Any], key: str) -> float:
    """Return an attribute such as ``632.8 nm`` in m; it must carry its unit."""
    value = attributes.get(key)
    try:
        return parse_quantity(value if isinstance(value, str) else "", dimension="length")
    except UnitError:
        raise file.corrupt(
            "a length has no unit",
            field=f"genraw {key}",
            expected="a number and a unit",
            found=repr(value)[:40],
        ) from None


def _fourd_scale(file: RawFile, attributes: dict[str, Any]) -> tuple[float, float]:
    """Return the wavelength in m and the wedge factor."""
    unit = str(attributes.get("height_units"))[:40]
    if unit != "wv":
        raise UnsupportedFeatureError(
            f"{file.path}: the heights are in {unit!r} (height_units), only waves ('wv') are known; "
            "export the measurement in waves"
        )
    kind = attributes.get("lut_type", "opd")
    if kind != "opd":
        raise UnsupportedFeatureError(
            f"{file.path}: the map is of type {str(kind)[:40]!r} (lut_type), only optical path differences ('opd') "
            "are known; export the measured phase"
        )
    low, high = _WAVELENGTHS
    wavelength = check_scale(
        file, "genraw wavelength", _quantity(file, attributes, "wavelength"), low=low, high=high
    )
    wedge = attributes.get("wedge")
    number = float(wedge) if isinstance(wedge, (int, float)) else float("nan")
    return wavelength, check_scale(file, "genraw wedge", number)


def _steps(
    file: RawFile, attributes: dict[str, Any], warnings: list[str]
) -> tuple[float | None, float | None]:
    """Return dx = xpix and dy = xpix * aspect, in m."""
    if "xpix" not in attributes:
        return None, None
    dx = lateral_or_none(file, "genraw xpix", _quantity(file, attributes, "xpix"), warnings)
    if dx is None:
        return None, None
    if abs(dx / _DEFAULT_PIXEL - 1.0) < _DEFAULT_RTOL:
        warnings.append(
            f"xpix is {dx * 1e3:.6g} mm, the pixel of the camera, which the software writes when "
            "nobody calibrated; pass lateral_step= if the part's pixel differs"
        )
    aspect = attributes.get("aspect", 1.0)
    number = float(aspect) if isinstance(aspect, (int, float)) else float("nan")
    check_scale(file, "genraw aspect", number)
    if number != 1.0:
        warnings.append(f"aspect is {number:g}: taken as dy / dx, which no real file confirmed")
    return dx, lateral_or_none(file, "genraw xpix * aspect", dx * number, warnings)


def _check_count(header: dict[str, Any], names: tuple[str, ...], warnings: list[str]) -> None:
    declared = header.get("/4D", {}).get("nummeas", len(names))
    if declared != len(names):
        warnings.append(f"the file declares {declared} measurements and holds {len(names)}")


fourd = BuiltIn(_fourd_sniff, _fourd_channels, _fourd_read)
