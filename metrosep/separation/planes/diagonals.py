"""Diagonal displacement tests after ISO 230-6: deviations of each diagonal and squareness.

Each diagonal is a positioning test along its own line: targets are distances from its start, error
= reached minus target. Names of diagonals and signs of squareness: `metrosep.separation.planes.squareness`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError
from metrosep.core.methods import RoleColumns
from metrosep.core.options import Option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import (
    NOISE_UNKNOWN,
    checked_readings,
    known_parts,
    part_of,
)
from metrosep.separation.contract import (
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    StoredResult,
    Unobservable,
    pooled,
)
from metrosep.separation.planes.squareness import (
    PAIRS,
    Squareness,
    canonical_name,
    checked_travel,
    design_of,
    signs_of,
    squareness_from_diagonals,
)
from metrosep.separation.positions.positioning import (
    POSITION_OPTIONS,
    as_positions,
    iso230_2,
    reached,
)
from metrosep.separation.positions.positioning_result import PositioningTest

if TYPE_CHECKING:
    import pandas as pd

_LEAST_SHARE = 0.5
"""Of the diagonal; below it the size does not belong to the targets (mm for m)."""

_WHOLE_SHARE = 0.9
"""Of the diagonal; below it the length error is said to be extrapolated."""

Reached = tuple[ArrayLike, ArrayLike | None, ArrayLike | None]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DiagonalTest(StoredResult):
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
        """Return a row per diagonal: ``E_um``, ``B_um``, ``R_um``, ``A_um``, ``length_error_um`` and its u.

        NaN where a direction is missing.
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

    Returns
    -------
    DiagonalTest
        ``.tests[name]["E"]``, ``.systematic`` and ``.reversal`` (the largest of all),
        ``.length_errors``, ``.squareness``.

    Raises
    ------
    DataError
        If a name is not a diagonal or is given twice, there is none, a diagonal is not a triple, size is
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
            raise DataError(f"diagonal {own} is given twice ({name!r} is the same line)")
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
        tests=tests,
        systematic=_largest(
            tests, ("E", "E_fwd", "E_bwd"), "systematic deviation of the diagonals"
        ),
        reversal=_reversal(tests),
        length_errors=lengths,
        squareness=squareness,
        audit={
            "diagonals": list(tests),
            "size_mm": None if travel is None else [float(v) * 1e3 for v in travel],
            "length": "least-squares slope times the diagonal",
        },
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
    messages = []
    for name, test in tests.items():
        share = float(np.ptp(test.targets)) / _nominal(canonical_name(name)[0], travel)
        if share < _WHOLE_SHARE:
            messages.append(
                f"{name}: the targets cover {100.0 * share:.0f} % of the diagonal: its length error "
                "is extrapolated"
            )
    return messages


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


# ---- `Diagonals`: length errors of body and face diagonals separated into squareness and scale errors ----
# ``dL = (sum e_i s_i^2 L_i^2 + sum a_ij s_i s_j L_i L_j) / D + g D``: a of the angles, e of the axes, g
# of the instrument, which reads everything too long by its share. Signs: `metrosep.separation.planes.squareness`.

_SCALES = ("scale_x", "scale_y", "scale_z")
_INSTRUMENT = (
    "an instrument that reads too long looks like axes that are too long: calibrate its wavelength, "
    "dead path and temperature"
)
_OPEN = "these diagonals do not determine it alone: add both diagonals of the faces"


class DiagonalsOfTables(NamedMethod):
    """`iso230_6_diagonals` by its name: a file for each diagonal, or one that names them."""

    name = "iso230_6_diagonals"
    what = "deviations along diagonals and squareness of the axes, ISO 230-6"
    reads = "tables"
    roles: ClassVar[Mapping[str, str]] = {
        "target": "length?", "direction": "label?", "readings": "length*?", "diagonal": "label?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = {
        "names": Option("texts", help="of the diagonals, one for each file: ppp,npp"),
        "size": Option("lengths", help="of the volume along x, y and z"),
        **POSITION_OPTIONS,
    }

    @classmethod
    def from_inputs(cls, data: Sequence[RoleColumns], options: Mapping[str, Any]) -> DiagonalTest:
        """Return the evaluation of the diagonals."""
        rest = dict(options)
        names, values = rest.pop("names", None), rest.pop("values", "position")
        tables = [as_positions(table, values) for table in data]
        first = tables[0]
        if "diagonal" in first.values:
            if len(tables) > 1 or names is not None:
                raise DataError(
                    "a column of diagonals is for one file; leave names out and give that file alone"
                )
            marks = first.values["diagonal"]
            diagonals = {
                str(name): reached(first, np.flatnonzero(marks == name))
                for name in dict.fromkeys(marks.tolist())
            }
        else:
            names = [t.name for t in tables] if names is None else names
            if len(names) != len(tables):
                raise DataError(
                    f"{len(names)} names of diagonals for {len(tables)} files; give one for each "
                    'file: names = ["ppp", "npp"]'
                )
            if len(set(names)) != len(names):
                raise DataError("a diagonal is named twice; give each file its own name")
            diagonals = {n: reached(t) for n, t in zip(names, tables, strict=True)}
        if not diagonals:
            raise NotSeparableError("there is no diagonal in the files")
        return iso230_6_diagonals(diagonals, **rest)


