"""The look of the house: a TOML file that a report names, with logo, colour, font and lines of text.

It holds no code. The logo is embedded in the result, so that a report can be made again anywhere; an
SVG keeps its shapes and loses scripts, links and everything else.
"""

from __future__ import annotations

import base64
import re
import struct
import tomllib
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from metrosep.core.atomic import RECIPE_BYTES, read_plain, read_plain_text
from metrosep.core.errors import DataError, RecipeError
from metrosep.core.options import option, options_of
from metrosep.recipe.report_fields import checked_languages, checked_table

PAGES = ("A4", "letter")
_LOGO_BYTES = 512 * 1024
_LONGEST_LINE = 200
_MOST_PIXELS = 4000
"""Width or height of a logo."""


@dataclass(frozen=True, slots=True)
class Look:
    """What a template may set; the place of verdict, number, U and page count cannot be moved."""

    logo: str = option("", kind="file", help="PNG or SVG beside the template, up to 512 kB")
    colour: str = option("", kind="text", help='colour of titles and lines, "#004b87"')
    font: str = option("", kind="text", help="name of the font")
    header: str = option("", kind="text", help="line above the title")
    footer: str = option("", kind="text", help="line at the foot of each page")
    language: Any = option("", kind="texts", help="language, or two: en, de, zh, ja")
    page: str = option("A4", kind="text", help="size of the page", choices=PAGES)


def read_look(path: Path, admits: Callable[[Path], bool] | None = None) -> dict[str, Any]:
    """Return a template with its logo as a data address; RecipeError says what is wrong with it."""
    try:
        held = tomllib.loads(read_plain_text(path, RECIPE_BYTES))
    except tomllib.TOMLDecodeError as exc:
        raise RecipeError(f"{path}: the template is not TOML ({exc})") from None
    except OSError as exc:
        reason = exc.strerror or exc
        raise RecipeError(f"{path}: the template cannot be read ({reason})") from None
    try:
        look = checked_table(held, options_of(Look), "the template")
        _require(look)
        if look.get("logo"):
            look["logo"] = _logo(path, look["logo"], admits)
    except DataError as exc:
        raise RecipeError(f"{path}: {exc}") from None
    return look


def _require(look: Mapping[str, Any]) -> None:
    colour, font = look.get("colour", "#000000"), look.get("font", "")
    if not re.fullmatch(r"#[0-9a-fA-F]{6}", colour):
        raise DataError(f'colour = {colour!r}: write six digits, such as "#004b87"')
    if not re.fullmatch(r"[\w .-]{0,80}", font):
        raise DataError(f"font = {font!r}: give the name of one font, such as Noto Sans CJK SC")
    for key in ("header", "footer"):
        if len(look.get(key, "")) > _LONGEST_LINE:
            raise DataError(f"{key} has {len(look[key])} characters; a line holds {_LONGEST_LINE}")
    checked_languages(look.get("language", ()), "the template")


def _logo(template: Path, name: str, admits: Callable[[Path], bool] | None) -> str:
    """Return the logo as a data address; it must lie beside the template or below."""
    place = (template.parent / name).resolve()
    if not place.is_relative_to(template.parent.resolve()) or (
        admits is not None and not admits(place)
    ):
        raise DataError(f"logo = {name!r}: put it beside the template")
    try:
        data = read_plain(place, _LOGO_BYTES)
    except OSError as exc:
        reason = "larger than 512 kB" if exc.errno is None else exc.strerror or exc
        raise DataError(f"logo = {name!r}: {reason}; give a PNG or SVG of up to 512 kB") from None
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        _require_png(data, name)
        kind = "png"
    elif b"<svg" in data[:4096]:
        data, kind = clean_svg(data, name), "svg+xml"
    else:
        raise DataError(f"logo = {name!r} is not a PNG or SVG picture")
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _require_png(data: bytes, name: str) -> None:
    """Refuse a PNG that is cut off, damaged or too large to show: each chunk has its checksum."""
    at, kinds = 8, []
    while at + 12 <= len(data):
        n = struct.unpack(">I", data[at : at + 4])[0]
        body = data[at + 4 : at + 8 + n]
        if (
            len(data) < at + 12 + n
            or zlib.crc32(body) != struct.unpack(">I", data[at + 8 + n : at + 12 + n])[0]
        ):
            break
        kinds.append(body[:4])
        if body[:4] == b"IHDR" and len(body) < 12:
            break
        if body[:4] == b"IHDR" and max(struct.unpack(">II", body[4:12])) > _MOST_PIXELS:
            raise DataError(f"logo = {name!r} has more than {_MOST_PIXELS} pixels along a side")
        at += 12 + n
    if not kinds or kinds[0] != b"IHDR" or b"IDAT" not in kinds or kinds[-1] != b"IEND":
        raise DataError(f"logo = {name!r} is a damaged PNG; export it again")


