"""Printed results of a real SurfTest export (acceptance rows M01 to M08).

R profile, 6664 samples, 4 sections, "ISO 1997". The workbook prints 23 results. Not tested here,
because the file does not say their settings: Rmr 0.030 %, Rdc 1.828 um, and the baseline of A1, A2.
"""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError
from metrosep.filters._arguments import DoubleFilterError
from metrosep.parameters.material_ratio import abbott_curve
from metrosep.parameters.profile import profile_parameters

UM = 1e-6
LAST_DIGIT = 0.5000001  # of the last printed digit, and rounding of that half
SAMPLE = 1.0 / 6664  # one sample of the material ratio
STEP = 1e-12  # relative; the mean step of a cropped profile differs in its last bit
RK = 1e-2  # relative; the 40 % secant of the instrument is not known better (M08)


@pytest.fixture(scope="module")
def profile(corpus):
    return ms.read(corpus / "st" / "mitutoyo_2_mock.xlsx")


@pytest.fixture(scope="module")
def printed(profile):
    """Symbol to value as printed and weight of its last digit, in the printed unit."""
    found = {}
    for text in profile.metadata["header"]["results"]:
        symbol, number = text.split()[:2]
        found[symbol] = (float(number), 10.0 ** -len(number.split(".")[1]))
    return found


@pytest.fixture(scope="module")
def table(profile):
    return profile_parameters(
        profile, kind="R", edition="ISO 4287:1997", sections=4, line="secant"
    )


@pytest.mark.parametrize(
    ("symbol", "label", "unit"),
    [
        ("Ra", "Ra", UM),
        ("Rq", "Rq", UM),
        ("Rz", "Rz", UM),
        ("Rp", "Rp", UM),
        ("Rv", "Rv", UM),
        ("Rsk", "Rsk", 1.0),
        ("Rku", "Rkµ", 1.0),
        ("Rc", "Rc", UM),
        ("RSm", "RSm", UM),
        ("RDq", "RDq", 1.0),
        ("Rt", "Rt", UM),
        ("Rz1max", "Rz1max", UM),
    ],
)
def test_printed_value_to_its_last_digit(table, printed, symbol, label, unit):
    value, digit = printed[label]

    assert table[symbol].value / unit == pytest.approx(value, abs=LAST_DIGIT * digit)


def test_core_height_by_secant(table, printed):
    assert table["Rk"].value / UM == pytest.approx(printed["Rk"][0], rel=RK, abs=0.0)


def test_core_height_by_least_squares_is_another_number(profile, printed):
    table = profile_parameters(
        profile, kind="R", edition="ISO 4287:1997", sections=4, names=["Rk"]
    )

    assert table["Rk"].value / UM < 0.94 * printed["Rk"][0]  # 7 % apart: line must be stated


@pytest.mark.parametrize(
    ("label", "percent_of_rt"), [("Rmr(c)1", 90), ("Rmr(c)2", 85), ("Mr1", 85), ("Mr2", 34)]
)
def test_ratios_are_rows_of_the_abbott_table(profile, printed, label, percent_of_rt):
    curve = abbott_curve(profile.z)
    level = float(curve.heights[-1]) + percent_of_rt / 100 * curve.total_height

    assert 100 * curve.ratio(level) == pytest.approx(printed[label][0], abs=100 * SAMPLE)


def test_printed_mr1_and_mr2_lie_beside_our_core(table, profile, printed):
    curve = abbott_curve(profile.z)
    step = curve.total_height / 100  # the instrument snaps to 1 % of Rt
    for symbol in ("Mr1", "Mr2"):
        ours = table[symbol].value
        height = curve.height(ours)
        reach = [100 * curve.ratio(height + k * step) for k in (-2, 2)]
        assert min(reach) <= printed[symbol][0] <= max(reach)


def test_printed_reduced_heights_follow_from_printed_areas(printed):
    """Rpk = 2 A1 / Mr1, Rvk = 2 A2 / (100 - Mr2), A in um %: the triangle rule of core_height."""
    area_digit = 0.5 * printed["A1"][1]
    rpk = 2 * printed["A1"][0] / printed["Mr1"][0]
    rvk = 2 * printed["A2"][0] / (100 - printed["Mr2"][0])

    assert rpk == pytest.approx(printed["Rpk"][0], abs=2 * area_digit / printed["Mr1"][0] + 0.0005)
    assert rvk == pytest.approx(
        printed["Rvk"][0], abs=2 * area_digit / (100 - printed["Mr2"][0]) + 0.0005
    )


def test_same_file_other_edition_other_number(profile):
    new = profile_parameters(profile, kind="R", sections=4)

    # 375.8 um were pairs of one direction and 10 % of Rz (texture-and-form.md, 1.1)
    assert new["RSm"].value / UM == pytest.approx(311.470, abs=0.001)  # counted, see test_profile
    assert new["Rsk"].value == pytest.approx(-0.183, abs=5e-4)
    assert new["Rz"].value / UM == pytest.approx(18.485, abs=6e-4)


def test_centring_is_another_number(profile):
    old = profile_parameters(profile, kind="R", edition="ISO 4287:1997", sections=4, centre=True)
    new = profile_parameters(profile, kind="R", sections=5, centre=True)

    assert old["Ra"].value / UM == pytest.approx(3.3030, abs=5e-5)
    assert old["Rq"].value / UM == pytest.approx(3.9578, abs=5e-5)
    assert old["Rp"].value / UM == pytest.approx(8.302, abs=5e-4)
    assert old["Rsk"].value == pytest.approx(-0.097, abs=5e-4)
    assert new["Ra"].value / UM == pytest.approx(3.3059, abs=5e-5)  # surfalize, Gwyddion
    assert new["Rq"].value / UM == pytest.approx(3.9689, abs=5e-5)
    assert new["Rsk"].value == pytest.approx(-0.1397, abs=5e-5)
    assert new["Rku"].value == pytest.approx(2.651, abs=2e-3)
    assert new["Rz"].value / UM == pytest.approx(17.994, abs=5e-4)


def test_file_declares_r_and_p_is_refused(profile):
    with pytest.raises(DoubleFilterError, match='kind="R"'):
        profile_parameters(profile)
    with pytest.raises(DataError, match="declared R"):
        profile_parameters(profile, kind="W")


def test_no_note_on_the_kind_but_on_what_came_before(table):
    assert not any("Nobody" in note for note in table.context.notes)
    assert any("before" in note for note in table.context.notes)


def test_missing_ends_are_cropped_ends(profile):
    z = np.array(profile.z)
    z[:500] = z[-64:] = np.nan
    holed = ms.Profile(profile.x, z)
    cropped = ms.Profile(profile.x[500:-64], profile.z[500:-64])

    for edition in ("ISO 4287:1997", "ISO 21920-2:2021"):
        one = profile_parameters(holed, kind="R", edition=edition)
        other = profile_parameters(cropped, kind="R", edition=edition)
        assert list(one) == list(other)
        for symbol in one:
            assert one[symbol].value == pytest.approx(other[symbol].value, rel=STEP, abs=0.0)
