"""The ISO 230-2 chart shows means, bands, readings and values of the result."""

import numpy as np
import pytest
from matplotlib.colors import to_hex

from metrosep.plot.charts import positioning_chart
from metrosep.plot.style import COLOURS
from metrosep.separation.positions.positioning import iso230_2

UM = 1e-6
EXACT = 1e-9  # in the unit of the axis


@pytest.fixture
def test_result():
    rng = np.random.default_rng(0)
    targets = np.array([0.0, 0.11, 0.19, 0.33])
    forward = targets[:, None] + UM * rng.normal(size=(4, 5))
    return iso230_2(targets, forward, forward - 3 * UM)


def test_means_of_both_directions_are_drawn(test_result):
    ax = positioning_chart(test_result)

    for name, mean in (
        ("forward", test_result.mean_forward),
        ("backward", test_result.mean_backward),
    ):
        (line,) = [item for item in ax.lines if str(item.get_label()).startswith(name)]
        np.testing.assert_allclose(line.get_xdata(), test_result.targets * 1e3, atol=EXACT, rtol=0)
        np.testing.assert_allclose(line.get_ydata(), mean / UM, atol=EXACT, rtol=0)
    assert ax.get_xlabel() == "target / mm"
    assert ax.get_ylabel().endswith("/ µm")


def test_bands_are_two_standard_deviations(test_result):
    ax = positioning_chart(test_result)

    band = ax.collections[0].get_paths()[0].vertices
    at = band[np.abs(band[:, 0] - 110.0) < EXACT, 1]
    assert at.max() - at.min() == pytest.approx(4 * test_result.sd_forward[1] / UM, abs=EXACT)
    assert to_hex(ax.collections[0].get_facecolor()[0]) == COLOURS["estimate"].lower()


def test_the_box_holds_the_values(test_result):
    (box,) = [t.get_text() for t in positioning_chart(test_result).texts]

    for symbol in ("A", "R", "E", "B", "M"):
        row = next(line.split() for line in box.splitlines() if line.split()[:1] == [symbol])
        assert float(row[1]) == pytest.approx(test_result[symbol].value / UM, abs=0.005)
        assert float(row[2]) == pytest.approx(test_result[symbol].u / UM, abs=0.005)


def test_one_direction_and_small_errors():
    targets = np.array([0.0, 0.1, 0.2])
    reached = targets[:, None] + 1e-9 * np.array([[0, 1], [2, 3], [5, 4.0]])

    ax = positioning_chart(iso230_2(targets, reached, None))

    assert ax.get_ylabel().endswith("/ nm")
    assert not any("backward" in str(line.get_label()) for line in ax.lines)
    assert "E_fwd" in ax.texts[0].get_text()
    assert "B_mean" not in ax.texts[0].get_text()
