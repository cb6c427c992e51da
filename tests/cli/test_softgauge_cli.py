"""metrosep verify-softgauge: a damaged or empty reference proves nothing, and says so.

Files are written here without metrosep: a sine of 0.5 um over whole periods, Ra = 1/pi um and
Pq = 0.5/sqrt(2) um from the closed forms.
"""

import json

import numpy as np
import pytest

N = 8000
Z_UM = 0.5 * np.sin(2 * np.pi * np.arange(N) / 100 + 0.3)
FILTER = "PROFILE_FILTER Gaussian LC 0.8 mm"
RA = "PARAMETER_VALUE Ra 0.318 um 0"
PQ = "PARAMETER_VALUE Pq 0.354 um 0"


@pytest.fixture
def verify(metrosep, tmp_path):
    """Write a gauge, damage it after its checksum was made, and return (code, text, JSON)."""

    def call(lines, *options, old=b"", new=b"", checksum=None):
        head = [
            "ISO 5436 - 2000 test\0",
            "PRF\0 1 ISO5436\0",
            f"CX\0 I\0 {N} mm\0 1.0e0 D\0 1e-3",
            f"CZ\0 A\0 {N} um\0 1.0e0 D\0",
        ]
        records = ["\r\n".join(r) for r in (head, lines, [f"{v:.12e}" for v in Z_UM])]
        body = "".join(r + "\r\n\x03\r\n" for r in records).encode("ascii")
        total = sum(body) % 65536 if checksum is None else checksum
        assert old in body
        path = tmp_path / "gauge.smd"
        path.write_bytes(body.replace(old, new, 1) + f"{total}\r\n\x03\r\n\x1a".encode("ascii"))
        code, text, err = metrosep("verify-softgauge", path, *options)
        again, plain, _ = metrosep("verify-softgauge", path, *options, "--json")
        assert again == code
        return code, text + err, json.loads(plain) if plain else {}

    return call


def height(k):
    return f"{Z_UM[k]:.12e}\r\n".encode("ascii")


def test_a_sound_file_is_verified(verify):
    code, text, found = verify([FILTER, RA, PQ])

    assert code == 0
    assert "result verified, 2 of 2 agree" in text
    assert (found["result"], found["reasons"]) == ("verified", [])


@pytest.mark.parametrize(
    ("value", "result", "expected"), [(b"0.318", "verified", 0), (b"0.418", "differs", 1)]
)
def test_wrong_checksum_is_told_with_the_result(verify, value, result, expected):
    """Publishers sum in more than one way: agreement of every digit outweighs the sum."""
    code, text, found = verify([FILTER, RA], checksum=1, old=b"0.318", new=value)

    assert code == expected
    assert f"result {result}" in text
    assert any("the checksum 1 is wrong" in line for line in text.splitlines()[-2:])
    assert found["result"] == result
    assert any("the checksum 1 is wrong" in r for r in found["reasons"])


def test_missing_checksum_is_told_with_the_result(verify, metrosep, tmp_path):
    verify([FILTER, RA])
    path = tmp_path / "gauge.smd"
    data = path.read_bytes()
    path.write_bytes(data[: data.rindex(b"\x03", 0, data.rindex(b"\x03")) + 3])

    code, text, _ = metrosep("verify-softgauge", path)

    assert code == 0
    assert "the checksum is missing" in text


@pytest.mark.parametrize(
    "keyword",
    ["PARAMETR_VALUE", "PARAMETER VALUE", "PARAMETER-VALUE", "PARAMETER_VALUES", "parametervalue"],
)
@pytest.mark.parametrize("stale", [True, False])
def test_a_value_with_a_misspelt_keyword_is_told(verify, keyword, stale):
    if stale:
        new = f"{keyword} Ra".encode()
        code, text, found = verify([FILTER, RA, PQ], old=b"PARAMETER_VALUE Ra", new=new)
    else:
        code, text, found = verify([FILTER, RA.replace("PARAMETER_VALUE", keyword), PQ])

    assert code == 3
    assert f"'{keyword} Ra 0.318 um 0'" in text
    assert any(f"{keyword} Ra" in r and "PARAMETER_VALUE" in r for r in found["reasons"])
    assert any("checksum" in r for r in found["reasons"]) is stale


def test_a_difference_counts_beside_a_misspelt_line_of_a_sound_file(verify):
    code, _, found = verify(["PARAMETR_VALUE Pa 1 um", "PARAMETER_VALUE Pq 0.454 um 0"])

    assert code == 1
    assert found["result"] == "differs"
    assert "PARAMETR_VALUE" in found["reasons"][0]


def test_gaps_are_told_and_prove_nothing(verify):
    code, text, found = verify([PQ], old=height(4001), new=b"nan\r\n")

    assert code == 3
    assert f"1 of {N} heights" in text
    assert any("checksum" in r for r in found["reasons"])
    assert any(f"1 of {N} heights" in r for r in found["reasons"])


def test_gaps_of_a_file_whose_checksum_is_right_are_told_too(verify):
    old, new = height(4001), b"nan\r\n"
    stale = verify([PQ], old=old, new=new)[2]["reasons"]
    written = int(next(r for r in stale if "checksum" in r).split("checksum ")[1].split()[0])

    right = (written - sum(old) + sum(new)) % 65536
    code, _, found = verify([PQ], old=old, new=new, checksum=right)

    assert code == 3
    assert len(found["reasons"]) == 1
    assert "heights" in found["reasons"][0]


@pytest.mark.parametrize("unit", ["mm", "um", ""])
def test_placeholder_zero_is_not_compared(verify, unit):
    """The header example of the format; 0 mm would allow 500 um."""
    code, text, found = verify([FILTER, f"PARAMETER_VALUE Ra 0 {unit} 0"])

    assert code == 3
    assert "not compared" in text
    assert "placeholder" in text
    assert found["result"] == "not verified"
    assert found["rows"][0]["agrees"] is None
    assert "placeholder" in found["rows"][0]["reason"]
    assert "Ra" in found["reasons"][0]


def test_filter_lines_add_up(verify):
    code, text, _ = verify([FILTER, "PROFILE_FILTER Gaussian LS 2.5 um", RA])

    assert code == 0
    assert "agrees" in text


def test_contradictory_filter_lines_are_refused(verify):
    code, text, _ = verify([FILTER, "PROFILE_FILTER Gaussian LC 2.5 mm", RA])

    assert code == 2
    assert "LC 0.8 mm" in text
    assert "LC 2.5 mm" in text


def test_negative_uncertainty_does_not_widen_the_tolerance(verify):
    code, text, _ = verify([FILTER, "PARAMETER_VALUE Ra 0.328 um -0.02"])

    assert code == 2
    assert "negative" in text
    assert "Ra 0.328 um -0.02" in text
