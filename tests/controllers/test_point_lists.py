"""Corrected lists of points: one column changes, by the correction, everything else stays."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest
from hypothesis import given, strategies as st

from metrosep.controllers.gcode.corrections import error_correction
from metrosep.controllers.gcode.lists import rewrite_points
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    InvalidSamplesError,
    LimitError,
    MetrosepError,
    UnitError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

HALF_MM = 0.5e-6 * (1 + 1e-6)
"""Half of the last digit of a nanometre in mm, and binary rounding."""


def rewritten(folder, text, correction, **options):
    (folder / "in.csv").write_bytes(text.encode("latin-1"))
    result = rewrite_points(folder / "in.csv", folder / "out.csv", correction, **options)
    text = (folder / "out.csv").read_bytes().decode("latin-1")
    return re.sub(r"[#%;] METROSEP CORRECTED Z [0-9a-f]{12}\r?\n", "", text), result


def test_z_moves_by_minus_the_error_where_the_tool_is(tmp_path):
    y, x = np.mgrid[-10e-3:10e-3:5j, -10e-3:10e-3:5j]
    surface = Surface(1e-4 * x + 3e-5 * y, dx=5e-3, dy=5e-3, origin=(-10e-3, -10e-3))
    text = "X_mm,C_deg,Z_mm\n8.0,0,1.0\n8.0,90,1.0\n8.0,450,1.0\n-8.0,0,1.0\n"

    out, _ = rewritten(tmp_path, text, error_correction(surface))
    assert out == (
        "X_mm,C_deg,Z_mm\n8.0,0,0.999200\n8.0,90,0.999760\n8.0,450,0.999760\n-8.0,0,1.000800\n"
    )

    out, _ = rewritten(tmp_path, text, error_correction(surface, c_sense=-1), overwrite=True)
    assert out.splitlines()[2] == "8.0,90,1.000240"


@pytest.mark.parametrize("sep", [",", ";", "\t", " ", ", ", "   "])
@pytest.mark.parametrize("eol", ["\n", "\r\n"])
def test_other_columns_stay_byte_for_byte(tmp_path, sep, eol):
    rows = [
        ["t_s", "X_mm", "note", "Z_mm", "C_deg"],
        ["0.10", "+1.50", "a\xe4", "-0.25", "3.0e1"],
        ["0.2", "1.60", "b", "1e-3", "400"],
    ]
    text = "# kept, 1, 2" + eol + eol + eol.join(sep.join(r) for r in rows)

    out, result = rewritten(tmp_path, text, lambda x, c: 1e-6 + 0 * x)

    assert out == text.replace("-0.25", "-0.249000").replace("1e-3", "0.002000")
    assert (result.n_points, result.n_changed) == (2, 2)


def test_columns_by_number_without_header_and_other_units(tmp_path):
    out, result = rewritten(
        tmp_path,
        "1 2000 0.25 9\n2 4000 0.5 9\n",
        lambda x, c: 1e-3 * x * np.sin(c),
        columns={"X": 1, "C": 2, "Z": 3},
        units={"X": "um", "C": "turn", "Z": "um"},
    )

    assert out == "1 2000 0.25 11.000\n2 4000 0.5 9\n"
    assert result.quantisation == pytest.approx(1e-9, abs=1e-20)


def test_profile_needs_no_c(tmp_path):
    out, _ = rewritten(
        tmp_path, "X_mm,Z_mm\n1,0.0\n", error_correction(Profile([0.0, 2e-3], [0.0, 4e-6]))
    )
    assert out == "X_mm,Z_mm\n1,-0.002000\n"


def test_speed_of_z_gets_the_slope_of_the_correction(tmp_path):
    n = 201
    t = np.linspace(0.0, 1.0, n)
    rows = "".join(f"{v:.6f};{5 * v:.6f};{30 * v:.6f};0.0;0.0\n" for v in t)

    out, _ = rewritten(
        tmp_path,
        "t_s;X_mm;C_deg;Z_mm;VZ_mm/min\n" + rows,
        lambda x, c: 1e-6 * np.sin(x / 1e-3),
        columns={"T": "t_s", "VZ": "VZ_mm/min"},
    )

    found = np.array([[float(v) for v in row.split(";")] for row in out.splitlines()[1:]])
    z, speed = found[:, 3], found[:, 4] / 60
    np.testing.assert_allclose(z, 1e-3 * np.sin(5 * t), rtol=0, atol=HALF_MM)
    # d/dt 1 um sin(5 t) = 5 um/s cos(5 t); central differences are short by (5 dt)^2 / 6 of it
    np.testing.assert_allclose(
        speed[1:-1], 5e-3 * np.cos(5 * t[1:-1]), rtol=0, atol=5e-3 * (5 / 200) ** 2 / 6 + 1e-6
    )


@given(st.lists(st.tuples(*[st.integers(-9999, 9999)] * 3), min_size=1, max_size=20))
def test_zero_changes_no_byte_and_amounts_are_met_to_half_a_digit(tmp_path_factory, rows):
    folder = tmp_path_factory.mktemp("points")
    text = "X_mm, C_deg ,Z_mm\n" + "".join(
        f"{a / 100}, {b / 10} ,{c / 1000}\n" for a, b, c in rows
    )

    same, _ = rewritten(folder, text, lambda x, c: 0 * x)
    assert same == text

    out, _ = rewritten(folder, text, lambda x, c: 3e-6 * np.cos(c) + 1e-4 * x, overwrite=True)
    for (a, b, c), line in zip(rows, out.splitlines()[1:], strict=True):
        x_text, c_text, z_text = line.split(",")
        assert (x_text, c_text) == (f"{a / 100}", f" {b / 10} ")
        wanted = c / 1000 + 3e-3 * math.cos(math.radians(b / 10)) + 1e-4 * a / 100
        assert float(z_text) == pytest.approx(wanted, abs=HALF_MM + 1e-12)


HEAD = "X_mm,C_deg,Z_mm\n"


@pytest.mark.parametrize(
    ("text", "options", "kind", "part"),
    [
        ("", {}, DataError, "no point"),
        (HEAD, {}, DataError, "no point"),
        ("X,C,Z\n1,2,3\n", {}, UnitError, "not stated"),
        ("X_mm,C_mm,Z_mm\n1,2,3\n", {}, UnitError, "column C"),
        ("X_mm,Z_mm\n1,2\n", {}, DataError, "no column 'C'"),
        ("1,2,3\n", {}, DataError, "no column 'X'"),
        (HEAD + "1,2\n", {}, CorruptFileError, "not a number|columns"),
        (HEAD + "1,2,3\n1,2,3,4\n", {}, CorruptFileError, "line 3 has 4"),
        (HEAD + "1,2,abc\n", {}, CorruptFileError, "line 2: 'abc'"),
        (HEAD + "1,2,nan\n", {}, CorruptFileError, "'nan'"),
        (HEAD + "1,2,3\n", {"columns": {"Q": 1}}, DataError, "'Q'"),
        (HEAD + "1,2,3\n", {"columns": {"X": "x"}}, DataError, "no column 'x'"),
        (HEAD + "1,2,3\n", {"stroke": 1e-9}, LimitError, "line 2"),
        (HEAD + "1,2,3\n", {"stroke": math.nan}, DataError, "stroke"),
        (HEAD + "1,2,3\n", {"decimals": 0}, DataError, "decimals"),
        ("t_s," + HEAD + "1,1,2,3\n", {"columns": {"T": 0}}, DataError, "T and VZ"),
        (
            "t_s,VZ_mm_s," + HEAD + "1,1,1,2,3\n1,1,1,2,3\n",
            {"columns": {"T": 0, "VZ": 1}},
            InvalidSamplesError,
            "do not rise",
        ),
    ],
)
def test_bad_lists_are_refused_and_nothing_is_written(tmp_path, text, options, kind, part):
    with pytest.raises(MetrosepError, match=part) as caught:
        rewritten(tmp_path, text, lambda x, c: 1e-6 + 0 * x, **options)

    assert isinstance(caught.value, kind)
    assert [p.name for p in tmp_path.iterdir()] == ["in.csv"]


def test_beyond_the_map_and_gaps_are_refused(tmp_path):
    z = np.zeros((5, 5))
    z[3, 3] = np.nan
    made = error_correction(Surface(z, dx=1e-3, dy=1e-3, origin=(-2e-3, -2e-3)))

    with pytest.raises(InvalidSamplesError, match=r"line 2: at X = 5 mm.*beyond the map"):
        rewritten(tmp_path, HEAD + "5,0,0\n", made)
    with pytest.raises(InvalidSamplesError, match=r"line 2: .*not measured"):
        rewritten(tmp_path, HEAD + "0.7,45,0\n", made)


def test_empty_fields_are_columns_too(tmp_path):
    text = "note\tX_mm\tC_deg\tZ_mm\ttag\n\t10\t90\t1.5\t\n\t11\t90\t1.5\t7\n"
    out, _ = rewritten(tmp_path, text, lambda x, c: 1e-3 * x)

    assert out == text.replace("90\t1.5\t\n", "90\t1.510000\t\n").replace(
        "90\t1.5\t7", "90\t1.511000\t7"
    )


@pytest.mark.parametrize("head", ["i,X_mm,C_deg,Z_mm", "X_mm,Z_mm"])
def test_rows_as_wide_as_the_header_or_refused(tmp_path, head):
    made = error_correction(Profile([0.0, 20e-3], [0.0, 1e-6]))
    with pytest.raises(CorruptFileError, match=r"line 2 has 3 columns, the header \d"):
        rewritten(tmp_path, head + "\n10,90,1.5\n", made)


@pytest.mark.parametrize(
    ("text", "options", "kind", "part"),
    [
        ("X_mm,C_deg,Z_mm\n1,90,1\n", {"units": {"X": "um"}}, UnitError, "header says mm"),
        ("X_mm,X_um,C_deg,Z_mm\n1,1000,90,1\n", {}, DataError, "X twice"),
        ("X_mm,C_deg,Z_mm\n1,2,3\n", {"columns": {"Z": 0}}, DataError, "same column"),
        ("X_mm,C_deg,Z_mm\n1,2,1e300\n", {}, CorruptFileError, "beyond the travel of any machine"),
        ("X_mm,C_deg,Z_mm\n1,2,3\n", {"decimals": 5.5}, DataError, "whole number"),
        ("\n# nothing\n", {}, DataError, "a list has a header such as"),
        ("t_s,X_mm,C_deg,Z_mm,VZ\n0,1,2,3,4\n", {}, UnitError, "column VZ"),
    ],
)
def test_contradictions_are_refused(tmp_path, text, options, kind, part):
    with pytest.raises(kind, match=part):
        rewritten(tmp_path, text, lambda x, c: 1e-6 + 0 * x, **options)
    assert [p.name for p in tmp_path.iterdir()] == ["in.csv"]


@pytest.mark.parametrize("found", [1e-6, np.zeros(1), np.zeros((2, 1))], ids=["one", "1", "2x1"])
def test_one_value_a_point(tmp_path, found):
    with pytest.raises(DataError, match="one value"):
        rewritten(tmp_path, HEAD + "1,2,3\n2,2,3\n", lambda x, c: found)


def test_units_in_signs_and_a_byte_order_mark(tmp_path):
    for sign in ("\xb0", "\xc2\xb0"):
        text = f"\xef\xbb\xbfX [mm],C [{sign}],Z [\xc2\xb5m]\n1,90,1\n"
        out, _ = rewritten(tmp_path, text, lambda x, c: 2e-6 * np.sin(c), overwrite=True)
        assert out == text.replace(",1\n", ",3.000\n")


def test_diameters_are_halved_for_the_lookup(tmp_path):
    out, result = rewritten(tmp_path, HEAD + "8,0,1\n", lambda x, c: 1e-3 * x, diameter=True)
    assert out == HEAD + "8,0,1.004000\n"
    assert result.audit["x_is_diameter"] is True


def test_time_and_speed_of_the_header_are_used(tmp_path):
    out, result = rewritten(
        tmp_path,
        "t_s,X_mm,C_deg,Z_mm,VZ_mm_s\n0,1,0,0.0,1.0\n1,2,0,0.0,1.0\n",
        lambda x, c: 1e-3 * x,
    )
    # c rises by 1 um in 1 s
    assert out.splitlines()[1:] == ["0,1,0,0.001000,1.001000", "1,2,0,0.002000,1.001000"]
    assert not any("speed" in m for m in result.messages)


def test_sidecar_and_existing_files(tmp_path):
    _, result = rewritten(tmp_path, HEAD + "1,2,3\n", lambda x, c: 1e-6 + 0 * x)
    assert json.loads((tmp_path / "out.csv.json").read_text()) == result.audit
    assert result.audit["sign"].startswith("correction c = -e")

    first = [(tmp_path / n).read_bytes() for n in ("out.csv", "out.csv.json")]
    rewritten(tmp_path, HEAD + "1,2,3\n", lambda x, c: 1e-6 + 0 * x)  # the same bytes
    with pytest.raises(WriteError, match="exists already"):
        rewritten(tmp_path, HEAD + "1,2,3\n", lambda x, c: 0 * x)
    rewritten(tmp_path, HEAD + "1,2,3\n", lambda x, c: 2e-6 + 0 * x, overwrite=True)
    assert [(tmp_path / n).read_bytes() for n in ("out.csv.1", "out.csv.1.json")] == first
    with pytest.raises(WriteError, match="the source itself"):
        rewrite_points(
            tmp_path / "in.csv", tmp_path / "in.csv", lambda x, c: 0 * x, overwrite=True
        )
