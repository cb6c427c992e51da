"""Frames: what the protocol page says, byte by byte; round trips; hostile frames."""

from __future__ import annotations

import contextlib
import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp

from metrosep.app.wire import error_header, pack, page_words, unpack
from metrosep.core.errors import DataError


def frame_of(header: object, payload: bytes = b"", text: bytes | None = None) -> bytes:
    """A frame by the protocol page, without library code."""
    raw = json.dumps(header).encode() if text is None else text
    raw += b" " * (-(4 + len(raw)) % 8)
    return struct.pack("<I", len(raw)) + raw + payload


def entry(name="z", dtype="f8", shape=(1,)):
    return {"name": name, "dtype": dtype, "shape": list(shape)}


def test_letters_that_turn_a_sentence_are_shown_as_marks():
    assert page_words('x"\u202e.toml is not a map') == 'x"\ufffd.toml is not a map'


@pytest.mark.parametrize(
    "name",
    [
        "part_v=2.x3p",
        "a=1/part.csv",
        "/d/my gain=2 (b=3).csv",
        "a=true.x3p",
        "x=.csv",
        "lambda_c.txt",
        "q=1-2.csv",
    ],
)
def test_the_name_of_a_file_is_no_grammar(name):
    assert page_words(f"{name}: there is no such file") == f"{name}: there is no such file"
    said = f"write n = 3, {name} has none"
    assert page_words(said, [name]) == f"write n = 3, {name} has none"
    assert page_words(said, [f"/some/where/{name}"]) == f"write n = 3, {name} has none"


def test_names_without_blanks_stay_also_where_nobody_names_them():
    said = "the session of part_v=2.x3p is not that of a=1/b.csv; give unit = 'um'"
    kept = "the session of part_v=2.x3p is not that of a=1/b.csv; give unit “um”"
    assert page_words(said) == kept


def test_the_line_of_a_recipe_goes_with_its_whole_name():
    assert page_words("my part.toml:15: bad") == "bad"
    assert (
        page_words("it is not used (my part.toml:15: bad)", ["my part.toml"])
        == "it is not used (bad)"
    )
    assert page_words("it is not used (part.toml:15: bad)") == "it is not used (bad)"


@pytest.mark.parametrize(
    ("said", "kept"),
    [
        ("column 'v=2' has no unit; give unit='um'", "column 'v=2' has no unit; give unit “um”"),
        ("found 'pos_x=3', 'F = 100 mm/min' and 'z'", "found 'pos_x=3', 'F = 100 mm/min' and 'z'"),
        ("say x='v=2' or x = 'z_um'", "say x “v=2” or x “z_um”"),
        ("missing='(1)' and 'a=1' are odd", "missing “(1)” and 'a=1' are odd"),
        ("column \"Müller's v=2\" in 'a=1/b.csv'", "column \"Müller's v=2\" in 'a=1/b.csv'"),
        ("'part 7' is not 'q=1'", "'part 7' is not 'q=1'"),
    ],
)
def test_what_a_message_quotes_is_the_word_of_a_file(said, kept):
    assert page_words(said) == kept


@pytest.mark.parametrize(
    ("said", "kept"),
    [
        ('r.toml:4: a = "abc": a point has x and y', "a “abc”: a point has x and y"),
        ("accept averaging with min_feeds=1", "accept averaging with min feeds = 1"),
        ("a window_rows = -2 is none", "a window rows = -2 is none"),
        ('give lateral_step = "3 um" or "-3 um"', 'give lateral step 3 um or "-3 um"'),
        ('spare = "" is empty', "spare “” is empty"),
    ],
)
def test_a_value_that_was_typed_is_kept_apart_from_its_key(said, kept):
    assert page_words(said) == kept


def test_limits_of_a_band_have_one_name_each():
    said = 'needs lambda_s, lambda_c or both, or lambda_c = "0.8 mm"'
    assert page_words(said) == "needs \u03bbs, \u03bbc or both, or \u03bbc 0.8 mm"


def test_a_short_name_leaves_words_whole():
    assert page_words("write radius = 3 to a", ["a", "r"]) == "write radius = 3 to a"


def test_a_frame_byte_by_byte():
    arrays = {"index": np.array([[1, 2, 3]], dtype="u1"), "low": np.array([1.5, -2.0], dtype="f4")}
    frame = pack({"id": 7, "k": "map", "ok": True}, arrays)
    (length,) = struct.unpack_from("<I", frame)
    assert (4 + length) % 8 == 0
    header = json.loads(frame[4 : 4 + length])
    assert header == {
        "id": 7,
        "k": "map",
        "ok": True,
        "arrays": [
            {"name": "index", "dtype": "u1", "shape": [1, 3]},
            {"name": "low", "dtype": "f4", "shape": [2]},
        ],
    }
    assert frame[4 + length :] == b"\1\2\3\0\0\0\0\0" + struct.pack("<2f", 1.5, -2.0)


