"""Files as spreadsheets, loggers, data acquisition, probes and lasers write them, typed by hand.

Each goes through the command line and the written file is judged: every number, or the refusal.
"""

import math
import re

import numpy as np
import pytest

CASES = []
SAME = 1e-12
"""Relative difference of two numbers that differ only in how SI factors are multiplied."""


def case(name, text, *options, enc="utf-8", **expected):
    content = text.encode(enc) if isinstance(text, str) else text
    CASES.append(pytest.param(name, content, options, expected, id=name))


W = [0.5, -1.25, 0.75, 2.0]
# 1 German spreadsheet
case(
    "excel-de.csv",
    "Position [mm];Abweichung [µm]\r\n0,000;0,5\r\n0,100;-1,25\r\n0,200;0,75\r\n0,300;2\r\n;\r\n",
    enc="cp1252",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[0.5e-6, -1.25e-6, 0.75e-6, 2e-6],
)
# 2 BenchLink
case(
    "benchlink.csv",
    "Name:,Straightness\nOwner:,admin\nAcquisition Date:,03/05/2026 14:07:01\nTotal Channels:,1\n\nScan,Time,101 (VDC),Alarm 101\n1,03/05/2026 14:07:09:120,0.5,0\n2,03/05/2026 14:07:09:220,-1.25,0\n3,03/05/2026 14:07:09:320,0.75,0\n4,03/05/2026 14:07:09:420,2.0,0\n",
    t=[0, 0.1, 0.2, 0.3],
    c={"101 (VDC)": W},
)
# 3 picoscope
case(
    "picoscope.csv",
    "Time,Channel A\n(ms),(V)\n\n-10.00000000,0.50000000\n-9.00000000,-1.25000000\n-8.00000000,0.75000000\n-7.00000000,2.00000000\n",
    t=[-0.01, -0.009, -0.008, -0.007],
    c={"Channel A": W},
)
# 4 tektronix
case(
    "tek.csv",
    "Model,DPO2024B\nFirmware Version,1.52\n\nWaveform Type,ANALOG\nPoint Format,Y\nHorizontal Units,s\nHorizontal Scale,4e-06\nSample Interval,4e-08\nRecord Length,4\nProbe Attenuation,10\nVertical Units,V\nVertical Offset,0\n\nTIME,CH1\n"
    + "".join(f"{-2e-8 + 4e-8 * i:.1e},{v}\n" for i, v in enumerate(W * 5)),
    "--set",
    "time=TIME:s",
    t=[float(f"{-2e-8 + 4e-8 * i:.1e}") for i in range(20)],
    c={"CH1": W * 5},
)
# 5 labview spreadsheet, trailing tabs, decimal commas
case(
    "labview.txt",
    "0,000\t0,500\t\r\n0,100\t-1,250\t\r\n0,200\t0,750\t\r\n0,300\t2,000\t\r\n",
    "--set",
    "unit=mm,um",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[0.5e-6, -1.25e-6, 0.75e-6, 2e-6],
)
# 6 siemens trace
case(
    "sinamics.csv",
    'sep=;\n"Zeit [ms]";"Lageistwert [µm]"\n"0,00";"0,50"\n"0,25";"-1,25"\n"0,50";"0,75"\n"0,75";"2,00"\n',
    enc="utf-8-sig",
    t=[0, 0.25e-3, 0.5e-3, 0.75e-3],
    c={"Lageistwert": [v * 1e-6 for v in W]},
)
# 7 climate logger
case(
    "testo.csv",
    "Gerät:;testo 175 H1\nStartzeit:;05.03.2026 23:59:00\n\nDatum;Uhrzeit;Abstand [µm];Temp. [°C]\n05.03.2026;23:59:00;0,5;20,1\n05.03.2026;23:59:30;-1,25;20,1\n06.03.2026;00:00:00;0,75;20,2\n06.03.2026;00:00:30;2,0;20,2\n\nMin.:;;-1,25;20,1\nMax.:;;2,0;20,2\n",
    enc="cp1252",
    t=[0, 30, 60, 90],
    c={"Abstand": [v * 1e-6 for v in W]},
)
# 8 catman
case(
    "catman.asc",
    "HBM_CATMAN_DATAFILE_40\r\nName:\tVersuch 3\r\nKanäle:\t2\r\n\r\nZeit\tTaster 1\r\ns\tµm\r\n0,0000E+00\t5,0000E-01\t\r\n1,0000E-03\t-1,2500E+00\t\r\n2,0000E-03\t7,5000E-01\t\r\n3,0000E-03\t2,0000E+00\t\r\n",
    enc="cp1252",
    t=[0, 1e-3, 2e-3, 3e-3],
    c={"Taster 1": [v * 1e-6 for v in W]},
)
# 9 micro-epsilon
case(
    "sensortool.csv",
    "sensorTOOL 1.14\nSensor;DT1420-10\n\nZeit [ms];Abstand 1 [mm]\n0,0;0,0005\n0,5;-0,00125\n1,0;Out of range\n1,5;0,002\n",
    t=[0, 0.5e-3, 1e-3, 1.5e-3],
    c={"Abstand 1": [0.5e-6, -1.25e-6, float("nan"), 2e-6]},
)
# 10 epoch ms without unit
case(
    "epoch.csv",
    "timestamp,gap_um\n1767225600000,0.5\n1767225600010,-1.25\n1767225600020,0.75\n1767225600030,2.0\n",
    "--set",
    "time=timestamp:ms",
    dt=0.01,
    c={"gap": [v * 1e-6 for v in W]},
)
# 11 clock over midnight
case(
    "midnight.csv",
    "time,gap_um\n23:59:59.50,0.5\n23:59:59.75,-1.25\n00:00:00.00,0.75\n00:00:00.25,2.0\n",
    t=[0, 0.25, 0.5, 0.75],
    c={"gap": [v * 1e-6 for v in W]},
)
# 12 iso
case(
    "iso.csv",
    "time,gap_um\n2026-03-05T14:07:09.120Z,0.5\n2026-03-05T14:07:09.130Z,-1.25\n2026-03-05T14:07:09.140Z,0.75\n2026-03-05T14:07:09.150Z,2.0\n",
    t=[0, 0.01, 0.02, 0.03],
    c={"gap": [v * 1e-6 for v in W]},
)
# 13 us am pm
case(
    "excel-us.csv",
    "Timestamp,Gap [um]\n3/5/2026 11:59:59 AM,0.5\n3/5/2026 12:00:00 PM,-1.25\n3/5/2026 12:00:01 PM,0.75\n3/5/2026 12:00:02 PM,2.0\n",
    t=[0, 1, 2, 3],
    c={"Gap": [v * 1e-6 for v in W]},
)
# 14 runs in blocks with comments
R = [
    f"# run {k} feed 2000\n"
    + "".join(f"{x:.1f} {z}\n" for x, z in zip((0, 0.1, 0.2, 0.3), W, strict=True))
    for k in (1, 2)
]
case("blocks.txt", "x_mm z_um\n" + "".join(R), check="2 runs", runs=2)
# 15 cat of files, header repeated
B = "x_mm,z_um\n" + "".join(f"{x:.1f},{z}\n" for x, z in zip((0, 0.1, 0.2, 0.3), W, strict=True))
case("cat.csv", B + B + B, check="3 runs", runs=3)
# 16 fixed width
case(
    "fixed.dat",
    "   X (mm)      Z (um)\n"
    + "".join(f"{x:9.3f}{z:12.4f}\n" for x, z in zip((0, 0.1, 0.2, 0.3), W, strict=True)),
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 17 nbsp thousands
case(
    "nbsp.csv",
    "Weg [µm];Höhe [nm]\n0,00;1\u00a0234,5\n100,00;-2\u00a0345,25\n1\u00a0200,00;12,5\n2\u00a0300,00;0\n",
    x=[0, 1e-4, 1.2e-3, 2.3e-3],
    z=[1234.5e-9, -2345.25e-9, 12.5e-9, 0],
)
# 18 excel unicode text
case(
    "unicode.txt",
    "Position [mm]\tHeight [µm]\r\n0\t0.5\r\n0.1\t-1.25\r\n0.2\t0.75\r\n0.3\t2\r\n",
    enc="utf-16",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 19 trailing separators only in rows
case(
    "trailing.csv",
    "x_mm,z_um\n0,0.5,\n0.1,-1.25,\n0.2,0.75,\n0.3,2,\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 20 text columns
case(
    "status.csv",
    "x_mm,z_um,status,operator\n0,0.5,OK,Müller\n0.1,-1.25,OK,Müller\n0.2,0.75,WARN,Müller\n0.3,2,OK,Müller\n",
    "--set",
    "x=x_mm",
    "--set",
    "z=z_um",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
case(
    "status2.csv",
    "x_mm,z_um,operator\n0,0.5,Müller\n0.1,-1.25,Müller\n0.2,0.75,Müller\n0.3,2,Müller\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 21 empty column between
case(
    "gapcol.csv",
    "x_mm,,z_um\n0,,0.5\n0.1,,-1.25\n0.2,,0.75\n0.3,,2\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 22 marker
case(
    "marker.csv",
    "x_mm,z_um\n0,0.5\n0.1,-9999\n0.2,0.75\n0.3,2\n0.4,1\n",
    "--set",
    "missing=-9999",
    x=[0, 1e-4, 2e-4, 3e-4, 4e-4],
    z=[0.5e-6, float("nan"), 0.75e-6, 2e-6, 1e-6],
)
case(
    "marker0.csv", "x_mm,z_um\n0,0.5\n0.1,-9999\n0.2,0.75\n0.3,2\n0.4,1\n", error="-9999.*missing"
)
# 23 index column, unit row
case(
    "index.csv",
    "No.,X,Z\n-,mm,um\n1,0,0.5\n2,0.1,-1.25\n3,0.2,0.75\n4,0.3,2\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 24 pandas index
case(
    "pandas.csv",
    ",x_mm,z_um\n0,0.0,0.5\n1,0.1,-1.25\n2,0.2,0.75\n3,0.3,2.0\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 25 R write.csv
case(
    "r.csv",
    '"","x_mm","z_um"\n"1",0,0.5\n"2",0.1,-1.25\n"3",0.2,0.75\n"4",0.3,2\n',
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 26 R write.table
case(
    "r.txt",
    '"x_mm" "z_um"\n"1" 0 0.5\n"2" 0.1 -1.25\n"3" 0.2 0.75\n"4" 0.3 2\n',
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 27 feeds
case(
    "rpm.csv",
    "position [mm],error [um],spindle [1/min],feed [in/min]\n0,0.5,3000,40\n0.1,-1.25,3000,40\n0.2,0.75,3000,40\n0.3,2,3000,40\n",
    "--set",
    "x=position",
    "--set",
    "z=error",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
case(
    "rpm-row.csv",
    "Weg;Abweichung;Drehzahl\nmm;µm;1/min\n0;0,5;3000\n0,1;-1,25;3000\n0,2;0,75;3000\n0,3;2;3000\n",
    "--set",
    "x=Weg",
    "--set",
    "z=Abweichung",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 28 french
case(
    "fr.csv",
    "Essai du 05/03/2026\r\nOpérateur : Lefèvre\r\n\r\nAbscisse (mm);Écart (µm);\r\n0,0;0,5;\r\n0,1;-1,25;\r\n0,2;0,75;\r\n0,3;2,0;\r\n",
    enc="cp1252",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
case(
    "it.csv",
    "Posizione [mm];Scostamento [µm]\n0,0;0,5\n0,1;-1,25\n0,2;0,75\n0,3;2,0\nMedia;0,5\nDev. std;1,36\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
case(
    "es.csv",
    "Posición (mm)|Desviación (µm)\n0.0|0.5\n0.1|-1.25\n0.2|0.75\n0.3|2.0\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
case(
    "ja.csv",
    "測定日時,2026/03/05 14:07:09\r\n位置(mm),高さ(μm)\r\n０．０,０．５\r\n０．１,－１．２５\r\n０．２,０．７５\r\n０．３,２．０\r\n",
    enc="cp932",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
case(
    "zh.csv",
    "操作员：王\n位置(毫米),偏差(微米)\n0.0,0.5\n0.1,-1.25\n0.2,0.75\n0.3,2.0\n",
    enc="gb18030",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 34 mac
case(
    "mac.csv",
    "Position (mm);Höhe (µm)\r0,0;0,5\r0,1;-1,25\r0,2;0,75\r0,3;2,0\r",
    enc="mac_roman",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 35 two-row header with spans
case(
    "spans.csv",
    "Axis,Probe,\nX,Z1,Z2\nmm,um,um\n0,0.5,1\n0.1,-1.25,2\n0.2,0.75,3\n0.3,2,4\n",
    "--set",
    "x=X",
    "--set",
    "z=Z1",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 36 fortran
case(
    "fortran.out",
    "  X[MM]        Z[UM]\n 0.0000D+00   5.0000D-01\n 1.0000D-01  -1.2500D+00\n 2.0000D-01   7.5000D-01\n 3.0000D-01   2.0000D+00\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 37 quoted decimal comma, comma separated
case(
    "quoted.csv",
    '"Position [mm]","Höhe [µm]"\n"0,0","0,5"\n"0,1","-1,25"\n"0,2","0,75"\n"0,3","2,0"\n',
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 38 savetxt
case(
    "savetxt.txt",
    "# x[mm] z[um]\n0.000000000000000000e+00 5.000000000000000000e-01\n1.000000000000000056e-01 -1.250000000000000000e+00\n2.000000000000000111e-01 7.500000000000000000e-01\n2.999999999999999889e-01 2.0e+00\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 39 origin
case(
    "origin.dat",
    "Position\tHeight\nmm\tµm\nX axis\tLK-G5000 head 1\n0\t0.5\n0.1\t-1.25\n0.2\t0.75\n0.3\t2\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 40 keyence -FFFFFFF
case(
    "keyence.csv",
    "X(mm),OUT1(um)\n0,+000.500\n0.1,-001.250\n0.2,-FFFFFFF\n0.3,+002.000\n",
    "--set",
    "missing=-FFFFFFF",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[0.5e-6, -1.25e-6, float("nan"), 2e-6],
)
case(
    "keyence0.csv",
    "X(mm),OUT1(um)\n0,+000.500\n0.1,-001.250\n0.2,-FFFFFFF\n0.3,+002.000\n",
    error="line 4.*missing",
)
# 41 tds old
case(
    "tds.csv",
    "Record Length,4.0e+00,,-0.02,0.5\nSample Interval,1.0e-02,,-0.01,-1.25\nVertical Units,V,,0.0,0.75\n,,,0.01,2.0\n",
    error=".",
)
# 42 tabs mixed with blanks
case(
    "mixed.txt",
    "x_mm \t z_um\n0.0\t 0.5\n0.1 \t-1.25\n 0.2\t0.75\n0.3   2.0\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 43 units between header words
case(
    "words.csv",
    "Travel in mm, Straightness error in um\n0.0, 0.5\n0.1, -1.25\n0.2, 0.75\n0.3, 2.0\n",
    x=[0, 1e-4, 2e-4, 3e-4],
    z=[v * 1e-6 for v in W],
)
# 44 ditto header end -999 etc  runs w/ run number
case(
    "runs.csv",
    "Lauf;Weg [mm];Messwert [µm];Vorschub [mm/min]\n"
    + "".join(
        f"{k};{str(x).replace('.', ',')};{str(z).replace('.', ',')};{2000 * k}\n"
        for k in (1, 2)
        for x, z in zip((0, 0.1, 0.2, 0.3), W, strict=True)
    ),
    check="2 runs",
    runs=2,
)
# 45 run column filled only at first row
case(
    "runfill.csv",
    "run,x_mm,z_um\n"
    + "".join(
        f"{k if i == 0 else ''},{x},{z}\n"
        for k in (1, 2)
        for i, (x, z) in enumerate(zip([round(0.1 * j, 1) for j in range(16)], W * 4, strict=True))
    ),
    check="2 runs one below",
    runs=2,
)
# 46 elapsed
case(
    "elapsed.csv",
    "Elapsed;gap [µm]\n00:00:00,0;0,5\n00:00:00,5;-1,25\n00:00:01,0;0,75\n00:00:01,5;2,0\n",
    t=[0, 0.5, 1, 1.5],
    c={"gap": [v * 1e-6 for v in W]},
)
# 47 d/m/y
case(
    "dmy.csv",
    "Date,Time,Gap (um)\n25/03/2026,14:07:09,0.5\n25/03/2026,14:07:10,-1.25\n25/03/2026,14:07:11,0.75\n25/03/2026,14:07:12,2\n",
    t=[0, 1, 2, 3],
    c={"Gap": [v * 1e-6 for v in W]},
)
# 48 several rows with one stamp
case(
    "coarse.csv",
    "time,gap_um\n" + "".join(f"14:07:{9 + i // 2:02d},{z}\n" for i, z in enumerate(W)),
    error="sampling_rate",
)
# 49 clock falls an hour
case(
    "dst.csv",
    "time,gap_um\n02:59:58,0.5\n02:59:59,-1.25\n02:00:00,0.75\n02:00:01,2.0\n",
    error="3600|summer|falls|back",
)
# 50 ambiguous date
case(
    "ambig.csv",
    "time,gap_um\n05/03/2026 14:07:09,0.5\n05/03/2026 14:07:10,-1.25\n05/03/2026 14:07:11,0.75\n05/03/2026 14:07:12,2\n",
    t=[0, 1, 2, 3],
    c={"gap": [v * 1e-6 for v in W]},
)


# what a second stranger's hour found: 80 files, these were read wrong, not at all, or refused without need
XS = [0, 1e-4, 2e-4, 3e-4]
ZS = [v * 1e-6 for v in W]
ROWS = "0,0.5\n0.1,-1.25{}\n0.2,0.75\n0.3,2\n"
case("remark-field.csv", "x_mm,z_um\n" + ROWS.format(",checked"), x=XS, z=ZS)
case(
    "remark-said.csv",
    "x_mm,z_um\n" + ROWS.format(",checked"),
    check="line 3: 'checked' stands behind",
)
case(
    "remark-words.csv", ("x_mm;z_um\n" + ROWS.replace(",", ";")).format(";wind, door"), x=XS, z=ZS
)
case(
    "remark-tab.txt",
    ("x_mm\tz_um\n" + ROWS.replace(",", "\t")).format("\ton both legs"),
    x=XS,
    z=ZS,
)
case(
    "remark-blank.txt", ("x_mm z_um\n" + ROWS.replace(",", " ")).format(" seen again"), x=XS, z=ZS
)
case("remark-long.csv", "x_mm,z_um\n" + ROWS.format(",,, again"), x=XS, z=ZS)
case("remark-digit.csv", "x_mm,z_um\n" + ROWS.format(",on 2 legs"), error="line 3.*skip_lines=3")
case("third-number.csv", "x_mm,z_um\n" + ROWS.format(",7"), error="line 3.*skip_lines=3")
case("third-unit.csv", "x_mm,z_um\n" + ROWS.format(",nm"), error="line 3.*skip_lines=3")
case("third-bad.csv", "x_mm,z_um\n" + ROWS.format(",bad"), error="line 3.*skip_lines=3")
case("glued-rows.csv", "x_mm,z_um\n" + ROWS.format(",x,0.15,0.3"), error="line 3.*skip_lines=3")
case(
    "cl3000.csv",
    "CL-3000シリーズ\r\n保存日時,2026/03/05 14:07:09\r\nサンプリング周期,1ms\r\n\r\nNo.,時刻,OUT1(mm),OUT2(mm)\r\n"
    "1,14:07:09.000,0.0005,1.0\r\n2,14:07:09.001,-0.00125,1.1\r\n3,14:07:09.002,-------,1.2\r\n"
    "4,14:07:09.003,0.0020,1.3\r\n",
    enc="cp932",
    t=[0, 0.001, 0.002, 0.003],
    c={"OUT1": [0.5e-6, -1.25e-6, float("nan"), 2e-6], "OUT2": [1e-3, 1.1e-3, 1.2e-3, 1.3e-3]},
)
case(
    "agilent.txt",
    "HEADER::\nFilename: x.lin\nDate: 03-05-2026\nEND HEADER\nPosition[mm]   Error[um]\n"
    "   0.0000   0.500\n   0.1000  -1.250\n   0.2000   0.750\n   0.3000   2.000\nEOF\n",
    x=XS,
    z=ZS,
)
case(
    "statistics.csv",
    "Weg [mm];Messwert [µm]\r\n0,0;0,5\r\n0,1;-1,25\r\n0,2;0,75\r\n0,3;2,0\r\n\r\n"
    "Mittelwert;0,5\r\nStandardabweichung;1,36\r\nSpannweite;3,25\r\nn;4\r\n",
    enc="cp1252",
    x=XS,
    z=ZS,
)
case(
    "russian.csv",
    "Координата, мм;Отклонение, мкм\r\n0,0;0,5\r\n0,1;-1,25\r\n0,2;0,75\r\n0,3;2,0\r\n",
    enc="cp1251",
    x=XS,
    z=ZS,
)
case(
    "empty-first-column.csv",
    ";Weg [mm];Abw. [µm];\n;0,0;0,5;\n;0,1;-1,25;\n;0,2;0,75;\n;0,3;2,0;\n",
    x=XS,
    z=ZS,
)
case(
    "signed-over.txt",
    "Pos [mm]\tGap [um]\n0.0\t0.5\n0.1\t+OVER\n0.2\t-OVER\n0.3\t*****\n0.4\t------\n0.5\t2.0\n",
    x=[i * 1e-4 for i in range(6)],
    z=[0.5e-6, *[float("nan")] * 4, 2e-6],
)
case(
    "unit-row-of-others.csv",
    "Zeit;Weg;Kraft;Bemerkung\n[s];[µm];[N];\n0,0;0,5;1;\n0,1;-1,25;2;\n0,2;0,75;3;\n0,3;2,0;4;\n",
    enc="cp1252",
    t=[0, 0.1, 0.2, 0.3],
    c={"Weg": ZS, "Kraft": [1, 2, 3, 4]},
)
case(
    "unit-row-of-air.csv",
    "Zeit\tWeg\tTemperatur\ts0\ns\tµm\t°C\t-\n0\t0,5\t20,1\t1\n1\t-1,25\t20,2\t2\n2\t0,75\t20,3\t3\n"
    "3\t2,0\t20,4\t4\n",
    enc="cp1252",
    t=[0, 1, 2, 3],
    c={"Weg": ZS, "Temperatur": [20.1, 20.2, 20.3, 20.4], "s0": [1, 2, 3, 4]},
)
case(
    "joined.csv",
    b"\xef\xbb\xbfx_mm,z_um\n0,0.5\n0.1,-1.25\n\xef\xbb\xbfx_mm,z_um\n0.2,0.75\n0.3,2\n",
    x=XS,
    z=ZS,
)
case("dos.txt", b"x_mm z_um\r\n0 0.5\r\n0.1 -1.25\r\n0.2 0.75\r\n0.3 2\r\n\x1a", x=XS, z=ZS)
case(
    "ruled.md",
    "| x_mm | z_um |\n|------|------|\n| 0.0 | 0.5 |\n| 0.1 | -1.25 |\n| 0.2 | 0.75 |\n| 0.3 | 2.0 |\n",
    x=XS,
    z=ZS,
)
case(
    "full-width.csv",
    "位置（ｍｍ）,高さ（μｍ）\r\n０．０,０．５\r\n０．１,－１．２５\r\n０．２,０．７５\r\n０．３,２．０\r\n",
    enc="cp932",
    x=XS,
    z=ZS,
)
case(
    "dash-for-minus.csv",
    b"x_mm;z_um\r\n0;0,5\r\n0,1;\x961,25\r\n0,2;0,75\r\n0,3;2\r\n",
    x=XS,
    z=ZS,
)


# names and remarks in quotes over several lines: every line is counted, no row is swallowed
XN = [round(0.1 * i, 1) for i in range(20)]
ZN = [round((i * 7 % 11 - 5) * 0.13 + 0.01 * i, 2) for i in range(20)]
LONG = {"x": [v * 1e-3 for v in XN], "z": [v * 1e-6 for v in ZN]}


def long(row, **changed):
    """Return twenty rows, some of them written otherwise."""
    rows = (changed.get(f"r{i}", row).format(x=XN[i], z=ZN[i]) for i in range(20))
    return "".join(f"{text}\n" for text in rows)


case("alt-enter.csv", '"Position\n[mm]","Error\n[um]"\n' + long("{x},{z}"), **LONG)
NOTED = "x_mm,z_um,note\n"
case("note.csv", NOTED + long("{x},{z},", r5='{x},{z},"a\nb, c\nd"'), **LONG)
case("first.csv", "x_mm,note,z_um\n" + long("{x},,{z}", r0='{x},"a\nb",{z}'), **LONG)
case("open.csv", NOTED + long("{x},{z},", r5='{x},{z},"a'), error="line 7.*skip_lines=7")
case(
    "swallowed.csv",
    NOTED + long("{x},{z},", r5='{x},{z},"a', r6='{x},{z},b"'),
    error="line 7.*skip_lines=7",
)
case(
    "swallowed-many.csv",
    NOTED + long("{x},{z},", r5='{x},{z},"a', r9='{x},{z},b"'),
    error="line 7.*skip_lines=7",
)
# numbers with their unit in every row
case("quantities.csv", "x;z\n" + long("{x} mm;{z} um"), **LONG)
case("quantity.csv", "x_mm;z\n" + long("{x};{z}µm"), **LONG)
case("comma.csv", ("x;z\n" + long("{x} mm;{z} um")).replace(".", ","), **LONG)
case("other-unit.csv", "x;z_um\n" + long("{x} mm;{z}", r7="{x} cm;{z}"), error="line 9")
case("bare.csv", "x;z_um\n" + long("{x} mm;{z}", r7="{x};{z}"), error="line 9")
case("one-unit.csv", "x_mm;z_um\n" + long("{x};{z}", r7="{x} mm;{z}"), error="line 9")
case("contradiction.csv", "x_um;z_um\n" + long("{x} mm;{z}"), error="line 2")
case("sections.txt", "[Header]\nRate=1kHz\n[Data]\nx_mm\tz_um\n" + long("{x}\t{z}"), **LONG)
case("hash-units.txt", "#x  z\n#mm um\n" + long("{x} {z}"), **LONG)
case("zeros.csv", ("x_mm,z_um\n" + long("{x},{z}")).encode() + bytes(200), error="line 22")
case(
    "there-and-back.csv",
    "x_mm,z_um\n0,0.5\n0.1,-1.25\n0.2,0.75\n0.2,0.8\n0.1,1.5\n0,2\n",
    error="skip_lines=5-7",
)
case(
    "there-only.csv",
    "x_mm,z_um\n0,0.5\n0.1,-1.25\n0.2,0.75\n0.2,0.8\n0.1,1.5\n0,2\n",
    "--set",
    "skip_lines=5-7",
    x=[0, 1e-4, 2e-4],
    z=[v * 1e-6 for v in W[:3]],
)
BOTH = "".join(
    f"{r};{d};{x};{z}\n".replace(".", ",")
    for r in (1, 2)
    for d, step in (("vor", 1), ("zurück", -1))
    for x, z in list(zip(XN, ZN, strict=True))[::step]
)
case("both-ways.csv", "Lauf;Richtung;Soll [mm];Abw. [µm]\n" + BOTH, check="--direction Richtung")


def columns_of(path):
    lines = [s for s in path.read_text(encoding="utf-8").split("\n") if s and s[0] != "#"]
    rows = [[float(v or "nan") for v in s.split(",")] for s in lines[1:]]
    return lines[0].split(","), np.array(rows).T


def is_same(found, wanted):
    pairs = zip(found.tolist(), wanted, strict=True)
    return all(
        (math.isnan(a) and math.isnan(b)) or abs(a - b) <= SAME * max(abs(b), SAME)
        for a, b in pairs
    )


@pytest.mark.parametrize(("name", "content", "options", "expected"), CASES)
def test_an_untidy_file_gives_its_numbers_or_is_refused_by_name(
    name, content, options, expected, tmp_path, metrosep
):
    path, target = tmp_path / name, tmp_path / "out.csv"
    path.write_bytes(content)
    if "check" in expected:
        code, out, _ = metrosep("check", path)
        assert code == 0
        assert re.search(expected["check"], out)
        return
    code, out, err = metrosep("convert", path, target, *options)
    if "error" in expected:
        assert code not in (0, 5)
        assert re.search(expected["error"], out + err, re.DOTALL)
        return
    assert code == 0, err
    names, columns = columns_of(target)
    if "x" in expected:
        assert is_same(columns[0], expected["x"])
        assert is_same(columns[1], expected["z"])
    if "t" in expected:
        assert np.abs(columns[0] - expected["t"]).max() < 1e-9  # a nanosecond
    for start, values in expected.get("c", {}).items():
        (k,) = [i for i, n in enumerate(names) if n.startswith(start)]
        assert is_same(columns[k], values)
