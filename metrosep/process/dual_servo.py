"""Dual servo: following error and straightness added up, negated, and judged on the part.

The slow axis leaves a following error FE(t); the cross slide adds its straightness s(x). A piezo
stage moves by the negative of their sum. All errors are positive out of the material.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.process._plain import Frozen, complete, known
from metrosep.process.straightness_runs import RunPolynomial


@dataclass(frozen=True, slots=True, eq=False)
class CumulativeError(Frozen):
    """The Z error that the tool sees, and the command that takes it away.

    Parameters
    ----------
    x : ndarray, shape (n,), m
        Position of the cross slide.
    following, straightness : ndarray, shape (n,), m
        Both parts.
    error : ndarray, shape (n,), m
        Their sum.
    command : ndarray, shape (n,), m
        Minus the sum: what the stage must add.
    u : ndarray, shape (n,), m
        Standard uncertainty of the straightness; NaN where nothing tells it.
    audit : mapping
        P-V of the parts and of the sum.
    messages : tuple of str
        In plain words.
    """

    x: FloatArray
    following: FloatArray
    straightness: FloatArray
    error: FloatArray
    command: FloatArray
    u: FloatArray
    audit: Mapping[str, Any]
    messages: tuple[str, ...]


def cumulative_error(
    x: ArrayLike,
    following: ArrayLike,
    straightness: RunPolynomial | Callable[[FloatArray], FloatArray] | ArrayLike,
    *,
    quantity: Literal["error", "compensation"] | None = None,
) -> CumulativeError:
    """Return ``eZ(x, t) = FE(t) + s(x)`` and its negative.

    Parameters
    ----------
    x : array_like, shape (n,), m
        Position of the cross slide at each time; in any order.
    following : array_like, shape (n,), m
        Following error of the slow axis, actual - commanded.
    straightness : RunPolynomial, callable or array_like
        Straightness at the positions, in m.
    quantity : {"error", "compensation"}, optional
        What `straightness` holds. A `RunPolynomial` knows; of everything else it must be stated.

    Returns
    -------
    CumulativeError
        Parts, sum and command.

    Raises
    ------
    DataError
        If `quantity` is missing, or contradicts the polynomial.
    InvalidSamplesError
        If the lengths differ or a position is NaN.
    LimitError
        If a position lies outside the polynomial's domain.

    Notes
    -----
    A sample that is NaN in either part is NaN in the command: hold the stage there.

    References
    ----------
    .. [1] Dual-servo paper, Fig. 2 and section 4.3.

    Examples
    --------
    >>> both = cumulative_error([0.0, 1e-3], [2e-7, 1e-7], [0.0, 3e-7], quantity="error")
    >>> (both.command * 1e9).round(6).tolist()
    [-200.0, -400.0]
    """
    at = complete(x, "position x", "leave the sample out")
    fe = frozen_float(following, name="following", ndim=1)
    s, u = _straightness(at, straightness, quantity)
    if not at.size == fe.size == s.size:
        raise InvalidSamplesError(
            f"x has {at.size} samples, following {fe.size} and straightness {s.size}; they belong "
            "together"
        )
    total = fe + s
    missing = int(np.isnan(total).sum())
    messages = []
    if missing:
        messages.append(f"{missing} of {total.size} samples are not known: hold the stage there")
    sizes = {"following": fe, "straightness": s, "cumulative": total}
    audit: dict[str, Any] = {f"{n}_pv_nm": known(_range(v) * 1e9) for n, v in sizes.items()}
    audit["samples_not_measured"] = missing
    return CumulativeError(at, fe, s, total, -total, u, audit, tuple(messages))


def _straightness(
    x: FloatArray,
    straightness: RunPolynomial | Callable[[FloatArray], FloatArray] | ArrayLike,
    quantity: str | None,
) -> tuple[FloatArray, FloatArray]:
    if isinstance(straightness, RunPolynomial):
        if quantity is not None and quantity != straightness.quantity:
            raise DataError(
                f"the polynomial gives the {straightness.quantity}, not the {quantity}; leave "
                "quantity out"
            )
        return straightness.error(x), straightness.sd(x)
    if quantity not in ("error", "compensation"):
        raise DataError(
            f"quantity={quantity!r}; state whether the straightness is an 'error' or a "
            "'compensation': the sign follows"
        )
    got = straightness(x) if callable(straightness) else straightness
    s = frozen_float(got, name="straightness", ndim=1)
    return (s if quantity == "error" else -s), np.full(s.size, np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class BeforeAfter(Frozen):
    """Roughness and profile height of the same region before and after compensation.

    Parameters
    ----------
    before, after : mapping of str to Quantity
        ``Ra`` and ``Pt`` in m, each with filter, form and region in its definition.
    ratio : mapping of str to float
        Before over after.
    profiles : tuple of (Profile, Profile)
        Primary profiles, form removed.
    region : tuple of (float, float), m
        Evaluated in both.
    audit : mapping
        Filters, form and region.
    messages : tuple of str
        In plain words.
    """

    before: Mapping[str, Quantity]
    after: Mapping[str, Quantity]
    ratio: Mapping[str, float]
    profiles: tuple[Profile, Profile]
    region: tuple[float, float]
    audit: Mapping[str, Any]
    messages: tuple[str, ...]


def before_after(
    before: Profile,
    after: Profile,
    *,
    lambda_c: float,
    lambda_s: float | None = None,
    form: Literal["none", "line"] = "line",
    region: tuple[float, float] | None = None,
) -> BeforeAfter:
    """Return Ra and Pt of two profiles over the same region, filtered alike.

    Parameters
    ----------
    before, after : Profile
        As measured.
    lambda_c : float, m
        Cutoff of the roughness, Gaussian ISO 16610-21.
    lambda_s : float, m, optional
        Short cutoff of both; none if omitted.
    form : {"none", "line"}, optional
        What is removed before Pt; Pt depends on it.
    region : tuple of (float, float), m, optional
        Part to evaluate; what both profiles share if omitted.

    Returns
    -------
    BeforeAfter
        Pairs and their ratios.

    Raises
    ------
    DataError
        If `form` or a cutoff is not one of its choices, or the profiles share no region.
    TooFewSamplesError
        If the region holds fewer than 8 samples of a profile.
    NotUniformError
        If a profile is not uniform.
    InvalidSamplesError
        If a profile cannot be filtered.

    Notes
    -----
    Ra: line removed, lambda_s, lambda_c, ISO 21920-2, one section. Pt: form removed as stated,
    lambda_s, largest minus smallest height. The paper pairs 1.285 um once with following-error
    compensation and once with none: a pair is only what was measured as one.

    References
    ----------
    .. [1] Dual-servo paper, section 4.4: Ra 48, 9, 4 nm; Pt 1.285, 0.3 um.
    """
    numbers.choice(form, "form", ("none", "line"))
    lambda_c = numbers.positive(lambda_c, "lambda_c", dimension="length")
    if lambda_s is not None:
        lambda_s = numbers.positive(lambda_s, "lambda_s", dimension="length")
    shared = (
        max(float(before.x[0]), float(after.x[0])),
        min(float(before.x[-1]), float(after.x[-1])),
    )
    low, high = shared if region is None else region
    slack = 1e-9 * abs(high - low)
    if not high > low or low < shared[0] - slack or high > shared[1] + slack:
        raise DataError(
            f"the region {low * 1e3:.6g} ... {high * 1e3:.6g} mm is not measured in both profiles; "
            f"they share {shared[0] * 1e3:.6g} ... {shared[1] * 1e3:.6g} mm"
        )
    span = f"{low * 1e3:.6g} ... {high * 1e3:.6g} mm"
    results, kept = [], []
    for name, profile in (("before", before), ("after", after)):
        part = profile.crop(low - slack, high + slack)
        if len(part) - part.n_invalid < 8:
            raise TooFewSamplesError(f"the profile {name} has {len(part)} samples in {span}")
        primary = part if form == "none" else part.remove_line()
        if lambda_s is not None:
            from metrosep.filters.chain import primary as without_short

            primary = without_short(primary, lambda_s=lambda_s)
        kept.append(primary)
        results.append(_pair(part, primary, lambda_c, lambda_s, form, span))
    ratio = {
        n: results[0][n].value / results[1][n].value if results[1][n].value > 0.0 else math.inf
        for n in ("Ra", "Pt")
    }
    messages = [f"{n} became worse: check the sign" for n, r in ratio.items() if r < 1.0]
    audit = {
        "lambda_c_mm": lambda_c * 1e3,
        "lambda_s_um": None if lambda_s is None else lambda_s * 1e6,
        "form_of_Pt": form,
        "region_mm": (low * 1e3, high * 1e3),
    }
    pair, region = (kept[0], kept[1]), (low, high)
    return BeforeAfter(results[0], results[1], ratio, pair, region, audit, tuple(messages))


def _pair(
    part: Profile, primary: Profile, lambda_c: float, lambda_s: float | None, form: str, span: str
) -> dict[str, Quantity]:
    from metrosep.filters.chain import roughness
    from metrosep.parameters.profile import profile_parameters

    rough = roughness(part.remove_line(), lambda_c=lambda_c, lambda_s=lambda_s)
    table = profile_parameters(rough, kind="R", sections=1, names=["Ra"])
    short = "no lambda_s" if lambda_s is None else f"lambda_s {lambda_s * 1e6:.6g} um"
    ra = f"Ra ISO 21920-2, lambda_c {lambda_c * 1e3:.6g} mm, {short}, line removed, x {span}"
    pt = f"Pt ISO 21920-2, {short}, form removed: {form}, x {span}"
    return {
        "Ra": Quantity(table["Ra"].value, "m", ra, symbol="Ra"),
        "Pt": Quantity(primary.peak_to_valley(), "m", pt, symbol="Pt"),
    }


def _range(values: FloatArray) -> float:
    valid = values[~np.isnan(values)]
    return float(np.ptp(valid)) if valid.size else math.nan
