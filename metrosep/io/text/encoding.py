"""From bytes to text: the encoding of a file, the ends of its lines, and the words of tables.

What columns are called in seven languages and Russian tells a code page; other words say that nothing was measured.
"""

from __future__ import annotations

import codecs
import itertools
import re
import unicodedata
from functools import lru_cache
from typing import Final, Literal, TypeAlias

from metrosep.core.errors import FormatMismatchError, ReadError
from metrosep.core.units import FOREIGN_SPELLINGS
from metrosep.io.source import HEAD_BYTES, RawFile

Role: TypeAlias = Literal[
    "position", "height", "time", "feed", "run", "direction", "angle", "temperature", "index"
]

ROLE_WORDS: Final[dict[Role, str]] = {
    "position": "x pos position encoder distance travel displacement lateral scanlength target nominal "
    "axisposition weg strecke lage verfahrweg soll sollwert sollposition zielposition déplacement course abscisse cible "
    "posizione spostamento corsa distanza quota posición desplazamiento distancia recorrido carrera "
    "位置 位移 距离 行程 坐标 変位量 距離 移動量 座標 "
    "координата положение перемещение расстояние",
    "height": "z height deviation dev error err sensor cap straightness profile reading probe gap topography höhe "
    "abweichung abw fehler geradheit profil messwert taster spalt hauteur écart erreur rectitude lecture "
    "palpeur altezza scostamento errore rettilineità profilo lettura altura desviación rectitud "
    "perfil lectura palpador 高度 偏差 误差 直线度 轮廓 读数 高さ 誤差 真直度 形状 測定値 "
    "отклонение погрешность высота профиль показание",
    "time": "t time clock timestamp elapsed zeit zeitstempel uhrzeit datum temps heure date horodatage "
    "tempo ora data tiempo hora fecha 时间 時間 时刻 日期 時刻 日時 測定日時 "
    "время дата",
    "feed": "feed feedrate f speed velocity vorschub geschwindigkeit avance vitesse avanzamento "
    "velocità velocidad 进给 进给速度 速度 送り 送り速度 "
    "подача скорость",
    "run": "run pass cycle trace repeat repetition lauf messung zyklus wiederholung fahrt passe essai "
    "répétition prova ciclo passata ripetizione pasada ensayo repetición 次数 循环 序列 回 回数 サイクル "
    "проход цикл",
    "direction": "direction dir richtung sens verso sentido dirección 方向 направление",
    "angle": "angle theta phi rotation c winkel drehwinkel angolo ángulo 角度 回転角 угол",
    "temperature": "temp temperature temperatur température temperatura 温度 температура",
    "index": "no nr n n° num number # i k id idx index row line rec record obs seq count counter sample point "
    "lfdnr nummer zeile zähler datensatz punkt pkt messpunkt numéro ligne numero riga progressivo "
    "punto número núm fila línea 序号 编号 行号 行 点 番号 行番号 連番 項番 ナンバー номер п/п строка точка",
}
"""What columns are called in English, German, French, Italian, Spanish, Chinese, Japanese and Russian."""

_SPREADSHEET = frozenset(
    [
        "#n/a",
        "#na",
        "#nv",
        "#value!",
        "#wert!",
        "#div/0!",
        "#ref!",
        "#bezug!",
        "#num!",
        "#zahl!",
        "#name?",
        "#null!",
        "#valeur!",
        "#nom?",
        "#nombre!",
        "#nul!",
        "#n/d",
        "#valore!",
        "#rif!",
        "#nome?",
        "#nullo!",
        "#¡valor!",
        "#¡ref!",
        "#¿nombre?",
        "#¡num!",
        "#¡nulo!",
        "#¡div/0!",
        "#calc!",
        "#spill!",
        "#field!",
        "#blocked!",
        "#connect!",
        "#error!",
        "#getting_data",
        "#busy!",
    ]
) | {f"{word}:{n}" for word in ("err", "fehler", "erreur", "errore") for n in range(501, 541)}
"""What spreadsheets in five languages write into a cell without a value; Chinese and Japanese ones have the English."""

_ERROR_CELL = re.compile(
    rf"(?:{'|'.join(sorted(map(re.escape, _SPREADSHEET)))})(?=[\s;,|\"]|$)", re.IGNORECASE
)
_SIGN = r"#[¡¿]?[^\W\d_a-z][^\Wa-z]*[!?]"
_LIKE_ERROR = re.compile(rf'(?:{_SIGN}|##+)"?[;,|\t]"?[-+.\d]')
"""A cell with the error of another program or too narrow for its number, before a number: #STOP! alone is a remark."""
_ALONE = re.compile(_SIGN)


def is_error_cell(text: str) -> bool:
    """Return whether a row begins with a cell of a spreadsheet that shows no number, #N/A or ####, and no comment."""
    return _ERROR_CELL.match(text) is not None or _LIKE_ERROR.match(text) is not None


def may_be_error_cell(text: str) -> bool:
    """Return whether the whole of a field may be the error of another program, #VÄRDEFEL!, or a remark, #STOP!."""
    return _ALONE.fullmatch(text) is not None


MISSING: Final = (
    frozenset(
        [
            "nan",
            "-nan",
            "+nan",
            "nan(ind)",
            "-nan(ind)",
            "1.#qnan",
            "-1.#qnan",
            "1.#ind",
            "-1.#ind",
            "na",
            "n/a",
            "null",
            "none",
            "nil",
            "missing",
            "bad",
            "invalid",
            "void",
            "nodata",
            "(null)",
            "<na>",
            "nat",
            "n.a.",
            "n.d.",
            "n/d",
            "s/d",
            "k.a.",
            "ungültig",
            "fehlt",
            "invalide",
            "manquant",
            "mancante",
            "assente",
            "无",
            "缺失",
            "无效",
            "无数据",
            "欠測",
            "欠損",
            "無効",
            "なし",
        ]
    )
    | {"", "no data", "non valide", "non valido", "no válido", "sin dato", "sin datos", "k. a."}
    | _SPREADSHEET
    | {mark * n for mark in "-*" for n in range(1, 25)}
    | {mark * n for mark in "\u2013\u2014\u2015\uff0d\uff0a\ufe63\u2212" for n in range(1, 7)}
    | {f"{m * a}{p}{m * b}" for m in "-*" for p in ".," for a in range(1, 7) for b in range(1, 7)}
)
"""Words, in lower case, for "not measured"."""

BEYOND: Final = frozenset(
    {"out of range", "over range", "under range", "saturated"}
    | {s + w for s in ("", "+", "-") for w in ("inf", "infinity", "1.#inf", "\u221e")}
    | {
        s + w
        for s in ("", "+", "-")
        for w in ("over", "under", "overflow", "overrange", "overload", "ol", "o.l", "ovld")
    }
    | {"überlauf", "übersteuert", "hors gamme", "hors plage", "fuori scala", "fuori campo"}
    | {"fuera de rango", "超量程", "溢出", "オーバー", "範囲外"}
)
"""Words, in lower case, for a reading beyond the range of the sensor."""

NO_READING: Final = MISSING | BEYOND

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
