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
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import TooFewSamplesError
from metrosep.core.inputs import Readings
from metrosep.core.numbers import positive
from metrosep.core.options import Option
from metrosep.core.profile import html_table
from metrosep.separation._methods import described_by
from metrosep.separation.circles._circle import (
    ProbeGeometry,
    circle_readings,
    harmonics_of,
    probe_geometry,
    revolutions,
)
from metrosep.separation.circles.probes import MultiprobeRoundness
from metrosep.separation.contract import NamedMethod, as_rows, over_turn

__all__ = ["ProbeCheck", "Suspect", "check_probes"]


class ProbesChecked(NamedMethod):
    """`check_probes` by its name."""

    name: ClassVar[str] = "check_probes"
    what: ClassVar[str] = (
        "whether four or more probes agree, and which angle or sensitivity is wrong if not"
    )
    over: ClassVar = "angle"
    arguments: ClassVar[Mapping[str, Option]] = {
        "angles": MultiprobeRoundness.fields["angles"],
        "kmax": Option("integer", required=True, help="highest undulation that is looked at"),
        "u_reading": Option("size", required=True, help="standard uncertainty of one reading"),
        "turn": MultiprobeRoundness.fields["turn"],
    }

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> ProbeCheck:
        """Return what the probes disagree by."""
        over_turn(data)
        return check_probes(as_rows(data.values), **options)


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
        The finding in words.
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


@described_by(MultiprobeRoundness)
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
    DataError
        If `u_reading` is not above zero, or kmax or turn is out of range.
    InvalidSamplesError
        If readings or angles cannot be used.

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
    p = _chance(chi2, freedom, _drops(phi, geometry, mean, turn) / variance)
    named, message = _verdict(chi2, freedom, suspects, p)
    return ProbeCheck(chi2, freedom, share, tuple(suspects), named, message, p)


def _geometry(phi: FloatArray, kmax: int, turn: int) -> ProbeGeometry:
    return probe_geometry(phi, kmax, covariance=None, max_gain=50.0, turn=turn)


def _chi2(geometry: ProbeGeometry, mean: ComplexArray, variance: float) -> FloatArray:
    rest = np.einsum("kij,jk->ki", geometry.residual, mean)
    out: FloatArray = np.sum(np.abs(rest) ** 2, axis=1) / variance
    return out


def _fitted(
    geometry: ProbeGeometry, mean: ComplexArray, moved: ComplexArray
) -> tuple[float, float]:
    """Return the real factor of `moved` (n, kmax + 1) that explains the residuals best, and size^2."""
    rest = np.einsum("kij,jk->ki", geometry.residual, mean)
    shape = np.einsum("kij,jk->ki", geometry.residual, moved)
    size = float(np.sum(np.abs(shape) ** 2))
    return (float(np.sum((shape.conj() * rest).real)) / size if size > 0.0 else 0.0), size


def _wrong_angle(
    i: int, phi: FloatArray, mean: ComplexArray, kmax: int, turn: int, variance: float
) -> Suspect:
    """Gauss-Newton in the angle of one probe."""
    angles = phi.copy()
    limit = 1.0 / kmax
    best = (math.inf, 0.0, math.inf)
    for _ in range(12):
        geometry = _geometry(angles, kmax, turn)
        chi2 = float(_chi2(geometry, mean, variance).sum())
        wanted, size2 = _fitted(geometry, mean, _moved(i, angles, geometry, mean, turn))
        if chi2 < best[0]:
            best = (chi2, float(angles[i] - phi[i]), _sd(size2, variance))
        step = float(np.clip(wanted, -limit, limit))
        angles[i] += step
        if abs(step) < 1e-10:
            break
    return Suspect(i, "angle", best[1], best[0], best[2])


def _sd(size2: float, variance: float) -> float:
    """Return the standard uncertainty of a factor."""
    return math.sqrt(variance / size2) if size2 > 0.0 else math.inf


def _moved(
    i: int, angles: FloatArray, geometry: ProbeGeometry, mean: ComplexArray, turn: int
) -> ComplexArray:
    """Return how the readings change with the angle of probe i."""
    seen = np.einsum("pkn,nk->pk", geometry.rows, mean)
    r, x, y = np.where(np.isnan(seen), 0.0, seen)
    k = np.arange(mean.shape[1])
    moved = np.zeros_like(mean)
    moved[i] = 1j * turn * k * np.exp(1j * turn * k * angles[i]) * r
    moved[i] += -math.sin(angles[i]) * x + math.cos(angles[i]) * y
    moved[:, :2] = 0.0
    return moved


def _wrong_sensitivity(
    i: int, phi: FloatArray, mean: ComplexArray, kmax: int, turn: int, variance: float
) -> Suspect:
    """Exact: readings of one probe times a factor are linear in the factor."""
    geometry = _geometry(phi, kmax, turn)
    moved = np.zeros_like(mean)
    moved[i] = -mean[i]
    wanted, size2 = _fitted(geometry, mean, moved)
    factor = 1.0 + wanted
    scaled = mean.copy()
    scaled[i] = factor * mean[i]
    chi2 = float(_chi2(geometry, scaled, variance).sum())
    if abs(factor) <= 1e-6:
        return Suspect(i, "sensitivity", math.inf, chi2, math.inf)
    return Suspect(i, "sensitivity", 1.0 / factor - 1.0, chi2, _sd(size2, variance) / factor**2)


def _drops(phi: FloatArray, geometry: ProbeGeometry, mean: ComplexArray, turn: int) -> FloatArray:
    """Return what each fault takes off the squared residuals, to first order at the stated angles.

    The shape of a fault is made of what the probes agree on, so its noise is independent of the
    residuals, and each drop is a chi-square of one degree of freedom; an iterated one is more.
    """
    found = []
    for i in range(phi.size):
        wrong = np.zeros_like(mean)
        wrong[i] = mean[i]
        for moved in (_moved(i, phi, geometry, mean, turn), wrong):
            factor, size2 = _fitted(geometry, mean, moved)
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
