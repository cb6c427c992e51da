"""Readings of a laser against a simulated interferometer that counts fringes; signs planted one by one.

The simulator shares no formula with the package: it knows paths and phases only.
"""

import json
import math
import re

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.errors import MetrosepError
from metrosep.optics import refractive_index
from metrosep.recipe import Recipe
from metrosep.separation import LaserSetup, iso230_2, laser_positions
from metrosep.separation.positions.positioning import positions_from_columns

pytestmark = pytest.mark.usefixtures("without_figures")

PM = 1e-12
NM = 1e-9
ROUNDING = 1e-14
"""m; a metre as a double is known to 1e-16, some operations."""

VACUUM = 632.9908e-9
AIR = {"temperature": 293.95, "pressure": 100_300.0, "humidity": 0.41}


def n_of(t, p=100_300.0, h=0.41):
    return refractive_index(VACUUM, t, p, humidity=h)


def displayed(true, *, n, n_zero, n_software, dead=0.0, away=True, angle=0.0):
    """What the laser shows: whole phase of the path in air now, less that at zero, in its own unit."""
    sense = 1.0 if away else -1.0
    along_beam = dead + sense * true * math.cos(angle)  # distance to the interferometer
    fringes = 2.0 * (n * along_beam - n_zero * dead) / VACUUM
    return sense * fringes * VACUUM / 2.0 / n_software


@pytest.mark.parametrize("away", [True, False])
@pytest.mark.parametrize("n_software", [1.0, 1.0002650])
def test_wavelength_and_dead_path_give_the_true_displacement_back(away, n_software):
    true = np.array([0.0, 0.1, 0.37, -0.2])
    t = np.array([293.15, 293.45, 294.05, 293.95])  # the room warms up
    shown = displayed(
        true, n=n_of(t), n_zero=n_of(293.15), n_software=n_software, dead=0.8, away=away
    )
    setup = LaserSetup(
        software_index=n_software, dead_path="800 mm", positive="away" if away else "towards",
        **{k: v for k, v in AIR.items() if k != "temperature"},
    )  # fmt: skip
    made = setup.correct(shown, temperature=t)
    assert np.abs(shown + made.total - true).max() < ROUNDING
    # the wrong side of the interferometer makes it worse, not the same
    turned = LaserSetup(
        software_index=n_software, dead_path="800 mm", positive="towards" if away else "away",
        **{k: v for k, v in AIR.items() if k != "temperature"},
    ).correct(shown, temperature=t)  # fmt: skip
    assert np.abs(shown + turned.total - true).max() > 1000 * NM


def test_a_room_that_warms_up_makes_the_reading_too_small_away_from_the_laser():
    # 1 K over 1 m of dead path is about 0.93 um (textbooks), the reflector does not move
    setup = LaserSetup(
        software="same air", dead_path=1.0, positive="away",
        **{**AIR, "temperature": "21 degC", "reset_temperature": "20 degC"},
    )  # fmt: skip
    shift = setup.correct([0.0]).corrections["dead_path"][0]
    assert 0.90e-6 < shift < 0.98e-6


def test_other_air_in_the_software_is_undone():
    true = 0.6
    assumed = {"temperature": 293.15, "pressure": 101_325.0, "humidity": 0.50}
    n_software = n_of(293.15, 101_325.0, 0.50)
    shown = displayed(true, n=n_of(293.95), n_zero=n_of(293.95), n_software=n_software)
    setup = LaserSetup(**AIR, **{f"software_{k}": v for k, v in assumed.items()})
    assert abs(shown + setup.correct(shown).total[0] - true) < ROUNDING
    # compensated with the very air that was: nothing is left
    assert LaserSetup(software="same air", **AIR).correct(true).total[0] == 0.0


def test_a_measured_angle_makes_the_reading_longer():
    true, angle = np.array([0.0, 0.5, -0.5]), 1.5e-3
    shown = displayed(true, n=n_of(293.95), n_zero=n_of(293.95), n_software=1.0, angle=angle)
    setup = LaserSetup(software="vacuum", beam_angle=-angle, misalignment="measured", **AIR)
    made = setup.correct(shown)
    assert np.abs(shown + made.total - true).max() < ROUNDING
    assert made.corrections["cosine"][1] > 0.5e-6 > 0.0 > made.corrections["cosine"][2]
    assert any("u_beam_angle" in m for m in made.messages)


@pytest.mark.parametrize(("spot", "travel", "ppm"), [(0.5, 500, 0.13), (0.2, 125, 0.32)])
def test_the_walk_of_the_spot_is_that_of_the_manual(spot, travel, ppm):
    # HP 5528A user's guide: 0.5 mm over 500 mm is 0.13 ppm, 0.2 mm over 125 mm 0.3 ppm
    setup = LaserSetup(
        software="same air", spot_walk=f"{spot} mm", walk_travel=f"{travel} mm",
        misalignment="measured", u_spot_walk="0 mm", **AIR,
    )  # fmt: skip
    found = setup.correct(1.0).corrections["cosine"][0]
    assert abs(found - ppm * 1e-6) < 0.006e-6  # two digits


