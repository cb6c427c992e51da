"""From the errors of a machine to tables on its axes: what each axis must add to its command.

With J the derivative of the nominal tool point with respect to the corrected linear axes, the
volumetric error E (actual minus nominal, workpiece coordinates) is what a perfect machine would do
at commands that are wrong by ``e = J^+ E``. The corrections solve, for all axes at once,

    c(q) = -(e(q + c(q)) - e(reference)),

looked up at the command, acting where the axes then are. What no axis can do, ``E - J e``, stays
and is reported. J does not depend on where the linear axes are, so this holds exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation._machine_errors import (
    VolumetricError,
    at_nodes,
    positions_by_axis,
    positions_to_axes,
    rms_of_vectors,
    volumetric_source,
)
from metrosep.compensation.area_errors import format_position, is_rotary, rising
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.volumes import AXES, MachineVolume
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotConvergedError, SignCheckFailedError, TableError
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.units import format_engineering, format_length
from metrosep.machine.chains import Chain
from metrosep.machine.elements import require_travel, term_unit
from metrosep.machine.error_sets import ErrorSet, as_error_set

Table = CompensationTable | CompensationMap

_TOLERANCE = 1e-13
"""Convergence of the fixed point in m: a tenth of a picometre."""

_MAX_STEPS = 60

ZERO = 1e-12
"""Below a picometre the correction at the reference counts as zero."""

_NOTHING = 1e-15
"""A femtometre: what is left below it is rounding."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MachineTables(Mapping[str, Table]):
    """Tables or maps of a machine by corrected axis, with what they leave.

    Parameters
    ----------
    tables : mapping of str to CompensationTable or CompensationMap
        One for each corrected axis, all over the same axes.
    over : tuple of str
        One or two axes whose positions are looked up.
    at : mapping of str to float, m or rad
        Where the other axes stood: there, and only there, the tables are right.
    error : ndarray, shape (n, 3) or (m, n, 3), m
        Error at the nodes in workpiece X, Y, Z, about the reference; NaN where not measured.
    left : ndarray, shape of error, m
        The same with the tables active.
    messages : tuple of str
        What no axis corrects, and other things to know.
    source : VolumetricError
        The error as a function of the commands.

    Notes
    -----
    A mapping: ``tables["Z"]``, ``"X" in tables``, ``len(tables)``.
    """

    tables: Mapping[str, Table]
    over: tuple[str, ...]
    at: Mapping[str, float]
    error: FloatArray
    left: FloatArray
    messages: tuple[str, ...]
    source: VolumetricError = field(repr=False)

    def __getitem__(self, axis: str) -> Table:
        if axis not in self.tables:
            raise KeyError(f"no table corrects {axis!r}; there are {', '.join(self.tables)}")
        return self.tables[axis]

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables)

    def __len__(self) -> int:
        return len(self.tables)

    def __repr__(self) -> str:
        return (
            f"MachineTables({', '.join(self.over)} -> {', '.join(self.tables)}, error "
            f"{format_length(rms_of_vectors(self.error))} RMS, left {format_length(rms_of_vectors(self.left))})"
        )

    def residual(
        self,
        positions: Mapping[str, ArrayLike],
        *,
        sign: int = 1,
        corrections: Mapping[str, Callable[..., FloatArray]] | None = None,
    ) -> FloatArray:
        """Return the error of the tool point with the tables active, anywhere.

        Parameters
        ----------
        positions : mapping of str to array_like, m or rad
            Commands of the looked-up axes, and of others that do not stand where `at` says.
        sign : {1, 0, -1}, optional
            1 as the tables are, 0 without them, -1 with the sign reversed.
        corrections : mapping of str to callable, optional
            What a controller adds, by corrected axis (`metrosep.controllers.simulate`), in place of
            what these tables hold.

        Returns
        -------
        ndarray, shape (..., 3), m
            In workpiece X, Y, Z, about the reference; NaN in a component that was not measured.

        Raises
        ------
        DataError
            A position is missing, an axis unknown, or a term is not known there.
        InvalidSamplesError
            Positions are not real numbers, infinite, or do not broadcast.

        Notes
        -----
        Commands with the corrections added are put through the chain again: interpolation between
        the nodes and the other places of the other axes are in the result.
        """
        q = {**self.at, **positions}
        missing = [a for a in self.over if a not in positions]
        if missing:
            raise DataError(f"positions lack the looked-up axis {missing[0]!r}")
        looked = [np.asarray(positions[a], dtype=np.float64) for a in self.over]
        read = corrections or {}
        c = {
            a: sign * (read[a](*looked) if a in read else _looked_up(t, looked))
            for a, t in self.tables.items()
        }
        full = {a: v - self.tables[a].offset_removed for a, v in c.items()}
        return self.source.remaining(q, c, full)

    def verify(self, positions: Mapping[str, ArrayLike] | None = None) -> dict[str, Any]:
        """Return error before, after and with the sign reversed, and refuse if it does not shrink.

        Parameters
        ----------
        positions : mapping of str to array_like, m or rad, optional
            Where; if omitted, at the nodes and between them.

        Returns
        -------
        dict
            ``before_rms_m``, ``after_rms_m``, ``wrong_sign_rms_m`` of the error vector, and for
            each workpiece direction P-V before and after; ``passed``.

        Raises
        ------
        SignCheckFailedError
            If the RMS does not shrink.
        DataError
            A position is missing, an axis unknown, or a term is not known there.
        """
        where = self.between() if positions is None else positions
        before, after, wrong = (self.residual(where, sign=s) for s in (0, 1, -1))
        # the offset at the reference is the same in all three: it is no matter of the tables
        sizes = [rms_of_vectors(v) for v in (before, after, wrong)]
        result = {
            "passed": sizes[1] < sizes[0],
            **dict(zip(("before_rms_m", "after_rms_m", "wrong_sign_rms_m"), sizes, strict=True)),
            "before_pv_m": _pv(before),
            "after_pv_m": _pv(after),
        }
        if not result["passed"]:
            raise SignCheckFailedError(
                f"tables over {', '.join(self.over)}: the error does not shrink: RMS "
                f"{format_length(sizes[0])} -> {format_length(sizes[1])}, with the reversed sign "
                f"{format_length(sizes[2])}; the tables belong to other errors or another place"
            )
        return result

    def negated(self) -> MachineTables:
        """Return the tables with the sign reversed, for tests of sign checks.

        Returns
        -------
        MachineTables
            They double the error.
        """
        turned = {a: t.negated() for a, t in self.tables.items()}
        return replace(self, tables=freeze_mapping(turned))

    def between(self) -> dict[str, FloatArray]:
        """Return positions at the nodes and between them, which broadcast.

        Returns
        -------
        dict of str to ndarray, m or rad
            Of each looked-up axis; of two axes the second stands in columns.
        """
        table = next(iter(self.tables.values()))
        if isinstance(table, CompensationMap):
            return {self.over[0]: _finer(table.x), self.over[1]: _finer(table.y)[:, None]}
        return {self.over[0]: _finer(table.positions)}


