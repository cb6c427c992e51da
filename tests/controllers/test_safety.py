"""The checks before a file: each refuses on a planted case, and is waived only by its name."""

import dataclasses
import json

import numpy as np
import pytest

from metrosep import Profile, controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers import registry
from metrosep.controllers.base import Dialect, DialectInfo, Encoded, identity
from metrosep.controllers.neutral import Neutral
from metrosep.controllers.safety import CHECKS
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignNotConfirmedError,
    TableError,
    WriteError,
)


def write(table, path, **options):
    return controllers.write(table, path, "csv", **options)


def test_travel_beyond_the_table_is_refused_with_what_happens_there(tmp_path, table):
    with pytest.raises(
        LimitError,
        match=r"cover 0 \.\.\. 50 mm, the travel is 0 \.\.\. 60 mm.*constant.*waive",
    ):
        write(table, tmp_path / "x.csv", travel_low="0 mm", travel_high="60 mm")
    assert list(tmp_path.iterdir()) == []


def test_a_waived_check_is_recorded(tmp_path, table):
    path = tmp_path / "x.csv"

    write(table, path, travel_high=60e-3, waive=("coverage",))

    sidecar = json.loads((tmp_path / "x.csv.json").read_text())
    assert sidecar["waived"] == ["coverage"]
    waived = [f for f in sidecar["findings"] if f["check"] == "coverage"]
    assert waived[0]["waived"] is True
    assert waived[0]["level"] == "error"


def test_another_name_does_not_waive(tmp_path, table):
    with pytest.raises(LimitError, match=r"cover 0 \.\.\. 50 mm"):
        write(table, tmp_path / "x.csv", travel_high=60e-3, waive=("stroke",))
    with pytest.raises(DataError, match=r"waive='everything' is not a check; there are dry-run"):
        write(table, tmp_path / "x.csv", travel_high=60e-3, waive=("everything",))


def test_software_limits_keep_the_stroke_as_a_margin(tmp_path, table):
    # stroke 3.7 um with lost motion; a margin of 3 um is not enough, one of 4 um is
    assert 3e-6 < table.stroke < 4e-6
    with pytest.raises(LimitError, match="software limits"):
        write(table, tmp_path / "x.csv", soft_high=50e-3 + 3e-6)
    write(table, tmp_path / "x.csv", soft_high=50e-3 + 4e-6, soft_low=-4e-6)


def test_noise_is_not_written(tmp_path, table):
    noisy = dataclasses.replace(table, u=np.full(table.positions.size, 2e-6))

    with pytest.raises(LimitError, match=r"101 of 101 entries.*this is noise"):
        write(noisy, tmp_path / "x.csv")
    write(noisy, tmp_path / "x.csv", waive="uncertainty")


def test_a_correction_at_the_reference_is_told(tmp_path, table):
    shifted = dataclasses.replace(table, forward=table.forward + 1e-6, source=None)

    write(shifted, tmp_path / "x.csv", allow_unverified=True)

    findings = json.loads((tmp_path / "x.csv.json").read_text())["findings"]
    assert any("the zero of the machine moves" in f["problem"] for f in findings)


def test_a_second_iteration_does_not_replace_the_first(tmp_path, table):
    path = tmp_path / "x.csv"
    write(table, path)
    second = dataclasses.replace(table, source_sha256=("cd" * 32,))

    with pytest.raises(LimitError, match=r"made of other readings.*active='none'"):
        write(second, path, overwrite=True)
    write(table, path, overwrite=True)  # the same readings: the same table, perhaps finer
    write(second, path, overwrite=True, waive=("active",))


class Coarse(Dialect):
    """Whole micrometres."""

    info = DialectInfo(
        id="coarse", title="test", entry="-e", units="um", outside="constant", sign_status="by definition",
    )  # fmt: skip
    STEP = 1e-6

    def encode(self, table, **options):
        rounded = np.round(table.forward / self.STEP)
        text = "".join(
            f"{p:.17g} {c:.0f}\n" for p, c in zip(table.positions, rounded, strict=True)
        )
        return Encoded(text.encode(), 0.5 * self.STEP, step=self.STEP)

    def decode(self, data, path, **options):
        rows = np.array([[float(v) for v in line.split()] for line in data.decode().splitlines()])
        return CompensationTable(
            rows[:, 0], rows[:, 1] * self.STEP, None, **identity(path, first=rows[0, 0])
        )


