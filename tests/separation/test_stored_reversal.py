"""Reversal of stored estimates by its name: command line, recipe and function; drift of the edge."""

import json
import re

import numpy as np
import pytest
from contracts.estimates import LENGTH, NM, X, known

from metrosep.cli.main import main
from metrosep.compensation import CompensationTable, fit_polynomial
from metrosep.errors import DataError
from metrosep.separation import (
    ErrorEstimate,
    Separation,
    separate,
    slide_error,
    straightedge_reversal,
)

pytestmark = pytest.mark.usefixtures("separations_once", "without_figures")

PM = 1e-12
EDGE = 80 * NM * np.exp(-(((X - 12e-3) / 4e-3) ** 2))
"""A bump left of the middle: upside down or mirrored it is another curve."""

SLIDE = 150 * NM * (X / LENGTH) ** 3


def flat(z, x):
    return z - np.polyval(np.polyfit(x - x.mean(), z, 1), x - x.mean())


def pair():
    first, _ = known(error=flat(EDGE + SLIDE, X), seed=1)
    second, _ = known(error=flat(EDGE - SLIDE, X), seed=2)
    return first, second


def test_registration_drift_and_a_common_part_are_terms_of_their_own():
    plain = straightedge_reversal(*pair())
    stated = straightedge_reversal(*pair(), u_registration=20e-6, u_drift=6 * NM, u_common=9 * NM)

    x = plain.coordinates["x"]
    more = {n: stated.u[n] ** 2 - plain.u[n] ** 2 for n in plain.parts}
    slope = np.gradient(flat(np.interp(x, X, EDGE), x), x)
    shift = (slope * 20e-6 / 2) ** 2
    # 0.1 % of the greatest: the edge is straight between the positions of the estimate
    near = 1e-3 * shift.max()
    np.testing.assert_allclose(more["machine"], shift + (3 * NM) ** 2, rtol=0, atol=near)
    np.testing.assert_allclose(
        more["artefact"], shift + (3 * NM) ** 2 + (9 * NM) ** 2, rtol=0, atol=near
    )
    assert stated.audit["u_drift_nm"] == pytest.approx(6.0, abs=1e-9)
    assert stated.audit["u_common_nm"] == pytest.approx(9.0, abs=1e-9)
    np.testing.assert_allclose(
        np.diag(stated.covariance("machine")), stated.u["machine"] ** 2, rtol=1e-9, atol=0
    )
    # a shift of the edge moves both flanks of its bump against each other
    left, right = np.argmax(slope), np.argmin(slope)
    only = straightedge_reversal(*pair(), u_registration=20e-6)
    gain = only.covariance("machine") - plain.covariance("machine")
    expected = slope[left] * slope[right] * (20e-6 / 2) ** 2
    assert expected < 0
    assert gain[left, right] == pytest.approx(expected, rel=0.05, abs=0)


def test_readings_take_the_same_terms():
    m1, m2 = EDGE + SLIDE, EDGE - SLIDE
    plain = straightedge_reversal(m1, m2, x=X, u_reading=NM)
    stated = straightedge_reversal(m1, m2, x=X, u_reading=NM, u_drift=6 * NM, u_common=9 * NM)

    more = {n: stated.u[n] ** 2 - plain.u[n] ** 2 for n in plain.parts}
    np.testing.assert_allclose(more["machine"], (3 * NM) ** 2, rtol=1e-9, atol=0)
    np.testing.assert_allclose(more["artefact"], 90 * NM**2, rtol=1e-9, atol=0)


@pytest.mark.parametrize("name", ["reversal_of_estimates", "straightedge_reversal"])
def test_the_name_makes_what_the_function_makes(name):
    found = separate(list(pair()), method=name, u_drift="6 nm")

    same = straightedge_reversal(*pair(), u_drift=6 * NM)
    np.testing.assert_allclose(found.machine, same.machine, rtol=0, atol=PM)
    np.testing.assert_allclose(found.u["machine"], same.u["machine"], rtol=1e-12, atol=0)


