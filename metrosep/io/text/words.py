"""Words of tables in seven languages and Russian: what columns are called, and what is no reading."""

from __future__ import annotations

import re
from typing import Final, Literal, TypeAlias

__all__ = [
    "BEYOND",
    "MISSING",
    "NO_READING",
    "ROLE_WORDS",
    "Role",
    "is_error_cell",
    "may_be_error_cell",
]

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
