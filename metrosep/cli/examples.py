"""Calls to copy, shown first in the help of each command."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "info": ("metrosep info part.x3p", "metrosep info runs.csv --json"),
    "check": ("metrosep check runs.csv", "metrosep check recipe.toml --explain"),
    "convert": ("metrosep convert part.dat part.x3p", 'metrosep convert slices.xyz map.h5 --unit "mm,mm,um"'),
    "measure": (
        'metrosep measure part.x3p --form plane --params Sq,Sz --upper "Sq=5 nm" --U "Sq=0.3 nm" -o out',
        'metrosep measure part.x3p --form sphere --upper "Sq=5 nm" --U "Sq=0.3 nm" --print-recipe > qa.toml',
    ),
    "form": (
        'metrosep form part.x3p --form "conic: R=50 mm" --free R',
        'metrosep form part.x3p --form "sphere: R=50 mm" --residual error.x3p',
    ),
    "psd": ('metrosep psd part.x3p --limit "rms = 5 nm from 0.1 mm to 5 mm"',),
    "geometry": (
        'metrosep geometry step_height groove.csv --x x_um --z z_nm --set "width=100 um" --set "middle=300 um"',
        'metrosep geometry cylindricity points.csv --x x_mm --y y_mm --z z_mm --upper "CYLt=2 um" --U "CYLt=0.2 um"',
    ),
    "circle": ('metrosep circle ballbar.csv --radius "150 mm" --feed "1000 mm/min" --plane XY',),
    "verify-softgauge": ('metrosep verify-softgauge gauge.smd --lambda-c "0.8 mm"',),
    "run": (
        "metrosep run recipe.toml runs.csv -o out",
        'metrosep run qa.toml part.x3p -o out -s check.Sq.upper="5 nm"',
    ),
    "batch": (
        """metrosep batch qa.toml maps -o qa -s 'input.files=["*.x3p"]'""",
        "metrosep batch qa.toml maps -o qa --watch",
    ),
    "separate": (
        "metrosep separate runs.csv --x x_mm --z z_um --feed feed_mm_min --run run -o out",
        ("metrosep separate runs.csv --x x_mm --z z_um --feed feed_mm_min --run run --compensates Z "
        "--table linuxcnc=x-z.comp --machine cross_axis=hal"),
        "metrosep separate ball.csv --method donaldson --readings m1_nm,m2_nm --angle angle_deg -o out",
    ),
    "plan": (
        'metrosep plan out --v-min "1000 mm/min" --v-max "9600 mm/min" --runs 4 --wavelengths "2 mm..20 mm"',
    ),
    "calibrate": (
        'metrosep calibrate five_axis ball_1.csv ball_2.csv --pivot-height "80 mm" -o terms',
        "metrosep calibrate mill.toml laser_x.csv level_x.csv -o terms",
    ),
    "thermal": (
        "metrosep thermal log.csv --time t_s --temperature nose_degC,room_degC --reading EZZ_um -o heat",
    ),
    "air": ('metrosep air --temperature "20.3 degC" --pressure "1002 hPa" --humidity "45 %"',),
    "table": (
        "metrosep table out --compensates Z --machine cross_axis=hal -o x-z.comp",
        ("metrosep table laser.csv --target target_mm --direction dir --readings e1_um,e2_um,e3_um "
        "--deviation reached-minus-target --axis X -o x.comp"),
        ("metrosep table laser.csv --target target_mm --direction dir --readings e1_um,e2_um,e3_um "
        "--deviation reached-minus-target --axis X --format sinumerik-enc --machine machine_axis=X1 -o x.INI"),
    ),
    "machine-tables": (
        'metrosep machine-tables mill.toml terms --over X --spacing "10 mm" --at "Y=0 mm" --at "Z=0 mm" -o tables',
        ('metrosep machine-tables five_axis terms --pivot-height "80 mm" --over A,C --spacing "10 deg" '
        '--span "A=-90 deg..30 deg" --span "C=0 deg..360 deg" --at "X=0 mm" --at "Y=0 mm" --at "Z=0 mm" -o tables'),
    ),
    "volume": ('metrosep volume mill.toml terms --tolerance "0.2 um" --span "Z=0 mm..100 mm" -o grid',),
    "path": (
        'metrosep path part.nc --error error.x3p --c-sense +1 --centre middle --tolerance "2 nm" -o corrected.nc',
        'metrosep path pocket.nc --machine five_axis --pivot-height "80 mm" --error terms -o corrected.nc',
    ),
    "verify": (
        "metrosep verify x-z.comp --against new.csv --x x_mm --z z_um --feed feed_mm_min --run run",
        ("metrosep verify x.comp --against laser.csv --target target_mm --direction dir --readings e1_um,e2_um,e3_um "
        "--deviation reached-minus-target"),
    ),
    "read": ('metrosep read five_axis ball.csv terms --pivot-height "80 mm"',),
    "rank": (
        'metrosep rank sts_lathe --form "sphere: R=50 mm" --radius "15 mm" --all-lengths "1 um"',
        'metrosep rank my_lathe.toml --form "sphere: R=50 mm" --radius "15 mm" --error "EXX=1 um"',
    ),
    "predict": ("metrosep predict process.toml -o predicted",),
    "report": (
        "metrosep report out --format html,csv -o reports",
        ('metrosep report out --issue --number 2026-7 --date 2026-03-05 --released "A. Name" '
        '--report "laboratory.name=Our laboratory" --report "item.name=mirror" --report "item.serial=A 12" -o reports'),
    ),
    "diff": ("metrosep diff before after", 'metrosep diff before after --tolerance "Sq=5 nm"'),
    "demo": ("metrosep demo -o metrosep-demo",),
    "ui": ("metrosep ui part.x3p", "metrosep ui --operator qa.toml --inbox maps --out qa"),
    "listen": (
        "metrosep listen tcp://192.168.0.20:5000 --columns x_mm,z_um -o run1.csv",
        r'metrosep listen serial:/dev/ttyUSB0:9600 --columns z_mm --ask "1\r" --line "01A{}" -o run1.csv',
        "halsampler -n 6000 | metrosep listen - --columns x_mm,z_um -o run1.csv",
    ),
    "formats": ("metrosep formats",),
    "controllers": ("metrosep controllers", "metrosep controllers linuxcnc"),
    "ops": ("metrosep ops", "metrosep ops donaldson"),
    "doctor": ("metrosep doctor",),
    "completion": ('eval "$(metrosep completion bash)"',),
}  # fmt: skip
