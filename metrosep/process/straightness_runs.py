"""Straightness of a slide from repeated runs: alignment apart, polynomial, repeatability.

The slope of a slide against its reference is alignment, what is left is straightness; a headline
number that mixes both says nothing. Error is positive out of the material.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.polynomial import legendre, polynomial as power
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, DegenerateFitError, LimitError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.process._plain import Frozen, frozen

_LINES = {"end-point": "EP", "least-squares": "LS", "minimum-zone": "MZ"}
_FEW = 10
"""Runs up to which a message says what their number does to a coverage factor."""

_ARCSEC = 180.0 * 3600.0 / math.pi


@dataclass(frozen=True, slots=True)
class StraightnessLines(Frozen):
    """Straightness about three lines, the slope of each apart.

    Parameters
    ----------
    total : Quantity, m
        P-V of the readings, alignment included.
    straightness : mapping of str to Quantity
        ``end-point``, ``least-squares`` and ``minimum-zone`` in m.
    slope : mapping of str to Quantity
        Slope of each line in m/m: the alignment.
    audit : mapping
        The same in um and arcsec, and the alignment's share of the total.
    messages : tuple of str
        In plain words.
    """

    total: Quantity
    straightness: Mapping[str, Quantity]
    slope: Mapping[str, Quantity]
    audit: Mapping[str, Any]
    messages: tuple[str, ...]


def straightness_lines(profile: Profile, *, against: str = "spindle face") -> StraightnessLines:
    """Return the straightness of a profile about three lines and its alignment apart.

    Parameters
    ----------
    profile : Profile
        Readings over the slide's position.
    against : str, optional
        What was measured against; goes into the definitions.

    Returns
    -------
    StraightnessLines
        Total, straightness, slopes.

    Raises
    ------
    TooFewSamplesError
        If fewer than 3 samples are valid.

    Notes
    -----
    For a parabola ``c x^2`` over the length L all three lines give ``c L^2/4``. The slope against
    the table is set-up only; against the spindle face it is the squareness that turns a face into
    a cone.

    References
    ----------
    .. [1] ISO 230-1:2012 (lines); dual-servo paper, section 4.3.

    Examples
    --------
    >>> x = np.linspace(0.0, 40e-3, 401)
    >>> lines = straightness_lines(Profile(x, 6.05e-3 * x**2 + 1e-4 * x))
    >>> round(lines.straightness["minimum-zone"].value * 1e6, 3)
    2.42
    """
    from metrosep.parameters.straightness import straightness_deviation

    total = profile.peak_to_valley()
    straight, slope = {}, {}
    for name, code in _LINES.items():
        found = straightness_deviation(profile, reference=code)  # type: ignore[arg-type]
        what = f"the {name} line against the {against}"
        straight[name] = Quantity(found.value, "m", f"straightness about {what}, no filter")
        inclined = found.reference_parameters["slope"].value
        slope[name] = Quantity(inclined, "1", f"slope of {what}")
    length = float(profile.x[-1] - profile.x[0])
    tilt = abs(slope["least-squares"].value)
    share = tilt * length / total if total > 0.0 else math.nan
    messages = []
    if share > 0.5:
        messages.append(
            f"of {total * 1e6:.4g} um against the {against}, "
            f"{straight['least-squares'].value * 1e6:.4g} um is straightness; most is alignment "
            f"({tilt * _ARCSEC:.4g} arcsec)"
        )
    audit = {
        "total_um": total * 1e6,
        **{f"{n.replace('-', '_')}_um": q.value * 1e6 for n, q in straight.items()},
        **{f"slope_{n.replace('-', '_')}_arcsec": q.value * _ARCSEC for n, q in slope.items()},
        "length_mm": length * 1e3,
        "samples_not_measured": profile.n_invalid,
    }
    whole = Quantity(total, "m", f"P-V against the {against}, alignment included", symbol="PV")
    return StraightnessLines(whole, straight, slope, audit, tuple(messages))


@dataclass(frozen=True, slots=True, eq=False)
class RunPolynomial(Frozen):
    """A polynomial of the position with covariance from the scatter between runs.

    Parameters
    ----------
    coefficients : ndarray, shape (degree + 1,)
        Of x^0, x^1 ... in m, 1, 1/m ...; x in m.
    cov : ndarray or None, shape (degree + 1, degree + 1)
        Of the mean of the runs; None with one run.
    quantity : {"error", "compensation"}
        What the polynomial gives.
    domain : tuple of (float, float), m
        Where all runs measured; not to be left.
    drift : ndarray, shape (runs, 2)
        Offset in m and slope of each run about the mean of all, at the middle of the domain.
    residual_rms : float, m
        Left by one polynomial and a line per run.
    repeatability : float, m
        Standard deviation between runs at one position, pooled, drift lines removed; NaN with
        one run.
    n_runs : int
        Runs.
    scores : tuple of mapping
        AICc, F-test and residual of every degree that was tried.
    audit : mapping
        Coefficients in um and mm with their uncertainties, and settings.
    messages : tuple of str
        In plain words.
    history : tuple of Step
        From the first run on.
    scaled : tuple of (ndarray, ndarray or None), optional
        Coefficients and covariance in powers of (x - middle)/half of the domain: powers of x lose
        all digits of the covariance where the domain lies far from 0. `evaluate` and `sd` use it.
    """

    coefficients: FloatArray
    cov: FloatArray | None
    quantity: str
    domain: tuple[float, float]
    drift: FloatArray
    residual_rms: float
    repeatability: float
    n_runs: int
    scores: tuple[Mapping[str, float], ...]
    audit: Mapping[str, Any]
    messages: tuple[str, ...]
    history: tuple[Step, ...]
    scaled: tuple[FloatArray, FloatArray | None] | None = None

    @property
    def degree(self) -> int:
        """Highest power."""
        return int(self.coefficients.size) - 1

    @property
    def u(self) -> FloatArray:
        """Standard uncertainties of the coefficients; NaN with one run."""
        if self.cov is None:
            return np.full(self.coefficients.size, np.nan)
        return np.asarray(np.sqrt(np.diag(self.cov)))

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the polynomial at positions.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Within the domain; NaN stays NaN.

        Returns
        -------
        ndarray, shape (n,), m
            In the sign of `quantity`.

        Raises
        ------
        LimitError
            If a position was not measured.
        """
        at = frozen_float(np.atleast_1d(np.asarray(x)), name="x", ndim=1)
        slack = 1e-9 * (self.domain[1] - self.domain[0])
        outside = (at < self.domain[0] - slack) | (at > self.domain[1] + slack)
        if outside.any():
            first = float(at[outside][0])
            beyond = max(self.domain[0] - first, first - self.domain[1])
            raise LimitError(
                f"x = {at[outside][0] * 1e3:.6g} mm lies outside {self.domain[0] * 1e3:.6g} ... "
                f"{self.domain[1] * 1e3:.6g} mm by {beyond * 1e3:.3g} mm: a polynomial is not "
                "extrapolated"
            )
        if self.scaled is None:
            return np.asarray(power.polyval(at, self.coefficients))
        return np.asarray(power.polyval(self._own(at), self.scaled[0]))

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return the standard uncertainty of the polynomial at positions.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions.

        Returns
        -------
        ndarray, shape (n,), m
            NaN with one run.
        """
        at = frozen_float(np.atleast_1d(np.asarray(x)), name="x", ndim=1)
        if self.cov is None:
            return np.full(at.size, np.nan)
        cov, own = self.cov, at
        if self.scaled is not None and self.scaled[1] is not None:
            cov, own = self.scaled[1], self._own(at)
        basis = power.polyvander(own, self.degree)
        variance = np.einsum("ij,jk,ik->i", basis, cov, basis)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def error(self, x: ArrayLike) -> FloatArray:
        """Return the error that the polynomial describes, whatever its own sign.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Within the domain.

        Returns
        -------
        ndarray, shape (n,), m
            Positive out of the material.

        Raises
        ------
        LimitError
            If a position was not measured.
        """
        return self.evaluate(x) if self.quantity == "error" else -self.evaluate(x)

    def _own(self, x: FloatArray) -> FloatArray:
        low, high = self.domain
        return np.asarray((x - 0.5 * (low + high)) / (0.5 * (high - low)))


def run_polynomial(
    runs: Iterable[Profile],
    *,
    quantity: Literal["error", "compensation"],
    degree: int | Literal["aicc", "f-test"] = "aicc",
    max_degree: int = 6,
) -> RunPolynomial:
    """Return one polynomial through repeated runs of a slide.

    Parameters
    ----------
    runs : iterable of Profile
        Repeated runs; NaN is omitted.
    quantity : {"error", "compensation"}
        What the runs hold, and so what the polynomial gives; never inferred.
    degree : int or {"aicc", "f-test"}, optional
        Degree, or how to choose it.
    max_degree : int, optional
        Highest degree to try.

    Returns
    -------
    RunPolynomial
        Coefficients with covariance, drift of each run, repeatability.

    Raises
    ------
    DataError
        If `quantity` or `degree` is not one of its choices, or the runs share no range.
    TooFewSamplesError
        If there is no run, or too few samples in one.
    DegenerateFitError
        If the positions do not determine the degree.

    Notes
    -----
    Each run is fitted apart over what all runs share; coefficients are the mean of the runs and
    their covariance is that of the runs over their number. Single-sample least squares would
    state a tenth of the true uncertainty where runs drift. With fewer runs than coefficients the
    covariance is singular and a message says so. AICc takes a needless degree in about a quarter
    of all cases, the F-test at 1 % in a few percent.

    References
    ----------
    .. [1] Dual-servo paper, eq. 1.

    Examples
    --------
    >>> x = np.linspace(0.0, 40e-3, 81)
    >>> run = Profile(x, 1e-6 + 5e-3 * x**2)
    >>> run_polynomial([run, run], quantity="error", degree=2).degree
    2
    """
    if quantity not in ("error", "compensation"):
        raise DataError(
            f"quantity={quantity!r}; state 'error' or 'compensation': the sign follows"
        )
    listed = list(runs)
    pairs, domain = _shared(listed)
    scores: list[dict[str, float]] = []
    if isinstance(degree, str):
        numbers.choice(degree, "degree, if no number,", ("aicc", "f-test"))
        most = numbers.count(max_degree, "max_degree", most=MOST_TRIED)
        found = degree_scores(pairs, domain, most, rounding=1e-13)
        chosen = best_degree(found, degree)
        scores = [
            {
                "degree": f.pop("degree"),
                "aicc": f.pop("aicc"),
                "residual_rms_nm": f.pop("residual_rms_m") * 1e9,
                **f,
            }
            for f in found
        ]
    else:
        chosen = numbers.count(degree, "degree", least=0, most=20)
    middle, half = 0.5 * (domain[0] + domain[1]), 0.5 * (domain[1] - domain[0])
    fits = np.array([fit_scaled(x, z, chosen, middle, half) for x, z in pairs])
    n = len(pairs)
    own, own_cov = fits.mean(axis=0), _covariance(fits)
    to_x = np.column_stack([to_powers(e, middle, half) for e in np.eye(chosen + 1)])
    mean = to_x @ own
    cov = None if own_cov is None else _covariance(fits @ to_x.T)
    rest = left_by(pairs, domain, chosen)
    scatter = _repeatability(pairs, domain)
    drift = _drift(pairs, own, domain)
    u = np.full(chosen + 1, np.nan) if cov is None else np.sqrt(np.diag(cov))
    audit = {
        "degree": chosen,
        "chosen_by": degree if isinstance(degree, str) else "user",
        "quantity": quantity,
        "runs": n,
        "domain_mm": (domain[0] * 1e3, domain[1] * 1e3),
        "coefficients_um_mm": [float(c) * 1e6 * 1e-3**k for k, c in enumerate(mean)],
        "u_um_mm": None if cov is None else [float(c) * 1e6 * 1e-3**k for k, c in enumerate(u)],
        "cov_source": f"scatter of {n} runs" if n > 1 else "unknown: one run",
        "cov_degrees_of_freedom": n - 1,
    }
    return RunPolynomial(
        coefficients=mean,
        cov=cov,
        quantity=quantity,
        domain=domain,
        drift=drift,
        residual_rms=float(np.sqrt(np.mean(np.concatenate(rest) ** 2))),
        repeatability=scatter,
        n_runs=n,
        scores=tuple(freeze_mapping(s) for s in scores),
        audit=audit,
        messages=_polynomial_messages(n, chosen, drift, scatter),
        history=(*listed[0].history, Step("run_polynomial", {"degree": chosen, "runs": n})),
        scaled=(frozen(own), own_cov),
    )


def _shared(runs: list[Profile]) -> tuple[Curves, tuple[float, float]]:
    if not runs:
        raise TooFewSamplesError("a polynomial needs at least one run, got none")
    pairs = []
    for i, run in enumerate(runs):
        if not isinstance(run, Profile):
            raise DataError(f"run {i} is a {type(run).__name__}; pass Profiles")
        run.require_metres()
        valid = ~np.isnan(run.z)
        if valid.sum() < 3:
            raise TooFewSamplesError(f"run {i} has {int(valid.sum())} valid samples, needs 3")
        pairs.append((run.x[valid], run.z[valid]))
    low = max(float(x[0]) for x, _ in pairs)
    high = min(float(x[-1]) for x, _ in pairs)
    if not high > low:
        raise DataError(
            f"the runs share no range of positions ({low:.6g} m is behind {high:.6g} m)"
        )
    slack = 1e-9 * (high - low)
    kept = []
    for i, (x, z) in enumerate(pairs):
        inside = (x >= low - slack) & (x <= high + slack)
        if inside.sum() < 3:
            raise TooFewSamplesError(
                f"run {i} has {int(inside.sum())} samples in the shared range"
            )
        kept.append((x[inside], z[inside]))
    return kept, (low, high)


def _repeatability(pairs: Curves, domain: tuple[float, float]) -> float:
    """Return the pooled standard deviation between runs on common positions, lines removed."""
    n = len(pairs)
    if n < 2:
        return math.nan
    grid = np.linspace(*domain, min(x.size for x, _ in pairs))
    first = pairs[0][0]
    if all(x.size == first.size and bool((x == first).all()) for x, _ in pairs):
        grid = first
    curves = np.array([np.interp(grid, x, z) for x, z in pairs])
    away = curves - curves.mean(axis=0)
    basis = power.polyvander((grid - grid.mean()) / (grid[-1] - grid[0]), 1)
    away -= (basis @ np.linalg.lstsq(basis, away.T, rcond=None)[0]).T
    return float(np.sqrt((away**2).sum() / ((n - 1) * max(grid.size - 2, 1))))


def _covariance(fits: FloatArray) -> FloatArray | None:
    """Return the covariance of the mean of the runs; None with one run."""
    if len(fits) < 2:
        return None
    return frozen(np.atleast_2d(np.cov(fits, rowvar=False)) / len(fits))


def _drift(pairs: Curves, own: FloatArray, domain: tuple[float, float]) -> FloatArray:
    """Return offset and slope of each run about the mean, of scaled coefficients `own`."""
    middle, half = 0.5 * (domain[0] + domain[1]), 0.5 * (domain[1] - domain[0])
    lines = []
    for x, z in pairs:
        u = (x - middle) / half
        slope, offset = power.polyfit(u, z - power.polyval(u, own), 1)[::-1]
        lines.append((offset, slope / half))
    return np.array(lines)


def _polynomial_messages(
    n: int, degree: int, drift: FloatArray, scatter: float
) -> tuple[str, ...]:
    messages = []
    if n == 1:
        messages.append("one run: no uncertainty can be stated; repeat the run")
    elif n <= degree + 1:
        messages.append(
            f"{n} runs for {degree + 1} coefficients: the covariance is singular; single "
            "uncertainties hold, combinations may be too certain"
        )
    if 1 < n <= _FEW:
        from scipy.special import stdtrit

        messages.append(
            f"uncertainties rest on {n} runs, {n - 1} degree{'s' * (n > 2)} of freedom: 95 % of "
            f"values lie within {stdtrit(n - 1, 0.975):.3g} u, not 2 u"
        )
    if n > 1 and float(drift[:, 0].std(ddof=1)) > 2.0 * scatter / math.sqrt(max(n, 1)):
        messages.append(
            f"the runs drift by {drift[:, 0].std(ddof=1) * 1e9:.3g} nm between each other: that, "
            "not noise, limits the constant term"
        )
    return tuple(messages)


# ---- private: plain powers of x, as a lathe's controller takes them -----------------------------


def fit_scaled(
    x: FloatArray, z: FloatArray, degree: int, centre: float, scale: float
) -> FloatArray:
    """Return least-squares coefficients of powers of (x - centre)/scale, lowest first."""
    if x.size < degree + 2:
        raise TooFewSamplesError(
            f"degree {degree} needs {degree + 2} samples in a run, got {x.size}"
        )
    basis = np.asarray(power.polyvander((x - centre) / scale, degree), dtype=np.float64)
    return solve(basis, z, degree)


def to_powers(own: FloatArray, centre: float, scale: float) -> FloatArray:
    """Return the coefficients of x from those of (x - centre)/scale."""
    total = np.zeros(1)
    for c in own[::-1]:
        total = power.polyadd(power.polymul(total, [-centre / scale, 1.0 / scale]), [c])
    result = np.zeros(own.size)
    result[: min(total.size, own.size)] = total[: own.size]
    return result


# ---- which degree a polynomial through several runs needs: AICc or F-test, drift of each run kept apart ----
# Every degree is tried as one polynomial common to all runs; each run may differ from it by its own
# offset and slope (drift), so that drift is not taken for shape, nor noise for shape n times over.
# The samples of a run are not independent: how many there are follows from the lag-one correlation
# r of the residual of the highest degree, n (1 - r)/(1 + r), and is the same for every degree, as a
# comparison of likelihoods demands.

Curves = list[tuple[FloatArray, FloatArray]]
"""Positions and values of each run."""

MOST_TRIED = 12
"""A higher degree is stated, not chosen."""
_SIGNIFICANT = 0.01


def to_unit(x: FloatArray, domain: tuple[float, float]) -> FloatArray:
    """Return positions scaled so that the domain is -1 ... 1."""
    return np.asarray((2.0 * x - domain[0] - domain[1]) / (domain[1] - domain[0]))


def basis_of(u: FloatArray, degree: int) -> FloatArray:
    """Return Legendre polynomials up to a degree, one a column."""
    return np.asarray(legendre.legvander(u, degree), dtype=np.float64)


def solve(basis: FloatArray, z: FloatArray, degree: int) -> FloatArray:
    """Return least-squares coefficients; refuse positions that do not determine them."""
    scale = float(np.abs(z).max()) or 1.0
    solution, _, rank, _ = np.linalg.lstsq(basis, z / scale, rcond=None)
    if rank < basis.shape[1]:
        raise DegenerateFitError(
            f"degree {degree} is not determined by these positions (rank {rank} of "
            f"{basis.shape[1]}); lower the degree"
        )
    return np.asarray(solution * scale)


def best_degree(scores: list[dict[str, float]], rule: str) -> int:
    """Return the degree of the smallest AICc, or the highest one that an F-test at 1 % asks for."""
    if rule == "aicc":
        return int(np.argmin([s["aicc"] for s in scores]))
    significant = [d for d, s in enumerate(scores) if s.get("p_of_f_test", 1.0) < _SIGNIFICANT]
    return max(significant, default=0)


def degree_scores(
    curves: Curves, domain: tuple[float, float], most: int, *, rounding: float
) -> list[dict[str, float]]:
    """Return the scores of each degree; `rounding`: residual over data that is nothing but rounding."""
    top = min(most, min(x.size for x, _ in curves) // 3)
    rests = [left_by(curves, domain, d) for d in range(top + 1)]
    n = sum(x.size for x, _ in curves)
    # two samples of every further run are spent on its own offset and slope
    spent = 2.0 * (len(curves) - 1)
    m = max(sum(_independent(r) for r in rests[-1]) - spent, top + 4.0)
    largest = max(float(np.abs(z).max()) for _, z in curves)
    floor = (rounding * largest) ** 2 * n + 1e-300
    squares = [max(sum(float(r @ r) for r in rest), floor) for rest in rests]
    scores: list[dict[str, float]] = []
    for d, square in enumerate(squares):
        k = d + 2
        penalty = 2.0 * k + 2.0 * k * (k + 1) / max(m - k - 1.0, 1.0)
        scores.append(
            {
                "degree": d,
                "aicc": m * math.log(square / squares[0]) + penalty,
                "residual_rms_m": math.sqrt(square / n),
                "independent_samples": m,
            }
        )
    for d, (low, high) in enumerate(itertools.pairwise(squares), start=1):
        scores[d]["p_of_f_test"] = _f_test(low - high, high, m - d - 1.0)
    return scores


def left_by(curves: Curves, domain: tuple[float, float], degree: int) -> list[FloatArray]:
    """Return what one common polynomial leaves, each run with its own offset and slope beside.

    The offsets and slopes of the runs sum to zero, so that the common part keeps its own.
    """
    last = len(curves) - 1
    blocks = []
    for i, (x, _) in enumerate(curves):
        u = to_unit(x, domain)
        line = basis_of(u, 1)
        own: FloatArray = np.zeros((x.size, last, 2))
        if i < last:
            own[:, i] = line
        else:
            own[:] = -line[:, None, :]
        blocks.append(np.hstack([basis_of(u, degree), own.reshape(x.size, -1)]))
    basis, z = np.vstack(blocks), np.concatenate([z for _, z in curves])
    rest = z - basis @ solve(basis, z, degree)
    return np.split(rest, np.cumsum([x.size for x, _ in curves])[:-1])


def _independent(rest: FloatArray) -> float:
    norm = float(rest @ rest)
    r = max(float(rest[1:] @ rest[:-1]) / norm, 0.0) if norm > 0.0 else 0.0
    return rest.size * (1.0 - r) / (1.0 + r)


def _f_test(gain: float, rest: float, freedom: float) -> float:
    from scipy.special import fdtrc

    if freedom < 1.0:
        return 1.0
    return float(fdtrc(1.0, freedom, max(gain, 0.0) / rest * freedom))