def test_a_limit_of_the_beam_is_an_asymmetric_rectangle():
    # direction anywhere in a cone of half-angle a, by lot
    rng, a = np.random.default_rng(5), 2e-3
    theta = a * np.sqrt(rng.random(400_000))
    lost = 1.0 / np.cos(theta) - 1.0
    made = LaserSetup(software="same air", beam_angle=a, **AIR).correct([0.0, 1.0])
    value, u = made.corrections["cosine"][1], made.u_of("cosine")[1]
    assert abs(value / lost.mean() - 1.0) < 0.005  # 0.1 % of scatter, five times
    assert abs(u / lost.std() - 1.0) < 0.005
    assert made.corrections["cosine"][0] == 0.0


def test_a_measured_beam_has_the_mean_and_spread_of_its_square():
    rng, angle, u = np.random.default_rng(6), 0.3e-3, 0.2e-3
    theta = angle + u * rng.standard_normal(400_000)
    lost = 1.0 / np.cos(theta) - 1.0
    made = LaserSetup(
        software="same air", beam_angle=angle, u_beam_angle=u, misalignment="measured", **AIR
    ).correct(1.0)
    assert abs(made.corrections["cosine"][0] / lost.mean() - 1.0) < 0.01  # 0.2 %, five times
    assert abs(made.u_of("cosine")[0] / lost.std() - 1.0) < 0.015


@pytest.mark.parametrize("name", ["pitch", "yaw"])
def test_the_point_ahead_of_the_beam_went_further_where_the_angle_is_positive(name):
    # a carriage turned about the beam's foot: the point at h moves by h sin(angle)
    angle = np.array([100e-6, 103e-6, 96e-6])  # with the zero of the instrument in it
    h = 0.12
    moved = h * (np.sin(angle) - np.sin(angle[0]))
    setup = LaserSetup(software="same air", **AIR, **{f"{name}_offset": h, f"u_{name}": 1e-6})
    made = setup.correct([0.0, 0.2, 0.4], **{name: angle})
    assert np.abs(made.corrections[name] - moved).max() < PM
    assert abs(made.u_of(name)[1] - h * 1e-6) < PM
    flipped = LaserSetup(software="same air", **AIR, **{f"{name}_offset": -h})
    assert np.abs(flipped.correct([0.0, 0.2, 0.4], **{name: angle}).total + moved).max() < PM


@pytest.mark.parametrize(
    ("axis", "about", "component", "sign"),
    [("x", "y", 2, 1), ("x", "z", 1, -1), ("y", "x", 2, -1), ("y", "z", 0, 1), ("z", "x", 1, 1),
     ("z", "y", 0, -1)],
)  # fmt: skip
def test_the_offset_has_the_sign_of_the_page_for_every_axis(axis, about, component, sign):
    # a carriage that turns by a right-handed angle about the foot of the beam, as a matrix
    angle, r = 8e-6, np.array([0.031, -0.047, 0.059])
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[about]
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = math.cos(angle)
    turn[j, i], turn[i, j] = math.sin(angle), -math.sin(angle)
    moved = (turn @ r - r)["xyz".index(axis)]
    assert abs(moved) > 200 * NM
    setup = LaserSetup(software="same air", pitch_offset=sign * r[component], **AIR)
    found = setup.correct([0.0, 0.1], pitch=[0.0, angle]).corrections["pitch"][1]
    assert abs(found - moved) < 2 * PM  # the cosine of the angle: r angle^2 / 2


def test_an_unknown_pitch_is_uncertainty_only():
    setup = LaserSetup(software="same air", pitch_offset=-0.1, pitch_limit="5 arcsec", **AIR)
    made = setup.correct([0.0, 0.3])
    assert made.corrections["pitch"].tolist() == [0.0, 0.0]
    assert abs(made.u_of("pitch")[1] - 0.1 * math.radians(5 / 3600) / math.sqrt(3)) < PM


def test_a_warm_part_is_longer_than_at_20_degrees():
    setup = LaserSetup(
        software="same air", expansion="11.5 um/m/K", part_temperature="22 degC",
        u_part_temperature="0.1 K", u_expansion="1 ppm/K", **AIR,
    )  # fmt: skip
    made = setup.correct([0.5 * (1.0 + 11.5e-6 * 2.0)])
    assert abs(made.reading[0] + made.total[0] - 0.5) < ROUNDING
    assert made.total[0] < 0.0
    by_hand = 0.5 * math.hypot(11.5e-6 * 0.1, 2.0 * 1e-6)
    assert abs(made.u_of("expansion")[0] / by_hand - 1.0) < 3e-5  # 1 + 2 alpha (T - 20)


# ---- uncertainty -------------------------------------------------------------------------------


