"""Recognition by content; plug-ins only after the built-in readers; files that are not files."""

import bz2
import gzip
import hashlib
import lzma
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

import metrosep as ms
from metrosep.io import registry
from metrosep.io.check import describe
from metrosep.io.declared import Match
from metrosep.io.read import channels
from metrosep.io.source import open_file


def test_formats_lists_measurements_and_compensations():
    known = {f.id: f for f in registry.formats()}

    assert {"delimited", "metropro", "x3p", "linuxcnc-comp", "neutral-table"} <= set(known)
    assert known["x3p"].writes
    assert not known["metropro"].writes
    assert not known["linuxcnc-comp"].is_measurement


def test_get_names_the_formats_there_are():
    with pytest.raises(ms.errors.UnknownFormatError, match="metropro"):
        registry.get("metrpro")


def test_suffix_alone_is_never_enough(put):
    path = put(b"\x00\x01\x02 no map at all", "map.x3p")

    with pytest.raises(ms.errors.UnknownFormatError, match="no reader knows"):
        registry.identify(path)


def test_two_sure_readers_are_refused(put, monkeypatch):
    path = put("x_mm,z_um\n0,1\n1,2\n")
    monkeypatch.setattr(registry.Format, "recognise", lambda self, file: Match.YES)

    with pytest.raises(ms.errors.AmbiguousFormatError, match="format="):
        registry.identify(path)


@pytest.fixture
def plugin(monkeypatch):
    """Entry point of a reader that claims every file."""
    asked = []

    def sniff(file):
        asked.append(file.name)
        return Match.YES if file.head.startswith(b"\x07lion") else Match.NO

    def read(file, *, channel=None, lateral_step=None, unit=None):
        return ms.Surface([[0.0, 1e-9]], history=file.history("lion"))

    reader = SimpleNamespace(sniff=sniff, read=read, channels=lambda file: ("height",))
    entry = SimpleNamespace(name="lion", load=lambda: reader)
    monkeypatch.setattr(
        "importlib.metadata.entry_points", lambda group: [entry] if "metrosep" in group else []
    )
    return asked


def test_plugin_reads_what_no_builtin_knows(put, plugin):
    surface = ms.read(put(b"\x07lion\x00\x01", "a.bin"))

    assert surface.history[0].parameters["format"] == "lion"
    assert "lion" in {f.id for f in registry.formats()}


def test_plugin_is_not_asked_when_a_builtin_knows(put, plugin):
    ms.read(put("x_mm,z_um\n0,1\n1,2\n"))

    assert plugin == []


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("absent.csv", "no such file"),
        (".", "is a folder"),
        ("empty.csv", "empty"),
        ("a\0b.csv", "check the path"),
    ],
)
def test_what_is_no_file_is_a_read_error(tmp_path, name, match):
    (tmp_path / "empty.csv").write_bytes(b"")

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(tmp_path / name)


