"""Write the reference pages from the code, at the start of a build.

- One page per package and the names that it exports.
- The command line from click.
- The table of formats from ``data_formats/*/format.toml``.
- The table of controllers from the facts that each dialect states.
- The steps of recipes with their options, from the fields of the classes.

All of them go to ``docs/reference/generated`` (not committed); a page is rewritten only when its
text changed, so that a second build stays quick.
"""

from __future__ import annotations

import importlib
import inspect
import json
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tools"))

from public_names import exported, inherited  # noqa: E402

PACKAGES = {
    "core": "Objects, units, errors",
    "io": "Reading and writing files",
    "separation": "Error separation",
    "spectral": "Spectra",
    "filters": "Filters",
    "forms": "Ideal surfaces",
    "parameters": "Parameters and fits",
    "optics": "Wavefronts",
    "machine": "Machines",
    "process": "Processes",
    "compensation": "Compensation",
    "controllers": "Controllers",
    "recipe": "Recipes",
    "plot": "Figures",
    "report": "Reports",
}


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the generator."""
    app.connect("builder-inited", generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def generate(app: Sphinx) -> None:
    """Write all pages and remove those that no longer exist."""
    folder = Path(app.srcdir) / "reference" / "generated"
    folder.mkdir(parents=True, exist_ok=True)
    shown: set[type] = set()
    pages = {f"{name}.rst": package_page(name, title, shown) for name, title in PACKAGES.items()}
    pages["command-line.rst"] = command_line_page()
    pages["formats.rst"] = formats_page()
    pages["controllers-list.rst"] = controllers_page()
    pages["steps.rst"] = steps_page()
    pages["json.rst"] = json_page()
    for stale in set(folder.iterdir()) - {folder / name for name in pages}:
        stale.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


# ---- Python names ------------------------------------------------------------------------------


def package_page(name: str, title: str, shown: set[type]) -> str:
    """Page of one package: what it is, and the names that it exports."""
    path = f"metrosep.{name}"
    lines = [*_heading(title, "="), f"``{path}``", ""]
    lines += [*(inspect.getdoc(importlib.import_module(path)) or "").splitlines(), ""]
    for public, value in sorted(exported(path).items()):
        lines += _directive(f"{path}.{public}", value, shown)
    return "\n".join(lines) + "\n"


def _directive(target: str, value: object, shown: set[type]) -> list[str]:
    if inspect.isclass(value):
        # a class that another page shows has its place in the index there
        again = ["   :no-index:"] if value in shown else []
        shown.add(value)
        lines = [f".. autoclass:: {target}", "   :members:", *again, ""]
        for name, member in sorted(inherited(value).items()):
            kind = (
                "autoproperty" if isinstance(member, property)
                else "automethod" if inspect.isroutine(member) or isinstance(member, classmethod | staticmethod)
                else "autoattribute"
            )  # fmt: skip
            lines += [f"   .. {kind}:: {target}.{name}", *("   " + a for a in again), ""]
        return lines
    if inspect.isfunction(value):
        return [f".. autofunction:: {target}", ""]
    return [f".. py:data:: {target}", "   :no-index-entry:", ""]


# ---- command line ------------------------------------------------------------------------------


def command_line_page() -> str:
    """Page of all commands, as click prints them."""
    import click

    main = importlib.import_module("metrosep.cli.main")
    command = next(
        value
        for name in ("cli", "main", "app")
        if isinstance(value := getattr(main, name, None), click.Command)
    )
    lines = [*_heading("Command line", "="), "What ``metrosep COMMAND --help`` prints.", ""]
    context = click.Context(command, info_name="metrosep", terminal_width=90, max_content_width=90)
    lines += _literal(command.get_help(context))
    for name in command.list_commands(context) if isinstance(command, click.Group) else ():
        sub = command.get_command(context, name)
        if sub is None or sub.hidden:
            continue
        inner = click.Context(
            sub, info_name=name, parent=context, terminal_width=90, max_content_width=90
        )
        lines += _heading(f"metrosep {name}", "-") + _literal(sub.get_help(inner))
    return "\n".join(lines) + "\n"


# ---- formats -----------------------------------------------------------------------------------


def formats_page() -> str:
    """Table of the file formats, from their descriptors."""
    rows = []
    for path in sorted((ROOT / "data_formats").glob("*/format.toml")):
        described = tomllib.loads(path.read_text(encoding="utf-8"))
        entry: dict[str, Any] = described.get("format", described)
        shown: dict[str, str] = entry.get("orientation", {})
        rows.append(
            [
                f"``{entry.get('id', path.parent.name)}``",
                str(entry.get("title", "")),
                _words(entry.get("kind")),
                _words(entry.get("suffixes")),
                ", ".join(verb for verb in ("reads", "writes") if entry.get(verb)),
                _words(entry.get("status")),
                ": ".join(shown[key] for key in ("evidence", "shown_by") if key in shown),
                f"``{shown['tested_by']}``" if shown else "",
            ]
        )
    header = [
        "id",
        "title",
        "kind",
        "suffixes",
        "does",
        "status",
        "rows of a map shown by",
        "test",
    ]
    lines = [*_heading("File formats", "=")]
    lines += [
        "From the descriptors in ``data_formats/``. *verified-on-real-file*: a file of a real",
        "instrument was read; *from-specification*: written from a description only;",
        "*synthetic*: only files that we made ourselves. What the last columns say about the",
        "orientation of a map is explained in :doc:`/explanation/reading`; each test fails when the",
        "maps of its format are mirrored.",
        "",
    ]
    return "\n".join(lines + _table([header, *rows])) + "\n"


# ---- controllers -------------------------------------------------------------------------------


def controllers_page() -> str:
    """Table of the controllers, from what their dialects state."""
    registry = importlib.import_module("metrosep.controllers.registry")
    header = [
        "name",
        "controller",
        "holds",
        "one entry, for the error e",
        "points",
        "sign",
        "proof",
    ]
    rows = [
        [
            f"``{d.id}``",
            d.title,
            f"{d.carries}, {d.spacing} spacing" if d.carries != "polynomial" else d.carries,
            d.entry,
            "no limit" if d.max_points is None else str(d.max_points),
            f"{d.sign}: {d.sign_status}",
            d.proof,
        ]
        for d in registry.describe()
    ]
    lines = [*_heading("Controllers", "=")]
    lines += [
        "From what each dialect states; ``metrosep controllers NAME`` prints all of one. Signs:",
        "*confirmed* by running the controller or by definition; *documented* by its maker;",
        "*stated*: they follow a fact of the machine that you give; *unconfirmed*: they must be tried",
        "on the machine before metrosep writes a table.",
        "",
    ]
    return "\n".join(lines + _table([header, *rows])) + "\n"


# ---- steps of recipes ----------------------------------------------------------------------------


def steps_page() -> str:
    """Table of the options of each step and method, as the fields of its class declare them."""
    described = importlib.import_module("metrosep.recipe.step_help").described_steps()
    lines = [*_heading("Steps of recipes", "=")]
    lines += [
        "``op`` of a recipe, ``--method`` of ``metrosep separate`` and ``method=`` of",
        "`metrosep.separation.separate` have the same names and options.",
        "",
    ]
    for step in described["steps"]:
        lines += [*_heading(step["op"], "-"), f"{step['what'].capitalize()}.", ""]
        rows = [
            [
                f"``{key['name']}``",
                key["kind"] + (", required" if key["required"] else ""),
                ", ".join(map(str, key["choices"])),
                "" if key["default"] in (None, "") else f"``{key['default']}``",
                str(key["help"]).replace("*", r"\*").replace("|", r"\|"),
            ]
            for key in step["keys"]
        ]
        if rows:
            lines += _table([["option", "kind", "one of", "default", "what it does"], *rows])
    return "\n".join(lines) + "\n"


def json_page() -> str:
    """Schemas of what commands print with ``--json``."""
    schemas = importlib.import_module("metrosep.cli.output_schema")
    lines = [*_heading("Output of commands as JSON", "=")]
    lines += [
        "With ``--json`` a command prints one JSON object on standard output, and nothing else there.",
        "Keys under ``required`` stay, with meaning and unit, within a minor version; others may be added.",
        "``null`` is a number that is not known. The schemas are JSON schema, draft 2020-12; in Python",
        "``metrosep.cli.output_schema.schema_of(COMMAND)`` returns one. The tests check the output of every",
        "command against them.",
        "",
    ]
    for name in sorted(schemas.OUTPUTS):
        text = json.dumps(schemas.schema_of(name), indent=1, ensure_ascii=False)
        lines += [*_heading(name, "-"), ".. code-block:: json", ""]
        lines += [f"   {line}" for line in text.splitlines()]
        lines += [""]
    return "\n".join(lines) + "\n"


def _words(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value or "")


# ---- restructured text -------------------------------------------------------------------------


def _table(rows: list[list[str]]) -> list[str]:
    lines = [".. list-table::", "   :header-rows: 1", ""]
    for row in rows:
        lines += [f"   {'*' if i == 0 else ' '} - {cell}" for i, cell in enumerate(row)]
    return lines


def _heading(text: str, mark: str) -> list[str]:
    return ["", text, mark * len(text), ""]


def _literal(text: str) -> list[str]:
    return [".. code-block:: text", "", *(f"   {line}".rstrip() for line in text.splitlines()), ""]
