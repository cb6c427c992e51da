"""What probes in a row cannot see, and how much they see of a wave."""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._line_probes import Row
from metrosep.separation.contract import Unobservable

LINE = (
    "offset and line are the alignment of artefact and probes to the carriage; measure them "
    "against another reference"
)
PARABOLA = (
    "the zero error of the middle probe bends the artefact into a parabola; give zero with "
    "u_zero, zero_cal from a reversal or a known flat, or the readings of a pitch sensor"
)


def hidden_wavelengths(row: Row) -> tuple[float, ...]:
    """Return the wavelengths of at least two steps that no combination of the probes sees, m."""
    o = np.array(row.offsets) - row.offsets[0]
    found: set[float] = set()
    for d in np.diff(o):
        for n in range(1, int(d / (2.0 * row.step) * (1.0 + 1e-9)) + 1):
            wavelength = float(d) / n
            phase = np.exp(2j * np.pi * o / wavelength)
            if np.abs(phase - 1.0).max() < 1e-6:
                found.add(float(f"{wavelength:.9g}"))
    return tuple(sorted(found, reverse=True))


def transfer_of(
    offsets: tuple[float, ...], nuisance: FloatArray, wavelengths: FloatArray
) -> FloatArray:
    """Return the length of what is left of a unit wave when the carriage has cancelled."""
    left, size, _ = np.linalg.svd(nuisance, full_matrices=True)
    rank = int((size > 1e-12 * size.max()).sum())
    with np.errstate(divide="ignore"):
        phase = np.exp(2j * np.pi * np.array(offsets)[:, None] / wavelengths[None, :])
    return np.asarray(np.linalg.norm(left[:, rank:].T @ phase, axis=0))


def null_space_of(row: Row, degree: int, *, pitch_part: bool) -> tuple[Unobservable, ...]:
    """Return what whole readings of these probes do not determine."""
    reason = LINE if degree < 2 else f"{LINE}; {PARABOLA}"
    items = [
        Unobservable(p, "polynomial", tuple(range(degree + 1)), reason)
        for p in ("artefact", "straightness")
    ]
    if row.pitch:
        items.append(Unobservable("pitch", "polynomial", tuple(range(degree)), reason))
    elif pitch_part:
        text = (
            "two probes cannot tell pitch from form: the sum of pitch times distance is in the "
            "artefact; use three probes or read the pitch with an angle sensor"
        )
        items.append(Unobservable("pitch", "term", ("pitch",), text))
    waves = hidden_wavelengths(row)
    if waves:
        text = (
            "all probes see these waves in the same phase; change the distances so that they have "
            "no large common measure, or measure a second time with another distance"
        )
        items.append(Unobservable("artefact", "wavelength", waves, text))
    if has_end_waves(row):
        text = (
            "each position gives one equation, so as many shapes as the probes span steps stay free: "
            "waves that die away from the ends; overlap the ends, add a probe, or use "
            "method='generalised', which takes the smoothest"
        )
        items.append(Unobservable("artefact", "term", ("end waves",), text))
    return tuple(items)


def has_end_waves(row: Row) -> bool:
    """Return whether shapes other than lines and waves of the distances escape these probes."""
    order = 2 if row.pitch else 1
    return len(row.offsets) == order + 1 and row.span > order * row.grid_period
