"""What an object is stays with it through text: kind, cut-offs and history, and damage to them."""

import zipfile

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.provenance import Step
from metrosep.filters import DoubleFilterError, gaussian, profile_kind, roughness, waviness
from metrosep.io.maps.x3p import md5

UM = 1e-6
X = np.arange(8000) * 0.5 * UM
FORMATS = ["p.csv", "p.x3p", "p.h5"]


@pytest.fixture
def trace(rng):
    return ms.Profile(X, 1e-8 * rng.standard_normal(X.size))


@pytest.fixture
def edited(tmp_path, trace):
    """Write a roughness profile as CSV or X3P with a part of its notes replaced."""

    def change(name, old, new):
        path = ms.write(roughness(trace, lambda_c=0.25e-3, end="cut"), tmp_path / name)
        if name.endswith(".csv"):
            text = path.read_text(encoding="utf-8")
            assert old in text
            path.write_text(text.replace(old, new), encoding="utf-8")
            return path
        with zipfile.ZipFile(path) as archive:
            members = {n: archive.read(n) for n in archive.namelist()}
        main = members["main.xml"].decode()
        assert old in main
        members["main.xml"] = main.replace(old, new).encode()
        members["md5checksum.hex"] = f"{md5(members['main.xml'])} *main.xml\n".encode()
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for member, data in members.items():
                archive.writestr(member, data)
        return path

    return change


@pytest.mark.parametrize("name", FORMATS)
def test_a_filtered_profile_is_refused_after_writing_and_reading(tmp_path, trace, name):
    r = roughness(trace, lambda_c=0.25e-3, end="cut")

    back = ms.read(ms.write(r, tmp_path / name))

    assert profile_kind(back) == "R"
    assert back.metadata["lambda_c_m"] == 0.25e-3
    np.testing.assert_array_equal(back.z, r.z)
    with pytest.raises(DoubleFilterError):
        roughness(back, lambda_c=0.25e-3, end="cut")
    with pytest.raises(DoubleFilterError):
        gaussian(back, cutoff=0.25e-3)


@pytest.mark.parametrize("name", FORMATS)
def test_kind_and_cut_offs_of_waviness_come_back(tmp_path, trace, name):
    w = waviness(trace, lambda_c=0.08e-3, lambda_f=0.8e-3, lambda_s=2.5e-6)

    back = ms.read(ms.write(w, tmp_path / name))

    kept = {k: back.metadata.get(k) for k in w.metadata}
    assert kept == dict(w.metadata)
    assert kept["profile_kind"] == "W"
    assert kept["lambda_f_m"] == 0.8e-3


@pytest.mark.parametrize("name", FORMATS)
def test_history_goes_on_where_it_ended(tmp_path, trace, name):
    step = Step("turn", {"pair": (1, 2.5), "gap": None, "far": float("inf"), "µ": '"a", b'})
    old = ms.Profile(trace.x, trace.z, history=(step, Step("tilt")))

    path = ms.write(old, tmp_path / name)
    back = ms.read(path)

    assert back.history[:-1] == old.history
    assert back.history[-1].name == "read"
    assert back.history[-1].parameters["file"] == path.name
    assert profile_kind(back) is None
    assert back.metadata["warnings"] == ()


@pytest.mark.parametrize("name", ["s.csv", "s.xyz", "s.x3p", "s.h5"])
def test_a_map_without_its_long_waves_is_refused_after_writing_and_reading(tmp_path, rng, name):
    rough = ms.Surface(1e-8 * rng.standard_normal((40, 50)), 1e-6, 1e-6)
    short = gaussian(rough, nesting_index=20e-6, band="short")

    back = ms.read(ms.write(short, tmp_path / name))

    assert back.history[:-1] == short.history
    with pytest.raises(DoubleFilterError):
        gaussian(back, nesting_index=20e-6, band="short")


def test_history_of_a_recording_comes_back(tmp_path):
    step = Step("resample", {"rate_hz": 50.0})
    recording = ms.Recording([0.0, 1.0], {"a": [0.0, 1.0]}, history=(step,))

    assert ms.read(ms.write(recording, tmp_path / "r.csv")).history[:-1] == (step,)


