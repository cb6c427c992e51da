"""The reference map that all sub-apertures share, pixel by pixel: what links, solution, scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotSeparableError
from metrosep.separation._stitch_iteration import ReferenceSystem
from metrosep.separation._stitch_solve import (
    Inverse,
    Problem,
    fitted_pieces,
    mean_of,
    right_side,
)

LabelArray = NDArray[np.int64]

_LEAST_GROUP = 8
"""Pixels that a group of linked pixels must hold to be kept."""

_NO_MODE = 1e-5
"""Share of a mode left by the means of the groups, below which it was only a sum of them."""

_RESOLVED = 0.02
"""Error of a random reference, for its size, beyond which a pixel is not determined."""

_OF_DRAWS = 1e-4
"""The same for simulated noise: u changes by less than 1 % against 1e-6."""


@dataclass(frozen=True, slots=True)
class Links:
    """Groups of the instrument's pixels that overlaps link; between groups nothing is compared."""

    # shape (n_y, n_x): group of each pixel of the instrument; -1 where it is in none
    instrument: LabelArray
    surface: LabelArray  # shape (grid): group of each pixel of the stitched grid
    n_groups: int  # how many


def links_of(problem: Problem, shape: tuple[int, int], kind: str) -> Links:
    """Return which pixels of the instrument the overlaps link."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    n_inst, n_all = shape[0] * shape[1], problem.weight.size
    instrument, grid = [], []
    index = np.arange(n_all).reshape(problem.weight.shape)
    rows, columns = np.divmod(np.arange(n_inst, dtype=np.float64).reshape(shape), shape[1])
    for p in problem.layout.placed:
        r, c = np.rint(p.forward(rows)).astype(int), np.rint(p.forward(columns)).astype(int)
        instrument.append((r * shape[1] + c)[p.valid])
        grid.append(index[p.rows, p.columns][p.valid])
    a, b = np.concatenate(instrument), np.concatenate(grid) + n_inst
    graph = sparse.coo_matrix(
        (np.ones(a.size, dtype=np.int8), (a, b)), shape=(n_inst + n_all,) * 2
    )
    _, labels = connected_components(graph, directed=False)
    size = np.bincount(labels[:n_inst], minlength=labels.max() + 1)
    measured = np.zeros(n_inst, dtype=bool)
    measured[a] = True
    big = size >= _LEAST_GROUP
    new = np.where(big, np.cumsum(big) - 1, -1)
    n_groups = int(big.sum())
    if n_groups == 0:
        raise NotSeparableError(
            f"stitch: no pixel of the reference is compared with enough others: the {kind}s were "
            "shifted by one step size only, so any error that repeats with it looks like the part. "
            "Measure with a second step size (no multiple of the first), or a turned sub-aperture, "
            'or fit a polynomial: reference_degree=4, or take reference="none"'
        )
    of_inst = np.where(measured, new[labels[:n_inst]], -1).reshape(shape)
    of_all = new[labels[n_inst:]].reshape(problem.weight.shape)
    of_all = np.where(problem.weight > 0.0, of_all, -1)
    return Links(of_inst.astype(np.int64), of_all.astype(np.int64), n_groups)


def without_modes(values: FloatArray, labels: LabelArray, modes: FloatArray) -> FloatArray:
    """Return values without the mean of each group and without smooth modes, least squares."""
    inside = (labels >= 0) & np.isfinite(values)
    out = np.full(values.shape, np.nan)
    if not inside.any():
        return out
    group = labels[inside]
    y = _group_centred(values[inside], group)
    whole = np.stack([m[inside] for m in modes], axis=1)
    b = np.stack([_group_centred(m, group) for m in whole.T], axis=1)
    directions, size, _ = np.linalg.svd(b, full_matrices=False)
    kept = directions[:, size > _NO_MODE * np.linalg.norm(whole, axis=0).max()]
    out[inside] = y - kept @ (kept.T @ y)
    return out


def resolved(
    problem: Problem,
    inverse: Inverse,
    system: ReferenceSystem,
    links: Links,
    modes: tuple[FloatArray, FloatArray],
) -> Links:
    """Return the groups without pixels at which random references do not come back."""
    instrument, surface = links.instrument, links.surface
    for readings, truth, found in system.probes():
        instrument = _agreeing(found - truth, instrument, modes[0])
        error = surface_with(problem, inverse, readings, found)
        surface = _agreeing(np.nan_to_num(error), surface, modes[1])
    return Links(instrument, surface, links.n_groups)


def _agreeing(error: FloatArray, labels: LabelArray, modes: FloatArray) -> LabelArray:
    """Return labels without errors; they pull at the removed modes, so the worst go first."""
    while (labels >= 0).any():
        rest = np.abs(without_modes(error, labels, modes))
        wrong = rest > max(_RESOLVED, 4.0 * float(np.nanmedian(rest)))
        if not wrong.any():
            break
        labels = np.where(wrong, -1, labels)
    return labels


def scatter(
    problem: Problem,
    inverse: Inverse,
    system: ReferenceSystem,
    links: Links,
    modes: tuple[FloatArray, FloatArray],
    draws: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviation of reference and surface for noise of one, by simulation."""
    rng = np.random.default_rng(0)
    of_r, of_s = np.zeros(system.shape), np.zeros(problem.weight.shape)
    for _ in range(draws):
        noise = [p.forward(rng.standard_normal(system.shape)) for p in problem.layout.placed]
        r = system.solve(system.left(noise), _OF_DRAWS)
        s = surface_with(problem, inverse, noise, r)
        of_r += np.nan_to_num(without_modes(r, links.instrument, modes[0])) ** 2
        of_s += np.nan_to_num(without_modes(s, links.surface, modes[1])) ** 2
    smooth = _smooth_root(of_r, links.instrument >= 0, draws)
    if draws > 0:
        alone = system.weak & ~np.isnan(smooth)
        smooth[alone] = np.sqrt(of_r[alone] / draws)
    return (
        smooth,
        _smooth_root(of_s, links.surface >= 0, draws),
    )


def surface_with(
    problem: Problem, inverse: Inverse, values: list[FloatArray], reference: FloatArray
) -> FloatArray:
    """Return the mean of readings without a reference and their freedoms."""
    rest = [v - p.forward(reference) for p, v in zip(problem.layout.placed, values, strict=True)]
    theta = inverse.matrix @ right_side(problem, rest, mean_of(problem, rest))
    return mean_of(problem, fitted_pieces(problem, rest, theta))


def _group_centred(values: FloatArray, group: LabelArray) -> FloatArray:
    count = np.bincount(group)
    total = np.bincount(group, weights=values)
    mean = np.divide(total, count, out=np.zeros(total.shape), where=count > 0)
    return np.asarray(values - mean[group])


def _smooth_root(squares: FloatArray, inside: NDArray[np.bool_], draws: int) -> FloatArray:
    from scipy.ndimage import uniform_filter

    if draws == 0:
        return np.full(squares.shape, np.nan)
    size = tuple(min(5, n) for n in squares.shape)
    share = uniform_filter(inside.astype(np.float64), size, mode="constant")
    mean = uniform_filter(np.where(inside, squares / draws, 0.0), size, mode="constant")
    out = np.full(squares.shape, np.nan)
    out[inside] = np.sqrt(np.maximum(mean[inside] / np.maximum(share[inside], 1e-12), 0.0))
    return out
