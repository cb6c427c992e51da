"""Which errors of a machine explain a measured part: the inverse of `metrosep.machine.ranking`.

The alignment of the measurement is fitted along with the terms. It starts from the closed-form
Jacobian and ends with the exact model (the part that a machine with those errors cuts). What the
map cannot determine is named and NaN: terms that look like the alignment, and terms that look like
each other. `error = actual - nominal`; the amount of a term is what the machine did.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotConvergedError, TooFewSamplesError
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.conic import Plane
from metrosep.machine._measured import Measured, map_noise, measured_points
from metrosep.machine._mesh import Positions, axis_positions, checked_place
from metrosep.machine._responses import (
    OWN,
    MapMaker,
    Solution,
    Solver,
    common_map,
    span_of,
    unit_columns,
)
from metrosep.machine.alignment import alignment_space, freedom_maps, removed_freedoms
from metrosep.machine.elements import term_unit
from metrosep.machine.gram import aligned_gram, check_threshold
from metrosep.machine.sensitivity import amount_text, plain_rows
from metrosep.machine.terms import TrialAmounts

if TYPE_CHECKING:
    import pandas as pd

    from metrosep.machine.calibration import Calibration

_STEPS = 20

_HARDLY = 0.05
"""Of a common map: a term with less in it is not what made the map."""

_WHITE = 1.3
"""Times the uncertainty of white noise: from here on a message says that the residual is not."""

_ORDERS = 6
"""Legendre orders over the travel of a slide that a curve may have."""

_BLOCKS = 32
"""Along a side of a map: its blocks show six orders, and the noise of the pixels averages out."""

_PER_BLOCK = 4
"""Scattered points in a block on average, so that hardly one is empty."""

_CHANCE = 1e-4
"""Of a message where there is noise alone: far below 1 %, because the noise is a model, too."""

_ALIKE = 0.9
"""Of what the best curve explains: another that explains as much cannot be distinguished from it."""

_LARGEST = 0.01
"""Of the radius of the part (for an angle: rad): no slide that still turns parts moves by so much
beside its line. Six orders of a motion that this part hardly feels would imitate any pattern."""

_SEEN = 1e-12
"""m; a smaller pattern is rounding, no instrument shows it."""

_SMALL = 1e-6
"""Of the uncertainty: a step this small ends the iteration."""


def identify(
    chain: Any,
    surface_map: Any,
    *,
    curves: Mapping[str, int | str] | None = None,
    form: Any = None,
    terms: Iterable[str] | None = None,
    removed: str | Iterable[str] = ("piston", "tilt"),
    radius: float | None = None,
    inner_radius: float = 0.0,
    centre: tuple[float, float] | None = None,
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0),
    positions: Positions | None = None,
    threshold: float = 0.9,
    exact: bool = True,
    max_points: int = 100_000,
) -> Identification | Calibration:
    """Find the error terms that explain a measured map, or curves that explain one or several.

    Parameters
    ----------
    chain : Chain
        The machine that cut the part.
    surface_map : Surface or tuple of three array_like (x, y, z), m
        Measured heights; NaN = not measured. Heights, not deviations: the form is taken off here.
        With `curves` a list of maps too, one of each part; the azimuth must be as it was cut.
    curves : mapping of str to int or "auto", optional
        Terms that are curves over the travel of their axis, and how many orders (linear axis) or
        harmonics (spindle) each may have: ``{"EZX": 6, "EZC": 3}``; with "auto" as many as foretell
        what is omitted from the maps best (cross-validation).
    form : Form, optional
        Nominal surface, with its origin on the axis of the part; a plane if omitted. With several
        maps a list, one for each.
    terms : iterable of str, optional
        Terms that may be at work; all of the chain if omitted. With `curves` the constants that may
        be at work beside them; none if omitted.
    removed : str or iterable of str, optional
        Freedoms of the alignment, fitted along; as in `metrosep.machine.ranking.rank`.
    radius, inner_radius : float, m, optional
        Points between them are used; all if omitted.
    centre : tuple of (float, float), m, optional
        Axis of the part in the coordinates of the map; the middle of what was measured if its
        origin was not declared (0, 0), else zero.
    tool : tuple of (float, float, float), m, optional
        Tool point in the frame of the last element of the tool branch.
    positions : callable or mapping of str to float or str, optional
        As in `metrosep.machine.ranking.rank`.
    threshold : float, optional
        Of ``|r|``: terms more alike are reported together. Nearer to 1 they are distinguished, with the
        uncertainty that this costs.
    exact : bool, optional
        Whether the exact model ends the fit; else it stays linear.
    max_points : int, optional
        Larger maps are thinned to every second, third, ... row and column.

    Returns
    -------
    Identification or Calibration
        Amounts with standard uncertainty, groups, what cannot be seen, residual. With `curves` a
        `Calibration`: ``found["EZX"].evaluate(x)`` and ``.sd(x)``.

    Raises
    ------
    DataError
        If a term or freedom is unknown, the map has no lateral calibration or no term can be seen.
    InvalidSamplesError
        If coordinates do not fit or are not finite.
    NotConvergedError
        If the iteration does not settle.
    TooFewSamplesError
        If there are fewer than twice as many points as unknowns.

    Notes
    -----
    Least squares over the points, each with equal weight, on maps scaled to unit size; directions
    below 1e-5 of the largest singular value are not determined (as in `calibrate`), and terms with a part in them are
    reported together. Uncertainties come from the residual. Of a map, the likeness of points over
    their distance is modelled by white noise and Gaussian bells of growing width, fitted to the
    sums of products of the residual, with what the fit took away accounted for; the covariance of
    the terms is that of the estimator in this noise, and never below that of white noise. A message
    says where it lies well above. Scattered points (1-D arrays) are taken as independent. A
    systematic error that looks like a term is in that term all the same. Turns about x and y are
    fitted to first order.

    With `curves` the model is linear, each part has its own alignment and its own constant of each
    slide (setting of the tool); `threshold` and `exact` have no use then. See the page on errors from a measured part.

    Examples
    --------
    >>> from metrosep.forms import Toric
    >>> from metrosep.machine.chains import presets
    >>> lathe, form = presets("fts_lathe", radius=20e-3), Toric(Rb=0.265, Rd=0.1325)
    >>> x = np.linspace(-14e-3, 14e-3, 60)
    >>> rho = np.hypot(x, x[:, None])
    >>> squareness = -2e-5 * (20e-3 - rho)  # B0Z = 20 urad: a cone
    >>> z = form(x, x[:, None]) + squareness
    >>> found = identify(lathe, Surface(z, dx=x[1] - x[0], dy=x[1] - x[0]), form=form,
    ...                  terms=["B0Z", "EXX", "EZX"])
    >>> round(found["B0Z"].value, 9), found.unobservable
    (2e-05, ('EZX',))
    """
    several = isinstance(surface_map, list | tuple) and any(
        isinstance(m, Surface) for m in surface_map
    )
    if curves is not None or several:
        from metrosep.machine._part_curves import curves_of_parts

        return curves_of_parts(
            chain, list(surface_map) if several else [surface_map], form, curves, terms=terms or (),
            removed=removed, tool=checked_place(tool), positions=positions, radius=radius,
            inner_radius=inner_radius, centre=centre, max_points=max_points,
        )  # fmt: skip
    names = chain.known_terms(chain.terms if terms is None else tuple(terms))
    if not names:
        raise DataError(f"terms names no error term; known are {', '.join(chain.terms)}")
    if len(set(names)) < len(names):
        raise DataError("terms names a term twice")
    check_threshold(threshold)
    freedoms = removed_freedoms(removed)
    place = checked_place(tool)
    points = measured_points(
        surface_map,
        Plane() if form is None else form,
        radius=radius,
        inner_radius=inner_radius,
        centre=centre,
        max_points=max_points,
    )
    need = 2 * (len(names) + len(freedoms))
    if points.z.size < need:
        raise TooFewSamplesError(
            f"{points.z.size} valid points for {len(names)} terms and {len(freedoms)} freedoms; "
            f"at least {need} are needed"
        )
    maker = MapMaker(chain, points.mesh, names, "form", "vertical", place, positions, None)
    solver = _solver(maker, freedoms, threshold)
    furthest = float(points.mesh.rho[-1])
    model = CutModel(chain, points.mesh.form, place, positions, exact=True, reach=furthest)
    solution, left, used = _fit(solver, model, points, exact=exact)
    hidden = _curves_left(solver, maker, points, left, used)
    found = _result(solver, solution, left, used, points, surface_map, form is None, hidden, exact)
    return replace(found, messages=(*getattr(chain, "messages", ()), *found.messages))


def _solver(maker: MapMaker, freedoms: tuple[str, ...], threshold: float) -> Solver:
    """Return the linear problem on the points; terms without effect are set aside."""
    mesh = maker.mesh
    scales = np.where([n.startswith(("shift", "rotation_z")) for n in freedoms], 1e-6, 0.0)
    columns = maker.freedoms(freedoms)
    scales = scales * np.where([n == "rotation_z" for n in freedoms], float(mesh.rho[-1]), 1.0)
    space = alignment_space(freedoms, columns, mesh.weights, scales=scales)
    maps = maker.make()
    gram = aligned_gram(maps, space)
    if gram.is_removed.all():
        raise DataError(
            f"the map shows nothing of {', '.join(maker.terms)}: the alignment "
            f"({', '.join(space.used) or 'none'}) takes it, or they do nothing to this part"
        )
    units = tuple(term_unit(maker.chain, n) for n in maker.terms)
    return Solver(maker.terms, maps, columns, space, gram, threshold, units)


def _fit(
    solver: Solver, model: CutModel, points: Measured, *, exact: bool
) -> tuple[Solution, FloatArray, NDArray[np.bool_]]:
    """Return the solution, the residual at the points, and which points were used."""
    everything = np.ones(points.z.size, dtype=bool)
    nominal = points.mesh.z
    solution = solver.solve(points.z - nominal, everything)
    left = points.z - nominal - solver.effect(solution)
    if not exact:
        return solution, left, everything
    # away from the centre, where neighbours do not change places
    moved = model.error(points.mesh.x, points.mesh.y, solution.errors())
    reach = float(np.nanmax(np.hypot(moved[:, 0], moved[:, 1]), initial=0.0))
    used = np.asarray(np.hypot(points.mesh.x, points.mesh.y) > 20.0 * reach)
    total = solution
    # heights of a deep part round: steps of that size never end
    rounding = 4.0 * float(np.finfo(float).eps * np.abs(points.z).max()) + 1e-18
    for _ in range(_STEPS):
        seen = model.seen(points.mesh.x, points.mesh.y, total.errors(), total.freedoms(solver))
        left = points.z - seen
        used &= np.isfinite(left)
        if used.sum() < 2 * (solution.rank + len(solver.space.used)):
            raise TooFewSamplesError(
                f"{int(used.sum())} points are left where the errors found do not mix up the part; "
                "are the heights in m, and is the form the right one?"
            )
        step = solver.solve(np.where(used, left, 0.0), used)
        total = total.plus(step)
        noise = float(np.sqrt(np.mean(left[used] ** 2)))
        if solver.size_of(step) <= _SMALL * noise / np.sqrt(used.sum()) + rounding:
            return total, left, used
    raise NotConvergedError(
        f"the exact fit did not settle in {_STEPS} steps; give fewer terms, or exact=False"
    )


def _result(
    solver: Solver,
    solution: Solution,
    left: FloatArray,
    used: NDArray[np.bool_],
    points: Measured,
    source: Any,
    no_form: bool,
    curves: _CurvesLeft,
    exact: bool,
) -> Identification:
    n = int(used.sum())
    residual: Any = points.on_map(np.where(used, left, np.nan))
    residual.setflags(write=False)
    if isinstance(source, Surface):
        residual = replace(source, z=residual, history=(*source.history, Step("identify")))
    names = solver.names
    spread, inflation, noise = _uncertainty(solver, left[used], used, points)
    m = len(solver.visible)
    cov, freedom_u = spread[:m, :m], np.sqrt(np.diag(spread)[m:])
    values, u = np.full(len(names), np.nan), np.full(len(names), np.nan)
    grouped = {i for g in solver.groups for i in g}
    moved = curves.lines | (np.abs(curves.shifts) > np.sqrt(np.diag(cov)))
    for k, i in enumerate(solver.visible):
        if i not in grouped and not moved[k]:
            values[i] = solution.scaled[k] / solver.sizes[k]
            u[i] = np.sqrt(cov[k, k]) / solver.sizes[k]
    amounts = solution.scaled / solver.sizes
    covariance = cov / np.outer(solver.sizes, solver.sizes)
    before = solver.space.remove(points.z - points.mesh.z)
    after = float(np.sqrt(np.mean(left[used] ** 2)))
    added = float(np.sum(solver.correlation * cov))
    seen_names = tuple(names[i] for i in solver.visible)
    for array in (values, u, covariance):
        array.setflags(write=False)
    audit = {
        "n_points": n,
        "n_not_used": points.n_given - n,
        "rank": solution.rank,
        "threshold": solver.threshold,
        "removed": solver.space.names,
        "dropped": solver.space.dropped,
        "inflation": inflation,
        "curves": tuple(name for name, _, _ in curves.found),
        **noise,
        "stride": points.stride,
        "centre_mm": tuple(1e3 * c for c in points.centre),
    }
    return Identification(
        names=names,
        units=solver.units,
        values=values,
        u=u,
        groups=tuple(_group(solver, solution, cov, g, moved) for g in solver.groups),
        unobservable=tuple(names[i] for i in range(len(names)) if i not in solver.visible),
        estimate=freeze_mapping(dict(zip(seen_names, amounts.tolist(), strict=True))),
        covariance=covariance,
        freedoms=freeze_mapping(
            {
                name: (float(v), float(s))
                for name, v, s in zip(solver.space.used, solution.amounts, freedom_u, strict=True)
            }
        ),
        sq_before=float(np.sqrt(np.mean(before[used] ** 2))),
        sq_after=after,
        predicted_sq=float(np.sqrt(after**2 + added)),
        residual=residual,
        audit=freeze_mapping(audit),
        messages=(
            *_about_curves(curves, solver, solution, moved, exact),
            *_messages(solver, points, used, inflation, no_form),
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _CurvesLeft:
    """Curves that the residual holds: (name, P-V in m or rad, what looks alike), strongest first.

    `shifts` (p,): what the scaled amounts of the visible terms change by with them fitted along;
    `lines` (p,): whether a term is the line or the constant of one of them.
    """

    found: tuple[tuple[str, float, tuple[str, ...]], ...]
    shifts: FloatArray
    lines: NDArray[np.bool_]


def _curves_left(
    solver: Solver, maker: MapMaker, points: Measured, left: FloatArray, used: NDArray[np.bool_]
) -> _CurvesLeft:
    """Return which error motions run over their travel in a way that constants do not describe.

    Each candidate, freed of terms and freedoms, is tested by F against the noise that is left when
    it is fitted: white noise first, then noise that is alike over distance. The strongest joins the
    model, until none is significant.
    """
    from scipy.special import fdtrc

    means, place, shape = _block_means(points, used)
    terms = solver.maps[:, solver.visible] / solver.sizes
    base, base_sizes = unit_columns(means(np.hstack([terms, solver.used_freedoms()])[used]))
    within = plain = span_of(base)
    start = means(left[used][:, None])[:, 0]
    start = rest = start - plain @ (plain.T @ start)
    columns, curves, lower = {}, {}, {}
    for name, maps, functions in _candidates(maker, points, used):
        block, sizes = unit_columns(means(maps))
        keep = unit_columns(block - plain @ (plain.T @ block))[1] > OWN
        if keep.any():
            lower[name] = block[:, ~keep]
            columns[name], curves[name] = block[:, keep], functions[:, keep] / sizes[keep]
    m = len(solver.visible)
    reach = float(points.mesh.rho[-1])
    found: list[tuple[str, float, tuple[str, ...]]] = []
    chosen: list[FloatArray] = []
    while True:
        explained = {}
        for name, block in columns.items():
            own = span_of(block - within @ (within.T @ block))
            amounts = own.T @ rest
            size = float(amounts @ amounts)
            lost = rest - own @ amounts
            k, free = own.shape[1], rest.size - within.shape[1] - own.shape[1]
            if free < rest.size / 2 or size <= rest.size * _SEEN**2:
                continue
            white = float(lost @ lost) / free + _SEEN**2
            chance = fdtrc(k, free, size / (k * white))
            if chance * len(columns) < _CHANCE:
                noise = map_noise(lost, np.hstack([within, own]), place, shape).covariance(own)
                noise += _SEEN**2 * np.eye(k)
                chance = fdtrc(k, free, float(amounts @ np.linalg.solve(noise, amounts)) / k)
            if chance * len(columns) < _CHANCE:
                explained[name] = size
        spans: dict[str, tuple[float, float]] = {}
        for n in explained:
            own = columns[n] - within @ (within.T @ columns[n])
            pv = float(np.ptp(curves[n] @ np.linalg.lstsq(own, rest, rcond=OWN)[0]))
            spans[n] = pv, pv * (reach if n[1] in "ABC" else 1.0)
        explained = {n: v for n, v in explained.items() if spans[n][1] <= _LARGEST * reach}
        if not explained:
            break
        top = max(explained.values())
        same = [n for n, size in explained.items() if size > _ALIKE * top]
        name, *alike = sorted(same, key=lambda n: spans[n][1])  # the smallest that does it
        found.append((name, spans[name][0], tuple(alike)))
        chosen.append(columns.pop(name))
        within = span_of(np.hstack([within, chosen[-1]]))
        rest = rest - within @ (within.T @ rest)
    if not found:
        return _CurvesLeft((), np.zeros(m), np.zeros(m, dtype=bool))
    # what the curves hold of terms and freedoms goes over to those
    together = np.hstack(chosen)
    along = np.linalg.lstsq(together - plain @ (plain.T @ together), start, rcond=OWN)[0]
    taken = np.asarray(np.linalg.lstsq(base, together @ along, rcond=OWN)[0], dtype=np.float64)
    lines = np.linalg.lstsq(base, np.hstack([lower[n] for n, _, _ in found]), rcond=OWN)[0]
    share = np.abs(lines[:m]).max(axis=1, initial=0.0)
    return _CurvesLeft(tuple(found), (-taken / base_sizes)[:m], share > _HARDLY)


def _candidates(
    maker: MapMaker, points: Measured, used: NDArray[np.bool_]
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield error motions of slides that travel here: maps (n, k) of their curves, and the curves."""
    mesh, chain = points.mesh, maker.chain
    q = axis_positions(chain, mesh.x, mesh.y, mesh.z, positions=maker.positions, tool=maker.tool)
    legendre: Any = np.polynomial.legendre.legvander
    shown = legendre(np.linspace(-1.0, 1.0, 361), _ORDERS)[:, 1:]
    for e in chain.elements:
        here = q[e.name][used] if e.kind == "linear" and e.name in q else np.zeros(1)
        names = tuple(f"E{d}{e.name}" for d in e.errors or () if f"E{d}{e.name}" in chain.terms)
        travel = float(np.ptp(here))
        if not names or travel <= OWN * float(mesh.rho[-1]):
            continue
        at = 2.0 * (here - float(here.min())) / travel - 1.0
        over = legendre(at, _ORDERS)[:, 1:]
        unit = replace(maker, terms=names, shapes={}).make()[used]
        for k, name in enumerate(names):
            yield name, unit[:, k, None] * over, shown


