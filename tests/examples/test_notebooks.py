"""The notebooks of the tutorials: the cells are those of the pages, they were run, and Jupyter can read them."""

import base64
import importlib.util
import json
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
LARGEST = 400_000
"""Bytes of a notebook in the repository."""


def _tool():
    spec = importlib.util.spec_from_file_location("notebooks", REPOSITORY / "tools/notebooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


TOOL = _tool()


def load(page):
    file = TOOL.TARGET / f"{page.stem}.ipynb"
    assert file.is_file(), f"run: python tools/notebooks.py {page.stem}"
    assert file.stat().st_size < LARGEST
    return json.loads(file.read_text("utf-8"))


@pytest.mark.parametrize("page", TOOL.pages(), ids=lambda p: p.stem)
def test_the_cells_of_a_notebook_are_those_of_its_page(page):
    stored = [(c["cell_type"], "".join(c["source"])) for c in load(page)["cells"]]
    wanted = TOOL.cells_of(page.read_text("utf-8"))
    assert stored == wanted, f"run: python tools/notebooks.py {page.stem}"


@pytest.mark.parametrize("page", TOOL.pages(), ids=lambda p: p.stem)
def test_a_notebook_was_run_and_shows_what_it_draws(page):
    made = load(page)
    cells = [c for c in made["cells"] if c["cell_type"] == "code"]
    assert [c["execution_count"] for c in cells] == list(range(1, len(cells) + 1))
    outputs = [o for c in cells for o in c["outputs"]]
    text = "".join("".join(o.get("text", "")) for o in outputs)
    assert "Traceback" not in text
    assert not any(line.startswith("error: ") for line in text.splitlines())
    pictures = [o["data"]["image/png"] for o in outputs if "image/png" in o.get("data", {})]
    assert all(base64.b64decode(p).startswith(b"\x89PNG") for p in pictures)
    sources = ["".join(c["source"]) for c in cells]
    assert len(pictures) >= sum(".plot(" in s for s in sources)
    assert len({c["id"] for c in made["cells"]}) == len(made["cells"])


@pytest.mark.parametrize("page", TOOL.pages(), ids=lambda p: p.stem)
def test_jupyter_reads_a_notebook(page):
    nbformat = pytest.importorskip("nbformat")
    nbformat.validate(nbformat.from_dict(load(page)))


def test_blocks_become_cells_and_outputs_stay_in_the_text():
    page = "# A\n\nText.\n\n```console\nmetrosep formats\n```\n\n```text\nout\n```\n\n```python\n>>> 1 + 1\n2\n```\n"
    assert TOOL.cells_of(page) == [
        ("markdown", "# A\n\nText."),
        ("markdown", "Run this notebook in the root of the repository: it reads `examples`."),
        ("code", "!metrosep formats"),
        ("markdown", "```text\nout\n```"),
        ("code", "1 + 1"),
    ]
