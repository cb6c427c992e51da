"""The layout of Aerotech 2-D files against an independent writer: mecode (MIT licence).

mecode writes Z of XY with the heights as they are, so it confirms rows, columns, words and the
number of values, not the sign of an entry.
"""

from pathlib import Path

import numpy as np
import pytest

from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.aerotech import Aerotech
from metrosep.errors import DataError

FLOAT = 1e-15
"""Rounding of millimetres in double, in m."""
ENTRY = 0.5e-10
"""Half of the last digit that metrosep prints, in m."""

pytestmark = pytest.mark.peer


@pytest.fixture
def write_cal_file():
    return pytest.importorskip("mecode.utils", reason="mecode is not installed").write_cal_file


@pytest.fixture
def surface():
    """Heights in mm over (x, y), different at every node and not symmetric."""
    x, y = np.meshgrid(np.arange(4), np.arange(3), indexing="ij")
    return 0.001 * (x + 10 * y + x * y) + 0.0025


@pytest.fixture
def written(tmp_path, surface, write_cal_file):
    """Nodes at x = -6, -4, -2, 0 mm and y = 3, 8, 13 mm; mecode takes X as counting down."""
    path = tmp_path / "mecode.cal"
    write_cal_file(str(path), surface.copy(), -6, 2, 2, 3, 18, 5, 0, 0, axis=4)
    return path


def test_mecode_file_reads(written, surface):
    back = Aerotech().decode(
        written.read_bytes(), written, corrected_sign=1, primary_unit=1e-3, offset_follows="axis"
    )

    np.testing.assert_allclose(back.values, (surface - surface[0, 0]).T * 1e-3, atol=FLOAT, rtol=0)
    np.testing.assert_allclose(back.x, [-6e-3, -4e-3, -2e-3, 0.0], atol=FLOAT, rtol=0)
    np.testing.assert_allclose(back.y, [3e-3, 8e-3, 13e-3], atol=FLOAT, rtol=0)


def test_same_words_and_cells(written, surface):
    """Token by token: axis numbers, columns, distances with their sign, offsets, zero outputs."""
    heights = (surface - surface[0, 0]).T * 1e-3
    made = CompensationMap([-6e-3, -4e-3, -2e-3, 0.0], [3e-3, 8e-3, 13e-3], heights)

    ours = Aerotech().encode(
        made,
        row_axis=2,
        column_axis=1,
        corrected_axis=4,
        row_sign=1,
        column_sign=-1,
        corrected_sign=1,
        offset_follows="axis",
    )

    assert _code(ours.data.decode())[0] == _code(written.read_text())[0]
    ours_words, theirs_words = (_words(t) for t in (ours.data.decode(), written.read_text()))
    assert ours_words.pop("CORUNIT") == "METRIC/1000"
    assert (theirs_words.pop("CORUNIT"), theirs_words.pop("POSUNIT")) == ("PRIMARY", "PRIMARY")
    assert ours_words.pop("POSUNIT") == "METRIC"
    assert ours_words == theirs_words
    np.testing.assert_allclose(
        np.array(_code(ours.data.decode())[2:-1], dtype=float) * 1e-6,
        np.array(_code(written.read_text())[2:-1], dtype=float) * 1e-3,
        atol=ENTRY + FLOAT,
        rtol=0,
    )


def test_offset_of_a_counter_that_runs_down_differs(written):
    """The one place where public writers disagree: mecode's OFFSETCOL follows the axis."""
    along_axis = Aerotech().decode(
        written.read_bytes(), written, corrected_sign=1, primary_unit=1e-3, offset_follows="axis"
    )
    along_encoder = Aerotech().decode(
        written.read_bytes(),
        written,
        corrected_sign=1,
        primary_unit=1e-3,
        offset_follows="encoder",
    )
    with pytest.raises(DataError, match="offset_follows="):
        Aerotech().decode(written.read_bytes(), written, corrected_sign=1, primary_unit=1e-3)

    assert along_axis.x[0] == pytest.approx(-6e-3, abs=FLOAT)
    assert along_encoder.x[0] == pytest.approx(6e-3, abs=FLOAT)
    np.testing.assert_array_equal(along_axis.y, along_encoder.y)


def _code(text: str) -> list[list]:
    """Words of each line that is not a comment; numbers as numbers in the first line."""
    lines = [s.split(";")[0].split() for s in text.splitlines()]
    lines = [s for s in lines if s]
    lines[0] = [lines[0][0], *map(float, lines[0][1:])]
    return lines


def _words(text: str) -> dict[str, object]:
    line = [s for s in text.splitlines() if s.startswith(":START2D")][1]
    pairs = line.removeprefix(":START2D").replace(" = ", "=").split()
    words: dict[str, object] = dict(p.split("=") for p in pairs)
    return {k: float(v) if k.startswith(("OFFSET", "OUT")) else v for k, v in words.items()}


def test_path_is_not_needed(written):
    assert Aerotech().decode(
        written.read_bytes(),
        Path("elsewhere.cal"),
        corrected_sign=1,
        primary_unit=1e-3,
        offset_follows="axis",
    )
