"""Identification of a balance's dynamics: from a shaken rig, from a free decay, from a published response table."""

from aerobalance.identification.dwells import Dwell, HarmonicDeviation, find_dwells, harmonic_check
from aerobalance.identification.frf import FrfFit, ResponseTable, identify_frf
from aerobalance.identification.live_check import LiveCheck
from aerobalance.identification.reference import ReferenceFit, reference_fit
from aerobalance.identification.rig import RigFit, identify_rig

__all__ = [
    "Dwell",
    "FrfFit",
    "HarmonicDeviation",
    "LiveCheck",
    "ReferenceFit",
    "ResponseTable",
    "RigFit",
    "find_dwells",
    "harmonic_check",
    "identify_frf",
    "identify_rig",
    "reference_fit",
]