def tables_from_machine(
    chain: Chain,
    errors: ErrorSet | Mapping[str, Any] | ArrayLike,
    *,
    over: str | Sequence[str],
    positions: ArrayLike | Sequence[ArrayLike] | Mapping[str, ArrayLike],
    corrects: Sequence[str] | None = None,
    at: Mapping[str, float] | None = None,
    reference: float | Sequence[float] | None = None,
    tool: ArrayLike = (0.0, 0.0, 0.0),
    exact: bool | str = False,
) -> MachineTables | MachineVolume:
    """Return tables on the axes of a machine that cancel its volumetric error.

    Parameters
    ----------
    chain : Chain
        The machine.
    errors : ErrorSet, mapping of str to term, Surface, ErrorMap or array_like
        Error terms by name; or a measured error: a surface or map over the two axes (errors along
        the workpiece's Z), or an array (n, 3) or (m, n, 3) in m in workpiece X, Y, Z at the
        positions, with NaN in a whole component that was not measured.
    over : str or sequence of str
        One axis for tables, two for maps (first the columns), three for a volume.
    positions : array_like, or two of them, or mapping of str to array_like, m or rad
        Commands of the axes in `over`.
    corrects : sequence of str, optional
        Linear axes that are corrected; all that are joints here if omitted.
    at : mapping of str to float, m or rad, optional
        Where the other axes stand.
    reference : float or two of them, m or rad, optional
        Place of zero correction; of each axis 0 if it is in range, else its first position.
    tool : array_like, shape (3,), m, optional
        Tool point in the frame of the last element of the tool branch.
    exact : bool or str, optional
        How the chain multiplies, as for `Chain.volumetric_error`.

    Returns
    -------
    MachineTables or MachineVolume
        Mapping of corrected axis to `CompensationTable` or `CompensationMap`, with what is left; over
        three axes a `MachineVolume`, as of `volume_from_machine`.

    Raises
    ------
    DataError
        An axis is unknown, missing or turns, two corrected axes move the tool the same way, or a
        measured error has a gap.
    TableError
        Positions do not rise, a reference lies outside, or an axis would turn back.
    NotConvergedError
        The errors are so steep that the corrections do not settle.
    InvalidSamplesError
        Positions are not real numbers, or a term is not known there.
    LimitError
        A position is outside the stated travel of its axis, or a polynomial of
        `metrosep.process.run_polynomial` was not measured there.
    UnitError
        An error is above 1 m or 1 rad.

    Notes
    -----
    Least squares where the axes cannot follow all three directions: what stays is smallest in
    length. A table holds at the places of the other axes in `at`; `MachineTables.residual` says
    what it leaves elsewhere. ``u`` of the tables is that of the error in the direction of the axis,
    from the uncertainties in an `ErrorSet`; None for a plain mapping or a measurement. Where
    ``q + c`` leaves what a term knows, the errors are held at the end.

    References
    ----------
    .. [1] controllers notes, section 0: lookup at the uncorrected position.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.machine.chains import presets
    >>> tables = tables_from_machine(
    ...     presets("mill_xyz"), {"EZX": lambda x: 1e-5 * x}, over="X",
    ...     positions=np.linspace(0, 0.1, 3), at={"Y": 0.0, "Z": 0.0})
    >>> sorted(tables), (tables["Z"].forward * 1e9).round(6).tolist()
    (['X', 'Y', 'Z'], [0.0, -500.0, -1000.0])
    """
    if not isinstance(chain, Chain):
        raise DataError(f"a machine is a Chain, got {type(chain).__name__}")
    axes = (over,) if isinstance(over, str) else tuple(over)
    if len(axes) == AXES:
        if exact is not False:
            raise DataError("over three axes errors act to first order; leave exact out")
        nodes = positions_by_axis(axes, positions)
        stated: Any = reference
        return volume_from_machine(
            chain, errors, over=axes, positions=nodes, corrects=corrects, at=at, reference=stated,
            tool=tool,
        )  # fmt: skip
    return tables_over(
        chain, errors, axes, positions, reference, at=at, corrects=corrects, tool=tool, exact=exact
    )


