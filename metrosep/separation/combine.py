"""Several separations of the same artefact as one: each harmonic weighted by its variance.

A reversal sees every undulation, a multi-probe set-up sees most of them with less noise, a second
set of angles sees others. Harmonic by harmonic the mean weighted with 1/u^2 takes the best of each;
what only one sees is taken from it, what none sees stays NaN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.provenance import Step
from metrosep.separation._circle import check_kmax, curve, grid, names_of_k
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import Unobservable, suppressed_harmonics

__all__ = ["combine_harmonics"]


_DISAGREE = 5.0
"""Excess of chi-square, in its standard deviations, at which the methods are said to disagree."""


def combine_harmonics(
    *separations: Separation, parts: Sequence[str] = ("artefact",), kmax: int | None = None
) -> Separation:
    """Return one separation from several of the same artefact, per harmonic by 1/variance.

    Parameters
    ----------
    *separations : Separation
        Two or more with harmonics of `parts` and their uncertainty, over the same angle of the
        artefact: same zero mark, same sense.
    parts : sequence of str, optional
        Parts to combine; the motion of the spindle only if it is the same direction in each.
    kmax : int, optional
        Highest harmonic of the result; the highest that any of them has if omitted.

    Returns
    -------
    Separation
        The parts with `harmonics`; the curve is the sum of the observable ones over the angles of
        the input with the most samples. ``audit["weights"]`` tells the share of each input.

    Raises
    ------
    TooFewSamplesError
        If fewer than two separations are given.
    DataError
        If an input lacks the part, its harmonics or its uncertainty, none knows a harmonic, or
        kmax is out of range.

    Notes
    -----
    ``c_k = sum(c_ik / u_ik^2) / sum(1 / u_ik^2)``, ``u_k^2 = 1 / sum(1 / u_ik^2)`` (Gauss-Markov
    for independent inputs). Type B shares that are common to the inputs, such as one sensitivity of
    one probe used in all, do not average: add them afterwards with `Separation.with_type_b`.
    Chi-square over all harmonics seen at least twice says whether the inputs agree.

    Examples
    --------
    >>> from metrosep.separation.probes import multiprobe
    >>> a = 2 * np.pi * np.arange(128) / 128
    >>> results = []
    >>> for degrees in ([0, 45, 135], [0, 60, 150]):
    ...     phi = np.deg2rad(degrees)
    ...     m = [1e-8 * np.cos(7 * (a + p)) + 1e-8 * np.sin(11 * (a + p)) for p in phi]
    ...     results.append(multiprobe(m, phi, 15, u_reading=1e-9))
    >>> [result.suppressed for result in results]
    [[7, 9, 15], [11, 13]]
    >>> combine_harmonics(*results).suppressed
    []
    """
    if len(separations) < 2:
        raise TooFewSamplesError(f"need >= 2 separations to combine, got {len(separations)}")
    for i, item in enumerate(separations):
        if not isinstance(item, Separation):
            raise DataError(f"input {i} is a {type(item).__name__}, no Separation")
        for part in parts:
            _check_has(item, part, i)
    top = max(item.harmonics[part].size for item in separations for part in parts) - 1
    if kmax is not None:
        wanted = check_kmax(kmax)
        if wanted > top:
            raise DataError(f"kmax must be from 2 to {top}, what the separations have, got {kmax}")
        top = wanted
    n = max(item.coordinates["angle"].size for item in separations)
    harmonics, harmonics_u, curves, u_curves = {}, {}, {}, {}
    null_space: list[Unobservable] = []
    messages: list[str] = []
    weights: dict[str, Any] = {}
    ratios: dict[str, float | None] = {}
    for part in parts:
        c, u = _padded(separations, part, top)
        mean, u_mean, share = _weighted(c, u)
        harmonics[part], harmonics_u[part] = mean, u_mean
        curves[part] = curve(mean, n)
        u_curves[part] = np.full(n, math.sqrt(float(np.nansum(u_mean[1:] ** 2))))
        weights[part] = [[float(w) for w in row] for row in share]
        ratios[part], text = _agreement(part, c, u, mean)
        messages += text
        messages += _empty(separations, part)
        found, text = _unseen(separations, part, mean)
        null_space += found
        messages += text
    return Separation(
        "combined harmonics",
        curves,
        u_curves,
        {part: separations[0].units[part] for part in parts},
        {"angle": grid(n)},
        tuple(null_space),
        separations[0].noise,
        harmonics,
        harmonics_u,
        {
            "methods": [item.method for item in separations],
            "kmax": top,
            "weights": weights,
            "chi2_ratio": ratios,
        },
        tuple(messages),
        (
            *(step for item in separations for step in item.history),
            Step("combine_harmonics", {"methods": [item.method for item in separations]}),
        ),
    )


def _check_has(item: Separation, part: str, i: int) -> None:
    if part not in item.harmonics or part not in item.harmonics_u:
        known = ", ".join(item.harmonics) or "none"
        raise DataError(
            f"separation {i} ({item.method}) has no harmonics of {part!r}; it has {known}"
        )
    if "angle" not in item.coordinates:
        raise DataError(f"separation {i} ({item.method}) is not over an angle")
    u = item.harmonics_u[part][np.isfinite(item.harmonics[part])]
    if not (u > 0.0).all():
        raise DataError(
            f"separation {i} ({item.method}) states no uncertainty for harmonics of {part!r}, so it "
            "has no weight: give its u_reading, or repeats"
        )


def _padded(
    separations: Sequence[Separation], part: str, top: int
) -> tuple[ComplexArray, FloatArray]:
    """Return (inputs, top + 1); NaN where an input has no such harmonic, and for k = 0 and 1."""
    c = np.full((len(separations), top + 1), np.nan, dtype=np.complex128)
    u = np.full((len(separations), top + 1), np.nan)
    for i, item in enumerate(separations):
        size = min(top + 1, item.harmonics[part].size)
        c[i, :size] = item.harmonics[part][:size]
        u[i, :size] = item.harmonics_u[part][:size]
    u[np.isnan(c)] = np.nan
    return c, u


def _weighted(c: ComplexArray, u: FloatArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
    seen = np.isfinite(u)
    information = np.where(seen, 1.0 / np.where(seen, u, 1.0) ** 2, 0.0)
    total = information.sum(axis=0)
    none = total == 0.0
    share = information / np.where(none, 1.0, total)
    mean = np.where(seen, c, 0.0)
    mean = np.sum(share * mean, axis=0)
    mean[none] = np.nan
    u_mean = np.where(none, np.nan, 1.0 / np.sqrt(np.where(none, 1.0, total)))
    return mean, u_mean, share


def _agreement(
    part: str, c: ComplexArray, u: FloatArray, mean: ComplexArray
) -> tuple[float | None, list[str]]:
    """Return chi-square over its freedom, and words where the inputs contradict each other."""
    seen = np.isfinite(u)
    freedom = 2 * int(np.maximum(seen.sum(axis=0) - 1, 0).sum())
    if freedom == 0:
        return None, []
    apart = np.where(seen, np.abs(np.where(seen, c, 0.0) - np.where(seen, mean, 0.0)), 0.0)
    ratio = float(np.sum((apart / np.where(seen, u, 1.0)) ** 2)) / freedom
    if ratio <= 1.0 + _DISAGREE * math.sqrt(2.0 / freedom):
        return ratio, []
    text = (
        f"the separations differ {math.sqrt(ratio):.3g} times more than their uncertainties allow "
        f"in {part}: is the zero mark and the sense of the angle the same in all, is the motion?"
    )
    return ratio, [text]


def _empty(separations: Sequence[Separation], part: str) -> list[str]:
    """Name inputs without one known harmonic: their curve has gaps; refuse if all are such."""
    empty = [
        (i, item)
        for i, item in enumerate(separations)
        if not np.isfinite(item.harmonics[part]).any()
    ]
    if len(empty) == len(separations):
        raise DataError(
            f"no separation knows a single harmonic of {part!r}: their curves have gaps (NaN); "
            "measure the missing samples, or leave incomplete revolutions out"
        )
    return [
        f"separation {i} ({item.method}) knows no harmonic of {part}, since its curve has gaps: it "
        "takes no part in the combination"
        for i, item in empty
    ]


def _unseen(
    separations: Sequence[Separation], part: str, mean: ComplexArray
) -> tuple[list[Unobservable], list[str]]:
    """Return what no input knows, and why: suppressed in all, or also lost for other reasons."""
    missing = np.isnan(mean)
    found, messages = [], []
    terms = tuple(t for t, m in zip(("offset", "eccentricity"), missing[:2], strict=True) if m)
    if terms:
        found.append(Unobservable(part, "term", terms, "left out by every one of the separations"))
    lost = [int(k) for k in np.flatnonzero(missing) if k > 1]
    hidden = [suppressed_harmonics(item.null_space, part) for item in separations]
    everywhere = tuple(k for k in lost if all(k in ks for ks in hidden))
    other = tuple(k for k in lost if k not in everywhere)
    if everywhere:
        why = "suppressed in every one of the separations"
        found.append(Unobservable(part, "harmonic", everywhere, why))
        messages.append(
            f"k={names_of_k(everywhere)} of {part} is suppressed in every separation: NaN"
        )
    if other:
        why = (
            "suppressed in some of the separations, and above kmax or lost to gaps (NaN) in the "
            "others"
        )
        found.append(Unobservable(part, "harmonic", other, why))
        messages.append(f"k={names_of_k(other)} of {part} is known by no separation ({why}): NaN")
    return found, messages
