"""What a separation did, as rows: every number has its unit and four digits."""

import json
import re

import pytest

import metrosep as ms
from metrosep.recipe.schema import Field
from metrosep.report.view import setting, settings, step_parameters, view

FIELDS = {
    "distance": Field("lengths"), "u_index": Field("angle"), "feed": Field("speed"),
    "span": Field("time"), "kmax": Field("integer"), "u_reading": Field("uncertainty"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("distance", [0.02], ("distance", "20 mm")),
        ("distance", [0.01, 0.0125], ("distance", "10 mm, 12.5 mm")),
        ("u_index_rad", 0.0008726646259971648, ("u index", "0.05 deg")),
        ("feed", 0.08, ("feed", "4800 mm/min")),
        ("span", 3600.0, ("span", "60 min")),
        ("kmax", 30, ("kmax", "30")),
        ("u_reading", 0.0, ("u reading", "0 nm")),
        ("travel_mm", 600.0000000001, ("travel", "600 mm")),
        ("motion_um", 7.401412e-05, ("motion", "74.01 pm")),
        ("wavelength_um", 123000.0, ("wavelength", "123 mm")),
        ("drift_nm_per_revolution", 0.95143, ("drift", "0.9514 nm per revolution")),
        ("feeds_mm_per_min", [4800.000000000001, 9600.0], ("feeds", "4800, 9600 mm/min")),
        ("angles_deg", [0.0, 51.42857142857143], ("angles", "0, 51.43 deg")),
        ("bandwidth_hz", 3.5555555, ("bandwidth", "3.556 Hz")),
        ("sd_nm", {"A": 21.0819, "B": None}, ("sd", "A 21.08 nm, B –")),
        ("windows_min", [[0.0, 60.0], [180.0, 240.0]], ("windows", "(0, 60 min), (180, 240 min)")),
        ("variance_nm2", 6964.467881, ("variance", "6964 nm²")),
        ("n_samples", 360, ("number of samples", "360")),
        ("p", 4.89369e-9, ("p", "4.894e−09")),
        ("suppressed", [], ("suppressed", "none")),
        ("closed", True, ("closed", "yes")),
        ("power_nm", None, ("power", "–")),
        ("lines", [{"amplitude_nm": 241.32, "n": 3}], ("lines", "amplitude 241.3 nm, number of")),
    ],
)
def test_a_setting_has_a_unit(key, value, words):
    found = setting(key, value, FIELDS)
    if key == "lines":
        assert found == ("lines", "amplitude 241.3 nm, n 3")
    else:
        assert found == words


def test_a_long_list_is_cut_and_counted():
    assert setting("gain_nm", [1.0] * 40, {})[1].endswith("1 nm, … (40 in all)")
    assert settings({"b": 1, "a_mm": 2.5}, {}) == [("a", "2.5 mm"), ("b", "1")]


def test_parameters_of_a_step_have_the_units_of_their_keys():
    given = {"distance": [0.02], "u_reading": 1e-9, "kmax": 30, "file": "a.csv", "lag_s": 0.0}
    assert step_parameters(given, FIELDS) == (
        "distance = 20 mm; file = a.csv; kmax = 30; lag = 0 s; u_reading = 1 nm"
    )
    assert step_parameters({}, FIELDS) == "–"


BARE_SI = re.compile(r"(?<![\w.])\d*\.?\d+e-\d+|\d\.\d{6,}")


@pytest.mark.parametrize(
    "name",
    ["spindle/recipe.toml", "three_point/recipe.toml", "positioning/recipe.toml",
     "multiprobe/recipe.toml", "drift/sequence.toml", "face_reversal/recipe.toml"],
)  # fmt: skip
def test_no_report_shows_bare_si(name, repository):
    result = ms.Recipe.load(repository / "examples" / name).run()
    shown = view(json.loads(json.dumps(result.document)))
    rows = [r for _, group in shown["settings"] for r in group]
    texts = [v for _, v in [*rows, *shown["summary"]]]
    texts += [s["parameters"] for s in shown["steps"]]
    for text in texts:
        assert not BARE_SI.search(text.replace("−", "-")), text


def test_spindle_shows_its_centre_in_nanometres(repository):
    result = ms.Recipe.load(repository / "examples" / "spindle" / "recipe.toml").run()
    rows = dict(view(result.document)["settings"][0][1])
    assert rows["centre cos"] == "1238 nm"
    assert rows["drift per revolution"].endswith(" pm")


def row(value, upper, u=None):
    entry = {"metric": "m", "name": "m", "value": value, "unit": "m", "u": u, "upper": upper}
    found = view({"characteristics": [entry]})["characteristics"][0]
    return found["value"], found["unit"], found["limits"]


def test_a_row_has_the_unit_of_its_value():
    assert row(1.37e-7, 5e-6, u=3.1e-8) == ("137", "nm", "≤ 5000")
    assert row(2e-9, 1e-3) == ("2.000", "nm", "≤ 1e+06")  # a far limit hides no value
    assert row(0.0, 1e-6) == ("0.000", "µm", "≤ 1")


def test_notes_have_a_true_micro_sign_and_names_no_underscores():
    document = {
        "messages": ["noise of 1.4 um and 3 urad"],
        "characteristics": [{"metric": "noise_floor", "name": "noise_floor", "value": 1e-9}],
    }
    shown = view(document)
    assert shown["c"]["warnings"] == ["Noise of 1.4 µm and 3 µrad."]
    assert shown["characteristics"][0]["name"] == "noise floor"


def test_null_space_is_told_once_and_says_degree():
    part = {"kind": "polynomial", "indices": [0, 1], "reason": "alignment"}
    separation = {"op": "two_point", "what": "w", "null_space": [
        {"part": "artefact", **part}, {"part": "straightness", **part},
        {"part": "pitch", **part, "indices": [0]},
    ]}  # fmt: skip
    rows = dict(view({"separation": separation})["summary"])
    assert rows["Not seen, artefact, straightness"] == "polynomials of degree 0, 1: alignment"
    assert rows["Not seen, pitch"] == "polynomial of degree 0: alignment"
