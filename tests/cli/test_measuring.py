"""Commands that measure: what they print, their JSON, their exit codes."""

import json

import numpy as np
import pytest

import metrosep as ms

NM = 1e-9
EXACT = 1e-9
"""Relative: JSON keeps all digits, x3p and h5 as well."""


@pytest.fixture
def waves(tmp_path):
    """Sine grid of the acceptance table on a tilted plane: Sq 49.9994 nm after the plane."""
    i = np.arange(500)
    wave = 50 * NM * np.cos(2 * np.pi * i / 100)
    X, Y = np.meshgrid(i * 1e-6, i * 1e-6)
    z = wave[None, :] + wave[:, None] + 2e-4 * X + 1e-4 * Y + 3e-6
    path = tmp_path / "waves.h5"
    ms.write(ms.Surface(z, 1e-6, 1e-6), path)
    return path


@pytest.fixture
def sine(tmp_path):
    """Profile: amplitude 50 nm, wavelength 100 um, over 4 mm."""
    x = np.arange(4000) * 1e-6
    path = tmp_path / "sine.h5"
    ms.write(ms.Profile(x, 50 * NM * np.cos(2 * np.pi * x / 100e-6)), path)
    return path


def test_a_map_is_levelled_and_measured(metrosep, waves):
    code, out, err = metrosep(
        "measure", waves, "--form", "plane", "--params", "Sq,PV,FLTt", "--json"
    )

    found = json.loads(out)
    assert code == 0
    np.testing.assert_allclose(found["sq_nm"], 49.9994, rtol=1e-5, atol=0)
    np.testing.assert_allclose(
        found["parameters"]["Sq"]["value"] / NM, found["sq_nm"], rtol=EXACT, atol=0
    )
    assert set(found["parameters"]) == {"Sq", "PV", "FLTt"}
    assert "fit plane" in found["evaluations"][0]["chain"]
    assert err == ""


def test_the_text_says_what_was_done(metrosep, waves):
    code, out, _ = metrosep(
        "measure", waves, "--form", "plane", "--lambda-s", "10 um", "--params", "Sa"
    )

    assert code == 0
    assert "ISO 25178-2" in out
    assert "plane fitted to 250000 points" in out
    assert "gaussian" in out
    assert "250000 of 250000 valid" in out


def test_a_profile_in_either_edition(metrosep, sine):
    _, new, _ = metrosep("measure", sine, "--kind", "R", "--json")
    _, old, _ = metrosep(
        "measure", sine, "--kind", "R", "--edition", "ISO 4287:1997", "--sections", 4, "--json"
    )

    new, old = json.loads(new), json.loads(old)
    np.testing.assert_allclose(new["ra_nm"], 31.8205160, rtol=1e-7, atol=0)
    np.testing.assert_allclose(old["rsm_um"], 100.0, rtol=1e-6, atol=0)
    assert new["evaluations"][0]["edition"] == "ISO 21920-2:2021"
    assert old["evaluations"][0]["settings"]["sections"] == 4


def test_filter_makes_the_profile_rough(metrosep, sine):
    code, out, _ = metrosep(
        "measure", sine, "--lambda-c", "0.8 mm", "--params", "Rq,RSm", "--json"
    )

    assert code == 0
    assert json.loads(out)["rq_nm"] > 35.0


def test_a_share_is_a_limit_in_percent(metrosep, tmp_path):
    x = np.arange(60) * 1e-6
    path = tmp_path / "ramp.h5"
    ms.write(ms.Surface(np.tile(0.2 * x, (60, 1)), 1e-6, 1e-6), path)
    sdr = np.sqrt(1.0 + 0.2**2) - 1.0  # 1.98 %

    for limit, code in (("1.9 %", 1), ("2.1 %", 0)):
        given = ("--params", "Sdr", "--upper", f"Sdr={limit}", "--U", "Sdr=0", "--json")
        found, out, _ = metrosep("measure", path, "--form", "none", *given)
        table = json.loads(out)["parameters"]["Sdr"]
        assert found == code
        np.testing.assert_allclose(table["value"], sdr, rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("limit", "U", "code"), [("60 nm", "2 nm", 0), ("40 nm", "2 nm", 1), ("51 nm", "2 nm", 3)]
)
def test_exit_code_is_the_verdict(metrosep, waves, limit, U, code):
    found, out, _ = metrosep(
        "measure",
        waves,
        "--form",
        "plane",
        "--params",
        "Sq",
        "--upper",
        f"Sq={limit}",
        "--U",
        f"Sq={U}",
    )

    assert found == code
    assert {0: "ACCEPT", 1: "REJECT", 3: "INCONCLUSIVE"}[code] in out


