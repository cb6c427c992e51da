"""Software gauges: files written here with values from closed forms."""

import math

import numpy as np
import pytest

import metrosep as ms
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
    lines = ["PROFILE_FILTER Gaussian LC 0.8 mm", "PARAMETER_VALUE RzJIS 1 um"]
    (row,) = verify_softgauge(gauge(tmp_path / "a.smd", sine(), 1e-3, lines))

    assert row.reason.startswith("'RzJIS' is not among")


@pytest.mark.parametrize(
    ("lines", "match"),
    [
        (["PARAMETER_VALUE Ra lots um 0"], "no number"),
        (["PARAMETER_VALUE Ra"], "expected PARAMETER_VALUE"),
        (["PARAMETER_VALUE Ra nan um 0"], "not finite"),
        (["PARAMETER_VALUE Ra 1.0 furlong 0"], "furlong"),
        (["PARAMETER_VALUE Ra 1 um 0", "PARAMETER_VALUE Ra 2 um 0"], "two values of Ra"),
        (["PROFILE_FILTER Spline LC 0.8 mm"], "Spline"),
        (["PARAMETER_VALUE Ra 0.4 um 1..2"], "Ra 0.4 um 1..2"),
        (["PARAMETER_VALUE Ra 0.4 um nan"], "Ra 0.4 um nan"),
        (["PARAMETER_VALUE Ra 0.4 um 0.1 0.2"], "expected PARAMETER_VALUE"),
        (["PARAMETER_VALUE Psk 0.4 0.1 0.2"], "expected PARAMETER_VALUE"),
    ],
)
def test_a_line_that_cannot_be_understood_is_quoted(lines, match):
    with pytest.raises(DataError, match=match):
        expectations(lines)


def test_a_file_without_expectations_is_no_gauge(tmp_path):
    with pytest.raises(DataError, match="expects nothing"):
        verify_softgauge(gauge(tmp_path / "a.smd", sine(100), 1e-3, ["DATE 03-Jan-2026"]))


def test_rows_are_plain_for_json(tmp_path):
    profile = gauge(tmp_path / "a.smd", sine(), 1e-3, ["PARAMETER_VALUE Rzz 1 um"])

    assert verify_softgauge(profile)[0].to_dict()["computed"] is None
