"""One cause of form error: a map or a P-V, and how it may vary."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.units import format_length
from metrosep.process.follow_ups import drawn_pv, square_root

__all__ = ["DRAWS", "LIKELY", "SEED", "Contribution", "checked_length", "spread_of"]

DRAWS, SEED = 4000, 20080415
LIKELY = (0.025, 0.975)
"""Quantiles of the interval of a Monte Carlo."""


@dataclass(frozen=True, slots=True, eq=False)
class Contribution:
    """One cause of form error.

    Parameters
    ----------
    name : str
        Such as "tool setting".
    pv : float, optional, m
        Peak to valley; that of the map if omitted.
    map : array_like, optional, m
        Error along z at the points that all maps of a budget share; NaN = not known there.
    u : float, optional, m
        Standard uncertainty of the P-V; scales the map as a whole in a Monte Carlo.
    modes : array_like, shape (k, ...), optional
        Change of the map with each of k uncertain numbers, at the points of the map; NaN = not
        known there. Instead of `u`, which then follows.
    cov : array_like, shape (k, k), optional
        Covariance of these numbers; modes times its root are in m.

    Attributes
    ----------
    expected : float or None, m
        Mean P-V of the draws, with `modes`. A P-V is never negative: near zero it is above `pv`.
    interval : tuple of (float, float) or None, m
        Between 2.5 and 97.5 % of these draws.

    Raises
    ------
    DataError
        If there is neither a map nor a P-V, both disagree, a number cannot be used, modes and
        covariance do not fit, or `u` is given beside them.
    InvalidSamplesError
        If the map or a mode is infinite somewhere.
    TooFewSamplesError
        If the map is NaN everywhere, or no point has map and modes.

    Notes
    -----
    With modes the map of a draw is ``map + xi @ modes``, xi normal with the covariance: its size,
    its sign and its shape vary. `u` is the standard deviation of the P-V of 4000 draws, at the
    points that have map and modes.

    Examples
    --------
    >>> Contribution("tool setting", map=[-1e-9, 3e-9]).pv
    4e-09
    >>> unset = Contribution("tool setting", map=[0, 0], modes=[[-1, 1]], cov=[[1e-18]])
    >>> round(unset.expected * 1e9, 1), round(unset.u * 1e9, 1)  # half normal, 2 nm times 0.8, 0.6
    (1.6, 1.2)
    """

    name: str
    pv: float | None = None
    map: FloatArray | None = None
    u: float | None = None
    modes: FloatArray | None = None
    cov: FloatArray | None = None
    expected: float | None = None
    interval: tuple[float, float] | None = None

    def __init__(
        self,
        name: str,
        pv: float | None = None,
        *,
        map: ArrayLike | None = None,  # noqa: A002  # the word of the field
        u: float | None = None,
        modes: ArrayLike | None = None,
        cov: ArrayLike | None = None,
    ) -> None:
        array = None if map is None else _values(f"the map of {name!r}", map)
        given = None if pv is None else checked_length(name, "P-V", pv)
        if array is None and given is None:
            raise DataError(f"the contribution {name!r} needs a map or a P-V, in m")
        if array is not None:
            own = float(np.nanmax(array) - np.nanmin(array))
            if given is not None and abs(given - own) > 1e-6 * max(given, own):
                raise DataError(
                    f"the contribution {name!r} has the P-V {format_length(own)} in its map, not "
                    f"{format_length(given)}; give one of the two"
                )
            given = own
        size = None if u is None else checked_length(name, "uncertainty", u)
        made: dict[str, object] = {"name": str(name), "pv": given, "map": array, "u": size}
        made |= {"modes": None, "cov": None, "expected": None, "interval": None}
        if modes is not None or cov is not None:
            if size is not None:
                raise DataError(
                    f"the contribution {name!r} has u and modes; give one of the two: u follows "
                    "from modes and cov"
                )
            made["modes"], made["cov"] = _checked_modes(name, array, modes, cov)
        for key, value in made.items():
            object.__setattr__(self, key, value)
        if self.modes is not None:
            self._draw()

    def _draw(self) -> None:
        base, rows = np.ravel(self.map), self.deviations()  # type: ignore[arg-type]
        good = ~(np.isnan(base) | np.isnan(rows).any(axis=0))
        if not good.any():
            raise TooFewSamplesError(f"no point of {self.name!r} has a map and all modes")
        if not good.all():
            base, rows = base[good], rows[:, good]
        xi = np.random.default_rng(SEED).standard_normal((DRAWS, rows.shape[0]))
        expected, u, interval = spread_of(drawn_pv(base, rows, xi))
        for key, value in (("expected", expected), ("u", u), ("interval", interval)):
            object.__setattr__(self, key, value)

    def deviations(self) -> FloatArray:
        """Return the change of the map with each of some independent standard normal numbers.

        Returns
        -------
        ndarray, shape (r, n), m
            Map points in one row; none where nothing is known to vary, or a P-V has no shape.
        """
        if self.map is None or (not self.u and self.modes is None):
            return np.empty((0, 0 if self.map is None else self.map.size))
        if self.modes is not None and self.cov is not None:
            flat = self.modes.reshape(self.modes.shape[0], -1)
            root = square_root(self.cov)
            # a mode without weight may be NaN
            used = root.any(axis=1)
            return np.asarray(root[used].T @ flat[used], dtype=np.float64)
        if not self.pv:
            return np.empty((0, self.map.size))
        return np.ravel(self.map)[None, :] * (float(self.u or 0.0) / self.pv)

    @property
    def is_shapeless(self) -> bool:
        """Whether it has an uncertainty, and a map of P-V 0 that does not tell its shape."""
        return self.map is not None and self.modes is None and bool(self.u) and not self.pv


def spread_of(found: FloatArray) -> tuple[float, float, tuple[float, float]]:
    """Return mean, standard deviation and likely interval of draws."""
    low, high = (float(v) for v in np.quantile(found, LIKELY))
    return float(found.mean()), float(found.std(ddof=1)), (low, high)


def checked_length(name: str, what: str, value: object) -> float:
    """Return a length from 0 on, or raise DataError."""
    try:
        size = float("nan") if isinstance(value, str | bytes) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        size = float("nan")
    if not (np.isfinite(size) and size >= 0.0):
        raise DataError(f"the {what} of {name!r} must be a length from 0 on, in m, got {value!r}")
    return size


def _values(what: str, values: ArrayLike) -> FloatArray:
    try:
        array = as_float(values)
    except (TypeError, ValueError) as error:
        raise DataError(f"{what} must hold real numbers in m: {error}") from None
    if np.isinf(array).any():
        raise InvalidSamplesError(f"{what} is infinite somewhere; write NaN where it is not known")
    if not array.size or np.isnan(array).all():
        raise TooFewSamplesError(f"{what} holds no value")
    array.setflags(write=False)
    return array


def _checked_modes(
    name: str, array: FloatArray | None, modes: ArrayLike | None, cov: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    if array is None:
        raise DataError(f"the modes of {name!r} need the map that they change")
    if modes is None or cov is None:
        raise DataError(f"the contribution {name!r} needs both modes and cov, or none of them")
    rows = _values(f"a mode of {name!r}", modes)
    if rows.shape[1:] != array.shape or rows.ndim != array.ndim + 1:
        raise DataError(
            f"the modes of {name!r} have the shape {rows.shape}; it must be (k, *{array.shape}), "
            "one map for each uncertain number"
        )
    try:
        square = as_float(cov)
    except (TypeError, ValueError) as error:
        raise DataError(f"the covariance of {name!r} must hold real numbers: {error}") from None
    k = rows.shape[0]
    if square.shape != (k, k) or not np.isfinite(square).all():
        raise DataError(
            f"the covariance of {name!r} must be finite and have the shape ({k}, {k}) of its "
            f"{k} mode(s), got the shape {square.shape}"
        )
    size = np.sqrt(np.abs(np.diag(square)))
    scale = np.where(size > 0.0, size, 1.0)
    correlation = square / np.outer(scale, scale)
    skew = float(np.abs(correlation - correlation.T).max())
    if skew > 1e-6 or float(np.linalg.eigvalsh(correlation).min()) < -1e-6:
        raise DataError(f"the covariance of {name!r} is not symmetric and positive")
    square = 0.5 * (square + square.T)
    square.setflags(write=False)
    return rows, square
