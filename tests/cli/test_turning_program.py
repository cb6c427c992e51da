"""The program file of a turned part: what a machine that is sent its numbers would cut."""

import csv

import numpy as np
import pytest

import metrosep as ms

Rs, R = 40e-3, 0.8e-3
RECIPE = """metrosep = 1
[[step]]
op = "predict"
form = "sphere: R=40 mm"
radius = "5 mm"
core = "4.8 mm"
feed = "10 um"
rpm = 30
angle_step = "5 deg"
{}
[[output]]
kind = "parts"
[[output]]
kind = "report"
formats = ["html"]
"""


@pytest.fixture
def turned(metrosep, tmp_path):
    """Run a prediction with more keys: exit code, text, columns of the program, report."""

    def run(keys):
        recipe, out = tmp_path / "turn.toml", tmp_path / "out"
        recipe.write_text(RECIPE.format(keys), "utf-8")
        code, shown, errors = metrosep("run", recipe, "-o", out)
        if code:
            return code, errors, {}, ""
        with (out / "parts-program.csv").open(newline="") as file:
            rows = list(csv.reader(file))
        columns = dict(zip(rows[0], np.array(rows[1:], float).T, strict=True))
        return code, shown + errors, columns, (out / "report.html").read_text("utf-8")

    return run


def test_a_program_without_a_nose_is_marked_in_file_report_and_terminal(turned):
    _, shown, columns, report = turned('dx = "1 nm"')

    assert {"cut_point_rho_um", "cut_point_z_command_nm"} <= set(columns)
    rho = 1e-6 * columns["cut_point_rho_um"]
    # a ball of 0.5 mm within the bowl: its tip path is (Rs - Z - R)^2 + X^2 = (Rs - R)^2
    tip = Rs - 0.5e-3 - np.sqrt((Rs - 0.5e-3) ** 2 - rho**2)
    deep = 1e6 * np.max(tip - (Rs - np.sqrt(Rs**2 - rho**2)))
    for text in (shown, report):
        assert "ut points: these are points of the surface, no tip path" in text
        said = float(text.replace("µ", "u").split("500 um cuts up to about ")[1].split(" um")[0])
        assert said == pytest.approx(deep, rel=0.02, abs=0.0)


def test_a_program_with_a_nose_holds_the_tip_of_a_ball_in_a_bowl(turned):
    _, shown, columns, report = turned('nose_radius = "0.8 mm"')

    x, z = 1e-6 * columns["tip_rho_um"], 1e-9 * columns["tip_z_command_nm"]
    assert np.abs(Rs - R - np.sqrt((Rs - R) ** 2 - x**2) - z).max() < 1e-14
    assert "cut points" not in shown + report


def test_a_raked_nose_is_asked_for_its_way_and_the_hint_works(turned):
    keys = 'nose_radius = "0.8 mm"\nrake = "-25 deg"'
    code, errors, _, _ = turned(keys)
    assert code == 2
    assert 'give sense = "counterclockwise"' in errors
    code, _, columns, _ = turned(keys + '\nsense = "counterclockwise"')
    assert code == 0
    # specs/cutting-path.md, (8): a raked circle in a hollow sphere
    c, s = np.cos(np.deg2rad(25)), np.sin(np.deg2rad(25))
    h = Rs - 1e-9 * columns["tip_z_command_nm"]
    left = (1e-6 * columns["tip_rho_um"]) ** 2 + h**2 - 2 * R * h * c
    assert left == pytest.approx(Rs**2 - 2 * R * np.sqrt(Rs**2 - (h * s) ** 2), rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ('rake = "-25 deg"', "rake belongs to a nose; give its radius: nose_radius"),
        (
            'nose_radius = "80 mm"',
            "the nose gouges: its tip radius 80 mm is larger than the concave",
        ),
        ('nose_radius = "0.8 mm"\nwindow = "10 deg"', "window from -5 to 5 degrees"),
    ],
)
def test_noses_that_cannot_cut_the_part_are_refused(turned, keys, words):
    code, errors, columns, _ = turned(keys)
    assert code != 0
    assert words in errors
    assert not columns


@pytest.mark.parametrize("verb", ["predict", "cut_budget"])
def test_one_section_of_the_part_is_refused_where_a_map_is_needed(metrosep, tmp_path, verb):
    ms.write(ms.Profile(np.arange(99) * 1e-4, np.arange(99) * 1e-9), tmp_path / "section.smd")
    keys = 'nose_radius = "0.8 mm"\npart = "section.smd"'
    text = RECIPE.format(keys)
    if verb == "cut_budget":
        keys += '\nprogram = "p.csv"\nform = "sphere: R=40 mm"\nc_positive = "workpiece ccw"'
        text = f'metrosep = 1\n[[step]]\nop = "cut_budget"\n{keys}\n'
        (tmp_path / "p.csv").write_text(
            "# quantity tip\n# interpolation linear\nt_s,X_mm,C_deg,Z_mm\n"
            + "".join(f"{k / 8},{5 - k / 800},{-45 * k},0\n" for k in range(99))
        )
    (tmp_path / "r.toml").write_text(text)
    code, _, error = metrosep("predict", tmp_path / "r.toml", "-o", tmp_path / "out")
    assert code in (2, 4)
    assert "section.smd holds a Profile" in error
    assert "give the map of the part around the axis" in error
    assert not (tmp_path / "out").exists()
