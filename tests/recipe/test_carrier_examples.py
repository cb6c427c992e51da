"""The examples of the carriers: what is written, cut and left is what their pages say."""

import re
import runpy
import sys

import numpy as np
import pytest

import metrosep as ms
from metrosep import controllers
from metrosep.core.errors import MetrosepError

FINE_NM = 12.5
"""What the separation leaves of the slide's 322.7 nm; files of entries below 1 nm add nothing."""

COARSE_NM = FINE_NM + 0.5 * 100.0 / 12**0.5 * 2
"""Entries of 0.1 um: rounded by 29 nm RMS at most, added as if in phase."""

COARSE = {"isg-cross", "heidenhain", "fanuc", "mitsubishi"}
REFUSED = {"pmac-backlash", "sinumerik-enc", "isg-axis", "fanuc-straightness"}


@pytest.fixture(scope="module")
def examples(request):
    return request.config.rootpath / "examples"


def run(path, *arguments):
    """Run a script as a user would, and return its names."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [path.name, *map(str, arguments)])
        return runpy.run_path(str(path), run_name="__main__")


def printed_rows(text):
    """Return name -> numbers of lines ``name 1.0 2.0 3.0``."""
    rows = re.findall(r"^([\w-]+) +([\d.]+) +([\d.]+) +([\d.]+)$", text, re.MULTILINE)
    return {name: tuple(map(float, numbers)) for name, *numbers in rows}


@pytest.fixture(scope="module")
def written(examples, tmp_path_factory):
    folder = tmp_path_factory.mktemp("carriers")
    return folder, run(examples / "carriers" / "tables.py", folder)


def test_each_file_of_the_carriers_cuts_a_better_part_and_a_worse_one_if_flipped(
    written, examples, capsys
):
    folder, names = written
    run(examples / "carriers" / "cut_parts.py", folder)
    rows = printed_rows(capsys.readouterr().out)

    assert set(rows) == set(names["CARRIERS"])
    for name, (before, after, flipped) in rows.items():
        assert before == pytest.approx(322.7, abs=0.1)
        assert after < (COARSE_NM if name in COARSE else FINE_NM), name
        assert flipped > 1.9 * before, name


def test_page_of_the_carriers_says_what_the_script_prints(written, examples, capsys):
    run(examples / "carriers" / "cut_parts.py", written[0])
    rows = printed_rows(capsys.readouterr().out)
    page = (examples / "carriers" / "README.md").read_text("utf-8")
    stated = re.findall(r"^\| ([\w, -]+) \| ([\d.]+) \| ([\d.]+) \|", page, re.MULTILINE)
    told = {n: (float(a), float(f)) for names, a, f in stated for n in names.split(", ")}

    assert told == {name: row[1:] for name, row in rows.items()}


def test_every_other_carrier_of_tables_refuses_this_one(written, tmp_path, examples):
    _, names = written
    carry = {i.id: i for i in controllers.describe() if i.carries == "table"}

    assert set(carry) == set(names["CARRIERS"]) | REFUSED
    for name in REFUSED:
        with pytest.raises(MetrosepError):
            controllers.write(
                names["table"], tmp_path / name, name, sign_confirmed=True, **carry[name].example
            )
        assert not (tmp_path / name).exists()
        assert f"`{name}`" in (examples / "carriers" / "README.md").read_text("utf-8")


def test_recipe_of_the_carriers_writes_six_files_that_pass(examples, tmp_path):
    result = ms.Recipe.load(examples / "carriers" / "recipe.toml").run(out=tmp_path / "out")

    assert result.verdict == "accept"
    table = controllers.simulate(tmp_path / "out" / "pmac.pmc", "pmac")
    polynomial = controllers.simulate(tmp_path / "out" / "MetrosepCorrection.st", "plc-st")
    x, truth = np.loadtxt(
        examples / "straightness" / "truth.csv", delimiter=",", skiprows=1, unpack=True
    )

    def left(lookup):
        rest = truth * 1e3 + lookup(x * 1e-3) * 1e9
        return np.std(rest - np.polyval(np.polyfit(x, rest, 1), x))

    assert left(table) < FINE_NM
    assert left(polynomial) < 50.0  # degree 16 follows the waves of the screw, but not closely
