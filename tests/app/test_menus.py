"""Menus of the page: every form of the library is there, and what a menu offers builds it."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.menus import described_menus
from metrosep.core.errors import DataError
from metrosep.forms.catalogue import form_from_text, form_names
from metrosep.recipe.pipeline_checks import FILTER, FILTER_KEYS


def test_every_form_of_the_library_is_in_the_menu():
    assert {form["name"] for form in described_menus()["forms"]} == set(form_names())


def test_what_is_offered_builds_the_form_with_all_its_fields_and_with_none():
    for form in described_menus()["forms"]:
        name, fields = form["name"], form["fields"]
        if name == "expression":  # "a*x**2 + b; a=1 SI, b": the letters stand behind the formula
            assert form_from_text("expression: a*x**2 + b; a=1 SI, b").name
            continue
        least = [f"{f['name']}={f['value'] or f['hint']}" for f in fields if f["required"]]
        # the last choice: a Q form of kind bfs has no conic constant
        every = [f"{f['name']}={f['value'] or f['hint'] or f['choices'][-1]}" for f in fields]
        for pairs in (least, every):
            text = name.replace("_", "-") + (": " + ", ".join(pairs) if pairs else "")
            form_from_text(text)
        for field in fields:
            for choice in field["choices"]:
                form_from_text(
                    f"{name}: "
                    + ", ".join(
                        [
                            *(o for o in least if not o.startswith(f"{field['name']}=")),
                            f"{field['name']}={choice}",
                        ]
                    )
                )


def test_what_a_form_cannot_guess_is_asked_for_and_nothing_else():
    """Each tile is an edit at once: with what must be typed the fit begins, without it it does not."""
    y, x = (np.mgrid[:24, :30] - 11.5) * 10e-6
    z = x**2 / 0.2 + y**2 / 0.3 + 50e-9 * np.sin(2 * np.pi * x / 1e-4)
    part = ms.Surface(z, 10e-6, 10e-6)
    for form in described_menus()["forms"]:
        name, needed = form["name"], [f for f in form["fields"] if f["required"]]
        if name in (
            "expression",
            "qforbes",
        ):  # a formula; an aperture that need not be that of the map
            continue
        pairs = [f"{f['name']}={f['value'] or f['hint']}" for f in needed]
        part.remove_form(": ".join([name, ", ".join(pairs)][: 2 if pairs else 1]))
        if name == "sine_grid":
            assert [f["name"] for f in needed] == ["wavelength"]
            with pytest.raises(DataError, match="wavelength"):
                part.remove_form(name)


def test_each_filter_has_its_keys():
    assert {k for keys in FILTER_KEYS.values() for k in keys} | {"kind"} == set(FILTER)
    assert described_menus()["filters"] == {k: list(v) for k, v in FILTER_KEYS.items()}
