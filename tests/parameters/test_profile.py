"""Profile parameters: closed forms (P01 to P08), editions, invariances, refusals."""

import json
from itertools import pairwise

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.provenance import Step
from metrosep.filters._arguments import DoubleFilterError
from metrosep.filters.chain import roughness, waviness
from metrosep.parameters._profile_rows import local_gradient
from metrosep.parameters.profile import profile_parameters
from metrosep.parameters.sections import section_slices

UM = 1e-6
NEW = "ISO 21920-2:2021"
OLD = "ISO 4287:1997"
EXACT = 1e-9  # relative; closed forms on the samples themselves
ROUNDING = 1e-9  # relative; other order of summation, other unit
LENGTHS = {"Ra", "Rq", "Rp", "Rv", "Rz", "Rzx", "Rz1max", "Rt", "Rc"} | {
    "Rk", "Rpk", "Rvk", "Rpkx", "Rvkx", "Rak1", "Rak2", "A1", "A2",
    "Rpt", "Rvt", "Rpq", "Rvq", "Rvmp", "Rvmc", "Rvvc", "Rvvv", "R5p", "R5v", "R10z", "RzJIS", "R3z",
}  # fmt: skip


def trace(z, *, dx=UM, unit=UM, **kwargs):
    z = np.asarray(z, dtype=float) * unit
    return Profile(np.arange(z.size) * dx, z, **kwargs)


def sine(n=4000, period=100, amplitude=0.05):
    return amplitude * np.cos(2 * np.pi * np.arange(n) / period)


@pytest.fixture
def rough(rng):
    """Skewed, correlated heights with a mean line of zero only roughly."""
    z = np.convolve(rng.standard_normal(2006), np.ones(7) / 17, mode="valid")
    return np.exp(3 * z) - np.exp(3 * z).mean() + 0.01


def values(table):
    return {s: q.value for s, q in table.items()}


# closed forms


def test_sine_heights():
    table = profile_parameters(trace(sine()), kind="R")

    assert table["Ra"].value == pytest.approx(
        2 * 0.05 * UM / 100 / np.tan(np.pi / 100), rel=1e-7, abs=0.0
    )
    assert table["Ra"].value == pytest.approx(31.8205160e-9, rel=1e-7, abs=0.0)
    assert table["Rq"].value == pytest.approx(35.3553391e-9, rel=1e-7, abs=0.0)
    assert table["Rku"].value == pytest.approx(1.5, rel=EXACT, abs=0.0)  # not the excess -1.5
    assert table["Rt"].value == pytest.approx(0.1 * UM, rel=EXACT, abs=0.0)


@pytest.mark.parametrize("edition", [NEW, OLD])
def test_sine_spacing(edition):
    table = profile_parameters(trace(sine()), kind="R", edition=edition, names=["RSm", "Rc"])

    assert table["RSm"].value == pytest.approx(100 * UM, rel=1e-6, abs=0.0)
    assert table["Rc"].value == pytest.approx(0.1 * UM, rel=EXACT, abs=0.0)


def test_narrow_notches_count_in_2021_only():
    z = np.cos(2 * np.pi * np.arange(5000) / 200)
    z[::200] = -1.0  # 1 um wide, sections of 1000 um: below 1 %

    old = profile_parameters(trace(z), kind="R", edition=OLD)["RSm"].value
    new = profile_parameters(trace(z), kind="R")["Rsm"].value

    assert old == pytest.approx(200 * UM, rel=1e-6, abs=0.0)
    assert new == pytest.approx(100 * UM, rel=0.05, abs=0.0)  # two elements in a period


@pytest.mark.parametrize("edition", [NEW, OLD])
def test_sine_gradient_is_nearly_the_continuous_one(edition):
    table = profile_parameters(trace(sine(period=10)), kind="R", edition=edition)

    # the 2-point formula is 1.6 % low, the central difference 6.4 %
    assert table["Rdq"].value == pytest.approx(np.sqrt(2) * np.pi * 0.05 / 10, rel=2e-3, abs=0.0)


@pytest.mark.parametrize(("edition", "n"), [(NEW, 4006), (OLD, 5 * 806)])
def test_sine_gradient_by_seven_points(edition, n):
    """Six samples lose their stencil in each trace; what is left are whole periods."""
    table = profile_parameters(trace(sine(n=n, period=10)), kind="R", edition=edition)
    w = 2 * np.pi / 10
    seven = 0.05 / np.sqrt(2) / 30 * abs(45 * np.sin(w) - 9 * np.sin(2 * w) + np.sin(3 * w))

    assert table["Rdq"].value == pytest.approx(seven, rel=EXACT, abs=0.0)


