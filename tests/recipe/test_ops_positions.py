"""Positioning tests from recipes: columns, lists of the standard, rotary axes, diagonals."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import MetrosepError
from metrosep.recipe.result import load_document
from metrosep.separation import iso230_2, iso230_6_diagonals

TARGETS = np.array([3.0, 51.0, 98.0, 152.0, 199.0]) * 1e-3
RUNS = 5


def reached(seed, lift=0.0, length=1.0):
    rng = np.random.default_rng(seed)
    error = 2e-6 * np.sin(20 * TARGETS) + 3e-5 * TARGETS * (length - 1.0) + lift
    return TARGETS[:, None] + error[:, None] + 0.3e-6 * rng.standard_normal((TARGETS.size, RUNS))


def written(path, tests, unit="mm", factor=1e3):
    """Rows of target and direction; `tests` maps a diagonal (or "") to forward and backward."""
    several = list(tests) != [""]
    head = (["diagonal"] if several else []) + [f"target_{unit}", "way"]
    lines = [",".join(head + [f"r{j}_{unit}" for j in range(RUNS)])]
    for name, ways in tests.items():
        for word, values in zip(("fwd", "bwd"), ways, strict=True):
            for target, row in zip(TARGETS, values, strict=True):
                cells = ([name] if several else []) + [f"{target * factor:.9f}", word]
                lines.append(",".join(cells + [f"{v * factor:.9f}" for v in row]))
    path.write_text("\n".join(lines) + "\n", "ascii")
    return path


def text(op, unit="mm", rest="", step=""):
    runs = ", ".join(f'"r{j}_{unit}"' for j in range(RUNS))
    return (
        f'metrosep = 1\n[input]\ntarget = "target_{unit}"\ndirection = "way"\n'
        f'readings = [{runs}]\n{rest}[[step]]\nop = "{op}"\n{step}'
    )


UP, DOWN = reached(1), reached(2, lift=-1.5e-6)


def values(result):
    return {c["metric"]: c for c in result.document["characteristics"]}


def test_a_table_gives_what_the_call_gives_and_the_chart(tmp_path):
    file = written(tmp_path / "p.csv", {"": (UP, DOWN)})
    recipe = text("iso230_2") + '[[check]]\nmetric = "B"\nupper = "3 um"\n'
    recipe += '[[output]]\nkind = "parts"\n[[output]]\nkind = "report"\n'
    result = ms.Recipe.parse(recipe).run(file, out=tmp_path / "out")

    called = iso230_2(TARGETS, UP, DOWN)
    found = values(result)
    for key in ("A", "R", "E", "B", "B_mean", "M"):
        assert found[key]["value"] == pytest.approx(called[key].value, abs=1e-11)
        assert found[key]["u"] == pytest.approx(called[key].u, rel=1e-3, abs=0.0)
    assert found["B_mean"]["value"] > 1e-6  # forward lies higher, as planted
    assert result.verdict == "accept"
    stored = load_document(tmp_path / "out")["separation"]
    assert stored["charts"][0]["kind"] == "positions"
    np.testing.assert_allclose(
        stored["charts"][0]["mean_backward"], called.mean_backward, rtol=0.0, atol=1e-11
    )
    rows = (tmp_path / "out" / "parts.csv").read_text("ascii").splitlines()
    assert rows[0].startswith("target_mm,mean_fwd_um,mean_bwd_um")
    assert len(rows) == 1 + TARGETS.size
    assert "Positioning test" in (tmp_path / "out" / "report.html").read_text("utf-8")


def test_a_rotary_axis_is_told_by_its_unit(tmp_path):
    angles = written(tmp_path / "a.csv", {"": (UP, DOWN)}, unit="deg", factor=180 / np.pi)
    result = ms.Recipe.parse(text("iso230_2", unit="deg")).run(angles)
    assert values(result)["E"]["unit"] == "rad"
    assert values(result)["E"]["value"] == pytest.approx(
        iso230_2(TARGETS, UP, DOWN, unit="rad")["E"].value, abs=1e-10
    )


def test_a_list_of_the_standard_needs_no_columns(tmp_path):
    lines = ["UNIT=mm", f"CYCLES={RUNS}", f"POSITIONS={TARGETS.size}"]
    lines += [f"TGT_DATA[{i + 1}]={t * 1e3:.4f}" for i, t in enumerate(TARGETS)]
    for key, data in (("FWD", UP), ("BWD", DOWN)):
        for (i, j), v in np.ndenumerate(data):
            lines.append(f"REF_DATA_{key}[{i + 1},{j + 1}]={v * 1e3:.9f}")
    file = tmp_path / "test.txt"
    file.write_text("\n".join(lines) + "\n", "ascii")
    recipe = 'metrosep = 1\n[input]\n[[step]]\nop = "iso230_2"\n'
    result = ms.Recipe.parse(recipe).run(file)
    assert values(result)["B"]["value"] == pytest.approx(
        iso230_2(TARGETS, UP, DOWN)["B"].value, abs=1e-11
    )


def test_missing_columns_and_foreign_files_are_refused(tmp_path):
    file = written(tmp_path / "p.csv", {"": (UP, DOWN)})
    with pytest.raises(MetrosepError, match="column of direction is not named"):
        ms.Recipe.parse(text("iso230_2").replace('direction = "way"\n', "")).run(file)
    with pytest.raises(MetrosepError, match="not a list of a positioning test"):
        ms.Recipe.parse('metrosep = 1\n[input]\n[[step]]\nop = "iso230_2"\n').run(file)


DIAGONALS = {
    name: (reached(i, length=1.0 + 0.2 * i), reached(i + 10, lift=-1e-6))
    for i, name in enumerate(("ppp", "npp", "pnp", "nnp"))
}
SIZE = 'size = ["120 mm", "120 mm", "101 mm"]\n'


def test_diagonals_from_files_or_from_a_column(tmp_path):
    called = iso230_6_diagonals(
        {k: (TARGETS, *v) for k, v in DIAGONALS.items()}, size=(0.12, 0.12, 0.101)
    )
    files = [written(tmp_path / f"{k}.csv", {"": v}) for k, v in DIAGONALS.items()]
    by_name = ms.Recipe.parse(text("iso230_6_diagonals", step=SIZE)).run(files)
    one = written(tmp_path / "all.csv", DIAGONALS)
    by_column = ms.Recipe.parse(
        text("iso230_6_diagonals", rest='diagonal = "diagonal"\n', step=SIZE)
    ).run(one)
    for result in (by_name, by_column):
        found = values(result)
        assert found["a_xy"]["value"] == pytest.approx(called.squareness.a_xy, abs=1e-9)
        assert found["ppp.length_error"]["value"] == pytest.approx(
            called.length_errors["ppp"].value, abs=1e-11
        )
        assert found["npp.B"]["value"] == pytest.approx(called.tests["npp"]["B"].value, abs=1e-11)
    assert len(by_name.document["separation"]["charts"][0]["panels"]) == 4


def test_names_of_diagonals_must_fit_the_files(tmp_path):
    files = [written(tmp_path / f"f{i}.csv", {"": v}) for i, v in enumerate(DIAGONALS.values())]
    step = 'names = ["ppp", "npp", "pnp"]\n'
    with pytest.raises(MetrosepError, match="3 names of diagonals for 4 files"):
        ms.Recipe.parse(text("iso230_6_diagonals", step=step)).run(files)
    with pytest.raises(MetrosepError, match="named twice"):
        ms.Recipe.parse(
            text("iso230_6_diagonals", step='names = ["ppp", "npp", "pnp", "ppp"]\n')
        ).run(files)