def test_all_uncertainties_together_are_those_of_a_monte_carlo():
    rng, many = np.random.default_rng(8), 20_000
    true, dead, h, alpha, part = 0.7, 0.5, 0.08, 11.5e-6, 293.65
    t0, t1, p, hum = 293.15, 294.65, 99_000.0, 0.4
    u = {
        "temperature": 0.15, "pressure": 40.0, "humidity": 0.03, "co2": 40e-6, "dead_path": 5e-3,
        "pitch": 2e-6, "pitch_offset": 2e-3, "expansion": 0.5e-6, "part_temperature": 0.08,
        "wavelength": 3e-8, "reading": 4e-9,
    }  # fmt: skip
    shown = displayed(true, n=n_of(t1, p, hum), n_zero=n_of(t0, p, hum), n_software=1.0, dead=dead)
    pitch = 12e-6

    def result(off):
        n1 = refractive_index(VACUUM, t1 + off["temperature"], p + off["pressure"],
                              humidity=hum + off["humidity"], co2=450e-6 + off["co2"])  # fmt: skip
        n0 = refractive_index(VACUUM, t0 + off["temperature"], p + off["pressure"],
                              humidity=hum + off["humidity"], co2=450e-6 + off["co2"])  # fmt: skip
        d = dead + off["dead_path"]
        counted = (shown + off["reading"]) * (1.0 + off["wavelength"])  # n_software = 1
        length = (counted + n0 * d) / n1 - d
        length += (h + off["pitch_offset"]) * (pitch + off["pitch"])
        return length * (
            1 - (alpha + off["expansion"]) * (part + off["part_temperature"] - 293.15)
        )

    spread = float(np.std(result({k: v * rng.standard_normal(many) for k, v in u.items()})))
    setup = LaserSetup(
        software="vacuum", dead_path=dead, positive="away", pitch_offset=h, expansion=alpha,
        part_temperature=part, wavelength=VACUUM,
        temperature=t1, pressure=p, humidity=hum, reset_temperature=t0,
        **{f"u_{k}": v for k, v in u.items()},
    )  # fmt: skip
    made = setup.correct([0.0, shown], pitch=[0.0, pitch])
    stated = float(made.u[1])
    equation = float(made.contributions["equation for the air"]["wavelength"][1])
    without = math.sqrt(stated**2 - equation**2)
    assert abs(equation / (-true * 2e-8) - 1.0) < 1e-3
    assert abs(without / spread - 1.0) < 0.025  # 0.5 % of scatter, five times
    assert made.messages == ()
    # a new budget of the same numbers adds up
    assert abs(math.sqrt(sum(v**2 for v in made.budget().values())) - stated) < PM


def test_a_thermometer_that_is_wrong_cancels_in_the_dead_path():
    setup = LaserSetup(
        software="same air", dead_path=1.0, u_dead_path=0.0, positive="away",
        **AIR, reset_temperature=292.95, u_temperature=0.5,
    )  # fmt: skip
    made = setup.correct([0.0])
    assert abs(made.corrections["dead_path"][0]) > 900 * NM
    assert made.u_of("dead_path")[0] < 5 * NM  # not 0.5 K x 0.95 um/K = 475 nm


def test_air_that_may_have_changed_is_uncertainty():
    setup = LaserSetup(software="same air", dead_path="300 mm", air_change="1 ppm", **AIR)
    made = setup.correct([0.0])
    assert made.corrections["dead_path"][0] == 0.0
    assert abs(made.u_of("dead_path")[0] - 0.3e-6 / math.sqrt(3)) < PM


# ---- positions, through every door ---------------------------------------------------------------


@pytest.fixture
def bench(tmp_path):
    """Two runs, forward and back, over 6 targets in a room that warms up, as a file; and the truth."""
    rng = np.random.default_rng(2)
    targets = np.array([0, 103, 197, 301, 404, 498]) * 1e-3
    way = ["fwd"] * 6 + ["bwd"] * 6
    x = np.concatenate([targets, targets[::-1]])
    error = 2e-6 * np.sin(9.0 * x) + np.where(np.array(way) == "bwd", -0.8e-6, 0.0)
    error -= error[0]
    t, p, h = 293.15 + 0.08 * np.arange(12), 100_300 + 7.0 * np.arange(12), 0.41
    n = refractive_index(VACUUM, np.round(t, 4), np.round(p, 1), humidity=h)
    pitch = 20e-6 * x**2 / 0.25
    at_beam = x + error - 0.06 * pitch  # the point of interest lies 60 mm above
    runs = [
        displayed(at_beam + e, n=n, n_zero=n[0], n_software=1.0, dead=0.25)
        for e in 5e-9 * rng.standard_normal((2, 12))
    ]
    rows = [
        f"{x[i] * 1e3:.3f},{way[i]},{runs[0][i] * 1e3:.9f},{runs[1][i] * 1e3:.9f},"
        f"{t[i] - 273.15:.4f},{p[i] / 100:.3f},41,{math.degrees(pitch[i]) * 3600:.9f}"
        for i in range(12)
    ]
    head = "target_mm,way,run1_mm,run2_mm,air [degC],p_hPa,rh_%,pitch_arcsec"
    (tmp_path / "bench.csv").write_text("\n".join([head, *rows]) + "\n")
    return tmp_path, x, way, error