def test_a_frame_written_by_hand_is_read():
    frame = frame_of(
        {"id": 1, "arrays": [entry(dtype="i4", shape=(3,))]}, struct.pack("<4i", 1, -2, 3, 0)
    )
    header, arrays = unpack(frame)
    assert header == {"id": 1}
    assert arrays["z"].tolist() == [1, -2, 3]
    assert arrays["z"].dtype == np.dtype("<i4")
    assert not arrays["z"].flags.writeable


plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_infinity=False, allow_nan=False)
    | st.text(st.characters(codec="utf-8")),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(st.characters(codec="utf-8")), inner, max_size=4)
    ),
    max_leaves=12,
)
numbers = st.sampled_from(["u1", "<i4", "<f4", "<f8", ">f8", ">i4"]).flatmap(
    lambda d: hnp.arrays(d, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5))
)


@settings(deadline=None, derandomize=True, max_examples=150)
@given(
    st.dictionaries(
        st.text(st.characters(codec="utf-8")).filter(lambda k: k != "arrays"), plain, max_size=5
    ),
    st.dictionaries(st.text(st.characters(codec="utf-8"), min_size=1), numbers, max_size=4),
)
def test_what_is_packed_comes_back(header, arrays):
    frame = pack(header, arrays)
    back, found = unpack(frame)
    assert back == header
    assert list(found) == list(arrays)
    for name, values in arrays.items():
        assert found[name].shape == values.shape
        assert found[name].dtype == values.dtype.newbyteorder("<")
        np.testing.assert_array_equal(found[name], values)  # NaN in the same places
    assert pack(back, found) == frame
    length = int.from_bytes(frame[:4], "little")
    assert (4 + length) % 8 == 0
    assert len(frame) % 8 == 0


def test_arrays_that_are_not_contiguous_keep_their_order():
    z = np.arange(24.0).reshape(4, 6)
    for values in (z.T, z[::-1], z[:, ::2], np.asfortranarray(z)):
        np.testing.assert_array_equal(unpack(pack({}, {"z": values}))[1]["z"], values)
    mask = z > 7
    np.testing.assert_array_equal(unpack(pack({}, {"m": mask}))[1]["m"], mask.astype("u1"))


def test_nan_is_null_in_the_header_and_nan_in_an_array():
    header, arrays = unpack(
        pack(
            {"pv": float("nan"), "u": np.float64("nan"), "l": [1, (np.nan,)]},
            {"z": np.array([np.nan, 1])},
        )
    )
    assert header == {"pv": None, "u": None, "l": [1, [None]]}
    assert np.isnan(arrays["z"][0])


def test_numpy_scalars_and_units_are_plain():
    header, _ = unpack(
        pack({"n": np.int64(3), "ok": np.bool_(True), "unit": "µm", "x": np.float32(0.5)})
    )
    assert header == {"n": 3, "ok": True, "unit": "µm", "x": 0.5}


@pytest.mark.parametrize(
    ("header", "arrays", "words"),
    [
        ({"pv": float("inf")}, {}, r"header\.pv is infinite"),
        ({"a": {"b": [object()]}}, {}, r"header\.a\.b\[0\] is a object"),
        ({"z": np.zeros(3)}, {}, r"header\.z is a ndarray"),
        ({1: 2}, {}, "keys must be text"),
        ({"t": "\ud800"}, {}, "cannot be written as JSON"),
        ({"arrays": []}, {}, "leave it out"),
        ({}, {"z": np.zeros(3, dtype="i8")}, "dtype int64"),
        ({}, {"z": np.zeros(3, dtype="c16")}, "dtype complex128"),
        ({}, {"z": np.array(["a"])}, "dtype <U1"),
        ({}, {"z": np.array([None])}, "dtype object"),
        ({}, {"z": np.zeros(2, dtype="i1")}, "dtype int8"),
        ({}, {"z": np.ma.masked_array([1.0], [True])}, "plain ndarray, got MaskedArray"),
        ({}, {"z": [1.0]}, "plain ndarray, got list"),
        ({}, {"": np.zeros(1)}, "must be a text"),
    ],
)
def test_what_a_frame_cannot_carry(header, arrays, words):
    with pytest.raises(DataError, match=words):
        pack(header, arrays)


