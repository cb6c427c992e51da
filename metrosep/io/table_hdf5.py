"""A table as HDF5: a dataset for each column, with its unit, and where it comes from.

Any HDF5 program reads it, and so does `metrosep.read` with ``x`` and ``z`` naming columns. The same
table gives the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep._version import __version__
from metrosep.core.errors import WriteError
from metrosep.core.units import column_unit

__all__ = ["TABLE_VERSION", "table_bytes"]

TABLE_VERSION = 1


def table_bytes(
    columns: Mapping[str, Sequence[Any] | NDArray[Any]], provenance: Mapping[str, str]
) -> bytes:
    """Return a table as the content of an HDF5 file."""
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", libver="earliest") as handle:
        handle.attrs["metrosep_table"] = TABLE_VERSION
        handle.attrs["metrosep_version"] = __version__
        n = {len(values) for values in columns.values()}
        if len(n) > 1:
            raise WriteError(f"columns of {min(n)} and {max(n)} rows are no table")
        for i, (name, values) in enumerate(columns.items()):
            key = name.replace("/", "_")
            if key in handle or key in ("", ".", "provenance"):
                raise WriteError(f"column {name!r} has no name of its own in HDF5; rename it")
            dataset = handle.create_dataset(key, data=_array(values), track_times=False)
            dataset.attrs["name"] = name
            dataset.attrs["column"] = i
            unit = _unit(name)
            if unit is not None:
                dataset.attrs["unit"] = unit
        group = handle.create_group("provenance")
        for name, text in provenance.items():
            values = _texts([text])
            group.create_dataset(name, (), values.dtype, values[0], track_times=False)
    return stream.getvalue()


_NO_LENGTH = frozenset({"zernike_m"})
"""Names that end as a unit does: this is the azimuthal order of a term."""


def _unit(name: str) -> str | None:
    if name in _NO_LENGTH:
        return None
    bare, unit = column_unit(name)
    # a unit that is not known, such as rev_per_s, must not be taken for its last piece
    return None if unit is None or bare.endswith("_per") else unit.name


def _array(values: Sequence[Any] | NDArray[Any]) -> NDArray[Any]:
    array = np.asarray(values)
    if array.dtype.kind in "iub":
        return array.astype(np.int64)
    if array.dtype.kind == "f" or all(v is None or isinstance(v, int | float) for v in values):
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)
    return _texts(["" if v is None else str(v) for v in values])


def _texts(texts: Sequence[str]) -> NDArray[Any]:
    """Return UTF-8 of one length, as HDF5 stores it."""
    import h5py

    coded = [t.encode("utf-8", "backslashreplace") for t in texts]
    longest = max((len(c) for c in coded), default=0)
    return np.array(coded, dtype=h5py.string_dtype("utf-8", max(longest, 1)))
