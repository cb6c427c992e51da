"""From an error to what is added to a command: tables, inverses, limits, dry-runs, polynomials."""

from __future__ import annotations

from metrosep.compensation.inverse import exact_correction
from metrosep.compensation.limits import Finding, Limits, check_limits, dead_zone
from metrosep.compensation.polynomial import PolynomialFit, fit_polynomial
from metrosep.compensation.reversal import LostMotion
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.verify import DirectionResidual, Verification, dry_run

__all__ = [
    "CompensationTable",
    "DirectionResidual",
    "Finding",
    "Limits",
    "LostMotion",
    "PolynomialFit",
    "Verification",
    "check_limits",
    "dead_zone",
    "dry_run",
    "exact_correction",
    "fit_polynomial",
]
