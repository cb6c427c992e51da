"""Corrections of a machine over three axes: on a grid, and as tables of one axis each.

No controller here holds a map over three axes. Where it adds several tables up, each looked-up axis
a has one for each corrected axis k, made with the other axes at the reference:

    c_k(x, y, z) = sum over a of c_k^a(q_a).

What depends on two axes at once (the lever of an angle) is left: with E_a the error along axis a through
the reference r and E(r) = 0, they leave E - sum E_a, and the additive functions nearest to E (its means over
the other two axes) are the least that any such tables leave. On a grid of (x, y, z) the
corrections are exact at the nodes and linear in each axis between them, which leaves, by component
(machines.md, eq. 21),

    |left| <= sum over i of h_i^2 / 8 max |d^2 E / dq_i^2|.

Both hold for one tool point t0: another sees W x (t - t0) more, W the angle errors at that place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation._machine_errors import (
    VolumetricError,
    at_nodes,
    rms_of_vectors,
    volumetric_source,
)
from metrosep.compensation.table import CompensationTable
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, SignCheckFailedError
from metrosep.core.units import format_length
from metrosep.machine._reading_problem import ReadingSet
from metrosep.machine.chains import Chain
from metrosep.machine.instruments import seen

AXES = 3

_PLACES = 2000
"""Poses of a verification that lie on no node."""

_EVEN = 16
"""Places of each axis for means over a volume: a straight line's variance is 0.4 % too small."""

_OTHER_TOOL = 0.05
"""m: by how much other tool points of a verification stand beside the own one."""

_NOTHING = 1e-12
"""m: a smaller error is none that any instrument shows."""

