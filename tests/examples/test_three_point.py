"""Example three_point: its input is reproducible, its numbers are right."""

import importlib.util

import numpy as np
import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "three_point"


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_input_is_made_by_its_script(folder, tmp_path):
    load(folder / "make_data.py").main(tmp_path)

    for name in ("readings.csv", "flat.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_script_scores(folder, capsys):
    results = load(folder / "separate.py").main()

    edge = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1, unpack=True)[1]
    t = np.linspace(-1, 1, edge.size)
    edge = (edge - np.polyval(np.polyfit(t, edge, 1), t)) * 1e-9
    rest = {k: r.artefact - edge for k, r in results.items()}
    # 40 nm of zero: sag 4500 nm, RMS of a parabola without its line 0.298 of that
    assert rest["zero taken as 0"].std() == pytest.approx(0.298 * 4500e-9, rel=0.1, abs=0.0)
    assert rest["zero from the flat"].std() < 60e-9
    assert rest["with the pitch sensor"].std() < 3e-9
    for name in ("zero from the flat", "with the pitch sensor"):
        assert np.mean(np.abs(rest[name]) <= 2 * results[name].u["artefact"]) >= 0.9
    out = capsys.readouterr().out
    assert "4496 nm" in out
    assert "parabola is not known" in out
