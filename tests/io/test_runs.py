"""read_runs: units, feeds, directions and clocks, and every way they can contradict each other."""

import contextlib
import hashlib
import importlib
import tracemalloc

import numpy as np
import pytest

import metrosep as ms

PM = 1e-12
MM_MIN = 1e-3 / 60.0


@pytest.fixture
def two_runs(put):
    """Two forward runs at two feeds in one file; heights tell run and sample."""
    lines = ["run,feed_mm_min,x_mm,z_um"]
    for run, feed in ((0, 4800), (1, 7200)):
        lines += [f"{run},{feed},{0.1 * i:.1f},{10 * run + i}" for i in range(5)]
    return put("\n".join(lines) + "\n", "runs.csv")


ONE = "x_mm,z_um\n0,1\n1,2\n2,3\n3,5\n"
BACK = "x_mm,z_um\n3,5\n2,3\n1,2\n0,1\n"


@pytest.mark.parametrize(
    ("name", "travel_mm"),
    [
        ("kono45_seed101_modal", (-5.625, 50.615)),
        ("kono45_seed102_floor", (-5.625, 50.615)),
        ("kono70_seed103_short_lag1ms", (-8.75, 78.69)),
    ],
)
def test_corpus_runs(corpus, name, travel_mm):
    path = corpus / "separation" / f"{name}_runs.csv"
    table = np.loadtxt(path, delimiter=",", skiprows=2)

    runs = ms.read_runs(
        path,
        x=("x_mm", "mm"),
        z=("z_um", "um"),
        feed=("feed_mm_min", "mm/min"),
        run="run",
        sampling_rate=1000.0,
    )

    assert len(runs) == 9
    assert [r.run_id for r in runs] == [str(i) for i in range(9)]
    assert runs.feeds == pytest.approx((0.08, 0.12, 0.16), rel=1e-12, abs=0.0)
    assert runs.directions == (1,)
    assert runs.full_travel[0] == pytest.approx(travel_mm[0] * 1e-3, abs=PM)
    for i, run in enumerate(runs):
        rows = table[table[:, 0] == i]
        np.testing.assert_allclose(run.x, rows[:, 3] * 1e-3, rtol=0, atol=PM)
        np.testing.assert_allclose(run.z, rows[:, 4] * 1e-6, rtol=0, atol=PM)
        assert run.sampling_rate == pytest.approx(1000.0, rel=1e-9, abs=0.0)
    assert runs.history[0].parameters["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("x", "z", "feed"),
    [
        ("x_mm", "z_um", "feed_mm_min"),
        ("x", "z", "feed"),
        ("X_MM", "Z_um", "Feed_mm_min"),
        ("x_mm:mm", "z_um:um", "feed_mm_min:mm/min"),
        (("x_mm", "mm"), ("z_um", "um"), ("feed_mm_min", "mm/min")),
    ],
)
def test_columns_may_be_named_in_every_way(two_runs, x, z, feed):
    runs = ms.read_runs(two_runs, x=x, z=z, feed=feed, run="run")

    assert runs.feeds == pytest.approx((4800 * MM_MIN, 7200 * MM_MIN), rel=1e-12, abs=0.0)
    np.testing.assert_allclose(runs[1].z, np.arange(10, 15) * 1e-6, rtol=0, atol=PM)


def test_time_follows_from_feed_and_mean_step(two_runs):
    runs = ms.read_runs(two_runs, x="x_mm", z="z_um", feed="feed_mm_min", run="run")

    np.testing.assert_allclose(np.diff(runs[0].t), 0.1e-3 / (4800 * MM_MIN), rtol=1e-9, atol=0)


def test_time_column_goes_before_feed(put):
    path = put("t_ms,x_mm,z_um\n0,0,1\n1,0.1,2\n2.1,0.2,3\n")

    run = ms.read_runs(path, x="x_mm", z="z_um", time="t_ms")[0]

    np.testing.assert_allclose(run.t, [0, 1e-3, 2.1e-3], rtol=0, atol=PM)
    assert run.feed == pytest.approx(0.2e-3 / 2.1e-3, rel=1e-9, abs=0.0)


