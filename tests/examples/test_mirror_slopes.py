"""Example mirror_slopes: its input is reproducible, its numbers are right."""

import importlib.util
import math

import numpy as np
import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "mirror_slopes"


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_input_is_made_by_its_script(folder, tmp_path):
    load(folder / "make_data.py").main(tmp_path)

    for name in ("slopes.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_script_scores(folder, capsys):
    results, truth = load(folder / "integrate.py").main()

    # 0.05 urad in each of 4 passes, 1 mm steps, 401 places: s h sqrt(N / 15) / 2
    expected = 0.5 * 0.05e-6 * 1e-3 * math.sqrt(401 / 15)
    for name, result in results.items():
        u = math.sqrt(np.mean(result.u["height"] ** 2))
        assert u == pytest.approx(expected, rel=0.1, abs=0.0), name
        assert (result.height - truth).std() < 2.5 * u, name
    assert "noise of one slope" in capsys.readouterr().out
