"""Two probes on one carriage: exact sums, their noise in closed form, what they cannot see."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep import Profile
from metrosep.core.errors import DataError, MetrosepError, NotUniformError, UnitError
from metrosep.separation.lines.three_points import TwoPoint, two_point

STEP = 10e-3
N = 24

ROUNDING = 1e-13
"""Relative; sums of 30 terms."""

MC_RTOL = 0.05
"""Goal S14; RMS of 600 trials scatters by about 1.5 %."""


def level(values):
    at = np.arange(values.size)
    return values - np.polyval(np.polyfit(at, values, 1), at)


def read(form, slide, s=1, pitch=0.0, distance=STEP):
    """Trailing probe at x, leading probe s steps further on."""
    n = slide.size
    return np.stack([form[:n] + slide, form[s : s + n] + slide + distance * pitch])


class TestTwoPoint(SeparationContract):
    sd = 3e-9

    def method(self):
        return TwoPoint(STEP, STEP)

    def truth(self, rng):
        return {"artefact": level(1e-7 * rng.standard_normal(N + 1))}

    def errors(self, rng):
        return {"straightness": 1e-6 * rng.standard_normal(N)}

    def readings(self, truth, errors):
        form = np.asarray(truth.get("artefact", np.zeros(N + 1)))
        slide = np.asarray(errors.get("straightness", np.zeros(N)))
        return read(form, slide, pitch=np.asarray(errors.get("pitch", 0.0)))

    def invisible(self, rng):
        line = 1e-6 * np.arange(N + 1)
        yield (
            {"artefact": line + 1e-6},
            {"straightness": -line[:-1] - 1e-6, "pitch": -1e-6 / STEP * np.ones(N)},
        )
        form = 1e-6 * rng.standard_normal(N + 1)
        yield {"artefact": form}, {"straightness": -form[:-1], "pitch": -np.diff(form) / STEP}


class TestLeastSquares(TestTwoPoint):
    def method(self):
        return TwoPoint(STEP, STEP, method="least_squares")


@pytest.mark.parametrize("method", ["sequential", "least_squares", "combined"])
def test_the_leading_probe_is_the_second(method):
    """A ramp only on the leading half: swapped probes would turn it over."""
    form = np.where(np.arange(12) > 7, 1e-6, 0.0)
    m = read(form, np.sin(np.arange(11)))

    found = two_point(m, STEP, step=STEP, method=method).artefact
    swapped = two_point(m[::-1], STEP, step=STEP, method=method).artefact

    np.testing.assert_allclose(found, level(form), rtol=0, atol=1e-6 * 1e-8)
    np.testing.assert_allclose(swapped, -found, rtol=0, atol=1e-6 * 1e-8)


@pytest.mark.parametrize("n", [9, 30, 200])
def test_uncertainty_has_its_closed_form(n):
    """Random walk without its line: RMS^2 = 2 s^2 (N^2 - 4)/(15 N)."""
    result = two_point(np.zeros((2, n)), STEP, step=STEP, u_reading=1e-9)

    points = n + 1
    expected = 1e-9 * math.sqrt(2.0 * (points**2 - 4) / (15.0 * points))
    found = math.sqrt(np.mean(result.u["artefact"] ** 2))
    assert found == pytest.approx(expected, rel=1e-9, abs=0.0)


@pytest.mark.slow
def test_noise_of_thirty_steps_is_that_of_the_specification():
    """Goal S14: 2.04 s for n = 30."""
    rng = np.random.default_rng(30)
    squares = [
        np.mean(two_point(rng.standard_normal((2, 30)), 1.0, step=1.0).artefact ** 2)
        for _ in range(600)
    ]
    assert math.sqrt(np.mean(squares)) == pytest.approx(2.04, rel=MC_RTOL, abs=0.0)


def test_zero_difference_is_only_a_line():
    form = level(np.sin(np.arange(15.0)))
    m = read(form, np.cos(np.arange(14.0)))
    m[1] += 0.3

    np.testing.assert_allclose(
        two_point(m, 1.0, step=1.0).artefact, form, rtol=0, atol=ROUNDING * 30
    )


def test_pitch_goes_into_the_form_and_is_said():
    x = np.arange(14) * STEP
    pitch = 1e-6 * np.sin(40 * x)
    m = read(np.zeros(15), np.zeros(14), pitch=pitch)

    result = two_point(m, STEP, x=x)

    expected = level(np.concatenate([[0.0], np.cumsum(pitch * STEP)]))
    np.testing.assert_allclose(result.artefact, expected, rtol=0, atol=1e-20)
    assert ("pitch", "term") in {(i.part, i.kind) for i in result.null_space}


def test_an_angle_sensor_takes_the_pitch_out():
    rng = np.random.default_rng(5)
    form, slide = 1e-7 * rng.standard_normal(41), 1e-6 * rng.standard_normal(40)
    pitch = 3e-6 * np.sin(np.arange(40) / 3.0)
    m = read(form, slide, pitch=pitch)

    with_sensor = two_point(
        m,
        STEP,
        step=STEP,
        method="least_squares",
        pitch=pitch + 2e-6,
        u_pitch=1e-8,
        u_reading=1e-9,
    )

    np.testing.assert_allclose(with_sensor.artefact, level(form), rtol=0, atol=1e-17)
    assert not [i for i in with_sensor.null_space if i.kind == "term"]
    # u: sqrt(2) s and u_pitch d of each difference add in quadrature
    one = math.hypot(math.sqrt(2.0) * 1e-9, 1e-8 * STEP)
    expected = one * math.sqrt((41**2 - 4) / (15.0 * 41))
    found = math.sqrt(np.mean(with_sensor.u["artefact"] ** 2))
    assert found == pytest.approx(expected, rel=1e-6, abs=0.0)


def test_waves_of_the_distance_are_named_and_not_invented():
    i = np.arange(60)
    long, lost = np.sin(2 * np.pi * i / 45), np.sin(2 * np.pi * i / 4)
    m = read(long + lost, np.zeros(56), s=4)

    for method in ("generalised", "combined", "least_squares"):
        result = two_point(m, 4.0, step=1.0, method=method)
        without = two_point(read(long, np.zeros(56), s=4), 4.0, step=1.0, method=method)
        np.testing.assert_allclose(result.artefact, without.artefact, rtol=0, atol=1e-9)
        waves = [w for n in result.null_space if n.kind == "wavelength" for w in n.indices]
        assert waves == pytest.approx([4.0, 2.0], rel=1e-9, abs=0.0)
        assert any("suppressed" in text for text in result.messages)


def test_transfer_is_that_of_the_textbook():
    method = TwoPoint(4e-3, 1e-3)
    lengths = np.array([2e-3, 3e-3, 4e-3, 8e-3, 1.0])

    expected = np.abs(np.exp(2j * np.pi * 4e-3 / lengths) - 1.0)

    np.testing.assert_allclose(method.transfer(lengths), expected, rtol=0, atol=1e-12)


def test_generalised_takes_any_distance():
    """Distance 3.7 steps: a smooth form of 25 steps comes back to 1 %."""
    grid = np.arange(104.0)
    form = np.sin(2 * np.pi * grid / 25.0)
    at = np.arange(100.0)
    m = np.stack([np.sin(2 * np.pi * at / 25.0), np.sin(2 * np.pi * (at + 3.7) / 25.0)])

    found = two_point(m, 3.7, step=1.0, method="generalised").artefact

    assert found.size == grid.size
    assert np.std(found - level(form)) < 0.01


def test_repeats_show_the_noise_whatever_the_slide_does():
    rng = np.random.default_rng(8)
    form = 1e-7 * rng.standard_normal(31)
    slides = 1e-6 * rng.standard_normal((20, 30))
    m = np.stack([form[:30] + slides, form[1:] + slides]) + 2e-9 * rng.standard_normal((2, 20, 30))

    result = two_point(m, STEP, step=STEP)

    assert result.noise.value == pytest.approx(2e-9, rel=0.1, abs=0.0)
    one = two_point(m[:, 0], STEP, step=STEP, u_reading=result.noise.value)
    np.testing.assert_allclose(
        result.u["artefact"] * math.sqrt(20), one.u["artefact"], rtol=1e-9, atol=0
    )


def test_a_gap_leaves_the_longest_piece():
    form = level(np.sin(np.arange(31.0)))
    m = read(form, np.zeros(30))
    m[1, 9] = np.nan

    for method in ("sequential", "least_squares"):
        result = two_point(m, 1.0, step=1.0, method=method)
        assert np.isnan(result.artefact[:10]).all()
        np.testing.assert_allclose(result.artefact[10:], level(form[10:]), rtol=0, atol=1e-12)
        assert any("NaN" in text for text in result.messages)
        assert next(i for i in result.null_space if i.kind == "samples").indices == tuple(
            range(10)
        )


def test_profiles_bring_positions_and_history():
    x = np.linspace(0.1, 0.4, 31)
    form, slide = 1e-7 * np.sin(np.arange(32.0)), np.zeros(31)
    m = read(form, slide)

    result = two_point([Profile(x, row) for row in m], STEP)

    np.testing.assert_allclose(result.artefact, level(form), rtol=0, atol=1e-20)
    np.testing.assert_allclose(
        result.coordinates["x"], 0.1 + STEP * np.arange(32), rtol=0, atol=1e-15
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"distance": -STEP}, "rising"),
        ({"distance": 0.0}, "rising"),
        ({"distance": 2.5 * STEP}, "multiples"),
        ({"distance": 1e4}, "not in mm"),
        ({"step": 0.0}, "step"),
        ({"method": "fourier"}, "no method"),
        ({"smoothing": 0.0}, "smoothing"),
        ({"u_reading": -1.0}, "u_reading"),
        ({"pitch": np.zeros(12), "u_pitch": 1e-6}, "pitch sensor"),
        (
            {"pitch": np.zeros(3), "u_pitch": 1e-6, "method": "least_squares", "u_reading": 1e-9},
            "12",
        ),
        ({"pitch": np.zeros(12), "method": "least_squares", "u_reading": 1e-9}, "u_pitch"),
        ({"pitch": np.zeros(12), "u_pitch": 1e-6, "method": "least_squares"}, "u_reading"),
        (
            {
                "pitch": np.arange(12.0),
                "u_pitch": 1.0,
                "method": "least_squares",
                "u_reading": 1e-9,
            },
            "rad",
        ),
        ({"x": np.arange(5) * STEP}, "positions"),
        ({"x": np.arange(12)[::-1] * STEP}, "turn round"),
    ],
)
def test_bad_input_is_refused_in_words(change, words):
    given = {"distance": STEP, "step": STEP, **change}
    with pytest.raises(MetrosepError, match=words):
        two_point(np.zeros((2, 12)), **given)


def test_uneven_steps_are_refused():
    with pytest.raises(NotUniformError, match="steps"):
        two_point(np.zeros((2, 12)), STEP, x=np.arange(12.0) ** 1.1)


def test_profiles_at_other_positions_are_refused():
    x = np.linspace(0, 1, 12)
    with pytest.raises(DataError, match="other positions"):
        two_point([Profile(x, x), Profile(x + 0.01, x)], x[1])


# --- passes with gaps, samples that nobody read, sensible calls ---


def passes(rng, n=24, repeats=3):
    """Each pass has its own slide motion of 1 um, a thousand times the noise."""
    form = 1e-7 * np.sin(0.5 * np.arange(n + 1.0))
    slide = 1e-6 * rng.standard_normal((repeats, n))
    m = np.stack([form[:n] + slide, form[1:] + slide]) + 1e-9 * rng.standard_normal(
        (2, repeats, n)
    )
    return form, m


@pytest.mark.parametrize("method", ["sequential", "least_squares", "combined", "generalised"])
def test_one_reading_missing_in_one_pass_lets_no_slide_motion_in(method):
    """The mean of a probe over other passes than its neighbour's would hold 0.3 um of slide."""
    form, m = passes(np.random.default_rng(77))
    m[0, 0, 7] = np.nan

    result = two_point(m, STEP, step=STEP, method=method)

    assert np.abs(result.artefact - level(form)).max() < 6e-9
    assert result.audit["passes_per_position"] == [2, 3]
    assert any("passes" in text and "missing" in text for text in result.messages)


