"""What a unit of each error term does to the part: maps of deviation, or of optical path.

The vertical deviation of a point that is cut at an error E is ``d = Ez - dz/dx Ex - dz/dy Ey``;
the normal one is ``d / sqrt(1 + |grad z|^2)``. Blocks of points keep the memory small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError
from metrosep.machine._mesh import Positions, SurfaceMesh, axis_positions
from metrosep.machine._reading_problem import NULL
from metrosep.machine.alignment import ZERNIKES, Alignment, freedom_maps
from metrosep.machine.error_sets import ErrorSet
from metrosep.machine.gram import AlignedGram, together
from metrosep.optics.rays import Mode, check_mode, path_sensitivity

_BLOCK = 16384
_SAMPLE = 1000

_ROUNDING = 1e-12
"""Of the parts of a deviation: a sum this small is their rounding."""

_OF_THE_WAVE = ("piston", "tilt_x", "tilt_y", "defocus", *ZERNIKES)

_STEP = 1e-4
"""Of the radius of a point: step of the central difference that gives the slopes of a map; its
error is 1e-8 of a map that varies with the radius."""


@dataclass(frozen=True, slots=True, eq=False)
class Perturbation:
    """A surface and its small changes, as a wavefront hook gets them."""

    x: FloatArray  # shape (n,): points of the nominal surface in m, and its slopes
    y: FloatArray
    z: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    dz: FloatArray  # shape (n, m), m per unit: change of height, one column per term
    dslope_x: FloatArray  # shape (n, m), per unit: change of the slopes
    dslope_y: FloatArray


WavefrontHook = Callable[[Perturbation], ArrayLike]
"""Returns the change of the optical path, shape (n, m), m per unit, linear in the changes."""


def vertical_maps(jacobian: ArrayLike, slope_x: ArrayLike, slope_y: ArrayLike) -> FloatArray:
    """Return ``d = Ez - dz/dx Ex - dz/dy Ey`` of each term, shape (n, m), m per unit.

    Takes the Jacobian, shape (n, 3, m), in either order of memory.
    """
    J = np.asarray(jacobian, dtype=np.float64)
    gx, gy = (np.asarray(s, dtype=np.float64) for s in (slope_x, slope_y))
    if J.ndim != 3 or J.shape[1] != 3 or gx.shape != J.shape[:1] or gy.shape != J.shape[:1]:
        raise InvalidSamplesError(
            f"a Jacobian of n points has shape (n, 3, terms) and n slopes, got {J.shape}, "
            f"{gx.shape} and {gy.shape}"
        )
    if J.flags.c_contiguous:
        factors = np.stack((-gx, -gy, np.ones_like(gx)), axis=1)[:, None, :]
        return np.asarray((factors @ J)[:, 0, :])
    out = np.empty((J.shape[2], J.shape[0]))
    for k in range(J.shape[2]):
        np.multiply(gx, J[:, 0, k], out=out[k])
        out[k] += gy * J[:, 1, k]
        np.subtract(J[:, 2, k], out[k], out=out[k])
    return out.T


def path_hook(mode: str, n: float | None) -> WavefrontHook:
    """Return the change of optical path of a plane wave along -z, mirror or boundary of glass.

    The path of `metrosep.optics.rays.path_difference`, linear in height and slopes, at a fixed
    point of the surface; positive where the material rises.
    """
    index = check_mode(mode, n)
    kind: Mode = "reflect" if index is None else "refract"

    def change(part: Perturbation) -> FloatArray:
        by_height, by_x, by_y = path_sensitivity(
            part.z, part.slope_x, part.slope_y, mode=kind, n=index
        )
        return np.asarray(
            by_height[:, None] * part.dz
            + by_x[:, None] * part.dslope_x
            + by_y[:, None] * part.dslope_y
        )

    return change


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """How a term runs along its axis, in parts of its largest amount: of its value, or of its u."""

    errors: ErrorSet
    name: str
    of_u: bool
    scale: float

    def at(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """Return the shape at axis positions."""
        found = self.errors.u_at(q) if self.of_u else self.errors.at(q, names=(self.name,))
        return np.asarray(found[self.name] / self.scale)


@dataclass(frozen=True, slots=True, eq=False)
class MapMaker:
    """Everything that unit maps are made of; `make` makes them."""

    chain: Any
    mesh: SurfaceMesh
    terms: tuple[str, ...]
    response: str
    direction: str
    tool: tuple[float, float, float]
    positions: Positions | None
    wavefront: WavefrontHook | None
    shapes: Mapping[str, Shape] = field(default_factory=dict)

    def make(self) -> FloatArray:
        """Return the unit maps at the points of the mesh, shape (n, m)."""
        maps = self._blocks(self._errors, len(self.terms))
        bad = np.flatnonzero(~np.isfinite(maps).all(axis=0))
        if bad.size:
            names = ", ".join(self.terms[k] for k in bad)
            raise InvalidSamplesError(
                f"the effect of {names} is not finite somewhere on the part: check positions and tool"
            )
        maps[:, self._is_rounding()] = 0.0
        return maps

    def miss(self) -> float:
        """Return how far the nominal tool point stands from the points it should cut, m."""
        (x, y, z, _, _), q = self._sample()
        reached = self.chain.transform(q, tool=self.tool)[..., :3, 3]
        return float(np.abs(reached - np.stack((x, y, z), axis=-1)).max())

    def _is_rounding(self) -> NDArray[np.bool_]:
        """Return which terms move the tool within the surface: what is left is rounding."""
        (_, _, _, gx, gy), q = self._sample()
        J = self.chain.jacobian(q, tool=self.tool, terms=self.terms)
        size = np.abs(J[:, 2]) + np.abs(gx[:, None] * J[:, 0]) + np.abs(gy[:, None] * J[:, 1])
        return np.asarray(
            np.abs(vertical_maps(J, gx, gy)).max(axis=0) <= _ROUNDING * size.max(axis=0)
        )

    def freedoms(self, names: Sequence[str]) -> FloatArray:
        """Return the maps of freedoms in the same response, shape (n, k).

        Piston, tilt and defocus of a wavefront are those of the wavefront itself.
        """

        def vertical(*points: FloatArray, wanted: Sequence[str] = names) -> FloatArray:
            x, y, z, slope_x, slope_y = points
            slopes: Any = {"slope_x": slope_x, "slope_y": slope_y}
            return freedom_maps(wanted, x=x, y=y, z=z, reach=float(self.mesh.rho[-1]), **slopes)

        plain = vertical(*self._points(slice(None)))
        if self.response == "form":
            return plain / self._secant(slice(None))[:, None]
        moved = [k for k, n in enumerate(names) if n not in _OF_THE_WAVE]
        if moved:
            motions = partial(vertical, wanted=[names[k] for k in moved])
            plain[:, moved] = self._blocks(motions, len(moved))
        return plain

    def _blocks(self, vertical: Callable[..., FloatArray], n_maps: int) -> FloatArray:
        n = self.mesh.x.size
        out = np.empty((n_maps, n))
        for i in range(0, n, _BLOCK):
            rows = slice(i, i + _BLOCK)
            if self.response == "form":
                block = vertical(*self._points(rows)) / self._secant(rows)[:, None]
            else:
                block = self._wave(vertical, rows)
            out[:, rows] = block.T
        return out.T

    def _sample(self) -> tuple[tuple[FloatArray, ...], dict[str, FloatArray]]:
        """Return some points, and where the axes stand at them."""
        points = self._points(slice(None, None, max(1, self.mesh.x.size // _SAMPLE)))
        place: Any = {"positions": self.positions, "tool": self.tool}
        return points, axis_positions(self.chain, *points[:3], **place)

    def _points(self, rows: slice) -> tuple[FloatArray, ...]:
        m = self.mesh
        return m.x[rows], m.y[rows], m.z[rows], m.slope_x[rows], m.slope_y[rows]

    def _secant(self, rows: slice) -> FloatArray:
        """Return by what a vertical deviation is divided: 1, or the secant of the slope."""
        gx, gy = self.mesh.slope_x[rows], self.mesh.slope_y[rows]
        return np.sqrt(1.0 + gx**2 + gy**2) if self.direction == "normal" else np.ones_like(gx)

    def _errors(
        self, x: FloatArray, y: FloatArray, z: FloatArray, gx: FloatArray, gy: FloatArray
    ) -> FloatArray:
        q = axis_positions(self.chain, x, y, z, positions=self.positions, tool=self.tool)
        maps = vertical_maps(self.chain.jacobian(q, tool=self.tool, terms=self.terms), gx, gy)
        for name, shape in self.shapes.items():
            maps[:, self.terms.index(name)] *= shape.at(q)
        return maps

    def _wave(self, vertical: Callable[..., FloatArray], rows: slice) -> FloatArray:
        """Return the change of optical path; slopes of the maps by central differences."""
        x, y, z, gx, gy = self._points(rows)
        step = _STEP * np.maximum(np.hypot(x, y), 1e-3 * float(self.mesh.rho[-1]))
        slopes = []
        for ux, uy in ((1.0, 0.0), (0.0, 1.0)):
            sides = []
            for sign in (1.0, -1.0):
                px, py = x + sign * ux * step, y + sign * uy * step
                pz, slope = self.mesh.form(px, py), self.mesh.form.gradient(px, py)
                sides.append(vertical(px, py, pz, *slope))
            slopes.append((sides[0] - sides[1]) / (2.0 * step[:, None]))
        change = Perturbation(x, y, z, gx, gy, vertical(x, y, z, gx, gy), *slopes)
        hook = self.wavefront or path_hook("reflect", None)
        result = np.asarray(hook(change), dtype=np.float64)
        if result.shape != change.dz.shape:
            raise InvalidSamplesError(
                f"the wavefront hook must return shape {change.dz.shape}, got {result.shape}"
            )
        return result


# ---- least squares of terms and freedoms at points: what is determined, alone or together ------

OWN = 1e-6
"""Of the size of a column: what others leave of it is rounding."""

_PART = 1e-3
"""Of a direction that is not determined: a term with less in it is distinguished."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Amounts of visible terms, scaled to the size of their maps (m), and of used freedoms."""

    names: tuple[str, ...]
    sizes: FloatArray
    scaled: FloatArray
    amounts: FloatArray
    rank: int

    def errors(self) -> dict[str, float]:
        """Return the terms' amounts by name."""
        return dict(zip(self.names, (self.scaled / self.sizes).tolist(), strict=True))

    def freedoms(self, solver: Solver) -> dict[str, float]:
        """Return the freedoms' amounts by name."""
        return dict(zip(solver.space.used, self.amounts.tolist(), strict=True))

    def plus(self, step: Solution) -> Solution:
        """Return the sum of two solutions."""
        scaled, amounts = self.scaled + step.scaled, self.amounts + step.amounts
        return replace(step, scaled=scaled, amounts=amounts)


