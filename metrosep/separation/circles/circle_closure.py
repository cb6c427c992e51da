"""Circle closure: a polygon and an index table calibrate each other without a standard.

In set-up p the polygon sits p positions on; at table index j the comparator reads
``m_pj = a_(j+p) + t b_j + c_p``: a the angle errors of the faces, b those of the table, c_p the zero
of the set-up, indices modulo N, and t = -1: reading = angle of the artefact minus that of the
table (t = +1 if the error of the table adds to the reading). Errors are actual minus nominal,
cumulative from a mean of zero; those of the pitches are their differences and sum to zero, since
the pitches sum to 360 degrees whatever they are: the circle is its own standard of scale.

Source: C. J. Evans, R. J. Hocken, W. T. Estler, CIRP Annals 45 (1996) 617, circle closure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.methods import Readings
from metrosep.core.numbers import count
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import known_parts, part_of
from metrosep.separation.circles._circle import (
    check_sign,
    check_u_reading,
    grid,
    hidden_message,
    numbers,
    reading_noise,
    unseen,
)
from metrosep.separation.contract import (
    History,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
    settle,
    suppressed_harmonics,
)

_PARTS = ("artefact", "machine")
_ZERO = (
    "a common angle of all divisions is the zero of the comparator; errors are given about their "
    "mean"
)
_ALIKE = (
    "all positions of the artefact show these alike, so artefact and table cannot be separated; add "
    "a position that shares no factor with N"
)

_LARGEST = 0.1
"""Readings in rad further from their mean are degrees or seconds of arc by mistake."""

_SINGULAR = 1e-9
"""Eigenvalues below this share of the largest are zero: the normal matrix counts readings."""


@dataclass(frozen=True)
class CircleClosure(RecordedMethod):
    """Angle comparisons of a divided circle with another one of as many divisions.

    Readings (P, N) in rad: row p is the set-up with the artefact `positions[p]` divisions on,
    column j the table index, NaN where not measured. Parts: ``artefact`` and ``machine``, angle
    errors of the faces and of the table, (N,), each about its mean. Noise that is not stated comes
    from the residuals.

    Parameters
    ----------
    n : int
        Divisions N of both, >= 3.
    positions : sequence of int, optional
        By how many divisions the artefact was turned on in each set-up, in the order of the
        readings; 0 ... N - 1 (full cross calibration) if omitted. A position may come twice.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 3 divisions or 2 set-ups.
    DataError
        If a position is not a whole number, or `table_sign` is neither -1 nor 1.
    NotSeparableError
        If all set-ups have the same position.

    Examples
    --------
    >>> CircleClosure(12, positions=(0, 3)).null_space()[1].indices
    (4,)
    """

    n: int
    positions: Any = option(
        None,
        kind="integers",
        help="divisions by which the artefact was turned on in each set-up, in the order of the "
        "readings; 0, 1, 2 ... if omitted",
    )
    table_sign: Literal[-1, 1] = option(
        -1,
        kind="integer",
        choices=(-1, 1),
        help="-1: reading = artefact minus table; 1: the errors add",
    )

    name = "closure"
    what = "angle errors of a polygon and of the table that carries it; one column a set-up"
    dimension = "angle"
    arguments: ClassVar[Mapping[str, Option]] = {
        "u_reading": Option("angle", help="standard uncertainty of one reading")
    }
    truth_parts = ("artefact",)
    error_parts = ("machine",)

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> Separation:
        """Return the errors of both circles; a row of the table is an index."""
        if data.values.shape[1] > 1:
            raise InvalidSamplesError(
                "closure takes one reading for each table index; average repeats first, and leave "
                "repeat out"
            )
        return closure(data.values[:, 0], **options)

    def __post_init__(self) -> None:
        n = count(self.n, "the number of divisions n", least=0)
        if n < 3:
            raise TooFewSamplesError(f"a divided circle needs >= 3 divisions, got {n}")
        given = range(n) if self.positions is None else self.positions
        try:
            whole = [int(p) for p in given]
            exact = all(p == q for p, q in zip(whole, given, strict=True))
        except (TypeError, ValueError, OverflowError):
            whole, exact = [], False
        if not exact:
            raise DataError(f"positions must be whole numbers of divisions, got {given!r}")
        if len(whole) < 2:
            raise TooFewSamplesError(f"need >= 2 set-ups, got {len(whole)}")
        sign = check_sign(self.table_sign, "table_sign")
        settle(self, n=n, positions=tuple(p % n for p in whole), table_sign=sign)
        if len(set(self.positions)) == 1:
            raise NotSeparableError(
                "all set-ups have the artefact at the same position, so artefact and table "
                "cannot be separated; turn the artefact between set-ups"
            )

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        given = known_parts(self, truth, errors)
        parts = {name: part_of(given, name, (self.n,), self.name) for name in _PARTS}
        faces = np.array([np.roll(parts["artefact"], -p) for p in self.positions])
        out: FloatArray = faces + self.table_sign * parts["machine"]
        return out

    def null_space(self) -> tuple[Unobservable, ...]:
        k = np.arange(1, self.n // 2 + 1)
        steps = np.array(self.positions) - self.positions[0]
        hidden = k[(np.outer(k, steps) % self.n == 0).all(axis=1)]
        return tuple(
            item
            for part in _PARTS
            for item in unseen(part, hidden, _ALIKE, terms=("offset",), why=_ZERO)
        )

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        check_u_reading(stated, "rad")
        array = _checked_angles(readings, len(self.positions), self.n)
        null_space = self.null_space()
        hidden = suppressed_harmonics(null_space)
        parts, unit_u, residual, rank = self._solution(array, hidden)
        n_readings = int(np.isfinite(array).sum())
        n_missing, freedom = array.size - n_readings, n_readings - rank
        noise = _noise_of_residuals(stated, residual, freedom)
        messages = hidden_message(
            hidden,
            "alike at all positions and absent from both parts",
            of=" of the divided circle",
        )
        if math.isnan(noise.value):
            messages.append(
                "no reading is redundant: give u_reading or one more position; no uncertainty is "
                "stated"
            )
        if n_missing:
            messages.append(f"{n_missing} of {array.size} readings are not measured")
        return Separation(
            self.name,
            dict(zip(_PARTS, parts, strict=True)),
            dict(zip(_PARTS, noise.value * unit_u, strict=True)),
            dict.fromkeys(_PARTS, "rad"),
            {"angle": grid(self.n)},
            null_space,
            noise,
            audit={
                "n_divisions": self.n,
                "positions": list(self.positions),
                "table_sign": self.table_sign,
                "n_readings": n_readings,
                "n_not_measured": n_missing,
                "residual_freedom": freedom,
                "suppressed": hidden,
                "removed": "zero of each set-up, mean of both parts",
                "noise_source": noise.definition,
            },
            messages=tuple(messages),
            history=(*history, Step(self.name, {"n": self.n, "positions": list(self.positions)})),
        )

    def _solution(
        self, array: FloatArray, hidden: list[int]
    ) -> tuple[FloatArray, FloatArray, FloatArray, int]:
        """Return parts, their u for unit noise, residuals, and the rank of the normal matrix.

        The unknowns are N faces, N table errors and P zeros of the set-ups.
        """
        (p, n), sign = array.shape, float(self.table_sign)
        taken = np.isfinite(array).astype(np.float64)
        value = np.where(taken > 0.0, array, 0.0)
        face = (np.arange(n) + np.array(self.positions)[:, np.newaxis]) % n
        size = 2 * n + p
        normal, right = np.zeros((size, size)), np.zeros(size)
        table = np.broadcast_to(n + np.arange(n), (p, n))
        setup = np.broadcast_to(2 * n + np.arange(p)[:, np.newaxis], (p, n))
        columns = ((face, 1.0), (table, sign), (setup, 1.0))
        for i, first in columns:
            np.add.at(right, i, first * value)
            for j, second in columns:
                np.add.at(normal, (i, j), first * second * taken)
        # the projector that takes off the mean and the hidden harmonics
        steps = np.subtract.outer(np.arange(n), np.arange(n))
        keep: FloatArray = np.eye(n) - 1.0 / n
        for k in hidden:
            keep -= (1.0 if 2 * k == n else 2.0) / n * np.cos(2.0 * np.pi * k * steps / n)
        with one_blas_thread():
            values, vectors = np.linalg.eigh(normal)
            known = values > _SINGULAR * values[-1]
            root = vectors[:, known] / np.sqrt(values[known])
            found = root @ (root.T @ right)
            spread = np.stack([keep @ root[:n], keep @ root[n : 2 * n]])
        rank = int(known.sum())
        extra = size - rank - 2 - sum(1 if 2 * k == n else 2 for k in hidden)
        if extra:
            raise NotSeparableError(
                f"{int(np.isnan(array).sum())} readings are missing, and those taken leave "
                f"{extra} more combinations of divisions open than these positions must; measure "
                "each face and each table index in more than one set-up"
            )
        return (
            np.stack([keep @ found[:n], keep @ found[n : 2 * n]]),
            np.sqrt(np.sum(spread**2, axis=2)),
            array - (found[face] + sign * found[table] + found[setup]),
            rank,
        )


@described_by(CircleClosure, CircleClosure.separate)
def closure(
    m: ArrayLike,
    *,
    positions: Sequence[int] | None = None,
    table_sign: Literal[-1, 1] = -1,
    u_reading: float | None = None,
) -> Separation:
    """Return angle errors of a divided circle and of the table that carried it.

    Parameters
    ----------
    m : array_like, shape (P, N), rad
        Row p: readings at the N table indices with the artefact turned on by `positions[p]`.
    positions : sequence of int, optional
        Divisions by which the artefact was turned on; 0 ... P - 1 if omitted.

    Returns
    -------
    Separation
        ``.artefact``, ``.machine`` in rad, each about its mean.

    Raises
    ------
    NotSeparableError
        If the set-ups do not tie all divisions together.
    UnitError
        If the readings look like degrees or seconds of arc.

    Notes
    -----
    Least squares. All N positions: ``u = s sqrt((N - 1)) / N`` for each division. Fewer positions
    leave those harmonics k open for which k times each difference of positions is a multiple of N;
    they are absent from both parts and named.

    Examples
    --------
    >>> polygon, table = np.array([2e-6, -1e-6, -1e-6]), np.array([1e-6, 1e-6, -2e-6])
    >>> found = closure([np.roll(polygon, -p) - table + 5e-6 for p in range(3)])
    >>> bool(np.abs(found.artefact - polygon).max() < 1e-18)
    True
    """
    try:
        shape = np.shape(m)
    except ValueError:
        shape = ()
    if len(shape) != 2:
        raise InvalidSamplesError(f"closure needs readings of shape (set-ups, N), got {shape}")
    given = range(shape[0]) if positions is None else positions
    if len(given) != shape[0]:
        raise DataError(f"{len(given)} positions do not fit {shape[0]} rows of readings")
    return CircleClosure(shape[1], given, table_sign).separate(m, u_reading=u_reading)


def _checked_angles(readings: ArrayLike, p: int, n: int) -> FloatArray:
    """Return readings (p, n) in rad, refused if infinite, of another shape or unit."""
    array = numbers(readings, "the readings must be a regular array of numbers in rad")
    if array.shape != (p, n):
        raise InvalidSamplesError(
            f"readings of {p} set-ups with {n} divisions need the shape ({p}, {n}), got "
            f"{array.shape}"
        )
    if np.isinf(array).any():
        i, j = (int(v) for v in np.argwhere(np.isinf(array))[0])
        raise InvalidSamplesError(f"reading {j} of set-up {i} is infinite; mark it NaN")
    if np.isnan(array).all():
        raise InvalidSamplesError("nothing was measured: all readings are NaN")
    counts = np.maximum(np.isfinite(array).sum(axis=1), 1)
    spread = array - (np.nansum(array, axis=1) / counts)[:, np.newaxis]
    largest = float(np.nanmax(np.abs(spread)))
    if largest > _LARGEST:
        raise UnitError(
            f"readings differ by up to {largest:.4g} from their mean; they must be in rad: degrees "
            "or seconds of arc? give numpy.deg2rad(m), or that of m / 3600"
        )
    return array


def _noise_of_residuals(stated: float | None, rest: FloatArray, freedom: int) -> Quantity:
    """Return the noise of one reading: as stated, else from the residuals."""
    if stated is not None:
        return reading_noise(stated, "as stated", unit="rad")
    if freedom < 1:
        return reading_noise(math.nan, "not known", unit="rad")
    value = math.sqrt(float(np.nansum(rest**2)) / freedom)
    text = f"type A from residuals, {freedom} degrees of freedom"
    return reading_noise(value, text, value / math.sqrt(2.0 * freedom), unit="rad")
