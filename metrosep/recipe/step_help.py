"""What the keys of steps are and do, in plain words, and what counts where they are left out."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from metrosep.core.options import KINDS
from metrosep.core.readable import readable_text, typed_number
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.recipe.key_values import DIMENSIONS, placeholder
from metrosep.recipe.schema import Field
from metrosep.recipe.steps import ALL_STEPS

__all__ = [
    "DEFAULTS",
    "HELP",
    "StepKeys",
    "in_words",
    "key_words",
    "keys_of_step",
    "kind_words",
    "step_words",
]

HELP: Mapping[str, Mapping[str, str]] = {
    "separate": {
        "method": "joint: least squares over all runs at once, with uncertainty; kono: Fourier series of "
        "the waves that repeat over the feedrates; mean: the plain mean of the runs",
        "start": "where the evaluation range begins; centred in the common travel where only the length "
        "is given",
        "length": "length of the evaluation range; up to the end of the common travel if left out",
        "shortest": "joint and kono only: shortest wavelength of the model; chosen from the data if left "
        "out",
        "lag": "joint only: delay of the reading against the position, positive when the reading is late; "
        "auto corrects what the runs show, fit finds it in any case; both need two feedrates",
        "exclude": "runs that are left out, by name; suspect leaves out all in which a fault was found",
        "accept": "runs that are kept although they are refused, by name, or suspect",
        "min_feeds": "joint only: feedrates that must be there; 1 accepts that vibration is only averaged",
        "false_discovery_rate": "joint only: accepted share of wavelengths called repeatable that are "
        "noise; the estimate itself does not depend on it",
        "sigma_t": "kono only: a wavelength repeats where the standard deviation over the feedrates lies "
        "below this, in SI; 5e-8 m, 5e-14 m^2 or 5e-17 m^3 after norm if left out, 0.05 where relative",
        "p_t": "kono only: a wavelength counts where its mean over the feedrates lies above this, in SI; "
        "1e-8 m, 1e-14 m^2 or 1e-17 m^3 after norm if left out",
        "norm": "kono only: what is compared with the thresholds: amplitude in m, its square, or its "
        "density over wavenumber",
        "taper_fraction": "kono only: share of the samples over which the weight rises at each end",
        "taper": "kono only: kono is the weight of the paper, tukey the symmetric cosine",
        "rule": "kono only: shortest keeps all waves down to the shortest that passes, contiguous down to "
        "the first that fails, mask only those that pass",
        "modelling_length": "kono only: longest wavelength of the series; the evaluation range over the "
        "flat part of the weight if left out",
        "values": "kono only: amplitudes from the mean run of one feedrate, or of all runs",
        "feed": "kono and mean only: the runs of this feedrate give the values; for kono the middle one, "
        "for mean all runs if left out",
        "averaging": "kono only: coherent takes the spectrum of the mean run, power the mean spectrum of "
        "the runs",
        "ddof": "kono only: 1 divides the squares by the feedrates less one (sample), 0 by the feedrates",
        "relative": "kono only: true compares the standard deviation over the mean with sigma_t",
        "min_coherence": "kono only: least agreement of the phases over the feedrates, 0 to 1; 0 ignores "
        "them as the paper does",
        "coefficients": "kono only: tapered are the Fourier sums of the weighted data, least_squares fits "
        "the kept waves, which does not decay in the ends",
        "drift": "joint only: degree of a polynomial in time that each run has for itself",
        "lines": "joint only: frequencies of vibrations that are taken out as sines; auto looks for them; "
        "none if left out",
        "line_phase": "joint only: free gives each run its own amplitude and phase of a line, locked one "
        "from the start of all runs",
        "false_alarm": "joint only: chance that lines = auto finds a line where there is none",
        "robust": "joint only: true takes weight from spikes, dropouts and bad stretches",
        "following": "joint only: what grows with the feedrate: the offset, the whole error (scale), or "
        "single waves of it",
        "following_waves": "joint only: how many of the strongest waves grow with the feedrate, or their "
        "wavelengths",
        "probes": "joint only: name of the probe of each run, separated by commas; from the files if left "
        "out",
        "probe_gain": "joint only: equal takes all probes as sensitive as the first, fit finds their "
        "sensitivities",
    },
    "polynomial": {
        "degree": "degree of the polynomial; auto takes that of least AICc",
        "max_degree": "highest degree that auto tries, up to 12",
        "quantity": "error is actual - nominal; compensation is minus the error, what is added to the "
        "command",
    },
    "plan_feedrates": {
        "v_min": "slowest feedrate of the machine that may be planned",
        "v_max": "fastest feedrate of the machine that may be planned",
        "n_runs": "number of runs to plan, beside those already done",
        "wavelengths": "shortest and longest wavelength that must become well known",
        "length": "travel of each run; that of the separated runs if left out",
        "settle_distance": "part of the travel that is lost while the axis settles",
        "max_time": "most time that all new runs together may take; no limit if left out",
        "min_ratio": "two feedrates are equal or at least this ratio apart",
        "fixed": "feedrates of runs that were already done, separated by commas; none if left out",
    },
}
"""By step and key: what it does. What only some methods know begins with their names and "only:"."""

DEFAULTS: Mapping[str, Mapping[str, Any]] = {
    "separate": {
        "method": "joint",
        "lag": "auto",
        "min_feeds": 2,
        "false_discovery_rate": 0.05,
        "norm": "amplitude",
        "taper_fraction": 0.1,
        "taper": "kono",
        "rule": "shortest",
        "values": "one_feed",
        "averaging": "coherent",
        "ddof": 1,
        "relative": False,
        "min_coherence": 0.0,
        "coefficients": "tapered",
        "drift": 0,
        "line_phase": "free",
        "false_alarm": 0.001,
        "robust": False,
        "following": "off",
        "following_waves": 3,
        "probe_gain": "equal",
    },
    "polynomial": {"degree": "auto", "max_degree": 6},
    "plan_feedrates": {"settle_distance": "0 mm", "min_ratio": 1.1},
}
"""By step and key, as it is typed; left out where what counts follows from the data."""

_KEY_WORDS: Mapping[tuple[str, str], str] = {
    ("", "machine"): "a preset (five_axis, fts_lathe, mill_xyz, sts_lathe) or a file of TOML "
    "(docs/how-to/describe-a-machine.md)",
    ("rank", "radius"): 'of the part, from its axis to the rim, "20 mm"',
    ("identify", "radius"): 'of the part, from its axis to the rim, "20 mm"',
    ("predict", "radius"): 'of the part, from its axis to the rim, "20 mm"',
    ("predict", "rpm"): "turns of the spindle per minute, 20",
    ("follow_up", "rpm"): "turns of the spindle per minute, 20",
    ("", "machine_radius"): "of the preset fts_lathe, where it is not that of the part",
    (
        "tool_setting",
        "form",
    ): 'the nominal surface, "sine_grid: amplitude=50 nm, wavelength=100 um"',
    ("tool_setting", "free"): "what is fitted, piston,dx,dy,dR (tilt_x, tilt_y, shift_x, shift_y, "
    "rotation too)",
    ("tool_setting", "noise"): 'standard uncertainty of one height, "1 nm"',
    ("tool_setting", "region"): 'radii between which points are used, "20 um, 220 um"',
    ("identify", "terms"): "error terms that may be at work, EXX,EYX,B0Z",
    ("identify", "exact"): "true: the surface is cut anew, not linear in the errors",
    ("rank", "errors"): 'a table, { EXX = "1 um", B0Z = "0.2 arcsec" }',
    ("rank", "all_lengths"): 'magnitude of every other term that is a length, "1 um"',
    ("rank", "all_angles"): 'magnitude of every other term that is an angle, "1 arcsec"',
    ("rank", "removed"): "none, piston, plane, plane+defocus, rigid, or names with commas",
    ("follow_up", "terms"): "what the error may depend on, velocity,acceleration,jerk (position, "
    "friction too)",
    ("follow_up", "delay"): 'known lag of the logger, taken out first, "1 ms"',
    ("follow_up", "spiral"): 'start radius and feed per turn, "500 um, 2 um"',
    ("predict", "feed"): 'towards the centre per turn, "2 um"',
    ("predict", "block_time"): 'that the controller needs for a block, "2 ms"',
    ("predict", "tolerance"): 'P-V that the points of the program may add, "1 nm"',
    ("predict", "core"): 'radius about the axis that is not judged, "4 um"',
    (
        "predict",
        "nose_radius",
    ): 'of the tool, "0.5 mm": the program is then a path of the tip; without '
    "it, points of the surface",
    (
        "predict",
        "rake",
    ): 'of the face in which the nose radius is measured, "-30 deg"; needs sense',
    ("predict", "window"): 'angle of the nose that is sharp, symmetric about the tip, "60 deg"',
    ("predict", "dx"): 'tool further from the spindle axis than programmed, "-0.25 um"',
    ("predict", "dy"): 'tool off the axis towards growing azimuth of the part, "0.1 um"',
    ("predict", "dR"): 'nose radius larger than programmed, "10 um"',
    ("predict", "follow_up"): "file with the log of the dry run of this part",
    ("predict", "follow_up_pv"): 'P-V of the follow-up error, where there is no log, "5 nm"',
    ("predict", "gain"): "share of a known error that the program makes up for, 1",
    ("predict", "measured"): 'P-V of the part as cut, to compare, "8 nm"',
    ("dual_servo", "sensitivity"): 'of the stage, where there is no sweep, "1.66 um/V"',
    ("dual_servo", "calibration"): "file with a sweep of the stage: voltage and displacement",
    ("dual_servo", "voltage"): "column of that file, voltage_V",
    ("dual_servo", "displacement"): "column of that file, displacement_um",
    ("dual_servo", "offset"): 'where the stage rests, within its travel, "2 um"',
    ("dual_servo", "limits"): "voltages of the amplifier, 0,10",
    ("dual_servo", "travel"): 'of the stage, from 0, "5 um"',
    ("dual_servo", "against"): "what the straightness is measured against, a text",
    ("dual_servo", "strict"): "true: a table beyond a limit is refused; false: it is written",
    ("dual_servo", "slew"): "fastest change of the amplifier in V/s, 100",
}
"""What a key means, by step and key; by key alone where the step is empty."""


def kind_words(kind: str) -> str:
    """Return what a value of a kind looks like.

    Examples
    --------
    >>> kind_words("size")
    'a length above zero with its unit, "25 mm"'
    """
    return KINDS[kind].words


def key_words(op: str, key: str) -> str:
    """Return what a key of a step does."""
    declared = ALL_STEPS[op].get(key) if op in ALL_STEPS else None
    if declared is not None and declared.help:
        return declared.help
    own = HELP.get(op, {}).get(key) or _KEY_WORDS.get((op, key))
    return own or _KEY_WORDS.get(("", key), "")


# ---- messages of the library in the words of who typed a recipe or a command -------------------
# The library names its arguments: ``pass zero=0.0``. Who wrote a recipe has keys with units,
# ``zero = "0 nm"``; who typed a command has ``--set zero="0 nm"``. What an argument is follows from
# the keys of the step alone (`Method.fields`, `input_fields`), never from a list of texts.

_COMMAND_COLUMNS = ("x", "z", "angle", "time", "repeat", "feed", "run", "direction", "readings")
"""Columns that the command has an option for; the others are given with ``--column``."""
_COMMAND_INPUT = ("scale", *TEXT_OPTIONS, "unit", "channel", "lateral_step")
_DIGITS = 6
"""Kept of a number that the library proposes."""
_OTHER_NAMES = {"dx": "lateral_step", "dy": "lateral_step"}
"""Arguments of the library that a file of maps has under another name."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_VALUE = rf"'[^']*'|\"[^\"]*\"|\([^()]*\)|\[[^\[\]]*\]|{_NUMBER}(?![\w.])|\.\.\.|[A-Za-z]\w*"
_PYTHON = rf"(?<![\w.\-\"'])([a-z_]\w*)=(?!=)({_VALUE})?( (?:nm|um|mm|m|rad|s)\b)?"
_ASKED = (
    r"\b((?:(?:give|pass|state) (?=[a-z])|(?:set|lower|needs?|without|unless|name|say|with|or)"
    r" (?=[a-z]+_)))([a-z]\w*)\b(?! =|[=(\w])"
)
_TOML = (
    r"(?<![\w.\-])([a-z_]\w*) = (\"[^\"]*\"|\[[^\[\]]*\](?!\])|true|false|-?\d+)"
    r"(?: in \[input\])?"
)
_NAMED = re.compile(f"{_PYTHON}|{_ASKED}|{_TOML}")
"""An argument as Python writes it, one that is asked for by its name alone, one as a recipe has it."""
_OTHER_ARGUMENT = re.compile(r",? or (?:give |tell it with )?([a-z_]\w*)=(?=[;.,]|$)")
"""A last way out by an argument, which falls away where the step has no such key."""
_ALL_THE_SAME = re.compile(r" \(([a-z_]\w*)=\w+ in Python does it all the same\)")
"""A way out that only a step with such a key has."""
_SENSITIVITY = re.compile(r"give the sensitivity of the sensor, such as scale='[^']*'")
_MULTIPLY = (
    "multiply it by the sensitivity of the sensor, and let the header name the unit of length"
)
_DEGREES = re.compile(
    r"degrees(?:, rad are needed|; give radians \(np\.deg2rad of it\)|: give numpy\.deg2rad\(\w+\))"
)
_ARRAY = re.compile(r"(?<=\))(,) or give an array \([^()]*\)|or give an array \([^()]*\)")
_SPLIT = "split the run at its turning points or "
_SI_AFTER = re.compile(r",? in (?:m|rad|s)\b(?= as well|[;.]|$)")


