"""Steps along a line and over time: the recipe gives what the call gives, on planted asymmetries."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import InvalidSamplesError, MetrosepError, RecipeError
from metrosep.recipe.describe.describe_tests import separation_of
from metrosep.recipe.result import load_document
from metrosep.separation import (
    ReferenceLine,
    abba,
    drift_against_temperature,
    integrate_slopes,
    iso230_3_drift,
    joint_drift,
    multi_probe_straightness,
    repeatable,
    speed_dependence,
    straightness_iso230_1,
    three_point,
    two_point,
    zero_calibration,
)

X = np.arange(31) * 10e-3
D = 10e-3
TEXT = 1e-13
"""Readings are written with 9 decimals of a nm, and chains add up some of them."""


def edge(x):
    return 200e-9 * np.sin(25 * x + 0.4) + 4e-6 * x**3


def slide(x):
    return 900e-9 * np.cos(11 * x) - 700e-9 * x


def pitch(x):
    return 4e-6 * np.sin(15 * x)


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


def same(found, called):
    assert set(found.parts) == set(called.parts)
    for part in called.parts:
        scale = 1e9 if called.units[part] == "rad" else 1.0
        np.testing.assert_allclose(
            found.parts[part], called.parts[part], rtol=0.0, atol=TEXT * scale
        )


def readings(offsets):
    return np.array([edge(X + o) + slide(X) + o * pitch(X) for o in offsets])


def columns(m):
    return {f"p{i}_nm": v * 1e9 for i, v in enumerate(m)}


def listed(m):
    return "[" + ", ".join(f'"p{i}_nm"' for i in range(len(m))) + "]"


def test_two_point(table):
    m = readings([0.0, D]) - np.array([0.0, 1.0])[:, None] * D * pitch(X)
    text = f'[input]\nreadings = {listed(m)}\nx = "x_mm"\n[[step]]\nop = "two_point"\n'
    file = table(x_mm=X * 1e3, **columns(m))
    result = run(text + 'distance = "10 mm"\nu_reading = "1 nm"\n', file)
    same(result.produced, two_point(m, D, x=X, u_reading=1e-9))
    assert result.document["separation"]["charts"][0]["kind"] == "curves"
    with pytest.raises(RecipeError, match="distance"):
        run(text, file)


@pytest.mark.slow
def test_three_point_with_an_angle_sensor_writes_a_table_for_each_coordinate(table, tmp_path):
    m = readings([0.0, D, 2 * D])
    file = table(x_mm=X * 1e3, **columns(m), pitch_urad=pitch(X) * 1e6)
    text = f"""[input]
readings = {listed(m)}
x = "x_mm"
pitch = "pitch_urad"
[[step]]
op = "three_point"
distance = ["10 mm"]
method = "least_squares"
u_reading = "1 nm"
u_pitch = "0.05 urad"
[[output]]
kind = "parts"
[[output]]
kind = "report"
"""
    result = run(text, file, out=tmp_path / "out")
    called = three_point(
        m, D, x=X, method="least_squares", u_reading=1e-9, pitch=pitch(X), u_pitch=0.05e-6
    )
    same(result.produced, called)
    names = [f.name for f in result.files]
    assert names == ["parts.csv", "parts-carriage_x.csv", "report.html", "result.json"]
    head = (tmp_path / "out" / "parts.csv").read_text("ascii").splitlines()[0]
    assert head == "x_m,artefact_m,u_artefact_m"
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "Parts over carriage position" in page


def test_three_point_with_two_distances_and_a_zero(table):
    m = readings([0.0, D, 4 * D])
    file = table(x_mm=X * 1e3, **columns(m))
    text = f"""[input]
readings = {listed(m)}
x = "x_mm"
[[step]]
op = "three_point"
distance = ["10 mm", "30 mm"]
method = "least_squares"
zero = "5 nm"
u_reading = "1 nm"
"""
    called = three_point(m, (D, 3 * D), x=X, method="least_squares", zero=5e-9, u_reading=1e-9)
    same(run(text, file).produced, called)
    with pytest.raises(MetrosepError, match="one distance, or two"):
        run(text.replace('"30 mm"]', '"30 mm", "1 mm"]'), file)
    with pytest.raises(MetrosepError, match="positions of the carriage"):
        run(text.replace('x = "x_mm"\n', ""), file)


def test_probes_at_any_offsets(table):
    offsets = [0.0, D, 4 * D]
    m = readings(offsets)
    file = table(x_mm=X * 1e3, **columns(m))
    text = f"""[input]
