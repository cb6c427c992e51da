"""Material and void volumes of a map from its material ratio curve: Vm(p), Vv(p), Vmp to Vvv.

A volume is per unit of area, m^3/m^2 = m. At the material ratio p the surface is cut at the height
Smc(p): the material above the cut is Vm(p), the void below the cut is Vv(p).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrosep.core.errors import DataError
from metrosep.parameters.material_ratio import AbbottCurve

__all__ = ["Volumes", "material_volume", "void_volume", "volumes"]

_PEAK = 0.10
_VALLEY = 0.80
"""Material ratios that divide peak, core and dale (defaults of ISO 25178-3)."""


@dataclass(frozen=True, slots=True)
class Volumes:
    """Volume parameters at the ratios 10 % and 80 %, in m^3/m^2."""

    Vmp: float  # m: peak material volume, Vm(10 %)
    Vmc: float  # m: core material volume, Vm(80 %) - Vm(10 %)
    Vvc: float  # m: core void volume, Vv(10 %) - Vv(80 %)
    Vvv: float  # m: dale void volume, Vv(80 %)


def material_volume(curve: AbbottCurve, p: float) -> float:
    """Return the material volume Vm(p) above the height at a material ratio.

    Notes
    -----
    Vm(p) = integral from 0 to p of Smc(q) - Smc(p) over q, here as the mean of
    max(z - Smc(p), 0) over the pixels.

    References
    ----------
    .. [1] ISO 25178-2:2021, 4.5.6 (number recalled, not checked).

    Examples
    --------
    >>> from metrosep.parameters.material_ratio import abbott_curve
    >>> import numpy as np
    >>> f"{material_volume(abbott_curve(np.linspace(0, 1e-6, 10001)), 0.5):.4g}"
    '1.25e-07'
    """
    cut, above = _cut(curve, p)
    return float(np.add.reduce(curve.heights[:above] - cut)) / curve.heights.size


def void_volume(curve: AbbottCurve, p: float) -> float:
    """Return the void volume Vv(p) below the height at a material ratio.

    Notes
    -----
    Vv(p) = integral from p to 1 of Smc(p) - Smc(q) over q, here as the mean of
    max(Smc(p) - z, 0) over the pixels. Vv(p) - Vm(p) = Smc(p) - mean(z).

    References
    ----------
    .. [1] ISO 25178-2:2021, 4.5.7 (number recalled, not checked).
    """
    cut, above = _cut(curve, p)
    return float(np.add.reduce(cut - curve.heights[above:])) / curve.heights.size


def volumes(curve: AbbottCurve, *, peak: float = _PEAK, valley: float = _VALLEY) -> Volumes:
    """Return the four volume parameters.

    References
    ----------
    .. [1] ISO 25178-2:2021, 4.5.6 and 4.5.7; ratios of ISO 25178-3 (recalled, not checked).

    Examples
    --------
    >>> from metrosep.parameters.material_ratio import abbott_curve
    >>> import numpy as np
    >>> v = volumes(abbott_curve(np.linspace(0, 1e-6, 100001)))
    >>> f"{v.Vmp:.3g} {v.Vmc:.3g} {v.Vvc:.3g} {v.Vvv:.3g}"
    '5e-09 3.15e-07 3.85e-07 2e-08'
    """
    if not peak < valley:
        raise DataError(f"the ratios must rise, peak < valley; got {peak} and {valley}")
    peak_material, dale_void = material_volume(curve, peak), void_volume(curve, valley)
    return Volumes(
        Vmp=peak_material,
        Vmc=material_volume(curve, valley) - peak_material,
        Vvc=void_volume(curve, peak) - dale_void,
        Vvv=dale_void,
    )


def _cut(curve: AbbottCurve, p: float) -> tuple[float, int]:
    """Return the height of the cut and the number of pixels above it."""
    cut = curve.height(p)
    heights = curve.heights
    return cut, int(heights.size - np.searchsorted(heights[::-1], cut, side="right"))
