"""The measures of the house, before one number of it is believed: ``make house`` prints them.

Lines, files and folders of the package, circles of imports, strings that name an upper layer,
declarations found twice, classes that only tests reach, modules that a command loads, and the time
of ``metrosep --help``. The exit code is the number of measures that are missed.
"""

from __future__ import annotations

import ast
import json
import re
import resource
import statistics
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "metrosep"
MOST_LINES, MOST_FILES = 130_000, 450
MOST_IN_FOLDER, LONGEST = 30, 900
MOST_OF_MEASURE, MOST_OF_SEPARATE = 120, 150
HELP_MS = 60.0

MEASURE = ["measure", "data_formats/metropro/samples/format1.dat", "--form", "plane", "--params", "PV,Sq"]  # fmt: skip
SEPARATE = [
    "separate", "examples/straightness/runs.csv", "--x", "x_mm", "--z", "z_um", "--feed",
    "feed_mm_min", "--run", "run",
]  # fmt: skip
LOADED = """
import contextlib, io, json, sys
from metrosep.cli.main import main
sys.argv[1:] = json.loads(sys.argv[1])
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    try:
        code = main()
    except SystemExit as end:
        code = end.code
names = [name for name in sys.modules if name.partition(".")[0] == "metrosep"]
print(json.dumps([code, len(names)]))
"""


def modules() -> dict[str, Path]:
    """Return the files of the package by the name of their module."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def _run_time_imports(tree: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Yield the imports of a module, also those inside functions, without those of type checkers."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        else:
            yield from _run_time_imports(node)


def imports(known: dict[str, Path]) -> dict[str, set[str]]:
    """Return the modules of metrosep that each module imports while it runs, lazily or not."""
    found: dict[str, set[str]] = {}
    for name, path in known.items():
        targets = set()
        for node in _run_time_imports(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names if alias.name in known}
            elif node.module and node.module.partition(".")[0] == "metrosep":
                full = [f"{node.module}.{alias.name}" for alias in node.names]
                targets |= {f if f in known else node.module for f in full}
        # what a package exports is not an arrow of its own: its modules are asked in their stead
        found[name] = {t for t in targets - {name} if known[t].name != "__init__.py"}
    return found


def circles(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Return the groups of modules that import each other (Tarjan's strong components)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    open_: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        order[name] = low[name] = len(order)
        open_.append(name)
        for target in sorted(arrows[name]):
            if target not in order:
                visit(target)
                low[name] = min(low[name], low[target])
            elif target in open_:
                low[name] = min(low[name], order[target])
        if low[name] == order[name]:
            group = open_[open_.index(name) :]
            del open_[-len(group) :]
            if len(group) > 1:
                found.append(sorted(group))

    sys.setrecursionlimit(10_000)
    for name in sorted(arrows):
        if name not in order:
            visit(name)
    return found


def strings_upwards(known: dict[str, Path]) -> list[str]:
    """Return where a text names a module of a layer above the one it stands in."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
        "contracts"
    ]
    rows = next(c["layers"] for c in contracts if c.get("containers") == ["metrosep"])
    height = {layer.strip(" ()"): -k for k, row in enumerate(rows) for layer in row.split("|")}
    found = []
    for name, path in known.items():
        own = name.split(".")[1] if "." in name else ""
        if own not in height:
            continue
        documented = set()
        for node in ast.walk(tree := ast.parse(path.read_text())):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and node.body:
                documented.add(id(getattr(node.body[0], "value", None)))
        for node in ast.walk(tree):
            if not isinstance(node, ast.Constant) or id(node) in documented:
                continue
            text = node.value if isinstance(node.value, str) else ""
            match = re.match(r"metrosep\.(\w+)(\.\w+)*(:\w+)?$", text)
            if match and height.get(match[1], -99) > height[own]:
                found.append(f"{path.relative_to(ROOT)}:{node.lineno} {text!r}")
    return found