SETTINGS = {
    "software": "vacuum", "dead_path": "250 mm", "positive": "away", "pitch_offset": "60 mm",
    "wavelength": "632.9908 nm", "u_temperature": "0.1 K", "u_pressure": "30 Pa",
    "u_humidity": "3 %", "u_reading": "5 nm",
}  # fmt: skip
COLUMNS = {
    "position": "target_mm", "approach": "way", "temperature": "air [degC]", "pressure": "p_hPa",
    "humidity": "rh_%", "pitch": "pitch_arcsec",
}  # fmt: skip


def recipe_text(**change):
    settings = {**SETTINGS, **change}
    lines = [
        "metrosep = 1",
        "[input]",
        'files = ["bench.csv"]',
        'readings = ["run1_mm", "run2_mm"]',
    ]
    lines += [f'{k} = "{v}"' for k, v in COLUMNS.items()]
    lines += ["[[step]]", 'op = "laser_positions"', *(f'{k} = "{v}"' for k, v in settings.items())]
    return "\n".join([*lines, "[[output]]", 'kind = "parts"', "[[output]]", 'kind = "report"', ""])


SCATTER = 25 * NM
"""Five standard deviations of the noise that was planted."""


def test_a_recipe_brings_the_planted_error_back(bench):
    folder, _, _, error = bench
    (folder / "r.toml").write_text(recipe_text())
    result = Recipe.load(folder / "r.toml").run(out=folder / "out")
    found = result.produced.separation
    for name in ("error_1", "error_2"):
        assert np.abs(found.parts[name] - error).max() < SCATTER
    assert np.abs(found.as_read).max() > 100_000 * NM
    values = {c["metric"]: c for c in result.document["characteristics"]}
    total, n = values["correction.total"], values["n"]
    assert abs(total["value"] + 133.2e-6) < 1e-6
    assert 50 * NM < total["u"] < 80 * NM  # 0.5 m of 0.1 K and 30 Pa
    assert 1.0002 < n["value"] < 1.0003
    assert n["u"] > 1e-7
    page = (folder / "out" / "report.html").read_text()
    for words in ("dead path", "Abbe offset times pitch", "Uncertainty budget", "u_wavelength"):
        assert words.lower() in page.lower()
    # on to ISO 230-2 with the table that was written
    table = np.genfromtxt(folder / "out" / "parts-corrected.csv", delimiter=",", names=True, dtype=None,
                          encoding="utf-8")  # fmt: skip
    runs = np.column_stack([table["run1_m"], table["run2_m"]])
    test = iso230_2(*positions_from_columns(table["target_m"], list(table["direction"]), runs))
    assert abs(test["B_mean"].value - 0.8e-6) < SCATTER


@pytest.mark.parametrize(
    "change",
    [{"positive": "towards"}, {"pitch_offset": "-60 mm"}, {"software": "same air"}],
)
def test_a_wrong_sign_or_a_wrong_air_makes_the_axis_worse(bench, change):
    folder, _, _, error = bench
    (folder / "r.toml").write_text(recipe_text(**change))
    found = Recipe.load(folder / "r.toml").run().produced.separation
    assert np.abs(found.error_1 - error).max() > 200 * NM


def test_command_line_and_function_give_what_the_recipe_gives(bench, capsys):
    folder, _, way, _ = bench
    (folder / "r.toml").write_text(recipe_text())
    by_recipe = Recipe.load(folder / "r.toml").run().produced.separation
    columns = [w for k, v in COLUMNS.items() for w in ("--column", f"{k}={v}")]
    settings = [w for k, v in SETTINGS.items() for w in ("--set", f"{k}={v}")]
    with pytest.raises(SystemExit) as end:
        main(["separate", str(folder / "bench.csv"), "--method", "laser_positions", "--readings",
              "run1_mm,run2_mm", *columns, *settings, "--json"])  # fmt: skip
    out, err = capsys.readouterr()
    assert end.value.code == 0, err
    by_command = {c["metric"]: c["value"] for c in json.loads(out)["characteristics"]}
    pv = float(np.ptp(by_recipe.error_1))
    assert abs(by_command["error_1.pv"] - pv) < PM
    data = np.genfromtxt(
        folder / "bench.csv", delimiter=",", skip_header=1, usecols=(0, 2, 3, 4, 5, 6, 7)
    )
    setup = LaserSetup(**SETTINGS)
    by_function = laser_positions(
        data[:, 0] * 1e-3, data[:, 1:3].T * 1e-3, setup=setup, approach=way,
        temperature=data[:, 3] + 273.15, pressure=data[:, 4] * 100, humidity=data[:, 5] / 100,
        pitch=np.radians(data[:, 6] / 3600),
    ).separation  # fmt: skip
    assert np.abs(by_function.error_2 - by_recipe.error_2).max() < PM


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("air [degC]", "air", "declares no unit of a temperature.*air \\[degC\\]"),
        ("air [degC]", "air [hPa]", "declares no unit of a temperature"),
        ("air [degC]", "air [K]", "is 20 K, out of the range of air"),
        ("p_hPa", "p_Pa", "is 1003 Pa, out of the range of air"),
        ("rh_%", "rh", "rh:%"),
    ],
)
def test_wrong_units_of_columns_are_refused_where_they_stand(bench, old, new, words):
    folder = bench[0]
    text = (folder / "bench.csv").read_text().replace(old, new)
    (folder / "bench.csv").write_text(text)
    (folder / "r.toml").write_text(recipe_text().replace(f'"{old}"', f'"{new}"'))
    with pytest.raises(MetrosepError, match=words):
        Recipe.load(folder / "r.toml").run()


