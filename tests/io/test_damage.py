"""Every sample of every format, damaged: a valid object or a ReadError, quickly, in little memory.

Bytes are flipped one at a time, files are cut short, and Hypothesis changes several bytes at once.
Here a share of the positions is tried; ``make test-slow`` tries every one.
"""

import contextlib
import json
import resource
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import metrosep as ms
from metrosep.io import registry
from metrosep.io.source import RawFile

PATTERNS = (0xFF, 0x80, 0x01)
SLOWEST = 2.0  # seconds of processor time for one damaged file
LONGEST_TEST = 1800  # seconds; a flip that ends the process of the HDF5 library costs half a second to start it anew
MEMORY = 200 * 2**20  # bytes more than before the file is read
LONGEST = 700  # characters of one message with a long path
REFUSED = (ms.errors.ReadError, ms.errors.UnitError)
FOLDERS = sorted(p.parent for p in Path(__file__).parents[2].glob("data_formats/*/format.toml"))


def truth_of(folder, sample):
    return json.loads((folder / "expected" / f"{sample.name}.json").read_text(encoding="utf-8"))


CASES = [
    pytest.param(folder.name, sample, id=f"{folder.name}/{sample.name}")
    for folder in FOLDERS
    if registry.get(folder.name).is_measurement
    for sample in sorted((folder / "samples").iterdir())
    if "error" not in truth_of(folder, sample)
]


