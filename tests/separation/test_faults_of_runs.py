"""Runs that misbehave are named as what they are, and nobody is blamed for another fault.

The simulator is that of a person with a logger: a curve of waves, oscillating noise made from many
close frequencies, and a file with German numbers, comments, blank lines and stray separators.
"""

import math
import re

import numpy as np
import pytest

from metrosep import Run, RunSet
from metrosep.cli.main import main
from metrosep.errors import InvalidSamplesError
from metrosep.separation import separate as separate_runs

pytestmark = pytest.mark.usefixtures("without_figures")

SHORTEST = 1.5e-3
"""The shortest wave of these shops is longer than 3 mm; the harmonics below cost most of the time of a joint estimate."""


def separate(runs, **options):
    """Separate; a joint estimate goes down to SHORTEST unless the test says otherwise."""
    if options.get("method", "joint") == "joint":
        options = {"shortest": SHORTEST} | options
    return separate_runs(runs, **options)


WAVES = ((15.0, 240.0), (8.0, 80.0), (5.0, 35.0), (90.0, 200.0), (33.0, 90.0))
"""Wavelength in mm, amplitude in nm."""


class Shop:
    """Runs as lists [x_mm, z_nm, t_s, v_mm_s, name]; the error at a place."""

    def __init__(
        self,
        seed,
        *,
        waves=WAVES,
        feeds=(50.0, 75.0, 110.0),
        repeats=3,
        travel=60.0,
        rate=300.0,
        white=12.0,
        hum=(70.0, 2.0, 50.0),
        lag=0.0,
    ):
        self.rng = rng = np.random.default_rng([seed, 1234])
        self.waves = [(w, a, rng.uniform(0.0, 2.0 * np.pi)) for w, a in waves]
        self.runs = []
        for v in np.repeat(feeds, repeats):
            t = np.arange(int(travel / abs(v) * rate) + 1) / rate
            x = v * t if v > 0 else travel + v * t
            z = self.error(x - v * lag) + white * rng.standard_normal(t.size)
            z = z + self.hum(t, *hum) + rng.normal(0.0, 60.0)
            self.runs.append([x, z, t, v, f"M{len(self.runs) + 1:02d}"])

    def hum(self, t, middle, width, rms):
        """Noise of a narrow band: 25 sines of random frequency and phase."""
        rng = self.rng
        f = middle + width * rng.standard_normal(25)
        sines = sum(np.cos(2.0 * np.pi * (q * t + rng.uniform())) for q in f)
        return sines * rms / math.sqrt(12.5)

    def error(self, x):
        return sum((a * np.cos(2.0 * np.pi * x / w + p) for w, a, p in self.waves), 0.0 * x)

    def displace(self, run, by):
        x, z = self.runs[run][:2]
        self.runs[run][1] = z - self.error(x) + self.error(x - by)

    def change(self, run, how):
        self.runs[run][1] = how(self.runs[run][1].copy())
        return self

    def set(self, **more):
        return RunSet(
            Run(x * 1e-3, z * 1e-9, t=t, feed=abs(v) * 1e-3, run_id=name, **more)
            for x, z, t, v, name in self.runs
        )

    def file(self, path):
        """A file as a German shop has it: comma, CRLF, a mark at its start, stray separators."""
        rows = ["\ufeff# Messung vom Montag", "", "Lauf;Zeit [s];Pos [mm];Anzeige [nm]"]
        for x, z, t, _, name in self.runs:
            for i, (a, b, c) in enumerate(zip(x, z, t, strict=True)):
                row = f"{name};{c:.5f};{a:.4f};{b:.2f}".replace(".", ",")
                rows.append(row + (";" if i % 50 == 7 else ""))
            rows.append("")
        path.write_bytes("\r\n".join(rows).encode())
        return str(path)


def named(messages):
    """Beginnings of the sentences that accuse a run or the runs of a feedrate."""
    found = (re.match(r"run (\S+?)(?= (?!was left))|the runs at (\S+)", m) for m in messages)
    return {m[0] for m in found if m and not m[0].endswith(":")}


