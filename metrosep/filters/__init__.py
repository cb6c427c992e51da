"""Filters after ISO 16610: profiles and surfaces in, the same kind of object out."""

from __future__ import annotations

from metrosep.filters.kind import DoubleFilterError, profile_kind
from metrosep.spectral.band import Band

__all__ = ["Band", "DoubleFilterError", "profile_kind"]
