"""The table of the workbench: its preview is the file, its refusals are those of a run."""

import hashlib
import json

import numpy as np
import pytest
from contracts.recipes import mean_of_runs

from metrosep import controllers as library
from metrosep.app.documents import Edit, Places
from metrosep.app.separations import described_controllers
from metrosep.app.server import Answers
from metrosep.app.sessions import Session
from metrosep.cli.main import main
from metrosep.controllers.safety import CHECKS
from metrosep.core.errors import DataError, MetrosepError, WriteError
from metrosep.recipe.pipeline import CancelledError
from metrosep.recipe.recipe import Recipe

PEAK, AT, WIDTH = 2e-6, 15e-3, 4e-3
"""An error that is lopsided over the travel of 50 mm: mirrored or negated it is another."""

SAME = 1e-9
"""The line that the mean takes off, and the noise of four runs, are below a nanometre at the peak."""

ROUNDING = 1e-11
"""Files hold at least ten picometres here."""


def error_of(x):
    return PEAK * np.exp(-(((x - AT) / WIDTH) ** 2))


def write_runs(folder, *, sign=1.0):
    rng = np.random.default_rng(7)
    x = np.linspace(0.0, 50e-3, 501)
    rows = ["run,x_mm,z_um"]
    for run in range(4):
        z = sign * error_of(x) + 2e-9 * rng.standard_normal(x.size)
        rows += [f"{run},{a * 1e3:.6f},{b * 1e6:.7f}" for a, b in zip(x, z, strict=True)]
    (folder / "runs.csv").write_text("\n".join(rows) + "\n")


def recipe_text(controller="csv", machine="", extra="", spacing='"0.5 mm"', path="z.txt"):
    return f"""{mean_of_runs()}[[output]]
kind = "table"
controller = "{controller}"
axis = "X"
compensates = "Z"
spacing = {spacing}
path = "{path}"
machine = {{ {machine} }}
{extra}
"""


@pytest.fixture
def work(tmp_path):
    """Open a recipe over the same four runs; return what asks."""
    write_runs(tmp_path)

    def start(text=None, **options):
        file = tmp_path / "recipe.toml"
        file.write_text(recipe_text(**options) if text is None else text)
        session = Session(Places([tmp_path]))
        session.open(str(file))
        answers = Answers(session)

        def ask(k="table", **message):
            return answers.answer({"k": k, **message})

        ask.session, ask.folder = session, tmp_path
        return ask

    return start


