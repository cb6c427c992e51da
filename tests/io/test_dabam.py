"""DABAM entries: real slopes and heights, integration by hand, pairs of files, damage."""

import json
import re
import runpy

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.source import RawFile
from metrosep.io.text import dabam

NM = 1e-9
URAD = 1e-6
DOUBLE = 1e-12  # relative; a product of two doubles
MANIFEST = 1e-6  # relative; digits of the manifest
PAIRS = ("heights", "slopes-of-heights", "slopes", "slopes-refused", "ragged")


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "dabam"


@pytest.fixture
def entry(folder, tmp_path):
    """Copy an entry, with the text of either file changed, and return the path of its JSON."""

    def copy(name="heights", json_=lambda s: s, dat=lambda s: s):
        path = tmp_path / f"{name}.txt"
        path.write_text(json_((folder / "pairs" / f"{name}.txt").read_text()))
        path.with_suffix(".dat").write_text(dat((folder / "pairs" / f"{name}.dat").read_text()))
        return path

    return copy


def test_real_heights_as_the_manifest_gives_them(corpus):
    profile = ms.read(corpus / "dabam" / "dabam-010.txt")

    assert len(profile) == 435
    assert profile.n_invalid == 0
    assert profile.peak_to_valley() == pytest.approx(33.95 * NM, rel=MANIFEST, abs=0.0)
    assert profile.rms() == pytest.approx(8.774851 * NM, rel=MANIFEST, abs=0.0)
    assert profile.dx == pytest.approx(1.02e-3, rel=MANIFEST, abs=0.0)


@pytest.mark.parametrize(
    ("name", "n", "dx", "pv", "sq"),
    [
        ("001", 1201, 1e-3, 66318.0, 18938.71),
        ("025", 171, 1.1764705882352927e-3, 449.0, 72.14006),
        ("071", 9230, 1.0493660e-4, 6627.811, 277.6726),
    ],
)
def test_real_slopes_as_the_manifest_gives_them(corpus, name, n, dx, pv, sq):
    """P-V and RMS of the manifest are those of the slopes, in nrad."""
    path = corpus / "dabam" / f"dabam-{name}.txt"

    profile = ms.read(path, slope="integrate")

    assert len(profile) == n
    assert profile.dx == pytest.approx(dx, rel=MANIFEST, abs=0.0)
    assert profile.metadata["slope_pv_rad"] == pytest.approx(pv * 1e-9, rel=MANIFEST, abs=0.0)
    assert profile.metadata["slope_rms_rad"] == pytest.approx(sq * 1e-9, rel=MANIFEST, abs=0.0)
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="slope='integrate'"):
        ms.read(path)


def test_real_slopes_integrate_to_the_real_heights(corpus):
    """Entry 010 holds both; its slopes are forward differences, half a step off the trapezoid rule."""
    path = corpus / "dabam" / "dabam-010.txt"
    heights, integrated = ms.read(path), ms.read(path, channel="Y3", slope="integrate")

    difference = (integrated.z - heights.z)[1:-1]

    half_step = 0.5 * np.abs(np.diff(heights.z)).max()
    assert np.abs(difference - difference.mean()).max() < 2 * half_step
    assert np.corrcoef(integrated.z, heights.z)[0, 1] > 0.995


def test_real_parallel_lines_are_channels(corpus):
    path = corpus / "dabam" / "dabam-025.txt"
    raw = np.loadtxt(path.with_suffix(".dat"))

    assert ms.io.read.channels(path) == tuple(f"Y{i}" for i in range(1, 13))
    profile = ms.read(path, channel="Y5", slope="integrate")

    by_hand = np.concatenate(
        [[0.0], np.cumsum((raw[1:, 5] + raw[:-1, 5]) / 2 * np.diff(raw[:, 0]) * URAD)]
    )
    np.testing.assert_allclose(profile.z, by_hand, rtol=0, atol=1e-18)
    np.testing.assert_array_equal(raw[:3, 1], raw[:3, 7])  # the central line is a copy


@pytest.mark.parametrize("name", PAIRS)
def test_pair_reads_as_expected(folder, name):
    truth = json.loads((folder / "pairs" / f"{name}.json").read_text())
    path = folder / "pairs" / f"{name}.txt"
    if "error" in truth:
        with pytest.raises(getattr(ms.errors, truth["error"]), match=re.escape(truth["match"])):
            ms.read(path)
        return

    profile = ms.read(path, **truth["options"])

    np.testing.assert_allclose(profile.x, truth["x_m"], rtol=DOUBLE, atol=1e-18)
    np.testing.assert_allclose(profile.z, truth["z_m"], rtol=DOUBLE, atol=1e-20)


