"""Private helper: parts of docstrings that several functions share stand once."""

from __future__ import annotations

from collections.abc import Callable
from textwrap import dedent
from typing import TypeVar

__all__ = ["documented"]

Documented = TypeVar("Documented")


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
