"""What repeats tell of a parameter: type A uncertainty, and the rms without noise.

Repeats are measurements of one part on the same points, each with noise of its own. Only points
that are valid in all repeats are used.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError
from metrosep.core.limits import COVERAGE
from metrosep.core.numbers import flag
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.parameters.budget import coverage_factor
from metrosep.parameters.noise import (
    REPEATS,
    NoiseEstimate,
    mean_of_repeats,
    noise_of_repeats,
    stack_repeats,
)
from metrosep.parameters.table import (
    Evaluate,
    value_of,
    with_heights,
)


@dataclass(frozen=True, slots=True)
class TypeA:
    """Mean of repeated values with its standard uncertainty.

    Parameters
    ----------
    mean : float
        Arithmetic mean.
    s : float
        Standard deviation of a single value (n - 1).
    u : float
        Standard uncertainty of the mean, s / sqrt(n).
    n : int
        Number of values.
    """

    mean: float
    s: float
    u: float
    n: int

    @property
    def dof(self) -> int:
        """Degrees of freedom, n - 1."""
        return self.n - 1

    def coverage_factor(self, coverage: float = COVERAGE) -> float:
        """Return k of the mean for a coverage probability, from Student's distribution.

        Parameters
        ----------
        coverage : float, optional
            Between 0 and 1.

        Returns
        -------
        float
            Factor, two-sided: 14.0 for two values, 2 for very many.

        Raises
        ------
        DataError
            If the probability is not between 0 and 1.
        """
        return coverage_factor(coverage, self.dof)

    def to_quantity(self, unit: str, definition: str, *, symbol: str = "") -> Quantity:
        """Return the mean as a quantity.

        Parameters
        ----------
        unit : str
            SI unit of the values.
        definition : str
            What was repeated.
        symbol : str, optional
            Its symbol.

        Returns
        -------
        Quantity
            Mean and u.
        """
        text = f"{definition}, mean of {self.n} repeats"
        return Quantity(self.mean, unit, text, u=self.u, symbol=symbol)


def type_a(values: ArrayLike) -> TypeA:
    """Return mean, scatter and type A uncertainty of repeated values.

    Parameters
    ----------
    values : array_like, shape (n,)
        Independent repeats, n >= 2.

    Returns
    -------
    TypeA
        Mean, s, u = s / sqrt(n), n - 1 degrees of freedom.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 2 values: scatter is undefined.
    InvalidSamplesError
        If a value is NaN or infinite, or the list is not one-dimensional.

    References
    ----------
    .. [1] JCGM 100:2008, 4.2, eqs. (3) to (5).

    Examples
    --------
    >>> result = type_a([1.0, 2.0, 3.0, 6.0])
    >>> result.mean, round(result.s, 4), round(result.u, 4), result.dof
    (3.0, 2.1602, 1.0801, 3)
    """
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1:
        raise InvalidSamplesError(f"repeats are a list of numbers, got shape {array.shape}")
    if array.size < 2:
        raise TooFewSamplesError(
            f"a type A uncertainty needs at least 2 repeats, got {array.size}; measure again or "
            "take the scatter from an earlier series as a type B contribution"
        )
    if not np.isfinite(array).all():
        raise InvalidSamplesError(
            f"repeat {int(np.flatnonzero(~np.isfinite(array))[0])} is NaN or infinite; leave a "
            "repeat out on purpose or not at all"
        )
    mean = float(array.mean())
    s = float(np.sqrt(np.square(array - mean).sum() / (array.size - 1)))
    return TypeA(mean, s, s / math.sqrt(array.size), int(array.size))


@dataclass(frozen=True, slots=True, eq=False)
class RepeatResult:
    """A parameter from repeats.

    Parameters
    ----------
    values : ndarray, shape (n_repeats,)
        Parameter of each repeat.
    type_a : TypeA
        Mean of the values and its uncertainty.
    value_of_mean : float
        Parameter of the mean profile or surface, whose noise is smaller.
    noise : NoiseEstimate
        Noise of a point of one repeat.

    Notes
    -----
    For parameters that noise makes larger (P-V, Rq), the mean of the values carries the bias of
    one repeat, `value_of_mean` that of a noise smaller by sqrt(n). A large difference between
    the two says that noise matters; the uncertainty of either does not contain it.
    """

    values: FloatArray
    type_a: TypeA
    value_of_mean: float
    noise: NoiseEstimate

    @property
    def inflation(self) -> float:
        """Mean of the values less the value of the mean: what averaging removed."""
        return self.type_a.mean - self.value_of_mean


@documented(repeats=REPEATS)
def from_repeats(
    objects: Sequence[Profile | Surface], evaluate: Evaluate, *, centre: bool | None = None
) -> RepeatResult:
    """Return a parameter of each repeat and of their mean, with type A uncertainty and noise.

    Parameters
    ----------
    objects : sequence of Profile or of Surface
        At least 2, on the same points; form removed and filtered alike.
    evaluate : str or callable
        A name such as "PV", "Sq", "Ra", or a function of an object that returns a number or a
        `Quantity`.
    centre : bool, optional
        For a name: whether the mean height is removed. By default for areal parameters and RMS,
        not for P, R and W.

    Returns
    -------
    RepeatResult
        Values, type A statement, value of the mean, noise.

    Raises
    ------
    $repeats
    DataError
        If the name is not known, an evaluation is not finite, or `centre` is not True, False or
        None.

    Notes
    -----
    All repeats are evaluated on the points that are valid in all of them.
    """
    centre = centre if centre is None else flag(centre, "centre")
    stack = stack_repeats(objects)
    common = [with_heights(o, z) for o, z in zip(objects, stack, strict=True)]
    values = np.array([value_of(evaluate, o, centre=centre) for o in common])
    values.setflags(write=False)
    mean = mean_of_repeats(objects)
    return RepeatResult(
        values,
        type_a(values),
        value_of(evaluate, mean, centre=centre),
        noise_of_repeats(objects),
    )


@dataclass(frozen=True, slots=True)
class NoiseFreeRms:
    """Root mean square without the noise of the instrument.

    Parameters
    ----------
    rms : float, m
        Square root of `mean_square`; 0 where that is not positive: no roughness above noise.
    u : float, m
        Standard uncertainty from noise and repeatability.
    mean_square : float, m^2
        Mean product of two repeats; may be negative by noise.
    u_mean_square : float, m^2
        Its standard uncertainty.
    raw : float, m
        Mean over the repeats of the mean square, as a root: with noise.
    sigma : float, m
        Noise of a point of one repeat.
    dof : int
        Degrees of freedom of u, repeats - 1.
    """

    rms: float
    u: float
    mean_square: float
    u_mean_square: float
    raw: float
    sigma: float
    dof: int


@documented(repeats=REPEATS)
def noise_free_rms(objects: Sequence[Profile | Surface], *, centre: bool = True) -> NoiseFreeRms:
    """Return the rms height that repeats share: Rq^2 = mean product of two repeats.

    Parameters
    ----------
    objects : sequence of Profile or of Surface
        At least 2, on the same points, with independent noise.
    centre : bool, optional
        Whether the mean height of each repeat is removed first.

    Returns
    -------
    NoiseFreeRms
        Rms with uncertainty, and the raw rms with noise beside it.

    Raises
    ------
    $repeats
    DataError
        If `centre` is not True or False.

    Notes
    -----
    With z the part and e_r the noise of repeat r, the mean over all pairs of mean(z_r z_s) has
    the expectation mean(z^2), whatever sigma and the correlation within a repeat. What repeats
    share (reference errors, drift that repeats) stays in. Its variance is estimated by
    (4 / R) var_r(mean(z_bar z_r)) + 2 sigma^4 / (R (R - 1) n_eff), where the first term holds
    the scatter of the repeats (R - 1 degrees of freedom) and n_eff the independent points of
    the noise; near the noise floor the first holds part of the second (u some 10 % too large).
    Then u(rms) = u(mean square) / (2 rms), or its root near zero.
    """
    centre = flag(centre, "centre")
    stack = stack_repeats(objects)
    noise = noise_of_repeats(objects, remove_mean=centre)
    z = stack[:, np.isfinite(stack[0])]
    if centre:
        z = z - z.mean(axis=1, keepdims=True)
    n_repeats, n = z.shape
    scale = float(np.abs(z).max()) or 1.0
    z = z / scale
    sum_of_squares = float(np.square(z).sum()) / n
    square_of_sum = float(np.square(z.sum(axis=0)).sum()) / n
    mean_square = (square_of_sum - sum_of_squares) / (n_repeats * (n_repeats - 1))
    along_mean = (z * z.mean(axis=0)).mean(axis=1)
    variance = 4.0 * type_a(along_mean).u ** 2
    variance += (
        2.0 * (noise.sigma / scale) ** 4 / (n_repeats * (n_repeats - 1) * noise.n_effective)
    )
    u_square = math.sqrt(variance)
    rms = math.sqrt(max(mean_square, 0.0))
    u = u_square / (2.0 * rms) if mean_square > u_square else math.sqrt(u_square)
    return NoiseFreeRms(
        rms * scale,
        u * scale,
        mean_square * scale**2,
        u_square * scale**2,
        math.sqrt(sum_of_squares / n_repeats) * scale,
        noise.sigma,
        n_repeats - 1,
    )


# ---- whether values over parts differ at all, or by the rounding of their own computation only ----
# What a fit takes away is zero but for rounding: the piston of a map that was levelled is 1e-24 m beside
# heights of 1e-8 m. Rounding is deterministic, so it may well rise from part to part; a test against
# its own scatter would call that a drift.

RELATIVE_FLOOR = 1e-12
"""Of the largest value. A float rounds to 1.1e-16 of itself; a sum of n heights one by one, or normal
equations of condition n, lose n times that: 1e4 leaves a floor of 1e-12."""

_MOST = {"m": 1e-15, "rad": 1e-15}
"""Of a floor from other terms, in m and rad: a radius of 1 km beside roughness does not make 1 nm a
rounding, and nothing here measures 1 fm."""


def floors(sizes: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the spread up to which values of a unit are the same, by unit."""
    largest: dict[str, float] = {}
    for unit, value in sizes:
        if unit in _MOST and math.isfinite(value):
            largest[unit] = max(largest.get(unit, 0.0), abs(value))
    return {u: min(RELATIVE_FLOOR * size, _MOST[u]) for u, size in largest.items()}


def constant(values: Sequence[float] | FloatArray, floor: float = 0.0) -> bool:
    """Return whether values are the same to within rounding.

    Examples
    --------
    >>> constant([1e-24, -3e-24], 2e-20), constant([1e-9, 1.001e-9], 2e-20)
    (True, False)
    """
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    if known.size == 0:
        return True
    least, most = float(known.min()), float(known.max())
    return most - least <= max(floor, RELATIVE_FLOOR * max(abs(least), abs(most)))


def term_floors(
    table: Mapping[str, FloatArray], units: Mapping[str, str], sizes: Mapping[str, float] | None
) -> dict[str, float]:
    """Return the floor of each term of a table."""
    of = {k: units.get(k, "m") for k in table}
    found = floors(
        [*((of[k], float(x)) for k, v in table.items() for x in v), *(sizes or {}).items()]
    )
    return {k: found.get(u, 0.0) for k, u in of.items()}
