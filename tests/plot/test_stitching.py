"""Figures of a stitching: outlines where the maps lay, the mismatch as in the audit."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.maps import overlap_mismatch, stitch_layout, stitched_surface
from metrosep.separation.maps.stitching import stitch
from metrosep.separation.positions.periodic import periodic_error

POSITIONS = np.array([(0, 0), (9, 1), (20, 0), (0, 11), (9, 12), (20, 11)]) * 1e-3


def maps(*, wrong=False):
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:40, 0:50]
    part = 50e-9 * np.sin(x / 5.0) * np.cos(y / 6.0) + 20e-9 * np.sin(y / 2.0 + x / 3.0)
    out = []
    for k, (a, b) in enumerate(np.rint(POSITIONS * 1e3).astype(int)):
        start = a + (3 if wrong and k == 4 else 0)
        out.append(part[b : b + 24, start : start + 24] + 1e-9 * rng.standard_normal((24, 24)))
    return out


def test_outlines_lie_where_the_maps_were_and_the_wrong_one_stands_out():
    axes = stitch_layout(stitch(maps(wrong=True), POSITIONS, dx=1e-3))

    assert len(axes.lines) == 6
    corners = np.array([np.min(line.get_xydata(), axis=0) for line in axes.lines])
    np.testing.assert_allclose(corners, POSITIONS * 1e3, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        np.ptp(axes.lines[0].get_xydata(), axis=0), 23.0, rtol=0.0, atol=1e-9
    )
    widths = [line.get_linewidth() for line in axes.lines]
    assert np.argmax(widths) == 4
    assert sorted(set(widths)) == [1.1, 2.0]
    assert "do not fit" in axes.get_title()
    assert axes.get_xlabel() == "x / mm"


def test_a_turned_map_is_drawn_turned_about_its_centre():
    turns = [0.0, 0.0, 0.0, 0.0, np.pi / 4, 0.0]
    axes = stitch_layout(stitch(maps(), POSITIONS, dx=1e-3, rotations=turns, u_reading=1e-6))
    outline = axes.lines[4].get_xydata()[:-1]
    np.testing.assert_allclose(
        outline.mean(axis=0), POSITIONS[4] * 1e3 + 11.5, rtol=0.0, atol=1e-9
    )
    # the first corner (-h, -h) turned by 45 degrees counter-clockwise lies straight below
    np.testing.assert_allclose(
        outline[0] - outline.mean(axis=0), [0.0, -11.5 * np.sqrt(2)], rtol=0.0, atol=1e-9
    )


def test_mismatch_is_the_audits_and_symmetric():
    result = stitch(maps(wrong=True), POSITIONS, dx=1e-3)
    axes = overlap_mismatch(result)

    drawn = axes.images[0].get_array()
    for o in result.audit["overlaps"]:
        i, j = (k - 1 for k in o["pair"])
        assert drawn[i, j] == pytest.approx(o["residual_nm"], rel=1e-12, abs=0.0)
        assert drawn[j, i] == drawn[i, j]
    assert drawn.mask[0, 0]
    assert len(axes.patches) == 2 * len(result.audit["outlying_pairs"])


def test_maps_share_a_figure_and_a_profile_has_its_band():
    result = stitch(maps(), POSITIONS, dx=1e-3, reference="fit", reference_degree=4)
    figure = stitched_surface(result)
    shown = [a.images[0].get_array() for a in figure.axes if a.images and a.get_xlabel()]
    np.testing.assert_allclose(
        np.ma.filled(shown[0], np.nan) * 1e-9, result.surface, rtol=0.0, atol=1e-20
    )

    rows = stitch([m[0] for m in maps()[:3]], [0.0, 9e-3, 20e-3], dx=1e-3)
    axes = stitched_surface(rows)
    np.testing.assert_allclose(
        axes.lines[0].get_ydata() * 1e-9, rows.surface, rtol=0.0, atol=1e-20
    )
    band = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert band.max() * 1e-9 == pytest.approx(
        np.max(rows.surface + 2 * rows.u["surface"]), rel=1e-9, abs=0.0
    )
    layout = stitch_layout(rows)
    assert [tuple(line.get_xdata()) for line in layout.lines][1] == pytest.approx(
        (9, 32), abs=1e-9
    )


def test_another_result_is_refused():
    x = np.linspace(0, 1e-6, 50)
    other = periodic_error(x, np.cos(x * 2e7), period=0.3e-6)
    for draw in (stitch_layout, overlap_mismatch, stitched_surface):
        with pytest.raises(DataError, match="stitch"):
            draw(other)
