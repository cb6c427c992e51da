"""Which probe is wrong: what more than three probes disagree by, and who explains it best.

With n > 3 probes each undulation leaves n - 3 complex residuals that no artefact and no motion can
make. Their chi-square says whether the set-up is as stated. If not, three kinds of fault are tried
for each probe: a wrong angle, a wrong sensitivity (each one number for all undulations) and a probe
that is left out. What explains the residuals is named, if it explains them clearly better than
the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import TooFewSamplesError
from metrosep.core.profile import html_table
from metrosep.separation._circle import check_number, harmonics_of, revolutions
from metrosep.separation._circle_input import circle_readings
from metrosep.separation._probe_geometry import ProbeGeometry, probe_geometry
from metrosep.separation.probes import MultiprobeRoundness

__all__ = ["ProbeCheck", "Suspect", "check_probes"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_EXCESS = 5.0
"""Chi-square this many of its standard deviations above its degrees of freedom is a fault."""

_LEAD = 2.0
"""The named fault leaves at most this part of the chi-square that the next leaves."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """A fault of one probe that would explain the residuals.

    Parameters
    ----------
    probe : int
        From 0, in the order of the readings; -1 for the turn.
    fault : {"angle", "sensitivity", "turn"}
        What would be wrong.
    size : float
        True minus stated angle in rad (add it to the stated one), or relative excess of the
        sensitivity (divide the readings by 1 + size); NaN for the turn.
    chi2 : float
        What is left with it.
    """

    probe: int
    fault: Literal["angle", "sensitivity", "turn"]
    size: float
    chi2: float

    def __str__(self) -> str:
        if self.fault == "turn":
            return "the part turns the other way: give turn with the opposite sign"
        if self.fault == "angle":
            return f"probe {self.probe} stands {math.degrees(self.size):+.4g} deg from its angle"
        return f"probe {self.probe} reads {100.0 * self.size:+.3g} % of its signal too much"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ProbeCheck:
    """Whether the probes agree, and the fault that explains it best.

    Parameters
    ----------
    chi2 : float
        Sum of squared residuals in units of their variance.
    freedom : int
        Its expectation without a fault.
    chi2_per_k : ndarray, shape (kmax + 1,)
        Share of each undulation over its freedom; NaN where there is none.
    suspects : tuple of Suspect
        The best explanation first.
    named : Suspect or None
        The one that explains it clearly better than the next; None if the probes agree or no
        single fault does.
    message : str
        The finding in words.
    """

    chi2: float
    freedom: int
    chi2_per_k: FloatArray
    suspects: tuple[Suspect, ...]
    named: Suspect | None
    message: str

    @property
    def agrees(self) -> bool:
        """Whether chi-square is what the noise explains."""
        return self.chi2 <= self.freedom + _EXCESS * math.sqrt(2.0 * self.freedom)

    def __repr__(self) -> str:
        return f"ProbeCheck(chi2 {self.chi2:.4g} of {self.freedom}; {self.message})"

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {"chi2 / freedom": f"{self.chi2:.4g} / {self.freedom}", "finding": self.message}
        rows.update({f"suspect {i + 1}": str(s) for i, s in enumerate(self.suspects[:4])})
        return html_table("Probe check", rows)


def check_probes(
    m: Any, angles: ArrayLike, kmax: int, *, u_reading: float, turn: Literal[1, -1] = 1
) -> ProbeCheck:
    """Return whether four or more probes agree, and which probe or angle is wrong if not.

    Parameters
    ----------
    m : array_like, shape (n, N) or (n, M, N), n > 3, m, or Recording, or sequence of Profile
        Readings as for `multiprobe`.
    angles : array_like, shape (n,), rad
        Where the probes are believed to stand.
    kmax : int
        Highest undulation, 2 <= kmax < N/2.
    u_reading : float, m, > 0
        Standard deviation of one reading.
    turn : {1, -1}, optional
        As for `multiprobe`.

    Returns
    -------
    ProbeCheck
        ``.agrees``, ``.named``, ``.suspects``, ``.message``.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than four probes, or too few samples for kmax.
    DataError
        If `u_reading` is not above zero, or kmax or turn is out of range.
    UnitError
        If the angles look like degrees.
    InvalidSamplesError
        If readings or angles cannot be used.
    NotSeparableError
        If the angles separate nothing.

    Notes
    -----
    A fault is linearised and then iterated, so angles wrong by some degrees are found as long as
    ``kmax`` times the error stays below about 1 rad. A common turn of all probes is invisible.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> theta = 2 * np.pi * np.arange(256) / 256
    >>> true = np.deg2rad([0.0, 20.5, 270.5, 298.0])
    >>> m = [sum(np.cos(k * (theta + p) + k**2) for k in range(2, 20)) * 1e-8 for p in true]
    >>> m = m + 1e-10 * rng.standard_normal((4, 256))
    >>> print(check_probes(m, np.deg2rad([0.0, 20.5, 270.5, 297.0]), 20, u_reading=1e-10).message)
    probe 3 stands +1.002 deg from its angle
    """
    method = MultiprobeRoundness(angles, kmax, turn=turn)
    phi = np.array(method.angles)
    if phi.size < 4:
        raise TooFewSamplesError(
            f"three probes always agree; need >= 4 to find a fault, got {phi.size}"
        )
    u_reading = check_number(u_reading, "u_reading", unit="m", above=0.0)
    given = circle_readings(m, what="check_probes").values
    array = revolutions(given, phi.size, what="probes", n_min=2 * method.kmax + 1).values
    mean = harmonics_of(array, method.kmax).mean(axis=1)
    variance = 2.0 * u_reading**2 / (array.shape[1] * array.shape[2])
    geometry = _geometry(phi, method.kmax, turn)
    per_k = _chi2(geometry, mean, variance)
    freedom = 2 * int(geometry.freedom.sum())
    chi2 = float(per_k.sum())
    share = np.full(per_k.size, np.nan)
    seen = geometry.freedom > 0
    share[seen] = per_k[seen] / (2.0 * geometry.freedom[seen])
    suspects = [
        find(i, phi, mean, method.kmax, turn, variance)
        for i in range(phi.size)
        for find in (_wrong_angle, _wrong_sensitivity)
    ]
    mirrored = float(_chi2(_geometry(phi, method.kmax, -turn), mean, variance).sum())
    suspects.append(Suspect(-1, "turn", math.nan, mirrored))
    suspects.sort(key=lambda s: s.chi2)
    named, message = _verdict(chi2, freedom, suspects)
    return ProbeCheck(chi2, freedom, share, tuple(suspects), named, message)


def _geometry(phi: FloatArray, kmax: int, turn: int) -> ProbeGeometry:
    return probe_geometry(phi, kmax, covariance=None, max_gain=50.0, turn=turn)


def _chi2(geometry: ProbeGeometry, mean: ComplexArray, variance: float) -> FloatArray:
    rest = np.einsum("kij,jk->ki", geometry.residual, mean)
    out: FloatArray = np.sum(np.abs(rest) ** 2, axis=1) / variance
    return out


def _fitted(geometry: ProbeGeometry, mean: ComplexArray, moved: ComplexArray) -> float:
    """Return the real factor of `moved` (n, kmax + 1) that explains the residuals best."""
    rest = np.einsum("kij,jk->ki", geometry.residual, mean)
    shape = np.einsum("kij,jk->ki", geometry.residual, moved)
    size = float(np.sum(np.abs(shape) ** 2))
    return float(np.sum((shape.conj() * rest).real)) / size if size > 0.0 else 0.0


def _wrong_angle(
    i: int, phi: FloatArray, mean: ComplexArray, kmax: int, turn: int, variance: float
) -> Suspect:
    """Gauss-Newton in the angle of one probe."""
    angles = phi.copy()
    k = np.arange(kmax + 1)
    limit = 1.0 / kmax
    best = (math.inf, 0.0)
    for _ in range(12):
        geometry = _geometry(angles, kmax, turn)
        chi2 = float(_chi2(geometry, mean, variance).sum())
        if chi2 < best[0]:
            best = (chi2, float(angles[i] - phi[i]))
        r, x, y = (np.where(np.isnan(v), 0.0, v) for v in _solve(geometry, mean))
        moved = np.zeros_like(mean)
        moved[i] = 1j * turn * k * np.exp(1j * turn * k * angles[i]) * r
        moved[i] += -math.sin(angles[i]) * x + math.cos(angles[i]) * y
        moved[:, :2] = 0.0
        step = float(np.clip(_fitted(geometry, mean, moved), -limit, limit))
        angles[i] += step
        if abs(step) < 1e-10:
            break
    return Suspect(i, "angle", best[1], best[0])


def _solve(geometry: ProbeGeometry, mean: ComplexArray) -> ComplexArray:
    out: ComplexArray = np.einsum("pkn,nk->pk", geometry.rows, mean)
    return out


def _wrong_sensitivity(
    i: int, phi: FloatArray, mean: ComplexArray, kmax: int, turn: int, variance: float
) -> Suspect:
    """Exact: readings of one probe times a factor are linear in the factor."""
    geometry = _geometry(phi, kmax, turn)
    moved = np.zeros_like(mean)
    moved[i] = -mean[i]
    factor = 1.0 + _fitted(geometry, mean, moved)
    scaled = mean.copy()
    scaled[i] = factor * mean[i]
    chi2 = float(_chi2(geometry, scaled, variance).sum())
    size = 1.0 / factor - 1.0 if abs(factor) > 1e-6 else math.inf
    return Suspect(i, "sensitivity", size, chi2)


def _verdict(chi2: float, freedom: int, suspects: list[Suspect]) -> tuple[Suspect | None, str]:
    enough = freedom + _EXCESS * math.sqrt(2.0 * freedom)
    if chi2 <= enough:
        return None, "the probes agree within their noise"
    best, second = suspects[0], suspects[1]
    if _LEAD * best.chi2 < second.chi2:
        rest = "" if best.chi2 <= enough else "; that explains most of it, not all"
        return best, f"{best}{rest}"
    if _LEAD * best.chi2 < chi2:
        return None, f"the probes disagree; either {best}, or {second}"
    return None, (
        "the probes disagree, and no wrong angle or sensitivity of a single probe explains it: "
        "look at noise, sampling angle, several faults"
    )
