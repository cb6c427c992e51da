"""Names: ISO 230-1 against the paper's swapped subscripts, term by term."""

from __future__ import annotations

import pytest

from metrosep.core.errors import DataError
from metrosep.machine.chains import presets
from metrosep.machine.elements import axis_of, from_paper, import_errors, paper_hint, to_paper

# Table 1 of the paper by hand: axis first, direction second; ISO: direction first, axis second.
TABLE_1 = {
    "delta_xx": "EXX", "delta_xy": "EYX", "delta_xz": "EZX",
    "epsilon_xx": "EAX", "epsilon_xy": "EBX", "epsilon_xz": "ECX",
    "delta_zx": "EXZ", "delta_zy": "EYZ", "delta_zz": "EZZ",
    "epsilon_zx": "EAZ", "epsilon_zy": "EBZ", "epsilon_zz": "ECZ",
    "delta_cx": "EXC", "delta_cy": "EYC", "delta_cz": "EZC",
    "epsilon_cx": "EAC", "epsilon_cy": "EBC", "epsilon_cz": "ECC",
    "delta_fx": "EXFTS", "delta_fy": "EYFTS", "delta_fz": "EZFTS",
    "epsilon_fx": "EAFTS", "epsilon_fy": "EBFTS", "epsilon_fz": "ECFTS",
    "eta_zx": "B0Z",
}  # fmt: skip

SHORT = {
    "dxx": "EXX", "dxy": "EYX", "dxz": "EZX", "exx": "EAX", "exy": "EBX", "exz": "ECX",
    "dcx": "EXC", "dcy": "EYC", "dcz": "EZC", "ecx": "EAC", "ecy": "EBC", "ecz": "ECC",
    "dfx": "EXFTS", "dfy": "EYFTS", "dfz": "EZFTS", "efx": "EAFTS", "efy": "EBFTS", "efz": "ECFTS",
    "dzx": "EXZ", "dzy": "EYZ", "dzz": "EZZ", "ezx": "EAZ", "ezy": "EBZ", "ezz": "ECZ",
    "Hzx": "B0Z", "H_zx": "B0Z", "hzx": "B0Z", "eta_{zx}": "B0Z",
    "eps_xy": "EBX", "epsxy": "EBX", "delta_{xy}": "EYX",
    "\u03b4xy": "EYX", "\u03b5cx": "EAC", "\u03b7zx": "B0Z", "\u03b5_{fz}": "ECFTS",
    "\u03f5_xy": "EBX", "\u03f5cx": "EAC",
}  # fmt: skip


@pytest.mark.parametrize(("paper", "iso"), TABLE_1.items())
def test_table_1_both_ways(paper, iso):
    assert from_paper(paper) == iso
    assert to_paper(iso) == paper


@pytest.mark.parametrize(("paper", "iso"), SHORT.items())
def test_spellings(paper, iso):
    assert from_paper(paper) == iso


def test_table_1_is_the_lathe():
    assert sorted(TABLE_1.values()) == sorted(presets("fts_lathe", radius=0.02).terms)


def test_the_swap_is_not_the_identity():
    # delta_xz is the straightness of X in Z; read as ISO it would be that of Z in X.
    assert from_paper("delta_xz") == "EZX"
    assert from_paper("delta_zx") == "EXZ"


def test_imported_errors_act_as_in_eq_11():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": 0.0, "X": 0.005, "FTS": 1e-3}
    error = chain.volumetric_error(q, import_errors({"dxz": 1e-6, "Hzx": 1e-4}))
    assert error[2] == pytest.approx(1e-6 - 1e-4 * 0.005, abs=1e-18)


@pytest.mark.parametrize("name", ["dx", "dyy", "EXX", "exq", "delta_x", "Hxz", "", "delta_ax"])
def test_names_that_the_paper_does_not_have(name):
    with pytest.raises(DataError, match="eta_zx"):
        from_paper(name)


@pytest.mark.parametrize("name", ["EXY", "C0Y", "dxx", "EX", "exx"])
def test_terms_that_the_paper_does_not_have(name):
    with pytest.raises(DataError, match="the paper has no term"):
        to_paper(name)


def test_two_spellings_of_one_term():
    with pytest.raises(DataError, match=r"'delta_xy' is EYX, which stands"):
        import_errors({"dxy": 1e-6, "delta_xy": 2e-6})


@pytest.mark.parametrize(
    ("term", "axis"),
    [("EXX", "X"), ("ECC", "C"), ("EXFTS", "FTS"), ("EBX1", "X1"), ("B0Z", None), ("EX0C", None)],
)
def test_axis_of_a_term(term, axis):
    assert axis_of(term) == axis


@pytest.mark.parametrize("term", ["XX", "EQX", "E", "EX", "B0", "EX 1"])
def test_names_that_are_no_terms(term):
    with pytest.raises(DataError, match="ISO 230-1"):
        axis_of(term)


def test_hint_for_a_name_of_the_paper():
    assert "EYX" in paper_hint("dxy")
    assert paper_hint("nonsense") == ""
