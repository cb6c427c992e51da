"""Documents as json.load gives them from a result.json, made from a simulated axis."""

import importlib.util
import os
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.recipe import Recipe
from metrosep.report import render_html

MAKER = Path(__file__).resolve().parents[1] / "plot" / "documents.py"
NAME = "metrosep_test_documents"


@pytest.fixture(scope="session")
def make_document():
    """Copy of the document of a method, made once for the plots and the reports."""
    if NAME not in sys.modules:
        spec = importlib.util.spec_from_file_location(NAME, MAKER)
        sys.modules[NAME] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[NAME])
    made = sys.modules[NAME].make_document
    # a third of the time of copy.deepcopy
    return lambda method, directions: pickle.loads(pickle.dumps(made(method, directions)))  # noqa: S301


@pytest.fixture
def document(make_document):
    """Result of the joint method with both directions and a table."""
    return make_document("joint", (1, -1))


@pytest.fixture(params=["kono", "mean"])
def plain_document(make_document, request):
    """Result of a method without a residual PSD; of the mean without a spectrum."""
    return make_document(request.param, (1,))


@pytest.fixture
def mean_document(make_document):
    """Result of the mean: no selected wavelengths, no residual PSD."""
    return make_document("mean", (1,))


@pytest.fixture(scope="session")
def whole_page(make_document):
    """Report with all figures."""
    return render_html(make_document("joint", (1, -1)))


@pytest.fixture(autouse=True)
def _once_here(separations_once, uncertainties_once):
    """These tests ask what becomes of a separation, not whether it repeats itself."""


SCHEMAS = Path(
    os.environ.get("METROSEP_SCHEMAS") or Path(__file__).resolve().parents[3] / "shared/schemas"
)

JUDGED = """
[[check]]
metric = "Sz"
name = "height"
upper = "10 nm"
U = "1 nm"
[[check]]
metric = "Ssk"
name = "skewness"
lower = -0.5
upper = 0.1
U = 0.2
"""


@pytest.fixture
def schemas(request):
    """Folder of the published schemas; skips where that of the module, or what reads it, is absent."""
    pytest.importorskip("lxml")
    root = {"test_dcc": "dcc*.xsd", "test_qif": "QIFDocument.xsd"}[request.path.stem]
    if not SCHEMAS.is_dir() or not any(SCHEMAS.rglob(root)):
        pytest.skip(f"no published schema {root}: set METROSEP_SCHEMAS")
    return SCHEMAS


@pytest.fixture(scope="session")
def certified(tmp_path_factory):
    """A measured ring with every field of a report, one value accepted, one rejected, one undecided."""
    from .test_certificate import REPORT, STEPS

    folder = tmp_path_factory.mktemp("certified")
    x = np.arange(48) * 100e-6
    z = 60e-9 * np.sin(np.add.outer(x, x) / 1e-3)
    ms.write(ms.Surface(z, 100e-6, 100e-6), folder / "part.x3p")
    text = STEPS.replace('"Sz"]', '"Sz", "Ssk", "Sku"]') + JUDGED + REPORT
    return Recipe.parse(text, folder=folder).run(folder / "part.x3p").document