def test_a_header_that_contains_itself():
    header: dict[str, object] = {}
    header["me"] = header
    with pytest.raises(DataError, match="cannot be written as JSON"):
        pack(header)


EIGHT = struct.pack("<d", 1.0)


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (b"", "at least 8 bytes"),
        (b"\1\2\3", "at least 8 bytes"),
        ("text of a page", "a frame is bytes, got str"),
        (b"\xff\xff\xff\xff" + b" " * 20, "it was cut"),
        (struct.pack("<I", 5) + b"{}   " + b"\0" * 7, "not a multiple of 8"),
        (frame_of(None, text=b"{"), "not JSON"),
        (frame_of(None, text=b"\xff\xfe"), "not JSON"),
        (frame_of(None, text=b"[" * 100_000), "not JSON"),
        (frame_of([]), "is an object, got list"),
        (frame_of({}), 'lacks its list "arrays"'),
        (frame_of({"arrays": {}}), 'lacks its list "arrays"'),
        (frame_of(None, text=b'{"a": NaN, "arrays": []}'), "says NaN"),
        (frame_of(None, text=b'{"a": 1e999, "arrays": []}'), "says 1e999"),
        (frame_of(None, text=b'{"a": 1, "a": 2, "arrays": []}'), "twice"),
        (frame_of({"arrays": [5]}), "must have name, dtype and shape"),
        (frame_of({"arrays": [{**entry(), "offset": 0}]}, EIGHT), "must have name"),
        (frame_of({"arrays": [entry(name=3)]}, EIGHT), "name must be a text"),
        (frame_of({"arrays": [entry(dtype="O")]}, EIGHT), "dtype must be"),
        (frame_of({"arrays": [entry(dtype=["f8"])]}, EIGHT), "dtype must be"),
        (frame_of({"arrays": [entry(shape=(-1,))]}, EIGHT), "shape must be"),
        (frame_of({"arrays": [entry(shape=(True,))]}, EIGHT), "shape must be"),
        (frame_of({"arrays": [entry(shape=(1.0,))]}, EIGHT), "shape must be"),
        (frame_of({"arrays": [entry(shape=(1,) * 40)]}, EIGHT), "shape must be"),
        (frame_of({"arrays": [entry(shape=(2**30, 2**30, 2**30))]}, EIGHT), "shape must be"),
        (frame_of({"arrays": [entry(shape=(0, 2**30, 2**30))]}, EIGHT), "shape must be"),
        (frame_of({"arrays": [entry(shape=(2,))]}, EIGHT), "ends at byte"),
        (frame_of({"arrays": [entry(), entry()]}, EIGHT * 2), "two arrays"),
        (frame_of({"arrays": [entry()]}, EIGHT + b"\0"), "1 bytes follow"),
        (frame_of({"arrays": [entry(dtype="u1")]}, b"\1\2" + b"\0" * 6), "padding after"),
        (frame_of({"arrays": [entry(dtype="u1")]}, b"\1"), "ends at byte"),
    ],
)
def test_hostile_frames(frame, words):
    with pytest.raises(DataError, match=words):
        unpack(frame)


@settings(deadline=None, derandomize=True, max_examples=300)
@given(st.binary(max_size=200))
def test_random_bytes_never_break_it(data):
    try:
        header, arrays = unpack(data)
    except DataError:
        return
    assert unpack(pack(header, arrays))[0] == header


@settings(deadline=None, derandomize=True, max_examples=300)
@given(st.data())
def test_a_frame_with_a_wrong_byte_is_read_or_refused_in_words(data):
    frame = bytearray(
        pack({"id": 3, "k": "map"}, {"i": np.arange(5, dtype="u1"), "z": np.ones((2, 3))})
    )
    for _ in range(data.draw(st.integers(1, 3))):
        frame[data.draw(st.integers(0, len(frame) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(frame)))
    for damaged in (bytes(frame), bytes(frame[:cut])):
        with contextlib.suppress(DataError):  # nothing else may come
            unpack(damaged)


def test_answers_that_failed():
    header, arrays = unpack(
        pack(
            error_header(
                "which unit?", code=4, request=9, k="open", ask={"name": "unit", "choices": ["mm"]}
            )
        )
    )
    assert header == {
        "id": 9,
        "k": "open",
        "ok": False,
        "error": {"code": 4, "message": "which unit?", "ask": {"name": "unit", "choices": ["mm"]}},
    }
    assert arrays == {}
    assert error_header("x", code=1) == {"ok": False, "error": {"code": 1, "message": "x"}}