@dataclass(frozen=True, slots=True)
class StepKeys:
    """The keys that a step and its input have."""

    step: Mapping[str, Field]  # mapping of str to Field: keys of the step
    source: Mapping[str, Field]  # mapping of str to Field: keys of ``[input]``
    columns: frozenset[str] = frozenset()  # collection of str: which of the latter name columns


def keys_of_step(op: str) -> StepKeys | None:
    """Return the keys of a step."""
    from metrosep.core.methods import METHODS
    from metrosep.recipe.method import input_fields
    from metrosep.recipe.steps import INPUT, STEPS

    if op in STEPS:
        columns = frozenset({"x", "z", "feed", "run", "direction", "time"})
        return StepKeys(STEPS[op], INPUT, columns)
    if op not in METHODS:
        return None
    method = METHODS[op]
    source = input_fields(method)
    places = {"x", "angle", "repeat", "readings"} if method.reads == "curves" else set()
    return StepKeys(method.fields, source, frozenset({*method.roles, *places} & set(source)))


def step_words(message: str, op: str, *, command: bool = False) -> str:
    """Return a message of the library with its arguments as keys of a step.

    Notes
    -----
    Numbers of keys with a dimension are SI in the library and get their unit here. A key without
    its value gets dots and the unit that it takes. Words that are no key of the step stay.

    Examples
    --------
    >>> step_words("pass zero=0.0 to keep it", "three_point")
    'pass zero = "0 nm" to keep it'
    >>> step_words("pass zero=0.0 to keep it", "three_point", command=True)
    'pass --set zero="0 nm" to keep it'
    >>> step_words("one reading and no sd=", "abba", command=True)
    'one reading and no --set sd="... nm"'
    """
    keys = keys_of_step(op)
    return readable_text(message) if keys is None else in_words(message, keys, command=command)


