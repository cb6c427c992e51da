"""`Recipe`: a TOML list of steps that CLI, scripts and reports share."""

from __future__ import annotations

import hashlib
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from metrosep.core.atomic import MACHINE_BYTES, RECIPE_BYTES, read_plain_text, require_plain
from metrosep.core.errors import (
    DataError,
    RecipeError,
    RecipeMissingError,
    UnsupportedFeatureError,
)
from metrosep.core.methods import METHODS, Method
from metrosep.core.plugins import entries
from metrosep.core.provenance import freeze_mapping
from metrosep.core.readable import did_you_mean, said_value
from metrosep.recipe.methods.turned import TurnedRuns, turning_axis
from metrosep.recipe.pipeline import MEASURING, measuring_steps
from metrosep.recipe.preflight import check_recipe, require_limits
from metrosep.recipe.report_fields import checked_report, typed_fields
from metrosep.recipe.result import Result
from metrosep.recipe.schema import (
    Field,
    Place,
    batch_table,
    blanked_texts,
    checked_table,
    input_fields,
    named_in,
)
from metrosep.recipe.steps import (
    ALL_STEPS,
    CHECK,
    INPUT,
    MEASURING_INPUT,
    METHOD_CHECK,
    METHOD_OUTPUTS,
    OPERATOR,
    OUTPUTS,
    TOP,
)
from metrosep.recipe.written.extends import (
    Admits,
    LayeredPlace,
    before_record,
    layers_of,
    overrides_in,
)
from metrosep.recipe.written.overrides import with_overrides

