"""Donaldson's reversal: roundness of an artefact and radial error motion of a spindle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.methods import Readings
from metrosep.core.numbers import between, count, positive, real
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._readings import (
    checked_readings,
    curves,
    first_angle,
    gap_message,
    given_parts,
    harmonics_of,
    harmonics_u,
    low_harmonics,
    stacked,
    unit_message,
    without_basis,
)
from metrosep.separation.circles._circle import curve, grid, names_of_k
from metrosep.separation.contract import (
    U_READING,
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
    over_turn,
    settle,
    suppressed_harmonics,
)
from metrosep.separation.lines.reversals import ReversedPair, combined

_CENTRING = "the mean and the eccentricity are the centring of each set-up, not form"


@dataclass(frozen=True, slots=True)
class DonaldsonReversal(ReversedPair):
    """Radial reversal of a roundness artefact on a spindle.

    Reading 1: ``m1 = P + S``. For reading 2 the artefact and the probe are both turned by half a
    revolution about the spindle axis: ``m2 = P - S``, over the same angle of the artefact.

    Readings: m1 and m2 (2, n) in m over equal angles of one revolution, or M revolutions of each.
    Parts: ``artefact``, radius deviation; ``spindle``, radial error motion towards the probe of
    reading 1.

    Parameters
    ----------
    u_index : float, rad, optional
        Standard uncertainty of the half turn of the artefact against the spindle. It adds
        ``u_index |P'| / 2`` to the uncertainty of both parts.
    start : float, rad, optional
        Angle of the first sample.
    """

    u_index: float = option(
        0.0, kind="angle", help="standard uncertainty of the half turn of the artefact"
    )
    start: float = 0.0

    name = "donaldson"
    what = "roundness of an artefact and radial error motion of a spindle, by reversal"
    readings = ("m1", "m2")
    over = "angle"
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = ("artefact",)
    error_parts = ("spindle",)

    def null_space(self) -> tuple[Unobservable, ...]:
        terms = ("offset", "eccentricity")
        return tuple(Unobservable(p, "term", terms, _CENTRING) for p in ("artefact", "spindle"))

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        u_index = between(
            self.u_index,
            "u_index",
            0.0,
            _LARGEST_INDEX,
            dimension="angle",
            why="0.1 deg is 1.7e-3",
        )
        start = real(self.start, "start", dimension="angle")
        array = checked_readings(readings, names=("m1", "m2"), minimum=8, what=self.name)
        angle = start + grid(array.shape[2])
        result = self._halves(array, low_harmonics(angle), stated, angle=angle)
        hidden = dict.fromkeys(result.parts, (0, 1))
        harmonics, spread = _harmonics(array, result, self._weights, start, hidden)
        # an index off by u turns P: dP/dangle of the harmonics that stand out of the noise
        c, k = harmonics["artefact"], np.arange(harmonics["artefact"].size)
        known = np.where(np.isfinite(c), c, 0.0)
        clear = np.isfinite(c) & ~(np.abs(known) < 3.0 * spread["artefact"])
        slope = np.where(clear, 1j * k * known, 0.0)
        turned = np.abs(slope) * u_index / 2.0 / np.sqrt(2.0)
        along = np.abs(np.real(np.exp(1j * np.outer(angle, k)) @ slope)) * u_index / 2.0
        return replace(
            result,
            u={name: np.sqrt(u**2 + along**2) for name, u in result.u.items()},
            harmonics=harmonics,
            harmonics_u={name: np.sqrt(u**2 + turned**2) for name, u in spread.items()},
            audit={**result.audit, "u_index_rad": u_index},
            messages=(
                *result.messages,
                *gap_message(result.parts["artefact"]),
                *_set_up_messages(array),
            ),
            history=(*history, Step(self.name, {"u_index_rad": u_index})),
        )


@described_by(DonaldsonReversal, DonaldsonReversal.separate)
def donaldson(
    m1: ArrayLike | Profile,
    m2: ArrayLike | Profile,
    *,
    angle: ArrayLike | None = None,
    u_reading: float | None = None,
    u_index: float = 0.0,
) -> Separation:
    """Return roundness of an artefact and radial error motion of a spindle from a reversal.

    Parameters
    ----------
    m1, m2 : array_like, shape (n,) or (M, n), m, or Profile over the angle in rad
        Readings before and after artefact and probe were turned by half a revolution, both over
        the same 8 or more angles of the artefact, equally spaced over one revolution; or M
        revolutions.
    angle : array_like, shape (n,), rad, optional
        Angles of the samples, if the readings are arrays; from 0 if omitted.

    Returns
    -------
    Separation
        ``.artefact``, ``.spindle``: offset and eccentricity (k = 0, 1) removed; ``.harmonics``.

    Notes
    -----
    ``P = (m1 + m2)/2``, ``S = (m1 - m2)/2``, exact for k >= 2. White noise of one reading s gives
    ``s / sqrt(2 M)`` for each. Only the synchronous part of the error motion is found. A sample
    that is NaN in one reading is NaN in both parts.

    References
    ----------
    R. R. Donaldson, A simple method for separating spindle error from test ball roundness error,
    CIRP Annals 21 (1972) 125-126.

    Examples
    --------
    >>> import numpy as np
    >>> a = 2 * np.pi * np.arange(360) / 360
    >>> part, spindle = 50e-9 * np.cos(3 * a), 20e-9 * np.sin(2 * a)
    >>> result = donaldson(part + spindle, part - spindle)
    >>> bool(abs(result.spindle - spindle).max() < 1e-20)
    True
    """
    array, start, history = _turns((m1, m2), angle, "donaldson")
    return DonaldsonReversal(u_index, start).separate(array, u_reading=u_reading, history=history)


def _harmonics(
    array: FloatArray,
    result: Separation,
    weights: Mapping[str, FloatArray],
    start: float,
    hidden: Mapping[str, tuple[int, ...]],
) -> tuple[dict[str, ComplexArray], dict[str, FloatArray]]:
    """Return the harmonics of the parts but for the hidden ones, and their type A uncertainty."""
    harmonics, spread = {}, {}
    for name, values in result.parts.items():
        c = harmonics[name] = harmonics_of(values, start=start, hidden=hidden[name])
        u = harmonics_u(array, weights[name], result.noise.value)
        spread[name] = np.where(np.isfinite(c), u, np.nan)
    return harmonics, spread


def _turns(
    items: Sequence[ArrayLike | Profile], angle: ArrayLike | None, what: str
) -> tuple[FloatArray, float, tuple[Step, ...]]:
    """Return readings over a turn as one array, the angle of the first sample, and the history."""
    readings, positions, history = curves(items, what=what, axis="angle")
    array = stacked(readings, what)
    return array, first_angle(positions, angle, array.shape[2], what), history


def _set_up_messages(array: FloatArray) -> tuple[str, ...]:
    """Warn where the second set-up looks as if it was not what a reversal asks for."""
    n = array.shape[2]
    if n % 2 or np.isnan(array).any():
        return ()
    basis = low_harmonics(2.0 * np.pi * np.arange(n) / n)
    m1, m2 = (without_basis(array[i].mean(axis=0), basis) for i in (0, 1))
    size = float(np.sqrt(np.sum(m1**2) * np.sum(m2**2)))
    if size == 0.0:
        return ()
    if float(np.max(np.abs(m1 - m2))) <= 1e-12 * float(np.max(np.abs(m1))):
        text = "both readings are the same: was anything turned for the second set-up?"
        return (text,)
    mirrored = np.roll(m2[::-1], 1)
    as_given, turned, back = (
        abs(float(m1 @ v)) / size for v in (m2, np.roll(m2, n // 2), mirrored)
    )
    if as_given < 0.5 and max(turned, back) > 0.95:
        way, ask = (
            (
                "after a further half turn",
                "was the artefact turned, was the probe turned, and was the index left alone?",
            )
            if turned >= back
            else ("when the second is mirrored", "did the spindle turn the other way round?")
        )
        text = (
            f"the readings are alike only {way} (|correlation| {max(turned, back):.2f} against "
            f"{as_given:.2f}): {ask}"
        )
        return (text,)
    return ()


_LARGEST_INDEX = 0.2
"""An index that is uncertain by more than 11 degrees was given in degrees."""


# ---- estler's face reversal: tilt and axial error motion of a spindle, and flatness of a plate ----

_SQUARENESS = "mean and once-per-revolution are how square the plate sits on the spindle"
_ZERO = "the zero of the probe is arbitrary"

_LARGEST_RADIUS = 5.0
"""The largest vertical lathes; a larger radius was given in mm."""


@dataclass(frozen=True, slots=True)
class FaceReversal(RecordedMethod):
    """Face reversal of a plate on a spindle with probes at the centre and at a radius.

    Centre probe: ``A(theta)``. Face probe at the radius r: ``F1 = A + r T + P``; with plate and
    face probe turned by half a revolution ``F2 = A - r T + P``, over the same angle of the plate.

    Readings: F1, F2 and A (3, n) in m, or M revolutions of each; a fourth one is A measured again
    in set-up 2, and the third is then that of set-up 1. Parts: ``artefact`` in m, height of the
    plate on the circle of the face probe; ``axial`` in m, towards the probes, its fundamental kept;
    ``tilt`` in rad, positive where it lifts the face probe of set-up 1.

    Parameters
    ----------
    start : float, rad, optional
        Angle of the first sample.

    Raises
    ------
    DataError
        If the radius is not positive or above 5 m.
    """

    radius: float = option(kind="size", help="distance r of the face probe from the axis, > 0")
    start: float = 0.0

    name = "face_reversal"
    what = "flatness of a plate, axial and tilt error motion of a spindle, by reversal"
    readings = ("F1", "F2", "A")
    spare = 1
    over = "angle"
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = ("artefact",)
    error_parts = ("axial", "tilt")

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> Separation:
        """Return the parts; a fourth reading is A measured again in the second set-up."""
        over_turn(data)
        rest, (f1, f2, axial, *second) = dict(options), data.values
        axial2 = second[0] if second else None
        return face_reversal(
            f1, f2, axial, rest.pop("radius"), axial2=axial2, angle=data.position, **rest
        )

    def __post_init__(self) -> None:
        radius = positive(self.radius, "radius", dimension="length", why="25 mm is 25e-3")
        if radius > _LARGEST_RADIUS:
            raise DataError(
                f"radius is {radius} m; the distance of the face probe from the axis must be "
                f"positive and at most {_LARGEST_RADIUS} m: 25 mm is 25e-3"
            )
        settle(self, radius=radius, start=real(self.start, "start", dimension="angle"))

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        plate, axial, tilt = given_parts(self, truth, errors).values()
        lift = self.radius * tilt
        return np.stack([axial + lift + plate, axial - lift + plate, axial])

    def null_space(self) -> tuple[Unobservable, ...]:
        return (
            Unobservable("artefact", "term", ("offset", "once per revolution"), _SQUARENESS),
            Unobservable("axial", "term", ("offset",), _ZERO),
            Unobservable("tilt", "term", ("offset", "once per revolution"), _SQUARENESS),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the axial motion for a fourth reading, as for the third, and for repeats."""
        if readings.shape[0] == model.shape[0] + 1:
            model = np.concatenate([model, model[2:]])
        return model[:, None] if readings.ndim == model.ndim + 1 else model

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = checked_readings(readings, names=_names(readings), minimum=8, what="face_reversal")
        angle = self.start + grid(array.shape[2])
        both, mean = low_harmonics(angle), low_harmonics(angle, highest=0)
        weights = _weights(self.radius, array.shape[0])
        bases = {"artefact": both, "axial": mean, "tilt": both}
        averaged, parts, u = combined(self, array, weights, bases, stated)
        result = Separation(
            self.name,
            parts,
            u,
            {"artefact": "m", "axial": "m", "tilt": "rad"},
            {"angle": angle},
            self.null_space(),
            noise=averaged.noise,
            audit={
                "radius_mm": self.radius * 1e3,
                "n_repeats": averaged.n_repeats,
                "n_samples": angle.size,
                "axial_readings": array.shape[0] - 2,
                "removed": "least squares: mean of all, once-per-revolution of plate and tilt",
            },
            messages=(
                *averaged.messages,
                *unit_message(array, self.name),
                *gap_message(parts["artefact"]),
            ),
            history=(*history, Step(self.name, {"radius_m": self.radius})),
        )
        hidden = {"artefact": (0, 1), "axial": (0,), "tilt": (0, 1)}
        harmonics, spread = _harmonics(array, result, weights, self.start, hidden)
        return replace(result, harmonics=harmonics, harmonics_u=spread)


