"""Documents as json.load gives them from a result.json, made from a simulated axis."""

import copy
import importlib.util
from pathlib import Path

import pytest

MAKER = Path(__file__).resolve().parents[1] / "plot" / "documents.py"


@pytest.fixture(scope="session")
def _made():
    """Documents by method and directions, made once."""
    spec = importlib.util.spec_from_file_location("documents", MAKER)
    maker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(maker)
    return {
        ("joint", 2): maker.make_document("joint", (1, -1)),
        ("kono", 1): maker.make_document("kono", (1,)),
        ("mean", 1): maker.make_document("mean", (1,)),
    }


@pytest.fixture
def document(_made):
    """Result of the joint method with both directions and a table."""
    return copy.deepcopy(_made["joint", 2])


@pytest.fixture(params=["kono", "mean"])
def plain_document(_made, request):
    """Result of a method without a residual PSD; of the mean without a spectrum."""
    return copy.deepcopy(_made[request.param, 1])


@pytest.fixture
def mean_document(_made):
    """Result of the mean: no selected wavelengths, no residual PSD."""
    return copy.deepcopy(_made["mean", 1])
