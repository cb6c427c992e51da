"""Rows that lack their last fields, and columns of one name: what is read is named, what is in doubt refused."""

import numpy as np
import pytest

import metrosep as ms

N = 40
X = np.arange(N) * 0.25
Z = np.arange(N) % 7 * 0.5 - 1.0
T = 20.0 + np.arange(N) % 3


def put(tmp_path, names, row, mark=";"):
    path = tmp_path / "a.csv"
    rows = [mark.join(map(str, row(k))) for k in range(N)]
    path.write_text("\n".join([names.replace(";", mark), *rows]) + "\n")
    return path


def full(k):
    return (X[k], Z[k], T[k])


def from_row(first):
    return lambda k: full(k)[: 3 if k < first else 2]


@pytest.mark.parametrize("mark", [";", ",", "\t"])
@pytest.mark.parametrize("first", [0, 3, 17, N - 2])
def test_rows_that_lack_their_last_number_from_one_on(tmp_path, mark, first):
    path = put(tmp_path, "t_s;z_um;temp_um", from_row(first), mark)

    read = ms.read(path)

    assert np.array_equal(read.t, X)
    assert np.array_equal(read.channels["z_um"], Z * 1e-6)
    if first:
        third = read.channels["temp_um"]
        assert np.array_equal(third[:first], T[:first] * 1e-6)
        assert np.isnan(third[first:]).all()
    said = next(w for w in read.metadata["warnings"] if "fewer fields" in w)
    assert f"{N - first} rows have" in said
    assert f"line {first + 2}" in said
    assert "'temp_um'" in said


@pytest.mark.parametrize("told", [{4}, set(range(3, N, 5)), set(range(N)) - {2, 9}])
def test_a_remark_behind_some_rows_leaves_the_others_whole(tmp_path, told):
    path = put(tmp_path, "x_mm;z_um;note", lambda k: (*full(k)[:2], *["ok"] * (k in told)))

    read = ms.read(path)

    assert np.array_equal(read.x, X * 1e-3)
    assert np.array_equal(read.z, Z * 1e-6)
    assert any(f"{N - len(told)} row" in w for w in read.metadata["warnings"])


# row: the line that must be named
ODD = {
    "one short row among full ones": (lambda k: full(k)[: 2 if k == 5 else 3], 7),
    "two short rows among full ones": (lambda k: full(k)[: 2 if k in (5, 6) else 3], 7),
    "the last row": (from_row(N - 1), N + 1),
    "rows that end in different columns": (
        lambda k: full(k)[: 3 if k < 30 else 2 if k < 35 else 1],
        37,
    ),
    "shorter rows behind an empty line": (
        lambda k: full(k) if k < 36 else ("",) if k == 36 else full(k)[:2],
        39,
    ),
    "a row with one more": (lambda k: (*full(k), 1) if k == 0 else full(k), 2),
}


@pytest.mark.parametrize("odd", ODD)
def test_what_may_be_damage_is_refused_by_its_line(tmp_path, odd):
    row, line = ODD[odd]

    with pytest.raises(ms.errors.ReadError, match=rf"line {line}\b"):
        ms.read(put(tmp_path, "x_mm;z_um;temp_C", row))


@pytest.mark.parametrize("between", ["", "# means of repeats"])
@pytest.mark.parametrize("noted", [True, False])
def test_a_table_below_is_not_read_as_rows_that_lack_a_field(tmp_path, between, noted):
    """Rows with words behind them, or two short rows of numbers before the line between."""
    path = put(tmp_path, "x_mm;z_um;note", lambda k: (*full(k)[:2], "ok"))
    if not noted:
        path = put(tmp_path, "x_mm;z_um;temp_C", from_row(N - 2))
    with path.open("a") as stream:
        stream.write(f"{between}\n100;999\n101;998\n")

    with pytest.raises(ms.errors.ReadError, match=rf"line {N + 3}\b"):
        ms.read(path)


def test_a_last_row_without_its_word_and_its_end_is_cut(tmp_path):
    path = put(tmp_path, "x_mm;z_um;note", lambda k: (*full(k)[:2], "ok"))
    with path.open("a") as stream:
        stream.write("100;99")  # of 100;997;ok

    with pytest.raises(ms.errors.ReadError, match=r"ends in the middle of a row"):
        ms.read(path)


def test_a_comma_within_a_name_is_no_column_more(tmp_path):
    path = put(tmp_path, "Position; X;Deviation", lambda k: full(k)[:2], ",")

    with pytest.raises(ms.errors.UnitError, match="'X,Deviation'"):
        ms.read(path)


@pytest.mark.parametrize("mark", [";", ","])
def test_a_position_or_a_reading_that_all_rows_lack_may_be_any_of_them(tmp_path, mark):
    path = put(tmp_path, "x_mm;y_mm;z_um", lambda k: full(k)[:2], mark)

    with pytest.raises(ms.errors.ReadError, match="line 1"):
        ms.read(path)


