"""A result as PDF, typeset by typst: hashes and page numbers at each foot, the result attached.

Fonts are those of typst and matplotlib, not of the system, and no clock is read: same document, same
bytes. A letter that these fonts lack is taken from the fonts of the system.
"""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.recipe.result import clean
from metrosep.report.html import captions_of, figures_of, is_narrow, split_main
from metrosep.report.text import capital, document_writer, one_line
from metrosep.report.view import view

PDF_STANDARDS = ("a-2b", "a-3b")
"""For archives. PDF/A-2b may hold no attachment, so the result is left out of it."""

_TIME = 946_684_800
"""2000-01-01 UTC, as the time of creation: a clock would make other bytes each time."""

_NARROW = 30
"""Letters of a name that fit beside the figure of the first page."""

_PAGE_WIDTH, _FIGURE_WIDTH, _FIGURE_HEIGHT, _TALL = 180.0, 150.0, 82.0, 165.0
_SHORT = 60


def render_pdf(document: Mapping[str, Any], *, standard: str | None = None) -> bytes:
    """Return the report of a result.

    Parameters
    ----------
    document : mapping
        Content of a result.json.
    standard : {"a-2b", "a-3b"}, optional
        PDF/A that it must conform to; plain PDF 1.7 if omitted.

    Returns
    -------
    bytes
        PDF; result.json is attached, except in PDF/A-2b.

    Raises
    ------
    DataError
        If the result is damaged, a verdict is unknown, the standard is none of these, or a letter
        cannot be set as the standard demands.
    UnsupportedFeatureError
        If typst is not installed.
    """
    if standard is not None and standard not in PDF_STANDARDS:
        raise DataError(
            f"PDF standard {standard!r} is not offered; there are {', '.join(PDF_STANDARDS)}"
        )
    plainer = "; or ask for the plainer pages of matplotlib: --pdf-engine matplotlib"
    typst = require_typst("a PDF report", "pdf", plainer)
    data, figures = _data(document)
    data |= {"attached": standard != "a-2b", "dated": standard is not None}
    with TemporaryDirectory(prefix="metrosep-") as name:
        folder = Path(name)
        for file, content in figures.items():
            (folder / file).write_bytes(content)
        text = json.dumps(data, sort_keys=True, allow_nan=False)
        (folder / "data.json").write_text(text, encoding="utf-8")
        (folder / "result.json").write_bytes(_bytes_of(document))
        (folder / "result.typ").write_text(_template(), encoding="utf-8")
        needs = _needs_system_fonts(text)
        compiled = partial(
            typst.compile,
            str(folder / "result.typ"),
            root=str(folder),
            font_paths=[str(_fonts_into(folder))],
            ignore_system_fonts=not (needs and _SYSTEM_FONTS),
            format="pdf",
            timestamp=_TIME,
        )
        try:
            if _needs_system_fonts(json.dumps(data["c"])):
                _require_letters(compiled, typst.TypstError, folder, data)
            made = compiled(pdf_standards=[standard] if standard else [])
        except typst.TypstError as exc:
            reason = " ".join(str(getattr(exc, "message", exc)).split())
            raise DataError(
                f"the PDF could not be set: {reason}; write it without a PDF standard, or as html"
            ) from exc
    return bytes(made)


def write_pdf(
    document: Mapping[str, Any], path: str | os.PathLike[str], *, standard: str | None = None
) -> Path:
    """Write the report of a result.

    Parameters
    ----------
    document : mapping
        Content of a result.json.
    path : str or path
        File.
    standard : {"a-2b", "a-3b"}, optional
        PDF/A that it must conform to.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DataError
        As `render_pdf`.
    UnsupportedFeatureError
        If typst is not installed.
    WriteError
        If it cannot be written.
    """
    return atomic_write(path, render_pdf(document, standard=standard))


_SYSTEM_FONTS = True
"""Whether fonts of the system may be taken for letters that DejaVu Sans lacks."""


