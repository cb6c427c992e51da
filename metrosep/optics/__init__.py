"""Optics: what the form of a surface does to a wavefront and to the image; the index of air.

The path difference is positive where the material is high. A name loads its module on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.optics.air import (
        AirIndex as AirIndex,
        air_index as air_index,
        refractive_index as refractive_index,
        saturation_pressure as saturation_pressure,
    )
    from metrosep.optics.image_quality import (
        ModulationTransfer as ModulationTransfer,
        PointSpread as PointSpread,
        marechal as marechal,
        point_spread as point_spread,
        strehl_ratio as strehl_ratio,
    )
    from metrosep.optics.rays import (
        path_difference as path_difference,
        path_sensitivity as path_sensitivity,
    )
    from metrosep.optics.wavefronts import (
        Wavefront as Wavefront,
        ZernikeTable as ZernikeTable,
        wavefront as wavefront,
    )

__getattr__, __dir__ = lazy_package(__name__)
