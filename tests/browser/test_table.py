"""The tab of the table: by keyboard from the preview to a file that the library reads back."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from contracts.recipes import mean_of_runs

import metrosep as ms
from metrosep import controllers

pytestmark = pytest.mark.browser

Opened = Callable[..., Any]

READY = (
    "document.querySelector('#panel-table').getAttribute('aria-busy') === 'false' "
    "&& document.querySelector('#table-controller') !== null"
)
RECIPE = mean_of_runs()
TABLE = """[[output]]
kind = "table"
controller = "{controller}"
axis = "X"
compensates = "Z"
spacing = "0.5 mm"
path = "slide.txt"
machine = {{ {machine} }}
"""
AT, WIDTH = 15e-3, 4e-3


@pytest.fixture
def recipe(tmp_path: Path) -> Callable[..., Path]:
    """Write a lopsided bump of 2 um over 50 mm, four runs, and a recipe of their mean."""

    def write(controller: str = "csv", machine: str = "", *, table: bool = True) -> Path:
        rng = np.random.default_rng(3)
        x = np.linspace(0.0, 50e-3, 501)
        rows = ["run,x_mm,z_um"]
        for run in range(4):
            z = 2e-6 * np.exp(-(((x - AT) / WIDTH) ** 2)) + 2e-9 * rng.standard_normal(x.size)
            rows += [f"{run},{a * 1e3:.6f},{b * 1e6:.7f}" for a, b in zip(x, z, strict=True)]
        (tmp_path / "runs.csv").write_text("\n".join(rows) + "\n")
        file = tmp_path / "slide.toml"
        file.write_text(RECIPE + (TABLE.format(controller=controller, machine=machine) * table))
        return file

    return write


def on_table(page: Any, ready: str = READY) -> None:
    page.click("#tab-table")
    page.wait(ready)


def answered(page: Any, act: Callable[[], Any]) -> None:
    """Do something that changes the table, and wait for what comes of it."""
    page.run("(document.querySelector('.table-facts-all').firstChild ?? {}).old = true")
    act()
    page.wait("!document.querySelector('.table-facts-all').firstChild?.old")
    page.wait(READY)


def typed(page: Any, key: str, text: str) -> None:
    """Type into a field of the form, by keyboard from its focus on."""
    field = f"document.querySelector('[data-key={json.dumps(key)}]')"
    page.run(f"(() => {{ const d = {field}.closest('details'); if (d) d.open = true; }})()")
    page.run(f"{field}.focus()")
    page.run("document.activeElement.select()")
    page.call("Input.insertText", text=text)
    page.press("Enter")


def chosen(page: Any, selector: str, value: str) -> None:
    page.run(
        f"(() => {{ const s = document.querySelector({json.dumps(selector)}); s.value = {json.dumps(value)};"
        "s.dispatchEvent(new Event('change')); })()"
    )


def number(text: str) -> tuple[float, float]:
    """Return a printed length in m, and half of its last digit."""
    found = re.match(r"(\u2212?)(\d+)(?:\.(\d+))?\u2009([pnµm]?)m", text)
    assert found, text
    sign, whole, decimals, prefix = found.groups()
    factor = {"p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0}[prefix]
    value = float(f"{whole}.{decimals or 0}") * factor
    return (-value if sign else value), 0.5 * 10.0 ** -len(decimals or "") * factor * (1 + 1e-9)


def dry_run_row(page: Any) -> list[str]:
    return list(
        page.run(
            "[...document.querySelectorAll('.table-dry-run tbody tr td')].map((e) => e.firstChild.textContent)"
        )
    )


def exported(page: Any, file: Path) -> None:
    page.run("document.querySelector('#table-export').focus()")
    page.press("Enter")
    page.fill("dialog input[name=path]", str(file))
    page.press("Enter")
    page.wait(
        f"document.querySelector('#status-link').textContent.includes({json.dumps(file.name)})"
    )


def test_by_keyboard_from_the_preview_to_the_file(
    opened: Opened, recipe: Callable[..., Path], tmp_path: Path
) -> None:
    page = opened(recipe())
    on_table(page)
    assert "101 entries" in page.text(".table-about")
    assert "the error shrinks" in page.text(".table-chip.good")
    first = page.text(".table-block pre")

    answered(page, lambda: typed(page, "output spacing", "1 mm"))

    assert page.run("document.activeElement.dataset.key") == "output spacing"
    assert "51 entries" in page.text(".table-about")
    assert page.text(".table-block pre") != first
    before_pv, after_pv, before_rms, after_rms, reversed_rms = dry_run_row(page)
    file = tmp_path / "by_hand.csv"
    exported(page, file)
    held = controllers.read(file, "csv")
    assert held.positions.size == 51
    assert page.text(".table-block pre") == file.read_text().rstrip("\n")
    sidecar = json.loads((tmp_path / "by_hand.csv.json").read_text())
    (row,) = sidecar["verification"]["residuals"]
    for shown, key in (
        (before_pv, "before_pv_m"),
        (after_pv, "after_pv_m"),
        (before_rms, "before_rms_m"),
        (after_rms, "after_rms_m"),
        (reversed_rms, "wrong_sign_rms_m"),
    ):
        value, half = number(shown)
        assert abs(value - row[key]) <= half, key
    # where the tool stands too far in +Z, less is commanded
    look = controllers.simulate(file, "csv")
    assert look(AT)[()] < -1.5e-6 < look(50e-3 - AT)[()]

    page.run("document.activeElement.blur()")
    page.press("s")
    page.fill("dialog input[name=path]", str(tmp_path / "saved.toml"))
    page.press("Enter")
    page.wait("document.querySelector('#status-link').textContent.includes('saved.toml')")
    assert tomllib.loads((tmp_path / "saved.toml").read_text())["output"][0]["spacing"] == "1 mm"
    ms.Recipe.load(tmp_path / "saved.toml").run(tmp_path / "runs.csv", out=tmp_path / "out")
    for end in ("", ".json"):
        ran = (tmp_path / "out" / f"slide.txt{end}").read_bytes()
        assert ran == (tmp_path / f"by_hand.csv{end}").read_bytes()
    assert page.errors == []


def test_a_controller_that_must_be_told_something_waits_as_a_draft(
    opened: Opened, recipe: Callable[..., Path]
) -> None:
    page = opened(recipe())
    on_table(page)
    answered(
        page, lambda: (page.fill("[data-key=search]", "turbo pmac position"), page.press("Enter"))
    )

    assert "count" in page.text(".table-draft")
    said = page.text(".table-findings")
    assert "cannot be written without count (length of one count" in said
    assert "{" not in said  # the page has a field for it
    assert page.run("document.querySelector('#table-export').disabled")
    assert page.text("#table-reason") == "Not yet: the controller must be told more first"
    assert page.run("document.querySelector('#undo').disabled")  # nothing was edited
    assert page.run("document.activeElement.dataset.key") == "option count"

    page.call("Input.insertText", text="10 nm")
    answered(page, lambda: page.press("Enter"))
    page.wait("document.querySelector('.table-draft') === null")
    answered(page, lambda: typed(page, "option target_motor", "2"))

    assert "DEFINE COMP" in page.text(".table-block pre")
    assert page.run("document.activeElement.dataset.key") == "option target_motor"
    assert not page.run("document.querySelector('#undo').disabled")
    assert page.run("document.querySelector('[data-key=\"output path\"]').value") == "slide.pmc"


def test_a_draft_can_be_given_up(opened: Opened, recipe: Callable[..., Path]) -> None:
    page = opened(recipe())
    on_table(page)
    answered(page, lambda: chosen(page, "#table-controller", "fanuc"))
    answered(page, lambda: page.click(".table-draft button"))

    assert page.run("document.querySelector('#table-controller').value") == "csv"
    assert not page.run("document.querySelector('#table-export').disabled")


def test_maps_cannot_be_chosen(opened: Opened, recipe: Callable[..., Path]) -> None:
    page = opened(recipe())
    on_table(page)
    disabled = page.run(
        "[...document.querySelectorAll('#table-controller option')].filter((o) => o.disabled).map((o) => o.value)"
    )
    assert sorted(disabled) == sorted(d.id for d in controllers.describe() if d.carries == "map")


def test_a_refusal_is_waived_by_name(opened: Opened, recipe: Callable[..., Path]) -> None:
    page = opened(recipe(machine='travel_high = "60 mm"'))
    on_table(page)

    assert "✗ Refused" in page.text('[data-check="coverage"]')
    assert "60 mm" in page.text('[data-check="coverage"]')
    assert page.text("#table-reason") == "Not yet: refused by “coverage”"
    assert page.run("document.querySelector('#table-export').disabled")
    assert page.run("document.querySelector('.table-block pre') === null")

    page.run("document.querySelector('[data-key=\"waive coverage\"]').focus()")
    answered(page, lambda: page.press(" "))

    assert "! Waived" in page.text('[data-check="coverage"]')
    assert not page.run("document.querySelector('#table-export').disabled")
    assert page.run("document.querySelector('.table-block pre') !== null")
    assert page.run("document.activeElement.dataset.key") == "waive coverage"


def test_runs_and_a_table_that_are_refused_have_the_buttons_that_mend_them(
    opened: Opened, recipe: Callable[..., Path]
) -> None:
    file = recipe(machine="max_points = 60")
    file.write_text(file.read_text().replace('method = "mean"', 'method = "joint"'))
    page = opened(file, "document.querySelector('.runs-message .mends button') !== null")
    assert "no time" in page.text(".runs-message")
    on_table(page, "document.querySelector('.table-right .mends button') !== null")
    page.click("#tab-runs")
    page.click(".runs-message .mends button")  # Set method = mean
    page.wait(
        "document.body.dataset.runs !== undefined && document.querySelector('.runs-message').hidden"
    )
    on_table(page, "document.querySelector('[data-check=points]') !== null")
    assert page.text(".table-right .mends") == "Set spacing = 1 mm"
    answered(page, lambda: page.click(".table-right .mends button"))
    assert page.run("document.querySelector('[data-check=points]') === null")
    assert not page.run("document.querySelector('#table-export').disabled")
    assert page.errors == []


def test_a_sign_that_nobody_knows_is_tried_first(
    opened: Opened, recipe: Callable[..., Path], tmp_path: Path
) -> None:
    page = opened(recipe("sinumerik-cec", 'input_axis = "AX1", output_axis = "AX3"'))
    on_table(page)

    assert "✗ Sign: not documented" in page.text('[aria-label="Sign"]')
    assert "indicator" in page.text(".table-trial")
    assert "not documented" in page.text("#table-reason")
    page.click("#table-trial")
    page.fill("dialog input[name=path]", str(tmp_path / "trial.INI"))
    page.press("Enter")
    page.wait("document.querySelector('#status-link').textContent.includes('trial.INI')")
    assert json.loads((tmp_path / "trial.INI.json").read_text())["trial"]["if_right"]

    answered(page, lambda: page.click("#table-confirmed"))
    assert not page.run("document.querySelector('#table-export').disabled")
    # another sign was not tried: it must be confirmed again
    answered(page, lambda: chosen(page, '[data-key="option entry_sign"]', "-1"))
    assert page.run("document.querySelector('#table-export').disabled")
    assert not page.run("document.querySelector('#table-confirmed').checked")


def test_a_recipe_without_a_table_gets_one(opened: Opened, recipe: Callable[..., Path]) -> None:
    page = opened(recipe(table=False))
    on_table(page, "document.querySelector('#table-first') !== null")
    assert "Z over X" in page.text(".table-empty")
    page.click("#table-first")
    page.wait(f"{READY} && document.querySelector('.table-about') !== null")
    assert page.run("document.querySelector('[data-key=\"output axis\"]').value") == "X"
    assert not page.run("document.querySelector('#table-export').disabled")


def test_somebody_elses_file_stays(
    opened: Opened, recipe: Callable[..., Path], tmp_path: Path
) -> None:
    page = opened(recipe())
    on_table(page)
    target = tmp_path / "machine.csv"
    target.write_text("0,1\n")
    page.click("#table-export")
    page.fill("dialog input[name=path]", str(target))
    page.press("Enter")
    page.wait("document.querySelector('.alert p') !== null")
    assert "not written by metrosep" in page.text(".alert p")
    assert target.read_text() == "0,1\n"


def test_what_is_refused_goes_back(opened: Opened, recipe: Callable[..., Path]) -> None:
    page = opened(recipe())
    on_table(page)
    typed(page, "output spacing", "1 second")
    page.wait("document.querySelector('.alert p') !== null")
    assert "spacing" in page.text(".alert p")
    field = "document.querySelector('[data-key=\"output spacing\"]').value"
    page.wait(f"{field} === '0.5 mm'")


def test_correction_and_error_are_drawn_as_mirror_images(
    opened: Opened, recipe: Callable[..., Path]
) -> None:
    """Above the middle line at the bump: the error; below it: the correction."""
    page = opened(recipe())
    on_table(page)
    page.wait("document.querySelector('#table-plot canvas') !== null")
    names = page.run(
        "[...document.querySelectorAll('.table-legend span')].map((e) => e.textContent)"
    )
    assert names == ["error, forward", "correction, both directions", "○ entry"]
    rows = page.run(
        """(() => {
          const canvas = document.querySelector('#table-plot canvas');
          const style = getComputedStyle(document.documentElement);
          const rgb = (name) => style.getPropertyValue(name).trim().match(/\\w\\w/g).map((h) => parseInt(h, 16));
          const over = document.querySelector('#table-plot .u-over').getBoundingClientRect();
          const own = canvas.getBoundingClientRect();
          const k = canvas.width / own.width;
          const x = Math.round((over.left - own.left + 0.3 * over.width) * k);
          const column = canvas.getContext('2d').getImageData(x - 3, 0, 7, canvas.height).data;
          const mean = (want) => {
            const hits = [];
            for (let i = 0; i < column.length; i += 4) {
              if (want.every((c, j) => Math.abs(column[i + j] - c) < 25)) hits.push(Math.floor(i / 28));
            }
            return hits.reduce((a, b) => a + b, 0) / hits.length;
          };
          return [mean(rgb('--faint')), mean(rgb('--line')), canvas.height];
        })()"""
    )
    error, correction, height = rows
    assert error < 0.45 * height < 0.6 * height < correction


def test_a_second_table_is_added_shown_and_taken_back(
    opened: Opened, recipe: Callable[..., Path]
) -> None:
    page = opened(recipe())
    on_table(page)
    answered(page, lambda: page.click("#table-add"))
    which = "document.querySelector('#panel-table header select')"
    assert page.run(f"{which}.selectedOptions[0].textContent") == "2 of 2: slide-2.txt"
    answered(page, lambda: typed(page, "output spacing", "1 mm"))
    assert "51 entries" in page.text(".table-about")

    answered(page, lambda: chosen(page, "#panel-table header select", "0"))
    assert "101 entries" in page.text(".table-about")

    page.run("document.activeElement.blur()")
    page.press("z")
    page.press("z")
    page.wait(f"{which}.hidden")
    page.wait(READY)
    assert "101 entries" in page.text(".table-about")
    assert page.errors == []
