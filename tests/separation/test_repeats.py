"""Repeatable and non-repeatable part: laws of means, shares, lines, shifts, real tool edges."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

import metrosep as ms
from metrosep.core.errors import DataError, InvalidSamplesError, MetrosepError, TooFewSamplesError
from metrosep.separation.positions.repeats import RepeatSplit, repeatable

EXACT = 1e-12
MC_RTOL = 0.05
M, N = 5, 120
X = np.linspace(0.0, 1.2e-3, N)


def straight(z):
    return z - np.polyval(np.polyfit(X, z, 1), X)


class TestProfiles(SeparationContract):
    takes_repeats = False
    has_redundancy = True

    def method(self):
        return RepeatSplit(tuple(X.tolist()))

    def truth(self, rng):
        return {"repeatable": straight(20e-9 * np.cumsum(rng.standard_normal(N)))}

    def errors(self, rng):
        return {}

    def readings(self, truth, errors):
        rest = errors.get("non_repeatable", np.zeros((M, N)))
        return truth.get("repeatable", np.zeros(N)) + rest

    def invisible(self, rng):
        common = np.tile(straight(rng.standard_normal(N)), (M, 1)) * 1e-9
        yield {"repeatable": -common[0]}, {"non_repeatable": common}

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        """Without errors the number of repeats is not known: it is given here."""
        rng = np.random.default_rng(seed)
        truth, rest = self.truth(rng), {"non_repeatable": 1e-9 * rng.standard_normal((M, N))}
        np.testing.assert_array_equal(
            self.method().simulate(truth, rest), self.readings(truth, rest)
        )


def test_each_repeats_own_share_comes_back_with_its_sign():
    rng = np.random.default_rng(1)
    part = straight(20e-9 * np.sin(X / 40e-6))
    own = np.stack([straight(z) for z in 3e-9 * rng.standard_normal((M, N))])
    own -= own.mean(axis=0)
    lines = 1e-6 * rng.standard_normal((M, 1)) + 1e-3 * rng.standard_normal((M, 1)) * X

    result = repeatable(part + own + lines, x=X)

    np.testing.assert_allclose(result.repeatable, part, rtol=0.0, atol=EXACT * 5e-6)
    np.testing.assert_allclose(result.non_repeatable, own, rtol=0.0, atol=EXACT * 5e-6)
    np.testing.assert_allclose(result.sd, own.std(axis=0, ddof=1), rtol=0.0, atol=EXACT * 5e-6)


def test_shares_are_not_biased_by_noise():
    """Pure noise: the mean has s^2/M of variance, the share is zero on average."""
    shares, lasting = [], []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        audit = repeatable(1e-9 * rng.standard_normal((M, N)), x=X).audit
        shares.append(audit["share_repeatable"])
        lasting.append(audit["variance_repeatable_nm2"])
    # of a line removed: (1 - 2/N)/M against 1/M, 0.003; scatter of the mean 0.2 sqrt(2/120)/17
    assert np.mean(lasting) == pytest.approx(0.0, abs=0.008)
    assert np.mean(shares) == pytest.approx(0.0, abs=0.008)

    wave = 2e-9 * np.sqrt(2) * np.sin(2 * np.pi * 6 * np.arange(N) / N)
    shares = [
        repeatable(wave + 1e-9 * np.random.default_rng(s).standard_normal((M, N)), x=X).audit[
            "share_repeatable"
        ]
        for s in range(50)
    ]
    # the line takes 6/(pi^2 36) = 1.7 % of a sine of 6 cycles
    assert np.mean(shares) == pytest.approx(4 / 5, abs=0.01)


def test_lines_that_repeat_are_found_and_noise_is_not():
    rng = np.random.default_rng(2)
    angle = 2 * np.pi * np.arange(360) / 360
    found, false = 0, 0
    for _ in range(100):
        own = rng.uniform(0, 7, (8, 1))  # of 11 upr, another phase in each repeat
        z = 5e-9 * np.cos(7 * angle - 1) + 5e-9 * np.cos(11 * angle + own)
        z = z + 5e-9 * rng.standard_normal((8, 360))
        lines = repeatable(z, x=angle, closed=True).audit["lines"]
        found += any(line["upr"] == 7 for line in lines)
        false += sum(line["upr"] != 7 for line in lines)
        if lines and lines[0]["upr"] == 7:
            assert abs(lines[0]["amplitude_nm"] - 5.0) < 5 * lines[0]["u_nm"] + 0.5
    assert found == 100
    assert false <= 15  # 5 % of about 1.05 discoveries each, 100 sets


def test_profiles_on_other_positions_are_brought_to_common_ones():
    rng = np.random.default_rng(3)

    def height(x):
        return 100e-9 * np.sin(x / 60e-6)

    profiles = []
    for shift in (0.0, 0.3e-6, -0.7e-6):
        x = np.sort(shift + np.linspace(0, 1e-3, 1500) + 0.1e-6 * rng.standard_normal(1500))
        profiles.append(ms.Profile(x, height(x) + 1e-9 * shift / 1e-6))

    result = repeatable(profiles)

    x = result.coordinates["x"]
    expected = height(x)
    expected = expected - np.polyval(np.polyfit(x, expected, 1), x)
    # linear interpolation over 0.67 um: h^2 z''/8 is 2 pm
    np.testing.assert_allclose(result.repeatable, expected, rtol=0.0, atol=5e-12)
    assert result.audit["resampled_step_um"] == pytest.approx(0.667, abs=0.02)


def test_shift_is_found_with_its_sign():
    z = [100e-9 * np.sin((X + s) / 60e-6) for s in (0.0, 4e-6, -11e-6)]  # lies s earlier

    result = repeatable(z, x=X, shift="fit")

    # linear interpolation at 10 um steps of a wave of 377 um
    np.testing.assert_allclose(result.audit["shifts_um"], [0.0, -4.0, 11.0], rtol=0.0, atol=0.05)
    assert result.noise.value < 0.3e-9
    assert repeatable(z, x=X).noise.value > 5e-9


def test_gaps_stay_gaps():
    rng = np.random.default_rng(4)
    z = rng.standard_normal((M, N)) * 1e-9
    z[:, 10] = np.nan
    z[1:, 20] = np.nan
    z[0, 30] = np.nan

    result = repeatable(z, x=X)

    assert np.isnan(result.repeatable[10])
    assert np.isnan(result.sd[[10, 20]]).all()
    assert np.isfinite(result.repeatable[[20, 30]]).all()
    assert result.u["repeatable"][20] > 2 * result.u["repeatable"][40]
    assert any("gaps" in m for m in result.messages)


def test_maps_lose_a_plane_each():
    rng = np.random.default_rng(5)
    y, x = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 30), indexing="ij")
    part = 50e-9 * x**3 * y
    maps = [
        ms.Surface(part + 1e-6 * a + 1e-6 * b * x + 1e-6 * c * y, 1e-3, 2e-3)
        for a, b, c in rng.standard_normal((4, 3))
    ]

    result = repeatable(maps)

    basis = np.stack([np.ones(600), x.ravel(), y.ravel()], axis=1)
    flat = part.ravel() - basis @ np.linalg.lstsq(basis, part.ravel(), rcond=None)[0]
    np.testing.assert_allclose(result.repeatable.ravel(), flat, rtol=0.0, atol=EXACT * 5e-6)
    assert result.coordinates["y"][1] == 2e-3
    assert result.noise.value < 1e-20


@pytest.mark.parametrize(
    ("given", "settings", "error"),
    [
        (np.zeros((1, N)), {}, TooFewSamplesError),
        (np.zeros(N), {}, InvalidSamplesError),
        ([np.zeros(5), np.zeros(6)], {}, InvalidSamplesError),
        (np.zeros((2, 4)), {}, TooFewSamplesError),
        (np.zeros((2, N)), {"align": "sphere"}, DataError),
        (np.zeros((2, N)), {"x": X[:5]}, DataError),
        (np.zeros((2, N)), {"shift": "fit"}, DataError),
        (np.zeros((2, N)), {"u_reading": -1.0}, DataError),
        ([ms.Profile(X, X), X], {}, DataError),
        ([ms.Profile(X, X), ms.Profile(X + 1.0, X)], {}, DataError),
        (ms.Profile(X, X), {}, TooFewSamplesError),
        (
            [ms.Surface(np.zeros((9, 9)), 1.0, 1.0), ms.Surface(np.zeros((9, 8)), 1.0, 1.0)],
            {},
            DataError,
        ),
        ([["a"], ["b"]], {}, InvalidSamplesError),
        (np.zeros((2, N)), {"u_reading": "a"}, DataError),
        (np.zeros((2, N)), {"x": np.full(N, np.nan)}, InvalidSamplesError),
    ],
)
def test_bad_input_is_refused(given, settings, error):
    with pytest.raises(error):
        repeatable(given, **settings)


def test_gaps_in_other_places_do_not_turn_the_repeats():
    """Found by review: a line of each by itself followed the part, 2.4 nm for 1.0 nm of noise."""
    rng = np.random.default_rng(21)
    part = 20e-9 * np.sin(2 * np.pi * np.arange(N) / (N / 4.7))
    noise = []
    for _ in range(10):
        z = part + 1e-9 * rng.standard_normal((5, N))
        z += 1e-6 * rng.standard_normal((5, 1)) + 1e-6 * rng.standard_normal((5, 1)) * X / X[-1]
        for k in range(5):
            z[k, k * N // 5 : k * N // 5 + N // 8] = np.nan
        result = repeatable(z, x=X)
        noise.append(result.noise.value)
        np.testing.assert_allclose(result.repeatable, straight(part), rtol=0.0, atol=4e-9)
    assert np.mean(noise) == pytest.approx(1e-9, rel=0.02, abs=0.0)
    exact = np.stack([np.where(np.isnan(r), np.nan, part + k * 1e-6 * X) for k, r in enumerate(z)])
    again = repeatable(exact, x=X)
    np.testing.assert_allclose(again.repeatable, straight(part), rtol=0.0, atol=EXACT * 5e-6)
    assert again.noise.value < 1e-15


def test_falling_positions_and_none():
    """A wavelength is positive; without x it is in samples."""
    rng = np.random.default_rng(22)
    wave = 10e-9 * np.sin(2 * np.pi * np.arange(N) * 8 / N)
    z = wave + 1e-9 * rng.standard_normal((5, N))
    rising, falling = repeatable(z, x=X), repeatable(z[:, ::-1], x=X[::-1])
    plain = repeatable(z)
    up, down = rising.audit["lines"][0], falling.audit["lines"][0]
    assert down["wavelength_um"] == pytest.approx(up["wavelength_um"], abs=1e-6)
    assert up["wavelength_um"] == pytest.approx(1e6 * N / 8 * (X[1] - X[0]), rel=1e-9, abs=0.0)
    assert plain.audit["lines"][0]["wavelength_samples"] == pytest.approx(N / 8, abs=1e-9)
    assert "wavelength_um" not in plain.audit["lines"][0]
    with pytest.raises(DataError, match="rises"):
        repeatable(z, x=X[::-1], shift="fit")


def test_masked_and_complex_readings():
    rng = np.random.default_rng(23)
    z = 1e-9 * rng.standard_normal((4, N))
    hole = np.zeros(z.shape, dtype=bool)
    hole[:, 5:9] = True
    masked = np.ma.array(np.where(hole, 1.0, z), mask=hole)
    for given in (masked, list(masked)):
        result = repeatable(given, x=X)
        assert np.isnan(result.repeatable[5:9]).all()
        assert result.noise.value < 2e-9
    with pytest.raises(InvalidSamplesError, match="complex"):
        repeatable(z + 1j, x=X)
    with pytest.raises(DataError, match="degrees"):
        repeatable(z, x=np.linspace(0, 360, N), closed=True)


def test_masks_that_do_not_meet():
    z = np.zeros((2, N))
    z[0, : N // 2] = np.nan
    z[1, N // 2 :] = np.nan
    with pytest.raises(MetrosepError, match="masks"):
        repeatable(z, x=X)


def test_real_tool_edge_repeats(corpus):
    """Three scans of one diamond edge: its shape repeats, the scans differ by about 1 um."""
    edges = [
        ms.read(corpus / "upm" / f"20221019-strategy-2p40-{k}.csv", x="path") for k in (1, 2, 3)
    ]
    same = [e.crop(0.1e-3, 1.9e-3) for e in edges[1:]]  # 2 and 3 have the same set-up; no ends

    plain, moved = repeatable(same), repeatable(same, shift="fit")

    # independent: interpolation at 1 um and a search over shifts gave -4 um, and 2.01 and 1.49 um
    # RMS of the difference over 1.8 mm, which is sqrt(2) of one repeat
    assert plain.noise.value == pytest.approx(2.0e-6 / math.sqrt(2), rel=0.02, abs=0.0)
    assert moved.noise.value == pytest.approx(1.49e-6 / math.sqrt(2), rel=0.02, abs=0.0)
    assert moved.audit["shifts_um"][1] == pytest.approx(-4.0, abs=1.0)
    assert moved.audit["share_repeatable"] > 0.999
    assert np.ptp(moved.repeatable) > 0.1e-3
    assert repeatable(edges, shift="fit").audit["n_repeats"] == 3
