"""Fixtures of the tests of commands."""

import pytest

from metrosep.cli.main import main


@pytest.fixture
def metrosep(capsys):
    """Run a command line in this process: (code, stdout, stderr)."""

    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        out = capsys.readouterr()
        return stop.value.code, out.out, out.err

    return call


@pytest.fixture(autouse=True)
def _once_here(separations_once):
    """These tests ask what becomes of a separation, not whether it repeats itself."""
