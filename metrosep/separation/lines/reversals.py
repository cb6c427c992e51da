"""Reversals: artefact and machine from set-ups in which one of them changes its sign.

Straightedge reversal and Donaldson's roundness reversal are one algebra: ``m1 = A + M`` and
``m2 = A - M`` give ``A = (m1 + m2)/2`` and ``M = (m1 - m2)/2``. What the alignment of each set-up
decides (line, offset, eccentricity) belongs to neither and is removed. Only what repeats is
separated; the scatter of the repeats is the uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._readings import (
    average_repeats,
    checked_readings,
    curves,
    given_parts,
    left_share,
    line_basis,
    require_common,
    size_doubts,
    stacked,
    without_basis,
)
from metrosep.separation.contract import U_READING, Separation, SeparationMethod, Unobservable
from metrosep.spectral.dft import real_number

__all__ = ["StraightedgeReversal", "straightedge_reversal"]


_LINE = "line and offset are the alignment of each set-up; measure them against another reference"


@dataclass(frozen=True, slots=True)
class StraightedgeReversal(SeparationMethod):
    """Reversal of a straightedge against a slide.

    Reading 1: ``m1 = T + S``. For reading 2 the edge is turned about its long axis and the probe
    set to its other side: ``m2 = T - S``, at the same positions of the edge.

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

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the two readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n,), m
            ``artefact``: deviation of the edge, towards the probe of reading 1.
        errors : mapping of str to array_like, shape (n,), m
            ``machine``: straightness error of the slide, in the same sense.

        Returns
        -------
        ndarray, shape (2, n), m
            m1, m2.

        Raises
        ------
        DataError
            If a part is unknown or none is given.
        """
        return simulated_pair(self, truth, errors)

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return offset and slope of both parts.

        Returns
        -------
        tuple of Unobservable
            Polynomial degrees 0 and 1.
        """
        return tuple(Unobservable(p, "polynomial", (0, 1), _LINE) for p in ("artefact", "machine"))

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return straightedge and machine.

        Parameters
        ----------
        readings : array_like, shape (2, n) or (2, M, n), m
            m1 and m2 at the same positions, or M passes of each.
        u_reading : float, m, optional
            Standard uncertainty of one reading; the scatter of the passes if omitted.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts ``artefact`` and ``machine``, least-squares line removed from each.

        Raises
        ------
        InvalidSamplesError, TooFewSamplesError
            If the readings are no two curves of at least 4 samples.
        NotSeparableError
            If too few positions were measured in both set-ups.
        DataError
            If `u_reading` or `u_registration` is negative, `u_registration` comes without `x`, or
            `x` has another length.
        """
        u_registration = real_number(
            self.u_registration, "u_registration", "a standard uncertainty in m"
        )
        if not (np.isfinite(u_registration) and u_registration >= 0.0):
            raise DataError(
                f"u_registration is {u_registration}; it is a standard uncertainty in m, >= 0"
            )
        if self.u_registration > 0.0 and self.x is None:
            raise DataError("u_registration is a length: it needs the positions x in m")
        array = checked_readings(readings, names=("m1", "m2"), minimum=4, what=self.name)
        x = _positions(self.x, array.shape[2])
        result = reverse_pair(self, array, line_basis(x), {"x": x}, "machine", u_reading)
        u_shift = _shift_uncertainty(result.parts["artefact"], x, self.u_registration / 2.0)
        return with_type_b_curve(
            result,
            u_shift,
            {"u_registration_mm": self.u_registration * 1e3},
            history=(*history, Step(self.name, {"u_registration_m": self.u_registration})),
        )


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
    u_reading : float, m, optional
        Standard uncertainty of one reading; the scatter of the passes if omitted.
    u_registration : float, m, optional
        Standard uncertainty of the position of the edge in the second set-up.

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


def simulated_pair(
    method: SeparationMethod, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
) -> FloatArray:
    """Return ``A + M`` and ``A - M`` of given parts."""
    part, machine = given_parts(
        method.name,
        truth,
        errors,
        truth_parts=method.truth_parts,
        error_parts=method.error_parts,
    ).values()
    return np.stack([part + machine, part - machine])


def reverse_pair(
    method: SeparationMethod,
    array: FloatArray,
    basis: FloatArray,
    coordinates: Mapping[str, FloatArray],
    machine: str,
    u_reading: float | None,
) -> Separation:
    """Return half the sum and half the difference of two readings, a basis removed from each."""
    averaged = average_repeats(array, basis, u_reading=u_reading)
    m1, m2 = averaged.mean
    valid = ~np.isnan(m1 + m2)
    require_common(valid, basis, method.name)
    parts = {
        "artefact": without_basis((m1 + m2) / 2.0, basis),
        machine: without_basis((m1 - m2) / 2.0, basis),
    }
    share = left_share(valid, basis)
    with np.errstate(divide="ignore"):
        variance = averaged.noise.value**2 / 4.0 * (1.0 / averaged.counts).sum(axis=0)
    u = np.sqrt(np.where(valid, variance, np.nan) * share)
    return Separation(
        method.name,
        parts,
        dict.fromkeys(parts, u),
        dict.fromkeys(parts, "m"),
        coordinates,
        method.null_space(),
        noise=averaged.noise,
        audit={
            "n_repeats": averaged.n_repeats,
            "n_samples": int(array.shape[2]),
            "n_not_measured": int(array.shape[2] - valid.sum()),
            "removed": "least squares: offset and "
            + ("eccentricity" if machine == "spindle" else "line"),
        },
        messages=(*averaged.messages, *size_doubts(array, method.name)),
    )


def _shift_uncertainty(values: FloatArray, x: FloatArray, u: float) -> FloatArray:
    """Return |dT/dx| u; where a neighbour is missing, the steepest slope stands for it."""
    if u == 0.0:
        return np.zeros(values.size)
    slope = np.abs(np.gradient(values, x))
    if np.isnan(slope).all():
        raise DataError("the slope of the edge cannot be found: no three neighbours were measured")
    return np.array(np.where(np.isnan(slope), np.nanmax(slope), slope) * u)


def with_type_b_curve(
    result: Separation,
    u_more: FloatArray,
    audit: Mapping[str, object],
    *,
    history: tuple[Step, ...],
    more_messages: tuple[str, ...] = (),
    harmonics: tuple[Mapping[str, NDArray[np.complex128]], Mapping[str, FloatArray]] = ({}, {}),
) -> Separation:
    """Return a result with a further uncertainty, sample by sample, and more to say."""
    return Separation(
        result.method,
        result.parts,
        {k: np.sqrt(v**2 + u_more**2) for k, v in result.u.items()},
        result.units,
        result.coordinates,
        result.null_space,
        noise=result.noise,
        harmonics=harmonics[0],
        harmonics_u=harmonics[1],
        audit={**result.audit, **audit},
        messages=(*result.messages, *more_messages),
        history=history,
    )


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
