"""Steps that take one map or profile through mask, outliers, form, filter and parameters.

The workbench, recipes and scripts share this: `run_steps` carries a list of steps out, `schema`
tells everything from which a form for them can be made.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from metrosep.core.errors import InvalidSamplesError, MetrosepError
from metrosep.core.numbers import LEAST, without_rounding
from metrosep.core.options import Option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.regions import counts_pixels, crosses_itself, not_round
from metrosep.core.surface import Surface
from metrosep.core.units import PIXEL, Pixels, format_length
from metrosep.recipe import pipeline_checks as keys
from metrosep.recipe.pipeline_checks import (
    AREAL_EDITIONS,
    CHECKS,
    SPECTRUM,
    USUAL_OF_MAPS,
    USUAL_OF_PROFILES,
    Evaluating,
    StepError,
    described_keys,
    form_options,
    iso_filtered,
    normal_values,
    parameter_tables,
)
from metrosep.recipe.pipeline_mask import Measured, masked, without_outliers
from metrosep.recipe.schema import Place

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
    def evaluates(self) -> bool:
        """Whether it leaves the map or profile as it is."""
        return self.op in keys.EVALUATING

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

MEASURING: Mapping[str, PipelineOp] = {
    op.op: op
    for op in (
        PipelineOp(
            "mask",
            "keep or exclude a region: circle, ring, rectangle, polygon or brush",
            keys.MASK,
        ),
        PipelineOp("outliers", "take out heights far from their neighbours", keys.OUTLIERS),
        PipelineOp("form", "fit an ideal form and keep what it leaves", keys.FORM),
        PipelineOp("filter", "keep long or short waves", keys.FILTER),
        PipelineOp("parameters", "evaluate parameters of texture and form", keys.PARAMETERS),
        PipelineOp("psd", "compare the spectrum with a limit, ISO 10110-8", keys.PSD),
        PipelineOp(
            "step_height", "depth of a groove or height of a ridge, ISO 5436-1", keys.STEP_HEIGHT
        ),
        PipelineOp(
            "surface_profile",
            "profile of a surface: deviation of a map from its nominal form, ISO 1101",
            keys.FORM_PROFILE,
            ("Surface",),
        ),
        PipelineOp(
            "line_profile",
            "profile of a line: deviation of a profile from its nominal form, ISO 1101",
            keys.FORM_PROFILE,
            ("Profile",),
        ),
    )
}


@dataclass(frozen=True, slots=True)
class Stage:
    """A step that was run, or skipped.

    Parameters
    ----------
    op : str
        Its kind.
    index : int
        Its number in the list, from 0.
    enabled : bool
        Whether it was run.
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
    ['mask', 'outliers', 'form', 'filter', 'parameters', 'psd', 'step_height', 'surface_profile', 'line_profile']
    """
    return {
        "steps": [
            {
                "op": op.op,
                "what": op.what,
                "evaluates": op.evaluates,
                "applies": list(op.applies),
                "keys": described_keys(op.all_keys),
            }
            for op in MEASURING.values()
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
    if not isinstance(op, str) or op not in MEASURING:
        raise StepError(f"a step has op = one of {', '.join(MEASURING)}, got {op!r}", "op")
    given = {k: v for k, v in step.items() if k != "op"}
    values = {"op": op, **normal_values(given, MEASURING[op].all_keys, f"a step {op}")}
    CHECKS[op](values)
    return values


def measuring_steps(
    steps: Sequence[Mapping[str, Any]], place_of: Callable[[int], Place]
) -> tuple[Mapping[str, Any], ...]:
    """Return the steps of a recipe that measures, checked one against its keys."""
    checked = []
    for i, step in enumerate(steps):
        place = place_of(i)
        if step["op"] not in MEASURING:
            raise place.error(
                f'op = "{step["op"]}" does not go with steps that measure one map or profile '
                f"({', '.join(MEASURING)}); put it into a recipe of its own",
                "op",
            )
        try:
            checked.append(freeze_mapping(checked_step(step)))
        except StepError as exc:
            error = place.error(f"step {i + 1} ({step['op']}): {exc}", exc.key)
            error.hints = exc.hints
            raise error from None
    if not any(step.get("enabled", True) for step in checked):
        raise place_of(0).error("every step is switched off; enable one", "enabled")
    return tuple(checked)


def lost_pixels(steps: Sequence[Mapping[str, Any]], drawn: Mapping[str, Any]) -> str:
    """Return why a step or section behind `steps` has no place; nothing where it has one.

    px are pixels of the map as it was read. A filter that cuts the rim off leaves others.
    """
    for i, step in enumerate(steps if counts_pixels(drawn) else ()):
        cuts = step["op"] == "filter" and step.get("end") == "cut"
        if cuts and step.get("enabled", True):
            return (
                f"px are pixels of the map as it was read, and step {i + 1} (filter) cuts its rim off, so that "
                'they would be others: write lengths here, or another end than "cut" there'
            )
    return ""


def run_step(
    obj: Measured,
    step: Mapping[str, Any],
    *,
    index: int = 0,
    preview: bool = False,
    before: Sequence[Mapping[str, Any]] = (),
) -> Stage:
    """Return what one step makes of what the steps `before` left; of a coarse preview without its uncertainty."""
    if not isinstance(obj, Surface | Profile):
        raise InvalidSamplesError(
            f"the steps of a measurement need a profile or a map, got a {type(obj).__name__}; "
            "separate it first, or read two columns of a text as a profile with x= and z="
        )
    options = checked_step(step)
    op = options["op"]
    if not options.get("enabled", True):
        return Stage(op, index, enabled=False, obj=obj)
    if type(obj).__name__ not in MEASURING[op].applies:
        kind, other = ("map", "surface") if isinstance(obj, Surface) else ("profile", "line")
        raise StepError(f"{op} does not belong to a {kind}; take {other}_profile", "op")
    lost = lost_pixels(before, options)
    if lost:
        raise StepError(lost, "op")
    began = time.perf_counter()
    hurried = preview and op == "form"
    done: Done = _form(obj, options, with_u=False) if hurried else APPLY[op](obj, options)
    messages = done.messages
    if options.get("intermediate", False):
        messages += (
            (
                f"intermediate: {', '.join(done.found)} are of the surface before the steps that follow, "
                "not of the one that is shown as judged"
            ),
        )
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
        messages=messages,
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
    before: Sequence[Mapping[str, Any]] = (),
    cancel: Callable[[], bool] | None = None,
    tell: Tell | None = None,
    preview: bool = False,
) -> tuple[Stage, ...]:
    """Return what each of a list of steps makes of an object, one after the other.

    Parameters
    ----------
    obj : Surface or Profile
        Measurement, or a coarser preview of it; not changed.
    steps : sequence of mapping
        ``op`` and keys: texts with units as in a recipe, or numbers in SI.
    upto : int, optional
        How many steps of the list are run; all if omitted.
    first : int, optional
        Number of the first step of the list, where earlier ones were run before: their
        last object is `obj` then.
    before : sequence of mapping, optional
        Those earlier steps.
    cancel : callable, optional
        Asked before each step; true stops.
    tell : callable, optional
        Told what is being done.
    preview : bool, optional
        `obj` is a coarse copy: fits state no uncertainty, which is that of the whole map.

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
        stages.append(
            run_step(
                stages[-1].obj if stages else obj,
                step,
                index=number,
                preview=preview,
                before=(*before, *steps[: number - first]),
            )
        )
    return tuple(stages)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


