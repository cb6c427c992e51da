"""Steps of recipes with readings of instruments on a machine: calibrate, circle, thermal."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from metrosep.core.errors import DataError, OptionError
from metrosep.core.methods import Method, NamedFiles, RoleColumns
from metrosep.core.numbers import count, quantity
from metrosep.core.options import Option
from metrosep.core.units import unit_dimension
from metrosep.recipe.methods.ops_machine import MACHINE, machine_of

_ALONE = ": no reading depends on it"


# ---- calibrate ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class MachineCalibration:
    """A calibration, and which of its terms are written."""

    found: Any
    smallest: bool

    @property
    def messages(self) -> tuple[str, ...]:
        """What was not determined, and what the user should know."""
        alone = [n.removesuffix(_ALONE) for n in self.found.null if n.endswith(_ALONE)]
        together = [n for n in self.found.null if not n.endswith(_ALONE)]
        unseen = [f"no reading depends on {', '.join(alone)}"] if alone else []
        return (*unseen, *together, *self.found.messages)


class MachineCalibrated(Method):
    """`calibrate` by its name."""

    name: ClassVar[str] = "calibrate"
    what: ClassVar[str] = "error terms of a machine from readings of instruments"
    reads: ClassVar = "files"
    arguments: ClassVar[Mapping[str, Option]] = {
        **{k: v for k, v in MACHINE.items() if k != "spindle_errors"},
        "degrees": Option(
            "table",
            help="highest order of the curves of an axis or a term, { X = 5, EZC = 3 }; if omitted 3 "
            "(harmonics: 2), and more as long as the residuals hold the next",
        ),
        "terms": Option("texts", help="error terms that may be at work; all if omitted"),
        "home": Option("table", help='where errors of an axis are zero, { X = "0 mm" }'),
        "all_readings": Option(
            "flag", help="true: no reading that contradicts the others is refused"
        ),
        "smallest": Option(
            "flag",
            help="true: terms that are not determined are written too, the smallest that explain the "
            "readings",
        ),
    }

    @classmethod
    def from_inputs(cls, data: NamedFiles, options: Mapping[str, Any]) -> MachineCalibration:
        """Return what the step makes."""
        from metrosep.io.reading_sets import read_reading_set
        from metrosep.machine import calibrate

        rest = dict(options)
        chain = machine_of(rest, None)
        kinds = chain.dimensions
        homes = {
            axis: quantity(place, f"home of {axis}", kinds.get(axis, "length"))
            for axis, place in rest.pop("home", {}).items()
        }
        degrees = {k: count(v, f"degree of {k}") for k, v in rest.pop("degrees", {}).items()}
        found = calibrate(
            chain,
            [read_reading_set(file, chain) for file in data.paths],
            degrees=degrees or None,
            terms=rest.get("terms"),
            home=homes,
            robust=not rest.get("all_readings", False),
        )
        return MachineCalibration(found, bool(rest.get("smallest", False)))


# ---- circle ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class CircleRun:
    """A circular test, and how its file was read."""

    test: Any
    notes: tuple[str, ...]

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know."""
        return (*self.test.messages, *self.notes)


class CircleTested(Method):
    """`circle_test` by its name."""

    name: ClassVar[str] = "circle"
    what: ClassVar[str] = "circular test of two axes after ISO 230-4"
    reads: ClassVar = "files"
    roles: ClassVar[Mapping[str, str]] = {
        "angle": "angle?",
        "ccw": "length?",
        "cw": "length?",
        "x": "length?",
        "y": "length?",
        "reading": "length?",
        "length": "length?",
    }
    arguments: ClassVar[Mapping[str, Option]] = {
        "radius": Option("size", required=True, help="programmed"),
        "feed": Option("speed", required=True, help="along the circle"),
        "plane": Option(
            "text",
            choices=("XY", "YZ", "ZX", "XZ"),
            help="first and second axis; the angle runs from the first to the second",
        ),
        "uncalibrated": Option("flag", help="true: the length of the bar is not known"),
    }

    @classmethod
    def from_inputs(cls, data: NamedFiles, options: Mapping[str, Any]) -> CircleRun:
        """Return what the step makes."""
        from metrosep.io.circle_logs import read_circle_log
        from metrosep.machine import circle_test

        rest = dict(options)
        layout = {k: v for k, v in data.options.items() if k not in cls.roles}
        columns = {k: v for k, v in data.options.items() if k in cls.roles}
        plane = rest.get("plane", "XY")
        log = read_circle_log(
            data.paths, radius=rest["radius"], columns=columns, plane=plane, **layout
        )
        test = circle_test(
            log.angle,
            log.ccw,
            log.cw,
            radius=rest["radius"],
            feed=rest["feed"],
            plane=plane,
            calibrated=not rest.get("uncalibrated", False),
        )
        return CircleRun(test, log.messages)


