"""Symbols of ISO 21920-2:2021 and ISO 25178-2:2021 on signals whose values have closed forms.

Expected numbers without a formula beside them were worked out by a program of its own (numpy only).
"""

import math

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.core.errors import DataError
from metrosep.parameters import areal_parameters, profile_parameters

UM = 1e-6
DIGITS = 1e-6
"""Relative: the digits of the references."""
CURVE = 2e-5
"""Relative: 20 000 samples stand half a sample off the continuous curve."""
KNEE = 0.02
"""Relative: two lines through a sampled curve (the page states 2 %)."""


def profile(z, dx=UM, **options):
    return profile_parameters(Profile(np.arange(len(z)) * dx, np.asarray(z)), kind="R", **options)


def values(table, unit=1.0):
    return {symbol: q.value / unit for symbol, q in table.items()}


def two_processes(n=20_000):
    """Heights that fall on two lines against the normal deviate, meeting at s = -1."""
    from scipy.special import erfinv

    s = math.sqrt(2) * erfinv(1 - 2 * (np.arange(n) + 0.5) / n)
    z = np.minimum(0.2 * s, 1.3 * s + 1.1) * UM
    return np.random.default_rng(0).permutation(z)


# ---- profiles ------------------------------------------------------------------------------------


def test_peaks_of_sections_and_of_the_evaluation_length():
    """A spike between two sections: the sliding window sees it whole, the sections do not."""
    i = np.arange(4000)
    z = np.sin(2 * np.pi * i / 160) + 0.3 * np.sin(2 * np.pi * i / 47 + 1)
    z += 0.1 * np.cos(2 * np.pi * i / 11)
    z[1590] += 4.0
    z[1612] -= 3.0
    names = ["Rp", "Rv", "Rpt", "Rvt", "Rzx", "Rsm", "Rc"]

    found = values(profile(z * UM, 0.5 * UM, names=names), UM)

    assert found == pytest.approx(
        {
            "Rp": 1.79365095, "Rv": 1.60082869, "Rpt": 3.50054053, "Rvt": 2.56193776,
            "Rzx": 6.06247830, "Rsm": 73.7816334, "Rc": 2.61031714,
        },
        rel=DIGITS, abs=0.0,
    )  # fmt: skip


def test_probability_and_volumes_of_two_processes():
    names = ["Rpq", "Rvq", "Rmq", "Rvmp", "Rvmc", "Rvvc", "Rvvv", "Rdc(20 %, 80 %)", "Rmr(-1 um)"]
    found = values(profile(two_processes(), names=names))

    assert found["Rpq"] == pytest.approx(0.2 * UM, rel=KNEE, abs=0.0)
    assert found["Rvq"] == pytest.approx(1.3 * UM, rel=KNEE, abs=0.0)
    assert found["Rmq"] == pytest.approx(0.84134475, abs=5e-3)
    volumes = [found[s] / UM for s in ("Rvmp", "Rvmc", "Rvvc", "Rvvv")]
    expected = [9.46788e-3, 0.181183147, 0.243451416, 0.113969648]
    assert volumes == pytest.approx(expected, rel=CURVE, abs=0.0)
    assert found["Rdc(20 %, 80 %)"] == pytest.approx(0.336648495 * UM, rel=CURVE, abs=0.0)
    assert found["Rmr(-1 um)"] == pytest.approx(0.9469, abs=1e-12)


def test_probability_of_a_valley_process_that_cuts_a_plateau():
    """What a honed bore is: the lower of two independent Gaussian surfaces."""
    rng = np.random.default_rng(1)
    z = np.minimum(0.2 * rng.standard_normal(200_000), 1.3 * rng.standard_normal(200_000) + 1.1)

    found = values(profile(z * UM, names=["Rpq", "Rvq"]), UM)

    # The knee is round: the tenth next to it is left out, the plateau still reads some valleys.
    assert found == pytest.approx({"Rpq": 0.2, "Rvq": 1.3}, rel=0.12, abs=0.0)


def test_one_process_has_no_knee():
    z = np.random.default_rng(2).standard_normal(20_000) * UM

    table = profile(z, names=["Rpq", "Rmq"])

    assert set(table.unavailable) == {"Rpq", "Rmq"}
    assert "one process only" in table.unavailable["Rpq"]
    upside_down = profile(-two_processes(), names=["Rpq"])
    assert "one process only" in upside_down.unavailable["Rpq"]