def _require_letters(
    compiled: Any, error: type[Exception], folder: Path, data: Mapping[str, Any]
) -> None:
    """Refuse a first page with letters that no font has: a standard for archives notices it, plain PDF prints boxes."""
    archived = json.dumps({**data, "attached": False, "dated": True}, sort_keys=True)
    plain = (folder / "data.json").read_text(encoding="utf-8")
    (folder / "data.json").write_text(archived, encoding="utf-8")
    try:
        compiled(pdf_standards=["a-2b"])
    except error as exc:
        said = str(getattr(exc, "message", exc))
        if "font" not in said:
            raise
        letters = sorted({c for c in json.dumps(data["c"], ensure_ascii=False) if _is_missing(c)})
        letters = [c for c in letters if c.isalpha()] or letters
        raise UnsupportedFeatureError(
            f"no font on this computer has the {_script(letters)} letters {''.join(letters[:8])} of the "
            "report; install one (such as Noto Sans CJK) and name it as font of the template, or write html"
        ) from None
    finally:
        (folder / "data.json").write_text(plain, encoding="utf-8")


def _is_missing(letter: str) -> bool:
    return ord(letter) > 127 and ord(letter) not in _letters()


def _script(letters: Sequence[str]) -> str:
    """Return the scripts of some letters, from the names that Unicode gives them."""
    words = {"CJK": "Chinese or Japanese", "HIRAGANA": "Japanese", "KATAKANA": "Japanese"}
    signs = [c for c in letters if unicodedata.category(c) == "Lo"] or letters
    names = [unicodedata.name(c, "UNKNOWN").split()[0] for c in signs]
    found = dict.fromkeys(words.get(n.partition("-")[0], n.capitalize()) for n in names)
    if "Japanese" in found:
        found.pop(words["CJK"], None)
    return " and ".join([*found][:2]) or "needed"


def require_typst(what: str, extra: str, otherwise: str = "") -> Any:
    """Return the module, or say what needs it and how it is installed."""
    try:
        import typst
    except ImportError:
        raise UnsupportedFeatureError(
            f"{what} needs typst, which is not installed; install it: pip install "
            f'"metrosep[{extra}]"{otherwise}'
        ) from None
    return typst


@cache
def _template() -> str:
    from importlib.resources import files

    return files("metrosep.report").joinpath("templates/result.typ").read_text("utf-8")


@cache
def _own_fonts() -> str:
    """Return the folder of the fonts that matplotlib brings."""
    from matplotlib import get_data_path

    return str(Path(get_data_path()) / "fonts" / "ttf")


def _fonts_into(folder: Path) -> Path:
    """Return a folder with the DejaVu fonts; that of matplotlib has one that draws a box for any letter, too."""
    place = folder / "fonts"
    place.mkdir()
    for font in sorted(Path(_own_fonts()).glob("DejaVuSans*.ttf")):
        shutil.copyfile(font, place / font.name)
    return place


def _needs_system_fonts(text: str) -> bool:
    """Return whether the data hold a letter that DejaVu Sans lacks."""
    letters = set(json.loads(f'"{_escapes(text)}"')) if "\\u" in text else set()
    return any(ord(c) not in _letters() for c in letters)


def _escapes(text: str) -> str:
    return "".join(re.findall(r"\\u[0-9a-f]{4}", text))


@cache
def _letters() -> frozenset[int]:
    from matplotlib.ft2font import FT2Font

    return frozenset(FT2Font(str(Path(_own_fonts()) / "DejaVuSans.ttf")).get_charmap())


def _bytes_of(document: Mapping[str, Any]) -> bytes:
    text = json.dumps(clean(document), indent=1, sort_keys=True, allow_nan=False)
    return (text + "\n").encode("utf-8")