@described_by(FaceReversal, FaceReversal.separate)
def face_reversal(
    f1: ArrayLike | Profile,
    f2: ArrayLike | Profile,
    axial: ArrayLike | Profile,
    radius: float,
    *,
    axial2: ArrayLike | Profile | None = None,
    angle: ArrayLike | None = None,
    u_reading: float | None = None,
) -> Separation:
    """Return flatness of a plate, axial and tilt error motion of a spindle from a face reversal.

    Parameters
    ----------
    f1, f2 : array_like, shape (n,) or (M, n), m, or Profile over the angle in rad
        Face readings before and after plate and face probe were turned by half a revolution,
        over the same 8 or more angles of the plate, equally spaced over one revolution.
    axial : array_like, shape (n,) or (M, n), m, or Profile
        Reading at the centre.
    axial2 : array_like, shape (n,) or (M, n), m, or Profile, optional
        Reading at the centre in the second set-up.
    angle : array_like, shape (n,), rad, optional
        Angles of the samples, if the readings are arrays; from 0 if omitted.

    Returns
    -------
    Separation
        ``.artefact`` (m), ``.axial`` (m), ``.tilt`` (rad).

    Notes
    -----
    ``T = (F1 - F2)/(2 r)``, ``P = (F1 + F2)/2 - A``. White noise s of one reading gives
    ``s/(r sqrt2)`` for T and ``s sqrt(3/2)`` for P. With a second axial reading
    ``T = (F1 - A1 - F2 + A2)/(2 r)`` and ``P = (F1 - A1 + F2 - A2)/2``, each with the variance of
    four readings; axial motion that differs between the set-ups then cancels.

    References
    ----------
    C. J. Evans, R. J. Hocken, W. T. Estler, CIRP Annals 45 (1996) 617-634, section 3.

    Examples
    --------
    >>> import numpy as np
    >>> a = 2 * np.pi * np.arange(64) / 64
    >>> axial, tilt, plate = 20e-9 * np.cos(a), 1e-6 * np.sin(2 * a), 50e-9 * np.cos(3 * a)
    >>> r = 25e-3
    >>> result = face_reversal(axial + r * tilt + plate, axial - r * tilt + plate, axial, r)
    >>> bool(abs(result.tilt - tilt).max() < 1e-18)
    True
    """
    items = [f1, f2, axial] if axial2 is None else [f1, f2, axial, axial2]
    array, start, history = _turns(items, angle, "face_reversal")
    return FaceReversal(radius, start).separate(array, u_reading=u_reading, history=history)