@pytest.fixture
def ran(monkeypatch, tmp_path, capfd):
    """Run the command line in the folder of the recipe."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        with pytest.raises(SystemExit) as end:
            main([str(w) for w in words])
        assert not end.value.code, capfd.readouterr().err

    return run


# ---- what there is ---------------------------------------------------------------------------


def test_every_dialect_is_listed_with_its_options_and_how_its_sign_is_known(work):
    header, _ = work()("controllers")

    json.dumps(header, allow_nan=False)  # plain
    listed = {c["id"]: c for c in header["controllers"]}
    assert set(listed) == set(library.names())
    assert set(header["checks"]) == set(CHECKS)
    for info in library.describe():
        one = listed[info.id]
        assert one["fits"] is (info.carries != "map")
        assert bool(one["why"]) is not one["fits"]
        assert one["sign"]["needs_trial"] is (info.sign == "unconfirmed")
        assert info.sign_status in one["sign"]["words"]
        asked = {o["name"] for o in one["options"] if o["required"]}
        assert asked <= set(info.example)
    count = next(o for o in listed["pmac"]["options"] if o["name"] == "count")
    assert count["required"]
    assert count["unit"] == "10 um"
    assert {m["name"] for m in header["machine"]} >= {"travel_low", "stroke", "feed"}


def test_every_example_of_an_option_is_one_that_the_option_takes():
    for one in described_controllers():
        dialect = library.find(one["id"])
        for option, said in zip(dialect.options, one["options"], strict=True):
            if said["unit"] and option.lowest is None and option.highest is None:
                taken = option.checked(said["unit"], one["id"])
                assert taken == said["unit"] if option.kind == "length or angle" else taken > 0


# ---- the preview -----------------------------------------------------------------------------

ONE_AXIS = {
    "csv": ("", ""),
    "linuxcnc": ('cross_axis = "hal"', ""),
    "pmac": ('count = "10 nm", source_motor = 1, target_motor = 2', ""),
    "sinumerik-cec": ('input_axis = "AX1", output_axis = "AX3"', "sign_confirmed = true"),
    "heidenhain": ('resolution = "1 nm"', "sign_confirmed = true"),
    "plc-st": ("actuator_sign = 1", "degree = 12"),
}
NEAR = {"pmac": 0.4e-9, "heidenhain": 0.6e-9}
"""Half a step of an entry: a sixteenth of a count of 10 nm; a last digit of 1 nm."""


@pytest.mark.parametrize("controller", ONE_AXIS)
def test_the_preview_is_the_file_that_a_run_writes(work, ran, controller):
    machine, extra = ONE_AXIS[controller]
    ask = work(controller=controller, machine=machine, extra=extra)
    before = sorted(ask.folder.iterdir())

    header, arrays = ask()

    assert "refused" not in header, header.get("refused")
    assert sorted(ask.folder.iterdir()) == before
    ran("run", "recipe.toml", "-o", "out")
    data = (ask.folder / "out" / "z.txt").read_bytes()
    assert header["sha256"] == hashlib.sha256(data).hexdigest()
    lines = data.decode().splitlines()
    shown = header["preview"]
    assert shown["n_lines"] == len(lines)
    assert shown["n_bytes"] == len(data)
    if shown["left_out"]:
        assert shown["lines"] == lines[:30] + lines[-30:]
        assert shown["left_out"] == len(lines) - 60
    else:
        assert shown["lines"] == lines
    held = library.read(ask.folder / "out" / "z.txt", controller)
    look = library.simulate(ask.folder / "out" / "z.txt", controller)
    if header["n_points"]:
        assert header["n_points"] == held.positions.size
        assert np.array_equal(arrays["positions"], held.positions)
        assert np.array_equal(arrays["forward"], held.forward)
        assert np.array_equal(arrays["x"][arrays["entries_at"]], held.positions)
    assert np.array_equal(arrays["applied_forward"], look(arrays["x"], 1))
    assert np.array_equal(arrays["applied_reverse"], look(arrays["x"], -1))


@pytest.mark.parametrize("controller", ["csv", "linuxcnc", "pmac", "sinumerik-cec", "heidenhain"])
def test_the_correction_is_minus_the_error_at_its_place(work, controller):
    machine, extra = ONE_AXIS[controller]
    header, arrays = work(controller=controller, machine=machine, extra=extra)()

    x, c = arrays["x"], arrays["applied_forward"]
    there, other = np.interp([AT, 50e-3 - AT], x, c)
    near = SAME + NEAR.get(controller, ROUNDING)
    line = np.polyval(np.polyfit(x, error_of(x), 1), x)
    wanted = -(error_of(x) - line)
    wanted -= np.interp(0.0, x, wanted)  # zero at the reference
    assert there - c[0] == pytest.approx(np.interp(AT, x, wanted), abs=5 * near)
    assert there < -1.2e-6 < other
    e = arrays["error_forward"]
    assert np.interp(AT, arrays["x"], e) > 1e-6
    assert np.interp(50e-3 - AT, arrays["x"], e) < 0.5e-6
    assert header["reference_m"] == 0.0


def test_the_dry_run_has_numbers_of_both_signs_and_their_uncertainty(work):
    header, _ = work()()

    (row,) = header["verification"]["residuals"]
    x = np.linspace(0, 50e-3, 401)  # the places of a dry-run
    e = error_of(x) - np.polyval(np.polyfit(x, error_of(x), 1), x)
    # five nanometres: the noise of four runs of 2 nm on a P-V; 0.1 nm on an RMS
    assert row["before_pv_m"] == pytest.approx(np.ptp(e), abs=5e-9)
    assert row["before_rms_m"] == pytest.approx(e.std(), abs=1e-10)
    assert row["wrong_sign_rms_m"] == pytest.approx(2 * e.std(), abs=2e-9)
    assert row["after_rms_m"] < 3e-9
    u = row["U_after_rms_m"]
    assert 0 < u < 2e-9
    assert header["verification"]["k"] == 2
    assert header["verification"]["passed"]


def test_what_the_controller_adds_between_the_entries_is_told(work):
    header, arrays = work(spacing='"5 mm"')()

    assert header["n_points"] == 11
    assert header["spacing_m"] == pytest.approx(5e-3, abs=1e-12)
    x, c = arrays["x"], arrays["applied_forward"]
    assert np.interp(12.5e-3, x, c) == pytest.approx(
        np.mean([arrays["forward"][2], arrays["forward"][3]]), abs=1e-14
    )


def test_a_polynomial_has_coefficients_and_no_entries(work):
    machine, extra = ONE_AXIS["plc-st"]
    header, arrays = work(controller="plc-st", machine=machine, extra=extra)()

    assert header["n_points"] is None
    assert header["degree"] == 12
    assert "positions" not in arrays
    at = int(np.argmin(arrays["applied_forward"]))
    assert arrays["x"][at] == pytest.approx(AT, abs=1e-3)


def test_both_directions_have_their_own_columns_and_dry_runs(work):
    """The reverse runs have a second bump at 35 mm; forward has none."""
    ask = work()
    x = np.linspace(0.0, 50e-3, 501)
    rows = ["run,x_mm,z_um"]
    for run in range(4):
        z = error_of(x) + (run % 2) * 0.6e-6 * np.exp(-(((x - 35e-3) / WIDTH) ** 2))
        z += 1e-9 * np.random.default_rng(run).standard_normal(x.size)
        way = slice(None, None, -1 if run % 2 else 1)
        rows += [f"{run},{a * 1e3:.6f},{b * 1e6:.7f}" for a, b in zip(x[way], z[way], strict=True)]
    (ask.folder / "runs.csv").write_text("\n".join(rows) + "\n")
    header, arrays = work()()

    assert header["directions"] == [1, -1]
    assert not header["one_column"]
    assert [r["direction"] for r in header["verification"]["residuals"]] == ["forward", "reverse"]

    def depth(name):
        c = arrays[name]
        return np.interp(35e-3, arrays["x"], c) - np.interp([27e-3, 43e-3], arrays["x"], c).mean()

    assert depth("applied_reverse") == pytest.approx(-0.6e-6, abs=0.03e-6)  # flanks at 8 mm
    assert abs(depth("applied_forward")) < 0.03e-6
    assert depth("error_reverse") > 0.5e-6
    assert np.array_equal(arrays["x"][arrays["entries_at"]], arrays["positions"])


# ---- what is refused -------------------------------------------------------------------------


def refused(header):
    assert "preview" not in header
    assert "sha256" not in header
    return header["refused"]


def test_the_negated_estimate_is_refused_and_shown(work, monkeypatch):
    ask = work()
    turned = ask.folder / "turned"
    turned.mkdir()
    write_runs(turned, sign=-1.0)
    recipe = Recipe.parse(recipe_text(), folder=turned)
    material = ask.session.opened.material
    wrong = recipe.run().estimate
    monkeypatch.setattr(material, "estimate", lambda *_: wrong)

    header, arrays = ask()

    found = refused(header)
    assert found["check"] == "dry-run"
    assert not found["waivable"]
    assert "the reversed sign would shrink it" in found["message"]
    assert found["message"].startswith("z.txt: refused: the dry-run")
    (row,) = header["verification"]["residuals"]
    assert row["after_rms_m"] == pytest.approx(2 * row["before_rms_m"], abs=2e-9)
    assert row["wrong_sign_rms_m"] < 3e-9
    assert [f["check"] for f in header["findings"]] == ["dry-run"]
    assert np.max(arrays["applied_forward"]) > 1e-6
    with pytest.raises(MetrosepError, match="dry-run"):
        ask(write="z.txt")
    assert not (ask.folder / "z.txt").exists()


ACTIVE = 'active = "old.csv"'


def write_old(folder):
    """A table of Z over X that was active: a slope of 20 um/m, zero at the start."""
    from metrosep.compensation import CompensationTable

    old = CompensationTable([0.0, 50e-3], [0.0, 1e-6], None, "X", "Z", 0.0)
    library.write(old, folder / "old.csv", "csv", allow_unverified=True)


def old_line(x):
    return 20e-6 * np.clip(x, 0.0, 50e-3)


def test_a_refused_table_is_shown_with_the_one_that_was_active(work, monkeypatch):
    write_old(work(extra=ACTIVE).folder)
    ask = work(extra=ACTIVE)
    turned = ask.folder / "turned"
    turned.mkdir()
    write_runs(turned, sign=-1.0)
    wrong = Recipe.parse(recipe_text(), folder=turned).run().estimate
    monkeypatch.setattr(ask.session.opened.material, "estimate", lambda *_: wrong)

    header, arrays = ask()

    assert refused(header)["check"] == "dry-run"
    x, added = arrays["x"], arrays["applied_forward"]
    c = np.interp(x, arrays["positions"], arrays["forward"])
    assert np.abs(added - c).max() < ROUNDING
    peak = added[np.argmin(np.abs(x - AT))] - added[0] - old_line(AT)
    assert peak == pytest.approx(PEAK, rel=0, abs=0.2 * PEAK)  # wrong way, its line taken off
    assert added[-1] - added[-50] > 0.5 * (old_line(x[-1]) - old_line(x[-50])) > 0
    (row,) = header["verification"]["residuals"]
    assert row["after_rms_m"] == pytest.approx(2 * row["before_rms_m"], abs=2e-9)


def test_a_recipe_without_a_folder_has_the_table_that_a_run_writes(work):
    write_old(work(extra=ACTIVE).folder)
    folder = work(extra=ACTIVE).folder
    recipe = Recipe.parse(recipe_text(extra=ACTIVE), folder=folder)
    alone = recipe.run().document["table"]
    written = recipe.run(out=folder / "out").document["table"]
    for key in ("positions_m", "forward_m"):
        assert np.abs(np.array(alone[key]) - np.array(written[key])).max() < ROUNDING
    plain = Recipe.parse(recipe_text(), folder=folder).run().document["table"]
    more = np.interp(alone["positions_m"], plain["positions_m"], plain["forward_m"])
    both = np.array(alone["forward_m"]) - more
    assert np.abs(both - old_line(np.array(alone["positions_m"]))).max() < ROUNDING


def test_a_limit_is_refused_by_name_and_can_be_waived(work):
    machine = 'travel_high = "60 mm"'
    ask = work(machine=machine)
    header, arrays = ask()

    found = refused(header)
    assert found["check"] == "coverage"
    assert found["checks"] == ["coverage"]
    assert found["waivable"]
    (error,) = [f for f in header["findings"] if f["level"] == "error"]
    assert error["check"] == "coverage"
    assert error["waivable"]
    assert not error["waived"]
    assert "60 mm" in error["problem"]
    assert arrays["positions"].size == 101
    with pytest.raises(MetrosepError, match="coverage"):
        ask(write="z.txt")

    ask.session.edit([Edit(("output", 0, "waive"), None, ["coverage"])])
    header, _ = ask()

    assert "refused" not in header
    (error,) = [f for f in header["findings"] if f["level"] == "error"]
    assert error["waived"]
    assert header["facts"]["waived"] == ["coverage"]


def test_two_refusals_name_both_checks(work):
    header, _ = work(machine='travel_high = "60 mm", stroke = "1 um"')()

    assert sorted(refused(header)["checks"]) == ["coverage", "stroke"]


def test_a_spacing_that_misses_the_error_is_said(work):
    """Entries 15 mm apart hold the peak of the bump and join it by lines of 15 mm."""
    header, arrays = work(spacing='"15 mm"')()

    (coarse,) = [f for f in header["findings"] if f["check"] == "coarse"]
    assert coarse["level"] == "warning"
    assert "990 nm" in coarse["problem"]
    x, c = arrays["x"], arrays["applied_forward"]
    e = np.interp(x, arrays["x"], arrays["error_forward"])
    assert np.max(np.abs(e - e[0] + c - c[0])) == pytest.approx(990e-9, abs=5e-9)
    # 15 mm does not divide the travel: what was measured beyond 45 mm has no entry
    assert header["held_m"] == [0.0, pytest.approx(45e-3, abs=1e-12)]
    assert header["span_m"] == [0.0, pytest.approx(50e-3, abs=1e-12)]


def test_a_spacing_beyond_the_travel_is_refused_with_the_error_still_shown(work):
    header, arrays = work(spacing='"80 mm"')()

    assert "80 mm" in refused(header)["message"]
    assert set(arrays) == {"x", "error_forward"}


def test_too_many_entries(work):
    header, _ = work(spacing='"1 nm"')()

    assert "5e+07 entries" in refused(header)["message"]


def test_points_of_the_controller(work):
    header, _ = work(machine="max_points = 50")()

    assert refused(header)["check"] == "points"


def test_a_sign_that_is_not_documented_waits_for_a_trial(work):
    machine, _ = ONE_AXIS["sinumerik-cec"]
    ask = work(controller="sinumerik-cec", machine=machine)
    header, arrays = ask(trial="2 um")

    found = refused(header)
    assert found["check"] == "sign"
    assert found["option"] == "sign_confirmed"
    assert not found["waivable"]
    assert header["sign"]["needs_trial"]
    assert not header["sign"]["confirmed"]
    assert "indicator" in header["trial"]["instruction"]
    assert header["verification"]["passed"]
    assert "applied_forward" in arrays
    with pytest.raises(MetrosepError, match="not known from its documents"):
        ask(write="z.txt")
    assert not (ask.folder / "z.txt").exists()


def test_the_dialect_itself_refuses_another_axis(work):
    header, arrays = work(controller="linuxcnc")()

    assert "cross axis" in refused(header)["message"]
    assert refused(header)["check"] == "format"
    assert not refused(header)["waivable"]
    assert arrays["forward"].size == 101
    assert "applied_forward" not in arrays


def test_what_else_is_wrong_is_said_beside_an_unknown_sign(work):
    """An axis' own table for a cross-axis error: confirming the sign would not help."""
    header, _ = work(controller="isg-axis", machine="axis_number = 2")()

    assert refused(header)["check"] == "sign"
    (other,) = header["findings"]
    assert other["check"] == "format"
    assert "X -> Z" in other["problem"]
    assert not other["waivable"]


