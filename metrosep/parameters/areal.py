"""Areal parameters of a map after ISO 25178-2:2021, in one table.

The map is taken as it is: form removed and filtered by others. Heights count from the mean of the
valid pixels; nothing else is removed. Only what is asked is computed, and what several parameters
share (moments, sorted heights, slopes, autocorrelation, peaks) is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.parameters._rows import Row, chosen_rows, evaluated
from metrosep.parameters.areal_heights import HeightStatistics, height_statistics
from metrosep.parameters.autocorrelation import (
    Autocorrelation,
    CentralLobe,
    autocorrelation,
    central_lobe,
    texture_direction,
)
from metrosep.parameters.gradients import GradientStatistics, gradient_statistics
from metrosep.parameters.material_ratio import (
    AbbottCurve,
    CoreHeight,
    CoreLine,
    abbott_curve,
    core_height,
)
from metrosep.parameters.table import Context, ParameterTable
from metrosep.parameters.volumes import Volumes, volumes
from metrosep.parameters.watershed import (
    LARGEST_HOLE,
    Peaks,
    five_point_height,
    mean_peak_curvature,
    significant_peaks,
)
from metrosep.spectral._checks import instance_of, real_number

__all__ = ["EDITION", "ArealParameterTable", "areal_parameters", "is_form_removed"]

EDITION = "ISO 25178-2:2021"
"""Whose definitions the table follows."""

_ALIASES = {"Smrk1": "Smr1", "Smrk2": "Smr2"}
"""Symbols of 2021 that stand in the table under the older ones."""

_FEATURES = {"S5p", "S5v", "S10z", "Spd", "Spc"}
"""Parameters of peaks and pits, from the segmentation."""

_CONSTANT = "all valid heights are equal, so Sq is zero and the ratio is not defined"


class ArealParameterTable(ParameterTable):
    """Areal parameters; Smrk1 and Smrk2 find Smr1 and Smr2.

    Parameters
    ----------
    quantities : sequence of Quantity
        Each with its symbol.
    context : Context
        Edition, filter chain, valid share, settings.
    unavailable : mapping of str to str, optional
        Symbols that could not be evaluated, each with the reason and what to do.

    Examples
    --------
    >>> from metrosep.core.quantity import Quantity
    >>> table = ArealParameterTable([Quantity(0.1, "1", "material ratio", symbol="Smr1")],
    ...                             Context(EDITION, n_valid=4, n_total=4))
    >>> table["Smrk1"].value, "Smrk1" in table, list(table)
    (0.1, True, ['Smr1'])
    """

    __slots__ = ()

    def own_symbol(self, symbol: str) -> str:
        """Return the symbol under which the table holds a parameter.

        Parameters
        ----------
        symbol : str
            Such as Smrk1.

        Returns
        -------
        str
            Such as Smr1.
        """
        return _ALIASES.get(symbol, symbol)


def areal_parameters(
    surface: Surface,
    *,
    names: Sequence[str] | None = None,
    line: CoreLine = "lsq",
    pruning: float = 0.05,
) -> ArealParameterTable:
    """Return the areal parameters of a map.

    Parameters
    ----------
    surface : Surface
        Form removed and filtered as the specification asks. Nothing is filtered here.
    names : sequence of str, optional
        Symbols wanted; all by default. What is not asked is not computed. Smrk1 and Smrk2 find
        Smr1 and Smr2, here and in the table.
    line : {"lsq", "secant"}, optional
        Core line of the Sk family.
    pruning : float, optional
        Wolf pruning of peaks and pits as a share of Sz, 0 to below 1.

    Returns
    -------
    ArealParameterTable
        In SI and in the order of the standard: ratios are numbers from 0 to 1 and not per cent
        (Sdr, Str, Smr1, Smr2), angles are in rad, volumes in m^3/m^2 = m. What cannot be given is
        listed in ``unavailable`` with the reason.

    Raises
    ------
    DataError
        If a name or the line is unknown, `pruning` is not a share, an argument is of the wrong
        type, a height is beyond 1e60 m, or their range is below 1e-60 m and not zero.
    InvalidSamplesError
        If no pixel is valid.

    Notes
    -----
    About the mean of the valid pixels, each with the same weight. NaN is never filled. Without
    lateral steps the heights, the core family and the volumes still come. The most costly are
    S10z, Spd, Spc (watershed), then Sal, Str, Std (FFT), then the core family (one sort).

    References
    ----------
    .. [1] ISO 25178-2:2021 and the defaults of ISO 25178-3:2012 (clauses recalled, not checked).

    Examples
    --------
    >>> import numpy as np
    >>> c = 50e-9 * np.cos(2 * np.pi * np.arange(500) / 100)
    >>> grid = Surface(c[:, None] + c[None, :], dx=1e-6, dy=1e-6)
    >>> table = areal_parameters(grid, names=["Sa", "Sq", "Sz"])
    >>> [f"{q.value * 1e9:.4f} nm" for q in table.values()]
    ['50.0000 nm', '200.0000 nm', '40.5218 nm']
    """
    instance_of(surface, Surface, "a table of areal parameters")
    rows = chosen_rows(_ROWS, names, "an areal parameter", _ALIASES)
    if line not in ("lsq", "secant"):
        raise DataError(f'line is "lsq" or "secant", got {line!r}')
    if not 0.0 <= real_number(pruning, "pruning", "a share of Sz") < 1.0:
        raise DataError(f"pruning is a share of Sz from 0 to below 1, got {pruning}")
    work = _Work(surface, line, pruning)
    n_valid = work.heights.n_valid
    quantities, unavailable = evaluated(rows, work)
    given = {row.symbol for row in rows}
    settings: dict[str, Any] = {"dx_m": surface.dx, "dy_m": surface.dy}
    if given & {"Sk", "Spk", "Svk", "Smr1", "Smr2"}:
        settings["line"] = line
    if given & _FEATURES:
        settings["pruning"] = pruning
    context = Context(
        edition=EDITION,
        n_valid=n_valid,
        n_total=surface.z.size,
        history=surface.history,
        settings=settings,
        notes=(*_notes(surface), *_filled_notes(work, given)),
    )
    return ArealParameterTable(quantities, context, unavailable=unavailable)


def is_form_removed(history: Sequence[Step]) -> bool:
    """Return whether a form removal or an L-filter is in a history."""
    return any(s.name.startswith("fit ") or s.parameters.get("band") == "short" for s in history)


def _notes(surface: Surface) -> tuple[str, ...]:
    if is_form_removed(surface.history):
        return ()
    return (
        "No form removal is in the history: tilt, form and waviness of the map are in the numbers.",
    )


@dataclass(frozen=True)
class _Work:
    """What the parameters share, each evaluated when first asked."""

    surface: Surface
    line: CoreLine
    pruning: float

    @cached_property
    def heights(self) -> HeightStatistics:
        return height_statistics(self.surface.z)

    @cached_property
    def centred(self) -> NDArray[np.float64]:
        return self.surface.z - self.heights.mean

    @cached_property
    def steps(self) -> tuple[float, float]:
        dx, dy = self.surface.dx, self.surface.dy
        if dx is None or dy is None:
            missing = " and ".join(n for n, v in (("dx", dx), ("dy", dy)) if v is None)
            raise DataError(
                f"the lateral step {missing} is not calibrated; give it when reading the file "
                "(lateral_step=) or with Surface(z, dx, dy)"
            )
        return dx, dy

    @cached_property
    def gradients(self) -> GradientStatistics:
        return gradient_statistics(self.surface.z, *self.steps)

    @cached_property
    def acf(self) -> Autocorrelation:
        return autocorrelation(self.surface.z, *self.steps)

    @cached_property
    def lobe(self) -> CentralLobe:
        return central_lobe(self.acf)

    @cached_property
    def curve(self) -> AbbottCurve:
        return abbott_curve(self.centred)

    @cached_property
    def core(self) -> CoreHeight:
        return core_height(self.curve.heights, line=self.line)

    @cached_property
    def volumes(self) -> Volumes:
        return volumes(self.curve)

    @cached_property
    def peaks(self) -> Peaks:
        return significant_peaks(self.centred, pruning=self.pruning)

    @cached_property
    def pits(self) -> Peaks:
        return significant_peaks(-self.centred, pruning=self.pruning)


def _given(value: float | None, reason: str) -> float:
    if value is None:
        raise DataError(reason)
    return value


def _aspect_ratio(work: _Work) -> float:
    return _given(
        work.lobe.aspect_ratio,
        "the autocorrelation does not fall to 0.2 within half the map in its longest direction; "
        "map a larger area, or remove form and waviness",
    )


def _peak_density(work: _Work) -> float:
    dx, dy = work.steps
    n = work.heights.n_valid + work.peaks.n_filled
    return len(work.peaks) / (n * dx * dy)


def _filled_notes(work: _Work, given: set[str]) -> list[str]:
    """Return how many pixels were filled for the segmentation, and which numbers feel it."""
    missing = work.surface.z.size - work.heights.n_valid
    if not given & _FEATURES or not missing or work.heights.Sz == 0.0:
        return []
    notes = []
    found = work.pits if given & _FEATURES == {"S5v"} else work.peaks
    if found.n_filled:
        notes.append(
            f"{found.n_filled} of {missing} missing pixels lie in holes of at most {LARGEST_HOLE} "
            "pixels and were filled to find peaks and pits; heights, Sz and all other parameters "
            "are those of measured pixels"
        )
    if missing > found.n_filled:
        notes.append(
            f"{missing - found.n_filled} missing pixels lie in larger holes or outside: peaks and "
            "pits beside them are not counted"
        )
    for symbol, what in (("S5p", "peaks"), ("S5v", "pits")):
        if given & {symbol, "S10z"}:
            n = int((work.peaks if symbol == "S5p" else work.pits).on_filled[:5].sum())
            if n:
                notes.append(f"{symbol}: {n} of its 5 {what} lie on filled pixels")
    if "Spc" in given and (n := int(work.peaks.beside_filled.sum())):
        notes.append(
            f"Spc: {n} of {len(work.peaks)} peaks lie on or beside a filled pixel and are left out"
        )
    return notes


_ROWS = (
    Row("Sq", "m", "root mean square height about the mean", lambda w: w.heights.Sq),
    Row("Ssk", "1", "skewness of the heights", lambda w: _given(w.heights.Ssk, _CONSTANT)),
    Row(
        "Sku",
        "1",
        "kurtosis of the heights, 3 for Gaussian ones",
        lambda w: _given(w.heights.Sku, _CONSTANT),
    ),
    Row("Sp", "m", "highest peak above the mean", lambda w: w.heights.Sp),
    Row("Sv", "m", "deepest pit below the mean, positive", lambda w: w.heights.Sv),
    Row("Sz", "m", "maximum height Sp + Sv", lambda w: w.heights.Sz),
    Row("Sa", "m", "arithmetic mean height about the mean", lambda w: w.heights.Sa),
    Row(
        "Sal",
        "m",
        "autocorrelation length, shortest distance of the decay to 0.2",
        lambda w: w.lobe.shortest,
    ),
    Row(
        "Str",
        "1",
        "texture aspect ratio, shortest over longest distance of the decay to 0.2",
        _aspect_ratio,
    ),
    Row(
        "Std",
        "rad",
        "direction of the largest angular spectrum, from +x to +y, 0 to pi; the lay is at right "
        "angles to it",
        lambda w: texture_direction(w.acf),
    ),
    Row("Sdq", "1", "root mean square gradient", lambda w: w.gradients.Sdq),
    Row(
        "Sdr",
        "1",
        "developed interfacial area ratio, as a number (1 is 100 %)",
        lambda w: w.gradients.Sdr,
    ),
    Row("Sk", "m", "core height", lambda w: w.core.k),
    Row("Spk", "m", "reduced peak height", lambda w: w.core.pk),
    Row("Svk", "m", "reduced dale height", lambda w: w.core.vk),
    Row(
        "Smr1",
        "1",
        "material ratio at the top of the core, 0 to 1 (Smrk1 of 2021)",
        lambda w: w.core.mr1,
    ),
    Row(
        "Smr2",
        "1",
        "material ratio at the bottom of the core, 0 to 1 (Smrk2 of 2021)",
        lambda w: w.core.mr2,
    ),
    Row("Vmp", "m", "peak material volume per area, Vm(10 %)", lambda w: w.volumes.Vmp),
    Row("Vmc", "m", "core material volume per area, Vm(80 %) - Vm(10 %)", lambda w: w.volumes.Vmc),
    Row("Vvc", "m", "core void volume per area, Vv(10 %) - Vv(80 %)", lambda w: w.volumes.Vvc),
    Row("Vvv", "m", "dale void volume per area, Vv(80 %)", lambda w: w.volumes.Vvv),
    Row(
        "Sxp",
        "m",
        "peak extreme height Smc(2.5 %) - Smc(50 %)",
        lambda w: w.curve.height_difference(0.025, 0.5),
    ),
    Row(
        "S5p",
        "m",
        "mean height of the five highest significant peaks",
        lambda w: five_point_height(w.peaks, 0.0),
    ),
    Row(
        "S5v",
        "m",
        "mean depth of the five deepest significant pits, positive",
        lambda w: five_point_height(w.pits, 0.0),
    ),
    Row(
        "S10z",
        "m",
        "ten-point height S5p + S5v",
        lambda w: five_point_height(w.peaks, 0.0) + five_point_height(w.pits, 0.0),
    ),
    Row("Spd", "1/m^2", "density of significant peaks", _peak_density),
    Row(
        "Spc",
        "1/m",
        "mean curvature of the significant peaks",
        lambda w: mean_peak_curvature(w.surface.z, w.peaks, *w.steps),
    ),
)