def test_the_kind_of_an_instrument_goes_through_csv(corpus, tmp_path):
    """The history of this file says nothing of a filter: the instrument did it."""
    profile = ms.read(corpus / "st" / "mitutoyo_2_mock.xlsx")

    back = ms.read(ms.write(profile, tmp_path / "mit.csv"))

    assert profile_kind(back) == "R"
    assert back.metadata["n_sections"] == 4
    assert back.metadata["lambda_c_m"] == 2.5e-3
    assert [s.parameters["format"] for s in back.history] == ["mitutoyo-xlsx", "delimited"]
    with pytest.raises(DoubleFilterError):
        roughness(back, lambda_c=2.5e-3, end="cut")


def test_files_that_earlier_versions_wrote_have_the_kind_in_their_history(edited):
    path = edited("p.csv", "# profile_kind: R\n# lambda_c_m: 0.00025\n", "")

    back = ms.read(path)

    assert profile_kind(back) == "R"
    assert back.metadata["lambda_c_m"] == 0.25e-3


def test_a_band_that_was_filtered_off_is_roughness_in_a_history_too(tmp_path, trace):
    path = ms.write(gaussian(trace, cutoff=0.25e-3, band="short"), tmp_path / "p.csv")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("# profile_kind: R\n", ""), encoding="utf-8")

    assert profile_kind(ms.read(path)) == "R"


@pytest.mark.parametrize("name", ["p.csv", "p.x3p"])
@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("profile_kind: R", "profile_kind: X", "profile_kind"),
        ("profile_kind: R", "profile_kind:", "profile_kind"),
        ("profile_kind: R", "profile_kind: R\n# profile_kind: P", "profile_kind"),
        ("lambda_c_m: 0.00025", "lambda_c_m: -1", "lambda_c_m"),
        ("lambda_c_m: 0.00025", "lambda_c_m: nan", "lambda_c_m"),
        ("lambda_c_m: 0.00025", "lambda_c_m: 1_0", "lambda_c_m"),
    ],
)
def test_a_damaged_kind_is_one_sentence(edited, name, old, new, field):
    if name == "p.x3p":
        new = new.replace("# ", "")
    path = edited(name, old, new)

    with pytest.raises(ms.errors.CorruptFileError, match=field) as caught:
        ms.read(path)
    assert path.name in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("name", ["p.csv", "p.x3p"])
@pytest.mark.parametrize("count", ["1.5", "9" * 5000, "none"])
def test_a_damaged_count_of_sections_decides_nothing_and_is_told(edited, name, count):
    read = ms.read(edited(name, "lambda_c_m: 0.00025", f"n_sections: {count}"))

    assert profile_kind(read) == "R"
    assert "n_sections" not in read.metadata
    assert any("n_sections" in w for w in read.metadata["warnings"])


@pytest.mark.parametrize("name", ["p.csv", "p.x3p"])
def test_a_kind_whose_line_was_taken_out_is_that_of_the_history(edited, name):
    """The cut-off is still there; what the error for a damaged line advises."""
    mark = "# " if name == "p.csv" else ""
    read = ms.read(edited(name, f"{mark}profile_kind: R\n", ""))

    assert profile_kind(read) == "R"
    assert read.metadata["lambda_c_m"] == pytest.approx(0.25e-3, rel=1e-12, abs=0.0)
    with pytest.raises(DoubleFilterError):
        roughness(read, lambda_c=0.25e-3)


@pytest.mark.parametrize(
    ("old", "new"),
    [("\nprofile_kind", " profile_kind"), ("metrosep history:", "By Ann\nmetrosep history:")],
    ids=["line ends are blanks", "a line before"],
)
def test_a_comment_that_another_program_reflowed_keeps_kind_and_history(edited, old, new):
    read = ms.read(edited("p.x3p", old, new))

    assert profile_kind(read) == "R"
    assert "roughness" in [s.name for s in read.history]
    assert read.metadata["lambda_c_m"] == pytest.approx(0.25e-3, rel=1e-12, abs=0.0)


