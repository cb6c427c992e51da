"""Separation of repeated runs: machine from vibration from noise.

``separate`` is the entry; `separate_joint`, `separate_kono` and `separate_mean` are the methods.
error = actual - nominal; the alignment line over the evaluation range is reported apart.
"""

from __future__ import annotations

from metrosep.separation.average import separate_mean
from metrosep.separation.base import ErrorEstimate
from metrosep.separation.face import face_reversal
from metrosep.separation.fourier import separate_kono
from metrosep.separation.joint import separate_joint
from metrosep.separation.reversals import straightedge_reversal
from metrosep.separation.roundness_reversal import donaldson
from metrosep.separation.separate import separate
from metrosep.separation.simulate import KONO_WAVES, SimulatedAxis, machine_axis
from metrosep.separation.spectra import feed_spectra
from metrosep.spectral.window import kono_weights

__all__ = [
    "KONO_WAVES",
    "ErrorEstimate",
    "SimulatedAxis",
    "donaldson",
    "face_reversal",
    "feed_spectra",
    "kono_weights",
    "machine_axis",
    "separate",
    "separate_joint",
    "separate_kono",
    "separate_mean",
    "straightedge_reversal",
]
