"""The picture of a series of parts shows what was found, with its signs."""

import numpy as np

from metrosep.parameters import part_series
from metrosep.plot.series_chart import draw_part_series
from metrosep.plot.style import figure_svg


def found():
    rng = np.random.default_rng(8)
    n = 30
    common = rng.standard_normal(n)
    table = {
        "falls": -2e-9 * np.arange(n) + 3e-9 * rng.standard_normal(n),
        "a": 5e-9 * common,
        "b": -5e-9 * common + 5e-10 * rng.standard_normal(n),
    }
    table["a"][4] = np.nan
    return part_series(table)


def test_bars_have_the_sign_of_the_drift():
    figure = draw_part_series(found().to_dict())
    axes = figure.subfigs[0].axes[0]
    assert next(t.get_text() for t in axes.get_yticklabels()) == "falls"
    assert axes.patches[0].get_width() < -2.0
    words = [t.get_text() for t in axes.texts]
    drift = found().terms[0].drift
    assert words[0] == f"{drift * 1e9:+.3g} nm"


def test_curves_are_the_values_and_gaps_stay_gaps():
    series = found()
    figure = draw_part_series(series.to_dict())
    by_name = {a.get_title(loc="left"): a for a in figure.subfigs[0].axes[1:]}
    drawn = by_name["a"].lines[0].get_ydata()
    term = next(t for t in series.terms if t.name == "a")
    assert np.isnan(drawn[4])
    assert np.nanmax(np.abs(drawn - term.values * 1e9)) <= 1e-9


def test_correlated_pair_is_framed_with_its_sign():
    series = found()
    assert [c[:2] for c in series.correlated] == [("a", "b")]
    axes = draw_part_series(series.to_dict()).subfigs[1].axes[0]
    assert len(axes.patches) == 2
    names = [t.get_text() for t in axes.get_xticklabels()]
    matrix = axes.images[0].get_array()
    assert matrix[names.index("a"), names.index("b")] < -0.9


def test_json_without_numbers_is_drawn():
    document = part_series({"a": np.full(9, 2.0), "b": np.arange(9.0)}).to_dict()
    document["correlation"] = [[1.0, None], [None, 1.0]]
    assert figure_svg(draw_part_series, document) == figure_svg(draw_part_series, document)