@pytest.mark.parametrize(
    ("options", "code", "match"),
    [
        (("--params", "Sdr", "--upper", "Sdr=1 nm"), 2, "is a length, but Sdr is a pure number"),
        (("--params", "Sq", "--upper", "Sa=5 nm"), 2, "Sa has a limit but is not among --params"),
        (("--upper", "Smr(5 nm)=30 %"), 2, '"all" has no parameters with arguments and no deviat'),
        (("--upper", "FLTt=1 um"), 2, "no deviations of form: name it"),
        (("--upper", "Saq=1 um"), 2, 'not among --params; did you mean "Sq"?'),
        (("--params", "Smr(0,5 um)"), 2, "decimal comma; write Smr(0.5 um), or Smr(0 %, 5 um)"),
        (("--params", "Sq", "--upper", "Smr(0.3 um=5 nm"), 2, "Smr(0.3 um has a limit but is not"),
        (("--params", "Sq", "--upper", "S[a=5 nm"), 2, "S[a has a limit but is not among"),
        (("--params", "Sq", "--upper", r"S\1q=5 nm"), 2, r"S\1q has a limit but is not among"),
        (
            ("--params", "Smr(5 nm)", "--upper", "Smr(5 nm)=30 nm"),
            2,
            "such as --upper 'Smr(5 nm)=0.5'",
        ),
        (("--params", "Sq", "--upper", "Sq=5", "--U", "Sq=1 nm"), 2, "unit"),
        (("--params", "Sq", "--upper", "Sq"), 2, "NAME=VALUE"),
        (("--params", "Ra"), 2, "a map has no parameter 'Ra'"),
        (("--form", "cone"), 2, "there is no form 'cone'"),
        (("--lambda-c", "0.5 um"), 2, "um"),
        (("--lambda-c", "80"), 2, "unit"),
        (
            ("--edition", "ISO 4287:1997", "--kind", "R", "--params", "Sq"),
            2,
            "belongs to profiles",
        ),
        (
            ("--edition", "ISO 25178-2:2012", "--params", "Svd"),
            2,
            "not offered as an areal parameter of ISO 25178-2:2012",
        ),
        (("--params", "Sq", "--end", "cut"), 2, "--lambda-s"),
        (("--lambda-s", "80 um", "--lambda-c", "20 um"), 2, "must be shorter"),
        (("--params", "Sq", "--U", "Sa=1 nm"), 2, "no limit"),
        (("--params", "Sq", "--upper", "Sq=1 nm", "--upper", "Sq=2 nm"), 2, "twice"),
        (("--params", "Sq", "--limit", "Sq=1 nm"), 2, "Did you mean --upper or --lower?"),
        (("--params", "Sq", "--max", "Sq=1 nm"), 2, "Did you mean --upper?"),
        (("--form", "sphere: 50 mm"), 2, "name the value, such as R=50 mm"),
        (("--params", "PVr", "--upper", "PVr=1 um", "--U", "PVr=1 nm"), 2, "not a disc"),
    ],
)
def test_wrong_words_are_one_sentence(metrosep, waves, options, code, match):
    found, _, err = metrosep("measure", waves, *options)

    assert found == code
    assert match in err
    assert err.count("error:") == (1 if code else 0)


@pytest.mark.parametrize(
    ("symbol", "limit", "example"),
    [
        ("Sq", "5 nm", '--U "Sq=10 nm"'),
        ("Sdr", "1 %", '--U "Sdr=0.001", or --U "Sdr=0" for simple'),
    ],
)
def test_a_limit_without_u_is_inconclusive_and_says_what_to_write(
    metrosep, waves, symbol, limit, example
):
    code, out, _ = metrosep("measure", waves, "--params", symbol, "--upper", f"{symbol}={limit}")

    assert code == 3
    assert f"the uncertainty of {symbol} is not known; state it: {example}" in out


