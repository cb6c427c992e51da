"""Untidy clocks through the command line: used as they are and said, or named with what to do.

The simulator knows nothing of the library and has the other sign: nominal minus actual, which the
file holds as a negative sensitivity. A lightly damped mode of 120 Hz shows whether the time is right.
"""

import json
import re

import numpy as np
import pytest
from scipy.signal import lfilter

from metrosep import Run, RunSet
from metrosep.cli.main import main
from metrosep.errors import InvalidSamplesError
from metrosep.separation import separate

pytestmark = pytest.mark.usefixtures("without_figures")

RATE, TRAVEL, MODE = 800.0, 52.0, 120.0
FEEDS = (55.0, 55.0, 90.0, 90.0, 135.0, 135.0)
WAVES = ((13.0, 240.0, 0.4), (6.5, 80.0, 2.1), (71.0, 260.0, 5.0))  # mm, nm, rad
CLEAN_NM = 5.0  # RMS error with an even clock: 1.4 to 2.3 nm over three seeds
MODE_HZ = 3.0  # half the width of a mode of 1.5 % damping, and of the resolution of a short run


def too_long_nm(x):
    """Minus the error of the axis: what a ruler reads too long."""
    return -sum(a * np.sin(2 * np.pi * x / w + p) for w, a, p in WAVES)


def axis(seed, clock=lambda rng, t, run: t, keep=lambda i, run: i == i, rate=RATE):
    """Runs as [run, x mm, volt, stamp]: samples are even in time, `clock` writes the stamps."""
    rng = np.random.default_rng([seed, 90210])
    runs = []
    for r, v in enumerate(FEEDS):
        n = int(TRAVEL / v * rate)
        pole = np.exp((-0.015 + 1j) * 2 * np.pi * MODE / rate)
        ring = lfilter([1.0], [1, -2 * pole.real, abs(pole) ** 2], rng.standard_normal(n + 2000))
        t = np.arange(n) / rate
        x = v * t
        nm = too_long_nm(x) + 12 * rng.standard_normal(n) + 60 * ring[2000:] / ring[2000:].std()
        kept = keep(np.arange(n), r)
        runs.append((r + 1, x[kept], nm[kept] / 500.0, clock(rng, t, r)[kept]))
    return runs


def csv(path, runs, written=lambda s: f"{s:.6f}", column="t_s"):
    rows = ["run,x_mm,volt_V," + column]
    for r, x, volt, t in runs:
        rows += [f"{r},{a:.5f},{b:.7f},{written(c)}" for a, b, c in zip(x, volt, t, strict=True)]
    path.write_text("\n".join(rows) + "\n")
    return str(path)


def call(file, *more, column="t_s"):
    given = ["--x", "x_mm", "--z", "volt_V", "--scale", "-500 nm/V", "--run", "run", "--json"]
    if "mean" not in more and "kono" not in more:
        given += ["--shortest", "2 mm"]  # the shortest wave is 6.5 mm
    with pytest.raises(SystemExit) as ended:
        main(["separate", file, *given, "--time", column, *more])
    return ended.value.code


def separated(file, tmp_path, *more, column="t_s"):
    assert call(file, "-o", str(tmp_path / "out"), *more, column=column) == 0
    return json.loads((tmp_path / "out" / "result.json").read_text())


def error_nm(result):
    """RMS of estimate minus truth, line removed, over 80 % of the travel."""
    from metrosep.separation.runs.base import ErrorEstimate

    x = np.linspace(0.1, 0.9, 601) * TRAVEL
    estimate = ErrorEstimate.from_dict(result["estimate"])
    rest = estimate.evaluate(x * 1e-3) * 1e9 + too_long_nm(x)
    return float(np.std(rest - np.polyval(np.polyfit(x, rest, 1), x)))


def peak_hz(result):
    table = result["estimate"]["residual_psd"]
    return table["frequency_hz"][int(np.argmax(table["psd_nm2_per_hz"]))]


def jittered(share):
    return lambda rng, t, run: t + share / RATE * rng.standard_normal(t.size)