def test_a_unit_behind_the_name_of_a_column_is_taken(bench):
    folder, _, _, error = bench
    text = (folder / "bench.csv").read_text().replace("air [degC]", "air")
    (folder / "bench.csv").write_text(text)
    (folder / "r.toml").write_text(recipe_text().replace('"air [degC]"', '"air:degC"'))
    found = Recipe.load(folder / "r.toml").run().produced.separation
    assert np.abs(found.error_1 - error).max() < SCATTER


def test_rows_without_air_stay_without_a_value(bench):
    folder = bench[0]
    lines = (folder / "bench.csv").read_text().splitlines()
    cells = lines[4].split(",")
    cells[4] = ""
    lines[4] = ",".join(cells)
    (folder / "bench.csv").write_text("\n".join(lines) + "\n")
    (folder / "r.toml").write_text(recipe_text())
    made = Recipe.load(folder / "r.toml").run().produced
    assert np.isnan(made.separation.error_1).tolist() == [i == 3 for i in range(12)]
    assert any("1 of 12 readings" in m for m in made.messages)


def test_deviations_are_taken_where_they_are_said_to_be(bench):
    x = np.linspace(0.0, 0.4, 5)
    setup = LaserSetup(software="vacuum", **AIR)
    reached = x * n_of(293.95)
    both = [
        laser_positions(x, z, setup=setup, values=v).separation.error
        for z, v in ((reached, "position"), (reached - x, "deviation"))
    ]
    assert np.abs(both[0]).max() < ROUNDING
    assert np.abs(both[1] - both[0]).max() < ROUNDING
    with pytest.raises(MetrosepError, match="look like deviations"):
        laser_positions(x, reached - x, setup=setup)


# ---- runs before they are separated --------------------------------------------------------------

RUNS = """metrosep = 1
[input]
files = ["runs.csv"]
x = "x_mm"
z = "z_um"
run = "run"
feed = "feed_mm_min"
{laser}
[[step]]
op = "separate"
method = "mean"
[[output]]
kind = "report"
formats = ["html"]
"""
LASER = """[[step]]
op = "laser_setup"
software = "vacuum"
temperature = "20.8 degC"
pressure = "1003 hPa"
humidity = "41 %"
u_temperature = "0.1 K"
dead_path = "250 mm"
air_change = "1 ppm"
"""


def test_runs_are_corrected_before_they_are_separated(tmp_path):
    x = np.linspace(0.0, 0.4, 401)
    error = 1e-6 * np.cos(40.0 * x)
    shown = displayed(x + error, n=n_of(293.95), n_zero=n_of(293.95), n_software=1.0)
    rows = [
        f"{a * 1e3:.4f},{(s - a) * 1e6:.7f},{k},{feed}"
        for k, feed in ((1, 600), (2, 900), (3, 1200))
        for a, s in zip(x, shown, strict=True)
    ]
    (tmp_path / "runs.csv").write_text("x_mm,z_um,run,feed_mm_min\n" + "\n".join(rows) + "\n")
    (tmp_path / "r.toml").write_text(RUNS.format(laser=LASER))
    result = Recipe.load(tmp_path / "r.toml").run(out=tmp_path / "out")
    at = np.linspace(0.01, 0.39, 50)
    found = result.produced(at) if callable(result.produced) else result.produced.evaluate(at)
    known = np.asarray(getattr(found, "z", found), dtype=float)
    apart = known - 1e-6 * np.cos(40.0 * at)
    apart -= np.polyval(np.polyfit(at, apart, 1), at)  # the line is alignment, and taken out
    assert np.abs(apart).max() < 2 * NM  # means over bins of a wave of 157 mm
    values = {c["metric"]: c for c in result.document["characteristics"]}
    assert abs(values["correction.wavelength"]["value"] + 107.4e-6) < 0.5e-6
    assert any("not in the band" in m for m in result.document["messages"])
    assert "laser_setup" in [s["step"] for s in result.document["provenance"]]
    assert "wavelength in the air that was" in (tmp_path / "out" / "report.html").read_text()


