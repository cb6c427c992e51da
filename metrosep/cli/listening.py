"""``metrosep listen``: readings of a gauge, as they come, into a file that grows."""

from __future__ import annotations

from pathlib import Path

import click

from metrosep.cli.options import say

__all__ = ["listen"]


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
@click.option("--for", "seconds", metavar="TIME", help='End after this time: "10 min".')
def listen(source: str, columns: str, out: str, every: str, seconds: str | None) -> int:
    r"""Record what SOURCE sends: lines of numbers, one reading each, until it ends or Ctrl-C.

    SOURCE is tcp://HOST:PORT of a gauge, serial:DEVICE:BAUD, or - for what a program prints, such as
    LinuxCNC's halsampler. 'metrosep ui FILE' shows the file as it grows ("follow this file").

    \b
    Examples:
      metrosep listen tcp://192.168.0.20:5000 --columns x_mm,z_um -o run1.csv
      halsampler -n 6000 | metrosep listen - --columns x_mm,z_um -o run1.csv
    """
    from metrosep.core.numbers import positive
    from metrosep.io.live import LineTable, open_line, record

    pause = positive(every, "--every", dimension="time")
    end = None if seconds is None else positive(seconds, "--for", dimension="time")
    table = LineTable([n.strip() for n in columns.split(",")], source)
    file = Path(out)
    with open_line(source) as chunks:
        say(f"{source}: recording to {file.name}; Ctrl-C ends it")
        try:
            record(chunks, table, file, every=pause, seconds=end)
        except KeyboardInterrupt:
            say("ended by hand")
    left = ", an unfinished last line was not kept" if table.is_unfinished else ""
    say(f"{file.name}: {table.n_rows} readings{left}")
    if not table.n_rows:
        say("nothing came: does the gauge send by itself, or only when it is asked?")
    return 0
