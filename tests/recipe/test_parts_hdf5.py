"""Arrays of a result in HDF5: read by h5py, which knows nothing of metrosep, and by metrosep."""

import csv
import hashlib
import io
import json

import h5py
import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.errors import RecipeError, WriteError
from metrosep.io.containers.native import table_bytes
from metrosep.separation import machine_axis

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

NM = 1e-9
ROUNDING = 1e-17
"""m: heights of 100 nm in double precision, a few steps of arithmetic."""
HEAD = 'metrosep = 1\n[input]\nfiles = ["part.h5"]\n'
PLANE = '[[step]]\nop = "form"\nform = "plane"\n'
PARTS = '[[output]]\nkind = "parts"\npath = "{}"\n'
DX, DY = 50e-6, 80e-6


def sha256(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def run(folder, text, name="part.h5", out="out"):
    recipe = ms.Recipe.parse(text, name="part.toml")
    return recipe.run([folder / name], out=folder / out)


@pytest.fixture
def surface(tmp_path):
    """A tilted map with a bump in one corner and a gap in another: no two of its turns are alike."""
    y, x = np.mgrid[:30, :40]
    z = 2 * NM * x - 3 * NM * y + 90 * NM * np.exp(-((x - 33) ** 2 + (y - 4) ** 2) / 9)
    z[25:, :3] = np.nan
    ms.write(ms.Surface(z, DX, DY, origin=(1e-3, -2e-3)), tmp_path / "part.h5")
    return z


@pytest.fixture
def profile(tmp_path):
    x = np.arange(300) * 1e-6
    z = 40 * NM * np.exp(-((x - 60e-6) ** 2) / 1e-10) + 1e-4 * x
    z[200:210] = np.nan
    ms.write(ms.Profile(x, z), tmp_path / "part.h5")
    return x, z


def without_plane(z):
    """Residual of z = a + b x + c y by least squares over what is measured."""
    rows, columns = np.indices(z.shape)
    known = np.isfinite(z)
    design = np.column_stack([np.ones(known.sum()), columns[known], rows[known]])
    left = z.copy()
    left[known] -= design @ np.linalg.lstsq(design, z[known], rcond=None)[0]
    return left


def test_the_map_that_is_left_in_h5py(surface, tmp_path):
    result = run(tmp_path, HEAD + PLANE + PARTS.format("end.h5"))

    assert result.files[0].name == "end-left.h5"
    with h5py.File(tmp_path / "out/end-left.h5") as file:
        z, attributes = file["z"][()], dict(file["z"].attrs)
        history = json.loads(bytes(file["history_json"][()]))
        assert (file.attrs["metrosep_format"], file.attrs["kind"]) == ("metrosep-h5", "surface")
    np.testing.assert_allclose(z, without_plane(surface), rtol=0.0, atol=100 * ROUNDING)
    assert np.unravel_index(np.nanargmax(z), z.shape) == (4, 33)  # row y, column x
    assert np.isnan(z[25:, :3]).all()
    assert np.isnan(z).sum() == 15
    assert (attributes["unit"], attributes["dx_m"], attributes["dy_m"]) == ("m", DX, DY)
    assert attributes["origin_m"].tolist() == [1e-3, -2e-3]
    assert sha256(tmp_path / "part.h5") in json.dumps(history)
    assert "fit plane" in json.dumps(history)


def test_the_map_that_is_left_in_metrosep(surface, tmp_path):
    result = run(tmp_path, HEAD + PLANE + PARTS.format("end.h5"))

    left = ms.read(tmp_path / "out/end-left.h5")

    np.testing.assert_array_equal(left.z, result.produced.obj.z)
    assert (left.dx, left.dy, left.origin) == (DX, DY, (1e-3, -2e-3))
    assert left.history[0].parameters["sha256"] == sha256(tmp_path / "part.h5")
    assert left.metadata["sha256"] == sha256(tmp_path / "out/end-left.h5")


def test_the_profile_that_is_left(profile, tmp_path):
    result = run(tmp_path, HEAD + PLANE + PARTS.format("end.h5"))

    assert [f.name for f in result.files] == ["end-left.h5", "result.json"]
    with h5py.File(tmp_path / "out/end-left.h5") as file:
        assert (file["x"].attrs["unit"], file["z"].attrs["unit"]) == ("m", "m")
        np.testing.assert_array_equal(file["x"][()], profile[0])
        z = file["z"][()]
        assert sha256(tmp_path / "part.h5") in bytes(file["history_json"][()]).decode()
    assert np.isnan(z[200:210]).all()
    assert np.isnan(z).sum() == 10
    assert int(np.nanargmax(z)) == 60
    left = ms.read(tmp_path / "out/end-left.h5")
    assert isinstance(left, ms.Profile)
    np.testing.assert_array_equal(left.z, result.produced.obj.z)
    assert left.history[0].parameters["sha256"] == sha256(tmp_path / "part.h5")


def test_the_profile_that_is_left_in_another_format(profile, tmp_path):
    run(tmp_path, HEAD + PLANE + PARTS.format("end.x3p"), out="x3p")
    csv_only = run(tmp_path, HEAD + PLANE + PARTS.format("end.csv"), out="csv")

    assert isinstance(ms.read(tmp_path / "x3p/end-left.x3p"), ms.Profile)
    assert [f.name for f in csv_only.files] == ["end.csv", "result.json"]
    with pytest.raises(
        RecipeError, match=r"part\.toml:9: path: sur .* Profile; .* csv, h5, pro, sdf, smd, x3p"
    ):
        run(tmp_path, HEAD + PLANE + PARTS.format("end.sur"), out="sur")
    assert not (tmp_path / "sur").exists()


REVERSAL = """metrosep = 1
[input]
readings = ["m1_nm", "m2_nm"]
x = "x_mm"
[[step]]
op = "straightedge_reversal"
u_reading = "3 nm"
"""


@pytest.fixture
def readings(tmp_path):
    """Artefact p and machine g: m1 = p + g, m2 = p - g; p is high late, g early."""
    x = np.linspace(0.0, 90.0, 46)
    p, g = 40 * np.exp(-((x - 70) ** 2) / 50), 90 * np.exp(-((x - 20) ** 2) / 80)
    lines = ["x_mm,m1_nm,m2_nm"]
    lines += [f"{a!r},{b!r},{c!r}" for a, b, c in zip(*map(np.ndarray.tolist, (x, p + g, p - g)),
                                                     strict=True)]  # fmt: skip
    (tmp_path / "edge.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def columns_of(path):
    """Columns of a table in their order, by h5py."""
    with h5py.File(path) as file:
        named = [d for d in file.values() if isinstance(d, h5py.Dataset)]
        named.sort(key=lambda d: d.attrs["column"])
        return {d.attrs["name"]: (d[()], d.attrs.get("unit")) for d in named}


def test_the_table_of_a_separation_holds_the_numbers_of_the_csv(readings):
    text = REVERSAL + PARTS.format("parts.csv") + PARTS.format("parts.h5")
    result = run(readings, text, "edge.csv")

    assert [f.name for f in result.files][:2] == ["parts.csv", "parts.h5"]
    head, *lines = csv.reader((readings / "out/parts.csv").read_text().splitlines())
    found = columns_of(readings / "out/parts.h5")
    assert list(found) == head
    for i, (name, (values, unit)) in enumerate(found.items()):
        wanted = [float(line[i]) if line[i] else np.nan for line in lines]
        np.testing.assert_array_equal(values, wanted, err_msg=name)
        assert unit == "m", name
    peaks = {n: found["x_m"][0][int(np.nanargmax(found[n][0]))] for n in head if n[0] in "am"}
    assert peaks["artefact_m"] == pytest.approx(70e-3, abs=2e-3)
    assert peaks["machine_m"] == pytest.approx(20e-3, abs=2e-3)


def test_the_table_says_where_it_comes_from(readings):
    text = REVERSAL + PARTS.format("parts.h5")
    result = run(readings, text, "edge.csv")

    with h5py.File(readings / "out/parts.h5") as file:
        told = {k: d.asstr()[()] for k, d in file["provenance"].items()}
    (source,) = json.loads(told["inputs_json"])
    assert source["sha256"] == sha256(readings / "edge.csv")
    assert told["recipe_sha256"] == hashlib.sha256(text.encode()).hexdigest()
    assert told["recipe"] == text
    assert json.loads(told["history_json"])[-1]["step"] == "straightedge_reversal"
    assert result.document["recipe"]["sha256"] == told["recipe_sha256"]


def test_metrosep_reads_the_table(readings):
    result = run(readings, REVERSAL + PARTS.format("parts.h5"), "edge.csv")

    for x, z in (("/x_m", "/machine_m"), ("x_m", "machine_m"), ("x_m:m", ("machine_m", "m"))):
        read = ms.read(readings / "out/parts.h5", x=x, z=z)

        assert isinstance(read, ms.Profile)
        np.testing.assert_array_equal(read.z, result.produced.machine)
        np.testing.assert_array_equal(read.x, result.produced.coordinates["x"])


def test_orders_of_terms_are_whole_numbers_without_a_unit():
    found = columns_of(io.BytesIO(table_bytes({"zernike_m": np.array([0, -1, 1])}, {})))
    values, unit = found["zernike_m"]
    assert unit is None
    assert values.dtype == np.int64
    assert values.tolist() == [0, -1, 1]


@pytest.mark.parametrize("name", ["x.hdf5", "x.npz", ".h5", "x."])
def test_a_name_of_parts_that_says_no_format_is_refused_before_anything_is_read(readings, name):
    with pytest.raises(RecipeError, match=r"part\.toml:10: .*path.*\.x3p"):
        run(readings, REVERSAL + PARTS.format(name), "edge.csv")


def test_the_same_run_gives_the_same_bytes(readings, tmp_path):
    files = []
    for out in ("a", "b"):
        run(readings, REVERSAL + PARTS.format("parts.h5"), "edge.csv", out=out)
        files.append((readings / out / "parts.h5").read_bytes())
    assert files[0] == files[1]


@pytest.mark.parametrize("suffix", [".x3p", ".sur"])
def test_a_table_in_a_format_of_maps_is_refused_with_its_line(readings, suffix):
    with pytest.raises(RecipeError, match=rf"part\.toml:10: .*\.csv or \.h5, not as \{suffix}"):
        run(readings, REVERSAL + PARTS.format("parts" + suffix), "edge.csv")
    assert not (readings / "out").exists()


def test_columns_of_every_kind():
    columns = {
        "term": ["roll", "Prüfling 量具", None],
        "count": [3, -1, 2],
        "x_mm": [0.1 + 0.2, None, float("nan")],
        "mean (um/V)": np.array([1.0, 2.0, 3.0]),
        "feed_mm_min": np.array([1.0, 2.0, 3.0], dtype=np.float32),
        "speed_rev_per_s": [1.0, 2.0, 3.0],
    }
    data = table_bytes(columns, {"who": "ü"})

    found = columns_of(io.BytesIO(data))
    assert list(found) == list(columns)
    assert [t.decode() for t in found["term"][0]] == ["roll", "Prüfling 量具", ""]
    assert found["count"][0].tolist() == [3, -1, 2]
    assert found["count"][0].dtype == np.int64
    assert found["x_mm"][0][0] == 0.1 + 0.2
    assert np.isnan(found["x_mm"][0][1:]).all()
    units = {n: u for n, (_, u) in found.items()}
    assert units == {
        "term": None, "count": None, "x_mm": "mm", "mean (um/V)": None, "feed_mm_min": "mm/min",
        "speed_rev_per_s": "Hz",
    }  # fmt: skip
    with h5py.File(io.BytesIO(data)) as file:
        assert file["mean (um_V)"].attrs["name"] == "mean (um/V)"
        assert file["provenance/who"].asstr()[()] == "ü"
        assert file["term"].asstr()[1] == "Prüfling 量具"
    assert table_bytes(columns, {"who": "ü"}) == data


@pytest.mark.parametrize(
    "columns",
    [{"a": [1.0], "b": [1.0, 2.0]}, {"a/b": [1.0], "a_b": [2.0]}, {"provenance": [1.0]}, {"": []}],
    ids=["lengths", "one name", "taken", "no name"],
)
def test_what_is_no_table_is_refused(columns):
    with pytest.raises(WriteError):
        table_bytes(columns, {})


SEPARATE = """metrosep = 1
[input]
x = "x_mm"
z = "z_um"
feed = "feed_mm_min"
run = "run"

[[step]]
op = "separate"
start = "0 mm"
length = "30 mm"
"""


@pytest.fixture(scope="module")
def both_directions(tmp_path_factory):
    """Runs forward and back over an axis that errs differently in the two."""
    folder = tmp_path_factory.mktemp("axis")
    lines = ["run,feed_mm_min,x_mm,z_um"]
    for r in machine_axis(seed=3, length=30e-3, directions=(1, -1), n_repeats=2).runs:
        lines += [
            f"{r.run_id},{r.feed * 6e4:.0f},{x * 1e3:.4f},{z * 1e6:.5f}"
            for x, z in zip(r.x, r.z, strict=True)
        ]
    (folder / "runs.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_the_arrays_of_a_separation_of_runs(both_directions, tmp_path):
    text = SEPARATE + PARTS.format("axis.h5") + PARTS.format("axis.csv")
    recipe = ms.Recipe.parse(text)
    result = recipe.run(both_directions / "runs.csv", out=tmp_path / "out")

    names = [f.name for f in result.files]
    assert {"axis.h5", "axis-spectrum.h5", "axis-feed_spectra.h5", "axis.csv"} <= set(names)
    found = columns_of(tmp_path / "out/axis.h5")
    estimate, x = result.produced, found["x_m"][0]
    assert (x[0], x[-1]) == (0.0, 30e-3)
    assert {u for _, u in found.values()} == {"m"}
    for name, direction in (("error", None), ("error_forward", 1), ("error_reverse", -1)):
        wanted = estimate.evaluate(x, direction=direction), estimate.sd(x, direction=direction)
        np.testing.assert_array_equal(found[f"{name}_m"][0], wanted[0], err_msg=name)
        np.testing.assert_array_equal(found[f"u_{name}_m"][0], wanted[1], err_msg=name)
    assert np.ptp(found["error_forward_m"][0] - found["error_reverse_m"][0]) > 0.0
    spectrum = columns_of(tmp_path / "out/axis-spectrum.h5")
    assert list(spectrum) == list(estimate.spectrum.columns)
    np.testing.assert_array_equal(spectrum["amplitude_nm"][0], estimate.spectrum["amplitude_nm"])
    assert (spectrum["wavelength_mm"][1], spectrum["phase_rad"][1]) == ("mm", "rad")
    assert spectrum["selected"][0].tolist() == estimate.spectrum["selected"].tolist()
    psd = columns_of(tmp_path / "out/axis-residual_psd.h5")
    assert {n: u for n, (_, u) in psd.items()}["frequency_hz"] == "Hz"
    assert psd["psd_nm2_per_hz"][1] is None  # nm2/Hz, and not Hz
    with h5py.File(tmp_path / "out/axis.h5") as file:
        inputs = json.loads(file["provenance/inputs_json"].asstr()[()])
    assert inputs[0]["sha256"] == sha256(both_directions / "runs.csv")


def test_a_separation_of_runs_without_parts_writes_none(both_directions, tmp_path):
    recipe = ms.Recipe.parse(SEPARATE)
    result = recipe.run(both_directions / "runs.csv", out=tmp_path / "out")
    assert [f.name for f in result.files] == ["result.json"]


def checked(file):
    with pytest.raises(SystemExit) as end:
        main(["check", str(file)])
    return end.value.code


def test_check_takes_parts_of_a_separation_of_runs(both_directions, tmp_path, capsys):
    file = tmp_path / "r.toml"
    file.write_text(SEPARATE.replace("[input]", '[input]\nfiles = ["runs.csv"]')
                    + PARTS.format("axis.h5"))  # fmt: skip
    assert checked(file) == 0
    file.write_text(file.read_text() + PARTS.format("axis.h5"))
    assert checked(file) == 2
    told = capsys.readouterr()
    assert "two outputs would be called 'axis.h5'" in told.out + told.err
