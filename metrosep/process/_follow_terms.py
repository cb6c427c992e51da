"""Private: the terms of a follow-up regression, their shares, and what they hint at."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.quantity import Quantity
from metrosep.process._follow_result import TermShare
from metrosep.process._regression import Regression, regress

TERMS: Mapping[str, tuple[str, str]] = {
    "velocity": ("cv", "s"),
    "acceleration": ("ca", "s^2"),
    "jerk": ("cj", "s^3"),
    "position": ("cx", "1"),
    "friction": ("cf", "m"),
}
"""Term: symbol and unit of its coefficient."""

_ALIKE = 0.999
"""Correlation of two terms from which a log cannot tell them apart."""

_MOTION = 2.0
"""RMS of a term over that of its noise, below which it is not there."""

_SIGNIFICANT = 3.0
_OPPOSED = 0.05
_LARGE = 0.10
"""Share of the variance from which a term is worth a hint."""


def checked_terms(terms: Sequence[str]) -> tuple[str, ...]:
    """Return the terms in their order, refused where unknown or twice."""
    if isinstance(terms, str):
        terms = (terms,)
    for name in terms:
        if name not in TERMS:
            raise DataError(f"there is no term {name!r}; use {', '.join(TERMS)}")
    if not terms or len(set(terms)) < len(terms):
        raise DataError(f"terms={list(terms)}: name at least one term, and each once")
    return tuple(terms)


def fit_terms(
    error: FloatArray,
    motion: Mapping[str, FloatArray],
    terms: tuple[str, ...],
    noise: Mapping[str, float],
) -> tuple[Regression, tuple[str, ...], NDArray[np.bool_], list[str]]:
    """Return the regression, the terms that were kept, which samples took part, and messages."""
    valid = ~np.isnan(error)
    for name in terms:
        valid &= ~np.isnan(motion[name])
    if valid.sum() < 2 * len(terms) + 6:
        raise TooFewSamplesError(
            f"a regression on {len(terms)} terms needs {2 * len(terms) + 6} samples with error and "
            f"motion, got {int(valid.sum())} of {error.size}; log for longer"
        )
    kept, messages = _told_apart({n: motion[n][valid] for n in terms}, noise)
    at = np.flatnonzero(valid)
    segments = np.cumsum(np.concatenate([[0], np.diff(at) > 1]))
    columns = [motion[n][valid] - motion[n][valid].mean() for n in kept]
    basis = np.column_stack([np.ones(at.size), *columns])
    fit = regress(basis, error[valid], segments, at=at)
    # back to c0 at zero motion
    shift = np.eye(len(kept) + 1)
    shift[0, 1:] = [-float(motion[n][valid].mean()) for n in kept]
    fit = Regression(
        shift @ fit.coefficients,
        shift @ fit.cov @ shift.T,
        fit.residual,
        fit.bandwidth,
        fit.inflation,
    )
    return fit, kept, valid, messages


def _told_apart(
    columns: dict[str, FloatArray], noise: Mapping[str, float]
) -> tuple[tuple[str, ...], list[str]]:
    """Return the terms without those that follow an earlier one, and a message for each lost."""
    kept: list[str] = []
    messages = []
    for name, column in columns.items():
        own = column - column.mean()
        size = float(np.linalg.norm(own))
        if size <= _MOTION * noise.get(name, 0.0) * math.sqrt(column.size) or size == 0.0:
            messages.append(
                f"the log holds no {name} that changes beyond its noise: its share cannot be told"
            )
            continue
        like = None
        for other in kept:
            rival = columns[other] - columns[other].mean()
            r = float(own @ rival) / (size * float(np.linalg.norm(rival)))
            if abs(r) > _ALIKE:
                like = (other, r)
        if like is None:
            kept.append(name)
        else:
            messages.append(
                f"{name} and {like[0]} cannot be told apart in this motion (r = {like[1]:.4f}, one "
                f"frequency only): what {name} explains is counted as {like[0]}"
            )
    if not kept:
        raise DataError(
            "the commanded position does not move, or evenly, or by less than its own noise: there "
            "is nothing to regress on; log a motion that accelerates"
        )
    return tuple(kept), messages


def shares(
    error: FloatArray,
    motion: Mapping[str, FloatArray],
    kept: tuple[str, ...],
    fit: Regression,
    *,
    least: float = 0.0,
) -> dict[str, TermShare]:
    """Return P-V, RMS and share of each term; arrays hold the samples of the regression only.

    An error whose RMS is not above `least` does not vary: no term has a share in it.
    """
    y = error - error.mean()
    power = float(y @ y)
    varies = power > error.size * least**2
    found = {}
    for i, name in enumerate(kept, start=1):
        c, u = float(fit.coefficients[i]), math.sqrt(max(float(fit.cov[i, i]), 0.0))
        part = motion[name] - motion[name].mean()
        pv, rms = float(np.ptp(part)), float(part.std())
        found[name] = TermShare(
            name,
            Quantity(abs(c) * pv, "m", f"P-V of the {name} share of the error", u * pv, "PV"),
            Quantity(abs(c) * rms, "m", f"RMS of the {name} share of the error", u * rms, "RMS"),
            c * float(part @ y) / power if varies else 0.0,
            _significance(abs(c), u) if varies else 0.0,
        )
    return found


def _significance(c: float, u: float) -> float:
    if u > 0.0:
        return c / u
    return math.inf if c > 0.0 else 0.0


def hints(found: Mapping[str, TermShare], fit: Regression, kept: tuple[str, ...]) -> list[str]:
    """Return what the leading terms suggest, in plain words."""
    messages = []
    for name, share in sorted(found.items(), key=lambda item: -item[1].share):
        if share.significance < _SIGNIFICANT or not share.share > _LARGE:
            continue
        c = float(fit.coefficients[1 + kept.index(name)])
        messages.append(f"{_CAUSES[name](c)} ({100.0 * share.share:.0f} % of the variance)")
    if any(not -_OPPOSED < share.share < 1.0 + _OPPOSED for share in found.values()):
        messages.append(
            "terms of this motion work against each other: their shares belong together, not one by "
            "one; log a motion of more frequencies"
        )
    if not messages:
        messages.append(
            "no term of the motion explains a tenth of the error: look for noise, cutting force, "
            "quantisation or vibration"
        )
    return messages


def _velocity(c: float) -> str:
    if c < 0.0:
        return (
            f"the error follows velocity: actual lags by {abs(c) * 1e3:.3g} ms; velocity "
            "feedforward, or a delay between the two channels of the log (the log cannot tell which)"
        )
    return (
        f"the error follows velocity: actual leads by {abs(c) * 1e3:.3g} ms; velocity feedforward is "
        "too large, or there is a delay between the two channels of the log, or the channels are "
        "swapped (the log cannot tell which)"
    )


def _acceleration(c: float) -> str:
    if c < 0.0:
        return "the error follows acceleration: missing acceleration feedforward"
    return (
        "the error follows acceleration with actual ahead: acceleration feedforward is too large, "
        "or the channel holds commanded minus actual (or the channels are swapped) and it is "
        "missing acceleration feedforward"
    )


def _jerk(c: float) -> str:
    return (
        "the error follows jerk: the integral part carries the acceleration (M/Ki); raise Ki or "
        "add acceleration feedforward"
    )


def _position(c: float) -> str:
    return "the error follows position: scale of the encoder, or a force like a spring"


def _friction(c: float) -> str:
    return "the error follows the sign of velocity: friction or lost motion at the reversals"


_CAUSES = {
    "velocity": _velocity,
    "acceleration": _acceleration,
    "jerk": _jerk,
    "position": _position,
    "friction": _friction,
}
