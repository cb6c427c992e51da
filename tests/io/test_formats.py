"""Contract of every folder in data_formats: samples made without metrosep read as expected."""

import hashlib
import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io import registry
from metrosep.io.objects import EVIDENCE
from metrosep.io.source import open_file

FOLDERS = sorted(p.parent for p in Path(__file__).parents[2].glob("data_formats/*/format.toml"))
CASES = [
    pytest.param(folder, sample, id=f"{folder.name}/{sample.name}")
    for folder in FOLDERS
    for sample in sorted((folder / "samples").iterdir())
]
MEASUREMENTS = [c for c in CASES if registry.get(c.values[0].name).is_measurement]

RTOL = 1e-12  # double precision after one multiplication by a scale
AM = 1e-18  # far below any height in the samples
STATUS = {"verified-on-real-file", "from-specification", "synthetic"}
KINDS = {"surface", "profile", "recording", "compensation"}


def truth_of(folder, sample):
    return json.loads((folder / "expected" / f"{sample.name}.json").read_text(encoding="utf-8"))


def options_of(truth):
    options = dict(truth.get("options", {}))
    if isinstance(options.get("unit"), list):
        options["unit"] = tuple(options["unit"])
    return options


def is_unproven(description):
    return description.status == "from-specification"


def numbers(values):
    return np.array(values, dtype=float)  # null becomes NaN


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: f.name)
def test_samples_are_what_the_script_writes(folder, tmp_path):
    source = (folder / "make_samples.py").read_text(encoding="utf-8")

    runpy.run_path(str(folder / "make_samples.py"))["main"](tmp_path)

    assert "metrosep" not in re.findall(r"^(?:import|from)\s+(\w+)", source, re.MULTILINE)
    for part in ("samples", "expected"):
        shipped = {p.name: p.read_bytes() for p in (folder / part).iterdir()}
        made = {p.name: p.read_bytes() for p in (tmp_path / part).iterdir()}
        assert shipped == made


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: f.name)
def test_descriptor_is_complete(folder):
    fmt = registry.get(folder.name)

    assert fmt.id == folder.name
    assert fmt.status in STATUS
    assert set(fmt.kind.split(" | ")) <= KINDS
    assert all(s.startswith(".") for s in fmt.suffixes)
    assert {"unit", "invalid", "axis_order", "sources"} <= set(fmt.facts)
    assert (folder / "SPEC.md").is_file()
    if "surface" in fmt.kind:
        assert fmt.facts["orientation"]["evidence"] in EVIDENCE
        assert fmt.facts["orientation"]["shown_by"]


def test_no_format_that_is_read_in_chunks_is_unproven():
    assert [f.id for f in registry.formats() if "chunks" in f.facts and is_unproven(f)] == []


def test_runs_of_an_unproven_format_say_so(tmp_path):
    path = tmp_path / "scope.csv"
    rows = [f"{k}\t{k % 7}.5\t{k}\t{k}.25" for k in range(30)]
    head = "Name\tscope\nFile\tscope.csv\n\nName\tgap\tName\tpos\nData-Type\tREAL64\tData-Type\tREAL64\n"
    head += "SampleTime[ms]\t1\tSampleTime[ms]\t1\nUnit\tum\tUnit\tmm\n\n"
    path.write_text(head + "\n".join(rows) + "\n")

    runs = ms.read_runs(path, x="pos", z="gap")

    assert runs[0].x.tolist() == pytest.approx([(k + 0.25) * 1e-3 for k in range(30)], abs=1e-15)
    assert any("no file of an instrument" in w for w in runs.metadata["warnings"])


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: f.name)
def test_declared_marks_are_in_every_sample(folder):
    fmt = registry.get(folder.name)
    if not fmt.is_measurement or fmt.reader == "layout" or folder.name == "pmac-gather":
        pytest.skip("recognised by no declared mark")

    assert {"what", "expected"} <= set(fmt.facts["recognise"])
    for sample in (folder / "samples").iterdir():
        assert fmt.marks.look(open_file(sample)) is not registry.Match.NO, sample.name


@pytest.mark.parametrize(("folder", "sample"), MEASUREMENTS)
def test_sample_is_recognised_whatever_its_name(folder, sample, tmp_path):
    if "format" in truth_of(folder, sample).get("options", {}):
        pytest.skip("plain columns without a header: the format must be named")
    renamed = tmp_path / "file.bin"
    renamed.write_bytes(sample.read_bytes())

    assert registry.identify(renamed).id == folder.name


@pytest.mark.parametrize(("folder", "sample"), MEASUREMENTS)
def test_sample_reads_as_expected(folder, sample):
    truth = truth_of(folder, sample)
    if "error" in truth:
        with pytest.raises(getattr(ms.errors, truth["error"]), match=re.escape(truth["match"])):
            ms.read(sample, **options_of(truth))
        return

    obj = ms.read(sample, **options_of(truth))

    said = [w for w in obj.metadata["warnings"] if "no file of an instrument" in w]
    assert len(said) == is_unproven(registry.get(folder.name))
    assert said == [obj.metadata.get("unproven")] * len(said)
    assert type(obj).__name__.lower() == truth["kind"]
    if truth["kind"] == "surface":
        assert list(obj.shape) == truth["shape"]
        np.testing.assert_allclose(obj.z, numbers(truth["z_m"]), rtol=RTOL, atol=AM)
        for step, own in (("dx_m", obj.dx), ("dy_m", obj.dy)):
            assert own == (truth[step] and pytest.approx(truth[step], rel=RTOL, abs=0.0))
        assert "row_order_in_file" in obj.metadata
    elif truth["kind"] == "profile":
        assert len(obj) == truth["shape"][0]
        np.testing.assert_allclose(obj.x, numbers(truth["x_m"]), rtol=RTOL, atol=AM)
        np.testing.assert_allclose(obj.z, numbers(truth["z_m"]), rtol=RTOL, atol=AM)
    else:
        np.testing.assert_allclose(obj.t, numbers(truth["t_s"]), rtol=RTOL, atol=AM)
        assert set(obj.channels) == set(truth["channels"])
        for name, values in truth["channels"].items():
            np.testing.assert_allclose(obj[name], numbers(values), rtol=RTOL, atol=AM)
    if "origin_m" in truth:
        assert obj.origin == pytest.approx(tuple(truth["origin_m"]), rel=RTOL, abs=0.0)
    if "warnings_match" in truth:
        assert any(truth["warnings_match"] in w for w in obj.metadata["warnings"])


@pytest.mark.parametrize(("folder", "sample"), MEASUREMENTS)
def test_every_object_carries_the_hash_of_its_file(folder, sample):
    truth = truth_of(folder, sample)
    if "error" in truth:
        return
    digest = hashlib.sha256(sample.read_bytes()).hexdigest()

    obj = ms.read(sample, **options_of(truth))

    assert obj.history[0].name == "read"
    assert obj.history[0].parameters["sha256"] == digest
    assert obj.history[0].parameters["format"] == folder.name
    assert obj.metadata["sha256"] == digest
    assert obj.metadata["header"]
