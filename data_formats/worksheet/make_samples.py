"""Write the samples of workbooks with zipfile alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import sys
import zipfile
from pathlib import Path

MAIN = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
RELATIONS = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006/relationships"
X_MM = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
Z_UM = [1.25, -3.5, None, 7.0, 2.0, -0.5]
DATES = '<numFmts><numFmt numFmtId="164" formatCode="dd/mm/yyyy\\ hh:mm:ss.000"/></numFmts>'


def cell(place, value):
    """Return a cell: a text, a number, a number shown as a moment (a pair), or an error by its sign."""
    if value is None:
        return ""
    if isinstance(value, tuple):
        return f'<c r="{place}" s="1"><v>{value[0]!r}</v></c>'
    if isinstance(value, str) and value.startswith("#"):
        return f'<c r="{place}" t="e"><v>{value}</v></c>'
    if isinstance(value, str):
        return f'<c r="{place}" t="inlineStr"><is><t>{value}</t></is></c>'
    return f'<c r="{place}"><v>{value!r}</v></c>'


def workbook(**sheets):
    """Return a workbook; each sheet is a list of rows, a row a list of values."""
    members = {
        "[Content_Types].xml": "<Types/>",
        "xl/styles.xml": f'<styleSheet {MAIN}>{DATES}<cellXfs><xf numFmtId="0"/>'
        '<xf numFmtId="164"/></cellXfs></styleSheet>',
    }
    listed, related = [], []
    for k, (name, rows) in enumerate(sheets.items(), start=1):
        listed.append(f'<sheet name="{name}" sheetId="{k}" r:id="rId{k}"/>')
        related.append(
            f'<Relationship Id="rId{k}" Type="{RELATIONS}/worksheet" Target="worksheets/sheet{k}.xml"/>'
        )
        body = "".join(
            f'<row r="{n}">{"".join(cell(f"{chr(65 + c)}{n}", v) for c, v in enumerate(row))}</row>'
            for n, row in enumerate(rows, start=1)
        )
        members[f"xl/worksheets/sheet{k}.xml"] = (
            f"<worksheet {MAIN}><sheetData>{body}</sheetData></worksheet>"
        )
    members["xl/workbook.xml"] = (
        f'<workbook {MAIN} xmlns:r="{RELATIONS}"><sheets>{"".join(listed)}</sheets></workbook>'
    )
    members["xl/_rels/workbook.xml.rels"] = (
        f'<Relationships xmlns="{PACKAGE}">{"".join(related)}</Relationships>'
    )
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in members.items():
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system = 3
            info.compress_type = zipfile.ZIP_STORED  # deflate may differ between versions of zlib
            archive.writestr(info, text.encode())
    return stream.getvalue()


OFFICE = "urn:oasis:names:tc:opendocument:xmlns:{}:1.0"
SPACES = " ".join(f'xmlns:{n}="{OFFICE.format(n)}"' for n in ("office", "table", "text", "style"))
CALC = "urn:org:documentfoundation:names:experimental:calc:xmlns:calcext:1.0"
UNSHOWN = (
    '<style:style style:name="ta2" style:family="table"><style:table-properties table:display="false"/>'
    "</style:style>"
)


def open_cell(value):
    """Return a cell of OpenDocument: a text, a number, a moment (a pair), an error, or XML as it stands."""
    if value is None:
        return "<table:table-cell/>"
    if isinstance(value, tuple):
        kind, text = value
        return f'<table:table-cell office:value-type="{kind}" office:{kind}-value="{text}"/>'
    if isinstance(value, str) and value.startswith("<"):
        return value
    if isinstance(value, str) and value.startswith("#"):
        return (
            '<table:table-cell table:formula="of:=1/0" office:value-type="string" office:string-value="" '
            f'calcext:value-type="error"><text:p>{value}</text:p></table:table-cell>'
        )
    if isinstance(value, str):
        return f'<table:table-cell office:value-type="string"><text:p>{value}</text:p></table:table-cell>'
    shown = f"<text:p>{value:.1f}</text:p>"
    return f'<table:table-cell office:value-type="float" office:value="{value!r}">{shown}</table:table-cell>'


def open_document(hidden="", **sheets):
    """Return an OpenDocument workbook; each sheet is a list of rows, a row a list of values or XML."""
    tables = []
    for name, rows in sheets.items():
        own = (
            row
            if isinstance(row, str)
            else f"<table:table-row>{''.join(map(open_cell, row))}</table:table-row>"
            for row in rows
        )
        style = ' table:style-name="ta2"' if name == hidden else ""
        tables.append(f'<table:table table:name="{name}"{style}>{"".join(own)}</table:table>')
    content = (
        f'<office:document-content {SPACES} xmlns:calcext="{CALC}"><office:automatic-styles>{UNSHOWN}'
        f"</office:automatic-styles><office:body><office:spreadsheet>{''.join(tables)}</office:spreadsheet>"
        "</office:body></office:document-content>"
    )
    mimetype = "application/vnd.oasis.opendocument.spreadsheet"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, text in {"mimetype": mimetype, "content.xml": content}.items():
            info = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            info.create_system = 3
            archive.writestr(info, text.encode())
    return stream.getvalue()


TABLE = [["Straightness of X"], [], ["x [mm]", "z [um]"], *map(list, zip(X_MM, Z_UM, strict=True))]
FAULTS = [[*row[:-1], "#DIV/0!"] if row and row[-1] is None else row for row in TABLE]
TEXTS = [
    *TABLE[:3],
    *([x, str(z).replace(".", ",")] for x, z in zip(X_MM, [1.25, *X_MM[1:]], strict=True)),
]
CLOCK = [["time", "gap_nm"], *([(46086.5 + k / 172800.0,), 10.0 * k] for k in range(4))]
OTHER = [["no", "gauge"], [1, "A"]]
UNSOLVED = '<table:table-cell table:formula="of:=[.A5]*2"/>'
NOTE = (
    '<table:table-cell office:value-type="float" office:value="-3.5"><office:annotation><text:p>9.9</text:p>'
    "</office:annotation><text:p>-3,5</text:p></table:table-cell>"
)
EMPTY_ROWS = (
    '<table:table-row table:number-rows-repeated="1048000"><table:table-cell table:number-columns-repeated='
    '"16384"/></table:table-row>'
)
NOTED = [*TABLE[:4], [0.5, NOTE], *TABLE[5:], EMPTY_ROWS]
SAME = '<table:table-cell office:value-type="float" office:value="0.25" table:number-columns-repeated="2"/>'
STAMPS = [[("date", f"2026-03-05T12:00:0{k // 2}.{5 * (k % 2)}"), 10.0 * k] for k in range(4)]
SPANS = [[("time", f"PT26H00M0{k // 2}.{5 * (k % 2)}S"), 10.0 * k] for k in range(4)]
PROFILE = {
    "kind": "profile",
    "shape": [6],
    "x_m": [x * 1e-3 for x in X_MM],
    "z_m": [None if z is None else z * 1e-6 for z in Z_UM],
}
CASES = {
    "profile.xlsx": (workbook(Straightness=TABLE, Remarks=[["none"]]), PROFILE),
    "error-cell.xlsx": (workbook(Data=FAULTS), PROFILE),
    "texts.xlsx": (
        workbook(Data=TEXTS),
        {
            **PROFILE,
            "z_m": [v * 1e-6 for v in [1.25, *X_MM[1:]]],
            "warnings_match": "read with a decimal comma",
        },
    ),
    "clock.xlsx": (
        workbook(Data=CLOCK),
        {
            "kind": "recording",
            "t_s": [0.5 * k for k in range(4)],
            "channels": {"gap_nm": [k * 1e-8 for k in range(4)]},
        },
    ),
    "chosen.xlsx": (workbook(Gauges=OTHER, Data=TABLE), {**PROFILE, "options": {"sheet": "Data"}}),
    "two-sheets.xlsx": (
        workbook(Gauges=OTHER, Data=TABLE),
        {"error": "FormatMismatchError", "match": "'Data' (11 numbers); choose one with sheet="},
    ),
    "odd-cell.xlsx": (
        workbook(Data=[*TABLE[:5], [0.75, "broken"], *TABLE[5:]]),
        {"error": "CorruptFileError", "match": "odd-cell.xlsx, worksheet 'Data': column 'z [um]'"},
    ),
    "profile.ods": (open_document(Straightness=NOTED, Remarks=[["none"]]), PROFILE),
    "error-cell.ods": (open_document(Data=FAULTS), PROFILE),
    "repeated.ods": (
        open_document(Data=[*TABLE[:3], [SAME], *TABLE[4:]]),
        {**PROFILE, "x_m": [0.25e-3, *PROFILE["x_m"][1:]], "z_m": [0.25e-6, *PROFILE["z_m"][1:]]},
    ),
    "clock.ods": (
        open_document(Data=[["time", "gap_nm"], *STAMPS]),
        {
            "kind": "recording",
            "t_s": [0.5 * k for k in range(4)],
            "channels": {"gap_nm": [k * 1e-8 for k in range(4)]},
        },
    ),
    "elapsed.ods": (
        open_document(Data=[["time", "gap_nm"], *SPANS]),
        {
            "kind": "recording",
            "t_s": [0.5 * k for k in range(4)],
            "channels": {"gap_nm": [k * 1e-8 for k in range(4)]},
        },
    ),
    "hidden.ods": (
        open_document(hidden="Data", Gauges=OTHER, Data=TABLE),
        {
            "error": "FormatMismatchError",
            "match": "'Data' (11 numbers, hidden); choose one with sheet=",
        },
    ),
    "no-result.ods": (
        open_document(Data=[*TABLE[:4], [0.5, UNSOLVED], *TABLE[5:]]),
        {
            "error": "UnsupportedFeatureError",
            "match": "cell B5 holds a formula without its result",
        },
    ),
    "cut-off.xlsx": (
        workbook(Data=TABLE)[:-40],
        {"error": "CorruptFileError", "match": "is not a whole zip archive"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (data, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(data)
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
