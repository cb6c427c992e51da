"""The linker of ES modules: what is linked runs as the modules do; what it cannot do it refuses."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from metrosep.app.notebook import linked_module, masked_code
from metrosep.core.errors import DataError, UnsupportedFeatureError

STATIC = Path(__file__).resolve().parents[2] / "metrosep" / "app" / "static"
NODE = shutil.which("node")


def ran(text: str) -> object:
    """Return the default export of a module text, by node."""
    if NODE is None:
        pytest.skip("node is not installed")
    body, last = text.rsplit("export default ", 1)
    script = f"{body}\nconsole.log(JSON.stringify({last.rstrip(';')}));"
    done = subprocess.run(
        [NODE, "--input-type=module", "-"],
        input=script,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_same_names_in_different_modules_do_not_meet() -> None:
    modules = {
        "main.js": 'import one, { twice as double } from "./one.js";\n'
        'import { value } from "./deep/two.js";\nconst hidden = 5;\nexport default [one, double(value), hidden];',
        "one.js": "const hidden = 7; export function twice(x) { return 2 * x; }\nexport default hidden;",
        "deep/two.js": 'import { twice } from "../one.js"; const hidden = 11; export const value = twice(hidden);',
    }
    assert ran(linked_module("main.js", modules)) == [7, 44, 5]


def test_a_module_is_run_once_and_before_those_that_need_it() -> None:
    modules = {
        "main.js": 'import { log } from "./log.js"; import { b } from "./b.js"; import { c } from "./c.js";'
        "export default [...log, b, c];",
        "log.js": "export const log = [];",
        "b.js": 'import { log } from "./log.js"; log.push("b"); export const b = 1;',
        "c.js": 'import { b } from "./b.js"; import { log } from "./log.js"; log.push("c"); export { b as c };',
    }
    assert ran(linked_module("main.js", modules)) == ["b", "c", 1, 1]


def test_words_in_strings_templates_patterns_and_comments_are_not_statements() -> None:
    source = r"""
// import nothing from "./nowhere.js";
/** @typedef {import("./types.js").T} T */
const a = 'export default 1; // no comment';
const b = `import x from "y"; ${[`/* ${a.length} */`].map((v) => { return v; })[0]} // stays`;
const c = /["'`/]import[(]/.source;
const d = 8 / 2 / 1;
export default [a, b, c, d];
"""
    assert ran(linked_module("m.js", {"m.js": source})) == [
        "export default 1; // no comment",
        f'import x from "y"; /* {len("export default 1; // no comment")} */ // stays',
        "[\"'`/]import[(]",
        4,
    ]


def test_a_licence_stays_and_other_comments_go() -> None:
    text = linked_module(
        "m.js", {"m.js": "/* Copyright (c) Somebody */\n// chatter\n/* more */ export default 1;"}
    )
    assert "/* Copyright (c) Somebody */" in text
    assert "chatter" not in text
    assert "more" not in text


def test_mask_is_as_long_as_what_it_masks() -> None:
    for file in (*STATIC.glob("*.js"), STATIC / "vendor" / "uPlot.esm.js"):
        kept, mask = masked_code(file.read_text(encoding="utf-8"), file.name)
        assert len(kept) == len(mask), file
        assert kept.count("\n") == mask.count("\n"), file


@pytest.mark.parametrize(
    ("source", "word"),
    [
        ('export * from "./b.js"; export default 1;', "export"),
        ('export { b } from "./b.js"; export default 1;', "export"),
        ('import * as b from "./b.js"; export default 1;', "import"),
        ('import "./b.js"; export default 1;', "import"),
        ('const b = await import("./b.js"); export default 1;', "import"),
        ("const b = import.meta.url; export default b;", "import"),
        ("export let b = 1; export default b;", "export let"),
        ("export const b = [1, 2], c = 2; export default b;", "export const"),
        ("export default function () {}", "export default function"),
        ("export default class {}", "export default class"),
        ('import b from "uplot"; export default b;', "uplot"),
        ('import b from "https://example.org/b.js"; export default b;', "example.org"),
        ('import b from "../b.js"; export default b;', "leaves the folder"),
    ],
)
def test_what_cannot_be_linked_is_refused(source: str, word: str) -> None:
    with pytest.raises(
        UnsupportedFeatureError, match=word.replace(".", r"\.").replace("*", r"\*")
    ):
        linked_module("a.js", {"a.js": source, "b.js": "export const b = 1; export default b;"})


def test_circles_are_refused_with_their_way() -> None:
    modules = {
        "a.js": 'import { b } from "./b.js"; export const a = 1; export default b;',
        "b.js": 'import { a } from "./a.js"; export const b = a;',
    }
    with pytest.raises(UnsupportedFeatureError, match=r"a\.js -> b\.js -> a\.js"):
        linked_module("a.js", modules)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (
            'import { b } from "./c.js"; export default b;',
            r"no module c\.js, which a\.js asks for",
        ),
        (
            'import { c } from "./b.js"; export default c;',
            r"c from b\.js, which does not export it",
        ),
        ("export const a = 1;", "no default export"),
        ("export default (1];", "closes nothing"),
        ("export default (1", "not closed"),
        ("export default `1", "template does not end"),
        ("export default '1\n';", "string does not end"),
        ("export default 1; /* on and on", "comment does not end"),
    ],
)
def test_what_is_missing_is_named(source: str, words: str) -> None:
    with pytest.raises(DataError, match=words):
        linked_module("a.js", {"a.js": source, "b.js": "export const b = 1;"})


def test_numbers_of_the_page_are_formatted_alike_when_linked() -> None:
    """The real modules, vendored uPlot left out: format.js gives what it gives in the page."""
    modules = {
        "main.js": 'import { si, ticks } from "./format.js"; import { colours } from "./colours.js";'
        "export default [si(9.13e-9), si(1000), si(-2.5e-6), ticks([0, 5e-7], 1e-6), Array.from(colours('viridis').slice(0, 3))];",
        **{
            name: (STATIC / name).read_text(encoding="utf-8")
            for name in ("format.js", "colours.js")
        },
    }
    assert ran(linked_module("main.js", modules)) == [
        "9.130\u2009nm",
        "1.000\u2009km",
        "\u22122.500\u2009µm",
        ["0.0", "0.5"],
        [0x44, 0x01, 0x54],
    ]