@pytest.mark.slow
def test_a_pass_broken_off_is_weighed_by_what_it_read():
    """Four of five passes end early: u is the scatter, position by position (review: 0.63)."""
    rng = np.random.default_rng(78)
    found = []
    for _ in range(400):
        m = 1e-9 * rng.standard_normal((2, 5, 24))
        m[:, :4, 8:16] = np.nan
        found.append(two_point(m, STEP, step=STEP, u_reading=1e-9))
    for name in ("artefact", "straightness"):
        scatter = np.std([r.parts[name] for r in found], axis=0, ddof=1)
        ratio = math.sqrt(np.mean(found[0].u[name] ** 2) / np.mean(scatter**2))
        assert ratio == pytest.approx(1.0, abs=0.1), name


def test_noise_of_passes_with_gaps_is_pooled_from_all_positions():
    rng = np.random.default_rng(79)
    _, m = passes(rng, repeats=12)
    m[rng.uniform(size=m.shape) < 0.1] = np.nan

    assert two_point(m, STEP, step=STEP, method="least_squares").noise.value == pytest.approx(
        1e-9, rel=0.25, abs=0.0
    )


@pytest.mark.parametrize("method", ["sequential", "least_squares", "combined", "generalised"])
@pytest.mark.parametrize("distance", [2.6, 80e-3, 50e-3])
def test_probes_that_never_read_the_same_place_are_refused(distance, method):
    """Five positions, 40 mm of travel: no sample is read by both probes."""
    m = 1e-6 * np.random.default_rng(0).standard_normal((2, 5))
    with pytest.raises(UnitError, match=r"40 mm.*probes"):
        two_point(m, distance, step=STEP, method=method)


