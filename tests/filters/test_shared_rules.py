"""What all filters have in common: limits of a cut-off, whole numbers, counts, words of errors."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.core.errors import DataError, NotConvergedError, NotUniformError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.filters.chain import roughness
from metrosep.filters.gaussian import gaussian, gaussian_support
from metrosep.filters.morphological import closing, dilation
from metrosep.filters.robust import regression_constant, robust_gaussian
from metrosep.filters.spline import spline
from metrosep.spectral.dft import Band

UM = 1e-6
NM = 1e-9
BY_CUTOFF = [gaussian, spline, robust_gaussian]


@pytest.fixture
def profile() -> Profile:
    """60 samples at 1 um."""
    return Profile(np.arange(60) * UM, np.random.default_rng(1).normal(size=60) * NM)


@pytest.fixture
def surface() -> Surface:
    """50 rows and 60 columns at 1 um."""
    return Surface(np.random.default_rng(2).normal(size=(50, 60)) * NM, UM, UM)


def _message(call, error=DataError) -> str:
    with pytest.raises(error) as caught:
        call()
    return str(caught.value)


def _weighted_line(x, z, cutoff):
    """Local straight lines with the weights of ISO 16610-21, point by point."""
    out = np.empty(x.size)
    for i in range(x.size):
        u = (x - x[i]) / cutoff
        root = np.exp(-0.5 * np.pi * u**2 / (np.log(2.0) / np.pi))
        design = np.column_stack([np.ones(u.size), u]) * root[:, None]
        out[i] = np.linalg.lstsq(design, z * root, rcond=None)[0][0]
    return out


def test_the_whole_length_as_cut_off_gives_the_definition(profile):
    x, z, cutoff = profile.x, profile.z, 60 * UM
    line = _weighted_line(x, z, cutoff)
    second = np.diff(np.eye(60), 2, axis=0)
    k = 1.0 / (2.0 * np.sin(np.pi / 60))
    ruler = np.linalg.solve(np.eye(60) + k**4 * second.T @ second, z)

    assert np.abs(gaussian(profile, cutoff=cutoff).z - line).max() < 1e-9 * NM
    robust = robust_gaussian(profile, cutoff=cutoff, order=1, robust=False)
    assert np.abs(robust.z - line).max() < 1e-9 * NM
    assert np.abs(spline(profile, cutoff=cutoff).z - ruler).max() < 1e-9 * NM
    reached = [z[max(0, i - 30) : i + 31].max() for i in range(60)]
    assert np.array_equal(dilation(profile, length=cutoff).z, reached)


@pytest.mark.parametrize("filtered", BY_CUTOFF)
def test_the_side_of_the_area_is_a_nesting_index_of_every_filter(filtered, surface):
    """ISO 25178-3: the L-filter is the side of the area, n dx."""
    low = filtered(surface, nesting_index=(60 * UM, 50 * UM))

    assert np.isfinite(low.z).all()
    assert low.history[-1].parameters["nesting_index_x_m"] == 60 * UM
    assert low.history[-1].parameters["nesting_index_y_m"] == 50 * UM


@pytest.mark.parametrize("filtered", BY_CUTOFF)
def test_rounding_of_positions_does_not_move_the_limit(filtered):
    p = Profile(0.3 + np.arange(60) * 0.1 * UM, np.random.default_rng(3).normal(size=60))

    assert np.isfinite(filtered(p, cutoff=6 * UM).z).all()


def test_limits_of_a_profile_are_told_in_the_same_words(profile):
    long = {_message(lambda f=f: f(profile, cutoff=60.1 * UM)) for f in BY_CUTOFF}
    short = {_message(lambda f=f: f(profile, cutoff=2 * UM)) for f in BY_CUTOFF}

    assert long == {
        (
            "cutoff 60.1 um is longer than what was measured, 60 um: remove a form instead, or measure "
            "a longer piece"
        )
    }
    assert short == {
        (
            "cutoff 2 um does not exceed the sampling limit of two steps, 2 um: shorter waves are not "
            "in the data; is the unit m?"
        )
    }
    for f in (gaussian, spline):
        assert len(f(profile, cutoff=2.001 * UM)) == 60
    assert len(robust_gaussian(profile, cutoff=2.001 * UM, unsupported="nan")) == 60


def test_limits_of_a_surface_are_told_in_the_same_words(surface):
    long = {_message(lambda f=f: f(surface, nesting_index=(60 * UM, 51 * UM))) for f in BY_CUTOFF}
    short = {_message(lambda f=f: f(surface, nesting_index=(2 * UM, 9 * UM))) for f in BY_CUTOFF}

    assert long == {
        (
            "nesting_index in y 51 um is longer than what was measured, 50 um: remove a form instead, "
            "or measure a longer piece"
        )
    }
    assert short == {
        (
            "nesting_index in x 2 um does not exceed the sampling limit of two steps, 2 um: shorter "
            "waves are not in the data; is the unit m?"
        )
    }


def test_a_band_has_the_limits_of_its_filters(profile, surface):
    assert len(gaussian(profile, band=Band(3 * UM, 60 * UM))) == 60
    assert "longer than what was measured, 60 um" in _message(
        lambda: gaussian(profile, band=Band(3 * UM, 61 * UM))
    )
    assert "does not exceed the sampling limit" in _message(
        lambda: gaussian(surface, band=Band(2 * UM, 50 * UM))
    )


@pytest.mark.parametrize("closed", [True, False])
def test_open_and_closed_have_one_limit(profile, closed):
    for filtered, end in ((gaussian, "moment"), (spline, "natural")):
        options = {"end": "closed" if closed else end}
        assert len(filtered(profile, cutoff=60 * UM, **options)) == 60
        assert "60 um: remove" in _message(
            lambda f=filtered, o=options: f(profile, cutoff=61 * UM, **o)
        )


def test_the_length_is_that_of_what_was_measured(surface):
    z = surface.z.copy()
    z[:10] = np.nan
    part = Surface(z, UM, UM)
    for filtered in BY_CUTOFF:
        assert filtered(part, nesting_index=40 * UM).n_invalid == 600
        assert "40 um: remove" in _message(
            lambda f=filtered: f(part, nesting_index=41 * UM), DataError
        )
    assert closing(part, length=40 * UM).n_invalid == 600
    assert "40 um: remove" in _message(lambda: closing(part, length=41 * UM))


def test_a_flat_element_ends_where_a_cut_off_does(profile, surface):
    assert len(closing(profile, length=60 * UM)) == 60
    assert closing(surface, length=50 * UM).shape == (50, 60)
    assert _message(lambda: closing(profile, length=60.1 * UM)) == (
        "length 60.1 um is longer than what was measured, 60 um: remove a form instead, or measure "
        "a longer piece"
    )
    two_steps = dilation(profile, length=2 * UM)  # one neighbour on each side: of use, so allowed
    assert two_steps.z[5] == profile.z[4:7].max()


def test_lengths_that_print_alike_get_more_digits(profile):
    text = _message(lambda: gaussian(profile, cutoff=60.0001 * UM))

    assert text.startswith("cutoff 60.0001 um is longer than what was measured, 60 um:")


@pytest.mark.parametrize("order", [0, 1, 2])
def test_numpy_integers_are_orders(profile, order):
    plain = robust_gaussian(profile, cutoff=20 * UM, order=order)
    given = robust_gaussian(profile, cutoff=20 * UM, order=np.int16(order))

    assert np.array_equal(plain.z, given.z)
    assert type(given.history[-1].parameters["order"]) is int
    assert regression_constant(np.uint8(order)) == regression_constant(order)


@pytest.mark.parametrize(
    "order",
    [1.0, 2.0, np.float64(0), True, False, np.True_, "1", None, 3, -1, [1], 1j, np.nan],
    ids=repr,
)
def test_what_is_no_order_is_refused_by_name(profile, order):
    expected = f"order must be a whole number from 0 to 2, got {order!r}"

    assert _message(lambda: robust_gaussian(profile, cutoff=20 * UM, order=order)) == expected
    assert _message(lambda: regression_constant(order)) == expected


@pytest.mark.parametrize("value", [True, 2.0, "5", None])
def test_what_is_no_number_of_iterations_or_sections_is_refused_by_name(profile, value):
    calls = {
        "max_iterations": [
            lambda: robust_gaussian(profile, cutoff=20 * UM, max_iterations=value),
            lambda: spline(profile, cutoff=20 * UM, max_iterations=value),
        ],
        "sections": [lambda: roughness(profile, lambda_c=20 * UM, sections=value)],
    }
    if value is None:
        del calls["sections"]  # all that is there
    for name, made in calls.items():
        for call in made:
            assert _message(call).startswith(f"{name} must be a whole number from ")


@pytest.mark.parametrize("value", [0.0, -1e-6, np.nan, np.inf])
def test_a_tolerance_that_cannot_be_met_is_refused_alone(profile, value):
    text = _message(lambda: robust_gaussian(profile, cutoff=20 * UM, tolerance=value))

    assert text == f"tolerance must be positive and finite, got {value}"


@pytest.mark.parametrize("end", ["natural", "closed"])
@pytest.mark.parametrize("tension", [1, 1.0, np.int64(1)], ids=repr)
def test_full_tension_solves_the_first_differences_alone(profile, end, tension):
    """ISO 16610-22 with b = 1; lines are taken off first and put back (closed: the mean)."""
    n, k = 60, 1.0 / (2.0 * np.sin(np.pi / 20))
    eye = np.eye(n)
    first = np.roll(eye, -1, axis=0) - eye if end == "closed" else np.diff(eye, axis=0)
    i = np.arange(n)
    trend = np.polyval(np.polyfit(i, profile.z, 0 if end == "closed" else 1), i)
    dense = np.linalg.solve(eye + k**2 * first.T @ first, profile.z - trend) + trend

    low = spline(profile, cutoff=20 * UM, end=end, tension=tension)

    assert np.abs(low.z - dense).max() < 1e-9 * NM
    assert low.history[-1].parameters["tension"] == 1.0
    assert type(low.history[-1].parameters["tension"]) is float


def test_full_tension_bridges_gaps_with_straight_lines(profile):
    z = profile.z.copy()
    z[20:30] = np.nan
    low = spline(Profile(profile.x, z), cutoff=20 * UM, tension=1, fill=True).z

    assert np.abs(np.diff(low[19:31], 2)).max() < 1e-9 * NM
    s = np.tile(z, (12, 1))
    w = spline(Surface(s, UM, UM), nesting_index=(20 * UM, 5 * UM), tension=1, fill=True).z
    assert np.isfinite(w).all()
    assert np.abs(np.diff(w[:, 19:31], 2, axis=1)).max() < 1e-7 * NM


@pytest.mark.parametrize(
    "tension", [True, False, np.True_, "1", None, 2, -1, 1.1, np.nan], ids=repr
)
def test_what_is_no_tension_is_refused(profile, tension):
    assert _message(lambda: spline(profile, cutoff=20 * UM, tension=tension)).startswith(
        "tension must "
    )


def _isolated() -> Profile:
    """A sample alone: at a cut-off of 40 steps its support is 1 / (0.4697 * 40) = 0.053."""
    z = np.random.default_rng(4).normal(size=200)
    z[50:150] = np.nan
    z[100] = 1.0
    return Profile(np.arange(200) * UM, z)


def _lost(before, after) -> int:
    return int(np.count_nonzero(np.isnan(after.z) & ~np.isnan(before.z)))


@pytest.mark.parametrize("fill", [False, True])
@pytest.mark.parametrize("band", ["long", "short"])
@pytest.mark.parametrize("end", ["moment", "renormalise", "closed"])
def test_gaussian_counts_the_samples_that_it_takes_out(fill, band, end):
    p = _isolated()
    low = gaussian(p, cutoff=40 * UM, fill=fill, band=band, end=end)

    assert np.isnan(low.z[100])
    assert low.history[-1].parameters["n_unsupported"] == _lost(p, low) == 1
    kept = gaussian(p, cutoff=40 * UM, min_support=0.01, fill=fill, band=band, end=end)
    assert kept.history[-1].parameters["n_unsupported"] == _lost(p, kept) == 0


def test_gaussian_counts_on_surfaces_in_bands_and_where_ends_are_cut():
    p = _isolated()
    cut = gaussian(p, cutoff=40 * UM, end="cut")
    assert cut.history[-1].parameters["n_unsupported"] == 1
    first, second = gaussian(p, band=Band(30 * UM, 40 * UM)).history
    assert [s.parameters["n_unsupported"] for s in (first, second)] == [1, 0]

    z = np.random.default_rng(5).normal(size=(80, 90))
    z[20:60, 20:60] = np.nan
    z[39:41, 40] = 1.0
    s = Surface(z, UM, UM)
    low = gaussian(s, nesting_index=15 * UM)
    assert low.history[-1].parameters["n_unsupported"] == _lost(s, low) == 2
    whole = gaussian(Surface(np.zeros((30, 30)), UM, UM), nesting_index=15 * UM)
    assert whole.history[-1].parameters["n_unsupported"] == 0


def test_spline_takes_no_measured_sample_out():
    p = _isolated()

    assert _lost(p, spline(p, cutoff=20 * UM)) == 0
    assert _lost(p, spline(p, cutoff=20 * UM, end="closed")) == 0


def _rounded() -> Profile:
    x = np.round(np.arange(200) * 167.3 * NM, 9)
    return Profile(x, np.random.default_rng(6).normal(size=200))


@pytest.mark.parametrize(
    "call",
    [
        lambda p: gaussian(p, cutoff=10 * UM),
        lambda p: gaussian(p, cutoff=10 * UM, end="closed"),
        lambda p: gaussian(p, upr=15, end="closed"),
        lambda p: gaussian_support(p, cutoff=10 * UM),
        lambda p: spline(p, cutoff=10 * UM),
        lambda p: spline(p, cutoff=10 * UM, end="closed"),
        lambda p: robust_gaussian(p, cutoff=10 * UM),
        lambda p: closing(p, radius=10 * UM),
        lambda p: dilation(p, length=10 * UM),
        lambda p: roughness(p, lambda_c=10 * UM, sections=1),
    ],
    ids=range(10),
)
def test_uneven_steps_are_told_with_their_size_and_a_way_out(call):
    """Steps of 167 and 168 nm about their mean: 0.7 nm = 0.42 % off."""
    p = _rounded()
    steps = np.diff(p.x)
    mean = (p.x[-1] - p.x[0]) / steps.size
    off = np.abs(steps - mean).max()
    assert 0.69 * NM < off < 0.71 * NM

    text = _message(lambda: call(p), NotUniformError)

    assert f"by up to {off / NM * 1e3:.4g} pm" in text
    assert f"{off / mean * 100:.3g} %" in text
    assert "0.0001 %" in text
    assert "numpy.interp" in text
    assert "lateral_step=" in text


def test_the_ways_out_of_uneven_steps_work(tmp_path):
    import metrosep

    p = _rounded()
    x = np.linspace(p.x[0], p.x[-1], len(p))
    even = Profile(x, np.interp(x, p.x, p.z))
    assert len(gaussian(even, cutoff=10 * UM)) == 200

    file = tmp_path / "rounded.csv"
    rows = [f"{a * 1e6:.3f},{b:.6f}" for a, b in zip(p.x, p.z, strict=True)]
    file.write_text("\n".join(["x_um,z_nm", *rows]), encoding="utf-8")
    read = metrosep.read(file, z="z_nm", lateral_step="167.3 nm")
    assert len(gaussian(read, cutoff=10 * UM)) == 200


def test_uniform_to_a_millionth_is_still_the_rule():
    x = np.arange(200) * UM
    for off, fine in ((0.9e-6, True), (1.1e-6, False)):
        y = x.copy()
        y[100:] += off * UM
        p = Profile(y, np.zeros(200))
        if fine:
            assert len(gaussian(p, cutoff=20 * UM)) == 200
        else:
            assert "0.000109 % of it" in _message(lambda p=p: gaussian(p, cutoff=20 * UM))


def test_one_is_singular():
    none = Profile(np.arange(5) * UM, np.full(5, np.nan))
    for call in (
        lambda: closing(none, length=4 * UM),
        lambda: gaussian(none, cutoff=4 * UM, end="closed"),
    ):
        text = _message(call, TooFewSamplesError)
        assert text.endswith("needs at least 1 measured sample, got 0 of 5")
    with pytest.raises(NotConvergedError, match="in 1 iteration,"):
        robust_gaussian(
            Profile(np.arange(200), np.random.default_rng(7).normal(size=200)),
            cutoff=50,
            max_iterations=1,
        )
    z = np.random.default_rng(8).normal(size=(20, 20))
    z[5:15, 5:15] = np.nan
    with pytest.raises(NotConvergedError, match="in 1 iteration: gaps of 100 samples"):
        spline(Surface(z, UM, UM), nesting_index=5 * UM, max_iterations=1)
    p = Profile(np.arange(60) * UM, np.zeros(60))
    with pytest.raises(TooFewSamplesError, match=r"^1 section of 25 um needs 25 samples, 10 are"):
        roughness(p, lambda_c=25 * UM, sections=1, end="cut")
