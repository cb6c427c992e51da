"""Lines of a gauge as they come, into a table that grows: from TCP, a serial port, or a program.

What comes down a line is not trusted: it is text of numbers or it ends the recording with one
sentence. The table holds the digits as they were sent, whole rows only; its names stand there at
once, the first row as it comes, and what follows some seconds' worth at a time.
"""

from __future__ import annotations

import math
import os
import re
import select
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from metrosep.core.errors import DataError, ReadError, WriteError
from metrosep.core.units import SURROUNDINGS, column_unit, surrounding_header

LONGEST = 4096
"""Bytes of a line: what has no line end by then is no text."""
MOST_ROWS = 20_000_000
_MARKS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "blanks"}
"""What parts the numbers of a line: the first of these that stands there."""
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?|[nN][aA][nN]")
_NAME = re.compile(r"[A-Za-z]\w{0,62}_[A-Za-z]\w*")
_LOST = "overrun"
"""Line of LinuxCNC's ``halsampler`` where its buffer was full and samples are gone."""
_QUIET = 0.2
"""Seconds between looks at a line that says nothing."""
_SILENT = 10.0
"""Seconds of silence after which it is said: a pulled cable ends no connection."""
Chunks = Callable[[], bytes | None]
"""Give what came, nothing (b"") after a moment of silence, None at the end."""


_ESCAPE = re.compile(r"\\(?:([rnt\\])|x([0-9a-fA-F]{2}))|([^\\])")


@dataclass(frozen=True)
class Question:
    """What a gauge must be sent before it sends a reading."""

    text: str  # as typed: \\r, \\n, \\t, \\\\ and \\x1b stand for one byte
    pace: float = 1.0  # s between two questions

    def __post_init__(self) -> None:
        if not self.data or len(self.data) > LONGEST:
            raise DataError("a question to a gauge has 1 to 4096 bytes, such as M\\r\\n")

    @property
    def data(self) -> bytes:
        """Bytes that are sent."""
        if not self.text.isascii() or _ESCAPE.sub("", self.text):
            raise DataError(
                f"{self.text[:40]!r}: a question is plain text with \\r, \\n, \\t, \\\\ or \\x and two hex digits"
            )
        known = {"r": "\r", "n": "\n", "t": "\t", "\\": "\\"}
        text = _ESCAPE.sub(
            lambda m: known[m[1]] if m[1] else chr(int(m[2], 16)) if m[2] else m[3], self.text
        )
        return text.encode("latin-1")