def alone(shop, method="mean", **options):
    """The only sentence about a run."""
    messages = separate(shop.set(), method=method, **options).messages
    own = [m for m in messages if named([m])]
    assert len(own) == 1, messages
    return own[0]


def ramp(z):
    z[z.size // 2 :] += 1200.0
    return z


def lost(z):
    z[[30, 77, 99, 140]] = -99_999.0
    return z


@pytest.mark.parametrize("method", ["mean", "kono"])
@pytest.mark.parametrize(
    ("how", "said"),
    [
        (lambda z: z[::-1].copy(), r"run M05 is mirrored"),
        (ramp, r"run M05 jumps by 1\.(1[5-9]|2)\d* um at (29|30)(\.\d*)? mm"),
        (lost, r"run M05 has 4 readings of -100 um, far from all others, the first at 7\.5 mm"),
        (lambda z: 0.4 * z, r"run M05 has the gain 0\.4"),
    ],
)
def test_a_run_is_named_as_what_it_is(method, how, said):
    """Noise and hum of 50 nm blur the size of the jump by 4 % and its place by a few samples."""
    assert re.match(said, alone(Shop(3).change(4, how), method))


def test_a_run_of_another_part_differs_whatever_its_place():
    shop, other = Shop(4), Shop(5)
    shop.runs[4][1] = other.runs[4][1]

    assert re.match(r"run M05 differs, whatever its gain and place, in \d", alone(shop))


def test_ten_times_the_gain_is_a_gain_and_refused():
    with pytest.raises(InvalidSamplesError, match=r"run M05 has the gain (9\.9|10\.)\d* \(u"):
        separate(Shop(6).change(4, lambda z: 10.0 * z).set(), method="mean")


def test_different_travels_name_the_run_and_its_displacement():
    shop = Shop(7)
    shop.runs[4][0] = shop.runs[4][0] + 2.0  # the encoder of this run reads 2 mm too far

    with pytest.raises(InvalidSamplesError, match="different travels") as caught:
        separate(shop.set(), method="mean")
    text = str(caught.value)
    assert re.search(r"run M05 2 \.\.\. 6[12](\.\d+)? mm", text)
    assert re.search(r"run M05 is displaced by (2|1\.9\d*|2\.0\d*) mm", text)
    assert "exclude='suspect' leaves out what is named here" in text


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("feed", "name"), [(0, "3000"), (1, "4500"), (2, "6600")])
def test_u_of_a_displaced_feedrate_holds_what_a_delay_would_do(seed, feed, name):
    """Three feedrates of which one is moved: at an end a delay moves them alike."""
    shop = Shop(20 + seed)
    for run in range(3 * feed, 3 * feed + 3):
        shop.displace(run, -0.6)
    said = re.match(
        r"the runs at (\d+) mm/min are displaced by (\S+) um \(u (\S+) um\)", alone(shop)
    )

    assert said[1] == name
    assert abs(float(said[2]) + 600.0) < 3.0 * float(said[3])


@pytest.mark.parametrize("run", [0, 1, 2])
@pytest.mark.parametrize("by", [-1.0, 1.0])
def test_one_of_three_single_runs_with_few_waves_is_found(run, by):
    """18 mm of two waves: no shift is sure by itself, all together they are."""
    few = {"travel": 18.0, "waves": ((6.7, 60.0), (2.7, 25.0)), "feeds": (1.0, 2.2, 4.8)}
    shop = Shop(8, **few, repeats=1, rate=60.0, white=3.0, hum=(9.0, 0.5, 4.0))
    shop.displace(run, by)
    said = re.match(r"run M0(\d) is displaced by (\S+) (mm|um) \(u (\S+) um\)", alone(shop))

    assert int(said[1]) == run + 1
    assert abs(float(said[2]) * {"mm": 1.0, "um": 1e-3}[said[3]] - by) < 3e-3 * float(said[4])


