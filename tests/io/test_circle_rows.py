"""Rows of a circular test that cannot be used are counted, and never take others with them."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, OptionError
from metrosep.io.circle_logs import read_circle_log

R = 0.1


def rows(n_cw=360):
    """Give one turn rising and one falling, 2 um apart, as one log."""
    up, down = np.arange(0.0, 360.0), np.arange(360.0, 360.0 - n_cw, -1.0)
    angle = np.concatenate([up, down])
    reading = np.concatenate([3.0 + 0.0 * up, 1.0 + 0.0 * down])
    return [f"{a:g},{r:g}" for a, r in zip(angle, reading, strict=True)]


def log_of(tmp_path, lines):
    file = tmp_path / "circle.csv"
    file.write_text("angle_deg,reading_um\n" + "\n".join(lines) + "\n")
    return read_circle_log(file, radius=R)


def test_an_empty_angle_loses_its_row_and_no_other(tmp_path):
    lines = rows()
    lines[100] = "," + lines[100].split(",")[1]
    log = log_of(tmp_path, lines)
    assert log.ccw is not None
    assert log.cw is not None
    assert np.nanmean(log.ccw) == pytest.approx(3e-6, abs=1e-12)
    assert np.nanmean(log.cw) == pytest.approx(1e-6, abs=1e-12)
    assert any("1 rows without an angle or a reading" in m for m in log.messages)


def test_a_sense_of_too_few_readings_is_refused_and_not_dropped(tmp_path):
    with pytest.raises(DataError, match="needs 16"):
        log_of(tmp_path, rows(n_cw=12))


@pytest.mark.parametrize("plane", ["Z", "", "QQ", "YX", "xy", None, ("X", "Y")])
def test_a_plane_that_is_none_is_refused_by_name(tmp_path, plane):
    file = tmp_path / "circle.csv"
    file.write_text("angle_deg,reading_um\n" + "\n".join(rows()) + "\n")
    with pytest.raises(OptionError, match="plane is one of XY, YZ, ZX, XZ"):
        read_circle_log(file, radius=R, plane=plane)
