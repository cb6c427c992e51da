"""`Diagonals`: length errors of body and face diagonals separated into squareness and scale errors.

``dL = (sum e_i s_i^2 L_i^2 + sum a_ij s_i s_j L_i L_j) / D + g D``: a of the angles, e of the axes, g
of the instrument, which reads everything too long by its share. Signs: `metrosep.separation.squareness`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._method_parts import known_parts, part_of, stated_u
from metrosep.separation._readings import NOISE_UNKNOWN, checked_readings
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.separation.squareness import (
    Squareness,
    canonical_name,
    checked_travel,
    squareness_from_diagonals,
)

__all__ = ["Diagonals"]


_PAIRS = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_SCALES = ("scale_x", "scale_y", "scale_z")
_SIGN = {"p": 1.0, "n": -1.0, "0": 0.0}
_INSTRUMENT = (
    "an instrument that reads too long looks like axes that are too long: calibrate its wavelength, "
    "dead path and temperature"
)
_OPEN = "these diagonals do not determine it alone: add both diagonals of the faces"


@dataclass(frozen=True, slots=True)
class Diagonals(SeparationMethod):
    """Diagonal displacement tests of one volume.

    Parameters
    ----------
    names : tuple of str
        Of the diagonals, in the order of the readings: ``"ppp"``, ``"npp"``, ``"pp0"``, ...
    size : tuple of 3 float, m
        Travel along X, Y and Z between their ends.

    Raises
    ------
    DataError
        If a name is no diagonal or stands twice, or the size is not three positive lengths.
    NotSeparableError
        If no angle is determined by these diagonals.

    Examples
    --------
    >>> method = Diagonals(("ppp", "npp", "pnp", "nnp"), (1.0, 1.0, 1.0))
    >>> lengths = method.simulate({}, {"xy": 3e-6})
    >>> found = method.separate(lengths, u_reading=1e-7)
    >>> round(float(found.xy) * 1e6, 6), bool(np.isnan(found.scale_x))
    (3.0, True)
    """

    names: tuple[str, ...]
    size: tuple[float, float, float]

    name: ClassVar[str] = "diagonals"
    truth_parts: ClassVar[tuple[str, ...]] = ("instrument",)
    error_parts: ClassVar[tuple[str, ...]] = (*_PAIRS, *_SCALES)

    def __post_init__(self) -> None:
        names: Any = self.names
        if isinstance(names, str) or not isinstance(names, Sequence):
            raise DataError(f"names are a tuple such as ('ppp', 'npp'), got {self.names!r}")
        self._solve(np.zeros(len(self.names)), None)

    def _solve(self, lengths: FloatArray, u: FloatArray | None) -> Squareness:
        own = [canonical_name(n)[0] for n in self.names]
        if len(set(own)) < len(own):
            raise DataError(f"a diagonal stands twice in {', '.join(self.names)}")
        table = dict(zip(own, lengths.tolist(), strict=True))
        spread = None if u is None else dict(zip(own, u.tolist(), strict=True))
        return squareness_from_diagonals(table, self.size, u=spread)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the length errors of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, scalar
            ``instrument``: relative length error of the instrument.
        errors : mapping of str to array_like, scalar
            ``xy``, ``xz``, ``yz`` in rad, ``scale_x``, ``scale_y``, ``scale_z`` relative; NaN is
            not determined and adds nothing.

        Returns
        -------
        ndarray, shape (n_diagonals, 1), m
            Actual minus nominal.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or no scalar.
        """
        parts = known_parts(self, truth, errors)
        given = {
            name: float(np.nan_to_num(part_of(parts, name, (), self.name), nan=0.0))
            for name in (*self.truth_parts, *self.error_parts)
        }
        travel = checked_travel(self.size)
        legs = travel * np.array([[_SIGN[c] for c in canonical_name(n)[0]] for n in self.names])
        diagonal = np.sqrt((legs**2).sum(axis=1))
        shear = sum(given[p] * legs[:, i] * legs[:, j] for p, (i, j) in _PAIRS.items())
        stretch = (legs**2) @ np.array([given[s] for s in _SCALES])
        return np.asarray((shear + stretch) / diagonal + given["instrument"] * diagonal)[:, None]

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what these diagonals cannot tell.

        Returns
        -------
        tuple of Unobservable
            The instrument's length error, and each angle and scale that is not determined.
        """
        found = _values(self._solve(np.zeros(len(self.names)), None))
        lost = [name for name, value in found.items() if math.isnan(value)]
        seen = [name for name in _SCALES if name not in lost]
        return (
            Unobservable("instrument", "term", ("all of it",), _INSTRUMENT),
            *(Unobservable(name, "term", (name,), _OPEN) for name in lost),
            *(Unobservable(name, "term", ("common to all axes",), _INSTRUMENT) for name in seen),
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return squareness and scale errors.

        Parameters
        ----------
        readings : array_like, shape (n_diagonals, M), m
            Length error (actual minus nominal) of each diagonal, M times; NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one length error; the scatter of the M if omitted.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``xy``, ``xz``, ``yz`` (rad), ``scale_x``, ``scale_y``, ``scale_z`` (relative) and
            ``instrument``; NaN where not determined.

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings are no numbers, infinite or of another shape.
        TooFewSamplesError
            If a diagonal was not measured.
        UnitError
            If a length error exceeds 1 % of its diagonal.

        Notes
        -----
        `squareness_from_diagonals` does the work, to first order; what the second order would add
        is in the audit. ``u`` of each length is ``s / sqrt(M)``; four body diagonals of one D give
        ``u(a_xy) = D s / (2 X Y sqrt(M))``.
        """
        stated = stated_u(u_reading, "m")
        array = checked_readings(readings, names=self.names, minimum=1, what=self.name)
        array = array.reshape(len(self.names), -1)
        count = (~np.isnan(array)).sum(axis=1)
        mean = np.nansum(array, axis=1) / count
        noise = _noise(array - mean[:, None], count, stated)
        s = noise.value
        found = self._solve(mean, None if math.isnan(s) else s / np.sqrt(count))
        quantities = {**found.angles, **{f"scale_{k}": q for k, q in found.scales.items()}}
        parts = {"instrument": math.nan, **_values(found)}
        u = {n: math.nan if q.u is None else q.u for n, q in quantities.items()}
        messages = tuple(m for m in found.messages if not m.startswith("no standard"))
        return Separation(
            self.name,
            {n: np.array(v) for n, v in parts.items()},
            {"instrument": np.array(math.nan), **{n: np.array(v) for n, v in u.items()}},
            {n: "rad" if n in _PAIRS else "1" for n in parts},
            {},
            self.null_space(),
            noise=noise,
            audit={
                **found.audit,
                "n_repeats": int(array.shape[1]),
                "second_order_urad": {k: v * 1e6 for k, v in found.remainder.items()},
            },
            messages=(*messages, *((NOISE_UNKNOWN,) if math.isnan(s) else ())),
            history=(*history, Step(self.name, {"size_m": [float(v) for v in self.size]})),
        )


def _values(found: Squareness) -> dict[str, float]:
    angles = {pair: found.angles[pair].value for pair in _PAIRS}
    return {**angles, **{f"scale_{k}": found.scales[k].value for k in "xyz"}}


def _noise(rest: FloatArray, count: NDArray[np.intp], stated: float | None) -> Quantity:
    if stated is not None:
        return Quantity(stated, "m", "standard uncertainty of one length, as stated", symbol="s")
    freedom = float((count - 1).sum())
    if freedom < 1.0:
        return Quantity(math.nan, "m", "standard deviation of one length; not known", symbol="s")
    value = math.sqrt(float(np.nansum(rest**2)) / freedom)
    text = "standard deviation of one length, pooled from the repeats (type A)"
    return Quantity(value, "m", text, u=value / math.sqrt(2.0 * freedom), symbol="s")