def in_words(message: str, keys: StepKeys, *, command: bool = False) -> str:
    """Return a message of the library with its arguments as these keys."""

    def words(found: re.Match[str]) -> str:
        name, value, unit, verb, asked, key, typed = found.groups()
        text: str | None = None
        if key is not None:
            text = _typed(key, typed, keys) if command else None
        elif asked is not None:
            if asked in keys.step:
                text = verb + _set_or_key(asked, None, "", keys.step[asked], command=command)
        else:
            before = found.string[: found.start()]
            option = command and not before.endswith("got ")
            if not re.search(r"\w\([^()]*$", before):  # no call of Python
                text = _worded(name, value, unit or "", keys, command=option)
        return found.group() if text is None else text

    message = _of_columns(message, keys)
    changed = _NAMED.sub(words, message)
    if changed != message:
        changed = re.sub(r"\bset --set ", "give --set ", _SI_AFTER.sub("", changed))
    return readable_text(changed)


def _of_columns(message: str, keys: StepKeys) -> str:
    """Return a message without what only a call of Python has: arrays, radians, other arguments."""

    def known(found: re.Match[str]) -> str:
        return found.group() if found.group(1) in {**keys.step, **keys.source} else ""

    message = _OTHER_ARGUMENT.sub(known, message)
    message = _ALL_THE_SAME.sub(
        lambda found: known(found).replace(" in Python does", " does"), message
    )
    if "scale" not in keys.source and "scale" not in keys.step:
        message = _SENSITIVITY.sub(_MULTIPLY, message)
    if "angle" in keys.source:
        message = _DEGREES.sub("degrees: rename the column so that it ends in _deg", message)
    if "repeat" in keys.source:
        message = _ARRAY.sub(lambda found: "" if found.group(1) else "and repeat=", message)
        message = message.replace("(repeat, a column", "(repeat=, a column")
        message = message.replace("add the channel 'angle' in rad and", "name angle= and")
        message = message.replace(
            _SPLIT, "number the runs in a column and name it with repeat=, or "
        )
    return message