@pytest.mark.parametrize(
    ("header", "options", "known"),
    [
        ("time [ms]", {}, True),
        ("Zeit [ms]", {}, True),
        ("time [ms]", {"feed": "60 mm/s"}, False),  # the feed tells the time
        ("settling time [mm]", {}, False),
        ("time", {}, False),  # of no unit
    ],
)
def test_a_clock_is_read_where_nothing_else_tells_the_time(put, header, options, known):
    path = put(f"{header},x_mm,z_um\n0,0,1\n1,0.1,2\n2.5,0.2,3\n")

    run = ms.read_runs(path, x="x_mm", z="z_um", **options)[0]

    if known:
        np.testing.assert_allclose(run.t, [0, 1e-3, 2.5e-3], rtol=0, atol=PM)
    else:
        assert run.t is None or run.t[2] == pytest.approx(0.2e-3 / 0.06, abs=PM)


def test_time_and_rate_together_are_refused(put):
    with pytest.raises(ms.errors.ReadError, match="leave the rate out"):
        ms.read_runs(
            put("t_s,x_mm,z_um\n0,0,1\n1,1,2\n2,2,3\n"),
            x="x_mm",
            z="z_um",
            time="t_s",
            sampling_rate=1.0,
        )


def test_one_run_per_file_with_a_feed_for_each(put):
    paths = [put(ONE, "a.csv"), put(BACK, "b.csv")]

    runs = ms.read_runs(paths, x="x_mm", z="z_um", feed=["4800 mm/min", 0.12])

    assert [r.run_id for r in runs] == ["a", "b"]
    assert [r.direction for r in runs] == [1, -1]
    assert [r.feed for r in runs] == pytest.approx([0.08, 0.12], rel=1e-12, abs=0.0)
    assert len(runs.history) == 2
    assert runs[1].z[0] == pytest.approx(5e-6, abs=PM)


def test_run_ids_of_several_files_name_the_file(put, two_runs):
    other = put(two_runs.read_bytes(), "other.csv")

    runs = ms.read_runs([two_runs, other], x="x_mm", z="z_um", run="run")

    assert [r.run_id for r in runs] == ["runs:0", "runs:1", "other:0", "other:1"]


def test_number_of_feeds_must_be_that_of_files(put):
    with pytest.raises(ms.errors.FormatMismatchError, match=r"2 values for 1 file"):
        ms.read_runs(put(ONE), x="x_mm", z="z_um", feed=[0.1, 0.2])


def test_sensor_in_volts_keeps_the_sign_of_its_sensitivity(put):
    path = put("x_mm;probe_mV\n0;1000\n1;-2000\n2;0\n")

    run = ms.read_runs(path, x="x_mm", z="probe_mV", scale="-2.5 um/V")[0]

    np.testing.assert_allclose(run.z, [-2.5e-6, 5e-6, 0], rtol=0, atol=PM)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"z": ("gap", "V")}, r"scale='2.5 um/V'"),
        ({"z": "gap"}, r"'gap' \(z\) declares no unit"),
        ({"z": "gap", "scale": "2.5 um/V"}, r"'gap' \(z\) declares no unit"),
        ({"z": ("gap", "um"), "scale": "2.5 um/V"}, "not in volts"),
        ({"z": ("gap", "V"), "scale": "2.5 um"}, "length per voltage"),
        ({"z": ("gap", "mm/min")}, "a length is needed"),
    ],
)
def test_units_of_the_sensor_are_demanded(put, options, match):
    with pytest.raises(ms.errors.UnitError, match=match):
        ms.read_runs(put("x_mm,gap\n0,1\n1,2\n2,4\n"), x="x_mm", **options)


def test_feed_without_unit_is_refused(put):
    path = put("x_mm,z_um,feed\n0,1,7200\n1,2,7200\n2,4,7200\n")

    with pytest.raises(ms.errors.UnitError, match="'feed'"):
        ms.read_runs(path, x="x_mm", z="z_um", feed="feed")
    with pytest.raises(ms.errors.UnitError, match="no unit"):
        ms.read_runs(path, x="x_mm", z="z_um", feed="7200")


