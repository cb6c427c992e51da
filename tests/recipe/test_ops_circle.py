"""Steps over a revolution: the recipe gives what the call gives, on asymmetric planted parts."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, MetrosepError, RecipeError
from metrosep.recipe.result import load_document
from metrosep.separation import closure, iso230_7, multiprobe, multistep, orthogonal_mixed

N = 72
ANGLE = 2 * np.pi * np.arange(N) / N
DEGREES = np.degrees(ANGLE)
PROBES = np.radians([0.0, 20.6, 47.8])
TEXT_NM = 1e-5
"""Readings are written with 6 decimals of a nm; the methods magnify the rounding a few times."""


def ball(t):
    return 50e-9 * np.cos(3 * t + 0.3) + 8e-9 * np.sin(5 * t)


def moved_x(t):
    return 20e-9 * np.cos(2 * t - 0.4)


def moved_y(t):
    return 9e-9 * np.sin(4 * t + 1.0)


@pytest.fixture
def table(tmp_path):
    def write(name="m.csv", **columns):
        rows = zip(*columns.values(), strict=True)
        text = [",".join(columns), *(",".join(_cell(v) for v in row) for row in rows)]
        file = tmp_path / name
        file.write_text("\n".join(text) + "\n", "ascii")
        return file

    return write


def _cell(value):
    return value if isinstance(value, str) else f"{value:.9f}"


def run(text, files, **options):
    return ms.Recipe.parse("metrosep = 1\n" + text).run(files, **options)


def same(found, called, parts):
    for part in parts:
        np.testing.assert_allclose(
            found.parts[part], called.parts[part], rtol=0.0, atol=TEXT_NM * 1e-9
        )
        np.testing.assert_allclose(found.u[part], called.u[part], rtol=1e-3)


MULTIPROBE = """[input]
readings = ["p0_nm", "p1_nm", "p2_nm"]
angle = "angle_deg"
[[step]]
op = "multiprobe"
angles = ["0 deg", "20.6 deg", "47.8 deg"]
kmax = 8
u_reading = "1 nm"
"""


def probes():
    return [
        ball(ANGLE + a) + moved_x(ANGLE) * np.cos(a) + moved_y(ANGLE) * np.sin(a) for a in PROBES
    ]


def test_multiprobe(table, tmp_path):
    m = probes()
    file = table(angle_deg=DEGREES, **{f"p{i}_nm": v * 1e9 for i, v in enumerate(m)})
    text = MULTIPROBE + '[[output]]\nkind = "report"\n[[output]]\nkind = "parts"\n'
    result = run(text, file, out=tmp_path / "out")

    called = multiprobe(np.array(m), PROBES, 8, u_reading=1e-9)
    same(result.produced, called, ("artefact", "x", "y"))
    np.testing.assert_allclose(result.produced.artefact, ball(ANGLE), rtol=0.0, atol=1e-12)
    charts = load_document(tmp_path / "out")["separation"]["charts"]
    bars = next(c for c in charts if c["title"] == "Harmonics, artefact")
    assert bars["amplitude"][2] == pytest.approx(50e-9, abs=1e-13)
    assert 1 in bars["suppressed"]
    assert 3 not in bars["suppressed"]
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "Harmonics, artefact" in page


def test_results_of_two_methods_are_combined(table, tmp_path):
    m = probes()
    file = table(angle_deg=DEGREES, **{f"p{i}_nm": v * 1e9 for i, v in enumerate(m)})
    results = []
    for name in ("a", "b"):
        run(MULTIPROBE, file, out=tmp_path / name)
        results.append(tmp_path / name / "result.json")
    text = '[input]\n[[step]]\nop = "combine_harmonics"\nkmax = 8\n'
    found = run(text, results).produced
    np.testing.assert_allclose(found.artefact, ball(ANGLE), rtol=0.0, atol=1e-12)
    document = {**load_document(results[0]), "separation": None}
    results[1].write_text(json.dumps(document), "utf-8")
    with pytest.raises(DataError, match="no parts over a revolution"):
        run(text, results)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (("kmax = 8", ""), r"recipe.toml:\d+: .*needs the key .kmax."),
        (('"20.6 deg"', '"20.6 mm"'), ":7.*angle"),
        (("kmax = 8", "kmax = 8.5"), "whole number"),
        (("kmax = 8", "kmax = 8\nturn = 2"), "not one of 1, -1"),
        (("kmax = 8", "kmax = 8\nturn = true"), "not one of 1, -1"),
    ],
)
def test_wrong_keys_are_refused_with_their_line(change, match):
    with pytest.raises(RecipeError, match=match):
        ms.Recipe.parse("metrosep = 1\n" + MULTIPROBE.replace(*change))


def test_probes_and_angles_must_be_as_many(table):
    file = table(angle_deg=DEGREES, **{f"p{i}_nm": v * 1e9 for i, v in enumerate(probes())})
    with pytest.raises(MetrosepError):
        run(MULTIPROBE.replace(', "47.8 deg"', ""), file)


def test_multistep_of_two_numbers_of_steps(table):
    names, m = [], []
    for n in (4, 3):
        for step in range(n):
            names.append(f"n{n}_s{step}_nm")
            m.append(ball(ANGLE + 2 * np.pi * step / n) + moved_x(ANGLE))
    file = table(angle_deg=DEGREES, **{k: v * 1e9 for k, v in zip(names, m, strict=True)})
    listed = ", ".join(f'"{n}"' for n in names)
    result = run(
        f'[input]\nreadings = [{listed}]\nangle = "angle_deg"\n'
        '[[step]]\nop = "multistep"\nsteps = [4, 3]\nkmax = 8\nu_reading = "1 nm"\n',
        file,
    )
    called = multistep(np.array(m), steps=(4, 3), kmax=8, u_reading=1e-9)
    same(result.produced, called, ("artefact", "spindle"))
    assert np.ptp(result.produced.artefact - ball(ANGLE)) < 1e-12


def test_orthogonal_mixed_reads_a_slope_beside_the_displacement(table):
    radius = 25e-3
    t = ANGLE + np.pi / 2
    slope = (-150e-9 * np.sin(3 * t + 0.3) + 40e-9 * np.cos(5 * t)) / radius
    displacement = ball(ANGLE) + moved_x(ANGLE)
    file = table(angle_deg=DEGREES, d_nm=displacement * 1e9, s_urad=slope * 1e6)
    text = """[input]