@pytest.fixture
def little_memory():
    """Let the process grow by `MEMORY` at most: a reader that allocates a claim fails."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


class Sample:
    """A sample, its reader and the object that it holds."""

    def __init__(self, format_id, path):
        options = dict(truth_of(path.parents[1], path).get("options", {}))
        if isinstance(options.get("unit"), list):
            options["unit"] = tuple(options["unit"])
        options.pop("format", None)
        self.path, self.data, self.options = path, path.read_bytes(), options
        self.reader = registry.get(format_id).load_reader()
        self.whole = self.reader.read(RawFile(path, self.data), **options)
        self.is_text = not any(b < 9 for b in self.data)

    def outcome(self, data):
        """Read bytes and check whatever comes out; return the object, or None when refused."""
        self.reader.sniff(RawFile(self.path, data))
        start = time.process_time()
        message = None
        try:
            obj = self.reader.read(RawFile(self.path, data), **self.options)
        except REFUSED as exc:
            message = str(exc)
        assert time.process_time() - start < SLOWEST
        if message is not None:
            assert self.path.name in message
            assert len(message) < LONGEST
            return None
        if isinstance(obj, ms.Recording):
            assert any(np.isfinite(v).any() for v in obj.channels.values())
        else:
            assert np.isfinite(obj.z).any()
        if isinstance(obj, ms.Surface):
            assert all(s is None or 0 < s < np.inf for s in (obj.dx, obj.dy))
        return obj


@pytest.fixture
def sample(request):
    return Sample(*request.param)


INDIRECT = [pytest.param(c.values, id=c.id) for c in CASES]
SOME = [
    pytest.param(*case.values, id=case.id, marks=[] if i % 3 == 0 else pytest.mark.slow)
    for i, case in enumerate(INDIRECT)
]
"""A third at every run, the others with the slow ones."""


def flips(data, n_positions):
    """Yield damaged copies; the head of a file, where the sizes are, is tried more densely."""
    head = range(min(len(data), 64))
    rest = np.linspace(0, len(data) - 1, n_positions).astype(int).tolist()
    for i, k in enumerate(sorted({*head, *rest})):
        damaged = bytearray(data)
        damaged[k] ^= PATTERNS[i % len(PATTERNS)]
        yield bytes(damaged)


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("sample", SOME, indirect=True)
def test_flipped_bytes(sample):
    results = {sample.outcome(data) is None for data in flips(sample.data, 100)}

    assert True in results or sample.is_text


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("sample", SOME, indirect=True)
def test_cut_short(sample):
    for end in np.unique(np.linspace(1, len(sample.data) - 1, 60).astype(int)).tolist():
        obj = sample.outcome(sample.data[:end])
        if obj is not None and not sample.is_text and isinstance(obj, ms.Surface):
            np.testing.assert_array_equal(obj.z, sample.whole.z)


@pytest.mark.slow
@pytest.mark.timeout(LONGEST_TEST)
@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize("sample", INDIRECT, indirect=True)
def test_every_byte_flipped_and_every_cut(sample):
    data = sample.data
    small = len(data) < 3000
    for k in range(len(data)):
        for pattern in PATTERNS if small else PATTERNS[k % 3 : k % 3 + 1]:
            sample.outcome(data[:k] + bytes([data[k] ^ pattern]) + data[k + 1 :])
    for end in range(1, len(data), 1 if small else 64):
        sample.outcome(data[:end])


@pytest.mark.parametrize("sample", SOME, indirect=True)
def test_several_changes_at_once(sample):
    n = len(sample.data)
    change = st.tuples(st.integers(0, n - 1), st.binary(min_size=1, max_size=8))

    @settings(
        max_examples=25,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.lists(change, min_size=1, max_size=6))
    def changed(changes):
        data = bytearray(sample.data)
        for k, new in changes:
            data[k : k + len(new)] = new
        sample.outcome(bytes(data))

    changed()


@pytest.mark.parametrize("sample", SOME, indirect=True)
def test_other_formats_content_is_refused_and_not_read(sample):
    """The reader is called by name on the first sample of every other format."""
    for other in {c.values[0]: c.values[1] for c in CASES}.values():
        if other.parents[1] == sample.path.parents[1]:
            continue
        with contextlib.suppress(*REFUSED):
            obj = sample.reader.read(RawFile(other, other.read_bytes()), **sample.options)
            assert len(obj.history) == 1


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_never_a_measurement(tmp_path, seed):
    path = tmp_path / "noise.dat"
    path.write_bytes(np.random.default_rng(seed).bytes(5000))

    with pytest.raises(ms.errors.UnknownFormatError):
        ms.read(path)


def _exported(kind, folder):
    """A file of two rows of heights whose last characters are ``1.25e-07`` (or ``12500000``)."""
    text = {
        "gwyddion.txt": "# Channel: Z\n# Width: 2.0 um\n# Height: 2.0 um\n# Value units: m\n"
        "1.5e-07\t2.5e-07\n3.5e-07\t1.25e-07\n",
        "grid.int": "made by hand\nGRD 2 2 SUR WVL 0.5 SSZ 1000\n1500 2500\n3500 12500000\n",
        "contour.DAT": "mm\n3\n  0.0,  0.00015\n  0.1,  0.00025\n  0.2,  1.25e-07\n",
    }[kind]
    (folder / kind).write_text(text, "ascii")
    return folder / kind


@pytest.mark.parametrize("kind", ["gwyddion.txt", "grid.int", "contour.DAT"])
def test_a_text_cut_in_its_last_number_says_so(tmp_path, kind):
    """A copy that stopped early: 1.25e-07 m became 1.25 m, and the count of numbers is right."""
    path = _exported(kind, tmp_path)
    whole = ms.read(path)
    assert not any("line end" in w for w in whole.metadata["warnings"])

    path.write_bytes(path.read_bytes()[:-5])
    cut = ms.read(path)

    assert np.size(cut) == np.size(whole)
    assert any("last number may be cut off" in w for w in cut.metadata["warnings"])


def test_an_sdf_cut_in_its_last_height_is_refused(tmp_path):
    """ISO 25178-71 ends with '*': 1.869E-7 m without its exponent would be 1.869 m."""
    path = tmp_path / "map.sdf"
    ms.write(ms.Surface(np.array([[1.5, 2.5], [3.5, 1.25]]) * 1e-7, 1e-6, 1e-6), path)
    text = path.read_bytes()
    assert text[:4] == b"aISO"
    end = text.rindex(b"e-", 0, text.rindex(b"*"))

    path.write_bytes(text[:end])
    with pytest.raises(ms.errors.CorruptFileError, match="ends within its last height"):
        ms.read(path)
