"""A quantity with a unit is taken, and what is no number refused, in one way by every public callable.

The callables are found, not listed: all that a subpackage exports and whose docstring gives a scalar
parameter a unit. The call of its own example is made again with that one argument replaced.
"""

import contextlib
import doctest
import importlib
import inspect
import io
import pkgutil
import re
import sys
import warnings

import numpy as np
import pytest

import metrosep
from metrosep.errors import MetrosepError

UNIT = re.compile(r",\s*(m|rad|s|Hz|m/s)\b(?!\^|/)")
NO_SCALAR = re.compile(r"array|shape|sequence|tuple|list|mapping|of them|three floats")
TYPED = {
    "m": lambda v: f"{float(v) * 1e3!r} mm",
    "rad": lambda v: f"{float(v)!r} rad",
    "s": lambda v: f"{float(v) * 1e3!r} ms",
    "Hz": lambda v: f"{float(v)!r} Hz",
    "m/s": lambda v: f"{float(v) * 6e4!r} mm/min",
}
USUAL = {"m": 1e-3, "rad": 0.1, "s": 1e-3, "Hz": 100.0, "m/s": 0.05}
REFUSED = {
    "a truth value": True,
    "a text without unit": "3",
    "a text with another unit": "3 V",
    "a complex number": 1e-3 + 1j,
    "an array": np.array([1e-3, 2e-3]),
}
OTHERWISE = {
    "run_batch.watch": "would watch until it is stopped",
    "SpiralPath.step": "an angle, or a length where the arc is divided",
    "Expansion.temperature_use": "two parameters in one entry: K",
    "Expansion.workpiece_expansion": "two parameters in one entry: 1/K",
    "zero_calibration.step": "one entry with an angle",
    "zero_calibration.u_reading": "m of the probes, rad of an angle sensor",
    "FringeError.period": "period and readings may be angles",
    "two_point.distance": "its example hands over no readings",
    "follow_up.spiral_start": "of a spiral, which its example does not state",
    "CompensationMap.interpolation_error": "a result holds it",
    "CompensationMap.offset_removed": "a result holds it",
    "ConstantTerm.value": "a term does not know whether it is a length or an angle: SI",
    "ConstantTerm.u": "as its value",
    "CallableTerm.u": "as its value",
    "FourierTerm.mean": "as the value of a constant term",
    "FourierTerm.u": "as its mean",
    "FourierTerm.origin": "as its mean",
    "PolynomialTerm.u": "as the value of a constant term",
    "as_term.u": "as the value of a constant term",
    "presets.parameters": "keywords of the machine",
    "drive_table.travel": "the usual one is infinite",
    "check_map_limits.feeds": "a mapping",
}
"""Parameters of the walk that are something else, and what."""
MENDED = {
    "choose_knots", "knots_for_tolerance", "dead_zone", "resample_uniform", "error_correction",
    "nose_correction",     "separation_maps",
    "setting_profiles", "evidence_table", "fit_plane_model", "iso230_3_drift", "joint_drift",
    "DriftFit", "machine_axis", "periodic_error", "plan_feedrates", "predicted_sd", "zero_calibration",
    "donaldson", "multiprobe", "sine_path_step", "trial_table",
}  # fmt: skip
"""Callables that are walked each time; the others with the slow tests."""


def parameters_with_unit(function):
    """Yield the scalar parameters of a docstring with their unit."""
    found = re.search(
        r"Parameters\n-+\n(.*?)(?:\n\n[A-Z][A-Za-z ]+\n-+\n|\Z)",
        inspect.getdoc(function) or "",
        re.DOTALL,
    )
    for line in found.group(1).splitlines() if found else ():
        names, colon, kind = line.partition(" : ")
        unit = UNIT.search(kind)
        if colon and line[0] != " " and unit and "float" in kind and not NO_SCALAR.search(kind):
            yield from ((n.strip(" *"), unit.group(1)) for n in names.split(","))


