"""``metrosep listen``: readings of a gauge, as they come, into a file that grows."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import click

from metrosep.cli.options import say


@click.command()
@click.argument("source")
@click.option(
    "--columns",
    required=True,
    metavar="NAME,...",
    help='Columns with their units, in the order in which they come: "x_mm,z_um".',
)
@click.option("-o", "--out", required=True, metavar="FILE", help="New CSV file that grows.")
@click.option(
    "--every",
    default="3 s",
    metavar="TIME",
    help='Time between two writes to FILE; "3 s" if omitted.',
)
@click.option(
    "--ask",
    metavar="TEXT",
    help=r'Send this for each reading, for a gauge that answers only: "M\r\n".',
)
@click.option(
    "--pace", default="1 s", metavar="TIME", help='Time between two --ask; "1 s" if omitted.'
)
@click.option(
    "--line", "form", metavar="FORM", help='Form of a line that is not numbers alone: "01A{}".'
)
@click.option("--for", "seconds", metavar="TIME", help='End after this time: "10 min".')
def listen(
    source: str,
    columns: str,
    out: str,
    every: str,
    ask: str | None,
    pace: str,
    form: str | None,
    seconds: str | None,
) -> int:
    """Record what SOURCE sends: lines of numbers, one reading each, until it ends or Ctrl-C.

    SOURCE is tcp://HOST:PORT of a gauge, serial:DEVICE:BAUD, or - for what a program prints, such as
    LinuxCNC's halsampler. 'metrosep ui FILE' shows the file as it grows ("follow this file").
    """
    from metrosep.core.numbers import positive
    from metrosep.io.live import LineTable, Question, joins_midway, open_line, record

    pause = positive(every, "--every", dimension="time")
    end = None if seconds is None else positive(seconds, "--for", dimension="time")
    question = None if ask is None else Question(ask, positive(pace, "--pace", dimension="time"))
    names = [n.strip() for n in columns.split(",")]
    table = LineTable(names, source, form, joins_midway(source, question))
    file = Path(out)
    with open_line(source, question) as chunks:
        say(f"{source}: recording to {file.name}; Ctrl-C ends it")
        with _until_signalled() as is_ended:
            try:
                record(
                    chunks, table, file, every=pause, seconds=end, is_ended=is_ended,
                    silent=lambda pause: say(
                        f"{source}: nothing came for {pause:.0f} s; is the gauge on, its cable plugged in, and "
                        "no other program on its line? The recording goes on"
                    ),
                )  # fmt: skip
            except KeyboardInterrupt:
                say("ended by hand")
            else:
                if is_ended():
                    say("ended by hand")
    if table.cut:
        say(
            f"the first line may have begun before the recording and was not kept: {ascii(table.cut[:40])[1:]}"
        )
    left = ", an unfinished last line was not kept" if table.is_unfinished else ""
    say(f"{file.name}: {table.n_rows} readings{left}")
    if not table.n_rows and not table.cut:
        say(
            "nothing came: does the gauge send only when it is asked (--ask)?"
            if ask is None
            else "nothing came: does the gauge know this question, with this line end?"
        )
    return 0


@contextmanager
def _until_signalled() -> Iterator[Callable[[], bool]]:
    """Tell whether Ctrl-C was pressed, or the system or a closed terminal ends the program.

    A write is not torn by it. The second time ends what hangs. What was ignored (``nohup``) stays so.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        if came or os.name == "nt":  # a read waits there for ever
            raise KeyboardInterrupt
        came.append(number)

    is_main = threading.current_thread() is threading.main_thread()
    known = [getattr(signal, n, None) for n in ("SIGINT", "SIGTERM", "SIGHUP") if is_main]
    before = {s: signal.getsignal(s) for s in known if s is not None}
    kept = {s: old for s, old in before.items() if old not in (signal.SIG_IGN, None)}
    try:
        for number in kept:
            signal.signal(number, note)
        yield lambda: bool(came)
    finally:
        for number, old in kept.items():
            signal.signal(number, old)
