"""Diagonal displacement tests after ISO 230-6: deviations of each diagonal and squareness.

Each diagonal is a positioning test along its own line: targets are distances from its start, error
= reached minus target. Names of diagonals and signs of squareness: `metrosep.separation.squareness`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.separation._result_values import plain, reduced
from metrosep.separation.positioning import iso230_2
from metrosep.separation.positioning_result import PositioningTest
from metrosep.separation.squareness import (
    Squareness,
    canonical_name,
    checked_travel,
    squareness_from_diagonals,
)

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["DiagonalTest", "iso230_6_diagonals", "squareness_from_diagonals"]


_LEAST_SHARE = 0.5
"""Of the diagonal; below it the size does not belong to the targets (mm for m)."""

_WHOLE_SHARE = 0.9
"""Of the diagonal; below it the length error is said to be extrapolated."""

Reached = tuple[ArrayLike, ArrayLike | None, ArrayLike | None]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DiagonalTest:
    """Result of diagonal displacement tests.

    Parameters
    ----------
    tests : mapping of str to PositioningTest
        Each diagonal: E, B, R, A, M with uncertainties.
    systematic : Quantity
        E of the diagonals: the largest bidirectional systematic deviation, m.
    reversal : Quantity or None
        B of the diagonals: the largest reversal error, m; None without a bidirectional one.
    length_errors : mapping of str to Quantity
        Error of the whole length of each diagonal in m, by its canonical name.
    squareness : Squareness or None
        None where `size` was not given or the diagonals do not determine any angle.
    audit : mapping
        Settings and counts, plain values.
    messages : tuple of str
        What the user should know.
    """

    tests: Mapping[str, PositioningTest]
    systematic: Quantity
    reversal: Quantity | None
    length_errors: Mapping[str, Quantity]
    squareness: Squareness | None
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def to_frame(self) -> pd.DataFrame:
        """Return the diagonals as a data frame.

        Returns
        -------
        pandas.DataFrame
            Index ``diagonal``; columns ``E_um``, ``B_um``, ``R_um``, ``A_um``, ``length_error_um``,
            ``u_length_error_um``; NaN where a direction is missing.
        """
        import pandas as pd

        rows = {}
        for name, test in self.tests.items():
            q = self.length_errors[canonical_name(name)[0]]
            rows[name] = {
                f"{key}_um": test[key].value * 1e6 if key in test else math.nan
                for key in ("E", "B", "R", "A")
            }
            rows[name]["length_error_um"] = q.value * 1e6
            rows[name]["u_length_error_um"] = math.nan if q.u is None else q.u * 1e6
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("diagonal")

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None.

        Returns
        -------
        dict
            ``tests`` and ``length_errors`` by diagonal, ``systematic``, ``reversal``,
            ``squareness``, ``audit``, ``messages``.
        """
        angles = self.squareness
        found: dict[str, Any] = plain({f.name: getattr(self, f.name) for f in fields(self)})
        return {
            **found,
            "tests": plain({name: test.to_dict() for name, test in self.tests.items()}),
            "squareness": None if angles is None else angles.to_dict(),
        }

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def __repr__(self) -> str:
        parts = [f"{len(self.tests)} diagonals", f"E {self.systematic}"]
        parts += [] if self.reversal is None else [f"B {self.reversal}"]
        parts += [] if self.squareness is None else [repr(self.squareness)]
        return f"DiagonalTest({', '.join(parts)})"


def iso230_6_diagonals(
    diagonals: Mapping[str, Reached],
    *,
    size: Sequence[float] | None = None,
    confidence: float = 0.95,
    seed: int = 0,
) -> DiagonalTest:
    """Return deviations of body or face diagonals and, with the size, squareness.

    Parameters
    ----------
    diagonals : mapping of str to tuple of (targets, forward, backward)
        By name (``"ppp"``, ``"npp"``, ``"pnp"``, ``"nnp"``; faces ``"pp0"``, ``"np0"``, ...): the
        arguments of `iso230_2`, targets and positions along the diagonal in m, forward is away
        from its start. One direction may be None.
    size : sequence of 3 float, m, optional
        Travel along X, Y, Z between the ends of the diagonals. With it squareness is evaluated.
    confidence : float, optional
        Of the repeatability intervals.
    seed : int, optional
        Of the simulations behind the uncertainties.

    Returns
    -------
    DiagonalTest
        ``.tests[name]["E"]``, ``.systematic`` and ``.reversal`` (the largest of all),
        ``.length_errors``, ``.squareness``.

    Raises
    ------
    DataError
        If a name is no diagonal or stands twice, there is none, a diagonal is no triple, size is
        not three positive lengths, or the targets are longer than the diagonal or shorter than
        half of it.
    TooFewSamplesError
        If a diagonal has fewer than 2 targets or runs.
    InvalidSamplesError
        If shapes do not fit or positions are deviations.
    UnitError
        If a length error exceeds 1 %.

    Notes
    -----
    The length error is the slope of the mean error (mean of both directions) over position, by
    least squares, times the diagonal; its u is from the scatter of the runs about their means. A
    shear or a scale error grows linearly along the diagonal, so nothing is lost, and the periodic
    errors of the axes weigh less than in the two ends alone.

    References
    ----------
    .. [1] ISO 230-6:2002, diagonal and step diagonal displacement tests (from memory).

    Examples
    --------
    >>> t = np.array([0.0, 0.5, 1.0])
    >>> reached = np.column_stack([t * (1 + 2e-6), t * (1 + 2e-6)])
    >>> test = iso230_6_diagonals({"ppp": (t, reached, reached)})
    >>> round(test.systematic.value * 1e6, 6)
    2.0
    """
    wanted = "pass a mapping such as {'ppp': (targets, up, down)}"
    if not isinstance(diagonals, Mapping):
        raise DataError(f"diagonals is a {type(diagonals).__name__}; {wanted}")
    if not diagonals:
        raise DataError(f"no diagonal was given; {wanted}")
    travel = None if size is None else checked_travel(size)
    tests: dict[str, PositioningTest] = {}
    lengths: dict[str, Quantity] = {}
    for name, data in diagonals.items():
        own, _ = canonical_name(name)
        if own in lengths:
            raise DataError(f"diagonal {own} stands twice ({name!r} is the same line)")
        if not isinstance(data, (tuple, list)):
            raise DataError(
                f"{name}: pass (targets, forward, backward), got a {type(data).__name__}"
            )
        if len(data) != 3:
            raise DataError(f"{name}: pass (targets, forward, backward), got {len(data)} items")
        tests[name] = iso230_2(*data, confidence=confidence, seed=seed)
        lengths[own] = _length_error(own, tests[name], travel)
    squareness, messages = _squareness(lengths, size)
    if travel is not None:
        messages += _extrapolated(tests, travel)
    return DiagonalTest(
        tests=freeze_mapping(tests),
        systematic=_largest(
            tests, ("E", "E_fwd", "E_bwd"), "systematic deviation of the diagonals"
        ),
        reversal=_reversal(tests),
        length_errors=freeze_mapping(lengths),
        squareness=squareness,
        audit=freeze_mapping(
            {
                "diagonals": list(tests),
                "size_mm": None if travel is None else [float(v) * 1e3 for v in travel],
                "length": "least-squares slope times the diagonal",
            }
        ),
        messages=(*messages, *(f"{n}: {m}" for n, t in tests.items() for m in t.messages)),
    )


