"""`Surface`: heights z on a rectangular grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, Heights, frozen_float, position
from metrosep.core._thumbnails import map_thumbnail
from metrosep.core.arithmetic import HeightArithmetic
from metrosep.core.attached import attached
from metrosep.core.errors import DataError, Example, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.core.profile import html_summary
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.public import Guessed, PublicObject
from metrosep.core.units import format_ends, format_length

if TYPE_CHECKING:
    from metrosep.core.profile import Profile

_SAME_PIXEL = 1e-6
"""Of a step: a pixel that lies outside by less is inside."""


def _checked_step(value: float | str | None, name: str) -> float | None:
    why = "a lateral step that the instrument did not calibrate is None"
    return None if value is None else positive(value, name, dimension="length", why=why)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Surface(Heights, HeightArithmetic, Guessed, PublicObject):
    """Heights on a grid; frozen, SI, NaN = not measured.

    Row index grows with y and column index with x, z points out of the material: ``z[0, 0]`` is
    the corner of smallest x and y. Readers turn files that store the top row first and record the
    file's own order in ``metadata["row_order_in_file"]``.

    Parameters
    ----------
    z : array_like, shape (n_y, n_x), m
        Heights; NaN where not measured.
    dx, dy : float (m), str with unit, or None
        Lateral steps, > 0; ``None`` where the instrument was not calibrated. ``dy=None`` with a
        given ``dx`` means not calibrated in y: square pixels are never assumed.
    origin : tuple of (float, float), m, optional
        Position of ``z[0, 0]``.
    metadata : mapping, optional
        What the file said.
    history : tuple of Step, optional
        Where it came from.

    Raises
    ------
    InvalidSamplesError
        If z is not two-dimensional, is infinite somewhere, or a step is not positive.
    OptionError
        If a step or the origin is not a number (True, an array, a complex number).
    UnitError
        If a text has no unit of length.

    Notes
    -----
    ``numpy.asarray(surface)`` is `z`, which cannot be written to.

    Examples
    --------
    >>> import numpy as np
    >>> Surface([[0, 1e-9], [np.nan, 2e-9]], dx=1e-6, dy=2e-6)
    Surface(2 x 2, 1 um x 2 um steps, z 0 ... 2 nm, 25.0 % not measured)
    """

    z: FloatArray
    dx: float | None = None
    dy: float | None = None
    origin: tuple[float, float] = (0.0, 0.0)
    metadata: Mapping[str, Any] = field(default_factory=dict)
    history: tuple[Step, ...] = ()

    def __init__(
        self,
        z: ArrayLike,
        dx: float | str | None = None,
        dy: float | str | None = None,
        *,
        origin: tuple[float | str, float | str] = (0.0, 0.0),
        metadata: Mapping[str, Any] | None = None,
        history: tuple[Step, ...] = (),
    ) -> None:
        object.__setattr__(self, "z", frozen_float(z, name="z", ndim=2))
        object.__setattr__(self, "dx", _checked_step(dx, "dx"))
        object.__setattr__(self, "dy", _checked_step(dy, "dy"))
        object.__setattr__(self, "origin", position(origin, "origin"))
        object.__setattr__(self, "metadata", freeze_mapping(metadata))
        object.__setattr__(self, "history", tuple(history))

    def _with_heights(self, z: FloatArray, step: Step) -> Surface:
        return Surface(
            z,
            self.dx,
            self.dy,
            origin=self.origin,
            metadata=self.metadata,
            history=(*self.history, step),
        )

    def _grid(self) -> tuple[tuple[FloatArray, float], ...]:
        axes = zip(self.shape[::-1], (self.dx, self.dy), self.origin, strict=True)
        return tuple(
            (start + np.array([0.0, n - 1.0]) * (step or 0.0), np.nan if step is None else step)
            for n, step, start in axes
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, ``(n_y, n_x)``."""
        return (int(self.z.shape[0]), int(self.z.shape[1]))

    def crop(
        self,
        x: tuple[float | str, float | str] | None = None,
        y: tuple[float | str, float | str] | None = None,
    ) -> Surface:
        """Return the part between positions, both included.

        Parameters
        ----------
        x, y : pair of float (m) or str with unit, optional
            Least and greatest position; the whole extent if omitted.

        Returns
        -------
        Surface
            The pixels whose centres lie inside, with the origin of the first of them.

        Raises
        ------
        DataError
            If the map has no lateral step along that axis.
        OptionError
            If two positions are not given.
        TooFewSamplesError
            If no pixel lies inside.

        Examples
        --------
        >>> Surface([[0.0, 1e-9, 2e-9]], dx=1e-3, dy=1e-3).crop(x=("0.5 mm", "5 mm")).z.tolist()
        [[1e-09, 2e-09]]
        """
        columns, x0 = self._between(x, "x", 0)
        rows, y0 = self._between(y, "y", 1)
        facts = {f"{k}_m": [*position(v, k)] for k, v in (("x", x), ("y", y)) if v is not None}
        return Surface(
            self.z[rows, columns],
            self.dx,
            self.dy,
            origin=(x0, y0),
            metadata=self.metadata,
            history=(*self.history, Step("crop", facts)),
        )

    def _between(self, ends: Any, name: str, axis: int) -> tuple[slice, float]:
        """Return the pixels between two positions along an axis, and the position of the first."""
        n, step, start = self.shape[1 - axis], (self.dx, self.dy)[axis], self.origin[axis]
        if ends is None:
            return slice(0, n), start
        if step is None:
            raise DataError(f"the map has no lateral step along {name}: crop needs positions")
        low, high = position(ends, name)
        first = max(math.ceil((low - start) / step - _SAME_PIXEL), 0)
        last = min(math.floor((high - start) / step + _SAME_PIXEL), n - 1)
        if first > last:
            raise TooFewSamplesError(
                f"no pixel between {name} = {format_length(low)} and {format_length(high)}; the map "
                f"spans {format_ends(start, start + step * (n - 1), between=' to ')}"
            )
        return slice(first, last + 1), start + step * first

    def __repr__(self) -> str:
        valid = self.z[~np.isnan(self.z)]
        steps = (
            "lateral steps not calibrated"
            if self.dx is None and self.dy is None
            else f"{format_length(self.dx)} x {format_length(self.dy)} steps"
        )
        heights = (
            f"z {format_ends(float(valid.min()), float(valid.max()))}"
            if valid.size
            else "nothing measured"
        )
        gaps = (
            f", {100.0 * self.n_invalid / self.z.size:.1f} % not measured"
            if self.n_invalid
            else ""
        )
        rows, columns = self.shape
        return f"Surface({rows} x {columns}, {steps}, {heights}{gaps})"

    def _repr_html_(self) -> str:
        """Return a thumbnail and a small table for notebooks."""
        rows, columns = self.shape
        picture, span = map_thumbnail(self.z, self.dx, self.dy)
        table = {
            "shape (rows y, columns x)": f"{rows} × {columns}",
            "dx, dy": f"{format_length(self.dx)}, {format_length(self.dy)}",
            "P-V (nothing removed)": format_length(self.peak_to_valley()),
            "Sq about the mean": format_length(self.rms()),
            "not measured": f"{self.n_invalid} of {self.z.size}",
        }
        if span is not None:
            table["colours"] = " ... ".join(format_length(v) for v in span)
        return html_summary("Surface", table, picture, self.history)

    def section(
        self,
        a: tuple[float | str, float | str],
        b: tuple[float | str, float | str],
        *,
        width: float | str | None = None,
        method: Literal["lanczos", "bilinear", "nearest"] = "lanczos",
    ) -> Profile:
        """Return the heights along a line, or their mean across a band.

        Parameters
        ----------
        a, b : tuple of two float (m) or str with unit
            x and y of its ends; or pixels, ``("10 px", "25 px")``, from 0 at the first one.
        width : float (m) or str with unit, optional
            Of the band: the mean of n = 2 floor(width / 2s) + 1 parallel lines, s the smaller step.
            A line with a gap leaves its mirror image out too; half of them or more must remain.
        method : {"lanczos", "bilinear", "nearest"}, optional
            Between pixels. Lanczos keeps waves from 3 pixels on within 1 %, bilinear does not
            overshoot at steps, nearest repeats pixels. None fills a gap.

        Returns
        -------
        Profile
            Over the distance from a; its history says which share had gaps beside it. On a map without
            lateral steps x counts pixels, as its `lateral_unit` says.

        Raises
        ------
        DataError
            If the ends are the same or more than 10 million samples apart, or the map has no lateral steps
            and they are not in px.

        Examples
        --------
        >>> plane = Surface([[0.0, 1.0], [2.0, 3.0]], dx=1.0, dy=1.0)
        >>> plane.section((0.0, 0.0), (0.6, 0.8)).z.round(12).tolist()
        [0.0, 2.2]
        """
        from metrosep.core.sections import require_units, section_profile

        require_units(self, a, b, width)
        return section_profile(self, a, b, width=width, method=method)

    def circle_section(
        self, centre: tuple[float | str, float | str], radius: float | str
    ) -> Profile:
        """Return the heights along a circle, from +x to +y, without the first point again.

        Parameters
        ----------
        centre : tuple of two float (m) or str with unit
            x and y; or pixels, ``("10 px", "25 px")``.
        radius : float (m) or str with unit
            Of the circle; of one in pixels, too.

        Returns
        -------
        Profile
            Over the length of the arc; ceil(2 pi r / min(dx, dy)) samples at equal angles. On a map
            without lateral steps x counts pixels, as its `lateral_unit` says.

        Raises
        ------
        DataError
            If the radius is not positive, the circle has more than 10 million samples, or the map has no
            lateral steps and it is not in px.

        Examples
        --------
        >>> plane = Surface([[0.0, 1.0, 2.0]] * 3, dx=1.0, dy=1.0)
        >>> len(plane.circle_section((1.0, 1.0), 1.0))
        7
        """
        from metrosep.core.sections import circle_section, require_units

        require_units(self, centre, radius)
        return circle_section(self, centre, radius)

    def explore(self, **options: Any) -> Any:
        """Show the map, a section and its spectrum in a notebook.

        Parameters
        ----------
        **options
            ``a``, ``b``: ends (x, y) of the section, m; ``band``: shortest and longest wavelength,
            m; ``limits``: heights at the ends of the colours, m; ``colours``: "viridis" or
            "cividis"; ``height``: pixels of the screen.

        Returns
        -------
        ExploreWidget
            With these as attributes, which follow the hand and may be set, and ``section``: the
            `Profile` from a to b at full resolution.

        Raises
        ------
        UnsupportedFeatureError
            If anywidget is not installed: ``pip install "metrosep[notebook]"``.
        DataError
            If an option is unknown or its value is wrong.

        Examples
        --------
        >>> surface = Surface([[0.0, 1e-9], [2e-9, 3e-9]], dx=1e-3, dy=1e-3)
        >>> widget = surface.explore(a=(0.0, 0.0), b=(1e-3, 1e-3))
        >>> widget.section.z[-1].item()
        3e-09
        """
        return attached.explore(self, **options)


def lateral_steps(surface: Surface, so: str = "") -> tuple[float, float]:
    """Return both lateral steps of a map, m; refuse a map without, with what follows from that."""
    if surface.dx is None or surface.dy is None:
        raise DataError(
            f"the surface has no lateral step in both axes{so}: read the file with lateral_step=..."
        ).hinting(lateral_step=Example("3 um"))
    return surface.dx, surface.dy
