"""metrosep's own HDF5: what is written comes back bit for bit, and damage is refused."""

import h5py
import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.provenance import Step
from metrosep.core.runset import Run, RunSet
from metrosep.io.containers import native
from metrosep.io.containers.native import native_bytes
from metrosep.io.read import read_one
from metrosep.io.source import RawFile

METADATA = {
    "operator": "J\u00fcrgen",
    "warnings": ("one", "two"),
    "window_px": (1, 2),
    "nested": {"values": [1.5, float("inf"), None, True], "empty": ()},
}
HISTORY = (Step("read", {"file": "a.dat", "steps_m": (1e-6, None)}, "0.0.1"), Step("level", {}))


@pytest.fixture
def there_and_back(put):
    """Return what is read of a written object."""

    def read(obj, **options):
        return ms.read(put(native_bytes(obj), "object.h5"), **options)

    return read


def bits(values):
    return values.view(np.uint64)


def runset():
    x = np.linspace(10e-3, 0.0, 7)
    z = np.array([1e-9, 1 / 3, np.nan, -0.0, 5e-324, 1e300, 2.0])
    return RunSet(
        [
            Run(x, z, feed=0.08, run_id="r1", metadata={"n": 1, "pair": (1, 2)}),
            Run(x[::-1], z, run_id="no time"),
            Run(x, -z, t=np.arange(7) * 0.1, run_id="r3"),
        ],
        metadata=METADATA,
        history=HISTORY,
    )


def test_surface_is_the_same(there_and_back, bump):
    z = np.array(bump.z)
    z[1, 1], z[1, 2] = -0.0, 5e-324
    written = ms.Surface(z, 1 / 3e6, None, origin=(0.1, -0.2), metadata=METADATA, history=HISTORY)

    obj = there_and_back(written)

    np.testing.assert_array_equal(bits(obj.z), bits(written.z))
    assert (obj.dx, obj.dy, obj.origin) == (written.dx, None, (0.1, -0.2))
    assert obj.history[:-1] == HISTORY
    assert {k: obj.metadata[k] for k in METADATA} == dict(written.metadata)


def test_history_goes_on_and_the_first_source_stays(there_and_back, bump):
    source = {"format": "metropro", "file": "a.dat", "sha256": "00", "header": {"sign": 1}}

    obj = there_and_back(ms.Surface(bump.z, 1e-6, 1e-6, metadata=source, history=HISTORY))

    assert [s.name for s in obj.history] == ["read", "level", "read"]
    assert obj.history[-1].parameters["sha256"] == obj.metadata["sha256"]
    assert obj.metadata["format"] == "metrosep-h5"
    assert obj.metadata["source"] == source


def test_profile_is_the_same(there_and_back):
    written = ms.Profile([0.0, 1 / 3, 0.7], [1e-9, np.nan, -0.0], history=HISTORY)

    obj = there_and_back(written)

    np.testing.assert_array_equal(bits(obj.x), bits(written.x))
    np.testing.assert_array_equal(bits(obj.z), bits(written.z))


@pytest.mark.parametrize(
    "empty",
    [
        ms.Surface(np.full((3, 5), np.nan), 1e-6, 2e-6),
        ms.Profile([0.0, 0.1, 0.3], [np.nan] * 3),
    ],
)
def test_heights_that_are_all_missing_are_refused_when_they_are_written(empty, tmp_path):
    path = tmp_path / "empty.h5"
    with pytest.raises(ms.errors.WriteError) as caught:
        ms.write(empty, path)
    assert str(caught.value) == (
        f"{path}: nothing was measured, so there is nothing to write as HDF5"
    )
    assert not path.exists()


@pytest.mark.parametrize(
    "full",
    [ms.Surface(np.zeros((3, 5)), 1e-6, 2e-6), ms.Profile([0.0, 0.1, 0.3], [0.0] * 3)],
)
def test_a_file_of_heights_that_are_all_missing_says_so(full, tmp_path, capsys):
    path = tmp_path / "empty.h5"
    ms.write(full, path)
    with h5py.File(path, "r+") as handle:
        handle["z"][...] = np.nan
    with pytest.raises(SystemExit):
        main(["measure", str(path)])
    assert capsys.readouterr().err == (
        f"error: {path}: no point was measured; write the object again from before it was masked\n"
    )


