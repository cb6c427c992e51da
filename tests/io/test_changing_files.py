"""Files that another program cuts, empties or spoils while they are read: named, never read in part."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.io import source
from metrosep.io.stream import open_stream

ROWS = [f"{0.25 * k};{k % 7}" for k in range(30)]
TEXT = ("\n".join(["x_mm;z_um", *ROWS]) + "\n").encode()


@pytest.mark.parametrize("opened", [ms.read, ms.read_runs, open_stream])
@pytest.mark.parametrize("n_rows", [30, 600_000])
@pytest.mark.parametrize("keep", [0, 5, 200])
def test_a_file_that_is_cut_while_it_is_read_is_refused(
    tmp_path, monkeypatch, opened, n_rows, keep
):
    path = tmp_path / "a.csv"
    rows = TEXT.split(b"\n")[1:-1]
    path.write_bytes(b"\n".join([b"x_mm;z_um", *(rows * (n_rows // 30))]) + b"\n")
    taken = source.RawFile.__init__

    def cut(self, *args, **options):
        taken(self, *args, **options)
        path.write_bytes(path.read_bytes()[:keep])

    monkeypatch.setattr(source.RawFile, "__init__", cut)

    with pytest.raises(ms.errors.ReadError, match="became shorter while it was read"):
        opened(path)


@pytest.mark.parametrize("zeros", [1, 3000])
@pytest.mark.parametrize("row", [0, 12, 29])
def test_a_byte_of_value_0_is_named_by_its_line(tmp_path, row, zeros):
    at = len(b"\n".join(TEXT.split(b"\n")[: row + 1])) + 2
    path = tmp_path / "a.csv"
    path.write_bytes(TEXT[:at] + b"\0" * zeros + TEXT[at:])

    for read in (ms.read, lambda p: ms.read(p, format="delimited", encoding="utf-8"), open_stream):
        with pytest.raises(ms.errors.ReadError, match=rf"line {row + 2} holds a byte of value 0"):
            read(path)


def test_a_file_that_was_cut_off_before_its_zeros_is_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(TEXT + b"\0" * 5000)
    with pytest.raises(ms.errors.ReadError, match=r"line 32 .*cut it off before that line"):
        ms.read(path)

    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:31]))
    assert np.array_equal(ms.read(path).x, np.arange(30) * 0.25e-3)


def test_a_byte_of_value_0_far_down_a_long_table_is_named(tmp_path):
    path = tmp_path / "a.csv"
    rows = TEXT.split(b"\n")[1:-1] * 20_000
    rows[450_000] = rows[450_000][:3] + b"\0" + rows[450_000][3:]
    path.write_bytes(b"\n".join([b"x_mm;z_um", *rows]) + b"\n")

    with pytest.raises(ms.errors.ReadError, match="line 450002 holds a byte of value 0"):
        ms.read(path)
