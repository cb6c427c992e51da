"""Panels of one chart share a unit, and no value vanishes in it."""

import numpy as np
import pytest

from metrosep.plot.charts import draw_chart
from metrosep.recipe.describe.charts import curve, curve_chart, panel

X = np.linspace(0.0, 0.2, 50)
WAVE = np.sin(40.0 * X)


def labels(*sizes, unit="m"):
    panels = [panel(str(i), unit, [curve("", X, s * WAVE)]) for i, s in enumerate(sizes)]
    figure = draw_chart(curve_chart("t", ("position", "m"), panels))
    drawn = [float(np.max(np.abs(a.lines[0].get_ydata()))) for a in figure.axes]
    return [a.get_ylabel() for a in figure.axes], drawn


@pytest.mark.parametrize(
    ("sizes", "unit", "label"),
    [
        ((5e-6, 3e-7), "m", "µm"),  # both read well in um
        ((5e-6, 5e-9), "m", "nm"),  # the second would vanish in um
        ((8e-5, 4e-6), "rad", "µrad"),
        ((3e-3, 2e-9), "m", "µm"),  # nm would have seven digits
        ((2e-8,), "m", "nm"),
        ((0.0, 3e-7), "m", "nm"),
    ],
)
def test_one_unit_for_a_quantity(sizes, unit, label):
    found, drawn = labels(*sizes, unit=unit)
    assert found == [label] * len(sizes)
    factor = {"mm": 1e3, "µm": 1e6, "nm": 1e9, "µrad": 1e6}[label]
    for size, value in zip(sizes, drawn, strict=True):
        assert value == pytest.approx(
            size * factor * np.max(np.abs(WAVE)), abs=1e-5 * size * factor
        )


def test_different_quantities_keep_their_own_units():
    panels = [
        panel("form", "m", [curve("", X, 5e-6 * WAVE)]),
        panel("pitch", "rad", [curve("", X, 2e-5 * WAVE)]),
    ]
    figure = draw_chart(curve_chart("t", ("position", "m"), panels))
    assert [a.get_ylabel() for a in figure.axes] == ["µm", "µrad"]
