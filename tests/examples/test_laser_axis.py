"""The example of a laser on an axis: its input is reproducible, its numbers are right."""

import importlib.util
import runpy

import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "laser_axis"


def test_input_is_made_by_its_script(folder, tmp_path):
    spec = importlib.util.spec_from_file_location("make_data", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    for name in ("readings.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_script_scores_against_the_truth(folder, capsys):
    runpy.run_path(str(folder / "find_error.py"), run_name="__main__")
    out = capsys.readouterr().out.split("\n")

    assert float(out[0].split("truth")[1].split("nm")[0]) > 100_000.0
    # noise of the mean of five runs, 5 nm of the beam's limit, 0.02 % of saturation in the simulator
    assert float(out[1].split("truth")[1].split("nm")[0]) < 15.0
    play = next(line for line in out if line.startswith("B_mean"))
    assert abs(float(play.split()[1]) - 800.0) < 3.0
