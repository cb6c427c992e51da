"""`Profile`: heights z along positions x."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, Heights, frozen_float, same_length, way
from metrosep.core._thumbnails import png_image, profile_thumbnail
from metrosep.core.arithmetic import HeightArithmetic
from metrosep.core.attached import attached
from metrosep.core.errors import (
    DataError,
    Example,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.numbers import quantity
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.public import Guessed, PublicObject
from metrosep.core.units import PIXEL, Pixels, format_ends, format_length

_UNIFORM_RTOL = 1e-6
"""Largest deviation of a step from the mean step, relative, for a grid to count as uniform."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Profile(Heights, HeightArithmetic, Guessed, PublicObject):
    """Heights along a line; frozen, SI, NaN = not measured.

    Parameters
    ----------
    x : array_like, shape (n,), m
        Positions, finite and strictly monotonic; descending positions are turned round together
        with `z`.
    z : array_like, shape (n,), m
        Heights, out of the material; NaN where not measured.
    metadata : mapping, optional
        What the file said; ``lateral_unit`` is "px" where x counts the pixels of a map without scale.
    history : tuple of Step, optional
        Where it came from.

    Raises
    ------
    InvalidSamplesError
        If the lengths differ, a position is not finite, or positions are not strictly monotonic.
    TooFewSamplesError
        If there is no sample.

    Examples
    --------
    >>> import numpy as np
    >>> Profile(np.linspace(0, 1e-3, 5), [0, 1e-9, np.nan, 0, 0])
    Profile(5 samples, 1 mm, step 250 um, z 0 ... 1 nm, 1 not measured)
    """

    x: FloatArray
    z: FloatArray
    metadata: Mapping[str, Any] = field(default_factory=dict)
    history: tuple[Step, ...] = ()

    def __init__(
        self,
        x: ArrayLike,
        z: ArrayLike,
        *,
        metadata: Mapping[str, Any] | None = None,
        history: tuple[Step, ...] = (),
    ) -> None:
        xs = frozen_float(x, name="x", ndim=1)
        zs = frozen_float(z, name="z", ndim=1)
        same_length(x=xs, z=zs)
        if np.isnan(xs).any():
            raise InvalidSamplesError(
                f"position x is NaN at index {int(np.flatnonzero(np.isnan(xs))[0])}; a height "
                "without a position cannot be used: drop the sample"
            )
        direction = way(xs)
        if direction < 0:
            xs, zs = (
                frozen_float(xs[::-1], name="x", ndim=1),
                frozen_float(zs[::-1], name="z", ndim=1),
            )
        elif not direction and xs.size > 1:
            steps = np.diff(xs)
            i = int(np.flatnonzero(steps <= 0)[0] if (steps > 0).sum() > 0 else 0)
            raise InvalidSamplesError(
                f"positions x are not strictly monotonic: x[{i}] = {xs[i]:.9g} m, "
                f"x[{i + 1}] = {xs[i + 1]:.9g} m; split the run at its turning points or remove "
                "the repeated encoder counts"
            )
        object.__setattr__(self, "x", xs)
        object.__setattr__(self, "z", zs)
        object.__setattr__(self, "metadata", freeze_mapping(metadata))
        object.__setattr__(self, "history", tuple(history))

    def _with_heights(self, z: FloatArray, step: Step) -> Profile:
        return Profile(self.x, z, metadata=self.metadata, history=(*self.history, step))

    def _grid(self) -> tuple[tuple[FloatArray, float], ...]:
        return ((self.x, float(np.ptp(self.x)) / max(self.x.size - 1, 1)),)

    def __len__(self) -> int:
        return int(self.x.size)

    @property
    def is_uniform(self) -> bool:
        """Whether the step is the same everywhere, to 1e-6 of the mean step."""
        steps = np.diff(self.x)
        if steps.size == 0:
            return False
        mean = (self.x[-1] - self.x[0]) / steps.size
        return bool(np.abs(steps - mean).max() <= _UNIFORM_RTOL * mean)

    @property
    def lateral_unit(self) -> Literal["m", "px"]:
        """Unit of x: "px" of a section of a map whose pixels have no known size."""
        return "px" if self.metadata.get("lateral_unit") == PIXEL else "m"

    def require_metres(self) -> None:
        """Refuse a profile whose x counts pixels, where a length along x is taken of it.

        Raises
        ------
        DataError
            If `lateral_unit` is "px".
        """
        if self.lateral_unit == PIXEL:
            raise DataError(
                "x of the profile counts pixels, so that nothing which needs a length along it can be "
                "given; give the map its lateral_step where it is read"
            ).hinting(lateral_step=Example("3 um"))

    def _said(self, along: float) -> str:
        """Return a length along x with its unit."""
        return format_length(along if self.lateral_unit == "m" else Pixels(along))

    @property
    def step(self) -> float:
        """Step of a uniform profile in the unit of x, `lateral_unit`.

        Raises
        ------
        NotUniformError
            If the positions are not uniform.
        """
        if not self.is_uniform:
            steps = np.diff(self.x)
            if steps.size == 0:
                raise NotUniformError("a profile of one sample has no step dx")
            mean = float(self.x[-1] - self.x[0]) / steps.size
            off = float(np.abs(steps - mean).max())
            raise NotUniformError(
                "the steps of the profile are not uniform: they depart from their mean "
                f"{self._said(mean)} by up to {self._said(off)}, {100.0 * off / mean:.3g} % of it, "
                "where 0.0001 % is allowed; if x was only rounded, read the heights alone with "
                "z=... and lateral_step=..., else resample them with numpy.interp"
            )
        return float((self.x[-1] - self.x[0]) / (self.x.size - 1))

    @property
    def dx(self) -> float:
        """Step in m of a uniform profile.

        Raises
        ------
        DataError
            If x counts pixels.
        NotUniformError
            If the positions are not uniform.
        """
        self.require_metres()
        return self.step

    def crop(self, start: float | str, stop: float | str) -> Profile:
        """Return the part with ``start <= x <= stop``.

        Parameters
        ----------
        start, stop : float (m) or str with unit
            Limits, ``start < stop``.

        Returns
        -------
        Profile
            The samples inside.

        Raises
        ------
        TooFewSamplesError
            If no sample lies inside.
        DataError
            If x counts pixels.
        """
        self.require_metres()
        start, stop = (quantity(v, k, "length") for v, k in ((start, "start"), (stop, "stop")))
        keep = (self.x >= start) & (self.x <= stop)
        if not keep.any():
            raise TooFewSamplesError(
                f"no sample between {format_length(start)} and {format_length(stop)}; the profile "
                f"spans {format_ends(float(self.x[0]), float(self.x[-1]), between=' to ')}"
            )
        step = Step("crop", {"start_m": start, "stop_m": stop})
        return Profile(
            self.x[keep], self.z[keep], metadata=self.metadata, history=(*self.history, step)
        )

    def remove_line(self) -> Profile:
        """Return the profile without its least-squares line.

        Returns
        -------
        Profile
            Residual from the line through the valid samples.

        Raises
        ------
        TooFewSamplesError
            If fewer than two samples are valid.
        """
        valid = ~np.isnan(self.z)
        if valid.sum() < 2:
            raise TooFewSamplesError(f"a line needs 2 valid samples, got {int(valid.sum())}")
        centre = self.x[valid].mean()
        scale = max(float(np.ptp(self.x[valid])), np.finfo(float).tiny)
        basis = np.column_stack([np.ones(self.x.size), (self.x - centre) / scale])
        coefficients = np.linalg.lstsq(basis[valid], self.z[valid], rcond=None)[0]
        slope = "slope_rad" if self.lateral_unit == "m" else "slope_m_per_px"
        step = Step("remove_line", {slope: float(coefficients[1] / scale)})
        return Profile(
            self.x,
            self.z - basis @ coefficients,
            metadata=self.metadata,
            history=(*self.history, step),
        )

    def __repr__(self) -> str:
        valid = self.z[~np.isnan(self.z)]
        span = self._said(float(np.ptp(self.x)))
        step = f"step {self._said(self.step)}" if self.is_uniform else "step not uniform"
        heights = (
            f"z {format_ends(float(valid.min()), float(valid.max()))}"
            if valid.size
            else "nothing measured"
        )
        gaps = f", {self.n_invalid} not measured" if self.n_invalid else ""
        return f"Profile({self.x.size} samples, {span}, {step}, {heights}{gaps})"

    def _repr_html_(self) -> str:
        """Return a thumbnail and a small table for notebooks."""
        rows = {
            "samples": str(len(self)),
            "from": self._said(float(self.x[0])),
            "to": self._said(float(self.x[-1])),
            "P-V (nothing removed)": format_length(self.peak_to_valley()),
            "RMS about the mean": format_length(self.rms()),
            "not measured": str(self.n_invalid),
        }
        return html_summary("Profile", rows, profile_thumbnail(self.x, self.z), self.history)

    def explore(self, **options: Any) -> Any:
        """Show the profile and its spectrum in a notebook.

        Parameters
        ----------
        **options
            ``band``: shortest and longest wavelength, m; ``window``: part of the profile that is
            shown, m; ``height``: pixels of the screen.

        Returns
        -------
        ExploreWidget
            With these as attributes, which follow the hand and may be set.

        Raises
        ------
        UnsupportedFeatureError
            If anywidget is not installed: ``pip install "metrosep[notebook]"``.
        DataError
            If an option is unknown or its value is wrong.

        Examples
        --------
        >>> widget = Profile(np.arange(99.0), np.arange(99.0) % 7).explore(band=(5.0, 9.0))
        >>> widget.band
        (5.0, 9.0)
        """
        return attached.explore(self, **options)


def html_summary(
    title: str, rows: Mapping[str, str], picture: bytes, history: tuple[Step, ...]
) -> str:
    """Return a picture, a table and a history that opens, as HTML."""
    steps = "".join(
        f"<li><b>{escape(step.name)}</b> "
        f"{escape(', '.join(f'{k} = {v}' for k, v in step.parameters.items()))}</li>"
        for step in history
    )
    names = " → ".join(step.name for step in history) or "made in memory"
    past = f"<summary>history: {escape(names)}</summary><ol>{steps}</ol>" if steps else ""
    return (
        "<div style='display:flex;gap:1em;align-items:flex-start;flex-wrap:wrap'>"
        f"{png_image(picture, title)}<div>{html_table(title, rows)}"
        f"{f'<details>{past}</details>' if past else f'<p>history: {escape(names)}</p>'}</div></div>"
    )


def html_table(title: str, rows: Mapping[str, str]) -> str:
    """Return a two-column HTML table."""
    body = "".join(
        f"<tr><th style='text-align:left;padding-right:1em'>{escape(k)}</th><td>{escape(v)}</td></tr>"
        for k, v in rows.items()
    )
    return f"<table><caption><b>{escape(title)}</b></caption>{body}</table>"
