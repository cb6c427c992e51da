"""Steps of recipes about features measured as points: roundness, cylindricity, run-out, orientation.

A file is the list of a coordinate measuring machine (x, y, z), or traces of a roundness instrument:
angle, radius and height of each reading. Traces may be one file each, `heights` then says where they
lie. Columns, or the files themselves, say which element (A, B ...) and which section a point belongs
to. Angles count from +x towards +y, heights along z; nothing is levelled, centred or filtered.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    MetrosepError,
    TooFewSamplesError,
)
from metrosep.core.methods import Method, RoleColumns
from metrosep.core.options import option
from metrosep.core.units import format_length
from metrosep.recipe.describe.charts import curve, curve_chart, panel
from metrosep.recipe.describe.description import Description

if TYPE_CHECKING:
    from metrosep.parameters.form_result import FormDeviation
    from metrosep.parameters.geometry import DatumAxis, GeometricDeviation

_DRAWS = 100
"""Of the Monte Carlo for u: its standard deviation is known to 7 %."""
_SEED = 1101
_CARTESIAN, _POLAR = ("x", "y", "z"), ("angle", "radius", "height")
_DEVIATION = 0.1
"""Of the nominal radius: readings whose mean is larger are radii, not deviations from it."""
_THIN, _FLAT = 1e-3, 0.2
"""Of a face: least width over its length, most height over its width."""
_FEWEST = 4
"""Readings of a section: three always lie on a circle."""
_PANELS = 12
_GAP = np.radians(60.0)
"""Of a section without a point: said, as the form there is not seen."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Measured points in one frame, with the names of their elements and sections."""

    xyz: FloatArray  # shape (n, 3), m
    element: NDArray[np.str_]
    section: NDArray[np.str_]  # empty where it is not known
    notes: tuple[str, ...] = ()

    def __getitem__(self, chosen: Any) -> Points:
        return replace(
            self,
            xyz=self.xyz[chosen],
            element=self.element[chosen],
            section=self.section[chosen],
        )

    @property
    def has_sections(self) -> bool:
        """Whether each point knows its section."""
        return bool((self.section != "").all())


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredGeometry:
    """What a step found: deviations, the points of the feature, and how far each of them is off."""

    found: tuple[GeometricDeviation, ...]
    u: tuple[float | None, ...]
    points: Points
    off: FloatArray  # shape (n,), m: of each point, as `about` says
    angle: FloatArray | None  # shape (n,), rad: about the axis, of round features
    about: str
    audit: Mapping[str, Any]
    messages: tuple[str, ...]
    titles: Mapping[str, str] = field(default_factory=dict)  # of sections: what was found of each
    is_trace: bool = False  # points are angle (rad), radius and height, not x, y and z


