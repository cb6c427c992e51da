"""Forbes' aspheres: a sphere or conic and orthogonal polynomials of the radius.

With ``u = r / radius`` and ``X = u^2``:

- "con": ``z = conic(r) + X^2 sum a_m Qcon_m(X)``, departure from a conic along the axis;
- "bfs": ``z = sphere(r) + X (1 - X) / sqrt(1 - r^2 / R^2) sum a_m Qbfs_m(X)``, departure from a
  sphere along its normal, zero at the vertex and at the rim, its slopes orthonormal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal, Self

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import choice, positive
from metrosep.forms.base import checked, positive_root
from metrosep.forms.conic import Conic, Departing

_RIM = 1e-9
"""Of the radius: a point this far outside still counts as on the rim."""

_HIGHEST = 100
"""More coefficients are a slip of the pen."""


def q_con(X: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return Qcon_0 ... Qcon_(n-1) and their derivatives by X.

    Jacobi polynomials P_m^(0,4)(2 X - 1), by their recurrence.

    Source: Forbes, Opt. Express 15 (2007) 5218, appendix A.
    """
    steps = [(6.0, -5.0, 0.0)]
    for m in range(2, n):
        low = 2 * m * (m + 4) * (2 * m + 2)
        slope = (2 * m + 3) * (2 * m + 4) * (2 * m + 2) / low
        shift = -16 * (2 * m + 3) / low
        steps.append((2.0 * slope, shift - slope, 2 * (m - 1) * (m + 3) * (2 * m + 4) / low))
    return _climb(X, n, steps)


