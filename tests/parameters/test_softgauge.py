"""Software gauges: files written here with values from closed forms."""

import math

import numpy as np
import pytest

import metrosep as ms
from metrosep import Surface
from metrosep.core.errors import DataError
from metrosep.parameters.softgauge import expectations, verify_softgauge

AMPLITUDE_UM = 0.5


def gauge(path, z_um, step_mm, lines):
    """Write an ISO 5436-2 file without metrosep."""
    n = len(z_um)
    head = [
        "ISO 5436 - 2000 test\0",
        "PRF\0 1 ISO5436\0",
        f"CX\0 I\0 {n} mm\0 1.0e0 D\0 {step_mm:.6e}",
        f"CZ\0 A\0 {n} um\0 1.0e0 D\0",
    ]
    records = ["\r\n".join(head), "\r\n".join(lines), "\r\n".join(f"{v:.12e}" for v in z_um)]
    body = "".join(r + "\r\n\x03\r\n" for r in records).encode("ascii")
    path.write_bytes(body + f"{sum(body) % 65536}\r\n\x03\r\n\x1a".encode("ascii"))
    return ms.read(path)


def sine(n=8000, step_mm=1e-3, period_mm=0.1, slope=0.0):
    x = np.arange(n) * step_mm
    return AMPLITUDE_UM * np.sin(2 * np.pi * x / period_mm + 0.3) + slope * x


def by_symbol(rows):
    return {r.expected.symbol: r for r in rows}


def test_right_values_agree_and_wrong_ones_do_not(tmp_path):
    """Pa and Pq of a sine over whole periods, and Ra after a filter 8 times its wavelength."""
    lines = [
        "DATE 03-Jan-2026",
        "PROFILE_FILTER Gaussian LS 2.5 um LC 0.8 mm",
        f"PARAMETER_VALUE Pq {AMPLITUDE_UM / math.sqrt(2):.4f} um 0",
        f"PARAMETER_VALUE Pa {2 * AMPLITUDE_UM / math.pi:.4f} um 0",
        f"PARAMETER_VALUE Ra {2 * AMPLITUDE_UM / math.pi * 1e-3:.6f} mm 0",
        "PARAMETER_VALUE RSm 0.1000 mm 0",
        "PARAMETER_VALUE Rku 1.500",
        "PARAMETER_VALUE Rq 0.3600 um 0.0001",
        "PARAMETER_VALUE Rzz 0.3600 um 0",
    ]
    # the tilt is what the filter takes away; the P values are those without it
    rows = by_symbol(verify_softgauge(gauge(tmp_path / "a.smd", sine(), 1e-3, lines)))

    agree = {s: r.agrees for s, r in rows.items()}
    assert agree == {
        "Pq": True,
        "Pa": True,
        "Ra": True,
        "RSm": True,
        "Rku": True,
        "Rq": False,
        "Rzz": None,
    }
    assert rows["Rq"].deviation < 0
    assert "Rzz" in rows["Rzz"].reason


def test_the_filter_is_really_applied(tmp_path):
    lines = ["PROFILE_FILTER Gaussian LC 0.8 mm", "PARAMETER_VALUE Rt 1.0000 um 0.001"]
    tilted = gauge(tmp_path / "tilted.smd", sine(slope=5.0), 1e-3, lines)

    (row,) = verify_softgauge(tilted)

    assert row.agrees


def test_cutoff_of_the_caller_and_a_profile_that_is_filtered_already(tmp_path):
    lines = ["PARAMETER_VALUE Rt 1.0000 um 0.001"]
    profile = gauge(tmp_path / "a.smd", sine(), 1e-3, lines)

    assert verify_softgauge(profile)[0].agrees is None
    assert "lambda_c" in verify_softgauge(profile)[0].reason
    assert verify_softgauge(profile, lambda_c=0.8e-3)[0].agrees
    assert verify_softgauge(profile, kind="R", sections=5)[0].agrees


