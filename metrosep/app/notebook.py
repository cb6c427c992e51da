"""`explore`: the map, section and spectrum of the workbench in a notebook, by anywidget.

The page of the workbench and the notebook share their widgets. A notebook takes a widget as one
text, so the modules are linked when the first widget is made (`metrosep.app.notebook`).
Nothing is asked of any other computer.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import PurePosixPath
from typing import Any, NoReturn

from metrosep.app.map_views import (
    Arrays,
    lateral_unit,
    map_frame,
    map_view,
    profile_arrays,
    section_frame,
    spectrum_frame,
)
from metrosep.app.pyramid import build_pyramid
from metrosep.app.spectrum_views import ProfileSpectrum, profile_spectrum, spectrum_view
from metrosep.app.view_tables import Extremes, profile_view, section_view
from metrosep.app.wire import error_header, pack
from metrosep.core.errors import DataError, MetrosepError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.sections import section_profile
from metrosep.core.surface import Surface
from metrosep.spectral.dft import Band

_SCOPE = ".metrosep-explore"
_COLOURS = ("viridis", "cividis")
_HEIGHTS = 240, 2000
_SHARED_STYLE = ("map", "plots")
"""Parts of the style of the page that belong to the pictures."""


def explore(obj: Surface | Profile, **options: Any) -> Any:
    """Return a widget that shows a map or a profile in a notebook.

    Notes
    -----
    Of a map without lateral calibration, a, b and band are in pixels; nothing takes them for m.
    Numbers below the section are those of the full map, never of the picture. The widget holds the
    map and its pyramid: half as much memory again as the map, until the widget is deleted.

    Examples
    --------
    >>> import numpy as np
    >>> w = explore(Surface(np.eye(5), dx=1e-3, dy=1e-3), a=(0, 0), b=(4e-3, 4e-3))
    >>> w.section.z.round(6).tolist()[::2]
    [1.0, 0.555556, 0.555556, 1.0]
    """
    known = (*_OPTIONS[_kind(obj)], "colours", "height")
    for name in options:
        if name not in known:
            raise DataError(
                f"there is no option {name!r} to explore a {type(obj).__name__}; there are "
                f"{', '.join(known)}"
            )
    return _widget_class()(Exploration(obj), **options)


_OPTIONS = {"map": ("a", "b", "band", "limits"), "profile": ("band", "window")}


def _kind(obj: object) -> str:
    return "profile" if isinstance(obj, Profile) else "map"


@cache
def widget_module() -> str:
    """Return the front end as the text of one ES module."""
    return linked_module("explore.js", _static)


@cache
def widget_style() -> str:
    """Return the style of the front end; it touches nothing outside of the widget."""
    page = _text("style.css")
    roots = re.findall(r":root\s*\{([^}]*)\}", page)
    parts = dict(re.findall(r"/\* (\w+) \*/\n(.*?)(?=\n/\* |\Z)", page, re.DOTALL))
    hidden = re.findall(r"^\[hidden\].*$", page, re.MULTILINE)
    if len(roots) != 2 or not hidden or any(name not in parts for name in _SHARED_STYLE):
        raise DataError("style.css lacks the colours of both schemes or a part on maps and plots")
    shared = "\n".join(parts[name] for name in _SHARED_STYLE)
    nested = "\n".join([_text("vendor/uPlot.min.css"), hidden[0], shared, _text("explore.css")])
    light, dark = roots
    return (
        f"{_SCOPE} {{{light}}}\n"
        f'{_SCOPE}[data-scheme="light"] {{ color-scheme: light; }}\n'
        f'{_SCOPE}[data-scheme="dark"] {{ color-scheme: dark; {dark} }}\n'
        f"{_SCOPE} {{\n{nested}\n}}\n"
    )


def _static(path: str) -> str | None:
    file = resources.files("metrosep.app").joinpath("static", *path.split("/"))
    return file.read_text(encoding="utf-8") if file.is_file() else None


def _text(path: str) -> str:
    found = _static(path)
    if found is None:
        raise DataError(f"the file {path} of the workbench is missing: install metrosep again")
    return found


def _pair(value: Any, what: str, *, rising: bool = False) -> tuple[float, float]:
    """Return two finite numbers."""
    one = two = math.nan
    if not isinstance(value, str | bytes):
        with contextlib.suppress(TypeError, ValueError):
            one, two = (float(v) for v in value)
    if not (math.isfinite(one) and math.isfinite(two)):
        raise DataError(f"{what} must be two finite numbers, got {value!r}")
    if rising and not one < two:
        raise DataError(f"{what} must rise, got {one:.9g} to {two:.9g}")
    return one, two


@cache
def _widget_class() -> Any:
    """Return the class of the widget; anywidget is loaded when the first one is made."""
    try:
        import anywidget
        import traitlets
    except ModuleNotFoundError as error:
        raise UnsupportedFeatureError(
            "explore() shows a widget in a notebook and needs anywidget, which is not installed: "
            'pip install "metrosep[notebook]"; `metrosep ui FILE` needs no notebook'
        ) from error

    class Numbers(traitlets.TraitType[Any, Any]):
        """Two numbers in m, or None."""

        def __init__(self, what: str, *, rising: bool = False, positive: bool = False) -> None:
            super().__init__(default_value=None, allow_none=True)
            self.what, self.rising, self.positive = what, rising, positive

        def validate(self, obj: Any, value: Any) -> tuple[float, float] | None:
            if value is None:
                return None
            pair = _pair(value, self.what, rising=self.rising)
            if self.positive and pair[0] <= 0.0:
                raise DataError(f"{self.what} must be positive, got {pair[0]:.9g}")
            return pair

    class ExploreWidget(anywidget.AnyWidget):  # type: ignore[misc,unused-ignore]
        """Map, section and spectrum, or profile and spectrum, in a notebook.

        Attributes
        ----------
        a, b : tuple of (float, float), m
            Ends of the section.
        band : tuple of (float, float), m
            Shortest and longest wavelength.
        limits : tuple of (float, float) or None, m
            Heights at the ends of the colours; None for the robust range.
        window : tuple of (float, float) or None, m
            Part of a profile that is shown.
        cursors : tuple of (float, float) or None
            Where the cursors of the section stand, parts of its length from a.
        colours : str
            "viridis" or "cividis".
        height : int
            Pixels of the screen.
        """

        _esm = widget_module()
        _css = widget_style()

        kind = traitlets.Unicode("map").tag(sync=True)
        colours = traitlets.Unicode("viridis").tag(sync=True)
        height = traitlets.Int(540).tag(sync=True)
        a = Numbers("a, an end of the section,").tag(sync=True)
        b = Numbers("b, an end of the section,").tag(sync=True)
        band = Numbers("the band of wavelengths", rising=True, positive=True).tag(sync=True)
        limits = Numbers("the limits of the colours", rising=True).tag(sync=True)
        window = Numbers("the window of the profile", rising=True).tag(sync=True)
        cursors = Numbers("the cursors of the section").tag(sync=True)
        view = traitlets.Dict().tag(sync=True)
        map_frame = traitlets.Bytes().tag(sync=True)
        section_frame = traitlets.Bytes().tag(sync=True)
        spectrum_frame = traitlets.Bytes().tag(sync=True)
        profile_frame = traitlets.Bytes().tag(sync=True)

        def __init__(self, exploration: Exploration, **options: Any) -> None:
            self._exploration = exploration
            self._seen: dict[str, tuple[Any, ...]] = {}
            first = {"cursors": _CURSORS, **options}
            if ends := exploration.first_section:
                first = {**dict(zip(("a", "b"), ends, strict=True)), **first}
            super().__init__(kind=exploration.kind, **first)
            if self.band is None:
                self.band = exploration.first_band(self.a, self.b)
            self._draw()

        @property
        def section(self) -> Profile:
            """The section from a to b at full resolution; the profile itself if it is one."""
            return self._exploration.line(self.a, self.b)

        @traitlets.validate("colours")
        def _known_colours(self, proposal: Any) -> Any:
            if proposal["value"] not in _COLOURS:
                raise DataError(f"colours are {' or '.join(_COLOURS)}, got {proposal['value']!r}")
            return proposal["value"]

        @traitlets.validate("height")
        def _seen_height(self, proposal: Any) -> Any:
            low, high = _HEIGHTS
            if not low <= proposal["value"] <= high:
                raise DataError(f"height must be {low} to {high} pixels, got {proposal['value']}")
            return proposal["value"]

        @traitlets.observe("a", "b", "band", "limits", "window", "view", "cursors")
        def _changed(self, change: Any) -> None:
            if self._seen:
                self._draw()

        def _draw(self) -> None:
            """Draw again what has changed, in one message."""
            wishes: dict[str, tuple[Any, ...]] = {"spectrum": (self.a, self.b, self.band)}
            if self.kind == "map":
                wishes |= {
                    "map": (self.view, self.limits),
                    "section": (self.a, self.b, self.cursors),
                }
            else:
                wishes["profile"] = (self.window,)
            with self.hold_sync():
                for picture, wish in wishes.items():
                    if self._seen.get(picture) != wish:
                        self._seen[picture] = wish
                        frame = getattr(self._exploration, picture)(*wish)
                        self.set_trait(f"{picture}_frame", frame)

    return ExploreWidget


# ---- `Exploration`: pictures of one map or profile in memory, as frames for a notebook ---------
# The same numbers as the page of the workbench gets from its server, from the same drawing modules,
# in the same frames (see `metrosep.app.wire`). It knows no notebook.

Pair = tuple[float, float]

_MARGIN = 0.08
"""Part of the width between the rim of the map and the ends of the first section."""

_CURSORS = (0.25, 0.75)
"""Where the cursors of the section stand first."""

_COLUMNS = 1000
"""Pixel columns of a line in a notebook; screens have no more there."""

_REFUSED = 2
"""Exit code of the command line for a request that cannot be met."""


class Exploration:
    """One map or profile with what its pictures are made of.

    Notes
    -----
    Each method gives one frame. What a picture refuses is a frame too, with the message: the other
    pictures go on. The number ``n`` of a header rises, so no two frames are alike.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.app.wire import unpack
    >>> shown = Exploration(Surface([[0.0, 1.0], [np.nan, 2.0]], dx=1e-3, dy=1e-3))
    >>> header, arrays = unpack(shown.map({"pixels": [2, 2]}, (0.0, 2.0)))
    >>> header["extent"], arrays["index"].tolist()
    ([-0.0005, -0.0005, 0.0015, 0.0015], [[0, 255], [1, 128]])
    """

    def __init__(self, obj: Surface | Profile) -> None:
        if not isinstance(obj, Surface | Profile):
            raise DataError(
                f"a Surface or a Profile can be explored, got {type(obj).__name__}; "
                "make one of it first"
            )
        self.obj = obj
        self._pyramid = build_pyramid(obj) if isinstance(obj, Surface) else None
        self._extremes = Extremes(obj) if isinstance(obj, Profile) else None
        self._transform: tuple[tuple[Pair, ...], ProfileSpectrum] | None = None
        self._n = 0

    @property
    def kind(self) -> str:
        """``"map"`` or ``"profile"``."""
        return "map" if isinstance(self.obj, Surface) else "profile"

    @property
    def first_section(self) -> tuple[Pair, Pair] | None:
        """Ends of the section that is shown first, m: a row through the middle of a map."""
        if self._pyramid is None:
            return None
        x0, y0, x1, y1 = self._pyramid.window
        room, y = _MARGIN * (x1 - x0), (y0 + y1) / 2.0
        return (x0 + room, y), (x1 - room, y)

    def line(self, a: Pair | None = None, b: Pair | None = None) -> Profile:
        """Return the profile itself, or the section of the map."""
        if isinstance(self.obj, Profile):
            return self.obj
        if a is None or b is None:
            raise DataError("a section of a map needs both of its ends, a and b")
        return section_profile(self.obj, a, b)

    def first_band(self, a: Pair | None = None, b: Pair | None = None) -> Pair | None:
        """Return the middle third of the wavelengths, on a logarithmic scale."""
        try:
            waves = 1.0 / self._transformed(a, b).frequency[1:]
        except MetrosepError:
            return None
        if waves.size < 2:
            return None
        long, short = math.log(waves[0]), math.log(waves[-1])
        third = (long - short) / 3.0
        return math.exp(short + third), math.exp(short + 2.0 * third)

    # ---- frames --------------------------------------------------------------------------------

    def map(self, view: Mapping[str, Any] | None = None, limits: Pair | None = None) -> bytes:
        """Return the picture of a window of the map."""
        wanted = view or {}

        def drawn() -> tuple[dict[str, Any], Arrays]:
            if self._pyramid is None:
                _refuse("this measurement is a profile, it has no map")
            found = map_view(
                self._pyramid,
                window=wanted.get("window"),
                pixels=wanted.get("pixels") or (512, 512),
                level=wanted.get("level") or "idle",
                limits=limits,
            )
            header, arrays = map_frame(found, self._pyramid.window)
            return {**header, "auto_range": self._pyramid.robust_range}, arrays

        return self._frame("map", drawn)

    def section(self, a: Pair, b: Pair, cursors: Pair | None = None) -> bytes:
        """Return the section from a to b, read from the map at full resolution."""

        def drawn() -> tuple[dict[str, Any], Arrays]:
            if not isinstance(self.obj, Surface):
                _refuse("this measurement is a profile, it has no sections")
            return section_frame(
                section_view(self.obj, a, b, columns=_COLUMNS, cursors=cursors or ())
            )

        return self._frame("section", drawn)

    def profile(self, window: Sequence[float] | None = None) -> bytes:
        """Return a window of the profile."""

        def drawn() -> tuple[dict[str, Any], Arrays]:
            if self._extremes is None:
                _refuse("this measurement is a map: ask for a section")
            found = profile_view(self._extremes, window=window, columns=_COLUMNS)
            return {"is_preview": False}, profile_arrays(found)

        return self._frame("profile", drawn)

    def spectrum(
        self, a: Pair | None = None, b: Pair | None = None, band: Pair | None = None
    ) -> bytes:
        """Return amplitude against wavelength, of the profile or of the section."""

        def drawn() -> tuple[dict[str, Any], Arrays]:
            found = spectrum_view(
                self._transformed(a, b), band=Band(*band) if band else None, columns=_COLUMNS
            )
            return spectrum_frame(found, unit=lateral_unit(self.obj))

        return self._frame("spectrum", drawn)

    def _transformed(self, a: Pair | None, b: Pair | None) -> ProfileSpectrum:
        """Return the transform of a line; that of the last line is kept while limits move."""
        place = () if a is None or b is None else (a, b)
        if self._transform is None or self._transform[0] != place:
            line = self.line(a, b)
            self._transform = place, profile_spectrum(line, unit=lateral_unit(self.obj))
        return self._transform[1]

    def _frame(self, kind: str, drawn: Callable[[], tuple[dict[str, Any], Arrays]]) -> bytes:
        self._n += 1
        try:
            header, arrays = drawn()
        except MetrosepError as error:
            return pack({"n": self._n, **error_header(str(error), code=_REFUSED, k=kind)})
        return pack({"n": self._n, "k": kind, "ok": True, **header}, arrays)


def _refuse(words: str) -> NoReturn:
    """Refuse a picture: the frame tells why."""
    raise DataError(words)


# ---- one text from several ES modules, for a notebook that takes a widget as a single text -----
# A small linker for the modules of our own `static` folder, not a bundler: each module becomes a
# function scope, in the order of import. What it does not understand it refuses.

_NAME = r"[A-Za-z_$][\w$]*"
_TOKEN = re.compile(
    r"(?P<comment>//[^\n]*|/\*.*?\*/)"
    r"|(?P<text>\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*')"
    r"|(?P<pattern>/(?:\\.|\[(?:\\.|[^\]\\\n])*\]|[^/\\\[\n*])(?:\\.|\[(?:\\.|[^\]\\\n])*\]|[^/\\\[\n])*/[a-z]*)"
    r"|(?P<word>[\w$]+)|(?P<space>\s+)|(?P<other>.)",
    re.DOTALL,
)
_BEFORE_PATTERN = frozenset(
    [
        "return",
        "typeof",
        "case",
        "in",
        "of",
        "do",
        "else",
        "void",
        "delete",
        "throw",
        "new",
        "instanceof",
    ]
)
"""Words after which a slash begins a regular expression and does not divide."""

_IMPORT = re.compile(
    rf"import\s+(?:(?P<default>{_NAME})\s*(?:,\s*)?)?(?:\{{(?P<names>[^}}]*)\}}\s*)?from\s*"
    r"(?P<quote>[\"'])(?P<path>[^\"']*)(?P=quote)\s*;"
)
_DECLARED = re.compile(
    rf"export\s+(?=(?:async\s+)?(?:function\s*\*?|class|const)\s+(?P<name>{_NAME}))"
)
_LISTED = re.compile(r"export\s*\{(?P<names>[^}]*)\}\s*;")
_DEFAULT = re.compile(r"export\s+default\s+(?!(?:async|function|class)\b)")
Pairs = tuple[tuple[str, str], ...]
"""Name as it is exported, and as it is called where it is used."""

_PAIR = re.compile(rf"(?P<one>{_NAME})(?:\s+as\s+(?P<other>{_NAME}))?")


@dataclass(frozen=True, slots=True)
class _Part:
    """What a module needs, what it gives, and its text without import and export."""

    needs: tuple[tuple[str, Pairs], ...]
    gives: Pairs
    body: str


def linked_module(entry: str, read: Callable[[str], str | None] | Mapping[str, str]) -> str:
    """Return one ES module that does what `entry` does with all that it imports.

    Notes
    -----
    A module is run once, after those that it imports, as a browser does it. Only what cannot
    change is exported (functions, classes, constants), so a copy of the binding is the binding.
    Names of different modules never meet: each has the scope of its own function.

    Examples
    --------
    >>> modules = {"a.js": 'import { b } from "./b.js"; export default b + 1;',
    ...            "b.js": "export const b = 1;"}
    >>> print(linked_module("a.js", modules))
    const module0 = (() => {
    const b = 1;
    return { b: b };
    })();
    const module1 = (() => {
    const { b: b } = module0;
     const exportedDefault = b + 1;
    return { default: exportedDefault };
    })();
    export default module1.default;
    """
    texts = read.get if isinstance(read, Mapping) else read
    done: dict[str, tuple[str, Pairs]] = {}
    lines: list[str] = []

    def add(path: str, above: tuple[str, ...]) -> None:
        if path in above:
            raise UnsupportedFeatureError(
                f"modules import one another in a circle: {' -> '.join((*above, path))}"
            )
        if path in done:
            return
        text = texts(path)
        if text is None:
            raise DataError(
                f"there is no module {path}, which {above[-1] if above else 'you'} asks for"
            )
        part = _parted(path, text)
        for needed, _ in part.needs:
            add(needed, (*above, path))
        name = f"module{len(done)}"
        done[path] = name, part.gives
        lines.append(f"const {name} = (() => {{")
        for needed, pairs in part.needs:
            home, given = done[needed]
            for wanted in dict(pairs).keys() - dict(given).keys():
                raise DataError(f"{path} imports {wanted} from {needed}, which does not export it")
            lines.append(f"const {_listed(pairs)} = {home};")
        lines.extend([part.body.strip("\n"), f"return {_listed(part.gives)};", "})();"])

    add(entry, ())
    name, given = done[entry]
    if "default" not in dict(given):
        raise DataError(f"{entry} has no default export")
    return "\n".join([*lines, f"export default {name}.default;"])


def masked_code(text: str, path: str = "module") -> tuple[str, str]:
    """Return JavaScript without comments, and the same with blanks for what is not code.

    Examples
    --------
    >>> masked_code("a = 'import'; // import")
    ("a = 'import'; ", 'a =         ; ')
    """
    kept: list[str] = []
    mask: list[str] = []
    open_: list[str] = []  # brackets; "`" for an expression within a template
    last = ""

    def put(piece: str, *, code: bool) -> None:
        kept.append(piece)
        mask.append(piece if code else re.sub(r"[^\n]", " ", piece))

    def template(at: int) -> int:
        """Put the text of a template from `at`; return where code goes on."""
        found = re.compile(r"(?:\\.|\$(?!\{)|[^`\\$])*(`|\$\{)", re.DOTALL).match(text, at)
        if found is None:
            raise DataError(f"{path}: a template does not end")
        put(found.group(0), code=False)
        if found.group(1) == "${":
            open_.append("`")
        return found.end()

    at = 0
    while at < len(text):
        found = _TOKEN.match(text, at)
        if found is None:  # pragma: no cover - any character matches "other"
            raise DataError(f"{path}: cannot read on at character {at}")
        kind, piece = str(found.lastgroup), found.group(0)
        if kind == "pattern" and not (
            not last or last in "(,=:[!&|?{};+-*%<>~^" or last in _BEFORE_PATTERN
        ):
            kind, piece = "other", "/"
        at += len(piece)
        if kind == "comment":
            if "opyright" in piece:
                put(piece, code=False)
            elif piece.startswith("/*"):
                put("\n" if "\n" in piece else " ", code=True)
            continue
        if kind in ("text", "pattern"):
            put(piece, code=False)
            last = ")"  # a value: what follows divides
        elif piece == "`":
            put(piece, code=False)
            at = template(at)
            last = "(" if open_ and open_[-1] == "`" and text[at - 1] == "{" else ")"
        elif piece == "}" and open_ and open_[-1] == "`":
            open_.pop()
            put(piece, code=False)
            at = template(at)
            last = "(" if open_ and open_[-1] == "`" and text[at - 1] == "{" else ")"
        else:
            if piece in ("'", '"'):
                raise DataError(f"{path}: a string does not end: {text[at - 1 : at + 30]!r}")
            if piece == "/" and text[at : at + 1] == "*":
                raise DataError(f"{path}: a comment does not end")
            if piece in "([{":
                open_.append(piece)
            elif piece in ")]}" and (not open_ or open_.pop() + piece not in ("()", "[]", "{}")):
                raise DataError(f"{path}: a bracket {piece} closes nothing")
            put(piece, code=True)
            last = last if kind == "space" else piece
    if open_:
        raise DataError(f"{path}: a bracket {open_[-1]} is not closed")
    return "".join(kept), "".join(mask)


def _parted(path: str, text: str) -> _Part:
    """Return what a module imports and exports, and the rest of its text."""
    kept, mask = masked_code(text, path)
    spare = "exportedDefault"
    while spare in mask:
        spare += "_"
    needs: list[tuple[str, Pairs]] = []
    gives: list[tuple[str, str]] = []
    cuts: list[tuple[int, int, str]] = []
    for keyword in re.finditer(r"(?<![\w$.])(?:import|export)(?![\w$]|\s*:)", mask):
        at = keyword.start()
        if kept.startswith("import", at):
            found = _IMPORT.match(kept, at)
            if found is None or not (found["default"] or found["names"] is not None):
                _modules_refuse(path, kept, at)
            needs.append((_joined(path, found["path"]), _imported(path, found)))
            cuts.append((*found.span(), ""))
        elif found := _LISTED.match(mask, at):
            gives += [(theirs, ours) for ours, theirs in _pairs(path, found["names"])]
            cuts.append((*found.span(), ""))
        elif found := _DEFAULT.match(mask, at):
            gives.append(("default", spare))
            cuts.append((*found.span(), f"const {spare} = "))
        elif (found := _DECLARED.match(mask, at)) and not _declares_more(mask, found.end()):
            gives.append((found["name"], found["name"]))
            cuts.append((*found.span(), ""))
        else:
            _modules_refuse(path, kept, at)
    for start, stop, put in reversed(cuts):
        kept = kept[:start] + put + kept[stop:]
    return _Part(
        tuple(needs),
        tuple(gives),
        re.sub(r"[ \t]+\n|\n{2,}", "\n", kept) if "`" not in kept else kept,
    )


def _imported(path: str, found: re.Match[str]) -> Pairs:
    first = () if found["default"] is None else (("default", found["default"]),)
    return (*first, *_pairs(path, found["names"] or ""))


def _declares_more(mask: str, at: int) -> bool:
    """Return whether ``const a = 1, b = 2`` declares several names."""
    if not mask.startswith("const", at):
        return False
    depth = 0
    for sign in mask[at:]:
        depth += (sign in "([{") - (sign in ")]}")
        if depth == 0 and sign in ",;":
            return sign == ","
    return False


def _listed(pairs: Pairs) -> str:
    return f"{{ {', '.join(f'{theirs}: {ours}' for theirs, ours in pairs)} }}"


def _pairs(path: str, names: str) -> Pairs:
    """Return the names on both sides of each ``as``."""
    pairs = []
    for name in (n.strip() for n in names.split(",") if n.strip()):
        found = _PAIR.fullmatch(name)
        if found is None:
            raise UnsupportedFeatureError(f"{path}: {name!r} cannot be linked")
        pairs.append((found["one"], found["other"] or found["one"]))
    return tuple(pairs)


def _joined(path: str, wanted: str) -> str:
    if not wanted.startswith(("./", "../")):
        raise UnsupportedFeatureError(
            f"{path} imports {wanted!r}: only modules beside it can be linked, by ./ or ../"
        )
    parts: list[str] = []
    for piece in (PurePosixPath(path).parent / wanted).parts:
        if piece != "..":
            parts.append(piece)
        elif parts:
            parts.pop()
        else:
            raise UnsupportedFeatureError(f"{path} imports {wanted!r}, which leaves the folder")
    return "/".join(parts)


def _modules_refuse(path: str, text: str, at: int) -> NoReturn:
    line = text[at:].partition("\n")[0][:80]
    raise UnsupportedFeatureError(
        f"{path}: {line!r} cannot be linked; write import {{ a }} from or import a from a relative "
        "path, export function, class, const, export default of a value, or export { a }"
    )
