"""HDF5 files are read by a process of its own: no claim, link or crash reaches the caller."""

import os
import struct
from pathlib import Path

import h5py
import numpy as np
import pytest

import metrosep as ms
from metrosep.io.containers import hdf5_file
from metrosep.io.containers.hdf5_file import open_hdf5
from metrosep.io.source import HDF5_MAGIC, RawFile, has_hdf5_magic, open_file


@pytest.fixture
def tree(tmp_path):
    """A file with every kind of object, and its path."""
    path = tmp_path / "tree.h5"
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as other:
        other["a"] = np.arange(4.0)
    with h5py.File(path, "w") as handle:
        handle.attrs["text"] = "name"
        handle.attrs["bytes"] = np.bytes_(b"mm ")
        handle.attrs["one"] = np.array([3.5])
        handle.attrs["many"] = np.array([1, 2, 3])
        handle.attrs["flag"] = True
        handle.attrs["record"] = np.array([(b"a", 1.5)], dtype=[("name", "S3"), ("value", "f8")])
        handle["group/flat"] = np.arange(12, dtype=">i4").reshape(3, 4)
        handle.create_dataset("packed", data=np.arange(50.0), compression="gzip")
        bomb = {"shape": (16000, 16000), "dtype": "f4", "chunks": (100, 100)}
        handle.create_dataset("bomb", compression="gzip", **bomb)[0, 0] = 1.0
        handle.create_dataset("unwritten", shape=(1000,), dtype="f8")
        handle["texts"] = np.array([b"ab", b"c"])
        handle["reference"] = handle["packed"].ref
        handle["out"] = h5py.ExternalLink("secret.h5", "/a")
        handle["soft"] = h5py.SoftLink("/packed")
        handle["loop"] = handle["/"]
        handle.create_dataset("elsewhere", shape=(4,), dtype="f8", external=[(str(secret), 0, 32)])
        layout = h5py.VirtualLayout(shape=(4,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(secret), "a", shape=(4,))
        handle.create_virtual_dataset("virtual", layout)
    return path


@pytest.fixture(params=["path", "memory"])
def opened(tree, request):
    """The file opened from its path, and from bytes."""
    raw = open_file(tree) if request.param == "path" else RawFile(tree, tree.read_bytes())
    with open_hdf5(raw) as handle:
        yield handle


def test_attributes_are_plain(opened):
    found = opened.attributes("/")

    assert found == {
        "text": "name",
        "bytes": "mm",
        "one": 3.5,
        "many": [1, 2, 3],
        "flag": True,
        "record": {"name": "a", "value": 1.5},
    }


def test_numbers_are_those_of_the_file(opened):
    np.testing.assert_array_equal(opened.read("/group/flat"), np.arange(12).reshape(3, 4))
    np.testing.assert_array_equal(opened.read("/group/flat", start=1, stop=2), [[4, 5, 6, 7]])
    np.testing.assert_array_equal(opened.read("/packed"), np.arange(50.0))
    np.testing.assert_array_equal(opened.read("/packed", start=48, stop=99), [48.0, 49.0])


def test_links_are_not_followed(opened):
    assert not {"/out", "/soft", "/loop"} & {*opened.datasets, *opened.groups}


@pytest.mark.parametrize("name", ["/elsewhere", "/virtual"])
def test_data_in_other_files_is_not_read(opened, name):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="lies in another file"):
        opened.read(name)


@pytest.mark.parametrize("name", ["/bomb", "/unwritten"])
def test_claims_without_storage_are_refused(opened, name):
    with pytest.raises(ms.errors.CorruptFileError, match="claims more than is stored"):
        opened.read(name)


def test_what_is_no_number_is_refused(opened):
    assert opened.rows("/texts") == ["ab", "c"]
    assert not opened.is_numeric("/texts")
    for name in ("/texts", "/reference"):
        with pytest.raises(ms.errors.UnsupportedFeatureError, match="plain numbers"):
            opened.read(name)


def test_missing_dataset_is_named(opened):
    with pytest.raises(ms.errors.CorruptFileError, match="/nothing"):
        opened.read("/nothing")


def test_more_values_than_allowed_are_refused(opened):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="max_pixels="):
        opened.read("/packed", max_pixels=49)


def test_highly_compressed_data_needs_a_word_of_the_caller(tmp_path):
    path = tmp_path / "zeros.h5"
    with h5py.File(path, "w") as handle:
        handle.create_dataset("z", data=np.zeros(10**6), chunks=(10**5,), compression="gzip")

    with open_hdf5(open_file(path)) as handle:
        with pytest.raises(ms.errors.CorruptFileError, match="claims more"):
            handle.read("/z")

        assert handle.read("/z", max_pixels=10**6).shape == (10**6,)


def test_process_that_died_meanwhile_is_replaced(tree):
    with open_hdf5(open_file(tree)) as handle:
        hdf5_file._WORKER._process.kill()
        hdf5_file._WORKER._process.wait()

        np.testing.assert_array_equal(handle.read("/packed", start=0, stop=2), [0.0, 1.0])


def test_two_files_may_be_open_at_once(tree, tmp_path):
    second = tmp_path / "second.h5"
    with h5py.File(second, "w") as handle:
        handle.create_dataset("packed", data=-np.arange(50.0), compression="gzip")

    with open_hdf5(open_file(tree)) as one, open_hdf5(open_file(second)) as two:
        assert one.read("/packed")[3] == 3.0
        assert two.read("/packed")[3] == -3.0


def test_a_module_in_the_working_folder_is_not_imported(tree, tmp_path, monkeypatch):
    trap = tmp_path / "trap"
    trap.mkdir()
    (trap / "h5py.py").write_text("raise SystemExit", encoding="utf-8")
    monkeypatch.chdir(trap)
    hdf5_file._WORKER.stop()

    with open_hdf5(open_file(tree)) as handle:
        assert "/packed" in handle


def test_forked_process_has_its_own_worker(tree):
    with open_hdf5(open_file(tree)):
        number = hdf5_file._WORKER._process.pid

    child = os.fork()
    if child == 0:
        with open_hdf5(open_file(tree)) as handle:
            fine = handle.read("/packed")[1] == 1.0 and hdf5_file._WORKER._process.pid != number
        hdf5_file._WORKER.stop()
        os._exit(0 if fine else 1)

    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_other_content_is_refused(tmp_path):
    with (
        pytest.raises(ms.errors.FormatMismatchError, match="not an HDF5 file"),
        open_hdf5(RawFile(tmp_path / "a.h5", b"no magic here")),
    ):
        pass


def test_magic_may_follow_a_user_block():
    for before, found in ((512, True), (2**16, True), (100, False), (1536, False)):
        assert has_hdf5_magic(RawFile(Path("a.h5"), bytes(before) + HDF5_MAGIC)) is found
    assert not has_hdf5_magic(RawFile(Path("a.h5"), b""))


def test_offset_beyond_the_end_is_refused(tmp_path):
    path = tmp_path / "cut.h5"
    with h5py.File(path, "w", libver="earliest") as handle:
        data = handle.create_dataset("z", data=np.arange(8.0))
        where = data.id.get_offset()
    content = path.read_bytes()
    at = content.index(struct.pack("<QQ", where, 64))
    moved = content[:at] + struct.pack("<Q", len(content) - 8) + content[at + 8 :]

    with (
        pytest.raises(ms.errors.CorruptFileError, match=r"invalid dataset size|beyond the end"),
        open_hdf5(RawFile(path, moved)) as handle,
    ):
        handle.read("/z")