def test_recording_is_the_same(there_and_back):
    channels = {"gap/left": [1e-9, np.nan, 3.0], "a": [1.0, 2.0, -0.0], "\u03b8": [0.1, 0.2, 0.3]}
    written = ms.Recording([0.0, 0.1, 0.3], channels, units={"gap/left": "m", "a": ""})

    obj = there_and_back(written)

    assert list(obj.channels) == list(channels)
    assert dict(obj.units) == dict(written.units)
    np.testing.assert_array_equal(bits(obj.t), bits(written.t))
    for name in channels:
        np.testing.assert_array_equal(bits(obj[name]), bits(written[name]))


def test_one_channel_of_a_recording(there_and_back, put):
    written = ms.Recording([0.0, 1.0], {"a": [1.0, 2.0], "b": [3.0, 4.0]}, units={"b": "m"})
    path = put(native_bytes(written), "two.h5")

    obj = ms.read(path, channel="b")

    assert (list(obj.channels), dict(obj.units)) == (["b"], {"b": "m"})
    assert ms.io.read.channels(path) == ("a", "b")
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="no metrosep-h5 channel 'c'"):
        ms.read(path, channel="c")


def test_runset_is_the_same(put):
    written = runset()

    obj = ms.read_runs(put(native_bytes(written), "runs.h5"))

    assert obj.history[:-1] == HISTORY
    assert [r.run_id for r in obj] == ["r1", "no time", "r3"]
    for new, old in zip(obj, written, strict=True):
        np.testing.assert_array_equal(bits(new.x), bits(old.x))
        np.testing.assert_array_equal(bits(new.z), bits(old.z))
        assert (new.t is None) == (old.t is None)
        assert old.t is None or np.array_equal(new.t, old.t)
        assert (new.feed, dict(new.metadata)) == (old.feed, dict(old.metadata))


def test_second_writing_gives_the_same_bytes(bump):
    assert native_bytes(bump) == native_bytes(bump)
    assert native_bytes(runset()) == native_bytes(runset())


def test_numbers_are_contiguous_float64_and_carry_no_time(put, bump):
    path = put(native_bytes(bump), "plain.h5")

    with h5py.File(path) as handle:
        data = handle["z"]
        assert (data.chunks, data.dtype) == (None, np.dtype("<f8"))
        assert h5py.h5o.get_info(data.id).mtime == 0
        np.testing.assert_array_equal(data[()], bump.z)


def test_lateral_step_is_replaced_and_recorded(there_and_back, bump):
    obj = there_and_back(bump, lateral_step=("3 um", "4 um"))

    assert (obj.dx, obj.dy) == pytest.approx((3e-6, 4e-6), rel=1e-9, abs=0.0)
    assert obj.metadata["lateral_step_in_file_m"] == (bump.dx, bump.dy)
    assert obj.history[-1].parameters["lateral_step_m"] == pytest.approx(
        (3e-6, 4e-6), rel=1e-9, abs=0.0
    )


def test_damaged_runset_is_refused_or_whole(tmp_path):
    data = native_bytes(RunSet([Run([0.0, 1.0, 2.0], [1e-9, 2e-9, 3e-9], feed=0.1)]))
    path = tmp_path / "runs.h5"
    outcomes = []

    for i in range(0, len(data), 37):
        content = data[:i] + bytes([data[i] ^ 0xFF]) + data[i + 1 :]
        try:
            obj = native.read(RawFile(path, content))
        except ms.errors.ReadError as exc:
            outcomes.append(path.name in str(exc))
        else:
            outcomes.append(any(np.isfinite(run.z).any() for run in obj))

    assert all(outcomes)


@pytest.mark.parametrize("name", ["history_json", "metadata_json"])
def test_text_that_is_no_json_is_refused(put, bump, name):
    path = put(native_bytes(bump), "text.h5")
    with h5py.File(path, "r+") as handle:
        del handle[name]
        handle[name] = np.frombuffer(b"[" * 9000, dtype=np.uint8)

    with pytest.raises(ms.errors.CorruptFileError, match=name):
        ms.read(path)


def test_other_type_of_number_is_refused(put, bump):
    path = put(native_bytes(bump), "single.h5")
    with h5py.File(path, "r+") as handle:
        del handle["z"]
        handle["z"] = np.array(bump.z, dtype=np.float32)

    with pytest.raises(ms.errors.CorruptFileError, match="float64"):
        ms.read(path)


