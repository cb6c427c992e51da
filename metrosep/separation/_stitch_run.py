"""One stitching from checked sub-apertures to a `Separation`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._overlaps import (
    mirrored_piece,
    outlying_pairs,
    overlaps_of,
    pair_residuals,
    require_connection,
)
from metrosep.separation._stitch_doubts import setup_doubts
from metrosep.separation._stitch_grid import layout_of
from metrosep.separation._stitch_input import Pieces
from metrosep.separation._stitch_models import (
    Settings,
    Solution,
    n_rigid,
    plain_problem,
    with_pixels,
    with_polynomial,
    without_reference,
)
from metrosep.separation._stitch_solve import (
    Problem,
    inverse_of,
    normal_matrix,
    own_residuals,
    require_rank,
)
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import Unobservable

_RIGID = "how the whole lies in space is arbitrary; it was removed by least squares"


def run(pieces: Pieces, settings: Settings, extra: dict[str, Any]) -> Separation:
    """Return the stitched surface."""
    layout = layout_of(pieces)
    overlaps = overlaps_of(layout)
    problem = plain_problem(layout, overlaps, settings.freedoms, line=pieces.line)
    require_connection(overlaps, len(pieces), least=problem.columns[0].size + 1)
    values = [p.values for p in layout.placed]
    inverse = inverse_of(normal_matrix(problem))
    require_rank(inverse, problem, n_rigid(settings.freedoms, line=pieces.line))
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
    messages = [*pieces.doubts, *extra.pop("messages", ()), *s.messages]
    messages += _outlier_words(problem, shown, bad)
    stated = settings.u_reading
    messages += setup_doubts(
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
        text = "standard uncertainty of one reading, as stated"
        return Quantity(settings.u_reading, "m", text, symbol="s")
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


def _outlier_words(problem: Problem, residuals: FloatArray, bad: list[int]) -> list[str]:
    if not bad:
        return []
    median = float(np.median(residuals))
    words = [
        f"overlap of {problem.overlaps[k].i + 1} and {problem.overlaps[k].j + 1}: mismatch "
        f"{residuals[k] * 1e9:.3g} nm, the median of all is {median * 1e9:.3g} nm"
        for k in bad[:6]
    ]
    if len(bad) > 6:
        words.append(f"{len(bad) - 6} further overlaps do not fit")
    counts: dict[int, int] = {}
    for k in bad:
        for i in (problem.overlaps[k].i, problem.overlaps[k].j):
            counts[i] = counts.get(i, 0) + 1
    worst = max(counts, key=lambda i: counts[i])
    if counts[worst] > 1:
        words.append(
            f"sub-aperture {worst + 1} is in {counts[worst]} of these: its position, its measurement "
            'or the part changed; registration="fit" finds a lateral shift'
        )
    return words
