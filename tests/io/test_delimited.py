"""Column text: dialects, headers, units, real files, and what must be refused."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile, open_file
from metrosep.io.text import delimited

NM = 1e-9
AM = 1e-18
X = np.array([0.0, 0.5, 1.0, 1.5]) * 1e-3
Z = np.array([0.25, -1.5, 3.0, 1234.5]) * 1e-6
ROWS = [("0", "0.25"), ("0.5", "-1.5"), ("1.0", "3"), ("1.5", "1.2345e3")]


def text(separator, decimal, header="x_mm{s}z_um"):
    lines = [header.format(s=separator)] if header else []
    lines += [(a + separator + b).replace(".", decimal) for a, b in ROWS]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("separator", "decimal"),
    [
        (",", "."),
        (", ", "."),
        (" , ", "."),
        (";", "."),
        (";", ","),
        ("; ", ","),
        ("\t", "."),
        ("\t", ","),
        (" ", "."),
        (" ", ","),
        ("    ", "."),
        (" \t ", ","),
    ],
)
@pytest.mark.parametrize("header", ["x_mm{s}z_um", ""], ids=["header", "none"])
def test_every_dialect_gives_the_same_numbers(put, separator, decimal, header):
    options = {} if header else {"unit": ("mm", "um")}

    profile = ms.read(put(text(separator, decimal, header)), **options)

    np.testing.assert_allclose(profile.x, X, rtol=1e-15, atol=AM)
    np.testing.assert_allclose(profile.z, Z, rtol=1e-15, atol=AM)


@pytest.mark.parametrize(
    ("x_name", "z_name"),
    [
        ("x_mm", "z_um"),
        ("x [mm]", "z [um]"),
        ("Position (mm)", "Height (\u00b5m)"),
        ("x in mm", "y in \u03bcm"),
        ("s / mm", "h/um"),
        ("Length mm", "Height um"),
        ('"x_mm"', '"z_um"'),
    ],
)
def test_units_of_a_header(put, x_name, z_name):
    profile = ms.read(put(text(";", ",", f"{x_name};{z_name}")))

    np.testing.assert_allclose(profile.x, X, rtol=1e-15, atol=AM)
    np.testing.assert_allclose(profile.z, Z, rtol=1e-15, atol=AM)


@pytest.mark.parametrize("name", ["feed mm/min", "feed / mm/min", "feed_mm/min", "feed [mm/min]"])
def test_a_speed_in_a_header_is_no_time(put, name):
    rows = [f"a;4800;{i};{80 * i};{i % 7}" for i in range(40)]
    file = put("\n".join([f"run;{name};t ms;x um;z nm", *rows]))
    runs = ms.read_runs(file, x="x um", z="z nm", feed=name, run="run", time="t ms")

    assert runs[0].feed == pytest.approx(0.08, abs=1e-12)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "latin-1"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\r\r\n"])
def test_encodings_and_line_ends(put, encoding, end):
    content = text("\t", ",", "Weg / mm\tH\u00f6he / \u00b5m").replace("\n", end)

    profile = ms.read(put(content.encode(encoding)))

    np.testing.assert_allclose(profile.z, Z, rtol=1e-15, atol=AM)


def test_numbers_are_read_to_the_last_bit(put, rng):
    values = rng.normal(size=500) * 10.0 ** rng.integers(-12, 3, size=500)
    lines = [f"{i},{v!r}" for i, v in enumerate(values.tolist())]

    profile = ms.read(put("x_m,z_m\n" + "\n".join(lines)))

    np.testing.assert_array_equal(profile.z, values)


def test_descending_positions_are_turned_with_their_heights(put):
    profile = ms.read(put("x_mm,z_um\n3,30\n2,20\n1,\n0,0\n"))

    np.testing.assert_allclose(profile.x, [0, 1e-3, 2e-3, 3e-3], rtol=1e-15, atol=AM)
    np.testing.assert_allclose(profile.z, [0, np.nan, 2e-5, 3e-5], rtol=1e-15, atol=AM)


@pytest.mark.parametrize("word", ["", " ", "nan", "NaN", "-", "--", "n/a", "No Data", "null"])
def test_words_for_not_measured(put, word):
    profile = ms.read(put(f"x_mm;z_um\n0;1\n1;{word}\n2;3\n"))

    assert np.isnan(profile.z).tolist() == [False, True, False]


def test_comment_above_the_numbers_names_the_columns(put):
    profile = ms.read(put("# made by numpy\n# x_mm z_um\n0 1\n1 2\n"))

    assert profile.x[1] == pytest.approx(1e-3, abs=AM)
    assert profile.metadata["header"]["comments"] == ("made by numpy", "x_mm z_um")


def test_count_above_the_numbers_is_a_hint(put):
    profile = ms.read(put("mm um\n7\n0 1\n1 2\n"))

    assert len(profile) == 2
    assert "declares 7 rows and holds 2" in profile.metadata["warnings"][0]


@pytest.mark.parametrize(
    ("content", "options", "n_columns"),
    [
        ("0,123\n1,456\n", {"separator": ",", "unit": "um"}, 2),
        ("0,123\n1,456\n", {"decimal": ",", "unit": "um", "lateral_step": "1 um"}, 1),
        ("x_um,z_um\n0,123\n1,456\n", {}, 2),
        ("1,5, 2,5\n2,5, 3,5\n", {"decimal": ",", "unit": "um"}, 2),
        ("x_um, z_um\n1,5, 2,5\n2,5, 3,5\n", {}, 2),
        ("5,123.4\n6,223.4\n", {"separator": "comma", "unit": "um"}, 2),
        ("x_um,z_um\n5,123.4\n6,223.4\n", {}, 2),
        ("5,123.4\n6,23.4\n", {"unit": "um"}, 2),
        ("z_um\n0,5\n1,5\n2\n", {"lateral_step": "1 um"}, 1),
    ],
)
def test_ambiguity_is_decided_by_header_or_caller(put, content, options, n_columns):
    profile = ms.read(put(content), **options)

    assert len(profile.metadata["header"]["columns"]) == n_columns


@pytest.mark.parametrize(
    "content",
    [
        "0,123\n1,456\n",
        "1,5, 2,5\n2,5, 3,5\n",
        "1,234.5;2,345.6\n",
        "1.234,5;2.345,6\n",
        "1,234.5,2,345.6\n2,234.5,3,345.6\n",
        "5,123.4\n6,223.4\n",
    ],
)
def test_ambiguity_and_thousands_are_refused(put, content):
    with pytest.raises(ms.errors.AmbiguousFormatError, match=r"thousands|separator="):
        ms.read(put(content), unit="um")


@pytest.mark.parametrize(
    "content",
    [
        "1'234.5;2'345.6\n3'234.5;4'345.6\n",
        "1\u2019234.5;2\u2019345.6\n3\u2019234.5;4\u2019345.6\n",
        "1 234,5;2 345,6\n3 234,5;4 345,6\n",
        "1\u202f234,5;2\u00a0345,6\n3\u2009234,5;4 345,6\n",
        "1 234.5\t2 345.6\n3 234.5\t4 345.6\n",
        "1,234.5\t2,345.6\n3,234.5\t990.5\n4234.5\t4,345.6\n",
    ],
)
def test_groups_of_digits_whose_mark_can_be_nothing_else_are_read(put, content):
    profile = ms.read(
        put(f"x;z\n{content}".replace(";" if "\t" in content else "\0", "\t")), unit="um"
    )

    expected = [1234.5, 3234.5, 4234.5][: len(profile)]
    assert (profile.x / 1e-6).tolist() == pytest.approx(expected, rel=1e-14, abs=0.0)
    assert profile.z[0] == pytest.approx(2345.6e-6, rel=1e-14, abs=0.0)


def test_missing_unit_names_the_column_and_the_remedy(put):
    with pytest.raises(ms.errors.UnitError, match=r"'gap' \(z\) declares no unit.*'gap_um'"):
        ms.read(put("x_mm,gap\n0,1\n1,2\n"))


def test_unit_of_another_dimension_is_refused(put):
    with pytest.raises(ms.errors.UnitError, match=r"is in deg \(angle\)"):
        ms.read(put("x_deg,z_um\n0,1\n1,2\n"))


def test_volts_need_a_sensitivity_and_keep_its_sign(put):
    path = put("x_mm,probe_V\n0,1\n1,2\n")

    with pytest.raises(ms.errors.UnitError, match=r"scale='2.5 um/V'"):
        ms.read(path)
    assert ms.read(path, scale="-2.5 um/V").z.tolist() == pytest.approx([-2.5e-6, -5e-6], abs=AM)


def test_header_and_caller_must_not_contradict(put):
    path = put("x_mm,z_um\n0,1\n1,2\n")

    with pytest.raises(ms.errors.FormatMismatchError, match="'x_mm' is in mm by its header"):
        ms.read(path, x=("x_mm", "um"), z="z_um")
    with pytest.raises(ms.errors.FormatMismatchError, match="declares its own unit"):
        ms.read(path, unit="nm")


def test_unit_row_and_name_must_not_contradict(put):
    with pytest.raises(ms.errors.FormatMismatchError, match="correct the header"):
        ms.read(put("x_mm;z_um\nmm;nm\n0;1\n1;2\n"))


@pytest.mark.parametrize(
    "options",
    [
        {"x": "pos:mm", "z": "probe 2:nm"},
        {"x": ("pos", "mm"), "z": ("PROBE 2", "nm")},
        {"x": "pos", "z": "probe 2", "unit": {"pos": "mm", "probe 2": "nm"}},
        {"x": "pos", "z": "probe 2", "unit": ("mm", "um", "nm")},
    ],
)
def test_columns_are_selected_with_their_unit(put, options):
    profile = ms.read(put("pos,probe 1,probe 2\n0,1,7\n1,2,8\n"), **options)

    assert profile.x.tolist() == pytest.approx([0, 1e-3], abs=AM)
    assert profile.z.tolist() == pytest.approx([7e-9, 8e-9], abs=AM)


def test_missing_column_lists_those_there_are(put):
    with pytest.raises(
        ms.errors.FormatMismatchError,
        match=r"the columns are x_mm, z_um, q; did you mean 'z_um'",
    ):
        ms.read(put("x_mm,z_um,q\n0,1,1\n1,2,1\n"), x="x_mm", z="z_umm")


def test_bare_name_that_fits_twice_is_refused(put):
    with pytest.raises(ms.errors.FormatMismatchError, match="z_um or z_nm"):
        ms.read(put("x_mm,z_um,z_nm\n0,1,1\n1,2,1\n"), x="x_mm", z="z")


def test_three_columns_without_a_time_are_refused_with_advice(put):
    with pytest.raises(
        ms.errors.FormatMismatchError, match=r"x= and z=.*sampling_rate=.*read_runs"
    ):
        ms.read(put("run,x_mm,z_um\n0,1,1\n0,2,1\n"))


def test_sampling_rate_makes_a_recording(put):
    recording = ms.read(put("a_mV,b\n1,2\n3,4\n"), sampling_rate="2 kHz")

    assert recording.t.tolist() == [0.0, 0.5e-3]
    assert recording["a_mV"].tolist() == pytest.approx([1e-3, 3e-3], abs=AM)
    assert dict(recording.units) == {"a_mV": "V"}


def test_time_without_unit_is_refused(put):
    with pytest.raises(ms.errors.UnitError, match="'time'"):
        ms.read(put("time,gap_um\n0,1\n1,2\n"))


def test_heights_alone_need_a_step(put):
    path = put("z_nm\n1\n2\n4\n")

    with pytest.raises(ms.errors.FormatMismatchError, match="lateral_step="):
        ms.read(path)
    assert ms.read(path, lateral_step="2 um").x.tolist() == [0.0, 2e-6, 4e-6]


@pytest.mark.parametrize(
    ("content", "names"),
    [
        ("x_mm,z_um,\n0,1,,\n1,2,,\n", ("x_mm", "z_um")),
        ("x_mm;z_um;\n0;1;\n1;2;\n", ("x_mm", "z_um")),
        ("x_mm,z_um,spare_um\n0,1,\n1,2,\n", ("x_mm", "z_um", "spare_um")),
    ],
)
def test_empty_last_columns_count_only_with_a_name(put, content, names):
    profile = ms.read(put(content), x="x_mm", z="z_um")

    assert profile.metadata["header"]["columns"] == names


def test_step_does_not_replace_positions(put):
    with pytest.raises(ms.errors.FormatMismatchError, match="cannot replace"):
        ms.read(put("x_mm,z_um\n0,1\n1,2\n"), lateral_step=1e-6)


def test_titles_above_the_names_are_kept_as_they_stand(put):
    titles = [
        "Straightness of X, spring",
        "by hand, on the flat, no. 2",
        "Sclr,0.156",
        "Machine,M3",
    ]
    path = put("\n".join([*titles, "x_mm,z_um", "0,1", "1,2", ""]))

    profile = ms.read(path)

    assert profile.x.tolist() == [0.0, 1e-3]
    assert profile.z.tolist() == pytest.approx([1e-6, 2e-6], rel=1e-15, abs=0.0)
    lines = profile.metadata["lines"]
    assert (lines["preamble"], lines["names"], lines["data"]) == (4, 1, 2)
    assert lines["listed"]["preamble"]["numbers"] == "1-4"
    assert lines["listed"]["preamble"]["texts"] == tuple(titles)


@pytest.mark.parametrize(
    ("above", "line"),
    [
        (["x_mm,z_um", "probe, tilted"], 1),  # which of the two are the names?
        (["x_mm,z_um", "the probe was tilted"], 2),
        (["1.O5,0.3", "x_mm,z_um"], 1),
        (["x_mm,y_mm,z_um"], 1),
    ],
)
def test_a_line_above_the_numbers_that_may_be_names_or_a_row_is_refused(put, above, line):
    with pytest.raises(ms.errors.ReadError, match=rf"line {line}\b"):
        ms.read(put("\n".join([*above, *(f"{i}.5,{i * i}" for i in range(9)), ""])), unit="um")


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ("x_mm,z_um\n0,1\n1,2,3\n2,3\n3,4\n", r"line 3|line 2"),
        ("x_mm,z_um\n0,1\n1,2\n2,3\n3", "middle of a row"),
        ("x_mm,z_um\n0,1\n1,1e999\n2,3\n", "line 3"),
        ("x_mm,z_um\n0,1\n1,1_0\n2,3\n", "1_0"),
        ("x_mm,z_um\n0,1\n1,2\n1,3\n", "not strictly monotonic"),
        ("x_mm,z_um\n0,1\n,2\n2,3\n", "position x is NaN"),
        ("x_mm,z_um\n0,\n1,\n2,\n", "own|no number|table"),
        ('x_mm,z_um\n0,"1\n1,2\n2,3\n', "quote|fields|number"),
    ],
)
def test_damaged_rows_are_read_errors(put, content, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(content))


@pytest.mark.parametrize(
    "word", ["inf", "-INF", "OL", "overflow", "\u221e", "out of range", "1.#INF"]
)
def test_a_reading_beyond_the_range_is_not_measured_and_said(put, word):
    profile = ms.read(put(f"x_mm,z_um\n0,1\n1,{word}\n2,3\n"))

    assert np.isnan(profile.z).tolist() == [False, True, False]
    (said,) = profile.metadata["warnings"]
    assert word in said
    assert "line 3" in said
    assert "out of its range" in said


@pytest.mark.parametrize("mark", ["#", "%"])
def test_a_remark_behind_a_row_is_kept_and_said(put, mark):
    profile = ms.read(put(f"x_mm,z_um\n0,1\n1,2 {mark} door opened\n2,3\n"))

    assert profile.z.tolist() == pytest.approx([1e-6, 2e-6, 3e-6], rel=1e-15, abs=0.0)
    (said,) = profile.metadata["warnings"]
    assert "line 3" in said
    assert "door opened" in said
    assert profile.metadata["lines"]["data"] == 3


@pytest.mark.parametrize(
    "remark",
    [
        "x1000", "in nm", "nm!", "E-3", "NG", "n.g.", "outlier", "unit nm", "µm", "mm (by hand)", "rejected",
        "Fehler", "ungültig", "UNGUELTIG", "Ausreißer", "faux", "malo", "無効", "door opened, 3 s",
    ],
)  # fmt: skip
@pytest.mark.parametrize("mark", [";", " # "])
def test_a_remark_that_may_change_its_row_is_refused_by_its_line(put, remark, mark):
    rows = [f"{i};0.{i}" + (mark + remark if i == 3 else "") for i in range(8)]

    with pytest.raises(ms.errors.ReadError, match=r"line 5\b.*skip_lines='5'"):
        ms.read(put("\n".join(["x_mm;z_um", *rows]) + "\n"))


@pytest.mark.parametrize("remark", ["door opened", "checked in Jena", "Tür offen", "ok"])
@pytest.mark.parametrize("mark", [";", " # "])
def test_a_remark_of_other_words_costs_nothing(put, remark, mark):
    rows = [f"{i};0.{i}" + (mark + remark if i == 3 else "") for i in range(8)]

    profile = ms.read(put("\n".join(["x_mm;z_um", *rows]) + "\n"))

    assert profile.z[3] == pytest.approx(0.3e-6, rel=0.0, abs=1e-18)
    assert remark in profile.metadata["warnings"][0]


def test_an_empty_quoted_cell_at_the_start_of_a_row_is_no_comment(put):
    profile = ms.read(put('"z_um";"x_mm"\n"1";"0"\n"";"1"\n"3";"2"\n'))

    assert profile.x.tolist() == [0.0, 1e-3, 2e-3]
    assert np.isnan(profile.z).tolist() == [False, True, False]


def test_bad_field_far_down_is_named_by_its_line(put):
    rows = [f"{i},{i}" for i in range(2000)]
    rows[1500] = "1500,4x2"

    with pytest.raises(ms.errors.CorruptFileError, match=r"line 1502.*'4x2'"):
        ms.read(put("x_mm,z_um\n" + "\n".join(rows)))


def test_row_with_a_field_too_many_far_down_is_named(put):
    rows = [f"{i},{i}" for i in range(2000)]
    rows[1500] = "1500,4,2"

    with pytest.raises(ms.errors.CorruptFileError, match=r"line 1502.*expected 2 fields.*found 3"):
        ms.read(put("x_mm,z_um\n" + "\n".join(rows)))


def test_encoding_that_does_not_fit_is_named(put):
    with pytest.raises(ms.errors.ReadError, match="encoding="):
        ms.read(put("x_mm,h\u00f6he_um\n0,1\n".encode("latin-1")), encoding="utf-8")


def test_incomplete_grid_has_gaps_and_irregular_points_are_refused(put):
    surface = ms.read(put("x_mm y_mm z_um\n0 0 1\n1 0 2\n0 1 3\n"))

    np.testing.assert_array_equal(np.isnan(surface.z), [[False, False], [False, True]])
    with pytest.raises(ms.errors.FormatMismatchError, match="regular grid"):
        ms.read(put("x_mm y_mm z_um\n0 0 1\n1 0 2\n2.3 1 3\n"))
    with pytest.raises(ms.errors.FormatMismatchError, match="same place"):
        ms.read(put("x_mm y_mm z_um\n0 0 1\n1 0 2\n1 0 3\n0 1 1\n"))


def test_grid_that_would_not_fit_into_memory_is_refused(put):
    points = "x_mm y_mm z_um\n0 0 1\n1 1 1\n100000 100000 1\n"

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="pixels"):
        ms.read(put(points))


@pytest.mark.parametrize(
    ("name", "options", "n", "n_invalid", "pv_nm", "sq_nm"),
    [
        ("st/csv-1.csv", {"unit": "um"}, 8, 0, 154.44, 47.22499),
        ("st/csv-3.csv", {}, 8, 0, 0.0, 0.0),
        ("st/opdx-3.txt", {"unit": "m"}, 3001, 0, 17.15182, 5.307509),
        ("st/xy-1.txt", {"unit": "um"}, 132, 0, 1.33052e4, 3.126835e3),
        ("st/xy-2.txt", {"unit": ("um", "um")}, 24, 0, 1.19288e4, 4.00167e3),
        ("st/xy-3.txt", {"unit": "nm"}, 11, 0, 1.0, 0.2874798),
        ("st/xy-4.txt", {"unit": "mm"}, 10001, 0, 5.7078e4, 8641.846),
        ("st/nonuniform.asc", {"unit": "um"}, 134, 0, 6.140568e4, 1.402919e4),
        ("upm/1021-WLI-2D.csv", {"unit": "um"}, 1143, 144, 1258.895, 302.3574),
        ("upm/1023-WLI-2D.csv", {"unit": "um"}, 1047, 52, 434.0051, 93.05667),
        ("upm/1021-contour.DAT", {}, 12001, 0, 5407985, 1691867),
    ],
)
def test_real_profiles_as_independent_readers_give_them(
    corpus, name, options, n, n_invalid, pv_nm, sq_nm
):
    """Manifest of the corpus (its numbers are in the unit of the file, here scaled)."""
    profile = ms.read(corpus / name, **options)

    assert len(profile) == n
    assert profile.n_invalid == n_invalid
    assert profile.peak_to_valley() == pytest.approx(pv_nm * NM, rel=1e-6, abs=1e-6 * NM)
    assert profile.rms() == pytest.approx(sq_nm * NM, rel=1e-6, abs=1e-6 * NM)


def test_real_stylus_export_below_its_parameters(corpus):
    """Its 27 lines of parameters, one of them a table of words; numbers of the manifest."""
    path = corpus / "st" / "dektak-1.csv"

    profile = ms.read(path, skip_rows=1, unit={"Raw Micrometer": "um"}, format="delimited")

    assert profile.metadata["lines"]["preamble"] == 24
    assert len(profile) == 9600
    assert profile.peak_to_valley() == pytest.approx(16590.45 * NM, rel=1e-6, abs=0.0)
    assert profile.rms() == pytest.approx(4764.233 * NM, rel=1e-6, abs=0.0)


def test_real_contour_runs_backwards(corpus):
    path = corpus / "upm" / "1021-contour.DAT"
    first = path.read_text().split("\n")[2].split(",")

    profile = ms.read(path)

    assert profile.x[-1] == pytest.approx(float(first[0]) * 1e-3, rel=1e-15, abs=0.0)
    assert profile.z[-1] == pytest.approx(float(first[1]) * 1e-3, rel=1e-15, abs=0.0)


def test_real_utf16_table_by_bare_names(corpus):
    profile = ms.read(corpus / "st" / "csv-2.csv", x="x", z="y")

    assert profile.metadata["header"]["columns"] == ("index", "x in \u00b5m", "y in \u00b5m")
    assert profile.dx == pytest.approx(83.33333e-9, rel=1e-6, abs=0.0)


@pytest.mark.parametrize(
    "name",
    [
        "st/nonsense_txt_file.txt",
        "lvm/short.lvm",
        "st/al3d-1.al3d",
        "st/sdf-1.sdf",
        "st/opd-1.opd",
    ],
)
def test_what_is_no_table_is_not_taken_for_one(corpus, name):
    path = corpus / name

    assert delimited.sniff(RawFile(path, open_file(path).head)) is Match.NO


@pytest.mark.parametrize(
    ("encoding", "names"),
    [
        ("cp932", ("高さ", "位置")),
        ("gb18030", ("直线度", "位置")),
        ("big5", ("高度", "位置")),
        ("cp1252", ("Höhe", "déplacement")),
        ("mac_roman", ("écart", "posición")),
    ],
)
def test_names_in_a_legacy_encoding_are_read(put, encoding, names):
    """Both columns rise and the height stands first: only the names tell which is which."""
    text = f"{names[0]} [um],{names[1]} [mm]\n0,0\n1,0.5\n2,1\n"

    profile = ms.read(put(text.encode(encoding)))

    assert profile.x.tolist() == [0.0, 5e-4, 1e-3]
    assert profile.metadata["warnings"] == ()


@pytest.mark.parametrize(
    ("encoding", "units"),
    [("cp1251", ("мм", "мкм")), ("gb18030", ("毫米", "微米")), ("cp932", ("ミリ", "ミクロン"))],
)
def test_units_of_a_legacy_encoding_are_read(put, encoding, units):
    profile = ms.read(
        put(f"x [{units[0]}];z [{units[1]}]\n0;0,5\n1;2,5\n2;1,5\n".encode(encoding))
    )

    assert profile.x.tolist() == [0.0, 1e-3, 2e-3]
    assert profile.z.tolist() == pytest.approx([0.5e-6, 2.5e-6, 1.5e-6], rel=1e-15, abs=0.0)


def test_names_in_an_unknown_encoding_say_how_to_name_it(put):
    path = put("軸 [mm],隙間 [um]\n0,1\n1,2\n2,3\n".encode("cp932"))

    assert any("encoding='shift_jis'" in w for w in ms.read(path).metadata["warnings"])
    with pytest.raises(ms.errors.FormatMismatchError, match="encoding="):
        ms.read(path, x="position", z="height")
    assert all(
        "encoding" not in w for w in ms.read(path, encoding="shift_jis").metadata["warnings"]
    )


def test_a_letter_across_the_edge_of_the_head_does_not_hide_a_table(put):
    rows = "0,1\n" * ((65536 - 15) // 4 - 2)
    text = "x_mm,z_um\n0,1\n" + rows
    path = put(text + "#" * (65535 - len(text)) + "é\n" + "0,1\n", "long.csv")

    assert ms.io.registry.identify(path).id == "delimited"
