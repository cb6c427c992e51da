"""What each command prints with ``--json``: one JSON schema (draft 2020-12) for each, in one place.

Keys under ``required`` stay, with their meaning and unit, within a minor version; others may be added.
Numbers are in the unit that the key ends in (``_m``, ``_nm``, ``_deg``, ``_si``: SI of the axis), null is "not known". The
reference page and the tests of all commands read these.
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]

_ANY: Schema = {}
_TEXT: Schema = {"type": "string"}
_TEXT_OR_NOT: Schema = {"type": ["string", "null"]}
_NUMBER: Schema = {"type": ["number", "null"]}
_SIZE: Schema = {"type": "number", "minimum": 0}
_COUNT: Schema = {"type": "integer", "minimum": 0}
_FLAG: Schema = {"type": "boolean"}
_MAP: Schema = {"type": "object"}
_VERDICT: Schema = {"enum": ["accept", "reject", "inconclusive", None]}


def _list(of: Schema) -> Schema:
    return {"type": "array", "items": of}


def _values(of: Schema) -> Schema:
    return {"type": "object", "additionalProperties": of}


def _object(what: str, required: Schema, more: Schema | None = None) -> Schema:
    """Return the schema of an object: keys that are always there, and keys that may be."""
    made: Schema = {"type": "object", "properties": {**required, **(more or {})}}
    made["required"] = sorted(required)
    return {"description": what, **made} if what else made


def _one_or_more(what: str, one: Schema, each: Schema | None = None) -> Schema:
    """Return the schema of a command that takes several files: of one file its object, else a list."""
    several = _object("", {"files": _list(one if each is None else each)})
    return {"description": f"{what}; of several files an object with a list 'files' of these",
            "anyOf": [one, several]}  # fmt: skip


_QUANTITY = _object(
    "value in SI with standard uncertainty",
    {"value": _NUMBER, "unit": _TEXT, "u": _NUMBER, "definition": _TEXT, "symbol": _TEXT},
)
_INPUT = _object("a file that was read", {"name": _TEXT, "sha256": _TEXT_OR_NOT}, {"size": _COUNT, "format": _TEXT})  # fmt: skip
_CHARACTERISTIC = _object(
    "a value of the result in SI, and its verdict where it was checked",
    {"name": _TEXT, "metric": _TEXT, "value": _NUMBER, "unit": _TEXT, "u": _NUMBER, "U": _NUMBER,
     "lower": _NUMBER, "upper": _NUMBER, "verdict": _VERDICT, "definition": _TEXT},
)  # fmt: skip
_FILES = _list(_TEXT)
_NAMED = _object(
    "what a recipe or a named separation found",
    {"characteristics": _list(_CHARACTERISTIC), "messages": _list(_TEXT), "inputs": _list(_INPUT),
     "verdict": _VERDICT, "separation": _MAP, "files": _FILES},
)  # fmt: skip
_SEPARATED = _object(
    "the error of an axis from repeated runs",
    {"method": {"enum": ["joint", "kono", "mean"]}, "pv_nm": _NUMBER, "u_pv_nm": _NUMBER,
     "residual_rms_nm": _NUMBER, "slope_urad": _NUMBER, "start_mm": _NUMBER, "stop_mm": _NUMBER,
     "selected": _list(_object("a wave of the error", {"wavelength_mm": _NUMBER, "amplitude_nm": _NUMBER, "sd_nm": _NUMBER})),
     "lag_ms": _NUMBER, "lag_sd_ms": _NUMBER, "messages": _list(_TEXT), "inputs": _list(_INPUT),
     "verdict": _VERDICT, "files": _FILES, "verification": _ANY, "polynomial": _ANY},
)  # fmt: skip
_RESULT: Schema = {"anyOf": [_SEPARATED, _NAMED]}
_GRADE: Schema = {"enum": ["accepted", "pointless", "inconclusive", "refused"]}
_REASON = _object("why it is not accepted", {"check": _TEXT, "grade": _GRADE, "text": _TEXT})
_DRY_RUN = _object(
    "what a table would do to the error, by readings; lengths end in _m, of an axis that turns in _rad",
    {"grade": _GRADE, "passed": _FLAG, "gain": _NUMBER,
     "u_gain": _NUMBER, "reasons": _list(_REASON), "sentences": _list(_TEXT), "warnings": _list(_TEXT),
     "headline": _TEXT_OR_NOT, "definition": _TEXT},
    {"before_rms_m": _NUMBER, "after_rms_m": _NUMBER, "before_pv_m": _NUMBER, "after_pv_m": _NUMBER,
     "n_runs": _COUNT, "residuals": _list(_MAP), "diagnosis": _TEXT},
)  # fmt: skip
_TABLES = _object(
    "tables of a machine, judged together by the error of the tool point",
    {"files": _FILES, "messages": _list(_TEXT), "before_rms_m": _NUMBER, "after_rms_m": _NUMBER, "where": _TEXT},
)  # fmt: skip
_DESCRIBED = _object("what a file holds", {"kind": _TEXT, "format": _TEXT, "sha256": _TEXT, "metadata": _MAP},
    {"shape": _list(_COUNT), "dx_m": _NUMBER, "dy_m": _NUMBER, "pv_nm": _NUMBER, "sq_nm": _NUMBER,
     "mean_nm": _NUMBER, "n_invalid": _COUNT})  # fmt: skip
_FINDING = _object(
    "a problem", {"level": {"enum": ["note", "warning", "error"]}, "problem": _TEXT, "fix": _TEXT}
)
_CHECKED: Schema = {
    "anyOf": [
        _object("of a file of data", {"file": _TEXT, "findings": _list(_FINDING)}),
        _object("of a recipe", {"file": _TEXT, "errors": _list(_TEXT), "warnings": _list(_TEXT)},
                {"defaults": _ANY}),
    ]
}  # fmt: skip
_MEASURED = _object(
    "parameters of a part; the same values stand under symbol_unit keys such as sq_nm",
    {"file": _TEXT, "parameters": _values(_QUANTITY), "unavailable": _values(_TEXT), "verdict": _VERDICT,
     "verdicts": _MAP, "evaluations": _list(_MAP)},
)  # fmt: skip
_NOT_MEASURED = _object("a file that failed among several", {"file": _TEXT, "error": _TEXT})

OUTPUTS: dict[str, Schema] = {
    "info": _one_or_more("what a file holds", _DESCRIBED),
    "check": _one_or_more("problems of a file", _CHECKED),
    "formats": _object("", {"formats": _list(_object("a format", {
        "id": _TEXT, "title": _TEXT, "kind": _TEXT, "reads": _FLAG, "writes": _FLAG, "status": _TEXT,
        "suffixes": _list(_TEXT)}))}),
    "controllers": {"anyOf": [
        _object("", {"controllers": _list(_object("a controller", {
            "id": _TEXT, "title": _TEXT, "sign": _TEXT, "suffix": _TEXT, "carries": _TEXT,
            "options": _list(_MAP)}))}),
        _object("a controller that was named", {"id": _TEXT, "title": _TEXT, "sign": _TEXT}),
    ]},
    "measure": _one_or_more("parameters of a part", _MEASURED, {"anyOf": [_MEASURED, _NOT_MEASURED]}),
    "form": {"anyOf": [_object(
        "a form that was fitted; SI unless a key ends in another unit",
        {"file": _TEXT, "form": _TEXT, "parameters": _values(_object("", {
            "value": _NUMBER, "u": _NUMBER, "unit": _TEXT, "free": _FLAG})),
         "rms_nm": _NUMBER, "pv_nm": _NUMBER, "n_points": _COUNT, "dof_effective": _NUMBER,
         "warnings": _list(_TEXT), "u_rests_on": _TEXT}), _NAMED]},
    "psd": _object("a spectrum against its limit", {
        "file": _TEXT, "direction": _TEXT, "verdict": _VERDICT, "sentence": _TEXT_OR_NOT, "limit": _TEXT_OR_NOT,
        "notes": _list(_TEXT), "bands": _list(_MAP), "filled_share": _NUMBER, "lost_share": _NUMBER,
        "holes": _TEXT}),
    "geometry": _NAMED,
    "circle": _object("a circular test of ISO 230-4", {
        "plane": _TEXT, "quantities": _values(_QUANTITY), "reversals": _ANY, "messages": _list(_TEXT),
        "files": _FILES, "audit": _MAP}),
    "verify-softgauge": _object("values against those of a software gauge", {
        "file": _TEXT, "result": _TEXT, "reasons": _list(_TEXT), "rows": _list(_object("", {
            "symbol": _TEXT, "unit": _TEXT, "expected": _NUMBER, "computed": _NUMBER, "deviation": _NUMBER,
            "agrees": {"type": ["boolean", "null"]}}))}),
    "run": _RESULT,
    "demo": _RESULT,
    "separate": _RESULT,
    "batch": _object("what became of each unit", {
        "counts": _values(_COUNT), "exit_code": _COUNT, "seconds": _SIZE, "messages": _list(_TEXT),
        "stopped": _TEXT_OR_NOT, "index": _TEXT_OR_NOT, "rows": _list(_object("", {
            "unit": _TEXT, "status": _TEXT, "verdict": _VERDICT, "link": _TEXT_OR_NOT,
            "characteristics": _list(_MAP)}))}),
    "plan": _object("feedrates for runs", {
        "feeds_mm_per_min": _list(_NUMBER), "runs": _list(_list(_NUMBER)), "quantities": _values(_QUANTITY),
        "messages": _list(_TEXT), "audit": _MAP}),
    "calibrate": {"anyOf": [_object("error terms of a machine", {
        "machine": _TEXT, "terms": _values(_object("values and u are null for a term that was refused", {
            "unit": _TEXT, "values": {"type": ["array", "null"]}, "u": {"type": ["array", "null"]}})),
        "noise": _MAP, "null": _list(_ANY), "refused": _MAP, "condition": _NUMBER, "messages": _list(_TEXT),
        "files": _FILES, "audit": _MAP}),
        _object("--candidate: set-ups in the order in which each adds most", {
            "plan": _list(_object("u of the error once it is read too", {"set": _TEXT, "u_rms_m": _NUMBER}))})]},
    "thermal": _object(
        "errors over temperatures: of a new fit 'drift' and what it rests on, of a stored one 'errors'",
        {"errors": {"anyOf": [_values(_object("", {"value": _NUMBER, "u": _NUMBER, "unit": _TEXT})), {"type": "null"}]},
         "files": _FILES},
        {"drift": _values(_NUMBER), "messages": _list(_TEXT), "audit": _MAP}),
    "air": _NAMED,
    "rank": _NAMED,
    "predict": _NAMED,
    "table": _object(
        "the sidecar of the table that was written",
        {"controller": _TEXT, "file_sha256": _TEXT, "options": _MAP, "table": _MAP, "activation": _list(_TEXT)},
        {"verification": _ANY}),
    "machine-tables": _TABLES,
    "volume": {"anyOf": [_TABLES, _object("the error over a volume", {"nodes": _MAP})]},
    "path": _object("a tool path that was rewritten", {
        "schema": _TEXT, "n_points": _COUNT, "n_changed": _COUNT, "source": _TEXT, "source_sha256": _TEXT,
        "file_sha256": _TEXT, "messages": _list(_TEXT)}),
    "verify": _DRY_RUN,
    "read": {"description": "readings of an instrument, one row for each position",
             "type": "object", "minProperties": 1,
             "patternProperties": {"^(reading|left)_(um|urad)$": _list(_list(_NUMBER))},
             "additionalProperties": False},
    "diff": _object("what differs between two results or recipes", {"equal": _FLAG}),
    "ops": _list(_object("a step or method", {"op": _TEXT, "what": _TEXT, "keys": _MAP})),
    "doctor": _object("the installation", {
        "versions": _values(_TEXT_OR_NOT), "extras": _values(_TEXT_OR_NOT), "places": _values(_TEXT)}),
}  # fmt: skip
"""By command."""


def schema_of(command: str) -> Schema:
    """Return the whole schema of what a command prints with ``--json``."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"metrosep {command} --json",
        **OUTPUTS[command],
    }
