"""Measurements whose numbers agree and whose maps, limits or definitions do not."""

import copy
import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError
from metrosep.report.compare import compare_documents

NM = 1e-9
FOUR_DIGITS = 5e-4
"""Relative: a result holds maps to four digits."""

RECIPE = """metrosep = 1
[input]
[[step]]
op = "form"
form = "{form}"
[[step]]
op = "parameters"
names = ["{p}q", "{p}z"]
"""


def measured(folder, obj, name):
    ms.write(obj, folder / f"{name}.h5")
    is_map = isinstance(obj, ms.Surface)
    text = RECIPE.format(form="plane", p="S" if is_map else "P")
    return json.loads(ms.Recipe.parse(text).run([folder / f"{name}.h5"]).to_json())


def pair(folder, kind, n=48):
    rng = np.random.default_rng(8)
    if kind == "map":
        z = 10 * NM * rng.standard_normal((n, n + 3))
        z -= z.mean()
        objs = [ms.Surface(s * z, 1e-6, 2e-6) for s in (1, -1)]
    else:
        x = np.arange(n) * 1e-6
        z = 10 * NM * rng.standard_normal(n)
        objs = [ms.Profile(x, s * z) for s in (1, -1)]
    return z, [measured(folder, o, f"{kind}{i}") for i, o in enumerate(objs)]


@pytest.mark.parametrize(
    ("kind", "n"), [("map", 48), ("map", 300), ("profile", 60), ("profile", 9000)]
)
def test_a_turned_sign_is_seen_where_all_parameters_agree(tmp_path, kind, n):
    z, (a, b) = pair(tmp_path, kind, n)

    found = compare_documents(a, b, tolerances={"*": "1 nm"})

    assert all(r.equal for r in found.rows if r.metric[1:] in ("q", "z"))
    charts = [r for r in found.rows if r.metric.startswith("chart.")]
    assert charts
    assert not found.equal
    largest = max(r.difference for r in charts if r.difference is not None)
    if n < 100:
        assert abs(largest - 2 * np.abs(z).max()) <= 0.5 * np.abs(z).max()
    assert largest > 10 * NM
    assert compare_documents(a, copy.deepcopy(a)).equal


def test_one_changed_pixel_is_found_to_its_height(tmp_path):
    _, (a, _) = pair(tmp_path, "map")
    b = copy.deepcopy(a)
    k = next(i for i, c in enumerate(b["separation"]["charts"]) if c["kind"] == "maps")
    (name,) = b["separation"]["charts"][k]["parts"]
    b["separation"]["charts"][k]["parts"][name][3][5] += 7 * NM

    rows = {r.metric: r for r in compare_documents(a, b).rows}

    assert abs(rows["chart.1"].difference - 7 * NM) <= FOUR_DIGITS * 7 * NM
    assert not rows["chart.1"].equal
    assert compare_documents(a, b, tolerances={"chart.1": "8 nm"}).equal
    b["separation"]["charts"][k]["parts"][name][3][5] = None
    assert "one side only" in compare_documents(a, b, tolerances={"*": "1 m"}).rows[
        -1
    ].message or any("one side only" in r.message for r in compare_documents(a, b).rows)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(dx_m=3e-6), "positions differ"),
        (lambda c: c.update(unit="rad"), "units differ"),
        (lambda c: c.update(title="another"), "only in"),
        (lambda c: c.update(parts={}), "only in A"),
    ],
)
def test_maps_that_cannot_be_subtracted_differ(tmp_path, change, message):
    _, (a, _) = pair(tmp_path, "map")
    b = copy.deepcopy(a)
    change(next(c for c in b["separation"]["charts"] if c["kind"] == "maps"))

    found = compare_documents(a, b)

    assert not found.equal
    assert any(message in r.message for r in found.rows)


def test_a_damaged_map_is_refused(tmp_path):
    _, (a, _) = pair(tmp_path, "map")
    b = copy.deepcopy(a)
    chart = next(c for c in b["separation"]["charts"] if c["kind"] == "maps")
    chart["parts"] = {"": [["a"]]}
    with pytest.raises(DataError):
        compare_documents(a, b)


def entry(**more):
    checked = {"lower": None, "upper": 100 * NM, "U": 5 * NM, "guard_factor": 1.0}
    return {
        "schema": "metrosep.result/1",
        "verdict": "accept",
        "characteristics": [
            {"metric": "Sa", "name": "Sa", "unit": "m", "value": 50 * NM, "u": None}
            | {"definition": "mean", "verdict": "accept"}
            | checked
            | more
        ],
    }


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"upper": 120 * NM}, "upper limit 100 nm became 120 nm"),
        ({"lower": 0.0}, "lower limit none became 0"),
        ({"guard_factor": 0.0}, "guard factor 1.0 became 0.0"),
        ({"definition": "another"}, "the definition was 'mean' and is 'another'"),
    ],
)
def test_a_check_that_asks_another_thing_is_a_difference(more, message):
    found = compare_documents(entry(), entry(**more), tolerances={"*": "1 mm"})
    assert not found.equal
    assert message in found.rows[0].message


def test_the_spelling_of_a_limit_is_none():
    assert compare_documents(entry(upper=0.1 * 1e-6), entry(upper=100 * 1e-9)).equal


def test_a_changed_u_is_told_and_counts_beyond_the_tolerance():
    one, two = entry(U=4 * NM), entry(U=6 * NM)
    (row,) = compare_documents(one, two).rows
    assert (row.equal, row.message) == (False, "U 4 nm became 6 nm")
    assert not compare_documents(one, two, tolerances={"Sa": "1 nm"}).equal
    within = compare_documents(one, two, tolerances={"Sa": "3 nm"})
    assert within.equal
    assert any(line.startswith("U of Sa") for line in within.other)