class Unknown(Neutral):
    info = dataclasses.replace(Neutral.info, id="unknown", sign="unconfirmed")


class Inverted(Neutral):
    """A bug: what is encoded is not what is read back."""

    def decode(self, data, path, **options):
        return super().decode(data, path, **options).negated()


@pytest.fixture
def plant(monkeypatch):
    def put(name, cls):
        monkeypatch.setitem(registry._places(), name, ("x", "X"))
        found = registry.find
        monkeypatch.setattr(
            "metrosep.controllers.files.find", lambda n: cls() if n == name else found(n)
        )

    return put


@pytest.fixture
def one_way(measured):
    return CompensationTable.from_error(measured, positions=101, axis="X", source_sha256=("ab",))


def test_coarse_steps_are_refused(tmp_path, one_way, plant):
    plant("coarse", Coarse)

    # the corrections span 4 um: a tenth is 0.4 um
    with pytest.raises(
        LimitError, match=r"steps of 1 um, the corrections span 4 um.*waive='quant"
    ):
        controllers.write(one_way, tmp_path / "x", "coarse")
    controllers.write(one_way, tmp_path / "x", "coarse", waive=("quantisation",))


def test_an_unconfirmed_sign_is_not_written(tmp_path, one_way, plant):
    plant("unknown", Unknown)

    with pytest.raises(SignNotConfirmedError, match=r"a trial with one bump.*sign_confirmed=True"):
        controllers.write(one_way, tmp_path / "x", "unknown")
    assert list(tmp_path.iterdir()) == []
    controllers.write(one_way, tmp_path / "x", "unknown", sign_confirmed=True)
    assert json.loads((tmp_path / "x.json").read_text())["sign_confirmed_by_user"] is True


def test_bytes_that_read_back_as_another_table_never_appear(tmp_path, one_way, plant):
    plant("inverted", Inverted)

    with pytest.raises(TableError, match="does not read back"):
        controllers.write(one_way, tmp_path / "x", "inverted", allow_unverified=True)
    assert list(tmp_path.iterdir()) == []


def test_a_controller_says_what_it_holds(tmp_path, measured):
    with pytest.raises(TableError, match=r"csv holds a CompensationTable.*not Profile"):
        write(measured, tmp_path / "x.csv")


def test_an_edited_file_is_not_read(tmp_path, table):
    path = tmp_path / "x.csv"
    write(table, path)
    path.write_bytes(path.read_bytes().replace(b"3", b"4", 1))

    with pytest.raises(CorruptFileError, match=r"not the table that its sidecar describes"):
        controllers.read(path, "csv")
    with pytest.raises(CorruptFileError, match=r"not the table that its sidecar describes"):
        controllers.simulate(path, "csv")


def test_an_existing_file_stays(tmp_path, table):
    path = tmp_path / "x.csv"
    path.write_text("in use")

    with pytest.raises(WriteError, match="a machine may be using it"):
        write(table, path)
    assert path.read_text() == "in use"


def test_a_mirrored_measurement_is_refused_by_every_check_name(tmp_path, table, bump):
    """No waiver turns off the dry-run where measured runs are given."""
    x = np.linspace(0.0, 50e-3, 2001)
    mirrored = Profile(x, bump(50e-3 - x))

    with pytest.raises(TableError, match="does not shrink"):
        write(table, tmp_path / "x.csv", verified_against=mirrored, waive=tuple(CHECKS))


def test_a_polynomial_covers_the_travel_too(tmp_path):
    from metrosep.compensation import fit_polynomial

    x = np.linspace(0.0, 50e-3, 101)
    error = Profile(x, 4e-6 * (x / 50e-3) ** 2)
    fit = fit_polynomial(error, degree=2, quantity="compensation")

    with pytest.raises(LimitError, match=r"cover 0 \.\.\. 50 mm, the travel"):
        controllers.write(
            fit,
            tmp_path / "x.st",
            "plc-st",
            verified_against=error,
            travel_high="60 mm",
            actuator_sign=1,
        )
    controllers.write(
        fit,
        tmp_path / "x.st",
        "plc-st",
        verified_against=error,
        travel_high=50e-3,
        actuator_sign=1,
    )


