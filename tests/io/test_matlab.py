"""MATLAB files: names, orientation, captures, real files of MATLAB against SciPy, damage."""

import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy import io as scipy_io

import metrosep as ms
from metrosep.io.containers import matlab, matlab as matlab_v5
from metrosep.io.containers.matlab import load
from metrosep.io.declared import Match
from metrosep.io.source import RawFile

SAMPLES = Path(__file__).parents[2] / "data_formats/matlab/samples"
SCIPY = Path(scipy_io.__file__).parent / "matlab/tests/data"
RTOL = 1e-12  # one multiplication in double precision
DAMAGED = {"bad_miuint32", "malformed1"}


@pytest.fixture
def save(tmp_path):
    """Write variables with SciPy and return the path."""

    def write(name="data.mat", *, packed=False, **variables):
        path = tmp_path / name
        scipy_io.savemat(path, variables, do_compression=packed, oned_as="column")
        return path

    return write


def captured(names, n=4, **extra):
    """Return a struct as dSPACE writes it."""
    traces = np.zeros((1, len(names)), dtype=[("Name", "O"), ("Data", "O")])
    for i, name in enumerate(names):
        traces[0, i] = (name, np.arange(n) * (i + 1.0))
    axis = {"Name": "time", "Data": 0.1 * np.arange(n)}
    return {"X": axis, "Y": traces, "Capture": {"SamplingPeriod": 0.1}, **extra}


@pytest.mark.parametrize("packed", [False, True])
def test_matrix_is_a_surface_with_row_1_at_the_smallest_y(save, packed):
    z = np.random.default_rng(1).normal(size=(7, 4))
    z[0, 3] = np.nan

    obj = ms.read(save(z=z, packed=packed), unit="nm", lateral_step=("2 um", "3 um"))

    np.testing.assert_allclose(obj.z, z * 1e-9, rtol=RTOL, atol=0)
    assert (obj.dx, obj.dy) == pytest.approx((2e-6, 3e-6), rel=RTOL, abs=0.0)
    assert obj.metadata["lateral_step_override_m"] == pytest.approx(
        (2e-6, 3e-6), rel=RTOL, abs=0.0
    )
    assert any("first row was taken" in w for w in obj.metadata["warnings"])


def test_uncalibrated_matrix_has_no_steps_and_needs_a_unit(save):
    path = save(z=np.eye(3))

    assert ms.read(path, unit="um").dx is None
    with pytest.raises(ms.errors.UnitError, match="declares no unit"):
        ms.read(path)
    with pytest.raises(ms.errors.UnitError, match="surface needs a length"):
        ms.read(path, unit="V")


def test_version_7_3_is_turned_back(tmp_path):
    z = np.arange(12.0).reshape(3, 4)
    path = tmp_path / "data.mat"
    with h5py.File(path, "w", userblock_size=512) as handle:
        handle["z"] = z.T
        handle["who"] = np.array([[ord(c)] for c in "Jane"], dtype="u2")
        handle["who"].attrs["MATLAB_class"] = np.bytes_(b"char")
        handle["none"] = np.array([0, 0], dtype="u8")
        handle["none"].attrs["MATLAB_empty"] = np.uint8(1)
        handle["s/v"] = np.array([[1.0, 2.0]])
        handle["#refs#/a"] = np.eye(4)
    text = b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM"
    path.write_bytes(text.ljust(512, b"\0") + path.read_bytes()[512:])

    obj = ms.read(path, unit="m")

    np.testing.assert_array_equal(obj.z, z)
    assert ms.io.read.channels(path) == ("z", "s.v")
    assert obj.metadata["header"]["texts"] == {"who": "Jane"}
    assert obj.metadata["header"]["version"] == "7.3"


def test_one_of_several_matrices_is_named(save):
    path = save(a=np.eye(2), b=2 * np.eye(3), s={"c": 3 * np.eye(4)}, n=5.0)

    assert ms.io.read.channels(path) == ("a", "b", "s.c")
    assert ms.read(path, channel="s.c", unit="m").z[0, 0] == 3.0
    with pytest.raises(ms.errors.FormatMismatchError, match="channel='a'"):
        ms.read(path, unit="m")
    with pytest.raises(ms.errors.FormatMismatchError, match=r"no matrix or vector 'd'.*'s.c'"):
        ms.read(path, unit="m", channel="d")


