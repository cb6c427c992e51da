"""Probe angles that magnify the noise least: search over arrangements of a multi-probe set-up.

The noise gain of undulation k is that of least squares with alike, independent probes: ``gain_k =
1 / |e_k - P e_k|``, e_k = exp(j k phi), P the projector on (cos phi, sin phi). For three probes it is
``sqrt(1 + c2^2 + c3^2) / |W_k|``. It cannot fall below ``1 / sqrt(n)``.

The search is random arrangements, then exchange of one probe at a time over a grid, then a fine
descent; seeded, so the same call gives the same angles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import choice, count, not_negative
from metrosep.core.options import Option
from metrosep.core.profile import html_table
from metrosep.separation.circles._circle import angle_tuple, probe_geometry

if TYPE_CHECKING:
    import pandas as pd

from metrosep.separation.contract import NamedMethod

_HIDDEN = 1e7
"""A gain that only rounding keeps finite: the angles hide the undulation."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ProbeAngles:
    """Chosen probe angles and how they magnify noise.

    Parameters
    ----------
    angles : ndarray, shape (n,), rad
        Rising from the first; given ones first where some were fixed.
    gain : float
        Root mean square noise gain over k = 2 ... kmax: sd of a harmonic of the artefact over sd
        of that harmonic of one reading.
    gain_per_k : ndarray, shape (kmax + 1,)
        Gain of each undulation from k = 0; inf for 0 and 1, which no angles show.
    worst_k : int
        Undulation of the largest gain from k = 2 on.
    robust_gain : float
        Gain averaged (root mean square) over angles that miss by `tolerance`; `gain` without.
    settings : mapping
        What was asked for, with unit suffixes.
    """

    angles: FloatArray
    gain: float
    gain_per_k: FloatArray
    worst_k: int
    robust_gain: float
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def worst_gain(self) -> float:
        """Gain of `worst_k`."""
        return float(self.gain_per_k[self.worst_k])

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: angles as ``angles_deg``, an infinite gain as None."""
        return {
            "angles_deg": np.rad2deg(self.angles).tolist(),
            "gain": _plain(self.gain),
            "gain_per_k": [_plain(g) for g in self.gain_per_k],
            "worst_k": self.worst_k,
            "worst_gain": _plain(self.worst_gain),
            "robust_gain": _plain(self.robust_gain),
            **self.settings,
        }

    def to_frame(self) -> pd.DataFrame:
        """Return the gain of each undulation from 2 on: ``k``, ``gain``."""
        import pandas as pd

        k = np.arange(2, self.gain_per_k.size)
        return pd.DataFrame({"k": k, "gain": self.gain_per_k[2:]})

    def _rows(self) -> dict[str, str]:
        return {
            "angles / deg": ", ".join(f"{a:.4g}" for a in np.rad2deg(self.angles)),
            "gain (RMS)": f"{self.gain:.4g}",
            "worst": f"{self.worst_gain:.3g} at k = {self.worst_k}",
            "averaged over the tolerance": f"{self.robust_gain:.4g}",
        }

    def __repr__(self) -> str:
        rows = self._rows()
        return (
            f"ProbeAngles({rows['angles / deg']} deg; gain {rows['gain (RMS)']}, "
            f"worst {rows['worst']})"
        )

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        return html_table("Probe angles", self._rows())


def optimise_probe_angles(
    n: int,
    kmax: int,
    *,
    min_separation: float = 0.0,
    fixed: ArrayLike = (),
    tolerance: float = 0.0,
    criterion: Literal["rms", "worst"] = "rms",
    resolution: float = math.pi / 3600.0,
    seed: int = 0,
) -> ProbeAngles:
    """Return probe angles of small noise gain over k = 2 ... kmax.

    Parameters
    ----------
    fixed : array_like, rad, optional
        Angles of probes that stand already; the others are chosen. The first probe stands at 0
        if none is given.

    Returns
    -------
    ProbeAngles
        ``.angles`` (rad), ``.gain``, ``.gain_per_k``, ``.worst_k``, ``.worst_gain``.

    Raises
    ------
    DataError
        If `n`, `kmax`, `resolution` or `tolerance` are out of range, or `fixed` leaves no probe
        to place.
    UnitError
        If an angle looks like degrees.
    NotSeparableError
        If no arrangement keeps `min_separation`.
    InvalidSamplesError
        If a fixed angle is not finite.

    Notes
    -----
    No global optimum is proven: the search starts at many random arrangements. The gain of any
    arrangement is at least ``1 / sqrt(n)``. Turning or mirroring an arrangement changes nothing.

    References
    ----------
    D. J. Whitehouse, J. Phys. E: Sci. Instrum. 9 (1976) 531-536: why angles matter (zeros of W_k).

    Examples
    --------
    >>> found = optimise_probe_angles(3, 30, min_separation=np.deg2rad(15))
    >>> found.gain < 1.2
    True
    """
    n_probes = count(n, "the number of probes n", least=3, most=24)
    kmax = count(kmax, "kmax", least=2)
    placed = np.array(angle_tuple(fixed, least=0, what="fixed probe"))
    min_separation = _small(min_separation, "min_separation", math.pi / 2.0)
    tolerance = _small(tolerance, "tolerance", 0.2)
    resolution = _small(resolution, "resolution", 0.1)
    if resolution == 0.0:
        raise DataError("resolution must be > 0 rad, got 0")
    choice(criterion, "criterion", ("rms", "worst"))
    _check_fixed(placed, n_probes, min_separation)
    seed = count(seed, "seed", least=0)
    rng = np.random.default_rng(seed)
    draws = (
        tolerance * rng.standard_normal((16, n_probes)) if tolerance else np.empty((0, n_probes))
    )
    given = placed if placed.size else np.zeros(1)
    search = _Search(n_probes, kmax, given, min_separation, resolution, draws, criterion)
    found = search.best(rng)
    if found is None:
        raise NotSeparableError(
            f"no arrangement of {n_probes} probes keeps {math.degrees(min_separation):.4g} degrees "
            "between all of them; use slimmer or fewer probes"
        )
    angles, starts = found
    free = np.sort(np.mod(angles[given.size :], 2.0 * np.pi))
    angles = np.concatenate([given, free])
    per_k = probe_gain(angles, kmax)
    gain = math.sqrt(float(np.mean(per_k[2:] ** 2)))
    met = gain_table(angles[:, np.newaxis] + draws.T, kmax)
    return ProbeAngles(
        angles,
        gain,
        per_k,
        2 + int(np.argmax(per_k[2:])),
        math.sqrt(float(np.mean(met**2))) if tolerance else gain,
        {
            "kmax": kmax,
            "min_separation_deg": math.degrees(min_separation),
            "tolerance_deg": math.degrees(tolerance),
            "criterion": criterion,
            "n_fixed": int(placed.size),
            "n_starts": starts,
            "seed": seed,
        },
    )


class ProbesChosen(NamedMethod):
    """`optimise_probe_angles` by its name; the table holds the probes that stand already."""

    name = "optimise_probe_angles"
    what = "angles of further probes of least noise; the table holds those that stand"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {"angle": "angle"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "n": Option("integer", required=True, help="number of probes, with those that stand"),
        "kmax": Option("integer", required=True, help="highest undulation that must become known"),
        "min_separation": Option(
            "angle", help="least angle between two probes, at most pi/2: what their bodies need"
        ),
        "tolerance": Option(
            "angle",
            help="standard deviation with which angles are met; the gain is averaged over such misses,"
            " so an arrangement that needs exact angles loses",
        ),
        "criterion": Option(
            "text",
            choices=("rms", "worst"),
            help="noise gain over all undulations, or at its worst",
        ),
        "resolution": Option("angle", help="finest step of the search; 0.05 degrees if omitted"),
        "seed": Option("integer", help="of the starts; the same seed gives the same angles"),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> ProbeAngles:
        """Return the angles of all probes, those of the table first."""
        rest = dict(options)
        return optimise_probe_angles(
            rest.pop("n"), rest.pop("kmax"), fixed=data.values["angle"], **rest
        )


def probe_gain(angles: ArrayLike, kmax: int) -> FloatArray:
    """Return the noise gain of each undulation for alike, independent probes.

    Parameters
    ----------
    angles : array_like, shape (n,), n >= 3, rad
        Where the probes stand.
    kmax : int
        Highest undulation per revolution, >= 2.

    Returns
    -------
    ndarray, shape (kmax + 1,)
        From k = 0; inf for 0 and 1 and for suppressed undulations.

    Raises
    ------
    TooFewSamplesError, InvalidSamplesError
        If there are fewer than 3 angles or they are not finite.
    UnitError
        If the angles look like degrees.
    DataError
        If kmax is below 2.
    NotSeparableError
        If the probes stand on one line.

    Notes
    -----
    Least squares for n > 3; ``sqrt(1 + c2^2 + c3^2) / |W_k|`` for n = 3. Where the angles hide an
    undulation its gain is infinite.

    Examples
    --------
    >>> gain = probe_gain(np.deg2rad([0, 45, 135]), 9)
    >>> [int(k) for k in np.flatnonzero(np.isinf(gain))]
    [0, 1, 7, 9]
    """
    geometry = probe_geometry(
        np.array(angle_tuple(angles, least=3, what="probe")),
        count(kmax, "kmax", least=2),
        covariance=None,
        max_gain=_HIDDEN,
        turn=1,
    )
    out: FloatArray = geometry.gain[0]
    return out


def _plain(gain: float) -> float | None:
    return float(gain) if math.isfinite(gain) else None


def _small(value: float, name: str, most: float) -> float:
    """Return an angle from zero in rad, refused where it can only be degrees."""
    angle = not_negative(value, name, dimension="angle")
    if angle > most * (1.0 + 1e-9):
        raise UnitError(
            f"{name} of {angle:.6g} rad is above {most:.4g}; degrees? give numpy.deg2rad"
        )
    return angle


def _check_fixed(fixed: FloatArray, n: int, min_separation: float) -> None:
    """Refuse fixed probes that leave none to place, or stand too close together."""
    if fixed.size >= n:
        raise DataError(
            f"{fixed.size} of {n} probes are fixed, so none is to be placed; use probe_gain for "
            "the gain of an arrangement"
        )
    if fixed.size > 1 and separations(fixed) < min_separation - 1e-9:
        raise NotSeparableError(
            f"two fixed probes stand {math.degrees(separations(fixed)):.4g} degrees apart, less "
            f"than min_separation = {math.degrees(min_separation):.4g} degrees"
        )


# ---- search of probe angles: the gain from power sums, exchange over a grid, descent in fine steps ----
# With ``S_m = sum_i exp(j m phi_i)`` the squared length of what cos and sin leave of exp(j k phi) is
# ``n - (n (|S_{k-1}|^2 + |S_{k+1}|^2) - 2 Re(conj(S_{k-1} S_2) S_{k+1})) / (n^2 - |S_2|^2)``, so one
# probe is exchanged by one addition to the sums.

Criterion = Literal["rms", "worst"]

_WORK = 8e7
"""Complex additions of the grid search: one or two seconds on one core."""

_BLOCK = 16384
"""Complex numbers of a block of places."""

_STARTS = 100
_FEWEST = 3
"""Starts where each is dear: with many probes all good arrangements are nearly alike."""

_SWEEPS = 4
_FINALISTS = 8
_TINY = 1e-9
_COLLINEAR = 1e-6
"""Share of n^2 below which the probes stand on one line and see one direction only."""


def gain_table(angles: FloatArray, kmax: int) -> FloatArray:
    """Return gains (kmax - 1, ...) of k = 2 ... kmax for angles (n, ...)."""
    m = np.arange(kmax + 2).reshape(-1, *([1] * angles.ndim))
    return _gain(np.exp(1j * m * angles).sum(axis=1), angles.shape[0])


def separations(angles: FloatArray) -> float:
    """Return the smallest distance round the circle between two angles, in rad."""
    ordered = np.sort(np.mod(angles, 2.0 * np.pi))
    return float(
        min([b - a for a, b in pairwise(ordered)] + [2 * np.pi + ordered[0] - ordered[-1]])
    )


def _gain(sums: ComplexArray, n: int) -> FloatArray:
    square = sums.real**2 + sums.imag**2
    product = sums[1:-2].conj() * sums[3:]
    second = sums[2]
    cross = 2.0 * (product.real * second.real + product.imag * second.imag)
    power = n * (square[1:-2] + square[3:])
    spread = n**2 - square[2]
    left = n - (power - cross) / np.maximum(spread, _TINY)
    left = np.where(spread > _COLLINEAR * n**2, left, 0.0)
    out: FloatArray = 1.0 / np.sqrt(np.maximum(left, _TINY))
    return out


@dataclass(frozen=True, slots=True)
class _Search:
    """A search of n angles, the fixed ones first."""

    n: int
    kmax: int
    fixed: FloatArray
    min_separation: float
    resolution: float
    draws: FloatArray  # shape (n_draws, n): errors of the angles over which the gain is averaged
    criterion: Criterion

    @property
    def grid(self) -> FloatArray:
        """Places of the exchange."""
        size = 360 * (2 if self.kmax <= 100 else 4)
        return 2.0 * np.pi * np.arange(size) / size

    def best(self, rng: np.random.Generator) -> tuple[FloatArray, int] | None:
        """Return the best angles found and the number of starts; None where nothing fits."""
        if self.n * self.min_separation > 2.0 * np.pi + _TINY:
            return None
        grid = self.grid
        table = np.exp(1j * np.outer(np.arange(self.kmax + 2), grid))
        work = (self.n - self.fixed.size) * _SWEEPS * table.size
        starts = min(max(_FEWEST, int(_WORK / work)), _STARTS)
        thin = math.ceil(_FEWEST * work / _WORK)
        found: list[tuple[float, FloatArray]] = []
        for _ in range(starts):
            start = self._random_start(grid, rng)
            if start is None:
                return None
            found.append(self._exchange(start, grid, table, thin))
        found.sort(key=lambda item: item[0])
        distinct: list[tuple[float, FloatArray]] = []
        for value, angles in found:
            if len(distinct) < _FINALISTS and all(abs(value - v) > 1e-6 for v, _ in distinct):
                distinct.append((value, angles))
        polished = [self._descend(angles, float(grid[1])) for _, angles in distinct]
        return min(polished, key=lambda item: item[0])[1], starts

    def _random_start(self, grid: FloatArray, rng: np.random.Generator) -> FloatArray | None:
        """Return angles drawn one by one where there is room left; None after some dead ends."""
        for attempt in range(50):
            angles = self.fixed.copy()
            while angles.size < self.n:
                room = grid[self._allowed(grid, angles)]
                if room.size == 0:
                    break
                # later attempts pack tightly, which fits whenever anything does on a free circle
                pick = room[0] if attempt >= 40 else rng.choice(room)
                angles = np.append(angles, pick)
            if angles.size == self.n:
                return angles
        return None

    def _allowed(self, grid: FloatArray, others: FloatArray) -> NDArray[np.bool_]:
        distance = np.abs((grid[:, np.newaxis] - others + np.pi) % (2.0 * np.pi) - np.pi)
        return np.asarray(np.all(distance >= self.min_separation - 1e-9, axis=1))

    def _exchange(
        self, angles: FloatArray, grid: FloatArray, table: ComplexArray, thin: int
    ) -> tuple[float, FloatArray]:
        """Move one probe after the other to the best place of the grid until none wants to move.

        Where the grid is dear, each probe tries every `thin`-th place only, from another first one.
        """
        m = np.arange(table.shape[0])
        best = math.inf
        for _ in range(_SWEEPS):
            before = best
            for i in range(self.fixed.size, self.n):
                others = np.delete(angles, i)
                places = np.flatnonzero(self._allowed(grid, others))
                if places.size > thin:
                    places = places[i % thin :: thin]
                if places.size == 0:
                    continue
                rest = np.exp(1j * np.outer(m, others)).sum(axis=1)
                scores = self._scores(rest, table, places)
                j = int(np.argmin(scores))
                if scores[j] < best:
                    best = float(scores[j])
                    angles = angles.copy()
                    angles[i] = grid[places[j]]
            if best >= before * (1.0 - 1e-6):
                break
        return best, angles

    def _scores(
        self, rest: ComplexArray, table: ComplexArray, places: NDArray[np.intp]
    ) -> FloatArray:
        """Return the score with one more probe at each place, in blocks that stay in the cache."""
        width = max(1, _BLOCK // rest.size)
        out = np.empty(places.size)
        for i in range(0, places.size, width):
            some = slice(i, i + width)
            gain = _gain(rest[:, np.newaxis] + table[:, places[some]], self.n)
            worst = self.criterion == "worst"
            out[some] = gain.max(axis=0) if worst else np.sqrt(np.mean(gain**2, axis=0))
        return out

    def _score(self, angles: FloatArray) -> float:
        """Return the score of angles, averaged over their errors."""
        errors = self.draws.T if self.draws.size else 0.0
        gain = gain_table(angles[:, np.newaxis] + errors, self.kmax)
        if self.criterion == "worst":
            return float(gain.max(axis=0).mean())
        return math.sqrt(float(np.mean(gain**2)))

    def _descend(self, angles: FloatArray, coarse: float) -> tuple[float, FloatArray]:
        """Move free probes by steps of the resolution as long as the score falls."""
        best = self._score(angles)
        steps = max(1, round(coarse / self.resolution))
        while steps >= 1:
            moved = False
            for i in range(self.fixed.size, angles.size):
                for sign in (1.0, -1.0):
                    trial = angles.copy()
                    trial[i] += sign * steps * self.resolution
                    if separations(trial) < self.min_separation - 1e-9:
                        continue
                    value = self._score(trial)
                    if value < best * (1.0 - 1e-9):
                        best, angles, moved = value, trial, True
            if not moved:
                steps //= 2
        return best, angles
