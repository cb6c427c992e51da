"""Every key of the steps of repeated runs has words, and the stated defaults are those of the code."""

from __future__ import annotations

import inspect
import re
from typing import Any

import pytest

from metrosep.compensation.polynomial import fit_polynomial
from metrosep.recipe import Recipe
from metrosep.recipe.step_help import described_steps, key_words
from metrosep.recipe.steps import STEPS
from metrosep.separation.runs.entry import separate
from metrosep.separation.runs.fourier import SelectionRule, separate_kono
from metrosep.separation.runs.joint import separate_joint
from metrosep.separation.runs.mean import separate_mean
from metrosep.separation.runs.planner import plan_feedrates

OPS = ("separate", "polynomial", "plan_feedrates")
KEYS = [(op, key) for op in OPS for key in STEPS[op] if key != "op"]
FUNCTIONS = {
    "separate": (separate, separate_joint, separate_kono, separate_mean),
    "polynomial": (fit_polynomial,),
    "plan_feedrates": (plan_feedrates,),
}
NOTHING = (None, (), inspect.Parameter.empty)
"""Defaults that nobody types."""

COMMON = {"shortest": {"joint", "kono"}, "lag": {"joint"}}
"""Parameters of `separate` itself that not every method takes."""

ALSO = {
    "polynomial": 'quantity = "error"',
    "plan_feedrates": 'v_min = "1000 mm/min"\nv_max = "9000 mm/min"\nn_runs = 4\n'
    'wavelengths = ["2 mm", "40 mm"]',
}


def parsed(op: str, key: str, typed: Any) -> Any:
    """Return what a recipe makes of a typed value."""
    value = str(typed).lower() if isinstance(typed, bool) else typed
    value = f'"{typed}"' if isinstance(typed, str) else value
    first = '[[step]]\nop = "separate"\n'
    own = "" if op == "separate" else f'[[step]]\nop = "{op}"\n{ALSO[op]}\n'
    text = f'metrosep = 1\n[input]\nx = "x"\nz = "z"\n{first}{own}{key} = {value}\n'
    return Recipe.parse(text).steps[-1][key]


def defaults_of(op: str, key: str) -> list[Any]:
    found = []
    for function in FUNCTIONS[op]:
        parameter = inspect.signature(function).parameters.get(key)
        if parameter is not None and parameter.kind is not inspect.Parameter.VAR_KEYWORD:
            found.append(parameter.default)
    return found


@pytest.mark.parametrize(("op", "key"), KEYS)
def test_every_key_has_one_plain_sentence(op, key):
    words = STEPS[op][key].about

    assert 20 < len(words) < 250
    assert not words.endswith(".")
    assert key_words(op, key) == words


@pytest.mark.parametrize(("op", "key"), KEYS)
def test_the_stated_default_is_that_of_the_code(op, key):
    known = defaults_of(op, key)
    assert known, f"no function of {op} has {key}"

    stated = STEPS[op][key].default
    if stated not in NOTHING:
        value = parsed(op, key, stated)
        assert known == [value] * len(known)
        assert type(value) is type(known[0])
    elif not STEPS[op][key].required:
        assert all(any(d is n or d == n for n in NOTHING) for d in known)


@pytest.mark.parametrize("key", [k for op, k in KEYS if op == "separate"])
def test_keys_of_single_methods_say_so(key):
    functions = {"joint": separate_joint, "kono": separate_kono, "mean": separate_mean}
    own = {m for m, f in functions.items() if key in inspect.signature(f).parameters}
    methods = COMMON.get(key, set() if key in inspect.signature(separate).parameters else own)

    found = re.match(r"([\w ]+) only: ", STEPS["separate"][key].about)

    assert set(found[1].split(" and ") if found else ()) == methods


def test_the_thresholds_in_the_words_are_those_of_the_rule():
    for norm, unit in (("amplitude", "m"), ("power", "m^2"), ("psd", "m^3")):
        sigma, p, _, _ = SelectionRule(norm=norm).thresholds()
        for key, value in (("sigma_t", sigma), ("p_t", p)):
            stated = re.findall(rf"(\S+) {re.escape(unit)}(?=[ ,])", STEPS["separate"][key].about)
            assert [float(v) for v in stated] == [pytest.approx(value, abs=1e-6 * value)]
    relative = SelectionRule(relative=True).thresholds()[0]
    assert f"{relative} where relative" in STEPS["separate"]["sigma_t"].about


def test_the_page_gets_words_and_defaults():
    steps = {s["op"]: s for s in described_steps()["steps"]}

    keys = {k["name"]: k for k in steps["separate"]["keys"]}

    assert keys["rule"]["default"] == "shortest"
    assert keys["rule"]["help"].startswith("kono only: ")
    assert keys["robust"]["default"] is False
    assert keys["shortest"]["default"] is None
