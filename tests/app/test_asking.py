"""Which columns are guessed, and what is asked for."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

from metrosep.app.asking import (
    Ask,
    answered,
    are_runs,
    ask_channel,
    ask_columns,
    fewest_feeds,
    holds_columns,
)
from metrosep.app.documents import Places, start_runs_text
from metrosep.app.sessions import Session
from metrosep.core.runset import Run, RunSet
from metrosep.core.text_options import ROW_ORDERS
from metrosep.errors import DataError, FormatMismatchError, ReadError
from metrosep.io.read import read


def table(folder, head, rows=5):
    n = len(head.split(","))
    path = folder / "a.csv"
    body = "\n".join(",".join(str(i + j) for j in range(n)) for i in range(rows))
    path.write_text(f"{head}\n{body}\n")
    return path


@pytest.mark.parametrize(
    ("head", "guesses"),
    [
        ("x_mm,z_um", {"x": "x_mm", "z": "z_um"}),
        ("z_um,x_mm", {"x": "x_mm", "z": "z_um"}),  # by name, not by place
        ("pos_mm,probe1_V,probe2_V", {"x": "pos_mm", "z": "probe1_V"}),
        ("t_s,encoder_mm,err_nm", {"time": "t_s", "x": "encoder_mm", "z": "err_nm"}),
        ("y_mm,z_um", {"x": "y_mm", "z": "z_um"}),  # a run along Y
        ("F,x,z_um", {"x": "x", "z": "z_um"}),  # a unit alone makes no position
        ("a_mm,z_um,c_mm", {"x": "a_mm", "z": "z_um"}),
        ("z_mm,err_um", {"x": "z_mm", "z": "err_um"}),
        ("run,x,z", {"x": "x", "z": "z", "run": "run"}),
        ("a,b", {"x": "a", "z": "b"}),  # of two columns the first is the position
        ("a,b,c", {}),  # of three nothing is known
        ("F_N,x_mm,z_um", {"x": "x_mm", "z": "z_um"}),  # a force is not a feedrate
        ("feed_mm_min,X_mm,Z_um", {"feed": "feed_mm_min", "x": "X_mm", "z": "Z_um"}),
    ],
)
def test_guesses(tmp_path, head, guesses):
    asked = ask_columns([table(tmp_path, head)], {}, "why")
    assert {f["name"]: f["value"] for f in asked.fields if f["value"]} == guesses


def test_what_was_answered_stands_in_the_fields(tmp_path):
    asked = ask_columns([table(tmp_path, "a,b,c")], {"x": "c", "z_unit": "nm"}, "why")
    values = {f["name"]: f["value"] for f in asked.fields}
    assert (values["x"], values["z_unit"]) == ("c", "nm")


def test_units_are_asked_for_only_where_the_header_has_none(tmp_path):
    names = lambda head: {f["name"] for f in ask_columns([table(tmp_path, head)], {}, "").fields}  # noqa: E731
    assert not {"x_unit", "z_unit", "scale"} & names("x_mm,z_um,y_mm")
    assert {"x_unit", "z_unit"} <= names("x,z,y")
    assert "scale" in names("x_mm,z_V,y_mm")
    assert names("x_mm,z_um") == {"x", "z"}


@pytest.mark.parametrize(
    ("head", "proposed"),
    [
        ("angle_deg,r_um", {"angle": "angle_deg", "radius": "r_um", "x": "", "z": ""}),
        (
            "height_mm,dev_um,Winkel",
            {"angle": "Winkel", "radius": "dev_um", "height": "height_mm"},
        ),
        ("C_deg,gap_um,feed_mm_min", {"angle": "", "z": "gap_um", "feed": "feed_mm_min"}),
    ],
)
def test_a_table_over_an_angle_is_asked_about_as_a_trace(tmp_path, head, proposed):
    asked = ask_columns([table(tmp_path, head)], {}, "why")
    values = {f["name"]: f["value"] for f in asked.fields}
    assert {k: values[k] for k in proposed} == proposed
    assert "roundness trace" in str(asked)


def test_every_field_has_a_label_and_each_choice_is_a_column(tmp_path):
    for field in ask_columns([table(tmp_path, "x,z,y")], {}, "").fields:
        assert field["label"]
        if field["choices"] and not field["name"].endswith("_unit"):
            assert field["choices"] == ["x", "z", "y"]


def test_one_column_cannot_be_a_run(tmp_path):
    with pytest.raises(ReadError, match="1 column"):
        ask_columns([table(tmp_path, "z_um")], {}, "why")


def test_holds_columns(tmp_path):
    assert holds_columns(table(tmp_path, "x,z"))
    assert not holds_columns(table(tmp_path, "x,z"), fewest=3)
    text = tmp_path / "b.csv"
    text.write_text("nothing of use\n")
    assert not holds_columns(text)
    assert not holds_columns(tmp_path / "missing.csv")


def test_answers_become_keys_of_the_recipe():
    assert answered({"x": "a", "x_unit": "mm", "z": "b", "feed": "", "run": None}) == {
        "x": {"column": "a", "unit": "mm"},
        "z": "b",
    }
    assert answered({"angle": "a", "angle_unit": "deg", "radius": "b", "radius_unit": ""}) == {
        "angle": "a:deg",
        "radius": "b",
    }
    with pytest.raises(DataError, match="needs the column z"):
        answered({"z_unit": "nm"})


# ---- the separation that repeated runs begin with --------------------------------------------


@pytest.mark.parametrize(
    ("more", "method"),
    [
        ({}, "mean"),
        ({"feed": "feed_mm_min"}, "joint"),
        ({"feed": {"column": "F", "unit": "mm/min"}}, "joint"),
        ({"feed": "7200 mm/min"}, "mean"),  # one for all runs
        ({"feed": 0.12}, "mean"),
        ({"feed": ["7200 mm/min", "4800 mm/min"]}, "joint"),
        ({"feed": ["7200 mm/min", "7200 mm/min"]}, "mean"),
        ({"time": "t_s"}, "joint"),
        ({"sampling_rate": "1 kHz"}, "joint"),
        ({"feed": "7200 mm/min", "time": "t_s"}, "mean"),  # the feed that is told holds
    ],
)
def test_runs_begin_with_a_method_that_they_allow(more, method):
    text = start_runs_text(["a.csv", "b.csv"], {"x": "x_mm", "z": "z_um", **more})
    assert tomllib.loads(text)["step"] == [{"op": "separate", "method": method}]


@pytest.mark.parametrize(
    ("feeds", "method"), [(0, "mean"), (1, "mean"), (2, "joint"), (5, "joint")]
)
def test_feeds_that_were_counted_decide(feeds, method):
    reading = {"x": "x_mm", "z": "z_um", "feed": "F"}
    assert tomllib.loads(start_runs_text(["a.csv"], reading, feeds))["step"][0]["method"] == method


@pytest.mark.parametrize(
    ("feeds", "more"),
    [
        ((4800, 4800, 4800), {}),
        ((4800, 4800, 7200), {}),
        ((4800, 4800, 7200, 7200), {"feed": "f_mm_min"}),
        ((4800, 7200, 4800, 7200), {"time": "t_s"}),
        ((4800, 4800, 4800), {"feed": "4800 mm/min"}),
        ((4800, 4800, 4800), {"feed": "f_mm_min"}),  # a column, with one feed in it
        ((4800, 4800, 4800), {"time": "t_s"}),
    ],
)
def test_what_a_session_of_runs_begins_with_can_be_separated(tmp_path, feeds, more):
    x = np.linspace(0.0, 50.0, 201)
    noise = np.random.default_rng(3).normal(0.0, 2e-3, (len(feeds), x.size))
    z = 2.0 * np.exp(-(((x - 15.0) / 4.0) ** 2)) + noise
    rows = [
        f"{k},{a:.4f},{b:.6f},{f},{a * 60 / f:.6f}"
        for k, f in enumerate(feeds)
        for a, b in zip(x, z[k], strict=True)
    ]
    path = tmp_path / "runs.csv"
    path.write_text("\n".join(["run,x_mm,z_um,f_mm_min,t_s", *rows]) + "\n")
    session = Session(Places([tmp_path]))
    session.open([str(path)], {"x": "x_mm", "z": "z_um", "run": "run", **more})
    opened, document = session.need()
    estimate = opened.material.estimate(document.recipe)  # an error would be refused here
    inside = np.linspace(2e-3, 48e-3, 461)
    peak = inside[np.argmax(estimate.evaluate(inside))]
    assert abs(peak - 15e-3) < 1e-3  # where the bump was planted


@pytest.mark.parametrize(
    ("directions", "feeds", "fewest"),
    [((1, 1), (0.1, 0.2), 2), ((1, -1), (0.1, 0.2), 1), ((1, 1, -1, -1), (0.1, 0.2, 0.1, 0.2), 2)],
)
def test_each_direction_needs_its_feeds(directions, feeds, fewest):
    x = np.linspace(0.0, 0.05, 50)
    runs = [
        Run(x[::way], np.cos(40 * x[::way]) * 1e-6, feed=f)
        for way, f in zip(directions, feeds, strict=True)
    ]
    assert fewest_feeds(RunSet(runs)) == fewest
    assert fewest_feeds(RunSet([Run(x, 1e-6 * x)])) == 0


# ---- a matrix of heights, channels of a recording, data sets of a file -----------------------

SAMPLES = Path(__file__).resolve().parents[2] / "data_formats"


def matrix(folder, suffix, separator, columns=30):
    z = np.random.default_rng(5).normal(size=(20, columns))
    path = folder / f"m.{suffix}"
    path.write_text("\n".join(separator.join(f"{v:.5f}" for v in row) for row in z) + "\n")
    return path, z


@pytest.mark.parametrize(("suffix", "separator"), [("txt", " "), ("csv", ",")])
def test_a_matrix_is_opened_as_a_map_by_what_is_asked(tmp_path, suffix, separator):
    path, z = matrix(tmp_path, suffix, separator)
    session = Session(Places([tmp_path]))
    with pytest.raises(Ask, match="map") as asked:
        session.open([str(path)])
    fields = {f["name"]: f for f in asked.value.fields}
    assert list(fields)[:2] == ["unit", "lateral_step"]
    assert fields["unit"]["choices"] == ["nm", "um", "mm", "m", "in"]
    assert "x" in fields  # it may still be columns
    answers = {name: field["value"] for name, field in fields.items()}
    session.open([str(path)], {**answers, "unit": "um", "lateral_step": "3 um"})
    opened, _ = session.need()
    assert opened.kind == "map"
    assert opened.material.obj.dx == pytest.approx(3e-6, abs=1e-18)
    assert opened.material.obj.z == pytest.approx(1e-6 * np.round(z, 5), abs=1e-18)


def test_the_rows_of_a_matrix_are_asked_for_with_it(tmp_path):
    path, z = matrix(tmp_path, "txt", " ")
    session = Session(Places([tmp_path]))
    with pytest.raises(Ask) as asked:
        session.open([str(path)])
    fields = {f["name"]: f for f in asked.value.fields}
    answers = {name: field["value"] for name, field in fields.items()}
    given = {"unit": "um", "lateral_step": "3 um", "row_order": fields["row_order"]["choices"][1]}

    session.open([str(path)], {**answers, **given})

    opened, _ = session.need()
    assert opened.material.obj.z[0] == pytest.approx(1e-6 * np.round(z[-1], 5), abs=1e-18)
    assert opened.material.obj.metadata["orientation_evidence"] == "stated"


def test_columns_with_names_and_two_columns_are_no_map(tmp_path):
    of = lambda path: {f["name"] for f in ask_columns([path], {}, "why").fields}  # noqa: E731
    assert "lateral_step" not in of(table(tmp_path, "x,z,y"))
    assert "lateral_step" not in of(matrix(tmp_path, "txt", " ", columns=2)[0])
    assert "lateral_step" in of(matrix(tmp_path, "txt", " ", columns=3)[0])


def test_a_set_of_files_is_asked_for_columns_only(tmp_path):
    files = [matrix(tmp_path, suffix, ",")[0] for suffix in ("txt", "csv")]
    assert "unit" not in {f["name"] for f in ask_columns(files, {}, "why").fields}


def test_what_is_a_set_of_runs(tmp_path):
    text, columns = table(tmp_path, "x,z,run"), {"x": "x", "z": "z"}
    assert not are_runs([text], columns)
    assert are_runs([text], {**columns, "run": "run"})
    assert are_runs([text, text], columns)
    recording = SAMPLES / "lvm/samples/comma.lvm"
    assert not are_runs([recording], {})
    assert are_runs([recording], columns)  # no profile is cut of channels over time
    assert not are_runs([SAMPLES / "hdf5/samples/no-choice.h5"], columns)


@pytest.mark.parametrize(
    ("name", "names"),
    [
        ("hdf5/samples/no-choice.h5", ["/first", "/second"]),
        ("delimited/samples/stacked.csv", ["left", "right"]),
        ("matlab/samples/packed-big-endian.mat", ["other", "counts"]),
        ("nmm/samples/two-lines.dsc", ["line 1", "line 2", "positions"]),
    ],
)
def test_a_file_of_several_data_sets_asks_which(name, names):
    file = SAMPLES / name
    with pytest.raises(FormatMismatchError) as refused:
        read(file)
    asked = ask_channel(file, {}, refused.value)
    assert asked is not None
    assert asked.name == "channel"
    assert [f["name"] for f in asked.fields] == ["channel"]
    assert asked.fields[0]["choices"] == names
    assert asked.fields[0]["value"] == names[0]
    assert "channel=" not in str(asked)
    assert ask_channel(file, {"channel": names[0]}, refused.value) is None


def test_a_map_of_which_nothing_shows_the_top_row_asks_and_proposes_nothing(tmp_path):
    heights = {}
    for order in ROW_ORDERS:
        file = shutil.copy(SAMPLES / "vk/samples/plain.vk4", tmp_path / f"{order[:3]}.vk4")
        session = Session(Places([tmp_path]))
        with pytest.raises(Ask, match="nothing shows") as asked:
            session.open([str(file)])
        (field,) = asked.value.fields
        assert (field["name"], field["value"]) == ("row_order", "")
        assert field["choices"] == list(ROW_ORDERS)
        session.open([str(file)], {"row_order": order})
        opened, document = session.need()
        assert tomllib.loads(document.text)["input"]["row_order"] == order
        heights[order] = opened.material.obj.z
    np.testing.assert_array_equal(*(z[:: 1 - 2 * k] for k, z in enumerate(heights.values())))


def test_no_channel_is_asked_for_where_there_is_none_to_choose(tmp_path):
    why = DataError("holds no length term; choose a length term with channel=")
    assert ask_channel(SAMPLES / "etalon/samples/angles.txt", {}, why) is None
    assert ask_channel(tmp_path / "missing.h5", {}, why) is None
    assert ask_channel(SAMPLES / "hdf5/samples/no-choice.h5", {}, DataError("damaged")) is None


def test_a_recording_is_opened_as_runs_by_what_is_asked(tmp_path):
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        "Decimal_Separator\t.\nMulti_Headings\tYes\nX_Columns\tOne\nTime_Pref\tRelative\n"
        "***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t101\t101\t\n"
        "Y_Unit_Label\tmm\tum\t\nX_Dimension\tTime\tTime\t\nX0\t0\t0\t\n"
        "Delta_X\t0.1\t0.1\t\n***End_of_Header***\t\t\t\nX_Value\tpos\tgap\tComment\n"
    )
    rows = "".join(f"{0.1 * k:.3f}\t{0.5 * k:.3f}\t{(k % 7) / 10:.3f}\t\n" for k in range(101))
    path = tmp_path / "run.lvm"
    path.write_text(head + rows)
    session = Session(Places([tmp_path]))
    with pytest.raises(Ask) as asked:
        session.open([str(path)])
    fields = {f["name"]: f["value"] for f in asked.value.fields}
    assert (fields["x"], fields["z"], fields["time"]) == ("pos", "gap", "t_s")
    session.open([str(path)], fields)
    opened, document = session.need()
    assert opened.kind == "runs"
    run = opened.material.runs(document.recipe)[0]
    assert run.x[-1] == pytest.approx(50e-3, abs=1e-12)
    assert run.z[1] == pytest.approx(0.1e-6, abs=1e-15)