PathLike = str | os.PathLike[str]
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Recipe:
    """A checked recipe.

    Parameters
    ----------
    name : str
        Name of its file.
    text : str
        Its text; what it builds on (``extends``) follows as comments.
    folder : Path
        Where relative file names of ``[input]`` start.
    title : str
        For reports.
    input : mapping
        How to read the runs.
    steps, checks, outputs : tuple of mapping
        What to do, values in SI.
    sections : tuple of mapping, optional
        Tables ``[[section]]``: what is measured on the map that the steps leave.
    operator : mapping, optional
        The table ``[operator]``: what ``metrosep ui --operator`` offers.
    batch_options : mapping, optional
        The table ``[batch]`` with its defaults.
    bases : tuple of (str, str), optional
        Name and text of each recipe that it builds on, the nearest first.
    report : mapping, optional
        The table ``[report]``: what a laboratory states beside the numbers, checked.
    typed : mapping, optional
        What ``--report`` said in its place.
    look : mapping, optional
        The template that ``[report]`` names, read.
    """

    name: str
    text: str
    folder: Path
    title: str
    input: Mapping[str, Any]
    steps: tuple[Mapping[str, Any], ...]
    checks: tuple[Mapping[str, Any], ...] = ()
    outputs: tuple[Mapping[str, Any], ...] = field(default=())
    batch_options: Mapping[str, Any] = field(default_factory=dict)
    bases: tuple[tuple[str, str], ...] = ()
    report: Mapping[str, Any] = field(default_factory=dict)
    typed: Mapping[str, Any] = field(default_factory=dict)
    look: Mapping[str, Any] = field(default_factory=dict)
    sections: tuple[Mapping[str, Any], ...] = ()
    operator: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_method(self) -> bool:
        """Whether it is not the separation of runs along an axis: a method, or steps that measure."""
        return self.is_pipeline or self._turns or self.steps[0]["op"] in METHODS

    @property
    def _turns(self) -> bool:
        """Whether runs over an angle are averaged."""
        is_separate = any(s["op"] == "separate" for s in self.steps)
        return is_separate and turning_axis(self.outputs) is not None

    @property
    def method(self) -> type[Method] | None:
        """The method of its step; None of runs along an axis, and of steps that measure."""
        return TurnedRuns if self._turns else METHODS.get(self.steps[0]["op"])

    @property
    def is_pipeline(self) -> bool:
        """Whether it measures one map or profile, step by step (`metrosep.recipe.pipeline`)."""
        return self.steps[0]["op"] in MEASURING

    @property
    def reads_nothing(self) -> bool:
        """Whether the keys of its step say all, and no input is read."""
        return self.method is not None and self.method.reads == "nothing"

    @property
    def sha256(self) -> str:
        """Hash of the text."""
        return hashlib.sha256(self.text.encode("utf-8")).hexdigest()

    @property
    def overrides(self) -> tuple[str, ...]:
        """What was overridden in the text, as it was given: ``step.2.degree=5``."""
        return overrides_in(self.text)

    @property
    def recorded(self) -> dict[str, Any]:
        """What a result keeps of the recipe: name, text, its hash; no ``[view]``, ``[report]``, ``[operator]``.

        Where values were overridden, also the list ``overrides``; the text is the one with them.
        """
        text = without_stated(without_view_block(self.text))
        digest = hashlib.sha256(text.encode("utf-8")).hexdigest()
        kept: dict[str, Any] = {"name": self.name, "text": text, "sha256": digest}
        given = list(self.overrides)
        return {**kept, "overrides": given} if given else kept

    @classmethod
    def load(
        cls, path: PathLike, *, overrides: Sequence[str] = (), report: Sequence[str] = ()
    ) -> Recipe:
        """Read and check a recipe.

        Parameters
        ----------
        path : str or path
            TOML file, in UTF-8 with or without byte order mark.
        overrides : sequence of str, optional
            ``key=value`` each, in place of what the file says: `Recipe.parse`.
        report : sequence of str, optional
            ``key=value`` each, in place of a field of ``[report]``: ``item.serial=A12``.

        Returns
        -------
        Recipe
            Every key checked, every quantity in SI.

        Raises
        ------
        RecipeError
            If the file cannot be read, is not TOML, or a key is unknown, missing or of the wrong
            kind; the message names file and line, or the override.
        """
        target = Path(path)
        try:
            text = read_plain_text(target, RECIPE_BYTES)
        except FileNotFoundError:
            message = f"{target}: no such recipe; check the name and the folder"
            raise RecipeMissingError(message, str(target)) from None
        except OSError as exc:
            reason = exc.strerror or exc
            raise RecipeError(f"{target}: the recipe cannot be read ({reason})") from None
        folder = target.resolve().parent
        return cls.parse(text, name=target.name, folder=folder, overrides=overrides, report=report)

    @classmethod
    def parse(
        cls,
        text: str,
        *,
        name: str = "recipe.toml",
        folder: PathLike = ".",
        overrides: Sequence[str] = (),
        admits: Admits | None = None,
        report: Sequence[str] = (),
    ) -> Recipe:
        """Check the text of a recipe.

        Parameters
        ----------
        text : str
            TOML.
        name : str, optional
            For messages.
        folder : str or path, optional
            Where relative file names start.
        overrides : sequence of str, optional
            ``key=value`` each, as ``-s`` of the command line takes them: ``step.form.robust=tukey``,
            ``step.2.degree=5``, ``check.Sa.upper=12 nm``, ``input.unit=um``, ``title=...``. They
            are written into the text.
        admits : callable, optional
            Whether a path that the recipe names may be read, as ``admits(path)``; every path if
            omitted. A device, a pipe or a description that is too large is refused in any case.
        report : sequence of str, optional
            ``key=value`` each, in place of a field of ``[report]``: ``item.serial=A12``.

        Returns
        -------
        Recipe
            Every key checked, every quantity in SI.

        Raises
        ------
        RecipeError
            If something in it is wrong; the message names file and line, or the override.
        """
        if overrides:
            text = with_overrides(text, name, Path(folder), overrides)
        layers = layers_of(text, name, Path(folder), admits)
        data, text, bases = layers.data, layers.text, layers.bases

        def place(header: str = "", number: int = 0) -> Place:
            return LayeredPlace(name, text, header, number, bases)

        top = place()
        checked_table(data, TOP, top, what="the recipe")
        if data["metrosep"] != 1:
            raise top.error(
                f"metrosep = {data['metrosep']}: this version reads recipes of version 1",
                "metrosep",
            )
        ops = ALL_STEPS
        steps = several_tables(data.get("step"), ops, "op", "[[step]]", top)
        named = [s["op"] for s in steps]
        method = METHODS.get(named[0]) if named else None
        pipeline = bool(named) and named[0] in MEASURING
        wanted = named.count("separate") if method is None else len(named)
        if pipeline:
            steps = measuring_steps(steps, lambda i: place("[[step]]", i))
        elif wanted != 1:
            raise top.error(
                'a recipe needs exactly one [[step]] that separates: op = "separate", one of '
                + ", ".join(METHODS)
                + "; or steps that measure: "
                + ", ".join(MEASURING),
                "step",
            )
        if method is not None:
            files = [(s, method.fields) for s in steps]
            _require_files(files, Path(folder), lambda i: place("[[step]]", i), admits)
        fields = INPUT if method is None else input_fields(method)
        if pipeline:
            fields = MEASURING_INPUT
        plain = method is None and not pipeline
        if "input" not in data and not (method is not None and method.reads == "nothing"):
            raise top.error('the recipe needs the key "input"')
        columns: set[str] = {"x", "z"} & dict(data.get("input") or {}).keys() if plain else set()
        if len(columns) == 1:  # files whose names and units tell their columns need neither
            other = "z" if "x" in columns else "x"
            raise place("[input]").error(f'[input] needs the key "{other}"')
        outputs = several_tables(
            data.get("output", []),
            OUTPUTS if plain else METHOD_OUTPUTS,
            "kind",
            "[[output]]",
            top,
        )
        recipe = cls(
            name=name,
            text=text,
            folder=Path(folder),
            title=data.get("title", ""),
            input=freeze_mapping(
                checked_table(data.get("input", {}), fields, place("[input]"), what="[input]")
            ),
            steps=steps,
            checks=several_tables(
                data.get("check", []),
                {"": CHECK if plain and not turning_axis(outputs) else METHOD_CHECK},
                "",
                "[[check]]",
                top,
            ),
            outputs=outputs,
            sections=_sections(data.get("section", []), top, place, measures=pipeline),
            batch_options=freeze_mapping(batch_table(data.get("batch", {}), place("[batch]"))),
            bases=bases,
            operator=freeze_mapping(
                checked_table(
                    data.get("operator", {}), OPERATOR, place("[operator]"), what="[operator]"
                )
            ),
            **_stated(data.get("report", {}), report, Path(folder), place("[report]"), admits),
        )
        files = [(o, (METHOD_OUTPUTS | OUTPUTS)[o["kind"]]) for o in recipe.outputs]
        _require_files(files, Path(folder), lambda i: place("[[output]]", i), admits)
        check_recipe(recipe)
        return recipe

    def place(self, header: str, number: int = 0) -> Place:
        """Return where a table of the recipe stands, to name its lines in messages.

        Parameters
        ----------
        header : str
            Such as ``[input]`` or ``[[output]]``; empty for the top.
        number : int, optional
            Which of the equal headers, from 0.

        Returns
        -------
        Place
            Of that table.
        """
        return LayeredPlace(self.name, self.text, header, number, self.bases)

    def run(
        self,
        inputs: PathLike | Iterable[PathLike] | None = None,
        *,
        out: PathLike | None = None,
        progress: Progress | None = None,
        overwrite: bool = False,
    ) -> Result:
        """Run the recipe.

        Parameters
        ----------
        inputs : path or iterable of paths, optional
            Files, or folders that hold the files of ``[input]``; the recipe's own folder if
            omitted.
        out : str or path, optional
            Folder for tables, reports and result.json, made if needed; nothing is written if
            omitted.
        progress : callable, optional
            Told what is being done.
        overwrite : bool, optional
            Replace tables of `out` by other bytes; the old ones stay as ``<name>.1``.

        Returns
        -------
        Result
            Document, estimate and the files that were written.

        Raises
        ------
        MetrosepError
            Of any kind of its tree; result.json is written last, so its absence means that the
            run did not finish.
        """
        from metrosep.recipe.run import run_recipe

        require_limits(self)
        return run_recipe(self, inputs, out=out, progress=progress, overwrite=overwrite)

    def batch(
        self,
        folder: PathLike,
        *,
        out: PathLike,
        workers: int | None = None,
        scheduler: str = "processes",
        resume: bool = True,
        **options: Any,
    ) -> Any:
        """Run the recipe on every input of a folder (`metrosep.batch.run_batch`).

        Parameters
        ----------
        folder : str or path
            With the inputs, subfolders too.
        out : str or path
            Folder for the results, one subfolder for each input.
        workers : int, optional
            How many work at once; as many as there are processors if omitted.
        scheduler : str, optional
            "processes", "threads", "serial", "dask" or "dask=tcp://host:8786".
        resume : bool, optional
            Keep what an earlier run finished.
        **options
            Further ones of `metrosep.batch.run_batch`.

        Returns
        -------
        BatchReport
            A row for each input, counts, exit code.

        Raises
        ------
        UnsupportedFeatureError
            If nothing that runs batches is installed.
        MetrosepError
            Of any kind of its tree, for what concerns the whole batch; an input that fails is a
            row of the report.
        """
        runners = entries("metrosep.runners")
        if "batch" not in runners:
            raise UnsupportedFeatureError(
                f"nothing that runs a batch over {folder} is installed (entry point 'batch' of "
                "metrosep.runners); install metrosep again"
            )
        run = runners["batch"].load()
        settings = {"workers": workers, "scheduler": scheduler, "resume": resume, **options}
        return run(self, folder, out=out, **settings)