@dataclass
class LineTable:
    """Rows of numbers out of bytes: lines ended by LF, CR or CR LF."""

    names: Sequence[str]  # of columns, each with its unit: x_mm
    source: str = "line"  # for messages
    form: str | None = None  # of a line, {} for each number: "01A{}"
    is_midway: bool = False  # the first line may have begun before: it is not kept
    cut: bytes = b""  # what was not kept of it
    n_lines: int = 0  # that came
    n_rows: int = 0  # that are numbers
    _rest: bytes = field(default=b"", repr=False)

    def __post_init__(self) -> None:
        bad = next((n for n in self.names if not _NAME.fullmatch(n)), None)
        if bad is not None or len(set(self.names)) < len(self.names) or not self.names:
            raise DataError(
                f"columns are names with their units, such as x_mm,z_um, each once; got {bad or list(self.names)!r}"
            )
        bare = next((n for n in self.names if not _has_unit(n)), None)
        if bare is not None:
            raise DataError(
                f"column {bare}: {bare.rpartition('_')[2]!r} at its end is not a unit of a column; end "
                "the name with one, such as z_um or t_s"
            )
        self._mark: str | None = None
        self._is_settled = False
        self._form: re.Pattern[str] | None = None
        if self.form is not None:
            words = [re.escape(w) for w in self.form.split("{}")]
            if len(words) != len(self.names) + 1:
                raise DataError(
                    f"the form of a line has one {{}} for each of the {len(self.names)} columns; got {self.form[:40]!r}"
                )
            if any(re.fullmatch(r"[\d.eE+-]*", w) for w in self.form.split("{}")[1:-1]):
                raise DataError(
                    f"between two {{}} of {self.form[:40]!r} must stand what is not part of a number"
                )
            self._form = re.compile(" ?([-+]? ?[\\d.eE+-]+|nan) ?".join(words), re.ASCII)

    def feed(self, chunk: bytes) -> Iterator[str]:
        """Give the rows that a piece of the line completes, as lines of CSV."""
        *lines, self._rest = re.split(rb"\r\n|\n|\r(?!\Z)", self._rest + chunk)
        for line in lines:
            self.n_lines += 1
            if self.is_midway:
                self.is_midway, self.cut = False, line.strip()
            elif line.strip():
                yield self._row(line)
        if len(self._rest) > LONGEST:
            self.n_lines += 1
            self._row(self._rest)

    def finish(self) -> Iterator[str]:
        """Give the last row where a carriage return ended it: the next byte may have been a line feed."""
        if self._rest.endswith(b"\r"):
            yield from self.feed(b"\n")

    @property
    def is_unfinished(self) -> bool:
        """Whether a last line without its end was left behind."""
        return bool(self._rest.strip())

    def _row(self, line: bytes) -> str:
        if len(line) > LONGEST:
            raise self._error(
                f"more than {LONGEST} bytes came without a line end; set the gauge to send each reading "
                "as a line"
            )
        try:
            text = line.decode("ascii").strip()
        except UnicodeDecodeError:
            text = "\0"
        if not text.replace("\t", " ").isprintable():
            raise self._error(
                "holds bytes that are not text; check the baud rate, and that the gauge sends ASCII"
            )
        if text == _LOST:
            raise self._error(
                "the sampler lost samples here (overrun): sample more slowly, or fewer pins"
            )
        if self._form is None:
            parts = self._parts(text)
        else:
            found = self._form.fullmatch(re.sub(r"[ \t]+", " ", text))
            if found is None:
                raise self._error(f"{text[:40]!r} is not of the form {self.form!r}")
            parts = [p.replace(" ", "") for p in found.groups()]
        wrong = next((p for p in parts if not _NUMBER.fullmatch(p)), None)
        if wrong == "":
            raise self._error(
                f"{text[:40]!r} lacks a number between two {_MARKS[self._mark or ',']}, or at an end"
            )
        if wrong is not None:
            raise self._error(f"{wrong[:40]!r} is not a number with a decimal point")
        if len(parts) != len(self.names):
            raise self._error(
                f"holds {len(parts)} numbers, and {len(self.names)} columns are named "
                f"({','.join(self.names)})"
            )
        if any(math.isinf(float(p)) for p in parts):
            raise self._error("holds a number beyond what a file can hold")
        if self.n_rows >= MOST_ROWS:
            raise self._error(f"{MOST_ROWS} rows are recorded; begin another file")
        self.n_rows += 1
        return ",".join(parts)

    def _parts(self, text: str) -> list[str]:
        """Return the fields of a line, parted as those of the lines before."""
        mark = next((m for m in _MARKS if m in text), None)
        if mark is None:
            return [text]
        if mark != (self._mark or mark):
            raise self._error(
                f"has {_MARKS[mark]} between its numbers, and the lines before have {_MARKS[self._mark or mark]}"
            )
        if mark == "," and not self._is_settled and _DECIMAL_COMMA.fullmatch(text):
            raise self._error(
                f"{text[:40]!r} may be one number with a decimal comma, or two; set the gauge to send "
                "decimal points, or say that they are two with --line '{},{}'"
            )
        self._mark, self._is_settled = mark, True
        return text.split() if mark == " " else [p.strip() for p in text.split(mark)]

    def _error(self, words: str) -> DataError:
        return DataError(f"{self.source}: line {self.n_lines}: {words}")


def record(
    chunks: Chunks,
    table: LineTable,
    file: Path,
    *,
    every: float = 3.0,
    seconds: float | None = None,
    tell: Callable[[int], None] = lambda n: None,
    is_ended: Callable[[], bool] = lambda: False,
    silent: Callable[[float], None] = lambda seconds: None,
    patience: float = _SILENT,
) -> int:
    """Write rows to a new file, some seconds' worth at a time, until the line ends or we do; return how many.

    What came before an error is in the file. `silent` is called once when nothing came for `patience` seconds.
    """
    try:
        with file.open("x", encoding="ascii", newline="\n") as out:
            out.write(",".join(table.names) + "\n")
            out.flush()
            begin, last = time.monotonic(), -math.inf
            heard, is_told = begin, False
            waiting: list[str] = []

            def keep() -> None:
                if waiting:  # whole rows in one write
                    out.write("\n".join(waiting) + "\n")
                    out.flush()
                    waiting.clear()
                    tell(table.n_rows)

            try:
                while not is_ended() and (chunk := chunks()) is not None:
                    for row in table.feed(chunk):  # what comes before an error is kept
                        waiting.append(row)  # noqa: PERF402
                    now = time.monotonic()
                    if chunk:
                        heard, is_told = now, False
                    elif now - heard >= patience and not is_told:
                        is_told = True
                        silent(now - heard)
                    if waiting and now - last >= every:
                        keep()
                        last = now
                    if seconds is not None and now - begin >= seconds:
                        break
                waiting.extend(table.finish())
            except KeyboardInterrupt:
                waiting.extend(table.finish())
                raise
            finally:
                keep()
    except FileExistsError:
        raise WriteError(f"{file}: is there already; name another file") from None
    except OSError as exc:
        if isinstance(exc, ReadError | WriteError):
            raise
        raise WriteError(f"{file}: cannot be written ({exc.strerror or exc})", exc) from None
    return table.n_rows


