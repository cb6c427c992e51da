"""Kono's rule: which wavelengths repeat over the feedrates.

The shortest wavelength with sigma < sigma_t and mean P > p_t; the paper states neither unit nor
normalisation of P, so both are options, and so is what else the rule leaves open.

Source: Kono et al. 2008, section 2.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.units import format_length
from metrosep.separation.spectra import Averaging, FeedSpectra, Norm

__all__ = ["Rule", "SelectionRule", "WavelengthSelection", "select_wavelengths"]

Rule = Literal["shortest", "contiguous", "mask"]

_UM, _MM = 1e-6, 1e-3
_THRESHOLDS = {
    "amplitude": (0.05 * _UM, 0.01 * _UM, "m"),
    "power": (0.05 * _UM**2, 0.01 * _UM**2, "m2"),
    "psd": (0.05 * _UM**2 * _MM, 0.01 * _UM**2 * _MM, "m3"),
}
"""The paper's 0.05 and 0.01, read in um, um^2 or um^2 mm: sigma_t, p_t, SI unit."""


@dataclass(frozen=True, slots=True)
class SelectionRule:
    """Thresholds and choices of the rule."""

    sigma_t: float | None = None  # thresholds in SI; the paper's if None
    p_t: float | None = None
    norm: Norm = "amplitude"  # {"amplitude", "power", "psd"}: normalisation of P
    rule: Rule = "shortest"  # {"shortest", "contiguous", "mask"}: what is kept
    # {"coherent", "power"}: order of averaging over the runs of one feedrate
    averaging: Averaging = "coherent"
    ddof: int = 1  # {1, 0}: sample or population standard deviation over feedrates
    relative: bool = False  # whether sigma is divided by the mean (sigma_t is then a number)
    # least coherence over feedrates, 0 to 1; 0 ignores phase as the paper does
    min_coherence: float = 0.0

    def __post_init__(self) -> None:
        if self.ddof not in (0, 1):
            raise DataError(f"ddof must be 1 (sample) or 0 (population), got {self.ddof}")
        if not 0.0 <= self.min_coherence <= 1.0:
            raise DataError(f"min_coherence must be in [0, 1], got {self.min_coherence}")

    def thresholds(self) -> tuple[float, float, str, str]:
        """Return sigma_t, p_t and the units of both."""
        default_sigma, default_p, unit = _THRESHOLDS[self.norm]
        sigma_unit = "1" if self.relative else unit
        default_sigma = 0.05 if self.relative else default_sigma
        for name, value, default, unit_name in (
            ("sigma_t", self.sigma_t, default_sigma, sigma_unit),
            ("p_t", self.p_t, default_p, unit),
        ):
            if value is not None and not 0.0 <= value < 1e3 * default:
                raise UnitError(
                    f"{name} is {value} {unit_name}; it is in SI here, so the paper's default is "
                    f"{default:.3g} {unit_name}"
                )
        sigma = default_sigma if self.sigma_t is None else float(self.sigma_t)
        return sigma, default_p if self.p_t is None else float(self.p_t), sigma_unit, unit


@dataclass(frozen=True, slots=True, eq=False)
class WavelengthSelection:
    """Harmonics that are kept, and why."""

    kept: NDArray[np.bool_]  # shape (K,): in the model; through the thresholds
    passed: NDArray[np.bool_]
    mean: FloatArray  # shape (K,): mean and standard deviation of P over feedrates
    sigma: FloatArray
    m: int  # highest harmonic of the model
    reasons: list[str]  # one for each wavelength


def select_wavelengths(
    spectra: FeedSpectra, length: float, rule: SelectionRule, *, shortest: float | None = None
) -> WavelengthSelection:
    """Return the harmonics that the rule keeps."""
    power = spectra.power(rule.norm, length, averaging=rule.averaging)
    sigma_t, p_t, sigma_unit, unit = rule.thresholds()
    mean = power.mean(axis=0)
    n, several = mean.size, power.shape[0] > 1
    sigma = power.std(axis=0, ddof=rule.ddof) if several else np.full(n, np.nan)
    if rule.relative:
        sigma = np.divide(sigma, mean, out=np.full(n, np.inf), where=mean > 0.0)
    coherent = spectra.coherence >= rule.min_coherence
    passed = (sigma < sigma_t) & (mean > p_t) & coherent
    if shortest is not None:
        usable = math.isfinite(shortest) and shortest > 0.0
        m = math.floor(length / shortest * (1.0 + 1e-9)) if usable else 0
        if not 1 <= m <= n:
            raise UnitError(
                f"shortest is {format_length(shortest)}; it must lie between "
                f"{format_length(length / n)} and {format_length(length)}; it is in metres: 4 mm is 4e-3"
            )
        kept = np.arange(n) < m
        reasons = ["set by hand" if k else "shorter than the one set by hand" for k in kept]
        return WavelengthSelection(kept, passed, mean, sigma, m, reasons)
    if not several:
        raise NotSeparableError(
            "the rule of repeatability over feedrates needs runs at >= 2 feedrates, got "
            f"{power.shape[0]}; add runs at another feedrate or set the shortest wavelength by hand"
        )
    if not passed.any():
        raise NotSeparableError(
            f"no wavelength has sigma < {sigma_t:.3g} {sigma_unit} and mean P > {p_t:.3g} {unit} (norm "
            f"{rule.norm!r}; largest mean P is {mean.max():.3g} {unit}); relax sigma_t or p_t, or set "
            "the shortest wavelength by hand"
        )
    kept, m = _kept(passed, rule.rule)
    reasons = [
        ("passes" if passed[k] else "longer than the selected one")
        if kept[k]
        else _why_not(sigma[k] < sigma_t, mean[k] > p_t, coherent[k])
        for k in range(n)
    ]
    return WavelengthSelection(kept, passed, mean, sigma, m, reasons)


def _kept(passed: NDArray[np.bool_], rule: Rule) -> tuple[NDArray[np.bool_], int]:
    n = passed.size
    if rule == "contiguous":
        m = n if passed.all() else int(np.argmin(passed))
        if m == 0:
            raise NotSeparableError(
                "the longest wavelength already fails the thresholds, so the contiguous band is "
                "empty; use rule='mask' or rule='shortest'"
            )
        return np.arange(n) < m, m
    m = int(np.flatnonzero(passed)[-1]) + 1
    return (passed if rule == "mask" else np.arange(n) < m), m


def _why_not(steady: bool, strong: bool, coherent: bool) -> str:
    parts = [
        text
        for text, fine in (
            ("sigma too large", steady),
            ("P too small", strong),
            ("phase does not repeat", coherent),
        )
        if not fine
    ]
    return " and ".join(parts) or "shorter than the band"
