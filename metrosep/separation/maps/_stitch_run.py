"""One stitching from checked sub-apertures to a `Separation`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, MetrosepError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._methods import as_stated
from metrosep.separation.contract import Separation, Unobservable
from metrosep.separation.maps._stitch_grid import (
    Pieces,
    mirrored_piece,
    outlying_pairs,
    pair_residuals,
    without_own_plane,
)
from metrosep.separation.maps._stitch_models import (
    Settings,
    Solution,
    connected,
    with_pixels,
    with_polynomial,
    without_reference,
)
from metrosep.separation.maps._stitch_solve import (
    Problem,
    fitted_to,
    noise_of,
    own_residuals,
)

_RIGID = "how the whole lies in space is arbitrary; it was removed by least squares"


def run(pieces: Pieces, settings: Settings, extra: dict[str, Any]) -> Separation:
    """Return the stitched surface."""
    problem, inverse, values = connected(pieces, settings.freedoms)
    if not settings.fit_reference:
        solution = without_reference(problem, inverse, values, pieces, settings)
    elif settings.degree is None:
        solution = with_pixels(problem, inverse, values, pieces, settings)
    else:
        solution = with_polynomial(problem, values, pieces, settings)
    return _result(problem, solution, pieces, settings, extra)


def _result(
    problem: Problem,
    s: Solution,
    pieces: Pieces,
    settings: Settings,
    extra: dict[str, Any],
) -> Separation:
    layout, line = problem.layout, pieces.line
    residuals = pair_residuals(layout, problem.overlaps, s.fitted)
    size = max(float(np.nanmax(np.abs(v))) for v in pieces.values)
    own = own_residuals(problem, s.fitted)
    floor = 1e-9 * size
    bad, shown = outlying_pairs(own, floor, settings.u_reading), own
    if not bad:
        bad, shown = outlying_pairs(residuals, floor, settings.u_reading), residuals
    _refuse_mirrored(pieces, problem, residuals, bad)
    messages = [*pieces.warnings, *extra.pop("messages", ()), *s.messages]
    messages += _outlier_messages(problem, shown, bad)
    stated = settings.u_reading
    messages += setup_warnings(
        pieces,
        problem,
        s.fitted,
        settings.freedoms,
        beyond_stated=stated is not None and s.noise[0] > 1.5 * stated > 0.0,
        named=bool(bad),
    )
    if settings.u_reading is None and math.isnan(s.noise[0]):
        messages.append("the overlaps are too small to show the noise: give u_reading")
    if settings.u_reading is not None and s.noise[0] > 1.5 * settings.u_reading > 0.0:
        messages.append(
            f"the overlaps scatter by {1e9 * s.noise[0]:.3g} nm, the stated noise is "
            f"{1e9 * settings.u_reading:.3g} nm: positions, drift or the instrument's reference "
            "do not fit, and u is too small"
        )
    if settings.fit_reference and settings.degree is None and settings.draws == 0:
        messages.append("no uncertainty was simulated (draws=0)")
    n_each = problem.columns[0].size
    parts = {"surface": s.surface}
    u = {"surface": np.where(np.isnan(s.surface), np.nan, s.u_surface)}
    if s.reference is not None and s.u_reference is not None:
        parts["reference"] = s.reference
        u["reference"] = np.where(np.isnan(s.reference), np.nan, s.u_reference)
    coordinates = {"x": layout.x} if line else {"x": layout.x, "y": layout.y}
    if line:
        parts, u = ({k: v[0] for k, v in d.items()} for d in (parts, u))
    audit = {
        "n_sub_apertures": len(pieces),
        "freedoms": list(settings.freedoms),
        "freedoms_nm": (1e9 * s.theta[: n_each * len(pieces)].reshape(-1, n_each))
        .round(6)
        .tolist(),
        "positions_mm": (1e3 * pieces.corners[:, : 1 if line else 2]).tolist(),
        "shapes": [list(v.shape) for v in pieces.values],
        "step_mm": [1e3 * pieces.dx, 1e3 * pieces.dy],
        "rotations_rad": pieces.turns.tolist(),
        "overlaps": [
            {
                "pair": [o.i + 1, o.j + 1],
                "n": o.n,
                "residual_nm": float(1e9 * r),
                "own_residual_nm": float(1e9 * q),
            }
            for o, r, q in zip(problem.overlaps, residuals, own, strict=True)
        ],
        "outlying_pairs": [[problem.overlaps[k].i + 1, problem.overlaps[k].j + 1] for k in bad],
        "noise_from_overlaps_nm": None if math.isnan(s.noise[0]) else 1e9 * s.noise[0],
        "degrees_of_freedom": s.noise[1],
        "weights": "plain mean of all sub-apertures at a pixel (inverse variance), no feathering",
        "removed": "least squares: piston" + ", tilt" * ("tilt" in settings.freedoms),
        "n_not_measured": int(np.isnan(s.surface).sum()),
        **(s.audit or {}),
        **extra,
    }
    names = {"piston": 0, "tilt": 1, "power": 2}
    rigid = Unobservable(
        "surface", "polynomial", tuple(names[f] for f in settings.freedoms), _RIGID
    )
    step = Step(
        "stitch",
        {
            "n": len(pieces),
            "freedoms": list(settings.freedoms),
            "reference": settings.fit_reference,
        },
    )
    return Separation(
        "stitch",
        parts,
        u,
        dict.fromkeys(parts, "m"),
        coordinates,
        (rigid, *s.unobservable),
        noise=_noise(s.noise, settings),
        audit=audit,
        messages=tuple(messages),
        history=(*pieces.history, step),
    )


def _noise(noise: tuple[float, float], settings: Settings) -> Quantity:
    if settings.u_reading is not None:
        return as_stated(settings.u_reading, "m")
    text = f"standard deviation of one reading, from the overlaps (type A, {noise[1]:.0f} d.o.f.)"
    u = noise[0] / math.sqrt(2.0 * noise[1]) if noise[1] >= 1.0 else None
    return Quantity(noise[0], "m", text, u=u, symbol="s")


def _refuse_mirrored(
    pieces: Pieces, problem: Problem, residuals: FloatArray, bad: list[int]
) -> None:
    suspects = {i for k in bad for i in (problem.overlaps[k].i, problem.overlaps[k].j)}
    if not suspects:
        rough = math.sqrt(sum(float(np.nanvar(v)) for v in pieces.values) / len(pieces))
        if float(residuals.max()) <= 0.3 * rough:
            return
        suspects = set(range(len(pieces)))
    found = mirrored_piece(pieces, problem.layout, problem.overlaps, suspects)
    if found is not None:
        raise DataError(
            f"stitch: {pieces.kind} {found[0] + 1} fits its neighbours only when {found[1]}; turn it "
            "round, or correct its position, before stitching"
        )


def _outlier_messages(problem: Problem, residuals: FloatArray, bad: list[int]) -> list[str]:
    if not bad:
        return []
    median = float(np.median(residuals))
    messages = [
        f"overlap of {problem.overlaps[k].i + 1} and {problem.overlaps[k].j + 1}: mismatch "
        f"{residuals[k] * 1e9:.3g} nm, the median of all is {median * 1e9:.3g} nm"
        for k in bad[:6]
    ]
    if len(bad) > 6:
        messages.append(f"{len(bad) - 6} further overlaps do not fit")
    counts: dict[int, int] = {}
    for k in bad:
        for i in (problem.overlaps[k].i, problem.overlaps[k].j):
            counts[i] = counts.get(i, 0) + 1
    worst = max(counts, key=lambda i: counts[i])
    if counts[worst] > 1:
        messages.append(
            f"sub-aperture {worst + 1} is in {counts[worst]} of these: its position, its measurement "
            'or the part changed; registration="fit" finds a lateral shift'
        )
    return messages


# ---- overlaps that disagree by more than noise: is it shown, and which other set-up would fit ----

_ALIKE = 0.6
"""Correlation of neighbouring mismatches; white noise has 0, interpolated noise up to 0.4."""

_ALIKE_ON_PIXELS = 0.3
"""The same where nothing was interpolated; instruments that smooth have up to about this."""

_LEAST_OF_ONE = 200
"""Pairs of neighbours for which a single overlap is judged: 0.6 is then 8 standard deviations."""

_CHANCE = 4.0
"""Standard deviations of the correlation of white noise that are not evidence."""

_LEAST_SHARE = 0.02
"""Of the structure in the overlaps: what interpolation of a rough part leaves is less."""

_LEAST_SAMPLES = 30
_BETTER = 0.5
_COARSE = 48
"""Pixels along the longer side on which other set-ups are tried."""

_TURNS = {
    "with the sign of x of the positions reversed": ((-1, 0), (0, 1)),
    "with the sign of y of the positions reversed (or the rows of each map in the other order)": (
        (1, 0),
        (0, -1),
    ),
    "with the signs of x and y of the positions reversed": ((-1, 0), (0, -1)),
    "with x and y of the positions exchanged": ((0, 1), (1, 0)),
    "with x and y of the positions exchanged and the sign of the new y reversed": (
        (0, 1),
        (-1, 0),
    ),
    "with x and y of the positions exchanged and the sign of the new x reversed": (
        (0, -1),
        (1, 0),
    ),
    "with x and y of the positions exchanged and both signs reversed": ((0, -1), (-1, 0)),
}


def setup_warnings(
    pieces: Pieces,
    problem: Problem,
    fitted: list[FloatArray],
    freedoms: tuple[str, ...],
    *,
    beyond_stated: bool,
    named: bool,
) -> list[str]:
    """Return what is to be said where the overlaps disagree by more than noise."""
    alike, share = likeness(problem, fitted)
    structured = alike > _ALIKE and share > _LEAST_SHARE
    if not (beyond_stated or structured):
        return []
    found = better_setup(pieces, freedoms)
    if found is not None:
        how, ratio = found
        times = f"{1 / ratio:.2g}" if ratio > 0.01 else "over 100"
        text = (
            f"the overlaps disagree by more than noise, and fit {times} times better {how}: the "
            "set-up is likely wrong, and u does not cover it"
        )
        return [text]
    if named or not structured:
        return []
    text = (
        "the overlaps disagree by more than noise (neighbouring mismatches are alike): positions, "
        "signs, rotations, drift or the instrument's reference do not fit, and u does not cover it"
    )
    return [text]


def likeness(problem: Problem, fitted: list[FloatArray]) -> tuple[float, float]:
    """Return the correlation of neighbouring mismatches, and their RMS over that of the surface.

    The correlation is that of all overlaps, or of the worst one; on pixels, where noise has none,
    it is scaled so that one limit serves.
    """
    product, size, squares, structure, n, worst = 0.0, 0.0, 0.0, 0.0, 0, 0.0
    for o in problem.overlaps:
        a, b = problem.layout.placed[o.i], problem.layout.placed[o.j]
        both = a.valid[o.in_i] & b.valid[o.in_j]
        z = np.where(both, fitted[o.i][o.in_i], 0.0)
        d = np.where(both, z - fitted[o.j][o.in_j], 0.0)
        squares, structure = squares + float(np.vdot(d, d)), structure + _rough(z, both)
        own_product, own_size, own_n = 0.0, 0.0, 0
        d2 = d * d
        for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            own_product += float(np.vdot(d[first], d[second]))  # zero where not both measured
            own_size += 0.5 * float(
                (d2[first] * both[second]).sum() + (d2[second] * both[first]).sum()
            )
            own_n += int(np.count_nonzero(both[first] & both[second]))
        product, size, n = product + own_product, size + own_size, n + own_n
        if own_n >= _LEAST_OF_ONE and own_size > 0.0:
            worst = max(worst, own_product / own_size)
    if n < _LEAST_SAMPLES or size <= 0.0 or structure <= 0.0:
        return 0.0, 0.0
    alike = max(product / size - _CHANCE / math.sqrt(n), 0.0)
    if not any(p.operator for p in problem.layout.placed):
        alike = min(alike * _ALIKE / _ALIKE_ON_PIXELS, 1.0)
    return max(alike, worst), math.sqrt(squares / structure)


def _rough(z: FloatArray, both: NDArray[np.bool_]) -> float:
    """Return the sum of squares about a plane: the whole may lie in space as it likes."""
    rest = without_own_plane(z, both)
    return float(np.vdot(rest, rest))


def better_setup(pieces: Pieces, freedoms: tuple[str, ...]) -> tuple[str, float] | None:
    """Return the other set-up that fits best, if it fits at least twice as well."""
    coarse = _coarse(pieces)
    given = _mismatch(coarse, freedoms)
    if given is None or given[0] <= 0.0:
        return None
    best: tuple[str, float] | None = None
    for how, other in _others(coarse):
        found = _mismatch(other, freedoms)
        if found is None or found[1] < 0.3 * given[1]:
            continue
        ratio = max(found[0] / given[0], 1e-9)
        if ratio < _BETTER and (best is None or ratio < best[1]):
            best = (how, ratio)
    return best


def _others(pieces: Pieces) -> Iterator[tuple[str, Pieces]]:
    origin = pieces.corners[0]
    for how, turn in _TURNS.items():
        if pieces.line and "sign of x of" not in how:
            continue
        corners = origin + (pieces.corners - origin) @ np.array(turn, dtype=np.float64).T
        if not np.array_equal(corners, pieces.corners):
            yield how, replace(pieces, corners=corners)
    if np.any(pieces.turns != 0.0):
        yield "with the sign of the rotations reversed", replace(pieces, turns=-pieces.turns)
    if pieces.known is not None:
        values = tuple(v + 2.0 * pieces.known for v in pieces.values)
        yield "with the sign of the known reference reversed", replace(pieces, values=values)


def _coarse(pieces: Pieces) -> Pieces:
    """Return every q-th pixel, q odd, of windows about the same centres."""
    longest = max(max(v.shape) for v in pieces.values)
    shortest = longest if pieces.line else min(min(v.shape) for v in pieces.values)
    q = 2 * (min(longest // _COARSE, shortest // 8) // 2) + 1
    if q == 1:
        return pieces
    values, corners = [], pieces.corners.copy()
    known = pieces.known
    for k, v in enumerate(pieces.values):
        rows = np.s_[0:1] if pieces.line else _every(v.shape[0], q)
        columns = _every(v.shape[1], q)
        values.append(v[rows, columns])
        corners[k] += [columns.start * pieces.dx, rows.start * pieces.dy]
        if k == 0 and known is not None:
            known = known[rows, columns]
    dy = pieces.dy if pieces.line else q * pieces.dy
    return replace(
        pieces, values=tuple(values), corners=corners, dx=q * pieces.dx, dy=dy, known=known
    )


def _every(n: int, q: int) -> slice:
    cut = next(j for j in range(q) if (n - 1 - 2 * j) % q == 0)
    return slice(cut, n - cut, q)


def _mismatch(pieces: Pieces, freedoms: tuple[str, ...]) -> tuple[float, float] | None:
    """Return the noise that the overlaps show, and its degrees of freedom."""
    try:
        problem, inverse, values = connected(pieces, freedoms)
    except MetrosepError:
        return None
    _, fitted, mean = fitted_to(problem, inverse, values)
    noise, freedom = noise_of(problem, fitted, mean, inverse.rank)
    return (noise, freedom) if freedom >= _LEAST_SAMPLES else None
