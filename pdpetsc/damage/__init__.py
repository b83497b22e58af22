"""Damage of bonds: when a bond fails, and how it loses its force."""

from pdpetsc.damage.critical import ConstantCritical, CriticalFunction, CriticalStretch, FractureEnergy, LinearCritical
from pdpetsc.damage.effect import DamageEffect, LargestStretch, PresentStretch
from pdpetsc.damage.laws import (
    BilinearSoftening,
    BondDamage,
    Brittle,
    ExponentialSoftening,
    LinearSoftening,
    PiecewiseLinear,
    SmoothDegradation,
)

__all__ = [
    "BilinearSoftening",
    "BondDamage",
    "Brittle",
    "ConstantCritical",
    "CriticalFunction",
    "CriticalStretch",
    "DamageEffect",
    "ExponentialSoftening",
    "FractureEnergy",
    "LargestStretch",
    "LinearCritical",
    "LinearSoftening",
    "PiecewiseLinear",
    "PresentStretch",
    "SmoothDegradation",
]