@dataclass(frozen=True, slots=True)
class Diagonals(RecordedMethod):
    """Diagonal displacement tests of one volume.

    Readings (n_diagonals, M) in m: length error (actual minus nominal) of each diagonal, M times, NaN
    = not measured. Parts are scalars: ``xy``, ``xz``, ``yz`` in rad, ``scale_x``, ``scale_y``,
    ``scale_z`` and ``instrument`` relative; NaN where not determined, which adds nothing when it is
    simulated. `squareness_from_diagonals` does the work, to first order; what the second order would
    add is in the audit. ``u`` of each length is ``s / sqrt(M)``; four body diagonals of one D give
    ``u(a_xy) = D s / (2 X Y sqrt(M))``. A length error above 1 % is refused with a UnitError.

    Parameters
    ----------
    names : tuple of str
        Of the diagonals, in the order of the readings: ``"ppp"``, ``"npp"``, ``"pp0"``, ...
    size : tuple of 3 float, m
        Travel along X, Y and Z between their ends.

    Raises
    ------
    DataError
        If a name is not a diagonal or is given twice, or the size is not three positive lengths.
    NotSeparableError
        If no angle is determined by these diagonals.

    Examples
    --------
    >>> method = Diagonals(("ppp", "npp", "pnp", "nnp"), (1.0, 1.0, 1.0))
    >>> lengths = method.simulate({}, {"xy": 3e-6})
    >>> found = method.separate(lengths, u_reading=1e-7)
    >>> round(float(found.xy) * 1e6, 6), bool(np.isnan(found.scale_x))
    (3.0, True)
    """

    names: tuple[str, ...]
    size: tuple[float, float, float]

    name = "diagonals"
    truth_parts = ("instrument",)
    error_parts = (*PAIRS, *_SCALES)

    def __post_init__(self) -> None:
        names: Any = self.names
        if isinstance(names, str) or not isinstance(names, Sequence):
            raise DataError(f"names are a tuple such as ('ppp', 'npp'), got {self.names!r}")
        self._solve(np.zeros(len(self.names)), None)

    def _solve(self, lengths: FloatArray, u: FloatArray | None) -> Squareness:
        own = [canonical_name(n)[0] for n in self.names]
        if len(set(own)) < len(own):
            raise DataError(f"a diagonal is given twice in {', '.join(self.names)}")
        table = dict(zip(own, lengths.tolist(), strict=True))
        spread = None if u is None else dict(zip(own, u.tolist(), strict=True))
        return squareness_from_diagonals(table, self.size, u=spread)

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        given = {
            name: float(np.nan_to_num(part_of(parts, name, (), self.name), nan=0.0))
            for name in (*self.truth_parts, *self.error_parts)
        }
        signs = signs_of([canonical_name(n)[0] for n in self.names])
        diagonal = np.sqrt((signs**2) @ checked_travel(self.size) ** 2)
        machine = design_of(signs, checked_travel(self.size)) @ [
            given[name] for name in self.error_parts
        ]
        return np.asarray(machine + given["instrument"] * diagonal)[:, None]

    def null_space(self) -> tuple[Unobservable, ...]:
        found = _values(self._solve(np.zeros(len(self.names)), None))
        lost = [name for name, value in found.items() if math.isnan(value)]
        seen = [name for name in _SCALES if name not in lost]
        return (
            Unobservable("instrument", "term", ("all of it",), _INSTRUMENT),
            *(Unobservable(name, "term", (name,), _OPEN) for name in lost),
            *(Unobservable(name, "term", ("common to all axes",), _INSTRUMENT) for name in seen),
        )

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = checked_readings(readings, names=self.names, minimum=1, what=self.name)
        array = array.reshape(len(self.names), -1)
        count = (~np.isnan(array)).sum(axis=1)
        mean = np.nansum(array, axis=1) / count
        squares = float(np.nansum((array - mean[:, None]) ** 2))
        text = "standard deviation of one length, pooled from the repeats (type A)"
        noise = pooled(squares, float((count - 1).sum()), stated, text, of="length")
        s = noise.value
        found = self._solve(mean, None if math.isnan(s) else s / np.sqrt(count))
        quantities = {**found.angles, **{f"scale_{k}": q for k, q in found.scales.items()}}
        parts = {"instrument": math.nan, **_values(found)}
        u = {n: math.nan if q.u is None else q.u for n, q in quantities.items()}
        messages = tuple(m for m in found.messages if not m.startswith("no standard"))
        return Separation(
            self.name,
            {n: np.array(v) for n, v in parts.items()},
            {"instrument": np.array(math.nan), **{n: np.array(v) for n, v in u.items()}},
            {n: "rad" if n in PAIRS else "1" for n in parts},
            {},
            self.null_space(),
            noise=noise,
            audit={
                **found.audit,
                "n_repeats": int(array.shape[1]),
                "second_order_urad": {k: v * 1e6 for k, v in found.remainder.items()},
            },
            messages=(*messages, *((NOISE_UNKNOWN,) if math.isnan(s) else ())),
            history=(*history, Step(self.name, {"size_m": [float(v) for v in self.size]})),
        )


def _values(found: Squareness) -> dict[str, float]:
    angles = {pair: found.angles[pair].value for pair in PAIRS}
    return {**angles, **{f"scale_{k}": found.scales[k].value for k in "xyz"}}