# ---- the steps that measure: what each does to one map or profile, and what it finds -----------


@dataclass(frozen=True, slots=True)
class Done:
    """What a step made."""

    obj: Measured  # or Profile: after the step; the very object where the step only evaluates
    # mapping of str to Quantity: by metric
    found: Mapping[str, Quantity] = field(default_factory=dict)
    messages: tuple[str, ...] = ()  # what the user should know
    audit: Mapping[str, Any] = field(default_factory=dict)  # mapping: what was done, plain values
    detail: Any = None  # `FitResult` of a form, tuple of `ParameterTable` of parameters, else None


def _mask(obj: Measured, options: Mapping[str, Any]) -> Done:
    result, audit = masked(obj, options["aperture"], outside=options.get("outside", True))
    where = audit["region"]
    if isinstance(obj, Profile):
        where = f"about {format_length(audit['centre_m'][0])}"
    messages = [
        f"mask, {where}: {audit['taken_out']} measured heights removed, {audit['left']} left"
    ]
    if audit.get("pixels"):
        messages.append(f"mask: {audit['pixels']}")
    points = options["aperture"].get("points", ())
    if options["aperture"]["shape"] == "polygon" and crosses_itself(points):
        messages.append(
            "mask: the polygon crosses itself; what lies in an even number of its loops is outside"
        )
    return Done(result, messages=tuple(messages), audit=audit)


