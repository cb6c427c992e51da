"""Every file of the corpus as its manifest gives it, read by independent programs.

What a file does not say is declared here (a unit, a channel); what differs on purpose is listed
with its reason. The manifest's step of a profile is extent / n for some files and extent / (n - 1)
for others; of positions that are not uniform it has none that we could compare with.
"""

import csv

import pytest

import metrosep as ms

MANIFEST = 1e-6  # relative; the manifest has seven digits

TEXT_M = {"unit": "m"}
OPTIONS = {
    "dabam/dabam-001.dat": {"slope": "integrate"},
    "dabam/dabam-025.dat": {"slope": "integrate"},
    "dabam/dabam-071.dat": {"slope": "integrate"},
    "nmm/test01_XYZ.pos": {"channel": "positions"},
    "st/csv-1.csv": {"unit": {"y1": "m"}},
    "st/csv-2.csv": {"x": "x", "z": "y"},
    "st/nonuniform.asc": TEXT_M,
    "st/opdx-3.txt": TEXT_M,
    "st/xy-1.txt": TEXT_M,
    "st/xy-3.txt": TEXT_M,
    "st/xy-4.txt": TEXT_M,
    "st/xyz-1.txt": {"x": "column1:m", "y": "column2:m", "z": "column3:m"},
    "st/xyz-1-different-order.txt": {"x": "column1:m", "y": "column2:m", "z": "column3:m"},
    "st/xyz-2.txt": {"x": "column1:m", "y": "column2:m", "z": "column3:m"},
    "upm/D906-1.csv": {"x": "path"},
    "upm/20221019-strategy-2p40-1.csv": {"x": "path"},
    "upm/20221019-strategy-2p40-2.csv": {"x": "path"},
    "upm/20221019-strategy-2p40-3.csv": {"x": "path"},
    "round/talyrond_profile.xlsx": {"unit": "um", "radius": "10 mm"},
}
NO_OBJECT = {
    "nmm/test01_XYZ_f_quad_Z_Heydemann.csv": "three columns of a quadrature circle: a table",
    "nmm/test01_XYZ_f_quad_Z_raw.csv": "three columns of a quadrature circle: a table",
    "round/cir2d30.csv": "points x, y, z of a circle without units: a table",
    "upm/D906-1.txt": "a tool edge whose positions turn back: no function of x",
    "upm/20221020-3D-1.csv": "16 lines of different positions: a line at a time",
}
OTHER_STEP = {
    "st/csv-1.csv": "the header declares microns; the peer took the first column for metres",
    "st/csv-2.csv": "the header declares um; the peer took metres",
    "st/csv-3.csv": "the header declares um; the peer took metres",
    "st/xy-2.txt": "the header declares um; the peer took metres",
    "prysm/valid_codev_int_file.int": "the format has no step: None, not 0",
    "x3ptools/testing.x3p": "the file declares 0.0275 m; the peer gave none",
}
OTHER_HEIGHT = {"st/xy-2.txt": "a row of units, um, above the numbers; the peer took metres"}
SLOPES = {"dabam/dabam-001.dat", "dabam/dabam-025.dat", "dabam/dabam-071.dat"}


def rows(corpus):
    with (corpus / "MANIFEST.tsv").open(encoding="utf-8") as handle:
        return [r for r in csv.DictReader(handle, delimiter="\t") if r["shape"]]


def names():
    import os
    from pathlib import Path

    folder = Path(
        os.environ.get("METROSEP_CORPUS", Path(__file__).parents[3] / "shared" / "corpus")
    )
    return [r["file"] for r in rows(folder)] if (folder / "MANIFEST.tsv").is_file() else []


@pytest.mark.parametrize("name", names())
def test_file_of_the_corpus(corpus, name):
    row = next(r for r in rows(corpus) if r["file"] == name)
    if name in NO_OBJECT:
        with pytest.raises((ms.errors.ReadError, ms.errors.UnitError)):
            ms.read(corpus / name)
        return

    obj = ms.read(corpus / name, **OPTIONS.get(name, {}))

    shape = tuple(int(n) for n in row["shape"].strip("()").split(",") if n.strip())
    if isinstance(obj, ms.Recording):
        assert len(obj) == shape[0]
        return
    assert obj.z.shape == shape[: obj.z.ndim]
    if row["PV_nm"] == "nan":
        return
    size, rms = (
        (obj.metadata["slope_pv_rad"], obj.metadata["slope_rms_rad"])
        if name in SLOPES
        else (obj.peak_to_valley(), obj.rms())
    )
    if name in OTHER_HEIGHT:
        size, rms = size * 1e6, rms * 1e6
    assert obj.n_invalid == int(row["n_invalid"])
    assert size * 1e9 == pytest.approx(float(row["PV_nm"]), rel=MANIFEST, abs=0.0)
    assert rms * 1e9 == pytest.approx(float(row["Sq_nm"]), rel=MANIFEST, abs=0.0)
    uniform = isinstance(obj, ms.Surface) or obj.is_uniform
    if name not in OTHER_STEP and uniform:
        tolerance = MANIFEST if isinstance(obj, ms.Surface) else 2.0 / len(obj)
        assert obj.dx == pytest.approx(float(row["dx"]), rel=tolerance, abs=0.0)