def test_the_wrong_door_is_named(put, bump):
    with pytest.raises(ms.errors.FormatMismatchError, match=r"metrosep\.read_runs"):
        read_one(put(native_bytes(runset()), "runs.h5"))
    with pytest.raises(ms.errors.FormatMismatchError, match="holds a surface, not runs"):
        ms.read_runs(put(native_bytes(bump), "surface.h5"))


def test_runs_are_cut_from_the_recordings_of_loggers(put):
    """One file per run; the clock is the recording's own, the units are the channels'."""
    t = np.arange(100) / 1e3
    for i, sign in enumerate((1, -1)):
        x = 10e-3 + sign * 0.08 * t
        recording = ms.Recording(
            t, {"encoder": x, "probe": 1e-6 * np.sin(x * 600), "T": t}, units={"encoder": "m"}
        )
        put(native_bytes(recording), f"run{i}.h5")
    paths = [put(b"", "x").with_name(f"run{i}.h5") for i in range(2)]

    runs = ms.read_runs(paths, x="encoder", z=("probe", "m"))

    assert [r.direction for r in runs] == [1, -1]
    assert runs.feeds == pytest.approx((0.08,), rel=1e-9, abs=0.0)
    np.testing.assert_array_equal(runs.runs[1].t, t)
    assert runs.history[0].parameters["format"] == "metrosep-h5"
    with pytest.raises(ms.errors.UnitError, match="probe"):
        ms.read_runs(paths, x="encoder", z="probe")


# What `save` wrote, at the door for files


def saved_things():
    x = np.linspace(0.0, 0.01, 21)
    z = np.arange(12.0).reshape(3, 4) * 1e-9
    return [
        ms.Surface(z, 2e-6, 3e-6, origin=(1e-3, 2e-3), metadata={"part": "lens 7"}),
        ms.Profile(x, 1e-6 * x),
        ms.Recording(x, {"gap": 1e-6 * x}, units={"gap": "m"}),
        ms.RunSet([ms.Run(x, 1e-6 * x, feed=0.05, run_id="07"), ms.Run(x[::-1], x, run_id="7")]),
    ]


@pytest.mark.parametrize("obj", saved_things(), ids=lambda o: type(o).__name__)
def test_what_save_wrote_is_read_in_si(tmp_path, obj, capsys):
    path = tmp_path / "saved.h5"
    obj.save(path)

    back = ms.read(path)

    assert type(back) is type(obj)
    if isinstance(obj, ms.RunSet):
        assert [r.run_id for r in back] == ["07", "7"]
        assert [r.z.tolist() for r in back] == [r.z.tolist() for r in obj]
        assert len(ms.read_runs(path)) == 2
    elif isinstance(obj, ms.Recording):
        assert back.channels["gap"].tolist() == obj.channels["gap"].tolist()
    else:
        assert back.z.tolist() == obj.z.tolist()
    if isinstance(obj, ms.Surface):
        assert (back.dx, back.dy, back.origin) == (obj.dx, obj.dy, obj.origin)
        assert back.metadata["part"] == "lens 7"
    assert back.history[-1].parameters["sha256"] == back.metadata["sha256"]
    with pytest.raises(SystemExit) as stop:
        main(["info", str(path)])
    assert stop.value.code == 0, capsys.readouterr().err


@pytest.mark.parametrize(
    "asked", [{"unit": "nm"}, {"channel": "/array_0"}, {"lateral_step": 1e-6}]
)
def test_no_unit_or_step_is_put_on_what_save_wrote(tmp_path, asked):
    saved_things()[0].save(tmp_path / "map.h5")

    with pytest.raises(ms.errors.ReadError, match="object that metrosep saved"):
        ms.read(tmp_path / "map.h5", **asked)


def test_another_object_that_save_wrote_is_for_load(tmp_path):
    saved_things()[3][0].save(tmp_path / "run.h5")

    with pytest.raises(ms.errors.ReadError, match=r"metrosep\.load"):
        ms.read(tmp_path / "run.h5")


def test_saved_numbers_that_do_not_fit_are_refused(tmp_path):
    path = tmp_path / "map.h5"
    saved_things()[1].save(path)
    with h5py.File(path, "r+") as handle:
        for name in ("array_0", "array_1"):
            if handle[name][1] == 0.0005:  # the positions
                handle[name][3] = -1.0

    with pytest.raises(ms.errors.CorruptFileError, match="do not fit"):
        ms.read(path)