def _declared(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield name and content of each option that a class declares on a field, and of each constant.

    An option is a field whose value is ``option(...)``; two with the same name and the same sentence of
    help are one fact in two places. A constant is a table or a text of a module, of more than 40
    characters: shorter ones are equal by chance.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            for field in node.body:
                value = getattr(field, "value", None)
                if not isinstance(field, ast.AnnAssign) or not isinstance(value, ast.Call):
                    continue
                if ast.unparse(value.func).rpartition(".")[2] == "option":
                    yield f"option {ast.unparse(field.target)}", ast.unparse(value)
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(
            node.value, ast.Dict | ast.Set | ast.Tuple | ast.List | ast.Constant
        ):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            content = ast.unparse(node.value)
            if ast.unparse(target) != "__all__" and len(content) > 40:
                yield "constant", content


def twice(trees: dict[str, ast.Module]) -> list[str]:
    """Return the declarations that stand in more than one place, with these places."""
    places: dict[tuple[str, str], list[str]] = {}
    for name, tree in trees.items():
        for key in _declared(tree):
            places.setdefault(key, []).append(name)
    return [
        f"{kind} {content[:60]!r}: {', '.join(found)}"
        for (kind, content), found in sorted(places.items())
        if len(found) > 1
    ]


def _is_dialect(node: ast.ClassDef) -> bool:
    """Return whether a class declares the facts of a controller, its own or those of its family."""
    return any(
        isinstance(part, ast.Assign)
        and ast.unparse(part.targets[0]) == "info"
        and isinstance(part.value, ast.Call)
        for part in node.body
    )


def only_tested(trees: dict[str, ast.Module], packages: dict[str, bool]) -> list[str]:
    """Return the classes that nothing in the package names beside their own definition and exports.

    A class that an ``__init__`` exports is public. Entries of ``__all__`` and the class's own body do not
    count; a name in any other text (a lazy import, a registry) does.
    """
    defined: dict[str, str] = {}
    named: set[str] = set()

    def walk(node: ast.AST, inside: frozenset[str]) -> None:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return
        if isinstance(node, ast.ClassDef):
            if _is_dialect(node):  # its registry finds it by this declaration
                named.add(node.name)
            for part in (*node.bases, *node.keywords, *node.decorator_list):
                walk(part, inside)
            inside |= {node.name}
            for part in node.body:
                walk(part, inside)
            return
        names: list[str] = []
        if isinstance(node, ast.Name):
            names = [node.id]
        elif isinstance(node, ast.Attribute):
            names = [node.attr]
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names = re.findall(r"\w+", node.value) if len(node.value) < 200 else []
        named.update(n for n in names if n not in inside)
        for part in ast.iter_child_nodes(node):
            walk(part, inside)

    for name, tree in trees.items():
        if packages[name]:  # what it exports is the door of users
            named.update(re.findall(r"\w+", ast.unparse(tree)))
        for node in tree.body:
            # a decorator registers, or the registry of controllers finds the class by its `info`
            marks = [*getattr(node, "decorator_list", ()), *getattr(node, "body", ())]
            registered = any(
                re.match(r"\w*register|info = DialectInfo", ast.unparse(m)) for m in marks
            )
            if isinstance(node, ast.ClassDef) and not registered:
                defined[node.name] = name
        walk(tree, frozenset())
    return sorted(f"{where}.{name}" for name, where in defined.items() if name not in named)


def loaded(arguments: list[str]) -> int:
    """Return how many modules of metrosep a command loads."""
    call = [sys.executable, "-c", LOADED, json.dumps(arguments)]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, check=True)
    code, count = json.loads(done.stdout.splitlines()[-1])
    if code not in (0, None):
        raise SystemExit(f"metrosep {' '.join(arguments)} ended with {code}")
    return int(count)


def help_ms(times: int = 11) -> float:
    """Return the median time of ``metrosep --help`` over that of Python alone, in ms of the processor.

    A clock on the wall would measure what else the machine does.
    """

    def took(call: list[str]) -> float:
        began = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(call, cwd=ROOT, capture_output=True, check=True)
        ended = resource.getrusage(resource.RUSAGE_CHILDREN)
        return 1e3 * (sum(ended[:2]) - sum(began[:2]))  # user and system

    ours = [sys.executable, "-c", "from metrosep.cli.main import main; main(['--help'])"]
    bare = [sys.executable, "-c", "pass"]
    pairs = [(took(ours), took(bare)) for _ in range(times)]
    return statistics.median(a - b for a, b in pairs)


def main() -> int:
    """Print the measures, and return how many are missed."""
    known = modules()
    lengths = {n: len(p.read_text().splitlines()) for n, p in known.items()}
    folders: dict[Path, int] = {}
    for path in known.values():
        folders[path.parent] = folders.get(path.parent, 0) + 1
    full = {f.relative_to(ROOT).as_posix(): n for f, n in folders.items() if n > MOST_IN_FOLDER}
    long_ = {n: k for n, k in lengths.items() if k > LONGEST}
    rings, upwards = circles(imports(known)), strings_upwards(known)
    trees = {name: ast.parse(path.read_text()) for name, path in known.items()}
    packages = {name: path.name == "__init__.py" for name, path in known.items()}
    doubled, tested = twice(trees), only_tested(trees, packages)
    measures: list[tuple[str, object, object, bool]] = [
        ("lines", sum(lengths.values()), MOST_LINES, sum(lengths.values()) <= MOST_LINES),
        ("files", len(known), MOST_FILES, len(known) <= MOST_FILES),
        ("folders with too many modules", full or 0, f"{MOST_IN_FOLDER} each", not full),
        ("modules that are too long", long_ or 0, f"{LONGEST} lines", not long_),
        ("circles of imports", [len(r) for r in rings] or 0, 0, not rings),
        ("texts that name an upper layer", len(upwards), 0, not upwards),
        ("declarations found twice", len(doubled), 0, not doubled),
        ("classes that only tests reach", len(tested), 0, not tested),
    ]
    for title, call, most in (
        ("modules of `measure`", MEASURE, MOST_OF_MEASURE),
        ("modules of `separate`", SEPARATE, MOST_OF_SEPARATE),
    ):
        count = loaded(call)
        measures.append((title, count, most, count <= most))
    ms = help_ms()
    measures.append(("`--help` over bare Python / ms", round(ms), HELP_MS, ms <= HELP_MS))
    for title, value, limit, kept in measures:
        print(f"{'ok    ' if kept else 'MISSED'}  {title:<32} {value}   (at most {limit})")
    for ring in rings:
        print("circle:", ", ".join(r.removeprefix("metrosep.") for r in ring))
    for text in upwards:
        print("upwards:", text)
    for text in doubled:
        print("twice:", text)
    for text in tested:
        print("only tested:", text)
    folder_lines: dict[str, int] = {}
    for name, count in lengths.items():
        part = name.split(".")[1] if "." in name else "metrosep"
        folder_lines[part] = folder_lines.get(part, 0) + count
    print(
        "lines:",
        ", ".join(f"{k} {n}" for k, n in sorted(folder_lines.items(), key=lambda i: -i[1])),
    )
    return sum(not kept for *_, kept in measures)


if __name__ == "__main__":
    sys.exit(main())
