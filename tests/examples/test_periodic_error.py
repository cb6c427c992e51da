"""The example of periodic error: its input is reproducible, its numbers are right."""

import importlib.util
import runpy

import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "periodic_error"


def test_input_is_made_by_its_script(folder, tmp_path):
    spec = importlib.util.spec_from_file_location("make_data", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    for name in ("scan.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
        assert (folder / name).stat().st_size < 300_000


def test_script_scores_against_the_truth(folder, capsys):
    runpy.run_path(str(folder / "find_error.py"), run_name="__main__")
    out = capsys.readouterr().out

    for line in out.split("\n")[:2]:
        found = float(line.split("harmonic")[1].split("nm")[0])
        u = float(line.split(" u ")[1].split("nm")[0])
        truth = float(line.split("truth")[1].split("nm")[0])
        left = float(line.split("left")[1].split("nm")[0])
        assert abs(found - truth) < 3 * u  # u is that of one part of the amplitude
        assert left < 1e-5
    noise = float(out.split("noise of a reading")[1].split("nm")[0])
    assert abs(noise - 0.4) < 0.02