def test_a_map_controller_is_refused(work):
    ask = work()
    stored = ask.session.state()["outputs"][0]

    header, _ = ask(draft={**stored, "controller": "klipper"})

    assert "holds maps over two axes" in refused(header)["message"]


def test_a_missing_option_is_named_before_the_recipe_has_it(work):
    ask = work()
    stored = ask.session.state()["outputs"][0]
    draft = {**stored, "controller": "pmac", "machine": {}}

    header, arrays = ask(draft=draft)

    assert header["refused"]["option"] == "count"
    assert "pmac cannot be written without count (" in header["refused"]["message"]
    assert arrays == {}
    header, _ = ask(
        draft={**draft, "machine": {"count": "10 nm", "source_motor": 1, "target_motor": 2}}
    )
    assert "refused" not in header
    assert ask.session.state()["outputs"][0] == stored
    with pytest.raises(DataError, match="draft is not written"):
        ask(draft=stored, write="z.txt")


def test_a_wrong_value_of_a_draft_is_named(work):
    ask = work()
    stored = ask.session.state()["outputs"][0]
    header, _ = ask(draft={**stored, "controller": "pmac", "machine": {"count": "ten"}})

    assert "count" in header["refused"]["message"]


# ---- which table -----------------------------------------------------------------------------


def test_a_recipe_without_a_table_gets_one_suggested(work):
    text = recipe_text().partition("[[output]]")[0]
    ask = work(text)
    header, arrays = ask()

    assert header["n_tables"] == 0
    assert arrays == {}
    suggested = header["suggested"]
    assert (suggested["axis"], suggested["compensates"]) == ("X", "Z")
    assert suggested["spacing"] == "0.5 mm"
    ask.session.edit([Edit(("output", 0), None, suggested)])
    header, _ = ask()
    assert header["n_tables"] == 1
    assert header["preview"]["n_lines"] > 100


