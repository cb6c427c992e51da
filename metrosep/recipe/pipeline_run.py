"""Carrying out a recipe that measures one map or profile: read, step by step, judge, write."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    MetrosepError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.recipe.pipeline import Stage, run_step
from metrosep.recipe.pipeline_checks import SPECTRUM, StepError
from metrosep.recipe.pipeline_mask import Measured
from metrosep.recipe.report_fields import report_of
from metrosep.recipe.schema import COMMAND, reading_options

if TYPE_CHECKING:
    from metrosep.recipe.describe.description import Description
    from metrosep.recipe.map_sections import MapSection
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.result import Result

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Measurement:
    """What a recipe made of one map or profile."""

    source: Measured  # or Profile: as read
    stages: tuple[Stage, ...]  # one for each step
    sections: tuple[MapSection, ...] = ()  # one for each table [[section]]

    @property
    def obj(self) -> Measured:
        """What is left after the last step."""
        return self.stages[-1].obj if self.stages else self.source

    @property
    def found(self) -> dict[str, Quantity]:
        """Everything that was found, by metric; what occurs again is called ``Sa#2``."""
        found: dict[str, Quantity] = {}
        for stage in self.stages:
            for name, quantity in stage.found.items():
                n = 1
                while (key := name if n == 1 else f"{name}#{n}") in found:
                    n += 1
                found[key] = quantity
        for section in self.sections:
            found |= section.found
        return found

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know, once each."""
        said = [s.messages for s in self.stages] + [s.messages for s in self.sections]
        return tuple(dict.fromkeys(m for messages in said for m in messages))

    @property
    def history(self) -> tuple[Step, ...]:
        """The source and every step that was run, evaluations too."""
        return (*self.source.history, *(step for s in self.stages for step in s.history))

    @property
    def audit(self) -> dict[str, Any]:
        """What each step did, by its number and name."""
        return {f"step {s.index + 1}, {s.op}": dict(s.audit) for s in self.stages if s.enabled}

    @property
    def decided(self) -> dict[str, dict[str, Any]]:
        """What each step that compares a spectrum with its limit says of the check of it, by metric."""
        done = [s.detail for s in self.stages if s.enabled and s.op == "psd"]
        return {
            SPECTRUM if n == 1 else f"{SPECTRUM}#{n}": {
                "upper": 1.0,
                "U": d.expanded,
                "guard_factor": d.guard / d.expanded,
                "verdict": d.verdict,
                "u_source": "scatter of the spectrum",
                "u_note": d.sentence.partition(": ")[2],
            }
            for n, d in enumerate(done, start=1)
        }

    @property
    def unsure(self) -> dict[str, str]:
        """By metric, why no verdict on it is possible: a section that was measured in part."""
        return {k: why for s in self.sections for k, why in s.unsure.items()}

    def values(self, metric: str) -> list[float]:
        """Return a parameter of each section of a profile, in the order of x."""
        from metrosep.parameters.profile import section_values

        symbol = metric.partition("#")[0]
        for stage in (s for s in self.stages if s.op == "parameters"):
            for table in stage.detail or ():
                if isinstance(stage.obj, Profile) and symbol in table:
                    return section_values(stage.obj, symbol, table)
        raise DataError(
            f"{metric} is one value, and a rule counts several: it is for parameters of the sections "
            "of a profile, or for several files of metrosep measure"
        )

    def metric(self, name: str) -> str:
        """Return the metric that a check means."""
        known = self.found
        if name in known:
            return name
        for table in (t for s in self.stages if s.op == "parameters" for t in s.detail or ()):
            own = table.own_symbol(name)
            if own in known:
                return str(own)
            if own in table.unavailable:
                raise DataError(f"{name} could not be evaluated: {table.unavailable[own]}")
        return name


def measure_object(recipe: Recipe, obj: Any, *, tell: Tell | None = None) -> Measurement:
    """Return what a recipe makes of a map or profile in memory."""
    stages: list[Stage] = []
    for i, step in enumerate(recipe.steps):
        if tell is not None and step.get("enabled", True):
            tell(f"step {i + 1}: {step['op']}")
        try:
            left = stages[-1].obj if stages else obj
            stages.append(run_step(left, step, index=i, before=recipe.steps[:i]))
        except MetrosepError as exc:
            raise step_error(exc, recipe, i) from None
    return with_sections(recipe, Measurement(obj, tuple(stages)))


def with_sections(
    recipe: Recipe, measured: Measurement, *, lost: list[MetrosepError] | None = None
) -> Measurement:
    """Return a measurement with the sections of a recipe, cut through what the last step left.

    The errors of single sections go into `lost` where it is given, and the others are kept.
    """
    if not recipe.sections:
        return measured
    from metrosep.recipe.map_sections import section_of

    found = []
    for i, section in enumerate(recipe.sections):
        try:
            found.append(section_of(measured.obj, section, behind=recipe.steps))
        except DataError as exc:
            error = recipe.place("[[section]]", i).error(str(exc), "name")
            if isinstance(exc, _OF_DATA):  # gaps of one map are no fault of the recipe
                exc.args = (str(exc if recipe.name == COMMAND else error), *exc.args[1:])
            told = exc if isinstance(exc, _OF_DATA) else error
            if lost is None:
                raise told from None
            lost.append(told)
    return replace(measured, sections=tuple(found))


_OF_DATA = (InvalidSamplesError, NotUniformError, TooFewSamplesError)


def step_error(exc: MetrosepError, recipe: Recipe, number: int) -> MetrosepError:
    """Return an error with file, line and step: what the recipe asks wrongly is of the recipe."""
    from metrosep.recipe.step_help import step_words

    place, op = recipe.place("[[step]]", number), recipe.steps[number]["op"]
    words = step_words(str(exc), op)
    words = words.replace("nesting_index", "cutoff") if op == "filter" else words
    text = f"step {number + 1} ({op}): {words}"
    if isinstance(exc, DataError) and not isinstance(exc, _OF_DATA):
        key = exc.key if isinstance(exc, StepError) else _key_in(exc, recipe, number)
        error = place.error(text, key)
        error.hints = exc.hints
        return error
    told = f"{op}: {exc}" if recipe.name == COMMAND else str(place.error(text, "op"))
    exc.args = (told, *exc.args[1:])
    return exc


def _key_in(exc: MetrosepError, recipe: Recipe, number: int) -> str:
    """Return the key of a step that a message of the library names first."""
    message = str(exc)
    given = [
        k for k in recipe.steps[number] if k not in ("op", "enabled", "kind") and k in message
    ]
    if given:
        return min(given, key=message.index)
    usual = ("aperture", "form", "cutoff", "lambda_c", "lambda_s", "names")
    return next((k for k in usual if k in recipe.steps[number]), "op")


def run_pipeline(
    recipe: Recipe,
    files: list[Path],
    *,
    out: Path | None,
    tell: Tell,
    with_result: bool = True,
    more: Mapping[str, Any] | None = None,
) -> Result:
    """Read one file, carry the steps out, judge and write."""
    from metrosep.recipe.describe.describe_measure import measurement_of
    from metrosep.recipe.outputs import staged, write_reports
    from metrosep.recipe.parts import write_parts
    from metrosep.recipe.preflight import RESULT_NAME
    from metrosep.recipe.result import Result

    obj = _read(recipe, files, tell)
    measured = measure_object(recipe, obj, tell=tell)
    described = measurement_of(measured)
    document = {**_document(recipe, measured, described), **(more or {})}
    document |= report_of(recipe, files, document, measured.source.metadata)
    if out is None:
        return Result(document, measured)
    with staged(out) as stage:
        names = write_parts(recipe, described, stage, tell, document)
        names += write_reports(recipe, document, stage, tell)
        if with_result:
            Result(document, measured).write(stage / RESULT_NAME)
            names.append(RESULT_NAME)
    return Result(document, measured, tuple(out / n for n in names))


def measured_result(recipe: Recipe, measured: Measurement) -> Result:
    """Return the result of steps that were run already; nothing is written."""
    from metrosep.recipe.describe.describe_measure import measurement_of
    from metrosep.recipe.preflight import require_limits
    from metrosep.recipe.result import Result

    require_limits(recipe)
    measured = with_sections(recipe, measured)
    return Result(_document(recipe, measured, measurement_of(measured)), measured)


def _read(recipe: Recipe, files: list[Path], tell: Tell) -> Measured:
    from metrosep.io.read import read_for_recipe as read

    if len(files) != 1:
        shown = ", ".join(f.name for f in files[:4]) + (" ..." if len(files) > 4 else "")
        raise recipe.place("[input]").error(
            f"steps that measure take one file at a time, got {len(files)} ({shown}); name one, or "
            "run the recipe on each",
            "files",
        )
    tell(f"reading {files[0].name}")
    obj = read(files[0], **reading_options(recipe.input))
    if not isinstance(obj, Surface | Profile):
        raise InvalidSamplesError(
            f"{files[0]}: holds a {type(obj).__name__}, and the steps need a profile or a map; "
            "separate it first, or read two columns of a text as a profile with x and z in [input]"
        )
    return obj


def _document(recipe: Recipe, measured: Measurement, described: Description) -> dict[str, Any]:
    from metrosep.recipe.characteristics import DECISION_RULE
    from metrosep.recipe.parts import input_records
    from metrosep.recipe.result import SCHEMA, clean, versions
    from metrosep.recipe.step_help import step_words

    messages = [step_words(m, s.op) for s in measured.stages for m in s.messages]
    messages += [m for s in measured.sections for m in s.messages]
    messages = list(dict.fromkeys(messages))
    warnings = [str(w) for w in measured.source.metadata.get("warnings", ())]
    kind = type(measured.source).__name__
    return clean(  # type: ignore[no-any-return]
        {
            "schema": SCHEMA,
            "metrosep": __version__,
            "title": recipe.title or f"Measurement of a {_WORDS[kind]}",
            "inputs": input_records(measured.history, (measured.source,)),
            "estimate": None,
            "separation": {
                "op": "measure",
                "what": f"one {_WORDS[kind]}, step by step: {', '.join(_carried_out(measured))}",
                "result": "Measurement",
                "audit": described.audit,
                "messages": messages,
                **described.document,
                "charts": list(described.charts),
            },
            "plots": None,
            "table": None,
            "more_tables": [],
            "polynomial": None,
            "messages": [*warnings, *messages],
            "provenance": history_as_dicts(measured.history),
            "recipe": recipe.recorded,
            "versions": versions(),
            "decision_rule": DECISION_RULE,
            **judge_measurement(recipe, measured),
        }
    )


_WORDS = {"Surface": "map", "Profile": "profile"}


def _carried_out(measured: Measurement) -> Iterator[str]:
    for stage in measured.stages:
        if stage.enabled:
            yield stage.op


def judge_measurement(
    recipe: Recipe, measured: Measurement, *, values: Callable[[str], list[float]] | None = None
) -> Mapping[str, Any]:
    """Return characteristics and verdict; checks may use the spelling of the other edition.

    Rules over several values take those of `values`, else of the sections of the profile.
    """
    from metrosep.recipe.characteristics import judged

    checks = []
    for i, check in enumerate(recipe.checks):
        try:
            checks.append({**check, "metric": measured.metric(check["metric"])})
        except DataError as exc:
            raise recipe.place("[[check]]", i).error(str(exc), "metric") from None
    return judged(
        replace(recipe, checks=tuple(checks)),
        measured.found,
        values=values or measured.values,
        decided=measured.decided,
        unsure=measured.unsure,
    )
