"""Filters after ISO 16610: profiles and surfaces in, the same kind of object out."""

from __future__ import annotations

from metrosep.filters._arguments import DoubleFilterError, profile_kind
from metrosep.filters.bands import BandEdges, band_edges, band_stop
from metrosep.filters.chain import primary, roughness, waviness
from metrosep.filters.gaussian import gaussian, gaussian_support
from metrosep.filters.morphological import closing, dilation, erosion, opening
from metrosep.filters.robust import regression_constant, robust_gaussian
from metrosep.filters.sampling import resample
from metrosep.filters.spline import spline
from metrosep.spectral.dft import Band

__all__ = [
    "Band",
    "BandEdges",
    "DoubleFilterError",
    "band_edges",
    "band_stop",
    "closing",
    "dilation",
    "erosion",
    "gaussian",
    "gaussian_support",
    "opening",
    "primary",
    "profile_kind",
    "regression_constant",
    "resample",
    "robust_gaussian",
    "roughness",
    "spline",
    "waviness",
]
