"""Two results side by side: pinned, stored, or another file by the same recipe."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.compare_answers import compare, difference_of, grid_words
from metrosep.app.documents import Edit, Places
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError, MetrosepError, ReadError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.recipe.pipeline import CancelledError

STEP = 1e-3
ROUNDING = 1e-15
"""m: sums and differences of heights of micrometres in double precision."""


def heights(bump=3e-6):
    y, x = np.mgrid[:41, :51] * STEP
    z = bump * np.exp(-(((x - 12e-3) / 4e-3) ** 2) - ((y - 30e-3) / 4e-3) ** 2) + 1e-4 * x
    z[5, 40] = np.nan
    return z


def part(path, bump=3e-6, step=STEP, cut=0):
    z = heights(bump)
    ms.write(Surface(z[:, : z.shape[1] - cut], step, step), path)
    return path


@pytest.fixture
def session(tmp_path):
    made = Session(Places([tmp_path]))
    made.open(str(part(tmp_path / "a.x3p")))
    return made


def ask(session, cancel=lambda: False, **message):
    return compare(session, {"k": "compare", **message}, cancel, lambda news: None)


def by_metric(header):
    return {r["metric"]: r for r in header["rows"]}


def level_off(session):
    session.edit([Edit(("step", 0, "enabled"), None, False)])


# ---- pinned ----------------------------------------------------------------------------------


def test_a_pinned_result_stays_when_the_recipe_changes(session):
    header, _ = ask(session, pin="levelled")
    assert header["pins"] == ["levelled"]
    level_off(session)
    header, _ = ask(session, against={"pin": "levelled"})
    row = by_metric(header)["Sz"]
    flat = heights()
    y, x = np.mgrid[:41, :51]
    ok = ~np.isnan(flat)
    design = np.stack([np.ones(ok.sum()), x[ok], y[ok]], axis=1)
    left = flat[ok] - design @ np.linalg.lstsq(design, flat[ok], rcond=None)[0]

    assert header["names"] == ["levelled", "present"]
    assert row["value_a"] == pytest.approx(np.ptp(left), abs=1e-12)
    assert row["value_b"] == pytest.approx(np.ptp(flat[ok]), abs=1e-12)
    assert row["difference"] == pytest.approx(row["value_b"] - row["value_a"], abs=ROUNDING)
    assert "+enabled = false" in header["recipe"]
    assert by_metric(header)["tilt_x"]["message"] == "only in levelled"


def test_the_difference_map_is_present_minus_other_after_the_steps_of_each(session):
    """Only the plane was taken from one of them: the difference is that plane."""
    ask(session, pin="levelled")
    level_off(session)
    header, _ = ask(session, against={"pin": "levelled"})
    assert (header["shown"], header["refused"]) == ("map", "")
    pinned = session.evaluations.outcome([{"op": "form", "form": "plane"}], "full").after(-1)
    expected = heights() - pinned.z
    picture, arrays = ask(session, against={"pin": "levelled"}, picture={"pixels": [51, 41]})

    assert picture["pv"] == pytest.approx(np.nanmax(expected) - np.nanmin(expected), abs=1e-12)
    assert picture["share_valid"] == pytest.approx(1 - 1 / (41 * 51), abs=1e-12)
    low, high = picture["range"]
    assert low == -high < 0  # about the mean, which the title has
    assert high <= picture["pv"]
    given = {"pixels": [51, 41], "range": [0.0, 1e-9]}
    assert ask(session, against={"pin": "levelled"}, picture=given)[0]["range"] == (0.0, 1e-9)
    index = arrays["index"]
    assert index.shape == (41, 51)
    assert index[40 - 5, 40] == 0  # not measured: row 0 is the largest y
    assert index[20, 50] > index[20, 0]  # +100 um per m along x


def test_labels_are_refused_when_taken_unknown_or_too_many(session):
    ask(session, pin="one")
    with pytest.raises(DataError, match="pinned under this label; choose"):
        ask(session, pin="one")
    with pytest.raises(DataError, match="there are one"):
        ask(session, against={"pin": "two"})
    for k in range(5):
        ask(session, pin=f"p{k}")
    with pytest.raises(DataError, match="6 results are pinned"):
        ask(session, pin="more")
    header, _ = ask(session, unpin="one")
    assert "one" not in header["pins"]
    with pytest.raises(DataError, match="a label has"):
        ask(session, pin="x" * 61)
    with pytest.raises(DataError, match="no result is pinned"):
        ask(session, unpin="one")


# ---- stored, and other files -----------------------------------------------------------------


def test_a_stored_result_of_the_same_run_has_no_difference(session, tmp_path):
    opened, document = session.need()
    document.recipe.run(list(opened.files), out=tmp_path / "out")
    header, _ = ask(session, against={"result": str(tmp_path / "out" / "result.json")})

    assert header["equal"]
    assert header["recipe"] == []
    assert {r["difference"] for r in header["rows"]} == {0.0}
    assert header["shown"] is None
    assert "no samples at full resolution" in header["refused"]


def test_another_file_by_the_same_recipe(session, tmp_path):
    """The bump is 1 um higher: so is the difference of the maps, less what the planes take."""
    other = part(tmp_path / "b.x3p", bump=2e-6)
    header, _ = ask(session, against={"files": [str(other)]})
    picture, _ = ask(session, against={"files": [str(other)]}, picture={})

    assert header["names"] == ["b.x3p", "present"]
    assert header["recipe"] == []
    assert any("only in b.x3p: b.x3p" in line for line in header["inputs"])
    assert picture["pv"] == pytest.approx(1e-6, abs=0.1e-6)
    assert by_metric(header)["Sz"]["difference"] > 0.9e-6


@pytest.mark.parametrize(
    ("change", "words"),
    [({"cut": 1}, "50 x 41 and 51 x 41 samples"), ({"step": 1.1e-3}, "dx is 1.1 mm and 1 mm")],
)
def test_other_grids_are_refused_by_name_and_numbers_stay(session, tmp_path, change, words):
    other = part(tmp_path / "b.x3p", **change)
    header, _ = ask(session, against={"files": [str(other)]})

    assert header["shown"] is None
    assert words in header["refused"]
    assert by_metric(header)["Sz"]["difference"] is not None
    with pytest.raises(DataError, match="the grids differ"):
        ask(session, against={"files": [str(other)]}, picture={})


def test_u_of_the_difference_decides_what_exceeds(session, tmp_path):
    """sqrt(30^2 + 40^2) = 50 nm; the planes leave a difference of about 1 um."""
    session.edit([Edit(("check", 0), None, {"metric": "Sz", "upper": "5 um", "U": "30 nm"})])
    ask(session, pin="before")
    session.edit([Edit(("check", 0, "U"), "30 nm", "40 nm")])
    header, _ = ask(session, against={"pin": "before"})
    row = by_metric(header)["Sz"]
    assert row["U"] == pytest.approx(50e-9, abs=ROUNDING)
    assert row["exceeds"] is False
    assert row["verdict_a"] == row["verdict_b"] == "accept"
    level_off(session)
    row = by_metric(ask(session, against={"pin": "before"})[0])["Sz"]
    assert row["exceeds"] is True


def test_profiles_are_overlaid(tmp_path):
    x = np.arange(200) * 1e-4
    wave = 1e-6 * np.sin(2 * np.pi * x / 4e-3)
    for name, factor in (("a", 1.0), ("b", 3.0)):
        rows = "\n".join(
            f"{p:.10g},{z:.10g}" for p, z in zip(x * 1e3, factor * wave * 1e6, strict=True)
        )
        (tmp_path / f"{name}.csv").write_text(f"x_mm,z_um\n{rows}\n", "ascii")
    session = Session(Places([tmp_path]))
    session.open(str(tmp_path / "a.csv"), {"x": "x_mm", "z": "z_um"})
    header, arrays = ask(session, against={"files": [str(tmp_path / "b.csv")]})

    assert (header["shown"], header["refused"]) == ("curves", "")
    assert arrays["a_low"] == pytest.approx(3 * arrays["b_low"], abs=1e-12)
    assert arrays["difference_low"] == pytest.approx(-2 * arrays["b_low"], abs=1e-12)


def test_rankings_are_compared_by_their_numbers(tmp_path):
    (tmp_path / "r.toml").write_text(
        'metrosep = 1\n[[step]]\nop = "rank"\nmachine = "fts_lathe"\nradius = "20 mm"\n'
        'form = "toric: Rb=265 mm, Rd=132.5 mm"\nerrors = { EXX = "1 um", EYX = "1 um" }\n'
    )
    session = Session(Places([tmp_path]))
    session.open(str(tmp_path / "r.toml"))
    ask(session, pin="1 um")
    session.edit([Edit(("step", 0, "errors", "EXX"), "1 um", "2 um")])
    header, _ = ask(session, against={"pin": "1 um"})
    row = by_metric(header)["sq.EXX"]

    assert row["value_b"] == pytest.approx(2 * row["value_a"], abs=ROUNDING)
    assert header["shown"] is None
    assert header["refused"] == ""
    with pytest.raises(DataError, match="reads no file"):
        ask(session, against={"files": [str(tmp_path / "r.toml")]})


def test_bad_requests_have_words(session, tmp_path):
    with pytest.raises(ReadError, match="outside the folders"):
        ask(session, against={"result": "/etc/hostname"})
    with pytest.raises(DataError, match="nothing is chosen to compare with"):
        ask(session, against={"pin": "a", "result": "b"})
    with pytest.raises(DataError, match="nothing is chosen to compare with"):
        ask(session, against={"folder": "b"})
    (tmp_path / "torn.json").write_text('{"schema": "metrosep.re')
    with pytest.raises(MetrosepError, match="not JSON"):
        ask(session, against={"result": str(tmp_path / "torn.json")})
    (tmp_path / "x.json").write_text(json.dumps({"schema": "other"}))
    with pytest.raises(MetrosepError, match="not a result of metrosep"):
        ask(session, against={"result": str(tmp_path / "x.json")})
    with pytest.raises(DataError, match="one file at a time"):
        ask(session, against={"files": [str(tmp_path / "a.x3p")] * 2})
    (tmp_path / "p.csv").write_text(
        "x_mm,z_um\n" + "".join(f"{k},{k * k % 7}\n" for k in range(30))
    )
    with pytest.raises(MetrosepError):
        ask(session, against={"files": [str(tmp_path / "p.csv")]})
    level_off(session)
    with pytest.raises(CancelledError):
        ask(session, pin="never", cancel=lambda: True)
    assert ask(session)[0]["pins"] == []


# ---- differences -----------------------------------------------------------------------------


def test_difference_has_the_sign_and_the_gaps_of_both():
    a = Surface([[1.0, np.nan, 3.0]], 1e-3, 1e-3)
    b = Surface([[5.0, 1.0, np.nan]], 1e-3, 1e-3)
    left = difference_of(a, b).z

    assert left[0, 0] == 4.0
    assert np.isnan(left[0, 1:]).all()
    with pytest.raises(TooFewSamplesError):
        difference_of(a, Surface([[np.nan, 1.0, np.nan]], 1e-3, 1e-3))


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [
        (Surface([[0.0, 1.0]], 1e-3, 1e-3), Surface([[0.0, 1.0]], None, None), "known of one"),
        (
            Surface([[0.0, 1.0]], 1e-3, 1e-3),
            Surface([[0.0, 1.0]], 1e-3, 1e-3, origin=(1e-3, 0.0)),
            "the x of their first pixels is 1 mm apart",
        ),
        (Surface([[0.0, 1.0]], 1e-3, 1e-3), Surface([[0.0, 1.0]], 1e-3, 2e-3), "dy is 1 mm and 2"),
        (Profile([0.0, 1e-3], [0.0, 1.0]), Profile([0.0, 2e-3], [0.0, 1.0]), "up to 1 mm apart"),
    ],
)
def test_grids_that_differ_are_named(a, b, words):
    assert words in grid_words(a, b)
    with pytest.raises(DataError, match="the grids differ"):
        difference_of(a, b)


def test_a_map_and_a_profile_have_no_difference():
    with pytest.raises(DataError, match="one is a Profile and the other a Surface"):
        difference_of(Profile([0.0, 1e-3], [0.0, 1.0]), Surface([[0.0, 1.0]], 1e-3, 1e-3))


# ---- runs ------------------------------------------------------------------------------------


def runs(path, amplitude):
    """Three runs of 40 mm at one feedrate: a wave of 8 mm that keeps its place, and some noise."""
    rng = np.random.default_rng(8)
    x = np.linspace(0.0, 40e-3, 401)
    rows = ["run,x_mm,z_um,feed_mm_min"]
    for k in range(3):
        z = amplitude * np.sin(2 * np.pi * x / 8e-3) + 2e-9 * rng.standard_normal(x.size)
        rows += [f"{k},{1e3 * a:.6g},{1e6 * b:.8g},1200" for a, b in zip(x, z, strict=True)]
    path.write_text("\n".join(rows) + "\n", "ascii")
    return path


def test_separated_errors_are_overlaid_and_subtracted(tmp_path):
    """The wave is 1 um beside 0.4 um: the difference is a wave of 0.6 um."""
    runs(tmp_path / "a.csv", 1e-6)
    runs(tmp_path / "b.csv", 0.4e-6)
    (tmp_path / "mean.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["a.csv"]\nx = "x_mm"\nz = "z_um"\nrun = "run"\n'
        'feed = "feed_mm_min"\n[[step]]\nop = "separate"\nmethod = "mean"\n',
        "utf-8",
    )
    session = Session(Places([tmp_path]))
    session.open(str(tmp_path / "mean.toml"))
    header, arrays = ask(session, against={"files": [str(tmp_path / "b.csv")]})
    inner = (arrays["difference_x"] > 2e-3) & (arrays["difference_x"] < 38e-3)
    x, left = arrays["difference_x"][inner], arrays["difference_low"][inner]
    wave = np.sin(2 * np.pi * x / 8e-3)

    assert (header["shown"], header["refused"]) == ("curves", "")
    assert 2 * np.mean(left * wave) == pytest.approx(0.6e-6, abs=0.01e-6)
    assert arrays["difference_low"] == pytest.approx(
        arrays["b_low"] - arrays["a_low"], abs=ROUNDING, nan_ok=True
    )


def test_a_stored_separation_holds_its_curve(tmp_path):
    runs(tmp_path / "a.csv", 1e-6)
    (tmp_path / "mean.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["a.csv"]\nx = "x_mm"\nz = "z_um"\nrun = "run"\n'
        'feed = "feed_mm_min"\n[[step]]\nop = "separate"\nmethod = "mean"\n',
        "utf-8",
    )
    session = Session(Places([tmp_path]))
    session.open(str(tmp_path / "mean.toml"))
    opened, document = session.need()
    document.recipe.run(list(opened.files), out=tmp_path / "out")
    header, arrays = ask(session, against={"result": str(tmp_path / "out" / "result.json")})

    assert header["equal"]
    assert float(np.abs(arrays["difference_low"]).max()) == 0.0


# ---- side by side ------------------------------------------------------------------------------


def test_both_maps_are_drawn_in_colours_that_they_share(session):
    ask(session, pin="levelled")
    level_off(session)
    header, _ = ask(session, against={"pin": "levelled"})
    assert header["maps"] is True
    pictures = {
        side: ask(session, against={"pin": "levelled"}, picture={"of": side, "pixels": [51, 41]})
        for side in "ab"
    }
    (first, drawn_a), (second, drawn_b) = pictures["a"], pictures["b"]
    assert first["range"] == second["range"]
    assert first["extent"] == second["extent"]
    tilted, flat = (np.ptp(d["index"][d["index"] > 0].astype(int)) for d in (drawn_b, drawn_a))
    assert tilted > flat  # the present one has its slope of 5 um
    # y up: the bump lies in the upper part of both, the gap at lower right
    for drawn in (drawn_a, drawn_b):
        assert drawn["index"][-1 - 5, 40] == 0
        assert (drawn["index"] == 0).sum() == 1


def test_maps_of_another_grid_still_stand_side_by_side(session, tmp_path):
    other = part(tmp_path / "b.x3p", cut=5)
    header, _ = ask(session, against={"files": [str(other)]})
    assert (header["shown"], header["maps"]) == (None, True)
    assert "samples" in header["refused"]
    picture, _ = ask(session, against={"files": [str(other)]}, picture={"of": "a"})
    assert picture["extent"][2] == pytest.approx(45.5e-3, abs=1e-9)