def test_gradient_is_exact_to_degree_six():
    x = np.linspace(-1, 1, 41)
    gradient = local_gradient(x**6 - 2 * x**3, dx=0.05)

    assert gradient[3:-3] == pytest.approx((6 * x**5 - 6 * x**2)[3:-3], abs=1e-12)
    assert np.isnan(gradient[[0, 1, 2, -3, -2, -1]]).all()


@pytest.mark.parametrize(("edition", "largest"), [(NEW, "Rzx"), (OLD, "Rz1max")])
def test_growing_sections(edition, largest):
    z = np.concatenate([a * np.cos(2 * np.pi * np.arange(1000) / 100) for a in range(1, 6)])

    table = profile_parameters(trace(z), kind="R", edition=edition)

    assert table["Rz"].value == pytest.approx(6 * UM, rel=EXACT, abs=0.0)
    assert table["Rp"].value == pytest.approx(3 * UM, rel=EXACT, abs=0.0)
    assert table["Rt"].value == pytest.approx(10 * UM, rel=EXACT, abs=0.0)
    assert table[largest].value == pytest.approx(10 * UM, rel=EXACT, abs=0.0)
    assert largest in list(table)


def test_growing_sections_tell_the_editions_apart():
    z = np.concatenate([a * np.cos(2 * np.pi * np.arange(1000) / 100) for a in range(1, 6)])

    old = profile_parameters(trace(z), kind="R", edition=OLD)
    new = profile_parameters(trace(z), kind="R")

    assert old["Rq"].value == pytest.approx(3 / np.sqrt(2) * UM, rel=EXACT, abs=0.0)
    assert new["Rq"].value == pytest.approx(np.sqrt(11 / 2) * UM, rel=EXACT, abs=0.0)
    assert old["Ra"].value == pytest.approx(new["Ra"].value, rel=EXACT, abs=0.0)
    assert old["Rku"].value == pytest.approx(1.5, rel=EXACT, abs=0.0)
    assert new["Rku"].value == pytest.approx(
        1.5 * 979 / 5 / 11**2, rel=EXACT, abs=0.0
    )  # mean a^4/mean a^2


@pytest.mark.parametrize("edition", [NEW, OLD])
def test_rectangle_about_its_mean(edition):
    z = (np.arange(1000) % 100 < 10).astype(int)

    table = profile_parameters(trace(z), kind="R", edition=edition, centre=True)

    assert table["Ra"].value == pytest.approx(0.18 * UM, rel=EXACT, abs=0.0)
    assert table["Rq"].value == pytest.approx(0.3 * UM, rel=EXACT, abs=0.0)
    assert table["Rsk"].value == pytest.approx(8 / 3, rel=EXACT, abs=0.0)
    assert table["Rku"].value == pytest.approx(73 / 9, rel=EXACT, abs=0.0)
    assert (table["Rp"].value, table["Rv"].value) == pytest.approx(
        (0.9 * UM, 0.1 * UM), rel=1e-9, abs=0.0
    )


def test_rectangle_as_it_is():
    z = (np.arange(1000) % 100 < 10).astype(float)

    table = profile_parameters(trace(z), kind="R")

    assert table["Ra"].value == pytest.approx(0.1 * UM, rel=EXACT, abs=0.0)
    assert table["Rq"].value == pytest.approx(np.sqrt(0.1) * UM, rel=EXACT, abs=0.0)
    assert any("mean of the heights is 100 nm" in note for note in table.context.notes)


@pytest.mark.parametrize("line", ["lsq", "secant"])
def test_core_family(rng, line):
    m = (np.arange(20_000) + 0.5) / 20_000
    z = rng.permutation(np.interp(m, [0, 0.1, 0.8, 1], [2.8, 0.8, -0.6, -3.6]))

    table = profile_parameters(trace(z), kind="R", line=line)

    expected = {"Rk": 2e-6, "Rpk": 1.8e-6, "Rvk": 2.6e-6, "Mr1": 0.09, "Mr2": 0.826667}
    for symbol, value in expected.items():
        assert table[symbol].value == pytest.approx(value, rel=5e-3, abs=0.0)
    assert table.context.settings["line"] == line