def test_single_numbers_and_texts_are_in_the_header(save):
    header = ms.read(save(z=np.eye(2), rate=50.0, note="part 7"), unit="m").metadata["header"]

    assert header["scalars"] == {"rate": 50}
    assert header["texts"] == {"note": "part 7"}
    assert header["shapes"] == {"z": "2 x 2"}


def test_vectors_of_one_length_become_a_recording(save):
    path = save(clock=np.arange(5.0), a=np.arange(5) ** 2, short=np.arange(3.0))

    obj = ms.read(path, time="clock:ms", unit={"a": "um"})

    np.testing.assert_allclose(obj.t, np.arange(5) * 1e-3, rtol=RTOL)
    np.testing.assert_allclose(obj["a"], np.arange(5) ** 2 * 1e-6, rtol=RTOL)
    assert tuple(obj.channels) == ("a",)
    assert len(ms.read(path, sampling_rate="10 Hz", channel="short")) == 3


def test_time_alone_is_no_recording(save):
    with pytest.raises(ms.errors.FormatMismatchError, match=r"nothing was measured"):
        ms.read(save(clock=np.arange(5.0), b=np.full(5, np.nan)), time="clock:s")
    with pytest.raises(ms.errors.FormatMismatchError, match=r"nothing was measured"):
        ms.read(save(clock=np.arange(5.0), b=1.0), time="clock:s")


def test_columns_of_a_matrix_are_vectors_where_a_time_is_named(save):
    path = save(m=np.array([[0.0, 5.0, 7.0], [0.5, 6.0, 8.0]]))

    obj = ms.read(path, time="m(:,1):s")

    np.testing.assert_array_equal(obj.t, [0.0, 0.5])
    np.testing.assert_array_equal(obj["m(:,3)"], [7.0, 8.0])
    assert "m(:,1)" in ms.read(path, sampling_rate=2.0, channel="m").channels


def test_vectors_become_a_profile(save):
    path = save(x=np.array([0.0, 1.0, 3.0]), z=np.array([5.0, np.nan, 4.0]))

    obj = ms.read(path, x=("x", "mm"), z=("z", "nm"))

    assert isinstance(obj, ms.Profile)
    np.testing.assert_allclose(obj.x, [0.0, 1e-3, 3e-3], rtol=RTOL)
    np.testing.assert_allclose(obj.z, [5e-9, np.nan, 4e-9], rtol=RTOL)


NAMES = ('"Model Root"/" EncoderX"/"Pos"', '"Model Root"/"Gap"')


@pytest.mark.parametrize("packed", [False, True])
def test_capture_is_a_recording_with_the_names_of_its_channels(save, packed):
    path = save(trial=captured(NAMES), packed=packed)

    obj = ms.read(path, unit={NAMES[1]: "um"})

    assert tuple(obj.channels) == NAMES == ms.io.read.channels(path)
    np.testing.assert_allclose(obj.t, [0.0, 0.1, 0.2, 0.3], rtol=RTOL)
    np.testing.assert_allclose(obj[NAMES[1]], [0.0, 2e-6, 4e-6, 6e-6], rtol=RTOL)
    assert obj.metadata["sampling_period_s"] == pytest.approx(0.1, rel=1e-9, abs=0.0)
    assert tuple(ms.read(path, channel=NAMES[0]).channels) == NAMES[:1]


def test_capture_without_times_has_its_sampling_period(save):
    record = captured(["a", "a"]) | {"X": {"Name": "time"}}

    obj = ms.read(save(trial=record))

    np.testing.assert_allclose(obj.t, [0.0, 0.1, 0.2, 0.3], rtol=RTOL)
    assert tuple(obj.channels) == ("a", "a (2)")


def test_one_of_several_captures_is_named(save):
    path = save(first=captured(["a"]), second=captured(["b"]))

    assert tuple(ms.read(path, channel="second").channels) == ("b",)
    with pytest.raises(ms.errors.FormatMismatchError, match="2 captures"):
        ms.read(path)


def test_times_of_another_length_are_refused(save):
    record = captured(["a"]) | {"X": {"Data": np.arange(3.0)}}

    with pytest.raises(ms.errors.CorruptFileError, match="differ in length"):
        ms.read(save(trial=record))