def tables_over(
    chain: Chain,
    errors: Any,
    axes: tuple[str, ...],
    positions: Any,
    reference: float | Sequence[float] | None,
    *,
    at: Mapping[str, float] | None = None,
    corrects: Sequence[str] | None = None,
    tool: ArrayLike = (0.0, 0.0, 0.0),
    exact: bool | str = False,
) -> MachineTables:
    """Return tables over one axis, or maps over two; see `tables_from_machine`."""
    grid = positions_to_axes(axes, positions, chain)
    source, zero, offset, c, before, rest = _corrected(
        chain, errors, axes, grid, reference, at=at, corrects=corrects, tool=tool, exact=exact
    )
    q = at_nodes(axes, grid, source.at)
    tables = _tables(source, axes, grid, zero, c, offset, q)
    left = _left_over(rest, source.correctable(q), tuple(c))
    same = _same_everywhere(chain, errors, axes, grid, at=source.at, corrects=corrects, tool=tool)
    messages = (*source.messages, *left, *_zero_moves(tables), *same)
    for array in (before, rest):
        array.setflags(write=False)
    return MachineTables(
        tables=freeze_mapping(tables),
        over=axes,
        at=freeze_mapping(source.at),
        error=before,
        left=rest,
        messages=messages,
        source=source,
    )


