"""Kinematic chains: two branches from the bed, and what their error motions do at the tool point.

The chain gives the tool point in the workpiece, ``P = W^-1 T p``, with T and W the products of the
elements of either branch (`metrosep.machine.elements`) and p the tool point in the tool's frame.
The error is ``E = P - P0``, actual minus nominal, in workpiece coordinates. Its Jacobian needs no
differentiation: with A the pose of the frame in which an error sits, the column of error j is

    dP = sign W^-1 A hat(e_j) A^-1 p_bed,    sign = +1 in the tool branch, -1 in the workpiece branch.

Positions `q` are SI (m, rad) by axis name, numbers or arrays that broadcast against each other.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from os import PathLike
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, UnitError
from metrosep.core.public import PublicObject, shortened
from metrosep.core.readable import did_you_mean
from metrosep.machine import _poses as ps
from metrosep.machine._chain_checks import refuse_parallel, refuse_strange_names, refuse_twice
from metrosep.machine._poses import States
from metrosep.machine.chain_files import chain_parts, toml_table
from metrosep.machine.elements import (
    BRANCHES,
    DIRECTIONS,
    Element,
    element_terms,
    error_sign,
    paper_hint,
    place_of,
)
from metrosep.machine.error_sets import ErrorSet, as_error_set

if TYPE_CHECKING:
    from metrosep.machine.instruments import Instrument

Positions = Mapping[str, ArrayLike]
Errors = ErrorSet | Mapping[str, Any]


@dataclass(frozen=True, slots=True, repr=False)
class Chain(PublicObject):
    """Kinematic chain of a machine, from the workpiece over the bed to the tool.

    Parameters
    ----------
    elements : sequence of Element
        Each branch in the order from the bed outwards; the branches may be mixed.
    name : str, optional
        Name of the machine.
    description : str, optional
        One sentence for lists.

    Raises
    ------
    DataError
        No element in one of the branches, two elements or terms of the same name, a location error
        or ``parallel_to`` that names no axis of the chain, two axes of a kind along the same
        direction, as they stand with all axes at zero, that do not say so (``parallel_to``).

    Examples
    --------
    >>> chain = Chain([
    ...     Element("X", "tool", "linear", direction=(1, 0, 0)),
    ...     Element("C", "workpiece", "rotary"),
    ... ])
    >>> chain.volumetric_error({"X": 0.02, "C": 0.0}, {"ECC": 1e-6}).round(12).tolist()
    [0.0, -2e-08, 0.0]
    """

    elements: Sequence[Element]
    name: str = ""
    description: str = ""
    terms: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        if not isinstance(self.elements, Iterable):
            raise DataError(f"a chain is a sequence of elements, got {self.elements!r}")
        object.__setattr__(self, "elements", tuple(self.elements))
        for element in self.elements:
            if not isinstance(element, Element):
                raise DataError(f"a chain is made of Element objects, got {element!r}")
        for branch in BRANCHES:
            if not any(e.branch == branch for e in self.elements):
                raise DataError(
                    f"chain {self.name!r} does not close: no element has branch = {branch!r}; a part "
                    "that is fixed to the bed is an element of kind 'fixed'"
                )
        refuse_twice([e.name for e in self.elements], "element")
        terms = tuple(term for element in self.elements for term in element_terms(element))
        refuse_twice(terms, "term")
        refuse_strange_names(self.elements)
        refuse_parallel(self.elements)
        object.__setattr__(self, "terms", terms)

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], **parameters: float) -> Chain:
        """Return a chain from a table of plain values, as a TOML file gives it.

        Parameters
        ----------
        table : mapping
            Keys ``name``, ``description``, ``parameters`` and a list ``element`` of tables.
        **parameters : float, SI
            Values of the parameters that the table names.

        Returns
        -------
        Chain
            The chain.

        Raises
        ------
        DataError
            A key, a unit or a parameter is unknown or missing, or the chain does not close.
        InvalidSamplesError
            A value is not a finite number.

        Examples
        --------
        >>> Chain.from_dict({"element": [
        ...     {"name": "X", "branch": "tool", "kind": "linear", "direction": "+X"},
        ...     {"name": "C", "branch": "workpiece", "kind": "rotary", "direction": "+Z",
        ...      "errors": "XZ"},
        ... ]}).terms
        ('EXX', 'EYX', 'EZX', 'EAX', 'EBX', 'ECX', 'EXC', 'EZC')
        """
        elements, name, description = chain_parts(table, parameters)
        return cls(elements, name=name, description=description)

    @classmethod
    @described_by(from_dict, errors=False)
    def from_toml(cls, path: str | PathLike[str], **parameters: float) -> Chain:
        """Return the chain that a TOML file describes.

        Parameters
        ----------
        path : str or path
            File with ``[[element]]`` tables; lengths and angles carry their unit in the key
            (``location_mm``, ``angle_deg``).

        Returns
        -------
        Chain
            The chain.

        Raises
        ------
        DataError
            The file is not TOML, or as of `from_dict`; the message names file and key.

        Notes
        -----
        A missing or locked file raises what the operating system says (FileNotFoundError).
        """
        elements, name, description = chain_parts(toml_table(path), parameters, source=str(path))
        try:
            return cls(elements, name=name, description=description)
        except DataError as exc:
            raise DataError(f"{path}: {exc}") from None

    @property
    def messages(self) -> tuple[str, ...]:
        """What the reader of a result must know of the description of the machine."""
        lever = [
            e.name
            for e in self.elements
            if (e.branch, e.kind, e.error_frame) == ("workpiece", "linear", None)
            and e.frame == "after"
            and set(e.errors or ()) & set("ABC")
        ]
        if not lever:
            return ()
        text = (
            f"{', '.join(lever)}: errors of the body of a slide that carries the workpiece are taken "
            "in the moved frame, so its own travel is a lever of its angles; where an instrument at "
            'the tool read them, write errors_of = "tool", or error_frame = "before"'
        )
        return (text,)

    def __repr__(self) -> str:
        axes = ", ".join(e.name for e in self.elements if e.kind != "fixed")
        return shortened(f"Chain({self.name!r}: axes {axes}; {len(self.terms)} error terms)")

    def describe(self) -> str:
        """Return where the errors of each axis are stated, in which directions and with which sign.

        Returns
        -------
        str
            One line for each axis, from the bed outwards.

        Examples
        --------
        >>> chain = Chain([Element("X", "workpiece", "linear", (-1, 0, 0), errors_of="tool"),
        ...                Element("Z", "tool", "linear")])
        >>> print(chain.describe())
        X: linear, carries the workpiece; errors of the tool against the workpiece at (0, 0, 0) mm, in the frame before the axis: own travel is not a lever; zero at X = 0
        Z: linear, carries the tool; errors of its body at (0, 0, 0) mm, in the frame that the axis moves; zero at Z = 0
        """
        frames = {
            "before": "in the frame before the axis",
            "after": "in the frame that the axis moves",
        }
        lines = []
        for e in self.elements:
            sense = "the tool against the workpiece" if error_sign(e) < 0.0 else "its body"
            place = ", ".join(
                f"{1e3 * (c + r):g}" for c, r in zip(e.location, e.measured_at, strict=True)
            )
            own = (
                ": own travel is not a lever" if (e.kind, e.frame) == ("linear", "before") else ""
            )
            home = "" if e.kind == "fixed" else f"; zero at {e.name} = 0"
            if e.travel is not None:
                home += f"; travel {' to '.join(place_of(e, v) for v in e.travel)}"
            lines.append(
                f"{e.name}: {e.kind}, carries the {e.branch}; errors of {sense} at ({place}) mm, "
                f"{frames[e.frame]}{own}{home}"
            )
        return "\n".join([*lines, *self.messages])

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes that move, in the order of the elements."""
        return tuple(e.name for e in self.elements if e.kind != "fixed")

    @property
    def dimensions(self) -> dict[str, str]:
        """By element what its position is: ``"length"``, or ``"angle"`` of an axis that turns."""
        return {e.name: "angle" if e.kind == "rotary" else "length" for e in self.elements}

    def jacobian(
        self,
        q: Positions,
        *,
        tool: ArrayLike = (0.0, 0.0, 0.0),
        terms: Iterable[str] | None = None,
    ) -> FloatArray:
        """Return the derivative of the volumetric error with respect to each error term.

        Parameters
        ----------
        q : mapping of str to array_like, m or rad
            Position of every axis; parked axes may be missing.
        tool : array_like, shape (3,) or (..., 3), m
            Tool point in the frame of the last element of the tool branch.
        terms : iterable of str, optional
            Terms wanted, in this order; all (`terms`) by default.

        Returns
        -------
        ndarray, shape (..., 3, n_terms), m/m or m/rad
            Columns in workpiece X, Y, Z. In memory the states lie innermost.

        Raises
        ------
        DataError
            A position is missing, an axis or a term is unknown.
        InvalidSamplesError
            Positions or tool points are not real numbers, infinite, or do not broadcast.

        Notes
        -----
        Closed adjoint form of [1]_, no differentiation and no loop over states. An axis that is
        parked and not in `q` is not a joint: its columns are zero (the setting of the machine takes
        up what it does). NaN in a position gives NaN in every column of that state.

        References
        ----------
        .. [1] papers.md section 4.2; eq 11 of the FTS paper is this for its lathe.

        Examples
        --------
        >>> chain = Chain([Element("X", "tool", "linear", direction=(1, 0, 0)),
        ...                Element("C", "workpiece", "rotary")])
        >>> chain.jacobian({"X": 0.02, "C": [0.0, 1.0]}, terms=["EXX", "ECX"]).shape
        (2, 3, 2)
        """
        return self._gathered(self._states(q, tool), terms, turns=False)

    @described_by(jacobian, errors=False)
    def turn_jacobian(self, q: Positions, *, terms: Iterable[str] | None = None) -> FloatArray:
        """Return the derivative of the turn of the tool against the workpiece by each error term.

        Returns
        -------
        ndarray, shape (..., 3, n_terms), rad/m or rad/rad
            Small rotation about workpiece X, Y, Z.

        Notes
        -----
        The squareness of a slide turns its travel, not its carriage: its column is zero.

        Examples
        --------
        >>> chain = Chain([Element("X", "tool", "linear", direction=(1, 0, 0)),
        ...                Element("C", "workpiece", "rotary")])
        >>> chain.turn_jacobian({"X": 0.02, "C": 0.0}, terms=["EBX", "EBC"])[1].tolist()
        [1.0, -1.0]
        """
        return self._gathered(self._states(q, (0.0, 0.0, 0.0)), terms, turns=True)

    def workpiece_turn(self, q: Positions) -> FloatArray:
        """Return the nominal rotation of the workpiece in the machine.

        Parameters
        ----------
        q : mapping of str to array_like, m or rad
            Position of every axis; parked axes may be missing.

        Returns
        -------
        ndarray, shape (..., 3, 3)
            ``R``: a direction of the workpiece v is ``R v`` in the machine.

        Raises
        ------
        DataError
            A position is missing or an axis is unknown.

        Examples
        --------
        >>> chain = Chain([Element("X", "tool", "linear", direction=(1, 0, 0)),
        ...                Element("C", "workpiece", "rotary")])
        >>> chain.workpiece_turn({"X": 0.0, "C": 0.5 * np.pi}).round(12)[:, 0].tolist()
        [0.0, 1.0, 0.0]
        """
        states = self._states(q, (0.0, 0.0, 0.0))
        out = np.zeros((3, 3, *states.shape))
        for i in range(3):
            for k in range(3):
                out[i, k] = states.bed_turn[k][i]  # bed_turn takes the machine to the workpiece
        states.poison(out)
        return np.moveaxis(out, (0, 1), (-2, -1))

    def _gathered(self, states: States, terms: Iterable[str] | None, *, turns: bool) -> FloatArray:
        """Return the columns of the terms, of the point or of the turn, shape (..., 3, n)."""
        wanted = self.terms if terms is None else self.known_terms(terms)
        columns = {}
        for element in self.elements:
            chosen = [t for t in element_terms(element) if t in wanted]
            if chosen and element.name in states.active:
                columns.update(_columns(element, states, chosen, turns=turns))
        out = np.zeros((3, len(wanted), *states.shape))
        for i, term in enumerate(wanted):
            for k, part in enumerate(columns.get(term, ps.ORIGIN)):
                if not isinstance(part, float) or part != 0.0:
                    out[k, i] = part
        states.poison(out)
        result: FloatArray = np.moveaxis(out, (0, 1), (-2, -1))
        return result

    @described_by(jacobian, errors=False)
    def volumetric_error(
        self,
        q: Positions,
        errors: Errors,
        *,
        tool: ArrayLike = (0.0, 0.0, 0.0),
        exact: bool | str = False,
    ) -> FloatArray:
        """Return the error of the tool point in the workpiece, actual minus nominal.

        Parameters
        ----------
        errors : ErrorSet or mapping of str to float, callable or ErrorTerm
            Error terms by name; those that are not named are zero.
        exact : bool or str
            False: first order, `jacobian` times errors. ``"orthonormal"`` or True: the product with
            true rotations. ``"small-angle"``: the product with matrices ``I + hat``.

        Returns
        -------
        ndarray, shape (..., 3), m
            In workpiece X, Y, Z.

        Raises
        ------
        DataError
            A position is missing, an axis, a term or `exact` is unknown, a position lies outside a term's
            table; positions or errors are not real numbers, infinite, or do not broadcast; a term is not
            known at a position, or is above 1 m or 1 rad (degrees as rad, um as m).
        LimitError
            A polynomial of `metrosep.process.run_polynomial` was not measured at a position.

        Notes
        -----
        True rotations are ``Rx(EA) Ry(EB) Rz(EC)``; another order differs by the second order. A
        correction is the negative of the result. NaN in a position gives NaN in that state.

        Examples
        --------
        >>> chain = Chain([Element("X", "tool", "linear", direction=(1, 0, 0)),
        ...                Element("C", "workpiece", "rotary")])
        >>> chain.volumetric_error({"X": 0.02, "C": 0.0}, {"EZX": lambda x: x / 1024}).tolist()
        [0.0, 0.0, 1.953125e-05]
        """
        rule = _rule(exact)
        states = self._states(q, tool)
        values = self._values(q, errors)
        if rule is None:
            shift = ps.linear_error(self.elements, states, values).t
        else:
            pose = ps.exact_pose(self.elements, states, values, rule)
            shift = ps.subtract(pose.t, states.point)
        out = np.zeros((3, *states.shape))
        for k, part in enumerate(shift):
            out[k] = part
        states.poison(out)
        return np.moveaxis(out, 0, -1)

    @described_by(volumetric_error, errors=False)
    def transform(
        self,
        q: Positions,
        errors: Errors | None = None,
        *,
        tool: ArrayLike = (0.0, 0.0, 0.0),
        exact: bool | str = "orthonormal",
    ) -> FloatArray:
        """Return the pose of the tool in the workpiece.

        Parameters
        ----------
        errors : ErrorSet or mapping of str to float, callable or ErrorTerm, optional
            Error terms by name; none gives the nominal pose.
        exact : bool or str, optional
            As of `volumetric_error`; by default with true rotations.

        Returns
        -------
        ndarray, shape (..., 4, 4)
            Directions of the tool frame (columns 0 to 2) and the tool point (column 3, m) in
            workpiece coordinates.

        Raises
        ------
        DataError, LimitError
            As of `volumetric_error`.

        Examples
        --------
        >>> chain = Chain([Element("X", "tool", "linear", direction=(1, 0, 0)),
        ...                Element("C", "workpiece", "rotary")])
        >>> chain.transform({"X": 0.02, "C": 0.0})[:3, 3].tolist()
        [0.02, 0.0, 0.0]
        """
        rule = _rule(exact)
        states = self._states(q, tool)
        values = self._values(q, {} if errors is None else errors)
        if rule is None:
            pose = ps.linear_pose(self.elements, states, values)
        else:
            pose = ps.exact_pose(self.elements, states, values, rule)
        out = np.zeros((4, 4, *states.shape))
        for i in range(3):
            for k in range(3):
                out[i, k] = pose.r[i][k]
            out[i, 3] = pose.t[i]
        out[3, 3] = 1.0
        states.poison(out)
        return np.moveaxis(out, (0, 1), (-2, -1))

    @described_by(volumetric_error, errors=False)
    def volumetric_covariance(
        self, q: Positions, errors: ErrorSet, *, tool: ArrayLike = (0.0, 0.0, 0.0)
    ) -> FloatArray:
        """Return the covariance of the volumetric error that the terms' uncertainties cause.

        Parameters
        ----------
        errors : ErrorSet
            Error terms with standard uncertainties (``u=``) and correlations.

        Returns
        -------
        ndarray, shape (..., 3, 3), m^2
            ``J Sigma J'`` at each state; square roots of the diagonal are standard uncertainties.

        Raises
        ------
        DataError
            As of `volumetric_error`.

        Notes
        -----
        A plain mapping is no `ErrorSet`: its numbers and functions are taken as exact, and the
        covariance of exact terms is zero. Only terms with an ``sd`` of their own bring one.

        Examples
        --------
        >>> chain = Chain([Element("X", "tool", "linear", direction=(1, 0, 0)),
        ...                Element("C", "workpiece", "rotary")])
        >>> errors = ErrorSet({"EZX": 0.0}, u={"EZX": 1e-7})
        >>> u = chain.volumetric_covariance({"X": 0.02, "C": 0.0}, errors)[2, 2] ** 0.5
        >>> print(f"{1e9 * u:.1f} nm")
        100.0 nm
        """
        from metrosep.core.blas import one_blas_thread

        names = self.known_terms(as_error_set(errors).names)
        matrix = self.jacobian(q, tool=tool, terms=names)
        active = self._active(names, q)
        chosen = np.array([n in active for n in names], dtype=bool)
        part = as_error_set(errors).covariance(active, q)
        sigma = np.zeros((*part.shape[:-2], len(names), len(names)))
        sigma[..., chosen[:, None] & chosen[None, :]] = part.reshape(*part.shape[:-2], -1)
        with one_blas_thread():
            result: FloatArray = matrix @ sigma @ np.swapaxes(matrix, -1, -2)
        return result

    def read(
        self,
        instrument: Instrument,
        q: Positions,
        errors: Errors,
        *,
        tool: ArrayLike = (0.0, 0.0, 0.0),
        exact: bool = False,
        total: bool = False,
    ) -> FloatArray:
        """Return what an instrument reads on the machine.

        Parameters
        ----------
        instrument : Instrument
            `Displacement`, `Angle`, `Ballbar`, `Nest` or `Length`.
        q : mapping of str to array_like, m or rad
            Position of every axis that lies between the ends of the instrument.
        errors : ErrorSet or mapping of str to float, callable or ErrorTerm
            Error terms by name; those that are not named are zero.
        tool : array_like, shape (3,) or (..., 3), m
            Tool point in the frame of the last element of the tool branch.
        exact : bool, optional
            Whether rotations and lengths are exact; first order otherwise.
        total : bool, optional
            Whether the nominal reading is added.

        Returns
        -------
        ndarray, shape (...) or (..., 3), m or rad
            Deviation from nominal; three components of a `Nest`.

        Raises
        ------
        DataError
            As of `volumetric_error`, or the direction of a reading is not defined.

        Examples
        --------
        >>> from metrosep.machine.instruments import Displacement
        >>> chain = Chain([Element("X", "tool", "linear", direction=(1, 0, 0)),
        ...                Element("C", "workpiece", "rotary")])
        >>> probe = Displacement(direction=(0, 1, 0))
        >>> chain.read(probe, {"X": 0.5, "C": 0.0}, {"EYX": 2e-6, "ECC": 1e-6}).round(9).item()
        1.5e-06
        """
        from metrosep.machine.instruments import read

        return read(self, instrument, q, errors, tool=tool, exact=exact, total=total)

    def from_bed(self) -> Chain:
        """Return the chain of the tool branch alone, with its other end on the bed.

        Returns
        -------
        Chain
            What an instrument on the bed sees of the machine.
        """
        tools = [e for e in self.elements if e.branch == "tool"]
        return Chain(
            [*tools, Element("BED", "workpiece", "fixed")], name=f"{self.name}, from the bed"
        )

    def inverse(
        self, points: ArrayLike, *, tool: ArrayLike = (0.0, 0.0, 0.0), **axes: ArrayLike
    ) -> dict[str, FloatArray]:
        """Return positions of all axes that put the tool point at points of the workpiece.

        Parameters
        ----------
        points : array_like, shape (3,) or (n, 3), m
            In the coordinates of the workpiece.
        tool : array_like, shape (3,), m, optional
            Tool point in the frame of the tool.
        **axes : array_like, m or rad
            Positions of the rotary axes, and of linear ones beyond three.

        Returns
        -------
        dict of str to ndarray, m or rad
            Positions of all axes; errors as of `metrosep.machine.inverse_kinematics`.
        """
        from metrosep.machine.inverse import inverse_kinematics

        return inverse_kinematics(self, points, tool=tool, **axes)

    def error_values(self, q: Positions, errors: Errors) -> FloatArray:
        """Return the errors at the states.

        Parameters
        ----------
        q : mapping of str to array_like, m or rad
            Position of every axis; parked axes may be missing.
        errors : ErrorSet or mapping of str to float, callable or ErrorTerm
            Error terms by name.

        Returns
        -------
        ndarray, shape (..., n), m or rad
            In the order of the set; zero where the axis is not a joint.
        """
        found = self._values(q, errors)
        shape = self._states(q, (0.0, 0.0, 0.0)).shape
        names = as_error_set(errors).names
        parts = [np.broadcast_to(np.asarray(found.get(n, 0.0)), shape) for n in names]
        return np.stack(parts, axis=-1) if parts else np.zeros((*shape, 0))

    def _states(self, q: Positions, tool: ArrayLike) -> States:
        return States(
            self.elements, ps.positions_of(self.elements, q, self.name), ps.tool_point(tool)
        )

    def _active(self, names: Iterable[str], q: Positions) -> list[str]:
        """Return the terms of the elements that are joints: fixed ones, and axes that are in q."""
        home = {t: e for e in self.elements for t in element_terms(e)}
        return [n for n in names if home[n].kind == "fixed" or home[n].name in q]

    def _values(self, q: Positions, errors: Errors) -> dict[str, ps.Part]:
        """Return the errors at the states, by name."""
        errors = as_error_set(errors)
        active = self._active(self.known_terms(errors.names), q)
        values = errors.at(q, names=active)
        return {name: ps.as_part(value) for name, value in values.items()}

    def known_terms(self, terms: Iterable[str]) -> tuple[str, ...]:
        """Return the names as a tuple, after a check that the chain has them.

        Parameters
        ----------
        terms : iterable of str
            Names of error terms.

        Returns
        -------
        tuple of str
            The same names in the same order.

        Raises
        ------
        DataError
            A name is not a term of this chain.

        Examples
        --------
        >>> chain = Chain([Element("X", "tool", "linear"), Element("C", "workpiece", "rotary")])
        >>> chain.known_terms(["EXX"])
        ('EXX',)
        """
        if not isinstance(terms, Iterable):
            raise DataError(f"terms are names of error terms, got {terms!r}")
        names = (terms,) if isinstance(terms, str) else tuple(terms)
        unknown = [name for name in names if name not in self.terms]
        if unknown:
            name = str(unknown[0]).upper().replace("O", "0")  # no term has the letter O
            hint = paper_hint(unknown[0]) or f".{did_you_mean(name, self.terms)}"
            raise DataError(
                f"{unknown[0]!r} is not an error term of chain {self.name!r}; "
                f"known are {', '.join(self.terms)}{hint}"
            )
        return names


