"""The page and the workbook of a batch: what they say, what they link, and hostile input."""

import base64
import copy
import hashlib
import io
import json
import re
from html.parser import HTMLParser

import openpyxl
import pytest

from metrosep.core.errors import DataError
from metrosep.report.index import link_of, render_index, series_of, spark_points, write_index
from metrosep.report.workbook import render_index_workbook, write_index_workbook

HOSTILE = "<script>alert('x')</script>\n\"=1+1\" ü 量 " + "x" * 500
STATUSES = ("accepted", "rejected", "inconclusive", "measured", "failed", "refused")
WORDS = ("✓ ACCEPT", "✗ REJECT", "? INCONCLUSIVE", "– NO VERDICT", "! FAILED", "∅ NOT BEGUN")


class _Page(HTMLParser):
    """Tags, attributes, and the cells of each table."""

    def __init__(self, text):
        super().__init__()
        self.open, self.attributes, self.tables, self.scripts = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, *a) for a in attrs]
        if tag not in ("meta", "img", "polyline", "circle"):
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_startendtag(self, tag, attrs):
        self.attributes += [(tag, *a) for a in attrs]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)
        elif "td" in self.open or "th" in self.open:
            self.tables[-1][-1][-1] += data


def _row(i, status="accepted", value=6e-9, **more):
    entry = {"metric": "Sq", "name": "Sq", "unit": "m", "value": value, "U": 1e-10}
    entry |= {"lower": 4e-9, "upper": 8e-9, "verdict": None}
    return {
        "unit": f"ring_{i:03d}.datx",
        "groups": {"part": "ring", "serial": f"{i:03d}"},
        "status": status,
        "verdict": None,
        "reason": None,
        "link": f"ring_{i:03d}/ab/result.json",
        "characteristics": [] if status in ("failed", "refused") else [entry],
        "hash": f"{i:064x}",
    } | more


def _index(rows, **more):
    return {
        "schema": "metrosep.index/1",
        "metrosep": "0.1.0",
        "title": "Lot 12",
        "groups": ["part", "serial"],
        "trend": [],
        "rows": rows,
        "recipe": {"name": "r.toml", "text": "metrosep = 1\n", "sha256": "cd" * 32},
    } | more


@pytest.fixture(scope="module")
def batch():
    """Thirty parts, two failed, one rejected; values 5 to 7 nm in turns."""
    rows = [_row(i, value=(5e-9, 7e-9)[i % 2]) for i in range(30)]
    for i in (3, 20):
        rows[i] = _row(i, "failed", reason="it ends after 512 of 4096 bytes", link="f/failed.json")
    rows[5] = _row(5, "rejected", value=9e-9, reason="Sq: reject")
    return _index(rows)


@pytest.fixture(scope="module")
def page(batch):
    return render_index(batch)


def _table(text, title):
    """Cells of the table under a heading."""
    part = text[text.index(f"<h2>{title}</h2>") :]
    (first, *_) = _Page("<table>" + part.split("<table", 1)[1].split(">", 1)[1].split("</table>")[0]
                        + "</table>").tables  # fmt: skip
    return first


def test_counts_have_icon_word_and_colour():
    text = render_index(_index([_row(i, s) for i, s in enumerate(STATUSES)]))

    counts = text[text.index('<ul class="counts">') : text.index("</ul>")]
    plain = re.sub(r"<[^>]+>", "", counts)
    assert all(word in plain for word in WORDS)
    assert len(set(re.findall(r"background:(#\w+)", counts))) == len(WORDS)


def test_failures_come_first_with_their_reasons(page):
    assert page.index("<h2>Failed</h2>") < page.index("<h2>Not accepted, worst first</h2>")
    assert page.index("<h2>Not accepted, worst first</h2>") < page.index(
        "<h2>Characteristics over the batch</h2>"
    )
    failed = _table(page, "Failed")
    assert [r[0] for r in failed[1:]] == ["ring_003.datx", "ring_020.datx"]
    assert failed[1][2] == "it ends after 512 of 4096 bytes"
    assert _table(page, "Not accepted, worst first")[1][2] == "Sq: reject"