def test_a_limit_of_one_axis_is_refused_for_a_map(tmp_path):
    from metrosep.compensation import CompensationMap

    x = np.linspace(0.0, 50e-3, 6)
    bed = CompensationMap.from_error(lambda x, y: 1e-4 * (x + y), x=x, y=x)

    with pytest.raises(DataError, match=r"travel_low is of one axis.*measure the map over both"):
        controllers.write(bed, tmp_path / "x.csv", "csv-map", travel_low=0.0)


def test_limits_hold_for_what_is_written_not_for_what_was_given(tmp_path):
    """Subtracting a corner or surrounding a map by zeros makes corrections larger and steeper."""
    from metrosep.compensation import CompensationMap

    x = np.linspace(0.0, 50e-3, 11)
    bed = CompensationMap.from_error(
        lambda x, y: 1e-4 * (x - 25e-3) + 0.0 * y, x=x, y=x, reference=(25e-3, 25e-3)
    )
    machine = {"row_axis": 2, "column_axis": 1, "corrected_axis": 4}
    signs = {"row_sign": 1, "column_sign": 1, "corrected_sign": 1}
    assert bed.stroke == pytest.approx(2.5e-6, abs=1e-12)

    controllers.write(bed, tmp_path / "a.cal", "aerotech", stroke="3 um", **machine, **signs)
    with pytest.raises(LimitError, match="stroke"):
        controllers.write(
            bed,
            tmp_path / "b.cal",
            "aerotech",
            stroke="3 um",
            subtract_corner=True,
            **machine,
            **signs,
        )


def test_a_waiver_of_a_dry_run_that_was_done_is_not_recorded(tmp_path, table, measured):
    controllers.write(
        table, tmp_path / "x.csv", "csv", verified_against=measured, allow_unverified=True
    )

    sidecar = json.loads((tmp_path / "x.csv.json").read_text())
    assert sidecar["waived"] == []
    assert sidecar["verification"]["passed"] is True


def test_replacing_a_file_of_unknown_origin_is_told(tmp_path, table):
    path = tmp_path / "x.csv"
    path.write_text("position_mm,correction_forward_um\n0,0\n1,1\n")

    write(table, path, overwrite=True)

    findings = json.loads((tmp_path / "x.csv.json").read_text())["findings"]
    assert any(f["check"] == "active" and f["level"] == "warning" for f in findings)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"table": {"reference_m": 1' + "0" * 400 + "}}",
        '{"table": {"reference_m": NaN}}',
        '{"table": {"reference_m": 1e999}}',
        '{"table": {"axis": ["X"]}}',
        "[1, 2]",
        "\ufeff{",
    ],
)
def test_a_hostile_sidecar_is_one_clear_sentence(tmp_path, table, text):
    path = tmp_path / "x.csv"
    write(table, path)
    (tmp_path / "x.csv.json").write_text(text)

    with pytest.raises(CorruptFileError, match=r"move it away"):
        controllers.read(path, "csv")


def test_a_trial_is_written_without_a_confirmed_sign_and_marked(tmp_path):
    from metrosep.compensation import CompensationMap, trial_map, trial_table

    x = np.linspace(0.0, 50e-3, 21)
    across = CompensationTable.from_error(
        lambda x: 1e-4 * x, positions=x, axis="X", compensates="Z", exact=False
    )
    bed = CompensationMap(x, x[:11], np.zeros((11, 21)))
    for made, name in (
        (trial_table(across, 2e-6), "sinumerik-cec"),
        (trial_map(bed, 2e-6), "isg-plane"),
    ):
        path = tmp_path / name
        machine = registry.find(name).info.example
        controllers.write(made, path, name, **machine)

        sidecar = json.loads((tmp_path / f"{name}.json").read_text())
        assert sidecar["sign_confirmed_by_user"] is False
        assert "not for cutting" in sidecar["trial"]["note"]
        assert "+2 um" in sidecar["trial"]["if_right"]
