"""How many sections of one cut-off a real length holds, and what is said where they do not fit."""

import numpy as np
import pytest

from metrosep import Profile, read
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.filters._arguments import SHORTFALL
from metrosep.filters.chain import roughness
from metrosep.parameters.profile import profile_parameters
from metrosep.parameters.sections import sections_in, sections_that_fit

UM, MM = 1e-6, 1e-3
SAME = 1e-9  # relative; lengths of whole samples
STANDARD = [  # lambda_c, lambda_s, step of ISO 21920-3
    (0.08 * MM, 2.5 * UM, 0.5 * UM),
    (0.25 * MM, 2.5 * UM, 0.5 * UM),
    (0.8 * MM, 2.5 * UM, 0.5 * UM),
    (2.5 * MM, 8 * UM, 1.5 * UM),
    (8 * MM, 25 * UM, 5 * UM),
]


def flat(n, dx, **metadata):
    wave = 0.1 * UM * np.cos(2 * np.pi * np.arange(n) / 40)
    return Profile(np.arange(n) * dx, wave, metadata={"profile_kind": "R", **metadata})


@pytest.mark.parametrize(
    ("n", "dx", "cutoff", "sections"),
    [
        (6664, 1.5 * UM, 2.5 * MM, 4),  # 4 x 1666 samples, the instrument prints N 4
        (7999, 0.5 * UM, 0.8 * MM, 5),
        (7990, 0.5 * UM, 0.8 * MM, 5),  # 5.6 mm less run-in, run-out and two lambda_s
        (8000, 0.5 * UM, 0.8 * MM, 5),
        (8001, 0.5 * UM, 0.8 * MM, 5),
        (3330, 1.5 * UM, 2.5 * MM, 2),  # was one section of 4.995 mm
        (7800, 0.5 * UM, 0.8 * MM, 4),  # an eighth of a section short
        (9400, 0.5 * UM, 0.8 * MM, 5),
        (40, 0.5 * UM, 0.8 * MM, 1),
    ],
)
def test_count_of_real_lengths(n, dx, cutoff, sections):
    assert sections_that_fit(flat(n, dx), cutoff) == sections


@pytest.mark.parametrize("dx", [0.5 * UM, 0.3 * UM, 1.0 / 3.0 * UM])
@pytest.mark.parametrize("sections", [1, 2, 5, 16])
def test_limit_of_the_shortfall(dx, sections):
    cutoff = 3000 * dx
    assert sections_that_fit(flat(3000 * sections - 300, dx), cutoff) == sections
    assert sections_that_fit(flat(3000 * sections - 301, dx), cutoff) == max(1, sections - 1)


def test_length_of_a_section_stays_near_the_cutoff():
    """Brute force: of all n, the largest whose last section lacks no more than a tenth."""
    for length in np.linspace(0.31, 12.3, 997):
        n = sections_in(length * MM, MM)
        fitting = [k for k in range(1, 20) if length >= k - SHORTFALL]
        assert n == max(fitting, default=1)
        if length >= 1 - SHORTFALL:
            assert 1 - SHORTFALL / n <= length / n + SAME
            assert length / n < 1 + (1 - SHORTFALL) / n


@pytest.mark.parametrize(("lambda_c", "lambda_s", "dx"), STANDARD)
def test_seven_cutoffs_less_filter_ends_are_five_sections(lambda_c, lambda_s, dx):
    n = round(7 * lambda_c / dx)
    measured = Profile(np.arange(n) * dx, 0.1 * UM * np.cos(2 * np.pi * np.arange(n) / 40))
    rough = roughness(measured, lambda_c=lambda_c, lambda_s=lambda_s, end="cut")

    table = profile_parameters(rough, kind="R", sections=sections_that_fit(rough, lambda_c))

    assert len(rough) * dx < 5 * lambda_c  # lambda_s took samples at both ends
    assert table.context.settings["sections"] == 5
    length = table.context.settings["section_length_m"]
    assert length == pytest.approx(len(rough) * dx / 5, rel=SAME, abs=0.0)
    assert length == pytest.approx(lambda_c, rel=SHORTFALL / 5, abs=0.0)
    assert not any("pass sections" in note for note in table.context.notes) or lambda_c < 0.1 * MM


def test_printed_rz_and_rsm_of_an_export_follow_from_its_cutoff(corpus):
    profile = read(corpus / "st" / "mitutoyo_2_mock.xlsx")
    n = sections_that_fit(profile, 2.5 * MM)

    table = profile_parameters(profile, kind="R", edition="ISO 4287:1997", sections=n)

    assert table["Rz"].value / UM == pytest.approx(18.485, abs=0.5000001e-3)  # printed
    assert table["RSm"].value / UM == pytest.approx(419.9, abs=0.05)  # printed


def test_missing_ends_are_not_counted():
    profile = flat(8000, 0.5 * UM)
    z = np.array(profile.z)
    z[:1600], z[-1600:] = np.nan, np.nan
    assert sections_that_fit(Profile(profile.x, z), 0.8 * MM) == 3
    z[4000:4100] = np.nan
    assert sections_that_fit(Profile(profile.x, z), 0.8 * MM) == 3


def notes_on_length(profile, sections):
    notes = profile_parameters(profile, kind="R", sections=sections).context.notes
    return [n for n in notes if n.startswith(("Sections are", "Used are"))]


def test_asked_number_is_honoured_and_its_length_stated():
    (note,) = notes_on_length(flat(7990, 0.5 * UM, lambda_c_m=0.8 * MM), 5)
    assert "799 um" in note
    assert "800 um" in note
    assert "pass" not in note
    assert notes_on_length(flat(8000, 0.5 * UM, lambda_c_m=0.8 * MM), 5) == []
    assert notes_on_length(flat(8001, 0.5 * UM, lambda_c_m=0.8 * MM), 5) == []  # half a sample


@pytest.mark.parametrize(
    ("n", "used", "said", "unsaid"),
    [
        (7990, 4, ["998.8 um", "1.25 times", "pass sections=5"], ["crop", "roughness"]),
        (2800, 1, ["1.75 times", "crop the profile to 800 um", "sections=1"], []),
        (7200, 4, ["1.12 times", "crop the profile to 3.2 mm", "roughness(..., sections=4)"], []),
        (1000, 1, ["0.625 times", "short of one", "measure longer"], ["pass", "crop"]),
        (3060, 2, ["0.956 times", "short of 2", "measure longer"], ["pass", "crop"]),
        (3060, 1, ["1.91 times", "pass sections=2, or measure longer"], ["crop"]),
    ],
)
def test_note_names_a_way_out_that_is_not_the_present_one(n, used, said, unsaid):
    (note,) = notes_on_length(flat(n, 0.5 * UM, lambda_c_m=0.8 * MM), used)
    assert all(word in note for word in said), note
    assert not any(word in note for word in unsaid), note


@pytest.mark.parametrize("cutoff", [0.0, -1.0, np.nan, np.inf, "0.8", None])
def test_cutoff_that_is_no_length_is_named(cutoff):
    with pytest.raises(DataError, match="the cut-off"):
        sections_that_fit(flat(100, UM), cutoff)


def test_profile_without_samples_is_named():
    with pytest.raises(TooFewSamplesError, match="2 valid samples"):
        sections_that_fit(Profile(np.arange(5) * UM, np.full(5, np.nan)), 0.8 * MM)