@pytest.mark.parametrize("role", ["x", "z", "feed", "run", "direction", "time"])
def test_missing_column_lists_the_columns(two_runs, role):
    options = {"x": "x_mm", "z": "z_um", role: "x_mmm"}

    with pytest.raises(
        ms.errors.FormatMismatchError,
        match=rf"no {role} column 'x_mmm'; the columns are run, feed_mm_min, x_mm, z_um; did you mean 'x_mm'",
    ):
        ms.read_runs(two_runs, **options)


def test_several_runs_without_a_run_column_get_a_hint(two_runs):
    with pytest.raises(ms.errors.InvalidSamplesError, match=r"not monotonic.*run='run'"):
        ms.read_runs(two_runs, x="x_mm", z="z_um")


def test_feed_that_contradicts_the_clock_is_refused(two_runs):
    with pytest.raises(ms.errors.DataError, match=r"runs\.csv: run '0'.*check the units"):
        ms.read_runs(
            two_runs, x="x_mm", z="z_um", feed="feed_mm_min", run="run", sampling_rate="1 MHz"
        )


def test_feed_that_varies_within_a_run_is_refused(put):
    path = put("x_mm,z_um,f_mm_min\n0,1,7200\n1,2,7200\n2,4,4800\n")

    with pytest.raises(ms.errors.InvalidSamplesError, match=r"4800 to 7200 mm/min"):
        ms.read_runs(path, x="x_mm", z="z_um", feed="f_mm_min")


def test_feed_with_the_sign_of_the_travel_is_accepted(put):
    path = put("x_mm,z_um,f_mm_min\n2,1,-7200\n1,2,-7200\n0,4,-7200\n")

    assert ms.read_runs(path, x="x_mm", z="z_um", feed="f_mm_min")[0].feed == pytest.approx(
        0.12, rel=1e-9, abs=0.0
    )


def test_feed_against_the_travel_is_refused(put):
    path = put("x_mm,z_um,f_mm_min\n0,1,-7200\n1,2,-7200\n2,4,-7200\n")

    with pytest.raises(ms.errors.InvalidSamplesError, match="positions rise"):
        ms.read_runs(path, x="x_mm", z="z_um", feed="f_mm_min")


@pytest.mark.parametrize(("fwd", "rev"), [("fwd", "rev"), ("forward", "backward"), ("+1", "-1")])
def test_directions_split_a_run_that_holds_both(put, fwd, rev):
    rows = [f"1,{fwd},{i},{i}" for i in range(3)] + [f"1,{rev},{i},{10 + i}" for i in (2, 1, 0)]
    path = put("cycle,dir,x_mm,z_um\n" + "\n".join(rows))

    runs = ms.read_runs(path, x="x_mm", z="z_um", run="cycle", direction="dir")

    assert [(r.run_id, r.direction) for r in runs] == [("1 forward", 1), ("1 reverse", -1)]
    np.testing.assert_allclose(runs[1].z, [12e-6, 11e-6, 10e-6], rtol=0, atol=PM)


def test_label_against_the_travel_is_refused(put):
    path = put("dir,x_mm,z_um\nrev,0,1\nrev,1,2\nrev,2,3\n")

    with pytest.raises(ms.errors.InvalidSamplesError, match=r"labelled reverse.*0 mm to 2 mm"):
        ms.read_runs(path, x="x_mm", z="z_um", direction="dir")


def test_unknown_direction_is_named_by_its_line(put):
    path = put("dir,x_mm,z_um\nfwd,0,1\nsideways,1,2\nfwd,2,3\n")

    with pytest.raises(ms.errors.FormatMismatchError, match="line 3: direction 'sideways'"):
        ms.read_runs(path, x="x_mm", z="z_um", direction="dir")


def test_reading_that_is_missing_stays_in_its_place(put):
    run = ms.read_runs(put("x_mm,z_um\n0,1\n1,\n2,3\n"), x="x_mm", z="z_um")[0]

    assert np.isnan(run.z).tolist() == [False, True, False]


def test_position_that_is_missing_is_named_by_its_line(put):
    with pytest.raises(ms.errors.InvalidSamplesError, match="line 3 has no position"):
        ms.read_runs(put("x_mm,z_um\n0,1\n,2\n2,3\n"), x="x_mm", z="z_um")


