"""Scales of TDMS channels: from raw numbers of a card to volts or a physical quantity.

Linear and polynomial scales are computed here, each from the scale that it names as its input or
from the raw data. Sensors (thermocouple, RTD, strain, table ...) are left to the package npTDMS.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, UnsupportedFeatureError
from metrosep.io.source import RawFile
from metrosep.io.tdms_metadata import DAQMX_RAW
from metrosep.io.tdms_segments import TdmsChannel

__all__ = ["Scaling", "scaling_of"]

Scaling = Callable[[Mapping[int, NDArray[Any]]], FloatArray]
"""From the raw values of each scaler (-1 without DAQmx) to float64."""

_RAW_INPUT = 0xFFFFFFFF
_MAX_SCALES = 64
_MAX_COEFFICIENTS = 64
_SCALE_TYPE = re.compile(r"NI_Scale\[(\d{1,6})\]_Scale_Type")
_OWN = ("Linear", "Polynomial", "AdvancedAPI")


def scaling_of(
    file: RawFile, channel: TdmsChannel, inherited: tuple[Mapping[str, Any], ...]
) -> Scaling:
    """Return how the raw values of a channel become its samples."""
    for properties in (channel.properties, *inherited):
        n_scales = _number(file, channel, properties)
        if n_scales and properties.get("NI_Scaling_Status", "unscaled") != "scaled":
            break
    else:
        if channel.type_code == DAQMX_RAW:
            raise _wrong(file, channel, "raw DAQmx data have no scale", "NI_Number_Of_Scales", 0)
        return _plain
    kinds = [properties.get(f"NI_Scale[{k}]_Scale_Type") for k in range(n_scales)]
    if any(kind not in (None, *_OWN) for kind in kinds):
        return _foreign(file, channel, properties, ", ".join(str(k) for k in kinds))
    steps: list[FloatArray] = []
    source = n_scales - 1
    for _ in range(n_scales + 1):
        if source == _RAW_INPUT:
            return _chain(file, channel, steps, -1)
        if not 0 <= source < n_scales:
            break
        kind = kinds[source]
        if kind is None:
            return _chain(file, channel, steps, source)
        steps.append(_coefficients(file, channel, properties, source, kind))
        source = properties.get(f"NI_Scale[{source}]_{kind}_Input_Source", _RAW_INPUT)
        if not isinstance(source, int):
            break
    raise _wrong(file, channel, "a scale has no input", "NI_Scale[..]_Input_Source", source)


def _plain(raw: Mapping[int, NDArray[Any]]) -> FloatArray:
    return next(iter(raw.values())).astype(np.float64)


def _chain(file: RawFile, channel: TdmsChannel, steps: list[FloatArray], scaler: int) -> Scaling:
    """Return the polynomials one after another, the one nearest to the raw values last in `steps`."""
    if scaler not in channel.extents:
        raise _wrong(file, channel, "a scale has no raw values", "scaler", scaler)

    def scaled(raw: Mapping[int, NDArray[Any]]) -> FloatArray:
        values = raw[scaler].astype(np.float64)
        for coefficients in reversed(steps):
            values = np.asarray(np.polynomial.polynomial.polyval(values, coefficients))
        return values

    return scaled


def _number(file: RawFile, channel: TdmsChannel, properties: Mapping[str, Any]) -> int:
    declared = properties.get("NI_Number_Of_Scales")
    if declared is None:
        found = [int(m[1]) for key in properties if (m := _SCALE_TYPE.fullmatch(key))]
        declared = max(found, default=-1) + 1
    if not isinstance(declared, (int, float, str)) or not str(declared).isdecimal():
        raise _wrong(
            file, channel, "the number of scales is none", "NI_Number_Of_Scales", declared
        )
    if int(declared) > _MAX_SCALES:
        raise _wrong(file, channel, "there are too many scales", "NI_Number_Of_Scales", declared)
    return int(declared)


def _coefficients(
    file: RawFile, channel: TdmsChannel, properties: Mapping[str, Any], k: int, kind: str
) -> FloatArray:
    """Return the coefficients of a scale, constant first."""
    prefix = f"NI_Scale[{k}]_{kind}"
    if kind == "AdvancedAPI":
        return np.array([0.0, 1.0])
    names = [f"{prefix}_Y_Intercept", f"{prefix}_Slope"]
    if kind == "Polynomial":
        n = properties.get(f"{prefix}_Coefficients_Size", 4)
        if not isinstance(n, int) or not 1 <= n <= _MAX_COEFFICIENTS:
            raise _wrong(file, channel, "a polynomial has no usable length", prefix, n)
        names = [f"{prefix}_Coefficients[{i}]" for i in range(n)]
    values = [properties.get(name) for name in names]
    for name, value in zip(names, values, strict=True):
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            raise _wrong(file, channel, "a scale is not usable", name, value)
    if not any(values[1:]):
        raise _wrong(file, channel, "a scale gives the same value for all", names[-1], values[-1])
    return np.array(values, dtype=np.float64)


def _foreign(
    file: RawFile, channel: TdmsChannel, properties: Mapping[str, Any], kinds: str
) -> Scaling:
    """Return the scaling of a sensor by npTDMS."""
    try:
        from nptdms.base_segment import RawChannelDataChunk
        from nptdms.scaling import get_scaling
    except ImportError:
        raise UnsupportedFeatureError(
            f"{file.path}: channel {channel.name[:40]!r} is scaled by {kinds[:80]}, which needs the package "
            "nptdms; install metrosep[formats]"
        ) from None
    for name, value in properties.items():
        if name.endswith("_Size") and not (isinstance(value, int) and 0 <= value < 10**5):
            raise _wrong(file, channel, "a scale has no usable length", name, value)
    failures = (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError)
    try:
        scaling = get_scaling(properties, {}, {})
    except failures as exc:
        raise _wrong(file, channel, f"a scale is not usable ({exc})", "NI_Scale", kinds) from None
    if scaling is None:
        raise UnsupportedFeatureError(
            f"{file.path}: channel {channel.name[:40]!r} is scaled by {kinds[:80]}, which is not read; "
            "export it as scaled values"
        )

    def scaled(raw: Mapping[int, NDArray[Any]]) -> FloatArray:
        plain = set(raw) == {-1}
        chunk = RawChannelDataChunk(raw[-1] if plain else None, None if plain else dict(raw))
        try:
            return np.asarray(scaling.scale(chunk), dtype=np.float64)
        except Exception as exc:  # npTDMS raises Exception itself
            raise _wrong(file, channel, f"a scale fails ({exc})", "NI_Scale", kinds) from None

    return scaled


def _wrong(
    file: RawFile, channel: TdmsChannel, reason: str, name: str, found: object
) -> CorruptFileError:
    return CorruptFileError(
        file.path,
        f"channel {channel.name[:40]!r}: {reason}",
        field=name[:80],
        found=repr(found)[:80],
    )