def test_columns_of_one_name_are_named(tmp_path):
    path = put(tmp_path, "x_mm;z_um;z_um", full)

    read = ms.read(path, x="x_mm", z="z_um (2)")

    assert np.array_equal(read.z, T * 1e-6)
    assert any("'z_um', 'z_um (2)'" in w for w in read.metadata["warnings"])
    assert any("'z_um (2)'" in w for w in ms.read(path, x="x_mm", z="z_um").metadata["warnings"])
    with pytest.raises(ms.errors.ReadError, match=r"z_um, z_um \(2\)"):
        ms.read(path)


def test_labels_of_rows_that_lack_them_are_empty(tmp_path):
    path = put(
        tmp_path, "run;x_mm;z_um;note", lambda k: (1 + k // 20, X[k % 20], Z[k], *["a"] * (k == 3))
    )

    runs = ms.read_runs(path, x="x_mm", z="z_um", run="run", feed="100 mm/min")

    assert [len(r) for r in runs] == [20, 20]
    assert any("fewer fields" in w for w in runs.metadata["warnings"])


@pytest.mark.parametrize(
    ("name", "is_read"), [("encoder counter", True), ("count", False), ("Reading no.", False)]
)
def test_a_counter_that_is_measured_is_a_channel(tmp_path, name, is_read):
    path = put(tmp_path, f"t_s;{name};z_um", lambda k: (X[k], k + 5, Z[k]))

    assert (name in ms.read(path).channels) is is_read


def test_a_count_of_rows_that_is_asked_for_with_its_unit_is_read(tmp_path):
    path = put(tmp_path, "sample;z_um", lambda k: (k + 5, Z[k]))

    assert ms.read(path, x="sample:um", z="z_um").x[-1] == pytest.approx((N + 4) * 1e-6, abs=1e-15)


ROWS, LATE = 4000, 2273
"""More rows than the sample looks at, and one that it does not."""


def _with_remark(put, named, late, place=2):
    rows = []
    for k in range(ROWS):
        fields = [f"{k * 0.01:.2f}", f"{k * 7 % 13 / 10:.1f}"]
        fields.insert(place, late.get(k, ""))
        rows.append(",".join(fields))
    return put(f"{named}\n" + "\n".join(rows) + "\n")


@pytest.mark.parametrize("word", ["chip seen", "5 chips", "1O5"])
@pytest.mark.parametrize(("named", "place"), [("x_mm,z_um,remark", 2), ("x_mm,remark,z_um", 1)])
def test_a_remark_far_below_empty_fields_is_read(put, named, place, word):
    found = ms.read(_with_remark(put, named, {LATE: word}, place))

    assert found.x.tolist() == [float(f"{k * 0.01:.2f}") * 1e-3 for k in range(ROWS)]
    assert found.z.tolist() == [float(f"{k * 7 % 13 / 10:.1f}") * 1e-6 for k in range(ROWS)]
    assert found.metadata["lines"]["data"] == ROWS


def test_a_remark_far_below_that_calls_its_row_bad_is_said(put):
    found = ms.read(_with_remark(put, "x_mm,z_um,remark", {LATE: "bad row"}))

    assert f"skip_lines='{LATE + 2}'" in " ".join(found.metadata["warnings"])


@pytest.mark.parametrize(
    ("named", "late"),
    [
        ("x_mm,z_um,z2_um", {LATE: "chip"}),  # a unit: numbers belong there
        ("x_mm,z_um,temperature", {LATE: "chip"}),
        ("x_mm,z_um,other", {LATE: "chip", LATE - 1200: "5.5"}),
        ("x_mm,z_um,other", {LATE: "chip", LATE + 1200: "5.5"}),
    ],
)
def test_words_among_numbers_that_begin_late_are_refused_with_an_option_that_works(
    put, named, late
):
    path = _with_remark(put, named, late)

    with pytest.raises(ms.errors.CorruptFileError, match=f"line {LATE + 2}") as refused:
        ms.read(path)

    assert f"skip_lines='{LATE + 2}'" in str(refused.value)
    assert len(ms.read(path, skip_lines=str(LATE + 2), x="x_mm", z="z_um").x) == ROWS - 1


@pytest.mark.parametrize(
    ("options", "answer"),
    [
        ({"lateral_step": "10 um"}, {"z": "z_um"}),
        ({"sampling_rate": "1 kHz"}, {"channel": "z_um"}),
    ],
)
def test_rows_whose_numbers_have_a_gap_have_no_counted_place(tmp_path, options, answer):
    path = put(tmp_path, "no;z_um", lambda k: (k + 1 + 2 * (k >= 30), Z[k]))

    ((name, value),) = answer.items()
    with pytest.raises(
        ms.errors.FormatMismatchError, match=r"line 32: .*from 30 to 33"
    ) as refused:
        ms.read(path, **options)
    assert f"{name}='{value}'" in str(refused.value)
    read = ms.read(path, **options, **answer)
    assert any("rows may be missing" in w for w in read.metadata["warnings"])
    whole = put(tmp_path, "no;z_um", lambda k: (k + 1, Z[k]))
    assert ms.read(whole, **options).metadata["warnings"] == ()