def test_tolerance_is_half_of_the_last_digit_and_the_uncertainty():
    (value,), _ = expectations(["PARAMETER_VALUE Ra 0.4213 um 0.0002"])

    assert math.isclose(value.half_digit, 0.5e-10, rel_tol=1e-12)
    assert math.isclose(value.u, 2e-10, rel_tol=1e-12)


@pytest.mark.parametrize(
    ("line", "u"),
    [
        ("PARAMETER_VALUE Psk 0.0888", None),
        ("PARAMETER_VALUE Psk 0.0888 1", None),
        ("PARAMETER_VALUE Psk 0.0888 1 0", None),
        ("PARAMETER_VALUE Psk 0.0888 1 0.01", 0.01),
        ("PARAMETER_VALUE Psk 0.0888 - 0.01", 0.01),
        ("PARAMETER_VALUE Psk 0.0888 0.01", 0.01),
        ("PARAMETER_VALUE Psk 0.0888 0", None),
    ],
)
def test_pure_numbers_with_and_without_their_unit(line, u):
    """Exactly "1" is the unit of a pure number; an uncertainty of 1 would accept anything."""
    (value,), _ = expectations([line])

    assert (value.value, value.u) == (0.0888, u)
    assert math.isclose(value.half_digit, 0.5e-4, rel_tol=1e-12)


@pytest.mark.parametrize(
    ("line", "unit"),
    [
        ("PARAMETER_VALUE Pa 0.4 deg 0", "deg"),
        ("PARAMETER_VALUE Psk 0.1 mm 0", "mm"),
        ("PARAMETER_VALUE Pa 0.4", "1"),
    ],
)
def test_unit_of_another_dimension_is_not_compared(tmp_path, line, unit):
    (row,) = verify_softgauge(gauge(tmp_path / "a.smd", sine(), 1e-3, [line]))

    assert row.agrees is None
    assert f"in {unit}" in row.reason


@pytest.mark.parametrize(("kind", "symbol"), [("R", "Wt"), ("W", "Rt"), ("R", "Pt"), ("W", "Pt")])
def test_filtered_profile_is_never_filtered_again(tmp_path, kind, symbol):
    lines = ["PROFILE_FILTER Gaussian LC 0.8 mm", f"PARAMETER_VALUE {symbol} 1.0 um 9"]
    profile = gauge(tmp_path / "a.smd", sine(), 1e-3, lines)

    (row,) = verify_softgauge(profile, kind=kind)

    assert row.agrees is None
    assert f"declared {kind}" in row.reason


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"sections": 0}, "sections"),
        ({"sections": 2.5}, "sections"),
        ({"sections": "5"}, "sections"),
        ({"sections": True}, "sections"),
        ({"edition": "ISO 4287:1984"}, "edition"),
        ({"relative_tolerance": -0.1}, "relative_tolerance"),
        ({"relative_tolerance": math.nan}, "relative_tolerance"),
        ({"relative_tolerance": "much"}, "relative_tolerance"),
        ({"kind": "Q"}, "kind"),
        ({"line": "tangent"}, "secant"),
    ],
)
def test_bad_options_are_refused_at_the_call(tmp_path, options, match):
    profile = gauge(tmp_path / "a.smd", sine(), 1e-3, ["PARAMETER_VALUE Pt 1.0 um"])

    with pytest.raises(DataError, match=match):
        verify_softgauge(profile, **options)


def test_reason_keeps_its_quotes(tmp_path):
    lines = ["PROFILE_FILTER Gaussian LC 0.8 mm", "PARAMETER_VALUE Rzq 1 um"]
    (row,) = verify_softgauge(gauge(tmp_path / "a.smd", sine(), 1e-3, lines))

    assert row.reason.startswith("'Rzq' is not among")