def test_gradients_and_developed_length_of_a_sine():
    a, wave = 0.4 * UM, 50 * UM
    z = a * np.sin(2 * np.pi * np.arange(20_000) * 0.1 * UM / wave)

    found = values(profile(z, 0.1 * UM, names=["Rdq", "Rda", "Rdt", "Rdl", "Rdr"]))

    stencil = 2e-4
    assert found["Rdq"] == pytest.approx(2 * np.pi * a / wave / math.sqrt(2), rel=stencil, abs=0.0)
    assert found["Rda"] == pytest.approx(4 * a / wave, rel=stencil, abs=0.0)
    assert found["Rdt"] == pytest.approx(2 * np.pi * a / wave, rel=stencil, abs=0.0)
    assert found["Rdr"] == pytest.approx(6.31315895e-4, rel=DIGITS, abs=0.0)  # of the polygon
    assert found["Rdl"] == pytest.approx(
        19_999 * 0.1 * UM * (1 + found["Rdr"]), rel=1e-12, abs=0.0
    )


def test_autocorrelation_length_and_dominant_wavelength():
    x = np.arange(8000)
    z = np.cos(2 * np.pi * x / 100 + 0.3) + 0.5 * np.cos(2 * np.pi * x / 37 + 0.3)
    # (cos(2 pi t / 100) + 0.25 cos(2 pi t / 37)) / 1.25 = 0.2 at t = 16.8462
    found = profile(z * 1e-7, names=["Rsal"])["Rsal"].value
    assert found == pytest.approx(16.8462 * UM, rel=2e-3, abs=0.0)

    i = np.arange(4000)
    waves = 60e-9 * np.cos(2 * np.pi * i / 125) + 30e-9 * np.cos(2 * np.pi * i / 40)
    assert profile(waves, names=["Rsw"])["Rsw"].value == pytest.approx(
        125 * UM, rel=1e-12, abs=0.0
    )


def test_feature_parameters_count_the_crests_of_two_waves():
    """20 crests of 3 um on a slow wave of 1 um, and ripples of 40 nm that pruning takes away."""
    i = np.arange(4000)
    z = 1.5 * np.cos(2 * np.pi * (i - 100) / 200) + 0.5 * np.cos(2 * np.pi * (i - 100) / 4000)
    z += 0.02 * np.cos(2 * np.pi * (i - 100) / 20)

    found = values(profile(z * UM, names=["Rpd", "Rvd", "R5p", "R5v", "Rmpc", "Rmvc"]))

    assert found["Rpd"] * 4000 * UM == pytest.approx(20.0, abs=1e-9)
    # The troughs at both ends count: ripples put their lowest sample inside.
    assert found["Rvd"] * 4000 * UM == pytest.approx(21.0, abs=1e-9)
    crests = z[100::200]
    assert found["R5p"] == pytest.approx(np.sort(crests)[-5:].mean() * UM, rel=1e-12, abs=0.0)
    bend = UM * (1.5 * (2 * np.pi / 200) ** 2 + 0.02 * (2 * np.pi / 20) ** 2) / UM**2
    assert found["Rmpc"] == pytest.approx(bend, rel=1e-3, abs=0.0)
    assert found["Rmvc"] < found["Rmpc"]  # ripples make the crests sharper and the troughs wider


def test_portions_of_sections():
    i = np.arange(4000)
    z = UM * np.sin(2 * np.pi * i / 100) * (1 + 0.3 * np.sin(2 * np.pi * i / 1370))
    names = ["RzJIS", "R3z", "Rz"]
    expected = {"RzJIS": 2.23983342, "R3z": 2.27035113, "Rz": 2.53032875}
    assert values(profile(z, names=names), UM) == pytest.approx(expected, rel=DIGITS, abs=0.0)

    few = profile(z, names=names, sections=40)  # one wave in each
    assert "a section holds" in few.unavailable["R3z"]
    assert "5 are needed" in few.unavailable["RzJIS"]


