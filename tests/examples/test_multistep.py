"""The example of 8 and 7 steps: reproducible data, the second run closes the gaps."""

import importlib.util
import runpy

import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "multistep"


def test_data_are_made_by_their_script(folder, tmp_path):
    spec = importlib.util.spec_from_file_location("make_multistep", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    for name in ("readings.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_seven_more_steps_close_the_gaps_of_eight(folder, capsys):
    runpy.run_path(str(folder / "separate_ring.py"), run_name="__main__")
    eight, both = capsys.readouterr().out.split("steps (8, 7)")

    def score(text, name):
        return float(text.split(f"{name}: RMS against truth")[1].split("nm")[0])

    assert "k = [8, 16]" in eight
    # what is missing: sqrt((5^2 + 3^2)/2) of the ring, 4/sqrt(2) of the spindle
    assert score(eight, "artefact") == pytest.approx(4.12, abs=0.1)
    assert score(eight, "spindle") == pytest.approx(2.83, abs=0.1)
    assert "k = []" in both
    assert score(both, "artefact") < 0.4
    assert score(both, "spindle") < 0.4
