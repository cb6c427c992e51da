"""Write the samples of TDMS files byte by byte; neither metrosep nor npTDMS is imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

META, NEW_LIST, RAW, INTERLEAVED, BIG, DAQMX = 2, 4, 8, 32, 64, 128
CODES = {"i2": (2, "h"), "f4": (9, "f"), "f8": (10, "d"), "u4": (7, "I")}
OPEN_END = 0xFFFFFFFFFFFFFFFF
START = 3723638400  # s from 1904-01-01 to 2021-12-29 16:00


def text(value, order="<"):
    return struct.pack(f"{order}I", len(value.encode())) + value.encode()


def prop(name, value, order="<"):
    """Return a property: text, double, integer, or (seconds, half seconds) as a time."""
    if isinstance(value, str):
        return text(name, order) + struct.pack(f"{order}I", 0x20) + text(value, order)
    if isinstance(value, tuple):
        fields = value if order == ">" else value[::-1]
        codes = "qQ" if order == ">" else "Qq"
        return text(name, order) + struct.pack(f"{order}I{codes}", 0x44, *fields)
    code, letter = CODES["f8" if isinstance(value, float) else "u4"]
    return text(name, order) + struct.pack(f"{order}I{letter}", code, value)


def index(kind, count, order="<"):
    if kind is None:
        return struct.pack(f"{order}I", 0xFFFFFFFF)
    return struct.pack(f"{order}IIIQ", 20, CODES[kind][0], 1, count)


def strings_index(values):
    return struct.pack("<IIIQQ", 28, 0x20, 1, len(values), len(strings(values)))


def strings(values):
    ends = [sum(len(v) for v in values[: k + 1]) for k in range(len(values))]
    return struct.pack(f"<{len(values)}I", *ends) + "".join(values).encode()


def daqmx_index(count, byte, width):
    """One scaler: i16 (code 3) in buffer 0 at a byte of the row, scale number 0."""
    head = struct.pack("<IIIQI", 0x1269, 0xFFFFFFFF, 1, count, 1)
    return head + struct.pack("<5I", 3, 0, byte, 0, 0) + struct.pack("<2I", 1, width)


def entry(path, raw_index, props, order="<"):
    fields = b"".join(prop(k, v, order) for k, v in props.items())
    return text(path, order) + raw_index + struct.pack(f"{order}I", len(props)) + fields


def segment(entries, raw, flags, *, order="<", length=None):
    meta = struct.pack(f"{order}I", len(entries)) + b"".join(entries) if entries else b""
    flags |= (META | NEW_LIST if entries else 0) | (RAW if raw else 0)
    flags |= BIG if order == ">" else 0
    size = len(meta) + len(raw) if length is None else length
    lead = b"TDSm" + struct.pack("<I", flags)
    return lead + struct.pack(f"{order}IQQ", 4713, size, len(meta)) + meta + raw


def floats(*values, order="<", letter="d"):
    return struct.pack(f"{order}{len(values)}{letter}", *values)


ROOT = entry("/", index(None, 0), {"name": "run 7"})
GROUP = entry("/'axis'", index(None, 0), {})
TIMING = {"wf_start_time": (START, 2**63), "wf_start_offset": 0.0, "wf_increment": 0.25}
VOLTS = {
    "unit_string": "mV",
    "NI_Scaling_Status": "unscaled",
    "NI_Number_Of_Scales": 1,
    "NI_Scale[0]_Scale_Type": "Linear",
    "NI_Scale[0]_Linear_Slope": 0.5,
    "NI_Scale[0]_Linear_Y_Intercept": -2.0,
    "NI_Scale[0]_Linear_Input_Source": 0xFFFFFFFF,
}
PROBE, SENSOR = "/'axis'/'probe'", "/'axis'/'sensor'"


def two_segments():
    """Return a file whose second segment has no metadata but two chunks."""
    first = [
        ROOT,
        GROUP,
        entry(PROBE, index("f8", 2), {**TIMING, "unit_string": "um"}),
        entry(SENSOR, index("i2", 2), {**TIMING, **VOLTS}),
    ]
    data = segment(first, floats(1.5, -2.5) + floats(10, 20, letter="h"), 0)
    more = (
        floats(3.5, 4.5)
        + floats(30, -40, letter="h")
        + floats(5.5, 6.5)
        + floats(7, 8, letter="h")
    )
    return data + segment([], more, 0)


def big_endian_rows():
    first = [
        entry("/'a'/'x''y'", index("f4", 3, ">"), {"wf_increment": 0.5}, ">"),
        entry(
            "/'b'/'probe'", index("i2", 3, ">"), {"wf_increment": 0.5, "wf_start_offset": 0.0}, ">"
        ),
    ]
    rows = b"".join(struct.pack(">fh", x, y) for x, y in ((0.5, 1), (-1.5, -2), (2.5, 300)))
    return segment(first, rows, INTERLEAVED, order=">")


def daqmx_rows():
    scale = {
        "NI_Number_Of_Scales": 2,
        "NI_Scale[1]_Scale_Type": "Polynomial",
        "NI_Scale[1]_Polynomial_Coefficients_Size": 3,
        "NI_Scale[1]_Polynomial_Coefficients[0]": 1.0,
        "NI_Scale[1]_Polynomial_Coefficients[1]": 0.5,
        "NI_Scale[1]_Polynomial_Coefficients[2]": 0.25,
        "NI_Scale[1]_Polynomial_Input_Source": 0,
        "wf_increment": 0.5,
        "unit_string": "V",
    }
    first = [
        entry(PROBE, daqmx_index(2, 0, 6), scale),
        entry(SENSOR, daqmx_index(2, 4, 6), scale),
    ]
    rows = struct.pack("<12h", 2, 99, -2, 4, 99, 6, 8, 99, -10, 0, 99, 12)
    return segment(first, rows, DAQMX)


def interrupted():
    first = [
        entry(PROBE, index("f8", 3), {"wf_increment": 0.5, "unit_string": "mm"}),
        entry(SENSOR, index("f8", 3), {"wf_increment": 0.5}),
    ]
    raw = floats(1.5, 2.5, 3.5) + floats(10.5, 20.5) + b"\x00\x01\x02"
    return segment(first, raw, 0, length=OPEN_END)


def with_text():
    first = [
        entry("/'g'/'time'", index("f8", 2), {"unit_string": "ms"}),
        entry("/'g'/'note'", strings_index(["on", "off"]), {}),
        entry("/'g'/'probe'", index("f8", 2), {"unit_string": "nm"}),
    ]
    return segment(first, floats(1.0, 2.5) + strings(["on", "off"]) + floats(-7.0, 9.0), 0)


TRUTHS = {
    "two-segments.tdms": (
        two_segments(),
        [0.25 * k for k in range(6)],
        {
            "probe": [v * 1e-6 for v in (1.5, -2.5, 3.5, 4.5, 5.5, 6.5)],
            "sensor": [(0.5 * v - 2.0) * 1e-3 for v in (10, 20, 30, -40, 7, 8)],
        },
        {},
    ),
    "big-endian-rows.tdms": (
        big_endian_rows(),
        [0.0, 0.5, 1.0],
        {"a/x'y": [0.5, -1.5, 2.5], "b/probe": [1, -2, 300]},
        {},
    ),
    "daqmx.tdms": (
        daqmx_rows(),
        [0.0, 0.5, 1.0, 1.5],
        {
            "probe": [1 + 0.5 * v + 0.25 * v * v for v in (2, 4, 8, 0)],
            "sensor": [1 + 0.5 * v + 0.25 * v * v for v in (-2, 6, -10, 12)],
        },
        {},
    ),
    "interrupted.tdms": (
        interrupted(),
        [0.0, 0.5, 1.0],
        {"probe": [1.5e-3, 2.5e-3, 3.5e-3], "sensor": [10.5, 20.5, None]},
        {"warnings_match": "was not finished"},
    ),
    "time-channel.tdms": (
        with_text(),
        [1e-3, 2.5e-3],
        {"probe": [-7e-9, 9e-9]},
        {"options": {"time": "time"}, "warnings_match": "omitted: note"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    files = {name: data for name, (data, *_) in TRUTHS.items()}
    truths = {}
    for name, (_, t, channels, more) in TRUTHS.items():
        truths[name] = {"kind": "recording", "t_s": t, "channels": channels, **more}
    whole = files["two-segments.tdms"]
    second = whole.rindex(b"TDSm")
    lost = whole[:second] + whole[second + 1 :]
    absurd = bytearray(segment([entry(PROBE, index("f8", 2**40), TIMING)], floats(1.5, 2.5), 0))
    for name, data, match in (
        ("lost-byte.tdms", lost, "does not begin where the one before ends"),
        ("absurd-count.tdms", bytes(absurd), "do not fill a chunk"),
    ):
        files[name] = data
        truths[name] = {"error": "CorruptFileError", "match": match}
    for name, data in files.items():
        (folder / "samples" / name).write_bytes(data)
        truth = json.dumps(truths[name], indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(truth, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