def _outliers(obj: Measured, options: Mapping[str, Any]) -> Done:
    given = {k: v for k, v in options.items() if k in ("threshold", "window", "form")}
    result, audit = without_outliers(obj, **given)
    n, measured = audit["taken_out"], audit["taken_out"] + audit["left"]
    text = (
        f"outliers: {n} of {measured} measured heights removed (robust sigma "
        f"{format_length(audit['sigma_m'])}); nothing is filled"
    )
    messages = [text]
    if audit["not_judged"]:
        messages.append(
            f"outliers: {audit['not_judged']} heights at an edge or a gap have no opposite "
            "neighbours and were not judged; a smaller aperture removes the rim"
        )
    return Done(result, messages=tuple(messages), audit=audit)


def _form(obj: Measured, options: Mapping[str, Any], *, with_u: bool = True) -> Done:
    from metrosep.forms.fit import fit

    ideal, rest = form_options(options)
    if isinstance(obj, Surface) and None in (obj.dx, obj.dy):
        return _over_pixels(obj, ideal, rest)
    result = fit(obj, ideal, **rest)
    left = result.residual
    assert isinstance(left, Surface | Profile)  # noqa: S101  # as obj is
    name = result.form.name
    u = result.u if with_u else dict.fromkeys(result.u_white, math.nan)
    dof = result.dof_effective if with_u else math.nan
    guard = {k: v for k, v in result.guard.items() if np.isfinite(v)} if with_u else {}
    least = _sizes(obj)
    found = {
        k: Quantity(
            without_rounding(result.params[k], least.get(result.units[k], 0.0)),
            result.units[k],
            f"{k.replace('_', ' ')} of the fitted {name}",
            u=float(v) if np.isfinite(v) else None,
            symbol=k,
            dof=dof if np.isfinite(dof) else None,
            u_source="fit residual",
            guard=guard.get(k),
        )
        for k, v in u.items()
    }
    found |= _left_by(name, result)
    messages = [*result.found_warnings, *result.notes]
    if with_u:
        messages = [*result.warnings, *result.notes, *([result.assumption] if u else [])]
    lost = left.n_invalid - obj.n_invalid
    if lost:
        messages.append(f"{lost} measured heights lie where the {name} has no value")
    return Done(left, found, tuple(messages), result.to_dict() if with_u else {}, result)


def _sizes(obj: Measured) -> dict[str, float]:
    """Return of a height, an inclination and a curvature what the largest height makes of them, by unit."""
    size = max(abs(float(of.reduce(obj.z, axis=None))) for of in (np.fmin, np.fmax))
    size = max(size, LEAST)  # a form of zeros has parameters of 1e-120
    if isinstance(obj, Profile):
        across = float(np.ptp(obj.x))
    else:
        across = math.hypot(
            *((n - 1) * (d or 0.0) for n, d in zip(obj.shape, (obj.dy, obj.dx), strict=True))
        )
    if not across > 0.0:
        return {"m": size}
    return {"m": size, "rad": size / across, "1/m": size / across**2}


def _left_by(name: str, result: Any) -> dict[str, Quantity]:
    """Return P-V and RMS of what a form leaves."""
    text = f"of what the {name} leaves, before any further step"
    return {
        "residual.pv": Quantity(result.peak_to_valley, "m", f"P-V {text}", symbol="PV residual"),
        "residual.rms": Quantity(result.rms, "m", f"RMS {text}", symbol="RMS residual"),
    }


def _over_pixels(obj: Surface, ideal: Any, rest: Mapping[str, Any]) -> Done:
    """Return a map without scale less a form that needs none; its parameters would be per pixel."""
    from metrosep.forms.fit import over_pixels

    result, name = over_pixels(obj, ideal, **rest), ideal.name
    facts = {"form": name, "over": PIXEL, "n_points": result.n_points}
    facts |= {"rms_m": result.rms, "pv_m": result.peak_to_valley}
    lost = "inclination is" if name == "plane" else "coefficients are"
    messages = [
        *result.found_warnings,
        (
            f"the {name} is fitted over pixels, whatever their size is; its {lost} not known, as the file "
            "does not say how large they are"
        ),
    ]
    found, left = _left_by(name, result), result.residual
    assert isinstance(left, Surface)  # noqa: S101  # as obj is
    return Done(left, found, tuple(messages), {**facts, "parameters": {}})


