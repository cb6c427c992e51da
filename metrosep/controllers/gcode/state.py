"""What is in force at each block of a program, and which programs cannot be corrected.

A correction is looked up at the position of a block. Whatever makes that position differ from the
words of the block (arcs, incremental words, offsets, cutter compensation, rotation, cycles,
subprograms) is refused with the line, the reason and the way out. A word that is not known is
refused too: nobody can say what it does to the position.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    MetrosepError,
    UnitError,
    UnsupportedFeatureError,
)

MM, INCH = 1e-3, 25.4e-3
_UNIT_WORDS = {"mm": MM, "inch": INCH, "in": INCH}

_NEUTRAL = frozenset({90, 150, 170, 180, 190, 400, 610, 611, 690, 901, 911, 970, 500, 960})
_FEEDS = {930: "G93", 940: "G94", 950: "G95", 980: "G98", 990: "G99"}
_UNITS = {200: INCH, 210: MM, 7000: INCH, 7100: MM}
_GEOMETRY_UNITS = (700, 710)
"""G70, G71 of Sinumerik and TwinCAT: unit of positions; F stays in that of the control (802D sl manual, 8.2.3)."""
_OF_CYCLES = frozenset("PQUWR")
"""Words of G70 and G71 as cycles of lathes, one of which each has; D, I and K beside G71 are of Sinumerik too."""
_CYCLES = {
    900: "a turning cycle",
    920: "a threading cycle",
    940: "a facing cycle",
    200: "a turning cycle",
    210: "a threading cycle",
    240: "a facing cycle",
}
"""Of lathes of Fanuc and its kin: the first three in system A of G codes, the others in C."""
_OF_SYSTEM_A = frozenset({900, 920, 940})
_RETURNS = frozenset({980, 990})
"""Feed modes in system A; where cycles return to on mills and in system B."""
_ONE_SHOT = frozenset({280, 300, 530})
"""Codes that take the axis words of their block themselves."""
_FRAMES = frozenset({*range(540, 600, 10), 541, 591, 592, 593, 921, 922})
_LENGTHS = frozenset({430, 431, 432, 440, 490})
_HOMES = frozenset({280, 300, 530})
_PART_CALLS = {"TRAORI": True, "TRAFOOF": False, "ORIAXES": None, "ORIWKS": None}
"""Tool-centre-point control of Sinumerik: on, off, and how the tool turns in it."""
_SMOOTH = "blocks may be merged or smoothed here"
_OFFSET_WAY = "set offsets on the machine before the program and take the word out"
_ARC_WAY = "post-process the path to short linear moves (G1)"

_REFUSED: dict[int, tuple[str, str]] = {
    20: ("an arc has no single point to correct", _ARC_WAY),
    30: ("an arc has no single point to correct", _ARC_WAY),
    52: ("a spline is not a line between its points", _ARC_WAY),
    53: ("a spline is not a line between its points", _ARC_WAY),
    62: ("a spline is not a line between its points", _ARC_WAY),
    100: ("it changes offsets", _OFFSET_WAY),
    160: ("polar words are not X and C", "post-process the path to X, C, Z"),
    330: ("threading follows the spindle", "leave threads out of the corrected program"),
    410: (
        "cutter compensation moves the path",
        "let the post-processor compensate the tool radius",
    ),
    420: (
        "cutter compensation moves the path",
        "let the post-processor compensate the tool radius",
    ),
    434: (
        "words are places on the part, not of the axes",
        "post-process the path to axis positions",
    ),
    435: (
        "words are places on the part, and I, J, K a direction of the tool",
        "post-process the path to words of the axes of rotation (G43.4), or to axis positions",
    ),
    682: ("the plane is tilted", "post-process the path to axis positions"),
    510: ("scaling changes positions", "post-process the path without it"),
    511: ("mirroring changes positions", "post-process the path without it"),
    520: ("it shifts the coordinates", _OFFSET_WAY),
    680: ("the coordinates are rotated", "post-process the path without rotation"),
    910: ("incremental words add up roundings", "post-process the path in absolute words (G90)"),
    920: ("it shifts the coordinates", _OFFSET_WAY),
    923: ("it shifts the coordinates", _OFFSET_WAY),
} | dict.fromkeys(
    (*range(700, 800, 10), *range(810, 900, 10)),
    ("a canned cycle moves on its own", "post-process the cycle to plain moves"),
)
_M_REFUSED: dict[int, tuple[str, str]] = {
    **dict.fromkeys(
        (17, 97, 98, 99, 198),
        ("a subprogram is not in the text", "expand the program into one file"),
    ),
    60: ("a pallet change moves the part", "correct one part at a time"),
    61: ("another tool brings another offset", "correct one tool's path at a time"),
    **dict.fromkeys(
        (70, 71, 72, 73), ("it restores states the text does not show", "take it out")
    ),
}
SAFE_M = frozenset({0, 1, 2, 30, 3, 4, 5, 6, 7, 8, 9, 19, *range(48, 54), *range(62, 69)})
"""M codes that are understood: stops, spindle, tool, coolant, overrides, inputs and outputs."""

_OPTIONAL_M = frozenset({0, 1, 7, 8, 9, *range(48, 54), *range(62, 69)})
"""Those that a switch on the machine may leave out without a change of the path."""

_UNKNOWN = "nobody can say what it does to the position"
_BELONGS: dict[str, tuple[frozenset[int], frozenset[int]]] = {
    "P": (frozenset({40, 50, 51, 80, 640}), frozenset({62, 63, 64, 65, 66})),
    "Q": (frozenset({50, 51, 640}), frozenset({66, 67, 68})),
    "L": (frozenset(), frozenset({66})),
    "E": (frozenset(), frozenset({66, 67, 68})),
    "D": (frozenset({410, 420, 960}), frozenset()),
}
"""Words that mean something only beside one of these G (tenths) or M codes."""

_MOTIONS = frozenset({0, 10, 20, 30})
_AXES = "XCZ"
_ALL_AXES = "XYZABCUVW"


def scale_of_unit(unit: str | None) -> float | None:
    """Return the metres of a unit that a caller states for a program without G20 or G21."""
    if unit is None:
        return None
    if unit not in _UNIT_WORDS:
        raise UnitError(f"unit is {unit!r}; it is 'mm' or 'inch'")
    return _UNIT_WORDS[unit]


@dataclass(slots=True)
class ModalState:
    """What is in force; changed by each block that is more than axis words."""

    scale: float | None = None  # m: length of one unit of the file; None while it is unknown
    diameter: bool | None = None  # whether X words are diameters; None while nothing says so
    motion: int | None = None  # 0 for rapid, 1 for feed, None for no motion mode
    feed_mode: str = ""  # ``"G93"``, ``"G94"`` ... or empty while unknown
    stated_scale: bool = False  # whether program (or caller, for the diameter) said so
    stated_diameter: bool = False
    stated_absolute: bool = False
    incremental: bool = False  # G91 of a home move is in force
    moved: bool = False  # whether there was a move, a feed move, a Z word
    cut: bool = False
    z_known: bool = False
    away: int = 0  # line of the last home move, 0 if there was none
    # axes whose place the text no longer tells since the last move; taken by the reader
    lost: str = ""
    feed: float = math.nan  # F of a block that is not a move, NaN once a move has taken it
    spindle: int = 0  # line of the last M3 or M4, 0 if the spindle stands
    spun: int = 0  # line of the first M3 or M4 that was in force in a feed move
    begun: bool = False  # after the first block that is more than ``%``
    # frozenset of int: M codes of this machine that neither move nor change the coordinates
    harmless_m: frozenset[int] = frozenset()
    g_system: str | None = None  # "A" or "B" of Fanuc lathes, or "mill"; None where nobody said
    ended: bool = False  # after M2 or M30
    # whether tool-centre-point control is in force, so that words are places on the part; None where
    # it is refused (the part of a lathe)
    part: bool | None = None
    length: str = ""  # number of the tool length that G43.4 took
    geometry_line: int = 0  # of the first G71, which leaves the unit of F to the control; 0: none
    open_feed: bool = False  # whether nothing but G71 said a unit
    edge: str = ""  # number of the tool edge (D of Sinumerik), whose lengths are in force
    dropped: bool = False  # whether G49 or D0 took the length away and nothing has given it back
    axes: str = _AXES  # letters of the axes that are corrected
    spindle_axis: str = "C"  # whose place a turning spindle takes; empty where it turns the tool
    # to int: words for the person, with the line of the first occasion
    messages: dict[str, int] = field(default_factory=dict)

    @property
    def unit(self) -> float:
        """Length of one unit of the file in m."""
        if self.scale is None:
            raise UnitError("the unit of the path is not known; give unit='mm' or 'inch'")
        return self.scale

    def apply(self, tokens: Sequence[Token], line: int) -> bool:
        """Take a block into account."""
        if self.ended:
            return False
        words = [t for t in tokens if t.kind == "word"]
        if any(t.kind == "percent" for t in tokens):
            self.ended |= self.begun  # the second % of a tape: what follows is not carried out
            if self.ended:
                return False
        self.begun |= any(t.kind not in ("space", "percent") for t in tokens)
        self._calls(tokens, line)
        axes = {w.letter for w in words if w.letter in self.axes}
        codes = {_code(w, line) for w in words if w.letter == "G"}
        if any(t.kind == "slash" for t in tokens) and not all(
            w.letter == "N" or (w.letter == "M" and w.value in _OPTIONAL_M) for w in words
        ):
            raise refuse_block(
                line,
                "'/'",
                "a switch on the machine decides whether this block is run",
                "take the block out or the slash away",
            )
        self._refuse_cycle(codes, words, line)
        for code in sorted(codes):
            self._g(code, axes, words, line)
        for word in words:
            self._word(word, words, codes, line)
        self._take_feed(words, axes, codes, line)
        if codes & _HOMES:
            self.away, self.lost = line, self.axes
            return False
        return bool(axes) and self._move(axes, codes, line)

    def refuse_behind(self, block: str, line: int) -> None:
        """Refuse a move behind the end of the program: it belongs to another one, which would stay as it is.

        Also behind a %: of a text without one at its top, a control may load what follows the first %.
        """
        try:
            tokens = tokenize(block, line)
        except MetrosepError:
            return  # no block
        move = next((t for t in tokens if t.kind == "word" and t.letter in _ALL_AXES), None)
        if move is not None:
            why = (
                "it stands behind the end of the program (M2, M30 or %) and would not be corrected"
            )
            raise refuse_block(line, move.text, why, "make a file of each program of the text")

    def note(self, message: str, line: int) -> None:
        """Keep a message with the line where it was first due."""
        self.messages.setdefault(message, line)

    def _refuse_cycle(self, codes: set[int], words: list[Token], line: int) -> None:
        """Refuse a turning cycle, and what may be one; later blocks with X alone repeat it."""
        moving = any(w.letter in _ALL_AXES for w in words)
        if self.g_system == "A":
            found = codes & _OF_SYSTEM_A
        elif self.g_system is None and moving and not codes & (_MOTIONS | _ONE_SHOT):
            found = codes & _CYCLES.keys()
        else:
            return
        for code in sorted(found):
            system = "A" if code in _OF_SYSTEM_A else "C"
            way = "post-process the cycle to plain moves"
            if self.g_system is None:
                way += ", or say g_system='mill' (or 'B') if it is none"
            raise refuse_block(
                line,
                f"G{code / 10:g}",
                f"with an axis word it is {_CYCLES[code]} in system {system} of G codes of lathes, which "
                "moves on its own"
                if self.g_system is None
                else f"in system A of G codes it is {_CYCLES[code]}, which moves on its own",
                way,
            )

    def _take_feed(self, words: list[Token], axes: set[str], codes: set[int], line: int) -> None:
        feeds = [w for w in words if w.letter == "F"]
        if not feeds:
            return
        if 40 in codes:
            why = "beside G4 it is a time on some controllers, a feed on others"
            raise refuse_block(line, feeds[0].text, why, "write the dwell in a block of its own")
        if not axes or codes & _HOMES:
            self.feed = feeds[-1].value

    def _calls(self, tokens: Iterable[Token], line: int) -> None:
        for token in tokens:
            if token.kind == "call":
                name = token.text.split("(")[0].strip().upper()
                if name in _PART_CALLS:
                    if self.part is None:
                        raise refuse_block(line, name, *_REFUSED[434])
                    self._place_on_part(_PART_CALLS[name])
                elif name not in ("COMPOF", "BRISK"):
                    self.note(_smoothing(token.text.strip()), line)

    def _word(self, word: Token, words: list[Token], codes: set[int], line: int) -> None:
        letter = word.letter
        if letter in self.axes or letter in "GFNST":
            if letter == "T":
                self._tool(word, words, line)
            return
        if letter == "M":
            self._m(word, words, line)
        elif letter == "O":
            self._program_number(word, words, line)
        elif letter in _ALL_AXES:
            why, known = "the correction is looked up over X and C only", "X, C and Z"
            if self.axes != _AXES:
                known = ", ".join(self.axes)
                why = f"the axes of the machine are {known}"
            elif letter in "UW":
                why = "U and W are incremental X and Z, or further axes"
            raise refuse_block(line, word.text, why, f"post-process the path to {known}")
        elif letter in "IJKR":
            why = "it belongs to an arc or a corner"
            raise refuse_block(line, word.text, why, _ARC_WAY)
        elif letter == "H" and not codes & (_LENGTHS | {434}):
            why = "without G43 it is an incremental C on some lathes"
            raise refuse_block(line, word.text, why, "write C absolute, or G43 beside H")
        elif letter == "D" and self.part is not None and not codes & _BELONGS["D"][0]:
            self._edge(word, line)
        elif letter != "H" and not self._belongs(letter, words, codes):
            raise refuse_block(line, word.text, _UNKNOWN, "take it out of the path")

    @staticmethod
    def _belongs(letter: str, words: list[Token], codes: set[int]) -> bool:
        """Return whether a word stands beside the code that it is a number of."""
        g, m = _BELONGS.get(letter, (frozenset(), frozenset()))
        return bool(codes & g) or any(w.letter == "M" and w.value in m for w in words)

    def _m(self, word: Token, words: list[Token], line: int) -> None:
        number = int(word.value)
        if number != word.value or number < 0:
            raise refuse_block(line, word.text, _UNKNOWN, "take it out of the path")
        if number in _M_REFUSED:
            raise refuse_block(line, word.text, *_M_REFUSED[number])
        if number not in SAFE_M and number not in self.harmless_m:
            way = (
                f"take it out, or say harmless_m=[{number}] if it neither moves an axis nor changes "
                "the coordinates on your machine"
            )
            raise refuse_block(line, word.text, _UNKNOWN, way)
        if number == 6:
            self._tool(word, words, line)
        elif number in (3, 4, 5, 19):
            if number != 5 or self.spindle:
                self.lost = self.lost or self.spindle_axis
            self.spindle = line if number in (3, 4) else 0
        elif number in (2, 30):
            self.ended = True

    def _tool(self, word: Token, words: list[Token], line: int) -> None:
        """Take another tool: the machine goes where it is changed, and its offset is another."""
        if self.cut:
            raise refuse_block(
                line,
                word.text,
                "a tool change brings another offset into the path",
                "correct one tool's path at a time",
            )
        if any(w.letter in self.axes for w in words):
            why = "nobody can say whether the tool changes before the move or after it"
            raise refuse_block(line, word.text, why, "put it into a block of its own")
        self.lost = self.axes

    def _program_number(self, word: Token, words: list[Token], line: int) -> None:
        if self.moved or len(words) > 1:
            raise refuse_block(
                line,
                word.text,
                "an O-word in a program begins a subprogram or a control structure",
                "expand the program into one file of plain moves",
            )

    def _g(self, code: int, axes: set[str], words: list[Token], line: int) -> None:
        name = f"G{code / 10:g}"
        if code in (0, 10):
            self.motion = code // 10
        elif code == 800:
            self.motion = None
        elif code in _UNITS:
            self._units(_UNITS[code], name, line)
        elif code in _GEOMETRY_UNITS and not self._is_cycle(words):
            self._unit_of_geometry(code, name, line)
        elif code in _RETURNS and self.g_system in ("B", "mill"):
            return
        elif code in _FEEDS:
            self.feed_mode = _FEEDS[code]
        elif code == 900:
            self.stated_absolute, self.incremental = True, False
        elif code == 910 and any(w.letter == "G" and w.value in (28, 30) for w in words):
            self.incremental = True
        elif code in (70, 80):
            self._seven(code, words, line)
        elif code in (50, 51):
            self._five(name, words, axes, line)
        elif code == 434 and self.part is not None:
            self._tip_length(words, line)
        elif code == 490 and self.part:
            self._place_on_part(False)
            self.dropped = True
        elif code in _FRAMES or code in _LENGTHS:
            self._offset(code, name, axes, line)
        elif code == 640:
            if any(w.letter == "P" for w in words):
                self.note(_smoothing(" ".join(w.text for w in words if w.letter in "GP")), line)
        elif code == 40 or code == 500 or code == 920:
            self._not_a_move(code, name, axes, words, line)
        elif code in _HOMES:
            if self.cut and not self.away:
                self.note(f"{name}: the path ends there", line)
        elif code in _REFUSED:
            raise refuse_block(line, name, *_REFUSED[code])
        elif code not in _NEUTRAL:
            raise refuse_block(line, name, _UNKNOWN, "take it out of the path")

    def _is_cycle(self, words: list[Token]) -> bool:
        """Return whether G70 or G71 is a cycle of a lathe here, and no unit."""
        return self.g_system in ("A", "B") or any(w.letter in _OF_CYCLES for w in words)

    def _unit_of_geometry(self, code: int, name: str, line: int) -> None:
        """Take G71; G70 is refused, because inches with a feed in mm/min are likely beside it."""
        if code == _GEOMETRY_UNITS[0]:
            why = "F stays in the basic unit of the control, which the text does not say"
            raise refuse_block(line, name, why, "write G700 or G20, which hold for F too")
        self.open_feed = self.scale is None
        self.geometry_line = self.geometry_line or line
        self._units(MM, name, line)

    def _units(self, scale: float, name: str, line: int) -> None:
        if self.scale is not None and self.scale != scale:
            why = "the path is in " + ("mm" if self.scale == MM else "inch")
            way = "give the unit that the program states" if not self.moved else "use one unit"
            raise refuse_block(line, name, why, way)
        if self.moved and self.scale is None:
            raise refuse_block(
                line, name, "there were moves before it", "state the unit before the first move"
            )
        self.scale, self.stated_scale = scale, True

    def _seven(self, code: int, words: list[Token], line: int) -> None:
        """Take G7 and G8 of lathes; G8 P1 is a look-ahead of Fanuc, G7 with words an interpolation."""
        with_p = any(w.letter == "P" for w in words)
        if code == 80 and with_p:
            self.note(_smoothing("G8 P"), line)
            return
        wanted = code == 70
        if self.moved and self.diameter is not wanted:
            why = "X changes between radius and diameter in the path"
            raise refuse_block(line, f"G{code // 10}", why, "keep one of them")
        if self.stated_diameter and self.diameter is not wanted:
            why = "it contradicts what was said of X"
            raise refuse_block(line, f"G{code // 10}", why, "give diameter= as the program has it")
        self.diameter, self.stated_diameter = wanted, True

    def _five(self, name: str, words: list[Token], axes: set[str], line: int) -> None:
        """Take the look-ahead of Fanuc (G05 P10000, G05.1 Q1); otherwise these are splines."""
        asked = [w for w in words if w.letter in "PQ"]
        if axes or len(asked) != 1 or any(w.letter in "IJ" for w in words):
            raise refuse_block(line, name, "a spline is not a line between its points", _ARC_WAY)
        if asked[0].value != 0.0:
            self.note(_smoothing(f"{name} {asked[0].text}"), line)

    def _offset(self, code: int, name: str, axes: set[str], line: int) -> None:
        length = code in _LENGTHS
        kept = not self.cut and ("Z" in axes or not self.z_known) if length else not self.moved
        if not kept:
            what = "the tool length changes" if length else "the coordinates change"
            raise refuse_block(line, name, f"{what} within the path", "keep one offset to the end")

    def _tip_length(self, words: list[Token], line: int) -> None:
        """Begin tool-centre-point control, with the same length of the tool to the end."""
        length = next((w.number.lstrip("0") for w in words if w.letter == "H"), self.length)
        if self.cut and length != self.length:
            why = "the tool length changes within the path"
            raise refuse_block(line, "G43.4", why, "keep one offset to the end")
        self._place_on_part(True)
        self.length, self.dropped = length, False

    def _edge(self, word: Token, line: int) -> None:
        """Take the lengths of a tool edge, which are those that the caller stated; one edge in a path."""
        if word.value < 0 or word.value != int(word.value):
            raise refuse_block(line, word.text, _UNKNOWN, "take it out of the path")
        number = str(int(word.value))
        linear = "".join(a for a in self.axes if a in "XYZUVW")
        if number == "0":
            self.dropped, self.lost = True, self.lost + linear
            return
        if self.cut and number != self.edge:
            why = "another edge of the tool has other lengths"
            raise refuse_block(line, word.text, why, "keep one edge, named before the first cut")
        if self.dropped or number != self.edge:
            self.lost += linear
        self.edge, self.dropped = number, False
        self.note(
            f"D{number}: the lengths of this edge are taken to be in the tool point and the zero that were stated",
            line,
        )

    def _place_on_part(self, part: bool | None) -> None:
        """Words mean something else from here on: where the tool stands in them is not in the text."""
        if part is not None and self.part is not part:
            linear = "".join(a for a in self.axes if a in "XYZUVW" and a not in self.lost)
            self.part, self.lost = part, self.lost + linear

    def _not_a_move(
        self, code: int, name: str, axes: set[str], words: list[Token], line: int
    ) -> None:
        if code == 40 and axes:
            why = "X or another axis word with it is a time on some controllers, a move on others"
            raise refuse_block(line, name, why, "write the dwell with P in a block of its own")
        if code != 40 and (axes or not any(w.letter == "S" for w in words)):
            raise refuse_block(line, name, *_REFUSED[920])

    def _move(self, axes: set[str], codes: set[int], line: int) -> bool:
        if 40 in codes:
            return False
        if self.incremental:
            raise refuse_block(line, "a move in G91", *_REFUSED[910])
        if self.motion is None:
            why = "no G0 or G1 is in force"
            raise refuse_block(line, "a move", why, "state G0 or G1 before the first position")
        self.check_move(line)
        self.z_known |= "Z" in axes
        return True

    def check_move(self, line: int) -> None:
        """Take note of a move."""
        if self.scale is None:
            raise refuse_block(
                line,
                "a move",
                "neither G20 (inch) nor G21 (mm) was stated, nor G700, G710 or G71 of Sinumerik",
                "add G21 (G710 for Sinumerik) or give unit='mm' (or 'inch')",
            )
        if self.away and self.cut:
            raise refuse_block(
                self.away,
                "G28, G30 or G53",
                "the machine leaves the path and comes back",
                "split the program there",
            )
        self.moved = True
        self.cut |= self.motion == 1
        if self.motion == 1 and self.spindle and not self.spun:
            self.spun = self.spindle


def checked_system(name: str | None) -> str | None:
    """Return the system of G codes of a program, refusing those that are not known."""
    if name == "C":
        raise DataError(
            "g_system='C' cannot be corrected: its cycles are G20, G21 and G24 and its units G70 and G71, "
            "which no document at hand confirms; post-process the path in system A or B"
        )
    if name not in (None, "A", "B", "mill"):
        raise DataError(f"g_system is {name!r}; it is 'A', 'B' or 'mill'")
    return name


def _smoothing(text: str) -> str:
    return (
        f"{text}: {_SMOOTH}: set the tolerance of the smoothing to 1/10 of the correction's "
        "amplitude or less, or the correction is filtered away"
    )


def _code(word: Token, line: int) -> int:
    code = round(word.value * 10)
    if code < 0 or abs(word.value * 10 - code) > 1e-6:
        raise refuse_block(line, word.text, _UNKNOWN, "take it out of the path")
    return code


# ---- words of a block; every byte is kept, so that only what is meant to change changes ---------
# A block is cut into tokens whose texts, joined, are the block again: words (a letter and a number),
# comments ``( )`` and ``;``, white space, ``%``, the slash of an optional block. What is none of these
# (variables, expressions, control words, decimal commas) is refused by name, because a program that
# computes its positions cannot be corrected from its text.

Kind = Literal["word", "comment", "space", "percent", "slash", "call"]

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_TOKEN = re.compile(
    r"(?P<comment>\([^()\r\n]*\)|;[^\r\n]*)"
    r"|(?P<call>(?:TRAORI|TRAFOOF|ORIAXES|ORIWKS|CYCLE832|COMPCAD|COMPCURV|COMPON|COMPOF|COMPSURF|SOFT|BRISK)\b(?:\s*\([^()\r\n]*\))?)"
    r"|(?P<word>[A-Za-z][ \t]*" + _NUMBER + r")"
    r"|(?P<space>[ \t\r\n\f]+)"
    r"|(?P<percent>%)"
    r"|(?P<slash>/)"
    r"|(?P<program>:\d+)",
    re.IGNORECASE,
)
_COMPUTED = re.compile(
    r"#|\[|=|\$|<|\b(?:IF|WHILE|GOTO|GOTOF|GOTOB|DO\d*|END\d*|FOR|REPEAT|CALL|SUB|ENDSUB|RETURN|PROC"
    r"|DEF|LOOP)\b",
    re.IGNORECASE,
)
_DIGITS = str.maketrans("", "", "0123456789.+-")


@dataclass(frozen=True, slots=True)
class Token:
    """A piece of a block."""

    # {"word", "comment", "space", "percent", "slash", "call"}: what it is; "call" is a named
    # setting of smoothing such as ``CYCLE832(...)``
    kind: Kind
    text: str  # its characters
    start: int  # where it begins in the block
    letter: str = ""  # of a word, upper case; otherwise empty
    number: str = ""  # of a word, as it is written; otherwise empty

    @property
    def value(self) -> float:
        """Number of a word."""
        return float(self.number)

    @property
    def end(self) -> int:
        """Where it ends in the block."""
        return self.start + len(self.text)


def tokenize(block: str, line: int = 0) -> tuple[Token, ...]:
    """Cut a block into tokens whose texts joined are the block.

    Examples
    --------
    >>> [t.text for t in tokenize("N10 g1X1.5(to it)Z-.25")]
    ['N10', ' ', 'g1', 'X1.5', '(to it)', 'Z-.25']
    """
    found: list[Token] = []
    at = 0
    while at < len(block):
        match = _TOKEN.match(block, at)
        if match is None:
            raise _refused(block, at, line)
        kind, text = match.lastgroup, match.group()
        if kind == "word" or kind == "program":
            letter = "O" if kind == "program" else text[0].upper()
            found.append(Token("word", text, at, letter, text[1:].strip()))
        else:
            found.append(Token(kind, text, at))  # type: ignore[arg-type]
        at = match.end()
    _refuse_split_numbers(found, block, line)
    return tuple(found)


def shape_of(block: str) -> str:
    """Return the block without its digits, points and signs.

    Examples
    --------
    >>> shape_of("N10 X1.5 Z-.25")
    'N X Z'
    """
    return block.translate(_DIGITS)


def decimals_of(number: str) -> int:
    """Return how many digits stand after the point.

    Examples
    --------
    >>> decimals_of("-1.250"), decimals_of("3")
    (3, 0)
    """
    return len(number) - number.find(".") - 1 if "." in number else 0


def format_number(value: float, decimals: int) -> str:
    """Return a number with that many digits after the point, never an exponent or minus zero.

    Examples
    --------
    >>> format_number(-4e-9, 6), format_number(1.25, 3)
    ('0.000000', '1.250')
    """
    text = f"{value:.{decimals}f}"
    return text[1:] if text[0] == "-" and not text.strip("-0.") else text


def refuse_block(line: int, what: str, why: str, way_out: str) -> UnsupportedFeatureError:
    """Return the error for a block that cannot be rewritten."""
    return UnsupportedFeatureError(f"line {line}: {what}: {why}; {way_out}")


def _refused(block: str, at: int, line: int) -> Exception:
    rest = block[at:].strip()[:30]
    computed = _COMPUTED.search(block, max(0, at - 8))
    if computed is not None:
        return refuse_block(
            line,
            f"{rest!r}",
            "variables, expressions and control words compute positions that the text does not show",
            "post-process the path to plain numbers",
        )
    if block[at] == ",":
        why = "a comma is neither a decimal point nor a chamfer that can be corrected"
        return refuse_block(line, f"{rest!r}", why, "write numbers with a decimal point")
    return CorruptFileError(
        f"line {line}",
        f"{rest!r} is not a word of G-code (a letter and a number)",
        hint="post-process the path to plain words",
    )


def _refuse_split_numbers(tokens: list[Token], block: str, line: int) -> None:
    """Refuse an exponent, which controllers read as a word E."""
    for before, after in pairwise(tokens):
        if after.letter == "E" and before.kind == "word":
            raise refuse_block(
                line,
                before.text + after.text,
                "controllers take no exponents",
                "write the number out",
            )
