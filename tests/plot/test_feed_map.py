"""The map shows the amplitudes of each feedrate and where vibrations slide; evidence its levels."""

from itertools import pairwise

import numpy as np
import pytest

from metrosep import Run, RunSet
from metrosep.errors import DataError
from metrosep.plot.evidence_chart import evidence_plot, feed_map
from metrosep.plot.style import COLOURS
from metrosep.separation.runs.base import ErrorEstimate
from metrosep.separation.runs.evidence import evidence_table

FEEDS = (0.08, 0.12, 0.16)
WAVE, GEOMETRY, VIBRATION, TONE = 10e-3, 200e-9, 150e-9, 60.0
EXACT = 1e-9


def made_runs(*, tone=TONE, feeds=FEEDS, ways=(1,), seed=0):
    """100 mm at 1 kHz: a wave that sits on the position, a tone in time, white noise of 2 nm."""
    rng = np.random.default_rng(seed)
    runs = []
    for v in feeds:
        for way in ways:
            t = np.arange(int(0.1 / v * 1000)) * 1e-3
            x = v * t if way > 0 else 0.1 - v * t
            z = GEOMETRY * np.cos(2 * np.pi * x / WAVE) + 2e-9 * rng.standard_normal(t.size)
            runs.append(Run(x, z + VIBRATION * np.sin(2 * np.pi * tone * t + v), t=t, feed=v))
    return RunSet(runs)


def mesh_of(axes):
    mesh = axes.collections[0]
    corners = mesh.get_coordinates()
    return mesh.get_array(), corners[0, :, 0], corners[:, 0, 1]


def guides_of(axes):
    return [line for line in axes.lines if line.get_color() == COLOURS["after"]]


def test_geometry_stays_in_its_column_and_the_tone_slides():
    axes = feed_map(made_runs())
    power, bands, _ = mesh_of(axes)
    width = bands[1] / bands[0]

    at_wave = np.searchsorted(bands, 10.0) - 1
    for v, row in zip(FEEDS, power, strict=True):
        assert row[at_wave - 1 : at_wave + 2].max() == pytest.approx(200.0, rel=0.05, abs=0.0)
        falls = v * 1e3 / TONE
        short = bands[1:] < 6.0
        strongest = int(np.argmax(np.where(short, row, 0.0)))
        assert abs(np.log(np.sqrt(bands[strongest] * bands[strongest + 1]) / falls)) < np.log(
            width
        )


def test_rows_stand_at_their_feedrates():
    axes = feed_map(made_runs())
    _, _, edges = mesh_of(axes)

    assert [text.get_text() for text in axes.get_yticklabels()] == ["4800", "7200", "9600"]
    for v, low, high in zip((4800, 7200, 9600), edges[:-1], edges[1:], strict=True):
        assert low < v < high
    assert axes.get_xscale() == axes.get_yscale() == "log"


def test_the_tone_is_found_and_its_line_is_straight():
    (line,) = guides_of(feed_map(made_runs()))
    wavelength, feed = line.get_data()

    np.testing.assert_allclose(
        np.diff(np.log(feed)), np.diff(np.log(wavelength)), atol=EXACT, rtol=0
    )
    frequency = feed[0] / 60.0 / wavelength[0]
    assert frequency == pytest.approx(TONE, rel=0.06, abs=0.0)  # a band of 1/12 octave


def test_stated_lines_are_drawn_where_they_fall():
    (line,) = guides_of(feed_map(made_runs(), lines=[80.0]))
    wavelength, feed = line.get_data()

    np.testing.assert_allclose(wavelength * 80.0 * 60.0, feed, atol=EXACT, rtol=1e-12)
    assert not guides_of(feed_map(made_runs(), lines=()))


@pytest.mark.parametrize("seed", range(8))
def test_without_vibration_no_line_is_drawn(seed):
    rng = np.random.default_rng(seed)
    runs = []
    for v in FEEDS:
        t = np.arange(int(0.1 / v * 1000)) * 1e-3
        z = GEOMETRY * np.cos(2 * np.pi * v * t / WAVE) + 2e-9 * rng.standard_normal(t.size)
        runs.append(Run(v * t, z, t=t, feed=v))

    assert not guides_of(feed_map(RunSet(runs)))


def test_power_is_kept_in_bands_that_hold_several_wavelengths():
    """A random mode spreads over many wavelengths; bands add squares."""
    n = 200
    columns = {
        "feed_mm_min": [4800.0] * n + [9600.0] * n,
        "wavelength_mm": (100.0 / np.tile(np.arange(1, n + 1), 2)).tolist(),
        "amplitude_nm": [3.0] * (2 * n),
    }
    power, bands, _ = mesh_of(feed_map({"estimate": {"feed_spectra": columns}}))
    wavelength = np.array(columns["wavelength_mm"][:n])
    count = np.array(
        [((wavelength > low) & (wavelength <= high)).sum() for low, high in pairwise(bands)]
    )

    np.testing.assert_allclose(power[0], 3.0 * np.sqrt(np.maximum(count, 1)), atol=EXACT, rtol=0)


