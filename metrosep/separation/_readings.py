"""What separations of repeated curves share: checks, means of repeats, removal of a basis.

Readings are arrays (n_readings, n_samples), or (n_readings, n_repeats, n_samples) where each was
repeated: passes of a slide, revolutions of a spindle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import ComplexArray, FloatArray, as_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.numbers import count, not_negative, real
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface

if TYPE_CHECKING:
    from metrosep.separation.contract import SeparationMethod

NOISE_UNKNOWN = (
    "the noise of a reading is not known, so no uncertainty is stated: give repeats, or u_reading"
)


@dataclass(frozen=True, slots=True)
class Averaged:
    """Means of repeated readings."""

    mean: FloatArray  # shape (n_readings, n_samples): naN where no repeat was measured
    counts: FloatArray  # shape (n_readings, n_samples): how many repeats stand behind each mean
    n_repeats: int  # largest number of repeats
    # standard deviation of one reading; NaN where it is neither stated nor shown by repeats
    noise: Quantity

    @property
    def messages(self) -> tuple[str, ...]:
        """What is to be said about the noise."""
        return (NOISE_UNKNOWN,) if math.isnan(self.noise.value) else ()


def as_numbers(values: ArrayLike, needs: str) -> FloatArray:
    """Return a copy in float64; what a masked array masks is NaN."""
    try:
        return as_float(values)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{needs}, got no array of numbers ({exc})") from None


def unit_message(array: FloatArray, what: str) -> tuple[str, ...]:
    """Warn where readings in m are so large that another unit was meant."""
    known = array[~np.isnan(array)]
    span = float(np.ptp(known)) if known.size else 0.0
    if span <= _LARGEST:
        return ()
    text = f"{what}: the readings span {span:.3g} m; are they in m? 5 um is 5e-6"
    return (text,)


_LARGEST = 0.1
"""No displacement sensor of these methods reads over 0.1 m."""


def checked_readings(
    readings: ArrayLike, *, names: Sequence[str], minimum: int, what: str
) -> FloatArray:
    """Return readings as (n_readings, n_repeats, n_samples), or refuse them."""
    array = as_numbers(
        readings, f"{what} needs {len(names)} readings of equal length ({', '.join(names)})"
    )
    if array.ndim not in (2, 3) or array.shape[0] != len(names):
        raise InvalidSamplesError(
            f"{what} needs {len(names)} readings ({', '.join(names)}) as an array of shape "
            f"({len(names)}, n) or ({len(names)}, repeats, n), got {array.shape}"
        )
    if array.ndim == 2:
        array = array[:, None, :]
    if array.shape[2] < minimum or array.shape[1] < 1:
        raise TooFewSamplesError(
            f"{what} needs at least {minimum} samples in each reading, got {array.shape[2]}"
        )
    if np.isinf(array).any():
        i, r, j = (int(v) for v in np.argwhere(np.isinf(array))[0])
        raise InvalidSamplesError(
            f"{what}: {names[i]} is infinite at repeat {r}, sample {j}; mark what was not measured "
            "as NaN"
        )
    for name, repeats in zip(names, array, strict=True):
        n_measured = int((~np.isnan(repeats)).any(axis=0).sum())
        if n_measured < minimum:
            raise TooFewSamplesError(
                f"{what}: {name} holds {n_measured} measured samples, at least {minimum} are needed"
            )
    return array


def average_repeats(
    array: FloatArray, basis: FloatArray, *, u_reading: float | None, unit: str = "m"
) -> Averaged:
    """Return the means over repeats, and the noise of one reading.

    The noise is that of what remains when `basis` is removed from each repeat: an offset or an
    eccentricity that differs from repeat to repeat does not reach the result either.
    """
    counts = (~np.isnan(array)).sum(axis=1).astype(np.float64)
    mean = np.stack([_mean_curve(rows, n, basis) for rows, n in zip(array, counts, strict=True)])
    n_repeats = array.shape[1]
    if u_reading is not None:
        stated = stated_u(u_reading, unit)
        assert stated is not None  # noqa: S101
        noise = Quantity(
            stated, unit, "standard uncertainty of one reading, as stated", symbol="s"
        )
    else:
        noise = _noise_of_repeats(array, mean, basis, unit)
    return Averaged(mean, counts, n_repeats, noise)


def _mean_curve(repeats: FloatArray, counts: FloatArray, basis: FloatArray) -> FloatArray:
    """Return the mean of repeats; each may have its own share of the basis.

    Where every sample has all repeats, that is the plain mean. With gaps the plain mean would jump
    between levels, so the shares are fitted first: ``z_r(x) = f(x) + basis(x) c_r``.
    """
    valid = ~np.isnan(repeats)
    used = valid.any(axis=1)
    own = np.where(valid, repeats, 0.0)
    if not valid[used].all() and used.sum() > 1:
        own = own - valid * own_shares(own, valid, counts, basis)
    return np.where(counts > 0, own.sum(axis=0) / np.maximum(counts, 1.0), np.nan)


def own_shares(
    own: FloatArray, valid: NDArray[np.bool_], counts: FloatArray, basis: FloatArray
) -> FloatArray:
    """Return basis(x) c_r by least squares, the curve f eliminated; their mean is not determined."""
    return joint_coefficients(own, valid, counts, basis)[0] @ basis.T


def joint_coefficients(
    own: FloatArray, valid: NDArray[np.bool_], counts: FloatArray, basis: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return c_r of z_r(x) = f(x) + basis(x) c_r, shape (n_repeats, p), and the normal matrix.

    The curve f is eliminated; what it can exchange with all c_r is none of theirs (least norm).
    """
    n_repeats, p = own.shape[0], basis.shape[1]
    weight = valid / np.maximum(counts, 1.0)
    normal = np.zeros((n_repeats, p, n_repeats, p))
    for i in range(p):
        for j in range(p):
            product = basis[:, i] * basis[:, j]
            normal[:, i, :, j] = np.diag(valid @ product) - (valid * product) @ weight.T
    apart = valid * (own - own.sum(axis=0) / np.maximum(counts, 1.0))
    size = n_repeats * p
    right = (apart @ basis).ravel()
    square = normal.reshape(size, size)
    found = np.linalg.lstsq(square, right, rcond=1e-12)[0]
    return found.reshape(n_repeats, p), square