def test_the_second_table_of_a_recipe(work):
    text = recipe_text() + recipe_text(path="b.txt", spacing="11").partition('method = "mean"')[2]
    ask = work(text)

    assert ask()[0]["n_points"] == 101
    header, _ = ask(output=1)
    assert header["n_points"] == 11
    assert header["name"] == "b.txt"
    for wrong in (2, -1, True, "0"):
        with pytest.raises(DataError, match="number of a table"):
            ask(output=wrong)


def test_a_cancelled_request_stops(work):
    ask = work()
    with pytest.raises(CancelledError):
        Answers(ask.session).answer({"k": "table"}, lambda: True)


def test_a_map_has_no_table(tmp_path):
    import metrosep as ms

    rng = np.random.default_rng(1)
    ms.write(ms.Surface(1e-8 * rng.standard_normal((20, 20)), 1e-3, 1e-3), tmp_path / "m.x3p")
    session = Session(Places([tmp_path]))
    session.open(str(tmp_path / "m.x3p"))
    with pytest.raises(DataError, match="made of separated runs"):
        Answers(session).answer({"k": "table"})


# ---- files -----------------------------------------------------------------------------------


def test_a_table_is_not_made_of_runs_that_changed_since(work):
    ask = work(controller="csv")
    opened, _ = ask.session.need()
    before = opened.files[0].read_bytes()
    for content in (before + b"\n", None):
        if content is None:
            opened.files[0].unlink()
        else:
            opened.files[0].write_bytes(content)
        with pytest.raises(WriteError, match="changed since it was opened; open it again"):
            ask(write="z2.txt")
    assert not (ask.folder / "z2.txt").exists()


