"""Curves for separations: units by header, order of readings, repeats, positions that must agree."""

import numpy as np
import pytest

from metrosep.core.errors import FormatMismatchError, InvalidSamplesError, ReadError, UnitError
from metrosep.io.readings import read_readings

EXACT = 1e-12
"""Decimal texts times one factor."""


def write(path, header, rows):
    path.write_text("\n".join([header, *(",".join(map(str, r)) for r in rows)]) + "\n", "ascii")
    return path


@pytest.fixture
def two_columns(tmp_path):
    rows = [(i * 90, 0.1 * i, -3 * i) for i in range(4)]
    return write(tmp_path / "both.csv", "angle_deg,m1_um,m2_nm", rows)


def test_columns_of_one_file_in_si_and_in_order(two_columns):
    found = read_readings(two_columns, readings=["m2_nm", "m1_um"], angle="angle_deg")

    assert found.values.shape == (2, 1, 4)
    np.testing.assert_allclose(found.values[0, 0], -3e-9 * np.arange(4), rtol=EXACT)
    np.testing.assert_allclose(found.values[1, 0], 1e-7 * np.arange(4), rtol=EXACT)
    np.testing.assert_allclose(found.position, np.pi / 2 * np.arange(4), rtol=EXACT)
    assert found.names == ("m2_nm", "m1_um")
    assert found.history[0].parameters["file"] == "both.csv"


def test_one_column_of_two_files(tmp_path):
    a = write(tmp_path / "a.csv", "x_mm,z_um", [(0, 1), (1, 2), (2, 3)])
    b = write(tmp_path / "b.csv", "x_mm,z_um", [(0, 4), (1, 5), (2, 7)])

    found = read_readings([a, b], readings="z_um", x="x_mm")

    np.testing.assert_allclose(found.values[:, 0] * 1e6, [[1, 2, 3], [4, 5, 7]], rtol=EXACT)
    np.testing.assert_allclose(found.position, [0, 1e-3, 2e-3], rtol=EXACT)
    assert found.names == ("a.csv: z_um", "b.csv: z_um")
    assert len(found.history) == 2


def test_repeats_are_cut_where_their_number_changes(tmp_path):
    rows = [(r, 120 * i, 10 * r + i) for r in (7, 3) for i in range(3)]
    file = write(tmp_path / "revs.csv", "revolution,angle_deg,m_nm", rows)

    found = read_readings(file, readings="m_nm", angle="angle_deg", repeat="revolution")

    assert found.values.shape == (1, 2, 3)
    np.testing.assert_allclose(found.values[0] * 1e9, [[70, 71, 72], [30, 31, 32]], rtol=EXACT)


def test_accumulated_angle_of_later_revolutions_is_the_same_position(tmp_path):
    rows = [(r, 360 * r + 120 * i, i) for r in range(3) for i in range(3)]
    file = write(tmp_path / "revs.csv", "revolution,angle_deg,m_nm", rows)

    found = read_readings(file, readings="m_nm", angle="angle_deg", repeat="revolution")

    np.testing.assert_allclose(np.degrees(found.position), [0, 120, 240], rtol=EXACT)


def test_missing_reading_is_nan_missing_position_is_refused(tmp_path):
    rows = [(0, 1), (1, ""), (2, 3)]
    file = write(tmp_path / "gap.csv", "x_mm,z_um", rows)
    assert np.isnan(read_readings(file, readings="z_um", x="x_mm").values[0, 0, 1])

    file = write(tmp_path / "lost.csv", "x_mm,z_um", [(0, 1), ("", 2), (2, 3)])
    with pytest.raises(InvalidSamplesError, match="line 3"):
        read_readings(file, readings="z_um", x="x_mm")


@pytest.mark.parametrize(
    ("rows", "match"),
    [
        ([(0, 0, 1), (0, 1, 2), (0, 2, 3), (1, 0, 4), (1, 1, 5)], "2 to 3 samples"),
        ([(0, 0, 1), (0, 1, 2), (1, 0.1, 4), (1, 1.1, 5)], "other positions"),
    ],
)
def test_repeats_that_do_not_match_are_refused(tmp_path, rows, match):
    file = write(tmp_path / "revs.csv", "pass,x_mm,z_um", rows)
    with pytest.raises(InvalidSamplesError, match=match):
        read_readings(file, readings="z_um", x="x_mm", repeat="pass")


def test_files_that_do_not_match_are_refused(tmp_path):
    a = write(tmp_path / "a.csv", "x_mm,z_um", [(0, 1), (1, 2), (2, 3)])
    short = write(tmp_path / "b.csv", "x_mm,z_um", [(0, 4), (1, 5)])
    mirrored = write(tmp_path / "c.csv", "x_mm,z_um", [(2, 4), (1, 5), (0, 6)])

    with pytest.raises(InvalidSamplesError, match="2 samples"):
        read_readings([a, short], readings="z_um", x="x_mm")
    with pytest.raises(InvalidSamplesError, match="different numbers"):
        read_readings([a, short], readings="z_um")
    with pytest.raises(InvalidSamplesError, match="other positions"):
        read_readings([a, mirrored], readings="z_um", x="x_mm")


def test_wrong_units_and_names_are_refused(two_columns):
    with pytest.raises(UnitError, match="angle"):
        read_readings(two_columns, readings="m1_um", x="angle_deg")
    with pytest.raises(UnitError, match="length"):
        read_readings(two_columns, readings="m1_um", dimension="angle")
    with pytest.raises(ReadError, match="m3"):
        read_readings(two_columns, readings="m3")
    with pytest.raises(FormatMismatchError, match="not both"):
        read_readings(two_columns, readings="m1_um", x="angle_deg", angle="angle_deg")
    for nothing in ([], ()):
        with pytest.raises(FormatMismatchError):
            read_readings(two_columns, readings=nothing)
    with pytest.raises(FormatMismatchError, match="no file"):
        read_readings([], readings="m1_um")


def test_slopes_and_voltages(tmp_path):
    file = write(tmp_path / "s.csv", "x_mm,slope_urad,gap_V", [(0, 1, 0.5), (1, 2, -1)])

    slope = read_readings(file, readings="slope_urad", x="x_mm", dimension="angle")
    gap = read_readings(file, readings="gap_V", scale="-2 um/V")

    np.testing.assert_allclose(slope.values.ravel(), [1e-6, 2e-6], rtol=EXACT)
    np.testing.assert_allclose(gap.values.ravel(), [-1e-6, 2e-6], rtol=EXACT)
