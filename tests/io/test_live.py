"""A gauge that sends lines by TCP or a serial port: what it sent stands in the file, digit for digit."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, ReadError, WriteError
from metrosep.io.live import LONGEST, LineTable, Question, open_line, record


def gauge(pieces, pause=0.0):
    """Send bytes to the first who calls; return the address."""
    server = socket.create_server(("127.0.0.1", 0))

    def work():
        with server, server.accept()[0] as line:
            for piece in pieces:
                line.sendall(piece)
                time.sleep(pause)

    threading.Thread(target=work, daemon=True).start()
    return f"tcp://127.0.0.1:{server.getsockname()[1]}"


def recorded(pieces, file, names=("x_mm", "z_um"), **more):
    table = LineTable(names, "gauge")
    with open_line(gauge(pieces, more.pop("pause", 0.0))) as chunks:
        record(chunks, table, file, **more)
    return table


def test_what_a_gauge_sends_in_pieces_is_read_with_its_sign_and_place(tmp_path):
    x = np.arange(400) * 0.25
    z = 3.0 * np.sin(x / 7.0) + 0.01 * x
    sent = b"".join(f"{a:.2f},{b:+.5f}\r\n".encode() for a, b in zip(x, z, strict=True))
    pieces = [sent[i : i + 97] for i in range(0, len(sent), 97)]  # lines are cut anywhere
    table = recorded(pieces, tmp_path / "run.csv")
    assert table.n_rows == 400
    assert not table.is_unfinished
    found = ms.read(tmp_path / "run.csv", x="x_mm", z="z_um")
    assert np.abs(found.x - 1e-3 * np.round(x, 2)).max() < 1e-12
    assert np.abs(found.z - 1e-6 * np.round(z, 5)).max() < 1e-16
    assert found.z[11] > 0 > found.z[110]


def test_the_file_is_whole_rows_while_it_grows(tmp_path):
    file = tmp_path / "run.csv"
    pieces = [b"1,0.5\n2,", b"0.6\n3,0.", b"7\n4,0.8\n5,9"]
    told = []
    recorded(
        pieces, file, pause=0.05, every=0.02, tell=lambda n: told.append((n, file.read_text()))
    )
    assert len(told) >= 2
    for n, text in told:
        assert text.splitlines() == ["x_mm,z_um", "1,0.5", "2,0.6", "3,0.7", "4,0.8"][: n + 1]
        assert text.endswith("\n")
    assert file.read_text().endswith(
        "4,0.8\n"
    )  # the last line had no end: it may be half a number


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (b"2,oops\n", "line 2: 'oops' is not a number"),
        (b"2,3,4\n", "line 2: holds 3 numbers, and 2 columns are named"),
        (b"2\n", "line 2: holds 1 numbers"),
        (b"2,\xff\xfe\n", "line 2: holds bytes that are not text; check the baud rate"),
        (b"2,\x1b[2J\n", "line 2: holds bytes that are not text"),
        (b"2,1e999\n", "line 2: holds a number beyond"),
        (b"2,inf\n", "line 2: 'inf' is not a number"),
        (b"overrun\n", "line 2: the sampler lost samples here"),
        (b"=cmd|' /C calc'!A0,1\n", "line 2: \"=cmd|' /C calc'!A0\" is not a number"),
        (b"9" * (LONGEST + 1), "line 2: more than 4096 bytes came without a line end"),
        (b"9" * 9000 + b"\n", "line 2: more than 4096 bytes came without a line end"),
    ],
)  # fmt: skip
def test_what_is_no_reading_ends_it_with_a_sentence_and_loses_nothing(tmp_path, sent, words):
    with pytest.raises(DataError) as told:
        recorded([b"1,0.5\n" + sent + b"3,0.7\n"], tmp_path / "run.csv")
    assert words in str(told.value)
    assert "\n" not in str(told.value)
    assert (tmp_path / "run.csv").read_text() == "x_mm,z_um\n1,0.5\n"


def test_places_that_are_no_line(tmp_path):
    for text, words in (
        ("tcp://127.0.0.1:1", "nothing answers there"),
        ("tcp://127.0.0.1:99999", "is none of"),
        ("http://127.0.0.1:80", "is none of"),
        ("serial:/dev/null:9600", "is not a serial port"),
        ("serial:/dev/null:12345", "is not a baud rate"),
        (f"serial:{tmp_path / 'no'}:9600", "cannot be opened"),
    ):
        with pytest.raises((DataError, ReadError), match=words), open_line(text):
            pass
    (tmp_path / "there.csv").write_text("mine")
    with pytest.raises(WriteError, match="is there already"):
        recorded([b"1,2\n"], tmp_path / "there.csv")
    assert (tmp_path / "there.csv").read_text() == "mine"
    with pytest.raises(DataError, match="with their units"):
        LineTable(["x", "z_um"])
    for name in ("z_foo", "z_min", "zone_um_x"):
        with pytest.raises(DataError, match=f"column {name}: .* not a unit"):
            LineTable(["x_mm", name])
    LineTable(["t_s", "T_degC", "p_hPa", "f_mm_min"])


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="this system has no pseudo terminals")
def test_a_serial_port(tmp_path):
    ours, theirs = os.openpty()
    table = LineTable(["t_s", "z_um"], "serial")
    with open_line(f"serial:{os.ttyname(theirs)}:9600") as chunks:
        os.write(ours, b"0.0\t-1.25\r0.1\t2.5\r0.2\t7\r")  # ends of lines that are CR alone
        record(chunks, table, tmp_path / "run.csv", seconds=0.5, every=0.1)
    with open_line(f"serial:{os.ttyname(theirs)}:9600", Question(r"M\r", 0.05)) as chunks:
        record(chunks, table, tmp_path / "asked.csv", seconds=0.2)
    assert os.read(ours, 100).startswith(b"M\rM\rM\r")
    os.close(ours)
    os.close(theirs)
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert lines == ["t_s,z_um", "0.0,-1.25", "0.1,2.5", "0.2,7"]


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="this system has no pseudo terminals")
def test_the_tail_of_a_line_at_the_join_is_no_reading(tmp_path):
    ours, theirs = os.openpty()
    listen = listening(f"serial:{os.ttyname(theirs)}:9600", "run.csv", tmp_path, "--for", "0.4 s")
    told = listen.stderr.readline()  # the port is open
    os.write(ours, b"456\r\n-1.5\r\n+2.5\r\n")
    told += listen.communicate(timeout=30)[1]
    os.close(ours)
    os.close(theirs)
    assert (tmp_path / "run.csv").read_text() == "z_mm\n-1.5\n+2.5\n"
    assert "may have begun before the recording and was not kept: '456'" in told
    assert "2 readings" in told


def listening(source, out, folder, *more):
    words = [
        sys.executable,
        "-m",
        "metrosep",
        "listen",
        source,
        "--columns",
        "z_mm",
        "-o",
        out,
        *more,
    ]
    return subprocess.Popen(
        words, cwd=folder, text=True, stdin=subprocess.PIPE, stderr=subprocess.PIPE
    )


@pytest.mark.skipif(os.name == "nt", reason="this system has no such signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_whoever_ends_it_loses_no_reading_that_came(tmp_path, name):
    number = getattr(signal, name)
    before = signal.signal(number, signal.SIG_DFL)  # else ignored where the tests run under nohup
    listen = listening("-", "run.csv", tmp_path, "--every", "1 h")
    signal.signal(number, before)
    listen.stdin.write("1.5\r-2.5\r")
    listen.stdin.flush()
    file = tmp_path / "run.csv"
    wait_for(lambda: file.exists() and file.read_text() == "z_mm\n1.5\n")  # the first row at once
    listen.stdin.write("3.5\r")
    listen.stdin.flush()
    time.sleep(0.3)
    listen.send_signal(number)
    told = listen.communicate(timeout=30)[1]
    assert file.read_text() == "z_mm\n1.5\n-2.5\n3.5\n"
    assert listen.returncode == 0
    assert "ended by hand" in told
    assert "3 readings\n" in told  # the last one ended with CR: it is whole


def wait_for(holds, seconds=30.0):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (b"1,5\n", "may be one number with a decimal comma"),
        (b"-1,5\n", "may be one number with a decimal comma"),
        (b"1,5;2,0\n", "'1,5' is not a number with a decimal point"),
        (b"1,5 2,0\n", "is not a number"),
        (b"1.0,,2.0\n", "lacks a number between two commas"),
        (b"1.0\t\t2.0\n", "lacks a number between two tabs"),
        (b"1.0,2.0,\n", "lacks a number"),
        (b"1.0;2.0\n1.0,2.0\n", "line 2: has commas between its numbers, and the lines before have"),
    ],
)  # fmt: skip
def test_no_column_is_made_of_a_decimal_comma_or_a_gap(sent, words):
    with pytest.raises(DataError, match="line") as told:
        list(LineTable(["x_mm", "z_um"], "gauge").feed(sent))
    assert words in str(told.value)


def test_whole_numbers_are_read_where_it_is_said_that_commas_part_them():
    assert list(LineTable(["x_mm", "z_um"], "gauge", "{},{}").feed(b"1,-5\n2,7\n")) == [
        "1,-5",
        "2,7",
    ]
    rows = list(LineTable(["x_mm", "z_um"], "gauge").feed(b"1.0, -5\n2,7\n"))
    assert rows == ["1.0,-5", "2,7"]  # the first line shows what a comma is


def answering(answer, n=400):
    """Answer each question that ends with CR, as a multiplexer of dial gauges does; note what was asked."""
    server = socket.create_server(("127.0.0.1", 0))
    asked = []

    def work():
        with server, server.accept()[0] as line:
            waiting = b""
            while len(asked) < n and (came := line.recv(100)):
                *whole, waiting = (waiting + came).split(b"\r")
                for one in whole:
                    asked.append(one)
                    line.sendall(answer(len(asked)))

    threading.Thread(target=work, daemon=True).start()
    return f"tcp://127.0.0.1:{server.getsockname()[1]}", asked


def test_a_gauge_that_must_be_asked_is_asked_at_a_pace(tmp_path):
    address, asked = answering(lambda k: f"01A{'-+'[k % 2]}0000{k}.125\r".encode(), n=6)
    table = LineTable(["z_mm"], "gauge", "01A{}")
    begin = time.monotonic()
    with open_line(address, Question(r"1\r", 0.05)) as chunks:
        record(chunks, table, tmp_path / "run.csv")
    assert time.monotonic() - begin > 0.2  # five waits of 50 ms
    assert asked == [b"1"] * 6
    rows = (tmp_path / "run.csv").read_text().splitlines()
    assert rows == ["z_mm", *(f"{'-+'[k % 2]}0000{k}.125" for k in range(1, 7))]


@pytest.mark.parametrize(
    ("form", "sent", "row"),
    [
        ("{} mm", b"+   1.2345 mm\n", "+1.2345"),
        ("X={};Z= {}", b"X= 1.5 ; Z=-2\n", None),
        ("X={};Z={}", b"X= 1.5 ;Z=-2\n", "1.5,-2"),
        ("01A{}", b"911\n", None),
        ("01A{}", b"01A1.2.3\n", None),
        ("01A{}", b"01A" + b"1" * 4000 + b"x\n", None),
        ("{} {}", b"1" + b" " * 4000 + b"x\n", None),  # at once, not after trying all ways
        ("{} {}", b"+ 1.5   - 2\n", "+1.5,-2"),
    ],
)
def test_the_form_of_a_line_takes_its_numbers_and_nothing_else(form, sent, row):
    table = LineTable(["x_mm", "z_um"] if form.count("{}") == 2 else ["z_mm"], "gauge", form)
    if row is None:
        with pytest.raises(DataError, match="line 1: "):
            list(table.feed(sent))
    else:
        assert list(table.feed(sent)) == [row]


def test_questions_and_forms_that_are_none():
    assert Question(r"\x1bA\\M\r\n\t\xff").data == b"\x1bA\\M\r\n\t\xff"
    for text in ("", "M\\", "M\\q", "\\x1", "µ", "a" * 5000):
        with pytest.raises(DataError, match="question"):
            Question(text)
    for form in ("01A", "{}{}", "{}.{}", "{}e-{}", "{} {} {}"):
        with pytest.raises(DataError, match=r"\{\}"):
            LineTable(["x_mm", "z_um"], "gauge", form)
    with pytest.raises(DataError, match="cannot be asked"), open_line("-", Question("M")):
        pass


def test_a_silence_is_told_once_until_something_comes_again(tmp_path):
    """A pulled cable ends no connection: nothing comes, and nobody says why."""
    told = []
    chunks = iter([b"1;2\n", *[b""] * 40, b"2;3\n", *[b""] * 40, None])

    def slow():
        time.sleep(0.002)
        return next(chunks)

    table = LineTable(("x_mm", "z_um"), "gauge")
    record(slow, table, tmp_path / "run.csv", silent=told.append, patience=0.02)
    assert len(told) == 2
    assert all(0.02 <= pause < 5.0 for pause in told)
    assert table.n_rows == 2
