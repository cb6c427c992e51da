"""Damage x container: the same values, or a refusal; no row is lost and no value changed in silence.

Each container is written by the program that owns it. Two kinds of damage: bytes of the file, where a
checksum of the container must show every change; and cells, with one habit or fault of people and programs.
A container without a checksum (SQLite, Feather, Parquet as it is usually written) cannot show a changed
bit of a number: there no row may be lost without a word.
"""

import gzip
import math
import random
import re
import sqlite3
import zlib

import numpy as np
import openpyxl
import pytest

import metrosep as ms

pa = pytest.importorskip("pyarrow")
feather = pytest.importorskip("pyarrow.feather")
parquet = pytest.importorskip("pyarrow.parquet")

N = 40
X = [round(0.05 * k, 6) for k in range(N)]
Z = [round(3.0 * math.sin(k) + 0.01 * k, 4) for k in range(N)]
NAMES = ("x_mm", "z_um")
CHECKED = ["csv.gz", "xlsx", "npz", "parquet"]
"""Containers with a checksum of all that counts."""
BARE = ["db", "feather"]
FEW, MANY = 60, 500
"""Damaged files of each container: always, and five times with `make test-slow`: ten thousand of the checked ones."""
PARTS = [0, *(pytest.param(part, marks=pytest.mark.slow) for part in range(1, 6))]


def write(kind, path, rows, names=NAMES):
    """Write rows of numbers, texts and None."""
    columns = [list(c) for c in zip(*rows, strict=True)]
    if kind == "csv.gz":
        lines = [",".join("" if v is None else str(v) for v in row) for row in (names, *rows)]
        path.write_bytes(gzip.compress("\n".join([*lines, ""]).encode(), mtime=0))
    elif kind == "xlsx":
        made = openpyxl.Workbook()
        for row in (names, *rows):
            made.active.append(row)
        made.save(path)
    elif kind == "db":
        base = sqlite3.connect(path)
        base.execute(f"CREATE TABLE data ({', '.join(f'{n} REAL' for n in names)})")
        base.executemany("INSERT INTO data VALUES (?, ?)", rows)
        base.commit()
        base.close()
    elif kind == "npz":
        np.savez(path, **{n: as_array(c) for n, c in zip(names, columns, strict=True)})
    else:
        table = pa.table({n: as_column(c) for n, c in zip(names, columns, strict=True)})
        if kind == "parquet":
            parquet.write_table(table, path, write_page_checksum=True)
        else:
            feather.write_feather(table, path)


def as_array(column):
    if any(isinstance(v, str) for v in column):
        return np.array(["" if v is None else str(v) for v in column])
    return np.array([np.nan if v is None else v for v in column])


def as_column(column):
    if any(isinstance(v, str) for v in column):
        return [None if v is None else str(v) for v in column]
    return column


def with_bytes_changed(draw, data):
    """Return damaged bytes: what cables, disks and mail programs do."""
    made, i = bytearray(data), draw.randrange(len(data))
    kind = draw.choice(
        ["flip", "byte", "cut", "zero", "insert", "remove", "swap", "append", "repeat"]
    )
    if kind == "flip":
        made[i] ^= 1 << draw.randrange(8)
    elif kind == "byte":
        made[i] = draw.randrange(256)
    elif kind == "cut":
        del made[i:]
    elif kind == "zero":
        made[i : i + 16] = bytes(len(made[i : i + 16]))
    elif kind == "insert":
        made[i:i] = bytes([draw.randrange(256)])
    elif kind == "remove":
        del made[i]
    elif kind == "swap":
        a, b = sorted((i, draw.randrange(len(data))))
        made[a : a + 8], made[b : b + 8] = made[b : b + 8], made[a : a + 8]
    elif kind == "append":
        made += draw.randbytes(20)
    else:
        made[i:i] = made[i : i + 32]
    return bytes(made)


def differences(kind, folder, part):
    """Return the damaged files of a container that are read with other rows or values."""
    path = folder / f"table.{kind}"
    write(kind, path, list(zip(X, Z, strict=True)))
    whole, good = ms.read(path), path.read_bytes()
    draw = random.Random(f"{kind} {part}")  # noqa: S311  a reproducible draw, no secret
    found = []
    for k in range(MANY if part else FEW):
        path.write_bytes(with_bytes_changed(draw, good))
        try:
            read = ms.read(path)
        except ms.errors.MetrosepError:
            continue
        warned = read.metadata["warnings"] != whole.metadata["warnings"]
        if not isinstance(read, ms.Profile) or len(read) != N:
            found.append((k, "rows", warned))
        elif not (np.array_equal(read.x, whole.x) and np.array_equal(read.z, whole.z)):
            found.append((k, "values", warned))
    return found


