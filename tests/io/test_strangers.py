"""Files as instruments, spreadsheets and people of many countries write them; read off by eye, not by our code.

Each case is what a stranger's program put round the same thirty readings, and what must come out of it.
"""

import math
import re
import zipfile

import h5py
import numpy as np
import pytest
import scipy.io

import metrosep as ms
from metrosep.io.stream import open_stream

N = 30
X = [0.25 * k for k in range(N)]
Z = [round(1.7 * math.sin(0.37 * k) + 0.03 * k, 4) for k in range(N)]
TIGHT = 1e-15
"""Metres: far below a digit that the files hold."""


def table(top, row, x=X, z=Z):
    return (
        "\n".join([top, *(row(k, a, b) for k, (a, b) in enumerate(zip(x, z, strict=True)))]) + "\n"
    )


def comma(value):
    return f"{value:g}".replace(".", ",")


HALF = [0.5 * k for k in range(N)]
TENTHS = [round(10 * z) for z in Z]
INCH = [round(x / 25.4, 6) for x in X]

# text, positions in m, heights in m
READ = {
    "a unit with a decimal comma beside whole numbers": (
        table("Weg;Höhe", lambda k, x, z: f"{comma(HALF[k])} mm;{TENTHS[k]} µm"),
        [v * 1e-3 for v in HALF],
        [v * 1e-6 for v in TENTHS],
    ),
    "the same in quotes between commas": (
        table("Weg,Höhe", lambda k, x, z: f'"{comma(HALF[k])} mm","{TENTHS[k]} µm"'),
        [v * 1e-3 for v in HALF],
        [v * 1e-6 for v in TENTHS],
    ),
    "the sign of inches in the header": (
        table('x ["];z [um]', lambda k, x, z: f"{INCH[k]};{z}"),
        [v * 25.4e-3 for v in INCH],
        [v * 1e-6 for v in Z],
    ),
    "thousandths of an inch": (
        table("x (thou),z (um)", lambda k, x, z: f"{k},{z}"),
        [k * 25.4e-6 for k in range(N)],
        [v * 1e-6 for v in Z],
    ),
    "a column of percent": (
        table("x_mm;z_um;LF [%]", lambda k, x, z: f"{x};{z};45.1"),
        [v * 1e-3 for v in X],
        [v * 1e-6 for v in Z],
    ),
    "a column of temperatures between": (
        table(
            "Weg [mm];Temp [°C];Abweichung [µm]",
            lambda k, x, z: f"{comma(x)};20,{k % 9};{z:.4f}".replace(".", ","),
        ),
        [v * 1e-3 for v in X],
        [v * 1e-6 for v in Z],
    ),
    "units in braces": (
        table("Position {mm};Height <um>", lambda k, x, z: f"{x};{z}"),
        [v * 1e-3 for v in X],
        [v * 1e-6 for v in Z],
    ),
    "a word in front of the units": (
        table("Name;X;Z\nUnits;mm;um", lambda k, x, z: f";{x};{z}"),
        [v * 1e-3 for v in X],
        [v * 1e-6 for v in Z],
    ),
    "rules above and below": (
        table("x_mm   z_um\n====== ======", lambda k, x, z: f"{x:6.2f} {z:9.4f}")
        + "====== ======\n",
        [v * 1e-3 for v in X],
        [v * 1e-6 for v in Z],
    ),
    "a printed frame": (
        table("------\n|x_mm    |z_um    |\n------", lambda k, x, z: f"|{x:8.2f}|{z:8.4f}|")
        + "------\n",
        [v * 1e-3 for v in X],
        [v * 1e-6 for v in Z],
    ),
    "names like comments in every row": (
        table("id,x_mm,z_um", lambda k, x, z: f"#{k},{x},{z}"),
        [v * 1e-3 for v in X],
        [v * 1e-6 for v in Z],
    ),
}


@pytest.mark.parametrize("case", READ)
def test_a_profile_is_what_a_person_reads(put, case):
    text, x, z = READ[case]

    found = ms.read(put(text))

    np.testing.assert_allclose(found.x, x, rtol=0.0, atol=TIGHT)
    np.testing.assert_allclose(found.z, z, rtol=0.0, atol=TIGHT)


def test_channels_of_a_scope_are_named_by_numbers_above_their_units(put):
    """Keysight: the row ``x-axis,1`` above ``second,Volt``."""
    found = ms.read(
        put(table("x-axis,1\nsecond,Volt", lambda k, x, z: f"{k * 1e-4:+.8E},{z:+.5E}"))
    )

    assert found.channels["1"].tolist() == [float(f"{z:.5E}") for z in Z]
    assert found.units["1"] == "V"
    assert found.metadata["warnings"] == ()


