"""Which way up a map lies: every format says what shows it, and a test of it fails for a mirror image."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.text_options import ROW_ORDERS
from metrosep.io import registry
from metrosep.recipe.recipe import Recipe

SMALLEST_FIRST, TOP_FIRST = ROW_ORDERS
MAPS = [f for f in registry.formats() if "surface" in f.kind]
MATRICES = ("npy", "npz", "matlab", "hdf5")
"""Bare arrays: they warn. What else shows nothing is refused."""
ASSUMED = [
    f.id for f in MAPS if f.facts["orientation"]["evidence"] == "assumed" and f.id not in MATRICES
]
OWN_MAPS = {"worksheet"}
"""Formats whose samples hold no map; the test that they name makes one."""


def mirrored(z):
    """Return the seven other ways in which a map may lie."""
    turned = [np.rot90(z, k) for k in range(4)] + [np.rot90(z.T, k) for k in range(4)]
    return turned[1:]


@pytest.mark.parametrize("fmt", MAPS, ids=lambda f: f.id)
def test_evidence_and_its_test_are_stated(fmt, repository):
    file, _, name = fmt.facts["orientation"]["tested_by"].partition("::")

    assert f"def {name}(" in (repository / file).read_text(encoding="utf-8")


@pytest.mark.parametrize("fmt", [f for f in MAPS if f.id not in OWN_MAPS], ids=lambda f: f.id)
def test_a_sample_is_no_mirror_image_of_itself(fmt, repository):
    """Samples are written from the description, not by our reader: a mirrored map is not what they hold."""
    expected = (repository / "data_formats" / fmt.id / "expected").glob("*.json")
    maps = [
        np.array(e["z_m"], float)
        for e in map(json.loads, (p.read_text() for p in expected))
        if e.get("kind") == "surface"
    ]

    assert any(
        not any(np.array_equal(z, other, equal_nan=True) for other in mirrored(z)) for z in maps
    )


def first_map(repository, name):
    """Return a sample of a map, what its rows are and the other options that it needs."""
    folder = repository / "data_formats" / name
    for path in sorted((folder / "expected").glob("*.json")):
        truth = json.loads(path.read_text())
        if truth.get("kind") == "surface" and "channel" not in truth["options"]:
            order = truth["options"].pop("row_order")
            rows = np.array(truth["z_m"], float)
            return folder / "samples" / path.stem, rows, order, truth["options"]
    raise LookupError(name)


@pytest.mark.parametrize("name", ASSUMED)
def test_rows_that_nothing_shows_are_asked_for(name, repository, tmp_path, capsys):
    path, rows, order, options = first_map(repository, name)

    with pytest.raises(ms.errors.AmbiguousFormatError, match="nothing shows"):
        ms.read(path, **options)
    for stated in ROW_ORDERS:
        surface = ms.read(path, row_order=stated, **options)
        expected = rows if stated == order else rows[::-1]
        np.testing.assert_allclose(surface.z, expected, rtol=0, atol=1e-15)
        assert surface.metadata["orientation_evidence"] == "stated"
        assert surface.history[0].parameters["row_order"] == stated

    words = [w for key, value in options.items() for w in (f"--{key}", value)]
    words += ["--lateral-step", "1 um"]  # for x3p, which needs one
    made = tmp_path / "map.x3p"
    for verb in (["check"], ["info"], ["measure"], ["convert", str(made)]):
        command = [verb[0], str(path), *verb[1:], *words]
        with pytest.raises(SystemExit) as refused:
            main(command)
        said = "".join(capsys.readouterr())
        hint = f"row_order={TOP_FIRST}"
        assert refused.value.code == 4
        assert f'--set "{hint}"' in said, verb
        with pytest.raises(SystemExit) as done:
            main([*command, "--set", hint])
        assert done.value.code in (0, 3), verb
    np.testing.assert_allclose(
        ms.read(made).z, rows if order == TOP_FIRST else rows[::-1], rtol=0, atol=1e-15
    )


HEIGHTS = np.array([[1.5, 2.0, -3.0, 4.25], [5.0, 6.0, 7.0, 8.0], [90.0, 10.0, 11.0, -12.0]])
"""In um; like no turned or mirrored image of itself."""
MATRIX = {"unit": "um", "lateral_step": "2 um"}


def write_matrix(folder, kind):
    """Write a bare matrix as other programs do."""
    path = folder / f"m.{kind}"
    if kind == "csv":
        path.write_text("".join(",".join(map(repr, row)) + "\n" for row in HEIGHTS.tolist()))
    elif kind == "xlsx":
        book = pytest.importorskip("openpyxl").Workbook()
        for row in HEIGHTS.tolist():
            book.active.append(row)
        book.save(path)
    elif kind == "npy":
        np.save(path, HEIGHTS)
    elif kind == "npz":
        np.savez(path, z=HEIGHTS)
    elif kind == "mat":
        pytest.importorskip("scipy.io").savemat(path, {"z": HEIGHTS})
    else:
        with pytest.importorskip("h5py").File(path, "w") as made:
            made["z"] = HEIGHTS
    return path


@pytest.mark.parametrize("kind", ["csv", "xlsx", "npy", "npz", "mat", "h5"])
def test_a_matrix_lies_as_stated_and_warns_where_nothing_is(kind, tmp_path):
    path = write_matrix(tmp_path, kind)
    up = HEIGHTS * 1e-6
    for order, wanted in ((None, up), (SMALLEST_FIRST, up), (TOP_FIRST, up[::-1])):
        surface = ms.read(path, **MATRIX, **({} if order is None else {"row_order": order}))
        np.testing.assert_allclose(surface.z, wanted, rtol=0, atol=1e-18)
        evidence = "assumed" if order is None else "stated"
        assert surface.metadata["orientation_evidence"] == evidence
        said = [w for w in surface.metadata["warnings"] if "which row is on top" in w]
        assert len(said) == (order is None)
        assert all(f"row_order={o!r}" in w for w in said for o in ROW_ORDERS)
        assert surface.history[0].parameters.get("row_order") == order


@pytest.mark.parametrize("verb", ["check", "info", "measure", "convert"])
def test_the_warning_of_a_matrix_names_the_option_of_the_command(verb, tmp_path, capsys):
    path = write_matrix(tmp_path, "csv")
    made = tmp_path / "map.x3p"
    command = [verb, str(path), *([str(made)] if verb == "convert" else [])]
    command += ["--unit", "um", "--lateral-step", "2 um"]
    with pytest.raises(SystemExit):
        main(command)
    hint = f"row_order={TOP_FIRST}"
    assert f'--set "{hint}"' in "".join(capsys.readouterr())
    made.unlink(missing_ok=True)
    with pytest.raises(SystemExit) as done:
        main([*command, "--set", hint])
    assert done.value.code in (0, 3)
    assert "which row is on top" not in "".join(capsys.readouterr())
    if verb == "convert":
        np.testing.assert_allclose(ms.read(made).z, HEIGHTS[::-1] * 1e-6, rtol=0, atol=1e-18)


@pytest.mark.parametrize(
    ("verb", "words"),
    [("separate", ["--method", "three_flat"]), ("geometry", ["surface_profile"])],
)
def test_a_command_that_makes_a_recipe_writes_the_order_of_rows_into_its_input(
    verb, words, tmp_path, capsys
):
    names = [str(write_matrix(tmp_path, "csv"))] * (3 if verb == "separate" else 1)
    words = [*words, *names] if verb == "geometry" else [*names, *words]
    command = [verb, *words, "--unit", "um", "--set", f"row_order={TOP_FIRST}", "--print-recipe"]
    with pytest.raises(SystemExit):
        main(command)
    head, _, step = capsys.readouterr().out.partition("[[step]]")
    assert f'row_order = "{TOP_FIRST}"' in head.partition("[input]")[2]
    assert "row_order" not in step


def test_an_order_of_rows_is_compared_with_what_the_file_shows(repository, tmp_path):
    path = tmp_path / "m.x3p"
    ms.write(ms.Surface(HEIGHTS * 1e-6, 1e-6, 1e-6), path)  # row 0 of an X3P has the smallest y
    assert ms.read(path, row_order=SMALLEST_FIRST).metadata["orientation_evidence"] == "standard"
    points = repository / "data_formats/delimited/samples/points.xyz"
    profile = repository / "data_formats/npz/samples/profile.npz"
    for file, options, said in (
        (path, {}, "smallest y first, by standard"),
        (points, {}, "coordinates"),
        (profile, {}, "holds a profile, which has no rows"),
    ):
        with pytest.raises(ms.errors.ReadError, match=said):
            ms.read(file, row_order=TOP_FIRST, **options)


def test_one_recipe_reads_files_that_show_their_rows_and_files_that_do_not(repository, tmp_path):
    shown = tmp_path / "shown.x3p"
    ms.write(ms.Surface(HEIGHTS * 1e-6, 1e-6, 1e-6), shown)
    asked = repository / "data_formats/vk/samples/plain.vk4"
    recipe = Recipe.parse(
        f'metrosep = 1\n[input]\nrow_order = "{TOP_FIRST}"\n[[step]]\nop = "parameters"\nnames = ["Sz"]\n'
    )

    said = {f.name: " ".join(recipe.run(f).document["messages"]) for f in (shown, asked)}

    assert "smallest y first, by standard" in said["shown.x3p"]
    assert "of the recipe is not used for it" in said["shown.x3p"]
    assert "row_order" not in said["plain.vk4"]


def test_a_word_that_is_no_order_of_rows_is_refused(repository):
    with pytest.raises(ms.errors.ReadError, match="use 'smallest y first' or 'top row first'"):
        ms.read(repository / "data_formats/vk/samples/plain.vk4", row_order="top")