@pytest.mark.parametrize("controller", ["linuxcnc", "pmac", "heidenhain", "plc-st"])
def test_the_exported_files_are_those_of_the_command_line(work, ran, controller):
    machine, extra = ONE_AXIS[controller]
    ask = work(controller=controller, machine=machine, extra=extra)
    header, _ = ask(write="by_hand.txt")

    assert [f.rpartition("/")[2] for f in header["files"]] == ["by_hand.txt", "by_hand.txt.json"]
    ran("run", "recipe.toml", "-o", "out")
    for end in ("", ".json"):
        mine = (ask.folder / f"by_hand.txt{end}").read_bytes()
        assert mine == (ask.folder / "out" / f"z.txt{end}").read_bytes()
    if controller == "plc-st":
        return  # `metrosep table` fits a polynomial to the mean runs that a result keeps
    # the result of the separation alone: what `metrosep table` is given after `metrosep separate`
    alone = Recipe.parse(recipe_text().partition("[[output]]")[0], folder=ask.folder)
    alone.run(ask.folder / "runs.csv").write(ask.folder / "result.json")
    wanted = [
        f"--machine={m.strip()}" for m in machine.replace('"', "").replace(" = ", "=").split(",")
    ]
    confirmed = ["--sign-confirmed"] if "sign_confirmed" in extra else []
    ran("table", "result.json", "--format", controller, "--compensates", "Z",
               "--spacing", "0.5 mm", *wanted, *confirmed, "-o", "cli.txt")  # fmt: skip
    assert (ask.folder / "cli.txt").read_bytes() == (ask.folder / "by_hand.txt").read_bytes()


