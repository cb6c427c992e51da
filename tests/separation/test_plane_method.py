"""The plane model under the contract: maps of e(x) + e(y) + alpha y + beta x + coupling."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

import metrosep as ms
from metrosep.core.errors import DataError, MetrosepError
from metrosep.separation.planes.plane_fit import PlaneModel, fit_plane_model

N_Y, N_X = 14, 18
DX, DY = 2e-3, 3e-3
X, Y = 0.1 + DX * np.arange(N_X), -0.05 + DY * np.arange(N_Y)

SAME = 1e-18
"""m; the class and the function do the same sums."""


def straight(x, z):
    return z - np.polyval(np.polyfit(x - x.mean(), z, 1), x - x.mean())


def both_ways_free(z):
    return z - z.mean(axis=0) - z.mean(axis=1, keepdims=True) + z.mean()


class TestOneMap(SeparationContract):
    takes_repeats = False
    trials = 500
    n_maps = None

    def method(self):
        return PlaneModel(DX, DY, (0.1, -0.05))

    def truth(self, rng):
        return {"coupling": both_ways_free(30e-9 * rng.standard_normal((N_Y, N_X)))}

    def errors(self, rng):
        return {
            "along_x": straight(X, 100e-9 * rng.standard_normal(N_X)),
            "along_y": straight(Y, 50e-9 * rng.standard_normal(N_Y)),
            "alpha": 3e-6 * rng.standard_normal(),
            "beta": 3e-6 * rng.standard_normal(),
        }

    def readings(self, truth, errors):
        z = np.zeros((N_Y, N_X))
        for j in range(N_Y):
            for i in range(N_X):
                z[j, i] += errors.get("alpha", 0.0) * (Y[j] - Y[0])
                z[j, i] += errors.get("beta", 0.0) * (X[i] - X[0])
                z[j, i] += errors.get("along_x", np.zeros(N_X))[i]
                z[j, i] += errors.get("along_y", np.zeros(N_Y))[j]
                z[j, i] += truth.get("coupling", np.zeros((N_Y, N_X)))[j, i]
        return z if self.n_maps is None else np.stack([z] * self.n_maps)

    def invisible(self, rng):
        a, b = rng.standard_normal(2) * 1e-7
        yield {}, {"along_x": np.full(N_X, a), "along_y": np.full(N_Y, -a)}
        yield {}, {"along_x": b * (X - X[0]), "beta": -b}
        f, g = rng.standard_normal(N_X) * 1e-7, rng.standard_normal(N_Y) * 1e-7
        yield {"coupling": f + g[:, None]}, {"along_x": -f, "along_y": -g}

    def test_unknown_noise_is_said_not_zero(self):
        """One map: the rough coupling stands for the noise, which is what must be said."""
        *_, readings = self.draw(11)
        result = self.method().separate(readings)
        assert any("u_reading" in m and "rough coupling counts as noise" in m
                   for m in result.messages)  # fmt: skip
        assert "residual of smooth terms" in result.noise.definition


class TestRepeatedMaps(TestOneMap):
    has_redundancy = True
    n_maps = 3
    trials = 500

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        """The method gives one map; every repeat is that map."""
        _, truth, errors, readings = self.draw(seed)
        simulated = self.method().simulate(truth, errors)
        np.testing.assert_allclose(readings - simulated, 0.0, rtol=0.0, atol=1e-15)

    @pytest.mark.parametrize("bad", ["empty", "flat", "inf", "text", "nothing measured"])
    def test_useless_readings_are_refused_in_words(self, bad):
        """One repeat alone is a map, and may be used."""
        super().test_useless_readings_are_refused_in_words(bad)

    def test_unknown_noise_is_said_not_zero(self):
        """Nothing is unknown here."""
        *_, readings = self.draw(11)
        assert "repeats" in self.method().separate(readings).noise.definition


def example(seed=3, shape=(3, N_Y, N_X)):
    rng = np.random.default_rng(seed)
    return 1e-7 * rng.standard_normal(shape) + 1e-6 * Y[:, None] ** 2


def test_the_class_gives_what_the_function_gives():
    maps = example()
    maps[:, 4, 5] = np.nan
    maps[:, 7] = np.nan
    found = PlaneModel(DX, DY).separate(maps)
    fit = fit_plane_model(maps, dx=DX, dy=DY)
    np.testing.assert_allclose(found.along_x, fit.along_x.z, rtol=0.0, atol=SAME)
    np.testing.assert_allclose(found.u["along_y"], fit.u_y.z, rtol=0.0, atol=SAME)
    np.testing.assert_allclose(found.coupling, fit.residual.z, rtol=0.0, atol=SAME)
    assert np.isnan(found.coupling[:, 5]).sum() == 2
    assert np.isnan(found.along_y[7])
    assert float(found.alpha) == pytest.approx(fit.alpha.value, abs=SAME)
    assert found.audit["coupling_p"] == pytest.approx(fit.interaction.p, abs=1e-15)


@pytest.mark.slow
def test_uncertainty_of_the_coupling_with_gaps_is_its_scatter():
    """Closed form on a whole map; with gaps the scatter of 800 maps is the law."""
    sd, rng = 2e-9, np.random.default_rng(5)
    plain = PlaneModel(DX, DY).separate(np.zeros((N_Y, N_X)), u_reading=sd)
    whole = sd * np.sqrt((1 - 1 / N_X) * (1 - 1 / N_Y))
    np.testing.assert_allclose(plain.u["coupling"], whole, rtol=1e-9)

    holes = rng.random((5, 6)) < 0.2
    zero = np.where(holes, np.nan, 0.0)
    method = PlaneModel(DX, DY)
    draws = [
        method.separate(zero + sd * rng.standard_normal(zero.shape), u_reading=sd)
        for _ in range(800)
    ]
    scatter = np.std([d.coupling for d in draws], axis=0)
    np.testing.assert_allclose(draws[0].u["coupling"], scatter, rtol=0.1, atol=1e-3 * sd)


def test_a_surface_must_lie_on_the_grid_of_the_method():
    surface = ms.Surface(example(shape=(N_Y, N_X)), DX, DY, origin=(0.1, -0.05))
    found = PlaneModel(DX, DY, (0.1, -0.05)).separate(surface, u_reading=1e-9)
    assert found.coordinates["x"][0] == pytest.approx(0.1, abs=1e-15)
    with pytest.raises(DataError, match="resample"):
        PlaneModel(DX, 2 * DY, (0.1, -0.05)).separate(surface, u_reading=1e-9)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: PlaneModel(0.0, 1e-3), "dx"),
        (lambda: PlaneModel(1e-3, 1e-3, (0.0, np.nan)), "origin"),
        (lambda: PlaneModel(DX, DY).simulate({}, {"alpha": 1e-6}), "both along_x and along_y"),
        (lambda: PlaneModel(DX, DY).simulate({"coupling": "abc"}, {}), "not an array of numbers"),
        (
            lambda: PlaneModel(DX, DY).simulate(
                {"coupling": np.zeros((3, 4))}, {"along_x": np.zeros(3)}
            ),
            "shape",
        ),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()
