"""Menus of the page: every form of the library is there, and what a menu offers builds it."""

from metrosep.app.menus import described_menus
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


def test_each_filter_has_its_keys():
    assert {k for keys in FILTER_KEYS.values() for k in keys} | {"kind"} == set(FILTER)
    assert described_menus()["filters"] == {k: list(v) for k, v in FILTER_KEYS.items()}
