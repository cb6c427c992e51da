"""The examples of standards sheets: data reproducible, values right."""

import importlib.util
import re
import runpy

import pytest

FILES = {
    "positioning": ("runs.csv", "diagonals.csv", "truth.csv"),
    "drift": ("warm_up.csv", "sequence.csv", "speeds.csv", "truth.csv"),
}


@pytest.mark.parametrize("example", FILES)
def test_data_are_made_by_their_script(repository, tmp_path, example):
    folder = repository / "examples" / example
    spec = importlib.util.spec_from_file_location(example, folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    module.main(tmp_path)

    for name in FILES[example]:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def scores(repository, capsys, example):
    runpy.run_path(str(repository / "examples" / example / "evaluate.py"), run_name="__main__")
    out = capsys.readouterr().out
    number = r"(-?\d+\.\d+) \w+"
    found = re.findall(rf"^(.+?)\s+{number}, u {number}, truth {number}$", out, flags=re.MULTILINE)
    return {name: tuple(map(float, rest)) for name, *rest in found}


def test_positioning_scores(repository, capsys):
    found = scores(repository, capsys, "positioning")

    assert len(found) == 8
    for name in ("E", "B_mean", "M", "R_unbiased", "a_xy", "a_xz", "a_yz"):
        value, u, truth = found[name]
        assert abs(value - truth) <= 3 * u
    assert found["R"][0] > found["R"][2]  # the largest of few


def test_drift_scores(repository, capsys):
    found = scores(repository, capsys, "drift")

    assert len(found) == 6
    for name, (value, u, truth) in found.items():
        if "range" not in name:
            assert abs(value - truth) <= 3 * u
    value, _, truth = found["combined range, 4 h"]
    assert 0.0 <= value - truth <= 0.15  # noise of 0.02 um widens each range
