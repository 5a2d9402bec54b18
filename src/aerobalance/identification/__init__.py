"""Identification of a balance's dynamics: from a shaken rig, from a free decay, from a published response table."""

from aerobalance.identification.base_excitation.frf_table import FrfFit, ResponseTable, identify_frf
from aerobalance.identification.base_excitation.live_check import LiveCheck
from aerobalance.identification.base_excitation.paper_procedure import ReferenceFit, reference_fit
from aerobalance.identification.base_excitation.rig import RigFit, identify_rig
from aerobalance.identification.base_excitation.sine_dwell import Dwell, HarmonicDeviation, find_dwells, harmonic_check

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