def test_several_axes_of_time_are_refused(save):
    axes = np.zeros((1, 2), dtype=[("Data", "O")])
    axes[0, 0], axes[0, 1] = (np.arange(4.0),), (np.arange(4.0),)

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="several axes of time"):
        ms.read(save(trial=captured(["a"]) | {"X": axes}))


def test_complex_numbers_are_named(save):
    path = save(c=np.array([1j, 2.0]))

    with pytest.raises(ms.errors.FormatMismatchError, match="'c' is complex"):
        ms.read(path, channel="c")
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="omitted: c"):
        ms.read(path)


@pytest.mark.parametrize("path", sorted(SCIPY.glob("*.mat")), ids=lambda p: p.stem)
def test_files_of_matlab_are_as_scipy_reads_them(path):
    version = matlab.sniff(RawFile(Path(), path.read_bytes()))
    is_old = path.stem.endswith(("4.2c_SOL2", "_4_GLNX86")) or "4" in path.stem[:9]
    if version is Match.NO:
        assert is_old or path.stem == "debigged_m4"
        return
    try:
        values = load(RawFile(path))
    except ms.errors.CorruptFileError:
        assert path.stem in DAMAGED or "corrupted" in path.stem
        return
    if values.header["version"] != "5.0" or path.stem == "nasty_duplicate_fieldnames":
        return
    try:
        truth = scipy_io.loadmat(path)
    except ValueError:  # SciPy refuses a name that is not ASCII
        return
    for name in set(truth) & set(values.numbers):
        np.testing.assert_array_equal(values.numbers[name], truth[name])
    assert {n for n, v in truth.items() if getattr(v, "dtype", None) is np.dtype(float)} <= {
        *values.numbers,
        *values.left_out,
    }


def damaged(offset, code, value):
    data = bytearray((SAMPLES / "map.mat").read_bytes())
    struct.pack_into("<" + code, data, offset, value)
    return RawFile(Path("map.mat"), bytes(data))


@pytest.mark.parametrize(
    ("offset", "code", "value", "match"),
    [
        (128, "I", 7, "expected a matrix in"),
        (132, "I", 2**31, "a variable does not fit"),
        (136, "I", 5, "expected type 6 with 2 values"),
        (144, "B", 99, "a known class"),
        (160, "i", -2, "the dimensions"),
        (160, "i", 2**31 - 1, "an array"),
        (168, "I", 5 << 16 | 1, "1 to 4 bytes"),
        (176, "I", 77, "found type 77"),
        (180, "I", 40, "an array"),
    ],
)
def test_false_size_is_named(offset, code, value, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        matlab.read(damaged(offset, code, value), unit="nm")


def test_packed_variable_is_inflated_to_its_claim_only(save):
    packed = zlib.compress(struct.pack("<II", 14, 16) + bytes(2**24))
    content = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + struct.pack("<II", 15, len(packed))
    file = RawFile(Path("bomb.mat"), content + packed)

    with pytest.raises(ms.errors.CorruptFileError, match="a packed variable does not fit"):
        matlab.read(file)
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="max_pixels="):
        ms.read(save(z=np.zeros((50, 50)), packed=True), max_pixels=99, unit="m")


def test_deep_nesting_is_refused(save):
    nested = np.eye(2)
    for _ in range(30):
        nested = {"a": nested}

    with pytest.raises(ms.errors.CorruptFileError, match="at depth"):
        ms.read(save(s=nested), unit="m")


def test_other_text_is_no_matlab_file():
    assert matlab.sniff(RawFile(Path("a.mat"), b"MATLAB 5.0 MAT-file".ljust(200))) is Match.NO
    assert matlab.sniff(RawFile(Path("a.mat"), b"MATLAB 7.3 MAT-file".ljust(600))) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="-v7"):
        matlab.read(RawFile(Path("a.mat"), bytes(200)))
    with pytest.raises(ms.errors.CorruptFileError, match="endian"):
        matlab_v5.byte_order(RawFile(Path("a.mat"), bytes(200)))


@pytest.mark.parametrize("name", ["map.mat", "packed-big-endian.mat", "in-a-struct.mat"])
def test_damage_is_refused_or_harmless(name, survives_damage):
    survives_damage(matlab, SAMPLES / name, every=3, unit="nm")


def test_damaged_capture_is_refused_or_harmless(save, survives_damage):
    survives_damage(matlab, save(trial=captured(["a"])), every=11)
