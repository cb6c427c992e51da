"""Names of error terms: ISO 230-1 and the swapped subscripts of the fast-tool-servo paper.

ISO 230-1 writes the direction first and the axis second: EYX is the straightness of X in Y. The
paper writes the axis first: delta_xy is the same term. ``delta_xy`` read as an ISO name would be the
straightness of Y in X: a swap that no program notices, since both exist on a machine with a Y axis.

========================  ==================  =========================
paper                     short spellings     ISO 230-1
========================  ==================  =========================
delta_xx delta_xy         dxx dxy             EXX EYX
epsilon_xx epsilon_xy     exx exy eps_xx      EAX EBX
delta_cz epsilon_cz       dcz ecz             EZC ECC
delta_fx epsilon_fy       dfx efy             EXFTS EBFTS
eta_zx                    Hzx H_zx hzx        B0Z
========================  ==================  =========================
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TypeVar

from metrosep.core.errors import DataError

__all__ = ["axis_of", "from_paper", "import_errors", "located_axis", "paper_hint", "to_paper"]

_AXES = {"x": "X", "z": "Z", "c": "C", "f": "FTS"}
_MOTIONS = {"delta": "XYZ", "epsilon": "ABC"}
_STEMS = {"d": "delta", "delta": "delta", "e": "epsilon", "eps": "epsilon", "epsilon": "epsilon"}
_SQUARENESS = {"eta_zx": "B0Z"}
# both shapes of epsilon: what a person types and what LaTeX and many PDF files hold
_GREEK = {"\u03b4": "delta", "\u03b5": "epsilon", "\u03f5": "epsilon", "\u03b7": "eta"}
_SPELLING = re.compile(r"(delta|epsilon|eps|d|e)_?\{?([xzcf])([xyz])\}?")
_ISO_MOTION = re.compile(r"E([XYZABC])([A-Za-z][A-Za-z0-9_]*)")
_ISO_LOCATION = re.compile(r"E?([XYZABC])0([A-Za-z][A-Za-z0-9_]*)")

Value = TypeVar("Value")


def from_paper(name: str) -> str:
    """Return the ISO 230-1 name of a term of the paper.

    Parameters
    ----------
    name : str
        ``delta_mn``, ``epsilon_mn`` or ``eta_zx`` with Greek letters or spelt, or the short forms
        (dxx, exy, eps_xy, dcx, ecy, dfx, efx, Hzx); m the axis x, z, c or f, n the direction.

    Returns
    -------
    str
        ISO name: E + direction + axis, or B0Z.

    Raises
    ------
    DataError
        The paper has no such term; ISO names are refused, since their subscripts mean otherwise.

    Notes
    -----
    A lone ``exz`` is the paper's epsilon_xz, the yaw of X: ECX. The merged terms of its Table 2
    (dx, dy, dz) are sums of several and are refused.

    References
    ----------
    .. [1] Micromachines 11 (2020) 331, Table 1.

    Examples
    --------
    >>> from_paper("delta_xy"), from_paper("efx"), from_paper("Hzx")
    ('EYX', 'EAFTS', 'B0Z')
    """
    text = str(name).strip()
    for letter, word in _GREEK.items():
        text = text.replace(letter, word)
    if re.fullmatch(r"(eta_?|H_?|h_?)\{?zx\}?", text):
        return "B0Z"
    match = _SPELLING.fullmatch(text)
    if match is None:
        raise DataError(
            f"{name!r} is no error term of the paper; write delta_mn or epsilon_mn with m one of "
            "x, z, c, f (the axis) and n one of x, y, z (the direction), or eta_zx"
        )
    stem, axis, direction = match.groups()
    return f"E{_MOTIONS[_STEMS[stem]]['xyz'.index(direction)]}{_AXES[axis]}"


def to_paper(term: str) -> str:
    """Return the paper's name of an ISO 230-1 term.

    Parameters
    ----------
    term : str
        Name such as EYX, ECC, EXFTS, B0Z.

    Returns
    -------
    str
        ``delta_mn``, ``epsilon_mn`` or ``eta_zx``.

    Raises
    ------
    DataError
        The paper has no such term.

    Examples
    --------
    >>> to_paper("EYX"), to_paper("EAFTS")
    ('delta_xy', 'epsilon_fx')
    """
    for paper, iso in _SQUARENESS.items():
        if term == iso:
            return paper
    given: object = term
    match = _ISO_MOTION.fullmatch(given) if isinstance(given, str) else None
    letters = {axis: letter for letter, axis in _AXES.items()}
    if match is None or match[2] not in letters:
        raise DataError(f"the paper has no term {term!r}; its axes are X, Z, C and FTS, and B0Z")
    stem = "delta" if match[1] in "XYZ" else "epsilon"
    direction = "xyz"[_MOTIONS[stem].index(match[1])]
    return f"{stem}_{letters[match[2]]}{direction}"


def import_errors(errors: Mapping[str, Value]) -> dict[str, Value]:
    """Return errors with the paper's names as errors with ISO names.

    Parameters
    ----------
    errors : mapping of str to any
        Values by the paper's names.

    Returns
    -------
    dict
        The same values by ISO names.

    Raises
    ------
    DataError
        The errors are no mapping, a name is not the paper's, or two spellings mean the same term.

    Examples
    --------
    >>> import_errors({"dxy": 1e-6, "eta_zx": 2e-6})
    {'EYX': 1e-06, 'B0Z': 2e-06}
    """
    if not isinstance(errors, Mapping):
        raise DataError(
            f"errors are a mapping of the paper's names to values, got {type(errors).__name__}"
        )
    result: dict[str, Value] = {}
    for name, value in errors.items():
        term = from_paper(name)
        if term in result:
            raise DataError(f"{name!r} is {term}, which stands in the errors already")
        result[term] = value
    return result


def axis_of(term: str) -> str | None:
    """Return the axis on whose position an error term depends.

    Parameters
    ----------
    term : str
        ISO 230-1 name.

    Returns
    -------
    str or None
        Axis name; None for a location error, which is a constant.

    Raises
    ------
    DataError
        The name follows neither rule.

    Examples
    --------
    >>> axis_of("EAFTS"), axis_of("B0Z")
    ('FTS', None)
    """
    if not isinstance(term, str):
        raise DataError(f"{term!r} is no ISO 230-1 name: it is no text")
    if _ISO_LOCATION.fullmatch(term):
        return None
    match = _ISO_MOTION.fullmatch(term)
    if match is None:
        raise DataError(
            f"{term!r} is no ISO 230-1 name: E, a direction X Y Z A B C, the axis name"
            + paper_hint(term)
        )
    return match[2]


def located_axis(term: str) -> str | None:
    """Return the axis whose place a location error describes.

    Examples
    --------
    >>> located_axis("B0Z"), located_axis("EXX")
    ('Z', None)
    """
    match = _ISO_LOCATION.fullmatch(term)
    return None if match is None else match[2]


def paper_hint(term: str) -> str:
    """Return what to add to a message about an unknown name: the term that the paper means by it.

    Examples
    --------
    >>> paper_hint("dxy")
    "; in the paper's swapped subscripts it is EYX, see import_errors"
    """
    try:
        meant = from_paper(term)
    except DataError:
        return ""
    return f"; in the paper's swapped subscripts it is {meant}, see import_errors"