@pytest.mark.parametrize("step", [400.0, 600.0])
def test_coarse_steps_accuse_nobody(step):
    """Steps above an error of 250 nm: every run has another error of its own making, or none."""
    for seed in range(3):
        shop = Shop(30 + seed, hum=(70.0, 2.0, 0.0))
        for run in range(9):
            shop.change(run, lambda z: step * np.round(z / step))
        messages = separate(shop.set(), method="mean").messages

        assert not named(messages)
        assert any(f"steps of {step:.0f} nm" in m for m in messages)


# --- the joint method: sentences about what it was told ------------------------------------------


def test_at_one_feedrate_it_says_that_no_delay_can_be_seen():
    runs = Shop(40, feeds=(90.0,), lag=5e-3).set()
    said = [m for m in separate(runs, min_feeds=1).messages if "delay" in m]

    assert len(said) == 1
    assert "each ms moves the error by 90 um" in said[0]
    assert not any("delay" in m for m in separate(runs, min_feeds=1, lag=5e-3).messages)


def test_a_shortest_wavelength_that_leaves_waves_out_is_said_and_one_that_does_not_is_not():
    runs = Shop(41).set()

    cut = [m for m in separate(runs, shortest=20e-3).messages if "omitted as stated" in m]
    wavelength = float(re.search(r"one of ([\d.]+) mm", cut[0])[1])
    assert min(abs(wavelength - w) for w in (15.0, 8.0, 5.0)) < 3.0  # leakage of a coarse grid
    assert not any("omitted" in m for m in separate(runs, shortest=3e-3).messages)


def test_a_stated_line_that_is_not_there_is_said_and_one_that_is_is_removed():
    quiet, loud = Shop(42, repeats=2), Shop(42, repeats=2)
    for run in loud.runs:
        run[1] = run[1] + 90.0 * np.sin(2.0 * np.pi * 31.0 * run[2] + loud.rng.uniform(0.0, 6.3))

    none, there = (separate(s.set(), lines=[31.0]).messages for s in (quiet, loud))
    assert any(m.startswith("no line stands out of the noise at 3") for m in none)
    assert not any(m.startswith("line at") for m in none)
    assert any(re.match(r"line at 31\.0\d* Hz .*amplitude (8[6-9]|9[0-4])", m) for m in there)


def test_a_probe_of_another_gain_is_no_drift():
    """5 % of a tilt of 0.1 mm/m is 300 nm over the travel, which looks like a drift."""
    shop = Shop(43, repeats=2)
    for i, run in enumerate(shop.runs):
        run[1] = (run[1] + 100.0 * run[0]) * (1.05 if i % 2 else 1.0)
    messages = separate(shop.set(), probes=["A", "B"] * 3).messages

    assert any("probe_gain='fit'" in m for m in messages)
    assert not any("drift" in m for m in messages)


def test_a_true_drift_is_still_said():
    shop = Shop(44)
    for run in shop.runs:
        run[1] = run[1] + shop.rng.normal(0.0, 900.0) * run[2]

    assert any("drift=1" in m for m in separate(shop.set()).messages)


@pytest.mark.parametrize("few", ["forward", "reverse"])
def test_directions_with_few_runs_are_compared_as_far_as_they_go(few):
    """Below three runs of a direction nothing predicts a run; the table has gaps there."""
    one, two = (50.0, 75.0, 110.0), (60.0, 90.0)
    feeds = (*two, *(-v for v in one)) if few == "forward" else (*one, *(-v for v in two))
    table = separate(Shop(45, feeds=feeds, repeats=1).set()).runs

    assert list(table["predicted_gain"].isna()) == [(v > 0) == (few == "forward") for v in feeds]


@pytest.mark.slow
def test_a_wrong_stated_lag_accuses_no_run():
    messages = separate(Shop(46, lag=2e-3).set(), lag=-2e-3).messages

    assert not named(messages)
    assert any("-2 ms was stated: not corrected" in m for m in messages)


