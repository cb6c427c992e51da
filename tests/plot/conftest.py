"""Documents as json.load gives them from a result.json, made from a simulated axis."""

import importlib.util
import pickle
import sys
from pathlib import Path

import pytest

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
