"""The order of the parts: a drift that only time shows, with names that hide it."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest

from metrosep.batch import run_batch
from metrosep.core.errors import DataError, RecipeError
from metrosep.recipe import Recipe
from metrosep.recipe.parts import parts_in_order
from metrosep.report.index import batch_table, render_index, series_of, series_section

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

N = 16
STEP = 0.2e-9  # m of Sa from part to part; it rises
FIRST = 5e-9  # m
READING = 0.05e-9  # m: digits of the text of an SDF
NOT_MADE = b"010119700000"
"""CreateDate of a file that metrosep wrote."""
ORDER = [int(i) for i in np.random.default_rng(7).permutation(N)]
"""Number in the name of the part that was made as the k-th."""


def clock(k: int) -> str:
    """Day, month, year, hour, minute: sorted as text, it would be another order."""
    return f"{28 - k:02d}{1 + k:02d}2025{8:02d}{k:02d}" if k < 12 else f"{k:02d}0120260{k - 11}00"


def fill(folder, parts, *, dated=True, stamp=""):
    """Parts whose Sa rises in the order of making; their names are shuffled."""
    for k, number in enumerate(ORDER):
        file = parts(folder / f"P_{number:02d}{stamp.format(k=k)}.sdf", FIRST + k * STEP)
        if dated:
            content = file.read_bytes()
            assert NOT_MADE in content
            file.write_bytes(content.replace(NOT_MADE, clock(k).encode(), 1))
    return folder


def index_of(recipe_text, folder, out, batch=""):
    text = recipe_text + f"[batch]\nindex = ['html']\n{batch}"
    return run_batch(Recipe.parse(text), folder, out=out, scheduler="serial")


def rises(values) -> bool:
    """Whether the values are those of the parts as they were made."""
    made = FIRST + STEP * np.arange(N)
    return len(values) == N and bool(np.abs(np.array(values) - made).max() <= READING)


def sa(document):
    (series,) = [s for s in series_of(document) if s.metric == "Sa"]
    return [v * series.factor for v in series.ordered]


def test_a_drift_that_only_time_shows(recipe_text, tmp_path, parts):
    folder = fill(tmp_path / "in", parts)
    by_name = index_of(recipe_text, folder, tmp_path / "qa").document
    section = series_section(by_name)
    assert not any(d.startswith("Sa") for d in section["drifts"])
    assert not rises(sa(by_name))
    assert "in the order of their names, not of time" in section["caption"]

    report = index_of(recipe_text, folder, tmp_path / "qa", 'order = "time"\n')
    assert report.counts["skipped"] == N
    document = report.document
    assert document["order"] == "time"
    assert rises(sa(document))
    assert rises(batch_table(document)[0]["Sa"])
    section = series_section(document)
    (drift,) = [d for d in section["drifts"] if d.startswith("Sa: ")]
    assert drift.startswith("Sa: +3 ")
    assert "in the order of measuring" in section["caption"]
    page = (tmp_path / "qa/index.html").read_text()
    assert "in the order of measuring" in page
    assert "in the order of their names" not in page


def test_control_limits_follow_the_order(recipe_text, tmp_path, parts):
    """Ranges of neighbours in time are one step; of shuffled ones they are many."""
    folder = fill(tmp_path / "in", parts)
    document = index_of(recipe_text, folder, tmp_path / "qa", 'order = "time"\n').document
    (series,) = [s for s in series_of(document) if s.metric == "Sa"]
    assert abs(series.control.mean_range * series.factor - STEP) <= READING
    (shuffled,) = [s for s in series_of({**document, "order": "name"}) if s.metric == "Sa"]
    assert shuffled.control.mean_range > 3 * series.control.mean_range
    assert series.values == shuffled.values  # of the rows, as the table prints them


def test_a_group_orders_by_its_numbers(recipe_text, tmp_path, parts):
    folder = fill(tmp_path / "in", parts, dated=False, stamp="_run{k}")
    batch = "pattern = 'P_(?P<serial>\\d+)_run(?P<run>\\d+)\\.sdf'\norder = 'run'\n"
    document = index_of(recipe_text, folder, tmp_path / "qa", batch).document
    assert rises(sa(document))  # as text, run10 would stand before run2
    assert "in the order of run" in (tmp_path / "qa/index.html").read_text()


def test_the_time_of_change_counts_only_where_it_is_asked_for(recipe_text, tmp_path, parts):
    folder = fill(tmp_path / "in", parts, dated=False)
    for k, number in enumerate(ORDER):
        os.utime(folder / f"P_{number:02d}.sdf", ns=(0, (1_700_000_000 + 60 * k) * 10**9))
    report = index_of(recipe_text, folder, tmp_path / "qa", 'order = "time"\n')
    assert sa(report.document) == []
    (told,) = [m for m in report.messages if 'order = "time"' in m]
    assert "all parts state no date of measuring" in told
    assert "file_time" in told
    page = render_index(report.document)
    assert "state no date of measuring" in page
    assert series_section(report.document) is None

    report = index_of(recipe_text, folder, tmp_path / "qa", 'order = "file_time"\n')
    assert rises(sa(report.document))
    assert "in the order in which their files were last changed" in render_index(report.document)
    row = next(r for r in report.document["rows"] if r["unit"] == f"P_{ORDER[0]:02d}.sdf")
    assert row["file_time"] == "2023-11-14T22:13:20+00:00"


def test_without_that_wish_no_clock_is_in_the_index(recipe_text, tmp_path, parts):
    folder = fill(tmp_path / "in", parts)
    document = index_of(recipe_text, folder, tmp_path / "qa", 'order = "time"\n').document
    assert not any("file_time" in r for r in document["rows"])


def test_some_parts_without_a_date_are_left_out_and_told(recipe_text, tmp_path, parts):
    folder = fill(tmp_path / "in", parts)
    parts(folder / "P_98.sdf", 6e-9)
    (folder / "P_99.sdf").write_text("junk")
    report = index_of(recipe_text, folder, tmp_path / "qa", 'order = "time"\n')
    assert rises(sa(report.document))
    (told,) = [m for m in report.messages if 'order = "time"' in m]
    assert "1 of 17 parts state no date" in told  # the failed one has no value to place


def test_results_say_when_they_were_measured(recipe_text, tmp_path, parts):
    folder = fill(tmp_path / "in", parts)
    report = index_of(recipe_text, folder, tmp_path / "qa")
    row = next(r for r in report.rows if r["unit"] == f"P_{ORDER[2]:02d}.sdf")
    document = json.loads((tmp_path / "qa" / row["link"]).read_text())
    assert document["inputs"][0]["measured_at"] == "2025-03-26T08:02:00"
    assert row["measured_at"] == "2025-03-26T08:02:00"


def test_offsets_count_and_a_mixture_is_told():
    def row(name, when):
        return {"unit": name, "characteristics": [{"metric": "Sq"}], "measured_at": when}

    rows = [
        row("a", "2026-01-03T12:00:00+00:00"),
        row("b", "2026-01-03T12:30:00+01:00"),
        row("c", "2026-01-03T11:45:00"),
    ]
    assert parts_in_order({"order": "time", "rows": rows}) == [1, 2, 0]
    from metrosep.recipe.parts import order_notes

    (note,) = order_notes({"order": "time", "rows": rows})
    assert "offset" in note
    assert order_notes({"order": "time", "rows": rows[:2]}) == []


@pytest.mark.parametrize(
    ("batch", "message"),
    [
        ('order = "tim"', r'order = "tim" is not one of name, time, file_time; .*"time"\?'),
        ("pattern = '(?P<run>.*)'\norder = 'rum'", r'name, time, file_time, run .*"run"\?'),
        ("pattern = '(?P<time>.*)'\norder = 'time'", "give the group another name"),
    ],
)
def test_orders_that_are_none_are_refused_with_their_line(recipe_text, batch, message):
    text = f"{recipe_text}[batch]\n{batch}\n"
    line = next(i for i, n in enumerate(text.splitlines(), 1) if n.startswith("order"))
    with pytest.raises(RecipeError, match=rf":{line}: .*{message}"):
        Recipe.parse(text)


def test_names_without_leading_zeros_stand_by_their_numbers_everywhere():
    rows = [
        {"unit": f"p{i}", "status": "measured", "characteristics": [
            {"metric": "Sq", "name": "Sq", "unit": "m", "value": 1e-9 * i}]}
        for i in (1, 10, 11, 12, 2, 3, 4, 5, 6, 7, 8, 9)
    ]  # fmt: skip
    document = {"schema": "metrosep.index/1", "rows": rows}
    (series,) = series_of(document)
    in_order = [round(v * series.factor * 1e9) for v in series.ordered]
    assert in_order == list(range(1, 13))
    assert [round(v * 1e9) for v in batch_table(document)[0]["Sq"]] == in_order


def test_a_damaged_order_is_refused():
    with pytest.raises(DataError, match="order of the parts in this index is damaged"):
        parts_in_order({"order": "$x$ <b>", "rows": []})


def test_the_default_is_the_name():
    recipe = Recipe.parse("metrosep = 1\n[input]\n[[step]]\nop = 'form'\nform = 'plane'\n")
    assert recipe.batch_options["order"] == "name"
