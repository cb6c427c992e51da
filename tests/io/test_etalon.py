"""Etalon exchange format: terms, their units, what is not a profile, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text.machine_tests import etalon, read_terms

PUBLISHED = """\
// Every parameter is specified in a block.
[C0B]
VALUE = 0.000022355737
[Y0A]
VALUE = 0.25
[EXY]
Gridpoints = {
          -280.0 -0.001358635132
          -270.0 -0.000240680764
           260.0 -0.001297146744 }  // end of EXY
[EBY]
gridpoints = { -280.0 0.00001
 260.0 -0.00002
}
[EZC]
Gridpoints = {
0 0.001
90 0.002
}
"""


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "etalon" / "samples"


def test_every_term_in_si(put):
    terms = read_terms(RawFile(put(PUBLISHED)))

    assert list(terms) == ["C0B", "Y0A", "EXY", "EBY", "EZC"]
    units = {name: (t.position_unit, t.error_unit) for name, t in terms.items()}
    assert units == {
        "C0B": ("", "rad"),
        "Y0A": ("", "m"),
        "EXY": ("m", "m"),
        "EBY": ("m", "rad"),
        "EZC": ("", "m"),
    }
    np.testing.assert_allclose(terms["Y0A"].errors, [0.25e-3], rtol=1e-15)
    np.testing.assert_allclose(terms["EBY"].errors, [1e-5, -2e-5], rtol=1e-15)
    np.testing.assert_allclose(terms["EBY"].positions, [-0.28, 0.26], rtol=1e-15)
    np.testing.assert_array_equal(terms["EZC"].positions, [0.0, 90.0])
    assert terms["C0B"].positions.size == 0


def test_the_one_length_term_needs_no_channel(put):
    profile = ms.read(put(PUBLISHED))

    np.testing.assert_allclose(profile.x, [-0.28, -0.27, 0.26], rtol=1e-15)
    np.testing.assert_allclose(
        profile.z, [-1.358635132e-6, -0.240680764e-6, -1.297146744e-6], rtol=1e-12
    )
    assert profile.metadata["header"]["term"] == "EXY"


@pytest.mark.parametrize(
    ("term", "reason"), [("EBY", "angle in rad"), ("C0B", "constant"), ("EZC", "rotary axis")]
)
def test_what_is_no_profile_is_refused_with_the_reason(put, term, reason):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match=f"{reason}.*read_terms"):
        ms.read(put(PUBLISHED), channel=term)


def test_channels_are_the_profiles(samples):
    assert etalon.channels(RawFile(samples / "two-lengths.txt")) == ("EYX", "EXY")
    assert etalon.channels(RawFile(samples / "angles.txt")) == ()


def test_term_that_is_not_there(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="no term 'EZZ'"):
        ms.read(samples / "two-lengths.txt", channel="EZZ")


def test_other_keys_stay_in_the_header(samples):
    header = ms.read(samples / "two-lengths.txt", channel="EXY").metadata["header"]

    assert dict(header["other_keys"]) == {"INFO.Serial": "12"}


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("-270.0 -0.000240680764", "-270.0 -0.00024x", "not a number"),
        ("-270.0 -0.000240680764", "-270.0 nan", "a number of EXY"),
        ("-270.0 -0.000240680764", "-270.0 1e999", "not a number"),
        ("-270.0 -0.000240680764", "-270.0 1 2", "a position and an error"),
        ("-270.0 -0.000240680764", "-280.0 1", "profile does not fit"),
        ("[EBY]", "[EXY]", "one table for EXY"),
        ("Gridpoints = {\n0", "Gridpoints =\n0", "Gridpoints = {"),
        ("VALUE = 0.25", "VALUE = ", "a number of Y0A"),
        ("[Y0A]", "what", "a section, a key"),
    ],
)
def test_table_that_lies(put, old, new, match):
    assert old in PUBLISHED

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(PUBLISHED.replace(old, new, 1)), channel="EXY", format="etalon")


@pytest.mark.parametrize(
    "head",
    [
        b"",
        b"[EXY]\n1 2\n",
        b"[Main]\nVALUE = 1\n",
        b"VALUE = 1\n",
        b"\x00\xff",
        b"[EXY]\nUnit = mm\n",
    ],
)
def test_other_text_is_not_claimed(head):
    assert etalon.sniff(RawFile(Path("a.txt"), head)) is Match.NO


def test_damage_is_a_read_error_or_a_profile(samples, survives_damage):
    survives_damage(etalon, samples / "two-lengths.txt", channel="EXY")