HOSTILE = [
    "[[[",
    "{}",
    '"text"',
    "[1, 2]",
    '{"step": "a"}',
    '{"step": "a", "parameters": 3, "version": "1"}',
    '{"step": 7, "parameters": {}, "version": "1"}',
    '{"step": "a", "parameters": {"b": {"__number__": "no"}}, "version": "1"}',
    '{"step": "a", "parameters": {"b": {"__tuple__": 1}}, "version": "1"}',
    '{"step": "a", "parameters": {"b": ' + "9" * 6000 + '}, "version": "1"}',
    "[" * 100_000 + "]" * 100_000,
    '{"step": "a", "version": "1", "parameters": {"b": ' + "[" * 300 + "]" * 300 + "}}",
]


@pytest.mark.parametrize("line", HOSTILE, ids=lambda line: line[:45])
def test_a_damaged_history_is_ignored_with_a_warning(put, line):
    head = "# metrosep 0.1.0: SI units, empty or nan = not measured\n"
    good = '# history: {"step": "tilt", "parameters": {}, "version": "0.1.0"}\n'
    back = ms.read(put(f"{head}{good}# history: {line}\n# profile_kind: R\nx_m,z_m\n0,1\n1,2\n"))

    assert [s.name for s in back.history] == ["tilt", "read"]
    assert profile_kind(back) == "R"
    assert len([w for w in back.metadata["warnings"] if "history" in w]) == 1


@pytest.mark.parametrize("line", HOSTILE, ids=lambda line: line[:45])
def test_a_damaged_history_of_x3p_is_ignored_with_a_warning(edited, line):
    path = edited("p.x3p", "metrosep history: [", f"metrosep history: [{line}, ")

    back = ms.read(path)

    assert back.history[-1].name == "read"
    assert profile_kind(back) == "R"
    assert len([w for w in back.metadata["warnings"] if "history" in w]) == 1


@pytest.mark.parametrize(
    "comment",
    [
        "# profile_kind: R\n",
        '# history: {"step": "roughness", "parameters": {}, "version": "1"}\n',
        "# history: calibrated in 2019\n# profile_kind: unknown\n",
        "# metrosepia scan\n# profile_kind: unknown\n",
    ],
)
def test_notes_of_others_are_comments_as_before(put, comment):
    back = ms.read(put(f"{comment}x_m,z_m\n0,1\n1,2\n"))

    assert "profile_kind" not in back.metadata
    assert [s.name for s in back.history] == ["read"]
    assert back.metadata["warnings"] == ()


def test_a_comment_of_others_in_x3p_is_no_note(edited):
    back = ms.read(edited("p.x3p", "metrosep history: ", "history by another: "))

    assert profile_kind(back) is None
    assert [s.name for s in back.history] == ["read"]


def test_a_spreadsheet_that_pads_and_quotes_lines_keeps_the_kind(edited):
    """Saved again, every line has as many commas as columns, and quotes around what holds quotes."""
    path = edited("p.csv", "# profile_kind: R\n", "# profile_kind: R,\n")
    lines = path.read_text(encoding="utf-8").split("\n")
    quoted = ['"' + n.replace('"', '""') + '",' if n.startswith("# history") else n for n in lines]
    path.write_text("\n".join(quoted), encoding="utf-8")

    back = ms.read(path)

    assert profile_kind(back) == "R"
    assert [s.name for s in back.history] == ["read"]
    assert "history" in back.metadata["warnings"][0]


def test_one_object_gives_one_text_and_notes_survive_a_second_trip(tmp_path, trace):
    r = roughness(trace, lambda_c=0.25e-3)
    first, second = (ms.write(r, tmp_path / n) for n in ("a.csv", "b.csv"))
    assert first.read_bytes() == second.read_bytes()

    again = ms.read(ms.write(ms.read(first), tmp_path / "c.csv"))

    assert profile_kind(again) == "R"
    assert [s.name for s in again.history] == ["gaussian", "roughness", "read", "read"]
