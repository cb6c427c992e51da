"""The rotationally symmetric asphere of lens drawings: a conic and powers of the radius.

``z = c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2)) + sum of a_n r^n``, as in ISO 10110-12.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.forms._shape import Shape
from metrosep.forms.base import checked
from metrosep.forms.conic import Conic

__all__ = ["Asphere"]

Terms = Mapping[int, float | None] | Sequence[Any]

_HIGHEST = 40
"""Powers above it are a slip of the pen."""


@dataclass(frozen=True, repr=False)
class Asphere(Shape):
    """A conic of revolution with added powers of the radius.

    Parameters
    ----------
    R : float or None, m
        Radius of curvature at the vertex, not zero; > 0 for a concave part. None: not known.
    k : float or None, dimensionless
        Conic constant, 0 for a sphere. None: not known.
    coefficients : mapping of int to float, or sequence of float, m^(1-n)
        Power and coefficient, such as ``{4: 1.5e3, 6: None}``, or the even terms from r^4 on.
        None as a value: not known, a fit finds it.
    odd : mapping of int to float, or sequence of float, m^(1-n)
        The same for odd powers; a sequence starts at r^3.
    norm_radius : float or None, m
        With it the powers are those of r/norm_radius, and all coefficients are in m.

    Raises
    ------
    DataError
        If R or norm_radius is zero, a value is not finite, a power is not an integer from 2 to 40,
        stands twice, or is even in `odd`.

    Notes
    -----
    Parameters are named ``R``, ``k``, ``a3``, ``a4`` ... A drawing in millimetres gives a_n in
    mm^(1-n): multiply by 1e3^(n-1). A power of 2 acts like a change of 1/R, and a free k like a
    free a4 on a shallow part: a fit of both is confounded. Domain as for `Conic`.

    References
    ----------
    .. [1] ISO 10110-12:2019, rotationally symmetric surfaces, even and odd terms.

    Examples
    --------
    >>> Asphere(R=50e-3, k=-1.0, coefficients=[1e3])(10e-3).item()
    0.00101
    """

    R: float | None = None
    k: float | None = 0.0
    coefficients: Terms = ()
    odd: Terms = ()
    norm_radius: float | None = None

    name = "asphere"
    radii = ("R",)
    weak = ("k",)

    def __post_init__(self) -> None:
        terms = _terms(self.coefficients, first=4, is_odd=False)
        for power, value in _terms(self.odd, first=3, is_odd=True).items():
            if power in terms:
                raise DataError(f"the power {power} stands twice in the asphere; give it once")
            terms[power] = value
        ordered = tuple(sorted(terms.items()))
        norm = checked(self.norm_radius, "norm_radius", zero=False, dimension="length")
        if norm is not None and norm < 0.0:
            raise DataError(f"norm_radius must be positive, got {norm} m")
        units = {"R": "m", "k": "1"}
        units |= {f"a{n}": "m" if norm else f"m^{1 - n}" for n, _ in ordered}
        self._set(
            R=checked(self.R, "R", zero=False, dimension="length"),
            k=checked(self.k, "k"),
            coefficients=ordered,
            odd=(),
            norm_radius=norm,
            units=units,
        )

    @property
    def terms(self) -> tuple[tuple[int, float | None], ...]:
        """Powers and coefficients, rising."""
        return cast("tuple[tuple[int, float | None], ...]", self.coefficients)

    @property
    def parameters(self) -> dict[str, float | None]:
        """Shape parameters by name, SI; None where not known yet."""
        return {"R": self.R, "k": self.k, **{f"a{n}": v for n, v in self.terms}}

    def with_parameters(self, **values: float) -> Self:
        """Return the asphere with other values of some parameters.

        Parameters
        ----------
        **values : float
            By name (R, k, a4 ...), SI.

        Returns
        -------
        Asphere
            Another one with the same powers.

        Raises
        ------
        DataError
            If a name is unknown or a value is not allowed.
        """
        self._check_names(values)
        now = {**self.parameters, **values}
        terms = {n: now[f"a{n}"] for n, _ in self.terms}
        return type(self)(now["R"], now["k"], terms, norm_radius=self.norm_radius)

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        """Return the asphere with values for its unknown parameters, good enough to start a fit.

        Parameters
        ----------
        x, y, z : ndarray, shape (n,), m
            Valid points, x and y from the assumed vertex; no NaN.

        Returns
        -------
        Asphere
            Unknown coefficients are 0; R and k as `Conic.start` finds them without the known ones.

        Raises
        ------
        TooFewSamplesError
            If there are fewer than 4 points.
        DegenerateFitError
            If all points lie at the centre.
        """
        zeros = {f"a{n}": 0.0 for n, v in self.terms if v is None}
        form = self.with_parameters(**zeros)
        if self.R is not None and self.k is not None:
            return form
        rest = z - form.departure(x, y)
        conic = Conic(self.R, self.k).start(x, y, rest)
        return form.with_parameters(**{n: v for n, v in conic.parameters.items() if v is not None})

    def departure(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the added powers alone, the departure from the conic.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.

        Returns
        -------
        ndarray, m
            Heights.

        Raises
        ------
        DataError
            If a coefficient is not known yet.
        """
        return self._powers(x * x + y * y, lowered=0)

    def _powers(self, square: FloatArray, *, lowered: int) -> FloatArray:
        """Return the sum of a_n rho^n, or of n a_n rho^(n-2) / norm^2 when lowered by 2."""
        norm = self.norm_radius or 1.0
        values = self._known(*(f"a{n}" for n, _ in self.terms))
        weights = {
            n: v * (n / norm**2 if lowered else 1.0)
            for (n, _), v in zip(self.terms, values, strict=True)
        }
        if not weights:
            return np.zeros_like(square)
        rho2 = square / norm**2
        even = {(n - lowered) // 2: v for n, v in weights.items() if n % 2 == 0}
        odd = {(n - 1 - lowered) // 2: v for n, v in weights.items() if n % 2}
        total = _horner(even, rho2)
        return total + np.sqrt(rho2) * _horner(odd, rho2) if odd else total

    def _height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return Conic(self.R, self.k).height(x, y) + self.departure(x, y)

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        gx, gy = Conic(self.R, self.k).slopes(x, y)
        rate = self._powers(x * x + y * y, lowered=2)
        return gx + x * rate, gy + y * rate

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        conic = [n for n in names if n in ("R", "k")]
        found = dict(zip(conic, Conic(self.R, self.k).derivatives(x, y, conic), strict=True))
        rho = np.hypot(x, y) / (self.norm_radius or 1.0)
        return [found[n] if n in found else rho ** int(n[1:]) for n in names]


def _horner(terms: Mapping[int, float], variable: FloatArray) -> FloatArray:
    total = np.zeros_like(variable)
    for power in range(max(terms, default=0), -1, -1):
        total *= variable
        if power in terms:
            total += terms[power]
    return total


def _terms(given: Terms, *, first: int, is_odd: bool) -> dict[int, float | None]:
    if isinstance(given, Mapping):
        pairs = list(given.items())
    elif isinstance(given, str):
        raise DataError("coefficients are a mapping of power to value or a sequence of values")
    else:
        items = list(given)
        paired = bool(items) and all(isinstance(i, tuple) for i in items)
        pairs = items if paired else [(first + 2 * i, v) for i, v in enumerate(items)]
    terms: dict[int, float | None] = {}
    for power, value in pairs:
        if power not in range(2, _HIGHEST + 1):
            raise DataError(
                f"a power of an asphere is an integer from 2 to {_HIGHEST}, got {power!r}"
            )
        if is_odd and power % 2 == 0:
            raise DataError(f"odd= has the even power {power}; put it into coefficients=")
        terms[int(power)] = checked(value, f"a{power}")
    return terms
