"""Points for a tolerance, the error map with its regions, and its surface."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.forms import SineGrid
from metrosep.process.path_errors import estimated_points
from metrosep.process.path_points import SpiralPath, errors_by_count, points_for_tolerance

RADIUS, FEED = 500e-6, 2e-6
GRID = SineGrid(amplitude=50e-9, wavelength=100e-6)
SMALL = {"form": GRID, "radius": 150e-6, "feed": 5e-6}
NM = 1e-9


@pytest.mark.slow
def test_smallest_count_of_the_paper():
    plan = points_for_tolerance(GRID, RADIUS, FEED, 1e-9)

    assert plan.n_points == pytest.approx(47_000, abs=0.02 * 47_000)  # printed: about 47,000
    assert plan.peak_to_valley <= 1e-9
    assert int(plan) == plan.path.n_points == plan.n_points


def test_error_at_50_000_points():
    at = SpiralPath(RADIUS, FEED, "CA", math.radians(1.8))
    assert at.n_points == 50_000
    assert at.error_map(GRID).peak_to_valley() == pytest.approx(0.88 * NM, abs=0.01 * NM)


@pytest.mark.slow
def test_smallest_count_of_lines():
    plan = points_for_tolerance(GRID, RADIUS, FEED, 1e-9, interpolation="linear")

    assert plan.n_points == pytest.approx(176_000, abs=0.005 * 176_000)
    planned = estimated_points(50e-9, 100e-6, RADIUS, FEED, 1e-9, interpolation="linear")
    assert planned == pytest.approx(plan.n_points, abs=0.02 * plan.n_points)


@pytest.mark.slow
def test_lead_in_saves_points_and_meets_the_estimate():
    bare = points_for_tolerance(GRID, RADIUS, FEED, 1e-9)
    led = points_for_tolerance(GRID, RADIUS, FEED, 1e-9, lead_in=3)

    planned = estimated_points(50e-9, 100e-6, RADIUS, FEED, 1e-9)
    assert led.n_points < 0.85 * bare.n_points
    assert planned == pytest.approx(led.n_points, abs=0.01 * led.n_points)


@pytest.mark.parametrize("interpolation", ["linear", "spline"])
@pytest.mark.parametrize("distribution", ["CA", "CAL"])
def test_count_against_all_counts(distribution, interpolation):
    options = {"distribution": distribution, "interpolation": interpolation}
    region = (40e-6, None)

    plan = points_for_tolerance(**SMALL, tolerance=4e-9, annulus=region, resolution=0.0, **options)

    def error(n):
        path = SpiralPath.with_points(SMALL["radius"], SMALL["feed"], n, **options)
        return path.error_map(GRID).peak_to_valley(annulus=region)

    assert error(plan.n_points) == plan.peak_to_valley <= 4e-9
    assert error(plan.n_points - 1) > 4e-9
    tried = dict(zip(plan.tried.tolist(), plan.tried_peak_to_valley.tolist(), strict=True))
    assert tried[plan.n_points] == plan.peak_to_valley
    holding = [n for n, e in tried.items() if e <= 4e-9]
    assert min(holding) == plan.n_points
    failing_above = any(n > plan.n_points and e > 4e-9 for n, e in tried.items())
    assert plan.is_monotone is not failing_above
    assert plan.audit["pv_nm"] == pytest.approx(plan.peak_to_valley * 1e9, abs=1e-12)


def test_lucky_counts_are_reported():
    # Points at whole fractions of 36 degrees lie on zeros of this form: lines have no error there.
    def flower(x, y):
        return 1e-8 * np.sin(5.0 * np.arctan2(y, x)) * (np.hypot(x, y) > 1e-6)

    plan = points_for_tolerance(
        flower, 150e-6, 5e-6, 0.9e-9, interpolation="linear", annulus=(10e-6, None)
    )

    assert plan.peak_to_valley <= 0.9e-9
    again = plan.path.error_map(flower).peak_to_valley(annulus=(10e-6, None))
    assert again == plan.peak_to_valley


def test_coarse_centre_has_no_count():
    with pytest.raises(LimitError, match=r"20000 holds 1e-09 m.*annulus"):
        points_for_tolerance(GRID, RADIUS, FEED, 1e-9, distribution="CAL", max_points=20_000)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"tolerance": 0.0}, "tolerance"),
        ({"tolerance": math.nan}, "tolerance"),
        ({"feed": -1e-6}, "feed"),
        ({"radius": 1e-6}, "not one turn"),
        ({"resolution": 0.5}, "resolution"),
        ({"distribution": "XY"}, "distribution"),
        ({"interpolation": "XY"}, "interpolation"),
        ({"annulus": (0.0, 1.0)}, "outside the path"),
    ],
)
def test_refuses(change, match):
    with pytest.raises(DataError, match=match):
        points_for_tolerance(**({**SMALL, "tolerance": 1e-9} | change))


def test_undefined_form_is_named():
    with pytest.raises(InvalidSamplesError, match="height nan"):
        points_for_tolerance(lambda x, y: x + np.nan, 150e-6, 5e-6, 1e-9)


def test_regions_of_the_map():
    made = SpiralPath(RADIUS, FEED, "CAL", 30e-6).error_map(GRID)
    inside = (made.rho >= 200e-6) & (made.rho <= 300e-6)

    assert made.peak_to_valley(annulus=(200e-6, 300e-6)) == np.ptp(made.z[inside])
    assert made.peak_to_valley(annulus=(None, None)) == np.ptp(made.z)
    line = made.line(0.0)
    near = np.abs(np.angle(np.exp(1j * made.theta))) < 1.5e-6 / made.rho
    near &= made.rho > 50e-6
    assert line.x[0] < line.x[-1]
    both = np.interp(made.rho[near], line.x, line.z)
    # Samples up to 1.5 um beside the line, on waves of 8 nm and 30 um.
    assert np.abs(both - made.z[near]).max() < 2.5 * NM


@pytest.mark.parametrize("sense", ["counterclockwise", "clockwise"])
def test_line_lies_where_the_map_says(sense):
    form = SineGrid(amplitude=50e-9, wavelength=100e-6, wavelength_y=230e-6, phase_y=0.9)
    path = SpiralPath(200e-6, 4e-6, "CA", math.radians(6), sense=sense, start=0.3)
    made = path.error_map(form, sub_points=12)
    azimuth = float(made.theta[6])  # the middle of the first interval, again on each turn

    line = made.line(azimuth)

    on_it = np.abs(np.angle(np.exp(1j * (made.theta - azimuth)))) < 1e-5
    rho, z = made.rho[on_it], made.z[on_it]
    assert rho.size > 30
    assert np.abs(line.z[::-1][: rho.size] - z).max() < 1e-3 * NM
    assert np.abs(line.x[::-1][: rho.size] - rho).max() < 1e-10


@pytest.mark.parametrize(
    ("region", "match"),
    [
        ({"annulus": (1, 2, 3)}, "annulus must be .inner, outer. .* got .1, 2, 3"),
        ({"annulus": 5e-5}, "annulus must be .* got 5e-05"),
        ({"annulus": ("a", None)}, "annulus 'a' is not a number"),
        ({"annulus": (0.0, 300e-6)}, "uncut core of 3.70893e-07"),
        ({"annulus": (300e-6, 200e-6)}, "empty"),
        ({"annulus": (math.nan, 200e-6)}, "must be a finite number"),
        ({"annulus": (0.2, 0.3)}, "outside"),
        ({"azimuth": math.nan}, "azimuth"),
        ({"annulus": (200e-6, 200.1e-6), "azimuth": 0.0}, "wider"),
    ],
)
def test_refuses_regions(region, match):
    made = SpiralPath(RADIUS, FEED, "CAL", 30e-6).error_map(GRID)
    with pytest.raises(DataError, match=match):
        made.peak_to_valley(**region)


@pytest.mark.parametrize("sense", ["counterclockwise", "clockwise"])
def test_surface_holds_the_errors_where_they_are(sense):
    # An error that tells x from y and left from right: steps too wide for the fine side.
    def form(x, y):
        return 50e-9 * np.sin(2 * np.pi * x / 60e-6) * np.exp((x + 2 * y) / 150e-6)

    path = SpiralPath(150e-6, 1e-6, "CA", math.radians(9), "linear", sense=sense, start=1.1)
    made = path.error_map(form)
    surface = made.to_surface(101)

    axis = np.linspace(-150e-6, 150e-6, 101)
    x, y = np.meshgrid(axis, axis)
    rho = np.hypot(x, y)
    assert np.isnan(surface.z[rho > 150e-6]).all()
    inside = (rho > 2e-6) & (rho < 148e-6)
    assert np.isfinite(surface.z[inside]).all()
    assert np.isnan(surface.z[50, 50])
    assert surface.origin == (-150e-6, -150e-6)
    column = np.rint((made.rho * np.cos(made.theta) + 150e-6) / 3e-6).astype(int)
    row = np.rint((made.rho * np.sin(made.theta) + 150e-6) / 3e-6).astype(int)
    sums, counts = np.zeros((101, 101)), np.zeros((101, 101))
    np.add.at(sums, (row, column), made.z)
    np.add.at(counts, (row, column), 1)
    binned = sums / np.maximum(counts, 1)
    good = inside & (counts > 0)
    assert np.corrcoef(binned[good], surface.z[good])[0, 1] > 0.9
    assert np.corrcoef(binned[::-1][good], surface.z[good])[0, 1] < 0.5


@pytest.mark.parametrize("distribution", ["CA", "CAL"])
def test_rms_is_one_over_the_area(distribution):
    # an error that grows with rho: the RMS of rho over a disc is R / sqrt 2, over its radii R / sqrt 3
    path = SpiralPath.with_points(150e-6, 5e-6, 3000, distribution=distribution)
    made = path.error_map(lambda x, y: 0.0 * x)
    grown = replace(made, z=1e-4 * made.rho)
    rms = grown.summary()[1]
    assert rms.value == pytest.approx(1e-4 * 150e-6 / 2**0.5, abs=1e-3 * 1e-4 * 150e-6)
    assert "over the area" in rms.definition


def test_rms_of_the_paper_part_over_the_area():
    # reviewer's own average with weights rho: 1.911 nm; over the samples it would be 1.481 nm
    made = SpiralPath(RADIUS, FEED, step=math.radians(2), interpolation="linear").error_map(GRID)
    assert made.summary()[1].value == pytest.approx(1.911 * NM, abs=0.001 * NM)


def test_a_core_needs_fewer_points():
    # 25 turns are left: 8 points each; the whole disc would start at 2008
    plan = points_for_tolerance(GRID, RADIUS, FEED, 180e-9, core=450e-6, lead_in=3)
    held = SpiralPath.with_points(RADIUS, FEED, 1200, core=450e-6, lead_in=3)
    assert held.error_map(GRID).peak_to_valley() < 180e-9
    assert plan.n_points < 1.05 * 1200  # 1200 is luck: not the next counts
    assert plan.peak_to_valley <= 180e-9


def test_too_few_points_allowed_is_a_limit():
    with pytest.raises(LimitError, match=r"max_points of 100 .* 2009 blocks"):
        points_for_tolerance(GRID, RADIUS, FEED, 1e-9, max_points=100)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"max_points": None}, "max_points must be a whole number"),
        ({"max_points": math.nan}, "max_points must be a whole number"),
        ({"resolution": "a"}, "resolution must be a number"),
        ({"tolerance": 1.0}, "tolerance = 1 m"),
        ({"tolerance": None}, "tolerance must be a number"),
        ({"foo": 1}, "no option 'foo'"),
        ({"step": 0.1}, "step follows"),
        ({"core": None}, "core must be a number"),
        ({"core": 1.0}, "core must lie"),
        ({"distribution": "XX"}, "distribution is one of"),
        ({"annulus": 5e-5}, "annulus must be"),
        ({"sub_points": None}, "sub_points must be a whole number"),
    ],
)
def test_bad_arguments_in_one_sentence(change, match):
    given = {**SMALL, "tolerance": 5e-9} | change
    with pytest.raises(DataError, match=match):
        points_for_tolerance(**given)


@pytest.mark.parametrize("counts", [None, [], ["a"], 5, [1000, None]], ids=repr)
def test_counts_in_one_sentence(counts):
    with pytest.raises(DataError, match="count"):
        errors_by_count(GRID, 150e-6, 5e-6, counts)


def test_summary_and_audit():
    made = SpiralPath(RADIUS, FEED, "CA", math.radians(4)).error_map(GRID)
    pv, rms = made.summary()

    assert pv.unit == rms.unit == "m"
    assert pv.value == made.peak_to_valley()
    assert "not-a-knot ends, 0 lead-in" in pv.definition
    assert made.audit["step_deg"] == pytest.approx(4.0, abs=1e-12)
    worst = made.audit["largest_error_nm"] * 1e-9
    assert abs(worst) == pytest.approx(np.abs(made.z).max(), abs=1e-20)
    assert repr(made).startswith("PathErrorMap(225001 samples, CA, 22500 intervals, spline")
    assert made.to_surface(21).history[0].parameters["end"] == "not-a-knot"
    assert all(a >= b for a, b in itertools.pairwise(made.rho[::1000]))


@pytest.mark.slow
def test_ten_million_points_are_made_in_few_steps(calls):
    path = SpiralPath.with_points(RADIUS, FEED, 1_000_000)

    steps, made = calls(lambda: path.error_map(GRID))

    assert len(made) == 10_000_001
    assert steps < 1_000_000


def test_a_tolerance_out_of_reach_is_refused_early_with_the_points_it_would_take(calls):
    """Lines leave the sagitta: 0.01 pm needs sqrt(5e5) times the points of 5 nm, and no search to 10^6."""
    grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    words = {"lead_in": 3, "interpolation": "linear"}

    def refusal():
        with pytest.raises(LimitError, match="would take about") as refused:
            points_for_tolerance(grid, 400e-6, 10e-6, 1e-14, **words)
        return refused

    steps, refused = calls(refusal)

    near = points_for_tolerance(grid, 400e-6, 10e-6, 5e-9, **words).n_points
    needed = float(str(refused.value).split("about ")[1].split(" ")[0])
    assert needed == pytest.approx(near * np.sqrt(5e5), abs=0.3 * near * np.sqrt(5e5))
    assert steps < 300_000  # the whole search took minutes