def _filter(obj: Measured, options: Mapping[str, Any]) -> Done:
    kind = options.get("kind", "gaussian")
    if isinstance(obj, Surface):
        for key in ("profile", "sections", "core_filter"):
            if key in options:
                raise StepError(f"{key} belongs to profiles, and this is a map", key)
    if "lambda_s" in options or "lambda_c" in options:
        result = iso_filtered(
            obj,
            lambda_s=options.get("lambda_s"),
            lambda_c=options.get("lambda_c"),
            end=options.get("end", "moment"),
            kind=options.get("profile"),
            sections=options.get("sections"),
            core_filter=options.get("core_filter", "gaussian"),
            stop=options.get("band") == "stop",
        )
    else:
        result = _one_cutoff(obj, kind, options)
    shape: Any = result.z.shape
    messages = []
    if options.get("band") == "stop":
        messages.append(_edges_of_band(obj, options))
    if shape != obj.z.shape:
        messages.append(
            f"filter: the ends were cut, {obj.z.size - result.z.size} samples are gone"
        )
    elif result.n_invalid > obj.n_invalid:
        messages.append(
            f"filter: {result.n_invalid - obj.n_invalid} heights have too few measured ones within "
            "the cut-off and were removed"
        )
    return Done(result, messages=tuple(messages), audit={"left": result.z.size - result.n_invalid})


def _edges_of_band(obj: Measured, options: Mapping[str, Any]) -> str:
    """Return what a filter that takes a band out left, and where."""
    from metrosep.filters import band_edges

    edges = band_edges(obj, shortest=options["lambda_s"], longest=options["lambda_c"])
    low, high, shorter, longer = map(format_length, edges)
    longest = "" if math.isinf(edges.longer) else f" and longer than {longer}"
    missing = ""
    if obj.n_invalid:
        share = 100.0 * obj.n_invalid / obj.z.size
        missing = f"; {share:.2g} % of the samples are missing, so that these may keep less"
    return (
        f"filter: waves of {low} to {high} were removed: less than 5 % of the amplitude of each is left "
        f"over the whole, more within a wavelength of the ends; waves shorter than {shorter}{longest} "
        f"keep at least 95 %, those between a part{missing}"
    )


def _one_cutoff(obj: Measured, kind: str, options: Mapping[str, Any]) -> Any:
    from metrosep import filters

    name = {"robust": "robust_gaussian"}.get(kind, kind)
    keys = ("band", "end", "order", "tension", "refilter", "radius", "length")
    rest = {k: options[k] for k in keys if k in options}
    if "cutoff" in options:
        rest["nesting_index" if isinstance(obj, Surface) else "cutoff"] = options["cutoff"]
    return getattr(filters, name)(obj, **rest)


_OF_PROFILES = ("kind", "edition", "sections", "centre")


def _parameters(obj: Measured, options: Mapping[str, Any]) -> Done:
    if isinstance(obj, Surface):
        for key in _OF_PROFILES:
            if options.get(key) and not (key == "edition" and options[key] in AREAL_EDITIONS):
                raise StepError(f"{key} belongs to profiles, and this is a map", key)
    elif options.get("edition") in AREAL_EDITIONS:
        raise StepError(f"{options['edition']} belongs to maps, and this is a profile", "edition")
    settings = {k: v for k, v in options.items() if k in (*_OF_PROFILES, "line", "reference")}
    names = options.get("names")
    asked = usual_names(obj, options.get("kind")) if names is None else tuple(names)
    if "all" in asked:
        asked = ()
    tables = parameter_tables(obj, Evaluating(names=asked, **settings))
    found = {symbol: quantity for table in tables for symbol, quantity in table.items()}
    messages = [note for table in tables for note in table.context.notes]
    messages += [
        f"{s} is not available: {why}" for t in tables for s, why in t.unavailable.items()
    ]
    contexts = [t.to_dict() for t in tables]
    audit = {
        "evaluations": [
            {k: t[k] for k in ("edition", "n_valid", "n_total", "chain", "settings")}
            for t in contexts
        ],
        "unavailable": {s: why for t in contexts for s, why in t["unavailable"].items()},
    }
    return Done(obj, found, tuple(dict.fromkeys(messages)), audit, tables)


def _psd(obj: Measured, options: Mapping[str, Any]) -> Done:
    from metrosep.parameters.psd_limits import judge_psd, psd_limit
    from metrosep.spectral.masked import masked_psd

    keys = ("detrend", "max_filled", "estimate")
    spectrum = masked_psd(obj, **{k: options[k] for k in keys if k in options})
    found = judge_psd(spectrum, psd_limit(options["limit"]))
    ratio = Quantity(
        found.worst.ratio,
        "1",
        f"largest ratio of the spectrum to its limit, {found.limit.text}",
        symbol=SPECTRUM,
    )
    bands = [
        {"wavelength_m": [1.0 / b.high, 1.0 / b.low], "mean": b.mean, "limit": b.limit,
         "ratio": b.ratio, "independent_values": b.n_independent, "verdict": b.verdict}
        for b in found.bands
    ]  # fmt: skip
    audit = {
        "direction": found.direction,
        "filled_share": spectrum.filled_share,
        "lost_share": spectrum.lost_share,
        "holes": spectrum.holes,
        "estimate": spectrum.estimate,
        "bands": bands,
    }
    return Done(obj, {SPECTRUM: ratio}, (found.sentence, *found.notes), audit, found)