@pytest.mark.parametrize(
    ("lines", "match"),
    [
        (["PARAMETER_VALUE Ra lots um 0"], "not a number"),
        (["PARAMETER_VALUE Ra"], "expected PARAMETER_VALUE"),
        (["PARAMETER_VALUE Ra nan um 0"], "not finite"),
        (["PARAMETER_VALUE Ra 1 um 0", "PARAMETER_VALUE Ra 2 um 0"], "two values of Ra"),
        (["PROFILE_FILTER Spline LC 0.8 mm"], "Spline"),
        (["PARAMETER_VALUE Ra 0.4 um 1..2"], "Ra 0.4 um 1..2"),
        (["PARAMETER_VALUE Ra 0.4 um nan"], "Ra 0.4 um nan"),
        (["PARAMETER_VALUE Ra 0.4 um 0.1 0.2"], "expected PARAMETER_VALUE"),
        (["PARAMETER_VALUE Psk 0.4 0.1 0.2"], "expected PARAMETER_VALUE"),
        (["PARAMETER_VALUE Ra 0.4 um -0.02"], "'-0.02' in .* is negative"),
        (["PARAMETER_VALUE Psk 0.4 -0.02"], "'-0.02' in .* is negative"),
        (["PARAMETER_VALUE Ra 1e400 um"], "not finite"),
        (["PARAMETER_VALUE Ra 0e400 um"], "not finite"),
        (["PROFILE_FILTER Gaussian LC"], "cut-off LC in .* no number"),
        (["PROFILE_FILTER Gaussian LC 0.8"], "cut-off LC in .* no number"),
        (["PROFILE_FILTER Gaussian LC 0.8 mm LC 2.5 mm"], "two cut-offs LC"),
        (
            ["PROFILE_FILTER Gaussian LC 0.8 mm", "PROFILE_FILTER Gaussian LC 0.25 mm"],
            "two cut-offs LC: .*LC 0.8 mm.*LC 0.25 mm",
        ),
        (
            ["PROFILE_FILTER Gaussian LS 8 um", "PROFILE_FILTER Gaussian LS 2.5 um"],
            "two cut-offs LS",
        ),
        (["PROFILE_FILTER Gaussian LS 2.5 um", "PROFILE_FILTER Spline LC 0.8 mm"], "Spline"),
    ],
)
def test_a_line_that_cannot_be_understood_is_quoted(lines, match):
    with pytest.raises(DataError, match=match):
        expectations(lines)


@pytest.mark.parametrize(
    "lines",
    [
        ["PROFILE_FILTER Gaussian LC 0.8 mm", "PROFILE_FILTER Gaussian LS 2.5 um"],
        ["PROFILE_FILTER Gaussian LS 2.5 um", "PROFILE_FILTER Gaussian LC 0.8 mm"],
        ["PROFILE_FILTER Gaussian LS 2.5 um LC 0.8 mm", "PROFILE_FILTER GAUSS LC 800 um"],
    ],
)
def test_filter_lines_add_up(lines):
    _, settings = expectations(lines)

    assert settings.lambda_c == pytest.approx(0.8e-3, abs=1e-15)
    assert settings.lambda_s == pytest.approx(2.5e-6, abs=1e-18)


@pytest.mark.parametrize(
    "line",
    [
        "PARAMETR_VALUE Ra 0.4 um",
        "PARAMETER_VALUERa 0.4 um",
        "PARAMETER_VALUE: Ra 0.4 um",
        "Parameter Value Ra 0.4 um",
        "PROFIL_FILTER Gaussian LC 2.5 mm",
        "PROFILE FILTER Gaussian LC 2.5 mm",
    ],
)
def test_keyword_with_a_slip_is_told(line):
    expected, settings = expectations(["PARAMETER_VALUE Pa 0.3 um", line])

    assert len(expected) == 1
    assert settings.lambda_c is None
    (told,) = settings.unread
    assert repr(line) in told


