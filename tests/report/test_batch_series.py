"""A batch as a series: planted drift and pair are named, in the order of the parts."""

import json
import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.report.index import (
    batch_series,
    batch_table,
    render_index,
    series_of,
    series_section,
)

EXACT = 1e-15
"""Values are passed on as they are."""


def index_of(columns, names=None):
    n = len(next(iter(columns.values())))
    names = names or [f"part{i}.x3p" for i in range(n)]
    rows = [
        {
            "unit": name,
            "key": name,
            "groups": {},
            "status": "measured",
            "verdict": None,
            "reason": None,
            "link": f"{name}/aa/result.json",
            "characteristics": [
                {"metric": k, "name": k, "value": v[i], "unit": "m"} for k, v in columns.items()
            ],
            "hash": "ab",
        }
        for i, name in enumerate(names)
    ]
    return {"schema": "metrosep.index/1", "rows": rows, "title": "lot", "groups": [], "trend": []}


def noise(n, seed):
    return (3e-9 * np.random.default_rng(seed).standard_normal(n)).tolist()


def test_planted_drift_is_named_with_its_sign():
    n = 30
    wear = [-1e-9 * i + e for i, e in enumerate(noise(n, 1))]
    section = series_section(index_of({"Z8": wear, "Z9": noise(n, 2)}))
    assert section is not None
    assert len(section["drifts"]) == 1
    slope = np.polyfit(np.arange(n), wear, 1)[0]
    assert section["drifts"][0].startswith(f"Z8: −{-29e9 * slope:.3g} ± ")
    # u of a slope by the book; t(0.977249868; 28) = 2.0933 of printed tables
    rest = np.asarray(wear) - np.polyval(np.polyfit(np.arange(n), wear, 1), np.arange(n))
    u = 29e9 * np.sqrt((rest @ rest) / (n - 2) / (n * (n**2 - 1) / 12))
    assert section["drifts"][0].endswith(f" ± {2.0933 * u:.2g} nm (k = 2.09)")
    page = render_index(index_of({"Z8": wear, "Z9": noise(n, 2)}))
    assert "Drift and correlation" in page
    assert page == render_index(index_of({"Z8": wear, "Z9": noise(n, 2)}))


def test_a_drift_over_few_parts_has_the_k_of_its_degrees_of_freedom():
    wear = [-10e-9 * i + e for i, e in enumerate(noise(8, 1))]
    section = series_section(index_of({"Z8": [*wear[:4], None, *wear[4:]]}))
    assert section is not None
    assert section["drifts"][0].endswith(
        "nm (k = 2.52)"
    )  # t(0.977249868; 6): eight parts, not nine


def test_parts_stand_in_the_order_of_their_numbers():
    # sorted as texts, part10 would come before part9
    n = 14
    values = [1e-9 * i for i in range(n)]
    names = [f"part{i}.x3p" for i in range(n)]
    order = np.random.default_rng(3).permutation(n)
    index = index_of({"Sq": [values[i] for i in order]}, [names[i] for i in order])
    table, _, parts = batch_table(index)
    assert parts == names
    assert np.abs(np.array(table["Sq"]) - values).max() <= EXACT


def test_missing_values_stay_missing():
    values = noise(12, 4)
    values[5] = None
    table, _, _ = batch_table(index_of({"Sq": values}))
    assert math.isnan(table["Sq"][5])


def test_wavelengths_come_from_the_results(tmp_path):
    n = 12
    index = index_of({"pv": noise(n, 5)})
    for i, row in enumerate(index["rows"]):
        file = tmp_path / row["link"]
        file.parent.mkdir(parents=True)
        spectrum = {
            "wavelength_mm": [35.15, 17.575],
            "amplitude_nm": [100.0 + 2.0 * i, 4.0],
            "selected": [True, False],
        }
        file.write_text(json.dumps({"estimate": {"spectrum": spectrum}}))
    found = batch_series(index, tmp_path)
    assert found is not None
    term = next(t for t in found.terms if t.name == "wavelength 35.15 mm")
    assert abs(term.drift - 22e-9) <= 1e-15
    assert [t.name for t in found.drifting] == ["wavelength 35.15 mm"]
    assert "wavelength 17.57 mm" not in {t.name for t in found.terms}


def test_damaged_results_and_links_that_lead_out_are_left_alone(tmp_path):
    index = index_of({"pv": noise(8, 6)})
    index["rows"][0]["link"] = "../../result.json"
    file = tmp_path / index["rows"][1]["link"]
    file.parent.mkdir(parents=True)
    file.write_text('{"estimate": 3}')
    assert batch_series(index, tmp_path) is not None


@pytest.mark.parametrize("n", [1, 4])
def test_few_parts_have_no_section(n):
    assert series_section(index_of({"Sq": noise(n, 7)})) is None


def test_equal_values_have_no_section():
    assert series_section(index_of({"Sq": [1e-9] * 9})) is None


def test_what_is_no_index_is_refused():
    with pytest.raises(DataError, match=r"index\.json"):
        batch_table({"schema": "metrosep.result/1"})


def piston_and_waviness(n=30):
    """Rounding of zero that rises, roughness under two names, and a pair that moves together."""
    common = np.array(noise(n, 5))
    sq = 2e-8 + np.array(noise(n, 6)) / 10
    return {
        "Sq": sq.tolist(),
        "residual.rms": (sq * (1 + 1e-15)).tolist(),
        "piston": [1e-24 * (i + math.sin(7.0 * i)) for i in range(n)],
        "Z8": common.tolist(),
        "Z9": (common + 0.4 * np.array(noise(n, 7))).tolist(),
    }


def test_rounding_of_zero_is_no_finding():
    section = series_section(index_of(piston_and_waviness()))
    page = render_index(index_of(piston_and_waviness()))

    assert section["drifts"] == []
    assert "4 terms" in section["caption"]
    assert "piston" not in " ".join(section["pairs"])
    assert "piston over the batch" not in page  # no chart with control limits
    assert "to within rounding, so without a chart: piston." in page
    series = {s.metric: s for s in series_of(index_of(piston_and_waviness()))}
    assert series["piston"].control is None
    assert series["Sq"].control is not None


def test_a_limit_tells_what_is_small_too():
    # nothing but the piston, judged against a limit of 12 nm: Cpk would be 1e15
    index = index_of({"piston": piston_and_waviness()["piston"]})
    for row in index["rows"]:
        row["characteristics"][0] |= {"upper": 12e-9, "lower": -12e-9}

    assert series_section(index) is None
    series = series_of(index)[0]
    assert (series.control, series.capability) == (None, None)


def test_identities_are_one_sentence_and_the_pair_is_listed():
    section = series_section(index_of(piston_and_waviness()))

    assert section["same"] == "Sq, residual.rms"
    assert len(section["pairs"]) == 1
    assert section["pairs"][0].startswith("Z8 and Z9: +0.")
    page = render_index(index_of(piston_and_waviness()))
    assert "These say the same (correlation 0.9999 and more): Sq, residual.rms." in page