@dataclass(frozen=True, kw_only=True)
class _Judged(Method):
    """What all of them do with what they read."""

    verb: ClassVar = "geometry"
    reads: ClassVar = "tables"
    noisy: ClassVar[tuple[int, ...]] = (0, 1, 2)  # columns of the points that are readings

    u_reading: float | None = option(
        None, kind="uncertainty", help="standard uncertainty of each reading, independent of the others, for u by Monte Carlo"
    )  # fmt: skip

    @classmethod
    def from_inputs(cls, data: tuple[RoleColumns, ...], options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        return cls(**options).evaluated(data)

    def evaluated(self, data: tuple[RoleColumns, ...]) -> MeasuredGeometry:
        """Return the deviations of what was read."""
        points = self._read(data)
        parts = self._parts(points)
        found = self._found(*parts)
        u, messages = self._spread(found, parts)
        off, angle, about = self._off(*parts)
        audit = {
            "points": len(parts[0].xyz),
            "element": _names(parts[0].element),
            "sections": len(np.unique(parts[0].section)) if parts[0].has_sections else 0,
            **{f"points of datum {_names(p.element)}": len(p.xyz) for p in parts[1:]},
        }
        notes = (*points.notes, *messages, *_open_sections(parts[0], angle))
        return MeasuredGeometry(found, u, parts[0], off, angle, about, audit, notes)

    def _found(self, feature: Points, *datum: Points) -> tuple[GeometricDeviation, ...]:
        raise NotImplementedError

    def _off(self, feature: Points, *datum: Points) -> tuple[FloatArray, FloatArray | None, str]:
        """Return how far each point is off, its angle, and what that is."""
        raise NotImplementedError

    def _read(self, data: tuple[RoleColumns, ...]) -> Points:
        raise NotImplementedError

    def _parts(self, points: Points) -> tuple[Points, ...]:
        """Return the points of the feature; of the datum after them, where there is one."""
        return (points,)

    def _spread(
        self, found: Sequence[GeometricDeviation], parts: tuple[Points, ...]
    ) -> tuple[tuple[float | None, ...], tuple[str, ...]]:
        """Return u of each value from draws of the readings, and how much noise lifts the values."""
        if not self.u_reading:
            why = (
                "the uncertainty of the values is not known: state u_reading= for what independent noise of "
                "the readings does, or U of a check"
            )
            return (None,) * len(found), (why,)
        rng, size, drawn = np.random.default_rng(_SEED), self.u_reading, []
        read = np.isin(np.arange(3), self.noisy)
        for _ in range(_DRAWS):
            noisy = (
                replace(p, xyz=p.xyz + rng.normal(0.0, size, p.xyz.shape) * read) for p in parts
            )
            drawn.append([d.value for d in self._found(*noisy)])
        values = np.array(drawn)
        lift = values.mean(axis=0) - [d.value for d in found]
        words = ", ".join(
            f"{d.symbol} by {format_length(float(v), digits=2)}"
            for d, v in zip(found, lift, strict=True)
        )
        about = (
            f"the standard uncertainty is that of {_DRAWS} draws of independent noise of "
            f"{format_length(size)} of each reading; such noise also lifts the values, {words}; scale, "
            "spindle and datum of the instrument are not in it"
        )
        return tuple(float(s) for s in values.std(axis=0, ddof=1)), (about,)


@dataclass(frozen=True, kw_only=True)
class _OfPoints(_Judged):
    """Of points with three coordinates."""

    roles: ClassVar[Mapping[str, str]] = {
        "x": "length?", "y": "length?", "z": "length?",
        "angle": "angle?", "radius": "length?", "height": "length?",
        "section": "label?", "element": "label?",
    }  # fmt: skip

    feature: str | None = option(
        None, kind="text", help="element that is judged, where the points are of several"
    )
    elements: tuple[str, ...] | None = option(
        None,
        kind="texts",
        help="element of each file; without it and without the column element a file is one where there is a datum",
    )
    heights: tuple[float, ...] | None = option(
        None, kind="lengths", help="height of the trace in each file, where no column says it"
    )
    nominal_radius: float | None = option(
        None, kind="size", help="added to the radii of traces that are deviations from a circle"
    )
    section_gap: float | None = option(
        None,
        kind="size",
        help="points that lie farther apart along the axis are of other sections; without the column section",
    )
    direction: str = option(
        "z",
        kind="text",
        help='roughly along the axis of the feature: x, y, z, or a vector "0.1 0 1"',
    )

    def _parts(self, points: Points) -> tuple[Points, ...]:
        return (_chosen(points, self.feature, "feature"),)

    # ---- reading ------------------------------------------------------------------------------

    def _read(self, data: tuple[RoleColumns, ...]) -> Points:
        for name, given in (("heights", self.heights), ("elements", self.elements)):
            if given is not None and len(given) != len(data):
                raise DataError(
                    f"{name}= lists {len(given)} values for {len(data)} file(s); give one for each file"
                )
        return _joined([self._of_file(k, file, len(data)) for k, file in enumerate(data)])

    def _of_file(self, k: int, file: RoleColumns, n_files: int) -> Points:
        values = file.values
        named = [r for r in (*_CARTESIAN, *_POLAR) if r in values]
        is_polar = any(r in _POLAR for r in named)
        wanted = _POLAR if is_polar else _CARTESIAN
        missing = [r for r in wanted if r not in values]
        if is_polar and self.heights is not None:
            if "height" in values:
                raise DataError("the column height says where the traces lie: leave heights= out")
            missing = [r for r in missing if r != "height"]
        if missing or any(r not in wanted for r in named):
            raise DataError(
                f"{file.name}: a point has the columns x, y and z, or angle, radius and height (of a trace; "
                f"heights= instead where each file is one); named are {', '.join(named) or 'none'}"
            )
        if self.heights is not None and not is_polar:
            raise DataError("heights= is of traces; points with x, y and z have their height")
        n = values[named[0]].size
        section = values.get("section", np.full(n, ""))
        if is_polar:
            height = np.full(n, self.heights[k]) if self.heights else values["height"]
            if "section" not in values and self.section_gap is None:
                section = np.array([_height_name(h) for h in height])
            radius = self._radii(values["radius"], file.name)
            angle = values["angle"]
            xyz = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
        else:
            xyz = np.stack([values[r] for r in _CARTESIAN], axis=1)
        if "element" in values:
            element = values["element"]
        elif self.elements is not None:
            element = np.full(n, self.elements[k])
        else:
            element = np.full(n, file.name if n_files > 1 and self.heights is None else "")
        for each in np.unique(element[section != ""]):  # a face beside a bore needs no sections
            if (section[element == each] == "").any():
                of = f" of element {each}" if each else ""
                raise DataError(
                    f"{file.name}: a point{of} has no entry in the column section; fill it"
                )
        return Points(np.asarray(xyz, dtype=np.float64), element.astype(str), section.astype(str))

    def _radii(self, readings: FloatArray, name: str) -> FloatArray:
        known = readings[~np.isnan(readings)]
        if self.nominal_radius is None:
            if (known <= 0.0).any():
                raise DataError(
                    f"{name}: some radii are not above zero, so they are deviations from a circle: state its "
                    "nominal_radius=..."
                )
            return readings
        if known.size and abs(float(known.mean())) > _DEVIATION * self.nominal_radius:
            raise DataError(
                f"{name}: the readings are {format_length(float(known.mean()))} in the mean, so they are "
                "radii and not deviations from one: leave nominal_radius= out, or correct the unit"
            )
        return np.asarray(self.nominal_radius + readings)

    def _sections(self, points: Points, along: FloatArray) -> NDArray[np.str_] | None:
        """Return the section of each point; None where nothing says it."""
        if self.section_gap is not None:
            number = _apart(points.xyz @ along, self.section_gap)
            return np.array([f"{k + 1}" for k in number])
        return points.section if points.has_sections else None

    def _centres(self, points: Points, along: FloatArray, why: str) -> FloatArray:
        """Return the centres of the sections of a round element."""
        from metrosep.parameters.geometry import section_centres

        return section_centres(points.xyz, self._labels(points, along, why), along)

    def _labels(self, points: Points, along: FloatArray, why: str) -> NDArray[np.str_]:
        labels = self._sections(points, along)
        if labels is None:
            raise DataError(
                f"{why} needs to know the section of each point: name the column section, give traces with "
                "heights, or state section_gap=..."
            )
        return labels


@dataclass(frozen=True, kw_only=True)
class Roundness(_Judged):
    """`metrosep.parameters.deviation.roundness_deviation` of one or more traces by its name."""

    name: ClassVar[str] = "roundness"
    what: ClassVar[str] = (
        "roundness RONt of one or more traces: angle and radius, or deviation from a circle"
    )
    roles: ClassVar[Mapping[str, str]] = {
        "angle": "angle", "radius": "length", "height": "length?", "section": "label?",
    }  # fmt: skip
    noisy: ClassVar[tuple[int, ...]] = (1,)

    reference: str = option(
        "MZ", kind="text", choices=("MZ", "LS", "MC", "MI"), help="minimum zone, least squares, smallest circumscribed or largest inscribed circle"
    )  # fmt: skip
    nominal_radius: float | None = option(
        None, kind="size", help="radius from which deviations are counted: says how far a limacon is from a circle; needed where exact"
    )  # fmt: skip
    section_gap: float | None = option(
        None, kind="size", help="readings whose heights lie farther apart are of other sections; without the column section"
    )  # fmt: skip
    exact: bool = option(
        default=False,
        kind="flag",
        help="true circles in place of limacons R + a cos + b sin, for large eccentricities",
    )
    upr: float | None = option(
        None, kind="number", help="Gaussian filter: half of the amplitude of so many undulations per revolution is kept, more of slower ones: 15, 50, 150 (ISO 12181-2); readings at equal angles"
    )  # fmt: skip
    upr_low: float | None = option(
        None, kind="number", help="the same for slower ones: with upr the band upr_low to upr"
    )

    def evaluated(self, data: tuple[RoleColumns, ...]) -> MeasuredGeometry:
        """Return the roundness of the worst section, with the circle of each."""
        made = super().evaluated(data)
        titles, notes = {}, list(made.messages)
        for label, _, one in self._circles(made.points):
            a, b = (one.reference_parameters[k].value for k in "ab")
            shift = format_length(float(np.hypot(a, b)))
            titles[label] = (
                f"{f'{label}: ' if label else ''}RONt {format_length(one.value)}, centre {shift} off at "
                f"{np.degrees(np.arctan2(b, a)) % 360.0:.4g} deg"
            )
            n_said = 1 if self.upr is None and self.upr_low is None else 2  # the filter, the model
            notes += [f"section {label}: {n}" if label else n for n in one.notes[:n_said]]
        messages = tuple(dict.fromkeys(notes))
        return replace(made, titles=titles, messages=messages, is_trace=True)

    def _read(self, data: tuple[RoleColumns, ...]) -> Points:
        names = [file.name for file in data]
        for k, name in enumerate(names):  # of other folders
            if (n := [file.name for file in data[:k]].count(name)) > 0:
                names[k] = f"{name} ({n + 1})"
        return _joined([self._of_file(*each, len(data)) for each in zip(data, names, strict=True)])

    def _of_file(self, file: RoleColumns, name: str, n_files: int) -> Points:
        """Return the readings of a file; the same height or section in another file is another section."""
        angle, radius = file.values["angle"], file.values["radius"]
        height = file.values.get("height", np.zeros(angle.size))
        section = file.values.get("section")
        if section is None and "height" in file.values:
            section = self._by_height(height, file.name)
        if section is None:
            section = np.full(angle.size, name if n_files > 1 else "")
        elif n_files > 1:
            section = np.array([f"{name}, {each}" for each in section])
        xyz = np.stack([angle, radius, height], axis=1)
        return Points(xyz, np.full(angle.size, ""), section.astype(str))

    def _by_height(self, height: FloatArray, name: str) -> NDArray[np.str_]:
        if self.section_gap is None:
            number = np.unique(height, return_inverse=True)[1]
            if number.size and np.bincount(number).min() < _FEWEST:
                raise DataError(
                    f"{name}: {number.max() + 1} different heights of {height.size} readings, of which some have fewer "
                    f"than {_FEWEST} readings: state section_gap=..., the height between two sections, or leave the "
                    "column height out if all are of one"
                )
        else:
            number = _apart(height, self.section_gap)
        means = [float(height[number == k].mean()) for k in range(number.max(initial=-1) + 1)]
        return np.array([_height_name(means[k]) for k in number], dtype=np.str_)

    def _circles(self, points: Points) -> list[tuple[str, IntArray, FormDeviation]]:
        """Return each section with its points in the order of the angle, and what it deviates."""
        from metrosep.core.profile import Profile
        from metrosep.parameters.deviation import roundness_deviation

        made, reference = [], cast("Any", self.reference)
        for label in dict.fromkeys(points.section.tolist()):
            inside = np.flatnonzero(points.section == label)
            angle, inside = _one_turn(points.xyz[inside, 0], inside)
            try:
                found = roundness_deviation(
                    Profile(angle, points.xyz[inside, 1]),
                    reference=reference,
                    exact=self.exact,
                    radius=self.nominal_radius,
                    upr=self.upr,
                    upr_low=self.upr_low,
                )
            except MetrosepError as exc:
                why = re.sub(
                    r"\bradius=", "nominal_radius=", str(exc)
                )  # radius is the column here
                exc.args = (f"{f'section {label}: ' if label else ''}{why}", *exc.args[1:])
                raise
            made.append((label, inside, found))
        return made

    def _found(self, feature: Points, *datum: Points) -> tuple[GeometricDeviation, ...]:
        from metrosep.parameters.geometry import GeometricDeviation

        circles, found = self._circles(feature), []
        for symbol in ("RONt", "RONp", "RONv", "RONq"):
            _, inside, worst = max(circles, key=lambda c: c[2].table[symbol].value)
            value = worst.table[symbol]
            of = "" if len(circles) == 1 else ", worst section"
            support = inside[worst.support.indices]
            about = f"{self.reference}CI"
            words = value.definition.partition(", ISO")[0].replace(f" ({about})", "") + of
            edition = "ISO 12181-1:2011"
            found.append(
                GeometricDeviation(value.value, symbol, words, about, "", support, edition)
            )
        return tuple(found)

    def _off(self, feature: Points, *datum: Points) -> tuple[FloatArray, FloatArray | None, str]:
        off = np.full(len(feature.xyz), np.nan)
        for _, inside, one in self._circles(feature):
            off[inside] = one.residual.z
        angle = np.mod(feature.xyz[:, 0], 2.0 * np.pi)
        return off, angle, f"from the {self.reference}CI of its section"


def _height_name(height: float) -> str:
    """Return the name of the section at a height."""
    return f"{height * 1e3:.6g} mm"


def _apart(t: FloatArray, gap: float) -> IntArray:
    """Return the group of each position, counted from the lowest: neighbours in a group lie at most a gap apart."""
    order = np.argsort(t, kind="stable")
    number = np.zeros(t.size, dtype=np.intp)
    number[order] = np.cumsum(np.diff(t[order], prepend=t[order[:1]]) > gap)
    return number


def _one_turn(angle: FloatArray, at: IntArray) -> tuple[FloatArray, IntArray]:
    """Return angles that rise, and the points in that order: a trace may run backwards and through zero."""
    whole = np.unwrap(angle)
    if np.all(np.diff(whole) < 0.0):
        return whole[::-1], at[::-1]
    if np.all(np.diff(whole) > 0.0):
        return whole, at
    whole = np.mod(angle, 2.0 * np.pi)
    order = np.argsort(whole, kind="stable")
    return whole[order], at[order]


@dataclass(frozen=True, kw_only=True)
class Cylindricity(_OfPoints):
    """`metrosep.parameters.cylindricity` by its name."""

    name: ClassVar[str] = "cylindricity"
    what: ClassVar[str] = "cylindricity CYLt of points or of roundness traces at several heights"

    reference: str = option(
        "MZ", kind="text", choices=("MZ", "LS"), help="minimum zone, or least-squares axis"
    )

    def _found(self, feature: Points, *datum: Points) -> tuple[GeometricDeviation, ...]:
        from metrosep.parameters.geometry import cylindricity

        reference: Any = self.reference
        along = _vector(self.direction, "direction")
        return (cylindricity(feature.xyz, direction=along, reference=reference),)

    def _off(self, feature: Points, *datum: Points) -> tuple[FloatArray, FloatArray | None, str]:
        from metrosep.parameters.geometry import datum_axis

        axis = datum_axis(feature.xyz, direction=_vector(self.direction, "direction"))
        return _about(axis, feature, "from the least-squares cylinder")


@dataclass(frozen=True, kw_only=True)
class _WithDatumAxis(_OfPoints):
    """Of a round feature about a datum axis."""

    datum: str = option(
        kind="text", help='element whose least-squares cylinder gives the datum axis; "frame": the axis through the origin of the file'
    )  # fmt: skip

    def _parts(self, points: Points) -> tuple[Points, ...]:
        return _with_datum(points, self.feature, self.datum, frame=True)

    def _axis(self, *datum: Points) -> DatumAxis:
        return _datum_axis(self.direction, *datum)

    def _off(self, feature: Points, *datum: Points) -> tuple[FloatArray, FloatArray | None, str]:
        return _about(self._axis(*datum), feature, "about the datum axis, from their mean")


@dataclass(frozen=True, kw_only=True)
class RunOut(_WithDatumAxis):
    """`metrosep.parameters.run_out` by its name."""

    name: ClassVar[str] = "run_out"
    what: ClassVar[str] = "circular (CRO) and total (TRO) run-out about a datum axis"

    measured: str = option(
        "radial", kind="text", choices=("radial", "axial"), help="distances from the axis, or positions of a face along it, whose sections are circles"
    )  # fmt: skip

    def _found(self, feature: Points, *datum: Points) -> tuple[GeometricDeviation, ...]:
        from metrosep.parameters.geometry import run_out

        axis, measured = self._axis(*datum), cast("Any", self.measured)
        total = run_out(feature.xyz, axis, measured=measured)
        labels = self._sections(feature, axis.direction)
        if self.measured == "axial" and self.section_gap is not None:
            raise DataError(
                "section_gap= tells sections along the axis; the circles of a face are named by the column "
                "section"
            )
        if labels is None:
            return (total,)
        return (run_out(feature.xyz, axis, sections=labels, measured=measured), total)

    def _off(self, feature: Points, *datum: Points) -> tuple[FloatArray, FloatArray | None, str]:
        axis = self._axis(*datum)
        off, angle, words = _about(axis, feature, "about the datum axis, from their mean")
        if self.measured == "axial":
            along = feature.xyz @ axis.direction
            off, words = along - along.mean(), "along the datum axis, from their mean"
        return off, angle, words


@dataclass(frozen=True, kw_only=True)
class Coaxiality(_WithDatumAxis):
    """`metrosep.parameters.coaxiality` by its name."""

    name: ClassVar[str] = "coaxiality"
    what: ClassVar[str] = "coaxiality COX of sections with a datum axis"

    def _found(self, feature: Points, *datum: Points) -> tuple[GeometricDeviation, ...]:
        from metrosep.parameters.geometry import coaxiality

        axis = self._axis(*datum)
        labels = self._labels(feature, axis.direction, "coaxiality")
        found = coaxiality(feature.xyz, labels, axis)
        worst = np.unique(labels)[found.support[0]]  # the section that holds it: all of its points
        return (replace(found, support=np.flatnonzero(labels == worst)),)


@dataclass(frozen=True, kw_only=True)
class _Orientation(_OfPoints):
    """Of a plane or an axis to a datum plane or axis."""

    symbol: ClassVar[str]
    level: ClassVar[str]  # kind of datum whose direction is across the zone
    lies: ClassVar[str]  # that zone, to its datum

    datum: str = option(kind="text", help="element that is the datum")
    feature_kind: str = option(
        "plane", kind="text", choices=("plane", "axis"), help="what is judged: a face, or the axis of a round element through the centres of its sections"
    )  # fmt: skip
    datum_kind: str = option(
        "plane", kind="text", choices=("plane", "axis"), help="what the datum is"
    )
    association: str = option(
        "tangent", kind="text", choices=("tangent", "LS"), help="of a datum plane: minimax plane from outside the material (ISO 5459), or least squares"
    )  # fmt: skip
    datum_direction: str | None = option(
        None,
        kind="text",
        help="of a datum axis: roughly along it; that of the feature if omitted",
    )

    def _parts(self, points: Points) -> tuple[Points, ...]:
        return _with_datum(points, self.feature, self.datum, frame=False)

    def _datum(self, datum: Points) -> tuple[FloatArray, str]:
        """Return normal or direction of the datum, and what it is."""
        if self.datum_kind == "plane":
            from metrosep.parameters.geometry import datum_plane

            # which side the material is on moves the plane along its normal only: no matter here
            association: Any = self.association
            out = _normal(datum)
            plane = datum_plane(datum.xyz, outward=out, association=association)
            return plane.normal, f"plane, {plane.association}"
        axis = _datum_axis(self.datum_direction or self.direction, datum)
        return axis.direction, f"axis, {axis.association}"

    def _feature(self, feature: Points, words: str) -> FloatArray:
        """Return what must lie in the zone: the points of a face, or the centres of sections."""
        if self.feature_kind == "plane":
            return feature.xyz
        return self._centres(feature, _vector(self.direction, "direction"), words)

    def _found(self, feature: Points, *datum: Points) -> tuple[GeometricDeviation, ...]:
        words = f"{self.name} of a{'n axis' if self.feature_kind == 'axis' else ' plane'}"
        make: Callable[..., GeometricDeviation] = self._across
        if self.datum_kind != self.level:
            make = self._cylinder if self.feature_kind == "axis" else self._turning
        return (make(feature, datum[0], words),)

    def _across(self, feature: Points, datum: Points, words: str) -> GeometricDeviation:
        """Return the range along a direction of the datum: a zone at right angles to it."""
        from metrosep.parameters.geometry import DatumPlane, parallelism

        d, about = self._datum(datum)
        points = self._feature(feature, words)
        found = parallelism(points, DatumPlane(d, 0.0, ""))
        how = f"zone of two planes {self.lies} to the datum"
        found = replace(found, symbol=self.symbol, definition=words, association=how, datum=about)
        return self._held(found, feature)

    def _held(self, found: GeometricDeviation, feature: Points) -> GeometricDeviation:
        """Return the deviation with its support as points of the feature."""
        if self.feature_kind == "plane":
            return found
        along = _vector(self.direction, "direction")
        labels = self._labels(feature, along, found.definition)
        held = np.isin(labels, np.unique(labels)[found.support])
        return replace(found, support=np.flatnonzero(held))

    def _cylinder(self, feature: Points, datum: Points, words: str) -> GeometricDeviation:
        """Return the smallest cylinder along the datum around the centres of sections."""
        from metrosep.parameters.geometry import axis_zone

        d, about = self._datum(datum)
        found = axis_zone(self._feature(feature, words), d, symbol=self.symbol)
        return self._held(replace(found, definition=words, datum=about), feature)

    def _turning(self, feature: Points, datum: Points, words: str) -> GeometricDeviation:
        """Return the narrowest zone that holds the direction of the datum and may turn about it."""
        from metrosep.parameters.geometry import DatumPlane, perpendicularity

        d, about = self._datum(datum)
        normal = _least_direction(feature.xyz, d)
        found = perpendicularity(feature.xyz, DatumPlane(d, 0.0, ""), normal=normal)
        how = "narrowest zone along the datum's direction, free to turn about it"
        return replace(found, symbol=self.symbol, definition=words, association=how, datum=about)

    def _off(self, feature: Points, *datum: Points) -> tuple[FloatArray, FloatArray | None, str]:
        d, _ = self._datum(datum[0])
        if self.feature_kind == "axis":
            axis = _datum_axis(self.direction, feature)
            return _about(axis, feature, "from the least-squares cylinder of the feature")
        across = d if self.datum_kind == self.level else _least_direction(feature.xyz, d)
        off = feature.xyz @ across
        return off - off.mean(), None, "across the zone, from their mean"


@dataclass(frozen=True, kw_only=True)
class Parallelism(_Orientation):
    """`metrosep.parameters.parallelism` and its kin of axes by their name."""

    name: ClassVar[str] = "parallelism"
    what: ClassVar[str] = "parallelism PAR of a face or an axis to a datum plane or axis"
    symbol: ClassVar[str] = "PAR"
    level: ClassVar[str] = "plane"
    lies: ClassVar[str] = "parallel"


@dataclass(frozen=True, kw_only=True)
class Perpendicularity(_Orientation):
    """`metrosep.parameters.perpendicularity` and its kin of axes by their name."""

    name: ClassVar[str] = "perpendicularity"
    what: ClassVar[str] = "perpendicularity PER of a face or an axis to a datum plane or axis"
    symbol: ClassVar[str] = "PER"
    level: ClassVar[str] = "axis"
    lies: ClassVar[str] = "at right angles"


def _joined(parts: Sequence[Points]) -> Points:
    """Return the points of all files that have all of their coordinates."""
    xyz = np.concatenate([p.xyz for p in parts])
    element, section = (
        np.concatenate([getattr(p, n) for p in parts]) for n in ("element", "section")
    )
    lost = np.isnan(xyz).any(axis=1)
    if np.isinf(xyz).any():
        raise InvalidSamplesError("a coordinate is infinite; leave the point out")
    if lost.all():
        raise TooFewSamplesError("no point has all of its coordinates; check the columns")
    notes = [f"{int(lost.sum())} points without a coordinate were omitted"] if lost.any() else []
    notes += [n for p in parts for n in p.notes]
    return Points(xyz, element, section, tuple(dict.fromkeys(notes)))[~lost]


# ---- elements, directions, datums --------------------------------------------------------------

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
FRAME = "frame"
"""As a datum: the axis of the coordinates."""


def _vector(text: str, key: str) -> FloatArray:
    """Return a direction from ``+z`` or three numbers."""
    plain = text.strip().lower()
    if plain.lstrip("+-") in _AXES and len(plain) <= 2:
        sign = -1.0 if plain.startswith("-") else 1.0
        return sign * np.array(_AXES[plain.lstrip("+-")])
    try:
        numbers = np.array([float(v) for v in re.split(r"[\s,;]+", plain)])
    except ValueError:
        numbers = np.empty(0)
    size = float(np.linalg.norm(numbers)) if numbers.size == 3 else 0.0
    if not (size > 0.0 and np.isfinite(size)):
        raise DataError(
            f'{key}={text!r} is not a direction: write x, -z, or three numbers "0.1 0 1"'
        )
    return np.asarray(numbers / size)


def _names(labels: NDArray[np.str_]) -> str:
    return ", ".join(dict.fromkeys(str(v) for v in labels if v)) or "all"


def _chosen(points: Points, wanted: str | None, key: str) -> Points:
    """Return the points of one element."""
    known = sorted(set(points.element.tolist()))
    if wanted is None:
        if len(known) > 1 and key == "feature":
            raise DataError(
                f"the points are of {len(known)} elements ({', '.join(known)}): state feature=..., the one "
                "that is judged"
            )
        return points
    if wanted not in known:
        raise DataError(
            f"{key}={wanted!r} is not one of the elements ({', '.join(known) or 'none'}); name the column "
            "element, or state elements=..., one for each file"
        )
    return points[points.element == wanted]


def _with_datum(
    points: Points, feature: str | None, datum: str, *, frame: bool
) -> tuple[Points, ...]:
    if frame and datum.strip().lower() == FRAME:
        return (_chosen(points, feature, "feature"),)
    of_datum = _chosen(points, datum, "datum")
    if feature == datum:
        raise DataError(
            f"feature and datum are both {datum!r}: an element is judged by another one"
        )
    rest = points[points.element != datum]
    if rest.xyz.size == 0:
        raise DataError(f"all points are of the datum {datum!r}: the feature is missing")
    return _chosen(rest, feature, "feature"), of_datum


def _datum_axis(direction: str, *datum: Points) -> DatumAxis:
    """Return the axis of a datum element, or that of the frame."""
    from metrosep.parameters.geometry import DatumAxis, datum_axis

    along = _vector(direction, "direction")
    if datum:
        return datum_axis(datum[0].xyz, direction=along)
    return DatumAxis(np.zeros(3), along, f"through the origin of the file along {direction}")


def _least_direction(xyz: FloatArray, d: FloatArray) -> FloatArray:
    """Return the direction at right angles to d in which points spread least: roughly their normal."""
    across = np.linalg.svd(d[None, :])[2][1:]
    q = (xyz - xyz.mean(axis=0)) @ across.T
    return np.asarray(np.linalg.svd(q, full_matrices=False)[2][1] @ across)


def _normal(points: Points) -> FloatArray:
    """Return roughly the normal of a face, the direction in which it spreads least."""
    q = points.xyz - points.xyz.mean(axis=0)
    _, size, directions = np.linalg.svd(q, full_matrices=False)
    if len(q) < 4 or not size[1] > _THIN * size[0] or size[2] > _FLAT * size[1]:
        raise DataError(
            f"the {len(q)} points of element {_names(points.element)!r} do not lie on a face: a plane needs 4 "
            "points or more that are not on one line; check the element, or datum_kind="
        )
    return np.asarray(directions[2])


def _about(
    axis: DatumAxis, feature: Points, words: str
) -> tuple[FloatArray, FloatArray | None, str]:
    """Return the distances from an axis, less their mean, and the angles about it."""
    r = axis.distances(feature.xyz)
    q = feature.xyz - axis.point
    u = np.eye(3)[int(np.argmin(np.abs(axis.direction)))]
    if abs(axis.direction[2]) > 0.5:
        u = np.array([1.0, 0.0, 0.0])  # angles count from x where the axis is that of a spindle
    u = u - (u @ axis.direction) * axis.direction
    v = np.cross(axis.direction, u)
    angle = np.mod(np.arctan2(q @ v, q @ u), 2.0 * np.pi)
    return r - r.mean(), np.asarray(angle), words


def _open_sections(points: Points, angle: FloatArray | None) -> tuple[str, ...]:
    """Return what is to be known of a round feature that was not measured all around."""
    if angle is None:
        return ()
    sections = points.section if points.has_sections else np.full(angle.size, "")
    gaps = {}
    for label in np.unique(sections):
        a = np.sort(angle[sections == label])
        gaps[label] = float(np.max(np.diff(a, append=a[0] + 2.0 * np.pi)))
    worst = max(gaps, key=lambda k: gaps[k])
    if gaps[worst] <= _GAP:
        return ()
    where = f"section {worst}" if worst else "the feature"
    return (
        f"{where} has no point over {np.degrees(gaps[worst]):.3g} deg: what lies there is in no value",
    )


# ---- the result document -----------------------------------------------------------------------


def geometry_of(produced: MeasuredGeometry, inputs: Any = None) -> Description:
    """Return what a document holds of a `MeasuredGeometry`."""
    found = {
        d.symbol: d.to_quantity(u=u, u_source="u_reading, Monte Carlo")
        for d, u in zip(produced.found, produced.u, strict=True)
    }
    points = produced.points
    named = zip(("angle_deg", "radius_um", "height_mm"), (180.0 / np.pi, 1e6, 1e3), strict=True)
    if not produced.is_trace:
        named = zip((f"{name}_mm" for name in _CARTESIAN), (1e3, 1e3, 1e3), strict=True)
    columns: dict[str, Any] = {n: points.xyz[:, k] * f for k, (n, f) in enumerate(named)}
    columns["off_um"] = produced.off * 1e6
    if points.has_sections:
        columns["section"] = points.section.tolist()
    for d in produced.found:
        columns[f"holds_{d.symbol}"] = np.isin(np.arange(produced.off.size), d.support).tolist()
    zones = [
        {
            "symbol": d.symbol,
            "value_m": d.value,
            "association": d.association,
            "datum": d.datum,
            "edition": d.edition,
            **(
                {}
                if produced.is_trace
                else {"support_m": points.xyz[d.support[:_PANELS]].tolist()}
            ),
        }
        for d in produced.found
    ]
    return Description(
        found,
        (_chart(produced),),
        {"": columns},
        document={"zones": zones},
        audit=produced.audit,
    )


def _chart(produced: MeasuredGeometry) -> dict[str, Any]:
    """Return the deviations over the angle, a panel for each section; of a face over its length."""
    points, off = produced.points, produced.off
    words = f"Each point {produced.about}. Nothing is filtered."
    if produced.angle is None:
        widest = int(np.argmax(np.ptp(points.xyz, axis=0)))
        rows = [curve("", points.xyz[:, widest], off, points=True)]
        title = f"position along {_CARTESIAN[widest]}"
        return curve_chart(
            "Deviation of the points", (title, "m"), [panel("", "m", rows)], caption=words
        )
    labels = (
        points.section
        if points.has_sections or produced.is_trace
        else np.full(off.size, "all points")
    )
    known = list(dict.fromkeys(labels.tolist()))
    if len(known) > _PANELS:
        words += f" {_PANELS} of {len(known)} sections are drawn."
    panels = []
    for label in known[:_PANELS]:
        inside = np.flatnonzero(labels == label)
        order = inside[np.argsort(produced.angle[inside])]
        rows = [curve("", produced.angle[order], off[order], points=order.size < 40)]
        panels.append(panel(produced.titles.get(label, str(label)), "m", rows))
    chart = curve_chart("Deviation of the points", ("angle", "rad"), panels, caption=words)
    return chart | {"closed": True, "each": True}