def test_other_keywords_and_comments_are_no_slips():
    """Keywords of the standard, and a comment over several lines."""
    _, settings = expectations(
        [
            "DATE 03-Jan-2026",
            "TIME 12:00",
            "CREATED_BY somebody",
            "INSTRUMENT_ID 1",
            "INSTRUMENT_SERIAL 2",
            "LAST_ADJUSTMENT 03-Jan-2026",
            "PROBING_SYSTEM Contacting TIP 2 um",
            "OFFSET 0 mm",
            "SPEED 0.5 mm/s",
            "COMMENT /* first",
            "Parameter values by reference software",
            "last */",
            "PARAMETER_VALUE Pa 0.3 um",
        ]
    )

    assert settings.unread == ()


def test_value_in_a_comment_is_told():
    lines = ["COMMENT /* not", "PARAMETER_VALUE Pq 1 um", "*/", "PARAMETER_VALUE Pa 0.3 um"]

    expected, settings = expectations(lines)

    assert [e.symbol for e in expected] == ["Pa"]
    assert "'PARAMETER_VALUE Pq 1 um' stands in a comment" in settings.unread[0]


@pytest.mark.parametrize(
    ("line", "agrees"),
    [
        ("PARAMETER_VALUE Pa 0 mm 0", None),
        ("PARAMETER_VALUE Pa 0 um", None),
        ("PARAMETER_VALUE Pa 0.0 mm 0.001", None),
        ("PARAMETER_VALUE Pa 0.3 um 0.4", None),
        ("PARAMETER_VALUE Pa 0.3 um 0.2", True),
        ("PARAMETER_VALUE Psk 0", None),
        ("PARAMETER_VALUE Psk 0 1 0", None),
        ("PARAMETER_VALUE Psk 0.000 1 0", True),
        ("PARAMETER_VALUE Psk 0 1 0.001", None),
        ("PARAMETER_VALUE Psk 0.001 1 0.01", True),
    ],
)
def test_a_value_that_decides_nothing_is_not_compared(tmp_path, line, agrees):
    """Pa of 318 nm: where 0 is within the tolerance too, agreeing would say nothing.

    The skewness of a sine is 0, so a zero with decimals is a value there.
    """
    (row,) = found = verify_softgauge(gauge(tmp_path / "a.smd", sine(), 1e-3, [line]))

    assert row.agrees is agrees
    assert bool(row.reason) is (agrees is None)
    assert found.result == ("verified" if agrees else "not verified")


def test_what_the_reader_warned_of_is_told_with_the_result(tmp_path):
    lines = ["PARAMETER_VALUE Pt 1.0000 um 0.001", "PARAMETER_VALUE Pq 9.9 um 0"]
    sound = gauge(tmp_path / "a.smd", sine(), 1e-3, lines)
    warned = ms.Profile(sound.x, sound.z, metadata={**sound.metadata, "warnings": ("odd",)})

    assert verify_softgauge(sound).result == verify_softgauge(warned).result == "differs"
    assert not verify_softgauge(sound).reasons
    assert "odd" in verify_softgauge(warned).reasons[0]


def test_result_is_a_sequence_of_its_rows(tmp_path):
    lines = [
        "PARAMETER_VALUE Pt 1.000 um 0",
        "PARAMETER_VALUE Pzz 1 um",
        "PARAMETER_VALUE Rt 1 um",
    ]

    found = verify_softgauge(gauge(tmp_path / "a.smd", sine(), 1e-3, lines))

    assert [r.expected.symbol for r in found] == ["Pt", "Pzz", "Rt"]
    assert (len(found), found.n_agree, found[0].agrees) == (3, 1, True)
    assert found.reasons == ("2 of 3 values were not compared: Pzz, Rt",)
    assert set(found.to_dict()) == {"result", "reasons", "rows"}


