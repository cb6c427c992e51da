"""Write the samples of Parquet and Feather tables; metrosep is not imported.

They were written once by pyarrow, whose version stands in each file.
Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import base64
import json
import sys
import zlib
from pathlib import Path

X_MM = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
Z_UM = [1.25, -3.5, None, 7.0, 2.0, -0.5]
TABLE = (
    "eNplUk1LAlEUfTMNg8gs2jyZgVm4cSBS0yAXJeSdyVJCUqNMEELFNNC0MR1x2U+IVv2Z/Cn+hBYtWnbfB9rQ5Q3n"
    "vvvuOecO3CrUs5TQIR0mqYGJTnWbEKLiZygkFOtTgV8SfySSggCtgPwWbf0T2jkRDd+SYKwE2oWwwPqTalb+iJj6"
    "tDvojdpUIzSaUE1tcT8aiVRZkphh2VbSITaNWgmdWOKZYj32puBxImUb/QlVSX5PtxxioPSfdmXJe18VPM6HEm5W"
    "o9gce1djhhNBIJZtGlCvXzWOxUjmSj1gsd8HjBqIuAQIwO3DOUAfPP4ErgtQYYkHUOaFLYJIPX6/kCLFPjQZH3VK"
    "TI/ruzVWF1Gr3DC45peQP2Mz5RxsqoE0CaTvtn/r72Y7NXkv3c7ad0JuMcf/C7gF9/f4iF04k+QibObhhBKERxF6"
    "g4dOI4NJU/Kb8rUMxIxP2v7zrPeS6k4mqbbvj4P4vOdPH8dP8cNcOpPOWklcHbY9u7g+VdzQX24jiXE="
)
FEATHER = (
    "eNpzDAryDzdkYPgPBCsYGBgEGECAi4GHgY2BlYEDyAICRhYgnwHI4wCSLFCSgYEJiF2g7CtA/UCFzCD9ElAxEGAD"
    "4vTEgvi8XAaGY2A1TEA7RIBmsDGwg00VgNrJyAWiZZD0guiSzNxUkCkg9WxgUWYwCXLvDiAtAlXLwyAGdTEP2FQG"
    "ZhawOzIYYIALyOcBux7kpxioX9kYEICFATcwQKMZobQFmjgDNFzY0PSzoeljcHphI/N9pgTD8q1RYJqnuQJMFwZM"
    "A9PXZLeAaevXF0G0NYppX+yhvj6AaouMA5QBpR/s/w8Oc4hfeYChxQYOIQFIGAF9DHK/BtTvILftgBoAMzgDzR+D"
    "JQ1cAJKO4LQLAKGQSW8="
)


def unpacked(text):
    return zlib.decompress(base64.b64decode(text))


HEIGHTS = [None if z is None else z * 1e-6 for z in Z_UM]
PROFILE = {"kind": "profile", "shape": [6], "x_m": [x * 1e-3 for x in X_MM], "z_m": HEIGHTS}
GAP = [None if z is None else z * 1e-9 for z in Z_UM]
CASES = {
    "profile.parquet": (unpacked(TABLE), PROFILE),
    "recording.feather": (
        unpacked(FEATHER),
        {"kind": "recording", "t_s": [0.5 * k for k in range(6)], "channels": {"gap_nm": GAP}},
    ),
    "cut-off.parquet": (
        unpacked(TABLE)[:200],
        {"error": "CorruptFileError", "match": "cannot be read"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (data, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(data)
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
