"""Write the reference pages from the code, at the start of a build.

- One page per package and its public names (``__all__`` of the package, or of its modules where
  the package itself names nothing).
- The command line from click.
- The table of formats from ``data_formats/*/format.toml``.
- The table of controllers from the facts that each dialect states.

All of them go to ``docs/reference/generated`` (not committed); a page is rewritten only when its
text changed, so that a second build stays quick.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import ModuleType

    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]

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
    pages = {f"{name}.rst": package_page(name, title) for name, title in PACKAGES.items()}
    pages["command-line.rst"] = command_line_page()
    pages["formats.rst"] = formats_page()
    pages["controllers-list.rst"] = controllers_page()
    for stale in set(folder.iterdir()) - {folder / name for name in pages}:
        stale.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


# ---- Python names ------------------------------------------------------------------------------


def package_page(name: str, title: str) -> str:
    """Page of one package: each module's text, then its public names."""
    package = importlib.import_module(f"metrosep.{name}")
    lines = [*_heading(title, "="), f"``metrosep.{name}``", "", *_doc(package)]
    lines += _exports(package)
    for module in _modules(package):
        names = [n for n in getattr(module, "__all__", ()) if _defined_in(module, n)]
        if names:
            lines += _heading(f"``{module.__name__}``", "-") + _doc(module)
            for public in names:
                lines += _directive(module, public)
    return "\n".join(lines) + "\n"


def _modules(package: ModuleType) -> Iterator[ModuleType]:
    for found in sorted(
        pkgutil.walk_packages(package.__path__, package.__name__ + "."), key=lambda m: m.name
    ):
        if not any(part.startswith("_") for part in found.name.split(".")):
            yield importlib.import_module(found.name)


def _exports(package: ModuleType) -> list[str]:
    names = sorted(getattr(package, "__all__", ()))
    if not names:
        return []
    role = {True: "class", False: "func"}
    links = []
    for name in names:
        value = getattr(package, name)
        owner = _owner(package, name, value)
        if inspect.isclass(value) or inspect.isfunction(value):
            links.append(f":py:{role[inspect.isclass(value)]}:`{name} <{owner}.{name}>`")
        else:
            links.append(f"``{name}``")
    return ["Names of the package: " + ", ".join(links), ""]


def _owner(package: ModuleType, name: str, value: Any) -> str | None:
    """Module under which a name is documented: a public one where it is written in a private one."""
    written: str | None = getattr(value, "__module__", None)
    if written is None or not written.rpartition(".")[2].startswith("_"):
        return written
    for module in _modules(package):
        if name in getattr(module, "__all__", ()):
            return module.__name__
    return written


def _defined_in(module: ModuleType, name: str) -> bool:
    value = getattr(module, name)
    if not callable(value):
        return True
    written = getattr(value, "__module__", module.__name__)
    if not written.rpartition(".")[2].startswith("_"):
        return bool(written == module.__name__)
    package = importlib.import_module(module.__name__.rpartition(".")[0])
    return _owner(package, name, value) == module.__name__


def _directive(module: ModuleType, name: str) -> list[str]:
    value = getattr(module, name)
    target = f"{module.__name__}.{name}"
    if inspect.isclass(value):
        return [f".. autoclass:: {target}", "   :members:", ""]
    if inspect.isfunction(value):
        return [f".. autofunction:: {target}", ""]
    return [f".. py:data:: {target}", "   :no-index-entry:", ""]


def _doc(module: ModuleType) -> list[str]:
    return [*(inspect.getdoc(module) or "").splitlines(), ""]


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
        rows.append(
            [
                f"``{entry.get('id', path.parent.name)}``",
                str(entry.get("title", "")),
                _words(entry.get("kind")),
                _words(entry.get("suffixes")),
                ", ".join(verb for verb in ("reads", "writes") if entry.get(verb)),
                _words(entry.get("status")),
            ]
        )
    header = ["id", "title", "kind", "suffixes", "does", "status"]
    lines = [*_heading("File formats", "=")]
    lines += [
        "From the descriptors in ``data_formats/``. *verified-on-real-file*: a file of a real",
        "instrument was read; *from-specification*: written from a description only;",
        "*synthetic*: only files that we made ourselves.",
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