def test_primary_profile_has_one_section():
    z = np.concatenate([np.full(500, -1.0), np.full(500, 3.0)])

    table = profile_parameters(trace(z))

    assert table["Pt"].value == table["Pz"].value == pytest.approx(4 * UM, rel=EXACT, abs=0.0)
    assert table.context.settings["sections"] == 1
    assert not any(symbol.startswith("R") for symbol in table)


def test_waviness_symbols():
    table = profile_parameters(trace(sine()), kind="W", edition=OLD)

    assert {"Wa", "WSm", "Wz1max", "WMr1"} <= set(table)


# symbols, context


@pytest.mark.parametrize("edition", [NEW, OLD])
@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("RSm", "Rsm"),
        ("Mr1", "Rmrk1"),
        ("Rmr2", "Mr2"),
        ("RDq", "Rdq"),
        ("R\N{GREEK CAPITAL LETTER DELTA}q", "Rdq"),
        ("A1", "Rak1"),
    ],
)
def test_spelling_of_the_other_edition_is_found(edition, one, other):
    table = profile_parameters(trace(sine()), kind="R", edition=edition)

    assert one in table
    assert other in table
    assert table[one] is table[other]
    assert profile_parameters(trace(sine()), kind="R", edition=edition, names=[one])[other]


def test_editions_use_their_own_symbols():
    old = profile_parameters(trace(sine()), kind="R", edition=OLD)
    new = profile_parameters(trace(sine()), kind="R", edition="ISO21920:2021")

    assert {"RSm", "Rz1max", "Mr1", "A2"} <= set(old)
    assert not set(old) & {"Rsm", "Rzx", "Rmrk1", "Rpkx", "Rda"}
    assert {"Rsm", "Rzx", "Rmrk1", "Rak2", "Rpkx", "Rvkx", "Rda"} <= set(new)
    assert not set(new) & {"RSm", "Rz1max", "Mr1", "A2"}


def test_names_select_in_the_order_of_the_standard():
    table = profile_parameters(trace(sine()), kind="R", names=["Rt", "Ra"])

    assert list(table) == ["Ra", "Rt"]
    assert not any("core family" in note for note in table.context.notes)


def test_context_says_how():
    history = (Step("gaussian", {"cutoff_m": 8e-4}),)
    profile = trace(sine(), metadata={"profile_kind": "R"}, history=history)

    table = profile_parameters(profile, kind="R", edition=OLD, sections=4, centre=True)

    settings = table.context.settings
    assert settings["section_length_m"] == pytest.approx(1e-3, rel=1e-9, abs=0.0)
    assert (settings["sections"], settings["centre"]) == (4, True)
    assert (settings["height_threshold"], settings["spacing_threshold"]) == (0.1, 0.01)
    assert table.context.edition == OLD
    assert "gaussian" in table.context.chain
    assert "mean of 4 sections (ISO 4287:1997, 4.2.1" in table["Ra"].definition
    assert not any("Nobody" in n or "dealt with" in n for n in table.context.notes)
    new = profile_parameters(profile, kind="R").context.settings
    assert new["spacing_threshold"] is None
    assert (settings["height_threshold_of"], new["height_threshold_of"]) == ("Rz", "Rp and Rv")
    json.dumps(table.to_dict(), allow_nan=False)


def test_uncertainty_by_the_other_spelling():
    table = profile_parameters(trace(sine()), kind="R").with_uncertainties({"RSm": 1e-7})

    assert table["Rsm"].u == 1e-7
    assert table["RSm"].u == 1e-7


def test_sections_that_do_not_divide_are_noted():
    table = profile_parameters(trace(sine(n=4003)), kind="R")

    assert any("800 or 801 samples" in note for note in table.context.notes)


@pytest.mark.parametrize(("n", "sections"), [(10, 3), (6664, 5), (6664, 4), (1001, 7), (2, 1)])
def test_section_slices_cover_all_samples_once(n, sections):
    slices = section_slices(n, sections)

    sizes = [s.stop - s.start for s in slices]
    assert (slices[0].start, slices[-1].stop, len(slices)) == (0, n, sections)
    assert all(a.stop == b.start for a, b in pairwise(slices))
    assert max(sizes) - min(sizes) <= (n % sections > 0)
    assert sizes == sizes[::-1]  # the direction of x does not matter


