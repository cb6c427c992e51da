"""Writers: exact numbers back, whole files or none."""

import os

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.atomic import atomic_write


def test_profile_through_csv_is_exact(tmp_path, rng):
    profile = ms.Profile(np.cumsum(rng.random(200)) * 1e-4, rng.normal(size=200) * 1e-7)
    z = profile.z.copy()
    z[7] = np.nan
    profile = ms.Profile(profile.x, z)

    back = ms.read(ms.write(profile, tmp_path / "p.csv"))

    np.testing.assert_array_equal(back.x, profile.x)
    np.testing.assert_array_equal(back.z, profile.z)


@pytest.mark.parametrize("name", ["s.csv", "s.xyz"])
def test_surface_through_text_is_exact_and_not_mirrored(tmp_path, bump, name):
    back = ms.read(ms.write(bump, tmp_path / name))

    np.testing.assert_array_equal(back.z, bump.z)
    assert (back.dx, back.dy) == pytest.approx((bump.dx, bump.dy), rel=1e-12, abs=0.0)
    assert back.origin == pytest.approx(bump.origin, rel=1e-12, abs=0.0)


def test_recording_through_csv_is_exact(tmp_path, rng):
    recording = ms.Recording(
        np.arange(50) / 3.0,
        {"gap, probe 1": rng.normal(size=50) * 1e-6, "count": np.arange(50.0)},
        units={"gap, probe 1": "m"},
    )

    back = ms.read(ms.write(recording, tmp_path / "r.csv"))

    np.testing.assert_array_equal(back.t, recording.t)
    np.testing.assert_array_equal(back["gap, probe 1 [m]"], recording["gap, probe 1"])
    np.testing.assert_array_equal(back["count"], recording["count"])
    assert dict(back.units) == {"gap, probe 1 [m]": "m"}


def test_runs_through_csv_are_exact(tmp_path, rng):
    x = np.linspace(0.0, 10e-3, 41)
    runs = ms.RunSet(
        [
            ms.Run(x, rng.normal(size=41) * 1e-7, feed=0.08, run_id="a"),
            ms.Run(x[::-1], rng.normal(size=41) * 1e-7, feed=0.16, run_id="b"),
        ]
    )

    path = ms.write(runs, tmp_path / "runs.csv")
    back = ms.read_runs(path, x="x_m", z="z_m", feed="feed_m_s", run="run", time="t_s")

    for old, new in zip(runs, back, strict=True):
        assert new.run_id == old.run_id
        np.testing.assert_array_equal(new.x, old.x)
        np.testing.assert_array_equal(new.z, old.z)
        np.testing.assert_array_equal(new.t, old.t)
        assert new.feed == old.feed


def test_history_stands_above_the_table(tmp_path, put):
    profile = ms.read(put("x_mm,z_um\n0,1\n1,2\n"))

    text = ms.write(profile, tmp_path / "out.csv").read_text(encoding="utf-8")

    assert profile.history[0].parameters["sha256"] in text
    assert text.splitlines()[-3] == "x_m,z_m"


@pytest.mark.parametrize(("name", "kind"), [("a.x3p", None), ("a.xyz", None), ("a.bin", "x3p")])
def test_format_that_does_not_hold_the_object_is_refused(tmp_path, name, kind):
    recording = ms.Recording([0.0, 1.0], {"a": [0.0, 1.0]})

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="does not hold a Recording"):
        ms.write(recording, tmp_path / name, format=kind)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("a.doc", "'doc'"),
        ("a", "csv, h5, int, pro, sdf, smd, sur, x3p, xyz"),
    ],
)
def test_format_that_is_not_written_says_so(tmp_path, bump, name, match):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match=match):
        ms.write(bump, tmp_path / name)


def test_uncalibrated_surface_has_no_positions(tmp_path):
    with pytest.raises(ms.errors.WriteError, match="lateral_step"):
        ms.write(ms.Surface([[0.0, 1.0]]), tmp_path / "a.xyz")


def test_other_objects_are_refused(tmp_path):
    with pytest.raises(ms.errors.WriteError, match="a list cannot be written"):
        ms.write([1, 2], tmp_path / "a.csv")


def test_missing_folder_is_one_sentence(tmp_path):
    with pytest.raises(ms.errors.WriteError, match="does not exist; create it first"):
        atomic_write(tmp_path / "absent" / "a.csv", b"x")


def test_folder_instead_of_a_file_is_refused(tmp_path):
    with pytest.raises(ms.errors.WriteError, match="is a folder"):
        atomic_write(tmp_path, b"x")


def test_unwritable_folder_is_one_sentence(tmp_path, monkeypatch):
    def refuse(*args):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)

    with pytest.raises(ms.errors.WriteError, match=r"cannot be written \(Permission denied\)"):
        atomic_write(tmp_path / "a.csv", b"x")


def test_interrupted_writing_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = tmp_path / "table.comp"
    path.write_bytes(b"old")

    def full(handle):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)

    with pytest.raises(ms.errors.WriteError, match="No space left"):
        atomic_write(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_old_file_is_replaced_with_its_mode(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"old")
    path.chmod(0o600)

    atomic_write(path, b"new")

    assert path.read_bytes() == b"new"
    assert path.stat().st_mode & 0o777 == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_symbolic_link_is_followed(tmp_path):
    target, link = tmp_path / "target.csv", tmp_path / "link.csv"
    target.write_bytes(b"old")
    link.symlink_to(target)

    atomic_write(link, b"new")

    assert link.is_symlink()
    assert target.read_bytes() == b"new"


@pytest.mark.parametrize("suffix", ["csv", "h5", "int", "sdf", "sur", "x3p", "xyz"])
def test_every_format_keeps_heights_steps_and_orientation(tmp_path, bump, suffix):
    """Exact but for the two that round: 16 bits of the P-V (int), 32 bits (sur)."""
    rounding = {"int": 0.5 / 65534, "sur": 1e-9}.get(suffix, 1e-15) * bump.peak_to_valley()

    again = ms.read(ms.write(bump, tmp_path / f"map.{suffix}"))

    z, truth = (s.z - s.z[0, 0] if suffix == "int" else s.z for s in (again, bump))
    np.testing.assert_allclose(z, truth, rtol=0, atol=2.0 * rounding)
    if suffix != "int":
        assert (again.dx, again.dy) == pytest.approx((bump.dx, bump.dy), rel=1e-6, abs=0.0)


def test_options_reach_the_writer_and_unknown_ones_are_named(tmp_path, bump):
    binary = ms.write(bump, tmp_path / "a.sdf", binary=True)

    assert binary.read_bytes().startswith(b"bISO-1.0")
    with pytest.raises(ms.errors.WriteError, match="sdf takes no option 'bits'; it takes binary"):
        ms.write(bump, tmp_path / "b.sdf", bits=16)
    with pytest.raises(ms.errors.WriteError, match="csv takes no option 'bits'"):
        ms.write(bump, tmp_path / "b.csv", bits=16)


def test_channels_that_differ_in_their_unit_alone_come_back(tmp_path):
    channels = {
        "probe [um]": [1e-6, 2e-6],
        "probe [nm]": [3e-9, 5e-9],
        "probe (2) [m]": [0.5, 0.7],
    }
    recording = ms.Recording([0.0, 0.1], channels, units=dict.fromkeys(channels, "m"))
    ms.write(recording, tmp_path / "rec.csv")

    back = ms.read(tmp_path / "rec.csv")
    assert [v.tolist() for v in back.channels.values()] == [list(v) for v in channels.values()]
    assert list(back.channels) == ["probe [m]", "probe (2) [m]", "probe (2) (2) [m]"]
