"""Repeats of one measurement: what repeats, what does not, point by point and by wavelength."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.methods import Readings
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.separation._readings import as_numbers, not_tied, own_shares
from metrosep.separation.contract import (
    U_READING,
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
    as_stated,
    type_a,
)

Align = Literal["none", "piston", "line"]

_LEAST = 8
_COMMON = (
    "an error that is the same in every repeat (reference, probe, a vibration locked to the start) "
    "looks like the part: change the set-up, the speed or the orientation between repeats"
)
_ALIGNED = "the alignment of each repeat decides it; it was removed from each"


@dataclass(frozen=True, slots=True)
class RepeatSplit(RecordedMethod):
    """Repeats of a profile or a map at the same positions.

    Readings (M, n) or (M, n_y, n_x) in m. Parts: ``repeatable``, ``non_repeatable`` (M, ...), what each
    repeat has besides, and ``sd``, the scatter at each point.

    Parameters
    ----------
    x : tuple of float or None, m, optional
        Positions of profiles; pixels if omitted.
    steps : tuple of (float, float) or None, m, optional
        dx and dy of maps.

    Raises
    ------
    DataError
        If `align` is unknown.
    """

    x: tuple[float, ...] | None = None
    align: Align = option(
        "line",
        kind="text",
        choices=("line", "piston", "none"),
        help="what is removed from each repeat: line or plane, mean (piston), or nothing",
    )
    closed: bool = option(
        False,
        kind="flag",
        help="true: the curve closes after one revolution, and wavelengths are undulations per "
        "revolution",
    )
    steps: tuple[float, float] | None = None

    name = "repeatable"
    what = "what repeats in several readings of one thing, and what does not"
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "shift": Option(
            "text",
            choices=("trust", "fit"),
            help="fit: each profile is moved along x onto the first by least squares; trust: it stays "
            "where it is",
        ),
    }
    truth_parts = ("repeatable",)
    error_parts = ("non_repeatable",)

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> Separation:
        """Return what repeats; columns and their repeats are repeats of one reading."""
        every = data.values.reshape(-1, data.values.shape[-1])
        return repeatable(every, x=data.position, **options)

    def __post_init__(self) -> None:
        if self.align not in ("none", "piston", "line"):
            raise DataError(f"repeatable: align is {self.align!r}; none, piston or line")

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        unknown = [n for n in truth if n != "repeatable"]
        unknown += [n for n in errors if n != "non_repeatable"]
        if unknown or not (truth or errors):
            raise DataError(
                "repeatable simulates the truth part 'repeatable' and the error part "
                f"'non_repeatable', got {[*truth, *errors]}"
            )
        common = np.asarray(truth.get("repeatable", 0.0), dtype=np.float64)
        if "non_repeatable" in errors:
            return common + np.asarray(errors["non_repeatable"], dtype=np.float64)
        return np.stack([common, common])

    def null_space(self) -> tuple[Unobservable, ...]:
        out = [Unobservable("repeatable", "term", ("errors common to all repeats",), _COMMON)]
        if self.align != "none":
            degrees = (0,) if self.align == "piston" else (0, 1)
            out += [
                Unobservable(p, "polynomial", degrees, _ALIGNED)
                for p in ("repeatable", "non_repeatable")
            ]
        return tuple(out)

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        stack = _checked(readings)
        coordinates = self._coordinates(stack.shape[1:])
        aligned, n_removed, left = _aligned(stack, self.align, coordinates)
        return self._result(aligned, n_removed, left, coordinates, stated, history)

    def _coordinates(self, shape: tuple[int, ...]) -> dict[str, FloatArray]:
        if len(shape) == 2:
            dx, dy = self.steps or (1.0, 1.0)
            across, along = (
                np.arange(shape[1], dtype=np.float64),
                np.arange(shape[0], dtype=np.float64),
            )
            return {"x": np.asarray(dx * across), "y": np.asarray(dy * along)}
        if self.x is None:
            n = shape[0]
            return (
                {"angle": 2 * np.pi * np.arange(n) / n}
                if self.closed
                else {"x": np.arange(float(n))}
            )
        if len(self.x) != shape[0]:
            raise DataError(f"repeatable: {len(self.x)} positions for {shape[0]} samples")
        return {"angle" if self.closed else "x": np.array(self.x)}

    def _result(
        self,
        stack: FloatArray,
        n_removed: int,
        left: FloatArray,
        coordinates: dict[str, FloatArray],
        u_reading: float | None,
        history: tuple[Step, ...],
    ) -> Separation:
        m = stack.shape[0]
        counts = np.isfinite(stack).sum(axis=0).astype(np.float64)
        total = np.where(np.isfinite(stack), stack, 0.0).sum(axis=0)
        mean = np.where(counts > 0, total / np.maximum(counts, 1.0), np.nan)
        rest = stack - mean
        squares = np.where(np.isfinite(rest), rest**2, 0.0).sum(axis=0)
        sd = np.where(counts > 1, np.sqrt(squares / np.maximum(counts - 1.0, 1.0)), np.nan)
        freedom = float(np.maximum(counts - 1.0, 0.0).sum()) - n_removed * (m - 1)
        if freedom < 1.0:
            raise TooFewSamplesError(
                "repeatable: no point was measured twice; the masks do not meet"
            )
        pooled = math.sqrt(float(squares.sum()) / freedom)
        spread = pooled if u_reading is None else float(u_reading)
        share = _share(mean, counts, pooled, m)
        u_mean = spread * np.sqrt(left / np.maximum(counts, 1.0))
        u_rest = spread * np.sqrt(left * (1.0 - 1.0 / np.maximum(counts, 1.0)))
        parts = {"repeatable": mean, "non_repeatable": rest, "sd": sd}
        u = {
            "repeatable": np.where(counts > 0, u_mean, np.nan),
            "non_repeatable": np.where(np.isfinite(rest), u_rest, np.nan),
            "sd": np.where(counts > 1, sd / np.sqrt(2.0 * np.maximum(counts - 1.0, 1.0)), np.nan),
        }
        audit: dict[str, Any] = {
            "n_repeats": m,
            "align": self.align,
            "sd_one_repeat_nm": 1e9 * pooled,
            "degrees_of_freedom": freedom,
            **share,
        }
        messages = []
        lines: list[dict[str, Any]] = []
        if mean.ndim == 1:
            ((_, positions),) = coordinates.items()
            lines, said = repeating_lines(
                stack, positions, closed=self.closed, calibrated=self.x is not None
            )
            messages += said
        audit["lines"] = lines
        if m < 4:
            messages.append(
                f"{m} repeats: the scatter at a single point is known to "
                f"{100 / math.sqrt(2 * (m - 1)):.0f} % only; u uses the scatter pooled over all points"
            )
        text = f"scatter of one repeat, pooled from {m} repeats (type A)"
        noise = type_a(pooled, "m", text, freedom) if u_reading is None else as_stated(spread, "m")
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, "m"),
            coordinates,
            self.null_space(),
            noise=noise,
            audit=audit,
            messages=tuple(messages),
            history=(*history, Step(self.name, {"n": m, "align": self.align})),
        )


@described_by(RepeatSplit, errors=False)
def repeatable(
    repeats: Sequence[ArrayLike | Profile | Surface] | ArrayLike,
    *,
    x: ArrayLike | None = None,
    align: Align = "line",
    shift: Literal["trust", "fit"] = "trust",
    closed: bool = False,
    u_reading: float | None = None,
) -> Separation:
    """Return what repeats in several measurements of one thing, and what does not.

    Parameters
    ----------
    repeats : sequence of Profile, Surface or array_like, m
        At least two. Profiles may lie on different positions: they are interpolated to common ones
        over the common range. Maps must have the same pixels.
    x : array_like, shape (n,), m, optional
        Positions of arrays; for a closed profile angles in rad.
    u_reading : float, m, optional
        Standard uncertainty of one reading; the scatter of the repeats if omitted.

    Returns
    -------
    Separation
        ``.repeatable`` (mean), ``.non_repeatable`` (each repeat minus the mean), ``.sd`` (scatter of
        one repeat at each point). The audit has the shares of variance, and ``lines``: amplitude,
        uncertainty and p-value of each wavelength that repeats.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If there are fewer than two repeats, or they have no common positions.
    NotConvergedError
        If the shifts do not settle.

    Notes
    -----
    With scatter s (line removed from each of M repeats) the variance over x of the mean holds
    ``s^2/M`` of noise; it is subtracted: ``repeatable = var(mean) - s^2/M``, and may come out below
    zero. A wavelength repeats where ``F = M |mean Z|^2 / S`` (S the scatter of the complex amplitude
    Z) passes Benjamini-Hochberg at 5 % of false discoveries; F follows F(2, 2 M - 2) without it.

    References
    ----------
    Y. Benjamini, Y. Hochberg, J. R. Stat. Soc. B 57 (1995) 289-300.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0, 1e-3, 200)
    >>> noise = 1e-9 * np.random.default_rng(0).standard_normal((5, 200))
    >>> result = repeatable(20e-9 * np.sin(2 * np.pi * x / 0.2e-3) + noise, x=x)
    >>> 0.99 < result.audit["share_repeatable"] < 1.0
    True
    """
    if shift not in ("trust", "fit"):
        raise DataError(f"repeatable: shift is {shift!r}; trust or fit")
    stack, positions, steps, history, extra = common_stack(repeats, x)
    if closed and positions is not None and np.ptp(positions) > 2.0 * np.pi * 1.001:
        raise DataError(
            f"repeatable: x of a closed profile spans {float(np.ptp(positions)):.4g} rad, more than one "
            "turn; this looks like degrees or m: give angles in rad"
        )
    if shift == "fit":
        if positions is None or stack.ndim != 2:
            raise DataError('repeatable: shift="fit" needs profiles, or arrays with x')
        stack, positions, moved = shifted_to_first(stack, positions)
        extra = {**extra, **moved}
    method = RepeatSplit(
        None if positions is None else tuple(positions.tolist()), align, closed, steps
    )
    result = method.separate(stack, u_reading=u_reading, history=history)
    if not extra:
        return result
    from dataclasses import replace

    return replace(result, audit={**result.audit, **extra})


def _checked(readings: ArrayLike) -> FloatArray:
    stack = as_numbers(readings, "repeatable: repeats must be numbers in m")
    if stack.ndim not in (2, 3):
        raise InvalidSamplesError(
            f"repeatable needs an array (repeats, n) or (repeats, n_y, n_x), got {stack.shape}"
        )
    if stack.shape[0] < 2:
        raise TooFewSamplesError(f"repeatable needs at least 2 repeats, got {stack.shape[0]}")
    if np.isinf(stack).any():
        raise InvalidSamplesError("repeatable: a reading is infinite; mark it as NaN")
    for k, one in enumerate(stack):
        if np.isfinite(one).sum() < _LEAST:
            raise TooFewSamplesError(
                f"repeatable: repeat {k + 1} has {int(np.isfinite(one).sum())} measured samples, at "
                f"least {_LEAST} are needed"
            )
    return stack


def _aligned(
    stack: FloatArray, align: Align, coordinates: Mapping[str, FloatArray]
) -> tuple[FloatArray, int, FloatArray]:
    """Return repeats without their alignment, columns removed, and the share of variance left."""
    shape = stack.shape[1:]
    scaled = [_scaled(c) for c in reversed(list(coordinates.values()))]  # y, x as the rows go
    axes = np.meshgrid(*scaled, indexing="ij")
    columns = [] if align == "none" else [np.ones(shape)]
    if align == "line":
        columns += axes
    if not columns:
        return stack, 0, np.ones(shape)
    basis = np.stack([c.ravel() for c in columns], axis=1)
    flat = stack.reshape(stack.shape[0], -1)
    out = _lines_removed(flat, basis)
    common = np.isfinite(out).all(axis=0)
    used = basis[common] if common.sum() > basis.shape[1] else basis
    lever = np.einsum("ni,ij,nj->n", basis, np.linalg.pinv(used.T @ used), basis)
    return out.reshape(stack.shape), basis.shape[1], np.maximum(1.0 - lever, 0.0).reshape(shape)


def _lines_removed(flat: FloatArray, basis: FloatArray) -> FloatArray:
    """Return repeats without their columns of the basis.

    With gaps in other places a line of each by itself would follow the part where it was measured.
    The columns are then fitted together with the mean: ``z_r(x) = f(x) + basis(x) c_r``; what f and
    all c_r can exchange is taken from f by least squares over all positions.
    """
    valid = np.isfinite(flat)
    seen = valid.any(axis=0)
    if (valid == seen).all():
        found = np.linalg.lstsq(basis[seen], flat[:, seen].T, rcond=None)[0]
        return flat - (basis @ found).T
    _require_common(valid, basis.shape[1])
    counts = valid.sum(axis=0).astype(np.float64)
    own = np.where(valid, flat, 0.0)
    rest = own - valid * own_shares(own, valid, counts, basis)
    mean = rest.sum(axis=0)[seen] / counts[seen]
    common = basis @ np.linalg.lstsq(basis[seen], mean, rcond=None)[0]
    return np.where(valid, rest - common, np.nan)


def _require_common(valid: NDArray[np.bool_], n_columns: int) -> None:
    """Refuse repeats that no chain of common positions ties together."""
    loose = not_tied(valid, n_columns)
    if loose:
        apart = ", ".join(str(k + 1) for k in loose[:8])
        raise TooFewSamplesError(
            f"repeatable: the masks do not meet: repeats {apart} share too few positions with the "
            'first to tell their line from the part; leave them out, or use align="none"'
        )


def _scaled(x: FloatArray) -> FloatArray:
    half = max(float(np.ptp(x)) / 2.0, np.finfo(np.float64).tiny)
    return np.asarray((x - (x.max() + x.min()) / 2.0) / half)


def _share(mean: FloatArray, counts: FloatArray, pooled: float, m: int) -> dict[str, float]:
    full = counts == m
    if full.sum() < _LEAST:
        return {}
    lasting = float(np.var(mean[full])) - pooled**2 / m
    total = lasting + pooled**2
    return {
        "variance_repeatable_nm2": 1e18 * lasting,
        "variance_non_repeatable_nm2": 1e18 * pooled**2,
        "share_repeatable": lasting / total if total > 0.0 else math.nan,
    }


# ---- repeats as callers give them, on common positions, laterally aligned ----------------------

_MOST_PASSES = 50
_SETTLED = 1e-3


class RepeatedMaps(NamedMethod):
    """`repeatable` of maps by its name."""

    name = "repeatable_maps"
    function = "repeatable"
    what = "what repeats in several maps of one thing, and what does not"
    reads = "maps"
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "align": RepeatSplit.fields["align"],
    }


def common_stack(
    repeats: Any, x: ArrayLike | None
) -> tuple[
    FloatArray,
    FloatArray | None,
    tuple[float, float] | None,
    tuple[Step, ...],
    dict[str, Any],
]:
    """Return repeats as one array with positions, steps, history and notes for the audit."""
    if isinstance(repeats, Profile | Surface):
        raise TooFewSamplesError("repeatable needs at least 2 repeats: a list of them")
    try:
        items = list(repeats)
    except TypeError:
        raise InvalidSamplesError(
            f"repeatable needs a list, got {type(repeats).__name__}"
        ) from None
    profiles = [i for i in items if isinstance(i, Profile)]
    surfaces = [i for i in items if isinstance(i, Surface)]
    if (profiles or surfaces) and len(items) not in (len(profiles), len(surfaces)):
        raise DataError("repeatable: give all repeats as profiles, surfaces or arrays, not mixed")
    if profiles or surfaces:
        if x is not None:
            raise DataError("repeatable: profiles and surfaces bring their positions, leave out x")
        if len(items) < 2:
            raise TooFewSamplesError(f"repeatable needs at least 2 repeats, got {len(items)}")
        history = tuple(s for i in items for s in i.history)
        if profiles:
            stack, positions, notes = _on_common_positions(profiles)
            return stack, positions, None, history, notes
        stack, steps = _maps(surfaces)
        return stack, None, steps, history, {}
    needs = "repeatable: repeats must be arrays of numbers of one shape"
    rows = [as_numbers(i, needs) for i in items]
    shapes = sorted({r.shape for r in rows})
    if len(shapes) > 1:
        raise InvalidSamplesError(f"{needs}, got {shapes}")
    stack = np.array(rows)
    if x is None:
        return stack, None, None, (), {}
    positions = as_numbers(x, "repeatable: x must be positions in m (or angles in rad)")
    if positions.ndim != 1 or not np.isfinite(positions).all():
        raise InvalidSamplesError("repeatable: x must be one row of finite positions")
    return stack, positions, None, (), {}


def _maps(surfaces: list[Surface]) -> tuple[FloatArray, tuple[float, float] | None]:
    first = surfaces[0]
    for k, s in enumerate(surfaces[1:], start=2):
        if s.shape != first.shape or s.dx != first.dx or s.dy != first.dy:
            raise DataError(
                f"repeatable: map {k} has {s.shape} pixels of {s.dx} x {s.dy} m, the first "
                f"{first.shape} of {first.dx} x {first.dy} m; resample them to the same pixels"
            )
    steps = None if first.dx is None else (first.dx, first.dy or first.dx)
    return np.stack([s.z for s in surfaces]), steps


def _on_common_positions(
    profiles: list[Profile],
) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    first = profiles[0]
    if all(len(p) == len(first) and np.array_equal(p.x, first.x) for p in profiles):
        return np.stack([p.z for p in profiles]), first.x.copy(), {}
    start, stop = max(p.x[0] for p in profiles), min(p.x[-1] for p in profiles)
    step = float(np.median([np.median(np.diff(p.x)) for p in profiles if len(p) > 1]))
    n = int(np.floor((stop - start) / step + 1e-9)) + 1 if stop > start else 0
    if n < 8:
        raise DataError(
            f"repeatable: the repeats share {max(stop - start, 0.0):.3g} m of positions, less than 8 "
            "steps; do they start at the same place, all in m?"
        )
    x = start + step * np.arange(n)
    stack = np.stack([_interpolated(p.x, p.z, x) for p in profiles])
    return (
        stack,
        x,
        {"resampled_step_um": 1e6 * step, "resampled": "linear, over the common range"},
    )


def _interpolated(x: FloatArray, z: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate linearly; NaN outside, and where a neighbour with weight was not measured."""
    hole = np.isnan(z)
    out = np.interp(at, x, np.where(hole, 0.0, z))
    near = np.interp(at, x, hole.astype(np.float64)) > 1e-9
    margin = 1e-9 * (x[-1] - x[0])
    return np.where(near | (at < x[0] - margin) | (at > x[-1] + margin), np.nan, out)


