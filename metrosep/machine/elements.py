"""Elements of a kinematic chain: one slide, spindle, table or fixed part each.

The frame of an element sits in the frame of the element before it (or in the bed):

    T = Trans(location) M(q) (I + hat(xi))      error frame "after": the error moves with the body
    T = Trans(location) (I + hat(xi)) M(q)      error frame "before": the error stays where it was

with ``M = Trans(q direction)``, ``Rot(direction, q)`` or, for a fixed part, ``Rot(direction, angle)``
and ``xi = (EX, EY, EZ, EA, EB, EC)`` along and about the element's own X, Y, Z, at the functional
point `measured_at` of that frame. With all axes at zero (and no fixed rotation) every frame is
parallel to the bed. SI: metres and radians.

An instrument reads at the functional point, which the tool side carries. Seen from there, an axis
that carries the workpiece has its errors in the frame before it: its own travel is no lever, and a
rotary table does not turn the directions in which a nest in the spindle reads.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.provenance import freeze_mapping
from metrosep.machine._numbers import is_real

__all__ = [
    "BRANCHES",
    "DIRECTIONS",
    "FRAMES",
    "KINDS",
    "SIDES",
    "Element",
    "element_terms",
    "error_sign",
]

KINDS = ("linear", "rotary", "fixed")
BRANCHES = ("tool", "workpiece")
FRAMES = ("after", "before")
SIDES = ("body", "tool")
DIRECTIONS = "XYZABC"

_LOCATION_NAME = re.compile(r"E?[XYZABC]0[A-Za-z][A-Za-z0-9_]*")
_UNIT_TOLERANCE = 1e-9  # a direction typed with ten digits passes, one with three does not

Triple = tuple[float, float, float]


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
        The axis may be missing in the positions: then it is no joint, its motion and errors are nil.
    parallel_to : str, optional
        Name of the axis that this one repeats on purpose (a fast tool on a slide).

    Raises
    ------
    DataError
        An unknown kind, branch, error frame, side or direction, a name that cannot be part of a term, a
        direction that is no unit vector, a rotation of a part that is not fixed, a location error
        that does nothing (the shift of a slide's line of travel).
    InvalidSamplesError
        A vector with the wrong length or with values that are no finite numbers, an angle that is none.

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

    def __post_init__(self) -> None:
        given: object = self.name
        name = given if isinstance(given, str) else ""
        if not name.isidentifier() or not name.isascii() or name[0] == "_":
            raise DataError(
                f"an axis name is a letter and then letters, digits or _, got {self.name!r}; "
                "it becomes part of the term names (X -> EXX)"
            )
        for key, allowed in (
            ("kind", KINDS),
            ("branch", BRANCHES),
            ("error_frame", FRAMES),
            ("errors_of", SIDES),
        ):
            value = getattr(self, key)
            if value not in (*allowed, None) or (value is None and key != "error_frame"):
                raise DataError(
                    f"{key} of element {self.name!r} is {value!r}; known are {', '.join(allowed)}"
                )
        self._set("direction", _vector(self.direction, 3, f"direction of {self.name!r}"))
        self._set("location", _vector(self.location, 3, f"location of {self.name!r}"))
        point = _vector(self.measured_at, 3, f"measured_at of {self.name!r}")
        self._set("measured_at", point)
        norm = math.hypot(*self.direction)
        if abs(norm - 1.0) > _UNIT_TOLERANCE:
            raise DataError(
                f"direction of element {self.name!r} is {tuple(self.direction)} with length "
                f"{norm:.9g}; it must be a unit vector"
            )
        self._set("direction", tuple(c / norm for c in self.direction))
        if not is_real(self.angle) or not math.isfinite(self.angle):
            raise InvalidSamplesError(
                f"angle of element {self.name!r} is {_short(self.angle)}, not a finite number in rad"
            )
        self._set("angle", float(self.angle))
        if self.kind != "fixed" and self.angle != 0.0:
            raise DataError(
                f"element {self.name!r} is {self.kind} and has a fixed angle of {self.angle} rad; "
                "put the rotation into a fixed element of its own"
            )
        self._check_parking()
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
        if not isinstance(self.parked, bool):
            raise DataError(
                f"parked of element {self.name!r} is true or false, got {self.parked!r}"
            )
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
            raise DataError(f"location error {name!r} of {self.name!r} does nothing: {reason}")


def error_sign(element: Element) -> float:
    """Return what turns an element's errors into motions of its body: -1 or 1.

    Examples
    --------
    >>> error_sign(Element("X", "workpiece", "linear", errors_of="tool"))
    -1.0
    """
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


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 80 else text[:60] + " ..."


def _vector(values: Sequence[float], size: int, name: str) -> tuple[float, ...]:
    try:
        listed = () if isinstance(values, str | Mapping) else tuple(values)
    except TypeError:
        listed = ()
    if not listed or not all(is_real(v) for v in listed):
        raise InvalidSamplesError(f"{name} must be {size} numbers, got {_short(values)}")
    vector = tuple(float(v) for v in listed)
    if len(vector) != size or not all(math.isfinite(v) for v in vector):
        raise InvalidSamplesError(f"{name} must be {size} finite numbers, got {_short(values)}")
    return vector
