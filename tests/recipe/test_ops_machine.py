"""Steps with the model of a machine: each gives what the call gives, and names what was planted."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, MetrosepError, RecipeError, UnitError
from metrosep.machine import presets, rank
from metrosep.recipe.describe.described import describe

TORIC = 'form = "toric: Rb=265 mm, Rd=132.5 mm"\n'
PART = 'machine = "fts_lathe"\nradius = "20 mm"\n'
RB, RD = 0.265, 0.1325


def run(op, text, files=None):
    head = "metrosep = 1\n" if files is None else "metrosep = 1\n[input]\n"
    return ms.Recipe.parse(f'{head}[[step]]\nop = "{op}"\n{text}').run(files)


def found(result):
    return {c["metric"]: (c["value"], c["u"]) for c in result.document["characteristics"]}


def toric(x, y):
    return RB - np.sqrt((RB - RD + np.sqrt(RD**2 - y**2)) ** 2 - x**2)


@pytest.fixture
def part(tmp_path):
    """Return a function that writes a part of 20 mm radius cut with errors."""

    def write(squareness=0.0, out=0.0, along=0.0, noise=2e-9):
        line = np.arange(-40, 41) * 0.5e-3
        x, y = np.meshgrid(line, line)
        rho, azimuth = np.hypot(x, y), np.arctan2(y, x)
        at_x = out * np.cos(azimuth) - along * np.sin(azimuth)
        at_y = out * np.sin(azimuth) + along * np.cos(azimuth)
        z = toric(x - at_x, y - at_y) - squareness * (0.02 - rho)
        z += noise * np.random.default_rng(4).standard_normal(z.shape)
        file = tmp_path / "part.h5"
        ms.write(ms.Surface(np.where(rho <= 0.02, z, np.nan), 0.5e-3, 0.5e-3), file)
        return file

    return write


def test_rank_is_the_call():
    text = TORIC + PART + 'errors = { EXX = "1 um", EYX = "2 um", B0Z = "0.001 deg" }\n'
    values = found(run("rank", text))

    errors = {"EXX": "1 um", "EYX": "2 um", "B0Z": "0.001 deg"}
    table = rank(
        presets("fts_lathe", radius=20e-3),
        ms.forms.Toric(Rb=RB, Rd=RD),
        radius=20e-3,
        errors=errors,
    )
    for name in errors:
        assert values[f"sq.{name}"][0] == pytest.approx(
            table.sq[table.names.index(name)], abs=1e-15
        )
    # papers.md 4.3, levelled: Hzx .0823, dx .0330, dy .0190 um for 1 um
    assert values["sq.B0Z"][0] == pytest.approx(0.0823e-6, abs=5e-11)
    assert values["sq.EYX"][0] == pytest.approx(2 * 0.0190e-6, abs=1e-10)
    assert values["expected_sq"][0] == pytest.approx(table.expected_sq, abs=1e-15)


def test_names_of_the_paper_and_common_magnitudes():
    text = (
        TORIC + PART + 'removed = "none"\nall_lengths = "1 um"\nerrors = { Hzx = "0.002 deg" }\n'
    )
    values = found(run("rank", text))

    assert values["sq.B0Z"][0] == pytest.approx(2 * 0.1425e-6, abs=2e-10)
    assert values["sq.EZX"][0] == pytest.approx(1e-6, abs=1e-12)
    assert "sq.EAC" not in values  # an angle: all_lengths says nothing of it


def test_spindle_errors_fixed_in_the_machine_are_a_cone():
    """papers.md 4.1: with E Rz, ecy gives eps rho, a cone, and not a tilt that levelling takes."""
    text = TORIC + PART + 'errors = { EBC = "0.001 deg" }\n'
    turning = found(run("rank", text))["sq.EBC"][0]
    fixed = found(run("rank", text + 'spindle_errors = "fixed"\n'))["sq.EBC"][0]

    cone = (
        np.radians(0.001) * 0.02 / np.sqrt(18)
    )  # rms of rho less its mean over a disc, flat limit
    assert turning < 1e-9
    assert fixed == pytest.approx(cone, rel=0.03, abs=0.0)


def test_machine_of_a_file_beside_the_recipe(tmp_path):
    text = (
        'name = "lathe"\n[[element]]\nname = "X"\nbranch = "tool"\nkind = "linear"\ndirection = "+X"\n'
        '[[element]]\nname = "Z"\nbranch = "tool"\nkind = "linear"\ndirection = "+Z"\n'
        '[[element]]\nname = "C"\nbranch = "workpiece"\nkind = "rotary"\ndirection = "+Z"\n'
    )
    (tmp_path / "m.toml").write_text(text, "utf-8")
    recipe = tmp_path / "r.toml"
    recipe.write_text(
        'metrosep = 1\n[[step]]\nop = "rank"\nmachine = "m.toml"\nradius = "20 mm"\n'
        'errors = { EZX = "1 um" }\nremoved = "none"\n' + TORIC,
        "utf-8",
    )
    values = found(ms.Recipe.load(recipe).run())

    assert values["sq.EZX"][0] == pytest.approx(1e-6, abs=1e-12)


def test_wavefront_of_a_piston_and_its_zernike_terms():
    text = TORIC + PART + 'errors = { EZX = "1 um", B0Z = "0.001 deg" }\nresponse = "wavefront"\n'
    values = found(run("rank", text + 'removed = "none"\n'))

    assert values["sq.EZX"][0] == pytest.approx(2.015e-6, abs=1e-9)  # papers.md 4.4
    assert values["sq.B0Z"][0] == pytest.approx(0.284e-6, abs=6e-10)


def test_identify_finds_signs_and_leaves_the_noise(part):
    file = part(squareness=-np.radians(0.002), out=1e-6, along=-3e-6)
    values = found(run("identify", TORIC + PART + 'terms = ["EXX", "EYX", "B0Z"]\n', [file]))

    for name, true in (("EXX", 1e-6), ("EYX", -3e-6), ("B0Z", -np.radians(0.002))):
        value, u = values[name]
        assert abs(value - true) < 3.5 * u
        assert u < 0.01 * abs(true)
    assert values["sq_after"][0] == pytest.approx(2e-9, abs=1e-10)


def test_identify_says_what_to_enter(part):
    """The correction is the negative of the error: cut 3 um too far along -y, move +3 um."""
    result = run("identify", TORIC + PART + 'terms = ["EYX"]\n', [part(along=-3e-6, noise=0.0)])
    words = [m for m in result.document["messages"] if m.startswith("correction: EYX +")]
    assert len(words) == 1
    assert float(words[0].split()[2]) == pytest.approx(3.0, abs=0.02)
    assert words[0].split()[3] == "um"


def test_identify_reports_what_hangs_together_as_one(part):
    result = run("identify", TORIC + PART + 'terms = ["EYX", "EAX"]\n', [part(along=2e-6)])
    values = found(result)

    assert "EYX" not in values
    assert values["EYX+EAX"][0] == pytest.approx(2 * 19.0e-9, abs=0.1 * 2 * 19.0e-9)
    value, u = values["EYX+EAX.EYX"]  # were it alone, with its sign
    assert abs(value - 2e-6) < 3.5 * u + 0.02e-6
    table = describe(result.produced).tables["groups"]
    assert table["term"] == ["EYX", "EAX"]
    assert table["if_alone_si"][0] == value
    assert any("correct one alone" in m for m in result.document["messages"])


def test_identify_says_once_what_it_cannot_see(part):
    result = run("identify", TORIC + PART + 'terms = ["EXX", "EZX"]\n', [part(out=1e-6)])

    assert "EZX" not in found(result)
    assert sum(m.startswith("EZX") for m in result.document["messages"]) == 1


def test_wavefront_of_a_measured_sphere(tmp_path):
    """A mirror of sag rho^2 / 2R sends back twice the sag: Z4 is 2 sag / (2 sqrt 3) over the rim."""
    line = np.linspace(-5e-3, 5e-3, 101)
    x, y = np.meshgrid(line, line)
    sag = 1e-6
    z = sag * (x**2 + y**2) / 25e-6
    ms.write(
        ms.Surface(np.where(np.hypot(x, y) <= 5e-3, z, np.nan), 1e-4, 1e-4), tmp_path / "m.h5"
    )
    text = 'terms = 6\nwavelength = "633 nm"\nremoved = "piston, tilt, defocus"\nradius = "5 mm"\n'
    values = found(run("wavefront", text, [tmp_path / "m.h5"]))

    assert values["Z4"][0] == pytest.approx(sag / np.sqrt(3), rel=2e-3, abs=0.0)
    assert values["rms"][0] < 1e-9
    assert values["strehl"][0] > 0.999


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ('machine = "fts_lath"\nall_lengths = "1 um"\n', DataError, 'Did you mean "fts_lathe"'),
        ('machine = "none.toml"\nall_lengths = "1 um"\n', DataError, "there is no such file"),
        (
            'machine = "fts_lathe"\nerrors = { EXQ = "1 um" }\n',
            DataError,
            "'EXQ' is not an error term",
        ),
        ('machine = "fts_lathe"\nerrors = { EXX = "1" }\n', UnitError, "EXX '1' has no unit"),
        (
            'machine = "fts_lathe"\nerrors = { EXX = "1 deg" }\n',
            UnitError,
            "EXX.*length is needed",
        ),
        (
            'machine = "fts_lathe"\nerrors = { EBX = "5 rad" }\n',
            DataError,
            "EBX = 5 rad is beyond",
        ),
        ('machine = "fts_lathe"\nerrors = { EXX = "1 m" }\n', DataError, "EXX = 1 m is beyond"),
        ('machine = "fts_lathe"\nerrors = { dxx = "1 um", EXX = "1 um" }\n', DataError, "twice"),
        ('machine = "fts_lathe"\n', DataError, "no error is given"),
        ('machine = "fts_lathe"\nall_lengths = "1 um"\nremoved = "foo"\n', DataError, "'foo'"),
        ('machine = "fts_lathe"\nall_lengths = "1 um"\nn = 1.5\n', DataError, "wavefront"),
        (
            'machine = "fts_lathe"\nall_lengths = "1 um"\ntool = ["1 mm"]\n',
            DataError,
            "three lengths",
        ),
        ('machine = "fts_lathe"\nall_lengths = "1"\n', RecipeError, "no unit"),
    ],
)
def test_rank_refuses(text, kind, words):
    with pytest.raises(kind, match=words):
        run("rank", TORIC + 'radius = "20 mm"\n' + text)


def test_name_of_the_paper_is_told():
    result = run("rank", TORIC + PART + 'errors = { dxy = "1 um", EXX = "1 um" }\n')
    assert any("dxy is a name of the paper: EYX" in m for m in result.document["messages"])
    assert not any(m.startswith("EXX is a name") for m in result.document["messages"])


def test_radius_in_the_wrong_unit_is_refused():
    with pytest.raises(DataError, match="radius = 15 m"):
        run("rank", TORIC + PART.replace("20 mm", "15 m") + 'errors = { EXX = "1 um" }\n')


@pytest.mark.slow
def test_height_of_the_part_is_no_fault_of_the_machine():
    """A shift along z moves the vertex off the reference plane: that leads a wavefront only."""
    text = TORIC + PART + 'errors = { EZX = "1 um", EXX = "1 um" }\n'
    wave = run("rank", text + 'response = "wavefront"\n').document["messages"]
    form = run("rank", text).document["messages"]

    assert any(m.startswith("EZX only move the whole part") for m in wave)
    assert not any("move the whole part" in m for m in form)


def test_form_without_a_parameter_is_refused():
    with pytest.raises(DataError, match="no value for Rd"):
        run("rank", 'form = "toric: Rb=265 mm"\n' + PART + 'all_lengths = "1 um"\n')


def test_part_larger_than_its_surface_is_refused():
    with pytest.raises(DataError, match="ends at a radius of 132"):
        run("rank", TORIC + PART.replace("20 mm", "150 mm") + 'all_lengths = "1 um"\n')


def test_surface_nowhere_defined_is_refused():
    text = 'form = "sphere: R=1 mm"\n' + PART + 'inner_radius = "10 mm"\nall_lengths = "1 um"\n'
    with pytest.raises(MetrosepError, match="surface"):
        run("rank", text)


def test_options_of_a_preset_do_not_go_with_a_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.toml").write_text("", "utf-8")
    text = TORIC + 'machine = "m.toml"\nradius = "20 mm"\nall_lengths = "1 um"\n'
    with pytest.raises(DataError, match="belong to a preset"):
        run("rank", text + 'spindle_errors = "fixed"\n')


def test_chain_that_is_none_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.toml").write_text('name = "empty"\n', "utf-8")
    with pytest.raises(DataError, match="no element"):
        run("rank", TORIC + 'machine = "m.toml"\nradius = "20 mm"\nall_lengths = "1 um"\n')


def test_identify_needs_the_radius_of_a_lathe(part):
    with pytest.raises(DataError, match="needs the radius"):
        run("identify", TORIC + 'machine = "fts_lathe"\nterms = ["EXX"]\n', [part()])


def test_rows_of_nothing_are_words_and_not_numbers():
    text = TORIC + PART + 'errors = { EZX = "1 um", EXX = "1 um", EYX = "0 um" }\n'
    result = run("rank", text)
    told = " ".join(result.document["messages"])

    assert set(found(result)) == {"expected_sq", "expected_sq_raw", "sq.EXX"}
    assert "EZX: not visible on this part (taken away by the alignment" in told
    assert "EYX: not visible on this part (size zero)" in told


def test_a_check_may_name_a_term_of_which_nothing_is_left():
    text = TORIC + PART + 'errors = { EZX = "1 um", EXX = "1 um" }\n'
    result = run("rank", text + '[[check]]\nmetric = "sq.EZX"\nupper = "1 nm"\nU = "0.1 nm"\n')

    assert result.verdict == "accept"
    assert found(result)["sq.EZX"][0] == 0.0


def test_nothing_visible_has_no_steps_of_compensation():
    result = run("rank", TORIC + PART + 'errors = { EZX = "1 um" }\n')

    assert not [m for m in result.document["messages"] if m.startswith("without")]
    assert result.document["separation"]["ranking"]["terms"][0]["share"] is None


def test_a_size_comes_back_as_it_was_typed():
    text = TORIC + PART + 'errors = { EBX = "1 arcsec", B0Z = "0.001 deg", EXX = "2 um" }\n'
    result = run("rank", text)
    sizes = {t["term"]: t["size"] for t in result.document["separation"]["ranking"]["terms"]}
    words = {c["metric"]: c["definition"] for c in result.document["characteristics"]}

    assert sizes == {"EBX": "1 arcsec", "B0Z": "0.001 deg", "EXX": "2 um"}
    assert "from EBX = 1 arcsec;" in words["sq.EBX"]