@pytest.mark.parametrize("kind", CHECKED)
@pytest.mark.parametrize("part", PARTS)
def test_changed_bytes_never_change_a_value_where_the_container_has_a_checksum(
    tmp_path, kind, part
):
    assert differences(kind, tmp_path, part) == []


@pytest.mark.parametrize("kind", BARE)
@pytest.mark.parametrize("part", PARTS)
def test_changed_bytes_never_lose_a_row_in_silence(tmp_path, kind, part):
    silent = [f for f in differences(kind, tmp_path, part) if f[1:] == ("rows", False)]

    assert silent == []


# ---- cells: what people and programs do to one of them -----------------------------------------

KINDS = ["csv.gz", "xlsx", "npz", "parquet", "feather", "db"]
AT = 17
"""Row that is changed."""
CELLS = {
    "nothing": (None, Z[AT]),
    "empty": ("", math.nan),
    "none": ("null", math.nan),
    "word": ("N/A", math.nan),
    "error": ("#NV", math.nan),
    "dashes": ("-----", math.nan),
    "beyond": ("OVER", math.nan),
    "minus": ("\u22121.25", -1.25),
    "exponent": ("1.25E-1", 0.125),
    "letter": ("1.O5", "line"),
    "unknown": ("E4711", "line"),
    "unit": ("1.25 um", "line"),
    "saturated": (99999.99, "line"),
    "far": (1e99, "line"),
    "two marks": ("1.234,5.6", "line"),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("cell", CELLS)
def test_a_changed_cell_gives_the_value_or_its_line(tmp_path, kind, cell):
    value, expected = CELLS[cell]
    rows = [list(r) for r in zip(X, Z, strict=True)]
    rows[AT][1] = Z[AT] if value is None else value
    path = tmp_path / f"table.{kind}"
    write(kind, path, rows)

    if expected == "line":
        with pytest.raises(ms.errors.MetrosepError) as caught:
            ms.read(path)
        assert re.search(rf"\bline {AT + 2}\b|\bcell B{AT + 2}\b", str(caught.value))
        return
    read = ms.read(path)

    truth = [*Z[:AT], expected, *Z[AT + 1 :]]
    assert read.x.tolist() == (np.array(X) * 1e-3).tolist()
    np.testing.assert_array_equal(read.z, np.array(truth) * 1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_a_number_for_not_measured_in_every_seventh_row_is_asked_for(tmp_path, kind):
    rows = [(x, -9999.0 if k % 7 == 3 else z) for k, (x, z) in enumerate(zip(X, Z, strict=True))]
    path = tmp_path / f"table.{kind}"
    write(kind, path, rows)

    with pytest.raises(ms.errors.AmbiguousFormatError, match="missing='-9999'"):
        ms.read(path)
    assert np.isnan(ms.read(path, missing="-9999").z).sum() == 6


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "npz"])
def test_a_row_without_any_value_is_left_out_with_its_line(tmp_path, kind):
    rows = [*zip(X, Z, strict=True)]
    rows[AT] = (None, None)
    path = tmp_path / f"table.{kind}"
    write(kind, path, rows)

    read = ms.read(path)

    assert len(read) == N - 1
    lines = read.metadata["lines"]
    said = " ".join(read.metadata["warnings"])
    assert f"line {AT + 2} holds no value" in said or lines["blank"] == 1


def test_a_gzip_whose_checksum_is_wrong_is_refused(tmp_path):
    text = b"x_mm,z_um\n" + b"".join(f"{x},{z}\n".encode() for x, z in zip(X, Z, strict=True))
    packed = bytearray(gzip.compress(text, mtime=0))
    packed[-8:-4] = zlib.crc32(text + b"1").to_bytes(4, "little")
    path = tmp_path / "table.csv.gz"
    path.write_bytes(packed)

    with pytest.raises(ms.errors.ReadError):
        ms.read(path)
