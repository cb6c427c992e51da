"""Columns by role: units, labels, several files, and headers whose unit is none."""

import numpy as np
import pytest

from metrosep.core.errors import FormatMismatchError, ReadError, UnitError
from metrosep.io.readings import read_readings
from metrosep.io.role_columns import Role, read_roles


@pytest.fixture
def put(tmp_path):
    def write(text, name="t.csv"):
        file = tmp_path / name
        file.write_text(text, "ascii")
        return file

    return write


def test_numbers_come_in_si_labels_as_text(put):
    file = put("t_ms,who,z_um\n0,A,1.5\n2,B,-2.5\n")
    data = read_roles(
        file,
        {
            "time": Role("t_ms", "time"),
            "label": Role("who", "label"),
            "z": Role(["z_um"], "length"),
        },
    )
    np.testing.assert_allclose(data.values["time"], [0.0, 2e-3], rtol=0.0, atol=1e-15)
    assert data.values["label"].tolist() == ["A", "B"]
    np.testing.assert_allclose(data.values["z"], [[1.5e-6, -2.5e-6]], rtol=1e-12)
    assert data.columns["z"] == ("z",)
    assert data.history[0].parameters["time"] == "t_ms"


def test_numbers_as_labels_and_rows_of_several_files(put):
    files = [put("n,x_mm\n1,0\n2,1\n"), put("n,x_mm\n3,2\n", "u.csv")]
    data = read_roles(files, {"n": Role("n", "label"), "x": Role("x_mm", "position")})
    assert data.values["n"].tolist() == ["1", "2", "3"]
    assert data.units == {"x": "m"}
    assert len(data.history) == 2
    assert data.name == "t"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("part,z_nm\n1E2,1\n100,2\n100.0,3\n", ["1E2", "100", "100.0"]),
        ("part,z_nm\n01,1\n1,2\n+1,3\n", ["01", "1", "+1"]),
        (
            "part,z_nm\n12345678901234561,1\n12345678901234562,2\n",
            ["12345678901234561", "12345678901234562"],
        ),
        ("# by hand\npart;z_nm\n\n 01 ;1,5\n# again\n1;2,5\n", ["01", "1"]),
        ('z_nm,part\n1,"1E2"\n2,"100"\n', ["1E2", "100"]),
        (
            "z_nm 1\n1.5 1234567\n2.5 1234568\n".replace("z_nm 1", "z_nm part"),
            ["1234567", "1234568"],
        ),
    ],
)
def test_serial_numbers_keep_their_text(put, text, expected):
    data = read_roles(put(text), {"part": Role("part", "label"), "z": Role("z_nm", "length")})
    assert data.values["part"].tolist() == expected


def test_serial_numbers_of_a_marked_file_keep_their_text(tmp_path):
    file = tmp_path / "t.csv"
    file.write_bytes("part,z_nm\r\n01,1\r\n1,2\r\n".encode("utf-8-sig"))
    assert read_roles(file, {"p": Role("part", "label")}).values["p"].tolist() == ["01", "1"]


def test_a_header_of_something_per_time_is_no_unit_of_time(put):
    file = put("speed_rev_per_ms,t_ms\n100,1\n200,2\n")
    data = read_roles(file, {"v": Role("speed_rev_per_ms", "any"), "t": Role("t_ms", "any")})
    assert data.values["v"].tolist() == [100.0, 200.0]
    assert data.values["t"].tolist() == [1e-3, 2e-3]


def test_positions_are_all_lengths_or_all_angles(put):
    file = put("a_deg,b_mm\n180,1\n90,2\n")
    assert read_roles(file, {"p": Role("a_deg", "position")}).units == {"p": "rad"}
    with pytest.raises(UnitError, match="lengths and angles"):
        read_roles(file, {"p": Role(["a_deg", "b_mm"], "position")})


def test_what_does_not_fit_is_refused(put):
    file = put("who,z_um\nA,1\nB,2\n")
    with pytest.raises(FormatMismatchError, match="holds text"):
        read_roles(file, {"v": Role("who", "any")})
    with pytest.raises(UnitError, match="time is needed"):
        read_roles(file, {"t": Role("z_um", "time")})
    with pytest.raises(ReadError, match="z_um"):
        read_roles(file, {"t": Role("q", "any")})
    with pytest.raises(FormatMismatchError, match="no file"):
        read_roles([], {"t": Role("q", "any")})


def test_readings_with_extra_columns_by_repeat(put):
    file = put(
        "run,x_mm,z_nm,p_urad\n"
        + "".join(f"{r},{i},{r + i},{10 * r + i}\n" for r in (1, 2) for i in range(3))
    )
    data = read_readings(
        file, readings="z_nm", x="x_mm", repeat="run", extra={"pitch": Role("p_urad", "angle")}
    )
    np.testing.assert_allclose(data.extra["pitch"] * 1e6, [[10, 11, 12], [20, 21, 22]], rtol=1e-12)
    assert data.position_unit == "m"
    with pytest.raises(FormatMismatchError, match="readings of one file"):
        read_readings([file, file], readings="z_nm", extra={"pitch": Role("p_urad", "angle")})


def test_a_time_that_counts_from_a_date_keeps_its_digits_over_two_files(tmp_path):
    """A float of seconds since 1970 holds 0.24 us; steps of 1 us would be 0.95 or 1.19 us."""
    for k in range(2):
        rows = "".join(f"{1790000000 + k}.{n:06d},{n % 3}\n" for n in range(10, 16))
        (tmp_path / f"{k}.csv").write_text("time_s,z_um\n" + rows)
    roles = {"time": Role("time_s", "time"), "z": Role("z_um", "length")}

    found = read_roles([tmp_path / "0.csv", tmp_path / "1.csv"], roles)

    expected = [k + n * 1e-6 for k in range(2) for n in range(6)]
    np.testing.assert_allclose(found.values["time"], expected, rtol=0, atol=1e-12)
    assert sum("counts from a date" in w for w in found.warnings) == 2


def test_times_of_two_roles_that_count_from_a_date_have_one_zero(tmp_path):
    """Each row ends 4.75 s after it began, in every file."""
    for k in range(2):
        rows = "".join(
            f"{1790000000 + 100 * k + 10 * n}.5,{1790000005 + 100 * k + 10 * n}.25\n"
            for n in range(4)
        )
        (tmp_path / f"{k}.csv").write_text("start_s,end_s\n" + rows)
    roles = {"start": Role("start_s", "time"), "end": Role("end_s", "time")}

    found = read_roles([tmp_path / "0.csv", tmp_path / "1.csv"], roles).values

    starts = [100.0 * k + 10.0 * n for k in range(2) for n in range(4)]
    np.testing.assert_allclose(found["start"], starts, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["end"] - found["start"], 4.75, rtol=0, atol=1e-9)
