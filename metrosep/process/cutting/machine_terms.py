"""What error terms of a machine do to the tip along a program, term by term.

The chain of the machine says where the tool point is in the workpiece, nominal and with an error; the
difference, turned into the frame of the tool (radial, across, along z), is a deviation of the path.
First order in the errors, as the tool point moves; the edge keeps its direction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.process._plain import frozen
from metrosep.process.cutting.budgets import PathDeviation
from metrosep.process.cutting.programs import TurningProgram

if TYPE_CHECKING:
    from metrosep.machine.chains import Chain

_TURN = 2.0 * math.pi
_BLOCK = 1 << 16
_ON_SPIRAL = 1e-6
"""rad: by which the azimuth of the chain may leave that of the program; another way of C leaves it by radians."""


def machine_deviations(
    program: TurningProgram,
    chain: Chain,
    errors: Any,
    *,
    positions: Mapping[str, FloatArray] | None = None,
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> dict[str, PathDeviation]:
    """Return what each error term of a machine does to the tip along a program.

    Parameters
    ----------
    program : TurningProgram
        Of the tip.
    chain : Chain
        With the axes X, Z and C; others stand at zero.
    errors : ErrorSet or mapping of str to float, callable or ErrorTerm
        Error terms by their ISO 230-1 names, as of `Chain.volumetric_error`.
    positions : mapping of str to ndarray, shape (n,), m and rad, optional
        Of the axes of the chain at the points of the program; if omitted X and Z are those of the program, and
        C is what puts the tool at its azimuths.
    tool : tuple of float, m, optional
        Tool point in the frame of the last element of its branch.

    Returns
    -------
    dict of str to PathDeviation
        By the name of each term: actual minus nominal, for `cut_budget(..., deviation=...)`.

    Raises
    ------
    DataError
        If the chain has no X, Z or C, the tool of the chain does not go round the part as the program does,
        or as of `Chain.volumetric_error`.

    Notes
    -----
    An uncertainty of a term (of `ErrorSet`, or a column of its file) is that of all its positions together: the
    term and u times one number, the same everywhere. For a location error that is all there is; noise from
    position to position acts less. C is taken within one turn, 0 to 2 pi. A tilt acts at the tip; what it turns of the edge, R sin(psi)
    times the tilt, is omitted: 0.1 nm for 1 urad and a contact 0.1 mm beside the tip.

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> turn = np.linspace(0.0, 4.0 * np.pi, 49)
    >>> program = TurningProgram(1e-3 - 1e-6 * turn, turn, 0.0 * turn, turn, "tip")
    >>> found = machine_deviations(program, presets("sts_lathe"), {"EYX": 1e-6})
    >>> found["EYX"].Y[:2].round(9).tolist()
    [1e-06, 1e-06]
    """
    from metrosep.machine import CallableTerm, as_error_set

    lacking = [a for a in ("X", "Z", "C") if a not in chain.axes]
    if lacking:
        raise DataError(
            f"the machine {chain.name!r} has no axis {', '.join(lacking)}: it turns nothing"
        )
    given = as_error_set(errors)
    n = len(program)
    q = _positions(program, chain, positions)
    outward = float(np.mean(q["X"])) >= 0.0  # a tool on -X: x grows towards the axis
    # a term, and what its u does where it has one
    acting: dict[str, list[Any]] = {name: [term] for name, term in given.terms.items()}
    for name, u in given.u_at({a: v for a, v in q.items() if np.ndim(v)}).items():
        if np.any(u != 0.0):  # NaN: not known, and so is what it does
            acting[name].append(CallableTerm(given.terms[name].sd))
    found = {name: np.zeros((len(terms), 4, n)) for name, terms in acting.items()}
    for first in range(0, n, _BLOCK):
        part = slice(first, min(first + _BLOCK, n))
        here = {a: v if np.ndim(v) == 0 else v[part] for a, v in q.items()}
        phi = _direction(chain, here) + (0.0 if outward else math.pi)
        c, s = np.cos(phi), np.sin(phi)
        for name, terms in acting.items():
            for rows, term in zip(found[name], terms, strict=True):
                e = chain.volumetric_error(here, {name: term}, tool=tool)
                e = np.broadcast_to(e, (c.size, 3))
                rows[0, part] = c * e[:, 0] + s * e[:, 1]
                rows[2, part] = e[:, 2]
                rows[3, part] = c * e[:, 1] - s * e[:, 0]
    t = frozen(program.t)
    made: dict[str, PathDeviation] = {}
    for name, all_rows in found.items():
        plain, *more = (
            PathDeviation(t, frozen(X), frozen(turn), frozen(Z), frozen(Y))
            for X, turn, Z, Y in all_rows
        )
        made[name] = replace(plain, u=more[0]) if more else plain
    return made


def _positions(
    program: TurningProgram, chain: Chain, given: Mapping[str, FloatArray] | None
) -> dict[str, Any]:
    """Return where the axes of a chain stand; refuse a C that goes round the other way than the program."""
    q: dict[str, Any] = dict.fromkeys(chain.axes, 0.0)
    if given is None:
        at = [_direction(chain, {**q, "C": np.array([c])})[0] for c in (0.0, 1e-3)]
        way = 1.0 if math.remainder(at[1] - at[0], _TURN) > 0.0 else -1.0
        given = {"X": program.X, "Z": program.Z, "C": way * (program.azimuth - at[0])}
    q |= {**given, "C": np.mod(given["C"], _TURN)}
    sample = np.unique(np.linspace(0, len(program) - 1, 97).astype(np.intp))
    here = {a: v if np.ndim(v) == 0 else np.asarray(v)[sample] for a, v in q.items()}
    off = _direction(chain, here) - program.azimuth[sample]
    # where the part is clamped is no matter: a constant angle is left
    off = np.abs(np.angle(np.exp(1j * (off - off[0]))))
    if off.max() > _ON_SPIRAL:
        raise DataError(
            f"C of the machine {chain.name!r} and of the program turn the part opposite ways: c_positive, or "
            "the direction of C in the file of the machine, is wrong; in sts_lathe and fts_lathe C turns the "
            'workpiece ("workpiece ccw"), in five_axis the tool goes round it ("tool ccw")'
        )
    return q


def _direction(chain: Chain, q: Mapping[str, Any]) -> FloatArray:
    """Return the azimuth on the part along which X of the tool grows, rad."""
    near, far = (
        chain.transform({**q, "X": np.full(np.shape(q["C"]), x)})[..., :2, 3] for x in (0.0, 1.0)
    )
    out = far - near
    return np.asarray(np.arctan2(out[..., 1], out[..., 0]))
