"""Sections that count pixels: heights are known, lengths along them are not."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.compensation import CompensationTable
from metrosep.filters import gaussian, opening, resample, roughness
from metrosep.forms.fit import fit
from metrosep.parameters import profile_parameters
from metrosep.spectral import masked_psd, profile_psd

FM = 1e-15
"""m: rounding of heights of a micrometre."""
WHY = "x of the profile counts pixels.*; give the map its lateral_step"
STEP = 2.5e-6
"""m."""


def waves():
    column = np.arange(161.0)
    return np.broadcast_to(1e-6 * np.sin(2 * np.pi * column / 20) + 3e-9 * column, (5, 161))


@pytest.fixture
def line():
    return ms.Surface(waves()).section(("0 px", "2 px"), ("160 px", "2 px"))


@pytest.fixture
def scaled():
    return ms.Surface(waves(), STEP, STEP).section(("0 px", "2 px"), ("160 px", "2 px"))


def test_the_profile_states_its_unit(line, scaled):
    assert (line.lateral_unit, scaled.lateral_unit) == ("px", "m")
    assert repr(line).startswith("Profile(161 samples, 160 px, step 1 px, ")
    assert "<td>160 px</td>" in line._repr_html_()
    assert scaled.dx == pytest.approx(STEP, abs=FM)
    ring = ms.Surface(np.zeros((41, 41))).circle_section(("20 px", "20 px"), "9 px")
    for kept in (-line, line - 1e-9, line.remove_line(), ring):
        assert kept.lateral_unit == "px"


USES = {
    "step": lambda p: p.dx,
    "crop": lambda p: p.crop("0.1 mm", "0.2 mm"),
    "gaussian": lambda p: gaussian(p, cutoff="80 um"),
    "opening": lambda p: opening(p, radius="3 um"),
    "roughness": lambda p: roughness(p, lambda_c="80 um"),
    "resample": lambda p: resample(p, step="1 um"),
    "psd": profile_psd,
    "masked psd": masked_psd,
    "fit": lambda p: fit(p, "polynomial: degree=2"),
    "runs": lambda p: ms.RunSet([p]),
    "table": lambda p: CompensationTable.from_error(p, axis="X", positions=5),
}


@pytest.mark.parametrize("use", USES)
def test_what_needs_a_length_is_refused(use, line, scaled):
    USES[use](scaled)
    with pytest.raises(ms.errors.DataError, match=WHY):
        USES[use](line)


def test_heights_are_those_of_the_scaled_profile_and_lengths_are_refused(line, scaled):
    found, known = (profile_parameters(p, kind="P") for p in (line, scaled))
    lateral = {
        "Psm",
        "Pdq",
        "Pda",
        "Pdt",
        "Pdl",
        "Pdr",
        "Psal",
        "Psw",
        "Ppd",
        "Pvd",
        "Pmpc",
        "Pmvc",
    }
    assert set(found.unavailable) - set(known.unavailable) == lateral
    assert all("counts pixels" in found.unavailable[s] for s in lateral)
    for symbol in found:
        assert found[symbol].value == pytest.approx(known[symbol].value, abs=FM), symbol
    assert found.context.settings["dx_px"] == 1.0
    assert "dx_m" not in found.context.settings


def test_only_our_own_file_holds_it(line, tmp_path, capsys):
    for name in ("line.csv", "line.x3p"):
        with pytest.raises(ms.errors.WriteError, match="x of the profile counts pixels"):
            ms.write(line, tmp_path / name)
        assert not (tmp_path / name).exists()
    ms.write(line, tmp_path / "line.h5")
    assert ms.read(tmp_path / "line.h5").lateral_unit == "px"
    with pytest.raises(SystemExit):
        main(["info", str(tmp_path / "line.h5")])
    assert "  step      not calibrated, x counts pixels\n" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["measure", str(tmp_path / "line.h5"), "--lambda-c", "0.8 mm"])
    assert "counts pixels" in capsys.readouterr().err