@pytest.mark.parametrize("method", ["least_squares", "combined", "generalised"])
def test_samples_that_no_probe_read_are_nan_and_listed(method):
    """Positions one distance apart, samples half of it: every second one is never touched."""
    form = 1e-7 * np.sin(0.5 * np.arange(25.0))
    m = read(form, np.zeros(24))

    result = two_point(
        m, STEP, x=STEP * np.arange(24), step=STEP / 2, method=method, u_reading=1e-9
    )

    assert np.isnan(result.artefact[1::2]).all()
    assert np.isnan(result.u["artefact"][1::2]).all()
    np.testing.assert_allclose(result.artefact[::2], level(form), rtol=0, atol=2e-10)
    item = next(i for i in result.null_space if i.kind == "samples")
    assert item.indices == tuple(range(1, 49, 2))
    assert any("no probe" in text for text in result.messages)


def test_sums_refuse_positions_that_are_not_the_steps():
    m = np.zeros((2, 12))
    for x in (np.arange(12) * STEP, np.arange(12.0) ** 1.5 * STEP):
        with pytest.raises(NotUniformError, match="sequential"):
            two_point(m, STEP, x=x, step=STEP / 2)


def test_masked_values_are_not_measured():
    form, m = passes(np.random.default_rng(80))
    m[1, 1, 5] = 4e-4
    masked = np.ma.masked_greater(m, 1e-4)

    for given in (masked, [masked[0], masked[1]]):
        result = two_point(given, STEP, step=STEP)
        assert np.abs(result.artefact - level(form)).max() < 6e-9