@pytest.mark.parametrize("name", ["Source", "Sensor", "USB 1"])
def test_a_capital_in_a_name_is_no_unit(put, name):
    found = ms.read(put(table(f"{name},CH1\nSecond,Volt", lambda k, x, z: f"{k * 1e-4:.8E},{z}")))

    assert found.metadata["warnings"] == ()


@pytest.mark.parametrize(
    "word",
    ["(null)", "<NA>", "NaT", "n.a.", "--.--", "Overload", "over range", "O.L", "+OVERLOAD"],
)
def test_words_of_instruments_for_no_reading_are_nan(put, word):
    found = ms.read(put(table("x_mm;z_um", lambda k, x, z: f"{x};{word if k == 11 else z}")))

    assert np.flatnonzero(np.isnan(found.z)).tolist() == [11]
    beyond = word.casefold().lstrip("+") in ("overload", "over range", "o.l")
    assert ("out of its range" in " ".join(found.metadata["warnings"])) == beyond


# text, and what the message must name
REFUSED = {
    "1,234 mm may be a thousand": (
        table("x;z", lambda k, x, z: f"{k + 1},{100 + k} mm;{10 + k} µm"),
        r"line 2.*1,100 mm.*thousands=','",
    ),
    "points between groups of a spreadsheet": (
        table("Weg [µm];z [nm]", lambda k, x, z: f"1.{10 * k:03d};{k % 7}"),
        r"line 2: column 'Weg \[µm\]' holds '1\.000', which is 1\.000 or 1000.*thousands='\.'",
    ),
    "two units of one column": (
        table("x [mm];z (µm) [nm]", lambda k, x, z: f"{x};{z}"),
        r"'z \(µm\) \[nm\]' names two units",
    ),
    "two decimal marks": (
        table("x_mm;z_um", lambda k, x, z: f"{x:.2f};{comma(z + 0.0001)}"),
        r"0\.00.*different decimal marks",
    ),
    "numbers of sixteen": (
        table("x_mm;z_um", lambda k, x, z: f"{x};0x{k:02X}"),
        r"column 'z_um' holds texts such as '0x00'",
    ),
    "a unit in brackets that is none": (
        table("x [mm];z [A]", lambda k, x, z: f"{x};{z}"),
        r"'z \[A\]' \(z\) has 'A' for its unit",
    ),
    "a further length": (
        table("x_mm;z_um;b_um", lambda k, x, z: f"{x};{z};{z + 1}"),
        r"3 column\(s\)",
    ),
    "a name of a variable": (
        table("data =\n", lambda k, x, z: f"   {x:8.4f}   {z:8.4f}"),
        r"line 1 \('data ='\) is neither a row of 2 names",
    ),
    "quotes that end within a field": (
        table("x_mm,z_um", lambda k, x, z: f'"{x}"5,{z}' if k == 4 else f'"{x}","{z}"'),
        r"between a quote and the next separator, line 6",
    ),
    "metres of time": (
        table("t [m];z [um]", lambda k, x, z: f"{k};{z}"),
        r"'t \[m\]' is a time by its name",
    ),
    "minutes or hours": (
        table("Elapsed;z [um]", lambda k, x, z: f"00:{k:02d};{z}"),
        r"'00:00' may be hours and minutes, or minutes and seconds",
    ),
    "summer time ends": (
        table(
            "Zeit;z [um]",
            lambda k, x, z: f"27.10.2024 02:{45 + k if k < 15 else k - 15:02d}:00;{z}",
        ),
        r"line 17.*summer time",
    ),
    "two readings and no position": (
        table("OUT1 [um],OUT2 [um]", lambda k, x, z: f"{z},{-z}"),
        r"neither 'OUT1 \[um\]' nor 'OUT2 \[um\]' rises",
    ),
    "JSON": ('{"x_mm": [0.0, 0.25, 0.5],\n "z_um": [1.0, 2.0, 3.0]}\n', r"JSON"),
    "braces": (table("", lambda k, x, z: f"{{{x}, {z}}},").lstrip(), r"braces"),
    "XML": ('<?xml version="1.0"?>\n<d><p x="1" z="2"/></d>\n', r"is XML"),
    "a header alone": ("x_mm,z_um\n", r"holds 1 line\(s\) of text and no row of numbers"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_named(put, case):
    text, message = REFUSED[case]

    with pytest.raises((ms.errors.ReadError, ms.errors.UnitError), match=message):
        ms.read(put(text))


def test_groups_with_a_unit_are_read_as_declared(put):
    path = put(table("x;z", lambda k, x, z: f"{k + 1},{100 + k} mm;{10 + k} µm"))

    assert ms.read(path, decimal=",").x[0] == pytest.approx(1.1e-3, rel=0.0, abs=TIGHT)
    assert ms.read(path, thousands=",", decimal=".").x[0] == pytest.approx(1.1, rel=0.0, abs=TIGHT)


ONE_OF_TWO = {  # two marks or two units in one file: the cause is named, and no reading is given up
    "a comma among points": (
        "x_mm,z_um",
        lambda k: f'{k},"0,6447"' if k == 1 else f"{k},0.5",
        "'0,6447'",
    ),
    "a comma far down": (
        "x_mm;z_um",
        lambda k: f"{k};1,1009" if k == 7 else f"{k};0.5",
        "'1,1009'",
    ),
    "a point among commas": (
        "x_mm;z_um",
        lambda k: f"{k - 5}.000;{k},5",
        r"'0\.000'.*others of the file have ','",
    ),
    "nm among um": (
        "x;z",
        lambda k: f"{k}.5 mm;{'2 nm' if k == 3 else '0.5 um'}",
        "'2 nm' in nm, but the rows above have um",
    ),
    "mm under um": (
        "x_mm;z_um",
        lambda k: f"{k}.5;{k}.5 mm",
        r"'0\.5 mm' in mm, but its name says um",
    ),
}


@pytest.mark.parametrize("case", ONE_OF_TWO)
def test_two_marks_or_units_in_one_file_are_named_as_the_cause(put, case):
    top, row, message = ONE_OF_TWO[case]

    with pytest.raises(
        (ms.errors.AmbiguousFormatError, ms.errors.UnitError), match=message
    ) as got:
        ms.read(put(table(top, lambda k, x, z: row(k))))
    assert "skip_lines" not in str(got.value)
    assert "missing=" not in str(got.value)


def test_a_folder_or_a_file_with_our_result_is_called_that(tmp_path):
    (tmp_path / "result.json").write_text('{"characteristics":[{"name":"PV"}]}')

    for path in (tmp_path, tmp_path / "result.json"):
        with pytest.raises(
            ms.errors.ReadError, match=r"result that metrosep wrote.*'metrosep report'"
        ):
            ms.read(str(path))


@pytest.mark.parametrize("name", ["T_degC", "T [degC]", "p_mbar", "ok"])
def test_a_third_column_that_is_no_length_is_left_out_with_a_warning(put, name):
    found = ms.read(put(table(f"x_mm,z_um,{name}", lambda k, x, z: f"{x},{z},{k % 2}")))

    assert found.z.tolist() == [z * 1e-6 for z in Z]
    assert f"column {name!r} is neither a position nor a height" in " ".join(
        found.metadata["warnings"]
    )


LONG = 200_000
LONG_FIELDS = {  # a file with too long a field or remark in a line, and which line is named
    "a remark in quotes": (lambda k: '1,"' + "word " * (LONG // 5) + '"', 5),
    "a remark behind the row": (lambda k: "1 # " + "word " * (LONG // 5), 5),
    "a number in quotes": (lambda k: '"' + "1" * LONG + '"', 5),
    "a number": (lambda k: "1" * LONG, 5),
    "letters": (lambda k: "x" * LONG, 5),
    "a quote that does not close": (lambda k: '"' + "x" * LONG, 5),
    "a name in quotes": (f'x_mm,"z {"n" * LONG} um"', 1),
    "a name": (f"x_mm,z{'n' * LONG}_um", 1),
    "a title in quotes": ('"' + "r " * LONG + '"\nx_mm,z_um', 1),
}


@pytest.mark.parametrize("n", [3, 3000])  # the row within the sample, or far behind
@pytest.mark.parametrize("case", LONG_FIELDS)
def test_a_field_too_long_for_a_table_is_named_with_its_line_and_length(put, case, n):
    odd, line = LONG_FIELDS[case]
    x = [0.25 * k for k in range(n + 20)]
    top, odd = (odd, None) if isinstance(odd, str) else ("x_mm,z_um", odd)
    path = put(table(top, lambda k, x, z: f"{x},{odd(k) if odd and k == n else z}", x, x))

    at = line if odd is None else n + 2
    with pytest.raises(ms.errors.ReadError, match=rf"line {at} has [24]0\d{{4}} characters"):
        ms.read(path)


# x and z of a row between semicolons, and what the message quotes; None where another cell shows the mark
GROUPS = {
    "points, both with a unit": (
        lambda k: f"{k + 1}.000 mm;{k} um",
        r"'1\.000 mm', which is 1\.000 or 1000",
    ),
    "points, without a blank": (lambda k: f"{k + 1}.000mm;{k}um", r"'1\.000mm'"),
    "points, beside plain whole numbers": (lambda k: f"{k + 1}.500 mm;{k}", r"'1\.500 mm'"),
    "commas": (lambda k: f"{k + 1},250 mm;{k} um", r"'1,250 mm'"),
    "plain points": (lambda k: f"{k + 1}.125;{k}", r"'1\.125', which is 1\.125 or 1125"),
    "shown by a quantity": (lambda k: f"{k + 1}.000 mm;{k}.25 um", None),
    "shown by its own column": (lambda k: f"{k}.000 mm;{k} um", None),
    "shown by a plain number": (lambda k: f"{k + 1}.000 mm;{k}.5", None),
    "shown by the last row": (lambda k: f"{k + 1}.000 mm;{'0.5' if k == N - 1 else k} um", None),
}


@pytest.mark.parametrize("case", GROUPS)
def test_one_or_a_thousand_is_refused_with_a_unit_as_without(put, case):
    row, quoted = GROUPS[case]
    path = put(table("x_mm;z_um", lambda k, x, z: row(k)))

    if quoted is None:
        step = ms.read(path).x
        assert step[1] - step[0] == pytest.approx(1e-3, rel=0.0, abs=TIGHT)
    else:
        with pytest.raises(ms.errors.AmbiguousFormatError, match=f"line 2: .*{quoted}"):
            ms.read(path)


# what stands in the column of time, and the seconds from the first row
CLOCKS = {
    "FILETIME": [133500000000000000 + 100_000 * k for k in range(N)],
    "Datum": [f"{45418.5 + k * 0.01 / 86400:.12f}" for k in range(N)],
    "unix time": [1715032790000 + 10 * k for k in range(N)],
    "timestamp": [f"{1715032790000.5 + 10 * k:.1f}" for k in range(N)],
}


@pytest.mark.parametrize("name", CLOCKS)
def test_a_clock_that_counts_from_an_epoch_is_read_with_a_warning(put, name):
    found = ms.read(put(table(f"{name},z_um", lambda k, x, z: f"{CLOCKS[name][k]},{z}")))

    step = np.arange(N) * 0.01
    np.testing.assert_allclose(found.t, step, rtol=0.0, atol=2e-6)  # a day number has 0.6 us
    assert f"column {name!r} has no unit" in " ".join(found.metadata["warnings"])


# a clock of a logger in ms, in us, in ns; whole days; seconds that may be us of a logger
ANY_UNIT = {
    "ms of a logger": ("time", lambda k: 40000 + k),
    "ms with fractions": ("t", lambda k: 40000.25 + k),
    "us of a logger": ("time", lambda k: 1_500_000_000 + 1000 * k),
    "us of a logger called a stamp": ("timestamp", lambda k: 1_500_000_000 + 1000 * k),
    "us that look like LabVIEW": ("time", lambda k: 3_500_000_000 + 1000 * k),
    "us of an uptime of 20 days": ("timestamp", lambda k: 1_728_000_000_000 + 200 * k),
    "ns of an uptime of 20 days": ("Zeitstempel", lambda k: 1_728_000_000_000_000 + 200 * k),
    "ns from the start": ("timestamp", lambda k: 1_700_000_000_000 + 10_000 * k),
    "ns of a week": ("time", lambda k: 1_500_000_000_000_000 + 10_000 * k),
    "whole days": ("Datum", lambda k: 45418 + k),
}


@pytest.mark.parametrize("case", ANY_UNIT)
def test_a_clock_that_may_count_anything_is_refused_until_its_unit_is_given(put, case):
    name, count = ANY_UNIT[case]
    path = put(table(f"{name},z_um", lambda k, x, z: f"{count(k)},{z}"))

    with pytest.raises(ms.errors.UnitError, match=rf"time=\('{name}', 's'\)"):
        ms.read(path)
    t = ms.read(path, time=(name, "ms")).t
    assert t[1] - t[0] == pytest.approx((count(1) - count(0)) * 1e-3, rel=1e-3, abs=0.0)


def test_utf_32_is_text(put):
    text = table("x_mm,z_um", lambda k, x, z: f"{x},{z}")

    assert ms.read(put(text.encode("utf-32"))).z.tolist() == [z * 1e-6 for z in Z]


# name of a column, what stands in rows 10 and 11 (lines 11 and 12) and in the others, whether they are bad
STATUS = [
    ("flag", "bad", "ok", True),
    ("flag", "n.g.", "", True),
    ("status", "not ok", "ok", True),
    ("status", "kein Signal", "", True),
    ("status", "saturated", "ok", True),
    ("status", "sensor fault 5", "no error", True),
    ("Bemerkung", "NG", "", True),
    ("判定", "不良", "良", True),
    ("valid", "False", "True", True),
    ("valid", "no", "yes", True),
    ("valid", "n", "y", True),
    ("isValid", "FALSCH", "WAHR", True),
    ("Gültig", "nein", "ja", True),
    ("in tolerance ok", "0", "1", True),
    ("invalid", "yes", "no", True),
    ("Fehler", "ja", "nein", True),
    ("outlier", "True", "False", True),
    ("not_ok", "1", "0", True),
    ("outlier", "False", "True", False),  # the others are
    ("coolant", "False", "True", False),
    ("flag", "no", "yes", False),
    ("status", "no error", "ok", False),
    ("coolant", "0", "1", False),
    ("note", "we wiped the part with alcohol before this error was seen", "", False),
]


@pytest.mark.parametrize(("name", "one", "other", "bad"), STATUS)
def test_a_word_beside_a_row_that_calls_it_bad_is_reported(put, name, one, other, bad):
    text = table(
        f"x_mm;z_um;{name}", lambda k, x, z: f"{x};{z};{one if k in (2, 9, 10) else other}"
    )

    warnings = " ".join(ms.read(put(text), x="x_mm", z="z_um").metadata["warnings"])

    assert ("skip_lines='4,11-12'" in warnings) == bad
    assert not bad or f"says {one!r} in 3 row(s) (first: line 4)" in warnings
    assert bool(warnings) == (bad or name == "outlier")


def test_lines_of_rows_called_bad_are_all_listed_as_ranges(put):
    path = put(table("x_mm;z_um;outlier", lambda k, x, z: f"{x};{z};{k not in (9, 20)}"))

    (said,) = ms.read(path).metadata["warnings"]

    assert "says 'True' in 28 row(s)" in said
    assert (
        f"if that means that these were not measured well, leave them out with skip_lines='2-10,12-21,23-{N + 1}'"
        in said
    )


def test_a_null_of_a_well_log_is_reported_where_it_stands_once(put):
    path = put(table("x_mm;z_um", lambda k, x, z: f"{x};{-999.25 if k == 11 else z}"))

    assert "holds -999.25 in 1 row(s) (first: line 13)" in " ".join(
        ms.read(path).metadata["warnings"]
    )


def test_the_sign_of_micro_alone_is_a_micrometre_with_a_warning(put):
    found = ms.read(put(table("x [mm];z [µ]", lambda k, x, z: f"{x};{z}")))

    assert found.z.tolist() == [z * 1e-6 for z in Z]
    assert "µ alone" in " ".join(found.metadata["warnings"])


def test_a_comment_within_the_table_that_names_a_unit_is_reported(put):
    lines = table("x_mm;z_um", lambda k, x, z: f"{x};{z}").splitlines()
    plain = put("\n".join([*lines[:11], "# second part, 2026-11-28", *lines[11:], ""]), "a.csv")
    telling = put("\n".join([*lines[:11], "# from here z in nm", *lines[11:], ""]), "b.csv")

    assert ms.read(plain).metadata["warnings"] == ()
    (said,) = ms.read(telling).metadata["warnings"]
    assert said.startswith("line 12: the comment '# from here z in nm'")


def test_marks_without_a_width_are_no_part_of_a_number_or_a_name(put):
    found = ms.read(put(table("\u200ex_mm;z_um\u200b", lambda k, x, z: f"\u200b{x};{z}\u2060")))

    assert found.z.tolist() == [z * 1e-6 for z in Z]


def test_times_of_two_numbers_are_refused_in_chunks_too(put):
    path = put(table("time,z_um", lambda k, x, z: f"00:{k:02d},{z}"))

    with (
        open_stream(path, channels=["time", "z_um"]) as stream,
        pytest.raises(ms.errors.AmbiguousFormatError, match="or minutes and seconds"),
    ):
        list(stream.chunks(10))
    beside = put(table("date,time,z_um", lambda k, x, z: f"2026-11-28,00:{k:02d},{z}"), "b.csv")
    assert ms.read(beside).t[1] == pytest.approx(60.0, rel=0.0, abs=1e-9)


def test_keys_with_numbers_above_names_are_no_row_of_dates(put):
    """A waveform of a data acquisition: its interval stands above the names like a row."""
    top = "delta t\t0,01\t0,01\n\ntime\tA [um]\tB [um]"
    rows = table(top, lambda k, x, z: f"05.03.2026 14:59:{k:02d},50\t{comma(x)}\t{comma(z)}")

    found = ms.read(put(rows))

    np.testing.assert_allclose(found.t, np.arange(N), rtol=0, atol=1e-9)  # stamps are whole ns
    np.testing.assert_allclose(found.channels["B [um]"], np.array(Z) * 1e-6, rtol=0, atol=TIGHT)
    below = rows.replace("time\tA [um]\tB [um]\n", "")
    moved = below.replace("delta t\t0,01\t0,01\n\n", "time\tA [um]\tB [um]\nStart\t0,01\t0,01\n")
    with pytest.raises(ms.errors.ReadError, match="line 2"):  # below the names it is a damaged row
        ms.read(put(moved, "moved.csv"))


def test_a_historian_names_the_unit_of_its_values(put):
    rows = table(
        "Timestamp;Value [µm];Quality",
        lambda k, x, z: f"2026-03-05T14:59:{k:02d}Z;{z};{'Bad' if k == 9 else 'Good'}",
    )

    found = ms.read(put(rows)).channels["value"]

    expected = [math.nan if k == 9 else z * 1e-6 for k, z in enumerate(Z)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=TIGHT)


def test_variables_of_matlab_whose_names_end_in_a_unit(tmp_path):
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"x_mm": np.array(X), "z_um": np.array(Z)})

    found = ms.read(path)

    np.testing.assert_allclose(found.x, np.array(X) * 1e-3, rtol=0, atol=TIGHT)
    np.testing.assert_allclose(found.z, np.array(Z) * 1e-6, rtol=0, atol=TIGHT)


def test_a_zip_with_one_file_is_that_file(tmp_path):
    path = tmp_path / "run.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("run.csv", table("x_mm;z_um", lambda k, x, z: f"{x};{z}"))
        archive.writestr("__MACOSX/._run.csv", b"\0\5\x16\7")
    assert ms.read(path).z.tolist() == [z * 1e-6 for z in Z]

    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("more.csv", "1")
    with pytest.raises(ms.errors.UnknownFormatError):
        ms.read(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb.csv", bytes(2**27))
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="unpack it first"):
        ms.read(path)


@pytest.mark.parametrize(
    "word",
    [
        "OVER",
        "Überlauf",
        "hors gamme",
        "fuori scala",
        "Fuera de rango",
        "超量程",
        "オーバー",
        "-INF",
    ],
)
def test_words_beyond_the_range_in_the_languages_of_instruments(put, word):
    rows = table("x_mm;z_um", lambda k, x, z: f"{x};{word if k in (4, 9) else z}")
    found = ms.read(put(rows))

    assert np.flatnonzero(np.isnan(found.z)).tolist() == [4, 9]
    assert f"2 fields such as '{word}' (first: line 6)" in " ".join(found.metadata["warnings"])


MONTHS = ["14 mars 2026", "14 févr. 2026", "14-août-2026", "14 ago. 2026", "14 ene 2026", "14 luglio 2026"]  # fmt: skip


@pytest.mark.parametrize(("day", "number"), [*zip(MONTHS, (3, 2, 8, 8, 1, 7), strict=True)])
def test_months_in_french_italian_and_spanish(put, day, number):
    found = ms.read(put(table("Date;z_um", lambda k, x, z: f"{day} 10:{k:02d}:00;{z}")))

    assert found.t.tolist() == pytest.approx([60.0 * k for k in range(N)], abs=1e-9)
    assert found.metadata["header"]["clocks"]["Date"].startswith(f"2026-{number:02d}-14T10:00:00")


def test_a_month_that_may_be_two_is_refused(put):
    with pytest.raises(ms.errors.ReadError, match="line 2"):
        ms.read(put(table("Date;z_um", lambda k, x, z: f"14 jui 2026 10:{k:02d}:00;{z}")))


def test_datasets_of_hdf5_whose_names_end_in_a_unit(tmp_path):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["x_mm"], file["z_um"] = X, Z

    found = ms.read(path)

    np.testing.assert_allclose(found.x, np.array(X) * 1e-3, rtol=0, atol=TIGHT)
    np.testing.assert_allclose(found.z, np.array(Z) * 1e-6, rtol=0, atol=TIGHT)


def test_the_last_line_of_a_database_is_no_row(put):
    frame = "+------+------+\n"
    rows = table("| x_mm | z_um |", lambda k, x, z: f"| {x} | {z} |")
    found = ms.read(put(frame + rows + frame + "30 rows in set (0.00 sec)\n"))

    assert found.z.tolist() == [z * 1e-6 for z in Z]
    assert any("30 rows in set" in w for w in found.metadata["warnings"])


def test_a_table_of_r_numbers_its_rows_without_a_name(put):
    rows = table('"x_mm" "z_um"', lambda k, x, z: f'"{k + 1}" {x} {z}')
    found = ms.read(put(rows))

    assert found.x.tolist() == [x * 1e-3 for x in X]
    assert found.z.tolist() == [z * 1e-6 for z in Z]
    with pytest.raises(
        ms.errors.ReadError, match="line 1"
    ):  # a name is lost, no column of numbers
        ms.read(put(table('"x_mm" "z_um"', lambda k, x, z: f'"{x}" {z} {k}')))


def test_dates_written_as_numbers_are_no_counts_of_seconds(put):
    text = table(
        "timestamp;z_um",
        lambda k, x, z: f"20260228{23 + k // 60:02d}{k + 31 if k < 29 else 0:02d}07;{z}",
    )
    text = text.replace("20260228230007", "20260301000007")

    assert ms.read(put(text)).t.tolist() == [60.0 * k for k in range(N)]
    with pytest.raises(ms.errors.UnitError, match="dates written as numbers"):
        ms.read(put(text), time="timestamp:s")


def test_a_comma_between_columns_and_as_decimal_mark_is_named(put):
    rows = table("x_mm,z_um", lambda k, x, z: f"{x:.2f},{z:.4f}".replace(".", ","))
    with pytest.raises(ms.errors.ReadError, match="export it with ';' between the columns"):
        ms.read(put(rows))


def test_points_whose_height_has_another_name_are_a_map(put):
    heights = np.arange(12.0).reshape(3, 4) ** 1.5
    points = [f"{j};{i};{float(heights[i, j])!r}" for i in range(3) for j in range(4)]
    found = ms.read(put("\n".join(["X;Y;Höhe", "µm;µm;nm", *points]) + "\n"))

    np.testing.assert_allclose(found.z, heights * 1e-9, rtol=0, atol=1e-22)
    assert found.dx == pytest.approx(1e-6, abs=1e-18)


def test_a_time_that_falls_is_named_by_its_line(put):
    text = table("t_s;z_um", lambda k, x, z: f"{0.1 * (k if k != 9 else 3):.1f};{z}")
    with pytest.raises(
        ms.errors.ReadError, match=r"line 11: .* falls from 0.8 s to 0.3 s.*skip_lines='11'"
    ):
        ms.read(put(text))
    assert len(ms.read(put(text), skip_lines="11")) == N - 1


@pytest.mark.parametrize(
    ("places", "kept"),
    [
        ([70, *range(1, 60)], range(1, 60)),
        ([-5, *range(60, 0, -1)], range(1, 61)),
        ([*range(40), *range(38, 5, -1)], range(40)),
    ],
    ids=["the first is an outlier", "the first is one, backwards", "a way back"],
)
def test_following_the_hint_where_positions_turn_keeps_most_of_the_rows(put, places, kept):
    path = put("\n".join(["x_mm;z_um", *(f"{x};{x % 7}" for x in places), ""]))
    with pytest.raises(ms.errors.ReadError, match="strictly monotonic") as refused:
        ms.read(path, x="x_mm", z="z_um")

    lines = re.search(r"skip_lines='(.*?)'", str(refused.value)).group(1)
    found = ms.read(path, x="x_mm", z="z_um", skip_lines=lines)

    assert sorted(found.x) == pytest.approx([1e-3 * x for x in kept], abs=TIGHT)


COUNTED = [f"{k} {x} {z}" for k, (x, z) in enumerate(zip(X, Z, strict=True))]
ABOVE_UNITS = ";Weg;Höhe;Bemerkung\n;[mm];[µm];"
HABITS = {
    "pandas to_string: numbered rows have no name": "\n".join(
        ["   x_mm z_um", *COUNTED, ""]
    ).encode(),
    "a nameless counter above a row of units": table(
        ABOVE_UNITS, lambda k, x, z: f"{k};{x};{z};ok"
    ).encode(),
    "the micro sign of GB18030, of which two bytes are digits": table(
        "Weg [mm];Höhe [\u00b5m]", lambda k, x, z: f"{x};{z}"
    ).encode("gb18030"),
    "minus signs of GB18030": table("x [mm];z [um]", lambda k, x, z: f"{x};{z}")
    .replace("-", "\u2212")
    .encode("gb18030"),
    "an empty column and one of temperatures": table(
        "x_mm,spare,T {°C},z_um", lambda k, x, z: f"{x},,20.{k % 9},{z}"
    ).encode(),
    "the count of a database below blanks": (
        table("x_mm z_um", lambda k, x, z: f"{x} {z}") + "(30 rows)\n"
    ).encode(),
    "a title of as many words as columns": table(
        "Roughness profile Ra\n#\tx_mm\tz_um", lambda k, x, z: f"{k}\t{x}\t{z}"
    ).encode(),
    "a nameless counter before names in quotes": table(
        ',"Weg {mm}","Höhe {µm}"', lambda k, x, z: f"{k},{x},{z}"
    ).encode(),
    "units below names, and a footer": (
        "Device: P7\nRate: 1\n"
        + table("Weg,Höhe,Remark,spare\n[mm],[µm],,", lambda k, x, z: f"{x},{z},,")
        + "End of file\n"
    ).encode("utf-16"),
}


TITLED = ["Straightness guide", "Mean error", "  Position error", "Weg Abweichung"]


@pytest.mark.parametrize("title", [*TITLED, "Roughness profile"])
@pytest.mark.parametrize("mark", [" ", "\t"])
def test_a_title_above_numbered_rows_is_no_row_of_names(put, title, mark):
    """The first column counts like the rows of pandas, and may as well be the position."""
    rows = [mark.join(f"{v}" for v in (k, 0.5 * k, k * k)) for k in range(5)]

    with pytest.raises(ms.errors.ReadError, match=r"neither a row of 3 names|without names"):
        ms.read(put("\n".join([title, *rows, ""])), unit="um")
    named = ms.read(put("\n".join([title, f"# k{mark}x_mm{mark}z_um", *rows, ""])))
    assert named.x.tolist() == [0.5e-3 * k for k in range(5)]


def test_names_without_units_right_above_numbered_columns_are_names(put):
    rows = [f"{k}  {0.5 * k:4.2f}  {k * k:4d}" for k in range(5)]  # pandas and R print so
    found = ms.read(put("\n".join(["      x     z", *rows, ""])), x="x:mm", z="z:um")

    assert found.x.tolist() == [0.5e-3 * k for k in range(5)]


@pytest.mark.parametrize("habit", HABITS)
def test_habits_of_writers_change_no_value(tmp_path, habit):
    path = tmp_path / "data.csv"
    path.write_bytes(HABITS[habit])

    profile = ms.read(path)

    assert profile.x == pytest.approx([v * 1e-3 for v in X], abs=TIGHT)
    assert profile.z == pytest.approx([v * 1e-6 for v in Z], abs=TIGHT)


@pytest.mark.parametrize(
    ("top", "row", "damaged"),
    [
        ("x_mm;z_um;remark", lambda k, x, z: f"{x};{z};", "2.5;"),
        ("x_mm;z_um;spare;remark", lambda k, x, z: f"{x};{z};;ok", "2.5;;ok"),
    ],
    ids=["words that are empty in other rows", "a word in a column that was empty"],
)
def test_a_lost_field_before_a_column_of_words_is_refused_by_its_line(put, top, row, damaged):
    lines = table(top, row).split("\n")
    lines[11] = damaged
    lines[25] += "hit" * lines[25].endswith(";")

    with pytest.raises(ms.errors.ReadError, match="line 12"):
        ms.read(put("\n".join(lines)))


def test_numbers_among_words_below_a_unit_are_refused_not_dropped_with_the_words(put):
    readings = ["limit"] * 20 + ["0.25"] * 10
    path = put(table("x_mm,z_um,Error [um]", lambda k, x, z: f"{x},{z},{readings[k]}"))

    with pytest.raises(ms.errors.ReadError, match=r"line 2,.*'limit'"):
        ms.read(path)

    table_of = ms.read(path, missing="limit", x="x_mm", z="Error [um]")
    assert np.isfinite(table_of.z).sum() == 10


@pytest.mark.parametrize("name", ["Spindle_s", "Axis_m", "Remark [s]"])
def test_words_and_numbers_in_a_column_that_is_not_asked_for_are_a_warning(put, name):
    path = put(
        table(f"x_mm;z_um;{name}", lambda k, x, z: f"{x};{z};{'3' if 5 <= k < 12 else 'S1'}")
    )

    profile = ms.read(path, x="x_mm", z="z_um")

    assert profile.z.tolist() == [z * 1e-6 for z in Z]
    (said,) = (w for w in profile.metadata["warnings"] if name in w)
    assert "'S1' in line 2" in said
    assert len(ms.read_runs(path, x="x_mm", z="z_um")[0].z) == N
    for asked in ({}, {"x": "x_mm", "z": name}):
        with pytest.raises(ms.errors.ReadError, match=r"line 2,.*'S1'"):
            ms.read(path, **asked)
    with pytest.raises(ms.errors.ReadError, match="name those that are, x= and z="):
        ms.read(path)


@pytest.mark.parametrize("name", ["Error", "Sensor", "Target"])
@pytest.mark.parametrize("place", [0, 2])
def test_a_late_word_below_a_name_that_may_be_a_number_loses_no_row(put, name, place):
    n = 4000  # the word stands where no sample of the rows looks
    names, rows = ["x_mm", "z_um"], []
    names.insert(place, name)
    for k in range(n):
        row = [f"{k * 0.01:.2f}", f"{k % 7 / 10}"]
        row.insert(place, "limit switch" if k == 3123 else "")
        rows.append(",".join(row))

    profile = ms.read(put("\n".join([",".join(names), *rows, ""])))

    assert profile.z == pytest.approx([k % 7 * 1e-7 for k in range(n)], abs=TIGHT)
    assert profile.x[-1] == pytest.approx(39.99e-3, abs=TIGHT)
