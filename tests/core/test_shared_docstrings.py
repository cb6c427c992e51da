"""What one object says of a parameter or an error is said of another in its own order and with its own defaults."""

import inspect
import re
import sys

import pytest

from metrosep import separation
from metrosep.core.docs import describe_options, described_by
from metrosep.core.methods import METHODS
from metrosep.core.options import option, options_of


def source(a, b=1.0, *rest, c=2, **more):
    """Return nothing.

    Parameters
    ----------
    a, b : float, m
        Two lengths.
    *rest : float
        More of them.
    c : int, optional
        A count.
    **more : object
        Words.

    Raises
    ------
    ValueError
        If a is negative.
    KeyError
        If a word is not known,
        or c is.
    """


def section(of, title):
    """Lines of one section, found by its underline."""
    lines = inspect.getdoc(of).split("\n")
    if title not in lines:
        return []
    start = lines.index(title) + 2
    rest = lines[start:]
    return rest[: rest.index("") if "" in rest else None]


def test_the_order_is_that_of_the_borrower():
    @described_by(source)
    def borrower(c, own, a, b):
        """Do it.

        Parameters
        ----------
        own : str
            Its own.

        Returns
        -------
        int
            One.
        """

    assert section(borrower, "Parameters") == [
        "c : int", "    A count.",
        "own : str", "    Its own.",
        "a, b : float, m", "    Two lengths.",
    ]  # fmt: skip
    assert section(borrower, "Returns") == ["int", "    One."]


@pytest.mark.parametrize(
    ("borrower", "head"),
    [
        (lambda c: None, "c : int"),
        (lambda c=3: None, "c : int, optional"),
        (lambda a=0, b=0: None, "a, b : float, m, optional"),
        (lambda a, b=0: None, "a, b : float, m"),
        (lambda **more: None, "**more : object"),
    ],
)
def test_optional_is_what_has_a_default_here(borrower, head):
    borrower.__doc__ = "Do it."
    assert section(described_by(source)(borrower), "Parameters")[0] == head


def test_own_words_come_first():
    @described_by(source)
    def borrower(c):
        """Do it.

        Parameters
        ----------
        c : str
            A name.

        Raises
        ------
        ValueError
            If c is empty.
        """

    assert section(borrower, "Parameters") == ["c : str", "    A name."]
    assert section(borrower, "Raises") == [
        "ValueError", "    If c is empty.",
        "KeyError", "    If a word is not known,", "    or c is.",
    ]  # fmt: skip


def test_errors_are_left_where_they_are_on_request():
    @described_by(source, errors=False)
    def borrower(c):
        """Do it."""

    assert section(borrower, "Raises") == []
    assert section(borrower, "Parameters") == ["c : int", "    A count."]


def test_class_methods_and_classes_may_borrow():
    @described_by(source, errors=False)
    class Borrower:
        """Hold it."""

        def __init__(self, c=1):
            self.c = c

        @described_by(source, errors=False)
        @classmethod
        def made(cls, c):
            """Make it."""
            return cls(c)

    assert section(Borrower, "Parameters")[0] == "c : int, optional"
    assert section(Borrower.made, "Parameters")[0] == "c : int"
    assert section(vars(Borrower)["made"], "Parameters")[0] == "c : int"
    assert Borrower.made(3).c == 3


def test_without_docstrings_nothing_happens():
    def borrower(c):
        pass

    assert described_by(source)(borrower).__doc__ is None


def spring(readings, *, length=1e-3, ends="free", windows=()):
    """Return the spring.

    Parameters
    ----------
    readings : array_like
        What was read.
    """


def test_an_option_is_described_at_class_and_function_by_its_field():
    class Spring:  # a dataclass later: its decorator takes the fields away
        """A spring.

        Parameters
        ----------
        ends : {"free", "held"}
            Its own words.

        Returns
        -------
        Separation
        """

        length: float = option(kind="size", help="how long it is")
        ends: str = option("free", kind="text", help="of the spring", choices=("free", "held"))
        turns: int = option(3, kind="integer", help="of its wire", choices=(3, 4))
        places: tuple[float, ...] = option((), kind="places", help="where it is held")

    describe_options(Spring, spring)

    assert section(Spring, "Parameters") == [
        "length : float, m", "    How long it is.",
        'ends : {"free", "held"}', "    Its own words.",
        "turns : {3, 4}, optional", "    Of its wire.",
        "places : sequence of (float, float), m, optional", "    Where it is held.",
    ]  # fmt: skip
    assert section(Spring, "Returns") == ["Separation"]
    assert section(spring, "Parameters") == [
        "readings : array_like", "    What was read.",
        "length : float, m, optional", "    How long it is.",
        'ends : {"free", "held"}, optional', "    Its own words.",
    ]  # fmt: skip


def test_every_option_of_a_separation_is_on_the_page_of_its_class_and_function():
    missing = []
    for name in separation.METHODS:
        cls = METHODS[name]
        function = vars(sys.modules[cls.__module__]).get(name)
        for page in (cls, function) if inspect.isfunction(function) else (cls,):
            taken = inspect.signature(page).parameters
            said = "\n".join(section(page, "Parameters") or [])
            missing += [
                (page.__name__, option)
                for option in options_of(cls)
                if option in taken and not re.search(rf"(^|, ){option}(,| :)", said, re.MULTILINE)
            ]
    assert missing == []
