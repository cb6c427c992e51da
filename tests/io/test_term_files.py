"""Files of identified terms: what stands in them is read by plain splitting."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.io.term_files import read_term_table, term_texts
from metrosep.machine.terms import TableTerm

UM, URAD = 1e-6, 1e-6
KINDS = {"X": "length", "C": "angle"}


def test_uncertainties_are_written_beside_their_terms_and_come_back(tmp_path):
    place = [0.0, 0.1, 0.3]
    terms = {
        "EYX": TableTerm(place, [0.0, 2 * UM, -1 * UM], [0.1 * UM, 0.2 * UM, 0.4 * UM]),
        "EBX": TableTerm(place, [0.0, 3 * URAD, 5 * URAD]),  # nobody stated its u
        "EAX": TableTerm(place, [0.0, 1 * URAD, 1 * URAD], 0.5 * URAD),
    }
    (text,) = term_texts(terms, dict.fromkeys(terms, (0.0, 0.3)), set()).values()

    head, *rows = text.splitlines()
    table = dict(
        zip(head.split(","), np.array([r.split(",") for r in rows], float).T, strict=True)
    )
    x = table.pop("x_mm")
    assert set(table) == {"EYX_um", "EBX_urad", "EAX_urad", "u_EYX_um", "u_EAX_urad"}
    assert np.abs(table["u_EYX_um"] - np.interp(x, [0, 100, 300], [0.1, 0.2, 0.4])).max() < 1e-8
    assert np.abs(table["u_EAX_urad"] - 0.5).max() < 1e-8

    (tmp_path / "X.csv").write_text(text)
    back = read_term_table(tmp_path / "X.csv", KINDS)
    assert set(back) == set(terms)
    for name, (term, span) in back.items():
        assert span == pytest.approx((0.0, 0.3), abs=1e-12)
        for at in (0.0, 0.05, 0.2, 0.3):
            assert term.evaluate(at) == pytest.approx(terms[name].evaluate(at), abs=1e-14)
            assert term.sd(at) == pytest.approx(terms[name].sd(at), abs=1e-14)


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ("x_mm,EXX_um,u_EYX_um\n0,1,1\n1,1,1\n", DataError, "uncertainty of a term that is not there"),
        ("x_mm,EXX_um,u_EXX_um,u_EXX_um\n0,1,1,1\n1,1,1,1\n", DataError, "there twice"),
        ("x_mm,EXX_um,u_EXX_um\n0,1,-1\n1,1,1\n", InvalidSamplesError, "u must be"),
        ("x_mm,EXX_um,u_EXC_urad\n0,1,1\n1,1,1\n", DataError, "is not an error of X"),
    ],
)  # fmt: skip
def test_uncertainties_that_belong_to_nothing_are_refused(tmp_path, text, error, said):
    (tmp_path / "X.csv").write_text(text)
    with pytest.raises(error, match=said):
        read_term_table(tmp_path / "X.csv", KINDS)
