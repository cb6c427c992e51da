"""The report has a table with a row for each run: what the others predict of it, and what was found."""

import math
import re

import pytest

from metrosep.report import render_html

HOSTILE = "<script>alert('x')</script> & \"co\""


@pytest.fixture
def planted(document):
    """Nine runs of numbers that are typed here, one displaced and one left out; no figures."""
    estimate = document["estimate"]
    n = 9
    estimate["terms"] = {}
    estimate["runs"] = {
        "run": [f"2026-11-23 spindle off, pass {i} of 9 at the lathe" for i in range(n)],
        "direction": [1] * n,
        "feed_mm_min": [4800.0] * n,
        "used": [True] * 8 + [False],
        "finding": [""] * 4
        + ["is displaced by 900 um (u 49 um) against the other 8 runs"]
        + [""] * 4,
        "misfit": [1.04] * 4 + [12.3] + [0.95] * 3 + [None],
        "predicted_gain": [1.0] * 4 + [-0.5] + [1.0] * 3 + [None],
        "u_predicted_gain": [0.02] * 8 + [None],
        "predicted_shift_mm": [-0.004] * 4 + [0.9] + [math.nan] * 3 + [None],
        "u_predicted_shift_mm": [0.03] * 8 + [None],
    }
    document["plots"] = {}
    return document


def rows_of(page):
    """The cells of the table as text, row by row."""
    table = page.split('<table class="runs">')[1].split("</table>")[0]
    rows = re.findall(r"<tr.*?</tr>", table, flags=re.DOTALL)
    return [[re.sub(r"<.*?>", "", c) for c in re.findall(r"<t[dh].*?</t[dh]>", r)] for r in rows]


def test_each_run_has_a_row_and_the_found_one_a_second(planted):
    head, *rows = rows_of(render_html(planted))

    assert head == ["run", "feed, mm/min", "misfit", "gain", "u", "shift, mm", "u"]
    assert len(rows) == 9 + 2
    assert rows[0] == ["…0 of 9 at the lathe", "4800", "1.04", "1.000", "0.020", "−0.004", "0.030"]
    assert rows[4][2:] == ["12.30", "−0.500", "0.020", "0.900", "0.030"]
    assert rows[5] == [
        "▸ run …4 of 9 at the lathe: is displaced by 900 µm (u 49 µm) against the other 8 runs"
    ]
    assert rows[6][5] == "–"  # NaN is not measured
    assert rows[9][2:] == ["–"] * 5
    assert rows[10] == ["▸ run …8 of 9 at the lathe: excluded"]


def test_the_whole_name_is_there_and_hostile_ones_do_not_run(planted):
    planted["estimate"]["runs"]["run"][2] = HOSTILE
    planted["estimate"]["runs"]["finding"][2] = HOSTILE
    page = render_html(planted)

    assert "<script" not in page
    assert 'title="2026-11-23 spindle off, pass 3 of 9 at the lathe"' in page
    assert 'title="&lt;script&gt;' in page


def test_fitted_position_offsets_are_columns_with_their_sign(planted):
    planted["estimate"]["runs"] |= {
        "position_offset_mm": [0.6, -0.2, -0.0004] + [0.0] * 5 + [None],
        "u_position_offset_mm": [0.02] * 8 + [None],
    }
    head, *rows = rows_of(render_html(planted))

    assert head[-2:] == ["placed, mm", "u"]
    assert [r[-2:] for r in rows[:2]] == [["+0.600", "0.020"], ["−0.200", "0.020"]]
    assert rows[2][-2] == "0.000"
    assert rows[9][-2:] == ["–", "–"]


def test_two_directions_are_told_apart(planted):
    planted["estimate"]["runs"]["direction"][6:] = [-1] * 3
    head, *rows = rows_of(render_html(planted))

    assert head[1] == "direction"
    assert [r[1] for r in rows if len(r) > 1] == ["forward"] * 6 + ["reverse"] * 3


def test_old_results_and_damaged_tables_have_what_they_have(planted):
    planted["estimate"]["runs"]["misfit"] = [1.0]  # of another length
    assert rows_of(render_html(planted))[1][2] == "–"
    del planted["estimate"]["runs"]
    assert 'class="runs"' not in render_html(planted)


def test_the_delay_says_what_was_found_and_what_was_done(planted):
    planted["estimate"]["audit"] = {
        "lag_test": {"lag_ms": 0.98, "u_ms": 0.12, "probability": 0.997}
    }
    planted["estimate"] |= {"lag_s": 0.97e-3, "lag_sd_s": 0.125e-3}
    text = re.sub(r"<.*?>|\s+", " ", render_html(planted))

    assert (
        "Delay of the reading the readings show 0.98 ms (u 0.12 ms); weight of a delay 1.00"
        in (re.sub(r" +", " ", text))
    )
    assert "corrected: 0.97 ms (u 0.12 ms)" in text or "corrected: 0.97 ms (u 0.13 ms)" in text


def test_a_delay_of_which_nothing_is_known_is_not_called_corrected(planted):
    """Slow noise, or runs that lie apart: u above 1 ms, so no delay was taken out."""
    planted["estimate"]["audit"] = {
        "lag_test": {"lag_ms": -0.6, "u_ms": 1.3, "probability": 0.4, "fitted": False}
    }
    planted["estimate"] |= {"lag_s": 0.0, "lag_sd_s": None}
    text = re.sub(r" +", " ", re.sub(r"<.*?>|\s+", " ", render_html(planted)))

    assert "the readings show -0.6 ms (u 1.3 ms): too little is known of a delay, so none" in text