def test_hills_below_a_tenth_of_rz_are_no_hills_of_jis():
    i = np.arange(1000)
    z = np.sin(2 * np.pi * i / 100)
    low = np.where((i // 100) % 2 == 1, 0.05 * z, z)  # each second wave is 5 % high

    table = profile(low * UM, names=["RzJIS"], sections=1)

    assert table["RzJIS"].value == pytest.approx(2 * UM, rel=1e-12, abs=0.0)
    assert "a section holds 5 hills" not in str(dict(table.unavailable))


def test_asme_names_print_those_of_iso():
    i = np.arange(4000)
    z = UM * np.sin(2 * np.pi * i / 100) * (1 + 0.3 * np.sin(2 * np.pi * i / 1370))
    names = ["Ra", "Rpm", "Rp", "Rmax", "Rtm", "tp(0.5 um)"]

    asme = profile(z, names=names, edition="ASME B46.1")
    iso = profile(z, names=["Ra", "Rp", "Rpt", "Rz", "Rmr(0.5 um)"])
    old = profile(z, names=["Rz1max"], edition="ISO 4287:1997")

    pairs = {"Ra": "Ra", "Rpm": "Rp", "Rp": "Rpt", "Rtm": "Rz", "tp(0.5 um)": "Rmr(0.5 um)"}
    for one, other in pairs.items():
        assert asme[one].value == iso[other].value
    assert asme["Rmax"].value == old["Rz1max"].value
    assert "p of ISO" in asme["Rpm"].definition
    assert asme.context.edition == "ASME B46.1"


# ---- names with arguments --------------------------------------------------------------------------


def test_arguments_are_found_in_any_spelling():
    table = profile(two_processes(), names=["Rmr( 0.2um )", "Rmr(0 %, 500 nm)", "Rcm(0.1)"])

    assert list(table) == ["Rmr(200 nm)", "Rmr(0 %, 500 nm)", "Rcm(10 %)"]
    assert table["Rmr(0.2 um)"] is table["Rmr(200 nm)"]
    assert table["Rcm(10%)"].value <= 0.0  # from the highest peak
    z = two_processes()
    assert table["Rmr(0.2 um)"].value == np.mean(z >= 0.2 * UM)
    assert table["Rmr(0 %, 500 nm)"].value == np.mean(z >= z.max() - 0.5 * UM)
    assert list(profile(z, names=["Rmr(0, 0.5 um)", "Rmr(5 %,1 um)"])) == [
        "Rmr(0 %, 500 nm)",
        "Rmr(5 %, 1 um)",
    ]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Rmc(20 %)", r"the height at a ratio is Rcm"),
        ("Rmr(3)", r"3 needs a unit"),
        ("Rmr(0,5 um)", r"comma; write Rmr\(0.5 um\), or Rmr\(0 %, 5 um\) for two arguments$"),
        ("Rmr(1,25um)", r"write Rmr\(1.25um\), or Rmr\(100 %, 25um\) for"),
        ("Rmc(5,1e-1 µm)", r"write Rmc\(5.1e-1 µm\)$"),
        ("Rmr(0.5)", r"a length needs its unit"),
        ("Rmr(120 %, 1 um)", r"between 0 % and 100 %"),
        ("Rmr(1 kg)", r"Rmr\(1 kg\)"),
        ("Rdd(20 %, 80 %)", r"nearest: Rdc"),
        ("Rdc(20 %)", r"written as Rdc\(20 %, 20 %\)"),
        ("Rdc(20 %, 80 %", r"not a symbol with arguments"),
        ("Rsx", r"nearest: Rzx"),
    ],
)
def test_what_cannot_be_meant_is_refused(name, message):
    with pytest.raises(DataError, match=message):
        profile(two_processes(), names=[name])


# ---- maps ------------------------------------------------------------------------------------------


def crossed_cosines():
    c = np.cos(2 * np.pi * (np.arange(400) - 9.5) / 40)
    return Surface(100e-9 * c[:, None] * c, UM, UM)


def test_hills_and_dales_of_crossed_cosines():
    """Squares of 20 x 20 pixels, up and down in turn; those at the border are open."""
    names = ["Spd", "Svd", "Sha", "Sda", "Shv", "Sdv", "Spc", "Svc"]
    found = values(areal_parameters(crossed_cosines(), names=names))

    assert found["Spd"] == found["Svd"] == pytest.approx(1.25e9, rel=1e-12, abs=0.0)
    assert found["Sha"] == pytest.approx(400e-12, rel=1e-12, abs=0.0)
    assert found["Sda"] == pytest.approx(400e-12, rel=1e-12, abs=0.0)
    volume = 0.1 / math.sin(math.pi / 40) ** 2 * 1e-18  # sum of cosines over a square
    assert found["Shv"] == pytest.approx(volume, rel=1e-9, abs=0.0)
    assert found["Sdv"] == pytest.approx(volume, rel=1e-9, abs=0.0)
    assert found["Spc"] == pytest.approx(2427.088, rel=DIGITS, abs=0.0)
    assert found["Svc"] == pytest.approx(2427.088, rel=DIGITS, abs=0.0)
    wide = areal_parameters(crossed_cosines(), names=["Spc"], curvature_window=5)
    assert wide["Spc"].value == pytest.approx(2370.419, rel=DIGITS, abs=0.0)
    assert wide.context.settings["curvature_window"] == 5


