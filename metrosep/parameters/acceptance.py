"""Acceptance of a part by several values of one parameter: maximum rule, 16 % rule, median.

ISO 4288 and ISO 1302 apply the 16 % rule where a drawing says nothing, ISO 21920 the maximum rule
(recalled). The values are those of sections or of profiles at several places, in the order in which
they were measured. With an uncertainty the count is made twice, with the limit moved inwards and
outwards by the guard band.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.limits import RULES
from metrosep.core.numbers import choice, flag, not_negative, real
from metrosep.core.units import format_engineering
from metrosep.parameters.decision import Verdict, ordered_limits

__all__ = ["Acceptance", "AcceptanceRule", "judge_values"]

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
        How many may; -1 for the median.
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
    values of a part 10 % of which exceed the limit the stages accept 94.8 %.
    Guard band g = guard_factor U: accept if it passes with the limits moved inwards by g, reject if
    it fails with the limits moved outwards by g, else inconclusive.

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
    passes = [
        _passes(given, low + side, high - side, rule, staged=sequential)
        for side in (guard, 0.0, -guard)
    ]
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


def _passes(
    values: list[float], low: float, high: float, rule: AcceptanceRule, *, staged: bool
) -> Acceptance:
    """Return the outcome of a rule with limits that are sharp."""
    if rule == "median":
        median = float(np.median(values))
        inside = low <= median <= high
        n = sum(not low <= v <= high for v in values)
        where = "inside" if inside else "outside"
        text = f"median rule: the median of {len(values)} values lies {where} the limits"
        return Acceptance("accept" if inside else "reject", rule, text, tuple(values), n, -1, 0.0)
    if staged:
        return _in_stages(values, low, high)
    n = sum(not low <= v <= high for v in values)
    allowed = 0 if rule == "max" else len(values) // _ONE_IN
    name = "maximum rule" if rule == "max" else "16 % rule"
    text = f"{name}: {n} of {len(values)} values outside, {allowed or 'none'} allowed"
    if rule == "16%" and allowed == 0:
        text += f" (below {_ONE_IN} values the 16 % rule is the maximum rule)"
    return Acceptance(
        "accept" if n <= allowed else "reject", rule, text, tuple(values), n, allowed, 0.0
    )


def _in_stages(values: list[float], low: float, high: float) -> Acceptance:
    def outcome(verdict: Verdict, used: int, allowed: int, text: str) -> Acceptance:
        part = tuple(values[:used])
        n = sum(not low <= v <= high for v in part)
        return Acceptance(verdict, "16%", f"16 % rule in stages: {text}", part, n, allowed, 0.0)

    if math.isinf(low) and values[0] <= _SHORT * high:
        return outcome("accept", 1, 0, f"the first value is at most {_SHORT:g} of the limit")
    n = used = 0
    last, most = _STAGES[-1]
    for stage, allowed in _STAGES:
        part = values[:stage]
        n = sum(not low <= v <= high for v in part)
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