def _columns(
    element: Element, states: States, chosen: Sequence[str], *, turns: bool
) -> dict[str, ps.Vector]:
    """Return the columns of one element, of the point or of the turn, in workpiece coordinates."""

    def six(frame: str, lever: ps.Vector) -> list[ps.Vector]:
        return states.six_turns(element, frame) if turns else states.six(element, frame, lever)

    own = six(element.frame, states.read_lever(element))
    # of a displaced line of motion: ``L M L^-1`` of a slide, else ``L M``
    ends = [("before", 1.0), ("after", -1.0)] if element.kind == "linear" else [("before", 1.0)]
    columns = {}
    for term in chosen:
        if term not in element.location_errors:
            columns[term] = ps.scale(own[DIRECTIONS.index(term[1])], error_sign(element))
            continue
        total: ps.Vector = ps.ORIGIN
        for frame, sign in ends:
            moves = six(frame, states.levers[element.name, frame])
            for weight, column in zip(element.location_errors[term], moves, strict=True):
                total = ps.add(total, ps.scale(column, sign * weight))
        columns[term] = total
    return columns


def _rule(exact: bool | str) -> str | None:
    """Return the kind of product, None for the first order."""
    if isinstance(exact, str):
        return numbers.choice(exact, "exact, if no truth value,", ps.EXACT)
    return ps.EXACT[0] if exact else None