def test_the_trial_is_that_of_the_command_line(work, ran):
    machine, _ = ONE_AXIS["sinumerik-cec"]
    ask = work(controller="sinumerik-cec", machine=machine)
    header, _ = ask(write="trial.INI", trial="2 um")

    assert "+2 um" in header["trial"]["if_right"] or "2 um" in header["trial"]["if_right"]
    result = Recipe.parse(recipe_text().partition("[[output]]")[0], folder=ask.folder).run(
        ask.folder / "runs.csv"
    )
    result.write(ask.folder / "result.json")
    ran("table", "result.json", "--format", "sinumerik-cec", "--compensates", "Z", "--spacing",
               "0.5 mm", "--machine", "input_axis=AX1", "--machine", "output_axis=AX3", "--trial", "2 um",
               "-o", "cli.INI")  # fmt: skip
    for end in ("", ".json"):
        mine = (ask.folder / f"trial.INI{end}").read_bytes()
        assert mine == (ask.folder / f"cli.INI{end}").read_bytes()
    assert json.loads((ask.folder / "trial.INI.json").read_text())["trial"] is not None


@pytest.mark.parametrize("height", ["2", "2 V", "", 2e-6, "0 um"])
def test_a_trial_needs_a_height(work, height):
    ask = work()
    with pytest.raises(MetrosepError):
        ask(write="t.txt", trial=height)
    assert not (ask.folder / "t.txt").exists()


def test_no_trial_of_a_polynomial(work):
    machine, extra = ONE_AXIS["plc-st"]
    ask = work(controller="plc-st", machine=machine, extra=extra)
    with pytest.raises(DataError, match="no meaning for a polynomial"):
        ask(write="t.txt", trial="2 um")