def axis_error(made: MachineTables, axis: str) -> tuple[Callable[..., Any], float, float]:
    """Return by how much the commands of an axis are wrong, about the reference, its P-V, and it there.

    The P-V is that at the nodes and between them: a wave as long as the spacing is nothing at the nodes.
    """
    table = made[axis]
    zero = table.reference if isinstance(table.reference, tuple) else (table.reference,)
    there = dict(zip(made.over, zero, strict=True))
    offset = float(made.source.in_axes({**made.at, **there})[axis])

    def error(*places: Any) -> Any:
        grid = zip(
            places, made.source.grid, strict=True
        )  # beyond the nodes the error of the end holds
        inside = [np.clip(np.asarray(p, dtype=np.float64), g[0], g[-1]) for p, g in grid]
        q = {**made.at, **dict(zip(made.over, np.broadcast_arrays(*inside), strict=True))}
        found, inverse = made.source.moved(q, {}), made.source.inverse(q)
        k = made.source.names.index(axis)
        parts = np.einsum("...i,...i->...", inverse[..., k, :], found[..., made.source.known])
        return parts - offset

    places = made.between()
    return error, float(np.ptp(error(*(places[a] for a in made.over)))), offset


def moves_somewhere(
    chain: Chain,
    terms: Any,
    positions: Mapping[str, Any],
    at: Mapping[str, float],
    tool: ArrayLike = (0.0, 0.0, 0.0),
) -> bool:
    """Whether a table over these axes, one or two, would hold anything; what refuses it is for the table to say."""
    try:
        made = tables_over(chain, terms, tuple(positions), positions, None, at=at, tool=tool)
    except (DataError, TableError, NotConvergedError):
        return True
    return any(axis_error(made, axis)[1] >= ZERO for axis in made)


def _corrected(
    chain: Chain,
    errors: Any,
    axes: tuple[str, ...],
    grid: tuple[FloatArray, ...],
    reference: float | Sequence[float] | None,
    *,
    at: Mapping[str, float] | None,
    **how: Any,
) -> tuple[
    VolumetricError,
    tuple[float, ...],
    dict[str, FloatArray],
    dict[str, FloatArray],
    FloatArray,
    FloatArray,
]:
    """Return the error as a function, reference, the errors there, corrections, error before and after."""
    stand = standing(at, axes)
    source = volumetric_source(chain, errors, axes=axes, grid=grid, at=stand, **how)
    zero = references(axes, grid, reference)
    offset = source.in_axes({**stand, **dict(zip(axes, zero, strict=True))})
    q = at_nodes(axes, grid, stand)
    require_travel(chain.elements, {**stand, **dict(zip(axes, grid, strict=True))})
    c = solved(source, q, offset)
    before = source.remaining(q, {}, {a: -offset[a] + np.zeros(()) for a in c})
    after = source.remaining(q, c, {a: v - offset[a] for a, v in c.items()})
    return source, zero, offset, c, before, after


def standing(at: Mapping[str, float] | None, axes: tuple[str, ...]) -> dict[str, float]:
    """Return where the other axes stand, checked."""
    stand: dict[str, float] = {}
    if not isinstance(at, Mapping | None):
        raise DataError(f"at maps axis names to positions, got {type(at).__name__}")
    for axis, value in (at or {}).items():
        if axis in axes:
            raise DataError(
                f"at holds {axis!r}, whose positions are looked up; leave it out of at"
            )
        stand[axis] = numbers.quantity(value, f"at[{axis!r}]", _dimension(axis))
    return stand


