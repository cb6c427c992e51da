"""Spiral of a turned part: lengths, counts, sense, and the printed error table of the paper."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    LimitError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.surface import Surface
from metrosep.forms import SineGrid, Sphere
from metrosep.process.interpolation import angle_at_length, arc_length
from metrosep.process.path_points import SpiralPath

RADIUS, FEED = 500e-6, 2e-6
GRID = SineGrid(amplitude=50e-9, wavelength=100e-6)
NM = 1e-9
ROUNDING = 1e-18
"""Heights of 100 nm and positions of 500 um in double precision, times slopes of 3e-3, in m."""
ANNULUS = (200e-6, 300e-6)

TABLE = [
    # distribution, step (deg or um), n, nm: linear all, spline all, spline 200-300 um
    ("CA", 5, 18_000, 80.3, 88.0, 2.82),
    ("CA", 4, 22_500, 53.4, 34.2, 1.15),
    ("CA", 3, 30_000, 30.1, 3.64, 0.31),
    ("CA", 2, 45_000, 14.63, 1.07, 0.054),
    ("CA", 1, 90_000, 3.76, 0.15, None),
    ("CAL", 30, 13_090, 61.8, 71.6, 7.64),
    ("CAL", 20, 19_635, 28.1, 39.2, 0.99),
    ("CAL", 10, 39_270, 19.1, 15.2, 0.05),
    ("CAL", 5, 78_540, 9.3, 9.1, None),
]
SHORT_TABLE = [
    pytest.param(*row, marks=[pytest.mark.slow] if row[2] > 60_000 else []) for row in TABLE
]
FROM_50 = {30: 16.2, 20: 1.9, 10: 0.24, 5: 0.02}
LINE = {30: 7.58, 20: 0.93, 10: 0.03}


def half_digit(printed):
    """Half of the last printed digit, and 1 % for 10 samples an interval instead of 16."""
    digits = len(repr(printed).partition(".")[2])
    return (0.5 * 10.0**-digits + 0.01 * printed) * NM


def path_of(distribution, step, **options):
    step = math.radians(step) if distribution == "CA" else step * 1e-6
    return SpiralPath(RADIUS, FEED, distribution, step, **options)


def test_length_of_the_paper_and_by_quadrature():
    path = path_of("CA", 2)
    a = FEED / (2 * np.pi)
    by_quadrature, _ = quad(lambda u: a * math.hypot(1.0, u), 0.0, 7.3, epsabs=1e-16)

    assert path.length == pytest.approx(392_700.443e-6, abs=0.0005e-6)
    assert path.turns == pytest.approx(250.0, abs=1e-10)
    assert float(arc_length(7.3, FEED)) == pytest.approx(by_quadrature, abs=1e-18)
    assert path.length - math.pi * RADIUS**2 / FEED == pytest.approx(1.4e-6, abs=0.5e-6)


def test_angle_is_the_inverse_of_the_length():
    u = np.concatenate([[0.0], np.geomspace(1e-9, 1e6, 2001)])

    back = angle_at_length(arc_length(u, FEED), FEED)

    assert (np.abs(back - u) <= 2e-15 * u).all()
    assert float(arc_length(-3.0, FEED)) == -float(arc_length(3.0, FEED))
    assert np.isnan(angle_at_length([np.nan, 1e-6], FEED)).tolist() == [True, False]


@pytest.mark.parametrize(("distribution", "step", "n"), [row[:3] for row in TABLE])
def test_counts_of_the_paper(distribution, step, n):
    path = path_of(distribution, step)

    assert path.n_points == n
    assert path.rho.size == path.theta.size == path.u.size == n + 1
    assert path.rho[0] == pytest.approx(RADIUS, abs=1e-18)
    if distribution == "CA":
        assert path.core_radius == 0.0
        assert np.abs(np.diff(path.theta) - math.radians(step)).max() < 1e-12
    else:
        assert 0.0 < path.core_radius < 2e-6
        assert np.abs(np.diff(arc_length(path.u, FEED)) + step * 1e-6).max() < 1e-15


@pytest.mark.parametrize(("distribution", "step", "n", "linear", "spline", "annulus"), SHORT_TABLE)
def test_error_table_of_the_paper(distribution, step, n, linear, spline, annulus):
    lines = path_of(distribution, step, interpolation="linear").error_map(GRID)
    curve = path_of(distribution, step).error_map(GRID)

    assert len(curve) == 10 * n + 1
    assert lines.peak_to_valley() == pytest.approx(linear * NM, abs=half_digit(linear))
    assert curve.peak_to_valley() == pytest.approx(spline * NM, abs=half_digit(spline))
    inside = curve.peak_to_valley(annulus=ANNULUS)
    if annulus is None:
        assert inside < 0.01 * NM
    else:
        assert inside == pytest.approx(annulus * NM, abs=half_digit(annulus))


@pytest.mark.parametrize("step", [30, 20, 10, pytest.param(5, marks=pytest.mark.slow)])
def test_error_of_constant_arc_length_away_from_the_centre(step):
    made = path_of("CAL", step).error_map(GRID)

    outside = made.peak_to_valley(annulus=(50e-6, None))
    assert outside == pytest.approx(FROM_50[step] * NM, abs=half_digit(FROM_50[step]))
    line = made.peak_to_valley(annulus=(50e-6, None), azimuth=0.0)
    if step in LINE:
        assert line == pytest.approx(LINE[step] * NM, abs=half_digit(LINE[step]))
    else:
        assert line < 0.01 * NM


@pytest.mark.parametrize(
    ("distribution", "step"), [("CA", 4), ("CA", 2), ("CAL", 30), ("CAL", 10)]
)
def test_lead_in_leaves_the_inside_as_it_is(distribution, step):
    bare = path_of(distribution, step).error_map(GRID)
    led = path_of(distribution, step, lead_in=3).error_map(GRID)

    assert len(led) == len(bare)
    # A spline forgets its end by 0.27 a point: 100 points inside nothing is left.
    inside = slice(1000, None)
    assert np.abs(led.z[inside] - bare.z[inside]).max() < 1e-18
    assert led.peak_to_valley() <= bare.peak_to_valley()


def test_ends_of_the_spline():
    errors = {
        e: path_of("CA", 2, end=e).error_map(GRID).peak_to_valley()
        for e in ("not-a-knot", "natural", "clamped")
    }
    bare = path_of("CA", 2).error_map(GRID)
    led = path_of("CA", 2, lead_in=3).error_map(GRID)

    for end, printed in {"not-a-knot": 1.07, "natural": 4.47, "clamped": 0.50}.items():
        assert errors[end] == pytest.approx(printed * NM, abs=half_digit(printed))
    inner = bare.peak_to_valley(annulus=(50e-6, 490e-6))
    assert inner == pytest.approx(0.46 * NM, abs=half_digit(0.46))
    assert led.peak_to_valley() < 0.51 * NM
    assert any("natural ends" in m for m in path_of("CA", 2, end="natural").messages)
    assert any("lead_in=3" in m for m in bare.messages)
    assert not any("lead_in=3" in m for m in led.messages)


@pytest.mark.parametrize("sense", ["counterclockwise", "clockwise"])
@pytest.mark.parametrize("start", [0.0, 0.7])
def test_clamped_ends_take_the_slope_of_the_form(sense, start):
    form = SineGrid(amplitude=50e-9, wavelength=100e-6, wavelength_y=170e-6, phase_x=0.4)
    options = {"sense": sense, "start": start}
    free = SpiralPath(200e-6, 4e-6, "CA", 0.15, lead_in=12, **options).error_map(form)
    clamped = SpiralPath(200e-6, 4e-6, "CA", 0.15, end="clamped", **options).error_map(form)
    natural = SpiralPath(200e-6, 4e-6, "CA", 0.15, end="natural", **options).error_map(form)

    first = slice(0, 30)  # three intervals
    near = np.abs(clamped.z[first] - free.z[first]).max()
    assert near < 0.1 * np.abs(natural.z[first] - free.z[first]).max()


def test_crossing_of_linear_and_spline():
    def errors(distribution, step):
        both = ("linear", "spline")
        return [
            path_of(distribution, step, interpolation=i).error_map(GRID).peak_to_valley()
            for i in both
        ]

    for distribution, few, many in (("CA", 5, 4), ("CAL", 30, 10)):
        linear, spline = errors(distribution, few)
        assert linear < spline
        linear, spline = errors(distribution, many)
        assert spline < linear


def test_least_squares_knots():
    plain = path_of("CAL", 30)
    fitted = path_of("CAL", 30, knots="least-squares").error_map(GRID)

    assert fitted.path.n_points == plain.n_points
    assert fitted.peak_to_valley(annulus=ANNULUS) == pytest.approx(4.23 * NM, abs=0.02 * NM)
    wide = (50e-6, 490e-6)
    assert fitted.peak_to_valley(annulus=wide) == pytest.approx(13.6 * NM, abs=0.1 * NM)
    assert plain.error_map(GRID).peak_to_valley(annulus=wide) == pytest.approx(
        16.2 * NM, abs=0.1 * NM
    )


def test_line_through_the_start_is_blind_for_constant_angle():
    made = path_of("CA", 5).error_map(GRID)

    assert made.line(0.0).z.size == 251
    assert made.peak_to_valley(azimuth=0.0) < ROUNDING
    assert made.peak_to_valley(azimuth=math.radians(45.0)) < ROUNDING
    assert made.peak_to_valley(azimuth=math.radians(2.5)) > 50 * NM
    assert made.peak_to_valley() > 80 * NM


def test_map_against_a_simulation_without_the_library():
    radius, feed, dtheta, start = 60e-6, 8e-6, math.radians(20.0), 0.4

    def form(x, y):
        return 1e-9 * np.sin(x / 17e-6 + 0.3) * np.cos(y / 23e-6 - 0.8) + 2e-4 * x - 1e-4 * y

    a = feed / (2 * np.pi)
    whole = radius / a
    u = whole - dtheta * np.arange(math.floor(whole / dtheta) + 1)
    knots = np.array([quad(lambda v: a * math.hypot(1, v), v, whole)[0] for v in u])
    azimuth = start - (whole - u)
    spline = CubicSpline(knots, form(a * u * np.cos(azimuth), a * u * np.sin(azimuth)))

    path = SpiralPath(radius, feed, "CA", dtheta, sense="clockwise", start=start)
    made = path.error_map(form, sub_points=4)

    steps = np.linspace(0.0, 1.0, 5)[:4]
    s = (knots[:-1, None] + np.diff(knots)[:, None] * steps).ravel()
    assert path.n_points == u.size - 1 == 135
    x, y = made.rho * np.cos(made.theta), made.rho * np.sin(made.theta)
    assert np.abs(made.z[:-1] - (spline(s) - form(x, y)[:-1])).max() < 1e-15
    assert made.z[::4] == pytest.approx(np.zeros(136), abs=1e-18)


@pytest.mark.parametrize(("sense", "sign"), [("counterclockwise", 1.0), ("clockwise", -1.0)])
def test_sense_of_the_spiral(sense, sign):
    path = SpiralPath(RADIUS, FEED, "CA", math.radians(10), sense=sense, start=0.2)
    points = path.points(lambda x, y: 3e-3 * x + 7e-3 * y)

    quarter = 9
    azimuth = 0.2 + sign * np.pi / 2
    assert path.theta[quarter] == pytest.approx(np.pi / 2, abs=1e-12)
    assert path.azimuth[quarter] == pytest.approx(azimuth, abs=1e-12)
    assert points.x[quarter] == pytest.approx(path.rho[quarter] * math.cos(azimuth), abs=1e-15)
    assert points.y[quarter] == pytest.approx(path.rho[quarter] * math.sin(azimuth), abs=1e-15)
    assert points.z == pytest.approx(3e-3 * points.x + 7e-3 * points.y, abs=1e-18)
    assert sign * points.y[quarter] > 0.0


def test_wrong_sense_is_seen_on_an_asymmetric_form():
    form = SineGrid(amplitude=50e-9, wavelength=100e-6, wavelength_y=230e-6, phase_y=0.9)
    right = path_of("CA", 5).points(form)
    left = path_of("CA", 5, sense="clockwise").points(form)

    mirrored = SineGrid(amplitude=50e-9, wavelength=100e-6, wavelength_y=230e-6, phase_y=-0.9)
    assert np.abs(right.z - left.z).max() > 50 * NM
    assert np.abs(path_of("CA", 5).points(mirrored).z - left.z).max() < ROUNDING


def test_error_is_path_minus_ideal():
    # A cap: chords cut below it, so the path removes material and the error is negative.
    made = SpiralPath(1e-3, 10e-6, "CA", 0.1, interpolation="linear").error_map(
        lambda x, y: -(x**2 + y**2) / 0.02
    )
    bowl = SpiralPath(1e-3, 10e-6, "CA", 0.1, interpolation="linear").error_map(
        lambda x, y: 1e-6 * np.cos(2e4 * x)
    )
    # Along the spiral the cap is a parabola of curvature -2 (a/s')^2 / 0.02: a few pm.
    assert made.z.min() < 0.0
    assert made.z.max() < ROUNDING
    x = bowl.rho * np.cos(bowl.theta)
    valley, hill = np.cos(2e4 * x) < -0.95, np.cos(2e4 * x) > 0.95
    assert bowl.z[valley].mean() > 0.0 > bowl.z[hill].mean()


def test_dividing_and_remaining_core():
    whole = SpiralPath.with_points(RADIUS, FEED, 12_345, distribution="CAL")
    partly = SpiralPath(RADIUS, FEED, "CA", 0.4)
    ended = SpiralPath(RADIUS, FEED, "CA", math.radians(2), core=100e-6)

    assert whole.n_points == 12_345
    assert whole.core_radius == 0.0
    assert partly.core_radius == pytest.approx(FEED / (2 * np.pi) * (500 * np.pi % 0.4), abs=1e-16)
    assert "nothing is cut" in partly.messages[0]
    assert ended.n_points == 36_000
    assert ended.core_radius == pytest.approx(100e-6, abs=1e-15)
    for core in (0.0, 30e-6):
        for distribution in ("CA", "CAL"):
            made = SpiralPath.with_points(RADIUS, FEED, 4321, distribution=distribution, core=core)
            assert made.n_points == 4321
            assert made.core_radius == pytest.approx(core, abs=1e-12)


def test_undefined_points_are_named():
    def holed(x, y):
        return np.where(np.hypot(x, y) < 20e-6, np.nan, x)

    with pytest.raises(InvalidSamplesError, match=r"height nan at x = .*rho = .*core"):
        path_of("CA", 2).error_map(holed)
    made = path_of("CA", 2, core=25e-6, interpolation="linear").error_map(holed)
    assert np.isfinite(made.z).all()
    dome = Sphere(R=RADIUS * 1.00001)
    assert path_of("CA", 2).points(dome).z.size == 45_001
    with pytest.raises(InvalidSamplesError, match="lead-in"):
        path_of("CA", 2, lead_in=300).points(dome)


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"feed": -2e-6}, DataError, "feed must be positive"),
        ({"feed": 0.0}, DataError, "feed"),
        ({"feed": 1e-3}, DataError, "not one turn"),
        ({"radius": math.nan}, DataError, "radius must be positive and finite"),
        ({"radius": "half a millimetre"}, DataError, "is not a number with a unit"),
        ({"step": math.nan}, DataError, "step is missing"),
        ({"step": 0.0}, DataError, "step must be positive"),
        ({"step": -0.1}, DataError, "step must be positive"),
        ({"step": None}, DataError, "step must be a number"),
        ({"step": 2.0}, UnitError, "in rad"),
        ({"distribution": "CAL", "step": 30.0}, UnitError, "in m"),
        ({"distribution": "CAX"}, DataError, "CA, CAL"),
        ({"interpolation": "nurbs"}, DataError, "linear, spline"),
        ({"end": "periodic"}, DataError, "not-a-knot"),
        ({"sense": "left"}, DataError, "clockwise"),
        ({"lead_in": -1}, DataError, "lead_in"),
        ({"lead_in": 1.5}, DataError, "lead_in"),
        ({"lead_in": math.inf}, DataError, "lead_in"),
        ({"core": 500e-6}, DataError, "core"),
        ({"core": -1e-9}, DataError, "core"),
        ({"start": math.inf}, DataError, "start"),
        ({"start": 90.0}, UnitError, "start .* in rad"),
        ({"radius": 500.0}, UnitError, "radius .* in m"),
        ({"radius": "5e-4"}, DataError, "radius .* has no unit"),
        ({"radius": True}, DataError, "radius must be a number in m.*got True"),
        ({"knots": "least-squares", "end": "natural"}, DataError, "least-squares"),
        ({"radius": 2e-6, "core": 1.9e-6}, TooFewSamplesError, "interval"),
    ],
)
def test_refuses(change, error, match):
    given = {"radius": RADIUS, "feed": FEED, "distribution": "CA", "step": 0.7} | change
    with pytest.raises(error, match=match):
        SpiralPath(**given)


def test_refuses_calls():
    path = path_of("CA", 5)
    with pytest.raises(DataError, match="n_points"):
        SpiralPath.with_points(RADIUS, FEED, 0)
    with pytest.raises(DataError, match="sub_points"):
        path.error_map(GRID, sub_points=1)
    with pytest.raises(DataError, match="gradient"):
        path.with_options(end="clamped").points(lambda x, y: x + y)
    with pytest.raises(InvalidSamplesError, match="shape"):
        path.points(lambda x, y: x[:-1])
    with pytest.raises(InvalidSamplesError, match="arc length -1"):
        angle_at_length(-1.0, FEED)
    with pytest.raises(DataError, match="feed"):
        arc_length(1.0, math.nan)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: SpiralPath.with_points(RADIUS, FEED, 900, step=1.0), "step follows"),
        (lambda: SpiralPath.with_points(RADIUS, FEED, 9000, core=None), "core must be a number"),
        (lambda: SpiralPath.with_points(RADIUS, FEED, 9000, core=1e-3), "core must lie"),
        (lambda: SpiralPath.with_points(RADIUS, FEED, 9000, foo=1), "no option 'foo'"),
        (lambda: path_of("CA", 5).with_options(bar=1), "no option 'bar'"),
        (lambda: path_of("CA", 5).error_map(None), "got NoneType"),
        (lambda: path_of("CA", 5).points(Surface(np.zeros((3, 3)), 1e-6, 1e-6)), "got Surface"),
        (lambda: path_of("CA", 5).points(lambda x, y: 1j * x), "complex"),
        (lambda: path_of("CA", 5).points(lambda x, y: "high"), "must return"),
        (lambda: path_of("CA", 5).error_map(GRID).to_surface(10**8), "100000000 x 100000000"),
    ],
)
def test_refuses_options_and_forms_in_one_sentence(call, match):
    with pytest.raises((DataError, LimitError), match=match):
        call()


@pytest.mark.parametrize(
    ("path", "number"),
    [
        (SpiralPath(20e-3, 2e-6, step=math.radians(0.1)), "36,000,000"),
        (SpiralPath(20e-3, 2e-6, step=1e-9), "62,831,853,071,796"),
        (SpiralPath(20e-3, 2e-6, distribution="CAL", step=1e-12), "628,318,53"),
    ],
    ids=["6 GB of samples", "a step in the wrong unit", "arc length"],
)
def test_a_program_too_large_to_work_on_is_refused_with_its_size(path, number):
    for call in (lambda: path.error_map(GRID), lambda: path.points(GRID), lambda: path.rho):
        with pytest.raises(LimitError, match=number):
            call()
    # what needs no points is still told, at once
    assert path.core_radius < 1e-9
    assert "Spline" in path.messages[-2]


def test_samples_are_limited_as_well():
    path = SpiralPath(RADIUS, FEED, step=math.radians(1))
    with pytest.raises(LimitError, match="90,000,001 samples"):
        path.error_map(GRID, sub_points=1000)


@pytest.mark.parametrize("distribution", ["CA", "CAL"])
@pytest.mark.parametrize("core", [0.0, 37e-6])
def test_core_radius_in_closed_form_is_that_of_the_last_point(distribution, core):
    path = path_of(distribution, 7.3 if distribution == "CA" else 13.7, core=core)
    assert path.core_radius == pytest.approx(path.rho[-1], abs=ROUNDING)
    assert path.core_radius >= core


def test_constant_forms_and_no_mutation():
    flat = path_of("CA", 5).error_map(lambda x, y: 0.0)
    assert flat.peak_to_valley() == 0.0
    for array in (flat.z, flat.rho, flat.theta, flat.path.rho, flat.path.points(GRID).z):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