def test_names_with_arguments_have_limits_like_any_other(metrosep, sine):
    """A cosine of 50 nm lies above +25 nm on a third of its length, above 0 on a half."""
    words = ("--params", "Pmr(25 nm),Pdc(20 %, 80 %),Pmr(0 nm)", "--upper", "Pmr(0.025um)=35 %")
    code, out, _ = metrosep("measure", sine, *words, "--U", "Pmr(0.025um)=1 %")

    assert code == 0
    assert "Pmr(25 nm)" in out
    assert "Pdc(20 %, 80 %)" in out
    assert "ACCEPT" in out


def test_a_rule_counts_sections_or_files(metrosep, sine):
    limits = ("--upper", "Pq=1 um", "--U", "Pq=1 nm")
    code, out, _ = metrosep(
        "measure", sine, sine, sine, "--params", "Pq", *limits, "--rule", "max"
    )
    assert code == 0
    assert "maximum rule: 0 of 3 values outside" in out

    code, out, _ = metrosep("measure", sine, "--params", "Pq", *limits, "--rule", "16%")
    assert "0 of 1 values outside" in out  # a P profile is one section

    code, _, err = metrosep("measure", sine, "--params", "Pq", "--rule", "max")
    assert code == 2
    assert "--upper" in err


def test_filters_of_a_profile_are_in_order_or_refused(metrosep, sine):
    code, _, err = metrosep("measure", sine, "--lambda-s", "0.8 mm", "--lambda-c", "0.08 mm")

    assert code == 2
    assert "must be shorter" in err


def test_sections_are_cut_offs_long(metrosep, sine):
    _, out, _ = metrosep("measure", sine, "--lambda-c", "0.4 mm", "--params", "Rz", "--json")
    _, five, _ = metrosep(
        "measure", sine, "--lambda-c", "0.4 mm", "--params", "Rz", "--sections", 5, "--json"
    )

    assert json.loads(out)["evaluations"][0]["settings"]["sections"] == 10
    assert json.loads(five)["evaluations"][0]["n_total"] == 2000


def test_reject_counts_more_than_inconclusive(metrosep, sine, tmp_path):
    x = np.arange(4000) * 1e-6
    larger = tmp_path / "larger.h5"
    ms.write(ms.Profile(x, 80 * NM * np.cos(2 * np.pi * x / 100e-6)), larger)
    limits = ("--kind", "R", "--params", "Ra", "--upper", "Ra=32 nm", "--U", "Ra=1 nm")

    assert metrosep("measure", sine, *limits)[0] == 3
    assert metrosep("measure", larger, sine, *limits)[0] == 1
    assert metrosep("measure", sine, larger, *limits)[0] == 1


def test_pv_nm_is_peak_to_valley_in_every_command(metrosep, sine):
    _, told, _ = metrosep("info", sine, "--json")
    _, out, _ = metrosep("measure", sine, "--kind", "P", "--json")

    found = json.loads(out)
    assert "pv_nm" not in found
    np.testing.assert_allclose(found["pt_nm"], json.loads(told)["pv_nm"], rtol=1e-9, atol=0)
    np.testing.assert_allclose(found["p_v_nm"], 50.0, rtol=1e-9, atol=0)


def test_a_limit_may_use_the_spelling_of_the_other_edition(metrosep, sine):
    code, out, _ = metrosep(
        "measure", sine, "--kind", "R", "--params", "RSm", "--upper", "RSm=1 mm", "--U", "RSm=1 um"
    )

    assert code == 0
    assert "ACCEPT" in out


def test_ratios_by_their_old_names(metrosep, sine):
    old = ("--edition", "ISO 4287:1997", "--kind", "R", "--params", "Mr1,A2", "--json")

    code, out, _ = metrosep("measure", sine, *old)

    assert code == 0
    assert set(json.loads(out)["parameters"]) == {"Mr1", "A2"}


def test_kind_and_symbol_must_agree(metrosep, sine):
    assert metrosep("measure", sine, "--kind", "R", "--params", "Pa")[0] == 2


def test_a_bad_file_among_good_ones_is_named_and_the_rest_goes_on(metrosep, waves, tmp_path):
    bad = tmp_path / "bad.h5"
    bad.write_bytes(b"nothing")

    code, out, err = metrosep("measure", bad, waves, "--params", "Sq", "--json")

    assert code == 4
    first, second = json.loads(out)["files"]
    assert first["file"] == "bad.h5"
    assert "error" in first
    assert "sq_nm" in second
    assert "bad.h5" in err


