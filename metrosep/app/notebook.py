"""`explore`: the map, section and spectrum of the workbench in a notebook, by anywidget.

The page of the workbench and the notebook share their widgets. A notebook takes a widget as one
text, so the modules are linked when the first widget is made (`metrosep.app.linked_modules`).
Nothing is asked of any other computer.
"""

from __future__ import annotations

import contextlib
import math
import re
from functools import cache
from importlib import resources
from typing import Any

from metrosep.app.explorations import Exploration
from metrosep.app.linked_modules import linked_module
from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

__all__ = ["explore", "widget_module", "widget_style"]

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
        view = traitlets.Dict().tag(sync=True)
        map_frame = traitlets.Bytes().tag(sync=True)
        section_frame = traitlets.Bytes().tag(sync=True)
        spectrum_frame = traitlets.Bytes().tag(sync=True)
        profile_frame = traitlets.Bytes().tag(sync=True)

        def __init__(self, exploration: Exploration, **options: Any) -> None:
            self._exploration = exploration
            self._seen: dict[str, tuple[Any, ...]] = {}
            first = dict(options)
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

        @traitlets.observe("a", "b", "band", "limits", "window", "view")
        def _changed(self, change: Any) -> None:
            if self._seen:
                self._draw()

        def _draw(self) -> None:
            """Draw again what has changed, in one message."""
            wishes: dict[str, tuple[Any, ...]] = {"spectrum": (self.a, self.b, self.band)}
            if self.kind == "map":
                wishes |= {"map": (self.view, self.limits), "section": (self.a, self.b)}
            else:
                wishes["profile"] = (self.window,)
            with self.hold_sync():
                for picture, wish in wishes.items():
                    if self._seen.get(picture) != wish:
                        self._seen[picture] = wish
                        frame = getattr(self._exploration, picture)(*wish)
                        self.set_trait(f"{picture}_frame", frame)

    return ExploreWidget
