"""What a person can type is what a message asks for: columns, repeats, places; no call of Python."""

import numpy as np
import pytest

from metrosep.cli.errors import as_options
from metrosep.cli.main import main
from metrosep.recipe.step_help import step_words

SIGN_OF_PYTHON = ("=(", "array (", "np.", "numpy.", "rad are needed")


@pytest.fixture
def refused(capsys):
    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        assert stop.value.code not in (0, None)
        return capsys.readouterr().err

    return call


def write_revolutions(path, *, angle="angle_deg"):
    theta = np.arange(0.0, 360.0, 2.0)
    rows = [
        f"{rev},{a},{30 * np.cos(np.deg2rad(3 * a)) + rev:.4f},{12 * np.sin(np.deg2rad(2 * a)):.4f}"
        for rev in range(5)
        for a in theta
    ]
    path.write_text(f"rev,{angle},m1_nm,m2_nm\n" + "\n".join(rows) + "\n")
    return path


def donaldson(path, angle, *more):
    return (
        "separate",
        path,
        "--method",
        "donaldson",
        "--readings",
        "m1_nm,m2_nm",
        "--angle",
        angle,
        *more,
    )


def test_revolutions_ask_for_the_column_that_numbers_them(tmp_path, refused):
    told = refused(*donaldson(write_revolutions(tmp_path / "d.csv"), "angle_deg"))
    assert "--repeat COLUMN" in told
    assert not any(sign in told for sign in SIGN_OF_PYTHON), told


def test_degrees_under_a_header_in_radians_are_to_be_renamed(tmp_path, refused):
    path = write_revolutions(tmp_path / "d.csv", angle="angle_rad")
    told = refused(*donaldson(path, "angle_rad", "--repeat", "rev"))
    assert "degrees" in told
    assert "_deg" in told
    assert not any(sign in told for sign in SIGN_OF_PYTHON), told


def test_angle_without_unit_is_asked_for_an_angle(tmp_path, refused):
    path = write_revolutions(tmp_path / "d.csv", angle="angle")
    told = refused(*donaldson(path, "angle", "--repeat", "rev"))
    assert "'angle_deg'" in told
    assert "--angle angle:deg" in told
    assert "um" not in told.split("rename it")[1]


def test_column_without_unit_is_asked_for_as_it_is_typed(tmp_path, refused):
    path = tmp_path / "f.csv"
    path.write_text("u_V,d\n0,0\n1,2\n2,4\n")
    method = ("separate", path, "--method", "flexure_calibration", "--column", "voltage=u_V")
    told = refused(*method, "--column", "displacement=d")
    assert "--column displacement=d:um" in told
    assert not any(sign in told for sign in SIGN_OF_PYTHON), told


def test_volts_where_the_step_has_no_sensitivity_get_another_advice(tmp_path, refused):
    path = tmp_path / "f.csv"
    path.write_text("u_V,d_V\n0,0\n1,2\n2,4\n")
    method = ("separate", path, "--method", "flexure_calibration", "--column", "voltage=u_V")
    told = refused(*method, "--column", "displacement=d_V")
    assert "scale" not in told
    assert "multiply it by the sensitivity" in told


def test_several_runs_in_one_column_ask_for_their_number(tmp_path, refused):
    path = tmp_path / "s.csv"
    rows = [f"{run},{x},{0.1 * x + run}" for run in range(2) for x in range(30)]
    path.write_text("run,x_mm,z_um\n" + "\n".join(rows) + "\n")
    words = ("--readings", "z_um", "--x", "x_mm", "--set", "quantity=error")
    assert "--repeat COLUMN" in refused("separate", path, "--method", "dual_servo", *words)


@pytest.mark.parametrize("command", [True, False])
def test_key_that_a_step_lacks_is_not_asked_for(command):
    message = "mirrored; check form and centre, free less, or give start="
    assert step_words(message, "tool_setting", command=command).endswith("free less")
    kept = step_words("say so, or give sd=", "abba", command=command)
    assert "sd" in kept


def test_place_in_a_message_is_no_option():
    told = as_options("voltage 39.6 V at x=0.02145 lies outside; name x=", ("x", "z"))
    assert told == "voltage 39.6 V at x = 21.45 mm lies outside; name --x"
    assert as_options("at x=-3e-6.", ("x",)) == "at x = -3 um."


def test_call_of_python_keeps_its_arguments():
    told = as_options("read runs with read_runs(x=, z=), or give x=", ("settings",))
    assert told == 'read runs with read_runs(x=, z=), or give --set "x=..."'
    call = "read_runs('b.csv', x='Travel (in)', z='Probe (µin)', run='Pass')"
    assert (
        as_options(call, ("settings",)) == call
    )  # parentheses in the name of a column end no call


def test_check_of_a_table_has_no_option_within_a_call(tmp_path, capsys):
    path = tmp_path / "t.csv"
    path.write_text("a,b,c\n1,2,3\n4,5,7\n7,8,9\n")
    with pytest.raises(SystemExit):
        main(["check", str(path)])
    said = capsys.readouterr().out
    assert "or use metrosep separate FILE --x COLUMN" in said
    assert "read_runs" not in said
