"""Primary, roughness and waviness profile: closed forms, kinds, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.filters._arguments import DoubleFilterError, profile_kind
from metrosep.filters.chain import primary, roughness, waviness

UM = 1e-6
LAMBDA_S, LAMBDA_C, LAMBDA_F = 2.5 * UM, 0.8e-3, 4e-3
X = np.arange(20_000) * 0.5 * UM
WAVES = {"noise": 2.5 * UM, "tool": 50 * UM, "chatter": 2e-3}
MIDDLE = slice(5000, 15_000)
GAIN = 2e-3
"""Projection over 2.5 waves of the longest wave that is asked for."""


def _wave(length: float) -> Profile:
    return Profile(X, np.cos(2 * np.pi * X / length))


def _amplitude(result: Profile, length: float) -> float:
    wave = np.cos(2 * np.pi * result.x / length)[MIDDLE]
    return float(result.z[MIDDLE] @ wave / (wave @ wave))


def _passes(cutoff: float, length: float) -> float:
    return 2.0 ** -((cutoff / length) ** 2)


@pytest.mark.parametrize("length", WAVES.values(), ids=list(WAVES))
def test_shares_of_a_wave_in_each_profile(length: float) -> None:
    """P = S; R = S (1 - C); W = S C (1 - F), each a power of two of (cut-off / wavelength)^2."""
    s, c, f = (_passes(v, length) for v in (LAMBDA_S, LAMBDA_C, LAMBDA_F))
    wave = _wave(length)
    p = primary(wave, lambda_s=LAMBDA_S)

    tolerance = GAIN if length > 10 * UM else 1e-1  # 5 samples per cut-off: sampled weights
    assert _amplitude(p, length) == pytest.approx(s, abs=tolerance)
    assert _amplitude(roughness(p, lambda_c=LAMBDA_C), length) == pytest.approx(
        s * (1 - c), abs=tolerance
    )
    w = waviness(p, lambda_c=LAMBDA_C, lambda_f=LAMBDA_F)
    assert _amplitude(w, length) == pytest.approx(s * c * (1 - f), abs=GAIN)


def test_chain_in_one_call_equals_its_links() -> None:
    rng = np.random.default_rng(1)
    measured = Profile(X, rng.normal(size=X.size))
    linked = roughness(primary(measured, lambda_s=LAMBDA_S), lambda_c=LAMBDA_C)
    at_once = roughness(measured, lambda_c=LAMBDA_C, lambda_s=LAMBDA_S)

    assert np.array_equal(linked.z, at_once.z)
    assert linked.metadata == at_once.metadata


def test_roughness_and_waviness_add_up_to_the_primary_profile() -> None:
    p = primary(Profile(X, np.random.default_rng(2).normal(size=X.size)), lambda_s=LAMBDA_S)
    total = roughness(p, lambda_c=LAMBDA_C).z + waviness(p, lambda_c=LAMBDA_C).z

    assert np.abs(total - p.z).max() < 1e-14


def test_kinds_cutoffs_and_history_are_recorded() -> None:
    measured = Profile(X, np.zeros(X.size), metadata={"part": "7"})
    p = primary(measured, lambda_s=LAMBDA_S)
    r = roughness(p, lambda_c=LAMBDA_C)
    w = waviness(p, lambda_c=LAMBDA_C, lambda_f=LAMBDA_F)

    assert [profile_kind(q) for q in (p, r, w)] == ["P", "R", "W"]
    assert dict(r.metadata) == {
        "part": "7",
        "profile_kind": "R",
        "lambda_s_m": LAMBDA_S,
        "lambda_c_m": LAMBDA_C,
    }
    assert w.metadata["lambda_f_m"] == LAMBDA_F
    assert [s.name for s in r.history] == ["gaussian", "primary", "gaussian", "roughness"]


@pytest.mark.parametrize(
    ("kind", "refused"),
    [("P", ["primary", "with_s"]), ("R", "all"), ("W", "all"), (None, [])],
)
def test_double_filtering_is_refused(kind: str | None, refused: object) -> None:
    profile = Profile(X, np.zeros(X.size), metadata={"profile_kind": kind} if kind else {})
    links = {
        "primary": lambda **o: primary(profile, lambda_s=LAMBDA_S, **o),
        "roughness": lambda **o: roughness(profile, lambda_c=LAMBDA_C, **o),
        "waviness": lambda **o: waviness(profile, lambda_c=LAMBDA_C, **o),
        "with_s": lambda **o: roughness(profile, lambda_c=LAMBDA_C, lambda_s=LAMBDA_S, **o),
    }
    for name, link in links.items():
        if refused == "all" or name in list(refused):
            with pytest.raises(DoubleFilterError, match="refilter=True"):
                link()
        else:
            link()
        assert profile_kind(link(refilter=True)) in ("P", "R", "W")


def test_sections_are_whole_and_in_the_middle() -> None:
    """4 sections of floor(2.5 mm / 1.5 um) = 1666 samples: the 6664 of the Mitutoyo export."""
    x = np.arange(10_100) * 1.5 * UM
    r = roughness(Profile(x, np.zeros(x.size)), lambda_c=2.5e-3, end="cut", sections=4)

    assert len(r) == 6664
    assert r.x[0] == pytest.approx(x[-1] - r.x[-1], abs=1.6 * UM)


def test_cut_takes_one_cutoff_off_each_end() -> None:
    r = roughness(Profile(X, np.zeros(X.size)), lambda_c=LAMBDA_C, end="cut")

    assert len(r) == X.size - 2 * 1600
    assert r.x[0] == X[1600]


def test_bad_options() -> None:
    p = Profile(X, np.zeros(X.size))
    with pytest.raises(DataError, match=r"lambda_s .* shorter than lambda_c"):
        roughness(p, lambda_c=LAMBDA_C, lambda_s=LAMBDA_C)
    with pytest.raises(DataError, match=r"lambda_c .* shorter than lambda_f"):
        waviness(p, lambda_c=LAMBDA_C, lambda_f=LAMBDA_C)
    with pytest.raises(DataError, match="whole number from 1"):
        roughness(p, lambda_c=LAMBDA_C, sections=0)
    with pytest.raises(TooFewSamplesError, match="fewer sections"):
        roughness(p, lambda_c=LAMBDA_C, sections=13)
    with pytest.raises(DataError, match="sampling limit"):
        primary(p, lambda_s=1.0 * UM)


def test_sections_that_lack_a_few_samples_are_those_that_were_meant() -> None:
    """7 x 0.8 mm as it was traced: the S-filter takes 5 samples at each end, the L-filter 0.8 mm."""
    trace = Profile(np.arange(11_200) * 0.5 * UM, np.cos(np.arange(11_200) / 16.0))
    filtered = {"lambda_s": 2.5 * UM, "lambda_c": LAMBDA_C, "end": "cut"}

    kept = roughness(trace, **filtered, sections=5)

    step = next(s for s in kept.history if s.name == "sections")
    assert len(kept) == len(roughness(trace, **filtered)) == 7990
    assert step.parameters["sections"] == 5
    assert step.parameters["section_length_m"] == pytest.approx(799 * UM, rel=1e-12, abs=0.0)
    with pytest.raises(TooFewSamplesError, match=r"6 sections of 800 um need 9600 samples, 7990"):
        roughness(trace, **filtered, sections=6)


@pytest.mark.parametrize(("samples", "holds"), [(7840, True), (7839, False)])
def test_a_tenth_of_one_section_may_lack(samples: int, holds: bool) -> None:
    trace = Profile(np.arange(samples) * 0.5 * UM, np.cos(np.arange(samples) / 16.0))

    if holds:
        assert len(roughness(trace, lambda_c=LAMBDA_C, sections=5)) == samples
    else:
        with pytest.raises(TooFewSamplesError, match="5 sections"):
            roughness(trace, lambda_c=LAMBDA_C, sections=5)


@pytest.mark.parametrize("sections", [1.5, "a", True, 0, -1, np.nan])
def test_sections_that_are_no_whole_number_are_refused(sections: object) -> None:
    p = Profile(X, np.zeros(X.size))
    with pytest.raises(DataError, match="sections must be a whole number from 1"):
        roughness(p, lambda_c=LAMBDA_C, sections=sections)


@pytest.mark.parametrize("link", [primary, roughness, waviness])
def test_what_is_no_profile_is_refused(link) -> None:
    name = "lambda_s" if link is primary else "lambda_c"
    with pytest.raises(DataError, match="needs a Profile, got ndarray"):
        link(np.zeros(X.size), **{name: LAMBDA_C})


@pytest.mark.parametrize("name", ["lambda_c", "lambda_s"])
def test_cutoffs_that_are_no_numbers_are_refused(name: str) -> None:
    with pytest.raises(DataError, match=name):
        roughness(Profile(X, np.zeros(X.size)), **{"lambda_c": LAMBDA_C, name: "a"})
    with pytest.raises(DataError, match="lambda_c"):
        waviness(Profile(X, np.zeros(X.size)), lambda_c=None)


def test_refusal_names_the_way_round_it_in_python() -> None:
    p = Profile(X, np.zeros(X.size), metadata={"profile_kind": "R"})
    with pytest.raises(
        DoubleFilterError, match=r"\(refilter=True in Python does it all the same\)"
    ):
        roughness(p, lambda_c=LAMBDA_C)


def test_a_cutoff_may_be_a_text_with_its_unit() -> None:
    p = Profile(X, 1e-6 * np.sin(2 * np.pi * X / 50e-6))
    text = roughness(p, lambda_c="0.25 mm", lambda_s="2.5 um")
    number = roughness(p, lambda_c=0.25e-3, lambda_s=2.5e-6)

    assert np.array_equal(text.z, number.z, equal_nan=True)
    assert text.metadata["lambda_c_m"] == pytest.approx(0.25e-3, rel=0, abs=1e-18)


# ---- roughness for the Rk family ------------------------------------------------------------------


def grooved():
    """Plateau with two waves and a groove 2 um deep every 130 um, 8 mm long."""
    x = np.arange(16_000) * 0.5
    z = 0.15 * np.sin(2 * np.pi * x / 37) + 0.05 * np.sin(2 * np.pi * x / 9 + 1)
    z -= np.where(x % 130 < 12, 2 * np.sin(np.pi * (x % 130) / 12) ** 2, 0.0)
    return Profile(x * 1e-6, z * 1e-6)


def two_passes(z):
    """ISO 13565-1 with a kernel of our own, cut at one cut-off: 800 um in steps of 0.5 um."""
    t = np.arange(-1600, 1601) / 1600
    kernel = np.exp(-np.pi * t**2 / (np.log(2) / np.pi))

    def line(v):
        return np.convolve(v, kernel, "same") / np.convolve(np.ones_like(v), kernel, "same")

    return line(np.maximum(z, line(z)))


def test_two_passes_of_iso_13565_1_stay_on_the_plateau():
    profile = grooved()

    rough = roughness(profile, lambda_c="0.8 mm", core_filter="13565-1", end="renormalise")

    line = profile.z - rough.z
    assert np.abs(line - two_passes(profile.z)).max() < 5e-14  # m: the kernel is cut elsewhere
    assert line[8000] == pytest.approx(0.0047630637e-6, rel=1e-6, abs=0.0)
    assert rough.metadata["profile_kind"] == "R"
    # At the ends, one cut-off goes and the line inside stays.
    cut = roughness(profile, lambda_c="0.8 mm", core_filter="13565-1", end="cut")
    middle = slice(8000 - 100, 8000 + 100)
    at = np.searchsorted(cut.x, profile.x[middle])
    assert np.abs(cut.z[at] - rough.z[middle]).max() < 5e-14


def test_core_filters_tell_the_table_which():
    from metrosep.parameters import profile_parameters

    expected = {"13565-1": (0.383244, 0.0312416, 2.054847, 0.0595, 0.9266667)}
    for name in ("gaussian", "13565-1", "robust"):
        rough = roughness(grooved(), lambda_c="0.8 mm", core_filter=name, end="renormalise")
        part = slice(5000, 11_000)
        piece = Profile(
            rough.x[part], rough.z[part], metadata=rough.metadata, history=rough.history
        )
        table = profile_parameters(
            piece, kind="R", sections=1, names=["Rk", "Rpk", "Rvk", "Mr1", "Mr2"]
        )
        warned = any("valley-suppressing" in note for note in table.context.notes)
        assert warned == (name == "gaussian")
        assert ("13565-1" in table.context.chain) == (name == "13565-1")
        if name in expected:
            found = [q.value * (1e6 if q.unit == "m" else 1.0) for q in table.values()]
            assert found == pytest.approx(expected[name], rel=2e-6, abs=0.0)