def _has_unit(name: str) -> bool:
    """Whether the name of a column ends in a unit: of a length, a time, ... or of air and parts."""
    return column_unit(name)[1] is not None or any(
        surrounding_header(name, d) is not None for d in SURROUNDINGS
    )


def joins_midway(source: str, question: Question | None) -> bool:
    """Whether a source may be within a line when it is opened: one that sends without being asked.

    A serial port may hold what was sent before, also of an answer.
    """
    return source.startswith("serial:") or (source.startswith("tcp:") and question is None)


@contextmanager
def open_line(text: str, question: Question | None = None) -> Iterator[Chunks]:
    """Open ``tcp://HOST:PORT``, ``serial:DEVICE:BAUD``, or ``-`` for standard input."""
    quiet = _QUIET if question is None else min(_QUIET, question.pace)
    tcp = re.fullmatch(r"tcp://(\[[0-9a-fA-F:]+\]|[^:/\s]+):(\d{1,5})", text)
    serial = re.fullmatch(r"serial:(.+):(\d{2,7})", text)
    if text == "-":
        if question is not None:
            raise DataError("-: a program cannot be asked: name the line of the gauge itself")
        yield _chunks(_reading(sys.stdin.fileno(), quiet), text)
    elif tcp and 0 < int(tcp[2]) < 65536:
        place = (tcp[1].strip("[]"), int(tcp[2]))
        try:
            line = socket.create_connection(place, timeout=10.0)
        except OSError as exc:
            raise ReadError(
                f"{text}: nothing answers there ({exc.strerror or exc}); is the gauge on, and its port "
                "right?"
            ) from None
        with line:
            line.settimeout(quiet)
            yield _asking(_chunks(lambda: line.recv(65536), text), line.sendall, question, text)
    elif serial:
        for descriptor in _serial(serial[1], int(serial[2]), text):
            read = _chunks(_reading(descriptor, quiet), text)
            yield _asking(read, lambda data: os.write(descriptor, data), question, text)  # noqa: B023
    else:
        raise DataError(
            f"{text}: is none of tcp://HOST:PORT, serial:DEVICE:BAUD, or - for standard input"
        )


def _asking(
    chunks: Chunks, send: Callable[[bytes], object], question: Question | None, name: str
) -> Chunks:
    """Ask at a pace; what comes is read meanwhile."""
    if question is None:
        return chunks
    due = time.monotonic()

    def asked() -> bytes | None:
        nonlocal due
        if (now := time.monotonic()) >= due:
            due = max(due + question.pace, now)  # late once is not late for ever
            try:
                send(question.data)
            except OSError as exc:
                raise ReadError(f"{name}: cannot be asked ({exc.strerror or exc})") from None
        return chunks()

    return asked


def _reading(descriptor: int, quiet: float) -> Callable[[], bytes]:
    def read() -> bytes:
        if os.name != "nt" and not select.select([descriptor], [], [], quiet)[0]:
            raise TimeoutError
        return os.read(descriptor, 65536)

    return read


def _chunks(read: Callable[[], bytes], name: str) -> Chunks:
    def chunks() -> bytes | None:
        try:
            return read() or None
        except TimeoutError:
            return b""
        except OSError as exc:
            raise ReadError(f"{name}: the line broke off ({exc.strerror or exc})") from None

    return chunks


def _serial(device: str, baud: int, text: str) -> Iterator[int]:
    """Open a serial port, 8 bits, no parity, one stop bit, no echo; give its descriptor."""
    try:
        import termios
        import tty
    except ImportError:
        raise ReadError(
            f"{text}: this system opens no serial port; let a terminal program send it by TCP"
        ) from None
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise DataError(
            f"{text}: {baud} is not a baud rate of this system, such as 9600 or 115200"
        )
    try:
        descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as exc:
        raise ReadError(f"{text}: cannot be opened ({exc.strerror})") from None
    try:
        if not os.isatty(descriptor):
            raise ReadError(f"{text}: is not a serial port")
        tty.setraw(descriptor)
        made = termios.tcgetattr(descriptor)
        made[2] = (made[2] & ~(termios.PARENB | termios.CSTOPB)) | termios.CS8 | termios.CLOCAL
        made[4] = made[5] = speed
        termios.tcsetattr(descriptor, termios.TCSANOW, made)
        os.set_blocking(descriptor, True)
        yield descriptor
    finally:
        os.close(descriptor)