def shifted_to_first(
    stack: FloatArray, x: FloatArray
) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    """Return profiles moved along x onto the first, on the positions that all then have."""
    if not np.all(np.diff(x) > 0.0):
        raise DataError('repeatable: shift="fit" needs x that rises; sort x and the repeats')
    shifts = np.array([0.0, *(_shift(x, stack[0], z) for z in stack[1:])])
    low, high = x[0] + max(0.0, *(-shifts)), x[-1] - max(0.0, *shifts)
    keep = (x >= low) & (x <= high)
    out = np.stack([_interpolated(x, z, x[keep] + s) for z, s in zip(stack, shifts, strict=True)])
    return out, x[keep].copy(), {"shifts_um": (1e6 * shifts).tolist()}


def _shift(x: FloatArray, first: FloatArray, z: FloatArray) -> float:
    """Return s of least squares of ``z(x + s) - first(x)``, a line free."""
    step = float(np.median(np.diff(x)))
    slope = np.gradient(first, x)
    s = 0.0
    for _ in range(_MOST_PASSES):
        d = _interpolated(x, z, x + s) - first
        good = np.isfinite(d) & np.isfinite(slope)
        if good.sum() < x.size / 2:
            break
        u = np.linspace(-1.0, 1.0, x.size)
        basis = np.column_stack([slope, np.ones(x.size), u])[good]
        size = np.maximum(np.linalg.norm(basis, axis=0), np.finfo(float).tiny)
        found = np.linalg.lstsq(basis / size, d[good], rcond=1e-10)[0] / size
        change = float(np.clip(-found[0], -2 * step, 2 * step))
        s += change
        if abs(change) < _SETTLED * step:
            return s
    raise NotConvergedError(
        "repeatable: a lateral shift did not settle; the repeats differ too much for it, or start more "
        'than a few of their shortest waves apart: align them first, or use shift="trust"'
    )


