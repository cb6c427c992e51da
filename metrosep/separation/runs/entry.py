"""`separate`: one name for every method that separates repeated runs, and both directions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, cast, overload

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import (
    DataError,
    FitError,
    InvalidSamplesError,
    NotSeparableError,
    OptionError,
    SeparationError,
    TooFewSamplesError,
)
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.runset import RunSet
from metrosep.core.units import format_length
from metrosep.separation.runs.base import (
    ErrorEstimate,
    SampledCurve,
)
from metrosep.separation.runs.design import evaluation_range, probe_names
from metrosep.separation.runs.displaced import DISPLACED
from metrosep.separation.runs.evidence import (
    SLOW_SAID,
    SURELY,
    lost_below,
    said_apart,
    said_lag,
)
from metrosep.separation.runs.forensics import Named, RunChecks, check_runs
from metrosep.separation.runs.fourier import separate_kono
from metrosep.separation.runs.joint import DRIFT_SAID, GAIN_SAID, separate_joint
from metrosep.separation.runs.leave_out import scatter_of_places
from metrosep.separation.runs.mean import level_in_the_middle, separate_mean
from metrosep.separation.runs.options import RUN_OPTIONS, in_si, metres

_METHODS = ("joint", "kono", "mean")
_OWN = ("method", "start", "length", "shortest", "lag", "exclude", "accept")
"""Options that `separate` takes by itself."""

_MOST_NAMED = 4
"""Findings that an error message spells out."""

_NAMES = {1: "forward", -1: "reverse"}


@overload
def separate(
    runs: RunSet,
    *,
    method: Literal["joint", "kono", "mean"] = "joint",
    length: float | str | None = None,
    start: float | str | None = None,
    shortest: float | str | None = None,
    lag: float | str = "auto",
    exclude: Named | None = None,
    accept: Named | None = None,
    **options: Any,
) -> ErrorEstimate: ...
@overload
def separate(runs: Any, *, method: str, **options: Any) -> Any: ...
def separate(
    runs: Any,
    *,
    method: str = "joint",
    length: float | str | None = None,
    start: float | str | None = None,
    shortest: float | str | None = None,
    lag: float | str = "auto",
    exclude: Named | None = None,
    accept: Named | None = None,
    **options: Any,
) -> Any:
    """Return the repeatable geometric error of an axis from repeated runs, or what another method makes.

    Parameters
    ----------
    runs : RunSet
        Runs at one or, better, several feedrates, in one or both directions. For another method
        what it reads: an array, a sequence or a mapping of readings, profiles, maps, columns by
        their role, or results.
    method : str, optional
        "joint": generalised least squares over all runs; "kono": Kono's Fourier method to the
        letter; "mean": the plain mean. Or one of the methods that ``metrosep ops`` lists, such as
        "donaldson": everything else is then an option of that method, and the result is its own. An option
        that is itself called method is given as ``method_``.
    length, start : float, m, optional
        Evaluation range: its length and where it begins. The common travel (for "kono" its flat
        part under the window) if both are omitted; centred in it if only the length is given.
    shortest : float, m, optional
        Shortest wavelength of the model; chosen from the data if omitted.
    lag : float, "auto" or "fit", s, optional
        Delay of the reading against the position. "joint" tests for it in every fit: "auto"
        corrects what the runs show, a number is taken as stated and what is found beside it is
        said, "fit" fits it in any case. A lag can be found where lag times the difference of the
        feedrates stays below half the strongest wavelength. The other methods say what they see.
    exclude : "suspect", str or sequence of str, optional
        Runs that are omitted: names (``.runs["run"]``), or all in which `check_runs` finds a fault.
    accept : "suspect", str or sequence of str, optional
        Runs that are kept although they are refused.
    **options
        Of the method: "joint" min_feeds, false_discovery_rate, drift, lines, line_phase,
        false_alarm, robust, following, following_waves, probes, probe_gain, waves, slip,
        position_offsets, position_reference; "kono" sigma_t, p_t, norm, taper_fraction, taper, rule, modelling_length, values, feed, averaging,
        ddof, relative, min_coherence, coefficients; "mean" feed, robust.
        ``metrosep ops separate`` describes each of them.

    Returns
    -------
    ErrorEstimate
        Error, uncertainty, spectrum, residual, audit, messages, and the checks of the ``runs``. Where the runs go both ways,
        each direction is estimated apart and `lost_motion` is their mean offset.

    Raises
    ------
    DataError
        If the method or an option is unknown, a number is text, a lag is stated for a method
        without time, or `exclude` or `accept` names no run.
    NotSeparableError
        If the runs cannot tell geometry from vibration (one feedrate only).
    InvalidSamplesError, NotUniformError, TooFewSamplesError, UnitError
        If a run is stuck, saturated, given twice or of another gain (`check_runs`), or the runs or the ranges cannot be used; the Fourier sum of "kono" does not bridge a gap
        wider than 2 % of its length.

    Examples
    --------
    >>> from metrosep.separation import machine_axis, separate
    >>> axis = machine_axis(seed=1, disturbance="none")
    >>> estimate = separate(axis.runs, start=axis.start, length=axis.stop - axis.start)
    >>> bool(abs(estimate.evaluate([20e-3]) - axis.truth([20e-3]) < 60e-9))
    True
    >>> a = 2 * np.pi * np.arange(64) / 64
    >>> readings = [5e-8 * np.cos(3 * a) + 2e-8 * np.sin(2 * a), 5e-8 * np.cos(3 * a) - 2e-8 * np.sin(2 * a)]
    >>> found = separate(readings, method="donaldson", angle=a, u_reading="1 nm", u_index="0.05 deg")
    >>> bool(abs(found.spindle - 2e-8 * np.sin(2 * a)).max() < 1e-20)
    True
    """
    if method not in _METHODS:
        from metrosep.separation.inputs import separate_named

        own = {"length": length, "start": start, "shortest": shortest, "exclude": exclude}
        own |= {"accept": accept, "lag": None if lag == "auto" else lag}
        named = {k: v for k, v in own.items() if v is not None}
        return separate_named(runs, method, {**named, **options})
    return separate_runs(
        runs, method, length, start, shortest, lag, exclude=exclude, accept=accept, options=options
    )


def separate_runs(
    runs: RunSet,
    method: str,
    length: float | str | None,
    start: float | str | None,
    shortest: float | str | None,
    lag: float | str,
    *,
    exclude: Named | None,
    accept: Named | None,
    options: dict[str, Any],
    compare: bool = True,
) -> ErrorEstimate:
    """Return what `separate` makes of runs; without `compare` they are not held against each other."""
    known = [k for k, o in RUN_OPTIONS.items() if k not in _OWN and method in (o.of or _METHODS)]
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise OptionError(
            f"method {method!r} has no option {unknown[0]!r}; it knows {', '.join(known)}"
        )
    options = {k: in_si(k, v) for k, v in options.items()}
    lag = cast("float | Literal['auto', 'fit']", in_si("lag", lag))
    _check_types(runs, lag)
    length, start = metres(length, "length"), metres(start, "start")
    shortest = metres(shortest, "shortest")
    lag = lag if isinstance(lag, str) else float(lag)
    if method != "joint" and lag not in ("auto", 0.0):
        raise DataError(
            f"method {method!r} works in space and has no lag; use method='joint'"
        ).hinting(method="joint")
    if method == "mean" and shortest is not None:
        raise DataError("method 'mean' does not filter, so it has no shortest wavelength")
    if method == "mean" and options.get("feed") is not None:
        runs = runs.select(feed=options["feed"])
    names = probe_names(runs, options.get("probes")) if method == "joint" else [""] * len(runs)
    checks = check_runs(
        runs,
        probes=names,
        spikes=not options.get("robust"),
        clocks=method == "joint",
        compare=compare,
    )
    given = runs
    runs, checks = checks.settle(runs, exclude=exclude, accept=accept)
    left_out = [
        r.sha256 for r, used in zip(given, checks.columns["used"], strict=True) if not used
    ]
    names = [n for n, used in zip(names, checks.columns["used"], strict=True) if used]
    told = {
        d: [n for n, r in zip(names, runs, strict=True) if r.direction == d]
        for d in runs.directions
    }
    odd = [
        bool(f)
        for f, u in zip(checks.columns["finding"], checks.columns["used"], strict=True)
        if u
    ]
    ways = {d: [o for o, r in zip(odd, runs, strict=True) if r.direction == d] for d in told}
    named = {d: [i for i, o in enumerate(own) if o] for d, own in ways.items()}
    try:
        common = _common_range(runs, method, start, length, options)
        options = _plain_options(options)
        parts = {
            d: _separate_one(
                runs.select(direction=d),
                method,
                common[1],
                common[0],
                shortest,
                lag,
                options
                | ({"probes": told[d]} if any(names) else {})
                | ({"named": named[d]} if method == "joint" and named[d] else {}),
            )
            for d in runs.directions
        }
    except (InvalidSamplesError, TooFewSamplesError, FitError, SeparationError) as exc:
        few = isinstance(exc, NotSeparableError)
        reasons = [_findings(checks), _too_few_feeds(runs, checks, options) if few else ""]
        if not any(reasons):
            raise
        raise type(exc)(". ".join([str(exc), *filter(None, reasons)])) from exc
    step = Step(
        "separate",
        {
            "method": method,
            "length_m": length,
            "start_m": start,
            "shortest_m": shortest,
            "lag_s": lag,
            **({} if exclude is None else {"exclude": _plain_options({"": exclude})[""]}),
            **({} if accept is None else {"accept": _plain_options({"": accept})[""]}),
            "runs_sha256": [r.sha256 for r in runs],
            **({"left_out_sha256": left_out} if left_out else {}),
            **options,
        },
    )
    history = (*runs.history, step)
    if len(parts) == 1:
        direction, part = next(iter(parts.items()))
        found = _renamed(part, {direction: part}, runs, told, history)
    else:
        found = _renamed(parts[1], parts, runs, told, history)
    return _with_checks(found, checks, runs)


def _findings(checks: RunChecks) -> str:
    """Return what is wrong with the used runs, which may be the reason of an error; empty if nothing."""
    rows = zip(*(checks.columns[k] for k in ("run", "finding", "used")), strict=True)
    found = [f"run {name} {text}" for name, text, used in rows if text and used]
    if not found:
        return ""
    return (
        f"The reason may be: {'; '.join(found[:_MOST_NAMED])}; exclude='suspect' leaves out what is "
        "named here"
    )


def _too_few_feeds(runs: RunSet, checks: RunChecks, options: Mapping[str, Any]) -> str:
    """Return which runs to leave out where one direction alone has too few feedrates; else empty."""
    least = options.get("min_feeds", 2)
    enough = {d: len(runs.select(direction=d).feeds) >= least for d in runs.directions}
    if not any(enough.values()) or all(enough.values()):
        return ""
    used = (n for n, u in zip(checks.columns["run"], checks.columns["used"], strict=True) if u)
    out = ", ".join(n for n, r in zip(used, runs, strict=True) if not enough[r.direction])
    way = next(_NAMES[d] for d, good in enough.items() if good)
    return f"The {way} runs have enough feedrates: exclude={out!r} estimates them alone"


def _with_checks(estimate: ErrorEstimate, checks: RunChecks, runs: RunSet) -> ErrorEstimate:
    """Return the estimate with its run checks; the step of coarse readings enters the band."""
    from dataclasses import replace

    used = [i for i, u in enumerate(checks.columns["used"]) if u]
    rows = [
        i for d in runs.directions for i, r in zip(used, runs, strict=True) if r.direction == d
    ]
    scores = dict(estimate.runs_data)
    checks = checks.withdrawn(scores, rows)
    # Steps of the readings are no noise that a prediction knows, and displaced feedrates no run's fault.
    if checks.step > 0.0 or checks.apart:
        scores.pop("against_others", None)
    # A displaced run that is known of has its share in what is predicted of the others.
    known = zip(checks.columns["finding"], checks.columns["used"], strict=True)
    if "against_others" in scores and any(DISPLACED in text and use for text, use in known):
        said = scores["against_others"]
        scores["against_others"] = ["" if text.startswith(DISPLACED) else text for text in said]
    columns = _with_scores(checks.columns, scores, rows)
    messages = list(checks.messages)
    messages += [
        f"run {name} {text}"
        for name, text, known in zip(
            columns["run"], columns["finding"], checks.columns["finding"], strict=True
        )
        if text and not known
    ]
    kept = [
        name
        for name, text, used in zip(*(columns[k] for k in ("run", "finding", "used")), strict=True)
        if text and used
    ]
    if kept:
        messages.append(
            f"run {', '.join(kept)}: kept, so the uncertainty does not hold where it errs; "
            "exclude='suspect' (command line: --exclude suspect) leaves out what is named above"
        )
    if estimate.method != "joint":
        messages += [_lag_sentence(estimate, runs, lag, u) for lag, u in checks.lag.values()]
        messages += _apart_sentences(estimate.method, checks, runs, used)
    parts, audit = dict(estimate.directions_data), dict(estimate.audit)
    if checks.step > 0.0:
        audit["reading_step_nm"] = checks.step * 1e9
        parts = {
            # Of no form: the covariance takes it as common to close neighbours only.
            d: replace(
                p,
                uncertainty=SampledCurve(
                    p.uncertainty.x, np.hypot(p.uncertainty.z, checks.step / math.sqrt(12.0))
                ),
            )
            for d, p in parts.items()
        }
    return replace(
        estimate,
        directions_data=parts,
        audit=audit,
        runs_data=columns,
        messages=(
            *messages,
            *_causes(estimate.messages, sound=not kept and not checks.step and not checks.apart),
        ),
    )


def _causes(messages: tuple[str, ...], *, sound: bool) -> list[str]:
    """Return the messages less those of a drift or slow noise that a fault, named already, looks like."""
    other = not sound or any(GAIN_SAID in m for m in messages)
    return [
        m for m in messages if not ((other and DRIFT_SAID in m) or (not sound and SLOW_SAID in m))
    ]


def _with_scores(
    columns: Mapping[str, list[Any]], scores: Mapping[str, list[Any]], rows: list[int]
) -> dict[str, list[Any]]:
    """Return the table of the runs with what the others predict of each; NaN for those left out.

    A run that only the prediction finds odd gets a finding: the checks before the fit compare
    curves, the prediction knows the noise as well.
    """
    out = {k: list(v) for k, v in columns.items()}
    for key, values in scores.items():
        if key != "against_others":
            out[key] = [math.nan] * len(columns["run"])
        for i, value in zip(rows, values, strict=True):
            if key != "against_others":
                out[key][i] = value
            elif value and not out["finding"][i]:
                out["finding"][i] = value
    return out


def _apart_sentences(method: str, checks: RunChecks, runs: RunSet, used: list[int]) -> list[str]:
    """Say by how much the places of the runs scatter, to a method that takes them as they are.

    What belongs to the runs shows at every feedrate; a vibration at a wavelength of the error shifts
    the runs of one. So the chance is the least of those with one feedrate left out.
    """
    table = checks.columns
    shift = np.array([table["shift_mm"][i] for i in used]) * 1e-3
    variance = (np.array([table["u_shift_mm"][i] for i in used]) * 1e-3) ** 2
    named = np.array([bool(table["finding"][i]) for i in used])
    known = np.isfinite(shift) & np.isfinite(variance) & ~named
    ways = np.array([run.direction for run in runs])
    number = {id(run): i for i, (_, own) in enumerate(runs.by_feed()) for run in own}
    feeds = np.array([number.get(id(run), -1) for run in runs])
    out = []
    for way in runs.directions:
        own = known & (ways == way)
        if own.sum() < 3:
            continue
        parts = shift[own], variance[own], np.zeros(int(own.sum())), feeds[own]
        left_out = np.unique(parts[3])
        chances = [scatter_of_places(*parts, parts[3] != f).probability for f in left_out]
        found = scatter_of_places(*parts, np.ones(int(own.sum()), dtype=bool))
        if left_out.size > 1 and min(chances) >= SURELY:
            out.append(
                f"{said_apart(found.sd)}: method={method!r} averages them where they are, and waves "
                f"shorter than {format_length(lost_below(found.sd), digits=2)} lose more than a tenth; "
                "method='joint' with position_offsets=true (command line: --method joint --set "
                "position_offsets=true) fits the place of each run"
            )
    return out


def _lag_sentence(estimate: ErrorEstimate, runs: RunSet, lag: float, u: float) -> str:
    """Say what delay the places of the waves show, to a method that cannot correct it."""
    spread = abs(lag) * (max(runs.feeds) - min(runs.feeds))
    other = (
        f" (or the runs of one feedrate start {format_length(spread, digits=2)} off: two feedrates "
        "cannot tell)"
        if len(runs.feeds) == 2
        else ""
    )
    return (
        f"readings {said_lag(lag * 1e3, '.2g')} (u {u * 1e3:.2g} ms){other}: "
        f"method={estimate.method!r} cannot correct it and its uncertainty does not hold it; "
        "method='joint' (command line: --method joint) does"
    )


def _check_types(runs: object, lag: object) -> None:
    if not isinstance(runs, RunSet):
        raise DataError(
            f"separate needs a RunSet, got {type(runs).__name__}; wrap the runs: RunSet([run, ...])"
        )
    if runs.metadata.get("unit", "m") != "m":
        raise DataError(
            "the position of the runs is an angle, and runs are separated along a length; of an axis that "
            "turns the mean of its runs makes the table (command line: metrosep table FILE --axis C "
            "--compensates C --spacing SPACING -o TABLE)"
        )
    if isinstance(lag, str) and lag in ("auto", "fit"):
        return
    if isinstance(lag, bool) or not isinstance(lag, int | float | np.integer | np.floating):
        raise DataError(f"lag is a number in seconds, 'auto' or 'fit', got {lag!r}")


def _plain_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return lists and Python numbers, which the JSON of the history can hold."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        if isinstance(value, tuple | list):
            return [plain(v) for v in value]
        return value

    return {k: plain(v) for k, v in options.items()}


def _common_range(
    runs: RunSet,
    method: str,
    start: float | None,
    length: float | None,
    options: Mapping[str, Any],
) -> tuple[float | None, float | None]:
    """Return start and length that both directions share: each alone would centre its own."""
    if len(runs.directions) == 1:
        return start, length
    first, last = evaluation_range(runs, start=start, length=length, method=method)
    if method == "kono" and start is None and length is None:
        low, high = runs.common_travel
        l_x = options.get("modelling_length") or high - low
        half = (0.5 - options.get("taper_fraction", 0.1)) * l_x
        first, last = (low + high) / 2.0 - half, (low + high) / 2.0 + half
        return (first, last - first) if last > first else (start, length)
    return first, last - first


def _separate_one(
    runs: RunSet,
    method: str,
    length: float | None,
    start: float | None,
    shortest: float | None,
    lag: float | Literal["auto", "fit"],
    options: dict[str, Any],
) -> ErrorEstimate:
    if method == "joint":
        return separate_joint(
            runs, length=length, start=start, shortest=shortest, lag=lag, **options
        )
    if method == "kono":
        return separate_kono(runs, length=length, start=start, shortest=shortest, **options)
    return separate_mean(runs, length=length, start=start, **options)


def _renamed(
    main: ErrorEstimate,
    parts: dict[int, ErrorEstimate],
    runs: RunSet,
    probes: Mapping[int, list[str]],
    history: tuple[Step, ...],
) -> ErrorEstimate:
    """Return one estimate that holds those of all directions."""
    from dataclasses import replace

    messages = [
        m if len(parts) == 1 else f"{_NAMES[d]}: {m}" for d, p in parts.items() for m in p.messages
    ]
    audit = dict(main.audit)
    if len(parts) > 1:
        audit = {_NAMES[d]: dict(p.audit) for d, p in parts.items()}
    total = [
        (p.residual_rms, sum(len(r) for r in runs.select(direction=d))) for d, p in parts.items()
    ]
    rms = math.sqrt(sum(r * r * n for r, n in total) / sum(n for _, n in total))
    return replace(
        main,
        start=max(p.start for p in parts.values()),
        stop=min(p.stop for p in parts.values()),
        fit_range=(
            max(p.fit_range[0] for p in parts.values()),
            min(p.fit_range[1] for p in parts.values()),
        ),
        directions_data={
            d: replace(p.directions_data[0], slope=p.slope if len(parts) > 1 else None)
            for d, p in parts.items()
        },
        slope=_mean_slope(parts),
        lost_motion=_lost_motion(runs, parts, probes) if len(parts) > 1 else None,
        spectrum_data=_joined(parts, "spectrum_data"),
        evidence_data=_joined(parts, "evidence_data")
        if any(p.evidence_data for p in parts.values())
        else {},
        feed_spectra_data=_joined(parts, "feed_spectra_data"),
        residual_psd_data=_joined(parts, "residual_psd_data"),
        residual_rms=rms,
        runs_data={
            key: [v for d, p in parts.items() for v in _scores(p, key, len(probes[d]))]
            for key in {k: None for p in parts.values() for k in p.runs_data}
        },
        lag=float(np.mean([p.lag for p in parts.values()])),
        lag_sd=float(np.linalg.norm([p.lag_sd for p in parts.values()]) / len(parts)),
        audit=audit,
        messages=tuple(messages),
        history=history,
        terms=main.terms
        if len(parts) == 1
        else {_NAMES[d]: dict(p.terms) for d, p in parts.items() if p.terms},
    )


def _scores(part: ErrorEstimate, key: str, n: int) -> list[Any]:
    """Return a column of the runs of one direction; nothing is known of fewer than three runs."""
    return list(part.runs_data.get(key, ["" if key == "against_others" else math.nan] * n))


def _mean_slope(parts: dict[int, ErrorEstimate]) -> Quantity:
    slopes = [p.slope for p in parts.values()]
    known = [s.u for s in slopes if s.u is not None]
    u = float(np.linalg.norm(known)) / len(slopes) if len(known) == len(slopes) else None
    return Quantity(float(np.mean([s.value for s in slopes])), "rad", slopes[0].definition, u=u)


def _joined(parts: dict[int, ErrorEstimate], name: str) -> dict[str, list[Any]]:
    """Stack the tables of both directions, with a column that says which."""
    tables = {d: getattr(p, name) for d, p in parts.items()}
    if len(tables) == 1:
        return dict(next(iter(tables.values())))
    columns: dict[str, list[Any]] = {"direction": []}
    for d, table in tables.items():
        columns["direction"] += [_NAMES[d]] * len(next(iter(table.values()), []))
        for key, values in table.items():
            columns.setdefault(key, []).extend(values)
    return columns


def _lost_motion(
    runs: RunSet, parts: dict[int, ErrorEstimate], probes: Mapping[int, list[str]]
) -> Quantity:
    """Return mean offset of the reverse runs minus that of the forward runs, in the evaluation range.

    Each direction has its own line taken off about the middle of the range: were it taken off
    anywhere else, a difference of their slopes would turn into an offset.
    """
    if "run_levels_nm" in parts[1].audit:
        return _lost_motion_from_levels(parts, probes)
    offsets: dict[int, list[float]] = {1: [], -1: []}
    start, stop = parts[1].start, parts[1].stop
    for run in runs:
        within = (run.x >= start) & (run.x <= stop)
        x, part = run.x[within], parts[run.direction]
        rest = run.z[within] - part.evaluate(x) - part.slope.value * (x - 0.5 * (start + stop))
        level = level_in_the_middle(x, rest, (start, stop))
        if math.isfinite(level):
            offsets[run.direction].append(level)
    forward, reverse = np.array(offsets[1]), np.array(offsets[-1])
    value, u = _mean_difference(forward, reverse)
    return Quantity(
        value,
        "m",
        "mean reading of the reverse runs minus that of the forward runs over the evaluation range, "
        "estimates removed; it holds lost motion only as far as the sensor did not drift between the "
        "runs",
        u=u,
    )


def _lost_motion_from_levels(
    parts: dict[int, ErrorEstimate], probes: Mapping[int, list[str]]
) -> Quantity:
    """Take the levels that the fit found in the middle of the range: no spike, no drift in them."""
    levels = {d: np.array(p.audit["run_levels_nm"]) * 1e-9 for d, p in parts.items()}
    both = [name for name in dict.fromkeys(probes[1]) if name in probes[-1]]
    if not both:
        return Quantity(
            math.nan, "m", "no probe read runs of both directions: lost motion is not observable"
        )
    found = [
        _mean_difference(*(levels[d][[p == name for p in probes[d]]] for d in (1, -1)))
        for name in both
    ]
    known = [u for _, u in found if u is not None]
    u = float(np.linalg.norm(known)) / len(found) if len(known) == len(found) else None
    return Quantity(
        float(np.mean([value for value, _ in found])),
        "m",
        "level of the reverse runs minus that of the forward runs in the middle of the evaluation "
        "range and of the time of each run, probe by probe; it holds lost motion only as far as the "
        "sensor did not drift between the runs",
        u=u,
    )


def _mean_difference(
    forward: NDArray[np.float64], reverse: NDArray[np.float64]
) -> tuple[float, float | None]:
    value = float(reverse.mean() - forward.mean())
    if min(forward.size, reverse.size) < 2:
        return value, None
    return value, math.sqrt(
        float(forward.var(ddof=1)) / forward.size + float(reverse.var(ddof=1)) / reverse.size
    )