def not_tied(valid: NDArray[np.bool_], n_columns: int) -> list[int]:
    """Return the repeats that no chain of more than `n_columns` common positions ties to the first."""
    numbers = valid.astype(np.float64)
    tied = numbers @ numbers.T > n_columns
    reached = tied[0]
    for _ in range(len(valid)):
        reached = tied[reached].any(axis=0)
    return np.flatnonzero(~reached).tolist()


def _noise_of_repeats(
    array: FloatArray, mean: FloatArray, basis: FloatArray, unit: str
) -> Quantity:
    """Pool the scatter of all repeats about their means, the basis removed from each."""
    n_repeats, p = array.shape[1], basis.shape[1]
    squares, freedom = 0.0, 0.0
    for i in range(array.shape[0]):
        taken = [r for r in array[i] if (~np.isnan(r)).sum() > p]
        if len(taken) < 2:
            continue
        for repeat in taken:
            squares += float(np.nansum(without_basis(repeat - mean[i], basis) ** 2))
        counts = (~np.isnan(np.stack(taken))).sum(axis=0)
        freedom += float(np.maximum(counts - 1, 0).sum()) - p * (len(taken) - 1)
    if freedom < 1.0:
        return Quantity(math.nan, unit, "standard deviation of one reading; not known", symbol="s")
    value = math.sqrt(squares / freedom)
    text = f"standard deviation of one reading, pooled from {n_repeats} repeats (type A)"
    return Quantity(value, unit, text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def without_basis(values: FloatArray, basis: FloatArray) -> FloatArray:
    """Return values minus their least-squares combination of the basis; NaN stay NaN."""
    valid = ~np.isnan(values)
    found = np.linalg.lstsq(basis[valid], values[valid], rcond=None)[0]
    return np.asarray(values - basis @ found)


def require_common(valid: NDArray[np.bool_], basis: FloatArray, what: str) -> None:
    """Refuse set-ups that have too few samples in common."""
    n, p = int(valid.sum()), basis.shape[1]
    if n <= p + 1:
        raise NotSeparableError(
            f"{what}: only {n} of {valid.size} samples were measured in every set-up, more than "
            f"{p + 1} are needed: the gaps do not overlap, measure the missing part again"
        )


def left_share(valid: NDArray[np.bool_], basis: FloatArray) -> FloatArray:
    """Return the share of a white variance that removing the basis leaves, sample by sample."""
    share = np.full(valid.size, np.nan)
    q, _ = np.linalg.qr(basis[valid])
    share[valid] = np.maximum(1.0 - np.sum(q**2, axis=1), 0.0)
    return share


def low_harmonics(angle: FloatArray, highest: int = 1) -> FloatArray:
    """Return 1, cos and sin up to a harmonic as columns."""
    columns = [np.ones(angle.size)]
    for k in range(1, highest + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    return np.column_stack(columns)


def line_basis(x: FloatArray) -> FloatArray:
    """Return 1 and the centred, scaled position as columns."""
    half = max(float(np.ptp(x)) / 2.0, np.finfo(np.float64).tiny)
    return np.column_stack([np.ones(x.size), (x - (x.min() + x.max()) / 2.0) / half])


def harmonics_of(
    values: FloatArray, *, start: float = 0.0, hidden: Sequence[int] = ()
) -> ComplexArray:
    """Return one-sided Fourier coefficients of a closed curve."""
    n = values.shape[-1]
    top = (n - 1) // 2
    gaps = np.isnan(values).any(axis=-1)
    coefficients = np.fft.rfft(np.where(np.isnan(values), 0.0, values))[..., : top + 1] * (2.0 / n)
    coefficients[..., 0] /= 2.0
    coefficients = coefficients * np.exp(-1j * start * np.arange(top + 1))
    coefficients[gaps] = complex(np.nan, np.nan)
    coefficients[..., [k for k in hidden if k <= top]] = complex(np.nan, np.nan)
    return np.asarray(coefficients)


def gap_message(values: FloatArray) -> tuple[str, ...]:
    """Say why a curve has no harmonics."""
    n = int(np.isnan(values).sum())
    if n == 0:
        return ()
    text = (
        f"{n} of {values.size} angles were not measured in every set-up: the curves keep the gap, "
        "and the harmonics, which need the whole turn, are not determined"
    )
    return (text,)


def harmonics_u(array: FloatArray, weights: FloatArray, noise: float) -> FloatArray:
    """Return the standard uncertainty of the coefficients of a weighted sum of mean readings.

    Motion that does not repeat is not white over the angle, so the scatter of the repeats is taken
    harmonic by harmonic; without repeats the noise of a reading is white.
    """
    n = array.shape[2]
    top = (n - 1) // 2
    white = np.full(top + 1, noise * math.sqrt(2.0 / n))
    white[0] = noise / math.sqrt(n)
    variance = np.zeros(top + 1)
    for repeats, weight in zip(array, weights, strict=True):
        whole = repeats[~np.isnan(repeats).any(axis=1)]
        if weight == 0.0:
            continue
        if len(whole) >= _ENOUGH:
            c = harmonics_of(whole)
            own = (np.var(c.real, axis=0, ddof=1) + np.var(c.imag, axis=0, ddof=1)) / 2.0
            own[0] *= 2.0  # the mean is real
            variance += weight**2 * own / len(whole)
        else:
            held = max(int((~np.isnan(repeats).all(axis=1)).sum()), 1)
            variance += weight**2 * white**2 / held
    return np.sqrt(variance)


_ENOUGH = 4
"""Repeats from which the scatter of one harmonic is better known than that of white noise."""


# ---- settings of the standard tests as plain numbers -------------------------------------------


def checked_sd(value: Any, unit: str = "") -> float | None:
    """Return the standard deviation of one reading, or None."""
    if value is None:
        return None
    return not_negative(value, "sd", dimension=_DIMENSIONS.get(unit))


def checked_count(value: Any, name: str, *, low: int = 0) -> int:
    """Return a whole number; 2.0 is one, too."""
    whole = isinstance(value, float) and value.is_integer()
    return count(int(value) if whole else value, name, least=low)


def checked_seed(value: Any) -> int:
    """Return the seed of a simulation."""
    return checked_count(value, "seed")


# ---- private helper: refuse complex numbers, text and rows of unequal length before they are used ----


def real_numbers(values: Any, name: str) -> NDArray[Any]:
    """Return an array of real numbers of any kind; what is not such an array is refused by name."""
    try:
        array = np.asarray(values)
        is_complex = np.iscomplexobj(array)
        if not is_complex and array.dtype.kind not in "fiub":
            array = array.astype(np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{name} must be real numbers in rows of equal length, in SI: {exc}"
        ) from None
    if is_complex:
        raise InvalidSamplesError(f"{name} must be real, got complex: give X and Y as two rows")
    return array


# ---- parts and readings as callers give them: mappings, arrays or profiles ---------------------


def given_parts(
    method: SeparationMethod, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
) -> dict[str, FloatArray]:
    """Return all parts of a simulation, of one shape, zeros where one is missing."""
    found = known_parts(method, truth, errors)
    shapes = {v.shape for v in found.values()}
    if len(shapes) != 1:
        raise DataError(
            f"{method.name}: parts of one shape are needed to simulate, the shapes are {sorted(shapes)}"
        )
    zero = np.zeros(shapes.pop())
    return {k: found.get(k, zero) for k in (*method.truth_parts, *method.error_parts)}


def curves(
    items: Sequence[ArrayLike | Profile], *, what: str, axis: str
) -> tuple[list[Any], FloatArray | None, tuple[Step, ...]]:
    """Return readings as arrays, with the positions and the history that profiles carry."""
    profiles = [item for item in items if isinstance(item, Profile)]
    if not profiles:
        return list(items), None, ()
    if len(profiles) != len(items):
        raise DataError(f"{what}: give all readings as profiles, or all as arrays, not mixed")
    for profile in profiles:
        profile.require_metres()
    first = profiles[0]
    step = abs(float(np.ptp(first.x))) / max(len(first) - 1, 1)
    for i, other in enumerate(profiles[1:], start=2):
        if len(other) != len(first):
            raise DataError(
                f"{what}: reading {i} has {len(other)} samples, the first has {len(first)}; "
                "resample both onto the same positions"
            )
        shift = float(np.max(np.abs(other.x - first.x)))
        if shift > 1e-6 * step:
            raise DataError(
                f"{what}: the {axis} positions of reading {i} differ from the first by up to "
                f"{shift:.6g} {'rad' if axis == 'angle' else 'm'}; both must be given over the "
                "positions of the artefact (a reversal turns it by half a revolution)"
            )
    history = tuple(step for p in profiles for step in p.history)
    return [p.z for p in profiles], first.x, history


def stacked(readings: Sequence[ArrayLike], what: str) -> FloatArray:
    """Return curves, each perhaps repeated, as one array; missing repeats are NaN."""
    arrays = [as_numbers(r, f"{what} needs readings as numbers") for r in readings]
    shapes = [a.shape for a in arrays]
    if any(len(s) not in (1, 2) for s in shapes) or len({s[-1] for s in shapes}) != 1:
        raise DataError(
            f"{what}: readings must be curves of equal length, got the shapes "
            f"{', '.join(str(s) for s in shapes)}; resample them onto the same positions"
        )
    most = max(a.shape[0] if a.ndim == 2 else 1 for a in arrays)
    out = np.full((len(arrays), most, shapes[0][-1]), np.nan)
    for i, a in enumerate(arrays):
        rows = np.atleast_2d(a)
        out[i, : rows.shape[0]] = rows
    return out


def first_angle(positions: FloatArray | None, angle: ArrayLike | None, n: int, what: str) -> float:
    """Return the angle of the first sample of readings over one turn."""
    if positions is not None and angle is not None:
        raise DataError(f"{what}: profiles bring their angles, leave out angle")
    if positions is None and angle is None:
        return 0.0
    angles = positions if positions is not None else as_angles(angle, what)
    if angles.size != n:
        raise DataError(f"{what}: there are {angles.size} angles for {n} samples")
    require_turn(angles)
    return float(angles[0])


def as_angles(angle: ArrayLike | None, what: str) -> FloatArray:
    """Return angles as an array."""
    try:
        angles = np.array(angle, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{what}: the angles are not numbers ({exc})") from None
    if angles.ndim != 1 or not np.isfinite(angles).all():
        raise InvalidSamplesError(f"{what}: the angles must be one row of finite numbers, in rad")
    return angles


def require_turn(angle: FloatArray) -> None:
    """Refuse angles that are not equally spaced over one revolution."""
    n = angle.size
    step = 2.0 * np.pi / n
    apart = np.abs(angle - angle[0] - step * np.arange(n))
    if np.max(apart) > _ROUNDED * step:
        hint = _angle_hint(angle)
        raise InvalidSamplesError(
            f"the angles must be equally spaced over one revolution, {n} steps of "
            f"{np.degrees(step):.6g} deg; {hint}"
        )


def _angle_hint(angle: FloatArray) -> str:
    """Return what is probably the matter with angles that do not close one turn."""
    n = angle.size
    forward = float(np.median(np.diff(angle))) if n > 1 else 0.0
    if forward < 0.0:
        return "they fall: turn the samples round, or give the angle of the other sense"
    if np.max(np.abs(angle - angle[0] - 360.0 / n * np.arange(n))) < _ROUNDED * 360.0 / n:
        return "these look like degrees, rad are needed"
    turns = round(n * forward / (2.0 * np.pi))
    if turns > 1:
        return (
            f"they run through {turns} revolutions: tell them apart (repeat, a column that numbers "
            "them), or give an array (revolutions, samples)"
        )
    return "resample them; the last sample is not the first one again"


_ROUNDED = 0.01
"""Angles may lie this share of a step beside the grid: they were rounded in a text."""


# ---- parts of a simulation whose shapes differ from part to part; a stated uncertainty ---------


def known_parts(
    method: SeparationMethod, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
) -> dict[str, FloatArray]:
    """Return the parts that were given, as arrays."""
    found = {}
    for given, known, kind in (
        (truth, method.truth_parts, "truth"),
        (errors, method.error_parts, "error"),
    ):
        for name, values in given.items():
            if name not in known:
                has = ", ".join(known) or "none"
                raise DataError(f"{method.name} has no {kind} part {name!r}; it has {has}")
            try:
                found[name] = np.array(values, dtype=np.float64)
            except (TypeError, ValueError) as exc:
                raise DataError(
                    f"{method.name}: the part {name!r} is not an array of numbers: {exc}"
                ) from None
    if not found:
        every = ", ".join((*method.truth_parts, *method.error_parts))
        raise DataError(f"{method.name}: no part is given to simulate; it has {every}")
    return found


def part_of(
    parts: Mapping[str, FloatArray], name: str, shape: tuple[int, ...], what: str
) -> FloatArray:
    """Return one part of a stated shape, zeros where it was not given."""
    if name not in parts:
        return np.zeros(shape)
    if parts[name].shape != shape:
        raise DataError(
            f"{what}: the part {name!r} must have the shape {shape}, got {parts[name].shape}"
        )
    return parts[name]


def stated_u(u_reading: Any, unit: str, name: str = "u_reading") -> float | None:
    """Return a stated standard uncertainty of one reading, or None."""
    if u_reading is None:
        return None
    dimension = {"m": "length", "rad": "angle", "s": "time", "V": "voltage"}.get(unit)
    what = f"a standard uncertainty >= 0{f' in {unit}' if unit and dimension is None else ''}"
    return not_negative(real(u_reading, name, dimension=dimension, what=what), name)


# ---- private helpers of result classes: plain values for JSON, and copies by copy and pickle ----


def plain(value: Any) -> Any:
    """Return a value as lists, dicts, numbers and text; what is not finite becomes None."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, Quantity):
        return plain(value.to_dict())
    if isinstance(value, Step):
        return plain(history_as_dicts((value,))[0])
    if isinstance(value, Profile):
        return {"x": plain(value.x), "z": plain(value.z)}
    if isinstance(value, Surface):
        steps = {"dx": plain(value.dx), "dy": plain(value.dy), "origin": plain(value.origin)}
        return {**steps, "z": plain(value.z)}
    return str(value)


def reduced(result: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Return what ``__reduce__`` of a result must return for a copy with read-only arrays."""
    return _restored, (type(result), {n: getattr(result, n) for n in _slots(type(result))})


def _restored(kind: type, parts: Mapping[str, Any]) -> Any:
    made: Any = object.__new__(kind)
    for name, value in parts.items():
        object.__setattr__(made, name, value)
    _make_read_only(made)
    return made


def _make_read_only(value: Any) -> None:
    """Make the arrays read-only that an object of this package, a mapping or a sequence holds."""
    if isinstance(value, np.ndarray):
        value.setflags(write=False)
    elif isinstance(value, dict | MappingProxyType):
        for one in value.values():
            _make_read_only(one)
    elif type(value) in (tuple, list):
        for one in value:
            _make_read_only(one)
    elif type(value).__module__.startswith("metrosep."):
        for name in _slots(type(value)):
            _make_read_only(getattr(value, name))


def _slots(kind: type) -> list[str]:
    own = [getattr(base, "__slots__", ()) for base in kind.__mro__]
    return [n for names in own for n in ((names,) if isinstance(names, str) else names)]


# ---- checks on what a user of the planner types: speeds and lengths in SI, and hints where not ----

_FASTEST = 5.0
"""m/s (300 m/min); no feed drive of a machine tool is faster."""

LONG_WAVE = 2.0
"""m; longer waves are doubted: mm typed for m look so."""

_LONGEST = 100.0
"""m; no machine axis is longer."""

_N_IN_RANGE = 121


def positive(value: Any, name: str, unit: str, *, zero: bool = False) -> float:
    """Return a number that is positive and finite, or zero where that is taken."""
    check = not_negative if zero else numbers.positive
    return check(value, name, dimension=_DIMENSIONS.get(unit))


_DIMENSIONS = {"m": "length", "s": "time"}


def checked_feeds(values: ArrayLike, name: str) -> FloatArray:
    """Return feeds as numbers, refusing what cannot be m/s."""
    feeds = _numbers(values, name)
    if not (np.isfinite(feeds) & (feeds > 0.0)).all():
        raise DataError(f"{name} must be positive and finite speeds in m/s, got {feeds.tolist()}")
    if feeds.size and feeds.max() > _FASTEST:
        raise UnitError(
            f"{name}: {feeds.max():.6g} m/s is faster than any feed drive; speeds are in m/s "
            f"({feeds.max():.6g} mm/s is {feeds.max() / 1e3:.4g} m/s, {feeds.max():.6g} mm/min is "
            f"{feeds.max() / 6e4:.4g} m/s)"
        )
    return feeds


def checked_wavelengths(
    values: ArrayLike, *, travel_is_known: bool = False
) -> tuple[FloatArray, bool]:
    """Return the wavelengths, rising, and whether they came from a range."""
    waves = _numbers(values, "wavelengths")
    if not waves.size:
        raise TooFewSamplesError("wavelengths is empty; give the waves that matter in m")
    if not (np.isfinite(waves) & (waves > 0.0)).all():
        raise DataError(f"wavelengths must be positive and finite, in m, got {waves.tolist()}")
    if waves.max() > (_LONGEST if travel_is_known else LONG_WAVE):
        raise UnitError(
            f"a wavelength of {waves.max():.6g} m is longer than the travel of most machines; "
            f"wavelengths are in m ({waves.max():.6g} mm is {waves.max() / 1e3:.4g}); give length "
            "where the travel is that long"
        )
    if isinstance(values, tuple) and waves.size == 2 and waves[0] != waves[1]:
        grid: FloatArray = np.geomspace(waves.min(), waves.max(), _N_IN_RANGE)
        grid[0], grid[-1] = waves.min(), waves.max()
        return grid, True
    return waves, False


def _numbers(values: ArrayLike, name: str) -> FloatArray:
    return np.array(real_numbers(values, name), dtype=np.float64).ravel()
