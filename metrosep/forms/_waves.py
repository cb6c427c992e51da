"""Waves under which the polynomials beside a model are seen, and the spectra that a surface may have.

Of places in a plane: B' C B of columns B under the waves of each ring of frequencies, from which the
covariance under any spectrum is a weighted sum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from metrosep.core._arrays import FloatArray

_MARGIN = 6
"""Degrees beyond the last of which the waves still are: the tail of a polynomial's own spectrum."""
NARROW = 0.5
"""Of the sides: the rings hold fewer than half of the degrees across."""
_ALIKE = 0.04
"""Waves whose frequencies differ by a smaller share are one ring: no spectrum has sharper bends."""
_POWERS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
"""Of spectra that rise towards long waves."""
_RISING = np.array([1.0, 2.0, 4.0])
"""Widths of the map up to which they do."""


def under_waves(
    x: FloatArray, y: FloatArray, B: FloatArray, top: int, *, angle: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return frequencies times the width and the Gram matrices of columns B under waves of each.

    B' C B of an isotropic spectrum S is the integral of S(f) |B^(f)|^2 over the plane. Of a lay, which
    lies at one angle, it is that over a line.
    """
    rings = [(f, share * (w.T @ w)) for f, share, _, w in _rings(x, y, B, top, angle)]
    return np.array([f for f, _ in rings]), np.stack([G for _, G in rings])


def angle_across(x: FloatArray, y: FloatArray, r: FloatArray, top: int) -> float:
    """Return the angle of the second moment of the spectrum of a residual, across its lay."""
    moment = 0.0 + 0.0j
    for _, share, at, waves in _rings(x, y, r[:, None], top, None):
        power = np.square(waves).reshape(2, -1).sum(axis=0)
        moment += share * complex(power @ np.exp(2.0j * at))
    return 0.5 * float(np.angle(moment))


def _rings(
    x: FloatArray, y: FloatArray, B: FloatArray, top: int, angle: float | None
) -> Iterator[tuple[float, float, FloatArray, FloatArray]]:
    """Yield frequency times the width, share of each wave, angles, and sums of columns B under waves.

    Rings with equal angles on each, as many as make an integral exact for lags within the width D. A
    polynomial of degree d has its energy about f = (d + 1) / (pi side), so that beyond the last ring a
    spectrum is white to all of them.
    """
    x, y = x - 0.5 * (x.min() + x.max()), y - 0.5 * (y.min() + y.max())
    D = 2.0 * float(np.sqrt(np.max(x * x + y * y)))
    side, reach = max(float(np.ptp(x)), float(np.ptp(y))), D
    summed = _sums_under_waves(x, y, B)
    if narrowness(x, y) < NARROW:
        if angle is None:
            yield from _waves_of_both_axes(x, y, summed, D, top)
            return
        side = reach = max(float(np.ptp(x * np.cos(angle) + y * np.sin(angle))), 1e-3 * D)
    step = D / reach / 3.0  # the lags of a step of 1/(3 D) come round at 3 D
    n = int(np.ceil((top + _MARGIN) / np.pi * D / side / step))
    f = _graded(step, n)
    width = np.gradient(f) * (f if angle is None else 1.0)
    for ring, share in zip(f.tolist(), width.tolist(), strict=True):
        n = int(np.ceil(np.pi * ring + 8.0))
        at = np.pi / n * (np.arange(n) + 0.5) if angle is None else np.array([angle])
        k = 2.0 * np.pi * ring / D
        waves = summed(k * np.cos(at), k * np.sin(at))
        yield ring, share / at.size, np.asarray(at, dtype=np.float64), waves


def _graded(step: float, n: int) -> FloatArray:
    """Return n equal steps, and below the first one ever smaller ones, down to 1/50."""
    few = max(round(7.0 * np.log(50.0 * step) / np.log(50.0 / 3.0)), 1)
    return np.concatenate([np.geomspace(0.02, step, few + 1)[:-1], step * np.arange(1, n + 1)])


def _waves_of_both_axes(
    x: FloatArray,
    y: FloatArray,
    summed: Callable[[FloatArray, FloatArray], FloatArray],
    D: float,
    top: int,
) -> Iterator[tuple[float, float, FloatArray, FloatArray]]:
    """Yield what `_rings` does, of a narrow support: waves that are products of those of its two axes.

    Each axis has as many as its own length asks for, so that the polynomials across are held too. Those
    that are nearly as long make a ring.
    """
    turned = np.linalg.eigh(np.cov(x, y))[1]  # columns: across, along
    frequencies, widths = [], []
    for axis in turned.T:
        step = D / max(float(np.ptp(axis[0] * x + axis[1] * y)), 1e-3 * D) / 3.0
        f = _graded(step, int(np.ceil((top + _MARGIN) / np.pi * 3.0)))
        before = np.concatenate([[-f[0]], f[:-1]])  # the first one reaches to 0
        frequencies.append(f)
        widths.append(0.5 * (np.append(f[1:], 2.0 * f[-1] - f[-2]) - before))
    across, along = np.meshgrid(np.concatenate([-frequencies[0], frequencies[0]]), frequencies[1])
    share = np.outer(widths[1], np.tile(widths[0], 2)).ravel()
    k = turned @ np.stack([across.ravel(), along.ravel()])
    f = np.hypot(*k)
    ring = np.floor(np.log(f / f.min()) / _ALIKE).astype(np.intp)
    rank = np.argsort(ring, kind="stable")
    for part in np.split(rank, np.flatnonzero(np.diff(ring[rank])) + 1):
        waves = summed(*(2.0 * np.pi / D * k[:, part]))
        waves = waves * np.tile(np.sqrt(share[part]), 2)[:, None]
        yield (
            float(share[part] @ f[part] / share[part].sum()),
            1.0,
            np.arctan2(k[1, part], k[0, part]),
            waves,
        )


def _sums_under_waves(
    x: FloatArray, y: FloatArray, B: FloatArray
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return what gives cos(kx x + ky y)' B of each wave, and below it sin(kx x + ky y)' B.

    Of places on a grid exp(i (kx x + ky y)) is a product of two short tables, and no table of all
    waves at all places is made.
    """
    # centres of blocks are means: equal but for the rounding
    (across, column), (along, row) = (
        np.unique(v.round(12 - _decade(np.ptp(v))), return_inverse=True) for v in (x, y)
    )
    if across.size * along.size > 2 * x.size:  # no grid

        def scattered(kx: FloatArray, ky: FloatArray) -> FloatArray:
            phase = np.outer(kx, x) + np.outer(ky, y)
            return np.concatenate([np.cos(phase) @ B, np.sin(phase) @ B])

        return scattered

    grid = np.zeros((along.size, across.size, B.shape[1]))
    np.add.at(grid, (row, column), B)
    rows = grid.reshape(along.size, -1)

    def gridded(kx: FloatArray, ky: FloatArray) -> FloatArray:
        phase = np.outer(ky, along)
        under = (np.concatenate([np.cos(phase), np.sin(phase)]) @ rows).reshape(
            2, kx.size, *grid.shape[1:]
        )
        phase = np.outer(kx, across)[:, None]
        cos, sin = np.cos(phase), np.sin(phase)
        real = cos @ under[0] - sin @ under[1]
        imaginary = cos @ under[1] + sin @ under[0]
        return np.concatenate([real[:, 0], imaginary[:, 0]])

    return gridded


def _decade(span: float) -> int:
    return int(np.ceil(np.log10(span))) if span > 0.0 else 0


def likely_spectra(f: FloatArray, n_smooth: int = 45) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the spectra that a surface may have, (number, frequencies), the odds of each, and its reach.

    The reach is up to how many widths a spectrum rises, 0 for those that level off on the map.
    (1 + 2 (pi l f)^2 / B)^(-B/2), f in periods per width, falls as f^-B from a length l on;
    exp(-(pi l f)^2), its limit, is the Gaussian correlation. Two classes have odds of 1 each: lengths from
    a sixteenth of the width up to it, and, as no width is that of the surface, spectra that still rise
    there, where the map sees a pure power law. Within a class all kinds have the same odds. Powers lie
    near enough for one between two of them: with whole ones only, f^-1.5 was taken for a steeper one that
    levels off. A smooth kind as long as the map would be a form, and has lengths up to the width only.
    """
    found, odds = [], []
    for B in (*_POWERS, 8.0, np.inf):
        is_limit = bool(np.isinf(B))
        n = n_smooth if is_limit else 16 if B >= 8.0 else 8
        lengths = np.geomspace(1 / 16, 1.0, n, endpoint=B >= 8.0)
        found += [_levelling(lengths, f, B)]
        odds += [np.full(n, 1.0 / n / (len(_POWERS) + 2))]
    for B in _POWERS:
        found += [_levelling(_RISING, f, B)]
        odds += [np.full(_RISING.size, 1.0 / _RISING.size / len(_POWERS))]
    S = np.concatenate(found)
    beyond = np.tile(_RISING, len(_POWERS))
    return S, np.concatenate(odds), np.append(np.zeros(len(S) - beyond.size), beyond)


def with_short_ones(f: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what `likely_spectra` does, with spectra of texture, nearly white along the polynomials.

    Texture is smooth or exponential (B = 3), of lengths below those of `likely_spectra`. It is a third class.
    """
    S, odds, beyond = likely_spectra(f)
    lengths = np.geomspace(1 / 64, 1 / 16, 9)[:-1]
    short = np.concatenate([_levelling(lengths, f, B) for B in (3.0, 8.0, np.inf)])
    n = len(short)
    odds = np.concatenate([odds, np.full(n, 1.0 / n)])
    return np.concatenate([S, short]), odds, np.append(beyond, np.zeros(n))


def _levelling(lengths: FloatArray, f: FloatArray, B: float) -> FloatArray:
    """Return spectra that are flat up to a frequency of 1/length and fall as f^-B from there on."""
    square = np.square(np.pi * lengths[:, None] * f)
    return np.exp(-square) if np.isinf(B) else np.asarray((1.0 + 2.0 * square / B) ** (-0.5 * B))


def narrowness(x: FloatArray, y: FloatArray) -> float:
    """Return the shorter over the longer principal axis of the places: of a rectangle, of its sides."""
    small, large = np.linalg.eigvalsh(np.cov(x, y))
    return float(np.sqrt(max(small, 0.0) / large)) if large > 0.0 else 1.0