def test_misspelt_keyword_is_named_where_nothing_is_expected(tmp_path):
    profile = gauge(tmp_path / "a.smd", sine(100), 1e-3, ["PARAMETR_VALUE Ra 0.4 um"])

    with pytest.raises(DataError, match=r"expects nothing.*'PARAMETR_VALUE Ra 0.4 um'"):
        verify_softgauge(profile)


def test_a_file_without_expectations_is_no_gauge(tmp_path):
    with pytest.raises(DataError, match="expects nothing"):
        verify_softgauge(gauge(tmp_path / "a.smd", sine(100), 1e-3, ["DATE 03-Jan-2026"]))


def test_rows_are_plain_for_json(tmp_path):
    profile = gauge(tmp_path / "a.smd", sine(), 1e-3, ["PARAMETER_VALUE Rzz 1 um"])

    assert verify_softgauge(profile)[0].to_dict()["computed"] is None


def test_a_unit_that_is_not_known_leaves_the_other_values(tmp_path):
    lines = ["PARAMETER_VALUE RPc 30 1/cm", "PARAMETER_VALUE Pt 1.000 um 0.5"]

    found = verify_softgauge(gauge(tmp_path / "a.smd", sine(), 1e-3, lines))

    assert (found[0].agrees, found[1].agrees) == (None, True)
    assert "1/cm" in found[0].reason
    assert found.result == "not verified"


def test_a_heading_is_no_slip_of_a_keyword(tmp_path):
    lines = ["Parameter values:", "PARAMETER_VALUE Pt 1.000 um 0.5", "PROFILE FILTERS as usual"]

    assert verify_softgauge(gauge(tmp_path / "a.smd", sine(), 1e-3, lines)).result == "verified"


@pytest.mark.parametrize("word", ["NONE", "off"])
def test_a_filter_that_is_off_has_no_cutoff(word):
    _, settings = expectations([f"PROFILE_FILTER Gaussian LS {word} LC 0.8 mm"])

    assert settings.lambda_s is None
    assert settings.lambda_c == pytest.approx(0.8e-3, rel=1e-15, abs=0.0)


@pytest.mark.parametrize("length", ["-0.8 mm", "0 mm", "1e999 mm"])
def test_a_cutoff_of_the_file_must_be_positive(length):
    with pytest.raises(DataError, match="PROFILE_FILTER Gaussian LC"):
        expectations([f"PROFILE_FILTER Gaussian LC {length}"])


@pytest.mark.parametrize("lambda_c", [np.nan, 0.0, -1e-3, np.inf, "0.8"])
def test_a_cutoff_of_the_caller_must_be_positive(tmp_path, lambda_c):
    sound = gauge(tmp_path / "a.smd", sine(), 1e-3, ["PARAMETER_VALUE Pt 1.000 um 0.5"])

    with pytest.raises(DataError, match="lambda_c"):
        verify_softgauge(sound, lambda_c=lambda_c)


# ---- areal gauges: a map, and values that its publisher prints elsewhere ---------------------------


def gauge_map():
    """50 nm cos x cos y: Sq = 25 nm, Sz = 100 nm, Sa = 50 nm (mean of |cos| over ten samples, 0.63728)^2."""
    c = np.cos(2 * np.pi * (np.arange(400) + 0.5) / 40)
    return Surface(50e-9 * c[:, None] * c, 1e-6, 1e-6)


def test_an_areal_gauge_is_compared_with_published_values():
    expected = {"Sq": "0.0250 um", "Sa": "20.306 nm", "Sxx": "1 um"}
    found = verify_softgauge(gauge_map(), expected=expected)

    agrees = {r.expected.symbol: r.agrees for r in found}
    assert agrees["Sq"] is True
    assert agrees["Sa"] is True
    assert agrees["Sxx"] is None
    assert found.result == "not verified"

    wrong = verify_softgauge(gauge_map(), expected={"Sq": "0.0251 um"})
    assert wrong.result == "differs"
    with pytest.raises(DataError, match="state those of its publisher"):
        verify_softgauge(gauge_map())