def test_no_permission_is_a_read_error(put, monkeypatch):
    path = put("x_mm,z_um\n0,1\n")

    def refuse(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.read_bytes", refuse)
    with pytest.raises(ms.errors.ReadError, match="permission"):
        ms.read(path)


def test_table_of_a_controller_is_not_a_measurement(repository):
    path = repository / "data_formats" / "linuxcnc-comp" / "samples" / "x.comp"

    with pytest.raises(ms.errors.ReadError, match=r"metrosep\.controllers"):
        ms.read(path, format="linuxcnc-comp")


def test_unknown_option_is_named(put):
    with pytest.raises(ms.errors.ReadError, match=r"seperator.*separator"):
        ms.read(put("x_mm,z_um\n0,1\n1,2\n"), seperator=",")


def test_io_imports_nothing_heavy():
    code = (
        "import sys, metrosep.io, metrosep.io.read, metrosep.io.runs, metrosep.io.write;"
        "print([m for m in ('pandas','lmfit','matplotlib','scipy','h5py') if m in sys.modules])"
    )

    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert out.stdout.strip() == "[]"


def test_describe_a_surface_in_plain_values(repository):
    sample = repository / "data_formats" / "x3p" / "samples" / "double.x3p"

    facts = describe(sample)

    assert facts["format"] == "x3p"
    assert facts["kind"] == "surface"
    assert facts["shape"] == [4, 3]
    assert facts["dx_m"] == pytest.approx(1.5e-6, rel=1e-12, abs=0.0)
    assert facts["n_invalid"] == 1
    assert facts["pv_nm"] == pytest.approx(96.0, abs=1e-9)
    heights = np.array([0, 1, 90, 2, 3, 4, 5, -6, 7, 8, 9])
    assert facts["mean_nm"] == pytest.approx(heights.mean(), abs=1e-9)
    assert facts["sq_nm"] == pytest.approx(heights.std(), abs=1e-9)


def test_describe_lists_the_columns_of_repeated_runs(put):
    facts = describe(put("run,feed_mm_min,x_mm,z_um\n0,7200,0,1\n0,7200,1,\n1,9600,0,3\n"))

    assert facts["kind"] == "table"
    assert facts["shape"] == [3, 4]
    assert facts["n_invalid"] == 1
    assert facts["pv_nm"] is None
    assert [(c["name"], c["unit"]) for c in facts["metadata"]["columns"]] == [
        ("run", None),
        ("feed_mm_min", "mm/min"),
        ("x_mm", "mm"),
        ("z_um", "um"),
    ]


def test_channels_are_the_labels_of_a_stacked_export(repository):
    sample = repository / "data_formats" / "delimited" / "samples" / "stacked.csv"

    assert channels(sample) == ("left", "right")


def test_the_slow_reader_of_tables_is_asked_only_when_no_other_is_sure(put, monkeypatch):
    from metrosep.io.text import delimited

    asked = []
    sniff = delimited.sniff
    monkeypatch.setattr(delimited, "sniff", lambda file: asked.append(file.name) or sniff(file))
    surface = ms.Surface(np.arange(12.0).reshape(3, 4) * 1e-9, 1e-6, 1e-6)
    target = put(b"", "a.sdf").with_name("b.sdf")
    ms.write(surface, target)
    assert registry.identify(target).id == "sdf"
    assert not asked
    assert registry.identify(put("x / mm,z / nm\n0,1\n1,2\n2,3\n", "b.txt")).id == "delimited"
    assert asked == ["b.txt"]


def test_the_reader_of_tables_is_never_sure(repository):
    """Otherwise it must be asked with the others, so that two sure readers are refused."""
    from metrosep.io.text import delimited

    files = [f for f in sorted((repository / "data_formats").rglob("*.*")) if f.is_file()]
    assert len(files) > 50
    for file in files:
        assert delimited.sniff(open_file(file)) is not Match.YES, file.name


@pytest.mark.parametrize(
    ("start", "program"),
    [(b"\x28\xb5\x2f\xfd", "Zstandard"), (b"7z\xbc\xaf\x27\x1c", "7-Zip")],
)
def test_a_file_of_a_packer_that_is_not_known_is_called_so(put, monkeypatch, start, program):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)  # without pyarrow
    with pytest.raises(ms.errors.UnknownFormatError, match=f"compressed with {program}; .*unpack"):
        ms.read(put(start + bytes(range(200)), "map.x3p.gz"))


class Zstandard:
    @staticmethod
    def compress(data):
        return pytest.importorskip("pyarrow").compress(data, codec="zstd", asbytes=True)


def test_a_zstandard_file_that_is_cut_or_swells_is_refused(put):
    packed = Zstandard.compress(b"x_mm,z_um\n" + b"1,1\n" * 40_000_000)
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="more than 67108864 bytes"):
        ms.read(put(packed, "table.csv.zst"))
    with pytest.raises(ms.errors.ReadError, match="cannot be unpacked"):
        ms.read(put(Zstandard.compress(b"x_mm,z_um\n0,1\n1,2\n2,5\n")[:-9], "table.csv.zst"))


@pytest.mark.parametrize("pack", [gzip, bz2, lzma, Zstandard])
@pytest.mark.parametrize("sample", ["delimited/samples/comma.csv", "sdf/samples/binary-type5.sdf"])
def test_a_compressed_file_is_read_as_what_it_holds(put, repository, pack, sample):
    plain = repository / "data_formats" / sample
    packed = put(pack.compress(plain.read_bytes()), "data.packed")

    one, other = ms.read(plain), ms.read(packed)

    np.testing.assert_array_equal(one.z, other.z)
    assert one.metadata["format"] == other.metadata["format"]
    assert other.metadata["sha256"] == hashlib.sha256(packed.read_bytes()).hexdigest()


@pytest.mark.parametrize("pack", [gzip, bz2, lzma])
def test_runs_and_chunks_come_out_of_a_compressed_file(put, pack):
    text = "t_s,z_um\n" + "".join(f"{i},{i * i % 7}\n" for i in range(50))
    path = put(pack.compress(text.encode()), "runs.csv.gz")

    with ms.io.open_stream(path) as stream:
        chunks = [c["z_um"] for c in stream.chunks(20)]
    assert sum(map(len, chunks)) == 50
    np.testing.assert_allclose(np.concatenate(chunks)[3], 2e-6, rtol=1e-15)


