"""From bytes to text: the encoding of a file, the ends of its lines, and words that tell a code page."""

from __future__ import annotations

import codecs
import itertools
import re
import unicodedata
from functools import lru_cache
from typing import Final

from metrosep.core.errors import FormatMismatchError, ReadError
from metrosep.core.units import FOREIGN_SPELLINGS
from metrosep.io.source import HEAD_BYTES, RawFile
from metrosep.io.text.words import ROLE_WORDS

__all__ = [
    "decode",
    "encoding_of",
    "encoding_of_head",
    "head_text",
    "lines_before",
    "plain_ends",
    "refuse_zero_bytes",
    "zero_byte",
]

_ABOVE: Final = (
    "测量 采样 频率 周期 通道 设备 仪器 操作员 文件 单位 最大 最小 平均 传感器 编号 数据 结果 公司 "
    "計測 測定 周期 周波数 保存 装置 作業者 最大 最小 平均 番号 データ 結果 判定 "
    "年 月 日 时 時 分 秒 上午 下午 午前 午後 "
    "измерение прибор оператор канал частота файл среднее датчик"
)
"""Words that stand above tables beside the names of the columns; full-width kana are known one by one."""

_PAGES: Final = ("cp1252", "cp932", "gb18030", "big5", "euc_kr", "cp1251", "mac_roman")
_KNOWN = re.compile(
    "|".join(
        sorted(
            {
                w
                for words in ROLE_WORDS.values()
                for w in words.casefold().split()
                if not w.isascii() and len(w) > 1
            }
            | set("µμ°℃å±²³\u2212\u202f\u2009０１２３４５６７８９．，－＋")
            | set(_ABOVE.split())
            | {chr(c) for c in (*range(0x3041, 0x3097), *range(0x30A1, 0x30FB))}
            | FOREIGN_SPELLINGS,
            key=len,
            reverse=True,
        )
    )
)
_BEYOND_ASCII = re.compile(rb"(?<![^\r\n])[^\r\n\x80-\xff]*+[\x80-\xff][^\r\n]*")
"""Whole lines with a byte beyond ASCII; a long line is looked through once."""
_LINES = 100
"""Lines that are looked at for their code page."""
_WITH_DIGITS = re.compile(rb"[\x81-\xfe][0-9][\x81-\xfe][0-9]")
"""A character of GB18030 of which two bytes are digits, such as a micro sign or a minus."""
_WESTERN = re.compile(rb"(?<![\x80-\xff])(?:\xb5m|\xb0C)(?![\x80-\xff])")
"""A micrometre or a degree Celsius of a page of single bytes: in the others a rare word, or none."""
_SINGLE = ("cp1252", "cp1251", "mac_roman")
_PUNCTUATION = frozenset({*range(0x80), *range(0xA0, 0x100), *b"\x80\x85\x91\x92\x93\x94\x96\x97"})
"""Bytes that stand alone in a text of cp1252: letters, and the dash that is written for a minus."""
_ENOUGH = 1 / 3
"""Share of known characters: in a wrong page some bytes are a degree sign by chance."""
_CONTROL = bytes({*range(0x20)} - {*b"\t\n\v\f\r\x1a\x1b"})


def decode(data: bytes, path: object, encoding: str | None = None) -> tuple[str, str]:
    r"""Return the text of a file and the encoding it was in."""
    if encoding is None and len(data) <= HEAD_BYTES:
        known = _decoded_head(data)
        if known is not None:
            return known
    name = encoding or (_head_encoding(data) if len(data) <= HEAD_BYTES else _encoding(data))
    try:
        text = data.decode(name)
    except (UnicodeDecodeError, LookupError) as exc:
        raise ReadError(f"{path}: is not {name} text ({exc}); name it with encoding=") from None
    if _is_binary(data, text, name):
        raise _binary(path, data)
    return plain_ends(text), name


def _binary(path: object, data: bytes, above: int = 0) -> FormatMismatchError:
    other = "holds binary data, not text; if it is a text file, name it with encoding="
    return FormatMismatchError(f"{path}: {zero_byte(data, above) or other}")


def zero_byte(data: bytes, above: int = 0) -> str:
    """Name the line of the first byte of value 0 of a text that begins behind so many lines; empty for other bytes."""
    text, zero, rest = data.partition(b"\0")
    plain = data.replace(b"\0", b"")
    is_text = b"\n" in plain and plain.translate(None, _CONTROL) == plain
    if not zero or not is_text or _TWO_BYTES.search(data):
        return ""
    hint = (
        "correct that line in an editor that shows such bytes"
        if rest.strip(b"\0")
        else "cut it off before that line"
    )
    return (
        f"line {above + text.count(_LF) + 1} holds a byte of value 0, which no text has; a program that was stopped "
        f"leaves such bytes: copy the file again, or {hint}"
    )


_LF = b"\n"
_TWO_BYTES = re.compile(rb"(?:[^\0]\0){3}|(?:\0[^\0]){3}")
"""Characters of UTF-16, of which every second byte may be 0."""


def refuse_zero_bytes(file: RawFile, part: bytes, start: int) -> None:
    """Refuse a part of a text, from a byte of the file on, that holds a byte of value 0."""
    if b"\0" in part:
        raise _binary(file.path, part, lines_before(file, start, _LF))


def lines_before(file: RawFile, end: int, mark: bytes) -> int:
    """Return how many lines end before a byte of a file."""
    with file.stream() as handle:
        parts = iter(lambda: handle.read(min(2**20, end - handle.tell())), b"")
        return sum(part.count(mark) for part in parts)


