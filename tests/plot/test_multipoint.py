"""Figures of multi-point straightness draw the numbers of the result."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.multipoint import probe_transfer, straightness_parts
from metrosep.separation.contract import Separation
from metrosep.separation.lines.slope_integration import integrate_slopes
from metrosep.separation.lines.three_points import ThreePoint, TwoPoint, three_point


@pytest.fixture
def result():
    rng = np.random.default_rng(1)
    form = 1e-7 * np.sin(np.arange(40) / 4)
    slide, pitch = 1e-6 * rng.standard_normal(38), 1e-6 * rng.standard_normal(38)
    m = np.stack([form[k : k + 38] + slide + k * 10e-3 * pitch for k in range(3)])
    return three_point(m, 10e-3, step=10e-3, u_reading=1e-9, zero=0.0)


def test_parts_are_drawn_with_their_band(result):
    figure = straightness_parts(result)

    panels = figure.axes
    assert len(panels) == 3
    for axes, name, key, scale in zip(
        panels,
        ("artefact", "straightness", "pitch"),
        ("x", "carriage_x", "carriage_x"),
        (1e9, 1e6, 1e6),
        strict=True,
    ):
        line = axes.get_lines()[0]
        np.testing.assert_allclose(
            line.get_xdata(), result.coordinates[key] * 1e3, rtol=1e-12, atol=0
        )
        np.testing.assert_allclose(
            line.get_ydata(), result.parts[name] * scale, rtol=1e-12, atol=0
        )
        band = axes.collections[0].get_paths()[0].vertices[:, 1]
        top = np.max((result.parts[name] + 2 * result.u[name]) * scale)
        assert band.max() == pytest.approx(top, rel=1e-9, abs=0.0)
        assert name in axes.get_ylabel()
    assert "µm" in panels[1].get_ylabel()
    assert "mm" in panels[-1].get_xlabel()


def test_several_results_are_told_apart(result):
    figure = straightness_parts({"one": result, "other": result})

    lines = figure.axes[0].get_lines()[:2]
    assert lines[0].get_color() != lines[1].get_color()
    assert lines[0].get_linestyle() != lines[1].get_linestyle()
    texts = [t.get_text() for t in figure.axes[0].get_legend().get_texts()]
    assert texts == ["one ± 2 u", "other ± 2 u"]


def test_slopes_have_one_panel_and_gaps_stay():
    s = 1e-6 * np.cos(np.arange(60) / 5)
    s[10] = np.nan
    figure = straightness_parts(integrate_slopes(s, np.arange(60) * 1e-3))

    (axes,) = figure.axes
    assert np.isnan(axes.get_lines()[0].get_ydata()[:10]).all()
    assert not axes.collections


def test_transfer_is_drawn_with_the_lost_wavelengths():
    lengths = np.geomspace(2.1e-3, 0.3, 600)
    method = ThreePoint(10e-3, 1e-3)

    axes = probe_transfer({"10 mm": method, "two": TwoPoint(10e-3, 1e-3)}, lengths)

    line = next(a for a in axes.get_lines() if a.get_label() == "10 mm")
    drawn = np.asarray(line.get_ydata())
    seen = np.isfinite(drawn)
    assert seen.mean() > 0.8
    expected = np.abs(np.exp(2j * np.pi * 10e-3 / lengths) - 1) ** 2
    np.testing.assert_allclose(drawn[seen], expected[seen], rtol=1e-9, atol=0)
    marks = next(a for a in axes.get_lines() if a.get_marker() == "x")
    np.testing.assert_allclose(marks.get_xdata(), 10.0 / np.arange(1, 5), rtol=1e-6, atol=0)
    assert axes.get_yscale() == axes.get_xscale() == "log"


def test_nothing_to_draw_is_refused():
    with pytest.raises(DataError, match="over position"):
        straightness_parts(Separation("x", {}, {}, {}, {}, ()))
    with pytest.raises(DataError, match="set-up"):
        probe_transfer({}, [1.0, 2.0])
    with pytest.raises(DataError, match="above zero"):
        probe_transfer({"a": TwoPoint(1.0, 1.0)}, [0.0, 1.0])