@pytest.mark.parametrize("u", [-NM, np.nan, np.inf])
def test_a_drift_that_is_no_length_is_refused(u):
    with pytest.raises(DataError, match="u_drift"):
        straightedge_reversal(*pair(), u_drift=u)


@pytest.mark.parametrize("n", [1, 3])
def test_two_results_are_needed(n):
    first = pair()[0]

    with pytest.raises(DataError, match=r"2|two"):
        separate([first] * n, method="reversal_of_estimates")


def test_u_of_a_difference_is_that_of_the_covariance_known_outside():
    estimate, whole = known(seed=3)
    x, zero = X[::60], X[300]
    i = np.searchsorted(X, x)

    found = estimate.u_of_difference(x, zero)

    expected = np.sqrt(np.diag(whole)[i] + whole[300, 300] - 2 * whole[300, i])
    # 0.02 nm: straight lines between nodes, and modes cut at 1e-4 of the variance
    np.testing.assert_allclose(found, expected, rtol=0.02, atol=0.02 * NM)
    assert found[x == zero].tolist() == [0.0]
    assert np.isnan(estimate.u_of_difference([2 * LENGTH], zero)).all()
    assert estimate.u_of_difference([], zero).size == 0


def test_what_is_no_reversal_has_no_slide():
    with pytest.raises(DataError, match="straightedge_reversal"):
        slide_error(pair()[0])


def slide(x):
    return 250 * NM * np.cos(2 * np.pi * x / 12e-3 + 0.4) + 90 * NM * np.sin(2 * np.pi * x / 37e-3)


def edge(x):
    return 120 * NM * np.exp(-(((x - 15e-3) / 6e-3) ** 2))


def write_runs(folder, sign, seed):
    """Files of 6 runs over the edge plus or minus the slide, with a vibration of random phase."""
    rng = np.random.default_rng(seed)
    folder.mkdir()
    files = []
    for i, feed in enumerate((0.08, 0.08, 0.12, 0.12, 0.16, 0.16)):
        t = np.arange(0.0, 56e-3 / feed, 2e-3)
        x = feed * t
        z = edge(x) + sign * slide(x) + 20 * NM * rng.standard_normal(x.size)
        z += (
            80 * NM * np.sin(2 * np.pi * 47.0 * t + rng.uniform(0, 6))
            + 1e-6 * rng.standard_normal()
        )
        rows = np.column_stack([t, x * 1e3, z * 1e9])
        files.append(str(folder / f"run{i}.csv"))
        np.savetxt(files[-1], rows, delimiter=",", header="time_s,x_mm,z_nm", comments="")
    return files


def command(*words):
    try:
        return main(list(words))
    except SystemExit as exc:
        return exc.code


