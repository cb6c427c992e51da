"""The rotary example of the specification: 9" sin(a + 23 deg) + 4" cos 2a, zero at 0, closed over a turn."""

import numpy as np

from metrosep.compensation import CompensationTable

ARCSEC = np.pi / 180 / 3600


def error(angle):
    """Return the error in rad; neither odd nor even, and not that of half a turn."""
    shape = lambda a: 9 * np.sin(a + np.deg2rad(23)) + 4 * np.cos(2 * a)  # noqa: E731
    return (shape(np.asarray(angle)) - shape(0.0)) * ARCSEC


def table(lag=0.0, step=30, axis="C"):
    """Return its table over one turn; the reverse column lags by arcseconds."""
    angles = np.deg2rad(np.arange(0, 361, step))
    ahead = -error(angles)
    ahead[-1] = ahead[0]
    reverse = ahead - lag * ARCSEC if lag else None
    return CompensationTable(angles, ahead, reverse, axis, axis, 0.0, is_exact_inverse=True)


def over_three_turns(seen, made, unit, *, folds=True):
    """Return the largest deviation of a lookup in degrees, -360 to 720 deg, both ways, in units."""
    worst = 0.0
    for direction in (1, -1):
        for degrees in np.linspace(-360, 720, 433):
            place = degrees % 360.0 if folds else degrees
            wanted = made.correction(np.deg2rad(place), direction)[0]
            worst = max(worst, abs(float(seen(degrees, direction)) - wanted) / unit)
    return worst
