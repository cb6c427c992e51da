"""`metrosep check`: every oddity is planted, and the same object without it gives no finding."""

import json
import re
import shlex

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.io.check import check_file, check_object

pytestmark = pytest.mark.usefixtures("without_figures")


@pytest.fixture
def rough(rng):
    """A rough surface without oddities, and a way to spoil it."""
    z = 50e-9 * rng.standard_normal((60, 80))

    def make(change=None, *, dx=1e-6, dy=1e-6, **metadata):
        heights = z.copy()
        if change is not None:
            change(heights)
        return ms.Surface(heights, dx, dy, metadata=metadata)

    return make


def code_of(*words):
    with pytest.raises(SystemExit) as caught:
        main(list(words))
    return caught.value.code


def problems(obj):
    return [(f.level, f.problem) for f in check_object(obj)]


def only(obj):
    found = check_object(obj)
    assert len(found) == 1, found
    assert found[0].fix
    return found[0]


def test_a_good_surface_has_no_findings(rough):
    assert check_object(rough()) == ()


def test_many_invalid_points(rough):
    def hole(z):
        z[:6] = np.nan

    def crater(z):
        z[:40] = np.nan

    assert only(rough(hole)).problem == "10.0% of 4800 points were not measured"
    assert only(rough(hole)).level == "warning"
    assert only(rough(crater)).level == "error"


def test_clipped_on_one_side_only(rough):
    def clip(z):
        np.minimum(z, 80e-9, out=z)

    finding = only(rough(clip))

    assert "exactly the largest" in finding.problem
    assert "clipped or saturated" in finding.problem


def test_coarse_steps_of_a_converter_are_not_clipping():
    wave = np.round(20 * np.sin(np.linspace(0, 60, 4000))) * 1e-9

    assert check_object(ms.Profile(np.arange(4000) * 1e-6, wave)) == ()


def test_a_flat_map_is_an_error(rough):
    def flat(z):
        z[:] = 1e-9

    assert only(rough(flat)).level == "error"


@pytest.mark.parametrize(
    ("factor", "level"), [(1e6, "warning"), (1e9, "error"), (1e-6, "warning")]
)
def test_heights_that_cannot_be_metres(rough, factor, level):
    def wrong_unit(z):
        z *= factor

    finding = only(rough(wrong_unit))

    assert (finding.level, "unit" in finding.problem) == (level, True)


def test_lateral_scale(rough):
    assert "not calibrated" in only(rough(dx=None, dy=None)).problem
    assert only(rough(dy=2.5e-6)).level == "note"
    replaced = rough(lateral_step_override_m=(1e-6, 1e-6), lateral_step_in_file_m=(9e-6, 9e-6))
    assert "9e-06" in only(replaced).problem


def test_window_off_centre(rough):
    centred = {
        "window_origin_px": (280, 210),
        "window_px": (80, 60),
        "camera_px": (640, 480),
    }

    assert check_object(rough(**centred)) == ()
    moved = only(rough(**{**centred, "window_origin_px": (139, 210)}))
    assert "-141.0 px, +0.0 px" in moved.problem


def test_jitter_of_the_clock_is_stated_with_what_it_costs(rng):
    """A sine at stamps that jitter, read as uniform: the rms error is that of its own slope."""
    f, fs, n = 13.0, 800.0, 4000
    jitter = 0.05 / fs * rng.standard_normal(n)
    t = np.arange(n) / fs + jitter
    found = check_object(ms.Recording(t, {"a": np.sin(2.0 * np.pi * f * t)}))

    (note,) = [one for one in found if "jitters" in one.problem]
    stated = float(re.search(r"wrong by (\S+) f", note.fix)[1]) * f
    error = np.sin(2.0 * np.pi * f * t) - np.sin(2.0 * np.pi * f * np.arange(n) / fs)
    assert note.level == "note"
    assert stated == pytest.approx(
        error.std(), rel=0.05, abs=0.0
    )  # 4000 draws: 1.1 %, their spread as a sine 1 %
    plain = check_object(ms.Recording(np.arange(n) / fs, {"a": np.sin(t)}))
    assert not [one for one in plain if "jitters" in one.problem]


def test_gap_in_the_positions_of_a_profile(rng):
    x = np.arange(500) * 1e-6
    x[300:] += 40e-6

    finding = only(ms.Profile(x, 1e-9 * rng.standard_normal(500)))

    assert finding.problem.startswith("a gap of 41 ")


def test_lost_samples_of_a_recording(rng):
    t = np.delete(np.arange(1000) * 1e-3, slice(400, 407))

    finding = only(ms.Recording(t, {"gap": 1e-9 * rng.standard_normal(t.size)}))

    assert "1 gap(s) in the clock: the longest is 8.0 steps, the first after t = 0.399 s" in (
        finding.problem
    )


