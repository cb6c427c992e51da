"""Heavy packages are loaded where they are used, never by an import of metrosep."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator

import metrosep as ms

PROGRAMS = frozenset({"metrosep/io/containers/hdf5_worker.py"})
"""Run as processes of their own; nothing imports them."""

HEAVY = frozenset(
    {"scipy", "pandas", "matplotlib", "lmfit", "h5py", "skimage", "jinja2", "pyarrow"}
)


def test_no_module_imports_a_heavy_package_at_module_level(modules):
    found = [
        f"{path}:{line}: {name}"
        for path, tree in modules.items()
        for line, name in _imports_on_load(tree.body)
        if name.split(".")[0] in HEAVY and path not in PROGRAMS
    ]

    assert not found, "import these inside the functions that need them:\n" + "\n".join(found)


def test_a_planted_heavy_import_is_found():
    tree = ast.parse("try:\n    import scipy.signal\nexcept ImportError:\n    pass\n")

    assert list(_imports_on_load(tree.body)) == [(2, "scipy.signal")]


def test_type_checking_and_function_imports_cost_nothing():
    tree = ast.parse(
        "if TYPE_CHECKING:\n    import pandas\ndef f():\n    import scipy\n    return scipy\n"
    )

    assert list(_imports_on_load(tree.body)) == []


def test_help_on_the_command_line_imports_no_numpy():
    code = (
        "import sys\n"
        "from metrosep.cli.main import main\n"
        "sys.argv = ['metrosep', '--help']\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code, end.code\n"
        "names = {m.split('.')[0] for m in sys.modules}\n"
        f"print(sorted(names & {set(HEAVY | {'numpy'})!r}), file=sys.stderr)\n"
    )

    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert "demo" in run.stdout
    assert run.stderr.strip().splitlines()[-1] == "[]"


def test_import_metrosep_loads_numpy_at_most():
    code = (
        "import sys, json\n"
        "before = set(sys.modules)\n"
        "import metrosep\n"
        "after = {m.split('.')[0] for m in set(sys.modules) - before}\n"
        "print(json.dumps(sorted(after - set(sys.stdlib_module_names))))\n"
    )

    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert set(json.loads(run.stdout)) <= {"metrosep", "numpy"}


def test_every_public_name_of_the_package_resolves():
    missing = [name for name in ms.__all__ if not hasattr(ms, name)]

    assert not missing


def _imports_on_load(body: list[ast.stmt]) -> Iterator[tuple[int, str]]:
    """Line and name of the imports that run when the module is imported."""
    for node in body:
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.lineno, node.module or ""
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            yield from _imports_on_load(node.orelse)
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for part in ("body", "orelse", "finalbody"):
                yield from _imports_on_load(getattr(node, part, []))
            for handler in getattr(node, "handlers", []):
                yield from _imports_on_load(handler.body)


def test_reading_a_map_loads_no_heavy_package(repository):
    """Binary maps need NumPy only; pandas, SciPy, matplotlib and h5py stay out."""
    code = (
        "import sys, metrosep as ms, metrosep.io\n"
        f"ms.read({str(repository / 'data_formats/metropro/samples/format1.dat')!r})\n"
        f"ms.read({str(repository / 'data_formats/metrosep-h5/samples/surface.h5')!r})\n"
        "names = {m.split('.')[0] for m in sys.modules}\n"
        f"print(sorted(names & {set(HEAVY)!r}))\n"
    )

    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert run.stdout.strip() == "[]"