@pytest.mark.parametrize(
    ("cutoff", "sections", "noted"),
    [(0.8e-3, 5, False), (0.806e-3, 5, False), (0.25e-3, 5, True), (0.25e-3, 16, False)],
)
def test_sections_that_are_not_the_cutoff_are_noted(cutoff, sections, noted):
    """4 mm in 5 sections are sections of 0.8 mm: right for that cut-off only."""
    profile = trace(sine(), metadata={"profile_kind": "R", "lambda_c_m": cutoff})

    table = profile_parameters(profile, kind="R", sections=sections)

    notes = [n for n in table.context.notes if "lambda_c" in n]
    assert bool(notes) is noted
    if noted:
        assert "800 um" in notes[0]
        assert "250 um" in notes[0]
        assert "sections=16" in notes[0]


def test_filtered_profile_knows_its_cutoff():
    profile = roughness(trace(sine(n=8000)), lambda_c=0.8e-3)

    notes = profile_parameters(profile, kind="R").context.notes

    assert any("sections of 1.6 mm" in n and "sections=10" in n for n in notes)


def test_sections_of_a_waviness_profile_may_be_those_of_lambda_f():
    facts = {"profile_kind": "W", "lambda_c_m": 0.25e-3, "lambda_f_m": 0.8e-3}
    profile = trace(sine(), metadata=facts)

    assert not any("lambda_c" in n for n in profile_parameters(profile, kind="W").context.notes)


# kind


def test_undeclared_kind_is_taken_with_a_note():
    notes = profile_parameters(trace(sine()), kind="R").context.notes

    assert any("Nobody declared" in note for note in notes)


@pytest.mark.parametrize(("kind", "name"), [("R", "roughness"), ("W", "waviness")])
def test_unfiltered_data_asked_as_filtered_raise(kind, name):
    """The advice must lead out: the filter that it names gives that kind."""
    profile = trace(sine(), metadata={"profile_kind": "P"})

    with pytest.raises(DataError, match=rf"metrosep\.filters\.{name}\(profile, lambda_c=\.\.\.\)"):
        profile_parameters(profile, kind=kind)
    filtered = {"roughness": roughness, "waviness": waviness}[name](profile, lambda_c=0.8e-3)
    assert "t" in {s[1:] for s in profile_parameters(filtered, kind=kind)}


@pytest.mark.parametrize(("declared", "kind"), [("R", "P"), ("R", "W"), ("W", "R"), ("W", "P")])
def test_filtered_data_asked_as_other_raise(declared, kind):
    profile = trace(sine(), metadata={"profile_kind": declared})

    with pytest.raises(DoubleFilterError, match="already filtered"):
        profile_parameters(profile, kind=kind)


# the definitions of 2021 that differ from those of 1997


def three_waves():
    """Sine with two smaller waves, one spike up and one down beside the border of two sections."""
    i = np.arange(4000)
    z = np.sin(2 * np.pi * i / 160) + 0.3 * np.sin(2 * np.pi * i / 47 + 1)
    z += 0.1 * np.cos(2 * np.pi * i / 11)
    z[1590] += 4.0
    z[1612] -= 3.0
    return z


def tilted_triangles(periods=20):
    """Triangles, hill then dale; the 0.15 um hill is below a tenth of Rp, the 0.25 um dale of Rv."""
    parts = []
    for hill, width, dale, breadth in (
        (2.0, 40, -3.0, 50), (0.15, 12, -2.0, 36), (1.0, 30, -0.25, 10), (0.6, 24, -1.5, 44),
    ):  # fmt: skip
        for height, n in ((hill, width), (dale, breadth)):
            t = (np.arange(n) + 0.5) / n
            parts.append(height * (1.0 - np.abs(2.0 * t - 1.0)))
    return np.tile(np.concatenate(parts), periods)


def counted_elements(z, least_hill, least_dale):
    """Return widths (in steps) and heights of the elements of 2021 in the direction of x.

    Portion by portion as a person counts on paper: cut at the crossings, strike out what is too
    low, join what is left of equal sign, pair each with its right neighbour.
    """
    crossings = [
        k + z[k] / (z[k] - z[k + 1]) for k in range(len(z) - 1) if (z[k] >= 0) != (z[k + 1] >= 0)
    ]
    bounds = [0.0, *crossings, len(z) - 1.0]
    kept = []  # left, right, height, sign, whole
    for j, (a, b) in enumerate(pairwise(bounds)):
        inside = z[int(np.ceil(a)) : int(np.floor(b)) + 1]
        sign = 1 if inside[np.argmax(np.abs(inside))] >= 0 else -1
        height = np.max(sign * inside)
        whole = 0 < j < len(bounds) - 2
        if height < (least_hill if sign > 0 else least_dale):
            if whole and kept:
                kept[-1][1] = b
        elif kept and kept[-1][3] == sign:
            kept[-1][1:3] = [b, max(kept[-1][2], height)]
            kept[-1][4] &= whole
        else:
            kept.append([a, b, height, sign, whole])
    pairs = [(p, q) for p, q in pairwise(kept) if p[4] and q[4]]
    return [q[1] - p[0] for p, q in pairs], [p[2] + q[2] for p, q in pairs]


