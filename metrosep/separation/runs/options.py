"""Options of the joint separation, checked once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.numbers import flag, quantity, real
from metrosep.core.options import KINDS, Option, checked, option, options_of
from metrosep.core.units import format_length

Following = Literal["off", "offset", "scale", "waves"]

_MAX_WAVES = 8
"""Waves of the feed-dependent error; more would compete with the geometry itself."""


_SAME_PITCH = 0.25
"""Of a pitch: by less the samples of two runs part over the travel, so that they read a short wave alike."""


def _read(length: float, pitch: float) -> str:
    """Return what samples make of a wave below two of their pitches."""
    rest = abs(1.0 / length - round(pitch / length) / pitch)
    as_ = format_length(1.0 / rest, digits=3) if rest > 1e-9 / length else "a constant"
    return f"{format_length(length)} as {as_}"


@dataclass(frozen=True, slots=True)
class JointOptions:
    """What the joint model holds beside geometry, offsets and noise; all off by default."""

    drift: int = option(
        0,
        kind="integer",
        choices=(0, 1, 2),
        help="degree of a polynomial in time that each run has for itself",
        of=("joint",),
    )
    lines: Literal["auto"] | tuple[float, ...] = option(
        (),
        kind="frequencies",
        help="frequencies of vibrations that are removed as sines; auto looks for them; none if omitted",
        of=("joint",),
    )
    line_phase: Literal["free", "locked"] = option(
        "free",
        kind="text",
        choices=("free", "locked"),
        help="free gives each run its own amplitude and phase of a line, locked one from the start of all runs",
        of=("joint",),
    )
    false_alarm: float = option(
        0.001,
        kind="number",
        help="chance that lines = auto finds a line where there is none",
        of=("joint",),
    )
    robust: bool = option(
        False,
        kind="flag",
        help="true takes weight from spikes, dropouts and bad stretches; for mean, leaves out readings far from the other runs",
        of=("joint", "mean"),
    )
    following: Following = option(
        "off",
        kind="text",
        choices=("off", "offset", "scale", "waves"),
        help="what grows with the feedrate: the offset, the whole error (scale), or single waves of it",
        of=("joint",),
    )
    following_waves: int | tuple[float, ...] = option(
        3,
        kind="waves",
        help="how many of the strongest waves grow with the feedrate, or their wavelengths",
        of=("joint",),
    )
    probe_gain: Literal["equal", "fit"] = option(
        "equal",
        kind="text",
        choices=("equal", "fit"),
        help="equal takes all probes as sensitive as the first, fit finds their sensitivities",
        of=("joint",),
    )

    waves: tuple[float, ...] = option(
        (),
        kind="lengths",
        help="wavelengths that the machine may have, such as its leads: where the search for waves starts; free if omitted",
        of=("joint",),
    )
    slip: Literal["geometry", "sparse"] = option(
        "geometry",
        kind="text",
        choices=("geometry", "sparse"),
        help="of a wave that differs from run to run: geometry takes a wave of that length that repeats for as likely, so it is in the uncertainty; sparse takes it for absent",
        of=("joint",),
    )

    position_offsets: bool = option(
        False,
        kind="flag",
        help="true fits how far each run lies from its place along the axis, with u; a delay of the reading is then part of it",
        of=("joint",),
    )
    position_reference: str = option(
        "",
        kind="text",
        help="name of the run that lies at its place; the offsets of all runs have the sum zero if omitted",
        of=("joint",),
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "drift", _checked_drift(self.drift))
        for name, allowed in (
            ("line_phase", ("free", "locked")),
            ("following", ("off", "offset", "scale", "waves")),
            ("probe_gain", ("equal", "fit")),
            ("slip", ("geometry", "sparse")),
        ):
            value = getattr(self, name)
            if not isinstance(value, str) or value not in allowed:
                raise DataError(f"{name} is one of {', '.join(allowed)}, got {value!r}")
        flag(self.robust, "robust")
        flag(self.position_offsets, "position_offsets")
        if not isinstance(self.position_reference, str):
            raise DataError(
                f"position_reference is the name of a run, got {self.position_reference!r}"
            )
        if self.position_reference and not self.position_offsets:
            raise DataError(
                f"position_reference={self.position_reference!r} says where position offsets are zero, "
                "and none are fitted: add position_offsets=True (command line: --set position_offsets=true)"
            ).hinting(position_offsets=True)
        chance = "a probability between 0 and 1"
        if not 0.0 < real(self.false_alarm, "false_alarm", what=chance) < 1.0:
            raise DataError(f"false_alarm is {chance}, got {self.false_alarm}")
        object.__setattr__(self, "lines", _checked_lines(self.lines))
        object.__setattr__(self, "following_waves", _checked_waves(self.following_waves))
        object.__setattr__(self, "waves", _checked_lengths(self.waves, "waves"))

    def as_dict(self) -> dict[str, Any]:
        """Return the options as plain values, with unit suffixes."""
        waves = self.following_waves
        return {
            "drift": self.drift,
            "lines_hz": self.lines if isinstance(self.lines, str) else list(self.lines),
            "line_phase": self.line_phase,
            "false_alarm": self.false_alarm,
            "robust": bool(self.robust),
            "following": self.following,
            "following_waves_mm": waves if isinstance(waves, int) else [w * 1e3 for w in waves],
            "probe_gain": self.probe_gain,
            "waves_mm": [w * 1e3 for w in self.waves],
            "slip": self.slip,
            "position_offsets": bool(self.position_offsets),
            "position_reference": self.position_reference,
        }

    def check_waves(self, period: float) -> None:
        """Refuse stated wavelengths that the model cannot hold."""
        if self.following != "waves" or isinstance(self.following_waves, int):
            return
        for wave in self.following_waves:
            if wave > period * (1.0 + 1e-9):
                raise UnitError(
                    f"a wavelength of following_waves is {format_length(wave)}, longer than the "
                    f"longest of the model, {format_length(period)}; it is in metres: 8 mm is "
                    "8e-3 (a number of waves is a whole number, such as 3)"
                )

    def unheld_waves(
        self, looked: tuple[float, float], pitches: Sequence[float], *, sampled: bool
    ) -> list[str]:
        """Name the stated waves that are not looked for, and why; lengths in m.

        `looked` are the shortest and longest that are, the former by the samples if `sampled`.
        """
        shortest, longest = looked
        out = []
        long = [format_length(w) for w in self.waves if w > longest]
        if long:
            out.append(
                f"waves {', '.join(long)}: not looked for, since they are longer than the travel of "
                f"{format_length(longest)}"
            )
        short = [w for w in self.waves if w < shortest]
        if not short:
            return out
        why = "state shortest= (command line: --shortest) to go further"
        if sampled:
            why = (
                f"the samples of the fastest run are {format_length(max(pitches), digits=3)} apart and "
                "do not show them: sample faster or move slower"
            )
        out.append(
            f"waves {', '.join(format_length(w) for w in short)}: not looked for, since only waves "
            f"from {format_length(shortest, digits=3)} on are; {why}"
        )
        pitch = sum(pitches) / len(pitches)
        folded = [w for w in short if w < 2.0 * pitch]
        if folded and max(pitches) - min(pitches) < _SAME_PITCH * pitch**2 / longest:
            out.append(
                f"all runs have one pitch of {format_length(pitch, digits=3)}: at every feedrate a "
                f"wave below two pitches reads as a longer one ({', '.join(_read(w, pitch) for w in folded)}"
                "), and no run tells it from the error; take a finer pitch"
            )
        return out

    def check_runs(self, n_feeds: int, n_probes: int, *, fit_lag: bool, way: str) -> None:
        """Refuse what the feedrates and probes at hand cannot show."""
        if self.following != "off" and n_feeds < 2:
            raise NotSeparableError(
                f"following={self.following!r} needs runs at >= 2 feedrates (>= 3 to test it), the "
                f"{way} runs have {n_feeds}: at one feedrate a part that grows with the feed is part "
                "of the geometry; add runs at another feedrate"
            )
        if self.position_offsets and fit_lag:
            raise NotSeparableError(
                "lag='fit' and position_offsets cannot be distinguished: a delay moves each run by the delay "
                "times its speed; fit the one or the other"
            ).hinting(position_offsets=False)
        if self.position_offsets and self.following == "waves":
            raise (
                NotSeparableError(
                    "following='waves' and position_offsets cannot be distinguished: a displaced run changes the "
                    "phase of each wave; fit the one or the other"
                )
                .hinting(position_offsets=False)
                .hinting(following="off")
            )
        if self.following == "waves" and fit_lag:
            raise NotSeparableError(
                "lag='fit' and following='waves' cannot be distinguished: a lag is a wave in "
                "quadrature that grows with the feed; fit the one or the other"
            ).hinting(following="off")
        if self.probe_gain == "fit" and n_probes < 2:
            raise NotSeparableError(
                f"probe_gain='fit' compares probes, the {way} runs have {n_probes}; name the probe of "
                "each run (probes=[...] or metadata['probe'])"
            )


def metres(value: Any, name: str) -> float | None:
    """Return a length in m, of a number or of a text with its unit; None stays."""
    return None if value is None else quantity(value, name, "length")


def in_si(name: str, value: Any) -> Any:
    """Return the value of an option of `separate`, texts with a unit in SI."""
    declared = RUN_OPTIONS.get(name)
    if declared is None or KINDS[declared.kind].dimension is None:
        return value
    several = isinstance(value, list | tuple) and any(isinstance(v, str) for v in value)
    return checked(declared, value, name) if isinstance(value, str) or several else value


RUN_OPTIONS: Mapping[str, Option] = {
    "method": Option(
        "text",
        choices=("joint", "kono", "mean"),
        help="joint: least squares over all runs at once, with uncertainty; kono: Fourier series of the waves that repeat over the feedrates; mean: the plain mean of the runs",
        default="joint",
    ),
    "start": Option(
        "length",
        help="where the evaluation range begins; centred in the common travel where only the length is given",
    ),
    "length": Option(
        "size",
        help="length of the evaluation range; up to the end of the common travel if omitted",
    ),
    "shortest": Option(
        "size",
        help="shortest wavelength of the model; chosen from the data if omitted",
        of=("joint", "kono"),
    ),
    "lag": Option(
        "lag",
        help="delay of the reading against the position, positive when the reading is late; auto corrects what the runs show, fit finds it in any case; both need two feedrates",
        default="auto",
        of=("joint",),
    ),
    "exclude": Option(
        "texts",
        help="runs that are omitted, by name; suspect leaves out all in which a fault was found",
    ),
    "accept": Option(
        "texts", help="runs that are kept although they are refused, by name, or suspect"
    ),
    "min_feeds": Option(
        "integer",
        help="feedrates that must be there; 1 accepts that vibration is only averaged",
        default=2,
        of=("joint",),
    ),
    "false_discovery_rate": Option(
        "number",
        help="accepted share of wavelengths called repeatable that are noise; the estimate itself does not depend on it",
        default=0.05,
        of=("joint",),
    ),
    "sigma_t": Option(
        "number",
        help="a wavelength repeats where the standard deviation over the feedrates lies below this, in SI; 5e-8 m, 5e-14 m^2 or 5e-17 m^3 after norm if omitted, 0.05 where relative",
        of=("kono",),
    ),
    "p_t": Option(
        "number",
        help="a wavelength counts where its mean over the feedrates lies above this, in SI; 1e-8 m, 1e-14 m^2 or 1e-17 m^3 after norm if omitted",
        of=("kono",),
    ),
    "norm": Option(
        "text",
        choices=("amplitude", "power", "psd"),
        help="what is compared with the thresholds: amplitude in m, its square, or its density over wavenumber",
        default="amplitude",
        of=("kono",),
    ),
    "taper_fraction": Option(
        "number",
        help="share of the samples over which the weight rises at each end",
        default=0.1,
        of=("kono",),
    ),
    "taper": Option(
        "text",
        choices=("kono", "tukey"),
        help="kono is the weight of the paper, tukey the symmetric cosine",
        default="kono",
        of=("kono",),
    ),
    "rule": Option(
        "text",
        choices=("shortest", "contiguous", "mask"),
        help="shortest keeps all waves down to the shortest that passes, contiguous down to the first that fails, mask only those that pass",
        default="shortest",
        of=("kono",),
    ),
    "modelling_length": Option(
        "size",
        help="longest wavelength of the series; the evaluation range over the flat part of the weight if omitted",
        of=("kono",),
    ),
    "values": Option(
        "text",
        choices=("one_feed", "all"),
        help="amplitudes from the mean run of one feedrate, or of all runs",
        default="one_feed",
        of=("kono",),
    ),
    "feed": Option(
        "speed",
        help="the runs of this feedrate give the values; for kono the middle one, for mean all runs if omitted",
        of=("kono", "mean"),
    ),
    "averaging": Option(
        "text",
        choices=("coherent", "power"),
        help="coherent takes the spectrum of the mean run, power the mean spectrum of the runs",
        default="coherent",
        of=("kono",),
    ),
    "ddof": Option(
        "integer",
        help="1 divides the squares by the feedrates less one (sample), 0 by the feedrates",
        default=1,
        of=("kono",),
    ),
    "relative": Option(
        "flag",
        help="true compares the standard deviation over the mean with sigma_t",
        default=False,
        of=("kono",),
    ),
    "min_coherence": Option(
        "number",
        help="least agreement of the phases over the feedrates, 0 to 1; 0 ignores them as the paper does",
        default=0.0,
        of=("kono",),
    ),
    "coefficients": Option(
        "text",
        choices=("tapered", "least_squares"),
        help="tapered are the Fourier sums of the weighted data, least_squares fits the kept waves, which does not decay in the ends",
        default="tapered",
        of=("kono",),
    ),
    "probes": Option(
        "texts",
        help="name of the probe of each run, separated by commas; from the files if omitted",
        of=("joint",),
    ),
    **options_of(JointOptions),
}
"""What `separate` takes for repeated runs, beside the runs."""


def _checked_drift(drift: Any) -> int:
    """Return the degree as int; 1.0, as a file may hold it, is 1."""
    number = isinstance(drift, int | float | np.number) and not isinstance(drift, bool)
    if not number or drift not in (0, 1, 2):
        raise DataError(f"drift is the degree of a polynomial in time: 0, 1 or 2, got {drift!r}")
    return int(drift)


def _checked_lines(lines: Any) -> Literal["auto"] | tuple[float, ...]:
    if isinstance(lines, str):
        if lines != "auto":
            raise DataError(f"lines is 'auto' or a list of frequencies in Hz, got {lines!r}")
        return "auto"
    values = _numbers(() if lines is None else lines, "lines", "frequencies in Hz")
    for value in values:
        if not (math.isfinite(value) and value > 0.0):
            raise UnitError(f"a line has {value} Hz; its frequency must be positive and finite")
    if len(set(values)) < len(values):
        raise DataError(f"lines names a frequency twice: {list(values)}")
    return values


def _checked_waves(waves: Any) -> int | tuple[float, ...]:
    if isinstance(waves, int | np.integer) and not isinstance(waves, bool):
        if not 1 <= waves <= _MAX_WAVES:
            raise DataError(f"following_waves is 1 to {_MAX_WAVES} wavelengths, got {waves}")
        return int(waves)
    values = _checked_lengths(waves, "following_waves", what="wavelengths in m, or their number")
    if not 1 <= len(values) <= _MAX_WAVES:
        raise DataError(f"following_waves is 1 to {_MAX_WAVES} wavelengths, got {len(values)}")
    return values


def _checked_lengths(
    waves: Any, name: str, *, what: str = "wavelengths in m"
) -> tuple[float, ...]:
    values = _numbers(() if waves is None else waves, name, what)
    for value in values:
        if not (math.isfinite(value) and value > 0.0):
            raise UnitError(f"a wavelength of {name} is {value} m; it must be positive and finite")
    return values


def _numbers(values: Any, name: str, what: str) -> tuple[float, ...]:
    if isinstance(values, bool | np.bool_):
        raise DataError(f"{name} is a list of {what}, got {values!r}")
    items = [values] if isinstance(values, int | float | np.number) else values
    if isinstance(items, str | bytes):
        raise DataError(f"{name} is a list of {what}, got {values!r}")
    try:
        return tuple(float(v) for v in cast("Sequence[float]", items))
    except (TypeError, ValueError) as exc:
        raise DataError(f"{name} is a list of {what}, got {values!r}") from exc
