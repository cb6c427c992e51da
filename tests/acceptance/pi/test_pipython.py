"""PI's own client sends our waves: command for command what we write, on a fake controller.

Runs where PIPython 2.11 can be imported (its licence allows the use of PI devices only, so it is
no dependency: install it by hand into an environment beside, and run these tests there).
"""

import numpy as np
import pytest

from metrosep.compensation import CompensationTable
from metrosep.controllers.options import checked_options
from metrosep.controllers.waves import PiGcs

pytestmark = pytest.mark.peer

pipython = pytest.importorskip("pipython", reason="PIPython is not installed")

POINTS = 23
OPTIONS = {
    "polarity": 1, "travel": "12 um", "offset": "2 um", "speed": "1 mm/s", "rate": 100, "start": 0.0
}  # fmt: skip


def _device():
    from pipython.pidevice.gcs2.gcs2commands import GCS2Commands
    from pipython.pidevice.gcsmessages import GCSMessages
    from pipython.pidevice.interfaces.pigateway import PIGateway

    class Fake(PIGateway):
        """A controller that says it is an E-727 without errors, and remembers what it is told."""

        def __init__(self):
            self.sent = []
            self._answer = ""

        def __str__(self):
            return "fake"

        def __enter__(self):
            return self

        def __exit__(self, *args):
            return None

        timeout = property(lambda self: 1000)
        connected = property(lambda self: True)
        connectionid = property(lambda self: 0)

        def settimeout(self, value):
            del value

        def close(self):
            return None

        def unload(self):
            return None

        def flush(self):
            self._answer = ""

        def send(self, msg):
            for line in str(msg).splitlines():
                word = line.strip()
                answers = {"ERR?": "0", "*IDN?": "fake, E-727, 0, 1.0", "CSV?": "2.0"}
                if word in answers:
                    self._answer += answers[word] + "\n"
                elif word:
                    self.sent.append(word)

        def read(self):
            answer, self._answer = self._answer, ""
            return answer

        @property
        def answersize(self):
            return len(self._answer)

        def getanswer(self, bufsize):
            del bufsize
            return self.read()

    gateway = Fake()
    return GCS2Commands(GCSMessages(gateway)), gateway


def _table():
    x = np.arange(POINTS) * 5e-6
    c = 1e-6 * np.round(np.sin(np.arange(POINTS)) - 0.3 * (np.arange(POINTS) == 7), 6)
    return CompensationTable(x, c, None, "X", "Z", 0.0)


def _ours(bunch):
    dialect = PiGcs()
    options = checked_options({**OPTIONS, "bunch": bunch}, dialect.options, "pi-gcs")
    return dialect.encode(_table(), **options).data.decode().splitlines()


def _vendor(bunch):
    device, gateway = _device()
    from pipython.pitools.gcs2.gcs2pitools import GCS2Tools

    GCS2Tools(device).writewavepoints(1, [float(v) for v in _table().forward * 1e6], bunch)
    device.WSL(1, 1)
    device.WTR(1, 100, 1)
    device.WOS(1, 2)
    device.WGC(1, 1)
    device.WGO(1, 1)
    return gateway.sent


def _tokens(lines):
    """Words as they are, numbers as numbers: PIPython writes 0.5 as 0.50000 or 5e-1."""
    found = []
    for line in lines:
        row = []
        for word in line.split():
            try:
                row.append(float(word))
            except ValueError:
                row.append(word)
        found.append(row)
    return found


def _one_command(lines):
    """Undo the bunching: one WAV command with all points."""
    rows = _tokens(lines)
    waves = [r for r in rows if r[0] == "WAV"]
    points = [v for r in waves for v in r[6:]]
    return [[*waves[0][:4], 1.0, float(len(points)), *points], *rows[len(waves) :]]


@pytest.mark.parametrize("bunch", [1, 7, 10, 100])
def test_pipython_sends_the_commands_we_write(bunch):
    ours, vendor = _ours(bunch), _vendor(bunch)

    assert len(ours) == -(-POINTS // bunch) + 5
    assert _tokens(vendor) == _tokens(ours)


def test_pipython_in_other_bunches_sends_the_same_wave():
    assert _one_command(_vendor(4)) == _one_command(_ours(10))


def test_the_first_command_is_spelled_as_the_vendor_spells_it():
    first = _vendor(3)[0].split()

    assert first[:6] == _ours(3)[0].split()[:6] == ["WAV", "1", "X", "PNT", "1", "3"]
