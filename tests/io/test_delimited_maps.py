"""Maps as plain text without a header: a matrix of heights, or points x, y, z; nothing is guessed."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main

NM = 1e-9
ROUNDING = 1e-18  # m: the factor of a unit is one multiplication
STEP = 3e-6
LONGEST_MESSAGE = 400  # characters behind the name of the file
MAP = np.array(  # nm; not symmetric in any way, so that a turned map is seen
    [[1.5, 2.0, -3.0, 4.25], [5.0, np.nan, 7.0, 8.0], [90.0, 10.0, 11.0, -12.0]]
)


def write_matrix(path, heights, separator=",", nan="nan"):
    rows = [separator.join(nan if np.isnan(v) else repr(float(v)) for v in row) for row in heights]
    path.write_text("\n".join(rows) + "\n")
    return path


def write_points(path, *, header="", separator=" ", order=1):
    rows = [
        separator.join(["nan" if np.isnan(t) else repr(float(t)) for t in (3 * j, 2 * i, z)])
        for i, row in enumerate(MAP)
        for j, z in enumerate(row)
    ]
    path.write_text(header + "\n".join(rows[::order]) + "\n")
    return path


@pytest.mark.parametrize(
    ("separator", "nan"), [(",", "nan"), (" ", "NaN"), (";", ""), ("\t", "nan"), (" ", "No Data")]
)
def test_matrix_is_a_map_with_unit_and_step(tmp_path, separator, nan):
    path = write_matrix(tmp_path / "m.csv", MAP, separator, nan)
    surface = ms.read(path, unit="nm", lateral_step=("3 um", "2 um"))
    assert surface.z == pytest.approx(MAP * NM, abs=ROUNDING, nan_ok=True)
    assert (surface.dx, surface.dy) == (STEP, 2e-6)
    assert any("smallest y" in w for w in surface.metadata["warnings"])


@pytest.mark.parametrize("n_rows", [1, 2, 60])
@pytest.mark.parametrize("n_columns", [4, 700])
def test_first_rows_without_a_height_are_data(tmp_path, n_rows, n_columns):
    heights = np.arange(5.0 * n_columns).reshape(5, n_columns) - 3.5
    whole = np.vstack(
        [np.full((n_rows, n_columns), np.nan), heights, np.full((2, n_columns), np.nan)]
    )
    for nan in ("nan", ""):
        path = write_matrix(tmp_path / "m.csv", whole, nan=nan)
        z = ms.read(path, unit="nm", lateral_step=STEP, format="delimited").z
        # pytest.approx compares one number after the other, a second for a map of this size
        np.testing.assert_allclose(z, whole * NM, rtol=0.0, atol=ROUNDING)
    path = write_matrix(tmp_path / "m.csv", whole)
    assert ms.read(path, unit="nm", lateral_step=STEP).z.shape == whole.shape  # recognised too


def test_row_without_a_height_between_others_is_data(tmp_path):
    whole = np.vstack([MAP, np.full((1, 4), np.nan), MAP])
    for nan in ("nan", ""):
        z = ms.read(
            write_matrix(tmp_path / "m.csv", whole, nan=nan), unit="nm", lateral_step=STEP
        ).z
        assert z == pytest.approx(whole * NM, abs=ROUNDING, nan_ok=True)


@pytest.mark.parametrize("at", [0, 3, 6])
def test_row_of_tabs_alone_is_a_row_that_was_not_measured(tmp_path, at):
    whole = np.insert(np.vstack([MAP, MAP]), at, np.nan, axis=0)
    path = write_matrix(tmp_path / "m.txt", whole, "\t", nan="")
    z = ms.read(path, unit="nm", lateral_step=STEP).z
    assert z == pytest.approx(whole * NM, abs=ROUNDING, nan_ok=True)


def test_empty_line_of_a_text_with_tabs_is_no_lost_row(tmp_path):
    path = write_matrix(tmp_path / "m.txt", MAP, "\t")
    path.write_text(path.read_text().replace("\n", "\n\n", 1))
    with pytest.raises(ms.errors.FormatMismatchError, match="line 2 stands empty"):
        ms.read(path, unit="nm", lateral_step=STEP)


def test_names_above_missing_values_stay_names(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("x_um,z_nm\n0,nan\n1,2\n2,3\n")
    assert ms.read(path).z == pytest.approx([np.nan, 2 * NM, 3 * NM], abs=ROUNDING, nan_ok=True)


@pytest.mark.parametrize(
    ("options", "asked"),
    [
        ({}, "unit='nm' and lateral_step='3 um'"),
        ({"unit": "nm"}, "give lateral_step='3 um'"),
        ({"lateral_step": "3 um"}, "give unit='nm'"),
    ],
)
def test_what_is_missing_is_said_in_a_short_sentence(tmp_path, options, asked):
    path = write_matrix(tmp_path / "m.csv", np.arange(242.0).reshape(2, 121))
    with pytest.raises(ms.errors.MetrosepError, match=asked) as caught:
        ms.read(path, **options)
    assert len(str(caught.value)) - len(str(path)) < LONGEST_MESSAGE


def test_command_says_its_options(tmp_path, capsys):
    path = write_matrix(tmp_path / "m.csv", np.arange(242.0).reshape(2, 121))
    form = "form=sine_grid: amplitude=80 nm, wavelength=60 um"
    for words in (
        ["measure", path],
        ["separate", path, "--method", "tool_setting", "--set", form],
    ):
        with pytest.raises(SystemExit):
            main([str(w) for w in words])
        told = capsys.readouterr().err
        assert '--unit nm and --lateral-step "3 um"' in told


def test_matrix_of_volts_and_angles_is_refused(tmp_path):
    path = write_matrix(tmp_path / "m.csv", MAP)
    with pytest.raises(ms.errors.UnitError, match="sensitivity"):
        ms.read(path, unit="V", lateral_step=STEP)
    with pytest.raises(ms.errors.UnitError, match="a length is needed"):
        ms.read(path, unit="deg", lateral_step=STEP)
    volts = ms.read(path, unit="V", lateral_step=STEP, scale="-2 um/V")
    assert volts.z == pytest.approx(MAP * -2e-6, abs=1e-15, nan_ok=True)  # um per volt: turned


@pytest.mark.parametrize("header", ["", "x y z\n", "# x y z\n", "X\tY\tZ\n"])
@pytest.mark.parametrize("unit", ["um,um,nm", " um, um, nm", ("um", "um", "nm")])
@pytest.mark.parametrize("order", [1, -1])
def test_points_with_a_unit_each_are_a_map(tmp_path, header, unit, order):
    separator = "\t" if "\t" in header else " "
    path = write_points(tmp_path / "p.xyz", header=header, separator=separator, order=order)
    surface = ms.read(path, unit=unit)
    assert surface.z == pytest.approx(MAP * NM, abs=ROUNDING, nan_ok=True)
    assert surface.dx == pytest.approx(STEP, abs=ROUNDING)
    assert surface.dy == pytest.approx(2e-6, abs=ROUNDING)


def test_points_by_name_or_number(tmp_path):
    named = write_points(tmp_path / "n.xyz", header="x y z\n")
    bare = write_points(tmp_path / "b.xyz")
    wanted = ms.read(named, unit="x=um,y=um,z=nm").z
    for z in (
        ms.read(named, unit={"x": "um", "y": "um", "z": "nm"}).z,
        ms.read(bare, x="1:um", y="2:um", z="3:nm").z,
        ms.read(named, x="x:um", y="y:um", z="z:nm").z,
    ):
        assert z == pytest.approx(wanted, abs=ROUNDING, nan_ok=True)


@pytest.mark.parametrize("header", ["", "x y z\n"])
@pytest.mark.parametrize("options", [{}, {"unit": "nm"}, {"unit": "nm", "lateral_step": "3 um"}])
def test_one_unit_never_scales_positions_and_heights_of_points(tmp_path, header, options):
    path = write_points(tmp_path / "p.xyz", header=header)
    with pytest.raises(ms.errors.MetrosepError, match="unit='um,um,nm'"):
        ms.read(path, **options)


@pytest.mark.parametrize(
    ("unit", "told"),
    [("um,um", "2 entries for 3"), ("um,x=um,nm", "some units only"), ("um,um,parsec", "parsec")],
)
def test_units_that_do_not_fit_are_refused(tmp_path, unit, told):
    with pytest.raises(ms.errors.MetrosepError, match=told):
        ms.read(write_points(tmp_path / "p.xyz"), unit=unit)


def test_points_may_have_heights_in_volts_but_no_positions_in_degrees(tmp_path):
    path = write_points(tmp_path / "p.xyz")
    volts = ms.read(path, unit="um,um,V", scale="-2 um/V")
    assert volts.z == pytest.approx(MAP * -2e-6, abs=1e-15, nan_ok=True)
    for unit in ("deg,um,nm", "um,um,V"):
        with pytest.raises(ms.errors.UnitError, match="is in"):
            ms.read(path, unit=unit)


def test_three_columns_off_a_grid_are_a_narrow_map_only_with_one_unit_and_a_step(tmp_path):
    path = write_matrix(tmp_path / "m.csv", np.array([[1.0, 2, 3], [4, 5, 6], [1, 2, 9]]))
    assert ms.read(path, unit="nm", lateral_step=STEP).z.shape == (3, 3)
    with pytest.raises(ms.errors.FormatMismatchError, match="same place"):
        ms.read(path, unit="um,um,nm")
    with pytest.raises(ms.errors.ReadError, match="takes no lateral_step"):
        ms.read(path, unit="um,um,nm", lateral_step=STEP)


def test_command_reads_points(tmp_path, capsys):
    path = write_points(tmp_path / "p.xyz")
    with pytest.raises(SystemExit) as stop:
        main(["info", str(path), "--unit", "um,um,nm"])
    assert stop.value.code in (0, None)
    assert "urface" in capsys.readouterr().out


def test_few_columns_without_names_may_still_be_channels(tmp_path):
    path = write_matrix(tmp_path / "m.csv", MAP)
    assert set(ms.read(path, sampling_rate="1 kHz").channels) == {
        f"column{i}" for i in range(1, 5)
    }
    with pytest.raises(ms.errors.FormatMismatchError, match=r"sampling_rate=.*map of heights"):
        ms.read(path)
