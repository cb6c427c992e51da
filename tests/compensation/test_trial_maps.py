"""A map to try on the machine: one bump, lopsided in both axes, of known sign."""

import numpy as np
import pytest

from metrosep.compensation import CompensationMap
from metrosep.compensation.trial import trial_map
from metrosep.errors import DataError, SignCheckFailedError, TableError


def real(nx=21, ny=11, reference=(0.0, 0.0)):
    x, y = np.linspace(-0.1, 0.1, nx), np.linspace(0.0, 0.05, ny)
    return CompensationMap(x, y, np.zeros((ny, nx)), reference=reference)


@pytest.mark.parametrize("amplitude", [2e-6, -3e-6])
def test_the_bump_has_its_sign_and_stands_apart_from_every_mirror_image(amplitude):
    trial = trial_map(real(), amplitude)
    px, py = trial.place

    def there(x, y):
        return float(trial.table.correction(x, y)[0])

    assert there(px, py) == pytest.approx(amplitude, abs=1e-18)
    assert there(-px, py) == 0.0
    assert there(px, 0.05 - py) == 0.0
    assert there(-px, 0.05 - py) == 0.0
    assert there(0.0, 0.0) == 0.0
    assert np.count_nonzero(trial.table.values[[0, -1]]) == 0
    assert np.count_nonzero(trial.table.values[:, [0, -1]]) == 0
    assert f"{amplitude * 1e6:+.4g} um" in trial.if_right
    assert f"{-amplitude * 1e6:+.4g} um" in trial.if_wrong


def test_it_is_a_product_of_two_functions():
    values = trial_map(real(), 2e-6).table.values
    assert np.linalg.matrix_rank(values, tol=1e-15) == 1


def test_the_reference_stays_zero_wherever_it_is():
    for x in np.linspace(-0.1, 0.1, 21):
        for y in np.linspace(0.0, 0.05, 11):
            table = trial_map(real(reference=(x, y)), 2e-6).table
            assert float(table.correction(x, y)[0]) == 0.0


def test_its_dry_run_passes_and_the_flipped_one_fails():
    table = trial_map(real(), 2e-6).table

    assert table.verify().passed
    with pytest.raises(SignCheckFailedError):
        table.negated().verify(table.source)


@pytest.mark.parametrize("amplitude", [0.0, float("nan"), "0 um", True])
def test_an_amplitude_is_a_length(amplitude):
    with pytest.raises(DataError, match="amplitude"):
        trial_map(real(), amplitude)


def test_too_small_a_map_is_refused():
    with pytest.raises(TableError, match="at least 5 positions"):
        trial_map(real(nx=4), 1e-6)