def test_hills_at_a_ratio_and_not_dales():
    """One tall cone and one low one: at 1 % only the tall one is left, and the floor is one dale."""
    y, x = np.mgrid[0:200, 0:300].astype(float)
    cones = [(100, 80, 30.0), (100, 210, 10.0)]
    z = np.max([np.maximum(h - np.hypot(y - b, x - a), 0.0) for b, a, h in cones], axis=0)
    table = areal_parameters(Surface(z * UM, UM, UM), names=["Sha(1 %)", "Shv(1 %)", "Spd"])

    cut = areal_parameters(Surface(z * UM, UM, UM), names=["Smc(1 %)"])["Smc(1 %)"].value / UM
    level = cut + z.mean()
    inside = z >= level
    assert table["Spd"].value * 60_000e-12 == pytest.approx(2.0, abs=1e-9)
    assert inside[:, 200:].sum() == 0
    assert table["Sha(1 %)"].value == pytest.approx(inside.sum() * 1e-12, rel=1e-9, abs=0.0)
    assert table["Shv(1 %)"].value == pytest.approx(
        (z - level)[inside].sum() * 1e-18, rel=1e-6, abs=0.0
    )


def test_pruned_ripples_belong_to_their_hill():
    """Ripples of 1 % of Sz on the cosines change neither the number of hills nor their area much."""
    plain = crossed_cosines()
    ripple = 1e-9 * np.cos(2 * np.pi * np.arange(400) / 5)
    rippled = Surface(plain.z + ripple, UM, UM)

    one, other = (areal_parameters(s, names=["Spd", "Sha", "Shv"]) for s in (plain, rippled))

    assert other["Spd"].value == pytest.approx(one["Spd"].value, rel=1e-12, abs=0.0)
    assert other["Sha"].value == pytest.approx(one["Sha"].value, rel=0.02, abs=0.0)
    assert other["Shv"].value == pytest.approx(one["Shv"].value, rel=0.02, abs=0.0)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2])
def test_dropouts_leave_hills_and_dales(share):
    i, j = np.meshgrid(np.arange(300), np.arange(300))
    z = 50e-9 * np.cos(2 * np.pi * (i - 9) / 36) + 40e-9 * np.cos(2 * np.pi * (j - 9) / 36)
    lost = np.random.default_rng(3).random(z.shape) < share
    names = ["S5p", "Sha", "Shv"]

    whole = areal_parameters(Surface(z, UM, UM), names=names)
    table = areal_parameters(Surface(np.where(lost, np.nan, z), UM, UM), names=names)

    assert table["S5p"].value == pytest.approx(87.5581420e-9, rel=5e-3, abs=0.0)
    assert table["Sha"].value == pytest.approx(whole["Sha"].value, rel=0.01, abs=0.0)
    assert table["Shv"].value == pytest.approx(whole["Shv"].value, rel=0.02, abs=0.0)
    assert any("were filled to find peaks" in note for note in table.context.notes)


def test_core_volumes_and_heights_of_a_five_part_curve():
    m = (np.arange(250_000) + 0.5) / 250_000
    z = np.interp(m, [0, 0.12, 0.75, 1], [4, 1.5, -0.39, -3.39]) * UM
    z = np.random.default_rng(0).permutation(z).reshape(500, 500)
    names = ["Sk", "Smrk1", "Smrk2", "Sak1", "Sak2", "Spk", "Svk", "Spkx", "Svkx"]
    calls = ["Sdc(5 %, 90 %)", "Vm(10 %)", "Vv(80 %)"]

    found = areal_parameters(Surface(z, UM, UM), names=[*names, *calls])

    expected = [3.0, 0.10272e6, 0.8125e6, 0.1099104, 0.2109375, 2.14, 2.25, 2.14, 2.25]
    assert [found[s].value / UM for s in names] == pytest.approx(expected, rel=CURVE, abs=0.0)
    expected = [5.14833333, 0.10416667, 0.24]
    assert [found[s].value / UM for s in calls] == pytest.approx(expected, rel=CURVE, abs=0.0)


def test_dominant_wavelength_of_a_slanting_wave():
    i, j = np.meshgrid(np.arange(480), np.arange(480))
    z = 50e-9 * np.cos(2 * np.pi * (3 * i + 4 * j) / 160) + 20e-9 * np.cos(2 * np.pi * i / 60)

    found = areal_parameters(Surface(z, UM, UM), names=["Ssw"])
    stretched = areal_parameters(Surface(z, 2 * UM, UM), names=["Ssw"])

    assert found["Ssw"].value == pytest.approx(32 * UM, rel=1e-12, abs=0.0)  # 160 / hypot(3, 4)
    assert stretched["Ssw"].value == pytest.approx(
        160 * UM / math.hypot(1.5, 4), rel=1e-12, abs=0.0
    )
