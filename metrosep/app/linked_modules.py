"""One text from several ES modules, for a notebook that takes a widget as a single text.

A small linker for the modules of our own `static` folder, not a bundler: each module becomes a
function scope, in the order of import. What it does not understand it refuses.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import NoReturn

from metrosep.core.errors import DataError, UnsupportedFeatureError

__all__ = ["linked_module", "masked_code"]

_NAME = r"[A-Za-z_$][\w$]*"
_TOKEN = re.compile(
    r"(?P<comment>//[^\n]*|/\*.*?\*/)"
    r"|(?P<text>\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*')"
    r"|(?P<pattern>/(?:\\.|\[(?:\\.|[^\]\\\n])*\]|[^/\\\[\n*])(?:\\.|\[(?:\\.|[^\]\\\n])*\]|[^/\\\[\n])*/[a-z]*)"
    r"|(?P<word>[\w$]+)|(?P<space>\s+)|(?P<other>.)",
    re.DOTALL,
)
_BEFORE_PATTERN = frozenset(
    [
        "return",
        "typeof",
        "case",
        "in",
        "of",
        "do",
        "else",
        "void",
        "delete",
        "throw",
        "new",
        "instanceof",
    ]
)
"""Words after which a slash begins a regular expression and does not divide."""

_IMPORT = re.compile(
    rf"import\s+(?:(?P<default>{_NAME})\s*(?:,\s*)?)?(?:\{{(?P<names>[^}}]*)\}}\s*)?from\s*"
    r"(?P<quote>[\"'])(?P<path>[^\"']*)(?P=quote)\s*;"
)
_DECLARED = re.compile(
    rf"export\s+(?=(?:async\s+)?(?:function\s*\*?|class|const)\s+(?P<name>{_NAME}))"
)
_LISTED = re.compile(r"export\s*\{(?P<names>[^}]*)\}\s*;")
_DEFAULT = re.compile(r"export\s+default\s+(?!(?:async|function|class)\b)")
Pairs = tuple[tuple[str, str], ...]
"""Name as it is exported, and as it is called where it is used."""

_PAIR = re.compile(rf"(?P<one>{_NAME})(?:\s+as\s+(?P<other>{_NAME}))?")


@dataclass(frozen=True, slots=True)
class _Part:
    """What a module needs, what it gives, and its text without import and export."""

    needs: tuple[tuple[str, Pairs], ...]
    gives: Pairs
    body: str


def linked_module(entry: str, read: Callable[[str], str | None] | Mapping[str, str]) -> str:
    """Return one ES module that does what `entry` does with all that it imports.

    Notes
    -----
    A module is run once, after those that it imports, as a browser does it. Only what cannot
    change is exported (functions, classes, constants), so a copy of the binding is the binding.
    Names of different modules never meet: each has the scope of its own function.

    Examples
    --------
    >>> modules = {"a.js": 'import { b } from "./b.js"; export default b + 1;',
    ...            "b.js": "export const b = 1;"}
    >>> print(linked_module("a.js", modules))
    const module0 = (() => {
    const b = 1;
    return { b: b };
    })();
    const module1 = (() => {
    const { b: b } = module0;
     const exportedDefault = b + 1;
    return { default: exportedDefault };
    })();
    export default module1.default;
    """
    texts = read.get if isinstance(read, Mapping) else read
    done: dict[str, tuple[str, Pairs]] = {}
    lines: list[str] = []

    def add(path: str, above: tuple[str, ...]) -> None:
        if path in above:
            raise UnsupportedFeatureError(
                f"modules import one another in a circle: {' -> '.join((*above, path))}"
            )
        if path in done:
            return
        text = texts(path)
        if text is None:
            raise DataError(
                f"there is no module {path}, which {above[-1] if above else 'you'} asks for"
            )
        part = _parted(path, text)
        for needed, _ in part.needs:
            add(needed, (*above, path))
        name = f"module{len(done)}"
        done[path] = name, part.gives
        lines.append(f"const {name} = (() => {{")
        for needed, pairs in part.needs:
            home, given = done[needed]
            for wanted in dict(pairs).keys() - dict(given).keys():
                raise DataError(f"{path} imports {wanted} from {needed}, which does not export it")
            lines.append(f"const {_listed(pairs)} = {home};")
        lines.extend([part.body.strip("\n"), f"return {_listed(part.gives)};", "})();"])

    add(entry, ())
    name, given = done[entry]
    if "default" not in dict(given):
        raise DataError(f"{entry} has no default export")
    return "\n".join([*lines, f"export default {name}.default;"])


def masked_code(text: str, path: str = "module") -> tuple[str, str]:
    """Return JavaScript without comments, and the same with blanks for what is not code.

    Examples
    --------
    >>> masked_code("a = 'import'; // import")
    ("a = 'import'; ", 'a =         ; ')
    """
    kept: list[str] = []
    mask: list[str] = []
    open_: list[str] = []  # brackets; "`" for an expression within a template
    last = ""

    def put(piece: str, *, code: bool) -> None:
        kept.append(piece)
        mask.append(piece if code else re.sub(r"[^\n]", " ", piece))

    def template(at: int) -> int:
        """Put the text of a template from `at`; return where code goes on."""
        found = re.compile(r"(?:\\.|\$(?!\{)|[^`\\$])*(`|\$\{)", re.DOTALL).match(text, at)
        if found is None:
            raise DataError(f"{path}: a template does not end")
        put(found.group(0), code=False)
        if found.group(1) == "${":
            open_.append("`")
        return found.end()

    at = 0
    while at < len(text):
        found = _TOKEN.match(text, at)
        if found is None:  # pragma: no cover - any character matches "other"
            raise DataError(f"{path}: cannot read on at character {at}")
        kind, piece = str(found.lastgroup), found.group(0)
        if kind == "pattern" and not (
            not last or last in "(,=:[!&|?{};+-*%<>~^" or last in _BEFORE_PATTERN
        ):
            kind, piece = "other", "/"
        at += len(piece)
        if kind == "comment":
            if "opyright" in piece:
                put(piece, code=False)
            elif piece.startswith("/*"):
                put("\n" if "\n" in piece else " ", code=True)
            continue
        if kind in ("text", "pattern"):
            put(piece, code=False)
            last = ")"  # a value: what follows divides
        elif piece == "`":
            put(piece, code=False)
            at = template(at)
            last = "(" if open_ and open_[-1] == "`" and text[at - 1] == "{" else ")"
        elif piece == "}" and open_ and open_[-1] == "`":
            open_.pop()
            put(piece, code=False)
            at = template(at)
            last = "(" if open_ and open_[-1] == "`" and text[at - 1] == "{" else ")"
        else:
            if piece in ("'", '"'):
                raise DataError(f"{path}: a string does not end: {text[at - 1 : at + 30]!r}")
            if piece == "/" and text[at : at + 1] == "*":
                raise DataError(f"{path}: a comment does not end")
            if piece in "([{":
                open_.append(piece)
            elif piece in ")]}" and (not open_ or open_.pop() + piece not in ("()", "[]", "{}")):
                raise DataError(f"{path}: a bracket {piece} closes nothing")
            put(piece, code=True)
            last = last if kind == "space" else piece
    if open_:
        raise DataError(f"{path}: a bracket {open_[-1]} is not closed")
    return "".join(kept), "".join(mask)


def _parted(path: str, text: str) -> _Part:
    """Return what a module imports and exports, and the rest of its text."""
    kept, mask = masked_code(text, path)
    spare = "exportedDefault"
    while spare in mask:
        spare += "_"
    needs: list[tuple[str, Pairs]] = []
    gives: list[tuple[str, str]] = []
    cuts: list[tuple[int, int, str]] = []
    for keyword in re.finditer(r"(?<![\w$.])(?:import|export)(?![\w$]|\s*:)", mask):
        at = keyword.start()
        if kept.startswith("import", at):
            found = _IMPORT.match(kept, at)
            if found is None or not (found["default"] or found["names"] is not None):
                _refuse(path, kept, at)
            needs.append((_joined(path, found["path"]), _imported(path, found)))
            cuts.append((*found.span(), ""))
        elif found := _LISTED.match(mask, at):
            gives += [(theirs, ours) for ours, theirs in _pairs(path, found["names"])]
            cuts.append((*found.span(), ""))
        elif found := _DEFAULT.match(mask, at):
            gives.append(("default", spare))
            cuts.append((*found.span(), f"const {spare} = "))
        elif (found := _DECLARED.match(mask, at)) and not _declares_more(mask, found.end()):
            gives.append((found["name"], found["name"]))
            cuts.append((*found.span(), ""))
        else:
            _refuse(path, kept, at)
    for start, stop, put in reversed(cuts):
        kept = kept[:start] + put + kept[stop:]
    return _Part(
        tuple(needs),
        tuple(gives),
        re.sub(r"[ \t]+\n|\n{2,}", "\n", kept) if "`" not in kept else kept,
    )


def _imported(path: str, found: re.Match[str]) -> Pairs:
    first = () if found["default"] is None else (("default", found["default"]),)
    return (*first, *_pairs(path, found["names"] or ""))


def _declares_more(mask: str, at: int) -> bool:
    """Return whether ``const a = 1, b = 2`` declares several names."""
    if not mask.startswith("const", at):
        return False
    depth = 0
    for sign in mask[at:]:
        depth += (sign in "([{") - (sign in ")]}")
        if depth == 0 and sign in ",;":
            return sign == ","
    return False


def _listed(pairs: Pairs) -> str:
    return f"{{ {', '.join(f'{theirs}: {ours}' for theirs, ours in pairs)} }}"


def _pairs(path: str, names: str) -> Pairs:
    """Return the names on both sides of each ``as``."""
    pairs = []
    for name in (n.strip() for n in names.split(",") if n.strip()):
        found = _PAIR.fullmatch(name)
        if found is None:
            raise UnsupportedFeatureError(f"{path}: {name!r} cannot be linked")
        pairs.append((found["one"], found["other"] or found["one"]))
    return tuple(pairs)


def _joined(path: str, wanted: str) -> str:
    if not wanted.startswith(("./", "../")):
        raise UnsupportedFeatureError(
            f"{path} imports {wanted!r}: only modules beside it can be linked, by ./ or ../"
        )
    parts: list[str] = []
    for piece in (PurePosixPath(path).parent / wanted).parts:
        if piece != "..":
            parts.append(piece)
        elif parts:
            parts.pop()
        else:
            raise UnsupportedFeatureError(f"{path} imports {wanted!r}, which leaves the folder")
    return "/".join(parts)


def _refuse(path: str, text: str, at: int) -> NoReturn:
    line = text[at:].partition("\n")[0][:80]
    raise UnsupportedFeatureError(
        f"{path}: {line!r} cannot be linked; write import {{ a }} from or import a from a relative "
        "path, export function, class, const, export default of a value, or export { a }"
    )