def test_roughness_of_an_instrument_is_not_filtered_again(metrosep, corpus):
    path = corpus / "st" / "mitutoyo_2_mock.xlsx"

    code, out, _ = metrosep(
        "measure",
        path,
        "--edition",
        "ISO 4287:1997",
        "--sections",
        4,
        "--params",
        "Ra,Rz",
        "--json",
    )
    again, _, err = metrosep("measure", path, "--lambda-c", "0.8 mm")

    assert code == 0
    np.testing.assert_allclose(json.loads(out)["ra_nm"], 3308, rtol=0, atol=0.5)
    np.testing.assert_allclose(json.loads(out)["rz_nm"], 18485, rtol=0, atol=0.6)
    assert again == 2
    assert "filtering again" in err


def test_a_form_with_its_parameters_and_what_is_left(metrosep, tmp_path):
    x = np.linspace(-5e-3, 5e-3, 101)
    X, Y = np.meshgrid(x, x)
    part, left = tmp_path / "lens.h5", tmp_path / "left.h5"
    ms.write(
        ms.Surface(ms.forms.Conic(R=50e-3, k=-1.2)(X, Y) + 1e-6, x[1] - x[0], x[1] - x[0]), part
    )

    code, out, err = metrosep("form", part, "--form", "conic", "--residual", left, "--json")

    found = json.loads(out)
    assert code == 0
    np.testing.assert_allclose(found["parameters"]["R"]["value"], 50e-3, rtol=1e-8, atol=0)
    np.testing.assert_allclose(found["parameters"]["k"]["value"], -1.2, rtol=1e-8, atol=0)
    assert found["rms_nm"] < 1e-6
    assert "left.h5" in err
    assert ms.read(left).peak_to_valley() < 1e-14


def test_form_holds_what_is_fixed(metrosep, sine):
    code, out, _ = metrosep(
        "form", sine, "--form", "sphere", "--fix", "R=1 m", "--free", "piston", "--json"
    )

    found = json.loads(out)["parameters"]
    assert code == 0
    assert found["R"] == {"value": 1.0, "unit": "m", "u": None, "free": False}
    assert set(found) == {"piston", "R"}


def test_centre_of_the_form(metrosep, tmp_path):
    x = np.linspace(0, 10e-3, 201)
    path = tmp_path / "arc.h5"
    ms.write(ms.Profile(x, ms.forms.Sphere(R=-30e-3)(x - 4e-3)), path)

    code, out, _ = metrosep(
        "form", path, "--form", "sphere", "--free", "piston", "--centre", "4 mm", "--json"
    )

    assert code == 0
    np.testing.assert_allclose(
        json.loads(out)["parameters"]["R"]["value"], -30e-3, rtol=1e-9, atol=0
    )


@pytest.mark.parametrize(("line", "tilt"), [("row", "tilt_x"), ("column", "tilt_y")])
def test_a_map_of_one_row_or_column_is_fitted_as_the_profile_that_it_is(
    metrosep, tmp_path, line, tilt
):
    """A falling line on a hollow: what lies across it is not free, and is not asked for."""
    t = np.arange(400) * 1e-6
    z = 3e-9 - 2e-5 * t + t * t / (2 * 0.5)
    path = tmp_path / "line.x3p"
    ms.write(ms.Surface(z[None, :] if line == "row" else z[:, None], 1e-6, 1e-6), path)

    code, out, err = metrosep("form", path, "--form", "sphere", "--centre", "0 mm, 0 mm", "--json")

    assert (code, err) == (0, "")
    found = json.loads(out)["parameters"]
    assert found[tilt]["value"] == pytest.approx(-2e-5, abs=1e-9)
    assert found["R"]["value"] == pytest.approx(0.5, abs=1e-5)
    assert set(found) == {"piston", tilt, "R", "c"}
    other = {"tilt_x": "tilt_y", "tilt_y": "tilt_x"}[tilt]
    code, out, err = metrosep("form", path, "--free", f"piston,{other}")
    assert code == 2
    assert f"so there is no {other}; leave it out of free" in err