def test_from_runs_to_the_slide_at_the_command_line(tmp_path, capsys):
    results = []
    for name, sign, seed in (("before", 1.0, 5), ("after", -1.0, 6)):
        files, out = write_runs(tmp_path / name, sign, seed), tmp_path / f"{name}_out"
        columns = ("--x", "x_mm", "--z", "z_nm", "--time", "time_s")
        code = command("separate", *files, *columns, "--poly", "2", "-o", str(out))
        said = capsys.readouterr().err
        assert not code, said
        assert "u of the polynomial: up to" in said
        results.append(str(out / "result.json"))
    document = json.loads((tmp_path / "before_out" / "result.json").read_text())
    out = tmp_path / "reversed"

    code = command(
        "separate", *results, "--method", "reversal_of_estimates", "--set", "u_drift=1 nm",
        "-o", str(out),
    )  # fmt: skip

    assert not code, capsys.readouterr().err
    same = tmp_path / "same"
    by_function = ("--method", "straightedge_reversal", "--set", "u_drift=1 nm", "-o", str(same))
    folders = [str(tmp_path / name) for name in ("before_out", "after_out")]
    assert not command("separate", *folders, *by_function), capsys.readouterr().err
    assert (same / "parts.csv").read_bytes() == (out / "parts.csv").read_bytes()
    assert document["polynomial"]["u_greatest_m"] > 0.0
    assert ErrorEstimate.from_dict(document["estimate"]).has_covariance
    found = Separation.from_dict(json.loads((out / "result.json").read_text())["separation"])
    x = found.coordinates["x"]
    assert found.audit["u_from"].startswith("covariance of the two estimates")
    for part, truth in (("machine", slide(x)), ("artefact", edge(x))):
        u = found.u[part]
        error = found.parts[part] - flat(truth, x)
        assert np.isfinite(u).all()
        # A few long waves decide one set: its RMS may be off by chance, but not by 2.5.
        assert np.sqrt(np.mean(error**2)) < 2.5 * np.sqrt(np.mean(u**2))
        assert np.sqrt(np.mean(error**2)) < 15 * NM
        np.testing.assert_allclose(np.diag(found.covariance(part)), u**2, rtol=1e-9, atol=0)
    set_ups = "before: before_out (run0.csv, run1.csv, run2.csv, run3.csv, run4.csv, run5.csv), after: after_out ("
    assert any(m.startswith(set_ups) for m in found.messages)
    # no runs read the slide alone: its table is judged by what was found
    cells = tmp_path / "slide.csv"
    code = command("table", str(out), "--axis", "Y", "--compensates", "Z", "--format", "csv",
                   "--spacing", "1 mm", "-o", str(cells))  # fmt: skip
    said = capsys.readouterr().err
    assert not code, said
    assert "predicted, not shown" in said
    u = np.sqrt(np.mean(found.u["machine"] ** 2)) / NM
    (left, known_to) = re.findall(r"-> (\S+) nm \(predicted.* u = (\S+) nm RMS", said)[0]
    assert float(known_to) == pytest.approx(u, rel=0.05, abs=0.0)
    assert float(left) > float(known_to)  # straight lines over 1 mm come on top
    assert " 0 nm" not in said
    assert " 0.0 nm" not in said
    assert set_ups in said  # the other order gives the other sign
    assert set_ups in (tmp_path / "slide.csv.json").read_text()
    place, added = np.loadtxt(cells, delimiter=",", skiprows=1, usecols=(0, 1)).T
    left = slide(place * 1e-3) + added * 1e-6
    assert np.std(flat(left, place)) < 0.1 * np.std(slide(x))
    assert np.std(flat(slide(place * 1e-3) - added * 1e-6, place)) > np.std(slide(x))


def test_results_of_the_same_runs_are_refused_at_the_command_line(tmp_path, capsys):
    files, out = write_runs(tmp_path / "runs", 1.0, 5), tmp_path / "out"
    columns = ("--x", "x_mm", "--z", "z_nm", "--time", "time_s")
    assert not command("separate", *files, *columns, "--method", "mean", "-o", str(out))
    result = str(out / "result.json")
    capsys.readouterr()

    code = command("separate", result, result, "--method", "reversal_of_estimates")

    assert code
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert "same" in said


def test_the_slide_of_a_reversal_is_an_error_with_its_covariance():
    found = straightedge_reversal(*pair())

    error = slide_error(found)

    x = found.coordinates["x"]
    np.testing.assert_allclose(error.evaluate(x), found.machine, rtol=0, atol=PM)
    # 1 % of a variance: straight lines between nodes
    whole = found.covariance("machine")
    np.testing.assert_allclose(error.covariance(x), whole, rtol=0, atol=0.01 * whole.max())
    assert np.isfinite(fit_polynomial(error, degree=3).u_coefficients).all()
    with pytest.raises(DataError, match="slope"):
        CompensationTable.from_error(error, axis="X", compensates="X")


def test_readings_without_estimates_have_no_error_of_an_axis():
    with pytest.raises(DataError, match="covariance"):
        slide_error(straightedge_reversal(EDGE + SLIDE, EDGE - SLIDE, u_reading=NM))