readings = {listed(m)}
x = "x_mm"
[[step]]
op = "multi_probe_straightness"
offsets = ["0 mm", "10 mm", "40 mm"]
zeros_known = true
u_reading = "1 nm"
"""
    called = multi_probe_straightness(m, offsets, x=X, zeros_known=True, u_reading=1e-9)
    same(run(text, file).produced, called)


def test_zero_of_three_probes_over_a_flat(table):
    rng = np.random.default_rng(2)
    m = np.array([0.0, -20e-9, 5e-9])[:, None] + 1e-9 * rng.standard_normal((3, 40))
    text = f'[input]\nreadings = {listed(m)}\n[[step]]\nop = "zero_calibration"\n'
    result = run(
        text + 'distance = ["10 mm"]\nu_flat = "0.5 nm"\n'
        '[[check]]\nmetric = "zero"\nupper = "60 nm"\n',
        table(**columns(m)),
    )
    called = zero_calibration(m, D, flat=0.0, u_flat=0.5e-9)
    assert result.produced.zero == pytest.approx(called.zero, abs=TEXT)
    assert result.verdict == "accept"


def test_slopes_of_several_passes(table):
    rng = np.random.default_rng(5)
    m = 1e-6 * np.sin(12 * X + 0.2) + 2e-8 * rng.standard_normal((3, X.size))
    file = table(x_mm=X * 1e3, **{f"p{i}_urad": v * 1e6 for i, v in enumerate(m)})
    text = '[input]\nreadings = ["p0_urad", "p1_urad", "p2_urad"]\nx = "x_mm"\n'
    text += '[[step]]\nop = "integrate_slopes"\nmethod = "trapezoid"\n'
    result = run(text, file)
    same(result.produced, integrate_slopes(m, X, method="trapezoid"))
    true = -np.cos(12 * X + 0.2)
    true -= np.polyval(np.polyfit(X, true, 1), X)
    assert np.corrcoef(result.produced.height, true)[0, 1] > 0.9  # not upside down
    with pytest.raises(MetrosepError, match='x = "x_mm"'):
        run(text.replace('x = "x_mm"\n', ""), file)


def test_straightness_of_a_motion_averages_repeats(table):
    rng = np.random.default_rng(6)
    repeats = edge(X) + 3e-6 * X + 5e-9 * rng.standard_normal((4, X.size))
    # each run has a zero and an alignment of its own: no straightness, so no share of u
    repeats += 4e-6 * rng.standard_normal((4, 1)) + 2e-6 * rng.standard_normal((4, 1)) * X
    file = table(
        run=np.repeat(np.arange(4.0), X.size), x_mm=np.tile(X * 1e3, 4), z_nm=repeats.ravel() * 1e9
    )
    text = '[input]\nreadings = ["z_nm"]\nx = "x_mm"\nrepeat = "run"\n'
    text += '[[step]]\nop = "straightness_iso230_1"\nreference = "LS"\n'
    text += '[[check]]\nmetric = "MZ"\nupper = "1 um"\n'
    result = run(text, file)
    rest = (repeats - repeats.mean(axis=0)).T
    rest = rest - np.polyval(np.polyfit(X, rest, 1), X[:, None])
    sd = np.sqrt(np.sum(rest**2) / 3 / (X.size - 2) / 4)
    assert 0.8 < sd / 2.5e-9 < 1.2  # 5 nm over 4 runs
    called = straightness_iso230_1(X, repeats.mean(axis=0), reference="LS", sd=float(sd))
    values = {c["metric"]: c for c in result.document["characteristics"]}
    assert values["straightness"]["value"] == pytest.approx(called.value, abs=TEXT)
    assert values["straightness"]["u"] == pytest.approx(called.u, rel=1e-4, abs=0.0)
    assert values["MZ"]["value"] <= values["LS"]["value"]
    assert values["slope_LS"]["value"] == pytest.approx(called.slopes["LS"].value, abs=1e-11)
    assert result.verdict == "accept"
    chart = result.document["separation"]["charts"][0]
    drawn = np.array(chart["panels"][0]["curves"][0]["y"])
    assert np.ptp(drawn) == pytest.approx(called.value, abs=1e-12)


T = np.arange(8) * 30.0
SERIES = (
    np.tile([70e-9, 31e-9, 31e-9, 70e-9], 2) + 1e-9 * np.arange(8) + 0.2e-9 * np.arange(8) ** 2
)


def test_abba_of_rows_in_time(table):
    file = table(t_s=T, z_nm=SERIES * 1e9)
    text = '[input]\nreadings = ["z_nm"]\ntime = "t_s"\n[[step]]\nop = "abba"\n'
    result = run(text, file)
    called = abba(SERIES, t=T)
    assert result.produced.difference == pytest.approx(called.difference, abs=TEXT)
    value = next(c for c in result.document["characteristics"] if c["metric"] == "difference")
    assert value["value"] == pytest.approx(float(called.difference), abs=TEXT)
    assert value["value"] > 30e-9  # A is the higher one
    turned = run(text + 'order = "BAAB"\n', file).produced
    assert turned.difference == pytest.approx(-called.difference, abs=TEXT)


def test_abba_of_curves_in_columns(table):
    curves = [edge(X), slide(X) + 2e-9, slide(X) + 4e-9, edge(X) + 6e-9]
    file = table(x_mm=X * 1e3, **columns(curves))
    text = f'[input]\nreadings = {listed(curves)}\nx = "x_mm"\n[[step]]\nop = "abba"\n'
    result = run(text + 'sd = "1 nm"\n', file)
    np.testing.assert_allclose(result.produced.difference, edge(X) - slide(X), rtol=0.0, atol=TEXT)
    assert result.document["separation"]["charts"][0]["x"]["name"] == "position"
    assert {c["metric"] for c in result.document["characteristics"]} == {
        "difference.pv",
        "difference.rms",
    }
    timed = table("t.csv", t_s=X, **columns(curves))
    with pytest.raises(InvalidSamplesError, match="one column of readings"):
        run(text.replace('x = "x_mm"', 'time = "t_s"'), timed)


def test_joint_drift_with_labels(table):
    labels = ["A", "B", "B", "A", "A", "B", "B", "A"]
    file = table(t_s=T, master=labels, z_nm=SERIES * 1e9)
    text = """[input]