def by_hand_2021(z, sections):
    """Return Rsm in steps, Rc and Rzx of a profile whose samples the sections divide."""
    parts = np.split(z, sections)
    limits = 0.1 * np.mean([p.max() for p in parts]), 0.1 * np.mean([-p.min() for p in parts])
    ways = [counted_elements(way, *limits) for way in (z, z[::-1])]
    widths, heights = (np.concatenate([way[k] for way in ways]) for k in (0, 1))
    n = z.size // sections
    slid = max(np.ptp(z[k : k + n]) for k in range(z.size - n + 1))
    return widths.mean(), heights.mean(), slid


@pytest.mark.parametrize("kind", ["R", "W"])
@pytest.mark.parametrize("seed", [None, 3, 4])
def test_elements_and_largest_height_of_2021_are_those_counted_by_hand(seed, kind):
    z = three_waves()
    if seed is not None:
        noise = np.random.default_rng(seed).standard_normal(6006)
        z = np.convolve(noise, np.ones(7) / 7, mode="valid") ** 3  # peaks beside a quiet middle
    spacing, height, slid = by_hand_2021(z, 6 if z.size % 5 else 5)

    table = profile_parameters(trace(z), kind=kind, sections=6 if z.size % 5 else 5)

    assert table[f"{kind}sm"].value == pytest.approx(spacing * UM, rel=EXACT, abs=0.0)
    assert table[f"{kind}c"].value == pytest.approx(height * UM, rel=EXACT, abs=0.0)
    assert table[f"{kind}zx"].value == pytest.approx(slid * UM, rel=EXACT, abs=0.0)


def test_published_values_of_the_definitions_of_2021():
    """Reference values of specs/metrology-2.md, 4.1, computed by foreign code.

    Rc of the triangles is the sum of their heights by hand, which ends ...462 where the page has
    ...446: hills 1.95 and 1 (1 - 1/30), dales 2.94 and 1.5 (1 - 1/44), in 19, 19, 20 and 19 pairs.
    """
    hill, dale = 29 / 30, 1.5 * 43 / 44
    pairs = 19 * (hill + dale) + 19 * (1.95 + dale) + 20 * (hill + 2.94) + 19 * (1.95 + 2.94)
    waves = profile_parameters(trace(three_waves(), dx=0.5 * UM), kind="R")
    triangles = profile_parameters(trace(tilted_triangles()), kind="R")

    for table, symbol, value in (
        (waves, "Rz", 3.39447964), (waves, "Rzx", 6.06247830), (waves, "Rt", 6.06247830),
        (waves, "Rp", 1.79365095), (waves, "Rv", 1.60082869),
        (waves, "Rsm", 73.7816334), (waves, "Rc", 2.61031714),
        (triangles, "Rp", 1.95), (triangles, "Rv", 2.94),
        (triangles, "Rsm", 123.506085), (triangles, "Rc", pairs / 77),
    ):  # fmt: skip
        assert table[symbol].value / UM == pytest.approx(value, rel=1e-8, abs=0.0), symbol
    old = profile_parameters(trace(three_waves(), dx=0.5 * UM), kind="R", edition=OLD)
    assert old["Rz1max"].value / UM == pytest.approx(4.88736213, rel=1e-8, abs=0.0)


def test_triangles_longer_and_longer_tend_to_two_elements_a_period_of_246():
    """Per period of 246 um the small hill joins dales, the small dale hills: 4 portions are left."""
    table = profile_parameters(trace(tilted_triangles(200)), kind="R", sections=5)

    assert table["Rsm"].value / UM == pytest.approx(123.0, rel=1e-3, abs=0.0)