def _names(readings: ArrayLike) -> tuple[str, ...]:
    try:
        four = np.asarray(readings).shape[0] == 4
    except (ValueError, IndexError):
        four = False
    return ("F1", "F2", "A1", "A2") if four else ("F1", "F2", "A")


def _weights(radius: float, n_readings: int) -> dict[str, FloatArray]:
    """Return how each part is combined from the readings."""
    half = 1.0 / (2.0 * radius)
    if n_readings == 4:
        return {
            "artefact": np.array([0.5, 0.5, -0.5, -0.5]),
            "axial": np.array([0.0, 0.0, 0.5, 0.5]),
            "tilt": half * np.array([1.0, -1.0, -1.0, 1.0]),
        }
    return {
        "artefact": np.array([0.5, 0.5, -1.0]),
        "axial": np.array([0.0, 0.0, 1.0]),
        "tilt": half * np.array([1.0, -1.0, 0.0]),
    }


# ---- several separations of the same artefact as one: each harmonic weighted by its variance ----
# A reversal sees every undulation, a multi-probe set-up sees most of them with less noise, a second
# set of angles sees others. Harmonic by harmonic the mean weighted with 1/u^2 takes the best of each;
# what only one sees is taken from it, what none sees stays NaN.


class Combination(NamedMethod):
    """`combine_harmonics` by its name, from stored results."""

    name = "combine_harmonics"
    what = "one artefact from the results of several methods, harmonic by harmonic"
    reads = "results"
    accepts = ("Separation",)
    arguments: ClassVar[Mapping[str, Option]] = {
        "parts": Option(
            "texts",
            help="parts to combine; the motion of the spindle only if it is the same direction in each",
        ),
        "kmax": Option(
            "integer",
            help="highest harmonic of the result; the highest that any of them has if omitted",
        ),
    }