readings = ["z_nm"]
time = "t_s"
label = "master"
[[step]]
op = "joint_drift"
degree = 2
"""
    result = run(text, file)
    called = joint_drift(T, SERIES, labels, degree=2)
    value, _ = called.difference("B", "A")
    found = {c["metric"]: c for c in result.document["characteristics"]}
    assert found["B-A"]["value"] == pytest.approx(float(value), abs=TEXT)
    assert found["B-A"]["value"] == pytest.approx(-39e-9, abs=1e-12)
    assert found["A"]["value"] == pytest.approx(70e-9, abs=1e-12)
    with pytest.raises(MetrosepError, match="times are needed"):
        run(text.replace('time = "t_s"\n', ""), file)


def test_joint_drift_of_curves_in_columns(table):
    curves = [edge(X), slide(X) + 3e-9, edge(X) + 6e-9]
    file = table(x_mm=X * 1e3, **columns(curves))
    text = f"""[input]
readings = {listed(curves)}
x = "x_mm"
[[step]]
op = "joint_drift"
times = ["0 s", "1 min", "2 min"]
labels = ["part", "master", "part"]
reference = "0 s"
"""
    found = run(text, file).produced
    value, _ = found.difference("part", "master")
    np.testing.assert_allclose(value, edge(X) - slide(X), rtol=0.0, atol=TEXT)


def test_drift_after_iso230_3(table):
    t = np.arange(0.0, 4000.0, 50.0)
    channels = {
        "EX0C": 2e-6 * (1 - np.exp(-t / 900)),
        "EZ0C": -5e-6 * (1 - np.exp(-t / 1500)) + 0.3e-6,
    }
    file = table(t_s=t, **{f"{k}_um": v * 1e6 for k, v in channels.items()})
    text = """[input]
