"""Text formats without code: a format.toml of the user's own, its mistakes, and a real file."""

import os
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io import registry
from metrosep.io.source import RawFile
from metrosep.io.text.layout import LayoutReader

PM = 1e-12  # heights of micrometres, one multiplication

DESCRIPTION = """
id = "acme-gap"
title = "ACME gap logger"
vendor = "ACME"
kind = "recording"
suffixes = [".log"]
reader = "layout"
reads = true
writes = false
status = "synthetic"

[layout]
recognise = ["ACME gap", "rate"]
table_after = "[samples]"
separator = "semicolon"
decimal = ","
key_separator = ":"
sampling_rate_key = "rate"

[[layout.columns]]
name = "gap"
sensitivity = "-2,5 um/V"

[[layout.columns]]
name = "temperature"
role = "ignore"

[[layout.columns]]
name = "position"
unit = "mm"
"""
TEXT = """ACME gap logger 3
operator: Jane
rate (kHz): 2,0
[samples]
0,5;20,1;10,0
1,0;20,2;10,1
;20,3;10,2
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of the user's own formats, switched on."""

    def make(text=DESCRIPTION):
        where = tmp_path / "formats" / "acme-gap"
        where.mkdir(parents=True, exist_ok=True)
        (where / "format.toml").write_text(text.replace("-2,5", "-2.5"), encoding="utf-8")
        monkeypatch.setenv("METROSEP_FORMATS", str(where.parent))
        registry._user_descriptors.cache_clear()
        return where / "format.toml"

    return make


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "run 1.dat"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_a_logger_of_ones_own_needs_no_python(folder, log):
    folder()

    recording = ms.read(log)

    assert registry.identify(log).id == "acme-gap"
    np.testing.assert_allclose(recording.t, [0.0, 0.5e-3, 1e-3], rtol=0, atol=PM)
    np.testing.assert_allclose(recording["gap"], [-1.25e-6, -2.5e-6, np.nan], rtol=0, atol=PM)
    np.testing.assert_allclose(recording["position"], [0.01, 0.0101, 0.0102], rtol=0, atol=PM)
    assert recording.units == {"gap": "m", "position": "m"}
    assert recording.metadata["header"]["operator"] == "Jane"
    assert recording.metadata["format"] == "acme-gap"


def test_without_the_folder_the_text_is_not_guessed(log):
    with pytest.raises(ms.errors.ReadError):
        ms.read(log)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('decimal = ","', 'decimals = ","', "no key 'decimals'"),
        ('role = "ignore"', 'role = "skip"', "a role of time, x, y, z, channel, ignore"),
        ('unit = "mm"', 'unit = "furlong"', "position.*furlong"),
        ('recognise = ["ACME gap", "rate"]', "recognise = []", "recognise must list"),
        ('table_after = "[samples]"\n', "", "one of table_after and header_lines"),
        ('reader = "layout"', 'reader = "builtin:lvm"', 'reader must be "layout"'),
        ('id = "acme-gap"', 'id = "x3p"', "there is a format 'x3p' already"),
        ('id = "acme-gap"', "id = ", "no readable TOML"),
        ('vendor = "ACME"\n', "", "'vendor' is missing"),
    ],
)
def test_mistake_in_a_description_is_named_with_its_file(folder, log, old, new, message):
    path = folder(DESCRIPTION.replace(old, new))

    with pytest.raises(ms.errors.ReadError, match=message) as caught:
        ms.read(log)

    assert str(path) in str(caught.value)


def test_folder_without_a_description_is_named(monkeypatch, tmp_path, log):
    monkeypatch.setenv("METROSEP_FORMATS", os.pathsep.join([str(tmp_path / "nowhere")]))

    with pytest.raises(ms.errors.ReadError, match=r"nowhere: holds no <format>/format\.toml"):
        ms.read(log)


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ("rate (kHz): 2,0", "rate (kHz): fast", "how fast it was sampled"),
        ("rate (kHz): 2,0", "rate: 2,0", "how fast it was sampled"),
        ("rate (kHz): 2,0", "rate (kHz): -2,0", "how fast it was sampled"),
        (";20,3;10,2", ";20,3", "the middle of a row"),
        ("1,0;20,2;10,1", "1,0;20,2;1O,1", "line 6"),
    ],
)
def test_damaged_text_is_named(folder, log, old, new, error):
    folder()
    log.write_text(TEXT.replace(old, new), encoding="utf-8")

    with pytest.raises(ms.errors.CorruptFileError, match=error):
        ms.read(log)


def test_profile_with_a_time_step_in_the_head():
    reader = LayoutReader(
        "t",
        "T",
        {
            "recognise": ["T"],
            "header_lines": 2,
            "key_separator": "=",
            "sampling_interval_key": "dt",
            "columns": [{"name": "a", "unit": "V"}],
        },
        "t.toml",
    )
    file = RawFile(Path("t"), b"T\ndt=0.25 ms\n1\n2\n4\n")

    recording = reader.read(file)

    np.testing.assert_allclose(recording.t, [0.0, 0.25e-3, 0.5e-3], rtol=0, atol=PM)
    assert reader.channels(file) == ("a",)


def test_real_dektak_export(corpus):
    """Independent: MANIFEST of the corpus; the last of the 9600 rows by hand."""
    profile = ms.read(corpus / "st" / "dektak-1.csv")

    assert registry.identify(corpus / "st" / "dektak-1.csv").id == "dektak-csv"
    assert len(profile) == 9600
    assert profile.peak_to_valley() == pytest.approx(16590.45e-9, rel=1e-7, abs=0.0)
    assert profile.rms() == pytest.approx(4764.233e-9, rel=1e-6, abs=0.0)
    assert profile.x[-1] == pytest.approx(1499.8e-6, abs=PM)
