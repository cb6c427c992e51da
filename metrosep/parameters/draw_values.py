"""Values by name of a drawn profile or map: every symbol of the tables, and parameters of form fits.

A Monte Carlo evaluates these on each draw. Names of several families go together, so that one draw
serves all of them and their correlation is that of the measurement.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.parameters.symbol_units import unit_of_symbol
from metrosep.spectral.dft import symbols

__all__ = ["Evaluated", "evaluated_names"]

Evaluated = Callable[[Profile | Surface], dict[str, float]]

_INTERFEROMETRIC = ("PV", "RMS", "PVr", "PVq", "PV20")
_FORM = {"STR": "straightness", "FLT": "flatness", "RON": "roundness"}


def evaluated_names(
    names: Sequence[str], obj: Profile | Surface, options: Mapping[str, Any]
) -> Evaluated:
    """Return what evaluates names such as ``Rdq``, ``Smr(0.5 um)``, ``FLTt`` or ``sphere.R``.

    `options` are those of the parameter tables (edition, sections, ...). Names are checked against
    the object here, before anything is drawn.
    """
    groups: dict[str, list[str]] = {}
    for name in symbols(names):
        groups.setdefault(_family(name, obj), []).append(name)
    evaluators = [_evaluator(family, of, options) for family, of in groups.items()]

    def evaluate(drawn: Profile | Surface) -> dict[str, float]:
        found: dict[str, float] = {}
        for one in evaluators:
            found |= one(drawn)
        return {name: found[name] for name in names}

    return evaluate


def _family(name: str, obj: Profile | Surface) -> str:
    form, dot, _ = name.partition(".")
    if dot and "(" not in form:
        return f"form:{form}"
    if name[:3] in _FORM and unit_of_symbol(name) is not None:
        return name[:3]
    if isinstance(obj, Surface):
        return "interferometric" if name in _INTERFEROMETRIC else "S"
    plain = name in ("Mr1", "Mr2", "A1", "A2") or name.startswith("tp(")
    if not plain and name[:1] not in ("P", "W", "R"):
        raise DataError(f"a profile has no parameter {name!r}")
    return "R" if plain else name[0]


def _evaluator(family: str, names: Sequence[str], options: Mapping[str, Any]) -> Evaluated:
    if family.startswith("form:"):
        return partial(_of_form, form=family[5:], names=names)
    return partial(_of_table, family=family, names=names, options=options)


def _of_form(obj: Profile | Surface, *, form: str, names: Sequence[str]) -> dict[str, float]:
    from metrosep.forms import fit
    from metrosep.forms.catalogue import form_from_text

    found = fit(obj, form_from_text(form))
    known: dict[str, float] = {**found.params, "rms": found.rms, "pv": found.peak_to_valley}
    values = {}
    for name in names:
        parameter = name.partition(".")[2]
        if parameter not in known:
            raise DataError(f"{name}: a fit of the {form} gives {', '.join(known)}")
        values[name] = float(known[parameter])
    return values


def _of_table(
    obj: Profile | Surface, *, family: str, names: Sequence[str], options: Mapping[str, Any]
) -> dict[str, float]:
    from metrosep.parameters import (
        areal_parameters,
        form_deviation,
        interferometric_parameters,
        profile_parameters,
    )

    given: dict[str, Any] = dict(options)
    table: Any
    if family in _FORM:
        kind: Any = _FORM[family]
        table = form_deviation(obj, kind=kind).table
    elif family == "interferometric" and isinstance(obj, Surface):
        table = interferometric_parameters(obj, names=names)
    elif isinstance(obj, Surface):
        table = areal_parameters(obj, names=names, **given)
    else:
        letter: Any = family
        table = profile_parameters(obj, kind=letter, names=names, **given)
    return {name: float(table[name].value) for name in names}