_MOST_NODES = 129
"""Of an axis: a finer grid is asked for where an error has a step or the unit is wrong."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MachineVolume:
    """Corrections of a machine over three axes.

    Parameters
    ----------
    over : tuple of str
        The three axes whose positions are looked up.
    positions : tuple of ndarray, m or rad
        Nodes of each.
    corrections : mapping of str to ndarray, shape (n3, n2, n1), m
        What is added to the command of each corrected axis at the nodes, zero at the reference.
    parts : mapping of (str, str) to CompensationTable
        By looked-up and corrected axis: one table of one axis each, to be added up.
    error : ndarray, shape (n3, n2, n1, 3), m
        Error at the nodes in workpiece X, Y, Z, about the reference.
    left : ndarray, shape of error, m
        The same with `corrections` at the nodes.
    messages : tuple of str
        What no axis corrects, and other things to know.
    source : VolumetricError
        The error as a function of the commands.
    offset : mapping of str to float, m
        Error of each corrected axis at the reference, which the corrections leave.
    errors : ErrorSet or mapping of str to term
        What was corrected.
    """

    over: tuple[str, ...]
    positions: tuple[FloatArray, ...]
    corrections: Mapping[str, FloatArray]
    parts: Mapping[tuple[str, str], CompensationTable]
    error: FloatArray
    left: FloatArray
    messages: tuple[str, ...]
    source: VolumetricError = field(repr=False)
    offset: Mapping[str, float] = field(repr=False)
    errors: Any = field(repr=False)

    def __repr__(self) -> str:
        return (
            f"MachineVolume({', '.join(self.over)} -> {', '.join(self.corrections)}, error "
            f"{format_length(rms_of_vectors(self.error))} RMS, left "
            f"{format_length(rms_of_vectors(self.left))})"
        )

    def correction(self, positions: Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
        """Return what the grid adds to the commands, linear in each axis between the nodes.

        Parameters
        ----------
        positions : mapping of str to array_like, m or rad
            Commands of the looked-up axes, which broadcast; beyond the nodes the end holds.

        Returns
        -------
        dict of str to ndarray, m
            By corrected axis.

        Raises
        ------
        DataError
            A position is missing.
        """
        from scipy.interpolate import RegularGridInterpolator

        places = np.broadcast_arrays(*self._places(positions))
        held = [np.clip(p, g[0], g[-1]) for p, g in zip(places, self.positions, strict=True)]
        points = np.stack(held[::-1], axis=-1)
        return {
            axis: np.asarray(RegularGridInterpolator(self.positions[::-1], values)(points))
            for axis, values in self.corrections.items()
        }

    def residual(
        self,
        positions: Mapping[str, ArrayLike] | None = None,
        *,
        sign: int = 1,
        lookups: Mapping[tuple[str, str], Callable[..., FloatArray]] | None = None,
        tool: ArrayLike | None = None,
    ) -> FloatArray:
        """Return the error of the tool point with the corrections active, anywhere.

        Parameters
        ----------
        positions : mapping of str to array_like, m or rad, optional
            Commands of the looked-up axes; the nodes if omitted.
        sign : {1, 0, -1}, optional
            1 as the corrections are, 0 without them, -1 with the sign reversed.
        lookups : mapping of (str, str) to callable, optional
            Tables of one axis that are added up, by looked-up and corrected axis, in place of the
            grid: ``{k: t.correction for k, t in volume.parts.items()}``, or what a controller adds.
        tool : array_like, shape (3,), m, optional
            Another tool point than the one that was corrected.

        Returns
        -------
        ndarray, shape (..., 3), m
            In workpiece X, Y, Z, about the reference.

        Raises
        ------
        DataError
            A position is missing or a term is not known there.
        """
        if positions is None:
            q = at_nodes(self.over, self.positions, self.source.at)
        else:
            q = {**self.source.at, **dict(zip(self.over, self._places(positions), strict=True))}
        if lookups is None:
            c = {a: sign * v for a, v in self.correction(q).items()}
        else:
            shape = np.broadcast_shapes(*(np.shape(q[a]) for a in self.over))
            c = {axis: np.zeros(shape) for axis in self.corrections}
            for (looked, axis), lookup in lookups.items():
                place = np.asarray(q[looked], dtype=np.float64)
                found = np.asarray(lookup(place.ravel())).reshape(place.shape)
                c[axis] = c[axis] + sign * found
        source, offset = self.source, dict(self.offset)
        if tool is not None:
            source = self._with(tool)
            zero = {a: t.reference for (a, _), t in self.parts.items()}
            offset = {a: float(v) for a, v in source.in_axes({**source.at, **zero}).items()}
        return source.remaining(q, c, {a: v - offset[a] for a, v in c.items()})

    def bound(self) -> FloatArray:
        """Return what linear interpolation between the nodes may leave, shape (3,), m.

        Returns
        -------
        ndarray, shape (3,), m
            In workpiece X, Y, Z: machines.md, eq. 21, with the errors' distance from their chords, as
            `volume_positions` takes it.
        """
        spans = {
            a: (float(g[0]), float(g[-1])) for a, g in zip(self.over, self.positions, strict=True)
        }
        total = np.zeros(3)
        for axis, g in zip(self.over, self.positions, strict=True):
            lines = _along(self.source, spans, axis)
            steps = (g[-1] - g[0]) / float(np.diff(g).max())
            total += [_sag(lines[..., k : k + 1], steps) for k in range(3)]
        return total

    def verify(
        self,
        positions: Mapping[str, ArrayLike] | None = None,
        *,
        tools: Sequence[ArrayLike] | None = None,
        readings: ReadingSet | None = None,
    ) -> dict[str, Any]:
        """Return error before, after and with the sign reversed at places that are not nodes.

        Parameters
        ----------
        positions : mapping of str to array_like, m or rad, optional
            Where; 2000 places spread over the volume if omitted.
        tools : sequence of array_like, shape (3,), m, optional
            Other tool points; 50 mm beside the own one in X, Y and Z if omitted.
        readings : ReadingSet, optional
            Readings that were taken on the machine with the corrections active, best of another
            kind than those that gave the errors: a circle, a diagonal, a ball in another place.

        Returns
        -------
        dict
            ``before_rms_m``, ``after_rms_m``, ``after_max_m`` (of the vector), ``after_max_component_m``,
            ``wrong_sign_rms_m``, ``bound_m`` (X, Y, Z), ``places``, ``against`` (what it was judged by), and ``other_tools``: a list
            of ``tool_m``, ``before_rms_m``, ``after_rms_m``, ``after_per_metre``. With readings also
            ``readings``: ``name``, ``rms_m`` of what was read, and what the model says of it:
            ``predicted_rms_m``, ``without_rms_m``, ``wrong_sign_rms_m``; the set-up is fitted off
            each.

        Raises
        ------
        SignCheckFailedError
            The RMS does not shrink; or what was read is not smaller than what the machine would
            read without corrections.
        DataError
            A position is missing or a term is not known there; or the readings are angles, or from
            the bed, which corrections of positions do not change.

        Notes
        -----
        Without readings the judge is the model that the corrections come from: a wrong convention
        of a term passes.
        """
        found = self.judged(positions, tools=tools)
        if readings is not None:
            found["readings"] = self._read(readings)
            found["against"] = f"readings of {readings.label}"
            read, without = (found["readings"][k] for k in ("rms_m", "without_rms_m"))
            if not read < without:
                raise SignCheckFailedError(
                    f"{readings.label}: with the corrections active {format_length(read)} RMS was read, and "
                    f"without them the model says {format_length(without)}: they do not correct this "
                    "machine; a sign, an axis or the tool point is another one there"
                )
        before, after, wrong = (
            found[k] for k in ("before_rms_m", "after_rms_m", "wrong_sign_rms_m")
        )
        if not after < before:
            raise SignCheckFailedError(
                f"the corrections over {', '.join(self.over)} do not shrink the error: RMS "
                f"{format_length(before)} -> {format_length(after)}, with the reversed sign "
                f"{format_length(wrong)}; they belong to other errors or another place"
            )
        return found

    def added_up(
        self,
        positions: Mapping[str, ArrayLike] | None = None,
        *,
        lookups: Mapping[tuple[str, str], Callable[..., FloatArray]] | None = None,
    ) -> dict[str, Any]:
        """Return what tables of one axis each leave, added up, and what the grid on the same nodes leaves.

        Parameters
        ----------
        positions : mapping of str to array_like, m or rad, optional
            Where; 2000 places spread over the volume if omitted.
        lookups : mapping of (str, str) to callable, optional
            What a controller adds, as for `residual`; if omitted what `parts` hold.

        Returns
        -------
        dict
            ``before_rms_m``, ``after_rms_m`` and ``after_max_m`` of the error vector with the tables,
            ``grid_rms_m`` with the grid, ``least_rms_m`` that no tables of one axis can go below (16 places of
            each axis, in the middle of equal parts of its travel), and ``by_term``: the RMS in m of what each term does of two or three axes at once, about the
            reference, largest first.

        Raises
        ------
        DataError
            A position is missing or a term is not known there.
        """
        where = self.between() if positions is None else positions
        tables = lookups or {pair: table.correction for pair, table in self.parts.items()}
        before, after = (self.residual(where, sign=s, lookups=tables) for s in (0, 1))
        return {
            "before_rms_m": rms_of_vectors(before),
            "after_rms_m": rms_of_vectors(after),
            "after_max_m": float(np.linalg.norm(after, axis=-1).max()),
            "grid_rms_m": rms_of_vectors(self.residual(where)),
            "least_rms_m": rms_of_vectors(_not_additive(self._even())),
            "by_term": self._of_two_axes(where),
        }

    def _even(self) -> FloatArray:
        """Return the error at places that fill the volume evenly, (n, n, n, 3)."""
        share = (np.arange(_EVEN) + 0.5) / _EVEN
        grid = [g[0] + (g[-1] - g[0]) * share for g in self.positions]
        places = np.meshgrid(*grid, indexing="ij")
        return self.residual(dict(zip(self.over, places, strict=True)), sign=0)

    def _of_two_axes(self, positions: Mapping[str, ArrayLike]) -> dict[str, float]:
        """Return of each term the RMS of ``E - sum over a of E_a``, E about the reference."""
        terms: Any = getattr(self.errors, "terms", self.errors)
        if not isinstance(terms, Mapping):
            return {}
        zero = {a: t.reference for (a, _), t in self.parts.items()}
        still = {**self.source.at, **zero}
        moving = dict(zip(self.over, np.broadcast_arrays(*self._places(positions)), strict=True))
        found = {}
        for name, term in terms.items():

            def error(q: Mapping[str, Any], name: str = name, term: Any = term) -> FloatArray:
                return self.source.chain.volumetric_error(
                    {**still, **q}, {name: term}, tool=self.source.tool
                )

            here = error({})
            left = error(moving) - here - sum(error({a: v}) - here for a, v in moving.items())
            size = rms_of_vectors(left)
            if size > _NOTHING:
                found[name] = size
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def judged(
        self,
        positions: Mapping[str, ArrayLike] | None = None,
        *,
        tools: Sequence[ArrayLike] | None = None,
    ) -> dict[str, Any]:
        """Return what `verify` returns, whatever comes out.

        Parameters
        ----------
        positions, tools : optional
            As for `verify`.

        Returns
        -------
        dict
            As of `verify`.
        """
        where = self.between() if positions is None else positions
        left = [self.residual(where, sign=s) for s in (0, 1, -1)]
        before, after, wrong = (rms_of_vectors(v) for v in left)
        own = np.asarray(self.source.tool, dtype=np.float64)
        others = own + _OTHER_TOOL * np.eye(3) if tools is None else tools
        beside = []
        for tool in others:
            t = np.asarray(tool, dtype=np.float64)
            sizes = [rms_of_vectors(self.residual(where, sign=s, tool=t)) for s in (0, 1)]
            apart = float(np.linalg.norm(t - own))
            beside.append(
                {
                    "tool_m": t.tolist(),
                    "before_rms_m": sizes[0],
                    "after_rms_m": sizes[1],
                    "after_per_metre": sizes[1] / apart if apart > 0.0 else None,
                }
            )
        return {
            "before_rms_m": before,
            "after_rms_m": after,
            "after_max_m": float(np.linalg.norm(left[1], axis=-1).max()),
            "after_max_component_m": float(np.abs(left[1]).max()),
            "wrong_sign_rms_m": wrong,
            "bound_m": self.bound().tolist(),
            "places": int(left[1][..., 0].size),
            "against": "the model only",
            "other_tools": beside,
        }

    def _read(self, readings: ReadingSet) -> dict[str, Any]:
        """Return the RMS of readings, and of what the model says of them, set-up fitted off."""
        instrument, chain = readings.instrument, self.source.chain
        if instrument.is_angle or instrument.end == "bed":
            raise DataError(
                f"{readings.label}: angles and readings from the bed say nothing of corrected positions; "
                "give readings between tool and workpiece"
            )
        source = self._with(readings.tool)
        q: dict[str, Any] = {**self.source.at, **readings.q}
        _, _, _, view = seen(chain, instrument, q, readings.tool)
        values = np.asarray(readings.values)
        n, k = values.shape
        own = [np.broadcast_to(o, (n, k, o.shape[-1])) for o in (
            instrument.of_unknown(name, view) for name in readings.unknown
        )]  # fmt: skip
        keep = np.isfinite(values).ravel()
        A = np.concatenate([*own, np.zeros((n, k, 1))], axis=-1).reshape(n * k, -1)[keep]
        base = np.linalg.svd(A, full_matrices=False)
        Q = base[0][:, base[1] > 1e-9 * max(float(base[1][0]), 1e-300)]

        def rms(rows: FloatArray) -> float:
            part = np.broadcast_to(rows, (n, k)).ravel()[keep]
            part = part - Q @ (Q.T @ part)
            return float(np.sqrt(np.mean(part**2)))

        def predicted(sign: int) -> float:
            c = {a: sign * v for a, v in self.correction(q).items()}
            moved = source.remaining(q, c, c)
            return rms((instrument.of_errors(view) @ moved[..., None])[..., 0])

        whole = values - instrument.nominal(view) if readings.total else values
        return {
            "name": readings.label,
            "rms_m": rms(whole),
            "predicted_rms_m": predicted(1),
            "without_rms_m": predicted(0),
            "wrong_sign_rms_m": predicted(-1),
        }

    def _with(self, tool: ArrayLike) -> VolumetricError:
        """Return the error of another tool point."""
        return volumetric_source(
            self.source.chain,
            self.errors,
            axes=self.over,
            grid=self.positions,
            at=self.source.at,
            corrects=self.source.names,
            tool=tool,
            exact=False,
        )

    def _places(self, positions: Mapping[str, ArrayLike]) -> list[FloatArray]:
        missing = [a for a in self.over if a not in positions]
        if missing:
            raise DataError(f"positions lack the looked-up axis {missing[0]!r}")
        return [np.asarray(positions[a], dtype=np.float64) for a in self.over]

    def between(self) -> dict[str, FloatArray]:
        """Return places that fill the volume evenly and lie on no node (additive recurrence).

        Returns
        -------
        dict of str to ndarray, shape (2000,), m or rad
            Of each looked-up axis.
        """
        ratio = 1.2207440846057596  # the real root of x^4 = x + 1
        steps = np.arange(1, _PLACES + 1)
        return {
            a: g[0] + (g[-1] - g[0]) * np.mod(0.5 + steps / ratio ** (k + 1), 1.0)
            for k, (a, g) in enumerate(zip(self.over, self.positions, strict=True))
        }


def _not_additive(values: FloatArray) -> FloatArray:
    """Return what is left of values over three axes without their parts of one axis each (least squares)."""
    rest: FloatArray = values - values.mean(axis=(0, 1, 2))
    for axis in range(AXES):
        others = tuple(k for k in range(AXES) if k != axis)
        rest = rest - rest.mean(axis=others, keepdims=True)
    return rest


def volume_positions(
    chain: Chain,
    errors: Any,
    *,
    spans: Mapping[str, tuple[float, float]],
    tolerance: float | str,
    at: Mapping[str, float] | None = None,
    tool: ArrayLike = (0.0, 0.0, 0.0),
) -> dict[str, FloatArray]:
    """Return the coarsest grid over three axes that leaves no more than a tolerance between its nodes.

    Parameters
    ----------
    chain : Chain
        The machine.
    errors : ErrorSet or mapping of str to term
        Error terms by name.
    spans : mapping of str to tuple of (float, float), m or rad
        Travel of each of the three axes.
    tolerance : float or str, m
        Largest error in one direction of the workpiece that interpolation may leave.
    at : mapping of str to float, m or rad, optional
        Where the other axes stand.
    tool : array_like, shape (3,), m, optional
        Tool point.

    Returns
    -------
    dict of str to ndarray, m or rad
        Evenly spaced nodes of each axis.

    Raises
    ------
    DataError
        Not three axes, or no grid of 129 nodes of an axis keeps the tolerance.
    InvalidSamplesError, UnitError
        The tolerance is not a length above zero.

    Notes
    -----
    Each axis gets a third of the tolerance (machines.md, eq. 21). How far the errors leave their chords
    is looked at along lines with the other axes at both ends and in the middle of their travel, at
    4097 places and for steps that begin anywhere.
    """
    if len(spans) != AXES:
        raise DataError(f"spans names three axes; got {', '.join(spans) or 'none'}")
    allowed = numbers.positive(numbers.quantity(tolerance, "tolerance", "length"), "tolerance")
    ends = tuple(np.array(span, dtype=np.float64) for span in spans.values())
    source = volumetric_source(
        chain, errors, axes=tuple(spans), grid=ends, at=dict(at or {}), corrects=None, tool=tool,
        exact=False,
    )  # fmt: skip
    lines = {axis: _along(source, spans, axis) for axis in spans}
    if max(float(np.ptp(E, axis=(0, 1)).max()) for E in lines.values()) < _NOTHING:
        raise DataError(_nothing_to_correct(next(iter(lines.values()))[0, 0], tuple(spans)))
    found = {}
    for axis, (low, high) in spans.items():
        counts = range(2, _MOST_NODES + 1)
        wanted = next((n for n in counts if _sag(lines[axis], n - 1) <= allowed / AXES), None)
        if wanted is None:
            raise DataError(
                f"{axis} would need more than {_MOST_NODES} nodes for {format_length(allowed)}: an error "
                "has a step or a short wave, or a unit is wrong"
            )
        found[axis] = np.linspace(low, high, wanted)
    return found


_FINE = 4096
"""Steps along a line of the volume on which errors are looked at: waves down to a thousandth of it."""


def _nothing_to_correct(shift: FloatArray, over: Sequence[str]) -> str:
    """Return why no grid is needed: nothing moves the tool point, or it is moved alike everywhere."""
    if float(np.abs(shift).max()) < _NOTHING:
        return (
            "the errors do not move the tool point within these travels, so there is nothing to correct; an "
            "angle acts through an arm, so state the tool point that cuts (--tool)"
        )
    sizes = ", ".join(
        f"{a} {format_length(float(v), digits=4)}"
        for a, v in zip("XYZ", shift, strict=True)
        if abs(v) >= _NOTHING
    )
    return (
        f"over {', '.join(over)} the errors shift the tool point by the same everywhere (in the workpiece "
        f"{sizes}): no grid is needed; enter minus that as an offset of the work in the control"
    )


def _along(
    source: VolumetricError, spans: Mapping[str, tuple[float, float]], axis: str
) -> FloatArray:
    """Return the errors along an axis, the others at both ends and in the middle, (9, n, 3)."""
    low, high = spans[axis]
    x = np.linspace(low, high, _FINE + 1)
    others = {a: np.linspace(*span, 3) for a, span in spans.items() if a != axis}
    one, two = others
    q: dict[str, Any] = {**source.at, axis: x}
    places = [{one: i, two: k} for i in others[one] for k in others[two]]
    return np.stack([source.moved({**q, **place}, {}) for place in places])


def _sag(errors: FloatArray, steps: float) -> float:
    """Return by how much errors leave their chords over a step that begins anywhere.

    A wave that is as long as the step is zero at every node: eight beginnings find it.
    """
    at = np.arange(_FINE + 1) / _FINE
    h = 1.0 / steps
    begin = np.arange(0.0, 1.0 - h + 1e-12, h / 8.0)[:, None]
    share = np.linspace(0.0, 1.0, max(8, math.ceil(_FINE / (4.0 * steps))) + 1)
    largest = 0.0
    for part in (p for line in errors for p in line.T):
        E = np.interp(begin + share * h, at, part)
        chord = E[:, :1] * (1.0 - share) + E[:, -1:] * share
        largest = max(largest, float(np.abs(E - chord).max()))
    return largest
