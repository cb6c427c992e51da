"""The ranking that the page draws: rows by falling RMS, sizes as typed, what is hidden apart."""

import numpy as np
import pytest

from metrosep.app.documents import Edit, Places
from metrosep.app.metrics_answers import ranking, term_words
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError
from metrosep.recipe.pipeline import CancelledError

HEAD = (
    'metrosep = 1\n[[step]]\nop = "rank"\nmachine = "fts_lathe"\nradius = "20 mm"\n'
    'form = "toric: Rb=265 mm, Rd=132.5 mm"\n'
)
ERRORS = (
    'errors = { Hzx = "0.001 deg", EXX = "1 um", EYX = "1 um", EZX = "1 um", EBX = "1 arcsec" }\n'
)
HALF_NM = 0.05e-9
"""Table 4.3 of papers.md is printed to 0.1 nm."""


def session_of(folder, text):
    path = folder / "rank.toml"
    path.write_text(text, "utf-8")
    session = Session(Places([folder]))
    session.open(str(path))
    return session


def ask(session, cancel=lambda: False):
    news = []
    header, arrays = ranking(session, {"k": "ranking"}, cancel, news.append)
    assert arrays == {}
    return header


@pytest.fixture
def session(tmp_path):
    return session_of(tmp_path, HEAD + ERRORS)


def test_rows_are_those_of_the_published_table(session):
    """papers.md 4.3, levelled: B0Z 82.3, EXX 33.0, EYX 19.0 nm; EZX is a piston."""
    found = ask(session)
    rows = {r["term"]: r for r in found["rows"]}

    assert [r["term"] for r in found["rows"]] == ["B0Z", "EXX", "EYX", "EBX"]
    for name, rms in (("B0Z", 82.3e-9), ("EXX", 33.0e-9), ("EYX", 19.0e-9)):
        assert rows[name]["rms"] == pytest.approx(rms, abs=HALF_NM)
    assert rows["EXX"]["words"] == "positioning of X"
    assert [(h["term"], h["why"].split(":")[0]) for h in found["hidden"]] == [
        ("EZX", "taken away by the alignment")
    ]


def test_sizes_come_back_as_typed_with_their_place_in_the_recipe(session):
    rows = {r["term"]: r for r in ask(session)["rows"]}

    assert rows["EBX"]["size"] == "1 arcsec"
    assert rows["B0Z"]["size"] == "0.001 deg"
    assert rows["B0Z"]["path"] == ["step", 0, "errors", "Hzx"]  # the name of the paper
    assert rows["EBX"]["magnitude"] == pytest.approx(np.pi / 648e3, abs=1e-15)


def test_shares_are_of_the_mean_square_and_add_up(session):
    found = ask(session)
    squares = np.array([r["rms"] for r in found["rows"]]) ** 2

    assert [r["share"] for r in found["rows"]] == pytest.approx(
        list(squares / squares.sum()), abs=1e-12
    )
    assert found["cumulative"] == pytest.approx(
        list(np.cumsum(squares) / squares.sum()), abs=1e-12
    )
    assert found["total"]["rms"] == pytest.approx(np.sqrt(squares.sum()), abs=1e-15)
    assert found["total"]["U"] is None


def test_total_has_the_uncertainty_that_a_check_states(tmp_path):
    check = '[[check]]\nmetric = "expected_sq"\nupper = "200 nm"\nU = "5 nm"\n'
    found = ask(session_of(tmp_path, HEAD + ERRORS + check))

    assert found["total"]["U"] == pytest.approx(5e-9, abs=1e-15)


def test_a_term_switched_off_is_ranked_no_more_and_comes_back(session):
    row = ask(session)["rows"][0]
    session.edit([Edit(tuple(row["path"]), row["stored"], "0 arcsec")])
    found = ask(session)

    assert [r["term"] for r in found["rows"]] == ["EXX", "EYX", "EBX"]
    assert ("B0Z", "size zero") in [(h["term"], h["why"]) for h in found["hidden"]]
    session.undo()
    assert ask(session)["rows"][0]["term"] == "B0Z"


def test_a_doubled_size_doubles_its_row(session):
    rows = {r["term"]: r for r in ask(session)["rows"]}
    session.edit([Edit(("step", 0, "errors", "EXX"), "1 um", "2 um")])
    again = {r["term"]: r for r in ask(session)["rows"]}

    assert again["EXX"]["rms"] == pytest.approx(2 * rows["EXX"]["rms"], abs=1e-18)
    assert again["EYX"]["rms"] == pytest.approx(rows["EYX"]["rms"], abs=1e-18)


def test_by_wavefront_a_mirror_counts_twice(session):
    """A piston of 1 um moves a reflected wave by 2 um, less the obliquity: 2.015 um, papers.md 4.4."""
    session.edit(
        [
            Edit(("step", 0, "response"), None, "wavefront"),
            Edit(("step", 0, "removed"), None, "none"),
        ]
    )
    found = ask(session)
    rows = {r["term"]: r for r in found["rows"]}

    assert found["response"] == "wavefront"
    assert rows["EZX"]["rms"] == pytest.approx(2.015e-6, abs=1e-9)


def test_common_sizes_have_no_own_place_until_they_are_edited(tmp_path):
    session = session_of(tmp_path, HEAD + 'all_angles = "1 arcsec"\n')
    row = next(r for r in ask(session)["rows"] if r["term"] == "B0Z")

    assert (row["size"], row["stored"]) == ("1 arcsec", None)
    session.edit([Edit(tuple(row["path"]), row["stored"], "2 arcsec")])
    again = next(r for r in ask(session)["rows"] if r["term"] == "B0Z")
    assert again["rms"] == pytest.approx(2 * row["rms"], abs=1e-18)


def test_nothing_visible_has_words_and_no_nan(tmp_path):
    found = ask(session_of(tmp_path, HEAD + 'errors = { EZX = "1 um" }\n'))

    assert found["rows"] == []
    assert found["left"] == []
    assert found["total"]["rms"] == 0.0
    assert found["hidden"][0]["share"] is None


def test_other_recipes_and_a_stop_are_refused(tmp_path, session):
    with pytest.raises(CancelledError):
        ask(session, cancel=lambda: True)
    with pytest.raises(DataError, match="no file is open"):
        ask(Session(Places([tmp_path])))


def test_a_map_has_no_ranking(tmp_path):
    import metrosep as ms

    ms.write(
        ms.Surface(np.outer(np.arange(8.0), np.arange(8.0)) * 1e-9, 1e-3, 1e-3), tmp_path / "m.x3p"
    )
    session = Session(Places([tmp_path]))
    session.open(str(tmp_path / "m.x3p"))
    with pytest.raises(DataError, match="of op rank only"):
        ask(session)


@pytest.mark.parametrize(
    ("term", "words"),
    [
        ("EZX", "straightness of X in Z"),
        ("EAX", "roll of X"),
        ("ECX", "rotation of X about Z"),
        ("EZC", "axial motion of C in Z"),
        ("EBC", "tilt of C about Y"),
        ("ECC", "positioning of C"),
        ("C0Y", "squareness of Y, angle about Z"),
        ("nonsense", ""),
    ],
)
def test_names_of_the_standard_in_words(term, words):
    assert term_words(term) == words