def _dimension(axis: str) -> str:
    return "angle" if is_rotary(axis) else "length"


def references(
    axes: tuple[str, ...], grid: tuple[FloatArray, ...], reference: float | Sequence[float] | None
) -> tuple[float, ...]:
    """Return the place of zero correction of each axis."""
    given: list[float | None] = [None] * len(axes)
    if reference is not None:
        stated = [*reference] if np.ndim(reference) else [reference]  # type: ignore[misc]
        if len(stated) != len(axes):
            raise TableError(f"reference has {len(stated)} positions for {len(axes)} axes")
        given = [
            numbers.quantity(r, "reference", _dimension(a))
            for r, a in zip(stated, axes, strict=True)
        ]
    zero = []
    for axis, positions, wanted in zip(axes, grid, given, strict=True):
        low, high = float(positions[0]), float(positions[-1])
        value = wanted if wanted is not None else (0.0 if low <= 0.0 <= high else low)
        if not low <= value <= high:
            raise TableError(
                f"the reference {format_position(axis, value)} lies outside the table "
                f"{format_position(axis, low)} ... {format_position(axis, high)}"
            )
        zero.append(value)
    return tuple(zero)


def solved(
    source: VolumetricError, q: Mapping[str, Any], offset: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Return c with ``c(q) = -(e(q + c(q)) - e(reference))`` by fixed point."""
    inverse = source.inverse(q)
    start = source.in_axes(q, None, inverse)
    _refuse_turning_back(source, q, start)
    c = {a: offset[a] - e for a, e in start.items()}
    for _ in range(_MAX_STEPS):
        found = source.in_axes(q, c, inverse)
        update = {a: offset[a] - e for a, e in found.items()}
        change = max(float(np.abs(update[a] - c[a]).max()) for a in c)
        c = update
        if change < _TOLERANCE:
            return c
        if change > 1e3:
            break
    raise NotConvergedError(
        "the corrections do not settle to 0.1 pm: an error is so steep that an axis would turn back; "
        "check the units of the errors"
    )


def _refuse_turning_back(
    source: VolumetricError, q: Mapping[str, Any], e: Mapping[str, FloatArray]
) -> None:
    for k, axis in enumerate(source.axes):
        if axis in e:
            along = e[axis].ndim - 1 - k
            slope = np.diff(e[axis], axis=along) / np.diff(q[axis], axis=along)
            steepest = float(np.abs(slope).max())
            if steepest >= 1.0:
                raise TableError(
                    f"the error of {axis} changes by {steepest:.3g} m per m: the corrected axis would "
                    "turn back; check the units of position and error (mm against um?)"
                )


def _tables(
    source: VolumetricError,
    axes: tuple[str, ...],
    grid: tuple[FloatArray, ...],
    zero: tuple[float, ...],
    c: Mapping[str, FloatArray],
    offset: Mapping[str, FloatArray],
    q: Mapping[str, Any],
) -> dict[str, Table]:
    sd = source.sd_in_axes(q)
    fine = tuple(_finer(p) for p in grid)
    between = solved(source, at_nodes(axes, fine, source.at), offset)
    step = Step(
        "from_machine",
        {"chain": source.chain.name, "over": list(axes), "at_si": dict(source.at), **source.facts},
    )
    tables: dict[str, Table] = {}
    for axis, values in c.items():
        common: dict[str, Any] = {
            "compensates": axis,
            "u": None if sd is None else sd[axis],
            "is_exact_inverse": True,
            "offset_removed": float(offset[axis]),
            "history": (step,),
        }
        entries = _zeroed(values, grid, zero)
        if len(axes) == 1:
            tables[axis] = CompensationTable(
                grid[0], entries, None, axis=axes[0], reference=zero[0], **common
            )
        else:
            tables[axis] = CompensationMap(
                grid[0],
                grid[1],
                entries,
                (axes[0], axes[1]),
                reference=(zero[0], zero[1]),
                **common,
            )
        looked = [fine[0]] if len(axes) == 1 else [fine[0], fine[1][:, None]]
        missed = between[axis] - _looked_up(tables[axis], looked)
        tables[axis] = replace(tables[axis], interpolation_error=float(np.abs(missed).max()))
    return tables


def _zeroed(
    values: FloatArray, grid: tuple[FloatArray, ...], zero: tuple[float, ...]
) -> FloatArray:
    """Return corrections with an exact zero at the reference, where rounding leaves 1e-23."""
    here = grid[0] == zero[0]
    if len(grid) == 2:
        here = (grid[1] == zero[1])[:, None] & here
    return np.where(here, 0.0, values + 0.0)  # no -0.0


def _looked_up(table: Table, places: Sequence[FloatArray]) -> FloatArray:
    """Return the correction in the shape of the positions, a single number included."""
    shape = np.broadcast_shapes(*(p.shape for p in places))
    if isinstance(table, CompensationMap):
        return table.correction(places[0], places[1]).reshape(shape)
    return table.correction(places[0]).reshape(shape)


def _zero_moves(tables: Mapping[str, Table]) -> Iterator[str]:
    """Return what the interpolation leaves at a reference that is not a node, by axis."""
    for axis, table in tables.items():
        zero = table.reference
        places = zero if isinstance(zero, tuple) else (zero,)
        there = float(_looked_up(table, [np.array([p]) for p in places])[0])
        if abs(there) > ZERO:
            over = table.axes if isinstance(table, CompensationMap) else (table.axis,)
            where = ", ".join(format_position(a, p) for a, p in zip(over, places, strict=True))
            yield (
                f"at the reference {where}, which is not a node, {axis} is corrected by "
                f"{format_length(there, digits=3)}, not zero: make the reference a node"
            )


def _same_everywhere(
    chain: Chain,
    errors: Any,
    axes: tuple[str, ...],
    grid: tuple[FloatArray, ...],
    *,
    at: Mapping[str, float],
    **how: Any,
) -> Iterator[str]:
    """Return by axis of rotation which of its location errors no node of the tables shows, and which they hold."""
    if not isinstance(errors, ErrorSet | Mapping):
        return
    given = as_error_set(errors).terms
    q = at_nodes(axes, grid, at)
    for element in chain.elements:
        if element.name not in axes or element.kind != "rotary":
            continue
        listed: list[str] = []
        held: list[str] = []
        for term in element.location_errors:
            value = float(getattr(given.get(term), "value", 0.0))
            if not abs(value) > ZERO:
                continue
            alone = volumetric_source(
                chain, {term: value}, axes=axes, grid=grid, at=at, exact=False, **how
            ).in_axes(q)
            same = max(float(np.ptp(e)) for e in alone.values()) < ZERO
            said = f"{term} = {format_engineering(value, term_unit(chain, term))}"
            (listed if same else held).append(said)
        name = element.name
        if held:
            yield (
                f"{', '.join(held)}: in the tables, as for a part whose zero stands still in the machine; where the "
                f"control turns the zero with the axes that carry {name}, leave these out of the errors and correct "
                f"the place and direction of the axis {name} in its kinematics by them"
            )
        if listed:
            yield (
                f"{', '.join(listed)}: of the same effect at every node, so the tables hold none of it; where the control "
                f"turns the zero of the part with {name}, correct the place and direction of the axis {name} in its "
                f"kinematics by that, else take the zero of each part at the {name} at which it is cut"
            )


def _left_over(
    rest: FloatArray, correctable: tuple[bool, ...], axes: tuple[str, ...]
) -> Iterator[str]:
    for k, direction in enumerate("XYZ"):
        part = rest[..., k]
        if np.isnan(part).all():
            yield f"workpiece {direction}: not measured, nothing is known about it"
        elif not correctable[k]:
            size = float(np.abs(part).max())
            amount = "nothing to correct there" if size < _NOTHING else (
                f"up to {format_length(size, digits=3)} stay, P-V "
                f"{format_length(float(np.ptp(part)), digits=3)}"
            )  # fmt: skip
            yield (
                f"workpiece {direction}: {', '.join(axes)} cannot move the tool there everywhere; "
                + amount
            )


def _finer(positions: FloatArray) -> FloatArray:
    """Return the positions with three more in every interval."""
    fraction = np.arange(4) / 4
    inner = positions[:-1, None] + np.diff(positions)[:, None] * fraction
    return np.append(inner.ravel(), positions[-1])


def _pv(vectors: FloatArray) -> list[float | None]:
    parts = [vectors[..., k] for k in range(3)]
    return [None if np.isnan(p).any() else float(np.ptp(p)) for p in parts]


def volume_from_machine(
    chain: Chain,
    errors: Any,
    *,
    over: Sequence[str],
    positions: Mapping[str, ArrayLike],
    corrects: Sequence[str] | None = None,
    at: Mapping[str, float] | None = None,
    reference: Sequence[float] | None = None,
    tool: ArrayLike = (0.0, 0.0, 0.0),
) -> MachineVolume:
    """Return corrections of a machine over three axes, on a grid and as tables to be added up.

    Parameters
    ----------
    chain : Chain
        The machine.
    errors : ErrorSet or mapping of str to term
        Error terms by name.
    over : sequence of str
        Three axes.
    positions : mapping of str to array_like, m or rad
        Nodes of each.
    corrects, at, tool : optional
        As for `tables_from_machine`.
    reference : three floats, m or rad, optional
        Place of zero correction; of each axis 0 if it is in range, else its first position.

    Returns
    -------
    MachineVolume
        Corrections, tables and what is left.

    Raises
    ------
    DataError
        Not three axes, or as of `tables_from_machine`.
    TableError
        Positions do not rise, a reference lies outside, or an axis would turn back.
    NotConvergedError
        The errors are so steep that the corrections do not settle.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.machine.chains import presets
    >>> grid = {a: np.linspace(0.0, 0.1, 3) for a in "XYZ"}
    >>> volume_from_machine(presets("mill_xyz"), {"EZX": lambda x: 1e-5 * x}, over="XYZ", positions=grid)
    MachineVolume(X, Y, Z -> X, Y, Z, error 645.5 nm RMS, left 0 m)
    """
    axes = tuple(over)
    if len(axes) != AXES or len(set(axes)) != AXES:
        raise DataError(f"over names three different axes here; got {', '.join(axes) or 'none'}")
    missing = [a for a in axes if a not in positions or a not in chain.axes]
    if missing:
        raise DataError(
            f"{missing[0]!r} has no positions, or is not an axis of chain {chain.name!r}; its axes are "
            f"{', '.join(chain.axes)}"
        )
    grid = tuple(rising(positions[a], a) for a in axes)
    source, zero, offset, found, error, left = _corrected(
        chain, errors, axes, grid, reference, at=at, corrects=corrects, tool=tool, exact=False
    )
    place = {**source.at, **dict(zip(axes, zero, strict=True))}
    c = {a: found[a] for a in (*(a for a in axes if a in found), *(set(found) - set(axes)))}
    parts: dict[tuple[str, str], CompensationTable] = {}
    for axis, nodes, here in zip(axes, grid, zero, strict=True):
        others = {a: v for a, v in place.items() if a != axis}
        made = tables_over(
            chain, errors, (axis,), nodes, here, corrects=source.names, at=others, tool=tool
        )
        for name, table in made.items():
            if isinstance(table, CompensationTable):
                parts[axis, name] = table
    return MachineVolume(
        over=axes,
        positions=grid,
        corrections=freeze_mapping(c),
        parts=MappingProxyType(parts),
        error=error,
        left=left,
        messages=source.messages,
        source=source,
        offset=freeze_mapping({a: float(v) for a, v in offset.items()}),
        errors=errors,
    )
