"""Work by hand: steps, limits, verdict, files; the numbers are those of the library."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.browser

FULL = "document.querySelector('#status-full.done') !== null"
PREFIXES = {"p": 1e-12, "n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0}

Opened = Callable[..., Any]


def choose(page: Any, selector: str, value: str) -> None:
    """Set the value of a control, as a hand that picks it does."""
    page.run(
        f"(() => {{ const e = document.querySelector('{selector}'); e.value = '{value}';"
        "e.dispatchEvent(new Event('change')); })()"
    )


def settled(page: Any, act: Callable[[], Any]) -> None:
    """Do something that edits the recipe, and wait for the full resolution of what it gives."""
    before = page.run("document.body.dataset.full ?? ''")
    act()
    page.wait(f"document.body.dataset.full !== {json.dumps(before)}")
    page.wait(FULL)


def printed(page: Any, metric: str) -> tuple[float, float]:
    """Return a value of the table in m, and half of its last digit."""
    text = page.text(f'[data-metric="{metric}"] td:nth-child(2)')
    found = re.fullmatch(r"(\u2212?)(\d+)(?:\.(\d+))?\u2009([pnµm]?)m", text)
    assert found, text
    sign, whole, decimals, prefix = found.groups()
    factor = PREFIXES[prefix]
    value = float(f"{whole}.{decimals or 0}") * factor * (-1 if sign else 1)
    return value, 0.5 * 10.0 ** -len(decimals or "") * factor * (1 + 1e-9)


def set_limit(page: Any, row: str, upper: str, uncertainty: str) -> None:
    """Type an upper limit and U for a metric."""
    page.click(f'[data-row="{row}"]')
    page.fill(".limit-form input[name=upper]", upper)
    page.fill(".limit-form input[name=U]", uncertainty)
    page.press("Enter")


def test_a_limit_without_unit_has_that_of_the_value_beside_it(
    opened: Opened, map_file: Path
) -> None:
    """The field names the unit, and the recipe holds it; a pure number stays one."""
    page = opened(map_file)
    value = page.text('[data-metric="Sq"] td:nth-child(2)')
    unit = value.split("\u2009")[1]
    settled(page, lambda: set_limit(page, "row Sq", "180", "2"))
    page.click('[data-row="check 0"]')
    assert f"/ {unit}" in page.text(".limit-form")
    stored = page.run(
        "[...document.querySelectorAll('.limit-form input')].map((one) => one.value)"
    )
    assert stored == ["", f"180 {unit.replace('µ', 'u')}", f"2 {unit.replace('µ', 'u')}"]
    page.click('[data-row="check 0"]')
    assert "No verdict" not in page.text("#verdict")
    settled(page, lambda: set_limit(page, "row Ssk", "3", "0.1"))
    page.click('[data-row="check 1"]')
    assert page.run("document.querySelector('.limit-form input[name=upper]').value") == "3"
    assert "No verdict" not in page.text("#verdict")
    assert page.errors == []


def test_a_limit_without_unit_beside_a_larger_uncertainty_has_the_unit_that_is_shown(
    opened: Opened, map_file: Path
) -> None:
    """U of a check, in um, sets the unit of a value of some nm: what is typed then is in um too."""
    page = opened(map_file)
    before = page.text('[data-metric="Sq"] td:nth-child(2)').split("\u2009")[1]
    settled(page, lambda: set_limit(page, "row Sq", "1 mm", "1.2 mm"))
    shown = page.text('[data-metric="Sq"] td:nth-child(2)').split("\u2009")[1]
    assert (before != "mm", shown) == (True, "mm")
    settled(page, lambda: set_limit(page, "check 0", "1.5", "1.2 mm"))
    page.click('[data-row="check 0"]')
    assert "/ mm" in page.text(".limit-form")
    stored = page.run("document.querySelector('.limit-form input[name=upper]').value")
    assert stored == "1.5 mm"
    assert page.errors == []


def test_metrics_are_those_of_the_library_to_the_printed_digit(
    opened: Opened, map_file: Path
) -> None:
    from metrosep.io.read import read

    z = read(map_file).z
    y, x = np.indices(z.shape)
    valid = ~np.isnan(z)
    design = np.stack([np.ones(valid.sum()), x[valid] - 299.5, y[valid] - 299.5], axis=1)
    left = z[valid] - design @ np.linalg.lstsq(design, z[valid], rcond=None)[0]
    page = opened(map_file)
    for metric, value in (
        ("Sz", np.ptp(left)),
        ("Sq", np.std(left)),
        ("Sa", np.abs(left - left.mean()).mean()),
    ):
        shown, half = printed(page, metric)
        assert abs(shown - value) <= half, metric


def test_removing_the_form_and_undo(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    before = page.text('[data-metric="Sz"] td:nth-child(2)')
    settled(page, lambda: page.click('[aria-label="Step 1, form: on"]'))
    assert page.text('[data-metric="Sz"] td:nth-child(2)') != before
    page.run("document.activeElement.blur()")
    settled(page, lambda: page.press("z"))
    assert page.text('[data-metric="Sz"] td:nth-child(2)') == before
    settled(page, lambda: page.press("Z", shift=True))
    assert page.text('[data-metric="Sz"] td:nth-child(2)') != before


def test_nothing_final_comes_from_a_preview(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    settled(page, lambda: set_limit(page, "row Sq", "1 mm", "1 nm"))
    assert page.text("#verdict .word") == "Accepted"
    page.run(
        """(() => {
          window.seen = [];
          const look = () => window.seen.push([
            document.querySelector('#status-full').className,
            document.querySelector('#verdict').className,
            document.querySelector('[data-metric="Sz"] td:nth-child(2)')?.textContent,
            document.querySelector('[data-metric="Sq"] td:nth-child(2)')?.textContent,
            document.body.dataset.full,
          ]);
          new MutationObserver(look).observe(document.body, { subtree: true, childList: true, attributes: true });
        })()"""
    )
    before = page.run("document.body.dataset.full")
    settled(page, lambda: page.click('[aria-label="Step 1, form: on"]'))
    seen = page.run("window.seen")
    # Between the edit and the end of the full pass: values about, extremes and verdict wait.
    waiting = [s for s in seen if s[0] == "busy" or (s[3] or "").startswith("≈")]
    about = [s for s in waiting if (s[3] or "").startswith("≈")]
    assert about
    for _, verdict, extreme, _, _ in about:
        assert verdict == ""
        assert extreme == "…"
    assert seen[-1][4] != before
    assert page.text("#verdict .word") == "Accepted"


def test_a_limit_gives_a_verdict_with_sign_and_word(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    assert "No limits" in page.text("#verdict")
    settled(page, lambda: set_limit(page, "row Sq", "1 nm", "0.1 nm"))
    assert page.text("#verdict") == "✗Rejected"
    shown, _ = printed(page, "Sq")
    settled(page, lambda: set_limit(page, "check 0", f"{shown * 1e6:.4f} um", "100 nm"))
    assert page.text("#verdict") == "?Inconclusive"
    settled(page, lambda: set_limit(page, "check 0", "1 mm", "100 nm"))
    assert page.text("#verdict") == "✓Accepted"


def test_the_saved_recipe_gives_the_same_numbers_on_the_command_line(
    opened: Opened, map_file: Path, tmp_path: Path
) -> None:
    page = opened(map_file)
    page.run(
        "(() => { const s = document.querySelector('#add-step'); s.value = 'filter'; s.dispatchEvent(new Event('change')); })()"
    )
    page.wait("document.querySelector('[data-step=\"1\"] [data-key=lambda_c]') !== null")
    page.fill('[data-step="1"] [data-key=lambda_c]', "0.8 mm")
    settled(page, lambda: page.press("Enter"))
    settled(page, lambda: set_limit(page, "row Sq", "1 um", "1 nm"))
    page.run("document.activeElement.blur()")
    page.press("s")
    page.fill("dialog input[name=path]", str(tmp_path / "by_hand.toml"))
    page.press("Enter")
    page.wait("document.querySelector('#status-link').textContent.includes('by_hand.toml')")
    ran = subprocess.run(
        [
            sys.executable,
            "-m",
            "metrosep",
            "run",
            str(tmp_path / "by_hand.toml"),
            str(map_file),
            "-o",
            str(tmp_path / "out"),
        ],
        check=False,
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
    (result,) = (tmp_path / "out").rglob("result.json")
    said = json.loads(result.read_text())
    assert said["verdict"] == "accept"
    values = {c["metric"]: c["value"] for c in said["characteristics"]}
    for metric in ("Sq", "Sz", "Sa"):
        shown, half = printed(page, metric)
        assert abs(shown - values[metric]) <= half, metric


def test_words_of_the_server_are_shown_and_nothing_is_lost(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.click('[data-step="0"] .pick')
    settled(page, lambda: page.click("[data-form=zernike]"))
    page.fill('[data-step="0"] [data-field=terms]', "three")
    page.press("Enter")
    page.wait("document.querySelector('.alert p') !== null")
    assert "three" in page.text(".alert p")
    assert "terms=36" in page.text('[data-step="0"] .pick')
    assert page.run("document.querySelector('[data-step=\"0\"] [data-field=terms]').value") == "36"


def test_a_degree_is_chosen_and_one_that_was_typed_stays(opened: Opened, map_file: Path) -> None:
    field = "document.querySelector('[data-step=\"0\"] [data-field=degree]')"
    page = opened(map_file)
    page.click('[data-step="0"] .pick')
    settled(page, lambda: page.click("[data-form=polynomial]"))
    assert page.run(f"[...{field}.options].map(o => o.value).join()") == "1,2,3,4,5,6,7,8,9,10"
    page.run(f"{field}.value = '4'")
    settled(page, lambda: page.run(f"{field}.dispatchEvent(new Event('change'))"))
    assert "degree=4" in page.text('[data-step="0"] .pick')


def test_asks_for_the_unit(opened: Opened, tmp_path: Path) -> None:
    file = tmp_path / "plain.csv"
    i = np.arange(400)
    np.savetxt(file, np.column_stack([i * 0.01, np.cos(2 * np.pi * i / 40)]), delimiter=",")
    page = opened(file, "document.querySelector('dialog[open]') !== null")
    assert "unit" in page.text("dialog")
    assert page.run("document.querySelector('dialog input[name=x]').value") == "column1"
    page.fill("dialog input[name=x_unit]", "mm")
    page.fill("dialog input[name=z_unit]", "um")
    page.press("Enter")
    page.wait(FULL)
    assert page.run("document.body.dataset.kind") == "profile"
    shown, half = printed(page, "Pq")
    assert abs(shown - 1e-6 / np.sqrt(2)) <= max(half, 5e-9)  # the start takes a line off


def test_a_dropped_file_is_opened(opened: Opened, map_file: Path) -> None:
    import base64

    page = opened(None, "document.querySelector('#colours').options.length > 0")
    page.wait("document.querySelector('#status-link').textContent === ''")
    content = base64.b64encode(map_file.read_bytes()).decode()
    page.run(
        f"""(() => {{
          const bytes = Uint8Array.from(atob({json.dumps(content)}), (c) => c.charCodeAt(0));
          const data = new DataTransfer();
          data.items.add(new File([bytes], 'größe 1.x3p'));
          document.body.dispatchEvent(new DragEvent('drop', {{ dataTransfer: data, bubbles: true, cancelable: true }}));
        }})()"""
    )
    page.wait(FULL)
    assert page.text("#title") == "größe 1.x3p"
    assert page.run("document.body.dataset.kind") == "map"


def test_what_cannot_be_read_is_said(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.run(
        """(() => {
          const data = new DataTransfer();
          data.items.add(new File(['PK nonsense'], 'broken.x3p'));
          document.body.dispatchEvent(new DragEvent('drop', { dataTransfer: data, bubbles: true, cancelable: true }));
        })()"""
    )
    page.wait("document.querySelector('.alert p') !== null")
    assert "broken.x3p" in page.text(".alert p")
    assert page.text("#title") == "bowl.x3p"  # what was open stays


def test_everything_is_reached_by_tab_with_a_visible_focus(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    page.run("document.body.focus()")
    reached, plain = set(), []
    for _ in range(60):
        page.press("Tab")
        name, outline = page.run(
            "(() => { const a = document.activeElement; return [a.id || a.getAttribute('aria-label') || a.textContent.trim(),"
            "getComputedStyle(a).outlineStyle]; })()"
        )
        reached.add(name)
        if name and outline == "none" and page.run("document.activeElement !== document.body"):
            plain.append(name)
    for name in ("open", "save", "Step 1, form: on", "add-step", "shade", "colours", "Section end A", "Section end B",
                 "Upper end of the colours", "Cursor 1 of the section", "Longest wavelength of the band"):  # fmt: skip
        assert name in reached, name
    assert plain == []


def test_keys_go_to_the_panels_and_open_the_help(opened: Opened, map_file: Path) -> None:
    page = opened(map_file)
    for key, panel in enumerate(("steps", "map", "section", "spectrum", "metrics"), start=1):
        page.press(str(key))
        assert page.run("document.activeElement.id") == f"panel-{panel}"
    page.press("6")
    assert page.run("document.activeElement.id") == "status"
    page.press("?")
    page.wait("document.querySelector('dialog[open]') !== null")
    assert "undo" in page.text("dialog")
    page.press("Escape")
    page.wait("document.querySelector('dialog') === null")


def test_the_choice_of_columns_is_in_the_recipe_and_gives_the_bytes_of_metrosep_run(
    opened: Opened, tmp_path: Path
) -> None:
    """Four columns whose names say nothing; the position falls, a line of another program is above."""
    from browser.test_drawing import Hand, same_bytes

    i = np.arange(400)
    x, z = 8.0 - 0.02 * i, np.cos(i / 9.0) + 0.001 * i
    rows = [f"{k},{a:.4f},{7 * k % 11},{b:.6f}" for k, a, b in zip(i, x, z, strict=True)]
    file = tmp_path / "probe.csv"
    file.write_text("\n".join(["made by a logger", "n,u,v,w", *rows]) + "\n")
    page = opened(file, "document.querySelector('dialog[open]') !== null")
    page.wait("document.querySelector('dialog input[name=x]') !== null")
    shown = page.text("dialog .sample")
    assert "made by a logger" in shown
    assert "0,8.0000,0,1.000000" in shown
    for name, value in {"x": "u", "x_unit": "mm", "z": "w", "z_unit": "um"}.items():
        page.fill(f"dialog input[name={name}]", value)
    page.click("dialog [value=yes]")
    page.wait(FULL)
    data = Hand(page).data()
    assert data["input"] == {
        "files": ["probe.csv"],
        "x": {"column": "u", "unit": "mm"},
        "z": {"column": "w", "unit": "um"},
    }
    same_bytes(page, file)
    residual = z - np.polyval(np.polyfit(x, z, 1), x)
    shown_pv, half = printed(page, "residual.pv")
    assert abs(shown_pv - np.ptp(residual) * 1e-6) <= half
    assert page.errors == []


def test_what_another_page_puts_right_takes_the_message_away(
    opened: Opened, map_file: Path
) -> None:
    """Two pages follow one file: the message of a half written one must not stay in either."""
    page = opened(map_file)
    page.press("o")
    page.wait("document.querySelector('dialog[open]') !== null")
    page.fill("dialog [name=path]", str(map_file.with_name("missing.x3p")))
    page.press("Enter")
    page.wait("document.querySelector('.alert p') !== null")
    other = (
        "new Promise((done) => { const s = new WebSocket(`ws://${location.host}/ws?token=${sessionStorage.getItem('token')}`);"
        "s.onopen = () => s.send(JSON.stringify({ id: 1, k: 'edit', edits: [{ path: ['step', 0, 'enabled'], old: null, new: false }] }));"
        "s.onmessage = () => { done(true); s.close(); }; })"
    )
    assert page.run(other)
    page.wait("document.querySelector('.alert') === null")
    assert page.run("document.querySelector('[aria-label=\"Step 1, form: on\"]').checked") is False