# ---- thermal --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class ThermalResult:
    """A fit to temperatures, and the errors at stated ones."""

    fit: Any
    errors: Any  # ErrorSet at the stated temperatures; None where none are stated
    stated: Mapping[str, float]

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know."""
        return tuple(self.fit.messages)


class ThermalLearnt(Method):
    """`fit_thermal` by its name."""

    name: ClassVar[str] = "thermal"
    what: ClassVar[str] = "errors of a machine as functions of temperatures"
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "time": "time",
        "temperatures": "temperature*",
        "readings": "length*?",
        "tilts": "angle*?",
    }
    arguments: ClassVar[Mapping[str, Option]] = {
        "terms": Option(
            "table",
            help='which error a reading is, { EZ0C = "EZZ", near = "EXX at 50 mm", far = "EXX at 450 mm" }; '
            "of readings with the name of an error motion it is that",
        ),
        "lags": Option(
            "times",
            help="time constants to try; from two samples to half of the record if omitted",
        ),
        "blocks": Option("integer", help="of time, each foretold from the others", default=6),
        "most": Option("integer", help="largest number of sensors of a reading", default=3),
        "reference": Option(
            "table",
            help='temperatures at which the errors are zero, { spindle = "20 degC" }; those at the '
            "beginning if omitted",
        ),
        "at": Option(
            "table",
            help='temperatures that have settled, { spindle = "31 degC" }: the errors there are written',
        ),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> ThermalResult:
        """Return what the step makes."""
        from metrosep.machine.terms import is_angle
        from metrosep.machine.thermal import fit_thermal, names_a_motion

        rest = dict(options)
        sensors = _by_name(data, "temperatures")
        lengths, angles = _by_name(data, "readings"), _by_name(data, "tilts")
        twice = sorted(set(lengths) & set(angles))
        if twice:
            raise DataError(f"{twice[0]} is a length and an angle; give its columns other names")
        if not lengths and not angles:
            raise DataError(
                "no reading is named: name columns of lengths as readings, of angles as tilts"
            )
        terms = {k: _placed(k, v) for k, v in rest.pop("terms", {}).items()} or None
        at = {k: quantity(v, f"at {k}", "temperature") for k, v in rest.pop("at", {}).items()}
        named = {n: n for n in lengths if names_a_motion(n)} if terms is None else terms
        for name, place in named.items():  # before the fit, which takes its time
            term = place if isinstance(place, str) else place[0]
            if name in lengths and is_angle(term):
                raise DataError(
                    f"{name} is a length by its unit, and {term} is not; name another term"
                )
        fit = fit_thermal(
            data.values["time"],
            sensors,
            {**lengths, **angles},
            terms=terms,
            angular=tuple(angles),
            **rest,
        )
        return ThermalResult(fit, fit.errors(at) if at else None, at)


def _by_name(data: RoleColumns, role: str) -> dict[str, Any]:
    """Return the columns of a role by their names without unit."""
    if role not in data.values:
        return {}
    names = data.columns[role]
    if len(set(names)) < len(names):
        raise DataError(f"two columns of {role} have one name, {', '.join(names)}; rename one")
    return dict(zip(names, data.values[role], strict=True))


def _placed(name: str, text: Any) -> str | tuple[str, float]:
    """Return a term, and its place where one is given: ``EXX at 50 mm``."""
    if not isinstance(text, str):
        raise OptionError(f'terms: {name} = {text!r}; a text is needed, "EZZ" or "EXX at 50 mm"')
    parts = re.split(r"\s+at\s+", text.strip())
    if len(parts) == 1:
        return parts[0]
    if len(parts) != 2:
        raise OptionError(f'terms: {name} = {text!r}; write "EXX at 50 mm"')
    dimension = "angle" if unit_dimension(parts[1]) == "angle" else "length"
    return parts[0], quantity(parts[1], f"place of {name}", dimension)