# ---- SVG without anything that acts: an element or attribute that is not listed is dropped ---------

_SVG = "http://www.w3.org/2000/svg"
_ELEMENTS = frozenset(
    [
        "svg",
        "g",
        "defs",
        "title",
        "desc",
        "path",
        "rect",
        "circle",
        "ellipse",
        "line",
        "polyline",
        "polygon",
        "text",
        "tspan",
        "linearGradient",
        "radialGradient",
        "stop",
        "clipPath",
        "mask",
    ]
)
_ATTRIBUTES = frozenset(
    [
        "id",
        "d",
        "x",
        "y",
        "x1",
        "y1",
        "x2",
        "y2",
        "cx",
        "cy",
        "r",
        "rx",
        "ry",
        "fx",
        "fy",
        "dx",
        "dy",
        "width",
        "height",
        "viewBox",
        "points",
        "transform",
        "fill",
        "stroke",
        "stroke-width",
        "stroke-linecap",
        "stroke-linejoin",
        "stroke-miterlimit",
        "stroke-dasharray",
        "opacity",
        "fill-opacity",
        "stroke-opacity",
        "fill-rule",
        "clip-rule",
        "clip-path",
        "mask",
        "offset",
        "stop-color",
        "stop-opacity",
        "gradientUnits",
        "gradientTransform",
        "spreadMethod",
        "clipPathUnits",
        "maskUnits",
        "font-family",
        "font-size",
        "font-weight",
        "font-style",
        "text-anchor",
        "preserveAspectRatio",
        "version",
    ]
)
_WRAPS = (f"{{{_SVG}}}a", f"{{{_SVG}}}switch")
_ADDRESS = re.compile(r"url\(\s*(?!#[\w.-]+\s*\))", re.IGNORECASE)


def clean_svg(data: bytes, name: str = "logo.svg") -> bytes:
    """Return an SVG with its shapes only; DataError where it is not one.

    Examples
    --------
    >>> clean_svg(b'<svg xmlns="http://www.w3.org/2000/svg"><script>x</script><g onclick="y"/></svg>')
    b'<svg xmlns="http://www.w3.org/2000/svg"><g /></svg>'
    """
    from defusedxml import ElementTree as Safe
    from defusedxml.common import DefusedXmlException

    try:
        root = Safe.fromstring(data)
    except (ET.ParseError, DefusedXmlException, ValueError) as exc:
        raise DataError(f"logo = {name!r} is not an SVG that can be read ({exc})") from None
    if root.tag != f"{{{_SVG}}}svg":
        raise DataError(f"logo = {name!r} is XML, but not an SVG picture")
    try:
        _strip(root)
    except RecursionError:
        raise DataError(f"logo = {name!r}: its groups are nested too deeply") from None
    ET.register_namespace("", _SVG)
    made: bytes = ET.tostring(root)
    return made


def _strip(element: Any) -> None:
    style = element.attrib.get("style", "")
    own = (part.partition(":") for part in style.split(";"))
    for key, _, value in own:
        element.attrib.setdefault(key.strip(), value.strip())
    for key, value in list(element.attrib.items()):
        if key not in _ATTRIBUTES or _ADDRESS.search(value) or "\\" in value:
            del element.attrib[key]
    for child in list(element):
        tag = child.tag if isinstance(child.tag, str) else ""
        if tag in _WRAPS:  # the shapes of a link stay, its address goes
            child.tag = tag = f"{{{_SVG}}}g"
        if tag.removeprefix(f"{{{_SVG}}}") in _ELEMENTS and tag.startswith(f"{{{_SVG}}}"):
            _strip(child)
        else:
            element.remove(child)