@dataclass(frozen=True, slots=True, eq=False)
class Solver:
    """The linear problem: unit maps (n, m) and freedoms (n, k), and which terms go together."""

    names: tuple[str, ...]
    maps: FloatArray
    columns: FloatArray
    space: Alignment
    gram: AlignedGram
    threshold: float
    units: tuple[str, ...] = ()
    visible: tuple[int, ...] = field(init=False)
    sizes: FloatArray = field(init=False)
    correlation: FloatArray = field(init=False)
    groups: tuple[tuple[int, ...], ...] = field(init=False)
    design: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        visible = tuple(int(i) for i in np.flatnonzero(~self.gram.is_removed))
        matrix = self.gram.matrix[np.ix_(visible, visible)]
        sizes = np.sqrt(np.diag(matrix))
        aligned = self.space.remove(self.maps[:, visible]) / sizes
        _, singular, directions = np.linalg.svd(np.linalg.qr(aligned, mode="r"))
        blind = directions[singular <= NULL * singular[0]]
        set_ = object.__setattr__
        set_(self, "visible", visible)
        set_(self, "sizes", sizes)
        correlation = matrix / np.outer(sizes, sizes)
        set_(self, "correlation", correlation)
        set_(self, "design", aligned)
        # terms that are alike, or share a direction that is not determined (a projector: free of the
        # choice of directions)
        alike = (np.abs(correlation) > self.threshold) | (np.abs(blind.T @ blind) > _PART**2)
        set_(self, "groups", tuple(tuple(visible[i] for i in g) for g in together(alike)))

    def solve(self, heights: FloatArray, used: NDArray[np.bool_]) -> Solution:
        """Return the amounts that explain heights at the used points; the smallest if not unique."""
        rows, _, rank = self.estimator(used)
        names, m = tuple(self.names[i] for i in self.visible), len(self.visible)
        model = np.hstack([self.maps[:, self.visible] / self.sizes, self.used_freedoms()])[used]
        found = rows.T @ heights[used]
        found = found + rows.T @ (
            heights[used] - model @ found
        )  # what rounding left of large heights
        return Solution(names, self.sizes, found[:m], found[m:], rank)

    def effect(self, solution: Solution) -> FloatArray:
        """Return the linear effect of a solution at the points, m."""
        terms = self.maps[:, self.visible] @ (solution.scaled / self.sizes)
        return np.asarray(terms + self.used_freedoms() @ solution.amounts)

    def size_of(self, step: Solution) -> float:
        """Return how much a step moves the surface, RMS m."""
        moved = self.effect(step)
        return float(np.sqrt(np.mean(moved**2)))

    def estimator(self, used: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray, int]:
        """Return what makes terms and freedoms of heights at the used points, basis and rank.

        The first (n, p + k) gives scaled amounts and freedoms as ``rows.T @ heights``; the second
        (n, rank + k) is an orthonormal basis of all that the fit can follow.
        """
        columns = self.used_freedoms()[used]
        sizes = _column_sizes(columns)
        basis = np.linalg.qr(columns)[0]
        design = self.design[used]
        if not used.all():
            design = design - basis @ (basis.T @ design)
        U, singular, directions = np.linalg.svd(design, full_matrices=False)
        good = singular > NULL * singular[0]
        terms = U[:, good] @ (directions[good] / singular[good][:, None])
        inverse = np.linalg.pinv(columns / sizes).T / sizes
        maps = self.maps[used][:, self.visible] / self.sizes
        freedoms = inverse - terms @ (maps.T @ inverse)
        rank = int(np.count_nonzero(good))
        return np.hstack([terms, freedoms]), np.hstack([U[:, good], basis]), rank

    def used_freedoms(self) -> FloatArray:
        """Return the maps of the freedoms that move the surface in a way of their own, (n, k)."""
        return self.columns[:, [self.space.names.index(n) for n in self.space.used]]


def common_map(correlation: FloatArray) -> tuple[FloatArray, float]:
    """Return the strongest direction of maps of unit size, and its square strength."""
    values, vectors = np.linalg.eigh(correlation)
    vector = vectors[:, -1]
    return vector * np.sign(vector[np.argmax(np.abs(vector))]), float(values[-1])


def _column_sizes(columns: FloatArray) -> FloatArray:
    sizes = np.sqrt(np.sum(columns**2, axis=0))
    return np.asarray(np.where(sizes > 0.0, sizes, 1.0))


def unit_columns(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return columns of unit size, zeros left as they are, and the sizes."""
    sizes = np.sqrt(np.sum(columns**2, axis=0))
    return columns / np.where(sizes > 0.0, sizes, 1.0), sizes


def span_of(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of columns that were of unit size before they were freed of others."""
    U, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return U[:, singular > OWN]