def half_a_sample(rng, t, run):
    return t + rng.uniform(-0.5, 0.5, t.size) / RATE


def rounded(step):
    return lambda rng, t, run: np.round((t + 0.37) / step) * step


def in_blocks(size):
    """Buffers of so many samples, each with the time at which it was fetched, 2 % late by chance."""

    def clock(rng, t, run):
        block = np.arange(t.size) // size
        late = rng.uniform(0.0, 0.02, block[-1] + 1) * size / RATE
        return (size * block + size) / RATE + late[block]

    return clock


def set_forward(rng, t, run):
    """A time server sets the clock of the second run by 80 ms."""
    return t + np.where((run == 1) & (np.arange(t.size) > 300), 0.08, 0.0)


def in_float32(offset):
    return lambda rng, t, run: (offset + t).astype(np.float32).astype(np.float64)


def hms(s):
    s += 86397.0  # past midnight while the run goes
    return f"{int(s // 3600) % 24:02d}:{int(s // 60) % 60:02d}:{s % 60:07.4f}"


@pytest.mark.parametrize(
    ("clock", "written", "said"),
    [
        (lambda rng, t, run: t, lambda s: f"{s:.3f}", r"2\d % jitter of the clock \(run \d\)"),
        (jittered(0.05), lambda s: f"{s:.6f}", r"5(\.\d)? % jitter of the clock \(run \d\): fitted"),
        (jittered(0.2), lambda s: f"{s:.6f}", r"2\d % jitter of the clock"),
        pytest.param(half_a_sample, lambda s: f"{s:.6f}", r"(29|30) % jitter of the clock", marks=pytest.mark.slow),
        pytest.param(rounded(1e-3), lambda s: f"{s:.3f}", r"2\d % jitter of the clock", marks=pytest.mark.slow),
        (lambda rng, t, run: t + 1.764e9, lambda s: f"{s:.6f}", None),
        pytest.param(in_float32(45_000.0), lambda s: f"{s:.5f}", r"up to \d samples share a time stamp", marks=pytest.mark.slow),
        (in_blocks(16), lambda s: f"{s:.6f}", r"up to 16 samples share a time stamp"),
        (set_forward, lambda s: f"{s:.6f}", r"run 2: the time stamps jump by 80 ms at 20\.6\d mm"),
        pytest.param(lambda rng, t, run: t, hms, r"2.8 % jitter", marks=pytest.mark.slow),
        (lambda rng, t, run: t, lambda s: f"2026-03-04T12:00:{s + 1:07.4f}", r"2.8 % jitter"),
    ],
    ids=["3 decimals", "5 %", "20 %", "half", "1 ms", "unix", "float32", "blocks", "set", "hms", "date"],
)  # fmt: skip
def test_ordinary_clocks_are_used_as_they_are_and_said(clock, written, said, tmp_path, capsys):
    result = separated(csv(tmp_path / "a.csv", axis(1, clock), written), tmp_path)
    found = [m for m in result["estimate"]["messages"] if re.search("clock|stamp|lost", m)]

    assert error_nm(result) < CLEAN_NM
    assert peak_hz(result) == pytest.approx(MODE, abs=MODE_HZ)
    assert len(found) == (said is not None), found
    assert said is None or re.search(said, found[0])


@pytest.mark.parametrize("clock", [lambda rng, t, run: t, jittered(0.04), in_blocks(10)], ids=["even", "4 %", "blocks"])  # fmt: skip
def test_lost_samples_are_found_named_and_keep_their_times(clock, tmp_path, capsys):
    def keep(i, run):
        return ~((run == 3) & (((i >= 200) & (i < 211)) | (i == 333)))

    result = separated(csv(tmp_path / "a.csv", axis(2, clock, keep)), tmp_path)
    found = [m for m in result["estimate"]["messages"] if "lost" in m]

    assert found == [
        "run 4: 11 samples were lost at 22.39 mm: kept as a gap",  # 90 mm/s * 199 / 800 Hz
        "run 4: 1 sample was lost at 37.35 mm: kept as a gap",
    ]
    assert result["estimate"]["runs"]["n_lost"] == [0, 0, 0, 12, 0, 0]
    assert error_nm(result) < CLEAN_NM
    assert peak_hz(result) == pytest.approx(MODE, abs=MODE_HZ)


