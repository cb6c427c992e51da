"""Adding is one place: what is planted there is found at every door.

A method with an option is planted as one module of metrosep.separation and one line of its
``METHODS``; an option as one field. Controllers: tests/controllers/test_registry.py. Formats:
tests/io/test_registry.py. Parameters: below.
"""

import dataclasses
import importlib
import json
import sys
import types

import numpy as np
import pytest

import metrosep as ms
from metrosep import separation
from metrosep.cli.main import main
from metrosep.cli.shortcut import typed
from metrosep.core.options import KINDS, option, options_of
from metrosep.errors import DataError, RecipeError
from metrosep.recipe import Recipe
from metrosep.recipe.step_help import described_steps

PLANTED = '''
"""A method that exists in this test only."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from metrosep.core.options import option
from metrosep.separation.contract import NamedMethod, Separation


@dataclass(frozen=True, slots=True)
class Planted(NamedMethod):
    """Moves a curve by a width."""

    width: float = option(1e-3, kind="size", help="by how much the curve is moved, zzz")

    name: ClassVar[str] = "planted_method"
    what: ClassVar[str] = "a curve that is moved"
    readings: ClassVar[tuple[str, ...]] = ("curve",)
    over: ClassVar = "x"


def planted_method(curve, *, x, width=1e-3):
    z = np.ravel(np.asarray(curve))
    return Separation(
        "planted_method", {"curve": z}, {"curve": np.zeros(z.size)}, {"curve": "m"},
        {"x": np.asarray(x) + width}, (), audit={"width_mm": 1e3 * width},
    )
'''


@pytest.fixture
def planted(monkeypatch):
    module = types.ModuleType("metrosep.separation.zz_planted")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(PLANTED, "zz_planted.py", "exec"), module.__dict__)  # noqa: S102
    monkeypatch.setitem(separation.METHODS, "planted_method", "zz_planted:Planted")
    return module


def printed(capsys, *words):
    with pytest.raises(SystemExit) as end:
        main([str(w) for w in words])
    out, err = capsys.readouterr()
    return end.value.code, out, err


RECIPE = """metrosep = 1
[input]
files = ["a.csv"]
x = "x_mm"
readings = ["z_um"]
[[step]]
op = "planted_method"
width = "{width}"
"""


def test_a_planted_method_is_listed_with_its_option(planted, capsys):
    code, out, _ = printed(capsys, "ops")
    assert code == 0
    assert "planted_method: a curve that is moved" in out
    code, out, _ = printed(capsys, "ops", "planted_method")
    assert code == 0
    assert "width" in out
    assert "by how much the curve is moved, zzz" in out
    (form,) = (s for s in described_steps()["steps"] if s["op"] == "planted_method")
    (key,) = (
        k for k in form["keys"] if k["name"] == "width"
    )  # what the workbench makes a form of
    assert (key["kind"], key["dimension"], key["help"]) == (
        "size",
        "length",
        "by how much the curve is moved, zzz",
    )


def test_a_planted_method_is_in_the_reference(planted, repository, monkeypatch):
    monkeypatch.syspath_prepend(str(repository / "docs" / "_ext"))
    page = importlib.import_module("generated_reference").steps_page()
    assert "planted_method" in page
    assert "by how much the curve is moved, zzz" in page


def test_a_planted_method_is_carried_out_at_every_door(planted, tmp_path, capsys):
    x, z = np.linspace(0.0, 10.0, 11), np.cos(np.arange(11.0))
    rows = "\n".join(f"{a:g},{b:.17g}" for a, b in zip(x, z, strict=True))
    (tmp_path / "a.csv").write_text(f"x_mm,z_um\n{rows}\n")
    recipe = tmp_path / "r.toml"
    recipe.write_text(RECIPE.format(width="2 mm"))
    by_recipe = Recipe.load(recipe).run().produced
    data = ms.read(tmp_path / "a.csv")
    by_name = ms.separation.separate([data], method="planted_method", width="2 mm")
    code, out, err = printed(
        capsys, "separate", tmp_path / "a.csv", "--method", "planted_method", "--x", "x_mm",
        "--readings", "z_um", "--set", "width=2 mm", "--json",
    )  # fmt: skip
    assert code == 0, err
    for found in (by_recipe, by_name):
        np.testing.assert_array_equal(found.curve, by_recipe.curve)
        np.testing.assert_allclose(found.coordinates["x"], 1e-3 * x + 2e-3, rtol=0, atol=1e-15)
    assert json.loads(out)["separation"]["audit"]["width_mm"] == 2.0