@pytest.mark.parametrize(("unit", "turn"), [("", 360.0), ("rad", 2 * np.pi)])
def test_wrapped_angle_is_found_and_an_unwrapped_one_is_not(unit, turn):
    t = np.arange(2000) * 1e-3
    angle = turn * t * 1.7 + 0.001 * np.sin(t)

    units = {"c": unit} if unit else {}
    wrapped = ms.Recording(t, {"c": np.mod(angle, turn)}, units=units)

    assert "wraps 3 time(s)" in only(wrapped).problem
    assert check_object(ms.Recording(t, {"c": angle}, units=units)) == ()


def test_a_square_wave_is_no_angle(rng):
    t = np.arange(2000) * 1e-3
    wave = 360.0 * (np.mod(t, 0.1) > 0.05) + rng.standard_normal(2000)

    assert not any("wraps" in p for _, p in problems(ms.Recording(t, {"valve": wave})))


def test_what_the_reader_noticed_is_said(rough):
    finding = only(rough(warnings=("the MD5 is wrong; ask for the original",)))

    assert (finding.level, finding.problem, finding.fix) == (
        "warning",
        "the MD5 is wrong",
        "ask for the original",
    )


def test_errors_come_first(rough):
    def spoil(z):
        z[:40] = np.nan

    found = check_object(rough(spoil, dx=None, dy=None))

    assert [f.level for f in found] == ["error", "warning"]


def test_command_prints_findings_and_codes(tmp_path, capsys, rough):
    good, odd, bad = tmp_path / "good.csv", tmp_path / "odd.csv", tmp_path / "bad.csv"
    x = np.arange(100) * 1e-6
    ms.write(ms.Profile(x, 1e-7 * np.sin(x * 1e6)), good)
    ms.write(ms.Profile(x, 1e1 * np.sin(x * 1e6)), odd)
    bad.write_bytes(b"\0\1\2")

    assert code_of("check", str(good)) == 0
    assert "no problem found" in capsys.readouterr().out
    assert code_of("check", str(odd), "--json") == 1
    document = json.loads(capsys.readouterr().out)
    assert document["findings"][0]["level"] == "error"
    assert "20 m" in document["findings"][0]["problem"]
    assert code_of("check", str(good), str(bad)) == 4
    assert "no reader knows this content" in capsys.readouterr().out


def test_stated_unit_reaches_the_reader(tmp_path):
    path = tmp_path / "plain.txt"
    path.write_text("0 1\n1 2\n2 4\n")

    assert check_file(path)[0].unreadable
    assert check_file(path, unit="um") == ()


def test_runs_of_our_own_are_described_and_checked(tmp_path, capsys, rng):
    x = np.linspace(0, 20e-3, 200)
    z = 1e-7 * rng.standard_normal(200)
    gappy = np.where(np.arange(200) < 30, np.nan, z)
    runs = ms.RunSet([ms.Run(x, z, feed=0.08), ms.Run(x, gappy, feed=0.12, run_id="b")])
    path = ms.write(runs, tmp_path / "runs.h5")

    assert code_of("info", str(path)) == 0
    assert "4800 mm/min, 7200 mm/min" in capsys.readouterr().out
    finding, note = check_file(path)
    assert note.fix.endswith(f"metrosep separate {path}")
    assert finding.problem == "run 'b': 15.0% of 200 points were not measured"


LIST = """target_mm;direction;r1_um;r2_um;r3_um
0;fwd;0,1;0,2;0,1
0;rev;0,6;0,5;0,7
50;fwd;1,1;1,0;1,2
50;rev;1,6;1,5;1,7
100;fwd;2,1;2,2;2,0
100;rev;2,6;2,7;2,5
"""


def test_a_list_of_targets_gets_the_call_that_makes_its_pitch_table(tmp_path, capsys):
    path = tmp_path / "axis.csv"
    path.write_text(LIST)

    (finding,) = check_file(path)

    assert finding.level == "note"
    call = finding.fix.partition("metrosep table ")[2]
    words = shlex.split(call.replace("AXIS", "X").replace("FILE", str(tmp_path / "x.comp")))
    words[words.index("SENSE")] = "reached-minus-target"
    assert code_of("table", *words) == 0
    assert any(line.startswith("50") for line in (tmp_path / "x.comp").read_text().splitlines())


@pytest.mark.parametrize(
    "text",
    [
        LIST.replace("rev", "fwd"),  # one direction
        LIST.replace("100;rev", "90;rev"),  # other places on the way back
        LIST.replace("direction", "feed_mm_min").replace("fwd", "100").replace("rev", "200"),
    ],
)
def test_other_tables_are_not_lists_of_targets(tmp_path, text):
    path = tmp_path / "axis.csv"
    path.write_text(text)

    assert not any("metrosep table" in f.fix for f in check_file(path))
