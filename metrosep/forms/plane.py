"""The plane z = 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.forms.base import Shape

__all__ = ["Plane"]


@dataclass(frozen=True, repr=False)
class Plane(Shape):
    """The plane ``z = 0``; its height and inclination are rigid-body freedoms of a fit.

    Notes
    -----
    It has no parameters and no centre: a map is not moved for it.

    Examples
    --------
    >>> Plane()(1e-3, 2e-3).item()
    0.0
    """

    name = "plane"
    has_centre = False
    is_everywhere = True

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return np.zeros_like(x)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.zeros_like(x), np.zeros_like(x)

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        return []
