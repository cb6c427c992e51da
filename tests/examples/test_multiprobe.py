"""The example of four probes: reproducible data, honest scores against the truth."""

import importlib.util
import runpy

import pytest


@pytest.fixture
def folder(repository):
    return repository / "examples" / "multiprobe"


def test_data_are_made_by_their_script(folder, tmp_path):
    spec = importlib.util.spec_from_file_location("make_multiprobe", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    for name in ("readings.csv", "truth.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_script_finds_ball_and_motion(folder, capsys):
    runpy.run_path(str(folder / "separate_ball.py"), run_name="__main__")
    out = capsys.readouterr().out

    # noise 2 nm, gain 0.77, 58 numbers from 6 * 180 readings: 2 * 0.77 * sqrt(58 / 1080) = 0.36
    for name, limit in (("artefact", 0.5), ("x", 3.0), ("y", 2.5)):
        score, stated = out.split(f"{name}: RMS against truth")[1].split("\n")[0].split("stated u")
        assert float(score.split("nm")[0]) < limit
        assert 0.4 < float(score.split("nm")[0]) / float(stated.split("nm")[0]) < 2.0
    assert "the probes agree" in out
    assert "k = 7, 9, 15, 17, 23, 25" in out
