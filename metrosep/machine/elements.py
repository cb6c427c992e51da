"""Elements of a kinematic chain: one slide, spindle, table or fixed part each.

The frame of an element sits in the frame of the element before it (or in the bed):

    T = Trans(location) M(q) (I + hat(xi))      error frame "after": the error moves with the body
    T = Trans(location) (I + hat(xi)) M(q)      error frame "before": the error stays where it was

with ``M = Trans(q direction)``, ``Rot(direction, q)`` or, for a fixed part, ``Rot(direction, angle)``
and ``xi = (EX, EY, EZ, EA, EB, EC)`` along and about the element's own X, Y, Z, at the functional
point `measured_at` of that frame. With all axes at zero (and no fixed rotation) every frame is
parallel to the bed. SI: metres and radians.

An instrument reads at the functional point, which the tool side carries. Seen from there, an axis
that carries the workpiece has its errors in the frame before it: its own travel is not a lever, and a
rotary table does not turn the directions in which a nest in the spindle reads.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from metrosep.core import numbers
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length

KINDS = ("linear", "rotary", "fixed")
BRANCHES = ("tool", "workpiece")
FRAMES = ("after", "before")
SIDES = ("body", "tool")
DIRECTIONS = "XYZABC"

_LOCATION_NAME = re.compile(r"E?[XYZABC]0[A-Za-z][A-Za-z0-9_]*")
_REACHED = 1e-9  # m or rad beyond the end of a travel: rounding
_UNIT_TOLERANCE = 1e-9  # a direction typed with ten digits passes, one with three does not


@dataclass(frozen=True, slots=True)
class Element:
    """One element of a chain: how it moves and which errors it has.

    Parameters
    ----------
    name : str
        Name of the axis, as it stands in the error terms ("X", "C", "FTS"); letters, digits and
        ``_``, starting with a letter.
    branch : str
        ``"tool"`` or ``"workpiece"``.
    kind : str
        ``"linear"``, ``"rotary"`` or ``"fixed"``.
    direction : sequence of float, shape (3,), dimensionless
        Unit vector along which the axis moves this body when its position grows, or about which it
        turns it by the right-hand rule. Free for a fixed part without a rotation.
    location : sequence of float, shape (3,), m
        Origin of this element in the frame before it, at position zero: for a rotary axis a point
        on its axis, for a linear axis the point about which its angular errors turn.
    error_frame : str, optional
        ``"after"`` (the errors are attached to the moved body) or ``"before"``; `frame` says which
        holds. If omitted, "before" for errors of the tool on an axis that carries the workpiece,
        else "after".
    errors_of : str
        ``"body"``: the errors are motions of this body in its frame. ``"tool"``: they are motions of
        the tool against the workpiece, as an instrument between the two reads them; in the
        workpiece branch that is the opposite.
    measured_at : sequence of float, shape (3,), m
        Point at which the error motions were read, as an offset from the origin of the error frame
        at position zero; zero reads them at the tool point of the chain's zero.
    errors : sequence of str, optional
        Directions that have an error term; all six where the element moves, none where it is fixed.
    location_errors : mapping of str to sequence of float, shape (6,), optional
        Name of each location error (squareness, offset of a rotary axis) -> displacement of the
        line of motion per unit of the term: (x, y, z, a, b, c) in the frame before the motion.
    angle : float, rad, optional
        Fixed rotation of a fixed part.
    parked : bool, optional
        The axis may be missing in the positions: then it is not a joint, its motion and errors are nil.
    parallel_to : str, optional
        Name of the axis that this one repeats on purpose (a fast tool on a slide).
    travel : sequence of float, shape (2,), m or rad, optional
        Lowest and highest position that the axis reaches; not limited if omitted. Readings, inverse
        kinematics, paths and tables are refused beyond it.

    Raises
    ------
    DataError
        An unknown kind, branch, error frame, side or direction, a name that cannot be part of a term, a
        direction that is not a unit vector, a rotation of a part that is not fixed, a location error
        that does nothing (the shift of a slide's line of travel).
    InvalidSamplesError
        A vector with the wrong length or with values that are not finite numbers, an angle that is none.

    Notes
    -----
    A location error displaces the line of motion by a small displacement L about the element's
    location. Of a linear axis the travel turns and the carriage keeps its attitude, ``L M L^-1``:
    nothing happens at position zero (an attitude is the constant part of EA, EB, EC). The axis of a
    rotary element takes along what it carries, ``L M``.

    Examples
    --------
    >>> x = Element("X", "tool", "linear", direction=(1, 0, 0))
    >>> element_terms(x)
    ('EXX', 'EYX', 'EZX', 'EAX', 'EBX', 'ECX')
    """

    name: str
    branch: str
    kind: str
    direction: Sequence[float] = (0.0, 0.0, 1.0)
    location: Sequence[float] = (0.0, 0.0, 0.0)
    error_frame: str | None = None
    errors_of: str = "body"
    measured_at: Sequence[float] = (0.0, 0.0, 0.0)
    errors: Sequence[str] | None = None
    location_errors: Mapping[str, Sequence[float]] = field(default_factory=dict, hash=False)
    angle: float = 0.0
    parked: bool = False
    parallel_to: str | None = None
    travel: Sequence[float] | None = None

    def __post_init__(self) -> None:
        given: object = self.name
        name = given if isinstance(given, str) else ""
        if not name.isidentifier() or not name.isascii() or name[0] == "_":
            raise DataError(
                f"an axis name is a letter and then letters, digits or _, got {self.name!r}; "
                "it becomes part of the term names (X -> EXX)"
            )
        known = {"kind": KINDS, "branch": BRANCHES, "error_frame": FRAMES, "errors_of": SIDES}
        for key, allowed in known.items():
            if key != "error_frame" or self.error_frame is not None:
                numbers.choice(getattr(self, key), f"{key} of element {self.name!r}", allowed)
        for key in ("direction", "location", "measured_at"):
            self._set(key, _vector(getattr(self, key), 3, f"{key} of {self.name!r}"))
        norm = math.hypot(*self.direction)
        if abs(norm - 1.0) > _UNIT_TOLERANCE:
            raise DataError(
                f"direction of element {self.name!r} is {tuple(self.direction)} with length "
                f"{norm:.9g}; it must be a unit vector"
            )
        self._set("direction", tuple(c / norm for c in self.direction))
        angle = numbers.quantity(self.angle, f"angle of element {self.name!r}", "angle")
        self._set("angle", angle)
        if self.kind != "fixed" and self.angle != 0.0:
            raise DataError(
                f"element {self.name!r} is {self.kind} and has a fixed angle of {self.angle} rad; "
                "put the rotation into a fixed element of its own"
            )
        self._check_parking()
        if self.travel is not None:
            ends = _vector(self.travel, 2, f"travel of {self.name!r}")
            if self.kind == "fixed" or not ends[0] < ends[1]:
                why = (
                    "is fixed" if self.kind == "fixed" else "needs its low end before its high one"
                )
                raise DataError(f"element {self.name!r} {why}; travel is {_short(self.travel)}")
            self._set("travel", ends)
        self._set("errors", self._checked_errors())
        self._set("location_errors", self._checked_location_errors())

    @property
    def frame(self) -> str:
        """Frame of the error motions, "after" or "before": the one chosen, else as the errors are read."""
        if self.error_frame is not None:
            return self.error_frame
        return "before" if error_sign(self) < 0.0 else "after"

    def _set(self, key: str, value: object) -> None:
        object.__setattr__(self, key, value)

    def _check_parking(self) -> None:
        numbers.flag(self.parked, f"parked of element {self.name!r}")
        if self.parallel_to is not None and not isinstance(self.parallel_to, str):
            raise DataError(
                f"parallel_to of element {self.name!r} is the name of an axis, got "
                f"{_short(self.parallel_to)}"
            )
        if self.parallel_to == self.name:
            raise DataError(f"parallel_to of element {self.name!r} names itself")

    def _checked_errors(self) -> tuple[str, ...]:
        chosen = self.errors
        if chosen is None:
            return () if self.kind == "fixed" else tuple(DIRECTIONS)
        if not isinstance(chosen, Sequence):
            raise DataError(
                f"errors of element {self.name!r} are directions such as 'XYZ' or ['X', 'A'], got "
                f"{_short(chosen)}"
            )
        for direction in chosen:
            if direction not in tuple(DIRECTIONS):
                raise DataError(
                    f"errors of element {self.name!r} hold {_short(direction)}; "
                    f"known directions are {', '.join(DIRECTIONS)}"
                )
        if len(set(chosen)) < len(chosen):
            raise DataError(f"errors of element {self.name!r} repeat a direction: {list(chosen)}")
        return tuple(d for d in DIRECTIONS if d in chosen)

    def _checked_location_errors(self) -> Mapping[str, tuple[float, ...]]:
        if not isinstance(self.location_errors, Mapping):
            raise DataError(
                f"location_errors of element {self.name!r} map names to six numbers, got "
                f"{_short(self.location_errors)}"
            )
        if self.kind == "fixed" and self.location_errors:
            raise DataError(
                f"element {self.name!r} is fixed and has no line of motion that "
                f"{next(iter(self.location_errors))!r} could displace; give it errors instead"
            )
        for name in self.location_errors:
            if not _LOCATION_NAME.fullmatch(str(name)):
                raise DataError(
                    f"location error {name!r} of {self.name!r} needs a name such as C0Y, B0Z or X0C: "
                    "a direction, 0, an axis name"
                )
        lines = {
            name: _vector(value, 6, f"location error {name!r} of {self.name!r}")
            for name, value in self.location_errors.items()
        }
        for name, line in lines.items():
            self._refuse_idle(name, line)
        return freeze_mapping(lines)

    def _refuse_idle(self, name: str, line: Sequence[float]) -> None:
        """Refuse a location error whose effect is zero at every position."""
        if self.kind == "linear":
            x, y, z = self.direction
            a, b, c = line[3:]
            acts = any((b * z - c * y, c * x - a * z, a * y - b * x))
            reason = (
                "a shift of the line of travel of a slide, or a turn about it, moves nothing; its "
                "carriage has EX ... EC for that"
            )
        else:
            acts, reason = any(line), "its displacement is zero"
        if not acts:
            raise DataError(
                f"location error {name!r} of {self.name!r} does nothing: {reason}; leave it out"
            )


def place_of(element: Element, at: float) -> str:
    """Return a position of an axis as text with its unit."""
    return (
        f"{math.degrees(at):.9g} deg" if element.kind == "rotary" else format_length(at, digits=9)
    )


def require_travel(elements: Sequence[Element], q: Mapping[str, Any], first: int = 0) -> None:
    """Refuse poses, numbered from `first`, that an axis with a stated travel does not reach."""
    for e in elements:
        if e.travel is None or e.name not in q:
            continue
        low, high = e.travel
        at = np.ravel(np.asarray(q[e.name], dtype=np.float64))
        beyond = np.flatnonzero((at < low - _REACHED) | (at > high + _REACHED))
        if beyond.size:
            more = f" (and {beyond.size - 1} more)" if beyond.size > 1 else ""
            raise LimitError(
                f"pose {first + beyond[0] + 1}{more}: {e.name} = {place_of(e, float(at[beyond[0]]))} is outside the "
                f"travel of {e.name}, {place_of(e, low)} to {place_of(e, high)}"
            )


def error_sign(element: Element) -> float:
    """Return what turns an element's errors into motions of its body: -1 or 1."""
    return -1.0 if (element.errors_of, element.branch) == ("tool", "workpiece") else 1.0


def element_terms(element: Element) -> tuple[str, ...]:
    """Return the names of an element's error terms after ISO 230-1.

    Parameters
    ----------
    element : Element
        One element of a chain.

    Returns
    -------
    tuple of str
        ``E`` + direction + axis name for the error motions, then the location errors.

    Examples
    --------
    >>> element_terms(Element("C", "workpiece", "rotary", errors=("X", "A")))
    ('EXC', 'EAC')
    """
    motions = tuple(f"E{direction}{element.name}" for direction in element.errors or ())
    return motions + tuple(element.location_errors)


def term_unit(chain: Any, term: str) -> str:
    """Return "rad" for an angular term of a chain, "m" for another."""
    for element in chain.elements:
        if term in element.location_errors:
            return "rad" if any(element.location_errors[term][3:]) else "m"
    return "rad" if term[1:2] in ("A", "B", "C") else "m"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 80 else text[:60] + " ..."


def _vector(values: Sequence[float], size: int, name: str) -> tuple[float, ...]:
    try:
        listed = () if isinstance(values, str | Mapping) else tuple(values)
    except TypeError:
        listed = ()
    if not listed or not all(numbers.is_real(v) for v in listed):
        raise InvalidSamplesError(f"{name} must be {size} numbers, got {_short(values)}")
    vector = tuple(float(v) for v in listed)
    if len(vector) != size or not all(math.isfinite(v) for v in vector):
        raise InvalidSamplesError(f"{name} must be {size} finite numbers, got {_short(values)}")
    return vector


# ---- names of error terms: ISO 230-1 and the swapped subscripts of the fast-tool-servo paper ----
# ISO 230-1 writes the direction first and the axis second: EYX is the straightness of X in Y. The
# paper writes the axis first: delta_xy is the same term. ``delta_xy`` read as an ISO name would be the
# straightness of Y in X: a swap that no program notices, since both exist on a machine with a Y axis.
#
# ========================  ==================  =========================
# paper                     short spellings     ISO 230-1
# ========================  ==================  =========================
# delta_xx delta_xy         dxx dxy             EXX EYX
# epsilon_xx epsilon_xy     exx exy eps_xx      EAX EBX
# delta_cz epsilon_cz       dcz ecz             EZC ECC
# delta_fx epsilon_fy       dfx efy             EXFTS EBFTS
# eta_zx                    Hzx H_zx hzx        B0Z
# ========================  ==================  =========================

_AXES = {"x": "X", "z": "Z", "c": "C", "f": "FTS"}
_MOTIONS = {"delta": "XYZ", "epsilon": "ABC"}
_STEMS = {"d": "delta", "delta": "delta", "e": "epsilon", "eps": "epsilon", "epsilon": "epsilon"}
_SQUARENESS = {"eta_zx": "B0Z"}
# both shapes of epsilon: what a person types and what LaTeX and many PDF files hold
_GREEK = {"\u03b4": "delta", "\u03b5": "epsilon", "\u03f5": "epsilon", "\u03b7": "eta"}
_SPELLING = re.compile(r"(delta|epsilon|eps|d|e)_?\{?([xzcf])([xyz])\}?")
_ISO_MOTION = re.compile(r"E([XYZABC])([A-Za-z][A-Za-z0-9_]*)")
_ISO_LOCATION = re.compile(r"E?([XYZABC])0([A-Za-z][A-Za-z0-9_]*)")

Value = TypeVar("Value")


def from_paper(name: str) -> str:
    """Return the ISO 230-1 name of a term of the paper.

    Parameters
    ----------
    name : str
        ``delta_mn``, ``epsilon_mn`` or ``eta_zx`` with Greek letters or spelt, or the short forms
        (dxx, exy, eps_xy, dcx, ecy, dfx, efx, Hzx); m the axis x, z, c or f, n the direction.

    Returns
    -------
    str
        ISO name: E + direction + axis, or B0Z.

    Raises
    ------
    DataError
        The paper has no such term; ISO names are refused, since their subscripts mean otherwise.

    Notes
    -----
    A lone ``exz`` is the paper's epsilon_xz, the yaw of X: ECX. The merged terms of its Table 2
    (dx, dy, dz) are sums of several and are refused.

    References
    ----------
    .. [1] Micromachines 11 (2020) 331, Table 1.

    Examples
    --------
    >>> from_paper("delta_xy"), from_paper("efx"), from_paper("Hzx")
    ('EYX', 'EAFTS', 'B0Z')
    """
    text = str(name).strip()
    for letter, word in _GREEK.items():
        text = text.replace(letter, word)
    if re.fullmatch(r"(eta_?|H_?|h_?)\{?zx\}?", text):
        return "B0Z"
    match = _SPELLING.fullmatch(text)
    if match is None:
        raise DataError(
            f"{name!r} is not an error term of the paper; write delta_mn or epsilon_mn with m one of "
            "x, z, c, f (the axis) and n one of x, y, z (the direction), or eta_zx"
        )
    stem, axis, direction = match.groups()
    return f"E{_MOTIONS[_STEMS[stem]]['xyz'.index(direction)]}{_AXES[axis]}"


def to_paper(term: str) -> str:
    """Return the paper's name of an ISO 230-1 term.

    Parameters
    ----------
    term : str
        Name such as EYX, ECC, EXFTS, B0Z.

    Returns
    -------
    str
        ``delta_mn``, ``epsilon_mn`` or ``eta_zx``.

    Raises
    ------
    DataError
        The paper has no such term.

    Examples
    --------
    >>> to_paper("EYX"), to_paper("EAFTS")
    ('delta_xy', 'epsilon_fx')
    """
    for paper, iso in _SQUARENESS.items():
        if term == iso:
            return paper
    given: object = term
    match = _ISO_MOTION.fullmatch(given) if isinstance(given, str) else None
    letters = {axis: letter for letter, axis in _AXES.items()}
    if match is None or match[2] not in letters:
        raise DataError(f"the paper has no term {term!r}; its axes are X, Z, C and FTS, and B0Z")
    stem = "delta" if match[1] in "XYZ" else "epsilon"
    direction = "xyz"[_MOTIONS[stem].index(match[1])]
    return f"{stem}_{letters[match[2]]}{direction}"


def import_errors(errors: Mapping[str, Value]) -> dict[str, Value]:
    """Return errors with the paper's names as errors with ISO names.

    Parameters
    ----------
    errors : mapping of str to any
        Values by the paper's names.

    Returns
    -------
    dict
        The same values by ISO names.

    Raises
    ------
    DataError
        The errors are not a mapping, a name is not the paper's, or two spellings mean the same term.

    Examples
    --------
    >>> import_errors({"dxy": 1e-6, "eta_zx": 2e-6})
    {'EYX': 1e-06, 'B0Z': 2e-06}
    """
    if not isinstance(errors, Mapping):
        raise DataError(
            f"errors are a mapping of the paper's names to values, got {type(errors).__name__}"
        )
    result: dict[str, Value] = {}
    for name, value in errors.items():
        term = from_paper(name)
        if term in result:
            raise DataError(f"{name!r} is {term}, which stands in the errors already")
        result[term] = value
    return result


def axis_of(term: str) -> str | None:
    """Return the axis on whose position an error term depends.

    Parameters
    ----------
    term : str
        ISO 230-1 name.

    Returns
    -------
    str or None
        Axis name; None for a location error, which is a constant.

    Raises
    ------
    DataError
        The name follows neither rule.

    Examples
    --------
    >>> axis_of("EAFTS"), axis_of("B0Z")
    ('FTS', None)
    """
    if not isinstance(term, str):
        raise DataError(f"{term!r} is not an ISO 230-1 name: it is not a text")
    if _ISO_LOCATION.fullmatch(term):
        return None
    match = _ISO_MOTION.fullmatch(term)
    if match is None:
        raise DataError(
            f"{term!r} is not an ISO 230-1 name: E, a direction X Y Z A B C, the axis name"
            + paper_hint(term)
        )
    return match[2]


def located_axis(term: str) -> str | None:
    """Return the axis whose place a location error describes."""
    match = _ISO_LOCATION.fullmatch(term)
    return None if match is None else match[2]


def paper_hint(term: str) -> str:
    """Return what to add to a message about an unknown name: the term that the paper means by it."""
    try:
        meant = from_paper(term)
    except DataError:
        return ""
    return f"; in the paper's swapped subscripts it is {meant}, see import_errors"