def _typed(name: str, value: str, keys: StepKeys) -> str | None:
    """Return a key that a message writes as a recipe has it, as an option."""
    text = re.sub(r'"|^\[|\]$', "", value)
    if name in keys.step:
        return _set(name, text)
    return _source(name, text, keys, command=True) if name in keys.source else None


def _worded(
    name: str, value: str | None, unit: str, keys: StepKeys, *, command: bool
) -> str | None:
    """Return one argument as a key; None where it is none of this step."""
    parts = re.findall(r"\w+", value) if value is not None and value.startswith("(") else []
    if name not in keys.step and len(parts) > 1 and all(p in keys.step for p in parts):
        each = [_worded(p, None, "", keys, command=command) or p for p in parts]
        return ", ".join(each[:-1]) + f" and {each[-1]}"
    if name in keys.step and _fits(value, keys.step[name]):
        return _set_or_key(name, value, unit, keys.step[name], command=command)
    name = _OTHER_NAMES.get(name, name)
    if name not in keys.source or (name in keys.columns and re.fullmatch(_NUMBER, value or "")):
        return None
    return _source(name, value, keys, command=command)


def _set_or_key(name: str, value: str | None, unit: str, field: Field, *, command: bool) -> str:
    """Return a key of the step with its value, or with what the value looks like."""
    if value is None or _is_open(value):
        text = placeholder(name, field)
        n = len(re.findall(r"[A-Za-z]\w*", value or ""))
        if n and ", " in text:
            text = ", ".join([text.split(", ")[0]] * n)
    else:
        text = _converted(value, unit, field)
    return _set(name, text) if command else _key(name, text, field)


