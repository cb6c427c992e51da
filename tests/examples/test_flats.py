"""The examples of flats and rotations: reproducible data, and scripts that score against the truth."""

import importlib.util
import runpy

import pytest

FILES = {
    "flats": ("ab.csv", "ac.csv", "bc.csv", "ab_54.csv", "truth.csv"),
    "rotation_test": (*(f"position_{d:03d}.csv" for d in (0, 90, 180, 270)), "truth.csv"),
}


@pytest.mark.parametrize("example", FILES)
def test_data_are_made_by_their_script(repository, example, tmp_path):
    folder = repository / "examples" / example
    spec = importlib.util.spec_from_file_location(f"make_{example}", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)

    for name in FILES[example]:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def scores(text, name):
    rms, u = text.split(f"{name}: RMS against truth")[1].split("nm")[:2]
    return float(rms), float(u.split("stated u")[1])


def test_three_flats_are_found_within_their_uncertainty(repository, capsys):
    runpy.run_path(str(repository / "examples/flats/absolute_flats.py"), run_name="__main__")
    out = capsys.readouterr().out

    for name in "ABC":
        rms, u = scores(out, name)
        assert rms < 0.1
        assert rms == pytest.approx(u, rel=0.5, abs=0.0)  # about 30 coefficients: 13 % each
    assert "diameter only" in out


def test_mirror_and_interferometer_are_found(repository, capsys):
    runpy.run_path(
        str(repository / "examples/rotation_test/separate_mirror.py"), run_name="__main__"
    )
    out = capsys.readouterr().out

    for name in ("part", "instrument"):
        rms, u = scores(out, name)
        assert rms == pytest.approx(u, rel=0.1, abs=0.0)
        assert rms == pytest.approx(0.4 * (3 / 16) ** 0.5, rel=0.1, abs=0.0)
    assert "angular orders 0, 4, 8" in out
