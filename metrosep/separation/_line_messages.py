"""What a result of probes in a row says in plain words: gaps, counts, units, null space."""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.separation._line_found import Found
from metrosep.separation._line_null_space import PARABOLA, has_end_waves
from metrosep.separation._line_problem import Problem
from metrosep.separation._line_request import Request
from metrosep.separation._readings import NOISE_UNKNOWN
from metrosep.separation.null_space import Unobservable

LARGE_RANGE = 10e-3
"""Readings of a straightness probe that span more, m, were hardly given in m."""


def lost_samples(artefact: FloatArray, found: Found) -> tuple[Unobservable, ...]:
    """Return the samples that are NaN, with the reason."""
    lost = np.flatnonzero(np.isnan(artefact))
    if lost.size == 0:
        return ()
    reasons = []
    if lost.size > found.n_unread:
        reasons.append(
            "readings that were not measured cut the chain, and offset and line of its pieces are "
            "not connected: the longest piece is returned; measure the gap again"
        )
    if found.n_unread:
        reasons.append(
            "no probe read these samples together with the others: take a step as coarse as the "
            "positions, or measure there"
        )
    return (Unobservable("artefact", "samples", tuple(int(i) for i in lost), "; ".join(reasons)),)


def passes_per_position(problem: Problem) -> list[int]:
    """Return the least and the largest number of passes that a position rests on."""
    whole = problem.stations.valid[: problem.n_probes].all(axis=0)
    count = np.zeros(problem.x.size, dtype=np.intp)
    count[problem.stations.at[whole]] = problem.stations.count[whole]
    return [int(count.min()), int(count.max())]


def noise_messages(found: Found, noise: Quantity, scale: float, method: str) -> list[str]:
    """Return what is to be said about the noise, and a misfit of redundant rows."""
    if math.isnan(noise.value):
        return [NOISE_UNKNOWN]
    if found.freedom <= 0 or scale == 0.0:
        return []
    ratio = math.sqrt(found.rest / found.freedom) / scale
    if ratio <= 1.0 + 2.0 / math.sqrt(2.0 * found.freedom):
        return []
    return [
        f"the redundant rows scatter {ratio:.3g} times more than the noise of a reading says "
        f"({found.freedom} degrees of freedom): a probe drifts, a distance or sign is wrong"
        + ("" if method == "least_squares" else ", or the smoothing is too strong")
    ]


def reading_messages(readings: FloatArray, problem: Problem) -> list[str]:
    """Return doubts about the unit, and what became of passes that lack a reading."""
    out = []
    span = float(np.nanmax(readings) - np.nanmin(readings))
    if span > LARGE_RANGE:
        out.append(
            f"the readings span {span:.3g} m; they are taken in m: 5 um is 5e-6. Check the unit"
        )
    low, high = passes_per_position(problem)
    missing = np.isnan(readings)
    if readings.shape[1] > 1 and missing.any():
        torn = int((missing.any(axis=0) & ~missing.all(axis=0)).sum())
        text = f"the positions rest on {low} to {high} passes, and u follows these counts"
        if torn:
            text += (
                f"; in {torn} cases a pass is missing a probe: as each pass has its own straightness and "
                "pitch, the rest of that pass counts there only where it is free of them"
            )
        out.append(text)
    if problem.stations.n_lost_angles:
        out.append(
            f"at {problem.stations.n_lost_angles} positions the angle was left out: it is the mean of "
            "all passes, and a pass lacks a probe there"
        )
    return out


def null_space_messages(
    request: Request,
    null_space: tuple[Unobservable, ...],
    x: FloatArray,
    degree: int,
    found: Found,
    artefact: FloatArray,
) -> list[str]:
    """Return what these probes do not see."""
    out = []
    row = request.row
    if degree == 2:
        o = row.offsets
        length = float(x[-1] - x[0]) + o[-1] - o[0]
        sag = length**2 / (4.0 * (o[1] - o[0]) * (o[2] - o[0]))
        keep = "pass zero=0.0 to keep the parabola, " if request.name == "three_point" else ""
        out.append(
            "the parabola is not known and left out: a zero error of 1 nm would be a sag of "
            f"{format_length(sag * 1e-9)} over {format_length(length)}; {keep}{PARABOLA}"
        )
    for item in null_space:
        if item.kind == "wavelength":
            named = ", ".join(format_length(float(w)) for w in item.indices[:4])
            more = " ..." if len(item.indices) > 4 else ""
            out.append(f"the wavelengths {named}{more} are suppressed by these probe distances")
    if has_end_waves(row) and request.method == "least_squares":
        out.append(
            "waves that die away from the ends are not determined by these distances and removed by "
            "least squares: the ends are doubtful; method='generalised' takes the smoothest curve"
        )
    lost = int(np.isnan(artefact).sum())
    if found.n_unread:
        out.append(f"{found.n_unread} samples were read by no probe in a usable row and are NaN")
    if lost > found.n_unread:
        out.append(f"{lost - found.n_unread} samples are not connected with the rest and left NaN")
    return out
