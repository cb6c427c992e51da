"""The stitching example: its input is reproducible, its numbers are right."""

import importlib.util
import runpy

import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "stitching"


def test_input_is_made_by_its_script(folder, tmp_path):
    spec = importlib.util.spec_from_file_location("make_data", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    names = [*(f"map_{i}.csv" for i in range(1, 10)), "truth.csv"]
    assert sorted(f.name for f in folder.glob("*.csv")) == sorted(names)
    for name in names:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
        assert (folder / name).stat().st_size < 60_000


def test_script_scores_against_the_truth(folder, capsys):
    runpy.run_path(str(folder / "stitch_flat.py"), run_name="__main__")
    out = capsys.readouterr().out

    ignored = float(out.split("surface wrong by")[1].split("nm")[0])
    surface = out.split("surface   wrong by")[1].split("\n")[0]
    error, u = float(surface.split("nm")[0]), float(surface.split("u ")[1].split("nm")[0])
    assert ignored > 2.0
    assert error < 1.5 * u < 1.0  # S17
    reference = float(out.split("reference wrong by")[1].split("nm")[0])
    assert reference < 0.5
    noise = float(out.split("overlaps scatter")[2].split("nm")[0])
    assert abs(noise - 0.5) < 0.02
    assert "power, astigmatism 0, astigmatism 45 not observable" in out
