"""ISO 230-2 lists: the published numbers of the corpus, runs and directions, gaps, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text.machine_tests import iso230_2_list, read_targets

TEXT = 1e-12  # relative; text to double and one factor


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "iso230-2" / "samples"


@pytest.fixture
def slits(corpus):
    """The corpus table in mm by numpy alone: targets, forward and backward (position, cycle)."""
    path = corpus / "separation" / "iso230_2_slits_2021-11-02.csv"
    rows = [r.split(",") for r in path.read_text().splitlines() if r[:1].isdigit()]
    table = {d: np.array([r[3:] for r in rows if r[2] == d], float) for d in ("fwd", "bwd")}
    return np.array([float(r[1]) for r in rows[:5]]), table["fwd"], table["bwd"]


def listing(targets, forward, backward):
    lines = ["UNIT=mm", f"CYCLES={forward.shape[1]}", f"POSITIONS={len(targets)}"]
    lines += [f"TGT_DATA[{i + 1}]={float(t)!r}" for i, t in enumerate(targets)]
    for key, values in (("FWD", forward), ("BWD", backward)):
        for (i, j), v in np.ndenumerate(values):
            lines.append(f"REF_DATA_{key}[{i + 1},{j + 1}]={float(v)!r}")
    return "\n".join(lines) + "\n"


def test_published_numbers(slits, put):
    path = put(listing(*slits))

    targets, forward, backward = read_targets(RawFile(path))
    run = ms.read(path, channel="backward 4")

    for found, truth in zip((targets, forward, backward), slits, strict=True):
        np.testing.assert_allclose(found, truth * 1e-3, rtol=TEXT)
    np.testing.assert_allclose(run.z, (slits[2][:, 3] - slits[0]) * 1e-3, rtol=TEXT)
    np.testing.assert_allclose(run.x, slits[0] * 1e-3, rtol=TEXT)


def test_no_run_is_invented(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="their mean is not formed"):
        ms.read(samples / "backward.dat")


def test_run_that_does_not_exist(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="no run 'forward 3'"):
        ms.read(samples / "backward.dat", channel="forward 3")


def test_channels_and_header(samples):
    path = samples / "backward.dat"
    names = iso230_2_list.channels(RawFile(path))

    assert names == ("forward 1", "forward 2", "backward 1", "backward 2")
    assert ms.read(path, channel=names[0]).metadata["header"]["REF_PV"] == "TEST:PosAct"


def test_unit_is_not_guessed(samples):
    with pytest.raises(ms.errors.UnitError, match="unit='mm'"):
        ms.read(samples / "inches.dat", channel="forward 1")


def test_unit_against_the_file_is_refused(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="mm by the file"):
        ms.read(samples / "backward.dat", channel="forward 1", unit="um")


def test_targets_may_fall(slits, put):
    targets, forward, backward = slits
    path = put(listing(targets[::-1], forward[::-1], backward[::-1]))

    run = ms.read(path, channel="forward 1")

    np.testing.assert_allclose(run.z, (forward[:, 0] - targets) * 1e-3, rtol=TEXT)


def test_one_direction_only(samples, put):
    text = (samples / "backward.dat").read_text()
    text = "\n".join(s for s in text.splitlines() if "BWD" not in s) + "\n"

    _, forward, backward = read_targets(RawFile(put(text)))

    assert (forward.shape, backward.shape) == ((3, 2), (3, 0))


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("CYCLES=2", "CYCLES=3", "CYCLES"),
        ("TGT_DATA[2]=", "TGT_DATA[9]=", "target is missing"),
        ("TGT_DATA[2]=", "TGT_DATA[1]=", "is given twice"),
        ("TGT_DATA[2]=25.0", "TGT_DATA[2]=nan", "target is not a number"),
        ("TGT_DATA[2]=25.0", "TGT_DATA[2]=15.0", "profile does not fit"),
        ("FWD[2,1]", "FWD[2,0]", "does not fit"),
        ("FWD[2,1]", "FWD[2,999999]", "is missing"),
        ("FWD[2,1]", "FWD[2]", "does not fit"),
        ("=15.25", "=15.2x", "not a number"),
        ("=15.25", "=1e999", "not a number"),
        ("UNIT=mm", "UNIT=deg", "rotary"),
        ("UNIT=mm", "UNIT=qq", "qq"),
        ("DEC=5", "DEC 5", "not a known key"),
    ],
)
def test_list_that_lies(samples, put, old, new, match):
    text = (samples / "backward.dat").read_text()
    assert old in text

    with pytest.raises((ms.errors.ReadError, ms.errors.UnitError), match=match):
        ms.read(put(text.replace(old, new, 1)), channel="forward 1", format="iso230-2")


@pytest.mark.parametrize(
    "head", [b"", b"a=1\nb=2\n", b"TGT_DATA[1]=1\n", b"\x00\xff=\n", b"x,y\n"]
)
def test_other_text_is_not_claimed(head):
    assert iso230_2_list.sniff(RawFile(Path("a.dat"), head)) is Match.NO


def test_damage_is_a_read_error_or_a_profile(samples, survives_damage):
    survives_damage(iso230_2_list, samples / "backward.dat", channel="backward 2")
