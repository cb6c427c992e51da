"""Steps that take one map or profile through mask, outliers, form, filter and parameters.

The workbench, recipes and scripts share this: `run_steps` carries a list of steps out, `schema`
tells everything from which a form for them can be made.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from metrosep.core.errors import InvalidSamplesError, MetrosepError
from metrosep.core.options import Option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.recipe import pipeline_checks as keys
from metrosep.recipe.pipeline_checks import CHECKS, StepError, described_keys, normal_values
from metrosep.recipe.pipeline_mask import Measured
from metrosep.recipe.pipeline_steps import APPLY, Done
from metrosep.recipe.schema import Place

__all__ = [
    "STEPS",
    "CancelledError",
    "PipelineOp",
    "Stage",
    "StepError",
    "checked_step",
    "measuring_steps",
    "run_step",
    "run_steps",
    "schema",
]

Tell = Callable[[str], None]


class CancelledError(MetrosepError):
    """The caller asked to stop; nothing is kept of the step that was not begun."""


@dataclass(frozen=True, slots=True)
class PipelineOp:
    """One kind of step."""

    op: str  # its name in a recipe
    what: str  # what it does, in plain words
    # mapping of str to Option: without ``op`` and ``enabled``, which all steps have
    keys: Mapping[str, Option]
    applies: tuple[str, ...] = ("Surface", "Profile")  # kinds of objects it takes

    @property
    def fields(self) -> dict[str, Option]:
        """Every key that a recipe may hold, as `metrosep.recipe.schema` checks them."""
        return {
            "op": Option("text", required=True),
            **self.keys,
            "enabled": _ENABLED,
        }

    @property
    def help(self) -> dict[str, str]:
        """Plain words for each key."""
        return {name: key.help for name, key in self.all_keys.items()}

    @property
    def all_keys(self) -> dict[str, Option]:
        """Its keys and ``enabled``."""
        return {**self.keys, "enabled": _ENABLED}


_ENABLED = Option("flag", help="false: the step is skipped", default=True)

STEPS: Mapping[str, PipelineOp] = {
    op.op: op
    for op in (
        PipelineOp("mask", "keep an aperture: circle, ring or rectangle", keys.MASK),
        PipelineOp("outliers", "take out heights far from their neighbours", keys.OUTLIERS),
        PipelineOp("form", "fit an ideal form and keep what it leaves", keys.FORM),
        PipelineOp("filter", "keep long or short waves", keys.FILTER),
        PipelineOp("parameters", "evaluate parameters of texture and form", keys.PARAMETERS),
    )
}


@dataclass(frozen=True, slots=True)
class Stage:
    """A step that was carried out, or skipped.

    Parameters
    ----------
    op : str
        Its kind.
    index : int
        Its number in the list, from 0.
    enabled : bool
        Whether it was carried out.
    obj : Surface or Profile
        After the step.
    found : mapping of str to Quantity
        What it found, by symbol: parameters, or free parameters of a form with ``residual.pv``
        and ``residual.rms``.
    messages : tuple of str
        What the user should know.
    seconds : float, s
        How long it took.
    audit : mapping
        What was done, plain values, SI.
    detail : object
        `FitResult` of a form, tuple of `ParameterTable` of parameters, else None.
    history : tuple of Step
        What the step adds to the provenance.
    """

    op: str
    index: int
    enabled: bool
    obj: Measured
    found: Mapping[str, Quantity] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    seconds: float = 0.0
    audit: Mapping[str, Any] = field(default_factory=dict)
    detail: Any = None
    history: tuple[Step, ...] = ()


def schema() -> dict[str, Any]:
    """Return everything from which a form for the steps can be made.

    Returns
    -------
    dict
        Plain values for JSON: ``steps``, a list of ``op``, ``what``, ``applies`` and ``keys``;
        each key with ``name``, ``kind``, ``required``, ``choices``, ``default``, ``dimension``
        (length, angle ... or None), ``help`` and, of a table, ``keys``.

    Examples
    --------
    >>> [s["op"] for s in schema()["steps"]]
    ['mask', 'outliers', 'form', 'filter', 'parameters']
    """
    return {
        "steps": [
            {
                "op": op.op,
                "what": op.what,
                "applies": list(op.applies),
                "keys": described_keys(op.all_keys),
            }
            for op in STEPS.values()
        ]
    }


def checked_step(step: Mapping[str, Any]) -> dict[str, Any]:
    """Return a step with its values in SI, or refuse it.

    Examples
    --------
    >>> checked_step({"op": "filter", "cutoff": "0.5 mm", "band": "long"})["cutoff"]
    0.0005
    """
    op = step.get("op")
    if not isinstance(op, str) or op not in STEPS:
        raise StepError(f"a step has op = one of {', '.join(STEPS)}, got {op!r}", "op")
    given = {k: v for k, v in step.items() if k != "op"}
    values = {"op": op, **normal_values(given, STEPS[op].all_keys, f"a step {op}")}
    CHECKS[op](values)
    return values


def measuring_steps(
    steps: Sequence[Mapping[str, Any]], place_of: Callable[[int], Place]
) -> tuple[Mapping[str, Any], ...]:
    """Return the steps of a recipe that measures, checked one against its keys."""
    checked = []
    for i, step in enumerate(steps):
        place = place_of(i)
        if step["op"] not in STEPS:
            raise place.error(
                f'op = "{step["op"]}" does not go with steps that measure one map or profile '
                f"({', '.join(STEPS)}); put it into a recipe of its own",
                "op",
            )
        try:
            checked.append(freeze_mapping(checked_step(step)))
        except StepError as exc:
            raise place.error(f"step {i + 1} ({step['op']}): {exc}", exc.key) from None
    if not any(step.get("enabled", True) for step in checked):
        raise place_of(0).error("every step is switched off; enable one", "enabled")
    return tuple(checked)


def run_step(obj: Measured, step: Mapping[str, Any], *, index: int = 0) -> Stage:
    """Return what one step makes of an object."""
    if not isinstance(obj, Surface | Profile):
        raise InvalidSamplesError(
            f"the steps of a measurement need a profile or a map, got a {type(obj).__name__}; name "
            "a channel, or separate it first"
        )
    options = checked_step(step)
    op = options["op"]
    if not options.get("enabled", True):
        return Stage(op, index, enabled=False, obj=obj)
    began = time.perf_counter()
    done: Done = APPLY[op](obj, options)
    history = done.obj.history[len(obj.history) :]
    if done.obj is obj:
        facts = {k: _plain(v) for k, v in options.items() if k not in ("op", "enabled")}
        history = (Step(op, facts),)
    return Stage(
        op,
        index,
        enabled=True,
        obj=done.obj,
        found=done.found,
        messages=done.messages,
        seconds=time.perf_counter() - began,
        audit=done.audit,
        detail=done.detail,
        history=history,
    )


def run_steps(
    obj: Measured,
    steps: Sequence[Mapping[str, Any]],
    *,
    upto: int | None = None,
    first: int = 0,
    cancel: Callable[[], bool] | None = None,
    tell: Tell | None = None,
) -> tuple[Stage, ...]:
    """Return what each of a list of steps makes of an object, one after the other.

    Parameters
    ----------
    obj : Surface or Profile
        Measurement, or a coarser preview of it; not changed.
    steps : sequence of mapping
        ``op`` and keys: texts with units as in a recipe, or numbers in SI.
    upto : int, optional
        How many steps of the list are carried out; all if omitted.
    first : int, optional
        Number of the first step of the list, where earlier ones were carried out before: their
        last object is `obj` then.
    cancel : callable, optional
        Asked before each step; true stops.
    tell : callable, optional
        Told what is being done.

    Returns
    -------
    tuple of Stage
        One for each step, in order; a step that is switched off passes the object on.

    Raises
    ------
    CancelledError
        If `cancel` says so.
    StepError
        If a step is not valid, or does not apply to this kind of object.
    InvalidSamplesError
        If the object is neither a map nor a profile.
    MetrosepError
        Of a filter, a fit or an evaluation.

    Notes
    -----
    On a preview each step means the same lengths, but P-V and what needs short waves differ: give
    no verdict on it. A step ``outliers`` counts its window in samples of what it is given.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.arange(4000) * 1e-6
    >>> wave = Profile(x, 50e-9 * np.cos(2 * np.pi * x / 100e-6) + 1e-4 * x)
    >>> stages = run_steps(wave, [{"op": "form", "form": "plane"},
    ...                           {"op": "parameters", "names": ["Pq"]}])
    >>> f"{stages[-1].found['Pq'].value * 1e9:.2f} nm"
    '35.36 nm'
    """
    stages: list[Stage] = []
    for number, step in enumerate(steps[: len(steps) if upto is None else upto], start=first):
        if cancel is not None and cancel():
            raise CancelledError(f"stopped before step {number + 1} ({step.get('op')})")
        if tell is not None and step.get("enabled", True):
            tell(f"step {number + 1}: {step.get('op')}")
        stages.append(run_step(stages[-1].obj if stages else obj, step, index=number))
    return tuple(stages)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
