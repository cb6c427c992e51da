"""What method classes and the functions that call them share: the contract, docstrings, settings."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, ClassVar, TypeVar

from numpy.typing import ArrayLike

from metrosep.core.numbers import not_negative
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import plain, reduced
from metrosep.separation.contract import Separation, SeparationMethod

__all__ = [
    "History", "Parts", "RecordedMethod", "StoredResult", "as_stated", "described_by", "not_known",
    "settle", "type_a",
]  # fmt: skip

History = tuple[Step, ...]
Parts = Mapping[str, ArrayLike]
"""Parts of a simulation by name."""

Function = TypeVar("Function", bound=Callable[..., Any])


class RecordedMethod(SeparationMethod):
    """A method whose results carry the history of the readings."""

    @property
    def _dimension(self) -> str:
        """What the readings are."""
        return self.dimension

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        """Return the parts of readings, with the checked uncertainty; or `separate` is overridden."""
        raise NotImplementedError

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: History = (),
    ) -> Separation:
        """Return the parts that readings consist of.

        Parameters
        ----------
        readings : array_like
            As `simulate` returns them, or with the repeats as a second axis; NaN = not measured.
        u_reading : float, optional
            Standard uncertainty of one reading; the scatter of the repeats, or of what is
            redundant, if omitted.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts, uncertainties, null space, audit.

        Raises
        ------
        InvalidSamplesError
            If the readings are not numbers, infinite, or of another shape.
        TooFewSamplesError
            If too few samples were measured.
        NotSeparableError
            If what was measured in the set-ups does not overlap.
        DataError
            If `u_reading` is negative or no number, or the readings look like another unit.
        """
        stated = u_reading
        if stated is not None:
            stated = not_negative(stated, "u_reading", dimension=self._dimension)
        return self._solved(readings, stated, history)


class StoredResult:
    """A result of fields that can be copied, and stored as plain values."""

    __slots__ = ()
    _not_stored: ClassVar[tuple[str, ...]] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None.

        Returns
        -------
        dict
            One key for each field, arrays as lists; large tables are left out.
        """
        names = [f.name for f in fields(self)]  # type: ignore[arg-type]
        return {n: _plain(getattr(self, n)) for n in names if n not in self._not_stored}


def _plain(value: Any) -> Any:
    if isinstance(value, dict) and any(isinstance(v, StoredResult) for v in value.values()):
        return {str(k): v.to_dict() for k, v in value.items()}
    return plain(value)


def type_a(value: float, unit: str, text: str, freedom: float) -> Quantity:
    """Return a standard deviation that was found, with its own uncertainty from the freedom."""
    return Quantity(value, unit, text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def as_stated(value: float, unit: str, of: str = "reading") -> Quantity:
    """Return a standard uncertainty of one reading that was stated."""
    return Quantity(value, unit, f"standard uncertainty of one {of}, as stated", symbol="s")


def not_known(unit: str, of: str = "reading") -> Quantity:
    """Return the noise of one reading where nothing shows it: NaN."""
    return Quantity(math.nan, unit, f"standard deviation of one {of}; not known", symbol="s")


def settle(method: object, /, **values: Any) -> None:
    """Set checked values on the fields of a frozen dataclass."""
    for name, value in values.items():
        object.__setattr__(method, name, value)


# ---- docstrings: what a class says of an option is not written again at the function -----------


def described_by(*sources: object) -> Callable[[Function], Function]:
    """Return a decorator that adds the parameters and errors that classes or methods describe."""

    def complete(function: Function) -> Function:
        if function.__doc__:  # None under python -OO
            function.__doc__ = _completed(function, [inspect.getdoc(s) or "" for s in sources])
        return function

    return complete


def _completed(function: Callable[..., Any], sources: list[str]) -> str:
    """Return the docstring with all parameters in the order of the signature, and all errors."""
    sections = _sections(inspect.getdoc(function) or "")
    others = [_sections(text) for text in sources]
    own = _entries(sections.pop("Parameters", []))
    known = {n: e for s in reversed(others) for n, e in _entries(s.get("Parameters", [])).items()}
    listed = [own.get(n) or known.get(n) for n in inspect.signature(function).parameters]
    parameters = [line for entry in dict.fromkeys(e for e in listed if e) for line in entry]
    raised = sections.pop("Raises", [])
    named = set(_entries(raised))
    for entry in dict.fromkeys(e for o in others for e in _entries(o.get("Raises", [])).values()):
        names = set(_entries(list(entry)))
        raised = raised if names <= named else [*raised, *entry]
        named |= names
    order = {"": sections.pop(""), "Parameters": parameters}
    order.update({t: sections.pop(t) for t in ("Returns",) if t in sections})
    return _text({**order, "Raises": raised, **sections})


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
