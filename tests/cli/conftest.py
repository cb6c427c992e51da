"""Fixtures of the tests of commands."""

import json

import pytest
from jsonschema import Draft202012Validator

from metrosep.cli.main import main
from metrosep.cli.output_schema import OUTPUTS, schema_of


@pytest.fixture
def metrosep(capsys):
    """Run a command line in this process: (code, stdout, stderr); what --json prints must fit its schema."""

    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        out = capsys.readouterr()
        command = next((w for w in map(str, words) if w in OUTPUTS), "")
        if "--json" in words and out.out.strip() and command:
            Draft202012Validator(schema_of(command)).validate(json.loads(out.out))
        return stop.value.code, out.out, out.err

    return call


@pytest.fixture(autouse=True, scope="module")
def _once_here(quick_doors):
    """These tests ask what becomes of a result, not whether it repeats itself, and read the text."""
