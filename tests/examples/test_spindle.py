"""The spindle example: its input is reproducible, its numbers are right."""

import importlib.util
import runpy

import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "spindle"


def test_input_is_made_by_its_script(folder, tmp_path):
    spec = importlib.util.spec_from_file_location("make_data", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    for name in ("spindle.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
        assert (folder / name).stat().st_size < 300_000


def test_script_scores_against_the_truth(folder, capsys):
    runpy.run_path(str(folder / "analyse.py"), run_name="__main__")
    out = capsys.readouterr().out

    value = float(out.split("synchronous      ")[1].split("nm")[0])
    truth = float(out.split("value of the truth")[1].split("nm")[0])
    assert abs(value / truth - 1) < 0.01
    assert float(out.split("RMS against truth")[1].split("nm")[0]) < 0.5
    # 3 nm at 0.43 of the speed and 1.5 nm of noise: sd sqrt(3^2 / 2 + 1.5^2) = 2.6 nm
    four_sd = float(out.split("asynchronous_4s")[1].split("nm")[0])
    assert abs(four_sd / (4 * 2.598) - 1) < 0.1
    assert "speed 1199 to 1176 rev/min" in out