# ---- which wavelengths repeat: an F test of the complex amplitudes of all repeats --------------

FALSE_DISCOVERIES = 0.05
_MOST_LINES = 60


def repeating_lines(
    stack: FloatArray, x: FloatArray, *, closed: bool, calibrated: bool = True
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the wavelengths that repeat, strongest first."""
    from scipy.stats import f as f_distribution

    steps = np.diff(x)
    if np.isnan(stack).any():
        return [], ["no wavelengths were tested: there are gaps"]
    if np.abs(steps - steps.mean()).max() > 1e-3 * abs(float(steps.mean())):
        return [], ["no wavelengths were tested: the steps are not uniform"]
    m, n = stack.shape
    window = np.ones(n) if closed else np.hanning(n + 2)[1:-1]
    z = 2.0 / window.sum() * np.fft.rfft(stack * window, axis=1)
    first = 2  # 0 and 1 are the alignment, or leak from it
    orders = np.arange(first, (n - 1) // 2)
    z = z[:, first : (n - 1) // 2]
    mean = z.mean(axis=0)
    scatter = (np.abs(z - mean) ** 2).sum(axis=0) / (m - 1)
    floor = 1e-24 * float(np.max(np.abs(mean) ** 2, initial=0.0)) + np.finfo(float).tiny
    ratio = m * np.abs(mean) ** 2 / np.maximum(scatter, floor)
    p = f_distribution.sf(ratio, 2, 2 * (m - 1))
    order = np.argsort(p)
    passed = np.flatnonzero(p[order] <= FALSE_DISCOVERIES * (1 + np.arange(p.size)) / p.size)
    chosen = order[: passed[-1] + 1] if passed.size else order[:0]
    chosen = chosen[np.argsort(-np.abs(mean[chosen]))]
    length = abs(float(n * steps.mean()))
    lines = []
    for k in chosen[:_MOST_LINES]:
        name: dict[str, Any] = {"wavelength_um": 1e6 * length / int(orders[k])}
        if closed:
            name = {"upr": int(orders[k])}
        elif not calibrated:
            name = {"wavelength_samples": length / int(orders[k])}
        u = math.sqrt(float(scatter[k]) / (2.0 * m))
        lines.append(
            {**name, "amplitude_nm": 1e9 * float(abs(mean[k])), "u_nm": 1e9 * u, "p": float(p[k])}
        )
    more = chosen.size - len(lines)
    return lines, [f"{more} further wavelengths repeat"] if more else []