def q_bfs(X: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return Qbfs_0 ... Qbfs_(n-1) and their derivatives by X.

    ``S_m = X (1 - X) Qbfs_m`` have ``integral_0^1 S_m' S_n' (2/pi) / sqrt(1 - u^2) du = delta_mn``,
    with derivatives by u.

    Source: Forbes, Opt. Express 18 (2010) 19700, for P_m and the recurrence of f, g, h.
    """
    p, dp = _climb(X, n, [(-4.0, 3.0, 0.0), *((-4.0, 2.0, 1.0) for _ in range(2, n))])
    p, dp = 2.0 * p, 2.0 * dp
    q, dq = np.empty_like(p), np.empty_like(dp)
    for m, (f, g, h) in enumerate(_bfs_steps(n)):
        for out, source in ((q, p), (dq, dp)):
            out[m] = source[m]
            if m > 0:
                out[m] -= g * out[m - 1]
            if m > 1:
                out[m] -= h * out[m - 2]
            out[m] /= f
    return q, dq


def _climb(
    X: FloatArray, n: int, steps: Sequence[tuple[float, float, float]]
) -> tuple[FloatArray, FloatArray]:
    """Return p_0 = 1, p_m = (a X + b) p_(m-1) - c p_(m-2), and derivatives."""
    p, d = np.ones((n, *X.shape)), np.zeros((n, *X.shape))
    for m, (a, b, c) in zip(range(1, n), steps, strict=False):
        line = a * X + b
        p[m] = line * p[m - 1]
        d[m] = line * d[m - 1] + a * p[m - 1]
        if c:
            p[m] -= c * p[m - 2]
            d[m] -= c * d[m - 2]
    return p, d


@cache
def _bfs_steps(n: int) -> tuple[tuple[float, float, float], ...]:
    """Return (f_m, g_(m-1), h_(m-2)) with ``f_m Q_m = P_m - g_(m-1) Q_(m-1) - h_(m-2) Q_(m-2)``."""
    f, g, h = [2.0, math.sqrt(19.0) / 2.0], [-0.5], [0.0]
    for m in range(2, n):
        h_now = -m * (m - 1) / (2.0 * f[m - 2])
        g_now = -(1.0 + g[m - 2] * h_now) / f[m - 1]
        f.append(math.sqrt(m * (m + 1) + 3.0 - g_now**2 - h_now**2))
        g.append(g_now)
        h.append(h_now)
    return tuple(zip(f[:n], [0.0, *g][:n], [0.0, *h][:n], strict=False))


@dataclass(frozen=True, repr=False)
class QForbes(Departing):
    """A rotationally symmetric asphere in Forbes' polynomials.

    Parameters
    ----------
    R : float or None, m
        Radius of curvature of the sphere or conic at the vertex, not zero; > 0 for a concave part.
        None: not known, a fit finds it.
    k : float or None, dimensionless
        Conic constant; "bfs" departs from a sphere and has none but 0.
    kind : {"bfs", "con"}, optional
        Departure from a best-fit sphere along its normal, or from a conic along the axis.
    coefficients : sequence of float or None, m
        a_0, a_1, ...; None: not known, a fit finds it.
    radius : float, m, optional
        Half the aperture, where u = 1. Default: a fit takes the farthest point.

    Raises
    ------
    DataError
        If R or the radius is zero, a value is not finite, k is not 0 for "bfs", or there are more
        than 100 coefficients.

    Notes
    -----
    Parameters are ``R``, ``k`` (only "con"), ``a0``, ``a1`` ... in m. NaN beyond the radius and
    beyond the equator of the base. For "bfs" the rms of the normal departure's slope over the
    aperture (weight ``1 / sqrt(1 - u^2)``) is ``sqrt(sum a_m^2) / radius``. With R, k and a_0
    free on a shallow part, the fit is confounded: hold R.

    References
    ----------
    .. [1] Forbes, "Shape specification for axially symmetric optical surfaces", Opt. Express 15
       (2007) 5218.
    .. [2] ISO 10110-19:2015, general description of surfaces.

    Examples
    --------
    >>> lens = QForbes(R=50e-3, kind="con", coefficients=[1e-6, 0.5e-6], radius=10e-3)
    >>> round((lens(10e-3) - lens.base(10e-3)).item(), 12)
    1.5e-06
    """

    R: float | None = None
    k: float | None = 0.0
    kind: Literal["bfs", "con"] = "bfs"
    coefficients: Sequence[float | None] = ()
    radius: float | None = None

    name = "qforbes"

    def __post_init__(self) -> None:
        choice(self.kind, "kind", ("bfs", "con"))
        values = tuple(checked(v, f"a{m}") for m, v in enumerate(self.coefficients))
        if len(values) > _HIGHEST:
            raise DataError(f"at most {_HIGHEST} coefficients, got {len(values)}")
        R, k = checked(self.R, "R", zero=False, dimension="length"), checked(self.k, "k")
        radius = self.radius
        if radius is not None:
            radius = positive(radius, "radius", dimension="length")
        if self.kind == "bfs" and k != 0.0:
            raise DataError(
                f'"bfs" departs from a sphere, so k must be 0, got {k}; use kind="con"'
            )
        units = {"R": "m"} | ({"k": "1"} if self.kind == "con" else {})
        units |= {f"a{m}": "m" for m in range(len(values))}
        self._set(R=R, k=k, coefficients=values, radius=radius, units=units)

    @property
    def parameters(self) -> dict[str, float | None]:
        base = {"R": self.R} | ({"k": self.k} if self.kind == "con" else {})
        return base | {f"a{m}": v for m, v in enumerate(self.coefficients)}

    def with_parameters(self, **values: float) -> Self:
        self._check_names(values)
        return self._with({**self.parameters, **values}, self.radius)

    def _with(self, now: dict[str, float | None], radius: float | None) -> Self:
        terms = [now[f"a{m}"] for m in range(len(self.coefficients))]
        return type(self)(now["R"], now.get("k", 0.0), self.kind, terms, radius)

    @property
    def base(self) -> Conic:
        """The sphere or conic that the polynomials are added to."""
        return Conic(self.R, self.k)

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # Unknown coefficients are 0, R and k those of a conic, an unknown radius that of the farthest
        # point.
        radius = self.radius or float(np.sqrt((x * x + y * y).max(initial=0.0))) or None
        now = {n: 0.0 if v is None and n[0] == "a" else v for n, v in self.parameters.items()}
        if now["R"] is None or now.get("k", 0.0) is None:
            conic = self.base.start(x, y, z)
            now |= {n: v for n, v in conic.parameters.items() if n in now}
        return self._with(now, radius)

    def departure(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._sum(self._basis(x * x + y * y)[0])

    def _sum(self, functions: FloatArray) -> FloatArray:
        values = np.array(self._known(*(f"a{m}" for m in range(len(self.coefficients)))))
        total: FloatArray = np.tensordot(values, functions, axes=1)
        return total

    def _basis(self, square: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what each coefficient multiplies, and its derivative by r^2."""
        if self.radius is None:
            raise DataError(f"{self.name} has no radius yet: give half the aperture, or fit it")
        n = len(self.coefficients)
        X = square / self.radius**2
        outside = X > (1.0 + _RIM) ** 2
        if outside.any():
            X[outside] = np.nan
        if n == 0:
            none = np.empty((0, *X.shape))
            return none, none
        if self.kind == "con":
            q, dq = q_con(X, n)
            return X * X * q, (2.0 * X * q + X * X * dq) / self.radius**2
        q, dq = q_bfs(X, n)
        (R,) = self._known("R")
        w = positive_root(1.0 - square / R**2)  # cosine of the slope of the sphere
        normal = X * (1.0 - X) * q
        slope = ((1.0 - 2.0 * X) * q + X * (1.0 - X) * dq) / self.radius**2
        return normal / w, slope / w + normal / (2.0 * w**3 * R**2)

    def _inside(self, square: FloatArray) -> FloatArray:
        if self.radius is None:
            raise DataError(f"{self.name} has no radius yet: give half the aperture, or fit it")
        return np.where(square > (self.radius * (1.0 + _RIM)) ** 2, np.nan, 1.0)

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        inside = self._inside(x * x + y * y)
        return inside * (self.base.height(x, y) + self.departure(x, y))

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        square = x * x + y * y
        inside = self._inside(square)
        gx, gy = self.base.slopes(x, y)
        rate = 2.0 * self._sum(self._basis(square)[1])
        return inside * (gx + x * rate), inside * (gy + y * rate)

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        square = x * x + y * y
        inside = self._inside(square)
        of_base = [n for n in names if n in ("R", "k")]
        found = dict(zip(of_base, self.base.derivatives(x, y, of_base), strict=True))
        functions = self._basis(square)[0] if len(self.coefficients) else np.empty((0, *x.shape))
        if "R" in found and self.kind == "bfs" and len(self.coefficients):
            (R,) = self._known("R")
            # the cosine of the sphere's slope changes too: d(1/w)/dR = -r^2 / (R^3 w^3)
            found["R"] = found["R"] - self._sum(functions) * square / (R**3 - R * square)
        return [inside * (found[n] if n in found else functions[int(n[1:])]) for n in names]
