"""Reversals: artefact and machine from set-ups in which one of them changes its sign.

Straightedge reversal and Donaldson's roundness reversal are one algebra: ``m1 = A + M`` and
``m2 = A - M`` give ``A = (m1 + m2)/2`` and ``M = (m1 - m2)/2``. What the alignment of each set-up
decides (line, offset, eccentricity) belongs to neither and is removed. Only what repeats is
separated; the scatter of the repeats is the uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.numbers import not_negative
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._methods import History, Parts, RecordedMethod, described_by
from metrosep.separation._readings import (
    Averaged,
    average_repeats,
    checked_readings,
    curves,
    given_parts,
    left_share,
    line_basis,
    require_common,
    stacked,
    unit_message,
    without_basis,
)
from metrosep.separation.contract import U_READING, Separation, Unobservable

__all__ = ["StraightedgeReversal", "straightedge_reversal"]


def combined(
    method: RecordedMethod,
    array: FloatArray,
    weights: Mapping[str, FloatArray],
    bases: Mapping[str, FloatArray],
    stated: float | None,
) -> tuple[Averaged, dict[str, FloatArray], dict[str, FloatArray]]:
    """Return means over repeats, parts ``w @ mean`` without their basis, and their uncertainty.

    The widest basis, that of the artefact, is what may differ from repeat to repeat.
    """
    averaged = average_repeats(array, bases["artefact"], u_reading=stated)
    parts, u = {}, {}
    for name, w in weights.items():
        used, basis = w != 0.0, bases[name]
        curve = w[used] @ averaged.mean[used]
        valid = ~np.isnan(curve)
        require_common(valid, basis, method.name)
        parts[name] = without_basis(curve, basis)
        with np.errstate(divide="ignore"):
            spread = (w[used] ** 2) @ (1.0 / averaged.counts[used])
        variance = np.where(valid, averaged.noise.value**2 * spread, np.nan)
        u[name] = np.sqrt(variance * left_share(valid, basis))
    return averaged, parts, u


class ReversedPair(RecordedMethod):
    """Two readings ``A + M`` and ``A - M``; methods say what alignment takes from each."""

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        part, machine = given_parts(
            self.name, truth, errors, truth_parts=self.truth_parts, error_parts=self.error_parts
        ).values()
        return np.stack([part + machine, part - machine])

    @property
    def _weights(self) -> dict[str, FloatArray]:
        """Half the sum is the artefact, half the difference the machine."""
        artefact, machine = *self.truth_parts, *self.error_parts
        return {artefact: np.array([0.5, 0.5]), machine: np.array([0.5, -0.5])}

    def _halves(
        self, array: FloatArray, basis: FloatArray, stated: float | None, **at: FloatArray
    ) -> Separation:
        """Return both parts over their coordinate, a basis removed from each."""
        weights = self._weights
        averaged, parts, u = combined(self, array, weights, dict.fromkeys(weights, basis), stated)
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, "m"),
            at,
            self.null_space(),
            noise=averaged.noise,
            audit={
                "n_repeats": averaged.n_repeats,
                "n_samples": int(array.shape[2]),
                "n_not_measured": int(np.isnan(averaged.mean).any(axis=0).sum()),
                "removed": "least squares: offset and "
                + ("eccentricity" if "angle" in at else "line"),
            },
            messages=(*averaged.messages, *unit_message(array, self.name)),
        )


_LINE = "line and offset are the alignment of each set-up; measure them against another reference"


@dataclass(frozen=True, slots=True)
class StraightedgeReversal(ReversedPair):
    """Reversal of a straightedge against a slide.

    Reading 1: ``m1 = T + S``. For reading 2 the edge is turned about its long axis and the probe
    set to its other side: ``m2 = T - S``, at the same positions of the edge.

    Readings: m1 and m2 (2, n) in m, or M passes of each. Parts: ``artefact``, deviation of the edge
    towards the probe of reading 1; ``machine``, straightness error of the slide in the same sense.

    Parameters
    ----------
    u_registration : float, m, optional
        Standard uncertainty of the position of the edge in set-up 2. It adds
        ``u_registration |T'| / 2`` to the uncertainty of both parts.
    x : tuple of float or None, optional
        Positions in m; equal steps, of a length that does not matter, if omitted.
    """

    u_registration: float = option(
        0.0,
        kind="uncertainty",
        help="standard uncertainty of the position of the edge in the second set-up",
    )
    x: tuple[float, ...] | None = None

    name: ClassVar[str] = "straightedge_reversal"
    what: ClassVar[str] = "form of a straightedge and straightness of a slide, by reversal"
    readings: ClassVar[tuple[str, ...]] = ("m1", "m2")
    over: ClassVar = "x"
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact",)
    error_parts: ClassVar[tuple[str, ...]] = ("machine",)

    def null_space(self) -> tuple[Unobservable, ...]:
        return tuple(Unobservable(p, "polynomial", (0, 1), _LINE) for p in ("artefact", "machine"))

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        u_registration = not_negative(self.u_registration, "u_registration", dimension="length")
        if u_registration > 0.0 and self.x is None:
            raise DataError("u_registration is a length: it needs the positions x in m")
        array = checked_readings(readings, names=("m1", "m2"), minimum=4, what=self.name)
        x = _positions(self.x, array.shape[2])
        result = self._halves(array, line_basis(x), stated, x=x)
        u_shift = _shift_uncertainty(result.parts["artefact"], x, u_registration / 2.0)
        return replace(
            result,
            u={name: np.sqrt(u**2 + u_shift**2) for name, u in result.u.items()},
            audit={**result.audit, "u_registration_mm": u_registration * 1e3},
            history=(*history, Step(self.name, {"u_registration_m": u_registration})),
        )


@described_by(StraightedgeReversal, StraightedgeReversal.separate)
def straightedge_reversal(
    m1: ArrayLike | Profile,
    m2: ArrayLike | Profile,
    *,
    x: ArrayLike | None = None,
    u_reading: float | None = None,
    u_registration: float = 0.0,
) -> Separation:
    """Return form of a straightedge and straightness of a slide from a reversal.

    Parameters
    ----------
    m1, m2 : array_like, shape (n,) or (M, n), m, or Profile
        Readings before and after the edge was turned about its long axis and the probe set to
        its other side, at the same positions of the edge; or M passes of each.
    x : array_like, shape (n,), m, optional
        Positions, if the readings are arrays; equal steps if omitted.

    Returns
    -------
    Separation
        ``.artefact`` (the edge), ``.machine`` (the slide), least-squares line removed.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If the readings have different lengths or positions, fewer than 4 samples, or are not
        finite.

    Notes
    -----
    ``T = (m1 + m2)/2``, ``S = (m1 - m2)/2``; white noise s of one reading gives ``s / sqrt(2 M)``.
    A shift d of the edge between the set-ups adds ``d T'/2`` to both. Gravity does not reverse:
    in a set-up that measures vertically the sag of the edge stays in the machine.

    References
    ----------
    C. J. Evans, R. J. Hocken, W. T. Estler, Self-calibration: reversal, redundancy, error
    separation, and 'absolute testing', CIRP Annals 45 (1996) 617-634, section 2.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0, 0.3, 31)
    >>> edge, slide = 40e-9 * np.sin(40 * x), 1e-6 * (x - 0.15) ** 2
    >>> result = straightedge_reversal(edge + slide, edge - slide, x=x)
    >>> line = np.polyval(np.polyfit(x, slide, 1), x)
    >>> bool(abs(result.machine - (slide - line)).max() < 1e-20)
    True
    """
    readings, positions, history = curves((m1, m2), what="straightedge_reversal", axis="x")
    if positions is None and x is not None:
        positions = np.asarray(x, dtype=np.float64)
    elif x is not None:
        raise DataError("straightedge_reversal: profiles bring their positions, leave out x")
    method = StraightedgeReversal(
        u_registration, None if positions is None else tuple(positions.ravel().tolist())
    )
    array = stacked(readings, method.name)
    return method.separate(array, u_reading=u_reading, history=history)


def _shift_uncertainty(values: FloatArray, x: FloatArray, u: float) -> FloatArray:
    """Return |dT/dx| u; where a neighbour is missing, the steepest slope stands for it."""
    if u == 0.0:
        return np.zeros(values.size)
    slope = np.abs(np.gradient(values, x))
    if np.isnan(slope).all():
        raise DataError("the slope of the edge cannot be found: no three neighbours were measured")
    return np.array(np.where(np.isnan(slope), np.nanmax(slope), slope) * u)


def _positions(x: tuple[float, ...] | None, n: int) -> FloatArray:
    if x is None:
        return np.arange(n, dtype=np.float64)
    positions = np.array(x, dtype=np.float64)
    if positions.size != n:
        raise DataError(f"there are {positions.size} positions for {n} samples")
    steps = np.diff(positions)
    if not np.isfinite(positions).all() or not ((steps > 0).all() or (steps < 0).all()):
        raise InvalidSamplesError("positions must be finite and strictly rising or falling")
    return positions