_DISAGREE = 5.0
"""Excess of chi-square, in its standard deviations, at which the methods are reported to disagree."""


@described_by(Combination)
def combine_harmonics(
    *separations: Separation, parts: Sequence[str] = ("artefact",), kmax: int | None = None
) -> Separation:
    """Return one separation from several of the same artefact, per harmonic by 1/variance.

    Parameters
    ----------
    *separations : Separation
        Two or more with harmonics of `parts` and their uncertainty, over the same angle of the
        artefact: same zero mark, same sense.

    Returns
    -------
    Separation
        The parts with `harmonics`; the curve is the sum of the observable ones over the angles of
        the input with the most samples. ``audit["weights"]`` holds the share of each input.

    Raises
    ------
    TooFewSamplesError
        If fewer than two separations are given.
    DataError
        If an input lacks the part, its harmonics or its uncertainty, none knows a harmonic, or
        kmax is out of range.

    Notes
    -----
    ``c_k = sum(c_ik / u_ik^2) / sum(1 / u_ik^2)``, ``u_k^2 = 1 / sum(1 / u_ik^2)`` (Gauss-Markov
    for independent inputs). Type B shares that are common to the inputs, such as one sensitivity of
    one probe used in all, do not average: add them afterwards with `Separation.with_type_b`.
    Chi-square over all harmonics seen at least twice says whether the inputs agree.

    Examples
    --------
    >>> from metrosep.separation.circles.probes import multiprobe
    >>> a = 2 * np.pi * np.arange(128) / 128
    >>> results = []
    >>> for degrees in ([0, 45, 135], [0, 60, 150]):
    ...     phi = np.deg2rad(degrees)
    ...     m = [1e-8 * np.cos(7 * (a + p)) + 1e-8 * np.sin(11 * (a + p)) for p in phi]
    ...     results.append(multiprobe(m, phi, 15, u_reading=1e-9))
    >>> [result.suppressed for result in results]
    [[7, 9, 15], [11, 13]]
    >>> combine_harmonics(*results).suppressed
    []
    """
    if len(separations) < 2:
        raise TooFewSamplesError(f"need >= 2 separations to combine, got {len(separations)}")
    for i, item in enumerate(separations):
        if not isinstance(item, Separation):
            raise DataError(f"input {i} is a {type(item).__name__}, no Separation")
        for part in parts:
            _check_has(item, part, i)
    top = max(item.harmonics[part].size for item in separations for part in parts) - 1
    if kmax is not None:
        wanted = count(kmax, "kmax", least=2)
        if wanted > top:
            raise DataError(f"kmax must be from 2 to {top}, what the separations have, got {kmax}")
        top = wanted
    n = max(item.coordinates["angle"].size for item in separations)
    harmonics, harmonics_u, curves, u_curves = {}, {}, {}, {}
    null_space: list[Unobservable] = []
    messages: list[str] = []
    weights: dict[str, Any] = {}
    ratios: dict[str, float | None] = {}
    for part in parts:
        c, u = _padded(separations, part, top)
        # Gauss-Markov: weights 1/u^2 for each harmonic
        seen = np.isfinite(u)
        information = np.where(seen, 1.0 / np.where(seen, u, 1.0) ** 2, 0.0)
        total = information.sum(axis=0)
        none = total == 0.0
        share = information / np.where(none, 1.0, total)
        mean = np.sum(share * np.where(seen, c, 0.0), axis=0)
        mean[none] = np.nan
        u_mean = np.where(none, np.nan, 1.0 / np.sqrt(np.where(none, 1.0, total)))
        harmonics[part], harmonics_u[part] = mean, u_mean
        curves[part] = curve(mean, n)
        u_curves[part] = np.full(n, math.sqrt(float(np.nansum(u_mean[1:] ** 2))))
        weights[part] = [[float(w) for w in row] for row in share]
        ratios[part], text = _agreement(part, c, u, mean)
        messages += text
        messages += _empty(separations, part)
        found, text = _unseen(separations, part, mean)
        null_space += found
        messages += text
    return Separation(
        "combined harmonics",
        curves,
        u_curves,
        {part: separations[0].units[part] for part in parts},
        {"angle": grid(n)},
        tuple(null_space),
        separations[0].noise,
        harmonics,
        harmonics_u,
        {
            "methods": [item.method for item in separations],
            "kmax": top,
            "weights": weights,
            "chi2_ratio": ratios,
        },
        tuple(messages),
        (
            *(step for item in separations for step in item.history),
            Step("combine_harmonics", {"methods": [item.method for item in separations]}),
        ),
    )


