"""The drift chart shows change since the start, windows and ranges; the Allan plot its minimum."""

import numpy as np
import pytest

from metrosep.errors import DataError
from metrosep.plot.series_chart import allan_plot, drift_chart
from metrosep.separation import allan_deviation, iso230_3_drift

EXACT = 1e-9


def test_change_since_the_start_with_gaps_and_windows():
    t = np.arange(0.0, 7200.0, 60.0)
    x = 5e-6 + 3e-6 * t / t[-1]
    x[7] = np.nan
    test = iso230_3_drift(
        t, {"EX0C": x, "EAC": x}, windows=[(0, 3600), (3600, 7140)], angular=("EAC",)
    )

    ax = drift_chart(test)

    (line,) = [item for item in ax.lines if str(item.get_label()).startswith("EX0C")]
    wanted = 3.0 * t / t[-1]
    wanted[7] = np.nan
    np.testing.assert_allclose(line.get_ydata(), wanted, atol=EXACT, rtol=0)
    np.testing.assert_allclose(line.get_xdata(), t / 60, atol=EXACT, rtol=0)
    values = [f"{q.value * 1e6:.3g}" for q in test.ranges["EX0C"]]
    assert ", ".join(values) in line.get_label()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time / min", "drift / µm")
    assert len(ax.patches) == 1
    assert not any("EAC" in str(item.get_label()) for item in ax.lines)


def test_angles_alone_are_not_drawn():
    t = np.arange(10.0)
    with pytest.raises(DataError, match="no channel is a length"):
        drift_chart(iso230_3_drift(t, {"EAC": t}, angular=("EAC",)))


def test_allan_plot_marks_the_minimum():
    rng = np.random.default_rng(0)
    t = np.arange(4000.0)
    tau, dev, u = allan_deviation(t, 5e-9 * rng.normal(size=4000) + 1e-11 * t)

    ax = allan_plot(tau, dev, u)

    best = int(np.argmin(dev))
    assert any(
        np.size(line.get_xdata()) == 1
        and line.get_xdata()[0] == tau[best]
        and abs(line.get_ydata()[0] - dev[best] * 1e9) < EXACT
        for line in ax.lines
    )
    np.testing.assert_allclose(ax.lines[0].get_ydata(), dev * 1e9, atol=EXACT, rtol=0)
    assert ax.get_xscale() == ax.get_yscale() == "log"
    with pytest.raises(DataError, match="equally many"):
        allan_plot(tau, dev[1:])
