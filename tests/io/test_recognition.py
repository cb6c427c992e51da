"""A file opens without format= however far behind its first bytes the decisive names lie.

Every format that is recognised by names (text, HDF5, zip) is padded here with what the format
allows in front of them: comments, keys, long lines, members, a dataset written first. The others
are recognised by bytes at a fixed place, which nothing can move.
"""

import struct
import zipfile

import h5py
import numpy as np
import pytest

import metrosep as ms
from metrosep.io import registry

SIZES = [0, 1, 63 * 1024, 64 * 1024, 65 * 1024, 200 * 1024, 3 * 2**20]
FIXED = {
    "al3d", "bcr-stm", "contour-dat", "digital-surf", "frt", "gwy", "ibw", "imc", "matlab", "mdf4", "metropro",
    "nanoscope", "nid", "nmm", "nms", "npy", "opd", "opdx", "os3d", "parquet", "plu", "sdf", "smd", "sqlite", "tdms",
    "tmd", "wsxm", "zygo-xyz",
}  # fmt: skip
NOT_RECOGNISED = {"pmac-gather"}  # bare columns: the format must be named
NM = 1e-9


def lines_of(mark, size):
    """Lines of 100 characters that begin with a mark, as long as wanted together."""
    return (mark + "x" * (99 - len(mark)) + "\n") * -(-size // 100)


def below(path, first, filler):
    """Put text below the first line (or above all, for 0) of a sample."""
    lines = path.read_bytes().decode("latin-1").splitlines(keepends=True)
    return "".join([*lines[:first], filler, *lines[first:]]).encode("latin-1")


TEXT = {
    "camonitor": ("interleaved.txt", lambda p, n: below(p, 0, lines_of("pv:a *** ", n))),
    "codev-int": ("surface.int", lambda p, n: below(p, 0, lines_of("! ", n))),
    "dabam": (
        "alone.txt",
        lambda p, n: below(p, 1, f'"REMARK": "{"x" * min(n, 900_000)}",\n'),
    ),
    "dektak-csv": ("scan.csv", lambda p, n: below(p, 1, lines_of("Remark,", n))),
    "delimited": ("comments.txt", lambda p, n: below(p, 0, lines_of("# ", n))),
    "etalon": ("one-length.txt", lambda p, n: below(p, 0, lines_of("// ", n))),
    "gwyddion-ascii": (
        "english.txt",
        lambda p, n: (
            b"# Channel: a\n# Width: 6 um\n# Height: 1 um\n# Value units: nm\n"
            + ("\t".join(["-1.25e-03"] * max(3, n // 10)) + "\n").encode() * 2
        ),
    ),
    "halsampler": (
        "second-part.txt",
        lambda p, n: b"1.500000 -0.250000 1 \n" * (n // 22 + 2) + b"overrun\n2.5 0.75 0\n",
    ),
    "iso230-2": ("count.dat", lambda p, n: below(p, 0, lines_of("# ", n))),
    "lvm": ("comma.lvm", lambda p, n: below(p, 1, f"Description\t{'x' * n}\n")),
    "mitaka-mlp": ("lines.csv", lambda p, n: below(p, 1, f"Comment,{'x' * n}\n")),
    "mtconnect": ("agent.xml", lambda p, n: below(p, 1, f"<!-- {'x' * n} -->\n")),
    "mx-slice": (
        "one-slice.csv",
        lambda p, n: p.read_bytes().replace(b" ,Y", b" " * (n + 1) + b",Y", 1),
    ),
    "opcua": (
        "items.csv",
        lambda p, n: below(p, 1, f"2026-03-05T14:07:09.120Z,{'x' * n},1.0,Good\n"),
    ),
    "pi-gcs": ("blank.dat", lambda p, n: below(p, 0, lines_of("# REM ", n))),
    "twincat-scope": (
        "filetime.csv",
        lambda p, n: below(p, 1, lines_of("Remark;", min(n, 99_000))),
    ),
}


def hdf5_behind(source, target, size):
    """Copy an HDF5 file behind a dataset and groups, so that its names come last."""
    with h5py.File(source) as old, h5py.File(target, "w", libver="earliest") as new:
        if size:
            new["aaa"] = np.zeros(size, dtype="u1")
            for k in range(size // 10_000):
                new.create_group(f"bbb/{k}")
        new.attrs.update(old.attrs)
        for name in old:
            if isinstance(old.get(name, getlink=True), h5py.HardLink):
                old.copy(name, new)


def zip_behind(source, target, size):
    """Write the members of an archive behind one that does not pack."""
    filler = np.random.default_rng(1).bytes(size)
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        if size:
            new.writestr("a/preview.bin", filler)
        for item in old.infolist():
            new.writestr(item.filename, old.read(item))


def behind_picture(source, target, size):
    """Write the archive of a Keyence file behind a longer picture."""
    data = source.read_bytes()
    at = data.index(b"PK\x03\x04")
    target.write_bytes(data[:at] + bytes(size) + data[at:])


def ole_behind(source, target, size):
    """Move table, directory and stream behind sectors that belong to nothing; more tables list them."""
    data = source.read_bytes()
    free, table, end = 0xFFFFFFFF, 0xFFFFFFFD, 0xFFFFFFFE
    skip = -(-size // 512)
    n_old = len(data) // 512 - 1
    links = list(struct.unpack_from("<128I", data, 512))[1:n_old]
    moved = [skip + s if s < 0xFFFFFFFA else s for s in links]  # directory, then the stream
    total = skip + n_old
    n_tables = -(-total // 127)
    first = total  # tables behind the stream
    whole = [free] * skip + [free] + moved + [table] * n_tables
    whole += [free] * (128 * n_tables - len(whole))
    assert n_tables <= 109, "no further list of tables is written here"
    head = bytearray(data[:512])
    struct.pack_into("<2I", head, 44, n_tables, skip + 1)
    struct.pack_into(
        "<109I", head, 76, *range(first, first + n_tables), *[free] * (109 - n_tables)
    )
    stream = bytearray(data[512:])
    entry = 512 + 128 + 116  # where the stream begins, in the second entry of the directory
    struct.pack_into("<I", stream, entry, struct.unpack_from("<I", stream, entry)[0] + skip)
    assert end in moved
    target.write_bytes(
        bytes(head) + bytes(512 * skip) + bytes(stream) + struct.pack(f"<{len(whole)}I", *whole)
    )


def tiff_behind(source, target, size):
    """Put a page without pictures in front of the others, a long way before them."""
    data = source.read_bytes()
    first = int.from_bytes(data[4:8], "little")
    text = b"x" * size + b"\0"
    at = len(data)
    page = (1).to_bytes(2, "little") + (270).to_bytes(2, "little") + (2).to_bytes(2, "little")
    page += len(text).to_bytes(4, "little")
    page += (at + 18).to_bytes(4, "little") if len(text) > 4 else text.ljust(4, b"\0")
    page += first.to_bytes(4, "little") + text
    target.write_bytes(data[:4] + at.to_bytes(4, "little") + data[8:] + page)


CONTAINER = {
    "datx": ("nanometres.datx", hdf5_behind),
    "fourd": ("one.h5", hdf5_behind),
    "hdf5": ("one-map.h5", hdf5_behind),
    "lext": ("little.lext", tiff_behind),
    "metrosep-h5": ("surface.h5", hdf5_behind),
    "mitutoyo-xlsx": ("plain.xlsx", zip_behind),
    "mnt": ("plain.mnt", ole_behind),
    "npz": ("profile.npz", zip_behind),
    "plux": ("plain.plux", zip_behind),
    "talyrond": ("turn.xlsx", zip_behind),
    "vk": ("packed.vk6", behind_picture),
    "worksheet": ("profile.xlsx", zip_behind),
    "x3p": ("double.x3p", zip_behind),
}


def test_every_format_says_how_it_can_be_padded():
    known = {f.id for f in registry.formats() if f.is_measurement and f.reader != "plugin"}

    assert known == set(TEXT) | set(CONTAINER) | FIXED | NOT_RECOGNISED


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", sorted(TEXT))
def test_text_is_recognised_behind_a_long_head(repository, tmp_path, name, size):
    sample, padded = TEXT[name]
    path = tmp_path / "export.bin"
    path.write_bytes(padded(repository / "data_formats" / name / "samples" / sample, size))

    assert registry.identify(path).id == name


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", sorted(CONTAINER))
def test_container_is_recognised_wherever_its_names_lie(repository, tmp_path, name, size):
    sample, padded = CONTAINER[name]
    source = repository / "data_formats" / name / "samples" / sample
    path = tmp_path / "export.bin"
    padded(source, path, size)

    assert registry.identify(path).id == name


@pytest.mark.parametrize("size", [512, 4096, 2**16, 2**21])
def test_hdf5_opens_behind_a_user_block_of_any_length(tmp_path, size):
    """HDF5 allows any power of two from 512 on in front of its signature; h5py writes such files."""
    path = tmp_path / "map.h5"
    ms.write(ms.Surface(np.arange(12.0).reshape(3, 4) * NM, 1e-6, 1e-6), path)
    with (
        h5py.File(path) as plain,
        h5py.File(tmp_path / "behind.h5", "w", userblock_size=size) as behind,
    ):
        for name in plain:
            plain.copy(name, behind)
        behind.attrs.update(plain.attrs)

    assert np.array_equal(ms.read(tmp_path / "behind.h5").z, ms.read(path).z)


def test_padded_files_read_as_the_plain_ones(repository, tmp_path):
    for name in ("fourd", "datx", "x3p", "mitutoyo-xlsx"):
        sample, padded = CONTAINER[name]
        source = repository / "data_formats" / name / "samples" / sample
        padded(source, tmp_path / name, 3 * 2**20)

        np.testing.assert_array_equal(ms.read(tmp_path / name).z, ms.read(source).z)


def test_code_v_grid_below_many_comments_reads_its_numbers(repository, tmp_path):
    source = repository / "data_formats" / "codev-int" / "samples" / "surface.int"
    path = tmp_path / "long.int"
    path.write_bytes(below(source, 0, lines_of("! ", 200_000)))

    np.testing.assert_array_equal(ms.read(path).z, ms.read(source).z)


@pytest.mark.parametrize(
    ("name", "pv_nm", "n_invalid"),
    [
        ("m2_measurement_1_crop.h5", 80.094543, 576),
        ("m2g1_0_dec4.h5", 407.234542, 11),
        ("m2g1_90_dec4.h5", 382.302469, 8),
        ("m2g1_180_dec4.h5", 525.570616, 11),
    ],
)
def test_real_4d_files_open_by_themselves(corpus, name, pv_nm, n_invalid):
    surface = ms.read(corpus / "fourd" / name)

    assert surface.metadata["format"] == "fourd"
    assert np.isnan(surface.z).sum() == n_invalid
    assert np.nanmax(surface.z) - np.nanmin(surface.z) == pytest.approx(
        pv_nm * NM, rel=1e-8, abs=0.0
    )


TWINCAT = """Name;YT Scope Project
File;C:\\scope\\feed.csv
StartRecord;133500000000000000;Wednesday, January 17, 2024;22:20:00.000
EndRecord;133500000000300000;Wednesday, January 17, 2024;22:20:00.030

Name;X.ActPos;X.PosDiff
SymbolComment;;
Data-Type;REAL64;REAL64
SampleTime;10;10
VariableSize;8;8
Unit;(None);(None)

133500000000000000;1.5;0.25
133500000000100000;2.5;-0.25
133500000000200000;3.5;0.75
"""


def test_twincat_export_whose_sample_time_names_no_unit_opens(tmp_path):
    """As in two real exports: ``SampleTime;10;10``, ``(None)`` as unit, two rows ``Name``."""
    path = tmp_path / "scope.csv"
    path.write_text(TWINCAT)

    recording = ms.read(path)

    assert recording.metadata["format"] == "twincat-scope"
    np.testing.assert_allclose(recording.t, [0.0, 0.01, 0.02], rtol=0, atol=1e-12)
    assert recording.channels["X.ActPos"].tolist() == [1.5, 2.5, 3.5]
    assert recording.metadata["start_utc"].startswith("2024-01-17T21:20:00")


def lvm(notes, above="Channels\t2\t\t"):
    return (
        "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t.\n"
        "X_Columns\tOne\n***End_of_Header***\t\n\t\n"
        f"{notes}{above}\nSamples\t3\t3\t\nY_Unit_Label\tVolts\tVolts\t\n"
        "X_Dimension\tTime\tTime\t\nX0\t0.0\t0.0\t\nDelta_X\t0.5\t0.5\t\n"
        "***End_of_Header***\t\t\t\nX_Value\tprobe\tload\tComment\n"
        "0.0\t1.5\t-2.0\n0.5\t2.5\t-3.0\n1.0\t3.5\t-4.0\n"
    )


@pytest.mark.parametrize(
    "notes",
    ["Notes\trun 3, 20 mm/min\n", "Notes\tfirst line\nof two lines\n", "Operator\tAB\nNotes\tx\n"],
)
def test_labview_file_with_notes_opens_and_keeps_them(tmp_path, notes):
    path = tmp_path / "log.lvm"
    path.write_text(lvm(notes))

    recording = ms.read(path)

    assert recording.channels["probe"].tolist() == [1.5, 2.5, 3.5]
    kept = recording.metadata["header"]["file"]["remarks"]
    assert all(line.strip() in kept for line in notes.splitlines())


def test_rows_of_numbers_above_the_first_segment_are_not_taken_for_notes(tmp_path):
    path = tmp_path / "log.lvm"
    path.write_text(lvm("0.0\t1.5\t-2.0\n"))

    with pytest.raises(ms.errors.ReadError, match="line 8"):
        ms.read(path)
