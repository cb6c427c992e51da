"""Which columns are guessed, and what is asked for."""

import pytest

from metrosep.app.asking import answered, ask_columns, holds_columns
from metrosep.errors import DataError, ReadError


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
        ("F_N,x_mm,z_um", {"x": "x_mm", "z": "z_um"}),  # a force is no feedrate
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
    with pytest.raises(DataError, match="needs the column z"):
        answered({"z_unit": "nm"})