@pytest.mark.slow
def test_a_run_of_more_noise_is_not_accused_and_a_small_displacement_is_found():
    noisy, moved = Shop(47), Shop(47)
    z, t = noisy.runs[4][1:3]
    noisy.runs[4][1] = z + noisy.hum(t, 70.0, 2.0, 90.0) + 21.0 * noisy.rng.standard_normal(t.size)
    moved.displace(4, 0.2)

    assert not named(separate(noisy.set()).messages)
    said = re.match(r"run M05 is displaced by (\S+) um \(u (\S+) um\)", alone(moved, "joint"))
    assert abs(float(said[1]) - 200.0) < 4.0 * float(said[2])


# --- the command line ----------------------------------------------------------------------------


def command(capsys, file, *more):
    columns = ("--x", "Pos [mm]", "--z", "Anzeige [nm]", "--time", "Zeit [s]", "--run", "Lauf")
    with pytest.raises(SystemExit) as ended:
        main(["separate", file, *columns, *more])
    return ended.value.code, capsys.readouterr().err


def stuck(z):
    z[100:] = z[100]
    return z


def spike(z):
    z[77] += 9_000.0
    return z


@pytest.mark.parametrize("method", ["mean", "kono"])
@pytest.mark.parametrize(
    ("how", "code", "said"),
    [
        (lambda z: z, 0, ""),
        (lambda z: -z, 0, r"note: run M05 has the opposite sign: gain -1\.0"),
        (lambda z: 1000.0 * z, 4, r"error: .*run M05 reads [\d,]+ times .*--exclude M05"),
        (stuck, 4, r"error: .*run M05 repeats \S+ nm \d+ times from 25 mm on.*--exclude M05"),
        (lambda z: np.minimum(z, np.quantile(z, 0.8)), 4, r"error: .*run M05 has 20 % .*limit"),
        (spike, 0, r"note: run M05 has a spike at 19\.25 mm: (8\.9|9|9\.0)\d* um"),
        (lambda z: z[::-1].copy(), 0, r"note: run M05 is mirrored"),
        (ramp, 0, r"note: run M05 jumps by 1\.[12]\d* um"),
        (lost, 4, r"error: .*holds -99999 in 4 row.*--missing"),
    ],
)
def test_the_command_names_the_run_of_an_untidy_file(tmp_path, capsys, method, how, code, said):
    file = Shop(60).change(4, how).file(tmp_path / "Messung.csv")
    ended, text = command(capsys, file, "--method", method)

    assert ended == code, text
    assert re.search(said, text), text
    assert said or not re.search(r"run M\d\d", text), text
    if code == 0 and said:
        assert "--exclude suspect" in text
        assert command(capsys, file, "--method", method, "--exclude", "suspect")[0] == 0


def test_the_command_says_which_readings_of_a_run_were_given_twice(tmp_path, capsys):
    shop = Shop(61)
    shop.runs[5] = [*(a.copy() for a in shop.runs[4][:3]), 75.0, "M06"]
    ended, text = command(capsys, shop.file(tmp_path / "a.csv"), "--method", "mean")

    assert ended == 4
    assert re.search(r"run M06 is identical to run M05: the same readings are not a second", text)


def test_the_command_says_which_run_to_leave_out_where_one_alone_goes_back(tmp_path, capsys):
    """One run of nine was taken on the way back: the others are enough, and the user must know."""
    shop = Shop(62)
    x, z = shop.runs[4][:2]
    shop.runs[4][0], shop.runs[4][1] = x[::-1].copy(), z[::-1].copy()
    file = shop.file(tmp_path / "a.csv")
    ended, text = command(capsys, file, "--shortest", "1.5 mm")

    assert ended == 4
    assert "the reverse runs have 1 feedrate" in text
    assert "The forward runs have enough feedrates: --exclude M05 estimates them alone" in text
    assert command(capsys, file, "--shortest", "1.5 mm", "--exclude", "M05")[0] == 0
