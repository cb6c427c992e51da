"""What the page is told of repeated runs: planted geometry stays, a planted vibration slides."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from metrosep.app.documents import Places
from metrosep.app.run_answers import adjusted_p, feed_waves
from metrosep.app.server import make_app
from metrosep.app.wire import unpack
from metrosep.core._arrays import benjamini_hochberg
from metrosep.core.runset import Run, RunSet
from metrosep.recipe import Recipe

PORT, TOKEN = 8123, "t" * 43
HOST = {"host": f"127.0.0.1:{PORT}"}
MM, NM = 1e-3, 1e-9

TRAVEL = 60 * MM
FEEDS = (0.08, 0.12, 0.16)
GEOMETRY = ((20 * MM, 300 * NM, 0.4), (12 * MM, 150 * NM, -1.1))
"""Wavelength, amplitude, phase: whole numbers of waves in the travel, not symmetric."""

FREQUENCY, SHAKE = 32.0, 60 * NM
"""At the feeds above it lies at 2.5, 3.75 and 5 mm: 24, 16 and 12 waves in the travel."""

RESOLUTION = 1.0
"""Hz: the noise model of runs of some 0.5 s tells frequencies apart by about their inverse."""

AMPLITUDE = 15 * NM
"""Noise, and what the window lets of one wave into the other, at amplitudes of 150 and 300 nm."""

FILE = """metrosep = 1
title = "planted"
[input]
files = ["runs.csv"]
x = "x_mm"
z = "z_nm"
feed = { column = "feed_mm_min", unit = "mm/min" }
run = "run"
[[step]]
op = "separate"
method = "METHOD"
start = "6 mm"
length = "48 mm"
"""


def geometry(x: np.ndarray) -> np.ndarray:
    return np.asarray(sum(a * np.cos(2 * np.pi * x / w + p) for w, a, p in GEOMETRY))


def plant(folder: Path, method: str = "kono", *, ways: tuple[int, ...] = (1,), gap: bool = False):
    """Write six runs for each direction, and their recipe; reverse runs lie 400 nm higher."""
    rng = np.random.default_rng(3)
    lines, number = ["run,x_mm,z_nm,feed_mm_min"], 0
    for way in ways:
        for v in FEEDS:
            for phase in (0.3, 1.4):
                number += 1
                t = np.arange(0.0, TRAVEL / v, 1e-3)
                x = v * t if way > 0 else TRAVEL - v * t
                z = geometry(x) + SHAKE * np.cos(2 * np.pi * FREQUENCY * t + phase)
                z = z + 5 * NM * rng.standard_normal(t.size) + 1e-5 * x
                z = z + (400 * NM if way < 0 else 0.0)
                lost = (x > 30 * MM) & (x < 36 * MM) & (gap and number == 2)
                lines += [
                    f"r{number},{a / MM:.6f},{'' if n else f'{b / NM:.4f}'},{v * 6e4:.1f}"
                    for a, b, n in zip(x, z, lost, strict=True)
                ]
    (folder / "runs.csv").write_text("\n".join(lines) + "\n")
    (folder / "recipe.toml").write_text(FILE.replace("METHOD", method))
    return folder / "recipe.toml"


class Page:
    """The page: sends JSON, unpacks frames."""

    def __init__(self, socket: Any) -> None:
        self.socket, self.number = socket, 0

    def ask(self, k: str, **message: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        self.number += 1
        self.socket.send_text(json.dumps({"id": self.number, "k": k, **message}))
        while "of" in (frame := unpack(self.socket.receive_bytes()))[0]:
            pass
        return frame

    def ok(self, k: str, **message: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        header, arrays = self.ask(k, **message)
        assert header["ok"], header
        return header, arrays

    def refused(self, k: str, **message: Any) -> str:
        header, _ = self.ask(k, **message)
        assert not header["ok"], header
        return str(header["error"]["message"])


@contextmanager
def opened(file: Path) -> Iterator[Page]:
    app = make_app(Places([file.parent]), port=PORT, token=TOKEN, first=str(file))
    with (
        TestClient(app, base_url=f"http://127.0.0.1:{PORT}") as http,
        http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket,
    ):
        page = Page(socket)
        header, _ = page.ok("hello")
        assert header["session"]["kind"] == "runs", header["session"]
        yield page


# ---- waves -----------------------------------------------------------------------------------


@pytest.mark.parametrize("level", ["idle", "full"])
def test_geometry_stays_at_its_wavelength_at_every_feedrate(tmp_path, level):
    with opened(plant(tmp_path)) as page:
        header, arrays = page.ok("waves", level=level)

    assert [f["feed_words"] for f in header["feeds"]] == [
        "4800 mm/min", "7200 mm/min", "9600 mm/min",
    ]  # fmt: skip
    for wavelength, amplitude, _ in GEOMETRY:
        k = int(np.argmin(np.abs(arrays["wavelength"] - wavelength)))
        for i in range(3):
            line = arrays[f"feed_{i}"]
            assert abs(line[k] - amplitude) < AMPLITUDE + 0.1 * amplitude
            assert line[k] == line[k - 1 : k + 2].max()


def test_the_vibration_slides_with_the_feedrate(tmp_path):
    with opened(plant(tmp_path)) as page:
        header, arrays = page.ok("waves", level="full")

    (vibration,) = header["vibrations"]
    assert abs(vibration["frequency"] - FREQUENCY) < RESOLUTION
    for place, v in zip(vibration["at"], FEEDS, strict=True):
        assert place["feed"] == pytest.approx(v, abs=1e-6)
        assert abs(place["wavelength"] - v / FREQUENCY) < v / FREQUENCY * RESOLUTION / FREQUENCY
        assert place["amplitude"] > SHAKE / 4
    # each line has it at its own wavelength and nowhere else
    for i, v in enumerate(FEEDS):
        k = int(np.argmin(np.abs(arrays["wavelength"] - v / FREQUENCY)))
        own = [arrays[f"feed_{j}"][k] for j in range(3)]
        assert own[i] == max(own)
        assert own[i] > 2.5 * sorted(own)[1]


def test_geometry_that_the_method_leaves_is_no_vibration(tmp_path):
    file = plant(tmp_path)
    file.write_text(file.read_text() + 'shortest = "15 mm"\n')  # 12 mm stays in the residual
    with opened(file) as page:
        header, _ = page.ok("waves", level="full")

    places = [v["frequency"] for v in header["vibrations"]]
    assert len(places) == 1
    assert abs(places[0] - FREQUENCY) < RESOLUTION


@pytest.mark.slow
def test_lines_that_were_removed_are_named(tmp_path):
    file = plant(tmp_path, "joint")
    file.write_text(file.read_text() + 'lines = ["32 Hz"]\nshortest = "5 mm"\n')
    with opened(file) as page:
        header, _ = page.ok("waves", level="full")

    lines = [v for v in header["vibrations"] if v["source"] == "line"]
    assert [v["frequency"] for v in lines] == [pytest.approx(32.0, abs=0.2)]
    assert len(header["vibrations"]) == 1


def test_kono_tells_m_and_both_thresholds(tmp_path):
    file = plant(tmp_path)
    with opened(file) as page:
        header, arrays = page.ok("waves", level="full")
    estimate = Recipe.load(file).run(None).estimate

    assert header["m"] == estimate.audit["m"]
    assert f"m = {estimate.audit['m']} waves" in header["words"]
    keys = {s["key"]: (i, s) for i, s in enumerate(header["statistics"])}
    assert set(keys) == {"sigma_t", "p_t"}
    assert keys["sigma_t"][1]["value"] == 0.05e-6  # the paper's 0.05 read in um
    assert keys["p_t"][1]["value"] == 0.01e-6
    assert (keys["sigma_t"][1]["keeps"], keys["p_t"][1]["keeps"]) == ("below", "above")
    assert {s["unit"] for _, s in keys.values()} == {"m"}
    sigma, mean = (arrays[f"statistic_{keys[k][0]}"] for k in ("sigma_t", "p_t"))
    # the paper's rule: the shortest wave that passes, and all longer ones
    passed = (sigma < 0.05e-6) & (mean > 0.01e-6)
    m = int(np.flatnonzero(passed)[-1]) + 1
    assert m == header["m"]
    assert arrays["selected"].astype(bool).tolist() == [k < m for k in range(sigma.size)]
    # mean and deviation over feedrates of the amplitudes of the feeds at the 20 mm wave
    k = int(np.argmin(np.abs(arrays["estimate_wavelength"] - 20 * MM)))
    assert abs(mean[k] - 300 * NM) < 0.1 * 300 * NM
    assert sigma[k] < 0.1 * mean[k]


def test_a_moved_threshold_moves_m(tmp_path):
    with opened(plant(tmp_path)) as page:
        before, _ = page.ok("waves", level="full")
        edit = {"path": ["step", 0, "p_t"], "old": None, "new": 1e-7}
        page.ok("edit", edits=[edit], label="p_t")
        after, arrays = page.ok("waves", level="full")
        page.ok("undo")
        again, _ = page.ok("waves", level="full")

    # only the waves of 300 and 150 nm have a mean above 100 nm
    assert after["m"] < before["m"] == again["m"]
    assert after["stated"]["p_t"] == 1e-7
    last = arrays["estimate_wavelength"][after["m"] - 1]
    assert abs(last - 12 * MM) < 1 * MM


def test_a_stated_shortest_wavelength_switches_the_thresholds_off(tmp_path):
    file = plant(tmp_path)
    file.write_text(file.read_text() + 'shortest = "11 mm"\n')
    with opened(file) as page:
        header, arrays = page.ok("waves", level="full")

    assert header["thresholds_in_use"] is False
    assert header["stated"]["shortest"] == pytest.approx(11 * MM, abs=1e-12)
    assert header["shortest"]["by"] == "set by hand"
    assert header["shortest"]["value"] >= 11 * MM
    assert arrays["estimate_wavelength"][arrays["selected"] == 1].min() >= 11 * MM


def test_a_threshold_that_nothing_passes_is_refused_in_words(tmp_path):
    file = plant(tmp_path)
    file.write_text(file.read_text() + "p_t = 5e-6\n")
    with opened(file) as page:
        said = page.refused("waves", level="full")
        header, arrays = page.ok("waves", level="idle")

    assert "no wavelength has sigma" in said
    assert header["stated"]["p_t"] == 5e-6
    assert arrays["wavelength"].size > 10


def test_joint_tells_the_adjusted_chance_of_each_wave(tmp_path):
    file = plant(tmp_path, "joint")
    file.write_text(file.read_text() + 'shortest = "5 mm"\n')
    with opened(file) as page:
        header, arrays = page.ok("waves", level="full")

    (statistic,) = header["statistics"]
    assert (statistic["key"], statistic["value"], statistic["keeps"]) == (
        "false_discovery_rate", 0.05, "below",
    )  # fmt: skip
    q = arrays["statistic_0"]
    assert (q[arrays["selected"] == 1] <= 0.05).all()
    reasons = [header["reasons"][i] for i in arrays["reason"]]
    noise = [r == "within the noise" for r in reasons]
    assert (q[noise] > 0.05).all()
    peaks = arrays["estimate_amplitude"].argsort()[-2:]
    assert all(arrays["selected"][peaks])
    assert (arrays["low"] <= arrays["estimate_amplitude"]).all()
    half = arrays["high"] - arrays["estimate_amplitude"]
    assert np.abs(half - 2 * arrays["sd"]).max() < 1e-6 * NM


def test_a_joint_separation_tells_what_it_found_about_each_run(tmp_path):
    """Run r3 is moved by + 0.8 mm: it shows the geometry of the place x - 0.8 mm."""
    file = plant(tmp_path, "joint")
    rows = (tmp_path / "runs.csv").read_text().splitlines()
    header, *cells = rows
    moved = []
    for line in cells:
        run, x, z, feed = line.split(",")
        if run == "r3":
            at = float(x) * MM
            z = f"{float(z) + (geometry(at - 0.8 * MM) - geometry(at)) / NM:.4f}"
        moved.append(f"{run},{x},{z},{feed}")
    (tmp_path / "runs.csv").write_text("\n".join([header, *moved]) + "\n")
    file.write_text(file.read_text() + 'shortest = "5 mm"\n')
    with opened(file) as page:
        before, _ = page.ok("curves", level="idle")
        page.ok("waves", level="full")
        header, _ = page.ok("curves", level="full")

    assert "found" not in before
    found = header["found"]
    assert [r["run"] for r in found["runs"]] == [f"r{i}" for i in range(1, 7)]
    odd = found["runs"][2]
    assert "displaced" in odd["finding"]
    assert [r["finding"] for r in found["runs"] if r is not odd] == [""] * 5
    assert odd["shift_mm"] == pytest.approx(0.8, abs=4.0 * odd["u_shift_mm"])
    x = np.array(odd["x_mm"]) * MM
    strip = np.array(odd["strip_nm"], dtype=float)
    # the vibration is in the strip, too
    assert np.corrcoef(strip, geometry(x - 0.8 * MM) - geometry(x))[0, 1] > 0.7
    ((way, phrase),) = found["lag"]
    assert way == ""
    # one displaced run of six, one waves of 5 mm and more: no delay is known, and the average with none is small
    assert "the average over delay and none" in phrase
    assert abs(header["lag"]["value"]) < 0.5 * header["lag"]["u"]
    assert found["messages"] == header["messages"]


def test_kono_compares_runs_and_looks_for_no_delay(tmp_path):
    with opened(plant(tmp_path)) as page:
        page.ok("waves", level="full")
        header, _ = page.ok("curves", level="full")

    assert header["lag"] is None
    assert header["found"]["lag"] == []
    assert all(r["strip_nm"] is None for r in header["found"]["runs"])


def test_adjusted_chances_select_what_the_rule_selects():
    rng = np.random.default_rng(8)
    p = np.concatenate([rng.uniform(size=60), rng.uniform(size=20) ** 6])
    for rate in (0.01, 0.05, 0.2, 0.6):
        assert (adjusted_p(p) <= rate).tolist() == benjamini_hochberg(p, rate=rate).tolist()


def test_the_plain_mean_has_lines_but_no_wavelengths(tmp_path):
    with opened(plant(tmp_path, "mean")) as page:
        header, arrays = page.ok("waves", level="full")

    assert "tells no wavelengths apart" in header["words"]
    assert "estimate_wavelength" not in arrays
    assert "statistics" not in header
    assert arrays["feed_0"].size == arrays["wavelength"].size


def test_a_run_with_a_wide_gap_is_left_out_of_the_lines(tmp_path):
    with opened(plant(tmp_path, "mean", gap=True)) as page:
        header, arrays = page.ok("waves", level="idle")

    assert len(header["feeds"]) == 3
    assert not np.isnan(arrays["feed_0"]).any()


def test_lines_of_very_many_samples_come_with_the_separation():
    x = np.linspace(0.0, 60 * MM, 60_001)
    runs = RunSet([Run(x, geometry(x), feed=f, run_id=str(f)) for f in (0.08, 0.12)])

    found = feed_waves(runs, direction=1)

    assert found.wavelength.size == 0
    assert found.feeds == ()
    assert "come with the separation" in found.part


# ---- curves ----------------------------------------------------------------------------------


def test_the_runs_are_there_before_anything_is_separated(tmp_path):
    with opened(plant(tmp_path)) as page:
        header, arrays = page.ok("curves", level="idle", columns=400)

    assert header["is_preview"]
    assert "separated" not in header
    assert header["range"] == pytest.approx([6 * MM, 54 * MM], abs=1e-12)
    assert "without its least-squares line over 6 ... 54 mm" in header["levelled"]
    assert [r["feed_words"] for r in header["runs"]] == [
        w for w in ("4800 mm/min", "7200 mm/min", "9600 mm/min") for _ in range(2)
    ]
    assert header["stated"]["method"] == "kono"
    assert header["stated"]["shortest"] is None
    for i in range(6):
        x, low, high = (arrays[f"run_{i}_{n}"] for n in ("x", "low", "high"))
        inner = (x > 6 * MM) & (x < 54 * MM)
        rest = (low + high)[inner] / 2 - geometry(x[inner])
        line = np.polyval(np.polyfit(x[inner], rest, 1), x[inner])
        assert np.abs(rest - line).max() < SHAKE + 30 * NM
        assert np.abs(rest + 2 * geometry(x[inner])).max() > 400 * NM


def test_a_gap_of_a_run_is_a_gap_of_its_curve(tmp_path):
    with opened(plant(tmp_path, "mean", gap=True)) as page:
        header, arrays = page.ok("curves", level="idle", columns=200)

    assert [r["not_measured"] > 0 for r in header["runs"]] == [False, True, *[False] * 4]
    for i in range(6):
        x, low = arrays[f"run_{i}_x"], arrays[f"run_{i}_low"]
        inside = (x > 30.4 * MM) & (x < 35.6 * MM)
        assert inside.sum() > 10
        assert np.isnan(low[inside]).all() == (i == 1)
        assert not np.isnan(low[~((x > 29 * MM) & (x < 37 * MM))]).any()


def test_the_separated_error_is_the_geometry_with_its_sign(tmp_path):
    with opened(plant(tmp_path)) as page:
        header, arrays = page.ok("curves", level="full", columns=300, window=[6 * MM, 54 * MM])

    x = arrays["error_0_x"]
    error = (arrays["error_0_low"] + arrays["error_0_high"]) / 2
    truth = geometry(x)
    truth = truth - np.polyval(np.polyfit(x, truth, 1), x)
    # the vibration of one feedrate reaches the estimate as far as its wavelength is kept
    assert np.sqrt(np.mean((error - truth) ** 2)) < 60 * NM
    assert np.sqrt(np.mean((-error - truth) ** 2)) > 300 * NM
    assert header["separated"] == [{"direction": 1}]
    assert header["lost_motion"] is None
    assert header["slope"]["unit"] == "rad"
    assert abs(header["slope"]["value"] - 1e-5) < 3e-6
    assert (arrays["error_0_band_low"] <= arrays["error_0_low"]).all()


def test_what_is_left_is_smaller_than_what_was_there(tmp_path):
    with opened(plant(tmp_path)) as page:
        header, arrays = page.ok("curves", level="full", columns=300, window=[6 * MM, 54 * MM])

    assert [(m["feed_words"], m["n_runs"]) for m in header["means"]] == [
        ("4800 mm/min", 2), ("7200 mm/min", 2), ("9600 mm/min", 2),
    ]  # fmt: skip
    for i in range(3):
        before, after = (
            np.nanmax(np.abs(arrays[f"mean_{i}_{n}_low"])) for n in ("before", "after")
        )
        assert after < 0.6 * before


def test_directions_are_apart_and_lost_motion_is_told(tmp_path):
    with opened(plant(tmp_path, ways=(1, -1))) as page:
        header, _ = page.ok("curves", level="full")
        waves, _ = page.ok("waves", level="full", direction=-1)
        said = page.refused("waves", level="idle", direction=3)

    assert [s["direction"] for s in header["separated"]] == [1, -1]
    assert abs(header["lost_motion"]["value"] - 400 * NM) < 40 * NM
    assert header["lost_motion"]["unit"] == "m"
    assert [m["direction"] for m in header["means"]] == [1, 1, 1, -1, -1, -1]
    assert waves["direction"] == -1
    assert waves["statistics"]
    assert "direction is one of" in said


def test_bad_requests_are_refused(tmp_path):
    with opened(plant(tmp_path)) as page:
        assert "window" in page.refused("curves", window=[2, 1])
        assert "columns" in page.refused("curves", columns=-4)
        assert "level" in page.refused("waves", level="best")


def test_a_map_has_no_runs(tmp_path):
    import metrosep as ms

    ms.write(ms.Surface(np.zeros((9, 9)), 1e-3, 1e-3), tmp_path / "flat.x3p")
    file = tmp_path / "flat.x3p"
    app = make_app(Places([tmp_path]), port=PORT, token=TOKEN, first=str(file))
    with (
        TestClient(app, base_url=f"http://127.0.0.1:{PORT}") as http,
        http.websocket_connect(f"/ws?token={TOKEN}", headers=HOST) as socket,
    ):
        page = Page(socket)
        assert "needs repeated runs" in page.refused("curves")
        assert "needs repeated runs" in page.refused("waves")


# ---- a refused output ------------------------------------------------------------------------

BEYOND = """
[[check]]
metric = "pv"
upper = "10 um"
[[output]]
kind = "table"
controller = "csv"
axis = "X"
compensates = "Z"
spacing = "1 mm"
reference = "200 mm"
path = "x-z.csv"
"""
"""The place of zero correction lies outside the runs: `metrosep run` refuses the table."""


def test_numbers_and_curves_stay_where_only_the_table_is_refused(tmp_path):
    file = plant(tmp_path)
    with opened(file) as page:
        alone, _ = page.ok("metrics", level="full")
        _, curves_alone = page.ok("curves", level="full")
    file.write_text(file.read_text() + BEYOND)
    with opened(file) as page:
        header, _ = page.ok("metrics", level="full")
        _, arrays = page.ok("curves", level="full")
        table, _ = page.ok("table")

    assert "reference" in header["refused"]
    assert header["verdict"] is None  # although pv alone is within its limit
    assert header["rows"] == alone["rows"]
    assert sorted(arrays) == sorted(curves_alone)
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, curves_alone[name])
    assert "reference" in table["refused"]["message"]


def test_what_cannot_be_separated_is_still_refused(tmp_path):
    file = plant(tmp_path)
    file.write_text(file.read_text().replace('length = "48 mm"', 'length = "480 mm"') + BEYOND)
    with opened(file) as page:
        assert "is not covered by every run" in page.refused("metrics", level="full")