def test_many_lost_samples_are_summed_up(tmp_path, capsys):
    gone = np.random.default_rng(8).random(2000) < 0.08
    runs = axis(7, jittered(0.03), lambda i, run: ~((run == 3) & gone[i] & (i > 0)))
    result = separated(csv(tmp_path / "a.csv", runs), tmp_path)
    n = int(TRAVEL / 90.0 * RATE)
    kept = np.flatnonzero(~gone[:n])[[0, -1]]  # what is lost before the first or behind the last
    lost = int(gone[: kept[1]].sum() - gone[0])

    said = [m for m in result["estimate"]["messages"] if "lost" in m]
    assert len(said) == 1
    assert re.match(rf"run 4: {lost} samples were lost at \d+ places, \d of them at", said[0])
    assert error_nm(result) < CLEAN_NM


def test_samples_lost_in_most_runs_are_one_sentence(tmp_path, capsys):
    def keep(i, run):
        return (i != 40 + 7 * run) & ~((run == 4) & (i >= 200) & (i < 209))

    result = separated(csv(tmp_path / "a.csv", axis(2, keep=keep)), tmp_path)

    # the place is that of the last sample before the gap: 135 mm/s * 199 / 800 Hz
    assert [m for m in result["estimate"]["messages"] if "lost" in m] == [
        "15 samples were lost at 7 places of 6 runs, 9 of them at 33.58 mm in run 5: kept as gaps"
    ]
    assert result["estimate"]["runs"]["n_lost"] == [1, 1, 1, 1, 10, 1]
    assert error_nm(result) < CLEAN_NM


def test_lost_samples_are_found_in_positions_where_the_rate_is_stated(tmp_path, capsys):
    runs = axis(3, keep=lambda i, run: ~((run == 0) & (i >= 100) & (i < 220)))
    assert call(csv(tmp_path / "a.csv", runs)) == 0
    told = json.loads(capsys.readouterr().out)["messages"]
    given = ["--x", "x_mm", "--z", "volt_V", "--scale", "-500 nm/V", "--run", "run", "--json"]
    with pytest.raises(SystemExit):
        main(["separate", str(tmp_path / "a.csv"), *given, "--sampling-rate", "800 Hz"])
    by_rate = json.loads(capsys.readouterr().out)["messages"]

    for messages in (told, by_rate):
        assert any("run 1: 120 samples were lost at 6.806 mm" in m for m in messages)


def drifting(rng, t, run):
    """The clock of run 5 speeds up by half while it goes."""
    return t + (0.5 * t**2 / t[-1] if run == 4 else 0.0)


@pytest.mark.parametrize(
    ("clock", "reason"),
    [
        (drifting, "run 5 .*follow no even clock.*give the sampling rate"),
        (in_float32(1.764e9), "run '1': time does not increase.*32-bit.*give the sampling rate"),
        (rounded(0.25), "run 3 .*samples share [2-5] time stamps.*give the sampling rate"),
        (lambda rng, t, run: np.where(np.arange(t.size) < 99, t, t - 0.05), "falls back from"),
        (
            lambda rng, t, run: np.where(np.arange(t.size) == 99, np.nan, t),
            r"no time for 1 of \d+ samples, the first is sample 99; leave these rows out",
        ),
    ],
    ids=["drifting", "unix float32", "coarse", "falls back", "NaN"],
)
def test_a_clock_that_cannot_be_used_is_named_with_what_to_do(clock, reason, tmp_path, capsys):
    file = csv(tmp_path / "a.csv", axis(4, clock))

    assert call(file) == 4
    said = capsys.readouterr().err
    assert re.search(reason, said), said


