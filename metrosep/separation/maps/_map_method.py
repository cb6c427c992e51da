"""Private: the base of methods that read maps, and their result."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.separation._readings import given_parts
from metrosep.separation.contract import Parts, Separation, SeparationMethod, Unobservable
from metrosep.separation.maps._map_input import (
    PIXELS,
    MapGrid,
    checked_u,
    map_stack,
    require_overlap,
)


class MapReadings(NamedTuple):
    """Checked maps on one grid."""

    stack: FloatArray
    grid: MapGrid
    common: NDArray[np.bool_]
    """Pixels that all maps have measured."""
    u_reading: float | None
    history: tuple[Step, ...]


class MapMethod(SeparationMethod):
    """A method whose readings are maps on one grid; its results carry their history.

    Parameters
    ----------
    dx, dy : float, m, optional
        Lateral steps; pixels if omitted.
    centre : tuple of (float, float), m, optional
        Axis of the turns, and of the mirror of flats, as (x, y) from pixel [0, 0]; the middle of the
        map if omitted.
    removed : tuple of str, optional
        What alignment decides in each reading: ``"piston"``, ``"tilt"``, also ``"power"``.

    Raises
    ------
    DataError
        If a setting cannot be used: its type, sign, unit or number.
    NotSeparableError
        If the set-up turns or shifts nothing.
    """

    dx: float | None
    dy: float | None

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the parts that maps consist of, as far as they are determined.

        Parameters
        ----------
        readings : array_like, shape (n, n_y, n_x), m, or sequence of Surface
            One map for each set-up, in the order of `simulate`; NaN = not measured. Surfaces bring
            the lateral steps and their history.
        u_reading : float, m, optional
            Standard uncertainty of one pixel of one reading; from redundancy if omitted.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts, each (n_y, n_x) in m, with uncertainties, null space and audit.

        Raises
        ------
        DataError
            If maps or options cannot be used: other shapes or steps, no common measured pixels.
        InvalidSamplesError, TooFewSamplesError
            If the maps hold no numbers, or are too few or too small.
        DegenerateFitError
            If the pixels do not determine the Zernike terms of a method that uses them.
        """
        stack, grid, own = self._read(readings, self._names())
        u_reading = checked_u(u_reading, "u_reading")
        common = require_overlap(stack, self.name)
        with one_blas_thread():
            read = MapReadings(stack, grid, common, u_reading, (*own, *history))
            return self._separated(read)

    @abstractmethod
    def _names(self) -> Sequence[str]:
        """Return what each reading is called."""

    @abstractmethod
    def _separated(self, read: MapReadings) -> Separation:
        """Return the parts of checked maps."""

    def _read(
        self, readings: Sequence[ArrayLike | Surface] | ArrayLike, names: Sequence[str]
    ) -> tuple[FloatArray, MapGrid, tuple[Step, ...]]:
        """Return the readings as one array with their grid and history."""
        return map_stack(
            readings, what=self.name, names=names, one_frame=True,
            dx=self.dx, dy=self.dy, centre=getattr(self, "centre", None),
        )  # fmt: skip

    def _given(self, truth: Parts, errors: Parts) -> tuple[FloatArray, MapGrid]:
        """Return all parts of a simulation as one array with their grid."""
        parts = given_parts(self, truth, errors)
        return self._read(list(parts.values()), list(parts))[:2]


def map_separation(
    method: str,
    grid: MapGrid,
    parts: dict[str, FloatArray],
    u: dict[str, FloatArray],
    null_space: tuple[Unobservable, ...],
    noise: Quantity,
    audit: Mapping[str, object],
    messages: Sequence[str],
    history: tuple[Step, ...],
    settings: Mapping[str, object],
    coordinates: Mapping[str, FloatArray] = MappingProxyType({}),
) -> Separation:
    """Return the result of a separation of maps; all parts are heights."""
    return Separation(
        method,
        parts,
        u,
        dict.fromkeys(parts, "m"),
        {"x": grid.x, "y": grid.y, **coordinates},
        null_space,
        noise=noise,
        audit=audit,
        messages=(*messages, *(() if grid.calibrated else (PIXELS,))),
        history=(*history, Step(method, settings)),
    )