def _stated(
    data: Any, typed: Sequence[str], folder: Path, place: Place, admits: Admits | None
) -> dict[str, Any]:
    """Return the table ``[report]``, what was typed in its place, and the template that it names."""
    try:
        fields = checked_report(data)
    except DataError as exc:
        key = re.search(r'unknown key "(\w+)"|: (\w+) [=h]', str(exc))
        raise place.error(str(exc), (key[1] or key[2]) if key else None) from None
    try:
        own = checked_report(typed_fields(typed), "--report")
    except DataError as exc:
        raise RecipeError(str(exc)) from None
    template = own.get("template") or fields.get("template")
    if template is None:
        return {"report": fields, "typed": own}
    from metrosep.recipe.look import read_look

    _require_files(
        [({"template": template}, {"template": Field("file")})], folder, lambda _: place, admits
    )
    beside = folder / template
    look = read_look(beside if beside.exists() else Path(template), admits)
    return {"report": fields, "typed": own, "look": look}


def _sections(
    tables: Any, top: Place, place: Callable[[str, int], Place], *, measures: bool
) -> tuple[Mapping[str, Any], ...]:
    """Return the tables ``[[section]]`` of a recipe, checked; most recipes have none."""
    if tables == []:
        return ()
    from metrosep.recipe.map_sections import SECTIONS, check_sections

    sections = several_tables(tables, SECTIONS, "kind", "[[section]]", top)
    check_sections(sections, lambda i: place("[[section]]", i), measures=measures)
    return sections