def test_every_unit_has_a_row_with_its_value(page, batch):
    cells = _table(page, "All units")

    assert cells[0] == ["unit", "part", "serial", "status", "Sq, nm", "hash", "files"]
    assert len(cells) == 1 + len(batch["rows"])
    assert cells[1][:5] == ["ring_000.datx", "ring", "000", "✓ ACCEPT", "5.00"]
    assert cells[4][4] == "–"


def test_capability_is_printed_with_its_interval(page, batch):
    values = [
        r["characteristics"][0]["value"] * 1e9 for r in batch["rows"] if r["characteristics"]
    ]
    mean = sum(values) / len(values)
    sd = (sum((v - mean) ** 2 for v in values) / (len(values) - 1)) ** 0.5

    row = dict(zip(*_table(page, "Characteristics over the batch")[:2], strict=True))

    assert row["Cp (95 %)"].startswith(f"{4.0 / (6.0 * sd):.2f} (")
    assert row["Cpk (95 %)"].startswith(f"{min(8.0 - mean, mean - 4.0) / (3.0 * sd):.2f} (")
    assert row["limits"] == "4 … 8"
    assert row["values"] == "28"


@pytest.mark.parametrize("change", ["few", "no limits", "other limits", "crossed"])
def test_no_index_where_it_would_mean_nothing(batch, change):
    document = copy.deepcopy(batch)
    entries = [c for r in document["rows"] for c in r["characteristics"]]
    if change == "few":
        document["rows"] = document["rows"][:21]
    elif change == "no limits":
        [e.update(lower=None, upper=None) for e in entries]
    elif change == "other limits":
        entries[0]["upper"] = 7e-9
    else:
        [e.update(lower=8e-9, upper=4e-9) for e in entries]

    (series,) = series_of(document)

    assert series.capability is None
    text = _table(render_index(document), "Characteristics over the batch")
    assert [row[8:10] for row in text[1:]] == [["–", "–"]]


def test_units_of_a_characteristic_are_the_same_in_all_rows():
    (series,) = series_of(_index([_row(0, value=1e-12), _row(1, value=1e-3)]))

    assert series.unit == "nm"
    assert series.values == pytest.approx((1e-3, 1e6), abs=1e-9)


def test_nothing_is_fetched_and_the_only_script_is_the_one_of_the_policy(page):
    found = _Page(page)

    (script,) = found.scripts
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = next(v for t, n, v in found.attributes if n == "content" and "default-src" in v)
    assert f"script-src 'sha256-{digest}'" in policy
    assert "default-src 'none'" in policy
    for tag, name, value in found.attributes:
        assert not name.startswith("on")
        if name == "src":
            assert value.startswith("data:image/svg+xml;base64,")
        if name == "href":
            assert (tag, value.split("/")[0][:4]) in (("a", "ring"), ("a", "f"))
    assert "http" not in re.sub(r'src="[^"]*"', "", page).replace("http-equiv", "")


def test_reports_beside_the_results_are_linked(batch, tmp_path):
    (tmp_path / "ring_000" / "ab").mkdir(parents=True)
    (tmp_path / "ring_000" / "ab" / "report.html").write_text("x", encoding="utf-8")

    text = write_index(batch, tmp_path / "index.html").read_text("utf-8")

    assert 'href="ring_000/ab/report.html"' in text
    assert text.count("report.html") == 1


@pytest.mark.parametrize(
    ("link", "wanted"),
    [
        ("a b/ü.json", "a%20b/%C3%BC.json"),
        ("javascript:alert(1)", "javascript%3Aalert%281%29"),
        ("../x", None),
        ("a/../../x", None),
        ("a\\..\\x", None),
        ("/etc/passwd", None),
        ("", None),
        (None, None),
        (7, None),
    ],
)
def test_links_stay_below_the_folder(link, wanted):
    assert link_of(link) == wanted


def test_trends_have_control_limits_and_say_what_is_beyond(page):
    assert "Beyond the control limits (squares):" in page
    assert "Without a value: 2; they leave gaps." in page
    assert page.count("<figure>") == 1


def test_a_sparkline_leaves_gaps_and_has_large_values_on_top():
    (first, second) = spark_points([0.0, 1.0, None, 2.0])

    assert [x for x, _ in first] == [0.0, 33.33]
    assert first[0][1] > first[1][1] > second[0][1]