@pytest.mark.parametrize("pack", [gzip, bz2, lzma])
def test_a_damaged_or_huge_compressed_file_is_refused_in_one_sentence(put, pack, monkeypatch):
    whole = pack.compress(b"x_mm,z_um\n" + b"0,1\n" * 1000)
    with pytest.raises(ms.errors.ReadError, match="cannot be unpacked"):
        ms.read(put(whole[: len(whole) // 2], "cut.gz"))
    monkeypatch.setattr("metrosep.io.source._UNASKED", 1000)
    with pytest.raises(ms.errors.ReadError, match="more than"):
        ms.read(put(pack.compress(bytes(10**6)), "bomb.gz"))
    with pytest.raises(ms.errors.ReadError, match="0 bytes"):
        ms.read(put(pack.compress(b""), "empty.gz"))


@pytest.mark.parametrize(
    ("sample", "module"),
    [
        ("sdf/samples/binary-type5.sdf", "maps.sdf"),
        ("x3p/samples/double.x3p", "maps.x3p"),
        ("fourd/samples/one.h5", "containers.interferometers"),
        ("delimited/samples/comma.csv", "text.delimited"),
    ],
)
def test_only_the_reader_that_the_first_bytes_call_for_is_loaded(repository, sample, module):
    builtin = [f for f in registry.formats() if f.reader.startswith("builtin:")]
    readers = {f.reader.split(":")[1] for f in builtin}
    code = (
        "import sys, metrosep as ms\n"
        f"ms.read({str(repository / 'data_formats' / sample)!r})\n"
        "print(*(m[12:] for m in sys.modules if m.startswith('metrosep.io.')))\n"
    )

    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    loaded = set(out.stdout.split())
    assert loaded & readers == {module}
    assert len(loaded) <= 22


def test_every_reader_has_one_declaration():
    for known in registry.formats():
        if known.reader.startswith("builtin:"):
            sniff = known.load_reader().sniff
            assert known.marks.closer == (sniff.__module__ != "metrosep.io.registry"), known.id


@pytest.mark.parametrize("content", [b"\n" * 65536, b" \t" * 32768, b"GRD " * 16384, b"a" * 65536])
def test_no_mark_takes_long_on_a_hostile_head(put, content):
    start = time.process_time()

    with pytest.raises(ms.errors.ReadError):
        ms.read(put(content, "head.txt"))

    assert time.process_time() - start < 2.0


PLANTED = """id = "planted"
title = "Planted"
vendor = "test"
kind = "surface"
suffixes = [".pl"]
reader = "builtin:maps.planted"
reads = true
writes = false
status = "synthetic"

[recognise]
what = "a planted file"
expected = "'PLANT' at offset 0"
sure = "PLANT"

[structures.header]
order = "<"
fields = \"\"\"
5 H columns
7 H rows
9 d step um
\"\"\"
"""


def test_a_new_format_is_one_folder_and_one_module(put, tmp_path, monkeypatch):
    from metrosep.io.objects import map_reader
    from metrosep.io.registry import demand, sniffer, structure

    (tmp_path / "planted").mkdir()
    (tmp_path / "planted" / "format.toml").write_text(PLANTED)

    @map_reader("planted", "planted", "a planted file in metres")
    def read(asked):
        demand(asked.file, "planted")
        header = structure("planted").read(asked.file)
        columns, rows = header.area("columns", "rows", asked.max_pixels)
        step = header.step("step", asked.warnings)
        z = np.frombuffer(asked.file.data, "<f8", columns * rows, 17).reshape(rows, columns)
        return asked.surface(z, (step, step), row_order="smallest y first", header=header)

    module = SimpleNamespace(sniff=sniffer("planted"), read=read, channels=lambda f: ("height",))
    monkeypatch.setitem(sys.modules, "metrosep.io.maps.planted", module)
    caches = (registry._own_descriptors, registry._own_by_id)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(registry, "_format_folder", lambda: tmp_path)
            for cache in caches:
                cache.cache_clear()
            z = np.arange(6.0).reshape(2, 3) * 1e-9
            good = structure("planted").pack({"columns": 3, "rows": 2, "step": 2.0}, 17)
            path = put(b"PLANT" + good[5:] + z.tobytes(), "a.bin")
            with pytest.raises(ms.errors.AmbiguousFormatError, match="row_order="):
                ms.read(path)  # its description says nothing about the rows
            surface = ms.read(path, row_order="smallest y first")
            np.testing.assert_array_equal(surface.z, z)
            assert surface.dx == pytest.approx(2e-6, rel=1e-12, abs=0.0)
            with pytest.raises(
                ms.errors.FormatMismatchError, match=r"not a planted file.*offset 0"
            ):
                ms.read(put(b"other", "b.bin"), format="planted")
            with pytest.raises(ms.errors.ReadError, match="columns, at offset 5"):
                ms.read(put(b"PLANT" + bytes(12), "c.bin"))
    finally:
        for cache in caches:
            cache.cache_clear()


@pytest.mark.parametrize(
    "program",
    [
        "%\r\nO0007 (SPHERE)\r\nG21 G90\r\nX1\r\n",
        "G0X1Z1\nG1Z0\n",
        "(TIP)\n;a\nN10 G18\nX2. Z3.\n",
    ],
)
def test_a_program_is_named_with_what_takes_it(tmp_path, program):
    (tmp_path / "part.nc").write_text(program)
    with pytest.raises(
        ms.errors.ReadError, match=r"program of G-code, not a measurement; 'metrosep path'"
    ):
        ms.read(tmp_path / "part.nc")


@pytest.mark.parametrize("text", ["G1,G2\nx,1\ny,2\n", "G1x\nabc\ndef\nxyz\n"])
def test_words_that_only_look_like_a_program_are_none(tmp_path, text):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(ms.errors.ReadError) as told:
        ms.read(tmp_path / "a.txt")
    assert "G-code" not in str(told.value)