def _require_files(
    tables: Sequence[tuple[Mapping[str, Any], Mapping[str, Field]]],
    folder: Path,
    place: Callable[[int], Place],
    admits: Admits | None,
) -> None:
    """Refuse a file that a key names and that is not a plain file, too large, or not to be read."""
    for i, (step, fields) in enumerate(tables):
        for key, name in named_in(step, fields):
            try:
                # it is looked for beside the recipe, then where the process was started
                target = folder / name if (folder / name).exists() else Path(name)
                is_word = Path(name).name == name and not target.exists()  # such as a preset
                if (
                    admits is not None
                    and not is_word
                    and not (admits(target) and admits(folder / name))
                ):
                    raise place(i).error(
                        f'{key} = "{name}": it lies outside the folders that were opened; open its '
                        "folder too (--folder), or copy the file into one of them",
                        key,
                    )
                require_plain(target, MACHINE_BYTES if target.suffix == ".toml" else None)
            except (OSError, ValueError) as exc:
                why = getattr(exc, "strerror", None) or exc  # a NUL in it is a ValueError
                raise place(i).error(
                    f'{key} = "{name[:80]}": {why}; name a file that holds the data', key
                ) from None


# ---- arrays of tables in a recipe: ``[[step]]``, ``[[check]]``, ``[[output]]`` -----------------