readings = ["d_nm"]
slope = "s_urad"
angle = "angle_deg"
[[step]]
op = "orthogonal_mixed"
kmax = 8
radius = "25 mm"
u_reading = "1 nm"
u_slope = "0.1 urad"
"""
    found = run(text, file).produced
    called = orthogonal_mixed(displacement, slope, 8, radius=radius, u_reading=1e-9, u_slope=1e-7)
    for part in called.parts:
        np.testing.assert_allclose(found.parts[part], called.parts[part], rtol=0.0, atol=1e-13)
    with pytest.raises(RecipeError, match="slope"):
        run(text.replace('slope = "s_urad"\n', ""), file)


def test_closure_reads_a_matrix_of_angles(table):
    rng = np.random.default_rng(4)
    polygon, machine = (1e-6 * rng.standard_normal(6) for _ in range(2))
    m = [np.roll(polygon, -p) - machine + 2e-6 for p in range(6)]
    file = table(**{f"s{p}_urad": v * 1e6 for p, v in enumerate(m)})
    listed = ", ".join(f'"s{p}_urad"' for p in range(6))
    result = run(
        f'[input]\nreadings = [{listed}]\n[[step]]\nop = "closure"\nu_reading = "0.1 urad"\n', file
    )
    called = closure(m, u_reading=1e-7)
    np.testing.assert_allclose(result.produced.artefact, called.artefact, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(
        result.produced.artefact, polygon - polygon.mean(), rtol=0.0, atol=1e-13
    )


REVOLUTIONS = 12


def turning(seed=3):
    rng = np.random.default_rng(seed)
    once = 3e-6 * np.cos(ANGLE) + moved_x(ANGLE) + 6e-9 * np.cos(5 * ANGLE)
    return once + 1e-9 * rng.standard_normal((REVOLUTIONS, N))


def rounded(m):
    return np.round(m * 1e9, 9) * 1e-9


SPINDLE = '[[step]]\nop = "iso230_7"\n'


def test_spindle_at_fixed_angles_by_revolution(table, tmp_path):
    m = turning()
    file = table(
        revolution=np.repeat(np.arange(float(REVOLUTIONS)), N),
        angle_deg=np.tile(DEGREES, REVOLUTIONS),
        gap_nm=m.ravel() * 1e9,
    )
    text = '[input]\nreadings = ["gap_nm"]\nangle = "angle_deg"\nrepeat = "revolution"\n' + SPINDLE
    text += '[[check]]\nmetric = "synchronous"\nupper = "60 nm"\n'
    text += '[[output]]\nkind = "parts"\n[[output]]\nkind = "report"\n'
    result = run(text, file, out=tmp_path / "out")

    called = iso230_7(rounded(m), ANGLE)
    for key in ("synchronous", "asynchronous", "total", "eccentricity"):
        assert result.produced[key].value == pytest.approx(called[key].value, abs=1e-14)
        assert result.produced[key].u == pytest.approx(called[key].u, abs=1e-13)
    assert result.verdict == "accept"
    charts = load_document(tmp_path / "out")["separation"]["charts"]
    assert [c["kind"] for c in charts] == ["polar", "harmonics"]
    assert charts[0]["n_revolutions"] == REVOLUTIONS
    head = (tmp_path / "out" / "parts.csv").read_text("ascii").splitlines()[0]
    assert head == "angle_rad,synchronous_m,asynchronous_range_m,asynchronous_sd_m"


@pytest.mark.parametrize("wrap", [True, False])
def test_spindle_with_an_encoder(table, wrap):
    m = turning()
    every = np.concatenate([ANGLE + 2 * np.pi * r for r in range(REVOLUTIONS)])
    shown = np.mod(every, 2 * np.pi) if wrap else every
    file = table(angle_rad=shown, gap_nm=m.ravel() * 1e9)
    text = '[input]\nreadings = ["gap_nm"]\nangle = "angle_rad"\n' + SPINDLE + "n = 72\n"
    found = run(text, file).produced
    called = iso230_7(rounded(m.ravel()), np.round(shown, 9), n=72)
    assert found["synchronous"].value == pytest.approx(called["synchronous"].value, abs=1e-13)
    assert found["eccentricity"].value == pytest.approx(3e-6, abs=2e-9)


def test_spindle_with_an_index(table):
    m = turning().ravel()
    t = np.arange(m.size) * 1e-3
    index = np.where(np.arange(m.size) % N < 4, 5.0, 0.0)
    file = table(t_ms=t * 1e3, gap_nm=m * 1e9, index_V=index)
    text = '[input]\nreadings = ["gap_nm"]\ntime = "t_ms"\nindex = "index_V"\n' + SPINDLE
    found = run(text, file).produced
    assert found["eccentricity"].value == pytest.approx(3e-6, abs=5e-9)
    assert found["synchronous"].value == pytest.approx(
        np.ptp(moved_x(ANGLE) + 6e-9 * np.cos(5 * ANGLE)), abs=3e-9
    )

    uneven = t + np.where(np.arange(t.size) > 300, 0.4e-3, 0.0)
    bad = table("bad.csv", t_ms=uneven * 1e3, gap_nm=m * 1e9, index_V=index)
    with pytest.raises(DataError, match="not uniform in time"):
        run(text, bad)
    with pytest.raises(DataError, match="index channel"):
        run(
            '[input]\nreadings = ["gap_nm"]\n' + SPINDLE + 'edge = "falling"\n',
            file,
        )


def test_spindle_without_any_angle_says_what_is_needed(table):
    file = table(gap_nm=turning().ravel() * 1e9)
    with pytest.raises(MetrosepError, match="index_V"):
        run('[input]\nreadings = ["gap_nm"]\n' + SPINDLE, file)
