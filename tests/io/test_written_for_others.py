"""What metrosep writes, read by the programs that other people have; each is skipped by name where it is absent.

The map has no symmetry, pixels that are not square, a place, a level far from zero and pixels that were
not measured. Levels are compared only where the other program keeps them.
"""

import numpy as np
import pytest

import metrosep as ms

NY, NX = 37, 53
DX, DY = 1.7e-6, 2.9e-6
FLOAT32 = 1e-7
"""Steps in a Digital Surf file are 32-bit floats."""
STEPS = 2.0**30
"""Half of the steps that the range of a Digital Surf map or profile is divided into."""


def heights():
    y, x = np.mgrid[0:NY, 0:NX]
    z = 3e-7 * np.sin(x / 7.0) + 1e-7 * y / NY * np.cos(x / 5.0) - 4e-6
    z[0, 0] = -3e-6  # one corner stands out
    z[5:8, 40:50] = np.nan
    z[-1, 0] = np.nan
    return z


def written(folder, suffix, z=None):
    path = folder / f"map.{suffix}"
    ms.write(ms.Surface(heights() if z is None else z, DX, DY, origin=(1e-3, -2e-3)), path)
    return path


def same(found, z, far):
    """Compare the relief and the pixels that were not measured."""
    np.testing.assert_array_equal(np.isnan(found), np.isnan(z))
    relief = found - np.nanmean(found)
    np.testing.assert_allclose(relief, z - np.nanmean(z), rtol=0.0, atol=far)


@pytest.mark.parametrize(("suffix", "is_turned"), [("sdf", False), ("sur", True), ("x3p", False)])
def test_surface_topography_reads_our_maps(tmp_path, suffix, is_turned):
    package = pytest.importorskip("SurfaceTopography.IO", reason="SurfaceTopography is absent")
    read = package.open_topography(str(written(tmp_path, suffix))).topography()
    unit = {"m": 1.0, "mm": 1e-3, "µm": 1e-6}[read.unit]
    found = np.ma.filled(read.heights(), np.nan).T * unit

    same(found[::-1] if is_turned else found, heights(), 1e-6 / STEPS)
    size = [s * unit for s in read.physical_sizes]
    assert size == pytest.approx([NX * DX, NY * DY], rel=FLOAT32, abs=0.0)


@pytest.mark.filterwarnings("ignore:The surface has different pixel size")
@pytest.mark.parametrize(("suffix", "is_turned"), [("sdf", False), ("sur", True), ("x3p", False)])
def test_surfalize_reads_our_maps(tmp_path, suffix, is_turned):
    package = pytest.importorskip("surfalize", reason="surfalize is absent")
    read = package.Surface.load(str(written(tmp_path, suffix)))
    found = np.asarray(read.data) * 1e-6

    same(found[::-1] if is_turned else found, heights(), 1e-6 / STEPS)
    assert (read.step_x * 1e-6, read.step_y * 1e-6) == pytest.approx(
        (DX, DY), rel=FLOAT32, abs=0.0
    )


def test_rosettasciio_reads_our_maps_at_their_level_and_place(tmp_path):
    package = pytest.importorskip("rsciio.digitalsurf", reason="RosettaSciIO is absent")
    (read,) = package.file_reader(str(written(tmp_path, "sur")))
    found = np.asarray(read["data"], float)[::-1] * 1e-3

    np.testing.assert_allclose(found, heights(), rtol=0.0, atol=4e-6 / STEPS)
    rows, columns = read["axes"]
    assert (rows["units"], columns["units"]) == ("mm", "mm")
    steps = (columns["scale"] * 1e-3, rows["scale"] * 1e-3)
    assert steps == pytest.approx((DX, DY), rel=FLOAT32, abs=0.0)
    place = (columns["offset"] * 1e-3, rows["offset"] * 1e-3)
    assert place == pytest.approx((1e-3, -2e-3), rel=FLOAT32, abs=0.0)


@pytest.mark.parametrize("lacking", [(), (50, 51, 210)])
def test_rosettasciio_reads_our_profiles(tmp_path, lacking):
    package = pytest.importorskip("rsciio.digitalsurf", reason="RosettaSciIO is absent")
    x = 5e-5 + 0.83e-6 * np.arange(211)
    z = 4e-7 * np.sin(x / 3e-5) + 1e-3 * x
    z[list(lacking)] = np.nan
    ms.write(ms.Profile(x, z), tmp_path / "profile.pro")

    (read,) = package.file_reader(str(tmp_path / "profile.pro"))

    found = np.asarray(read["data"], float) * 1e-3
    np.testing.assert_allclose(found, z, rtol=0.0, atol=1e-6 / STEPS)
    (axis,) = read["axes"]
    assert axis["units"] == "mm"
    assert (axis["offset"] * 1e-3, axis["scale"] * 1e-3) == pytest.approx(
        (5e-5, 0.83e-6), rel=FLOAT32, abs=0.0
    )


def test_prysm_reads_our_grid_of_a_square_map(tmp_path):
    """Release 0.21.1 lays nx by ny numbers as nx rows: a map that is not square is scrambled by it."""
    package = pytest.importorskip("prysm.io", reason="prysm is absent")
    z = heights()[:, :NY]
    found, facts = package.read_codev_gridint(str(written(tmp_path, "int", z)))

    assert facts["data meaning"] == "surface error"
    half = np.ptp(z[np.isfinite(z)]) / 65534 / 2
    same(found[::-1] * 1e-9, z, 2 * half)
