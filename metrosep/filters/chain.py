"""The filter chain of profiles: primary, roughness and waviness profile (ISO 21920-2, 4287).

The lambda-s filter takes noise and tip effects off the measured profile: primary profile P. The
lambda-c filter splits P: what is shorter is roughness R, what is longer waviness W, from which
lambda-f takes the long form. All are Gaussian mean lines. A profile carries its kind, so that
no link of the chain is applied twice without `refilter`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import numpy as np

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import choice, count, positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.units import format_length
from metrosep.filters._arguments import (
    ALL_THE_SAME,
    SHORTFALL,
    DoubleFilterError,
    FilterBand,
    ProfileKind,
    counted,
    profile_kind,
)
from metrosep.filters.gaussian import End, gaussian
from metrosep.filters.robust import robust_gaussian
from metrosep.spectral.dft import instance_of

CoreFilter = Literal["gaussian", "13565-1", "robust"]

_ALREADY = {
    "P": "a primary profile: it has passed lambda-s already",
    "R": "a roughness profile: it has passed lambda-c already, filtering again makes it too small",
    "W": "a waviness profile: it has passed lambda-c already and holds no roughness",
}


def primary(
    profile: Profile, *, lambda_s: float | str, end: End = "moment", refilter: bool = False
) -> Profile:
    """Return the primary profile: what is longer than lambda-s.

    Parameters
    ----------
    profile : Profile
        As measured, form removed; NaN = not measured.
    lambda_s : float (m) or str with unit
        Cut-off against noise and tip effects, 2.5e-6 for lambda-c = 0.8e-3.
    end : {"moment", "renormalise", "closed", "cut"}, optional
        End rule of the Gaussian filter.
    refilter : bool, optional
        Filter a profile that is P, R or W already.

    Returns
    -------
    Profile
        Kind P, ``metadata["lambda_s_m"]`` set.

    Raises
    ------
    DoubleFilterError
        If the profile is of kind P, R or W.
    DataError
        If the cut-off lies outside the limits of `gaussian` or the options are unknown.
    InvalidSamplesError
        If the cut-off is not positive and finite.
    NotUniformError
        If the positions are not uniform.
    TooFewSamplesError
        If too little was measured.

    Notes
    -----
    A profile that its file calls P has passed lambda-s in the instrument.

    References
    ----------
    .. [1] ISO 21920-2:2021, clause 3.1 (primary profile); ISO 4287:1997, 3.1.5.

    Examples
    --------
    >>> import numpy as np
    >>> p = primary(Profile(np.arange(500) * 0.5e-6, np.zeros(500)), lambda_s=2.5e-6)
    >>> p.metadata["profile_kind"], p.metadata["lambda_s_m"]
    ('P', 2.5e-06)
    """
    _refuse(profile, ("P", "R", "W"), refilter)
    return _passed(profile, "P", "primary", end, refilter, None, lambda_s_m=lambda_s)


def roughness(
    profile: Profile,
    *,
    lambda_c: float | str,
    lambda_s: float | str | None = None,
    end: End = "moment",
    sections: int | None = None,
    core_filter: CoreFilter = "gaussian",
    refilter: bool = False,
) -> Profile:
    """Return the roughness profile: what is shorter than lambda-c, and longer than lambda-s.

    Parameters
    ----------
    profile : Profile
        Form removed; a primary profile, or as measured.
    lambda_c : float (m) or str with unit
        Cut-off between roughness and waviness.
    lambda_s : float (m) or str with unit, optional
        Applied first when given; a primary profile has passed it already.
    end : {"moment", "renormalise", "closed", "cut"}, optional
        End rule of the Gaussian filter; ``"cut"`` discards one cut-off at each end, as
        instruments do with run-in and run-out.
    sections : int, optional
        Keep this many section lengths of lambda-c in the middle, each of ``floor(lambda_c / dx)``
        samples, or all where no more than a tenth of one section lacks; without it everything is
        kept.
    core_filter : {"gaussian", "13565-1", "robust"}, optional
        How the mean line is found. "13565-1" cuts what lies below a first Gaussian line and filters
        once more, "robust" is the robust Gaussian regression of order 2 (end rule: its own); both
        stay on a plateau that valleys interrupt, as the Rk family asks for.
    refilter : bool, optional
        Filter a profile that was filtered already.

    Returns
    -------
    Profile
        Kind R, ``metadata["lambda_c_m"]`` and, when given, ``["lambda_s_m"]`` set.

    Raises
    ------
    DoubleFilterError
        If the profile is of kind R or W, or of kind P with `lambda_s` given.
    DataError
        If a cut-off lies outside the limits of `gaussian`, ``lambda_s >= lambda_c``, or
        `sections` is not a whole number from 1.
    InvalidSamplesError
        If a cut-off is not positive and finite.
    NotUniformError
        If the positions are not uniform.
    TooFewSamplesError
        If too little was measured, or less than the sections remains.

    References
    ----------
    .. [1] ISO 21920-2:2021, clause 3.1; ISO 4287:1997, 3.1.6.
    .. [2] ISO 13565-1:1996 (recalled; two passes as the NPL guide 37 describes them).

    Examples
    --------
    >>> import numpy as np
    >>> x = np.arange(8000) * 0.5e-6
    >>> r = roughness(Profile(x, 1e-6 * np.sin(2 * np.pi * x / 50e-6)), lambda_c=0.8e-3, sections=5)
    >>> len(r), r.metadata["profile_kind"]
    (8000, 'R')
    """
    _refuse(profile, ("R", "W") if lambda_s is None else ("P", "R", "W"), refilter)
    if sections is not None:
        sections = count(sections, "sections")
    return _passed(
        profile,
        "R",
        "roughness",
        end,
        refilter,
        sections,
        choice(core_filter, "core_filter", ("gaussian", "13565-1", "robust")),
        lambda_s_m=lambda_s,
        lambda_c_m=lambda_c,
    )


def waviness(
    profile: Profile,
    *,
    lambda_c: float | str,
    lambda_f: float | str | None = None,
    lambda_s: float | str | None = None,
    end: End = "moment",
    refilter: bool = False,
) -> Profile:
    """Return the waviness profile: what is longer than lambda-c, and shorter than lambda-f.

    Parameters
    ----------
    profile : Profile
        Form removed; a primary profile, or as measured.
    lambda_c : float (m) or str with unit
        Cut-off between roughness and waviness.
    lambda_f : float (m) or str with unit, optional
        Cut-off between waviness and form; without it only the nominal form is out.
    lambda_s : float (m) or str with unit, optional
        Applied first when given. It hardly matters to the waviness.
    end : {"moment", "renormalise", "closed", "cut"}, optional
        End rule of the Gaussian filter.
    refilter : bool, optional
        Filter a profile that was filtered already.

    Returns
    -------
    Profile
        Kind W, ``metadata["lambda_c_m"]`` and, when given, ``["lambda_f_m"]`` and
        ``["lambda_s_m"]`` set.

    Raises
    ------
    DoubleFilterError
        If the profile is of kind R or W, or of kind P with `lambda_s` given.
    DataError
        If a cut-off lies outside the limits of `gaussian` or they are not in order.
    InvalidSamplesError
        If a cut-off is not positive and finite.
    NotUniformError
        If the positions are not uniform.
    TooFewSamplesError
        If too little was measured.

    References
    ----------
    .. [1] ISO 21920-2:2021, clause 3.1; ISO 4287:1997, 3.1.7.

    Examples
    --------
    >>> import numpy as np
    >>> w = waviness(Profile(np.arange(999) * 1e-5, np.zeros(999)), lambda_c=0.8e-3)
    >>> w.metadata["profile_kind"], w.metadata["lambda_c_m"]
    ('W', 0.0008)
    """
    _refuse(profile, ("R", "W") if lambda_s is None else ("P", "R", "W"), refilter)
    cutoffs = {"lambda_s_m": lambda_s, "lambda_c_m": lambda_c, "lambda_f_m": lambda_f}
    return _passed(profile, "W", "waviness", end, refilter, None, **cutoffs)


def _passed(
    profile: Profile,
    kind: ProfileKind,
    name: str,
    end: End,
    refilter: bool,
    sections: int | None,
    core_filter: str = "gaussian",
    /,
    **cutoffs: float | str | None,
) -> Profile:
    """Return the profile after its cut-offs, shortest first; the last one takes off what is longer."""
    needed = "lambda_s_m" if kind == "P" else "lambda_c_m"
    given = {k: v for k, v in cutoffs.items() if v is not None or k == needed}
    facts = {k: positive(v, k[:-2], dimension="length") for k, v in given.items()}
    for (short, low), (long, high) in pairwise(facts.items()):
        if not low < high:
            raise DataError(
                f"{short[:-2]} {format_length(low)} must be shorter than {long[:-2]} "
                f"{format_length(high)}"
            )
    result = profile
    for key, cutoff in facts.items():
        is_long = key == {"R": "lambda_c_m", "W": "lambda_f_m"}.get(kind)
        band: FilterBand = "short" if is_long else "long"
        if is_long and core_filter == "robust":
            result = robust_gaussian(result, cutoff=cutoff, band=band, refilter=refilter)
        elif is_long and core_filter == "13565-1":
            result = _two_passes(result, cutoff, end)
        else:
            result = gaussian(result, cutoff=cutoff, band=band, end=end, refilter=refilter)
    if sections is not None:
        result = _middle(result, sections, facts["lambda_c_m"])
    facts = {k: facts[k] for k in ("lambda_c_m", "lambda_s_m", "lambda_f_m") if k in facts}
    return Profile(
        result.x,
        result.z,
        metadata={**result.metadata, "profile_kind": kind, **facts},
        history=(*result.history, Step(name, facts)),
    )


def _two_passes(profile: Profile, cutoff: float, end: End) -> Profile:
    """Return what the mean line of the profile without its valleys leaves (ISO 13565-1)."""
    first = gaussian(profile, cutoff=cutoff, end=end, refilter=True)
    inside = np.isin(profile.x, first.x) if len(first) < len(profile) else slice(None)
    x, z = profile.x[inside], profile.z[inside]
    plateau = Profile(x, np.maximum(z, first.z))
    line = gaussian(plateau, cutoff=cutoff, end=end)
    kept = np.isin(x, line.x) if len(line) < len(x) else slice(None)
    step = Step("gaussian 13565-1", {"cutoff_m": cutoff, "band": "short", "end": end, "passes": 2})
    return Profile(
        line.x,
        z[kept] - line.z,
        metadata={**profile.metadata, "profile_kind": "R"},
        history=(*profile.history, step),
    )


def _refuse(profile: Profile, kinds: tuple[ProfileKind, ...], refilter: bool) -> None:
    instance_of(profile, Profile, "the filter chain")
    kind = profile_kind(profile)
    if kind in kinds and not refilter:
        raise DoubleFilterError(
            f"the profile is {_ALREADY[kind]}; start from the profile before that filter "
            f"{ALL_THE_SAME}"
        )


def _middle(profile: Profile, sections: int, length: float) -> Profile:
    """Return whole sections from the middle of a profile."""
    whole = int(length / profile.dx * (1.0 + 1e-9))
    n = sections * whole
    if len(profile) < n - SHORTFALL * whole:
        raise TooFewSamplesError(
            f"{counted(sections, 'section')} of {format_length(length)} "
            f"{'needs' if sections == 1 else 'need'} {counted(n, 'sample')}, {len(profile)} are "
            "left: measure longer, or ask for fewer sections"
        )
    n = min(n, len(profile))
    first = (len(profile) - n) // 2
    part = slice(first, first + n)
    section = float(length) if n == sections * whole else n * profile.dx / sections
    step = Step("sections", {"sections": sections, "section_length_m": section})
    return Profile(
        profile.x[part],
        profile.z[part],
        metadata=profile.metadata,
        history=(*profile.history, step),
    )