def _step_height(obj: Measured, options: Mapping[str, Any]) -> Done:
    from metrosep.filters import profile_kind
    from metrosep.parameters.grooves import step_height

    if isinstance(obj, Profile):
        if "axis" in options:
            raise StepError("axis belongs to maps, and this is a profile: leave it out", "axis")
        letter = profile_kind(obj)
        if letter in ("R", "W"):
            raise StepError(
                f"this profile is filtered ({letter}), which changes a step; take it as measured",
                "op",
            )
    found = step_height(
        obj,
        **{k: v for k, v in options.items() if k in keys.STEP_HEIGHT and k != "intermediate"},
    )
    no_scale = isinstance(obj, Surface) and None in (obj.dx, obj.dy)
    counted = no_scale or isinstance(options.get("width"), Pixels)
    audit = {
        "type": found.kind,
        "height_m": found.height,
        "slope_m_per_px" if counted else "slope": found.slope,
        "n_used": found.n_used,
        "rms_m": found.rms,
        "degree": options.get("degree", 1),
    }
    what = f"{'groove' if found.height < 0.0 else 'ridge'} of type {found.kind}"
    if found.kind == "regions":
        what = "upper region over the lower one"
    text = (
        f"{what}: {found.n_used} samples in its ranges, RMS {format_length(found.rms)} about the fit; u from what the fit leaves, its "
        "correlation counted; scale and reference of the instrument are not in it"
    )
    round_ = [
        f"step_height: {note}"
        for key in ("upper", "lower")
        if isinstance(obj, Surface)
        and isinstance(options.get(key, {}).get("diameter"), Pixels)
        and (note := not_round(obj, f"the {options[key]['shape']} {key}"))
    ]
    values = {"d": found.to_quantity(), "h": found.to_quantity(signed=True)}
    return Done(obj, values, (text, *found.messages, *round_), audit, found)


def _form_profile(obj: Measured, options: Mapping[str, Any]) -> Done:
    from metrosep.forms.points import points_of
    from metrosep.parameters.geometry import surface_profile

    ideal, rest = form_options(options)
    points = points_of(obj, centre=rest.get("centre"), middle=True)
    parts = [np.stack(block, axis=1) for block in points.valid_blocks()]
    xyz, is_line = np.concatenate(parts), isinstance(obj, Profile)
    if is_line and getattr(ideal, "angle", None) == 0.0:  # a cylinder is level along its axis
        raise StepError(
            "the axis of the cylinder lies along the profile (angle 0), so its nominal is a straight "
            "line: give angle=90 deg, or take plane",
            "form",
        ).hinting(form="plane")
    fixed = options.get("datum", "none") == "frame"
    found = surface_profile(xyz, ideal, datum=fixed, what="line" if is_line else "surface")
    u = options.get("u_reading")
    # t = 2 |d| of one point; of a minimax fit 2 sum(w d) over its support, the weights |w| add up to 1
    value = found.to_quantity(u=None if u is None else 2.0 * u, u_source="u_reading of one height")
    x0, y0 = points.centre
    at = xyz[found.support[0]] + (x0, y0, 0.0)
    where = (
        format_length(at[0]) if is_line else f"({format_length(at[0])}, {format_length(at[1])})"
    )
    messages = [
        *points.notes,
        f"{found.definition}: {found.association}; largest at {where}, {len(xyz)} points",
    ]
    if u is not None:
        messages.append(
            "u is that of the point (fitted: points) that holds the value; noise of the readings also "
            "lifts a largest deviation, and a filter before this step lowers it"
        )
    audit = {"n_points": len(xyz), "association": found.association, "form": ideal.name}
    return Done(obj, {"t": value}, tuple(messages), audit, found)


def usual_names(obj: Measured, kind: str | None = None) -> tuple[str, ...]:
    """Return the parameters that are evaluated where none are named."""
    if isinstance(obj, Surface):
        return USUAL_OF_MAPS
    from metrosep.filters import profile_kind

    letter = kind or profile_kind(obj) or "P"
    return tuple(f"{letter}{s}" for s in USUAL_OF_PROFILES)


APPLY: Mapping[str, Callable[[Measured, Mapping[str, Any]], Done]] = {
    "mask": _mask,
    "outliers": _outliers,
    "form": _form,
    "filter": _filter,
    "parameters": _parameters,
    "psd": _psd,
    "step_height": _step_height,
    "surface_profile": _form_profile,
    "line_profile": _form_profile,
}