def _check_has(item: Separation, part: str, i: int) -> None:
    if part not in item.harmonics or part not in item.harmonics_u:
        known = ", ".join(item.harmonics) or "none"
        raise DataError(
            f"separation {i} ({item.method}) has no harmonics of {part!r}; it has {known}"
        )
    if "angle" not in item.coordinates:
        raise DataError(f"separation {i} ({item.method}) is not over an angle")
    u = item.harmonics_u[part][np.isfinite(item.harmonics[part])]
    if not (u > 0.0).all():
        raise DataError(
            f"separation {i} ({item.method}) states no uncertainty for harmonics of {part!r}, so it "
            "has no weight: give its u_reading, or repeats"
        )


def _padded(
    separations: Sequence[Separation], part: str, top: int
) -> tuple[ComplexArray, FloatArray]:
    """Return (inputs, top + 1); NaN where an input has no such harmonic, and for k = 0 and 1."""
    c = np.full((len(separations), top + 1), np.nan, dtype=np.complex128)
    u = np.full((len(separations), top + 1), np.nan)
    for i, item in enumerate(separations):
        size = min(top + 1, item.harmonics[part].size)
        c[i, :size] = item.harmonics[part][:size]
        u[i, :size] = item.harmonics_u[part][:size]
    u[np.isnan(c)] = np.nan
    return c, u


