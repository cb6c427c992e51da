"""Three-state decisions on conformity after ISO 14253-1.

With a guard band g = guard_factor * U inside each limit: accept if the value keeps clear of both
limits by g or more, reject if it passes a limit by g or more, else inconclusive. With g = 0 a value on
its limit is accepted.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.limits import RULES
from metrosep.core.numbers import choice, count, flag, not_negative, positive, real
from metrosep.core.units import format_engineering

_ROUNDING = 4.0 * sys.float_info.epsilon
"""Of each of the numbers, their difference and their product: 9.4 is 10 - 2 * 0.3."""

Verdict = Literal["accept", "reject", "inconclusive"]


def decide(
    value: float,
    *,
    lower: float | None = None,
    upper: float | None = None,
    U: float,
    guard_factor: float = 1.0,
) -> Verdict:
    """Return whether a value conforms to its limits.

    Parameters
    ----------
    value : float
        Measured value; NaN is inconclusive.
    lower, upper : float, optional
        Limits, same unit.
    U : float
        Expanded uncertainty, same unit, >= 0.
    guard_factor : float, optional
        Guard band over U, >= 0; 0 is simple acceptance.

    Returns
    -------
    {"accept", "reject", "inconclusive"}
        Verdict.

    Raises
    ------
    DataError
        If there is no limit, the limits cross, U or the factor is negative or not finite, or one
        of them is not a number.

    Notes
    -----
    Accept: lower + g <= value <= upper - g. Reject: value <= lower - g or value >= upper + g. Both
    edges are kept to within the rounding of floats, 4 epsilon of the largest of the three numbers.
    Where both hold, g being zero, the value is accepted.

    References
    ----------
    .. [1] ISO 14253-1:2017.

    Examples
    --------
    >>> decide(90e-9, upper=100e-9, U=5e-9), decide(98e-9, upper=100e-9, U=5e-9)
    ('accept', 'inconclusive')
    """
    low, high = ordered_limits(lower, upper)
    value = real(value, "value", finite=False)
    for name, number in (("U", U), ("guard_factor", guard_factor)):  # said as it was typed
        if not (math.isfinite(real(number, name, finite=False)) and number >= 0.0):
            raise DataError(f"{name} must be finite and not negative, got {_text(number)}")
    return _state(value, low, high, guard_factor * U)


def _state(value: float, low: float, high: float, guard: float) -> Verdict:
    """Return the verdict of `decide` with a guard band inside and outside each limit."""
    below, above = (_allowance(value, limit, guard) for limit in (low, high))
    if low + guard - below <= value <= high - guard + above:
        return "accept"
    if value <= low - guard + below or value >= high + guard - above:
        return "reject"
    return "inconclusive"


def ordered_limits(lower: float | None, upper: float | None) -> tuple[float, float]:
    """Return both limits of a decision, infinite where there is none."""
    if lower is None and upper is None:
        raise DataError("a decision needs a lower or an upper limit")
    low = -math.inf if lower is None else real(lower, "lower", finite=False)
    high = math.inf if upper is None else real(upper, "upper", finite=False)
    if math.isnan(low) or math.isnan(high) or low > high:
        raise limits_error(lower, upper)
    return low, high


def limits_error(lower: float | None, upper: float | None) -> DataError:
    """Return the error that two limits are not in order."""
    return DataError(f"the limits {_text(lower)} ... {_text(upper)} are not in order")


def _text(number: float | None) -> str:
    """Return a number for a message: a limit of a recipe tells itself with its unit."""
    own = getattr(number, "text", None)
    return own if isinstance(own, str) else "none" if number is None else f"{number:.10g}"


def _allowance(value: float, limit: float, guard: float) -> float:
    """Return the rounding of a limit with its guard band, zero where one of them is infinite."""
    largest = max(abs(value), abs(limit), guard)
    return _ROUNDING * largest if math.isfinite(largest) else 0.0


def worst(verdicts: list[Verdict]) -> Verdict | None:
    """Return the verdict of several characteristics together."""
    for verdict in ("reject", "inconclusive", "accept"):
        if verdict in verdicts:
            return verdict
    return None


# ---- decision rules: how far inside a limit a value must be before conformity is claimed -------
# `judge` gives a verdict together with the rule in words, the guard band, the margins and the
# probability that the true value conforms. All rules take the value for the centre of a normal
# distribution of standard uncertainty u.

Rule = Literal["iso14253-1", "simple", "ilac-g8", "pfa"]


def _between(value: float, low: float, high: float, name: str) -> float:
    if not low < value < high:
        raise DataError(f"{name} lies between {low:g} and {high:g}, got {value}")
    return value


def guard_factor(
    probability: float = 0.95, *, coverage_factor: float = 2.0, sides: Literal[1, 2] = 1
) -> float:
    """Return the guard band over U that proves conformity with a given probability.

    Parameters
    ----------
    probability : float, optional
        Probability that a value at the end of the acceptance zone conforms, 0.5 to 1.
    coverage_factor : float, optional
        k in U = k u_c, > 0.
    sides : {1, 2}, optional
        1 where only one limit can be broken within u_c, which includes two limits far apart; 2
        shares the risk between two limits.

    Returns
    -------
    float
        Factor for `decide`, 0.82 by default.

    Raises
    ------
    DataError
        If a number is out of range.

    References
    ----------
    .. [1] ISO 14253-1:2017: conformity proven at 95 % one-sided, g = 1.645 u_c.

    Examples
    --------
    >>> from metrosep.parameters.decision import decide
    >>> g = guard_factor(0.95)
    >>> [decide(y, upper=10.0, U=0.5, guard_factor=g) for y in (9.55, 9.60, 10.5)]
    ['accept', 'inconclusive', 'reject']
    """
    from scipy.special import ndtri

    _between(probability, 0.5, 1.0, "the probability of a guard band")
    positive(coverage_factor, "a coverage factor")
    count(sides, "sides", most=2)
    one_sided = probability if sides == 1 else 0.5 * (1.0 + probability)
    return float(ndtri(one_sided)) / coverage_factor


def conformance_probability(
    value: float,
    u: float,
    *,
    lower: float | None = None,
    upper: float | None = None,
    dof: float | None = None,
) -> float:
    """Return the probability that the true value lies within its limits.

    Parameters
    ----------
    value : float
        Measured value, corrected for known bias.
    u : float
        Its standard uncertainty, >= 0.
    lower, upper : float, optional
        Limits, same unit.
    dof : float, optional
        Degrees of freedom of u, > 0: Student's distribution; normal if omitted.

    Returns
    -------
    float
        0 to 1; NaN if the value is NaN.

    Raises
    ------
    DataError
        If there is no limit, the limits cross, or u is negative or not finite.
    OptionRangeError
        If dof is not above zero.

    Notes
    -----
    Normal or Student's distribution about the value, no prior knowledge of the process.

    References
    ----------
    .. [1] JCGM 106:2012, 7.4, eqs. (7) to (9).

    Examples
    --------
    >>> round(conformance_probability(9.5888, 0.25, upper=10.0), 3)
    0.95
    """
    from scipy.special import ndtr, stdtr

    low, high = ordered_limits(lower, upper)
    not_negative(u, "a standard uncertainty")
    nu = None if dof is None or math.isinf(dof) else positive(dof, "degrees of freedom")
    if math.isnan(value):
        return math.nan
    if u == 0.0:
        return float(low <= value <= high)
    # The part in the upper tail is taken as a lower tail: no digits are lost far outside.
    a, b = (low - value) / u, (high - value) / u
    if a > 0.0:
        a, b = -b, -a
    if nu is not None:
        return float(stdtr(nu, b) - stdtr(nu, a))
    return float(ndtr(b) - ndtr(a))


@dataclass(frozen=True, slots=True)
class Decision:
    """A verdict with everything it rests on.

    Parameters
    ----------
    verdict : {"accept", "reject", "inconclusive"}
        Outcome.
    rule : str
        Name of the rule.
    sentence : str
        The rule in words, with its numbers, for the report.
    value, u : float
        What was judged.
    lower, upper : float or None
        Limits.
    guard : float
        Guard band in the unit of the value; of the ``"pfa"`` rule: that of one limit alone.
    acceptance : tuple of (float, float)
        Values that are accepted; NaN where none is.
    probability : float
        That the true value conforms.
    """

    verdict: Verdict
    rule: Rule
    sentence: str
    value: float
    u: float
    lower: float | None
    upper: float | None
    guard: float
    acceptance: tuple[float, float]
    probability: float

    @property
    def margins(self) -> tuple[float, float]:
        """Distance from the lower and to the upper limit; negative outside, inf without limit."""
        low = math.inf if self.lower is None else self.value - self.lower
        high = math.inf if self.upper is None else self.upper - self.value
        return low, high

    @property
    def margin(self) -> float:
        """Distance to the nearer limit; negative outside."""
        return min(self.margins)

    def __str__(self) -> str:
        return f"{self.verdict}: {self.sentence} (conforms with {100 * self.probability:.3g} %)"


def judge(
    value: float,
    *,
    u: float,
    lower: float | None = None,
    upper: float | None = None,
    rule: Rule = "iso14253-1",
    probability: float = 0.95,
    coverage_factor: float = 2.0,
    pfa: float = 0.025,
    min_tur: float = 4.0,
    tolerance: float | None = None,
) -> Decision:
    """Return a verdict under a named decision rule.

    Parameters
    ----------
    value : float
        Measured value, corrected for known bias; NaN is inconclusive.
    u : float
        Combined standard uncertainty u_c, same unit, >= 0.
    lower, upper : float, optional
        Limits, same unit.
    rule : {"iso14253-1", "simple", "ilac-g8", "pfa"}, optional
        See Notes.
    probability : float, optional
        Of ``"iso14253-1"``: conformity or nonconformity is proven at this probability.
    coverage_factor : float, optional
        k of U in ``"ilac-g8"`` and in the uncertainty ratio of ``"simple"``.
    pfa : float, optional
        Of ``"pfa"``: largest probability of a false decision for this very value, below 0.5.
    min_tur : float, optional
        Of ``"simple"``: smallest test uncertainty ratio, tolerance / (2 U).
    tolerance : float, optional
        Width of the specification for that ratio where only one limit is given.

    Returns
    -------
    Decision
        Verdict, sentence, guard, margins and probability.

    Raises
    ------
    DataError
        If there is no limit, a number is out of range, the rule is not known, or the ratio of
        ``"simple"`` needs a tolerance.

    Notes
    -----
    - ``"iso14253-1"``: guard g = ndtri(probability) u_c inside (accept) and outside (reject).
      With two limits less than about 4 u_c apart g holds each risk, not their sum: see
      `Decision.probability`, or take ``"pfa"``.
    - ``"simple"``: accept inside the limits, reject outside, if the uncertainty ratio is
      reached; else inconclusive.
    - ``"ilac-g8"``: g = U, with inconclusive between the guard bands.
    - ``"pfa"``: accept if the probability of nonconformity is at most `pfa`, reject if that of
      conformity is; exact with two limits at any distance.

    References
    ----------
    .. [1] ISO 14253-1:2017. [2] ILAC-G8:09/2019. [3] JCGM 106:2012, 8.3.

    Examples
    --------
    >>> result = judge(9.60, u=0.25, upper=10.0)
    >>> result.verdict, round(result.acceptance[1], 4), round(result.probability, 3)
    ('inconclusive', 9.5888, 0.945)
    """
    low, high = ordered_limits(lower, upper)
    not_negative(u, "a standard uncertainty")
    positive(coverage_factor, "a coverage factor")
    chance = conformance_probability(value, u, lower=lower, upper=upper)
    if rule == "pfa":
        guard = guard_factor(1.0 - _between(pfa, 0.0, 0.5, "pfa"), coverage_factor=1.0) * u
        acceptance = _pfa_zone(low, high, u, pfa, guard)
        verdict: Verdict = "reject" if chance <= pfa else "inconclusive"
        if chance >= 1.0 - pfa:
            verdict = "accept"
        sentence = (
            f"accepted or rejected where a false decision has a probability of at most {pfa:g}"
        )
    else:
        guard, sentence = _guard_of(rule, u, probability, coverage_factor)
        acceptance = (low + guard, high - guard)
        verdict = decide(value, lower=lower, upper=upper, U=guard)
        if rule == "simple":
            ratio = _uncertainty_ratio(low, high, coverage_factor * u, tolerance)
            _between(min_tur, 0.0, math.inf, "the smallest uncertainty ratio")
            sentence += f"; test uncertainty ratio {ratio:.3g}, at least {min_tur:g} demanded"
            verdict = verdict if ratio >= min_tur else "inconclusive"
    if acceptance[0] > acceptance[1]:
        acceptance = (math.nan, math.nan)
        sentence += "; the uncertainty is too large for these limits, nothing can be accepted"
    return Decision(verdict, rule, sentence, value, u, lower, upper, guard, acceptance, chance)


def _guard_of(
    rule: Rule, u: float, probability: float, coverage_factor: float
) -> tuple[float, str]:
    if rule == "iso14253-1":
        factor = guard_factor(probability, coverage_factor=1.0)
        text = (
            f"ISO 14253-1, proven at {100 * probability:g} %: guard band {factor:.4g} u_c = "
            f"{factor * u:.4g} on both sides of each limit"
        )
        return factor * u, text
    if rule == "ilac-g8":
        U = coverage_factor * u
        return U, f"ILAC-G8, guard band U = {U:.4g} (k = {coverage_factor:g}) at each limit"
    if rule == "simple":
        return 0.0, "simple acceptance, no guard band"
    raise DataError(f'rule {rule!r} is not one of "iso14253-1", "simple", "ilac-g8", "pfa"')


def _uncertainty_ratio(low: float, high: float, U: float, tolerance: float | None) -> float:
    width = high - low if tolerance is None else tolerance
    if not (math.isfinite(width) and width >= 0.0):
        raise DataError(
            "simple acceptance compares U with the tolerance, and one limit alone has none: give "
            f"tolerance= (the limit itself for a parameter that starts at zero), got {tolerance}"
        )
    return width / (2.0 * U) if U > 0.0 else math.inf


def _pfa_zone(low: float, high: float, u: float, pfa: float, guard: float) -> tuple[float, float]:
    """Return the ends of the accepted values; with two limits their risks add."""
    if math.isinf(low) or math.isinf(high) or u == 0.0:
        return low + guard, high - guard
    middle = 0.5 * (low + high)
    if conformance_probability(middle, u, lower=low, upper=high) < 1.0 - pfa:
        return math.inf, -math.inf
    inside, outside = 0.0, 0.5 * (high - low)
    for _ in range(100):
        trial = 0.5 * (inside + outside)
        if conformance_probability(middle + trial, u, lower=low, upper=high) >= 1.0 - pfa:
            inside = trial
        else:
            outside = trial
    return middle - inside, middle + inside


# ---- several values of one parameter: maximum rule, 16 % rule, median -----------------------------
# ISO 4288 and ISO 1302 apply the 16 % rule where a drawing says nothing, ISO 21920 the maximum rule
# (recalled). The values are those of sections or of profiles at several places, in the order in which
# they were measured. With an uncertainty the count is made twice, with the limit moved inwards and
# outwards by the guard band.

AcceptanceRule = Literal["max", "16%", "median"]

_ONE_IN = 6
"""Values of which one may exceed the limit: 1 of 6, 2 of 12."""
_STAGES = ((3, 0), (6, 1), (12, 2))
"""Values measured, and how many of them may exceed the limit (ISO 4288, recalled)."""
_SHORT = 0.7
"""Of an upper limit: a first value up to it ends the staged measurement."""


@dataclass(frozen=True, slots=True)
class Acceptance:
    """A verdict on several values.

    Parameters
    ----------
    verdict : {"accept", "reject", "inconclusive"}
        Outcome.
    rule : {"max", "16%", "median"}
        Which rule.
    sentence : str
        How it came about, for the report.
    values : tuple of float
        The values that were used, in the order of measuring.
    n_outside : int
        How many of them lie outside the limits.
    n_allowed : int
        How many may, of two limits at each; -1 for the median.
    guard : float
        Guard band on each side of a limit.
    """

    verdict: Verdict
    rule: AcceptanceRule
    sentence: str
    values: tuple[float, ...]
    n_outside: int
    n_allowed: int
    guard: float

    def __str__(self) -> str:
        return f"{self.verdict}: {self.sentence}"


def judge_values(
    values: Sequence[float],
    *,
    lower: float | None = None,
    upper: float | None = None,
    rule: AcceptanceRule = "max",
    U: float = 0.0,
    guard_factor: float = 1.0,
    sequential: bool = False,
    unit: str = "1",
) -> Acceptance:
    """Return whether several values of one parameter conform to a limit.

    Parameters
    ----------
    values : sequence of float
        In the order of measuring, finite.
    lower, upper : float, optional
        Limits, same unit.
    rule : {"max", "16%", "median"}, optional
        No value outside; at most one in six outside; the median inside.
    U : float, optional
        Expanded uncertainty of one value, same unit, >= 0.
    guard_factor : float, optional
        Guard band over U, >= 0.
    sequential : bool, optional
        Of the 16 % rule: measure in stages and stop at the first that decides.
    unit : str, optional
        SI unit of the values, for the sentence.

    Returns
    -------
    Acceptance
        Verdict, sentence and the values that were used.

    Raises
    ------
    TooFewSamplesError
        If there is no value.
    DataError
        If there is no limit, the limits cross, a number is out of range, the rule is unknown or
        `sequential` is asked of another rule.

    Notes
    -----
    16 %: accept if at most ``floor(n / 6)`` of n values exceed the limit, which is none below six
    values: then it is the maximum rule, and the sentence says so. In stages: a first value of at
    most 0.7 of an upper limit accepts; so do none of the first three outside, at most one of six,
    at most two of twelve; else reject. With values left to measure it is inconclusive. Of Gaussian
    values of a part 10 % of which exceed the limit the stages accept 94.8 %. Two limits are two
    requirements: the values above one and below the other are counted apart, and the worse counts.
    Guard band g = guard_factor U: accept if it passes with the limits moved inwards by g, reject if
    it fails with the limits moved outwards by g, else inconclusive. A value on an edge counts as it
    does for `decide`, to within rounding.

    References
    ----------
    .. [1] ISO 4288:1996, clause 5 (recalled; the numbers 1 of 6 and 2 of 12 as public texts give
       them); ISO 21920-3:2021 (recalled).

    Examples
    --------
    >>> heights = [0.71, 0.78, 0.66, 0.83, 0.74, 0.69, 0.81, 0.92, 0.75, 0.70, 0.77, 0.73]
    >>> [judge_values(heights, upper=0.85, rule=r).verdict for r in ("max", "16%", "median")]
    ['reject', 'accept', 'accept']
    """
    low, high = ordered_limits(lower, upper)
    choice(rule, "rule", RULES)
    given = [real(v, "a value") for v in values]
    guard = not_negative(guard_factor, "guard_factor") * not_negative(U, "U")
    if not given:
        raise TooFewSamplesError("a rule over several values needs at least one value")
    if flag(sequential, "sequential") and rule != "16%":
        raise DataError(f'sequential measuring belongs to the 16 % rule, not to "{rule}"')
    if rule == "16%" and math.isfinite(low) and math.isfinite(high):
        return _of_both_limits(
            [
                judge_values(
                    given, lower=a, upper=b, rule=rule, U=U, guard_factor=guard_factor,
                    sequential=sequential, unit=unit,
                )
                for a, b in ((low, None), (None, high))
            ]
        )  # fmt: skip
    passes = [_passes(given, _Moved(low, high, *at), rule, staged=sequential)
              for at in ((guard, 1), (0.0, 1), (guard, -1))]  # fmt: skip
    verdict: Verdict = "inconclusive"
    if passes[0].verdict == "accept":
        verdict = "accept"
    elif passes[2].verdict == "reject":
        verdict = "reject"
    shown = passes[0] if verdict == "accept" else passes[2] if verdict == "reject" else passes[1]
    longest = max(passes, key=lambda p: len(p.values))
    sentence = shown.sentence
    if guard > 0.0:
        sentence += f"; guard band {format_engineering(guard, unit)} on both sides of the limit"
        if verdict == "inconclusive" and len({p.verdict for p in passes}) > 1:
            sentence += ", within which the count changes"
    return Acceptance(
        verdict, rule, sentence, longest.values, passes[1].n_outside, shown.n_allowed, guard
    )


def _of_both_limits(found: list[Acceptance]) -> Acceptance:
    """Return the worse of what the lower and the upper limit say, with the sentences of both."""
    lower, upper = found
    outcome = worst([f.verdict for f in found]) or "inconclusive"
    return Acceptance(
        outcome,
        "16%",
        f"lower limit, {lower.sentence}; upper limit, {upper.sentence}",
        max(lower.values, upper.values, key=len),
        lower.n_outside + upper.n_outside,
        max(lower.n_allowed, upper.n_allowed),
        lower.guard,
    )


class _Moved(NamedTuple):
    """Limits moved by a guard band, inwards (1) or outwards (-1); one value is judged as by `decide`."""

    low: float
    high: float
    guard: float
    side: Literal[1, -1]

    def leaves_out(self, value: float) -> bool:
        state = _state(value, self.low, self.high, self.guard)
        return state != "accept" if self.side > 0 else state == "reject"

    def is_short(self, value: float) -> bool:
        """Return whether a value is so far below an upper limit that it ends the staged measurement."""
        most = _SHORT * (self.high - self.side * self.guard)  # of a limit below 0 that is outside
        small = most > 0.0 and value <= most + _allowance(value, most, self.guard)
        return small and math.isinf(self.low)


def _passes(
    values: list[float], limits: _Moved, rule: AcceptanceRule, *, staged: bool
) -> Acceptance:
    """Return the outcome of a rule with limits that are sharp."""
    if staged:
        return _in_stages(values, limits)
    n = sum(map(limits.leaves_out, values))
    if rule == "median":
        inside = not limits.leaves_out(float(np.median(values)))
        where = "inside" if inside else "outside"
        text = f"median rule: the median of {len(values)} values lies {where} the limits"
        return Acceptance("accept" if inside else "reject", rule, text, tuple(values), n, -1, 0.0)
    allowed = 0 if rule == "max" else len(values) // _ONE_IN
    name = "maximum rule" if rule == "max" else "16 % rule"
    text = f"{name}: {n} of {len(values)} values outside, {allowed or 'none'} allowed"
    if rule == "16%" and allowed == 0:
        text += f" (below {_ONE_IN} values the 16 % rule is the maximum rule)"
    return Acceptance(
        "accept" if n <= allowed else "reject", rule, text, tuple(values), n, allowed, 0.0
    )


def _in_stages(values: list[float], limits: _Moved) -> Acceptance:
    def outcome(verdict: Verdict, used: int, allowed: int, text: str) -> Acceptance:
        part = tuple(values[:used])
        n = sum(map(limits.leaves_out, part))
        return Acceptance(verdict, "16%", f"16 % rule in stages: {text}", part, n, allowed, 0.0)

    if limits.is_short(values[0]):
        return outcome("accept", 1, 0, f"the first value is at most {_SHORT:g} of the limit")
    n = used = 0
    last, most = _STAGES[-1]
    for stage, allowed in _STAGES:
        part = values[:stage]
        n = sum(map(limits.leaves_out, part))
        used = len(part)
        if n > most:  # no later stage can accept
            break
        if used < stage:
            text = f"{n or 'none'} of {used} values outside; measure {stage - used} more"
            return outcome("inconclusive", used, allowed, text)
        if n <= allowed:
            text = (
                f"{n or 'none'} of the first {stage} values outside, {allowed or 'none'} allowed"
            )
            return outcome("accept", stage, allowed, text)
    text = f"{n} of the first {used} values outside, {most} of {last} allowed"
    return outcome("reject", used, most, text)
