"""Sine grid: Eq. (2) of the paper, the cosine grid of the acceptance table, starting values."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.forms.sine_grid import SineGrid

A, L = 50e-9, 100e-6
"""Of the paper on slow tool servo turning."""
NM = 1e-9


@pytest.fixture
def mesh():
    """500 x 500 um at 5 um steps: whole periods."""
    g = np.arange(100) * 5e-6
    x, y = np.meshgrid(g, g)
    return x.ravel(), y.ravel()


def test_equation_2():
    """Sine along x, cosine along y."""
    form = SineGrid(amplitude=A, wavelength=L)

    assert form(0.0, 0.0).item() == pytest.approx(50 * NM, abs=1e-22)
    assert form(L / 4, 0.0).item() == pytest.approx(100 * NM, abs=1e-22)
    assert form(-L / 4, L / 2).item() == pytest.approx(-100 * NM, abs=1e-22)
    assert form(L / 12, L / 6).item() == pytest.approx(50 * NM, abs=1e-22)


def test_known_numbers_of_the_grid(mesh):
    """Closed forms: P-V 4 A, Sq A, and Sdq 2 pi A / L, the RMS gradient."""
    form = SineGrid(amplitude=A, wavelength=L)

    z, (gx, gy) = form(*mesh), form.gradient(*mesh)

    assert np.ptp(z) == pytest.approx(4 * A, rel=1e-14, abs=0.0)
    assert z.std() == pytest.approx(A, rel=1e-14, abs=0.0)
    assert math.sqrt((gx**2 + gy**2).mean()) == pytest.approx(
        2 * math.pi * A / L, rel=1e-14, abs=0.0
    )


def test_gradient_in_closed_form():
    form = SineGrid(amplitude=A, wavelength=L)

    gx, gy = form.gradient([0.0, L / 4, L / 6], [0.0, L / 4, L / 2])

    peak = 2 * math.pi * A / L
    np.testing.assert_allclose(gx, [peak, 0.0, 0.5 * peak], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(gy, [0.0, -peak, 0.0], rtol=0.0, atol=1e-15)


def test_phase_turns_it_into_the_cosine_grid(mesh):
    x, y = mesh
    form = SineGrid(amplitude=A, wavelength=L, phase_x=math.pi / 2)

    cosines = A * np.cos(2 * np.pi * x / L) + A * np.cos(2 * np.pi * y / L)

    assert np.abs(form(x, y) - cosines).max() < 1e-21


def test_a_shift_by_a_period_changes_nothing(mesh):
    x, y = mesh
    form = SineGrid(amplitude=A, wavelength=L, amplitude_y=2 * A, wavelength_y=3 * L)

    assert form.period == (L, 3 * L)
    assert np.abs(form(x + L, y - 3 * L) - form(x, y)).max() < 1e-20
    assert SineGrid(A, L).period == (L, L)


def test_tied_and_own_parameters():
    assert list(SineGrid(A, L).parameters) == ["amplitude", "wavelength", "phase_x", "phase_y"]
    own = SineGrid(A, L, amplitude_y=2 * A)
    assert own.parameters["amplitude_y"] == 2 * A
    assert "wavelength_y" not in own.parameters
    assert own.with_parameters(amplitude=3 * A).parameters["amplitude_y"] == 2 * A
    assert not own.has_centre


def test_start_finds_amplitudes_and_phases(mesh):
    x, y = mesh
    truth = SineGrid(A, L, amplitude_y=2 * A, wavelength_y=L, phase_x=0.4, phase_y=-1.0)
    z = truth(x, y) + 1e-6 + 1e-4 * x

    unknown = SineGrid(None, L, amplitude_y=None, phase_x=None, phase_y=None)

    for name, value in unknown.start(x, y, z).parameters.items():
        assert value == pytest.approx(truth.parameters[name], rel=1e-9, abs=0.0)
    tied = SineGrid(None, L).start(x, y, z)
    assert tied.amplitude == pytest.approx(1.5 * A, rel=1e-9, abs=0.0)


def test_start_with_bad_points(mesh):
    x, y = mesh
    form = SineGrid(None, L)

    with pytest.raises(DegenerateFitError, match="all heights are equal"):
        form.start(x, y, np.full_like(x, 1e-6))
    with pytest.raises(TooFewSamplesError, match="at least 7 points"):
        form.start(x[:6], y[:6], x[:6])
    with pytest.raises(DataError, match="no value for wavelength"):
        SineGrid(A, None).start(x, y, x)


def test_bad_values_raise():
    with pytest.raises(DataError, match="wavelength must be positive"):
        SineGrid(A, -L)
    with pytest.raises(DataError, match="wavelength_y must be positive"):
        SineGrid(A, L, wavelength_y=0.0)
    with pytest.raises(DataError, match="amplitude must be finite"):
        SineGrid(math.inf, L)
    with pytest.raises(DataError, match="no value for wavelength"):
        SineGrid(A)(0.0)
