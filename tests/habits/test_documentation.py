"""The README and the documentation are executed: Python, sessions and command lines, page by page.

On each page the blocks run in their order, in one namespace and one empty folder that sees the
repository's ``examples``. Of the ``console`` blocks the lines that start with ``metrosep`` run; a
comment ``# exit code N`` at their end names a code other than 0. Calls of ``make`` must name a
target.
"""

import contextlib
import doctest
import io
import re
import shlex
from pathlib import Path
from typing import Any

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)

SESSION_FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def _pages() -> list[Path]:
    built = REPOSITORY / "docs" / "_build"
    docs = [path for path in (REPOSITORY / "docs").rglob("*.md") if built not in path.parents]
    top = [REPOSITORY / "README.md", REPOSITORY / "CONTRIBUTING.md"]
    return [path for path in [*top, *sorted(docs)] if FENCE.search(path.read_text("utf-8"))]


@pytest.mark.parametrize("page", _pages(), ids=lambda p: p.relative_to(REPOSITORY).as_posix())
@pytest.mark.usefixtures("one_figure_of_a_kind", "separations_once")
def test_every_block_of_the_page_runs(page, tmp_path, monkeypatch):
    for folder in ("examples", "data_formats"):
        (tmp_path / folder).symlink_to(REPOSITORY / folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("METROSEP_FORMATS", "")  # so that what a page sets does not outlive it
    namespace: dict[str, Any] = {"__name__": "__page__"}

    for language, code, line in _blocks(page):
        where = f"{page.name}:{line}"
        if language == "python" and code.lstrip().startswith(">>>"):
            _run_session(code, namespace, where)
        elif language == "python":
            exec(compile("\n" * line + code, str(page), "exec"), namespace)  # noqa: S102
        elif language == "console":
            _run_commands(code, where)


def test_make_targets_that_pages_name_exist():
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z][a-z-]*):", makefile, re.MULTILINE))
    named = {
        found.group(1)
        for page in _pages()
        for language, code, _ in _blocks(page)
        if language == "console"
        for found in re.finditer(r"^make (?:[A-Z]+=\S+ )*([a-z-]+)", code, re.MULTILINE)
    }

    assert {"demo", "test", "check"} <= named
    assert named <= targets


def test_links_between_pages_lead_somewhere():
    found = []
    pages = [REPOSITORY / "README.md", REPOSITORY / "CONTRIBUTING.md"]
    pages += sorted((REPOSITORY / "docs").rglob("*.md"))
    for page in pages:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            if "://" in target or target.endswith(".png") or "_build" in page.parts:
                continue
            if not (page.parent / target).exists():
                found.append(f"{page.relative_to(REPOSITORY)}: {target}")

    assert not found


def _blocks(page: Path) -> list[tuple[str, str, int]]:
    text = page.read_text(encoding="utf-8")
    return [(m[1], m[2], text.count("\n", 0, m.start()) + 1) for m in FENCE.finditer(text)]


def _run_session(code: str, namespace: dict[str, Any], where: str) -> None:
    test = doctest.DocTestParser().get_doctest(code, namespace, where, None, 0)
    test.globs = namespace
    said: list[str] = []
    failed, _ = doctest.DocTestRunner(optionflags=SESSION_FLAGS).run(
        test, out=said.append, clear_globs=False
    )
    assert not failed, f"{where}\n" + "".join(said)


def _run_commands(code: str, where: str) -> None:
    for line in code.replace("\\\n", " ").splitlines():
        if not line.startswith("metrosep "):
            continue
        expected = int(found.group(1)) if (found := re.search(r"# exit code (\d+)$", line)) else 0
        words = shlex.split(line, comments=True)[1:]
        code, said = _called(words)
        assert code == expected, f"{where}: {line}\n{said}"


def _called(words: list[str]) -> tuple[int, str]:
    """Run a command line in this process, which has the libraries loaded."""
    from metrosep.cli.main import main

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            main(words)
        except SystemExit as stop:
            return (stop.code if isinstance(stop.code, int) else 1), said.getvalue()
    return 0, said.getvalue()
