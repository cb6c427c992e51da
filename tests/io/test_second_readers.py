"""Maps of the corpus as other programs read them: shape, steps, invalid pixels, P-V, Sq and three pixels.

`READ` was written down from SurfaceTopography 1.27.1, surfalize 0.19.2, prysm 0.21.1, RosettaSciIO 0.15.0
and igor2 0.5.15, each in an environment without metrosep. Their arrays were laid as ours are (row 0 has
the smallest y): `turned` says what that took. Three heights about the mean, at places without any
symmetry, change for each of the seven other ways to lay a map. Where a reader is installed here, it is
asked again, and every pixel is compared.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

import metrosep as ms

NM = 1e-9
DIGITS = 1e-8
"""Relative; the table has nine digits."""
ROUNDING = 1e-11
"""Share of P-V by which programs differ that scale the same counts in another order."""
FILE_ORDER, TOP_FIRST = "T", "T, turned"
"""SurfaceTopography hands over [x, y]: transposed, and turned upside down where the file has the top row first."""


class Read(NamedTuple):
    """What another program reads: heights in nm about the mean at `places`."""

    reader: str
    file: str
    shape: tuple[int, int]
    steps: tuple[float, float]  # m
    n_invalid: int
    pv: float
    sq: float
    heights: tuple[float, float, float]
    turned: str
    options: dict[str, Any] = {}  # noqa: RUF012  (read only)


READ = [
    Read("SurfaceTopography", "text/matrix-3.txt", (256, 256), (3.90625e-08, 3.90625e-08), 0, 408.83, 35.22291875,
         (25.7920627, -34.2091373, 26.7587627), TOP_FIRST),
    Read("SurfaceTopography", "afm/stp-1.stp", (256, 256), (2.34375e-09, 2.34375e-09), 0, 13.700807033, 1.6541593884,
         (-0.743547712, -0.7683126, -0.641982623), TOP_FIRST),
    Read("SurfaceTopography", "afm/di-3.di", (256, 256), (3.90625e-08, 3.90625e-08), 0, 1210.1306163, 226.42539668,
         (29.4056595, 256.138435, -268.458967), TOP_FIRST),
    Read("SurfaceTopography", "afm/di-3.di", (256, 256), (3.90625e-08, 3.90625e-08), 0, 1414.4832880, 264.00285276,
         (68.0274857, 280.487086, -323.134826), TOP_FIRST, {"channel": "Height"}),
    Read("SurfaceTopography", "st/metropro-1.dat", (480, 640), (1.0982520280e-06, 1.0982520280e-06), 0, 1363.0563293,
         75.288222047, (-74.0892971, -35.8898344, 105.270748), TOP_FIRST),
    Read("SurfaceTopography", "st/x3p-2.x3p", (650, 650), (1.2765650984e-07, 3.1458211353e-07), 0, 554.3362,
         77.280332736, (-75.1963624, -81.4056624, 8.59623758), FILE_ORDER),
    Read("SurfaceTopography", "st/sdf-1.sdf", (4, 7), (1e-06, 1e-06), 0, 50.93, 13.602897289,
         (15.1767857, -8.65321429, -19.8732143), FILE_ORDER),
    Read("SurfaceTopography", "st/sur-2.sur", (484, 563), (3.4840002190e-06, 3.4840002190e-06), 117, 1476.0000172,
         17.517881244, (-11.9762766, 5.62372361, 7.52372363), TOP_FIRST),
    Read("SurfaceTopography", "st/bcrf-1.bcrf", (600, 960), (1.8514625e-06, 1.8514633333e-06), 0, 2223.7586975,
         24.560210668, (-1.82675403, -0.812044561, -10.0092797), TOP_FIRST),
    Read("SurfaceTopography", "st/opd-1.opd", (480, 640), (1.9673303177e-07, 1.9673303177e-07), 116, 129.15416219,
         8.3564511627, (-12.1404674, 3.32180306, 11.6415982), TOP_FIRST),
    Read("SurfaceTopography", "st/al3d-1.al3d", (296, 200), (4.38027e-07, 4.38027e-07), 0, 34950.67358,
         7688.2658434, (-4393.03852, 11722.5673, -6248.23308), TOP_FIRST),
    Read("SurfaceTopography", "st/plu-1.plu", (576, 768), (1.6600000858e-06, 1.6600000858e-06), 0, 10015.625,
         2834.3909876, (-2879.51869, -1656.86244, 4893.91881), TOP_FIRST),
    Read("surfalize", "st/x3p-2.x3p", (650, 650), (1.2765650984e-07, 3.1458211353e-07), 0, 554.3362, 77.280332736,
         (-75.1963624, -81.4056624, 8.59623758), "no"),
    Read("surfalize", "st/sdf-1.sdf", (4, 7), (1e-06, 1e-06), 0, 50.93, 13.602897289,
         (15.1767857, -8.65321429, -19.8732143), "no"),
    Read("surfalize", "st/sur-2.sur", (484, 563), (3.4840002190e-06, 3.4840002190e-06), 117, 1476.0000172,
         17.517881244, (-11.9762766, 5.62372361, 7.52372363), "turned"),
    Read("surfalize", "st/al3d-1.al3d", (296, 200), (4.38027e-07, 4.38027e-07), 0, 34950.67358, 7688.2658434,
         (-4393.03852, 11722.5673, -6248.23308), "turned"),
    Read("rsciio", "st/sur-2.sur", (484, 563), (3.4840002190e-06, 3.4840002190e-06), 117, 1476.0000172, 17.517881244,
         (-11.9762766, 5.62372361, 7.52372363), "turned"),
    Read("prysm", "st/metropro-1.dat", (480, 640), (1.0982520280e-06, 1.0982520280e-06), 0, 1363.0563293,
         75.288222047, (-74.0892971, -35.8898344, 105.270748), "turned"),
]  # fmt: skip


def places(shape):
    ny, nx = shape
    return [(ny // 7, nx // 5), (ny - 1 - ny // 9, nx // 3), (ny // 2, nx - 2)]


def name_of(read):
    return f"{read.reader} {read.file} {read.options.get('channel', '')}".strip()


@pytest.mark.parametrize("read", READ, ids=name_of)
def test_a_map_is_what_another_program_reads(corpus, read):
    found = ms.read(corpus / read.file, **read.options)

    assert found.z.shape == read.shape
    assert (found.dx, found.dy) == pytest.approx(read.steps, rel=DIGITS, abs=0.0)
    assert found.n_invalid == read.n_invalid
    assert found.peak_to_valley() == pytest.approx(read.pv * NM, rel=DIGITS, abs=0.0)
    assert found.rms() == pytest.approx(read.sq * NM, rel=DIGITS, abs=0.0)
    about_mean = found.z - np.nanmean(found.z)
    heights = [about_mean[at] for at in places(found.z.shape)]
    far = DIGITS * read.pv * NM
    assert heights == pytest.approx([h * NM for h in read.heights], rel=0.0, abs=far)


@pytest.mark.parametrize("read", READ, ids=name_of)
def test_no_mirror_image_would_pass(corpus, read):
    """The three pixels tell the map from its seven images."""
    z = ms.read(corpus / read.file, **read.options).z
    z = z - np.nanmean(z)
    wanted = np.array(read.heights) * NM
    images = [np.rot90(z, k) for k in range(4)] + [np.rot90(z.T, k) for k in range(4)]
    fits = [
        np.abs(np.array([image[at] for at in places(z.shape)]) - wanted).max()
        < 1e-3 * read.pv * NM
        for image in images
        if image.shape == z.shape
    ]

    assert fits.count(True) == 1
    assert fits[0]


# ---- the programs themselves, where they are installed: every pixel -----------------------------


def _surface_topography(path, channel):
    package = pytest.importorskip("SurfaceTopography.IO", reason="SurfaceTopography is absent")
    reader = package.open_topography(str(path))
    index = next((k for k, c in enumerate(reader.channels) if channel in (None, c.name)), 0)
    topography = reader.topography(channel_index=index)
    unit = {"m": 1.0, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9}[topography.unit]
    return np.ma.filled(topography.heights(), np.nan).T * unit


def _surfalize(path, _):
    package = pytest.importorskip("surfalize", reason="surfalize is absent")
    return np.asarray(package.Surface.load(str(path)).data, float) * 1e-6


def _rsciio(path, _):
    package = pytest.importorskip("rsciio.digitalsurf", reason="RosettaSciIO is absent")
    return np.asarray(package.file_reader(str(path))[0]["data"], float) * 1e-3


def _prysm(path, _):
    package = pytest.importorskip("prysm.io", reason="prysm is absent")
    return np.asarray(package.read_zygo_dat(str(path))["phase"], float) * 1e-9


ASK = {
    "SurfaceTopography": _surface_topography,
    "surfalize": _surfalize,
    "rsciio": _rsciio,
    "prysm": _prysm,
}


@pytest.mark.filterwarnings("ignore:The surface has different pixel size")
@pytest.mark.parametrize("read", READ, ids=name_of)
def test_every_pixel_is_that_of_a_program_that_is_installed(corpus, read):
    other = ASK[read.reader](corpus / read.file, read.options.get("channel"))
    other = other[::-1] if read.turned in (TOP_FIRST, "turned") else other

    z = ms.read(corpus / read.file, **read.options).z

    np.testing.assert_array_equal(np.isnan(z), np.isnan(other))
    np.testing.assert_allclose(
        z - np.nanmean(z), other - np.nanmean(other), rtol=0.0, atol=ROUNDING * read.pv * NM
    )
