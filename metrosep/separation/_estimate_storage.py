"""Private to separation: an estimate as plain values for JSON, and back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core.errors import DataError
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.quantity import Quantity
from metrosep.separation._estimate_parts import DirectionEstimate
from metrosep.separation.curves import Curve, FeedTerm, SampledCurve, curve_from_dict

if TYPE_CHECKING:
    from metrosep.separation.base import ErrorEstimate

__all__ = ["estimate_as_dict", "estimate_from_dict"]

Columns = Mapping[str, list[Any]]


def estimate_as_dict(estimate: ErrorEstimate) -> dict[str, Any]:
    """Return everything as plain values, NaN as None."""
    return {
        "method": estimate.method,
        "start_m": estimate.start,
        "stop_m": estimate.stop,
        "fit_range_m": list(estimate.fit_range),
        "directions": {
            str(d): {
                "error": p.error.to_dict(),
                "uncertainty": p.uncertainty.to_dict(),
                **({} if p.feed_term is None else {"feed_term": p.feed_term.to_dict()}),
            }
            for d, p in estimate.directions_data.items()
        },
        "slope": estimate.slope.to_dict(),
        "lost_motion": None if estimate.lost_motion is None else estimate.lost_motion.to_dict(),
        "spectrum": _without_nan(estimate.spectrum_data),
        "feed_spectra": _without_nan(estimate.feed_spectra_data),
        "residual_psd": _without_nan(estimate.residual_psd_data),
        "residual_rms_m": _plain(estimate.residual_rms),
        "lag_s": estimate.lag,
        "lag_sd_s": _plain(estimate.lag_sd),
        "audit": dict(estimate.audit),
        "messages": list(estimate.messages),
        "history": history_as_dicts(estimate.history),
        **({"terms": _nested_plain(estimate.terms)} if estimate.terms else {}),
        **({"evidence": _without_nan(estimate.evidence_data)} if estimate.evidence_data else {}),
        **({"runs": _without_nan(estimate.runs_data)} if estimate.runs_data else {}),
    }


def estimate_from_dict(cls: type[ErrorEstimate], data: Mapping[str, Any]) -> ErrorEstimate:
    """Return the estimate that `estimate_as_dict` wrote."""
    try:
        return cls(
            method=str(data["method"]),
            start=float(data["start_m"]),
            stop=float(data["stop_m"]),
            fit_range=(float(data["fit_range_m"][0]), float(data["fit_range_m"][1])),
            directions_data={
                int(d): DirectionEstimate(
                    curve_from_dict(p["error"]),
                    _sampled(curve_from_dict(p["uncertainty"])),
                    FeedTerm.from_dict(p["feed_term"]) if "feed_term" in p else None,
                )
                for d, p in data["directions"].items()
            },
            slope=_quantity(data["slope"]),
            lost_motion=None if data["lost_motion"] is None else _quantity(data["lost_motion"]),
            spectrum_data=_with_nan(data["spectrum"]),
            feed_spectra_data=_with_nan(data["feed_spectra"]),
            residual_psd_data=_with_nan(data["residual_psd"]),
            residual_rms=_number(data["residual_rms_m"]),
            lag=float(data["lag_s"]),
            lag_sd=_number(data["lag_sd_s"]),
            audit=data["audit"],
            messages=tuple(data["messages"]),
            history=tuple(Step(s["step"], s["parameters"], s["version"]) for s in data["history"]),
            terms=data.get("terms", {}),
            evidence_data=_with_nan(data.get("evidence", {})),
            runs_data=_with_nan(data.get("runs", {})),
        )
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as exc:
        raise DataError(
            f"this is not a stored estimate ({type(exc).__name__}: {exc}); expected the "
            "'estimate' part of a result.json that this version wrote"
        ) from exc


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and math.isnan(value) else value


def _nested_plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _nested_plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_nested_plain(v) for v in value]
    return _plain(value)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _without_nan(columns: Columns) -> dict[str, list[Any]]:
    return {k: [_plain(v) for v in values] for k, values in columns.items()}


def _with_nan(columns: Columns) -> dict[str, list[Any]]:
    return {k: [math.nan if v is None else v for v in values] for k, values in columns.items()}


def _sampled(curve: Curve) -> SampledCurve:
    if not isinstance(curve, SampledCurve):
        raise TypeError("the uncertainty must be a sampled curve")
    return curve


def _quantity(data: Mapping[str, Any]) -> Quantity:
    return Quantity(
        _number(data["value"]),
        str(data["unit"]),
        str(data["definition"]),
        u=None if data["u"] is None else float(data["u"]),
        symbol=str(data.get("symbol", "")),
    )