def _agreement(
    part: str, c: ComplexArray, u: FloatArray, mean: ComplexArray
) -> tuple[float | None, list[str]]:
    """Return chi-square over its freedom, and a message where the inputs contradict each other."""
    seen = np.isfinite(u)
    freedom = 2 * int(np.maximum(seen.sum(axis=0) - 1, 0).sum())
    if freedom == 0:
        return None, []
    apart = np.where(seen, np.abs(np.where(seen, c, 0.0) - np.where(seen, mean, 0.0)), 0.0)
    ratio = float(np.sum((apart / np.where(seen, u, 1.0)) ** 2)) / freedom
    if ratio <= 1.0 + _DISAGREE * math.sqrt(2.0 / freedom):
        return ratio, []
    text = (
        f"the separations differ {math.sqrt(ratio):.3g} times more than their uncertainties allow "
        f"in {part}: is the zero mark and the sense of the angle the same in all, is the motion?"
    )
    return ratio, [text]


def _empty(separations: Sequence[Separation], part: str) -> list[str]:
    """Name inputs without one known harmonic: their curve has gaps; refuse if all are such."""
    empty = [
        (i, item)
        for i, item in enumerate(separations)
        if not np.isfinite(item.harmonics[part]).any()
    ]
    if len(empty) == len(separations):
        raise DataError(
            f"no separation knows a single harmonic of {part!r}: their curves have gaps (NaN); "
            "measure the missing samples, or leave incomplete revolutions out"
        )
    return [
        f"separation {i} ({item.method}) knows no harmonic of {part}, since its curve has gaps: it "
        "takes no part in the combination"
        for i, item in empty
    ]


def _unseen(
    separations: Sequence[Separation], part: str, mean: ComplexArray
) -> tuple[list[Unobservable], list[str]]:
    """Return what no input knows, and why: suppressed in all, or also lost for other reasons."""
    missing = np.isnan(mean)
    found, messages = [], []
    terms = tuple(t for t, m in zip(("offset", "eccentricity"), missing[:2], strict=True) if m)
    if terms:
        found.append(Unobservable(part, "term", terms, "omitted by every one of the separations"))
    lost = [int(k) for k in np.flatnonzero(missing) if k > 1]
    hidden = [suppressed_harmonics(item.null_space, part) for item in separations]
    everywhere = tuple(k for k in lost if all(k in ks for ks in hidden))
    other = tuple(k for k in lost if k not in everywhere)
    if everywhere:
        why = "suppressed in every one of the separations"
        found.append(Unobservable(part, "harmonic", everywhere, why))
        messages.append(
            f"k={names_of_k(everywhere)} of {part} is suppressed in every separation: NaN"
        )
    if other:
        why = (
            "suppressed in some of the separations, and above kmax or lost to gaps (NaN) in the "
            "others"
        )
        found.append(Unobservable(part, "harmonic", other, why))
        messages.append(f"k={names_of_k(other)} of {part} is known by no separation ({why}): NaN")
    return found, messages
