r"""The clock of a run: a sampling interval fitted to its time stamps, and the samples that were lost.

:math:`t_i = t_0 + k_i\,\Delta t`, :math:`k_i` the place of sample i among those that the logger took.
Stamps of ordinary clocks jitter, are rounded, or are shared by the samples of a buffer; the samples
themselves were taken evenly. A noise model in time needs :math:`\Delta t` and the :math:`k_i`, not the
stamps. Where samples were lost, time and position both jump: the position tells a lost sample from
a wrong stamp.

Source: the project's notes on separation, section 6.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotUniformError
from metrosep.core.runset import Run
from metrosep.core.units import format_length
from metrosep.separation.runs.noise import MAD

_JITTER, _AWAY, _ROW = 0.3, 0.75, 5
"""Largest sd of the stamps about the fitted clock, in steps; so far off no so many in a row may be."""

_LONG_ROW = 25
"""Stamps on each side of a jump that are compared where they jitter, at most."""

_SHARED = 0.25
"""Share of equal neighbours from which stamps belong to blocks of samples, or are rounded to more than a step."""

_LEAST_STAMPS = 4
"""Blocks with a stamp of their own from which a rate can be fitted."""

_BLOCK_JITTER = 0.1
"""Largest sd of the stamps of blocks, in blocks."""

_RATE = 0.01
"""Largest standard uncertainty of the fitted interval, relative: runs within 1 % share a noise model."""

_EVEN = 0.15
"""Robust sd of the steps of position, relative, up to which they show whether a sample was lost."""

_NEAR = 4
"""Steps on each side with which a step of position is compared."""

_WHOLE = 0.3
"""A lost sample doubles the step of position, up to this share of a step."""

_MOST_NAMED = 3
"""Places of lost samples that are said one by one."""

_MENTIONED = 0.01
"""Jitter in steps that is said."""


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """Even times of the samples of a run."""

    start: float  # s: time of the first sample
    step: float  # s: sampling interval
    index: NDArray[np.intp]  # shape (n,): place of each sample among all that were taken, from 0
    jitter: float  # sd of the stamps about the fit, in steps; of blocks, in blocks
    block: float = 1.0  # samples that share a stamp
    lost: tuple[tuple[float, int], ...] = ()  # m, count: where samples were lost, and how many
    wrong: tuple[
        tuple[float, float], ...
    ] = ()  # m, s: where the stamps jump and the axis does not

    @property
    def size(self) -> int:
        """Number of samples that were taken, lost ones too."""
        return int(self.index[-1]) + 1


def fit_clock(run: Run) -> Clock:
    """Return the clock of a run with time; refuse stamps that no even clock explains."""
    assert run.t is not None  # noqa: S101  (callers look first)
    t, n = run.t - run.t[0], len(run)
    shared = np.diff(t) == 0.0
    if np.mean(shared) > _SHARED and n - shared.sum() <= _LEAST_STAMPS:
        raise NotUniformError(
            f"its {n} samples share {n - int(shared.sum())} time stamps, written or stored with too "
            "few digits (32-bit numbers hold no day in seconds): give the sampling rate instead of "
            "the column of time"
        )
    in_blocks = bool(np.mean(shared) > _SHARED)
    at = np.concatenate([[0], np.flatnonzero(~shared) + 1]) if in_blocks else np.arange(n)
    at = at[1:] if in_blocks else at  # the first stamp may belong to a block begun before the run
    block = float(np.median(np.diff(at))) if in_blocks else 1.0
    more = _steps_more(run.x)
    gaps = np.zeros(n, dtype=np.intp)
    if more is not None:
        gaps = _by_position(more, strict=in_blocks)
        gaps = gaps if in_blocks else _counted(t, gaps)
    wrong: list[tuple[int, float]] = []
    rest, fitted = _fit(t, at, gaps)
    if _fault(rest, block) or more is None:
        gaps, wrong = _by_time(t, at, gaps, more)
        for i, size in wrong:
            t[i:] -= size
        rest, fitted = _fit(t, at, gaps)
    _refuse(rest, block, fitted, run.x[at])
    index = np.arange(n) + np.cumsum(gaps)
    if index[-1] + 1 > 2 * n:
        raise NotUniformError(
            f"{int(index[-1]) + 1 - n} samples are missing between its {n}: split it where they are"
        )
    return Clock(
        start=float(run.t[0]) + fitted[0],
        step=fitted[1],
        index=index.astype(np.intp),
        jitter=float(np.sqrt(np.mean(rest**2))) / block,
        block=block,
        lost=tuple((float(run.x[i - 1]), int(gaps[i])) for i in np.flatnonzero(gaps)),
        wrong=tuple((float(run.x[i - 1]), size) for i, size in wrong if not gaps[i]),
    )


def clock_messages(clocks: list[tuple[str, Clock]]) -> list[str]:
    """Return what is said of the clocks of runs, by the names of the runs."""
    out = []
    gaps = [(k, x, name) for name, clock in clocks for x, k in clock.lost]
    broken = len({name for _, _, name in gaps})
    if broken > _MOST_NAMED:
        count, x, name = max(gaps)
        out.append(
            f"{sum(k for k, _, _ in gaps)} samples were lost at {len(gaps)} places of {broken} runs, "
            f"{count} of them at {format_length(x, digits=4)} in run {name}: kept as gaps"
        )
    for name, clock in clocks if broken <= _MOST_NAMED else ():
        for x, count in clock.lost if len(clock.lost) <= _MOST_NAMED else ():
            samples = "1 sample was" if count == 1 else f"{count} samples were"
            out.append(
                f"run {name}: {samples} lost at {format_length(x, digits=4)}: kept as a gap"
            )
        if len(clock.lost) > _MOST_NAMED:
            x, count = max(clock.lost, key=lambda gap: gap[1])
            out.append(
                f"run {name}: {sum(k for _, k in clock.lost)} samples were lost at {len(clock.lost)} "
                f"places, {count} of them at {format_length(x, digits=4)}: kept as gaps"
            )
    for name, clock in clocks:
        for x, size in clock.wrong:
            out.append(
                f"run {name}: the time stamps jump by {size * 1e3:.3g} ms at "
                f"{format_length(x, digits=4)} and the position does not: even time steps used"
            )
    blocks = [(c.block, n) for n, c in clocks if c.block > 1.0]
    if blocks:
        size, name = max(blocks)
        out.append(f"up to {size:.3g} samples share a time stamp (run {name}): fitted clock used")
    jitter, name = max(((c.jitter, n) for n, c in clocks if c.block == 1.0), default=(0.0, ""))
    if jitter > _MENTIONED:
        out.append(f"{100 * jitter:.2g} % jitter of the clock (run {name}): fitted clock used")
    return out


def _steps_more(x: FloatArray) -> FloatArray | None:
    """Return by how many steps the step before each position exceeds its neighbours; None if uneven."""
    size = np.abs(np.diff(x))
    if size.size <= _NEAR:
        return None
    around = np.lib.stride_tricks.sliding_window_view(
        np.pad(size, _NEAR, "reflect"), 2 * _NEAR + 1
    )
    near = np.median(around, axis=1)
    more = np.append(0.0, size / near - 1.0)
    return more if MAD * float(np.median(np.abs(more))) < _EVEN else None


def _by_position(more: FloatArray, *, strict: bool) -> NDArray[np.intp]:
    """Return how many samples the position lacks before each one; not strict where time decides."""
    whole = np.round(more)
    # A jerk of the axis or of its encoder is made good by the next step, a lost sample is not.
    kept = np.convolve(more, np.ones(3), "same")
    room = _WHOLE * np.maximum(1.0, 0.1 * whole)
    if not strict:
        room = np.maximum(room, 4.0 * MAD * float(np.median(np.abs(more))))
    lost = (whole >= 1.0) & (np.abs(more - whole) <= room) & (kept > whole - 0.5)
    return np.where(lost, whole, 0.0).astype(np.intp)


def _counted(t: FloatArray, moved: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the lost samples where the position shows some, counted by the time."""
    gaps, at = moved.copy(), np.arange(t.size)
    places = np.flatnonzero(moved)
    part = np.searchsorted(places, at, side="right")
    size = np.bincount(part)
    k, own = at - (np.bincount(part, at) / size)[part], t - (np.bincount(part, t) / size)[part]
    step = float(k @ own) / float(k @ k)
    level = np.bincount(part, t - step * at) / size
    for i, jump in zip(places, np.round(np.diff(level) / step), strict=True):
        # An even time with one or two steps missing in the position: the axis jerked.
        gaps[i] = int(jump) if jump >= 1 else (moved[i] if moved[i] > 2 else 0)
    return gaps