def positions_in_nm(folder, sign=1.0):
    """A log of a laser in vacuum wavelengths: absolute positions in nm, and the setup of LASER."""
    x = np.linspace(0.0, 0.4, 401)
    error = 1e-6 * np.cos(40.0 * x) + 3e-6 * x
    shown = displayed(x + error, n=n_of(293.95), n_zero=n_of(293.95), n_software=1.0)
    rows = [
        f"{a * 1e3:.4f},{sign * s * 1e9:.2f},{k},{feed}"
        for k, feed in ((1, 600), (2, 900), (3, 1200))
        for a, s in zip(x, shown, strict=True)
        if (k, round(a * 1e3)) != (2, 77)  # one sample was lost
    ]
    (folder / "runs.csv").write_text("x_mm,laser_nm,run,feed_mm_min\n" + "\n".join(rows) + "\n")


def laser_recipe(folder, *more):
    text = RUNS.format(laser=LASER + "\n".join(more) + "\n")
    text = text.replace('"z_um"', '"laser_nm"')
    (folder / "r.toml").write_text(text)
    return Recipe.load(folder / "r.toml")


def test_positions_in_nm_are_corrected_once_and_become_errors(tmp_path):
    positions_in_nm(tmp_path)
    result = laser_recipe(tmp_path, 'values = "position"').run(out=tmp_path / "out")
    at = np.linspace(0.01, 0.39, 50)
    apart = result.produced.evaluate(at) - 1e-6 * np.cos(40.0 * at)
    apart -= np.polyval(np.polyfit(at, apart, 1), at)
    values = {c["metric"]: c for c in result.document["characteristics"]}

    assert np.abs(apart).max() < 2 * NM  # means over bins of a wave of 157 mm
    # the slope of the error is there, that of the air (-270e-6) is not: 0.1 % of it is u(n)
    whole = np.linspace(0.0, 0.4, 401)
    own = np.polyfit(whole, 1e-6 * np.cos(40.0 * whole) + 3e-6 * whole, 1)[0]
    assert values["slope"]["value"] == pytest.approx(own, abs=0.3e-6)
    assert abs(values["correction.wavelength"]["value"] + 107.4e-6) < 0.5e-6


@pytest.mark.parametrize(
    ("more", "sign", "words"),
    [
        ((), 1.0, 'look like positions, not like errors.*values = "position"'),
        (('values = "position"',), -1.0, "change by -1 times.*change the sign"),
    ],
)
def test_positions_taken_for_errors_would_double_the_correction_and_are_refused(
    tmp_path, more, sign, words
):
    positions_in_nm(tmp_path, sign)

    with pytest.raises(MetrosepError, match=words):
        laser_recipe(tmp_path, *more).run(out=tmp_path / "out")


def test_errors_are_no_positions(tmp_path):
    x = np.linspace(0.0, 0.3, 31)
    setup = LaserSetup(software="vacuum", temperature=293.15, pressure=1e5, humidity=0.4)

    with pytest.raises(MetrosepError, match="do not look like positions"):
        setup.corrected(ms.RunSet([ms.Run(x, 1e-6 * x, feed=0.01)]), values="position")


def test_each_run_may_bring_its_own_air_and_pitch():
    x = np.linspace(0.0, 0.3, 31)
    runs = []
    for t, way in ((293.15, 1), (294.15, -1)):
        xs = x[::way]
        pitch = 1e-5 * xs
        shown = displayed(xs - 0.05 * pitch, n=n_of(t), n_zero=n_of(t), n_software=1.0)
        own = {"temperature": t, "pitch": pitch}
        runs.append(ms.Run(xs, shown - xs, feed=0.01, metadata={"air": own}))
    setup = LaserSetup(software="vacuum", pitch_offset=0.05, pressure=100_300.0, humidity=0.41)
    found, far = setup.corrected(ms.RunSet(runs))
    for run in found:
        assert np.abs(run.z).max() < ROUNDING
        assert run.feed == 0.01
    assert abs(far.reading[far.farthest] - 0.3) < 1e-3
    with pytest.raises(MetrosepError, match="temperature of the air is needed"):
        setup.corrected(ms.RunSet([ms.Run(x, 1e-9 * x, feed=0.01)]))


@pytest.mark.parametrize(
    ("text", "words"),
    [(RUNS.format(laser="") + LASER, "before separate"),
     (RUNS.format(laser=LASER + LASER), "one step, before separate"),
     (RUNS.format(laser=LASER.replace("20.8 degC", "20.8")), "temperature"),
     (RUNS.format(laser=LASER.replace("temperature", "temprature", 1)), "temprature")],
)  # fmt: skip
def test_a_recipe_with_a_wrong_laser_step_is_refused_before_it_runs(text, words):
    with pytest.raises(MetrosepError, match=words):
        Recipe.parse(text)


