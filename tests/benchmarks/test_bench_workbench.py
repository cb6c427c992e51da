"""Views of the workbench: a 4096 x 4096 map, a profile of 10^7 samples."""

import numpy as np

from metrosep import Profile, Surface
from metrosep.app.map_views import map_view
from metrosep.app.pyramid import build_pyramid
from metrosep.app.spectrum_views import profile_spectrum, spectrum_view
from metrosep.app.view_tables import Extremes, profile_view, section_view
from metrosep.spectral.dft import Band

UM, MM, NM = 1e-6, 1e-3, 1e-9


def large_map():
    z = np.random.default_rng(0).normal(size=(4096, 4096))
    z[1000:1200] = np.nan
    return Surface(z, UM, UM)


def test_pyramid(benchmark):
    surface = large_map()
    benchmark(lambda: build_pyramid(surface))


def test_view(benchmark):
    pyramid = build_pyramid(large_map())
    benchmark(lambda: map_view(pyramid, window=(0, 0, 3 * MM, 4 * MM), shade=True))


def test_section(benchmark):
    surface = large_map()
    benchmark(lambda: section_view(surface, (0.0, 0.0), (4.0 * MM, 4.0 * MM), columns=800))


def test_profile_window(benchmark):
    z = np.random.default_rng(0).normal(size=10**7)
    extremes = Extremes(Profile(np.arange(10**7) * NM, z))
    benchmark(lambda: profile_view(extremes, window=(UM, 9.9 * MM), columns=1000))


def test_limit_of_a_spectrum(benchmark):
    z = np.random.default_rng(2).normal(size=10**6)
    spectrum = profile_spectrum(Profile(np.arange(10**6) * UM, z))
    benchmark(lambda: spectrum_view(spectrum, band=Band(5 * UM, 50 * MM)))
