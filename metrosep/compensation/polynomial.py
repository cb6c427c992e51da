"""Polynomial fits of an error: degree by evidence, covariance from between-run scatter.

The fit runs in Legendre polynomials on the domain scaled to [-1, 1], so that any degree and any
unit of length is well conditioned; it is printed in Horner form in the unit the controller wants,
with the range where it is valid. A polynomial through drifting runs is not as certain as its
residual suggests: with several runs each run is fitted apart and the covariance is that of their
mean (papers notes, section 2: never from single-sample least squares).
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, SupportsIndex

import numpy as np
from numpy.polynomial import Polynomial, legendre
from numpy.typing import ArrayLike

from metrosep.compensation.measured import estimate_slope
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    NotConvergedError,
    TableError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.runset import RunSet
from metrosep.core.units import format_ends, format_length, parse_unit
from metrosep.process.straightness_runs import (
    MOST_TRIED,
    Curves,
    basis_of,
    best_degree,
    degree_scores,
    solve,
    to_unit,
)
from metrosep.separation.runs.base import ErrorEstimate

Quantity = Literal["error", "compensation"]
Removed = Literal["offset", "line"]

_ESTIMATE_POINTS = 401
_USEFUL = 0.7
"""Share of the RMS that a correction may leave, as for tables: more is pointless."""


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialFit:
    """A polynomial of position, valid on its domain only.

    Parameters
    ----------
    legendre_coefficients : ndarray, shape (degree + 1,), m
        In Legendre polynomials of the scaled position.
    cov : ndarray or None, shape (degree + 1, degree + 1), m^2
        Their covariance; None where nothing states it.
    cov_source : str
        Where the covariance comes from.
    domain : tuple of (float, float), m
        Where it is valid.
    quantity : {"error", "compensation"}
        What it gives: the error e, or the correction -e.
    residual_rms : float, m
        RMS of what is left.
    scores : tuple of dict
        AICc (Cp of an estimate), residual and test of every degree that was tried.
    chosen_by : str
        How the degree was chosen.
    history : tuple of Step
        From the files on.
    removed : {"offset", "line"}, optional
        What the data behind it have no opinion on: "line" for an estimate without alignment.
    """

    legendre_coefficients: FloatArray
    cov: FloatArray | None
    cov_source: str
    domain: tuple[float, float]
    quantity: Quantity
    residual_rms: float
    scores: tuple[dict[str, float], ...] = ()
    chosen_by: str = "user"
    history: tuple[Step, ...] = ()
    removed: Removed = "offset"

    @property
    def degree(self) -> int:
        """Highest power."""
        return int(self.legendre_coefficients.size - 1)

    @property
    def coefficients(self) -> FloatArray:
        """Coefficients of 1, x, x^2, ... in SI (m, 1, 1/m, ...)."""
        return self._power(1.0, 1.0)

    @property
    def u_coefficients(self) -> FloatArray | None:
        """Standard uncertainties of `coefficients`, the same units; None where not known."""
        if self.cov is None:
            return None
        unit = np.eye(self.degree + 1)
        to_power = np.array([replace(self, legendre_coefficients=c).coefficients for c in unit]).T
        variance = ((to_power @ self.cov) * to_power).sum(axis=1)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def _scaled(self, x: ArrayLike, *, clamp: bool) -> FloatArray:
        low, high = self.domain
        xs = np.atleast_1d(np.asarray(x, dtype=np.float64))
        inside = np.clip(xs, low, high)
        if not clamp:
            margin = 1e-9 * (high - low)
            inside = np.where((xs < low - margin) | (xs > high + margin), np.nan, inside)
        return np.asarray((2.0 * inside - low - high) / (high - low))

    def evaluate(self, x: ArrayLike, *, clamp: bool = False) -> FloatArray:
        """Return the polynomial at positions.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.
        clamp : bool, optional
            Hold the end values outside the domain, as the printed form for a controller does.

        Returns
        -------
        ndarray, shape (n,), m
            NaN outside the domain unless clamped.
        """
        return np.asarray(
            legendre.legval(self._scaled(x, clamp=clamp), self.legendre_coefficients)
        )

    @described_by(evaluate, errors=False)
    def sd(self, x: ArrayLike) -> FloatArray:
        """Return the standard uncertainty of the polynomial at positions.

        Returns
        -------
        ndarray, shape (n,), m
            NaN outside the domain and where no covariance is known.
        """
        basis = legendre.legvander(self._scaled(x, clamp=False), self.degree)
        if self.cov is None:
            return np.full(basis.shape[0], np.nan)
        variance = np.einsum("ij,jk,ik->i", basis, self.cov, basis)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def _power(self, x_factor: float, y_factor: float) -> FloatArray:
        """Coefficients of 1, x, x^2 ... with x and y in other units."""
        low, high = self.domain
        series = legendre.Legendre(self.legendre_coefficients, domain=[low, high])
        powers = series.convert(kind=Polynomial, domain=[-1, 1], window=[-1, 1]).coef
        full = np.zeros(self.degree + 1)
        full[: powers.size] = powers
        return np.asarray(full * x_factor ** np.arange(full.size) / y_factor)

    def correction(self, position: ArrayLike, direction: int = 1) -> FloatArray:
        """Return what is added to the command: c = -e, clamped to the domain.

        Parameters
        ----------
        position : array_like, shape (n,), m
            Commanded positions.
        direction : {1, -1}, optional
            A polynomial is the same both ways.

        Returns
        -------
        ndarray, shape (n,), m
            Of either `quantity`.

        Raises
        ------
        DataError
            If `direction` is neither 1 nor -1.
        """
        if direction not in (1, -1):
            raise DataError(f"direction is +1 or -1, got {direction!r}")
        values = self.evaluate(position, clamp=True)
        return values if self.quantity == "compensation" else -values

    def effect(self, estimate: ErrorEstimate) -> dict[str, Any]:
        """Return what the polynomial leaves of a separated error, both without their line.

        Parameters
        ----------
        estimate : ErrorEstimate
            Error e = actual - nominal.

        Returns
        -------
        dict
            P-V before and after in m, ``rest`` as the share of the RMS that stays, and whether it
            ``helps``: at least 30 % of the RMS go. Empty where the estimate is not known.
        """
        x = np.linspace(*self.domain, 2001)
        line = np.linspace(-1.0, 1.0, x.size)
        found = []
        for direction in estimate.directions:
            error = estimate.evaluate(x, direction=direction or None)
            known = np.isfinite(error)
            if known.sum() < 3:
                continue
            pair = [v[known] for v in (error, error + self.correction(x))]
            pair = [v - np.polyval(np.polyfit(line[known], v, 1), line[known]) for v in pair]
            found.append([*(float(np.ptp(v)) for v in pair), *(float(v.std()) for v in pair)])
        if not found:
            return {}
        before, after, rms, left = np.array(found).max(axis=0)
        rest = float(left / rms) if rms > 0.0 else 1.0
        return {
            "before_pv_m": float(before),
            "after_pv_m": float(after),
            "rest": rest,
            "helps": rest <= _USEFUL,
        }

    @property
    def made_over(self) -> tuple[float, float]:
        """Range of the estimate that it was fitted to, m."""
        return self.domain

    def remade(self, data: ErrorEstimate | RunSet | Profile) -> PolynomialFit:
        """Return the polynomial that the same settings make of other data.

        Parameters
        ----------
        data : ErrorEstimate, RunSet or Profile
            Error e = actual - nominal.

        Returns
        -------
        PolynomialFit
            On the same domain; of the same degree where an estimate without its covariance, such as
            one without a run, cannot choose it.

        Raises
        ------
        DataError
            If its history does not say how it was made.
        """
        step = next((s for s in reversed(self.history) if s.name == "polynomial"), None)
        if step is None:
            raise DataError("the history of the polynomial does not say how it was made")
        told = step.parameters
        estimated = isinstance(data, ErrorEstimate) and not data.has_covariance
        return fit_polynomial(
            data,
            degree=self.degree if estimated else told.get("wanted_degree", self.degree),
            quantity=self.quantity,
            domain=self.domain,
            max_degree=told.get("max_degree", 6),
            on_axis=told.get("on_axis"),
        )

    def horner(self, *, x_unit: str = "mm", y_unit: str = "um", digits: int = 9) -> str:
        """Return the polynomial in Horner form for a controller, with units and range.

        Parameters
        ----------
        x_unit, y_unit : str, optional
            Units of position and value.
        digits : int, optional
            Significant digits of each coefficient, 3 to 17.

        Returns
        -------
        str
            Two comment lines and one line ``y = c0 + x*(c1 + x*(...))``.

        Raises
        ------
        DataError
            If `digits` is out of range.
        """
        numbers = self._printed(x_unit, y_unit, digits)
        text = numbers[-1]
        for number in reversed(numbers[:-1]):
            text = f"{number} + x*({text})"
        low, high = (v / parse_unit(x_unit, dimension="length").factor for v in self.domain)
        meaning = (
            "error e = actual - nominal (subtract it)"
            if self.quantity == "error"
            else "correction c = -e (add it to the command)"
        )
        worst = self.printing_error(x_unit=x_unit, y_unit=y_unit, digits=digits)
        return (
            f"# {meaning}; x in {x_unit}, y in {y_unit}\n"
            f"# valid for {low:.9g} <= x <= {high:.9g}: clamp x to it; printed digits cost at most "
            f"{format_length(worst, digits=2)}\n"
            f"y = {text}"
        )

    def _printed(self, x_unit: str, y_unit: str, digits: int) -> list[str]:
        if not 3 <= digits <= 17:
            raise DataError(f"digits must be 3 to 17, got {digits}")
        x_factor = parse_unit(x_unit, dimension="length").factor
        y_factor = parse_unit(y_unit, dimension="length").factor
        return [f"{c:.{digits}g}" for c in self._power(x_factor, y_factor)]

    @described_by(horner)
    def printing_error(self, *, x_unit: str = "mm", y_unit: str = "um", digits: int = 9) -> float:
        """Return the largest deviation when only the printed digits are used.

        Returns
        -------
        float, m
            Over the domain.
        """
        x = np.linspace(*self.domain, 2001)
        numbers = [float(n) for n in self._printed(x_unit, y_unit, digits)]
        y = (
            np.polynomial.polynomial.polyval(
                x / parse_unit(x_unit, dimension="length").factor, numbers
            )
            * parse_unit(y_unit, dimension="length").factor
        )
        return float(np.abs(y - self.evaluate(x)).max())

    def to_dict(self) -> dict[str, Any]:
        """Return plain values with units in the keys.

        Returns
        -------
        dict
            For results and reports; ``u_greatest_m`` is the greatest standard uncertainty over the
            domain, without misfit, and of runs without their mean, since each has an offset of its
            own.
        """
        basis = legendre.legvander(np.linspace(-1.0, 1.0, 401), self.degree)
        if self.removed == "offset":
            basis[:, 0] = 0.0
        return {
            "degree": self.degree,
            "quantity": self.quantity,
            "domain_m": list(self.domain),
            "coefficients_si": self.coefficients.tolist(),
            "u_coefficients_si": None
            if self.u_coefficients is None
            else self.u_coefficients.tolist(),
            "legendre_coefficients_m": self.legendre_coefficients.tolist(),
            "legendre_covariance_m2": None if self.cov is None else self.cov.tolist(),
            "covariance_from": self.cov_source,
            "removed": self.removed,
            "u_greatest_m": None
            if self.cov is None
            else float(np.sqrt(np.einsum("ij,jk,ik->i", basis, self.cov, basis).clip(0.0).max())),
            "residual_rms_m": self.residual_rms,
            "degree_chosen_by": self.chosen_by,
            "scores": [dict(s) for s in self.scores],
            "horner": self.horner(),
        }


def fit_polynomial(
    data: ErrorEstimate | RunSet | Profile,
    *,
    degree: int | Literal["aicc", "f-test"] = "aicc",
    quantity: Quantity = "error",
    domain: tuple[float, float] | None = None,
    max_degree: int = 6,
    on_axis: bool | None = None,
) -> PolynomialFit:
    """Fit a polynomial to an error over position.

    Parameters
    ----------
    data : ErrorEstimate, RunSet or Profile
        Error e = actual - nominal. Runs are fitted one by one and averaged.
    degree : int or {"aicc", "f-test"}, optional
        Degree, or how to choose it. The uncertainty of an estimate is known, so there "aicc" takes
        the degree of the least expected distance from the truth, see Notes, and "f-test" is a
        chi-square test.
    quantity : {"error", "compensation"}, optional
        Whether to give e or -e; never inferred.
    domain : tuple of (float, float), m, optional
        Positions to fit over; all of the data if omitted.
    max_degree : int, optional
        Highest degree to try, up to 12.
    on_axis : bool, optional
        Whether the error is along the axis whose position it depends on. The slope that an estimate
        holds apart is then part of it; across the axis, as if omitted, it is the alignment and left
        out. Runs and profiles keep what slope they have.

    Returns
    -------
    PolynomialFit
        With covariance from the scatter between runs, or that of the estimate.

    Raises
    ------
    DataError
        If an option is not one of its choices, or the domain leaves what was measured.
    TooFewSamplesError
        If there are too few samples for the degree.
    DegenerateFitError
        If the domain is empty.

    Notes
    -----
    With C the covariance of an estimate z and H the projector on a degree, the expected square of
    ``H z - truth`` is that of ``|z - H z|^2 + 2 tr(H C) - tr(C)``; the degree of its least value is
    taken. In an orthonormal basis a term q of variance v lowers it where ``q^2 > 2 v``.

    References
    ----------
    .. [1] C. L. Mallows, Some comments on Cp, Technometrics 15 (1973) 661-675.
    """
    if quantity not in ("error", "compensation"):
        raise DataError(
            f"quantity={quantity!r}; state 'error' or 'compensation': the sign follows"
        )
    if domain is not None and not domain[1] > domain[0]:
        raise DegenerateFitError(f"the domain {domain[0]} ... {domain[1]} m has no length")
    line = _line(data) if on_axis and isinstance(data, ErrorEstimate) else None
    curves = _curves(data, domain)
    if line is not None:
        curves = [(x, z + line.value * (x - line.middle)) for x, z in curves]
    low = min(float(x.min()) for x, _ in curves) if domain is None else domain[0]
    high = max(float(x.max()) for x, _ in curves) if domain is None else domain[1]
    if not high > low:
        raise DegenerateFitError(f"the domain {low} ... {high} m has no length")
    known = _known_covariance(data, curves)
    chosen, scores, how = choose_degree(curves, (low, high), degree, max_degree, known)
    fits = np.array([fit_legendre(x, z, (low, high), chosen) for x, z in curves])
    coefficients = fits.mean(axis=0)
    cov, source = _covariance(fits, data, (low, high), chosen)
    if line is not None and cov is not None:
        cov, source = line.added(cov, source, (low, high))
    residual = [
        z - legendre.legval(to_unit(x, (low, high)), f)
        for (x, z), f in zip(curves, fits, strict=True)
    ]
    sign = -1.0 if quantity == "compensation" else 1.0
    return PolynomialFit(
        legendre_coefficients=sign * coefficients,
        cov=cov,
        cov_source=source,
        domain=(low, high),
        quantity=quantity,
        residual_rms=float(np.sqrt(np.mean(np.concatenate(residual) ** 2))),
        scores=tuple(scores),
        chosen_by=how,
        history=(
            *data.history,
            Step(
                "polynomial",
                {
                    "degree": chosen,
                    "quantity": quantity,
                    "wanted_degree": degree,
                    "max_degree": max_degree,
                    **({"on_axis": True} if line is not None else {}),
                    **(
                        {"runs_sha256": [r.sha256 for r in data]}
                        if isinstance(data, RunSet)
                        else {}
                    ),
                },
            ),
        ),
        removed="line" if isinstance(data, ErrorEstimate) and line is None else "offset",
    )


@dataclass(frozen=True, slots=True)
class _Line:
    """The slope that an estimate holds apart; zero in the middle of its range."""

    value: float  # rad
    u: float | None  # rad; None where not known
    middle: float  # m

    def added(
        self, cov: FloatArray, source: str, domain: tuple[float, float]
    ) -> tuple[FloatArray | None, str]:
        """Return a covariance of Legendre coefficients with that of the line, and its source."""
        if self.u is None:
            return None, "unknown: the slope of the estimate has no uncertainty"
        # x - middle = (m - middle) P_0 + h P_1, with m the middle and h half of the domain
        line: FloatArray = np.zeros(max(cov.shape[0], 2))
        line[:2] = 0.5 * (domain[0] + domain[1]) - self.middle, 0.5 * (domain[1] - domain[0])
        line = line[: cov.shape[0]]
        return cov + self.u**2 * np.outer(line, line), f"{source} and its slope"


def _line(estimate: ErrorEstimate) -> _Line:
    """Return the slope of an estimate; refused where it does not state one."""
    middle = 0.5 * (estimate.start + estimate.stop)
    return _Line(estimate_slope(estimate), estimate.slope.u, middle)


def _curves(
    data: ErrorEstimate | RunSet | Profile, domain: tuple[float, float] | None
) -> list[tuple[FloatArray, FloatArray]]:
    if isinstance(data, ErrorEstimate):
        x = np.linspace(data.start, data.stop, _ESTIMATE_POINTS)
        pairs = [(x, data.evaluate(x))]
    elif isinstance(data, RunSet):
        pairs = [(r.x, r.z) for r in data]
    elif isinstance(data, Profile):
        data.require_metres()
        pairs = [(data.x, data.z)]
    else:
        raise DataError(f"pass an ErrorEstimate, a RunSet or a Profile, got {type(data).__name__}")
    kept = []
    for x, z in pairs:
        keep = ~np.isnan(z)
        if domain is not None and keep.any():
            _check_domain(x[keep], domain)
            keep &= (x >= domain[0]) & (x <= domain[1])
        if not keep.any():
            raise TooFewSamplesError("no valid sample lies in the domain of the polynomial")
        kept.append((x[keep], z[keep]))
    return kept


def _known_covariance(data: Any, curves: Curves) -> FloatArray | None:
    """Return the covariance of the values of an estimate, shape (n, n), m^2; None where not known."""
    if not isinstance(data, ErrorEstimate) or not data.has_covariance:
        return None
    whole = data.covariance(curves[0][0])
    return whole if np.isfinite(whole).all() else None


def _check_domain(x: FloatArray, domain: tuple[float, float]) -> None:
    low, high = float(x.min()), float(x.max())
    step = (high - low) / max(x.size - 1, 1)
    if domain[0] < low - step or domain[1] > high + step:
        raise DataError(
            f"the domain {format_ends(domain[0], domain[1])} leaves the "
            f"measured range {format_ends(low, high)}: a polynomial is not "
            "extrapolated; narrow the domain or measure further"
        )


def _covariance(
    fits: FloatArray,
    data: ErrorEstimate | RunSet | Profile,
    domain: tuple[float, float],
    degree: int,
) -> tuple[FloatArray | None, str]:
    n = fits.shape[0]
    if n > 1:
        return np.atleast_2d(np.cov(fits, rowvar=False)) / n, f"scatter of {n} runs"
    if isinstance(data, ErrorEstimate):
        x = np.linspace(*domain, _ESTIMATE_POINTS)
        basis = legendre.legvander(to_unit(x, domain), degree)
        pinv = np.linalg.pinv(basis)
        if data.has_covariance:
            whole = data.covariance(x)
            if np.isfinite(whole).all():
                return np.asarray(pinv @ whole @ pinv.T), "covariance of the estimate"
            return None, "unknown: the uncertainty of the estimate has gaps"
        band = data.sd(x)
        if np.isfinite(band).all():
            # stored without its covariance: a triangle a quarter of the domain wide
            width = 0.25 * (domain[1] - domain[0])
            block = np.maximum(1.0 - np.abs(x[:, None] - x) / width, 0.0)
            return np.asarray(
                pinv @ (np.outer(band, band) * block) @ pinv.T
            ), "band of the estimate, stored without its covariance"
    return None, "unknown: one run tells no scatter"


MAX_DEGREE = 60


def fit_legendre(
    x: FloatArray, z: FloatArray, domain: tuple[float, float], degree: int
) -> FloatArray:
    """Return the least-squares coefficients in Legendre polynomials of the scaled position."""
    if x.size < degree + 2:
        raise TooFewSamplesError(
            f"a polynomial of degree {degree} needs {degree + 2} samples, got {x.size}"
        )
    return solve(basis_of(to_unit(x, domain), degree), z, degree)


def choose_degree(
    curves: Curves,
    domain: tuple[float, float],
    degree: SupportsIndex | str,
    max_degree: int,
    known: FloatArray | None = None,
) -> tuple[int, list[dict[str, float]], str]:
    """Return a degree, the scores of all that were tried, and who chose it; `known`: covariance of the one curve."""
    if isinstance(degree, SupportsIndex) and not isinstance(degree, bool):
        wanted = operator.index(degree)
        if not 0 <= wanted <= MAX_DEGREE:
            raise DataError(f"degree must be 0 to {MAX_DEGREE}, got {wanted}")
        return wanted, [], "user"
    if degree not in ("aicc", "f-test"):
        raise DataError(f"degree={degree!r}; use a number, 'aicc' or 'f-test'")
    if not 0 <= max_degree <= MOST_TRIED:
        raise DataError(
            f"max_degree must be 0 to {MOST_TRIED}, got {max_degree}; state a higher "
            "degree itself, as degree"
        )
    if known is not None:
        scores = _scores_of_estimate(*curves[0], known, domain, max_degree)
        if degree == "aicc":
            best = int(np.argmin([s["cp_m2"] for s in scores]))
            return best, scores, "least expected error, Cp with the covariance of the estimate"
        return best_degree(scores, degree), scores, "chi-square test, 1 %"
    scores = degree_scores(curves, domain, max_degree, rounding=1e-14)
    return best_degree(scores, degree), scores, "AICc" if degree == "aicc" else "F-test, 1 %"


def _scores_of_estimate(
    x: FloatArray, z: FloatArray, known: FloatArray, domain: tuple[float, float], most: int
) -> list[dict[str, float]]:
    """Return Cp per sample, residual and chi-square test of each degree, the covariance known."""
    from scipy.special import chdtrc

    top = min(most, x.size // 3)
    q, _ = np.linalg.qr(basis_of(to_unit(x, domain), top))
    terms, spread = (q.T @ z) ** 2, np.einsum("ij,ik,kj->j", q, known, q, optimize=True)
    left = np.maximum(float(z @ z) - np.cumsum(terms), 0.0)
    cp = (left + 2.0 * np.cumsum(spread) - float(np.trace(known))) / x.size
    p = [
        float(chdtrc(1.0, t / v)) if v > 0.0 else float(t == 0.0)
        for t, v in zip(terms, spread, strict=True)
    ]
    return [
        {
            "degree": d,
            "cp_m2": float(cp[d]),
            "residual_rms_m": float(np.sqrt(left[d] / x.size)),
            **({"p_of_f_test": p[d]} if d else {}),
        }
        for d in range(top + 1)
    ]


# ---- the correction that cancels an error exactly: lookup at the command, error at the actual place ----
# A controller looks the correction up at the uncorrected position p, while the error acts where the
# axis then is, p + c. With c = -e(p) a rest of about e e' is left; the exact inverse solves
# c(p) = -e(p + c(p)) (controllers notes, section 0).

_TOLERANCE = 1e-13
"""Convergence of the fixed point in m: a tenth of a picometre."""

_MAX_STEPS = 60


def exact_correction(
    error: Callable[[FloatArray], FloatArray], positions: FloatArray
) -> FloatArray:
    """Return c with ``c(p) = -e(p + c(p))``.

    Parameters
    ----------
    error : callable
        Error e in m at positions in m.
    positions : ndarray, shape (n,), m
        Commanded positions p.

    Returns
    -------
    ndarray, shape (n,), m
        Correction to add to the command.

    Raises
    ------
    TableError
        If the error is so steep that the axis would turn back, ``|de/dx| >= 1``, or not finite
        where it is looked up.
    NotConvergedError
        If the fixed point does not settle to 0.1 pm.

    Examples
    --------
    >>> import numpy as np
    >>> bool(abs(exact_correction(lambda x: 0.01 * x, np.array([1.0]))[0] + 0.01 / 1.01) < 1e-13)
    True
    """
    correction = -_finite(error, positions)
    for _ in range(_MAX_STEPS):
        update = -_finite(error, positions + correction)
        change = float(np.abs(update - correction).max(initial=0.0))
        correction = update
        if change < _TOLERANCE:
            return correction
        if change > 1e3:
            break
    steep = (
        float(np.abs(np.diff(error(positions)) / np.diff(positions)).max())
        if positions.size > 1
        else float("nan")
    )
    if steep >= 1.0:
        raise TableError(
            f"the error changes by {steep:.3g} m per m: the corrected axis would turn back; check "
            "the units of position and error (mm against um?)"
        )
    raise NotConvergedError(
        f"the exact inverse did not settle to 0.1 pm (largest slope {steep:.3g}); smooth the error "
        "or use exact=False"
    )


def _finite(error: Callable[[FloatArray], FloatArray], places: FloatArray) -> FloatArray:
    values = np.asarray(error(places), dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise TableError(
            f"the error is not finite at {places[int(bad[0])] * 1e3:.9g} mm ({bad.size} of "
            f"{places.size} places): narrow the positions to what was measured"
        )
    return values