def test_hostile_names_stay_texts(batch):
    document = copy.deepcopy(batch)
    document |= {"title": HOSTILE, "groups": [HOSTILE], "trend": [HOSTILE]}
    document["recipe"] = {"name": HOSTILE, "text": HOSTILE, "sha256": HOSTILE}
    row = document["rows"][3]
    row |= {"unit": HOSTILE, "reason": HOSTILE, "link": HOSTILE, "groups": {HOSTILE: HOSTILE}}
    document["rows"][0]["characteristics"][0] |= {"metric": HOSTILE, "name": HOSTILE}

    found = _Page(render_index(document))
    book = openpyxl.load_workbook(io.BytesIO(render_index_workbook(document)))

    assert len(found.scripts) == 1
    assert any("<script>" in cell for table in found.tables for row in table for cell in row)
    assert all(c.data_type != "f" for s in book for r in s.iter_rows() for c in r)


@pytest.mark.parametrize("render", [render_index, render_index_workbook])
@pytest.mark.parametrize(
    "bad",
    [
        {},
        [],
        None,
        {"schema": "metrosep.result/1"},
        _index(["row"]),
        _index("rows"),
        _index([_row(0, "perhaps")]),
        _index([_row(0, characteristics=["x"])]),
        _index([_row(0, characteristics=[{"verdict": "perhaps"}])]),
        _index([_row(0, characteristics=[{"value": "1"}])]),
    ],
)
def test_what_is_no_index_is_refused(render, bad):
    with pytest.raises(DataError):
        render(bad)


@pytest.mark.parametrize(
    "document",
    [
        {"schema": "metrosep.index/1"},
        _index([]),
        _index([{"status": "failed"}]),
        _index([_row(0, value=None), _row(1, value=float("nan"))]),
        _index([_row(i, value=6e-9) for i in range(30)]),
    ],
    ids=["bare", "empty", "poor row", "no values", "no scatter"],
)
def test_missing_parts_are_left_out(document):
    assert "nan" not in _Page(render_index(document)).tables[-1][-1]
    assert render_index_workbook(document).startswith(b"PK")


def test_the_bytes_are_the_same(batch, page, tmp_path):
    again = json.loads(json.dumps(batch))

    assert render_index(again) == page
    assert write_index_workbook(batch, tmp_path / "i.xlsx").read_bytes() == render_index_workbook(
        again
    )


def test_the_workbook_holds_numbers_and_capability(batch):
    book = openpyxl.load_workbook(io.BytesIO(render_index_workbook(batch)))

    units = list(book["Units"].iter_rows(values_only=True))
    assert units[0] == ("unit", "part", "serial", "status", "reason", "Sq / nm", "hash", "result")
    assert units[1][5] == pytest.approx(5.0, abs=1e-9)
    assert units[4][3:6] == ("! FAILED", "it ends after 512 of 4096 bytes", None)
    row = dict(zip(*list(book["Capability"].iter_rows(values_only=True))[:2], strict=True))
    assert row["values"] == 28
    assert row["Cpk from (95 %)"] < row["Cpk"] < row["Cpk to (95 %)"]


@pytest.mark.slow
def test_a_thousand_units_are_one_page():
    rows = [_row(i, value=6e-9 + 1e-9 * ((i * 37) % 100) / 100) for i in range(1000)]

    assert len(_table(render_index(_index(rows)), "All units")) == 1001


def test_two_checks_of_one_metric_stay_two():
    rows = []
    for i in range(25):
        row = _row(i)
        (entry,) = row["characteristics"]
        low = {**entry, "upper": None, "verdict": "accept"}
        high = {**entry, "lower": None, "verdict": "reject"}
        rows.append({**row, "characteristics": [low, high]})
    index = _index(rows, trend=["Sq"])
    series = series_of(index)
    assert [(s.lower, s.upper, s.verdicts[0], s.trend) for s in series] == [
        (4.0, None, "accept", True),
        (None, 8.0, "reject", True),
    ]
    page = render_index(index)
    assert "≥ 4" in page
    assert "≤ 8" in page
    assert "Sq (2)" in page
    book = openpyxl.load_workbook(io.BytesIO(render_index_workbook(index)))
    heads = [c.value for c in book["Units"][1]]
    assert "Sq / nm" in heads
    assert "Sq (2) / nm" in heads
