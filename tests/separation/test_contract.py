"""The result of a separation: attributes, type-B terms, tables, refusals."""

import copy
import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.separation.contract import Separation, Unobservable, suppressed_harmonics


@pytest.fixture
def separation():
    return Separation(
        "example",
        {"artefact": [1e-9, np.nan, 3e-9], "machine": [5e-9, 6e-9], "zero": 7e-9},
        {"artefact": [3e-9, np.nan, 3e-9], "machine": [1e-9, 1e-9], "zero": 2e-9},
        {"artefact": "m", "machine": "m", "zero": "m"},
        {"x": [0.0, 0.1, 0.2], "carriage_x": [0.0, 0.1]},
        (
            Unobservable("artefact", "harmonic", (7, 9), "the probe angles add to zero there"),
            Unobservable("machine", "harmonic", (0, 7), "offset"),
            Unobservable("machine", "wavelength", (0.01,), "equal to the distance"),
        ),
    )


def test_parts_are_attributes_and_read_only(separation):
    assert separation.artefact[2] == 3e-9
    with pytest.raises(ValueError, match="read-only"):
        separation.artefact[0] = 1.0
    with pytest.raises(AttributeError, match="artefact, machine, zero"):
        _ = separation.spindle
    assert copy.deepcopy(separation).machine.tolist() == [5e-9, 6e-9]


def test_harmonics_that_are_hidden_are_listed_once(separation):
    assert separation.suppressed == [0, 7, 9]
    assert suppressed_harmonics(separation.null_space, "artefact") == [7, 9]
    text = str(separation.null_space[0])
    assert text.startswith("artefact: harmonics 7, 9 not observable")


def test_type_b_terms_add_in_quadrature_to_the_named_part(separation):
    more = separation.with_type_b({"form": 4e-9}, part="artefact").with_type_b(
        {"linearity": 12e-9}, part="artefact"
    )

    assert more.u["artefact"][0] == pytest.approx(13e-9, abs=1e-20)
    assert math.isnan(more.u["artefact"][1])
    assert more.u["machine"][0] == 1e-9
    assert more.audit["type_b"]["artefact"] == {"form / m": 4e-9, "linearity / m": 12e-9}
    assert separation.u["artefact"][0] == 3e-9


def test_wrong_terms_are_refused(separation):
    with pytest.raises(DataError, match="no part 'spindle'"):
        separation.with_type_b({"form": 1e-9}, part="spindle")
    for bad in (-1e-9, math.nan, math.inf):
        with pytest.raises(DataError, match="form"):
            separation.with_type_b({"form": bad})


def test_table_keeps_each_part_beside_its_coordinate(separation):
    frame = separation.to_frame()

    assert list(frame.columns) == [
        "x_m", "artefact_m", "u_artefact_m", "carriage_x_m", "machine_m", "u_machine_m",
    ]  # fmt: skip
    assert frame["machine_m"].tolist()[:2] == [5e-9, 6e-9]
    assert math.isnan(frame["machine_m"][2])
    assert frame["x_m"].tolist() == [0.0, 0.1, 0.2]


def test_maps_have_no_table_and_shapes_must_fit():
    maps = Separation(
        "m", {"a": np.ones((2, 3))}, {"a": np.ones((2, 3))}, {"a": "m"}, {"x": [0, 1, 2]}, ()
    )
    with pytest.raises(DataError, match="maps"):
        maps.to_frame()
    with pytest.raises(DataError, match="uncertainty"):
        Separation("m", {"a": [1.0, 2.0]}, {"a": [1.0]}, {"a": "m"}, {"x": [0, 1]}, ())
    with pytest.raises(DataError, match="needs an uncertainty and a unit"):
        Separation("m", {"a": [1.0, 2.0]}, {}, {"a": "m"}, {"x": [0, 1]}, ())


def test_a_document_that_is_none_is_refused():
    with pytest.raises(DataError, match="not a stored separation"):
        Separation.from_dict({"method": "donaldson"})
