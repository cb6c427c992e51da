"""Private: the Gaussian weighting function of ISO 16610-21, in samples.

Lengths here are in samples along one axis, so that one code serves profiles and both axes of a
surface. `standard_deviation` is the only place where the constant a of the standard appears.

Source: ISO 16610-21:2011, 4.1 (weighting function) and 4.2 (transmission).
"""

from __future__ import annotations

import math

import numpy as np

ALPHA = math.sqrt(math.log(2.0) / math.pi)
"""The constant a = 0.4697: half of the amplitude passes at the cutoff."""

WINDOW = 7.0
"""Half-width in standard deviations (1.31 cutoffs); 3e-12 of the weight lies outside."""

COMPLETE = 1.0 - 5e-11
"""Support share from which the window counts as complete."""

SINGULAR = 1e-9
"""Determinant of the second moments (in squared deviations) below which no slope is fitted."""


def standard_deviation(cutoff: float, step: float) -> float:
    """Return the standard deviation of the weighting function in samples."""
    return ALPHA * cutoff / (math.sqrt(2.0 * math.pi) * step)


def lattice_sum(sd: float) -> float:
    """Return the sum of exp(-u^2 / 2 sd^2) over the integers u of the window."""
    u = np.arange(1, half_width(sd) + 1) / sd
    return 1.0 + 2.0 * float(np.exp(-0.5 * u * u).sum())


def half_width(sd: float) -> int:
    """Return the number of samples on either side of the centre that carry weight."""
    return math.ceil(WINDOW * sd)
