"""The .dfq file, re-read by a strict reader that knows the format only, and by aqdefreader where it is.

The reader here is written from the description of the format: lines of K-fields, then lines of
values with 0x0F between characteristics and 0x14 between the fields of one.
"""

import re
from decimal import Decimal

import pytest

from metrosep.core.errors import DataError
from metrosep.core.units import parse_quantity
from metrosep.report.aqdef import render_dfq, write_dfq

DIGITS_15 = 5e-15  # relative: half of the last of 15 digits, at most
ROUNDING = 1e-12  # nm, of a division by 1e-9


def _document(*entries, **more):
    return {
        "schema": "metrosep.result/1",
        "title": "Ring",
        "characteristics": list(entries),
    } | more


def _entry(metric="Sq", value=66.5e-9, unit="m", **more):
    return {"metric": metric, "name": f"name of {metric}", "value": value, "unit": unit} | more


def _read(data):
    """Return (header, characteristics, value lines); refuse what is not of the format."""
    lines = data.decode("cp1252").split("\r\n")
    assert lines.pop() == ""
    header, characteristics, values = {}, {}, []
    for line in lines:
        field = re.fullmatch(r"(K\d{4})(?:/(\d+))? (.*\S.*)", line)
        if field and not values:
            code, index, text = field.groups()
            place = header if index is None else characteristics.setdefault(int(index), {})
            assert code not in place, f"{code} twice"
            place[code] = text
            continue
        assert field is None, "a field behind the values"
        values.append([cell.split("\x14") for cell in line.split("\x0f")])
    assert sorted(characteristics) == list(range(1, int(header["K0100"]) + 1))
    assert all(len(row) == int(header["K0100"]) for row in values)
    return header, characteristics, values


def test_a_result_reads_back():
    checked = _entry(upper=80e-9, U=4e-9, verdict="accept", definition="root mean square")
    data = render_dfq([_document(checked, _entry("tilt", 2e-6, "rad"), _entry("Ssk", -0.5, "1"))])

    header, found, ((first, second, third),) = _read(data)

    assert header["K1002"] == "Ring"
    assert found[1]["K2002"] == "name of Sq"
    assert found[1]["K2142"] == "nm"
    assert float(found[1]["K2111"]) == pytest.approx(80.0, abs=ROUNDING)
    assert "K2110" not in found[1]
    assert "U 4 nm" in found[1]["K2900"]
    assert float(first[0]) == pytest.approx(66.5, abs=ROUNDING)
    assert first[1] == "0"
    assert (second[0], found[2]["K2142"]) == ("2", "urad")
    assert (third[0], "K2142" in found[3]) == ("-0.5", False)


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_what_is_not_known_is_not_measured(value):
    _, _, values = _read(render_dfq([_document(_entry(value=value))]))

    assert values == [[["0", "256"]]]


@pytest.mark.parametrize("value", [1.5e-15, 3.3e-7, 0.1, -1e-30])
def test_numbers_have_no_exponent_and_15_digits(value):
    _, _, (((text, _),),) = _read(render_dfq([_document(_entry(value=value))]))

    assert re.fullmatch(r"-?\d+(\.\d+)?", text)
    assert abs(float(text) - value / 1e-9) <= DIGITS_15 * abs(value / 1e-9)


def test_the_unit_does_not_depend_on_the_value():
    for value in (1e-12, 1e-3):
        _, found, _ = _read(render_dfq([_document(_entry(value=value, upper=2e-6))]))
        assert found[1]["K2142"] == "um"
        assert float(found[1]["K2111"]) == pytest.approx(2.0, abs=ROUNDING)


def test_several_parts_are_lines_of_one_file():
    parts = [
        _document(_entry(value=v), unit={"groups": {"part": "ring", "serial": f"{i:03d}"}})
        for i, v in enumerate((1e-9, 2e-9, None))
    ]

    header, _, values = _read(render_dfq(parts))

    assert header["K1001"] == "ring"
    assert [row[0][0] for row in values] == ["1", "2", "0"]
    assert [row[0][4] for row in values] == ["#000", "#001", "#002"]


def test_parts_of_other_characteristics_are_refused():
    with pytest.raises(DataError, match="result 2"):
        render_dfq([_document(_entry()), _document(_entry(upper=1.0))])
    with pytest.raises(DataError, match="2 characteristics, not 1"):
        render_dfq([_document(_entry()), _document(_entry(), _entry("PV"))])


HOSTILE = ["a\nK0100 99", "\x0f\x14", "<script>", "ü" * 500, "量", "\ud800", " ", "e\u0301"]


@pytest.mark.parametrize("text", HOSTILE)
def test_names_cannot_make_fields(text):
    hostile = _entry(text) | {"name": text, "definition": text}
    groups = {"part": text, "serial": text}
    data = render_dfq([_document(hostile, title=text, unit={"groups": groups})])

    header, found, values = _read(data)

    assert header["K0100"] == "1"
    assert len(found[1]["K2002"]) <= 80
    assert len(values) == 1


@pytest.mark.parametrize("documents", [[], [{}], [{"characteristics": []}]])
def test_nothing_to_write_is_refused(documents):
    with pytest.raises(DataError):
        render_dfq(documents)


def test_the_bytes_are_the_same(document, tmp_path):
    assert write_dfq(document, tmp_path / "a.dfq").read_bytes() == render_dfq([document])


def test_another_reader_reads_it(document):
    """aqdefreader 1.3 (Apache-2); its search for the encoding is left out, since it fails on short files."""
    aqdefreader = pytest.importorskip("aqdefreader")
    lines = render_dfq([document]).decode("cp1252").splitlines()

    (part,) = aqdefreader.DfqFile(lines).get_parts()

    first = part.get_characteristic_by_index(1)
    entry = document["characteristics"][0]
    assert first.get_data("K2002") == entry["name"]
    assert first.get_last_measurement().value * 1e-6 == pytest.approx(entry["value"], abs=1e-20)
    assert part.get_characteristic_by_index(1).get_data("K2142") == "um"


@pytest.mark.parametrize("text", ["100", "120", "5", "0.1", "33.3", "-7", "1234.5", "0.30000001"])
def test_a_limit_is_written_as_the_person_wrote_it(text):
    limit = parse_quantity(f"{text} nm", dimension="length")
    near = {"lower": -1e-6, "upper": limit} if limit > 0 else {"lower": limit, "upper": 1e-6}

    _, found, (((value, _),),) = _read(render_dfq([_document(_entry(value=limit, **near, U=0.0))]))

    factor = {"pm": 1000, "nm": 1, "um": 1e-3}[found[1]["K2142"]]
    expected = format((Decimal(text) * Decimal(str(factor))).normalize(), "f")
    assert found[1]["K2111" if limit > 0 else "K2110"] == expected
    assert value == expected


def test_two_sections_have_two_names_that_are_those_of_every_part():
    def part(samples):
        what = f"height of the middle over the faces beside it, negative, of {samples} samples, section "
        own = [_entry("section.a.h", name=what + "a", definition=what + "a")]
        own += [_entry("section.b.h", name=what + "b", definition=what + "b") for _ in range(2)]
        own += [_entry("x", name="n" * 90 + end) for end in "pq"]
        return _document(*own)

    _, found, _ = _read(render_dfq([part(2400), part(2399)]))
    names = [found[i]["K2002"] for i in range(1, 6)]
    assert names[:3] == ["section.a.h", "section.b.h", "section.b.h (2)"]
    assert (names[3], names[4]) == ("n" * 80, "n" * 76 + " (2)")
