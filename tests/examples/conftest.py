"""What the tests of the examples share: making the data again, running a script."""

import importlib.util
import runpy

import pytest

MOST_BYTES = 150_000
"""Of all files of one example."""


@pytest.fixture
def made_again(repository, tmp_path):
    """Return a check that the data of an example are those of its script, byte for byte."""

    def check(name):
        folder = repository / "examples" / name
        spec = importlib.util.spec_from_file_location(f"make_{name}", folder / "make_data.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        module.main(tmp_path)
        made = sorted(f.name for f in tmp_path.iterdir())
        assert made == sorted(f.name for f in folder.glob("*.csv"))
        for file in made:
            assert (tmp_path / file).read_bytes() == (folder / file).read_bytes()
        assert sum(f.stat().st_size for f in folder.iterdir() if f.is_file()) < MOST_BYTES

    return check


@pytest.fixture
def scripted(repository, capsys):
    """Return a function that runs the script of an example: its names, and what it printed."""

    def run(name, script):
        path = repository / "examples" / name / script
        assert len(path.read_text("utf-8").splitlines()) < 70
        names = runpy.run_path(str(path), run_name="__main__")
        return names, capsys.readouterr().out

    return run


@pytest.fixture
def scores():
    """Return a function that reads ``part: RMS against truth a, u b`` from what was printed."""

    def read(out, part):
        line = out.split(f"{part}: RMS against truth")[1].splitlines()[0]
        rms, u = line.split(", u ")
        return float(rms.split()[0]), float(u.split()[0])

    return read


@pytest.fixture(autouse=True, scope="module")
def _once_here(quick_doors):
    """These tests ask what becomes of a result, not whether it repeats itself, and read the text."""