def _block_means(
    points: Measured, used: NDArray[np.bool_]
) -> tuple[Callable[[FloatArray], FloatArray], NDArray[np.intp], tuple[int, int]]:
    """Return what averages columns over blocks, and where the blocks stand in their map.

    Blocks of a map hold as many pixels each, those of scattered points some points.
    """
    grid = points.on_thinned()
    if grid is None:
        at = np.stack([points.mesh.y[used], points.mesh.x[used]])
        side = int(min(max(np.sqrt(at.shape[1] / _PER_BLOCK), 1.0), _BLOCKS))
        span = np.maximum(np.ptp(at, axis=1), 1e-300)[:, None]
        row, column = np.minimum(
            (side * (at - at.min(axis=1)[:, None]) / span).astype(int), side - 1
        )
        block, shape = row * side + column, (side, side)
    else:
        side = -(-max(grid[1]) // _BLOCKS)
        row, column = np.divmod(grid[0][used], grid[1][1])
        shape = (-(-grid[1][0] // side), -(-grid[1][1] // side))
        block = row // side * shape[1] + column // side
    count = np.bincount(block)
    kept = np.flatnonzero(2 * count >= np.median(count[count > 0]))

    def means(columns: FloatArray) -> FloatArray:
        sums = [np.bincount(block, weights=c, minlength=count.size)[kept] for c in columns.T]
        return np.stack(sums, axis=1) / count[kept, None]

    return means, kept, shape


def _uncertainty(
    solver: Solver, left: FloatArray, used: NDArray[np.bool_], points: Measured
) -> tuple[FloatArray, float, dict[str, Any]]:
    """Return the covariance of scaled amounts and freedoms, how far beyond white, and the noise."""
    rows, basis, _ = solver.estimator(used)
    square = float(left @ left) / (left.size - basis.shape[1])
    white = rows.T @ rows * square
    grid = points.on_thinned()
    if grid is None:
        return white, 1.0, {"noise_widths_px": (0.0,), "noise_nm": (1e9 * float(np.sqrt(square)),)}
    place, shape = grid
    found = map_noise(left, basis, place[used], shape)
    cov = found.covariance(rows)
    floor = np.diag(white)
    # a residual that looks less than independent is not believed
    wider = np.sqrt(np.maximum(floor / np.maximum(np.diag(cov), 1e-300), 1.0))
    cov = cov * np.outer(wider, wider)
    known = floor > 0.0
    inflation = float(np.sqrt(np.max(np.diag(cov)[known] / floor[known], initial=1.0)))
    parts = [(w, v) for w, v in zip(found.widths, found.variances, strict=True) if v > 0.0]
    widths = tuple(w for w, _ in parts)
    noise = tuple(1e9 * float(np.sqrt(v)) for _, v in parts)
    return cov, inflation, {"noise_widths_px": widths, "noise_nm": noise}


def _group(
    solver: Solver,
    solution: Solution,
    cov: FloatArray,
    members: tuple[int, ...],
    moved: NDArray[np.bool_],
) -> IdentifiedGroup:
    """Return the common map of a group: its size, and each term's amount if it alone acted."""
    at = [solver.visible.index(i) for i in members]
    vector, strength = common_map(solver.correlation[np.ix_(at, at)])
    size = float(np.sqrt(strength) * vector @ solution.scaled[at])
    variance = float(strength * vector @ cov[np.ix_(at, at)] @ vector)
    u = float(np.sqrt(max(variance, 0.0)))
    alone = {}
    for k, i in enumerate(members):
        effect = float(np.sqrt(strength) * vector[k] * solver.sizes[at[k]])
        seen = abs(vector[k]) > _HARDLY and not moved[at].any()
        alone[solver.names[i]] = (size / effect, u / abs(effect)) if seen else (np.nan, np.nan)
    return IdentifiedGroup(
        tuple(solver.names[i] for i in members),
        size,
        u,
        freeze_mapping({n: (float(v), float(s)) for n, (v, s) in alone.items()}),
        float(strength) / len(members),
    )


def _about_curves(
    curves: _CurvesLeft, solver: Solver, solution: Solution, moved: NDArray[np.bool_], exact: bool
) -> Iterator[str]:
    """Yield what the reader must know of curves in the residual, and of the terms they shift."""
    for name, size, alike in curves.found:
        unit = "rad" if name[1] in "ABC" else "m"
        like = f"; {', '.join(alike)} would look alike" if alike else ""
        yield (
            f"the residual holds a curve of {name} over its travel ({amount_text(size, unit)} P-V"
            f"{like}): constants do not describe this part"
            + ("" if exact else ", or the errors are too large for exact=False")
        )
    grouped = {i for g in solver.groups for i in g}
    for k in np.flatnonzero(moved):
        i = solver.visible[k]
        amounts = np.array([solution.scaled[k], solution.scaled[k] + curves.shifts[k]])
        without, beside = (
            amount_text(float(v), solver.units[i]) for v in amounts / solver.sizes[k]
        )
        if i not in grouped:
            yield (
                f"{solver.names[i]}: not given, it depends on the curve: {without} without it, "
                f"{beside} with it"
            )
    for g in solver.groups:
        if moved[[solver.visible.index(i) for i in g]].any():
            yield (
                f"{', '.join(solver.names[i] for i in g)}: what each would be alone is not given, it "
                "depends on the curve"
            )


def _messages(
    solver: Solver, points: Measured, used: NDArray[np.bool_], inflation: float, no_form: bool
) -> tuple[str, ...]:
    found = list(points.notes)
    if no_form:
        found.append("no form was given: the part is taken as nominally plane")
    hidden = [solver.names[i] for i in range(len(solver.names)) if i not in solver.visible]
    if hidden:
        found.append(
            f"{', '.join(hidden)}: not visible; the alignment ({', '.join(solver.space.used)}) takes "
            "the effect, or there is none on this part"
        )
    found += [
        f"{', '.join(solver.names[i] for i in g)}: one part cannot distinguish them; they are known "
        "together"
        for g in solver.groups
    ]
    if solver.space.dropped:
        found.append(f"{', '.join(solver.space.dropped)}: moves this surface in no way of its own")
    core = int(used.size - used.sum())
    if core:
        found.append(f"{core} points at the centre or at the rim of the form were omitted")
    if points.stride > 1:
        found.append(f"every {points.stride}th row and column was used")
    if points.on_thinned() is None:
        found.append(
            "the points are scattered: how alike neighbours are is not known, and uncertainties "
            "hold for a white residual only; give a map where there is one"
        )
    if inflation > _WHITE:
        found.append(
            f"the residual is not white: uncertainties are up to {inflation:.1f} times those of "
            "white noise; an error that is not among the terms may be at work"
        )
    return tuple(found)


# ---- the part that a machine with errors cuts, exactly, and as an instrument sees it -----------
# A point that should lie at P lies at ``P + E(P)``. At a given (x, y) the height is that of the point
# that came there: ``u + E_xy(u) = (x, y)``, ``z = f(u) + E_z(u)``, solved by iteration. An instrument
# sees the part shifted, turned about z, tilted and raised.

_MODEL_STEPS = 30

_ROUNDING = 1e-15
"""Of the largest radius: positions are not known better."""

_EXACT = ("shift_x", "shift_y", "rotation_z")


@dataclass(frozen=True, slots=True, eq=False)
class CutModel:
    """Heights of a cut part at measured positions."""

    chain: Any
    form: Any
    tool: tuple[float, float, float]
    positions: Positions | None
    exact: bool
    reach: float = math.nan  # radius of the unit disc of Zernike terms among the freedoms

    def error(self, x: FloatArray, y: FloatArray, errors: dict[str, float]) -> FloatArray:
        """Return E at nominal points of the part, shape (n, 3)."""
        z = self.form(x, y)
        q = axis_positions(self.chain, x, y, z, positions=self.positions, tool=self.tool)
        return np.asarray(
            self.chain.volumetric_error(q, TrialAmounts(errors), tool=self.tool, exact=self.exact),
            dtype=np.float64,
        )

    def part(self, x: FloatArray, y: FloatArray, errors: dict[str, float]) -> FloatArray:
        """Return the height of the cut part at (x, y); NaN where the form has none."""
        ux, uy = x, y
        reach = float(np.max(np.hypot(x, y), initial=0.0))
        found = self.error(ux, uy, errors)
        limit = 1e-9 * float(np.nanmax(np.abs(found), initial=0.0)) + _ROUNDING * reach
        for _ in range(_MODEL_STEPS):
            vx, vy = x - found[:, 0], y - found[:, 1]
            moved = float(np.nanmax(np.hypot(vx - ux, vy - uy), initial=0.0))
            ux, uy = vx, vy
            found = self.error(ux, uy, errors)
            if moved <= limit:
                return np.asarray(self.form(ux, uy) + found[:, 2])
        raise NotConvergedError(
            f"errors of up to {np.nanmax(np.abs(found)):.3g} m move points of the part across each "
            "other (near its centre): leave the centre out, or fit fewer terms"
        )

    def seen(
        self, x: FloatArray, y: FloatArray, errors: dict[str, float], freedoms: dict[str, float]
    ) -> FloatArray:
        """Return the height that an instrument sees; turns about x and y to first order."""
        turn = freedoms.get("rotation_z", 0.0)
        sx, sy = x - freedoms.get("shift_x", 0.0), y - freedoms.get("shift_y", 0.0)
        px = np.cos(turn) * sx + np.sin(turn) * sy
        py = np.cos(turn) * sy - np.sin(turn) * sx
        height = self.part(px, py, errors)
        names = [n for n in freedoms if n not in _EXACT]
        if not names:
            return height
        slope = self.form.gradient(x, y)
        maps = freedom_maps(
            names, x=x, y=y, z=height, slope_x=slope[0], slope_y=slope[1], reach=self.reach
        )
        return np.asarray(height + maps @ np.array([freedoms[n] for n in names]))


# ---- what an identification found: terms with u, groups that hang together, what cannot be seen ----


@dataclass(frozen=True, slots=True)
class IdentifiedGroup:
    """Terms that one part cannot tell apart, and what is known of them together.

    Parameters
    ----------
    names : tuple of str
        The terms.
    sq, u : float, m
        Signed size of the map they have in common, as Sq after alignment, and its standard
        uncertainty.
    equivalents : mapping of str to tuple of (float, float)
        Amount and standard uncertainty of each term if it alone were at work, in its unit.
    likeness : float
        Share of the maps' squares that the common map holds, 0 to 1.
    """

    names: tuple[str, ...]
    sq: float
    u: float
    equivalents: Mapping[str, tuple[float, float]]
    likeness: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Identification:
    """Error terms that explain a measured map.

    Parameters
    ----------
    names, units : tuple of str
        Terms that were asked for.
    values, u : ndarray, shape (m,)
        Amount (actual minus nominal) and standard uncertainty of each term; NaN where the map does
        not determine it alone.
    groups : tuple of IdentifiedGroup
        Terms that are only known together.
    unobservable : tuple of str
        Terms of which the alignment or the part shows nothing.
    estimate : mapping of str to float
        One set of amounts that explains the map, of all terms that can be seen; within a group the
        smallest such set. For prediction and compensation of this part, not for diagnosis.
    covariance : ndarray, shape (p, p)
        Of `estimate`, in its order.
    freedoms : mapping of str to tuple of (float, float)
        Alignment fitted along, with standard uncertainty.
    sq_before, sq_after : float, m
        Sq after alignment alone, and after alignment and terms.
    predicted_sq : float, m
        Sq of a next part if `estimate` were compensated: what is left, and what the uncertainty of
        the amounts adds.
    residual : Surface or ndarray
        Measured minus model, m; NaN where not used.
    audit : mapping
        Settings and counts, with units in the keys.
    messages : tuple of str
        What the reader must know.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    u: FloatArray
    groups: tuple[IdentifiedGroup, ...]
    unobservable: tuple[str, ...]
    estimate: Mapping[str, float]
    covariance: FloatArray
    freedoms: Mapping[str, tuple[float, float]]
    sq_before: float
    sq_after: float
    predicted_sq: float
    residual: Surface | FloatArray
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def __getitem__(self, term: str) -> Quantity:
        """Return the amount of a term; NaN where the map does not determine it."""
        if term not in self.names:
            raise DataError(f"{term!r} was not asked for; there are {', '.join(self.names)}")
        i = self.names.index(term)
        u = float(self.u[i])
        return Quantity(
            float(self.values[i]),
            self.units[i],
            f"{term}, actual minus nominal, from a measured map",
            u=None if np.isnan(u) else u,
            symbol=term,
        )

    @property
    def correction(self) -> dict[str, float]:
        """Minus the estimate: what to command to take the errors away."""
        return {n: -v for n, v in self.estimate.items()}

    def to_frame(self) -> pd.DataFrame:
        """Return the terms as a data frame.

        Returns
        -------
        pandas.DataFrame
            Index ``term``; columns ``value``, ``u``, ``unit`` (SI), ``group`` (0: none),
            ``if_alone``, ``u_if_alone``, ``observable``.
        """
        import pandas as pd

        return pd.DataFrame(self._rows()).set_index("term")

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI; NaN becomes None.

        Returns
        -------
        dict
            Keys ``terms``, ``groups``, ``unobservable``, ``freedoms``, ``sq_before_nm``,
            ``sq_after_nm``, ``predicted_sq_nm``, ``audit``, ``messages``.
        """
        return {
            "terms": plain_rows(self._rows()),
            "groups": [
                {"terms": list(g.names), "sq_nm": 1e9 * g.sq, "u_nm": 1e9 * g.u}
                for g in self.groups
            ],
            "unobservable": list(self.unobservable),
            "freedoms": {n: {"value": v, "u": u} for n, (v, u) in self.freedoms.items()},
            "sq_before_nm": 1e9 * self.sq_before,
            "sq_after_nm": 1e9 * self.sq_after,
            "predicted_sq_nm": 1e9 * self.predicted_sq,
            "audit": dict(self.audit),
            "messages": list(self.messages),
        }

    def report(self) -> str:
        """Return what was found as text.

        Returns
        -------
        str
            Several lines.
        """
        lines = [f"{'term':<8}{'amount':>14}{'u':>14}"]
        for n, unit, v, u in zip(self.names, self.units, self.values, self.u, strict=True):
            if not np.isnan(v):
                lines.append(f"{n:<8}{amount_text(v, unit):>14}{amount_text(u, unit):>14}")
        for g in self.groups:
            lines.append(
                f"together {', '.join(g.names)}: Sq {format_length(g.sq, digits=3)} "
                f"(u = {format_length(g.u, digits=2)}); if one alone:"
            )
            for n, (v, u) in g.equivalents.items():
                unit = self.units[self.names.index(n)]
                lines.append(f"  {n:<6}{amount_text(v, unit):>14}{amount_text(u, unit):>14}")
        if self.unobservable:
            lines.append(f"not visible: {', '.join(self.unobservable)}")
        lines.append(
            f"Sq {format_length(self.sq_before)} aligned, {format_length(self.sq_after)} explained; "
            f"if compensated {format_length(self.predicted_sq)}"
        )
        return "\n".join([*lines, *self.messages])

    def __repr__(self) -> str:
        known = int(np.count_nonzero(~np.isnan(self.values)))
        return (
            f"Identification({known} terms, {len(self.groups)} groups, Sq "
            f"{format_length(self.sq_before)} -> {format_length(self.sq_after)})"
        )

    def _rows(self) -> list[dict[str, Any]]:
        alone = {n: (k, *g.equivalents[n]) for k, g in enumerate(self.groups, 1) for n in g.names}
        rows = []
        for n, unit, value, u in zip(self.names, self.units, self.values, self.u, strict=True):
            group, amount, u_amount = alone.get(n, (0, float("nan"), float("nan")))
            row = {"term": n, "value": float(value), "u": float(u), "unit": unit, "group": group}
            row |= {"if_alone": amount, "u_if_alone": u_amount}
            rows.append(row | {"observable": n not in self.unobservable})
        return rows