def encoding_of_head(file: RawFile) -> str:
    """Return the encoding of the head of a file; nothing else decides where all of the text is ASCII."""
    return _encoding(file.head)


def encoding_of(file: RawFile, size: int) -> str:
    """Return the encoding of a long text, which is looked at in parts of about `size` bytes to its end.

    It is what `decode` would find of the whole: strict UTF-8, or the code page of its words.
    """
    name = _encoding(file.head)
    if name.startswith(("utf-16", "utf-32")):
        return name
    beyond, is_unicode, above = b"", name in ("utf-8", "utf-8-sig"), 0
    with file.stream() as handle:
        while data := handle.read(size):
            data += handle.readline(size)
            if b"\0" in data:
                raise _binary(file.path, data, above)
            above += data.count(_LF)
            if data.isascii():
                continue
            if is_unicode:
                try:
                    data.decode(name)
                except UnicodeDecodeError:
                    is_unicode = False
            if len(beyond) < HEAD_BYTES:
                beyond += b"\n".join(
                    m.group() for m in itertools.islice(_BEYOND_ASCII.finditer(data), _LINES)
                )
    return name if is_unicode else _legacy_page(beyond)


def head_text(file: RawFile) -> str | None:
    """Return the text of the first whole lines of a file, None where it is not text."""
    try:
        return decode(file.head_lines, file.path)[0]
    except ReadError:
        return None


_NO_WIDTH = "\u200b\u200e\u200f\u2060"
"""Marks without a width, which web pages and spreadsheets put beside numbers."""


def plain_ends(text: str) -> str:
    """Return text whose lines end with LF alone; no other character ends a line."""
    if "\r" in text:
        for end in ("\r\r\n", "\r\n", "\r"):
            text = text.replace(end, "\n")
    if "\ufeff" in text:  # files that were joined have one in the middle
        text = text.replace("\n\ufeff", "\n")
    for mark in _NO_WIDTH:
        if mark in text:
            text = text.replace(mark, "")
    return text.removeprefix("\ufeff").removesuffix("\x1a")


@lru_cache(maxsize=2)
def _decoded_head(data: bytes) -> tuple[str, str] | None:
    """Return what `decode` does of a head that a dozen readers look at; None where it refuses."""
    name = _head_encoding(data)
    try:
        text = data.decode(name)
    except (UnicodeDecodeError, LookupError):
        return None
    return None if _is_binary(data, text, name) else (plain_ends(text), name)


def _is_binary(data: bytes, text: str, name: str) -> bool:
    by_byte = name in {"utf-8", "utf-8-sig", "latin-1", *_PAGES}
    return "\0" in text or (by_byte and len(data.translate(None, _CONTROL)) != len(data))


def _encoding(data: bytes) -> str:
    for mark, name in (
        (codecs.BOM_UTF8, "utf-8-sig"),
        (codecs.BOM_UTF32_LE, "utf-32"),
        (codecs.BOM_UTF32_BE, "utf-32"),
        (codecs.BOM_UTF16_LE, "utf-16"),
        (codecs.BOM_UTF16_BE, "utf-16"),
    ):
        if data.startswith(mark):
            return name
    head = data[:2000]
    if len(head) >= 4 and head[1::2].count(0) > 0.4 * len(head) / 2:
        return "utf-16-le"
    if len(head) >= 4 and head[0::2].count(0) > 0.4 * len(head) / 2:
        return "utf-16-be"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as exc:
        # the sample that sniff gets may end inside a character
        if exc.start < len(data) - 4 or len(data) < 1000:
            return _legacy_page(data)
    return "utf-8"


_head_encoding = lru_cache(maxsize=2)(_encoding)
"""Readers look again at a head that is not text; its code pages need not be tried again."""


def _legacy_page(data: bytes) -> str:
    """Return the code page under which most characters beyond ASCII are words of headers.

    Only names and units are at stake: digits, marks and separators are the same bytes in each.
    """
    lines = [m.group() for m in itertools.islice(_BEYOND_ASCII.finditer(data), _LINES)]
    # a word that every row repeats counts once
    sample = b"\n".join(dict.fromkeys(line.translate(None, b"0123456789.,+-") for line in lines))
    pages = _SINGLE if _WESTERN.search(sample) else _PAGES
    shares = {page: _known_share(sample, page) for page in pages}
    if "gb18030" in pages and any(map(_WITH_DIGITS.search, lines)):
        shares["gb18030"] = _known_share(b"\n".join(lines), "gb18030")
    best = max(pages, key=lambda page: shares[page])
    if shares[best] > _ENOUGH:
        return best
    alone = not re.search(rb"[\x80-\xff]{2}", sample)
    return "cp1252" if alone and _PUNCTUATION.issuperset(sample) else "latin-1"


def _known_share(sample: bytes, page: str) -> float:
    """Return the share of characters beyond ASCII that are known, 0 where the bytes are no text of a page."""
    try:
        text = unicodedata.normalize("NFC", sample.decode(page)).casefold()
    except UnicodeDecodeError:
        return 0.0
    if page == "gb18030":
        text = text.replace(
            "\xa0", "\u202f"
        )  # two of its four bytes are digits: it is none by chance
    beyond = _beyond_ascii(text)
    return sum(_beyond_ascii(m) for m in _KNOWN.findall(text)) / beyond if beyond else 0.0


def _beyond_ascii(text: str) -> int:
    return sum(not c.isascii() for c in text)
