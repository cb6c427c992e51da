"""What an instrument reads on a machine with given errors, and where a reading belongs.

A reading is a deviation from nominal. One end of the instrument sits on the tool side, at the tool
point; the other on the workpiece, or on the bed (then only the axes that carry the tool act). With E
the error of the tool point and W the turn of the tool, both against the other end, and u a unit
vector, an instrument reads to first order

    displacement  u . E        indicator, capacitive probe, straightness optics, laser (linear)
    angle         u . W        level, autocollimator, laser (angular)
    ballbar       u . E        u from the ball on the work to the tool
    nest          E            three components: R-test, touch probe on a sphere
    length        u . E        u from the station to the reflector: tracker, tracer

Squareness is two displacements. Sources: ISO 230-1 for where an error is stated; machines.md,
equations 6 to 11 for the readings and 14 to 16 for the change of line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.machine._poses import tool_point
from metrosep.machine.elements import require_travel
from metrosep.machine.error_sets import as_error_set
from metrosep.machine.terms import positions_array

if TYPE_CHECKING:
    from metrosep.machine.chains import Chain, Errors, Positions

_ENDS = ("workpiece", "bed")
_SPACES = ("machine", "workpiece")
_LARGEST = 100.0  # m; a length above it was typed in mm
_UNIT = 1e-6  # a direction typed with six digits is a unit vector


@dataclass(frozen=True, slots=True)
class View:
    """Where the tool stands, seen from the other end: points (..., 3) and the turn of that end."""

    point: FloatArray  # nominal tool point, m, in the coordinates of the other end
    turn: FloatArray  # (..., 3, 3): those coordinates to the machine's


@dataclass(frozen=True, slots=True, kw_only=True)
class Instrument:
    """What all instruments have: which end they stand on, and what of their set-up may be unknown.

    Parameters
    ----------
    end : {"workpiece", "bed"}, optional
        What the end away from the tool is fixed to.
    """

    end: str = "workpiece"

    unknowns: ClassVar[Mapping[str, int]] = {}
    """What of the set-up may be unknown, and how many numbers that is."""
    n_readings: ClassVar[int] = 1
    is_angle: ClassVar[bool] = False

    def _check(self) -> None:
        numbers.choice(self.end, f"end of a {type(self).__name__}", _ENDS)

    def of_errors(self, view: View) -> FloatArray:
        """Return the derivative of the readings by the error, or by the turn for an angle.

        Parameters
        ----------
        view : View
            Where the tool stands, seen from the other end.

        Returns
        -------
        ndarray, shape (..., k, 3)
            By the components in the coordinates of the other end.
        """
        raise NotImplementedError

    @described_by(of_errors, errors=False)
    def deviation(self, view: View, error: FloatArray) -> FloatArray:
        """Return the deviations of the readings for errors of any size.

        Parameters
        ----------
        error : ndarray, shape (..., 3), m or rad
            Error of the tool point, or turn.

        Returns
        -------
        ndarray, shape (..., k), m or rad
            Readings minus nominal.
        """
        return np.asarray(np.einsum("...ki,...i->...k", self.of_errors(view), error))

    @described_by(of_errors, errors=False)
    def nominal(self, view: View) -> FloatArray:
        """Return what the instrument reads on a machine without errors.

        Returns
        -------
        ndarray, shape (..., k), m or rad
            Nominal readings.
        """
        return np.zeros((*view.point.shape[:-1], self.n_readings))

    @described_by(of_errors, errors=False)
    def of_unknown(self, name: str, view: View) -> FloatArray:
        """Return the derivative of the readings by an unknown of the set-up.

        Parameters
        ----------
        name : str
            Of `unknowns`.

        Returns
        -------
        ndarray, shape (..., k, m)
            By its m numbers.
        """
        raise NotImplementedError

    def moved(self, name: str, by: FloatArray) -> Instrument:
        """Return the instrument with an unknown of its set-up changed.

        Parameters
        ----------
        name : str
            Of `unknowns`.
        by : ndarray, shape (m,)
            Change.

        Returns
        -------
        Instrument
            A new one; the same where the unknown is not a part of where it stands.
        """
        return self


def _ones(view: View, k: int) -> FloatArray:
    return np.broadcast_to(np.eye(k), (*view.point.shape[:-1], k, k))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Directed(Instrument):
    direction: Sequence[float]
    frame: str = "machine"

    unknowns: ClassVar[Mapping[str, int]] = {"offset": 1, "slope": 1}

    def __post_init__(self) -> None:
        self._check()
        numbers.choice(self.frame, f"frame of a {type(self).__name__}", _SPACES)
        along = _three(self.direction, f"direction of a {type(self).__name__}")
        size = float(np.linalg.norm(along))
        if abs(size - 1.0) > _UNIT:
            raise DataError(
                f"direction of a {type(self).__name__} is {tuple(along.tolist())} with length "
                f"{size:.6g}; it must be a unit vector"
            )
        object.__setattr__(self, "direction", tuple((along / size).tolist()))

    def of_errors(self, view: View) -> FloatArray:
        u = np.asarray(self.direction)
        if self.frame == "machine":
            u = np.einsum("j,...ji->...i", u, view.turn)
        return np.broadcast_to(u, view.point.shape)[..., None, :]

    def of_unknown(self, name: str, view: View) -> FloatArray:
        if name == "offset":
            return _ones(view, 1)
        along = view.point - view.point.reshape(-1, 3)[0]
        return np.asarray(np.linalg.norm(along, axis=-1)[..., None, None])


@dataclass(frozen=True, slots=True, kw_only=True)
class Displacement(_Directed):
    """Indicator, capacitive probe, straightness optics or linear laser: reads ``u . E``.

    Parameters
    ----------
    direction : sequence of float, shape (3,)
        Unit vector u: the motion of the tool against the other end that raises the reading.
    point : sequence of float, shape (3,), m, optional
        Tool-side point that is sensed, in the frame of the tool; the tool point of the reading if
        omitted.
    frame : {"machine", "workpiece"}, optional
        Coordinates of `direction`.
    end : {"workpiece", "bed"}, optional
        What the other end is fixed to.

    Raises
    ------
    DataError
        The direction is not a unit vector, or a choice is unknown.
    InvalidSamplesError
        A vector is not three finite numbers.

    Notes
    -----
    Unknown may be ``offset`` (1), ``slope`` (1, along the places), ``beam`` (2: the direction itself, by
    its two small turns; a diagonal of a laser) and ``form`` (the profile of the artefact that is read,
    see `ReadingSet`). A diagonal (ISO 230-6) is a displacement along it with the axes moving together.

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> mill = presets("mill_xyz")
    >>> bow = {"EZX": lambda x: 1e-6 * x}
    >>> mill.read(Displacement(direction=(0, 0, 1)), {"X": 0.5, "Y": 0.2, "Z": 0.0}, bow).item()
    5e-07
    """

    point: Sequence[float] | None = None

    unknowns: ClassVar[Mapping[str, int]] = {"offset": 1, "slope": 1, "beam": 2, "form": 0}

    def of_unknown(self, name: str, view: View) -> FloatArray:
        if name != "beam":
            return _Directed.of_unknown(self, name, view)
        # a direction turned a little reads the travel across it: e . (p - p0) for both e across u
        u = self.of_errors(view)
        across = _across(u[..., 0, :])
        along = view.point - view.point.reshape(-1, 3)[0]
        return np.asarray(np.einsum("...ki,...i->...k", across, along))[..., None, :]

    def __post_init__(self) -> None:
        _Directed.__post_init__(self)
        if self.point is not None:
            at = _three(self.point, "point of a Displacement")
            object.__setattr__(self, "point", tuple(at.tolist()))

    def nominal(self, view: View) -> FloatArray:
        return np.asarray(np.einsum("...ki,...i->...k", self.of_errors(view), view.point))


def _across(u: FloatArray) -> FloatArray:
    """Return two unit vectors across each unit vector, shape (..., 2, 3)."""
    least = np.eye(3)[np.argmin(np.abs(u.reshape(-1, 3)[0]))]
    one = np.cross(u, least)
    one = one / np.linalg.norm(one, axis=-1, keepdims=True)
    return np.stack([one, np.cross(u, one)], axis=-2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Angle(_Directed):
    """Level, autocollimator or angular laser: reads ``u . W``.

    Parameters
    ----------
    direction : sequence of float, shape (3,)
        Unit vector u: the turn of the tool against the other end about u raises the reading.
    frame : {"machine", "workpiece"}, optional
        Coordinates of `direction`.
    end : {"workpiece", "bed"}, optional
        What the other end is fixed to. A level on one body sees gravity: a level on the tool alone
        is ``end="bed"``, the difference of two levels ``end="workpiece"``.

    Raises
    ------
    DataError
        The direction is not a unit vector, or a choice is unknown.

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> mill = presets("mill_xyz")
    >>> level = Angle(direction=(0, 1, 0))
    >>> mill.read(level, {"X": 0.5, "Y": 0.2, "Z": 0.0}, {"EBX": 2e-6, "C0Y": 5e-6}).item()
    2e-06
    """

    is_angle: ClassVar[bool] = True


@dataclass(frozen=True, slots=True, kw_only=True)
class _Radial(Instrument):
    """Reads the distance between the tool point and a point of the other end."""

    def _place(self) -> FloatArray:
        raise NotImplementedError

    def _away(self, view: View) -> tuple[FloatArray, FloatArray]:
        """Return vectors from the place to the tool point, and their lengths."""
        away = view.point - self._place()
        length = np.linalg.norm(away, axis=-1)
        if np.any(length == 0.0):
            raise DataError(
                f"the tool point of a {type(self).__name__} stands on its other end: the direction "
                "of the reading is not defined there"
            )
        return away, length

    def of_errors(self, view: View) -> FloatArray:
        away, length = self._away(view)
        return np.asarray((away / length[..., None])[..., None, :])

    def deviation(self, view: View, error: FloatArray) -> FloatArray:
        away, length = self._away(view)
        # |a + e| - |a| without the difference of two large numbers
        along = np.sum((2.0 * away + error) * error, axis=-1)
        return np.asarray((along / (np.linalg.norm(away + error, axis=-1) + length))[..., None])

    def of_unknown(self, name: str, view: View) -> FloatArray:
        return -self.of_errors(view) if self.unknowns[name] == 3 else _ones(view, 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ballbar(_Radial):
    """Ballbar between a ball on the workpiece and one in the tool: reads its change of length.

    Parameters
    ----------
    ball : sequence of float, shape (3,), m
        Centre of the ball on the workpiece, in its coordinates.
    end : {"workpiece", "bed"}, optional
        What the ball is fixed to.

    Raises
    ------
    InvalidSamplesError
        The ball is not three finite numbers.
    UnitError
        A coordinate is above 100 m: it was given in mm.

    Notes
    -----
    Unknown may be ``ball`` (3) and ``length`` (1). ISO 230-4 tests are evaluated by
    `metrosep.machine.circle_test`.

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> mill = presets("mill_xyz")
    >>> bar = Ballbar(ball=(0.1, 0.1, 0.0))
    >>> mill.read(bar, {"X": 0.2, "Y": 0.1, "Z": 0.0}, {"EXX": lambda x: 1e-5 * x}).round(12).item()
    2e-06
    """

    ball: Sequence[float]

    unknowns: ClassVar[Mapping[str, int]] = {"ball": 3, "length": 1}

    def __post_init__(self) -> None:
        self._check()
        object.__setattr__(self, "ball", _place(self.ball, "ball of a Ballbar"))

    def _place(self) -> FloatArray:
        return np.asarray(self.ball)

    def nominal(self, view: View) -> FloatArray:
        return self._away(view)[1][..., None]

    def moved(self, name: str, by: FloatArray) -> Instrument:
        if name == "length":
            return self
        return Ballbar(ball=tuple((self._place() + by).tolist()), end=self.end)


@dataclass(frozen=True, slots=True, kw_only=True)
class Length(_Radial):
    """Length from a station to a reflector at the tool: tracker, tracing interferometer.

    Parameters
    ----------
    station : sequence of float, shape (3,), m
        Where the beam turns, in coordinates of the other end (workpiece or machine).
    dead_path : float, m, optional
        What is added to the length.
    end : {"workpiece", "bed"}, optional
        What the station stands on.

    Raises
    ------
    InvalidSamplesError
        The station is not three finite numbers.
    UnitError
        A coordinate is above 100 m: it was given in mm.

    Notes
    -----
    Unknown may be ``station`` (3) and ``dead_path`` (1).

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> mill = presets("mill_xyz")
    >>> tracer = Length(station=(-1.0, 0.0, 0.0))
    >>> mill.read(tracer, {"X": 0.2, "Y": 0.0, "Z": 0.0}, {"EXX": 1e-6}, total=True).round(9).item()
    1.200001
    """

    station: Sequence[float]
    dead_path: float = 0.0

    unknowns: ClassVar[Mapping[str, int]] = {"station": 3, "dead_path": 1}

    def __post_init__(self) -> None:
        self._check()
        object.__setattr__(self, "station", _place(self.station, "station of a Length"))
        path = numbers.quantity(self.dead_path, "dead_path of a Length", "length")
        object.__setattr__(self, "dead_path", path)

    def _place(self) -> FloatArray:
        return np.asarray(self.station)

    def nominal(self, view: View) -> FloatArray:
        return self._away(view)[1][..., None] + self.dead_path

    def moved(self, name: str, by: FloatArray) -> Instrument:
        place, path = self._place(), self.dead_path
        if name == "station":
            place = place + by
        else:
            path += float(by[0])
        return Length(station=tuple(place.tolist()), dead_path=path, end=self.end)


@dataclass(frozen=True, slots=True, kw_only=True)
class Nest(Instrument):
    """Sensor nest (R-test) or touch probe on a sphere: reads three components of E at the ball.

    Parameters
    ----------
    ball : sequence of float, shape (3,), m, optional
        Centre of the ball on the workpiece, in its coordinates; if omitted the ball is where the
        tool point nominally stands.
    senses : {"tool", "workpiece"}, optional
        Whose motion raises the readings: that of the tool, or that of the workpiece (then the
        readings are negative).
    frame : {"machine", "workpiece"}, optional
        Directions of the three readings.
    end : {"workpiece", "bed"}, optional
        What the ball is fixed to.

    Raises
    ------
    DataError
        A choice is unknown.
    InvalidSamplesError
        The ball is not three finite numbers.

    Notes
    -----
    Unknown may be ``ball`` (3, on the workpiece) and ``nest`` (3, the zero of the readings).

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> machine = presets("five_axis", pivot_height=0.08)
    >>> at = {"X": 0.0, "Y": 0.0, "Z": 0.1, "A": 0.0, "C": 0.0}
    >>> machine.read(Nest(), at, {"EXC": 1e-6, "EZC": 3e-6}).tolist()
    [1e-06, 0.0, 3e-06]
    """

    ball: Sequence[float] | None = None
    senses: str = "tool"
    frame: str = "machine"

    unknowns: ClassVar[Mapping[str, int]] = {"ball": 3, "nest": 3}
    n_readings: ClassVar[int] = 3

    def __post_init__(self) -> None:
        self._check()
        numbers.choice(self.senses, "senses of a Nest", ("tool", "workpiece"))
        numbers.choice(self.frame, "frame of a Nest", _SPACES)
        if self.ball is not None:
            object.__setattr__(self, "ball", _place(self.ball, "ball of a Nest"))

    def of_errors(self, view: View) -> FloatArray:
        sign = 1.0 if self.senses == "tool" else -1.0
        return sign * (view.turn if self.frame == "machine" else _ones(view, 3))

    def nominal(self, view: View) -> FloatArray:
        off = (
            np.zeros_like(view.point) if self.ball is None else view.point - np.asarray(self.ball)
        )
        return np.asarray(np.einsum("...ki,...i->...k", self.of_errors(view), off))

    def of_unknown(self, name: str, view: View) -> FloatArray:
        return -self.of_errors(view) if name == "ball" else _ones(view, 3)

    def moved(self, name: str, by: FloatArray) -> Instrument:
        if name != "ball" or self.ball is None:
            return self
        ball = tuple((np.asarray(self.ball) + by).tolist())
        return Nest(ball=ball, senses=self.senses, frame=self.frame, end=self.end)


# ---- the chain as an instrument sees it -------------------------------------------------------------


def seen(
    chain: Chain, instrument: Instrument, q: Positions, tool: ArrayLike
) -> tuple[Chain, dict[str, ArrayLike], FloatArray, View]:
    """Return the part of the chain that acts, its positions, the sensed point and the view."""
    if not isinstance(instrument, Instrument):
        raise DataError(
            f"an instrument is needed, got {instrument!r}; see metrosep.machine.Nest ..."
        )
    require_travel(chain.elements, q)
    part = chain.from_bed() if instrument.end == "bed" else chain
    at = {a: v for a, v in q.items() if a in part.axes or a not in chain.axes}
    point = getattr(instrument, "point", None)
    lever = tool_point(tool if point is None else point)
    pose = part.transform(at, tool=lever)
    turn = np.broadcast_to(part.workpiece_turn(at), (*pose.shape[:-2], 3, 3))
    return part, at, lever, View(pose[..., :3, 3], turn)


def read(
    chain: Chain,
    instrument: Instrument,
    q: Positions,
    errors: Errors,
    *,
    tool: ArrayLike = (0.0, 0.0, 0.0),
    exact: bool = False,
    total: bool = False,
) -> FloatArray:
    """Return what an instrument reads; the method `Chain.read` is its public face."""
    part, at, lever, view = seen(chain, instrument, q, tool)
    given = as_error_set(errors)
    chain.known_terms(given.names)
    acting = {n: t for n, t in given.terms.items() if n in part.terms}
    if not instrument.is_angle:
        moved = part.volumetric_error(at, acting, tool=lever, exact=exact)
    elif exact:
        ends = [part.transform(at, e, exact=True)[..., :3, :3] for e in (acting, None)]
        turned = ends[0] @ np.swapaxes(ends[1], -1, -2)
        moved = _vector_of(turned)
    else:
        values = part.error_values(at, acting)
        moved = part.turn_jacobian(at, terms=tuple(acting)) @ values[..., None]
        moved = np.asarray(moved[..., 0])
    deviation = instrument.deviation if exact else _first_order(instrument)
    found = deviation(view, moved)
    if total:
        found = found + instrument.nominal(view)
    return np.asarray(found[..., 0] if instrument.n_readings == 1 else found)


def _first_order(instrument: Instrument) -> Any:
    def linear(view: View, error: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("...ki,...i->...k", instrument.of_errors(view), error))

    return linear


def _vector_of(turn: FloatArray) -> FloatArray:
    """Return the rotation vector of small rotations, (..., 3); right to the third order."""
    skew = 0.5 * (turn - np.swapaxes(turn, -1, -2))
    return np.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)


def _three(values: Any, name: str) -> FloatArray:
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.shape != (3,) or not np.isfinite(found).all():
        raise InvalidSamplesError(f"{name} must be three finite numbers, got {values!r}")
    return found


def _place(values: Any, name: str) -> tuple[float, ...]:
    found = _three(values, name)
    if float(np.abs(found).max()) > _LARGEST:
        raise UnitError(f"{name} is {tuple(found.tolist())} m: lengths are in m, 70 mm are 0.07")
    return tuple(found.tolist())


# ---- from the line where it was measured to the functional point (Abbe, Bryan) ---------------------


@dataclass(frozen=True, slots=True, eq=False)
class FunctionalCurves(Mapping[str, FloatArray]):
    """Error motions of an axis at the functional point.

    Parameters
    ----------
    curves : mapping of str to ndarray, shape (n,), m
        By name (EXX, EYX, EZX of the axis X).
    u : mapping of str to ndarray, shape (n,), m
        Standard uncertainty; zero where nothing was given.
    u_of_lever : mapping of str to float, m
        Largest share of the angles' uncertainty in it.
    messages : tuple of str
        What was referred to home, and which share is the largest.
    """

    curves: Mapping[str, FloatArray]
    u: Mapping[str, FloatArray] = field(default_factory=dict)
    u_of_lever: Mapping[str, float] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> FloatArray:
        return self.curves[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.curves)

    def __len__(self) -> int:
        return len(self.curves)


def at_functional_point(
    axis: str,
    positions: ArrayLike,
    raw: Mapping[str, ArrayLike],
    angles: Mapping[str, ArrayLike] | None = None,
    *,
    point: Sequence[float],
    fixed_to: str,
    home: float = 0.0,
    u: Mapping[str, float] | None = None,
) -> FunctionalCurves:
    """Return positioning and straightness as an instrument at the functional point would read them.

    Parameters
    ----------
    axis : {"X", "Y", "Z"}
        The axis that moved.
    positions : array_like, shape (n,), m
        Its positions.
    raw : mapping of str to array_like, shape (n,), m
        What was read: ``E`` + direction + axis, such as ``{"EYX": ...}``.
    angles : mapping of str to array_like, shape (n,), rad, optional
        ``EAX``, ``EBX``, ``ECX`` at the same positions, as far as the lever needs them.
    point : sequence of float, shape (3,), m
        Where it was sensed, from the functional point, with the axis at 0.
    fixed_to : {"tool", "workpiece"}
        What the sensed point travels with: a point on the tool side keeps its lever; optics on
        a table that the axis moves come nearer by the travel.
    home : float, m, optional
        Position at which errors are zero by definition.
    u : mapping of str to float, m or rad, optional
        Standard uncertainties of raw curves and angles.

    Returns
    -------
    FunctionalCurves
        A mapping of the same names.

    Raises
    ------
    DataError
        The axis, a name or `fixed_to` is unknown, or an angle that has a lever is missing; the
        message names it.
    InvalidSamplesError
        Curves and positions are not of one length.
    UnitError
        The point is above 100 m.

    Notes
    -----
    ``d_func = d_raw - w x (m - P)`` [1]_: written out, with the lever (rx, ry, rz), EXX_raw = EXX +
    EB rz - EC ry, EYX_raw = EYX + EC rx - EA rz, EZX_raw = EZX + EA ry - EB rx; the first is
    Abbe's, the others are Bryan's. Angles are taken relative to their value at `home`. NaN in a
    curve gives NaN there.

    References
    ----------
    .. [1] machines.md, eq. 14 to 16; E. Abbe (1890); J. B. Bryan, Precision Engineering 1 (1979) 129.

    Examples
    --------
    >>> curves = at_functional_point("X", [0.0, 0.1], {"EYX": [0.0, 1e-6]}, {"EAX": [0.0, 5e-6]},
    ...                              point=(0.0, 0.0, 0.2), fixed_to="tool")
    >>> curves["EYX"].round(12).tolist()
    [0.0, 2e-06]
    """
    numbers.choice(axis, "axis", ("X", "Y", "Z"))
    numbers.choice(
        fixed_to, "fixed_to (what the sensed point travels with)", ("tool", "workpiece")
    )
    k = "XYZ".index(axis)
    x = positions_array(positions, f"positions of {axis}")
    if x.ndim != 1:
        raise InvalidSamplesError(f"positions of {axis} are one list, got shape {x.shape}")
    lever = np.tile(np.asarray(_place(point, "point")), (x.size, 1))
    if fixed_to == "workpiece":
        lever[:, k] -= x
    given = _columns_of(raw, [f"E{d}{axis}" for d in "XYZ"], x.size, "raw curves")
    known = _columns_of(angles or {}, [f"E{d}{axis}" for d in "ABC"], x.size, "angles")
    us = {n: numbers.not_negative(v, f"u of {n}") for n, v in (u or {}).items()}
    said = []
    turns = np.zeros((x.size, 3))
    for i, letter in enumerate("ABC"):
        name = f"E{letter}{axis}"
        if name in known:
            order = np.argsort(x)
            if not x[order[0]] <= home <= x[order[-1]]:
                raise DataError(
                    f"home, {axis} = {format_length(home)}, lies outside the positions; give home= "
                    "within them: angles are zero there"
                )
            zero = float(np.interp(home, x[order], known[name][order]))
            turns[:, i] = known[name] - zero
            if zero != 0.0:
                said.append(f"{name} is {zero * 1e6:.4g} urad at home and was set to zero there")
    curves, spread, of_lever = {}, {}, {}
    for name, values in given.items():
        i = "XYZ".index(name[1])
        one, two = (i + 1) % 3, (i + 2) % 3  # (w x r)_i = w_one r_two - w_two r_one
        for turning, arm in ((one, two), (two, one)):
            missing = f"E{'ABC'[turning]}{axis}"
            if missing not in known and np.any(lever[:, arm] != 0.0):
                raise DataError(
                    f"{name} was read {format_length(float(np.abs(lever[:, arm]).max()))} away in "
                    f"{'XYZ'[arm]}: {missing} is needed to move it to the functional point; measure "
                    f"it, or read {name} there"
                )
        curves[name] = values - (turns[:, one] * lever[:, two] - turns[:, two] * lever[:, one])
        parts = [
            us.get(f"E{'ABC'[t]}{axis}", 0.0) * lever[:, a] for t, a in ((one, two), (two, one))
        ]
        share = np.hypot(*parts)
        spread[name] = np.hypot(us.get(name, 0.0), share)
        of_lever[name] = float(share.max(initial=0.0))
        if of_lever[name] > 0.0:
            said.append(
                f"{name}: the angles bring u = {format_length(of_lever[name], digits=2)} by their "
                f"lever, of {format_length(float(spread[name].max()), digits=2)} in all"
            )
    return FunctionalCurves(
        freeze_mapping(curves), freeze_mapping(spread), freeze_mapping(of_lever), tuple(said)
    )


def _columns_of(
    given: Mapping[str, ArrayLike], known: list[str], n: int, what: str
) -> dict[str, FloatArray]:
    """Return curves by name, all of one length."""
    found = {}
    for name, values in given.items():
        if name not in known:
            raise DataError(f"{what} hold {name!r}; known are {', '.join(known)}")
        found[name] = positions_array(values, name)
        if found[name].shape != (n,):
            raise InvalidSamplesError(f"{name} has shape {found[name].shape} for {n} positions")
    return found