time = "t_s"
readings = ["EX0C_um", "EZ0C_um"]
[[step]]
op = "iso230_3_drift"
kind = "spindle"
windows = [["0 min", "20 min"], ["40 min", "60 min"]]
span = "10 min"
sd = "10 nm"
"""
    result = run(text, file)
    called = iso230_3_drift(
        t, channels, kind="spindle", windows=[(0, 1200), (2400, 3600)], span=600, sd=1e-8
    )
    found = {c["metric"]: c for c in result.document["characteristics"]}
    for i in (0, 1):
        for name in channels:
            assert found[f"{name}.range.{i + 1}"]["value"] == pytest.approx(
                called.ranges[name][i].value, abs=1e-14
            )
        assert found[f"combined.{i + 1}"]["value"] == pytest.approx(
            called.combined[i].value, abs=1e-14
        )
    assert found["EZ0C.worst"]["value"] == pytest.approx(called.worst["EZ0C"].value, abs=1e-14)
    with pytest.raises(RecipeError, match="start and an end"):
        run(text.replace('["0 min", "20 min"]', '["0 min"]'), file)
    with pytest.raises(RecipeError, match="time"):
        run(text.replace('time = "t_s"\n', ""), file)


def test_dependence_on_speed_takes_the_numbers_as_they_stand(table):
    speed = np.arange(1.0, 9.0) * 300
    amplitude = 20e-9 + 2e-14 * speed**2 + 1e-10 * (-1) ** np.arange(8)
    file = table(speed_rev_per_min=speed, amplitude_nm=amplitude * 1e9)
    text = '[input]\nspeed = "speed_rev_per_min"\namplitude = "amplitude_nm"\n'
    result = run(text + '[[step]]\nop = "speed_dependence"\n', file)
    called = speed_dependence(speed, amplitude)
    for key in ("c0", "c2"):
        found = next(c for c in result.document["characteristics"] if c["metric"] == key)
        assert found["value"] == pytest.approx(called.coefficients[key].value, rel=1e-6, abs=0.0)
        assert found["u"] == pytest.approx(called.coefficients[key].u, rel=1e-3, abs=0.0)
    with pytest.raises(RecipeError, match="amplitude"):
        run(
            text.replace('amplitude = "amplitude_nm"\n', "")
            + '[[step]]\nop = "speed_dependence"\n',
            file,
        )


def test_displacement_against_temperature(table):
    kelvin = 20.0 + np.linspace(0.0, 3.0, 20)
    z = 1.5e-6 * (kelvin - 20.0) + 1e-8 * (-1) ** np.arange(20)
    file = table(temperature_degC=kelvin, z_um=z * 1e6)
    text = '[input]\ntemperature = "temperature_degC"\ndisplacement = "z_um"\n'
    found = run(text + '[[step]]\nop = "drift_against_temperature"\n', file).produced
    called = drift_against_temperature(kelvin, z)
    assert found.coefficients["c1"].value == pytest.approx(
        called.coefficients["c1"].value, rel=1e-6, abs=0.0
    )


def test_what_repeats_in_several_passes(table):
    rng = np.random.default_rng(7)
    m = edge(X) + 6e-9 * rng.standard_normal((5, X.size))
    text = f'[input]\nreadings = {listed(m)}\nx = "x_mm"\n[[step]]\nop = "repeatable"\n'
    found = run(text, table(x_mm=X * 1e3, **columns(m))).produced
    called = repeatable(m, x=X)
    for part in ("repeatable", "sd"):
        np.testing.assert_allclose(found.parts[part], called.parts[part], rtol=0.0, atol=TEXT)


def test_periodic_error_of_an_interferometer(table):
    x = np.arange(400) * 7e-9
    z = 1e-4 * x + 2e-9 * np.cos(2 * np.pi * x / 316e-9 + 0.7)
    file = table(x_nm=x * 1e9, z_nm=z * 1e9)
    text = '[input]\nposition = "x_nm"\nreading = "z_nm"\n'
    text += '[[step]]\nop = "periodic_error"\nperiod = "316 nm"\nu_reading = "0.1 nm"\n'
    result = run(text, file)
    assert np.ptp(result.produced.periodic) == pytest.approx(4e-9, abs=2e-11)
    bars = next(c for c in result.document["separation"]["charts"] if c["kind"] == "harmonics")
    assert bars["amplitude"][0] == pytest.approx(2e-9, abs=1e-12)
    assert bars["k_name"] == "harmonic k"


def test_long_curves_are_thinned_in_the_document_and_whole_in_the_file(table, tmp_path):
    x = np.arange(40_000) * 1e-5
    slope = 1e-6 * np.sin(40 * x)
    slope[31_234] = 9e-6
    file = table(x_mm=x * 1e3, s_urad=slope * 1e6)
    text = '[input]\nreadings = ["s_urad"]\nx = "x_mm"\n[[step]]\nop = "integrate_slopes"\n'
    text += 'method = "trapezoid"\nu_slope = "0.1 urad"\n[[output]]\nkind = "parts"\n'
    small = run(text, file, out=tmp_path / "small")
    assert (tmp_path / "small" / "result.json").stat().st_size < 1_000_000
    separation = load_document(tmp_path / "small")["separation"]
    assert separation["parts"] == {}
    assert "40000 values" in separation["not_stored"]
    chart = separation["charts"][0]
    assert "Of 40000 samples" in chart["caption"]
    drawn = [v for v in chart["panels"][0]["curves"][0]["y"] if v is not None]
    assert max(drawn) == pytest.approx(float(np.max(small.produced.height)), rel=1e-5, abs=0.0)
    assert min(drawn) == pytest.approx(float(np.min(small.produced.height)), rel=1e-5, abs=0.0)
    rows = (tmp_path / "small" / "parts.csv").read_text("ascii").splitlines()
    assert len(rows) == 40_001


@pytest.mark.parametrize(
    ("step", "probes"),
    [
        (f'op = "three_point"\nzero = "0 nm"\ndistance = ["{D * 1e3} mm"]', 3),
        (f'op = "two_point"\ndistance = "{D * 1e3} mm"', 2),
    ],
)
def test_the_straightness_of_a_carriage_does_not_depend_on_how_the_edge_lies(table, step, probes):
    found = []
    for lie in (0.0, 3e-6, -8e-6):  # rad; the readings cannot tell it from the way of the carriage
        at = [edge(X + k * D) + lie * (X + k * D) + slide(X) for k in range(probes)]
        at = [v + k * D * pitch(X) * (probes > 2) for k, v in enumerate(at)]
        file = table(x_mm=X * 1e3, **{f"p{k}_nm": v * 1e9 for k, v in enumerate(at)})
        names = ", ".join(f'"p{k}_nm"' for k in range(probes))
        result = run(
            f'[input]\nreadings = [{names}]\nx = "x_mm"\n[[step]]\n{step}\nu_reading = "1 nm"',
            [file],
        )
        metrics = {c["metric"]: c for c in result.document["characteristics"]}
        found.append(metrics["straightness.pv"])

    def about_its_line(z):
        return z - np.polynomial.Polynomial.fit(X, z, 1)(X)

    def answer(m):  # what a reading of 1 m does to the curve about its line
        if probes == 2:
            return about_its_line(two_point(m, D, x=X, u_reading=0.0).straightness)
        return about_its_line(three_point(m, D, x=X, zero=0.0, u_reading=0.0).straightness)

    line = about_its_line(slide(X))
    ones = np.eye(probes * X.size).reshape(-1, probes, X.size) * 1e-3
    J = np.array([answer(m) for m in ones]) / 1e-3
    u = 1e-9 * np.linalg.norm(J[:, np.argmax(line)] - J[:, np.argmin(line)])
    for pv in found:
        assert pv["value"] == pytest.approx(
            np.ptp(line), abs=2e-12
        )  # rounding of the file, in chains
        assert pv["u"] == pytest.approx(u, abs=0.01 * u)  # 60 modes hold 1e-4 of the variance


def test_a_curve_whose_line_is_defined_keeps_it(table):
    """End points and least squares give 625 and 661 nm; where the line is arbitrary nobody says which."""
    x = np.linspace(0.0, 1.0, 11)
    z = 1e-6 * x**2 * (1 + x)
    slopes = (np.subtract.outer(z, z) / (np.subtract.outer(x, x) + np.eye(11))).ravel()
    slope_of = {"EP": z[-1] - z[0], "LS": np.polyfit(x, z, 1)[0]}
    widths = {k: np.ptp(z - s * x) for k, s in slope_of.items()}
    for line, width in widths.items():
        made = ReferenceLine(tuple(x), line).separate([z])
        assert f"straightness P-V {width * 1e9:.3g} nm" in repr(made)
        metrics = separation_of(made).quantities
        assert metrics["straightness.pv"].value == pytest.approx(width, abs=1e-15)
        assert made.audit[f"STR_{line}_um"] == pytest.approx(width * 1e6, abs=1e-9)
    assert widths["LS"] - widths["EP"] > 30e-9
    file = table(x_mm=x * 1e3, z_nm=z * 1e9)
    for line, width in {**widths, "MZ": min(np.ptp(z - s * x) for s in slopes)}.items():
        text = '[input]\nreadings = ["z_nm"]\nx = "x_mm"\n[[step]]\nop = "straightness_iso230_1"\n'
        document = run(text + f'reference = "{line}"\n', file).document
        found = {c["metric"]: c["value"] for c in document["characteristics"]}
        assert found["straightness"] == pytest.approx(width, abs=TEXT)
