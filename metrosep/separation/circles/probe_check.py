"""Which probe is wrong: what more than three probes disagree by, and who explains it best.

With n > 3 probes each undulation leaves n - 3 complex residuals that no artefact and no motion can
make. Their chi-square is tested as a whole, and so is what a single fault takes off it: a wrong
angle or a wrong sensitivity of one probe (each one number for all undulations). The second test is
sharp: one number against noise, not all residuals at once. What explains the residuals is named, if
it explains them clearly better than the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.core.options import Option
from metrosep.core.profile import html_table
from metrosep.separation.circles._circle import (
    ProbeGeometry,
    circle_readings,
    harmonics_of,
    probe_geometry,
    revolutions,
)
from metrosep.separation.circles.probes import MultiprobeRoundness, multiprobe
from metrosep.separation.contract import NamedMethod


class ProbesChecked(NamedMethod):
    """`check_probes` by its name."""

    name = "check_probes"
    what = "whether four or more probes agree, and which angle or sensitivity is wrong if not"
    over = "angle"
    arguments: ClassVar[Mapping[str, Option]] = {
        "angles": MultiprobeRoundness.fields["angles"],
        "kmax": Option("integer", required=True, help="highest undulation that is looked at"),
        "u_reading": Option("size", required=True, help="standard uncertainty of one reading"),
        "turn": MultiprobeRoundness.fields["turn"],
    }


_CHANCE = 0.002
"""Noise alone is taken for a fault once in 500 checks."""

_EXCESS = 5.0
"""Chi-square this many of its standard deviations above its degrees of freedom is not noise."""

_TOO_GOOD = 1e-3
"""Probability of a smaller chi-square below which the noise was stated too large."""

_CLEAR = 6.0
"""The named fault leaves a chi-square lower than the next by this much: odds of 20 to 1."""

_LEAD = 2.0
"""Where no single fault leaves noise alone, the named one leaves at most this part of the next."""


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
    u : float, optional
        Standard uncertainty of `size` from the noise, in its unit; NaN for the turn.
    """

    probe: int
    fault: Literal["angle", "sensitivity", "turn"]
    size: float
    chi2: float
    u: float = math.nan

    def __str__(self) -> str:
        if self.fault == "turn":
            return "the part turns the other way: give turn with the opposite sign"
        if self.fault == "angle":
            size, u = math.degrees(self.size), math.degrees(self.u)
            return f"probe {self.probe} stands {size:+.4g} deg (u {u:.2g}) from its angle"
        size, u = 100.0 * self.size, 100.0 * self.u
        return f"probe {self.probe} reads {size:+.3g} % (u {u:.2g}) of its signal too much"


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
        The finding as a sentence.
    p : float, optional
        Probability that noise alone disagrees as much, as a whole or along one of the faults.
    """

    chi2: float
    freedom: int
    chi2_per_k: FloatArray
    suspects: tuple[Suspect, ...]
    named: Suspect | None
    message: str
    p: float = math.nan

    @property
    def agrees(self) -> bool:
        """Whether noise explains the disagreement: p is at least 0.002."""
        return self.p >= _CHANCE

    def __repr__(self) -> str:
        return (
            f"ProbeCheck(chi2 {self.chi2:.4g} of {self.freedom}, p {self.p:.2g}; {self.message})"
        )

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {
            "chi2 / freedom": f"{self.chi2:.4g} / {self.freedom}",
            "p": f"{self.p:.2g}",
            "finding": self.message,
        }
        rows.update({f"suspect {i + 1}": str(s) for i, s in enumerate(self.suspects[:4])})
        return html_table("Probe check", rows)


@described_by(multiprobe, errors=False)
def check_probes(
    m: Any,
    angles: ArrayLike,
    kmax: int,
    *,
    u_reading: float,
    turn: Literal[1, -1] = 1,
    angle: ArrayLike | None = None,
) -> ProbeCheck:
    """Return whether four or more probes agree, and which probe or angle is wrong if not.

    Parameters
    ----------
    m : array_like, shape (n, N) or (n, M, N), n > 3, m, or Recording, or sequence of Profile
        Readings as for `multiprobe`.
    angles : array_like, shape (n,), rad
        Where the probes are believed to stand.
    u_reading : float, m, > 0
        Standard deviation of one reading.

    Returns
    -------
    ProbeCheck
        ``.agrees``, ``.named``, ``.suspects``, ``.message``.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than four probes, or too few samples for kmax.
    DataError, InvalidSamplesError
        If `u_reading` is not above zero, or readings, angles, kmax or turn cannot be used.

    Notes
    -----
    A fault is linearised and then iterated, so angles wrong by some degrees are found as long as
    ``kmax`` times the error stays below about 1 rad. A common turn of all probes is invisible.

    ``p = 2 min(p_all, p_one)``: p_all of chi-square as a whole; p_one of the largest drop by one
    fault, a chi-square of one degree of freedom, times the number 2 n of faults tried (Bonferroni).
    Noise raises a false alarm in one check of 500 (p < 0.002). u of a suspect's size tells what can
    be found: an angle wrong by 4 u is found in half of the checks, by 6 u nearly always.
    With `u_reading` too small everything disagrees, and no fault is named unless it clearly leads.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> theta = 2 * np.pi * np.arange(256) / 256
    >>> true = np.deg2rad([0.0, 20.5, 270.5, 298.0])
    >>> m = [sum(np.cos(k * (theta + p) + k**2) for k in range(2, 20)) * 1e-8 for p in true]
    >>> m = m + 1e-10 * rng.standard_normal((4, 256))
    >>> print(check_probes(m, np.deg2rad([0.0, 20.5, 270.5, 297.0]), 20, u_reading=1e-10).message)
    probe 3 stands +1.002 deg (u 0.0023) from its angle
    """
    method = MultiprobeRoundness(angles, kmax, turn=turn)
    phi = np.array(method.angles)
    if phi.size < 4:
        raise TooFewSamplesError(
            f"three probes always agree; need >= 4 to find a fault, got {phi.size}"
        )
    u_reading = positive(u_reading, "u_reading", dimension="length")
    given = circle_readings(m, what="check_probes", angle=angle).values
    array = revolutions(given, phi.size, what="probes", n_min=2 * method.kmax + 1).values
    mean = harmonics_of(array, method.kmax).mean(axis=1)
    variance = 2.0 * u_reading**2 / (array.shape[1] * array.shape[2])
    faults = _Faults(phi, mean, method.kmax, turn, variance)
    geometry = faults.geometry(phi)
    per_k = faults.chi2(geometry)
    freedom = 2 * int(geometry.freedom.sum())
    chi2 = float(per_k.sum())
    share = np.full(per_k.size, np.nan)
    seen = geometry.freedom > 0
    share[seen] = per_k[seen] / (2.0 * geometry.freedom[seen])
    suspects = [
        find(i) for i in range(phi.size) for find in (faults.wrong_angle, faults.wrong_sensitivity)
    ]
    mirrored = replace(faults, turn=-turn)
    turned = float(mirrored.chi2(mirrored.geometry(phi)).sum())
    suspects.append(Suspect(-1, "turn", math.nan, turned))
    suspects.sort(key=lambda s: s.chi2)
    p = _chance(chi2, freedom, faults.drops(geometry) / variance)
    named, message = _verdict(chi2, freedom, suspects, p)
    return ProbeCheck(chi2, freedom, share, tuple(suspects), named, message, p)


@dataclass(frozen=True, slots=True)
class _Faults:
    """Mean harmonics of the probes, and what single faults explain of their disagreement."""

    phi: FloatArray  # rad: stated angles
    mean: ComplexArray  # shape (n, kmax + 1)
    kmax: int
    turn: int
    variance: float  # of a harmonic of one probe

    def geometry(self, angles: FloatArray) -> ProbeGeometry:
        """Return the estimators of probes at these angles."""
        return probe_geometry(angles, self.kmax, covariance=None, max_gain=50.0, turn=self.turn)

    def chi2(self, geometry: ProbeGeometry, mean: ComplexArray | None = None) -> FloatArray:
        """Return chi-square of each undulation."""
        rest = np.einsum("kij,jk->ki", geometry.residual, self.mean if mean is None else mean)
        out: FloatArray = np.sum(np.abs(rest) ** 2, axis=1) / self.variance
        return out

    def _fitted(self, geometry: ProbeGeometry, moved: ComplexArray) -> tuple[float, float]:
        """Return the real factor of `moved` that explains the residuals best, and its size^2."""
        rest = np.einsum("kij,jk->ki", geometry.residual, self.mean)
        shape = np.einsum("kij,jk->ki", geometry.residual, moved)
        size = float(np.sum(np.abs(shape) ** 2))
        return (float(np.sum((shape.conj() * rest).real)) / size if size > 0.0 else 0.0), size

    def _u(self, size2: float) -> float:
        return math.sqrt(self.variance / size2) if size2 > 0.0 else math.inf

    def _moved(self, i: int, angles: FloatArray, geometry: ProbeGeometry) -> ComplexArray:
        """Return how the readings change with the angle of probe i."""
        seen = np.einsum("pkn,nk->pk", geometry.rows, self.mean)
        r, x, y = np.where(np.isnan(seen), 0.0, seen)
        turning = 1j * self.turn * np.arange(self.mean.shape[1])
        moved = np.zeros_like(self.mean)
        moved[i] = turning * np.exp(turning * angles[i]) * r
        moved[i] += -math.sin(angles[i]) * x + math.cos(angles[i]) * y
        moved[:, :2] = 0.0
        return moved

    def wrong_angle(self, i: int) -> Suspect:
        """Gauss-Newton in the angle of one probe."""
        angles = self.phi.copy()
        limit = 1.0 / self.kmax
        best = (math.inf, 0.0, math.inf)
        for _ in range(12):
            geometry = self.geometry(angles)
            chi2 = float(self.chi2(geometry).sum())
            wanted, size2 = self._fitted(geometry, self._moved(i, angles, geometry))
            if chi2 < best[0]:
                best = (chi2, float(angles[i] - self.phi[i]), self._u(size2))
            step = float(np.clip(wanted, -limit, limit))
            angles[i] += step
            if abs(step) < 1e-10:
                break
        return Suspect(i, "angle", best[1], best[0], best[2])

    def wrong_sensitivity(self, i: int) -> Suspect:
        """Exact: readings of one probe times a factor are linear in the factor."""
        geometry = self.geometry(self.phi)
        moved = np.zeros_like(self.mean)
        moved[i] = -self.mean[i]
        wanted, size2 = self._fitted(geometry, moved)
        factor = 1.0 + wanted
        scaled = self.mean.copy()
        scaled[i] = factor * self.mean[i]
        chi2 = float(self.chi2(geometry, scaled).sum())
        if abs(factor) <= 1e-6:
            return Suspect(i, "sensitivity", math.inf, chi2, math.inf)
        return Suspect(i, "sensitivity", 1.0 / factor - 1.0, chi2, self._u(size2) / factor**2)

    def drops(self, geometry: ProbeGeometry) -> FloatArray:
        """Return what each fault takes off the squared residuals, to first order.

        The shape of a fault is made of what the probes agree on, so its noise is independent of
        the residuals, and each drop is a chi-square of one degree of freedom; an iterated one is
        more.
        """
        found = []
        for i in range(self.phi.size):
            wrong = np.zeros_like(self.mean)
            wrong[i] = self.mean[i]
            for moved in (self._moved(i, self.phi, geometry), wrong):
                factor, size2 = self._fitted(geometry, moved)
                found.append(factor**2 * size2)
        return np.array(found)


def _chance(chi2: float, freedom: int, drops: FloatArray) -> float:
    """Return the probability that noise disagrees as much, as a whole or along one fault."""
    from scipy import special

    whole = float(special.gammaincc(0.5 * freedom, 0.5 * chi2)) if freedom else 1.0
    one = drops.size * math.erfc(math.sqrt(0.5 * float(drops.max())))
    return min(1.0, 2.0 * min(whole, one))


def _too_good(chi2: float, freedom: int) -> str:
    from scipy import special

    if not freedom or float(special.gammainc(0.5 * freedom, 0.5 * chi2)) > _TOO_GOOD:
        return ""
    return (
        f"; they scatter by {math.sqrt(chi2 / freedom):.2g} u_reading only: state it smaller to see "
        "smaller faults"
    )


def _verdict(
    chi2: float, freedom: int, suspects: list[Suspect], p: float
) -> tuple[Suspect | None, str]:
    if p >= _CHANCE:
        return None, f"the probes agree within their noise{_too_good(chi2, freedom)}"
    best, second = suspects[0], suspects[1]
    left = max(freedom - 1, 1)
    explained = best.chi2 <= left + _EXCESS * math.sqrt(2.0 * left)
    clear = _CLEAR * max(1.0, best.chi2 / left)
    if (second.chi2 - best.chi2 > clear) if explained else (_LEAD * best.chi2 < second.chi2):
        return best, f"{best}{'' if explained else '; that explains most of it, not all'}"
    if (chi2 - best.chi2 > clear) if explained else (_LEAD * best.chi2 < chi2):
        return None, f"the probes disagree; either {best}, or {second}"
    return None, (
        "the probes disagree, and no wrong angle or sensitivity of a single probe explains it: "
        "look at noise, sampling angle, several faults"
    )