# ---- the verb ------------------------------------------------------------------------------------


def called(capsys, *words):
    with pytest.raises(SystemExit) as end:
        main(list(words))
    out, err = capsys.readouterr()
    return end.value.code, out, err


ROOM = ("--temperature", "20 degC", "--pressure", "101.325 kPa", "--humidity", "0 %")


def test_the_verb_prints_index_and_wavelength(capsys):
    code, out, err = called(capsys, "air", *ROOM, "--wavelength", "633 nm")
    assert code == 0, err
    assert "n: 1.000271800 (u = 2e-08)" in out + err
    assert "wavelength: 632.827997 nm" in out + err


def test_the_verb_prints_each_correction_of_a_reading(capsys):
    code, out, err = called(
        capsys, "air", *ROOM, "--reading", "-500 mm", "--software", "vacuum", "--dead-path", "1 m",
        "--positive", "towards", "--reset-temperature", "19 degC", "--pitch-offset", "-100 mm",
        "--pitch", "2 arcsec", "--json",
    )  # fmt: skip
    assert code == 0, err
    found = {c["metric"]: c["value"] for c in json.loads(out)["characteristics"]}
    n, n_zero = (refractive_index(VACUUM, t, 101_325.0, humidity=0.0) for t in (293.15, 292.15))
    assert abs(found["correction.wavelength"] - (-0.5 / n + 0.5)) < PM
    assert abs(found["correction.dead_path"] - (n - n_zero) / n) < PM
    assert abs(found["correction.pitch"] + 0.1 * math.radians(2 / 3600)) < PM


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ["--temperature", "20.3", "--pressure", "1 bar", "--humidity", "4 %"],
            "--temperature.*no unit",
        ),
        (
            ["--temperature", "20 degC", "--pressure", "1013 Pa", "--humidity", "4 %"],
            "is 1013 Pa, out",
        ),
        (["--temperature", "20 K", "--pressure", "1013 hPa", "--humidity", "4 %"], "is 20 K, out"),
        (["--temperature", "20 degC", "--pressure", "1013 hPa"], "one of humidity, dew_point"),
        ([*ROOM, "--dead-path", "3 mm"], "needs a reading"),
        ([*ROOM, "--reading", "1 m"], "say once what the software"),
        (
            [*ROOM, "--reading", "1 m", "--software", "vacuum", "--software-index", "1.00027"],
            "say once",
        ),
        (
            [*ROOM, "--reading", "1 m", "--software-index", "0.99"],
            "software-index 0.99: value must be from 1 to 1.001",
        ),
        (
            [*ROOM, "--reading", "1 m", "--software", "vacuum", "--dead-path", "1 m"],
            "--reset-temperature",
        ),
        ([*ROOM, "--reading", "900 m", "--software", "vacuum"], "divide mm by 1000"),
    ],
)
def test_the_verb_refuses_with_one_line(capsys, words, told):
    code, _, err = called(capsys, "air", *words)
    assert code in (2, 4)
    (line,) = (e for e in err.splitlines() if e.startswith("error:"))
    assert re.search(told, line)


@pytest.mark.parametrize(
    ("options", "columns", "words"),
    [
        ({"beam_angle": 1e-3, "spot_walk": 1e-3}, {}, "say the same"),
        ({"beam_angle": 0.5}, {}, "more than 0.02 rad"),
        ({"beam_angle": 1e-3, "u_beam_angle": 1e-4}, {}, "a limit has none"),
        ({"spot_walk": 1e-3}, {}, "walk_travel"),
        ({"pitch_offset": 0.1}, {}, "needs the pitch"),
        ({"pitch_limit": 1e-5}, {}, "pitch_offset is needed"),
        ({"yaw_offset": 0.1, "yaw_limit": 1e-5}, {"yaw": [1e-6]}, "not both"),
        ({"pitch_offset": 0.1}, {"pitch": [1e-6, 2e-6]}, "2 values for 1 readings"),
        ({"pitch_offset": 0.1}, {"pitch": [np.nan]}, "pitch was not measured where"),
        ({"expansion": 11.5}, {}, "expansion must be from -0.0001 to 0.0001"),
        ({"expansion": 11.5e-6}, {}, "needs part_temperature"),
        ({"expansion": 11.5e-6, "part_temperature": 20.0}, {}, "is 20 K, not that of a part"),
        ({"part_temperature": "20 degC"}, {}, "needs expansion"),
        ({"dead_path": -0.1}, {}, "dead_path"),
        ({"dead_path": 0.1, "air_change": 1e-6, "reset_temperature": 293.0}, {},
         "contradict"),
        ({"dead_path": 0.1, "reset_temperature": 293.0}, {}, "needs positive"),
        ({}, {"temperature": [293.0]}, "a column and an option"),
        ({}, {"wind": [1.0]}, "'wind' is not a column"),
        ({"presure": 1e5}, {}, "no 'presure'. Did you mean \"pressure\""),
        ({"software": "none"}, {}, "not one of vacuum, same air"),
        ({"software": None, "software_temperature": "20 degC"}, {}, "software_pressure is needed"),
        ({"u_humidity": 3.0}, {}, "u_humidity must be at most 0.5"),
    ],
)  # fmt: skip
def test_what_contradicts_itself_is_refused(options, columns, words):
    given = {"software": "vacuum", **AIR, **options}
    with pytest.raises(MetrosepError, match=words):
        LaserSetup(**given).correct([0.3], **columns)