@pytest.mark.parametrize(
    ("options", "code", "match"),
    [
        (("--form", "qforbes: radius=6 mm, terms=x"), 2, "terms"),
        (("--centre", "nowhere"), 2, "centre"),
        (("--form", "plane", "--free", "wobble"), 2, "wobble"),
        (("--fix", "wobble=1 mm"), 2, "wobble"),
        (("--fix", "piston=1"), 2, "unit"),
        (("--form", "polynomial"), 2, "degree"),
    ],
)
def test_form_says_what_is_wrong(metrosep, sine, options, code, match):
    found, _, err = metrosep("form", sine, *options)

    assert found == code
    assert match in err


def gauge(path, lines):
    """Write a sine of 0.5 um as an ISO 5436-2 file."""
    n = 8000
    z = 0.5 * np.sin(2 * np.pi * np.arange(n) / 100)
    head = [
        "ISO 5436 - 2000 test\0",
        "PRF\0 1 ISO5436\0",
        f"CX\0 I\0 {n} mm\0 1.0e0 D\0 1e-3",
        f"CZ\0 A\0 {n} um\0 1.0e0 D\0",
    ]
    records = ["\r\n".join(r) for r in (head, lines, [f"{v:.12e}" for v in z])]
    body = "".join(r + "\r\n\x03\r\n" for r in records).encode("ascii")
    path.write_bytes(body + f"{sum(body) % 65536}\r\n\x03\r\n\x1a".encode("ascii"))
    return path


@pytest.mark.parametrize(
    ("line", "code", "word"),
    [
        ("PARAMETER_VALUE Pt 1.0000 um 0", 0, "agrees"),
        ("PARAMETER_VALUE Pt 1.0100 um 0", 1, "DIFFERS"),
        ("PARAMETER_VALUE Ra 0.3 um 0", 3, "not compared"),
    ],
)
def test_softgauge(metrosep, tmp_path, line, code, word):
    path = gauge(tmp_path / "gauge.smd", [line])

    found, out, _ = metrosep("verify-softgauge", path)
    as_json, rows, _ = metrosep("verify-softgauge", path, "--json")

    assert (found, as_json) == (code, code)
    assert word in out
    assert json.loads(rows)["rows"][0]["agrees"] == {0: True, 1: False, 3: None}[code]


def test_a_file_that_is_no_gauge(metrosep, waves):
    code, _, err = metrosep("verify-softgauge", waves)

    assert code == 2
    assert "a map holds no expected values" in err


def test_what_the_reader_warns_of_is_said_where_a_number_is_made(metrosep, tmp_path):
    """A row below the table is not a sample: each command that uses the file says so, not only info."""
    file = tmp_path / "trace.csv"
    rows = "\n".join(f"{0.25 * i:.2f};{(i * 7) % 11 * 0.1:.1f}" for i in range(57))
    file.write_text(f"Weg [mm];Messwert [um]\n{rows}\nMittelwert;0.5\n", "utf-8")

    for call in (
        ("convert", file, tmp_path / "trace.h5"),
        ("measure", file),
        ("measure", file, "--json"),
        ("form", file, "--form", "polynomial: degree=2"),
    ):
        code, _, err = metrosep(*call)
        assert code == 0, err
        assert "line 59 ('Mittelwert;0.5') stands below the table" in err


def test_heights_in_a_wrong_unit_are_warned_of_and_rounded_positions_have_a_way_out(
    metrosep, tmp_path
):
    """Nanometres under a header of micrometres; positions rounded to 1/1000 of a step."""
    file = tmp_path / "big.csv"
    rows = [f"{i},{5e7 * (i % 7)}" for i in range(400)]
    file.write_text("\n".join(["x_um,z_um", *rows]) + "\n")
    code, _, err = metrosep("measure", file, "--params", "Pq")
    assert code == 0
    assert "the unit of the heights is probably wrong" in err

    file = tmp_path / "rounded.csv"
    rows = [f"{round(i / 7, 4)},{0.01 * (i % 7)}" for i in range(400)]
    file.write_text("\n".join(["x_um,z_um", *rows]) + "\n")
    code, _, err = metrosep("measure", file, "--params", "Pq")
    assert code == 4
    assert "command line" not in err
    assert "--lateral-step" in err
    code, out, _ = metrosep(
        "measure", file, "--params", "Pq", "--set", "z=z_um", "--lateral-step", "0.142857 um"
    )
    assert code == 0
    assert "Pq" in out