def several_tables(
    items: Any,
    kinds: Mapping[str, Mapping[str, Field]],
    selector: str,
    header: str,
    top: Place,
) -> tuple[Mapping[str, Any], ...]:
    """Return an array of tables, each checked by what its key `selector` says that it is."""
    if not isinstance(items, list) or not all(isinstance(i, dict) for i in items):
        raise top.error(f"write {header} with double brackets", header.strip("[]"))
    checked = []
    for number, item in enumerate(items):
        place = LayeredPlace(top.file, top.text, header, number, getattr(top, "bases", ()))
        kind = item.get(selector, "") if selector else ""
        if not isinstance(kind, str) or kind not in kinds:
            known = ", ".join(f'"{k}"' for k in kinds)
            raise place.error(
                f"{header} needs {selector} = one of {known}, found {said_value(kind)}.{did_you_mean(kind, kinds)}",
                selector,
            )
        what = f"{header} {number + 1}" + (f" ({kind})" if kind else "")
        checked.append(freeze_mapping(checked_table(item, kinds[kind], place, what=what)))
    return tuple(checked)


# ---- the table ``[view]``: what the workbench shows of a measurement. Runs and results know nothing of it ----

_HEADER = re.compile(r"\s*\[\s*(?:view|\"view\"|'view')\s*\]\s*(?:#.*)?$")


def without_view_block(text: str) -> str:
    r"""Return the text of a recipe without its table ``[view]``; all else stays as it is written.

    The record of what it builds on stays too.

    Examples
    --------
    >>> without_view_block('metrosep = 1\n\n[view]\ntab = "report"\n')
    'metrosep = 1\n'
    """
    end = before_record(text)
    return _without(text[:end]) + text[end:]


def _without(text: str) -> str:
    lines = text.splitlines(keepends=True)
    plain = blanked_texts(text).splitlines()
    first = next((i for i, line in enumerate(plain) if _HEADER.match(line)), None)
    if first is None:
        return text
    held = tomllib.loads(text)
    held.pop("view")
    for after in range(first + 1, len(plain) + 1):
        # the next header may be a line of an array: the rest must say what it said
        if after < len(plain) and not plain[after].lstrip().startswith("["):
            continue
        made = "".join(lines[:first] + lines[after:])
        if _says(made, held):
            break
    else:
        return text
    before = "".join(lines[:first])
    if after == len(plain):
        return before.rstrip("\n") + "\n"
    return before + "".join(lines[after:])


_STATED = re.compile(r"\s*\[{1,2}\s*(report|operator)\s*(?:\.[\w\s.\"'-]+)?\]{1,2}\s*(?:#.*)?$")
_TABLE = re.compile(r"\s*\[{1,2}\s*[\w.\"' -]+\s*\]{1,2}\s*(?:#.*)?$")


def without_stated(text: str) -> str:
    r"""Return the text of a recipe without ``[report]`` and ``[operator]``: they change no number.

    Examples
    --------
    >>> without_stated('metrosep = 1\n[report]\nnumber = "7"\n[input]\n')
    'metrosep = 1\n[input]\n'
    """
    end = before_record(text)
    lines = text[:end].splitlines(keepends=True)
    plain = blanked_texts(text[:end]).splitlines()
    named = {found[1] for line in plain if (found := _STATED.match(line))}
    if not named:
        return text
    held = tomllib.loads(text[:end])
    for table in named:
        held.pop(table, None)
    kept, inside = [], False
    for line, bare in zip(lines, plain, strict=True):
        if _TABLE.match(bare):
            inside = bool(_STATED.match(bare))
        if not inside:
            kept.append(line)
    made = "".join(kept).rstrip("\n") + "\n"
    return made + text[end:] if _says(made, held) else text


def _says(text: str, held: dict[str, Any]) -> bool:
    """Whether a text is TOML with this content."""
    try:
        return tomllib.loads(text) == held
    except tomllib.TOMLDecodeError:
        return False
