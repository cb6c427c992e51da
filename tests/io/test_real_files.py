"""Real files of formats without a module of tests of their own, as independent programs read them.

The numbers are those of the MANIFEST of the corpus (SurfaceTopography 1.27.1, IMCtermite 2.1.18) and of
asammdf 8.8.28; corner values pin which way up and which way round a map lies.
"""

import numpy as np
import pytest

import metrosep as ms

NM = 1e-9
PM = 1e-12
LAST_DIGIT = 5e-7  # relative: seven digits are printed


@pytest.mark.parametrize(
    ("name", "options", "step_nm", "pv_nm", "sq_nm", "corner_nm", "beside_nm"),
    [
        ("di-3.di", {}, 39.0625, 1210.131, 226.4254, 64.31504868, 63.12951782),
        ("di-3.di", {"channel": "Height"}, 39.0625, 1414.483, 264.0029, None, None),
        ("stp-1.stp", {}, 2.34375, 13.70081, 1.654159, 0.64875401, -0.03070209),
        ("10x10.ibw", {"unit": "nm"}, 1.0, 1.0, None, 1.0, 1.0),
    ],
)
def test_maps_of_microscopes(corpus, name, options, step_nm, pv_nm, sq_nm, corner_nm, beside_nm):
    surface = ms.read(corpus / "afm" / name, **options)

    assert surface.dx == surface.dy == pytest.approx(step_nm * NM, rel=LAST_DIGIT, abs=0.0)
    assert surface.peak_to_valley() == pytest.approx(pv_nm * NM, rel=LAST_DIGIT, abs=0.0)
    assert not np.isnan(surface.z).any()
    if sq_nm is not None:
        assert np.std(surface.z) == pytest.approx(sq_nm * NM, rel=LAST_DIGIT, abs=0.0)
    if corner_nm is not None:  # row 0, the smallest y, from the left
        expected = np.array([corner_nm, beside_nm]) * NM
        np.testing.assert_allclose(surface.z[0, :2], expected, rtol=0, atol=1e-6 * NM)
    assert surface.metadata["orientation_evidence"] in ("peer", "coordinates")


def test_a_wave_without_units_is_refused(corpus):
    with pytest.raises(ms.errors.UnitError, match="declare it with unit="):
        ms.read(corpus / "afm" / "10x10.ibw")


@pytest.mark.parametrize(
    ("name", "channel", "unit", "n", "t_s", "values"),
    [
        ("sampleA.raw", "pressure_Vacuum", "mbar", 2402, (2044.03, 2056.035), (956.013794, 866.985291, 906.771051)),
        ("sampleB.raw", "VehicleSpeed_HS", "kph", 600, (2044.02, 2056.0), (5.94, 0.0, 1.039)),
        ("datasetA_1.raw", "ACC_long", "G", 6000, (416.01, 446.005), (0.010029276, None, -0.00431780641)),
        ("XY_dataset_example.dat", "here is the channel name", "", 13094, (67.855759, 395.158317),
         (None, 2982616.0, None)),
    ],
)  # fmt: skip
def test_imc_recordings(corpus, name, channel, unit, n, t_s, values):
    recording = ms.read(corpus / "imc" / name)
    found = recording[channel]

    assert len(recording) == n
    assert recording.metadata["units_in_file"][channel] == unit
    assert (recording.t[0], recording.t[-1]) == pytest.approx(t_s, abs=1e-9)
    for expected, got in zip(values, (found[0], found[-1], found.mean()), strict=True):
        if expected is not None:
            assert got == pytest.approx(expected, rel=LAST_DIGIT, abs=1e-12)


def test_mdf_recording_with_every_kind_of_conversion(corpus):
    recording = ms.read(corpus / "mdf4" / "test_metadata.mf4")
    expected = {
        "SBYTE.IDENTICAL": [-124.0, -25.0],
        "UBYTE.HYPERBOLIC": [1 / 44, 1 / 143],
        "UBYTE.RAT_FUNC.DIV_10": [14.4, 24.3],
        "UBYTE.TAB_INTP_DEFAULT_VALUE": [111.0, 111.0],
        "UWORD.IDENTICAL.BITMASK_0FF0": [50.0, 56.0],
        "UWORD.IDENTICAL.BITMASK_0008": [1.0, 1.0],
        "FLOAT32.IDENTICAL": [300.0, 400.0],
        "UBYTE.VTAB_RANGE_NO_DEFAULT_VALUE": [200.0, 43.0],  # texts: the number is kept
    }

    assert recording.t.tolist() == [0.0, 1.0]
    assert len(recording.channels) == 24
    for name, values in expected.items():
        full = f"ASAM.M.SCALAR.{name}"
        factor = 3600.0 if recording.metadata["units_in_file"][full] == "hours" else 1.0
        np.testing.assert_allclose(recording[full], np.array(values) * factor, rtol=1e-12)
    units = recording.metadata["units_in_file"]
    assert units["ASAM.M.SCALAR.UBYTE.TAB_INTP_DEFAULT_VALUE"] == "U/  min"
    assert units["ASAM.M.SCALAR.SBYTE.IDENTICAL"] == "hours"
    assert recording.units["ASAM.M.SCALAR.SBYTE.IDENTICAL"] == "s"
