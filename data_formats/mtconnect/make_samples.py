"""Write the samples of MTConnect logs as plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

LINES = """* adapterVersion: 2.0
2014-07-15T07:04:25.608Z|avail|AVAILABLE|Xpos|1.5
2014-07-15T07:04:25.858Z|Xpos|-2.25|Zpos|0.125
2014-07-15T07:04:26.608Z|Zpos|UNAVAILABLE
2014-07-15T07:04:26.608Z|system|FAULT|17|2|HIGH|door open
2014-07-15T07:04:27.608Z|Xpos|40
"""
STREAMS = """<?xml version="1.0" encoding="UTF-8"?>
<MTConnectStreams xmlns="urn:mtconnect.org:MTConnectStreams:1.3"><Streams><DeviceStream><ComponentStream>
<Samples><Position dataItemId="Xpos" timestamp="2014-07-15T07:04:25.608Z" subType="ACTUAL">1.5</Position>
<Position dataItemId="Xpos" timestamp="2014-07-15T07:04:25.858Z" subType="ACTUAL">-2.25</Position>
<Position dataItemId="Xpos" timestamp="2014-07-15T07:04:27.608Z">40</Position>
<Position dataItemId="Zpos" timestamp="2014-07-15T07:04:26.608Z">UNAVAILABLE</Position>
<Position dataItemId="Zpos" timestamp="2014-07-15T07:04:25.858Z">0.125</Position></Samples>
<Events><Execution dataItemId="exec" timestamp="2014-07-15T07:04:25.608Z">ACTIVE</Execution></Events>
</ComponentStream></DeviceStream></Streams></MTConnectStreams>
"""
TRUTH = {"kind": "recording", "t_s": [0.0, 0.25, 1.0, 2.0],
         "channels": {"Xpos": [1.5, -2.25, None, 40.0], "Zpos": [None, 0.125, None, None]}}  # fmt: skip
ONE = {"kind": "recording", "t_s": [0.0, 0.25, 2.0], "channels": {"Xpos": [1.5, -2.25, 40.0]},
       "options": {"channel": "Xpos"}}  # fmt: skip
BODY = LINES.partition("\n")[2]
CASES = {
    "adapter.log": (BODY, TRUTH | {"warnings_match": "avail (1)"}),
    "agent.xml": (STREAMS, TRUTH),
    "one-item.log": (BODY, ONE),
    "no-value.log": (BODY + "2014-07-15T07:04:28.608Z|Xpos\n", {"error": "CorruptFileError", "match": "line 6"}),
    "no-such-day.log": (BODY.replace("15T07:04:27", "35T07:04:27"), {"error": "CorruptFileError", "match": "line 5"}),
    "texts-only.log": (BODY.splitlines()[0].partition("|Xpos")[0] + "\n",
                       {"error": "CorruptFileError", "match": "no item holds a number"}),
    "doctype.xml": (STREAMS.replace("<MTC", '<!DOCTYPE x [<!ENTITY a "b">]><MTC', 1),
                    {"error": "CorruptFileError", "match": "not well-formed"}),
}  # fmt: skip


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (data, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(data.encode("utf-8"))
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
