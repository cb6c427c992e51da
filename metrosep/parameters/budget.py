"""Uncertainty budgets: contributions, combined uncertainty, effective freedom, expanded value.

The law of propagation of the GUM for a result that depends on its contributions linearly enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.limits import COVERAGE
from metrosep.core.numbers import choice, not_negative, positive, real
from metrosep.core.quantity import Quantity

if TYPE_CHECKING:
    import pandas as pd

Distribution = Literal["normal", "rectangular", "triangular", "arcsine"]

_DIVISOR = {
    "normal": 1.0,
    "rectangular": math.sqrt(3.0),
    "triangular": math.sqrt(6.0),
    "arcsine": math.sqrt(2.0),
}
"""Half-width over standard uncertainty (JCGM 100, 4.3.7 to 4.3.9; JCGM 101, 6.4.6 for arcsine)."""

_ROUNDING = 1e-12
"""A correlation matrix may be below semi-definite, or a variance below zero, by this share."""

_DIGITS = 700
"""Enough for the largest and the smallest float in one number."""


def coverage_factor(coverage: float = COVERAGE, dof: float = math.inf) -> float:
    """Return the factor k of a two-sided interval from Student's distribution.

    Parameters
    ----------
    coverage : float, optional
        Coverage probability, between 0 and 1; 95.45 % if omitted, as of every U that the program makes.
    dof : float, optional
        Degrees of freedom, > 0, broken ones as they are; infinite is the normal distribution.

    Returns
    -------
    float
        Factor k.

    Raises
    ------
    DataError
        If the probability or the degrees of freedom are out of range.

    References
    ----------
    .. [1] JCGM 100:2008, G.3 and G.4.1, which lets broken degrees of freedom be interpolated.

    Examples
    --------
    >>> round(coverage_factor(), 4), round(coverage_factor(0.95, 10), 2)
    (2.0, 2.23)
    """
    from scipy.special import ndtri, stdtrit

    if not 0.0 < coverage < 1.0:
        raise DataError(f"a coverage probability lies between 0 and 1, got {coverage}")
    if not dof > 0.0:
        raise DataError(f"degrees of freedom must be positive, got {dof}")
    p = 0.5 + 0.5 * coverage
    if math.isinf(dof):
        return float(ndtri(p))
    return float(stdtrit(dof, p))


@dataclass(frozen=True, slots=True)
class Contribution:
    """One line of a budget.

    Parameters
    ----------
    name : str
        What it is.
    value : float
        Standard uncertainty (normal, divisor 1), expanded uncertainty (normal, its k as divisor)
        or half-width (other distributions), >= 0, in the unit of the input.
    distribution : {"normal", "rectangular", "triangular", "arcsine"}, optional
        Of the input.
    divisor : float, optional
        Value over standard uncertainty; by default 1, sqrt 3, sqrt 6 and sqrt 2.
    sensitivity : float, optional
        Change of the result per unit of the input.
    dof : float, optional
        Degrees of freedom of the standard uncertainty, > 0.

    Raises
    ------
    DataError
        If a number is out of range or not finite, or the distribution is not known.

    Examples
    --------
    >>> Contribution("z scale", 1e-4, "rectangular", sensitivity=100e-9).u
    5.7735026918962585e-12
    """

    name: str
    value: float
    distribution: Distribution = "normal"
    divisor: float | None = None
    sensitivity: float = 1.0
    dof: float = math.inf

    def __post_init__(self) -> None:
        choice(self.distribution, f"the distribution of {self.name}", _DIVISOR)
        not_negative(self.value, f"the value of {self.name}")
        if self.divisor is not None:
            positive(self.divisor, f"the divisor of {self.name}")
        real(self.sensitivity, f"the sensitivity of {self.name}")
        if not real(self.dof, f"the degrees of freedom of {self.name}", finite=False) > 0.0:
            raise DataError(f"the degrees of freedom of {self.name} must be > 0, got {self.dof}")

    @property
    def u_input(self) -> float:
        """Standard uncertainty of the input."""
        return self.value / self.effective_divisor

    @property
    def effective_divisor(self) -> float:
        """Value over standard uncertainty."""
        return _DIVISOR[self.distribution] if self.divisor is None else self.divisor

    @property
    def u(self) -> float:
        """Standard uncertainty of the result from this line alone, >= 0."""
        return abs(self.sensitivity) * self.u_input


class Budget:
    """Contributions to one result, and what follows from them.

    Parameters
    ----------
    contributions : sequence of Contribution
        At least one, with names of their own.
    correlations : array_like, shape (n, n), optional
        Correlation matrix of the inputs in the order of the contributions; independent if
        omitted.

    Raises
    ------
    DataError
        If there is no line, a name occurs twice, or the matrix is not a correlation matrix.

    Notes
    -----
    u_c^2 = sum_ij c_i u_i r_ij c_j u_j (JCGM 100, eq. 16): signs of the sensitivities count when
    lines are correlated. The effective degrees of freedom follow Welch-Satterthwaite (eq. G.2b),
    which holds for independent lines only; with correlations the smallest freedom of a line that
    contributes is taken, which is on the safe side.

    Examples
    --------
    >>> budget = Budget([Contribution("repeatability", 0.3e-9, dof=9),
    ...                  Contribution("reference flat", 0.4e-9)])
    >>> budget.combined, round(budget.dof, 1)
    (5e-10, 69.4)
    """

    __slots__ = ("contributions", "correlations")

    def __init__(
        self, contributions: Sequence[Contribution], *, correlations: ArrayLike | None = None
    ) -> None:
        lines = tuple(contributions)
        names = [c.name for c in lines]
        if not lines:
            raise DataError("a budget needs at least one contribution")
        if len(set(names)) < len(names):
            raise DataError(f"names of contributions must differ, got {', '.join(names)}")
        self.contributions = lines
        self.correlations = _checked_correlations(correlations, len(lines))

    @property
    def signed(self) -> FloatArray:
        """Contributions c_i u_i with their signs, shape (n,)."""
        return np.array([c.sensitivity * c.u_input for c in self.contributions])

    @property
    def combined(self) -> float:
        """Combined standard uncertainty u_c."""
        parts = self.signed
        scale = float(np.abs(parts).max())
        if scale == 0.0:
            return 0.0
        if self.correlations is None:
            return math.hypot(*parts.tolist())
        parts = parts / scale
        return math.sqrt(max(float(parts @ self.correlations @ parts), 0.0)) * scale

    @property
    def dof(self) -> float:
        """Effective degrees of freedom; infinite when all lines are."""
        active = [c for c in self.contributions if c.u > 0.0 and math.isfinite(c.dof)]
        if not active:
            return math.inf
        if self.correlations is not None and np.any(self.correlations != np.eye(len(self))):
            return min(c.dof for c in active)
        u_c = self.combined
        return 1.0 / sum((c.u / u_c) ** 4 / c.dof for c in active)

    @property
    def shares(self) -> FloatArray:
        """Share of each line in u_c^2, shape (n,); sum 1, covariances halved between two lines."""
        parts = self.signed
        u_c = self.combined
        if u_c == 0.0:
            return np.zeros(parts.size)
        parts = parts / u_c
        whole = parts if self.correlations is None else self.correlations @ parts
        shares: FloatArray = parts * whole
        return shares

    def coverage_factor(self, coverage: float = COVERAGE) -> float:
        """Return k for a coverage probability and the effective degrees of freedom.

        Parameters
        ----------
        coverage : float, optional
            Between 0 and 1.

        Returns
        -------
        float
            Factor k.

        Raises
        ------
        DataError
            If the probability is not between 0 and 1.
        """
        return coverage_factor(coverage, self.dof)

    def expanded(self, coverage: float = COVERAGE, *, k: float | None = None) -> float:
        """Return the expanded uncertainty U = k u_c.

        Parameters
        ----------
        coverage : float, optional
            Between 0 and 1.
        k : float, optional
            A fixed factor such as 2 in place of the one for the coverage.

        Returns
        -------
        float
            U.

        Raises
        ------
        DataError
            If the probability or k is out of range.
        """
        k = self.coverage_factor(coverage) if k is None else positive(k, "a coverage factor")
        return k * self.combined

    def report(self, value: float, unit: str, *, coverage: float = COVERAGE) -> str:
        """Return the result in one line, as the GUM wants it.

        Parameters
        ----------
        value : float
            Result in SI.
        unit : str
            Its SI unit.
        coverage : float, optional
            Between 0 and 1.

        Returns
        -------
        str
            Result rounded to the place of U, U with two digits, k, coverage, freedom.

        Raises
        ------
        DataError
            If the value is not finite or the probability not between 0 and 1.
        """
        freedom = "" if math.isinf(self.dof) else f", {self.dof:.3g} degrees of freedom"
        return (
            f"{report_value(value, self.expanded(coverage), unit)} "
            f"(k = {self.coverage_factor(coverage):.2f}, {100 * coverage:.4g} %{freedom})"
        )

    def to_quantity(
        self, value: float, unit: str, definition: str, *, symbol: str = ""
    ) -> Quantity:
        """Return the result as a quantity with its combined standard uncertainty.

        Parameters
        ----------
        value : float
            Result in SI.
        unit, definition : str
            As in `Quantity`.
        symbol : str, optional
            Its symbol.

        Returns
        -------
        Quantity
            With u = u_c.
        """
        return Quantity(value, unit, definition, u=self.combined, symbol=symbol)

    def to_frame(self) -> pd.DataFrame:
        """Return the budget as a table, one row per line and one for the sum.

        Returns
        -------
        pandas.DataFrame
            Index ``name``; columns ``value``, ``distribution``, ``divisor``, ``u_input``,
            ``sensitivity``, ``u``, ``dof``, ``share``.
        """
        import pandas as pd

        rows = [
            {
                "name": c.name,
                "value": c.value,
                "distribution": c.distribution,
                "divisor": c.effective_divisor,
                "u_input": c.u_input,
                "sensitivity": c.sensitivity,
                "u": c.u,
                "dof": c.dof,
                "share": share,
            }
            for c, share in zip(self.contributions, self.shares.tolist(), strict=True)
        ]
        nothing = dict.fromkeys(("value", "divisor", "u_input", "sensitivity"), math.nan)
        total = {"name": "combined", "distribution": "", "u": self.combined, "dof": self.dof}
        rows.append({**nothing, **total, "share": float(self.shares.sum())})
        columns = list(rows[0])
        return pd.DataFrame(rows, columns=columns).set_index("name")

    def __len__(self) -> int:
        return len(self.contributions)

    def __repr__(self) -> str:
        parts = ", ".join(
            f"{c.name} {100 * s:.0f} %"
            for c, s in zip(self.contributions, self.shares.tolist(), strict=True)
        )
        return f"Budget(u_c = {self.combined:.3g}, {parts})"


def _checked_correlations(matrix: ArrayLike | None, n: int) -> FloatArray | None:
    if matrix is None:
        return None
    r = np.array(matrix, dtype=np.float64)
    if r.shape != (n, n) or not np.isfinite(r).all():
        raise DataError(f"the correlations must be a finite {n} x {n} matrix, got {r.shape}")
    if np.abs(r - r.T).max() > _ROUNDING or np.abs(np.diag(r) - 1.0).max() > _ROUNDING:
        raise DataError("a correlation matrix is symmetric with ones on its diagonal")
    if np.linalg.eigvalsh(r)[0] < -_ROUNDING * n:
        raise DataError(
            "these correlations contradict each other: the matrix is not positive semi-definite"
        )
    r.setflags(write=False)
    return r


def report_value(value: float, expanded: float, unit: str) -> str:
    """Return a result and its expanded uncertainty, both rounded to one place.

    Parameters
    ----------
    value : float
        Result in SI.
    expanded : float
        U in SI, >= 0.
    unit : str
        SI unit; m, rad, s and V get a prefix.

    Returns
    -------
    str
        U with two significant digits, the result rounded to the same place.

    Raises
    ------
    DataError
        If a number is not finite or U is negative.

    References
    ----------
    .. [1] JCGM 100:2008, 7.2.6.

    Examples
    --------
    >>> report_value(107.8683e-9, 2.84e-9, "m")
    '(107.9 +- 2.8) nm'
    """
    if not (math.isfinite(value) and math.isfinite(expanded) and expanded >= 0.0):
        raise DataError(f"cannot report {value} +- {expanded}: both finite and U >= 0 are needed")
    prefix, power = _prefix(max(abs(value), expanded), unit)
    name = "" if unit == "1" else f" {prefix}{unit}"
    y = Decimal(repr(float(value) + 0.0)).scaleb(-power)  # + 0.0: no negative zero
    if expanded == 0.0:
        return f"({float(y):.9g} +- 0){name}"
    U = Decimal(repr(float(expanded))).scaleb(-power)
    with localcontext() as context:
        context.prec = _DIGITS
        rounded = U.quantize(Decimal(1).scaleb(U.adjusted() - 1))
        place = Decimal(1).scaleb(rounded.adjusted() - 1)  # 0.0996 becomes 0.10, not 0.100
        U, y = rounded.quantize(place), y.quantize(place)
    if y.is_zero():
        y = abs(y)
    return f"({y:f} +- {U:f}){name}"


def _prefix(size: float, unit: str) -> tuple[str, int]:
    if unit not in ("m", "rad", "s", "V") or size == 0.0:
        return "", 0
    for prefix, power in (("", 0), ("m", -3), ("u", -6), ("n", -9)):
        if size >= 10.0**power:
            return prefix, power
    return "p", -12
