"""metrosep verify-softgauge on a map in SDF, with the values of its publisher."""

import numpy as np

import metrosep as ms


def test_an_areal_gauge_in_sdf_at_the_command_line(metrosep, tmp_path):
    file = tmp_path / "gauge.sdf"
    c = np.cos(2 * np.pi * (np.arange(400) + 0.5) / 40)
    ms.write(ms.Surface(50e-9 * c[:, None] * c, 1e-6, 1e-6), file)
    words = ("--expect", "Sq=25.0 nm", "--expect", "Sz=99.4 nm", "--expect", "Sku=2.25")
    code, out, _ = metrosep("verify-softgauge", file, *words)
    assert (code, "3 of 3 agree" in out) == (0, True), out
    code, out, _ = metrosep("verify-softgauge", file, "--expect", "Sq=25.2 nm")
    assert (code, "differs" in out) == (1, True)