# ---- chains of common machines, by name --------------------------------------------------------
# The files in ``presets_data`` hold them in the form that `Chain.from_toml` reads: `preset_table`
# returns one as a table, to start the description of another machine from.
#
# ==========  ========================================  =======================================
# name        positions (SI)                            kinematics
# ==========  ========================================  =======================================
# fts_lathe   C theta, X x, FTS s; Z parked             tool on FTS on X on Z; spindle C
# sts_lathe   X x, Z z, C theta                         tool on Z; spindle C on X
# mill_xyz    X x, Y y, Z z                             tool on Z; table X on Y
# five_axis   X x, Y y, Z z, A a, C c                   tool on Z on X; table C on A on Y
# ==========  ========================================  =======================================

_FOLDER = "presets_data"
_LATHES = ("fts_lathe", "sts_lathe")
_LARGEST = 5.0  # m; a radius or a height above it was typed in mm
_SPINDLE_ERRORS = {"co-rotating": "after", "fixed": "before"}


@overload
def presets() -> tuple[str, ...]: ...
@overload
def presets(name: None) -> tuple[str, ...]: ...
@overload
def presets(name: str, *, spindle_errors: str = ..., **parameters: float | str) -> Chain: ...
def presets(
    name: str | None = None, *, spindle_errors: str | None = None, **parameters: float | str
) -> Chain | tuple[str, ...]:
    """Return the chain of a common machine, or the names of all of them.

    Parameters
    ----------
    name : str, optional
        ``"fts_lathe"``, ``"sts_lathe"``, ``"mill_xyz"`` or ``"five_axis"``; without it, the names.
    spindle_errors : str, optional
        Of the lathes: ``"co-rotating"`` (eq 3 of [1]_: the errors turn with the workpiece; default
        of fts_lathe) or ``"fixed"`` (they stay in the machine, ISO 230-7; default of sts_lathe).
    **parameters : float or str, m
        ``radius`` of the workpiece (fts_lathe, > 0), ``pivot_height`` of the C table's datum above
        the axis of A (five_axis).

    Returns
    -------
    Chain or tuple of str
        The machine, or the names.

    Raises
    ------
    DataError
        The name, a parameter or the choice of the spindle errors is unknown, missing or out of
        range.
    UnitError
        A length is above 5 m: it was given in mm.

    Notes
    -----
    fts_lathe: 25 terms. Position X is the paper's x, 0 at the rim: the tool stands at the radius
    R - x; FTS is its current height s = S - z_f. **EXX runs along the workpiece's +X, against x**:
    a slide that stands 1 um too far along its own x has EXX = -1 um. Of every other axis of every
    preset the positioning error (EXX, EYY, EZZ, EZFTS, EAA, ECC) is that of its position. The spindle angle theta puts the cut point at the
    workpiece azimuth -theta. Z may be omitted: it is then no joint, and its errors do nothing.
    B0Z is the paper's eta_zx with the sign of its eq 1 (eq 9 has the other one).

    Error motions are those that an instrument reads at the tool point (0, 0, 0) with the other axes
    at zero: an indicator there on its own line returns EYX, EZX and so on, own travel is not a lever
    of an angle. For another point put ``measured_at_mm`` into `preset_table`. `Chain.describe` says
    for each axis where, in which directions and with which sign.

    References
    ----------
    .. [1] Micromachines 11 (2020) 331, eq 1-11 and Table 1.

    Examples
    --------
    >>> presets()
    ('five_axis', 'fts_lathe', 'mill_xyz', 'sts_lathe')
    >>> len(presets("fts_lathe", radius=20e-3).terms)
    25
    """
    if name is None:
        return _names()
    table = preset_table(name)
    if spindle_errors is not None:
        _choose_spindle(table, name, spindle_errors)
    lengths = {n: numbers.quantity(v, f"{n} of {name}", "length") for n, v in parameters.items()}
    chain = Chain.from_dict(table, **lengths)
    for key, value in lengths.items():
        if abs(value) > _LARGEST:
            raise UnitError(
                f"{key} of {name} is {value} m, more than {_LARGEST:g} m; lengths are in m, "
                "20 mm are 0.02"
            )
    if "radius" in lengths:
        numbers.positive(lengths["radius"], f"radius of {name}", dimension="length")
    return chain


def preset_table(name: str) -> dict[str, Any]:
    """Return the table of a preset, as its TOML file holds it.

    Parameters
    ----------
    name : str
        Name of the preset.

    Returns
    -------
    dict
        What `Chain.from_dict` takes; a new one each time.

    Raises
    ------
    DataError
        There is no such preset.

    Examples
    --------
    >>> [element["name"] for element in preset_table("mill_xyz")["element"]]
    ['Z', 'Y', 'X']
    """
    if name not in _names():
        raise DataError(f"there is no preset chain {name!r}; there are {', '.join(_names())}")
    file = files("metrosep.machine") / _FOLDER / f"{name}.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


def _names() -> tuple[str, ...]:
    folder = files("metrosep.machine") / _FOLDER
    found = (f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))
    return tuple(sorted(found))


def _choose_spindle(table: dict[str, Any], name: str, choice: str) -> None:
    """Write the error frame of the spindle into the table."""
    if name not in _LATHES:
        raise DataError(f"{name} has no spindle errors to choose; {', '.join(_LATHES)} have")
    numbers.choice(choice, "spindle_errors", _SPINDLE_ERRORS)
    for element in table["element"]:
        if element["name"] == "C":
            element["error_frame"] = _SPINDLE_ERRORS[choice]