@pytest.mark.slow
def test_a_result_names_its_geometry_and_its_noise(document):
    axes = feed_map(document)
    (marks,) = [line for line in axes.lines if line.get_marker() == "^"]
    spectrum = document["estimate"]["spectrum"]
    wanted = [
        w
        for w, s, d in zip(
            spectrum["wavelength_mm"], spectrum["selected"], spectrum["direction"], strict=True
        )
        if s and d == "forward" and axes.get_xlim()[0] <= w <= axes.get_xlim()[1]
    ]

    assert sorted(marks.get_xdata()) == sorted(wanted)
    (mode,) = guides_of(axes)  # the simulated column, 150 Hz
    wavelength, feed = mode.get_data()
    assert feed[0] / 60.0 / wavelength[0] == pytest.approx(150.0, rel=0.03, abs=0.0)
    text = [item.get_text() for item in axes.get_legend().get_texts()]
    assert text == ["geometry stays at its wavelength", "vibration slides: feedrate / frequency"]


def test_an_estimate_draws_as_its_result(document):
    estimate = ErrorEstimate.from_dict(document["estimate"])

    one, two = mesh_of(feed_map(estimate))[0], mesh_of(feed_map(document))[0]
    np.testing.assert_allclose(one, two, atol=EXACT, rtol=0)


def test_the_direction_is_chosen():
    runs = made_runs(ways=(1, -1))
    reverse = mesh_of(feed_map(runs, direction="reverse"))[0]
    alone = mesh_of(feed_map(runs.select(direction=-1)))[0]

    np.testing.assert_allclose(reverse, alone, atol=EXACT, rtol=0)
    assert np.abs(reverse - mesh_of(feed_map(runs))[0]).max() > 0.1  # other noise


@pytest.mark.parametrize(
    ("source", "options", "told"),
    [
        (made_runs(feeds=(0.1,)), {}, "2 feedrates"),
        (made_runs(), {"lines": [-5.0]}, "positive"),
        (made_runs(), {"direction": "reverse"}, "do not go reverse"),
        (made_runs(), {"direction": "up"}, "forward"),
        ({"estimate": None}, {}, "2 feedrates"),
        ([1.0, 2.0], {}, "got list"),
    ],
)
def test_what_cannot_be_drawn_is_refused(source, options, told):
    with pytest.raises(DataError, match=told):
        feed_map(source, **options)


@pytest.fixture(scope="module")
def table():
    return evidence_table(RunSet([r for s in range(3) for r in made_runs(seed=s)]), bandwidth=3.0)


@pytest.mark.parametrize("quantity", ["coherence", "snr"])
def test_evidence_is_drawn_filled_where_selected(table, quantity):
    axes = evidence_plot(table, quantity=quantity)
    by_label = {line.get_label(): line for line in axes.lines}
    frame = table.to_frame()
    chosen = by_label["repeats at all feedrates (selected)"]

    wanted = frame[frame["selected"]]
    np.testing.assert_allclose(chosen.get_xdata(), wanted["wavelength_mm"], atol=EXACT, rtol=0)
    np.testing.assert_allclose(chosen.get_ydata(), wanted[quantity], atol=EXACT, rtol=0)
    assert chosen.get_markerfacecolor() == COLOURS["estimate"]
    assert by_label["within the noise"].get_markerfacecolor() == "white"


def test_null_levels(table):
    frame = table.to_frame()
    level = {
        q: next(
            line.get_ydata()[0]
            for line in evidence_plot(table, quantity=q).lines
            if "5 %" in str(line.get_label())
        )
        for q in ("coherence", "snr")
    }

    assert level["coherence"] == frame["coherence_null"][0]
    r = table.audit["n_runs"]  # (1 + F / (R - 1))^-(R - 1) = 5 %, F = 1 + R snr
    exact = ((r - 1) * (0.05 ** (-1 / (r - 1)) - 1) - 1) / r
    assert level["snr"] == pytest.approx(exact, rel=0.2, abs=0.0)


def test_what_the_feeds_cannot_tell_is_hatched(table):
    axes = evidence_plot(table)
    blind = table.to_frame().query("reason == 'not separable by repeatability'")
    spans = [patch.get_extents().transformed(axes.transData.inverted()) for patch in axes.patches]

    assert len(blind) > 0
    assert len(spans) == len(blind)
    for w in blind["wavelength_mm"]:
        assert any(s.x0 < w < s.x1 for s in spans)
    assert all(patch.get_hatch() for patch in axes.patches)
    drawn = np.concatenate([line.get_xdata() for line in axes.lines if line.get_marker() == "o"])
    assert not set(drawn) & set(blind["wavelength_mm"])


def test_no_evidence_is_refused(table):
    with pytest.raises(DataError, match="no evidence"):
        evidence_plot({})
    with pytest.raises(DataError, match="'coherence' or 'snr'"):
        evidence_plot(table, quantity="p")
    blank = dict(table.columns) | {"coherence": [float("nan")] * len(table.columns["p"])}
    with pytest.raises(DataError, match="no coherence"):
        evidence_plot(blank)