def test_run_without_a_reading_is_refused(put):
    path = put("run,x_mm,z_um\n0,0,1\n0,1,1\n0,2,2\n1,0,\n1,1,\n1,2,\n")

    with pytest.raises(
        ms.errors.InvalidSamplesError, match="run '1' holds no reading in column 'z_um'"
    ):
        ms.read_runs(path, x="x_mm", z="z_um", run="run")


def test_run_of_two_samples_is_refused(put):
    with pytest.raises(ms.errors.TooFewSamplesError, match="at least 3"):
        ms.read_runs(put("x_mm,z_um\n0,1\n1,2\n"), x="x_mm", z="z_um")


def test_run_without_a_name_is_refused(put):
    path = put("run,x_mm,z_um\n0,0,1\n0,1,1\n0,2,2\n,3,1\n")

    with pytest.raises(ms.errors.FormatMismatchError, match="line 5 has no entry in the run"):
        ms.read_runs(path, x="x_mm", z="z_um", run="run")


def test_labels_tell_runs_apart(put):
    path = put("trace,x_mm,z_um\nA,0,1\nA,1,2\nA,2,3\nB,0,4\nB,1,5\nB,2,6\n")

    runs = ms.read_runs(path, x="x_mm", z="z_um", run="trace")

    assert [r.run_id for r in runs] == ["A", "B"]
    assert runs[1].metadata["first_line"] == 5


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (b"", "empty"),
        (bytes(range(256)) * 4, "binary data"),
        ("x_mm,z_um\n0,1\n1,2\n2,3\n3", "middle of a row"),
        ("hello, this is\na letter, not\na table\n", "no table of numbers"),
    ],
)
def test_what_is_no_table_is_a_read_error(put, content, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read_runs(put(content), x="x_mm", z="z_um")


def test_no_file_is_refused():
    with pytest.raises(ms.errors.ReadError, match="at least one"):
        ms.read_runs([], x="x_mm", z="z_um")


def test_unknown_option_is_named(put):
    with pytest.raises(ms.errors.ReadError, match="'seperator'"):
        ms.read_runs(put(ONE), x="x_mm", z="z_um", seperator=",")


def test_layout_reaches_the_table(put):
    path = put("a title\n0,5|1\n".replace("|", ";") + "1,5;2\n2,5;3\n")

    runs = ms.read_runs(path, x="column1:mm", z="column2:um", skip_rows=1, decimal=",")

    np.testing.assert_allclose(runs[0].x, [0.5e-3, 1.5e-3, 2.5e-3], rtol=0, atol=PM)


def test_runs_of_a_long_text_take_at_most_three_times_its_size(tmp_path, monkeypatch):
    monkeypatch.setattr("metrosep.io.text.table._BLOCK", 2**18)  # as small as the file is
    monkeypatch.setattr("metrosep.io.text._rows._PART", 2**16)
    n, header = 90_000, "run,x_mm,z_um,feed_mm_min\n"
    rows = "".join(
        f"{k // 30_000},{k % 30_000 * 1e-3:.6f},{k % 7}.12345678,3000.0\n" for k in range(n)
    )
    path = tmp_path / "long.csv"
    path.write_text(header + rows)
    del rows
    columns = {"x": "x_mm", "z": "z_um", "run": "run", "feed": "feed_mm_min"}
    short = tmp_path / "short.csv"
    short.write_text(path.read_text()[:5000] + "\n")
    importlib.import_module("pandas")  # what is loaded once is not counted
    with contextlib.suppress(ms.errors.MetrosepError):
        ms.read_runs(short, **columns)
    tracemalloc.start()

    runs = ms.read_runs(path, **columns)

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [len(r) for r in runs] == [30_000] * 3
    assert peak < 3 * path.stat().st_size


def test_an_empty_last_column_with_a_name_does_not_shift_those_of_a_long_text(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("metrosep.io.text._rows._PART", 2**16)
    path = tmp_path / "long.csv"
    rows = "".join(f"{k * 1e-3:.3f},{k % 7}.12345678901,\n" for k in range(20_000))
    path.write_text("x_mm,z_um,spare_um\n" + rows)

    read = ms.read(path, x="x_mm", z="z_um")

    assert (read.x[7], read.z[8]) == (7e-6, 1.12345678901e-6)


@pytest.mark.parametrize("name", ["#1", "%1", "!1", "//1"])
@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("mark", [";", ",", "\t", " "])
def test_a_run_that_is_named_like_a_comment_is_not_lost(tmp_path, name, place, mark):
    names = ["B", "C"]
    names.insert(place, name)
    rows = [(run, f"{i}", f"{0.1 * i + k:.1f}") for k, run in enumerate(names) for i in range(5)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(mark.join(r) for r in [("run", "x_mm", "z_um"), *rows]) + "\n")

    runs = ms.read_runs(path, x="x_mm", z="z_um", run="run")

    assert [r.run_id for r in runs] == names
    assert runs[place].z[0] == pytest.approx(place * 1e-6, rel=0.0, abs=1e-15)
    (warning,) = runs.metadata["warnings"]
    assert f"5 line(s) (first: line {2 + 5 * place})" in warning
    assert runs.metadata["files"][0]["lines"]["data"] == 15


@pytest.mark.parametrize("row", [0, 7])
def test_a_row_that_became_a_comment_is_reported_by_its_line(tmp_path, row):
    rows = [f"{'# ' if i == row else ''}{i};{0.1 * i:.1f}" for i in range(12)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["x_mm;z_um", "# stage warm since 8, 20 degC", *rows]) + "\n")

    profile = ms.read(path)

    assert len(profile) == 11
    (warning,) = profile.metadata["warnings"]
    assert f"line {3 + row}" in warning
    assert "omitted as comments" in warning


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_files_whose_clocks_count_from_a_date_keep_their_distance(tmp_path, order):
    """Seconds since 1970 of two files an hour and 7 us apart: one zero, and no digit lost."""
    paths = []
    for k in range(2):
        rows = [
            f"{1764417600 + 3600 * k}.{10000 * i + 7 * k:06d};{i};{i * i % 7}" for i in range(50)
        ]
        paths.append(tmp_path / f"run{k}.csv")
        paths[k].write_text("\n".join(["time [s];x_mm;z_nm", *rows]) + "\n")

    runs = ms.read_runs([paths[k] for k in order], x="x_mm", z="z_nm", time="time [s]")

    apart = 3600.000007 * (1 if order == (0, 1) else -1)
    np.testing.assert_allclose(runs.runs[0].t, np.arange(50) * 0.01, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(runs.runs[1].t, apart + np.arange(50) * 0.01, rtol=0.0, atol=1e-9)
    assert any("behind the first such moment" in w for w in runs.metadata["warnings"])


def test_a_sampling_rate_is_refused_for_a_run_whose_rows_number_themselves_with_a_gap(
    tmp_path,
):
    """Row 50 carries number 80 and was taken at 0.080 s; a gap between two runs does not matter."""
    asked = {"x": "x_mm", "z": "z_um", "sampling_rate": "1 kHz"}
    numbers = [k if k < 50 else k + 30 for k in range(100)]
    path = tmp_path / "gap.csv"
    path.write_text("n,x_mm,z_um\n" + "".join(f"{k},{k / 10},{k % 7}.5\n" for k in numbers))
    with pytest.raises(ms.errors.FormatMismatchError, match=r"line 52: column 'n'.* 49 to 80"):
        ms.io.read_runs(path, **asked)
    by_feed = ms.io.read_runs(path, x="x_mm", z="z_um", feed="6000 mm/min")
    assert any("49 to 80" in said for said in by_feed.metadata["warnings"])
    rows = [(n, i // 50, n % 80 / 10) for i, n in enumerate(numbers)]
    path.write_text("n,run,x_mm,z_um\n" + "".join(f"{n},{r},{x},0.5\n" for n, r, x in rows))
    assert [r.t[-1] for r in ms.io.read_runs(path, run="run", **asked)] == pytest.approx(
        [0.049, 0.049], abs=1e-12
    )
