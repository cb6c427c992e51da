"""Names of the rigid-body freedoms, and which parameters a fit may move.

``piston`` moves the form along z, ``shift_x`` and ``shift_y`` across it, ``tilt_x`` and ``tilt_y``
are the slopes dz/dx and dz/dy of its base plane, ``rotation_z`` turns it about its own axis
(counter-clockwise seen from +z).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core.errors import DataError
from metrosep.core.numbers import is_real
from metrosep.forms.base import Form

__all__ = ["RIGID", "Freedoms", "choose_freedoms"]

RIGID = {
    "piston": "m",
    "tilt_x": "rad",
    "tilt_y": "rad",
    "shift_x": "m",
    "shift_y": "m",
    "rotation_z": "rad",
}
"""Rigid-body freedoms and their units."""

DEFAULT = ("piston", "tilt_x", "tilt_y")

_ALIASES = {
    "dz": "piston",
    "z0": "piston",
    "tx": "tilt_x",
    "ty": "tilt_y",
    "dx": "shift_x",
    "x0": "shift_x",
    "decentre_x": "shift_x",
    "decenter_x": "shift_x",
    "dy": "shift_y",
    "y0": "shift_y",
    "decentre_y": "shift_y",
    "decenter_y": "shift_y",
    "rz": "rotation_z",
    "clocking": "rotation_z",
}


@dataclass(frozen=True, slots=True)
class Freedoms:
    """What a fit moves and what it holds."""

    rigid: tuple[str, ...]  # free rigid-body freedoms, in the order of `RIGID`
    shape: tuple[str, ...]  # free parameters of the form, in its order
    # mapping of str to float: rigid-body freedoms held at a value other than zero
    held: Mapping[str, float]
    notes: tuple[str, ...] = ()  # what the caller should know
    # what was asked for and is held, since the points do not determine it
    warnings: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All free parameters, rigid ones first."""
        return (*self.rigid, *self.shape)


def choose_freedoms(
    form: Form, free: Sequence[str] | None, fixed: Mapping[str, float], *, is_profile: bool
) -> tuple[Form, Freedoms]:
    """Return the form with its fixed values, and what is free."""
    held = known_values(fixed, form, "fixed")
    unknown = [k for k, v in form.parameters.items() if v is None and k not in held]
    is_open = form.is_linear and bool(unknown)
    asked = _asked(form, free, default=() if is_open and form.spanned else DEFAULT)
    if is_profile:
        across = [n for n in asked if n in ("tilt_y", "shift_y", "rotation_z")]
        if free is not None and across:
            raise DataError(
                f"a profile is the line y = 0 and has no {', '.join(across)}; leave it out of free"
            )
        asked = [n for n in asked if n not in across]
    if free is None:  # what is held gives way for nothing that was not asked for
        asked = [n for n in asked if n not in held]
    both = [n for n in asked if n in held]
    if both:
        raise DataError(f"{', '.join(both)} is free and fixed at once; name it once")
    values = {k: v for k, v in held.items() if k in form.parameters}
    shape = tuple(k for k in form.parameters if k in asked or k in unknown)
    spanned = form.spanned if is_open else frozenset()
    rigid = tuple(n for n in RIGID if n in asked and n not in spanned)
    dropped = [n for n in asked if n in spanned]
    notes = (
        (f"{', '.join(dropped)} is part of {form.name}: its coefficients hold it",)
        if dropped
        else ()
    )
    rest = {k: v for k, v in held.items() if k in RIGID}
    return (form.with_parameters(**values) if values else form), Freedoms(
        rigid, shape, rest, notes
    )


def known_values(values: Mapping[str, float], form: Form, option: str) -> dict[str, float]:
    """Return values by the proper name of each freedom."""
    if not isinstance(values, Mapping):
        raise DataError(
            f"{option} maps names to values in SI, such as {{'R': 0.05}}; got {values!r}"
        )
    found: dict[str, float] = {}
    for name, value in values.items():
        key = _known(name, form)
        if key in found:
            raise DataError(f"{option} holds {key} twice, by two of its names")
        number = float(value) if is_real(value) else float("nan")
        if not np.isfinite(number):
            raise DataError(f"{option}[{name!r}] is {value!r}; give a finite number in SI")
        found[key] = number
    return found


def _asked(form: Form, free: Sequence[str] | None, default: tuple[str, ...]) -> list[str]:
    if free is None:
        return list(default)
    if not isinstance(free, str | Iterable):
        raise DataError(f"free is a list of names, got {free!r}")
    names = [_known(n, form) for n in ((free,) if isinstance(free, str) else free)]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise DataError(f"{', '.join(twice)} stands twice in free")
    return names


def _known(name: str, form: Form) -> str:
    if not isinstance(name, str):
        raise DataError(f"a freedom is named by a text, got {name!r}")
    if name in form.parameters or name in RIGID:
        return name
    if name in _ALIASES:
        return _ALIASES[name]
    names = ", ".join((*RIGID, *form.parameters))
    raise DataError(f"{form.name} has no freedom {name!r}; there are: {names}")
