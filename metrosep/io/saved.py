"""Objects in HDF5 files, schema ``metrosep.object/1``: every public object comes back with every bit.

Arrays are data sets, everything else is one JSON text that says where each belongs. Nothing in a file is
run: a class is made without its constructor, and only a class of this package.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
import os
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from metrosep.core.atomic import atomic_write, read_plain
from metrosep.core.attached import attached
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    FileMissingError,
    UnsupportedFeatureError,
)
from metrosep.core.provenance import freeze_mapping
from metrosep.core.public import PublicObject, state_of

SCHEMA = "metrosep.object/1"
_MOST_BYTES = 2**34
_KIND = "kind"
"""Key of what JSON does not know by itself."""


def save(obj: PublicObject, path: str | os.PathLike[str]) -> Path:
    """Write an object to a file that appears whole or not at all."""
    import h5py

    from metrosep._version import __version__

    arrays: list[np.ndarray[Any, Any]] = []
    content = json.dumps(_plain(obj, arrays, type(obj).__name__), allow_nan=False, sort_keys=True)
    memory = BytesIO()
    with h5py.File(memory, "w", libver="earliest") as file:
        file.attrs["metrosep_schema"] = SCHEMA
        file.attrs["metrosep_class"] = _class_name(type(obj))
        file.attrs["metrosep_version"] = __version__
        file.create_dataset("content", data=np.frombuffer(content.encode("utf-8"), dtype=np.uint8))
        for i, array in enumerate(arrays):
            file.create_dataset(f"array_{i}", data=array, track_times=False)
    return atomic_write(path, memory.getvalue())


def load(path: str | os.PathLike[str]) -> Any:
    """Return the object that its method ``save`` wrote.

    Parameters
    ----------
    path : str or path
        The file; of a result also ``result.json``, whose `produced` is the error of repeated runs or None.

    Returns
    -------
    object
        Of its class, equal to the saved one in every bit; arrays cannot be written to.

    Raises
    ------
    FileMissingError
        If there is no such file.
    CorruptFileError
        If the file is damaged, or was not written by ``save``.
    UnsupportedFeatureError
        If it was written by a newer schema, or holds a class that this version does not have.
    """
    if os.fspath(path).lower().endswith(".json"):
        return attached.load_document(path)
    try:
        data = read_plain(path, _MOST_BYTES)
    except FileNotFoundError:
        raise FileMissingError(f"{path}: no such file; check the name", str(path)) from None
    except OSError as exc:
        raise CorruptFileError(path, f"cannot be read ({exc.strerror or exc})") from None
    return restored(data, path)


def restored(data: bytes, path: str | os.PathLike[str]) -> Any:
    """Return the object that the content of a file holds."""
    import h5py

    hint = "save the object again"
    try:
        with h5py.File(BytesIO(data), "r") as file:
            schema = file.attrs.get("metrosep_schema")
            if schema is None:
                raise CorruptFileError(
                    path,
                    "not an object that was saved",
                    hint="read measured files with metrosep.read",
                )
            if schema != SCHEMA:
                from metrosep._version import __version__

                raise UnsupportedFeatureError(
                    f"{path}: written as {schema} by metrosep {file.attrs.get('metrosep_version')}; this "
                    f"version {__version__} reads {SCHEMA}"
                )
            content = json.loads(bytes(_own_array(file, "content")).decode("utf-8"))
            made = _restored(content, lambda i: _own_array(file, f"array_{i}"), str(path))
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, OverflowError) as exc:
        if isinstance(exc, DataError | CorruptFileError | UnsupportedFeatureError):
            raise
        raise CorruptFileError(path, f"damaged or cut off ({exc})", hint=hint) from None
    if not isinstance(made, PublicObject):
        raise CorruptFileError(path, "it does not hold an object", hint=hint)
    return made


def _own_array(file: Any, name: str) -> Any:
    """Return an array that lies in the file itself: neither a link nor storage in another file."""
    import h5py

    link = file.get(name, getlink=True)
    array = file[name] if isinstance(link, h5py.HardLink) else None
    if not isinstance(array, h5py.Dataset) or array.external or array.is_virtual:
        raise ValueError(f"{name} is not stored in the file itself")
    return array[()]


def _class_name(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _plain(value: Any, arrays: list[Any], where: str) -> Any:
    """Return a value as JSON holds it; arrays go to a list of their own."""
    if value is None or isinstance(value, bool | str) or type(value) is int:
        return value
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biufc":
            raise DataError(f"{where} is an array of {value.dtype}, which cannot be saved")
        arrays.append(value)
        return {_KIND: "array", "n": len(arrays) - 1}
    if type(value) is float:
        if math.isfinite(value):
            return {_KIND: "float", "hex": value.hex()}
        return {_KIND: "float", "hex": str(value)}
    if isinstance(value, np.generic):
        arrays.append(np.asarray(value))
        return {_KIND: "scalar", "n": len(arrays) - 1}
    if isinstance(value, complex):
        return {_KIND: "complex", "parts": [value.real.hex(), value.imag.hex()]}
    if isinstance(value, Path):
        return {_KIND: "path", "name": value.name}  # folders are of one machine
    if type(value) in (list, tuple, frozenset, set):
        items = sorted(value) if isinstance(value, frozenset | set) else value
        kind = type(value).__name__
        return {
            _KIND: kind,
            "items": [_plain(v, arrays, f"{where}[{i}]") for i, v in enumerate(items)],
        }
    if type(value) in (dict, MappingProxyType):
        kind = "dict" if type(value) is dict else "mapping"
        pairs = [
            [_plain(k, arrays, where), _plain(v, arrays, f"{where}[{k!r}]")]
            for k, v in value.items()
        ]
        return {_KIND: kind, "items": pairs}
    if type(value).__module__.partition(".")[0] == "metrosep" and not isinstance(value, type):
        base = {"base": float(value).hex()} if isinstance(value, float) else {}
        state = {k: _plain(v, arrays, f"{where}.{k}") for k, v in state_of(value)}
        return {_KIND: "object", "class": _class_name(type(value)), "state": state, **base}
    raise DataError(
        f"{where} is a {type(value).__name__}, which cannot be saved; save the recipe instead"
    )


def _restored(value: Any, array: Any, path: str) -> Any:
    if not isinstance(value, dict):
        return value
    kind = value[_KIND]
    if kind == "array":
        found = array(value["n"])
        found.setflags(write=False)
        return found
    if kind == "scalar":
        return array(value["n"])[()]
    if kind == "float":
        return float.fromhex(value["hex"])
    if kind == "path":
        return Path(value["name"])
    if kind == "complex":
        return complex(*(float.fromhex(p) for p in value["parts"]))
    if kind in ("list", "tuple", "frozenset", "set"):
        items = [_restored(v, array, path) for v in value["items"]]
        return {"list": list, "tuple": tuple, "frozenset": frozenset, "set": set}[kind](items)
    if kind in ("dict", "mapping"):
        made = {_restored(k, array, path): _restored(v, array, path) for k, v in value["items"]}
        return made if kind == "dict" else freeze_mapping(made)
    return _made(value, array, path)


def _made(value: Mapping[str, Any], array: Any, path: str) -> Any:
    """Return an object of a class of this package, its state set without its constructor."""
    module, _, name = str(value["class"]).partition(":")
    found: Any = None
    if module.partition(".")[0] == "metrosep" and name.isidentifier():
        try:
            found = getattr(importlib.import_module(module), name, None)
        except ImportError:
            found = None
    is_data = isinstance(found, type) and (
        dataclasses.is_dataclass(found) or issubclass(found, PublicObject | float)
        or hasattr(found, "__slots__")
    )  # fmt: skip
    if not is_data:
        from metrosep._version import __version__

        raise UnsupportedFeatureError(
            f"{path}: holds a {value['class']}, which metrosep {__version__} does not have"
        )
    made = (
        found.__new__(found, float.fromhex(value["base"]))
        if "base" in value
        else object.__new__(found)
    )
    for key, held in value["state"].items():
        object.__setattr__(made, key, _restored(held, array, path))
    return made