@pytest.mark.parametrize(
    "form", ["without step", "two arrays", "keyword", "profiles", "all keywords"]
)
def test_other_ways_to_call_it_give_the_same(form, rng):
    m = 1e-7 * rng.standard_normal((2, 12))
    plain = two_point(m, STEP, step=STEP)
    other = {
        "without step": lambda: two_point(m, STEP),
        "two arrays": lambda: two_point(m[0], m[1], STEP),
        "keyword": lambda: two_point(m[0], m[1], distance=STEP),
        "all keywords": lambda: two_point(m=m, distance=STEP),
        "profiles": lambda: two_point(*(Profile(STEP * np.arange(12), row) for row in m), STEP),
    }[form]()
    np.testing.assert_allclose(other.artefact, plain.artefact, rtol=0, atol=1e-20)
    said = any("step is not given" in text for text in other.messages)
    assert said == (form != "profiles")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda m: two_point(m[1] - m[0], STEP), "raw readings"),
        (lambda m: two_point(m[0], m[1], m[0], STEP), r"two_point\(m, distance"),
        (two_point, "distance"),
        (lambda m: two_point(m, None, step=STEP), "distance"),
        (lambda m: two_point(m, "1 mm", step=STEP), "distance"),
        (lambda m: two_point(m, STEP, step="1"), "step"),
        (lambda m: two_point(m, STEP, u_reading="1"), "u_reading"),
        (lambda m: two_point(m, STEP, smoothing=None), "smoothing"),
        (lambda m: two_point(m, STEP, method=None), "no method"),
        (lambda m: two_point(m, STEP, method=["a"]), "no method"),
        (lambda m: two_point(m + 0j, STEP), "complex"),
    ],
    ids=[
        "differences",
        "three arrays",
        "no distance",
        "None",
        "text",
        "step",
        "u",
        "smoothing",
        "no name",
        "a list",
        "complex",
    ],
)
def test_wrong_calls_are_refused_in_words(call, words):
    with pytest.raises(MetrosepError, match=words):
        call(np.zeros((2, 12)))


