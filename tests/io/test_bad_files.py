"""The corpus of bad files that tools/make_bad_files.py writes: one sentence each, soon and small."""

import runpy
import time

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.check import check_file

SLOWEST = 2.0  # seconds
REFUSED = (ms.errors.ReadError, ms.errors.UnitError)


@pytest.fixture(scope="module")
def bad_files(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bad")
    script = request.config.rootpath / "tools" / "make_bad_files.py"
    runpy.run_path(str(script))["main"](folder)
    return folder


@pytest.mark.parametrize(
    "third", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_every_bad_file_is_read_rightly_or_refused(bad_files, monkeypatch, tmp_path, third):
    monkeypatch.chdir(tmp_path)
    files = sorted(bad_files.iterdir())
    assert len(files) > 800

    for path in files[third::3]:
        started = time.process_time()
        try:
            obj = ms.read(path)
        except REFUSED as exc:
            assert path.stem in str(exc), path.name  # noqa: PT017  (one of a thousand files)
        else:
            values = obj.channels.values() if isinstance(obj, ms.Recording) else [obj.z]
            assert any(np.isfinite(v).any() for v in values), path.name
        assert time.process_time() - started < SLOWEST, path.name
    assert list(tmp_path.iterdir()) == []  # no pickle was run


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("bomb.x3p", "bytes"),
        ("billion-laughs.x3p", "entit|DTD|DOCTYPE"),
        ("entity-outside.x3p", "entit|DTD|DOCTYPE"),
        ("path-traversal.x3p", "not a member|no member|outside|not in the archive|missing"),
        ("step-nan.x3p", "Increment|increment"),
        ("pickle.npy", "would run code"),
        ("claims-8-TB.npy", "claims 1000000000000 values"),
        ("zeros.dat", "no reader knows"),
    ],
)
def test_hostile_file_is_refused_for_its_reason(bad_files, name, match):
    with pytest.raises(REFUSED, match=match):
        ms.read(bad_files / name)


def test_a_map_of_zeros_is_said_to_be_one(bad_files):
    surface = ms.read(bad_files / "zeros.x3p")

    assert "no relief" in " ".join(surface.metadata["warnings"])


def test_check_turns_a_bad_file_into_a_finding(bad_files):
    (finding,) = check_file(bad_files / "claims-8-TB.npy")

    assert finding.unreadable
    assert finding.fix