@pytest.mark.parametrize("where", [700, 799, 950, 1199])
def test_a_spike_and_a_pit_count_together_wherever_the_border_of_sections_lies(where):
    """A hill of 3 um and a pit of 3 um lie 100 samples apart, on either side of no border or one."""
    z = sine()
    z[where], z[where + 100] = 3.0, -3.0

    table = profile_parameters(trace(z), kind="R")

    assert table["Rzx"].value == pytest.approx(6 * UM, rel=EXACT, abs=0.0)
    assert "slides" in table["Rzx"].definition


def test_window_counts_only_where_half_of_it_is_measured():
    third = np.arange(4000) % 6 < 2  # two side by side: on no coarser comb
    z = np.where(third, sine(), np.nan)
    table = profile_parameters(trace(z), kind="R")
    assert "no window of 800 samples" in table.unavailable["Rzx"]
    z[:801] = sine(801)
    z[:400] *= 5.0
    table = profile_parameters(trace(z), kind="R", names=["Rzx"])
    assert table["Rzx"].value == pytest.approx(0.5 * UM, rel=EXACT, abs=0.0)


# properties


@pytest.mark.parametrize("edition", [NEW, OLD])
@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1.0])
def test_unit_of_height(rough, edition, scale):
    one = profile_parameters(trace(rough, unit=1.0), kind="R", edition=edition)
    other = profile_parameters(trace(rough, unit=scale), kind="R", edition=edition)

    assert list(one) == list(other)
    for symbol in one:
        if symbol in {"Rdl", "Rdr", "Rmpc", "Rmvc"}:  # not proportional to the height
            continue
        slope = symbol in {"Rdq", "Rda", "Rdt"}
        factor = scale if symbol in LENGTHS or slope else 1.0
        assert other[symbol].value == pytest.approx(
            factor * one[symbol].value, rel=ROUNDING, abs=0.0
        )


