"""What an alignment takes away: piston, tilt, defocus, shifts and turns as maps, and projections.

Whoever measures or mounts a part first aligns it. An error term that looks like a motion of the
whole part is then gone, and must not be ranked by what it was before. Each freedom is a map of
vertical deviation per unit of it, ``d = Ez - dz/dx Ex - dz/dy Ey`` for the motion E of the part;
maps are projected off all freedoms at once, by least squares with area weights.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.readable import did_you_mean

LAST_TERM = 37
"""Noll index of the last Zernike term that an alignment may take."""

ZERNIKES = tuple(f"noll{j}" for j in range(4, LAST_TERM + 1))

FREEDOMS = {
    "piston": "m",
    "tilt_x": "rad",
    "tilt_y": "rad",
    "defocus": "1/m",
    "shift_x": "m",
    "shift_y": "m",
    "rotation_x": "rad",
    "rotation_y": "rad",
    "rotation_z": "rad",
    **dict.fromkeys(ZERNIKES, "m"),
}
"""Freedoms and the unit of their amount; `tilt_x` is the slope dz/dx of a plane, `noll5` a Zernike term."""

_WORDS: dict[str, tuple[str, ...]] = {
    "none": (),
    "tilt": ("tilt_x", "tilt_y"),
    "plane": ("piston", "tilt_x", "tilt_y"),
    "shift": ("shift_x", "shift_y"),
    "rigid": ("piston", "shift_x", "shift_y", "rotation_x", "rotation_y", "rotation_z"),
    "mounting": ("noll5", "noll6", "noll9", "noll10"),  # two and three lobes of a clamped part
}
_ZERNIKE = re.compile(r"zernike[ :]*(\d+)")

_DEPENDENT = 1e-9
"""A freedom of which the others leave less than this share is one of them already."""

_BLOCK = 4096


def removed_freedoms(removed: str | Iterable[str]) -> tuple[str, ...]:
    """Return the freedoms that words such as ``"plane+defocus"`` stand for.

    Parameters
    ----------
    removed : str or iterable of str
        Names of `FREEDOMS`, or ``"none"``, ``"tilt"`` (both), ``"plane"`` (piston and tilt),
        ``"shift"`` (both), ``"rigid"`` (piston, shifts, turns about x, y and z), ``"mounting"``
        (astigmatism and trefoil, what a chuck of two or three jaws does), ``"zernike 11"`` (the
        Zernike terms up to that Noll index); joined by ``+`` or one after the other.

    Returns
    -------
    tuple of str
        Each once, in the order of `FREEDOMS`.

    Raises
    ------
    DataError
        If a word is unknown.

    Examples
    --------
    >>> removed_freedoms("plane+defocus")
    ('piston', 'tilt_x', 'tilt_y', 'defocus')
    """
    if not isinstance(removed, str | Iterable):
        raise DataError(
            f"removed is a list of freedoms such as ('piston', 'tilt'), got {removed!r}"
        )
    parts = (removed,) if isinstance(removed, str) else tuple(removed)
    found: set[str] = set()
    for part in parts:
        if not isinstance(part, str):
            raise DataError(f"a freedom is named by a text, got {part!r}")
        for word in part.split("+"):
            name = word.strip().lower()
            zernike = _ZERNIKE.fullmatch(name)
            if zernike is not None:
                last = numbers.between(float(zernike[1]), "the last Zernike term", 1, LAST_TERM)
                found.update(_WORDS["plane"][: int(last)])
                found.update(ZERNIKES[: max(int(last) - 3, 0)])
                continue
            if name not in FREEDOMS and name not in _WORDS:
                plain = (n for n in FREEDOMS if n not in ZERNIKES)
                known = ", ".join((*_WORDS, "zernike N", *plain))
                hint = did_you_mean(name, (*_WORDS, *FREEDOMS))
                raise DataError(
                    f"Unknown alignment term {word.strip()!r}. Available: {known}.{hint}"
                )
            found.update(_WORDS.get(name, (name,)))
    return tuple(n for n in FREEDOMS if n in found)


def freedom_maps(
    names: Sequence[str],
    *,
    x: ArrayLike,
    y: ArrayLike,
    z: ArrayLike,
    slope_x: ArrayLike,
    slope_y: ArrayLike,
    reach: float = math.nan,
) -> FloatArray:
    """Return the vertical deviation per unit of each freedom.

    Parameters
    ----------
    names : sequence of str
        Of `FREEDOMS`.
    x, y, z : array_like, shape (n,), m
        Points of the nominal surface.
    slope_x, slope_y : array_like, shape (n,)
        Slopes dz/dx and dz/dy there.
    reach : float, m, optional
        Radius of the unit disc of Zernike terms; needed for them.

    Returns
    -------
    ndarray, shape (n, k)
        One column per freedom, in the order of `names`.

    Raises
    ------
    DataError
        If a name is unknown.

    Notes
    -----
    A shift or turn moves the part: ``shift_x`` gives -dz/dx, ``rotation_z`` (counter-clockwise
    seen from +z) gives ``y dz/dx - x dz/dy``, ``rotation_x`` gives ``y + z dz/dy``, ``rotation_y``
    gives ``-x - z dz/dx``. ``tilt_x`` and ``tilt_y`` are plain planes, ``defocus`` is x^2 + y^2.
    """
    px, py, pz, gx, gy = (np.asarray(v, dtype=np.float64) for v in (x, y, z, slope_x, slope_y))
    maps = {
        "piston": np.ones_like(px),
        "tilt_x": px,
        "tilt_y": py,
        "defocus": px**2 + py**2,
        "shift_x": -gx,
        "shift_y": -gy,
        "rotation_x": py + pz * gy,
        "rotation_y": -px - pz * gx,
        "rotation_z": py * gx - px * gy,
        **_zernike_maps(names, px, py, reach),
    }
    columns = np.empty((px.size, len(names)))
    for k, name in enumerate(names):
        columns[:, k] = maps[numbers.choice(name, "a freedom", FREEDOMS)]
    return columns


def _zernike_maps(
    names: Sequence[str], x: FloatArray, y: FloatArray, reach: float
) -> dict[str, FloatArray]:
    """Return the Zernike terms among freedoms, RMS 1 over the disc (Noll)."""
    wanted = [n for n in names if n in ZERNIKES]
    if not wanted:
        return {}
    from metrosep.forms.zernike import Zernike

    # slopes are taken a little beyond the rim
    form = Zernike([int(n[4:]) for n in wanted], order="noll", radius=1.001 * reach)
    return dict(zip(wanted, form.basis(x, y), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """The space of maps that an alignment removes."""

    names: tuple[str, ...]  # freedoms that were asked for
    used: tuple[str, ...]  # those that move the surface in a way of their own
    dropped: tuple[str, ...]  # those that leave the surface as it is, or do what others do
    weights: FloatArray  # shape (n,): area of each point, sum 1
    basis: FloatArray  # shape (n, k): orthonormal under the weights, a column per used freedom
    mixing: (
        FloatArray  # shape (k, k), upper triangular: maps of the used freedoms = basis @ mixing
    )

    def remove(self, maps: ArrayLike) -> FloatArray:
        """Return maps (n, m) or (n,) without what the alignment takes away, by least squares."""
        values, shape = self._checked(maps)
        out = np.array(values)
        with one_blas_thread():
            for _ in range(2):  # the second pass takes what rounding left of large maps
                parts = self.components(out)
                for i in range(0, out.shape[0], _BLOCK):
                    out[i : i + _BLOCK] -= self.basis[i : i + _BLOCK] @ parts
        return out.reshape(shape)

    def amounts(self, maps: ArrayLike) -> FloatArray:
        """Return how much of each used freedom is removed from each map, (k, m) or (k,), in its unit."""
        values, shape = self._checked(maps)
        found = np.linalg.solve(self.mixing, self.components(values))
        return np.asarray(found.reshape((len(self.used), *shape[1:])), dtype=np.float64)

    def components(self, maps: FloatArray) -> FloatArray:
        """Return the scalar products of the basis with maps, (k, m); nothing is checked."""
        total = np.zeros((self.basis.shape[1], maps.shape[1]))
        for i in range(0, maps.shape[0], _BLOCK):
            rows = slice(i, i + _BLOCK)
            total += (self.basis[rows] * self.weights[rows, None]).T @ maps[rows]
        return total

    def _checked(self, maps: ArrayLike) -> tuple[FloatArray, tuple[int, ...]]:
        values = np.asarray(maps, dtype=np.float64)
        shape = values.shape
        if values.ndim not in (1, 2) or shape[0] != self.weights.size:
            raise InvalidSamplesError(
                f"maps must have one row per point, {self.weights.size} of them, got shape {shape}"
            )
        if not np.isfinite(values).all():
            raise InvalidSamplesError(
                "maps hold NaN or infinity; leave such points out of the mesh"
            )
        return values.reshape(shape[0], -1), shape


def alignment_space(
    names: Sequence[str], maps: ArrayLike, weights: ArrayLike, *, scales: ArrayLike | None = None
) -> Alignment:
    """Return the space that freedoms span on a mesh.

    Parameters
    ----------
    names : sequence of str
        One per column of `maps`.
    maps : array_like, shape (n, k)
        Deviation per unit of each freedom, as from `freedom_maps`.
    weights : array_like, shape (n,)
        Area of each point, > 0; scaled to sum 1.
    scales : array_like, shape (k,), optional
        Size that each map could have (RMS); below 1e-9 of it a map is rounding. The map's own size
        if omitted.

    Returns
    -------
    Alignment
        Freedoms that add nothing are named in `dropped`.

    Raises
    ------
    InvalidSamplesError
        If shapes do not fit, a value is not finite or a weight is not positive.
    TooFewSamplesError
        If there are not more points than freedoms.

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.0, 5)
    >>> space = alignment_space(["piston"], np.ones((5, 1)), np.ones(5))
    >>> space.remove(x + 3.0)[3:].round(12).tolist()
    [0.5, 1.0]
    """
    columns = np.array(maps, dtype=np.float64)
    area = np.array(weights, dtype=np.float64)
    if columns.ndim != 2 or columns.shape != (area.size, len(names)):
        raise InvalidSamplesError(
            f"maps of {len(names)} freedoms on {area.size} points must have shape "
            f"({area.size}, {len(names)}), got {columns.shape}"
        )
    if area.size <= len(names):
        raise TooFewSamplesError(
            f"{area.size} points cannot tell {len(names)} freedoms from a deviation; "
            "take more points or remove less"
        )
    if not np.isfinite(columns).all():
        raise InvalidSamplesError("maps of freedoms hold NaN or infinity; leave those points out")
    if not (np.isfinite(area).all() and (area > 0.0).all()):
        raise InvalidSamplesError("weights must be positive and finite")
    area /= area.sum()
    root = np.sqrt(area)
    own = np.sqrt(np.einsum("n,nk,nk->k", area, columns, columns))
    limit = _DEPENDENT * (own if scales is None else np.maximum(np.asarray(scales), own))
    used: list[int] = []
    basis = np.empty((area.size, 0))
    for k in range(len(names)):
        left = columns[:, k] * root
        for _ in range(2):
            left = left - basis @ (basis.T @ left)
        size = float(np.sqrt(left @ left))
        if size > limit[k]:
            used.append(k)
            basis = np.column_stack((basis, left / size))
    mixing = np.triu(basis.T @ (columns[:, used] * root[:, None]))
    basis = np.ascontiguousarray(basis / root[:, None])
    for array in (area, basis, mixing):
        array.setflags(write=False)
    kept = tuple(names[k] for k in used)
    return Alignment(
        tuple(names), kept, tuple(n for n in names if n not in kept), area, basis, mixing
    )
