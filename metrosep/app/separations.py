"""What a recipe makes of repeated runs, or of the readings of another method, each part made once.

The readings are read again only where ``[input]`` changed, and separated again only where the step
that separates changed: a new limit or table costs nothing of it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from metrosep.app.documents import text_key
from metrosep.app.wire import plain
from metrosep.compensation.limits import Limits
from metrosep.controllers.base import Dialect, DialectInfo
from metrosep.controllers.options import LIMIT_DIMENSIONS, Option
from metrosep.controllers.registry import find, names
from metrosep.core.errors import DataError
from metrosep.core.runset import RunSet
from metrosep.core.units import format_engineering
from metrosep.recipe.pipeline import CancelledError
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.report_fields import report_hash
from metrosep.recipe.result import Result
from metrosep.recipe.run import read_inputs, separate_inputs, separated_result, table_basis
from metrosep.separation.runs.base import ErrorEstimate

_MOST = 8
"""Separations that are remembered: undo and redo show them at once."""

Cancel = Callable[[], bool]


class _Latest:
    """The latest results of a function, by a text that tells them apart."""

    def __init__(self) -> None:
        self._kept: dict[str, Any] = {}
        self._lock = threading.Lock()

    def of(self, key: str, make: Callable[[], Any], cancel: Cancel | None = None) -> Any:
        """Return what was made for a key, or make it; one at a time."""
        with self._lock:
            if key in self._kept:
                self._kept[key] = self._kept.pop(key)  # the latest stand last
                return self._kept[key]
            if cancel is not None and cancel():
                raise CancelledError("stopped before it began")
            made = make()
            self._kept[key] = made
            while len(self._kept) > _MOST:
                self._kept.pop(next(iter(self._kept)))
            return made


class Separations:
    """Repeated runs and what the step ``separate`` makes of them."""

    def __init__(
        self,
        files: Sequence[Path],
        read: Callable[[Recipe, list[Path]], RunSet] = read_inputs,
    ) -> None:
        self.files = list(files)
        self._read = read
        self._runs, self._estimates, self._results = _Latest(), _Latest(), _Latest()
        self._bases = _Latest()

    def runs(self, recipe: Recipe) -> RunSet:
        """Return the readings."""
        found: RunSet = self._runs.of(
            _input_key(recipe), lambda: self._read(recipe, list(self.files))
        )
        return found

    def estimate(self, recipe: Recipe, cancel: Cancel | None = None) -> ErrorEstimate:
        """Return the separated error."""
        runs = self.runs(recipe)
        step = next(s for s in recipe.steps if s["op"] == "separate")
        key = _input_key(recipe) + text_key(step)
        found: ErrorEstimate = self._estimates.of(
            key, lambda: separate_inputs(without_tables(recipe), runs), cancel
        )
        return found

    def basis(self, recipe: Recipe, cancel: Cancel | None = None) -> dict[str, Any]:
        """Return what tables are made of and judged by, as a result stores it."""
        estimate, runs = self.estimate(recipe, cancel), self.runs(recipe)
        of_tables = [dict(o) for o in recipe.outputs if o["kind"] == "table"]  # for on_axis
        key = _input_key(recipe) + text_key(recipe.steps) + text_key(of_tables)
        found: dict[str, Any] = self._bases.of(key, lambda: table_basis(recipe, runs, estimate))
        return found

    def result(self, recipe: Recipe, cancel: Cancel | None = None) -> Result:
        """Return everything that the recipe makes of the runs; nothing is written."""
        estimate, runs = self.estimate(recipe, cancel), self.runs(recipe)
        found: Result = self._results.of(
            _shown(recipe), lambda: separated_result(recipe, runs, estimate)
        )
        return found


class MethodResults:
    """What a recipe with one of the named methods makes of its readings."""

    def __init__(self, files: Sequence[Path]) -> None:
        self.files = list(files)
        self._results = _Latest()

    def result(self, recipe: Recipe, cancel: Cancel | None = None) -> Result:
        """Return everything that the recipe makes of the readings; nothing is written."""
        if not recipe.is_method or recipe.is_pipeline:
            raise DataError(f"{recipe.name}: is not a recipe of a named method")
        files = None if recipe.reads_nothing else self.files
        key = f"{_shown(recipe)}\0{report_hash(recipe, files or ())}"
        found: Result = self._results.of(key, lambda: recipe.run(files), cancel)
        return found


def _shown(recipe: Recipe) -> str:
    """Return what tells results apart: another view of a recipe gives no other numbers.

    With the limits and the outputs, which may have been left out of what the text says.
    """
    judged = text_key([recipe.checks, recipe.outputs])
    return f"{recipe.name}\0{recipe.recorded['text']}\0{judged}"


def without_tables(recipe: Recipe) -> Recipe:
    """Return a recipe without its files for a machine: what is separated does not depend on them."""
    kept = (o for o in recipe.outputs if o["kind"] not in ("table", "program"))
    return replace(recipe, outputs=tuple(kept))


def _input_key(recipe: Recipe) -> str:
    of_laser = [step for step in recipe.steps if step["op"] == "laser_setup"]
    return text_key({**{k: v for k, v in recipe.input.items() if k != "files"}, "laser": of_laser})


# ---- the dialects as plain values, from which a form is made: options, limits, how the sign is known ----

_SIGN = {
    "confirmed": "The sign was confirmed by a run of the controller itself, or by definition",
    "documented": "The sign is documented by the maker",
    "stated": "The sign follows a fact that you state",
    "unconfirmed": "The sign is NOT documented: try it on the machine first",
}
_UNITS = {
    "length": ("m", "10 um"),
    "length or angle": ("m", "10 um"),
    "angle": ("rad", "90 deg"),
    "speed": ("m/s", "60 mm/min"),
    "acceleration": ("m/s^2", "0.1 m/s^2"),
    "time": ("s", "1 ms"),
    "frequency": ("Hz", "50 Hz"),
    "voltage": ("V", "10 V"),
}
"""SI unit of a kind of option, and what a person may write."""

_MACHINE = {
    "stroke": "largest correction that the actuator can do",
    "feed": "largest feed of the looked-up axis",
    "velocity_share": "speed of the corrected axis that the correction may use",
    "acceleration_share": "acceleration of the corrected axis that the correction may use",
    "reversal_jump": "largest step of the correction at a reversal",
    "acceleration": "MAX_ACCELERATION of the joint (LinuxCNC), for its dead zone",
    "servo_period": "servo period (LinuxCNC), for its dead zone",
    "travel_low": "lowest commanded position, which the table must cover",
    "travel_high": "highest commanded position, which the table must cover",
    "soft_low": "lower software limit of the corrected axis",
    "soft_high": "upper software limit of the corrected axis",
    "max_points": "most entries that the controller takes, where it is not the usual number",
}


def described_controllers() -> list[dict[str, Any]]:
    """Return every dialect, in the order in which they are listed.

    Examples
    --------
    >>> described_controllers()[0]["id"]
    'linuxcnc'
    """
    return [described_controller(find(name)) for name in names()]


def described_controller(dialect: Dialect) -> dict[str, Any]:
    """Return what a form needs to know of a dialect."""
    info = dialect.info
    of_one_axis = info.carries != "map"
    return {
        "id": info.id,
        "title": info.title,
        "carries": info.carries,
        "fits": of_one_axis,
        "why": "" if of_one_axis else "holds maps over two axes, not the error of one axis",
        "suffix": info.suffix,
        "page": info.page,
        "options": [_described(option) for option in dialect.options],
        "limits": _limits(info),
        "sign": {
            "status": info.sign,
            "words": sign_words(info),
            "needs_trial": info.sign == "unconfirmed",
        },
        "notes": _notes(info),
    }


def sign_words(info: DialectInfo) -> str:
    """Return one sentence on the sign of a dialect."""
    return (
        f"The correction = \u2212error is ADDED to the command. An entry holds: {info.entry}. "
        f"{_SIGN[info.sign]} ({info.sign_status})."
    )


def machine_facts() -> list[dict[str, Any]]:
    """Return the limits that every machine may have, as options of a form."""
    fields = [name for name in Limits.__dataclass_fields__ if name in _MACHINE]
    return [
        _described(Option(name, _MACHINE[name], LIMIT_DIMENSIONS.get(name, "integer")))
        for name in fields
    ]


def _described(option: Option) -> dict[str, Any]:
    return {
        "name": option.name,
        "kind": option.kind,
        "choices": plain(list(option.choices)),
        "default": plain(option.default),
        "usual": _usual(option),
        "help": option.help,
        "required": option.required,
        "unit": _UNITS.get(option.kind, ("", ""))[1],
        "low": plain(option.lowest),
        "high": plain(option.highest),
    }


def _usual(option: Option) -> str:
    """Return the default as a person writes it."""
    if option.default is None:
        return ""
    if option.kind in _UNITS and isinstance(option.default, int | float):
        return format_engineering(float(option.default), _UNITS[option.kind][0])
    return str(option.default)


def _limits(info: DialectInfo) -> list[str]:
    said = [
        f"at most {info.max_points} entries"
        if info.max_points
        else "entries: as many as you like",
        "any spacing of the entries" if info.spacing == "free" else "entries evenly spaced",
        "forward and reverse may differ"
        if info.directions == "two"
        else "one column for both directions",
        f"outside the table: {info.outside}",
    ]
    if info.resolution:
        said.append(f"smallest step of an entry: {info.resolution}")
    if info.reference_rule:
        said.append(f"reference: {info.reference_rule}")
    return said


def _notes(info: DialectInfo) -> list[str]:
    return [f"units in the file: {info.units}", f"proof: {info.proof}", *info.activation]