def test_pairs_are_what_the_script_writes(folder, tmp_path):
    runpy.run_path(str(folder / "make_samples.py"))["main"](tmp_path)

    shipped = {p.name: p.read_bytes() for p in (folder / "pairs").iterdir()}
    assert shipped == {p.name: p.read_bytes() for p in (tmp_path / "pairs").iterdir()}


def test_constant_slope_is_a_tilt_of_that_slope(entry):
    path = entry("slopes", dat=lambda s: re.sub(r"\t\S+", "\t2", s))

    profile = ms.read(path, slope="integrate")

    np.testing.assert_allclose(np.diff(profile.z), 2 * URAD * 1e-3, rtol=DOUBLE)
    assert profile.z[-1] == 0.0  # the first row of the file has the largest x


def test_heights_refuse_to_be_integrated(entry):
    with pytest.raises(ms.errors.ReadError, match="takes no slope"):
        ms.read(entry(), slope="integrate")


def test_column_without_a_title_is_not_guessed(entry):
    path = entry(json_=lambda s: s.replace("Slope (urad)", "Y2"))

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="slopes or heights"):
        ms.read(path, channel="Y2")


def test_gap_in_slopes_is_refused(entry):
    path = entry("slopes", dat=lambda s: s.replace("\t-1.5", "\tnan"))

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="1 slopes of Y1"):
        ms.read(path, slope="integrate")


def test_step_override_is_recorded_for_heights_and_refused_for_slopes(entry):
    profile = ms.read(entry(), lateral_step="2 mm")

    assert profile.dx == pytest.approx(2e-3, rel=DOUBLE, abs=0.0)
    assert profile.metadata["lateral_step_in_file_m"] == pytest.approx(1e-3, rel=DOUBLE, abs=0.0)
    assert profile.metadata["lateral_step_override_m"] == 2e-3
    with pytest.raises(ms.errors.ReadError, match="takes no lateral_step"):
        ms.read(entry("slopes"), slope="integrate", lateral_step="2 mm")


def test_both_files_are_in_the_history(entry):
    profile = ms.read(entry("slopes"), slope="integrate")

    names = [step.name for step in profile.history]
    assert names == ["read", "read_columns", "integrate_slopes"]
    assert profile.history[1].parameters["sha256"] == profile.metadata["data_sha256"]
    assert profile.history[2].parameters["null_space"] == "piston"


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (('"X1_FACTOR": 0.001', '"X1_FACTOR": NaN'), "X1_FACTOR"),
        (('"X1_FACTOR": 0.001', '"X1_FACTOR": "mm"'), "X1_FACTOR"),
        (('"X1_FACTOR": 0.001', f'"X1_FACTOR": 1{"0" * 400}'), "X1_FACTOR"),
        (('"FILE_HEADER_LINES": 1', '"FILE_HEADER_LINES": -1'), "FILE_HEADER_LINES"),
        (('"FILE_HEADER_LINES": 1', '"FILE_HEADER_LINES": 900'), "there are no rows"),
        (('"FILE_HEADER_LINES": 1', '"FILE_HEADER_LINES": 0'), "line 1"),
        (('"FILE_FORMAT": 2', '"FILE_FORMAT": [2]'), "FILE_FORMAT"),
        (('"FILE_FORMAT": 2', f'"FILE_FORMAT": {"[" * 20000}'), "JSON is damaged"),
        (('"Y1_FACTOR"', '"Z1_FACTOR"'), "Y2"),
    ],
)
def test_description_that_lies_is_a_read_error(entry, change, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(entry(json_=lambda s: s.replace(*change)))


def test_columns_that_are_not_beside_the_file(entry):
    path = entry()
    path.with_suffix(".dat").unlink()

    with pytest.raises(ms.errors.ReadError, match=r"heights\.dat, which does not lie beside"):
        ms.read(path)


def test_the_columns_alone_are_not_taken_for_an_entry(folder, corpus):
    for path in (folder / "pairs" / "heights.dat", corpus / "dabam" / "dabam-025.dat"):
        assert dabam.sniff(RawFile(path, path.read_bytes()[:65536])) is ms.io.registry.Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match=r"pass the \.txt"):
        ms.read(folder / "pairs" / "heights.dat", format="dabam")


def test_damage(folder, survives_damage):
    survives_damage(dabam, folder / "pairs" / "slopes.txt", slope="integrate")


def test_damage_of_the_columns(entry):
    path = entry()
    data = path.with_suffix(".dat").read_bytes()
    outcomes = []
    for i in range(len(data)):
        for pattern in (0xFF, 0x80, 0x01):
            changed = data[:i] + bytes([data[i] ^ pattern]) + data[i + 1 :]
            path.with_suffix(".dat").write_bytes(changed)
            try:
                outcomes.append(np.isfinite(ms.read(path).z).any())
            except ms.errors.ReadError as exc:
                outcomes.append("heights." in str(exc))
    assert all(outcomes)