def _data(document: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Return what the template reads, and the figures by file name."""
    shown = view(document)
    first, others = split_main(figures_of(document), document)
    drawings = [*first, *others]
    figures = [
        {
            "number": i,
            "file": f"figure-{i}.svg",
            "title": f.title,
            "caption": f.caption,
            "width": _width(f.svg),
            "narrow": is_narrow(f.svg),
        }
        for i, f in enumerate(drawings, start=1)
    ]
    recipe = shown["recipe"]
    if recipe is not None:
        lines = [_printable(line) for line in str(recipe.get("text") or "").splitlines()]
        recipe = {"sha256": str(recipe.get("sha256") or "none"), "lines": lines}
    stamps = [
        {**c, "stamp": None if c["stamp"] is None else c["stamp"]._asdict()}
        for c in shown["characteristics"]
    ]
    title = _printable(str(shown["title"]))
    data = _tidied({k: v for k, v in shown.items() if k not in ("stamp", "c")})
    data |= {
        "title": title,
        "short_title": title if len(title) <= _SHORT else title[: _SHORT - 1] + "…",
        "stamp": shown["stamp"]._asdict(),
        "characteristics": _tidied(stamps),
        "figure_rows": _side_by_side(_tidied(figures[len(first) :])),
        "recipe": recipe,
    }
    files = {f"figure-{i}.svg": f.svg.encode("utf-8") for i, f in enumerate(drawings, start=1)}
    data["c"], logo = _first_page(shown["c"], _tidied(figures[: len(first)]))
    return data, files | logo


def _first_page(
    c: Mapping[str, Any], main: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Return what the first page shows, and the file of its logo."""
    rows = [{**r, "stamp": r["stamp"] and r["stamp"]._asdict()} for r in c["rows"]]
    shown = _tidied({**c, "rows": rows, "stamp": c["stamp"]._asdict()})
    shown["main"] = main[0] if main else None
    shown["wide"] = " / " in shown["t"]["characteristic"] or any(
        len(r["name"]) > _NARROW for r in rows
    )
    kind, _, data = str(c["look"]["logo"]).partition(";base64,")
    shown["logo"] = f"logo.{'png' if kind.endswith('png') else 'svg'}" if data else ""
    return shown, {shown["logo"]: base64.b64decode(data)} if data else {}


def _side_by_side(figures: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Return figures in rows: two narrow ones that follow each other share one."""
    rows: list[list[dict[str, Any]]] = []
    for each in figures:
        beside = rows and len(rows[-1]) == 1 and rows[-1][0]["narrow"] and each["narrow"]
        if beside:
            rows[-1].append(each)
        else:
            rows.append([each])
    return rows


def _width(svg: str) -> float:
    """Return the width in mm at which a figure fits the page beside others."""
    found = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    if found is None:
        return _FIGURE_WIDTH
    across, down = (float(v) for v in found.groups())
    tallest = _FIGURE_HEIGHT if across >= down else _TALL
    return round(min(_FIGURE_WIDTH, tallest * across / down, _PAGE_WIDTH), 2)


def _tidied(value: Any) -> Any:
    """Return nested texts without control characters; lines of a program stay lines."""
    if isinstance(value, Mapping):
        return {str(k): _tidied(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_tidied(v) for v in value]
    return _printable(value) if isinstance(value, str) else value


def _printable(text: str) -> str:
    return "".join(
        c if c == "\n" or (c.isprintable() and not "\ud800" <= c <= "\udfff") else " "
        for c in text.replace("\u00ad", "")  # typst parts words by itself
    )


# ---- A result as plain pages of matplotlib: the PDF for where typst is not installed -----------


def render_plain_pdf(document: Mapping[str, Any]) -> bytes:
    """Return the report of a result as plain pages."""
    from metrosep.plot.pages import plain_pages

    shown = view(document)
    lines = [(style, one_line(text)) for style, text in _lines(shown)]
    footer = f"SHA-256: {shown['hashes']}, metrosep {one_line(shown['version'])}"
    captions = {k: one_line(f"{t}. {c}") for k, (t, c) in captions_of(document).items()}
    return plain_pages(document, lines, captions, footer)


write_plain_pdf = document_writer(
    "write_plain_pdf", render_plain_pdf, "the report of a result as plain pages",
    DataError="If the result is damaged or a verdict is unknown.",
)  # fmt: skip


def _lines(shown: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    mark = shown["stamp"]
    c = shown["c"]
    yield "title", c["heading"]
    yield "head", shown["title"]
    if c["missing"]:
        yield "text", c["missing"]
    for name, rows in c["blocks"]:
        yield "text", f"{capital(name)}: " + "; ".join(f"{k} {v}" for k, v in rows)
    yield "head", f"{mark.symbol} {mark.word}"
    yield "text", mark.meaning
    if shown["decision_rule"] and mark.word != "NO VERDICT":
        yield "text", f"Decision rule: {shown['decision_rule']}"
    yield from _facts(shown["header"])
    for message in (*c["warnings"], *shown["messages"]):
        yield "text", f"Note: {message}"
    yield from _facts(shown["summary"])
    if shown["characteristics"]:
        yield from _head("Characteristics")
        for entry in shown["characteristics"]:
            yield from _characteristic(entry)
    if shown["runs"]:
        yield from _head("Each run against the others")
        for r in shown["runs"]:
            yield (
                "text",
                (
                    f"{r['short']} ({r['feed']} mm/min): misfit {r['misfit']}, gain {r['gain']} (u {r['u_gain']}), "
                    f"shift {r['shift']} mm (u {r['u_shift']} mm)"
                    + (f"; {r['found']}" if r["found"] else "")
                ),
            )
    yield from _table(shown["table"])
    if shown["polynomial"]:
        yield from _head(shown["polynomial"]["heading"])
        yield from (("mono", line) for line in shown["polynomial"]["horner"].splitlines())
        yield from _facts(shown["polynomial"]["rows"])
    yield from _head("Where it comes from")
    for item in shown["inputs"]:
        yield "text", f"{item['name']} ({item['format']}, {item['size']})"
        yield "mono", f"SHA-256 {item['sha256']}"
    for step in shown["steps"]:
        yield "text", f"{step['name']}: {step['parameters']} (metrosep {step['version']})"
    versions = [f"{name} {value}" for name, value in shown["versions"]]
    yield "text", ", ".join([f"metrosep {shown['version']}", *versions])
    if shown["recipe"]:
        yield from _head("Recipe")
        yield "mono", f"SHA-256 {shown['recipe'].get('sha256')}"
        text = str(shown["recipe"].get("text") or "")
        yield from (("mono", line) for line in text.splitlines())
    yield from _head("Signatures")
    for who, name in shown["c"]["persons"]:
        yield "text", ""
        yield "text", name
        yield (
            "mono",
            f"{capital(who):<12} name {'_' * 24} date {'_' * 14} signature {'_' * 24}",
        )


def _head(text: str) -> Iterator[tuple[str, str]]:
    yield "text", ""
    yield "head", text


def _facts(rows: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    yield from (("text", f"{name}: {value}") for name, value in rows)


def _characteristic(entry: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    words = [f"{entry['name']} = {entry['value']} {entry['unit']}".strip()]
    words += [f"{k} = {entry[k]}" for k in ("u", "U") if entry[k] != "–"]
    if entry["limits"] != "–":
        words.append(f"limits {entry['limits']}, guard band {entry['guard'] or 'not known'}")
    if entry["stamp"]:
        words.append(f"{entry['stamp'].symbol} {entry['stamp'].word}")
    yield "text", "; ".join(words)


def _table(table: Mapping[str, Any] | None) -> Iterator[tuple[str, str]]:
    if not table:
        return
    yield from _head("Compensation table")
    for found in table["findings"]:
        yield "text", f"{found['level']}: {found['problem']} {found['fix']}"
    yield from _facts(table["rows"])
    check = table["verification"]
    if check is None:
        yield "text", f"Dry-run: {table['waived']}. The sign is not proven on a measurement."
        return
    does = "shrinks" if check["passed"] else "does not shrink"
    yield "text", f"Dry-run: the table {does} the measured error in every direction."
    for row in check["rows"]:
        yield (
            "text",
            f"{row['direction']}, {row['quantity']}: before {row['before']}, after {row['after']}",
        )
