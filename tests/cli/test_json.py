"""What every command prints with --json fits its schema, which is declared once and shown in the reference."""

import json
from pathlib import Path

import click
import pytest
from jsonschema import Draft202012Validator

from metrosep.cli.main import _HOMES, cli
from metrosep.cli.output_schema import OUTPUTS, schema_of

ROOT = Path(__file__).resolve().parents[2]
MAP = "data_formats/metropro/samples/format1.dat"
RUNS = "examples/straightness/runs.csv --x x_mm --z z_um --feed feed_mm_min --run run --time t_ms"
BALL = "examples/five_axis_calibration/ball_1.csv"
SEPARATED = f"separate {RUNS} --method mean --start '0 mm' --length '45 mm' -o made"
READ = (
    "--target target_mm --direction direction"
    " --readings reached_1_mm,reached_2_mm,reached_3_mm,reached_4_mm,reached_5_mm"
)
LISTED = (
    f"table examples/positioning/runs.csv {READ} --axis X"
    " --reference '2.74 mm' --temperature '20.4 degC' --expansion '11.5 ppm/K'"
    " --u-temperature '0.1 K' -o x.comp"
)
COMMANDS = {
    "info": [f"info {MAP}", f"info {MAP} {MAP}"],
    "check": [
        f"check {MAP}",
        f"check {MAP} {MAP}",
        "check examples/measured_part/recipe.toml --explain",
    ],
    "formats": ["formats"],
    "controllers": ["controllers", "controllers linuxcnc"],
    "ops": ["ops", "ops donaldson"],
    "doctor": ["doctor"],
    "measure": [
        f"measure {MAP} --form plane --params PV,Sq --upper 'Sq=80 nm' --U 'Sq=2 nm'",
        f"measure {MAP} {MAP} missing.dat --params Sq",
    ],
    "form": [f"form {MAP} --form plane"],
    "psd": ["psd examples/measured_part/measured.sdf --limit 'rms = 10 um from 0.2 mm to 5 mm'"],
    "geometry": [
        (
            "geometry cylindricity examples/roundness_traces/traces.csv --angle angle_deg"
            " --radius deviation_um --height height_mm --set 'nominal_radius=12 mm'"
        )
    ],
    "circle": [
        "circle examples/five_axis_calibration/circle.csv --radius '100 mm' --feed '1500 mm/min'"
    ],
    "air": ["air --temperature '20 degC' --pressure '1013.25 hPa' --humidity '50 %'"],
    "rank": ["rank sts_lathe --form plane --radius '25 mm' --error 'EXX=1 um' --error 'EZZ=1 um'"],
    "predict": ["predict examples/cut_budget/motion.toml"],
    "calibrate": [
        f"calibrate five_axis {BALL} --pivot-height '80 mm' --terms X0C,Y0C,Y0A,Z0A -o terms"
    ],
    "read": [f"read five_axis {BALL} terms/constants.toml --pivot-height '80 mm'"],
    "thermal": [
        (
            "thermal examples/thermal/warm_up.csv --time t_s --reading EZZ_um --tilt EBX_urad"
            " --temperature bearing_degC,column_degC,room_degC -o heat"
        ),
        (
            "thermal heat/thermal.json --history examples/thermal/today.csv --time t_s"
            " --temperature bearing_degC,column_degC,room_degC"
        ),
    ],
    "separate": [
        SEPARATED,
        (
            "separate examples/reversal/donaldson.csv --method donaldson"
            " --readings m1_nm,m2_nm --angle angle_deg --repeat revolution"
        ),
    ],
    "run": ["run examples/measured_part/recipe.toml examples/measured_part/measured.sdf -o ran"],
    "table": [LISTED],
    "verify": [f"verify x.comp --against examples/positioning/runs.csv {READ}"],
    "diff": ["diff examples/measured_part/recipe.toml examples/measured_part/recipe.toml"],
    "batch": ["batch batch.toml parts -o qa"],
    "volume": [
        (
            "volume examples/volumetric_map/machine.toml examples/volumetric_map/x_terms.csv"
            " examples/volumetric_map/y_terms.csv --span 'Z=-100 mm..0 mm' --tolerance '0.2 um'"
        )
    ],
}
ELSEWHERE = {
    "demo": "run of an example, whose output is that of separate",
    "machine-tables": "tests/cli/test_machine_tables.py, through the fixture that checks each --json",
    "plan": "tests/cli/test_ops_cli.py, through the fixture that checks each --json",
    "path": "tests/cli/test_path.py, through the same fixture",
    "verify-softgauge": "tests/cli/test_softgauge_cli.py, through the same fixture",
}
"""Commands whose output other tests make."""


def has_json(name):
    return any(p.name == "as_json" for p in cli.get_command(click.Context(cli), name).params)


def test_every_command_with_json_has_a_schema_and_a_run():
    assert {n for n in _HOMES if has_json(n)} == set(OUTPUTS)
    assert set(COMMANDS) | set(ELSEWHERE) == set(OUTPUTS)


@pytest.mark.parametrize("name", OUTPUTS)
def test_a_schema_is_one_and_says_what_stays(name):
    schema = schema_of(name)
    Draft202012Validator.check_schema(schema)
    assert "required" in json.dumps(schema) or "minProperties" in schema


def test_the_output_of_every_command_fits_its_schema(metrosep, tmp_path, monkeypatch):
    """In one folder, since commands read what others wrote; the fixture checks each object."""
    import shlex

    monkeypatch.chdir(tmp_path)
    for folder in ("examples", "data_formats"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    (tmp_path / "parts").mkdir()
    for part in ("a", "b"):
        (tmp_path / "parts" / f"{part}.dat").write_bytes((ROOT / MAP).read_bytes())
    (tmp_path / "batch.toml").write_text(
        'metrosep = 1\n[input]\nfiles = "*.dat"\n[[step]]\nop = "parameters"\nnames = ["Sq"]\n',
        "utf-8",
    )
    silent = []
    for line in (line for lines in COMMANDS.values() for line in lines):
        code, out, err = metrosep(*shlex.split(line), "--json")
        if not out.strip():
            silent.append((line, code, err))
    assert not silent


def test_a_key_that_vanished_and_a_number_that_is_a_text_are_seen():
    good = {"equal": True}
    check = Draft202012Validator(schema_of("diff"))
    assert check.is_valid(good)
    assert not check.is_valid({})
    assert not check.is_valid({"equal": "yes"})
