"""What float64 cannot hold of the heights is 0 with its unit, not digits of rounding; what is small and real stays."""

import json

import numpy as np
import pytest

import metrosep as ms

SHAPE = (60, 80)
ROW, COLUMN = np.mgrid[: SHAPE[0], : SHAPE[1]]
TEXT = """metrosep = 1
[input]
files = ["part.h5"]
[[step]]
op = "form"
form = "{}"
[[step]]
op = "parameters"
names = ["all"]
"""
FLAT = {
    "constant": np.full(SHAPE, 1e-7),
    "zero": np.zeros(SHAPE),
    "plane": 3e-9 * COLUMN - 2e-9 * ROW,
    "last bits": 1e-7 * (1 + 2.3e-16 * ((ROW * COLUMN) % 3)),
}
FORM = ("residual.pv", "residual.rms", "tilt_x", "tilt_y", "c", "piston")


def evaluated(folder, command_line, z, form):
    ms.write(ms.Surface(z, 1e-6, 2e-6), folder / "part.h5")
    (folder / "r.toml").write_text(TEXT.format(form))
    done = command_line(folder, "run", "r.toml", "part.h5", "-o", "out")
    assert done.returncode == 0, done.stderr
    document = json.loads((folder / "out" / "result.json").read_text())
    return {c["metric"]: c["value"] for c in document["characteristics"]}, done


@pytest.mark.parametrize("form", ["plane", "sphere"])
@pytest.mark.parametrize("kind", FLAT)
def test_what_a_form_describes_exactly_leaves_zero(tmp_path, command_line, kind, form):
    found, done = evaluated(tmp_path, command_line, FLAT[kind], form)

    # Smrk2 of a map of one height is 1; a plane itself has its inclination
    digits = {k: v for k, v in found.items() if v and abs(v) < 1e-12}
    assert digits == {}
    for name in ("PV", "RMS", "Sq", "Sz", "residual.pv", "residual.rms"):
        assert found[name] == 0.0
        assert f"{name}: 0 m" in done.stderr.splitlines() + done.stdout.splitlines() or "." in name
    assert "Ssk" not in found  # of equal heights: not available


def test_a_symmetric_map_has_no_skewness_and_a_level_one_no_tilt(tmp_path, command_line):
    z = 5e-9 * np.sin(2 * np.pi * (COLUMN + 0.5) / 20) + 0.0 * ROW
    found, _ = evaluated(tmp_path, command_line, z, "plane")

    assert found["Ssk"] == 0.0
    assert found["tilt_y"] == 0.0
    assert abs(found["tilt_x"]) > 1e-6  # whole waves of a sine have an inclination


@pytest.mark.parametrize("size", [1e-15, 1e-18])
def test_what_is_small_and_real_stays(tmp_path, command_line, size):
    """A femtometre on heights of some nm is a hundred million times what a float of them loses."""
    noise = size * np.random.default_rng(4).standard_normal(SHAPE)
    z = 3e-11 * COLUMN - 2e-11 * ROW + noise
    found, _ = evaluated(tmp_path, command_line, z, "plane")

    assert found["Sq"] == pytest.approx(size, abs=0.05 * size)
    assert found["Ssk"] != 0.0


def test_a_sphere_that_is_held_leaves_its_sag_of_a_map_of_zeros(tmp_path, command_line):
    """R = 1 m over 79 by 118 um: the sag from centre to corner in closed form, of heights that are all 0."""
    held = 'sphere: R=1 m"\nfree = ["piston", "tilt_x", "tilt_y"] #'
    found, _ = evaluated(tmp_path, command_line, FLAT["zero"], held)

    across = np.hypot(39.5e-6, 59e-6)
    least = np.hypot(0.5e-6, 1e-6)  # of the four pixels about the middle
    sag = (across**2 - least**2) / 2.0
    assert found["residual.pv"] == pytest.approx(
        sag, abs=1e-6 * sag
    )  # beyond the parabola: r^2 / 4
    assert found["PV"] == pytest.approx(sag, abs=1e-6 * sag)
