"""STL bytes: both kinds by hand, every truncation and one wrong byte named, no unit guessed."""

import struct

import numpy as np
import pytest

from metrosep.core.errors import CorruptFileError, MetrosepError, ReadError, UnitError
from metrosep.forms import from_triangles
from metrosep.io.stl import parse_stl, read_stl

CORNERS = [
    [[0.0, 0.0, 1.5], [2.0, 0.0, 1.0], [0.0, 4.0, -1.0]],
    [[-0.5, 0.25, 0.125], [2.0, 8.0, 1.0], [1e3, 4.0, -1.0]],
]
"""In mm; exact in single precision."""


def binary(corners=CORNERS, header=b"made by hand", count=None):
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *np.ravel(c).tolist(), 0x7FFF) for c in corners)
    return header.ljust(80, b"\0") + struct.pack("<I", count or len(corners)) + body


def ascii_text(corners=CORNERS, end="\n"):
    lines = ["solid part of Jörg"]
    for c in corners:
        lines += ["  facet normal 0 0 1e0", "    outer loop"]
        lines += [f"      vertex {x:g} {y:.3e} {z}" for x, y, z in c]
        lines += ["    endloop", "  endfacet"]
    return end.join([*lines, "endsolid part of Jörg", ""]).encode()


@pytest.mark.parametrize("data", [binary(), ascii_text()], ids=["binary", "ascii"])
@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e-3), ("m", 1.0), ("um", 1e-6)])
def test_corners_in_the_unit_of_the_caller(data, unit, factor):
    found = parse_stl(data, unit=unit)

    assert found.dtype == np.float64
    np.testing.assert_allclose(found, np.array(CORNERS) * factor, rtol=1e-15, atol=0)


def test_binary_that_begins_with_solid():
    assert parse_stl(binary(header=b"solid facet normal"), unit="mm").shape == (2, 3, 3)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\n\n"], ids=["LF", "CRLF", "CR", "blank"])
def test_line_ends_and_letters(end):
    data = ascii_text(end=end)

    expected = parse_stl(ascii_text(), unit="mm")
    np.testing.assert_array_equal(parse_stl(data, unit="mm"), expected)
    np.testing.assert_array_equal(parse_stl(data.upper(), unit="mm"), expected)


def test_several_solids_are_joined():
    assert parse_stl(ascii_text() + ascii_text(), unit="mm").shape == (4, 3, 3)


def test_the_unit_must_be_said():
    with pytest.raises(TypeError, match="unit"):
        parse_stl(binary())
    for unit in ("", "furlong", "s"):
        with pytest.raises(UnitError):
            parse_stl(binary(), unit=unit)


def test_every_truncation_of_a_binary_file_raises():
    data = binary()

    for n in range(len(data)):
        with pytest.raises(CorruptFileError):
            parse_stl(data[:n], unit="mm")
    with pytest.raises(CorruptFileError, match=r"expected 184 bytes for 2 facets, found 185"):
        parse_stl(data + b"\0", unit="mm")


def test_every_truncation_of_an_ascii_file_raises():
    data = ascii_text()

    for n in range(data.index(b"endsolid") + len(b"endsolid")):
        with pytest.raises(CorruptFileError):
            parse_stl(data[:n], unit="mm")


def test_a_count_beyond_the_file_needs_no_memory():
    with pytest.raises(CorruptFileError, match="4294967295 facets"):
        parse_stl(binary(count=0xFFFFFFFF), unit="mm")


def test_one_wrong_byte_is_read_or_named(rng):
    """Whatever the damage: triangles that are finite, or an error of ours."""
    for data in (binary(), ascii_text()):
        for _ in range(500):
            damaged = bytearray(data)
            damaged[rng.integers(len(data))] = rng.integers(256)
            try:
                assert np.isfinite(parse_stl(bytes(damaged), unit="mm")).all()
            except MetrosepError:
                continue


@pytest.mark.parametrize("value", [np.nan, np.inf], ids=["nan", "inf"])
def test_coordinates_that_are_not_finite_raise(value):
    corners = np.array(CORNERS)
    corners[1, 0, 2] = value

    with pytest.raises(CorruptFileError, match="field facet 1, at offset 134"):
        parse_stl(binary(corners), unit="mm")
    with pytest.raises(CorruptFileError, match="line 11"):
        parse_stl(ascii_text(corners), unit="mm")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"vertex 2 ", b"vertex 2,0 ", "line 5.*decimal points"),
        (b"vertex 2 ", b"vertex 2_0 ", "line 5.*decimal points"),
        (b"vertex 2 ", b"vertex 1e999 ", "line 5.*finite"),
        (b"vertex 2 ", b"vertex ", "line 5.*vertex and 3 numbers"),
        (b"outer loop", b"outer ring", "line 3.*outer loop"),
        (b"facet normal", b"facet", "line 2.*facet normal and 3 numbers"),
        (b"endloop", b"vertex 0 0 0", "line 7.*expected endloop"),
        (b"endfacet", b"endfoot", "line 8.*expected endfacet"),
        (b"endsolid", b"end", "expected facet or endsolid"),
    ],
    ids=range(9),
)
def test_wrong_ascii_lines_are_named(old, new, message):
    with pytest.raises(CorruptFileError, match=message):
        parse_stl(ascii_text().replace(old, new, 1), unit="mm")


@pytest.mark.parametrize("data", [b"", b"PK", b"solid\nendsolid\n", b"x" * 500], ids=range(4))
def test_what_is_no_mesh_raises(data):
    with pytest.raises(CorruptFileError):
        parse_stl(data, unit="mm")


def test_empty_binary_raises():
    with pytest.raises(CorruptFileError, match="holds no facet"):
        parse_stl(b"\0" * 84, unit="mm")


def test_a_file_becomes_a_form(tmp_path):
    """Two triangles that make a tilted square, read and evaluated."""
    square = [[[0, 0, 0], [2, 0, 2], [0, 2, 4]], [[2, 2, 6], [0, 2, 4], [2, 0, 2]]]
    path = tmp_path / "part.stl"
    path.write_bytes(binary(square))

    form = from_triangles(read_stl(path, unit="mm"))

    np.testing.assert_allclose(form(0.5e-3, 1.5e-3), 3.5e-3, rtol=0, atol=1e-12)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ReadError, match="check the name"):
        read_stl(tmp_path / "none.stl", unit="mm")