def test_unit_of_length(rough):
    one = profile_parameters(trace(rough), kind="R")
    other = profile_parameters(trace(rough, dx=1e-3), kind="R")

    factor = {"Rsm": 1e3, "Rsal": 1e3, "Rsw": 1e3, "Rpd": 1e-3, "Rvd": 1e-3}
    factor |= {"Rdq": 1e-3, "Rda": 1e-3, "Rdt": 1e-3}
    for symbol in set(one) - {"Rdl", "Rdr", "Rmpc", "Rmvc"}:
        expected = factor.get(symbol, 1.0) * one[symbol].value
        assert other[symbol].value == pytest.approx(expected, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize("edition", [NEW, OLD])
def test_flip(rough, edition):
    one = profile_parameters(trace(rough), kind="R", edition=edition)
    other = profile_parameters(trace(-rough), kind="R", edition=edition)

    for symbol in ("Ra", "Rq", "Rku", "Rz", "Rt", "Rdq", "RSm", "Rc", "Rk"):
        assert other[symbol].value == pytest.approx(one[symbol].value, rel=ROUNDING, abs=0.0)
    assert other["Rp"].value == pytest.approx(one["Rv"].value, rel=ROUNDING, abs=0.0)
    assert other["Rpk"].value == pytest.approx(one["Rvk"].value, rel=ROUNDING, abs=0.0)
    assert other["Rsk"].value == pytest.approx(-one["Rsk"].value, rel=ROUNDING, abs=0.0)
    assert one["Rsk"].value > 0.5  # the asymmetry is there


@pytest.mark.parametrize("edition", [NEW, OLD])
def test_shift_in_x_and_centred_shift_in_z(rough, edition):
    plain = trace(rough)
    moved = Profile(plain.x + 5e-3, plain.z + 3e-6)

    one = profile_parameters(plain, kind="R", edition=edition, centre=True)
    other = profile_parameters(moved, kind="R", edition=edition, centre=True)

    for symbol in one:
        assert other[symbol].value == pytest.approx(one[symbol].value, rel=1e-7, abs=0.0)


@pytest.mark.parametrize("edition", [NEW, OLD])
def test_reversed_x(rough, edition):
    one = profile_parameters(trace(rough), kind="R", edition=edition)
    other = profile_parameters(trace(rough[::-1]), kind="R", edition=edition)

    # 1997: elements pair from the first crossing on; 2021 looks in both directions
    for symbol in set(one) - ({"RSm", "Rc"} if edition == OLD else set()):
        assert other[symbol].value == pytest.approx(one[symbol].value, rel=ROUNDING, abs=0.0)


def test_profile_measured_twice(rough):
    one = profile_parameters(trace(rough), kind="R", names=["Ra", "Rq", "Rsk", "Rt", "Rk"])
    twice = profile_parameters(trace(np.tile(rough, 2)), kind="R", names=list(one))

    for symbol in one:
        assert twice[symbol].value == pytest.approx(one[symbol].value, rel=1e-3, abs=0.0)


# missing samples


@pytest.mark.parametrize("edition", [NEW, OLD])
def test_missing_ends_are_cropped_ends(rough, edition):
    holed = rough.copy()
    holed[:101] = holed[-57:] = np.nan

    one = profile_parameters(trace(holed), kind="R", edition=edition)
    other = profile_parameters(trace(rough[101:-57]), kind="R", edition=edition)

    assert values(one) == pytest.approx(values(other), rel=ROUNDING, abs=0.0)
    assert one.context.n_valid == rough.size - 158
    assert one.context.n_total == rough.size
    assert any("158 missing samples at the ends" in note for note in one.context.notes)


def test_missing_inside_counts_only_valid_samples():
    z = sine(period=100)
    z[1000:1100] = np.nan  # one whole period: the statistics of the rest are the same

    table = profile_parameters(trace(z), kind="R")

    assert table["Ra"].value == pytest.approx(31.8205160e-9, rel=1e-7, abs=0.0)
    assert table["Rq"].value == pytest.approx(35.3553391e-9, rel=1e-7, abs=0.0)
    assert table["Rsm"].value == pytest.approx(100 * UM, rel=1e-6, abs=0.0)
    assert any("100 of 4000 samples are missing inside" in n for n in table.context.notes)


def test_gradient_uses_complete_stencils_only():
    z = np.arange(700.0)
    z[::8] += 1e3
    z[::8] = np.nan  # the outliers are not measured; 7 valid samples between them

    table = profile_parameters(trace(z), kind="R", names=["Rdq"])

    assert table["Rdq"].value == pytest.approx(1.0, rel=EXACT, abs=0.0)


def test_empty_section_leaves_what_does_not_need_it():
    z = sine()
    z[800:1600] = np.nan

    new = profile_parameters(trace(z), kind="R")
    old = profile_parameters(trace(z), kind="R", edition=OLD)

    assert "section 2 of 5" in new.unavailable["Rz"]
    assert "Ra" in new
    assert "Rt" in new
    assert {"Ra", "Rz", "RSm"} <= set(old.unavailable)
    with pytest.raises(DataError, match="Rz cannot be given: section 2"):
        new["Rz"]


def gapped(first, last):
    """A sine of 5 sections of 1000 samples, some samples of section 2 not measured."""
    z = np.cos(2 * np.pi * np.arange(5000) / 100)
    z[first:last] = np.nan
    return trace(z)


def test_section_of_few_samples_does_not_count_as_a_full_one():
    """One valid sample has no height: as a full section it would make Rz 1.6 um of 2.0 um."""
    new = profile_parameters(gapped(1001, 2000), kind="R")
    old = profile_parameters(gapped(1001, 2000), kind="R", edition=OLD)

    assert "section 2 of 5 holds 1 valid sample" in new.unavailable["Rz"]
    assert {"Rp", "Rv", "Rz", "Rsm"} <= set(new.unavailable)
    assert new["Rzx"].value == pytest.approx(2 * UM, rel=EXACT, abs=0.0)  # of a complete window
    assert new["Rt"].value == pytest.approx(2 * UM, rel=EXACT, abs=0.0)
    assert {"Ra", "Rq", "Rz", "Rdq", "RSm"} <= set(old.unavailable)
    assert "section 2 of 5" in old.unavailable["Rdq"]


@pytest.mark.parametrize(("missing", "given"), [(500, True), (501, False)])
def test_section_needs_half_of_its_samples(missing, given):
    table = profile_parameters(gapped(1250, 1250 + missing), kind="R", edition=OLD)

    assert ("Rz" in table) is given
    note = f"section 2 ({1000 - missing} of 1000 samples)"
    assert any(note in n for n in table.context.notes)


def test_one_section_is_the_evaluation_length_whatever_its_gaps():
    table = profile_parameters(gapped(500, 4500), kind="P", edition=OLD)

    assert table["Pz"].value == pytest.approx(2 * UM, rel=EXACT, abs=0.0)


# bad input


def test_constant_has_no_shape():
    table = profile_parameters(trace(np.full(1000, 2.0)), kind="R")

    assert table["Ra"].value == pytest.approx(2 * UM, rel=1e-9, abs=0.0)
    assert table["Rt"].value == 0.0
    assert table["Rdq"].value == 0.0
    for symbol in ("Rsk", "Rku", "Rk", "Mr1"):
        reason = table.unavailable[symbol] if symbol != "Mr1" else table.unavailable["Rmrk1"]
        assert "zero height" in reason
    assert "no complete profile element" in table.unavailable["Rsm"]
    with pytest.raises(DataError, match="zero height"):
        table["Mr1"]


def test_too_short_for_the_stencil_still_gives_the_table():
    table = profile_parameters(trace([0, 1, 0, -1, 0, 1]), kind="P")

    assert "7 consecutive valid samples" in table.unavailable["Pdq"]
    assert table["Pt"].value == pytest.approx(2 * UM, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("z", [[1.0], [np.nan] * 20, [np.nan, 1.0, np.nan]])
def test_nothing_to_evaluate_raises(z):
    with pytest.raises(TooFewSamplesError, match="2 valid samples"):
        profile_parameters(trace(z))


def test_too_many_sections_raise():
    with pytest.raises(TooFewSamplesError, match="fewer sections"):
        profile_parameters(trace(np.arange(9.0)), kind="R", sections=5)


@pytest.mark.parametrize("sections", [0, -1, 2.5, True, "5"])
def test_bad_sections_raise(sections):
    with pytest.raises(DataError, match="whole number"):
        profile_parameters(trace(sine()), kind="R", sections=sections)


def test_bad_options_raise():
    with pytest.raises(DataError, match="edition"):
        profile_parameters(trace(sine()), edition="ISO 4287:1984")
    with pytest.raises(DataError, match="kind"):
        profile_parameters(trace(sine()), kind="Q")
    with pytest.raises(DataError, match="secant"):
        profile_parameters(trace(sine()), line="tangent")
    with pytest.raises(DataError, match=r"Rzq \(nearest: Rz.*of kind R with edition ISO 21920"):
        profile_parameters(trace(sine()), kind="R", names=["Ra", "Rzq"])
    with pytest.raises(DataError, match="sequence"):
        profile_parameters(trace(sine()), kind="R", names="Ra")


def test_uneven_positions_raise():
    x = np.arange(100.0) ** 1.1

    with pytest.raises(NotUniformError, match="resample"):
        profile_parameters(Profile(x, np.sin(x)))


def test_infinite_height_raises():
    with pytest.raises(InvalidSamplesError, match="infinite"):
        profile_parameters(trace([0, np.inf, 1]))


def test_integers_are_taken():
    z = np.arange(1000, dtype=np.int16) % 7

    table = profile_parameters(Profile(np.arange(1000), z), kind="P")

    assert table["Pt"].value == 6.0


@pytest.mark.parametrize("obj", [Surface(np.zeros((50, 50)), UM, UM), np.zeros(50), None])
def test_what_is_no_profile_is_refused(obj):
    with pytest.raises(DataError, match=f"needs a Profile, got {type(obj).__name__}"):
        profile_parameters(obj)


@pytest.mark.parametrize("names", [[1], 1, [None, "Ra"]])
def test_names_that_are_no_texts_are_refused(names):
    with pytest.raises(DataError, match="names"):
        profile_parameters(trace(sine()), kind="R", names=names)


@pytest.mark.parametrize("edition", [NEW, OLD])
@pytest.mark.parametrize("size", [1e-207, 1e-100, 1e100, 1e153, 1e300])
def test_heights_beyond_any_instrument_are_refused(rough, size, edition):
    """Fourth powers of such heights are 0 or infinite in double precision."""
    with pytest.raises(DataError, match=r"range of the heights|heights reach"):
        profile_parameters(trace(rough, unit=size), kind="R", edition=edition)


@pytest.mark.parametrize("size", [1e-50, 1e50])
def test_heights_within_the_limits_are_taken(rough, size):
    one = profile_parameters(trace(rough, unit=1.0), kind="R", names=["Rku", "Rq"])
    other = profile_parameters(trace(rough, unit=size), kind="R", names=["Rku", "Rq"])

    assert other["Rku"].value == pytest.approx(one["Rku"].value, rel=ROUNDING, abs=0.0)
    assert other["Rq"].value == pytest.approx(size * one["Rq"].value, rel=ROUNDING, abs=0.0)