def _source(name: str, value: str | None, keys: StepKeys, *, command: bool) -> str:
    """Return a key of ``[input]``, or the option that gives it."""
    if name in keys.columns:
        pair = re.fullmatch(r"\(\s*'([^']*)',\s*'([^']*)'\s*\)", value or "")
        value = ":".join(pair.groups()) if pair else value
        column = "COLUMN" if value is None or _is_open(value) else value.strip("'\"")
        column = re.sub(r",\s+", ",", column)
        if not command:
            return f'{name} = "{column}" in [input]'
        return f"--{name} {column}" if name in _COMMAND_COLUMNS else f"--column {name}={column}"
    field = keys.source[name]
    text = placeholder(name, field) if _is_open(value) else _converted(value, "", field)
    if name == "lateral_step":
        text = text.replace("... mm", "... um")
    if command and name in _COMMAND_INPUT:
        option = name.replace("_", "-")
        return f"--{option} {_shell(text)}"
    return f"{_key(name, text, field)} in [input]"


def _is_open(value: str | None) -> bool:
    """Whether no value is named: nothing, dots, or letters that stand for values."""
    return value is None or "..." in value or bool(re.fullmatch(r"[(\[][A-Za-z_, ]+[)\]]", value))


def _fits(value: str | None, field: Field) -> bool:
    """Whether a key could hold the value: one of its choices, where it has any."""
    if value is None or not field.choices or _is_open(value):
        return True
    return value.strip("'\"") in {str(c) for c in field.choices}


def _converted(value: str | None, unit: str, field: Field) -> str:
    """Return a value as it is typed: numbers in SI with the unit of the key."""
    text = (value or "").strip("'\"")
    if value != text:  # a text has its unit
        return text
    if text in ("True", "False"):
        return text.lower()
    if unit and unit.strip() not in ("m", "rad", "s"):
        return text + unit
    dimension = DIMENSIONS.get(field.kind)
    if dimension is None or field.kind == "waves":
        return text.strip("()[]")

    def with_unit(number: re.Match[str]) -> str:
        return typed_number(float(number.group()), dimension, digits=_DIGITS)

    return re.sub(_NUMBER, with_unit, text.strip("()[]"))


def _key(name: str, text: str, field: Field) -> str:
    written = KINDS[field.kind].written
    if written.startswith("plain") or (
        field.kind in ("degree", "waves") and re.fullmatch(r"[\d.]+", text)
    ):
        return f"{name} = [{text}]" if "list" in written else f"{name} = {text}"
    if KINDS[field.kind].is_list:
        return f"{name} = [" + ", ".join(f'"{t.strip()}"' for t in text.split(",")) + "]"
    return f'{name} = "{text}"'


def _set(name: str, text: str) -> str:
    return f"--set {name}={_shell(text)}"


def _shell(text: str) -> str:
    return text if re.fullmatch(r"[\w.+-]+", text) else f'"{text}"'
