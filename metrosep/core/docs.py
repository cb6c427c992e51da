"""Private helper: parts of docstrings that several functions share stand once."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from textwrap import dedent, fill
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from metrosep.core.options import Option

Documented = TypeVar("Documented")
Function = TypeVar("Function")


def documented(**parts: str) -> Callable[[Documented], Documented]:
    r"""Return a decorator that replaces each line ``$name`` of a docstring by the part of that name.

    Examples
    --------
    >>> @documented(who="obj : Profile\n    Uniform.")
    ... def f(obj):
    ...     '''Return it.
    ...
    ...     Parameters
    ...     ----------
    ...     $who
    ...     '''
    >>> f.__doc__.splitlines()[-3:-1]
    ['    obj : Profile', '        Uniform.']
    """

    def fill(of: Documented) -> Documented:
        lines: list[str] = []
        for line in (of.__doc__ or "").split("\n"):
            name = line.strip()
            if name.startswith("$"):
                indent = line[: -len(line.lstrip())] if line != line.lstrip() else ""
                lines += [indent + part for part in dedent(parts[name[1:]]).strip().split("\n")]
            else:
                lines.append(line)
        if of.__doc__:
            of.__doc__ = "\n".join(lines)
        return of

    return fill


# ---- docstrings: what one object says of an option is not written again at another --------------


def described_by(*sources: object, errors: bool = True) -> Callable[[Function], Function]:
    """Return a decorator that adds the parameters, and the errors, that other objects describe."""

    def complete(function: Function) -> Function:
        of: Any = getattr(function, "__func__", function)  # of a class method
        if of.__doc__:  # None under python -OO
            texts = [inspect.getdoc(s) or "" for s in sources]
            texts += [_of_arguments(s) for s in sources]
            of.__doc__ = function.__doc__ = _completed(of, texts, errors)
        return function

    return complete


def describe_options(cls: type, function: Callable[..., Any] | None) -> None:
    """Complete the docstring of a class, and of its plain function, by what its options say."""
    known: dict[str, tuple[Option, bool]] = {}
    for name in getattr(cls, "__annotations__", {}):
        field = cls.__dict__.get(name)
        if isinstance(field, dataclasses.Field) and "option" in field.metadata:
            known[name] = field.metadata["option"], field.default is not dataclasses.MISSING
    if known and cls.__doc__:
        sections = _sections(inspect.cleandoc(cls.__doc__))
        own = _entries(sections.pop("Parameters", []))
        own |= {n: _entry(n, *option) for n, option in known.items() if n not in own}
        order = [n for n in cls.__annotations__ if n in own]
        listed = dict.fromkeys(own[n] for n in (*order, *(n for n in own if n not in order)))
        parameters = [line for entry in listed for line in entry]
        cls.__doc__ = _text({"": sections.pop(""), "Parameters": parameters, **sections})
    if function is not None and function.__doc__:
        texts = [inspect.cleandoc(cls.__doc__ or ""), _of_arguments(cls)]
        function.__doc__ = _completed(function, texts, errors=False)


def _of_arguments(cls: Any) -> str:
    """Return what the options of the call of a method say of themselves."""
    options: Mapping[str, Option] = getattr(cls, "arguments", {}) if inspect.isclass(cls) else {}
    entries = [_entry(n, o, not o.required) for n, o in options.items()]
    return _text({"": [""], "Parameters": [line for entry in entries for line in entry]})


def _entry(name: str, option: Option, has_default: bool) -> tuple[str, ...]:
    """Return the entry of an option: type, unit and its sentence of help."""
    from metrosep.core.numbers import unit_of
    from metrosep.core.options import KINDS

    kind, plain = KINDS[option.kind], option.kind.removesuffix("s")
    own = {"integer": "int", "flag": "bool", "text": "str", "pair": "(int, int)"}
    type_ = own.get(plain, "(float, float)" if plain in ("place", "window") else "float")
    if option.choices:
        type_ = "{" + ", ".join(repr(c).replace("'", '"') for c in option.choices) + "}"
    elif kind.is_list:
        type_ = f"sequence of {type_}"
    unit = unit_of(kind.dimension)
    head = f"{name} : {type_}{unit and f', {unit}'}{', optional' if has_default else ''}"
    text = option.help[:1].upper() + option.help[1:].rstrip(".") + "."
    indent = "    "
    return head, *fill(text, 94, initial_indent=indent, subsequent_indent=indent).split("\n")


def _completed(function: Callable[..., Any], sources: list[str], errors: bool) -> str:
    """Return the docstring with all parameters in the order of the signature, and all errors."""
    sections = _sections(inspect.getdoc(function) or "")
    others = [_sections(text) for text in sources]
    own = _entries(sections.pop("Parameters", []))
    known = {n: e for s in reversed(others) for n, e in _entries(s.get("Parameters", [])).items()}
    taken = inspect.signature(function).parameters
    lent = {n: _as_taken(e, taken) for n, e in known.items()}
    listed = [own.get(n) or lent.get(n) for n in taken]
    parameters = [line for entry in dict.fromkeys(e for e in listed if e) for line in entry]
    raised = sections.pop("Raises", [])
    named = set(_entries(raised))
    adding = others if errors else []
    for entry in dict.fromkeys(e for o in adding for e in _entries(o.get("Raises", [])).values()):
        names = set(_entries(list(entry)))
        raised = raised if names <= named else [*raised, *entry]
        named |= names
    order = {"": sections.pop(""), "Parameters": parameters}
    order.update({t: sections.pop(t) for t in ("Returns",) if t in sections})
    return _text({**order, "Raises": raised, **sections})


def _as_taken(entry: tuple[str, ...], taken: Mapping[str, inspect.Parameter]) -> tuple[str, ...]:
    """Return an entry that says "optional" where the borrower has a default, and only there."""
    head = entry[0].removesuffix(", optional")
    here = [
        taken[n] for name in head.split(" : ")[0].split(",") if (n := name.strip(" *")) in taken
    ]
    keywords = any(p.kind is p.VAR_KEYWORD for p in here)
    if not keywords and here and all(p.default is not p.empty for p in here):
        head += "" if "optional" in head else ", optional"
    return entry if keywords else (head, *entry[1:])


def _sections(doc: str) -> dict[str, list[str]]:
    """Return the lines of each section of a numpydoc text; what stands before them under ``""``."""
    found: dict[str, list[str]] = {"": []}
    lines, title = doc.splitlines(), ""
    for i, line in enumerate(lines):
        if i + 1 < len(lines) and line and lines[i + 1] == "-" * len(line):
            title = line
            found[title] = []
        elif not (title and line == "-" * len(title)):
            found[title].append(line)
    return {t: "\n".join(body).rstrip().split("\n") for t, body in found.items()}


def _entries(lines: list[str]) -> dict[str, tuple[str, ...]]:
    """Return the lines of each entry by its name; ``a, b : float`` is the entry of both."""
    starts = [i for i, line in enumerate(lines) if line and not line[0].isspace()]
    found = {}
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=False):
        for name in lines[start].split(" : ")[0].split(","):
            found[name.strip(" *")] = tuple(lines[start:end])
    return found


def _text(sections: dict[str, list[str]]) -> str:
    blocks = [
        "\n".join([title, "-" * len(title), *body] if title else body)
        for title, body in sections.items()
        if body
    ]
    return "\n\n".join(blocks) + "\n"
