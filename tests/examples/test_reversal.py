"""The example of the reversal: reproducible data, and a script that scores against the truth."""

import importlib.util
import runpy

import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "reversal"


def test_data_are_made_by_their_script(folder, tmp_path):
    spec = importlib.util.spec_from_file_location("make_reversal", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    for name in ("donaldson.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_script_finds_ball_and_spindle(folder, capsys):
    runpy.run_path(str(folder / "separate_ball.py"), run_name="__main__")
    out = capsys.readouterr().out

    # noise 1.5 nm and wander of 2 nm over 16 revolutions: sqrt(1.5**2 + 2**2 / 2) / 4
    for name in ("ball", "spindle"):
        assert float(out.split(f"{name}: RMS against truth")[1].split("nm")[0]) < 0.75
    assert "offset, eccentricity not observable" in out