def test_the_case_of_a_method_does_not_matter():
    assert two_point(np.zeros((2, 12)), STEP, method="Sequential").audit["method"] == "sequential"


def test_readings_in_another_unit_are_doubted_aloud():
    m = np.random.default_rng(0).standard_normal((2, 12))
    assert any("in m" in text for text in two_point(m, STEP).messages)
    assert not any("span" in text for text in two_point(1e-6 * m, STEP).messages)


def test_a_pitch_sensor_in_another_unit_is_refused():
    """Slopes of the readings of some urad cannot hold a pitch of mrad."""
    rng = np.random.default_rng(81)
    pitch = 3e-6 * np.sin(np.arange(40) / 3.0)
    m = read(1e-9 * rng.standard_normal(41), 1e-6 * rng.standard_normal(40), pitch=pitch)
    given = {"step": STEP, "method": "least_squares", "u_reading": 1e-9}

    with pytest.raises(UnitError, match="rad"):
        two_point(m, STEP, pitch=1e3 * pitch, u_pitch=1e-4, **given)
    two_point(m, STEP, pitch=pitch, u_pitch=1e-7, **given)


@pytest.mark.parametrize("repeats", [2, 4])
def test_passes_are_corrected_by_the_mean_error(repeats, rng):
    """R equal to the number of probes would hide a wrong broadcast."""
    m = 1e-7 * rng.standard_normal((2, repeats, 12))
    method = TwoPoint(STEP, STEP)

    corrected = method.correct(m)

    slide = method.separate(m).straightness
    np.testing.assert_allclose(corrected, m - slide[None, None, :], rtol=0, atol=1e-20)


def test_probes_closer_than_a_step_read_no_place_twice():
    m = np.zeros((2, 20))
    for method in ("sequential", "generalised", "least_squares"):
        with pytest.raises(DataError, match="no place is read by two probes"):
            two_point(m, 2e-3, step=5e-3, method=method)