def test_a_run_with_an_impossible_clock_can_be_left_out_and_other_methods_need_no_clock(
    tmp_path, capsys
):
    file = csv(tmp_path / "a.csv", axis(4, drifting))

    assert call(file, "--exclude", "5") == 0
    assert any("run 5 was omitted" in m for m in json.loads(capsys.readouterr().out)["messages"])
    assert call(file, "--method", "mean") == 0
    assert not any("clock" in m for m in json.loads(capsys.readouterr().out)["messages"])


@pytest.mark.parametrize("text", ["12:30", "25h", "12:30:61x"])
def test_a_time_that_is_no_time_of_day_is_named_by_its_line(text, tmp_path, capsys):
    file = csv(tmp_path / "a.csv", axis(5), lambda s: text if s == 0 else hms(s), column="clock")

    assert call(file, column="clock") != 0
    assert re.search(f"line 2.*'{text}'", capsys.readouterr().err)


def test_time_of_day_serves_other_methods_too(tmp_path, capsys):
    """A - B - B - A, 0.5 um/s of drift, B 3 um above A; the readings pass midnight."""
    seconds = 86394.0 + 2.0 * np.arange(8)
    drift = 0.5 * 2.0 * np.arange(8) + 3.0 * np.tile([0, 1, 1, 0], 2)
    rows = [f"{hms(s - 86397.0)},{z:.4f}" for s, z in zip(seconds, drift, strict=True)]
    (tmp_path / "a.csv").write_text("clock,z_um\n" + "\n".join(rows) + "\n")
    found = []
    for column in ("clock", "t_s"):
        call = ["separate", str(tmp_path / "a.csv"), "--method", "abba", "--readings", "z_um"]
        with pytest.raises(SystemExit) as ended:
            main([*call, "--column", f"time={column}", "--json"])
        assert ended.value.code == 0
        out = json.loads(capsys.readouterr().out)
        found.append({k: v for k, v in out.items() if k not in ("inputs", "files")})
        rows = [f"{s:.4f},{z:.4f}" for s, z in zip(seconds, drift, strict=True)]
        (tmp_path / "a.csv").write_text("t_s,z_um\n" + "\n".join(rows) + "\n")

    assert found[0] == found[1]
    values = [c["value"] for c in found[0]["characteristics"]]
    assert values == pytest.approx([-3e-6, 0.5e-6], rel=1e-9, abs=0.0)


def test_a_row_written_twice_is_named(tmp_path, capsys):
    runs = axis(6)
    r, *columns = runs[2]
    runs[2] = (r, *(np.insert(c, 50, c[50]) for c in columns))

    assert call(csv(tmp_path / "a.csv", runs)) == 4
    assert "drop rows that were written twice" in capsys.readouterr().err


def test_a_position_that_is_held_is_named(tmp_path, capsys):
    runs = axis(6)
    r, x, *rest = runs[2]
    runs[2] = (r, np.repeat(x[::5], 5)[: x.size], *rest)

    assert call(csv(tmp_path / "a.csv", runs)) == 4
    assert "updated more slowly than rows are written" in capsys.readouterr().err


def test_position_that_jerks_once_has_lost_no_sample():
    rng = np.random.default_rng(1)
    runs = []
    for v in (0.05, 0.09, 0.14):
        t = np.arange(int(0.05 / v * RATE)) / RATE
        x = v * t
        x[100] += 0.9 * v / RATE  # one reading of the encoder is late, the next one is right
        runs.append(Run(x, 1e-8 * rng.standard_normal(t.size), t=t))
    estimate = separate(RunSet(runs))

    assert estimate.runs["n_lost"].tolist() == [0, 0, 0]
    assert not any("lost" in m for m in estimate.messages)


def test_clock_of_samples_that_are_mostly_missing_is_refused():
    t = np.concatenate([np.arange(60), np.arange(400, 460)]) / RATE
    z = np.random.default_rng(2).standard_normal(t.size) * 1e-8
    runs = RunSet(Run(v * t, z, t=t, run_id=str(v)) for v in (0.05, 0.1))

    with pytest.raises(InvalidSamplesError, match=r"340 samples are missing between its 120"):
        separate(runs)