@pytest.mark.parametrize("width", ["2", "-1 mm", "3 deg"])
def test_a_wrong_value_of_a_planted_option_is_refused_where_it_stands(planted, width):
    with pytest.raises(RecipeError, match=r"recipe.toml:8.*width"):
        Recipe.parse(RECIPE.format(width=width))
    with pytest.raises(DataError, match="width"):
        ms.separation.separate(
            [np.zeros(5)], method="planted_method", x=np.arange(5.0), width=width
        )


# ---- an option of every kind that there is -----------------------------------------------------

EXAMPLES = {"text": "north", "any": "3", "table": "{ a = 1 }", "file": "a.csv", "column": "x_mm", "texts": "a,b"}  # fmt: skip
"""Of kinds whose own example is dots."""
WRONG = {
    "text": "3", "flag": "3", "table": "3", "column": "3", "file": "3", "texts": "3", "lag": "true",
    "degree": "1.5", "spacing": "1.5",
}  # fmt: skip
"""As TOML has it; of the others a word."""


@pytest.fixture
def every_kind(planted, monkeypatch):
    """Plant one field of each kind on the class; its help names it."""
    fields = {
        f"of_{kind.replace(' ', '_')}": option(None, kind=kind, help=f"planted, a {kind} zzz")
        for kind in KINDS
    }
    annotations = dict.fromkeys(fields, object)
    made = dataclasses.dataclass(frozen=True)(
        type("Every", (planted.NamedMethod,), {
            "name": "every_kind", "what": "all kinds", "readings": ("curve",), "over": "x",
            "__annotations__": annotations, **fields,
        })
    )  # fmt: skip
    planted.Every = made
    monkeypatch.setitem(separation.METHODS, "every_kind", "zz_planted:Every")
    return made


def test_an_option_of_every_kind_is_found_at_every_door(
    every_kind, capsys, repository, monkeypatch
):
    declared = options_of(every_kind)
    assert [o.kind for o in declared.values()] == list(KINDS)
    code, listed, _ = printed(capsys, "ops", "every_kind")
    assert code == 0
    (form,) = (s for s in described_steps()["steps"] if s["op"] == "every_kind")
    monkeypatch.syspath_prepend(str(repository / "docs" / "_ext"))
    page = importlib.import_module("generated_reference").steps_page()
    for name, known in declared.items():
        assert name in listed, name
        assert known.help in " ".join(listed.split()), name
        (key,) = (k for k in form["keys"] if k["name"] == name)
        assert (key["kind"], key["help"]) == (known.kind, known.help)
        assert key["dimension"] == KINDS[known.kind].dimension
        assert known.help in page, name


KEYED = 'metrosep = 1\n[input]\nx = "x_mm"\nreadings = ["z"]\n[[step]]\nop = "every_kind"\n{}\n'


@pytest.mark.parametrize("kind", list(KINDS))
def test_a_value_of_every_kind_is_taken_as_it_is_typed_and_a_wrong_one_refused(
    every_kind, capsys, tmp_path, kind
):
    name = f"of_{kind.replace(' ', '_')}"
    example = EXAMPLES.get(kind, KINDS[kind].example)
    if kind in ("any", "table"):
        line = f"{name} = {example}"
    else:  # the recipe that --set makes
        line = f"{name} = {typed(name, example, options_of(every_kind))}"
    (tmp_path / "a.csv").write_text("x_mm,z_um\n0,1\n1,2\n")
    recipe = Recipe.parse(KEYED.format(line), folder=tmp_path)
    assert name in recipe.steps[0]
    if kind not in ("any", "table"):
        code, out, err = printed(
            capsys, "separate", tmp_path / "a.csv", "--method", "every_kind", "--x", "x_mm",
            "--readings", "z_um", "--set", f"{name}={example}", "--print-recipe",
        )  # fmt: skip
        assert code == 0, err
        assert line in out
    if kind == "any":
        return
    with pytest.raises(RecipeError, match=name) as caught:
        Recipe.parse(KEYED.format(f"{name} = {WRONG.get(kind, chr(34) + 'nonsense' + chr(34))}"))
    assert caught.value.line == 7