def test_outside_the_opened_folders_nothing_is_written(work, tmp_path_factory):
    ask = work()
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "z.txt"
    for path in (str(elsewhere), "../z.txt", "nowhere/z.txt", "", "a\0b"):
        with pytest.raises(WriteError):
            ask(write=path)
    assert not elsewhere.exists()


def test_a_file_of_somebody_else_is_never_replaced(work):
    ask = work()
    target = ask.folder / "z.txt"
    target.write_text("0 1\n")
    for beside in (None, "{}", "no json"):
        if beside is not None:
            (ask.folder / "z.txt.json").write_text(beside)
        with pytest.raises(WriteError, match="not written by metrosep"):
            ask(write="z.txt", overwrite=True)
        assert target.read_text() == "0 1\n"


@pytest.mark.parametrize("name", ["runs.csv", "recipe.toml", "."])
def test_what_is_open_is_never_replaced(work, name):
    ask = work()
    before = (ask.folder / "runs.csv").read_bytes()
    with pytest.raises(WriteError):
        ask(write=name, overwrite=True)
    assert (ask.folder / "runs.csv").read_bytes() == before


def test_a_foreign_sidecar_is_not_replaced(work):
    ask = work()
    (ask.folder / "z.txt.json").write_text("[1]")
    with pytest.raises(WriteError, match="exists already"):
        ask(write="z.txt", overwrite=True)
    assert (ask.folder / "z.txt.json").read_text() == "[1]"


def test_an_own_file_is_replaced_only_when_told(work):
    ask = work()
    ask(write="z.txt")
    before = (ask.folder / "z.txt").read_bytes()
    beside = (ask.folder / "z.txt.json").read_bytes()
    ask(write="z.txt")  # the same bytes: nothing is replaced
    ask.session.edit([Edit(("output", 0, "spacing"), "0.5 mm", "1 mm")])
    with pytest.raises(WriteError, match="exists already"):
        ask(write="z.txt")
    assert (ask.folder / "z.txt").read_bytes() == before
    assert (ask.folder / "z.txt.json").read_bytes() == beside
    assert not list(ask.folder.glob("z.txt.1*"))
    ask(write="z.txt", overwrite=True)
    now = (ask.folder / "z.txt").read_bytes()
    assert len(now) < len(before)
    assert (ask.folder / "z.txt.1").read_bytes() == before
    assert (ask.folder / "z.txt.1.json").read_bytes() == beside
    (ask.folder / "z.txt").write_bytes(now + b"# edited\n")
    with pytest.raises(WriteError, match="changed since"):
        ask(write="z.txt", overwrite=True)


def test_a_table_of_other_readings_is_not_replaced(work):
    ask = work()
    ask(write="z.txt")
    write_runs(ask.folder, sign=0.5)
    other = work()
    with pytest.raises(MetrosepError, match="made of other readings"):
        other(write="z.txt", overwrite=True)


def test_a_recipe_that_changed_meanwhile_is_not_written(work):
    ask = work()
    shown = ask.session.state()["hash"]
    ask.session.edit([Edit(("output", 0, "spacing"), "0.5 mm", "1 mm")])
    with pytest.raises(DataError, match="has changed since"):
        ask(write="z.txt", hash=shown)
    ask(write="z.txt", hash=ask.session.state()["hash"])


# ---- over the socket -------------------------------------------------------------------------


def test_the_page_gets_frames_with_news_and_curves(work, tmp_path):
    from starlette.testclient import TestClient

    from metrosep.app.server import make_app
    from metrosep.app.wire import unpack

    work()
    app = make_app(
        Places([tmp_path]), port=8123, token="t" * 43, first=str(tmp_path / "recipe.toml")
    )
    headers = {"host": "127.0.0.1:8123"}
    with (
        TestClient(app, base_url="http://127.0.0.1:8123") as http,
        http.websocket_connect(f"/ws?token={'t' * 43}", headers=headers) as socket,
    ):
        socket.send_text(json.dumps({"id": 1, "k": "table"}))
        news, _ = unpack(socket.receive_bytes())
        header, arrays = unpack(socket.receive_bytes())

    assert (news["k"], news["of"]) == ("progress", 1)
    assert header["ok"]
    assert header["id"] == 1
    assert arrays["entries_at"].dtype == np.int32
    assert np.array_equal(arrays["x"][arrays["entries_at"]], arrays["positions"])