def _length_error(name: str, test: PositioningTest, travel: FloatArray | None) -> Quantity:
    """Return slope times diagonal with its standard uncertainty from the runs."""
    span = float(np.ptp(test.targets))
    nominal = span
    if travel is not None:
        nominal = _nominal(name, travel)
        if span < _LEAST_SHARE * nominal:
            raise DataError(
                f"{name}: the targets span {span:.6g} m, less than half of the diagonal of this "
                f"size, {nominal:.6g} m; check size (in m) and targets"
            )
        if not span <= nominal * (1.0 + 1e-3):
            raise DataError(
                f"{name}: the targets span {span:.6g} m, the diagonal of this size is {nominal:.6g} "
                "m long; check size and targets"
            )
    ways = [
        (mean, sd, errors)
        for mean, sd, errors in (
            (test.mean_forward, test.sd_forward, test.forward),
            (test.mean_backward, test.sd_backward, test.backward),
        )
        if errors is not None and np.count_nonzero(~np.isnan(mean)) >= 2
    ]
    slopes, variances = [], []
    for mean, sd, errors in ways:
        used = ~np.isnan(mean)
        lever = test.targets[used] - test.targets[used].mean()
        lever = lever / float(lever @ lever)
        slopes.append(float(lever @ mean[used]))
        count = np.count_nonzero(~np.isnan(errors), axis=1)[used]
        variances.append(float((lever**2) @ (sd[used] ** 2 / count)))
    value = nominal * float(np.mean(slopes))
    u = nominal * math.sqrt(sum(variances)) / len(slopes)
    return Quantity(
        value, "m", f"length error of diagonal {name}, actual - nominal", u, f"dL_{name}"
    )


def _nominal(name: str, travel: FloatArray) -> float:
    moves = np.array([letter != "0" for letter in name])
    return float(np.sqrt((travel[moves] ** 2).sum()))


def _extrapolated(tests: Mapping[str, PositioningTest], travel: FloatArray) -> list[str]:
    said = []
    for name, test in tests.items():
        share = float(np.ptp(test.targets)) / _nominal(canonical_name(name)[0], travel)
        if share < _WHOLE_SHARE:
            said.append(
                f"{name}: the targets cover {100.0 * share:.0f} % of the diagonal: its length error "
                "is extrapolated"
            )
    return said


def _largest(tests: Mapping[str, PositioningTest], keys: tuple[str, ...], text: str) -> Quantity:
    found = [next(t[k] for k in keys if k in t) for t in tests.values()]
    best = max(found, key=lambda q: q.value)
    return Quantity(best.value, "m", f"{text}, the largest, ISO 230-6", best.u, keys[0])


def _reversal(tests: Mapping[str, PositioningTest]) -> Quantity | None:
    both = {n: t for n, t in tests.items() if "B" in t}
    return _largest(both, ("B",), "reversal error of the diagonals") if both else None


def _squareness(
    lengths: Mapping[str, Quantity], size: Sequence[float] | None
) -> tuple[Squareness | None, list[str]]:
    if size is None:
        return None, ["no squareness: pass size=(X, Y, Z), the travels of the diagonals"]
    values = {name: q.value for name, q in lengths.items()}
    u = {name: math.nan if q.u is None else q.u for name, q in lengths.items()}
    try:
        result = squareness_from_diagonals(values, size, u=u)
    except NotSeparableError as exc:
        return None, [str(exc)]
    return result, list(result.messages)