def _fit(
    t: FloatArray, at: NDArray[np.intp], gaps: NDArray[np.intp]
) -> tuple[FloatArray, tuple[float, float]]:
    """Return what the stamps are off the fitted clock, in steps, and its start and step."""
    places = (np.arange(t.size) + np.cumsum(gaps))[at].astype(np.float64)
    away = places - places.mean()
    mean = float(t[at].mean())
    step = float(away @ (t[at] - mean)) / float(away @ away)
    return (t[at] - mean) / step - away, (mean - step * float(places.mean()), step)


def _by_time(
    t: FloatArray, at: NDArray[np.intp], gaps: NDArray[np.intp], x_more: FloatArray | None
) -> tuple[NDArray[np.intp], list[tuple[int, float]]]:
    """Return the samples lost before each one, and where the stamps alone jump (sample, s)."""
    gaps = gaps.copy()
    places = at + np.cumsum(gaps)[at]
    steps, counts = np.diff(t[at]), np.diff(places)
    step = float(np.median(steps / counts))
    more = steps / step - counts
    scatter = MAD * float(np.median(np.abs(more - np.median(more))))
    reach = int(np.clip(np.ceil(200.0 * scatter**2), _ROW, _LONG_ROW))
    if more.size < 2 * reach:
        return gaps, []
    # Jitter does not last: the middle of the stamps after a place against those before it.
    level = np.pad(np.append(0.0, np.cumsum(more)), (reach, reach - 1), "edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(level, reach), axis=1)
    jump = (middle[reach:] - middle[:-reach])[1:-1]
    found: list[tuple[int, float]] = []
    left = np.abs(jump)
    while left.max() > _AWAY:
        around = slice(max(0, int(np.argmax(left)) - reach + 1), int(np.argmax(left)) + reach)
        place = around.start + int(np.argmax((more * np.sign(jump[np.argmax(left)]))[around]))
        found.append((place, float(jump[np.argmax(left)])))
        left[around] = 0.0
    if len(found) > max(3, 0.01 * at.size):
        return gaps, []  # rounding, not faults
    wrong: list[tuple[int, float]] = []
    for place, size in sorted(found):
        sample = int(at[place + 1])
        near = slice(int(at[place]), sample + 2)
        if size > _AWAY and (x_more is None or float(x_more[near].max()) > 0.5 * size):
            gaps[sample] += round(size)
        else:
            wrong.append((sample, size * step))
    return gaps, wrong


def _fault(rest: FloatArray, block: float) -> bool:
    """Whether stamps scatter about the fitted clock more than a noise model bears."""
    sd, far = _allowed(block)
    out = np.abs(rest) > far
    row = out.size >= _ROW and bool((np.convolve(out, np.ones(_ROW), "valid") >= _ROW).any())
    return row or float(np.mean(rest**2)) > sd**2


def _allowed(block: float) -> tuple[float, float]:
    """Return the sd in steps, and what a row of stamps may be off; a block has 7 or 8 samples."""
    sd = _JITTER if block == 1.0 else max(0.5, _BLOCK_JITTER * block)
    return sd, _AWAY if block == 1.0 else 3.0 * sd


def _refuse(rest: FloatArray, block: float, fitted: tuple[float, float], x: FloatArray) -> None:
    """Refuse stamps that follow no even clock, or tell its rate too badly."""
    step, sd = fitted[1], float(np.sqrt(np.mean(rest**2)))
    if not step > 0.0 or _fault(rest, block):
        i = int(np.argmax(np.abs(rest)))
        raise NotUniformError(
            f"its time stamps follow no even clock: they scatter by {sd:.2g} sampling intervals of "
            f"{step * 1e3:.4g} ms (sd; at most {_allowed(block)[0]:.2g}) and are "
            f"{rest[i] * step * 1e3:.3g} ms off at {format_length(float(x[i]), digits=4)}: give the "
            "sampling rate if the samples were taken evenly, else resample them to even times"
        )
    u = sd / np.sqrt(rest.size * np.var(np.arange(rest.size) * block))
    if u > _RATE:
        raise NotUniformError(
            f"its {rest.size} time stamps of blocks tell the sampling interval to {100 * u:.2g} % "
            "only: give the sampling rate instead of the column of time"
        )