def test_one_reading_nothing_read_and_mirrored_data():
    setup = LaserSetup(software="vacuum", **AIR)
    assert setup.correct(0.25).total.shape == (1,)
    assert np.isnan(setup.correct([np.nan, np.nan]).total).all()
    there = setup.correct([0.1, 0.2]).total
    assert np.abs(setup.correct([-0.1, -0.2]).total + there).max() == 0.0
    assert ms.optics.refractive_index is refractive_index


@pytest.mark.parametrize("away", [True, False])
def test_the_zero_may_lie_anywhere_on_the_axis(away):
    x = np.array([0.7, 0.5, 0.3, 0.1])  # set to zero at 700 mm, where the software shows 700 mm
    t = np.array([293.15, 293.35, 293.55, 293.75])
    shown = 0.7 + displayed(
        x - 0.7, n=n_of(t), n_zero=n_of(293.15), n_software=1.0, dead=0.4, away=away
    )
    setup = LaserSetup(
        software="vacuum", zero="700 mm", dead_path=0.4, positive="away" if away else "towards",
        pressure=100_300.0, humidity=0.41,
    )  # fmt: skip
    found = laser_positions(x, shown, setup=setup, temperature=t).separation
    assert np.abs(found.error).max() < ROUNDING


def test_readings_that_are_not_those_of_the_positions_are_refused():
    x = np.array([0.0, 0.1, 0.2])
    setup = LaserSetup(software="vacuum", **AIR)
    for wrong in (-x, x * 900.0, x + 0.5):
        with pytest.raises(MetrosepError, match="from its position; check the units"):
            laser_positions(x, wrong, setup=setup)
    with pytest.raises(
        MetrosepError, match=r"the unit of a column is wrong \(mm and um, or m and mm\)"
    ):
        laser_positions(x, x * 1e3, setup=setup)
    with pytest.raises(MetrosepError, match="2 readings for 3 positions"):
        laser_positions(x, [0.0, 0.1], setup=setup)
    with pytest.raises(MetrosepError, match="finite"):
        laser_positions(x, [0.0, 0.1, np.inf], setup=setup)
    with pytest.raises(MetrosepError, match="a position is NaN"):
        laser_positions([0.0, np.nan, 0.2], x, setup=setup)
    room = LaserSetup(software="vacuum", pressure=1e5, humidity=0.4)
    with pytest.raises(MetrosepError, match="nothing can be corrected"):
        laser_positions(x, x * 1.00027, setup=room, temperature=[np.nan] * 3)


def test_runs_below_each_other_become_columns():
    x = np.array([0.0, 0.1, 0.1, 0.0, 0.0, 0.1, 0.1, 0.0])
    way = ["f", "f", "b", "b"] * 2
    z = x + 1e-6 * np.arange(8)
    setup = LaserSetup(software="same air", **AIR)
    found = laser_positions(x, z, setup=setup, approach=way, run=[1] * 4 + [2] * 4).table
    assert found["target_m"].tolist() == [0.0, 0.1, 0.1, 0.0]
    assert found["direction"] == ["f", "f", "b", "b"]
    assert np.abs(found["run2_m"] - found["run1_m"] - 4e-6).max() < ROUNDING
    with pytest.raises(MetrosepError, match="twice; name the column of directions"):
        laser_positions(x, z, setup=setup, run=[1] * 4 + [2] * 4)
    with pytest.raises(MetrosepError, match="name one of readings"):
        laser_positions(x, [z, z], setup=setup, approach=way, run=[1] * 8)


def test_a_setup_says_what_it_is_in_a_line_and_is_compared_by_values():
    from metrosep.separation import LaserSetup

    typed = LaserSetup(dead_path="200 mm", temperature="21 degC", positive="away")
    assert repr(typed) == "LaserSetup(dead_path='200 mm', temperature='21 degC', positive='away')"
    assert typed == LaserSetup(positive="away", dead_path=0.2, temperature=294.15)
    assert hash(typed) == hash(LaserSetup(positive="away", dead_path=0.2, temperature=294.15))
    assert typed != LaserSetup(positive="towards", dead_path=0.2, temperature=294.15)
    many = LaserSetup(
        temperature="21 degC",
        pressure="1005 hPa",
        humidity="45 %",
        u_reading="3 nm",
        co2="450 ppm",
    )
    assert len(repr(many)) <= 100
