"""MLP point autofocus: real tool edges, counts that are hints, contours that turn back, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.source import RawFile
from metrosep.io.text import mitaka_mlp

UM = 1e-6
DOUBLE = 1e-12  # relative; a factor of 1e-3
LINES = [
    ("20221019-strategy-2p40-1.csv", 2015, 2017, 10),
    ("20221019-strategy-2p40-2.csv", 1953, 1955, 19),
    ("20221019-strategy-2p40-3.csv", 1953, 1955, 22),
    ("D906-1.csv", 970, 972, 83),
]


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "mitaka-mlp" / "samples"


@pytest.fixture
def raw(corpus):
    def load(name, skip=24):
        return np.loadtxt(corpus / "upm" / name, delimiter=",", skiprows=skip) * 1e-3

    return load


@pytest.mark.parametrize(("name", "n", "declared", "falls"), LINES)
def test_real_line_over_its_path_holds_every_number(corpus, raw, name, n, declared, falls):
    path, truth = corpus / "upm" / name, raw(name)

    over_path = {axis: ms.read(path, x="path", z=axis) for axis in "XYZ"}

    for column, axis in enumerate("XYZ"):
        np.testing.assert_allclose(over_path[axis].z, truth[:, column], rtol=DOUBLE)
    assert (len(over_path["X"]), int((np.diff(truth[:, 0]) < 0).sum())) == (n, falls)
    assert f"declares {declared} points and the file holds {n}" in "".join(
        over_path["X"].metadata["warnings"]
    )
    chords = np.sqrt((np.diff(truth, axis=0) ** 2).sum(axis=1))
    np.testing.assert_allclose(np.diff(over_path["X"].x), chords, rtol=1e-9)


@pytest.mark.parametrize("name", [line[0] for line in LINES])
def test_real_line_turns_back(corpus, raw, name):
    path, truth = corpus / "upm" / name, raw(name)
    with pytest.raises(ms.errors.FormatMismatchError, match="turn back in X"):
        ms.read(path)

    profile = ms.read(path, overhang="drop")

    beyond = truth[:, 0] > np.maximum.accumulate(np.r_[-np.inf, truth[:-1, 0]])
    np.testing.assert_allclose(profile.x, truth[beyond, 0], rtol=DOUBLE)
    np.testing.assert_allclose(profile.z, truth[beyond, 1], rtol=DOUBLE)
    assert profile.metadata["n_dropped"] == int((~beyond).sum())
    assert profile.metadata["columns"] == {"x": "X", "z": "Y", "stepping": "Z"}


def test_unit_is_mm_since_the_radius_of_the_real_edge_was_printed_elsewhere(corpus, raw):
    """D906-1-result.txt beside the file: Radius 189.2658799 um, on a window that it does not name."""
    printed = (corpus / "upm" / "D906-1-result.txt").read_text(encoding="utf-8-sig")
    nose = raw("D906-1.csv")[104:364, :2]

    design = np.column_stack([2 * nose, np.ones(len(nose))])
    c = np.linalg.lstsq(design, (nose**2).sum(axis=1), rcond=None)[0]
    radius = np.sqrt(c[2] + c[0] ** 2 + c[1] ** 2)

    assert "189.2658799" in printed
    assert radius == pytest.approx(189.27 * UM, rel=0.01, abs=0.0)


def test_real_area_is_sixteen_lines(corpus, raw):
    path, truth = corpus / "upm" / "20221020-3D-1.csv", raw("20221020-3D-1.csv", skip=17)
    names = ms.io.read.channels(path)

    lines = [ms.read(path, channel=n, x="path", z="Y") for n in names]

    assert [len(line) for line in lines] == [661] * 15 + [405]
    np.testing.assert_allclose(np.concatenate([p.z for p in lines]), truth[:, 1], rtol=DOUBLE)
    steps = np.diff([p.metadata["stepping_position_m"] for p in lines])
    assert steps == pytest.approx(0.9 * UM, abs=0.1 * UM)  # the declared pitch; noise of the stage
    with pytest.raises(ms.errors.FormatMismatchError, match="channel='line 16'"):
        ms.read(path)


def test_max_below_min_is_a_warning(corpus):
    profile = ms.read(corpus / "upm" / "D906-1.csv", overhang="drop")

    assert "Max. in X direction is less than Min. in X direction" in profile.metadata["warnings"]


def test_columns_can_be_chosen_and_are_recorded(samples):
    profile = ms.read(samples / "columns.csv", x="Y", z="X", overhang="drop")

    assert profile.metadata["columns"] == {"x": "Y", "z": "X", "stepping": "Z"}
    assert profile.metadata["overhang"] == "drop"


def test_line_without_a_constant_coordinate_is_not_guessed(samples, put):
    text = (samples / "edge.csv").read_text().replace("1.750000,-0.850000", "1.750000,-0.900000")

    with pytest.raises(ms.errors.FormatMismatchError, match="no coordinate is constant"):
        ms.read(put(text))

    assert len(ms.read(put(text), x="X", z="Y")) == 4
    with pytest.raises(ms.errors.FormatMismatchError, match="no coordinate is constant"):
        ms.read(put(text), x="X")


def test_same_column_twice_is_refused(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="cannot both be X"):
        ms.read(samples / "edge.csv", x="X", z="X")


def test_bidirectional_lines_make_the_same_map(samples, put):
    """The second line of the file written backwards: positions decide, not the order."""
    lines = (samples / "grid.csv").read_text().splitlines()
    turned = "\n".join(lines[:-3] + lines[:-4:-1]) + "\n"

    np.testing.assert_array_equal(ms.read(put(turned)).z, ms.read(samples / "grid.csv").z)


@pytest.mark.parametrize(
    "options",
    [{"x": "A"}, {"z": "path"}, {"overhang": "keep"}, {"unit": "um"}, {"lateral_step": 1}],
)
def test_unknown_options_are_refused(samples, options):
    with pytest.raises(ms.errors.ReadError, match=r"unknown|takes no"):
        ms.read(samples / "edge.csv", **options)


def test_wrong_length_of_the_header_is_a_warning(samples, put):
    text = (samples / "edge.csv").read_text().replace("3D_003,24", "3D_003,19")

    assert "declares 19 lines and has 24" in ms.read(put(text)).metadata["warnings"][0]


def test_missing_coordinate_is_refused(samples, put):
    text = (samples / "edge.csv").read_text().replace("0.125000,1.750000", "0.125000,nan")

    with pytest.raises(ms.errors.CorruptFileError, match="line 27"):
        ms.read(put(text))


@pytest.mark.parametrize("first", ["3D_003,24", "MLP-2 3D CSV"])
def test_first_line_alone_is_not_enough(first):
    text = f"{first}\nX,Y,Z\n1,2,3\n".encode()

    assert mitaka_mlp.sniff(RawFile(Path("a.csv"), text)) is ms.io.registry.Match.NO


@pytest.mark.parametrize("name", ["edge.csv", "grid.csv"])
def test_damage(samples, survives_damage, name):
    survives_damage(mitaka_mlp, samples / name)