def walked():
    seen = set()
    for package in sorted(p.name for p in pkgutil.iter_modules(metrosep.__path__)):
        if package.startswith("_") or package in ("app", "cli"):
            continue
        module = importlib.import_module(f"metrosep.{package}")
        for name in sorted(n for n in dir(module) if not n.startswith("_")):
            thing = getattr(module, name)
            home = getattr(thing, "__module__", "") or ""
            if not callable(thing) or not home.startswith("metrosep.") or id(thing) in seen:
                continue
            seen.add(id(thing))
            taken = dict(parameters_with_unit(thing))
            if taken and "Examples" in (inspect.getdoc(thing) or ""):
                marks = () if name in MENDED else (pytest.mark.slow,)
                yield pytest.param(module, name, taken, id=f"{package}.{name}", marks=marks)


def call_of_example(module, name, monkeypatch):
    """Return the first call of a callable that its own example makes."""
    thing, calls = getattr(module, name), []

    def recorded(*args, **keywords):
        calls.append((args, keywords))
        return thing(*args, **keywords)

    monkeypatch.setattr(module, name, recorded)
    names = {**vars(sys.modules[thing.__module__]), name: recorded}
    for example in doctest.DocTestParser().get_examples(inspect.getdoc(thing)):
        with contextlib.suppress(Exception), contextlib.redirect_stdout(io.StringIO()):
            exec(compile(example.source, name, "single"), names)  # noqa: S102
        if calls:
            return thing, *calls[0]
    return None


def error_of(call):
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        with contextlib.redirect_stdout(io.StringIO()):
            try:
                call()
            except Exception as exc:
                return exc
    return None


@pytest.mark.parametrize(("module", "name", "taken"), [*walked()])
def test_units_are_taken_and_other_things_refused(module, name, taken, monkeypatch):
    recorded = call_of_example(module, name, monkeypatch)
    if recorded is None:
        pytest.skip("its example does not call it: a result")
    thing, args, keywords = recorded
    signature = inspect.signature(thing)
    given = signature.bind(*args, **keywords).arguments

    def with_value(parameter, value):
        bound = signature.bind(*args, **keywords)
        bound.arguments[parameter] = value
        return error_of(lambda: thing(*bound.args, **bound.kwargs))

    wrong = []
    for parameter, unit in taken.items():
        if f"{name}.{parameter}" in OTHERWISE or parameter not in signature.parameters:
            continue
        value = given.get(parameter, signature.parameters[parameter].default)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        value = value if is_number and np.isfinite(value) else USUAL[unit]
        plain, text = (with_value(parameter, v) for v in (value, TYPED[unit](value)))
        if text is not None and (type(text), str(text)) != (type(plain), str(plain)):
            wrong.append(f"{parameter} = {TYPED[unit](value)!r}: {text!r}")
        for what, bad in REFUSED.items():
            error = with_value(parameter, bad)
            if not isinstance(error, MetrosepError):
                wrong.append(f"{parameter}, {what}: {error!r}")
    assert not wrong, "\n".join(wrong)


def test_methods_and_budget_lines_take_a_unit_too():
    line = metrosep.parameters.nonlinearity_line
    assert line(1e-3, "50 um").value == line(1e-3, 50e-6).value
    rows = np.random.default_rng(3).normal(size=(2, 3, 12)) * 1e-6
    angle = np.arange(12) * np.pi / 6
    donaldson = metrosep.separation.donaldson
    made = [donaldson(*rows, angle=angle, u_reading=u) for u in ("2 nm", 2e-9)]
    assert made[0] == made[1]
    with pytest.raises(MetrosepError, match="no unit"):
        donaldson(*rows, angle=angle, u_reading="2")
    limit = metrosep.parameters.psd_limit("A = 0.02 um^3, B = 2 from 0.1 mm to 5 mm")
    with pytest.raises(MetrosepError, match="low"):
        limit.mean_square("3", 1e4)
