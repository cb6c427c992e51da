"""Which way up a map lies: every format says what shows it, and a test of it fails for a mirror image."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.text_options import ROW_ORDERS
from metrosep.io import registry

SMALLEST_FIRST, TOP_FIRST = ROW_ORDERS
MAPS = [f for f in registry.formats() if "surface" in f.kind]
ASSUMED = [f.id for f in MAPS if f.facts["orientation"]["evidence"] == "assumed"]
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


def test_a_word_that_is_no_order_of_rows_is_refused(repository):
    with pytest.raises(ms.errors.ReadError, match="use 'smallest y first' or 'top row first'"):
        ms.read(repository / "data_formats/vk/samples/plain.vk4", row_order="top")
