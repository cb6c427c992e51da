"""NMM scans: the real description and positions, lines by description only, damage."""

import json
import re
import runpy

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.check import describe
from metrosep.io.text import nmm

UM = 1e-6
PAIRS = ("line-1", "line-2", "positions", "interrupted")


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "nmm"


@pytest.fixture
def scan(folder, tmp_path):
    """Copy a scan, with the text of its files changed, and return the path of its description."""

    def copy(**changes):
        for suffix in ("dsc", "dat", "pos"):
            text = (folder / "pairs" / f"line-1.{suffix}").read_text()
            text = changes.get(suffix, lambda s: s)(text)
            (tmp_path / f"scan.{suffix}").write_text(text)
        return tmp_path / "scan.dsc"

    return copy


def test_real_positions_are_half_a_micrometre_apart(corpus):
    """The description says so: 'Distance beetween lines   : 0.5 [um]'."""
    path = corpus / "nmm" / "test01_XYZ.dsc"
    truth = np.loadtxt(path.with_suffix(".pos"))

    recording = ms.read(path, channel="positions")

    assert (len(recording), len(recording.channels)) == (11, 9)
    np.testing.assert_array_equal(np.column_stack(list(recording.channels.values())), truth)
    steps = np.hypot(np.diff(recording["X"]), np.diff(recording["Y"]))
    assert steps == pytest.approx(0.5 * UM, rel=0.01, abs=0.0)  # the stage follows to some nm
    assert recording.units == {"X": "m", "Y": "m", "Z": "m"}
    np.testing.assert_array_equal(recording.t, 36.0 * np.arange(11))
    assert recording.metadata["header"]["3. Scan field"]["Number of lines"] == "11"


def test_real_scan_without_its_points(corpus):
    path = corpus / "nmm" / "test01_XYZ.dsc"

    assert ms.io.read.channels(path)[-2:] == ("line 11", "positions")
    with pytest.raises(ms.errors.ReadError, match=r"test01_XYZ\.dat, which does not lie beside"):
        ms.read(path, channel="line 1")


@pytest.mark.parametrize("kind", ["raw", "Heydemann"])
def test_real_quadrature_signals_are_a_plain_table(corpus, kind):
    """Radius is in digits of the interferometer: no length is guessed."""
    path = corpus / "nmm" / f"test01_XYZ_f_quad_Z_{kind}.csv"

    found = describe(path)

    assert (found["kind"], found["shape"]) == ("table", [16511, 3])
    assert [c["unit"] for c in found["metadata"]["columns"]] == ["deg", None, None]


@pytest.mark.parametrize("name", PAIRS)
def test_scan_reads_as_expected(folder, name):
    truth = json.loads((folder / "pairs" / f"{name}.json").read_text())
    path = folder / "pairs" / f"{name}.dsc"
    if "error" in truth:
        with pytest.raises(getattr(ms.errors, truth["error"]), match=re.escape(truth["match"])):
            ms.read(path, **truth["options"])
        return

    obj = ms.read(path, **truth["options"])

    if truth["kind"] == "profile":
        np.testing.assert_allclose(obj.x, truth["x_m"], rtol=1e-14, atol=0)
        np.testing.assert_allclose(obj.z, truth["z_m"], rtol=1e-14, atol=0)
        assert obj.history[1].parameters["sha256"] == obj.metadata["data_sha256"]
    else:
        assert obj.t.tolist() == truth["t_s"]
        for channel, values in truth["channels"].items():
            assert obj[channel].tolist() == values


def test_pairs_are_what_the_script_writes(folder, tmp_path):
    runpy.run_path(str(folder / "make_samples.py"))["main"](tmp_path)

    shipped = {p.name: p.read_bytes() for p in (folder / "pairs").iterdir()}
    assert shipped == {p.name: p.read_bytes() for p in (tmp_path / "pairs").iterdir()}


def test_scan_without_a_sensor_at_the_sample(scan):
    path = scan(pos=lambda s: re.sub(r"\s+\S+$", "", s, flags=re.MULTILINE) + "\n")

    assert "sample temperature" not in ms.read(path, channel="positions").channels


def test_scan_without_heights_is_unsupported(scan):
    path = scan(dsc=lambda s: s.replace("-Lz+Az", "Az"))

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'-Lz\\+Az' and 'XY vector'"):
        ms.read(path, channel="line 1")


@pytest.mark.parametrize(
    ("suffix", "change", "channel", "match"),
    [
        ("dsc", ("vector : 3", "vector : 999999999"), "line 1", "contradict"),
        ("dsc", (": 3 :", ": 999999999 :"), "line 1", "more than 268435456"),
        ("dsc", ("01-Jan-2025", "31-Feb-2025"), "line 1", "a time is not usable"),
        ("dsc", ("01-Jan-2025", "01-Jan-2024"), "positions", "strictly increasing"),
        ("dat", ("5.00000000000000E-0009", "five"), "line 1", "line 1"),
        ("dat", ("1.00000000000000E-0007", "nan"), "line 1", "no position"),
        ("dat", ("1.00000000000000E-0007", "3.00000000000000E-0007"), "line 1", "monotonic"),
    ],
)
def test_files_that_lie_are_read_errors(scan, suffix, change, channel, match):
    path = scan(**{suffix: lambda s: s.replace(*change)})

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(path, channel=channel)


def test_other_file_of_the_scan_is_a_mismatch(folder):
    with pytest.raises(ms.errors.FormatMismatchError, match=r"pass the \.dsc"):
        ms.read(folder / "pairs" / "line-1.pos", format="nmm")


def test_damage(folder, survives_damage):
    survives_damage(nmm, folder / "pairs" / "line-1.dsc", channel="line 1")
    survives_damage(nmm, folder / "pairs" / "line-1.dsc", channel="positions", every=3)
