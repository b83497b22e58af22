"""Damage of bonds: what drives it, and how a bond loses its force."""

from pdpetsc.damage.criterion import Beyond, Criterion, Drive, DrivenBonds, Gradient, LinearDrive, LocalDrive
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
    "Beyond",
    "BilinearSoftening",
    "BondDamage",
    "Brittle",
    "ConstantCritical",
    "Criterion",
    "CriticalFunction",
    "CriticalStretch",
    "DamageEffect",
    "Drive",
    "DrivenBonds",
    "ExponentialSoftening",
    "FractureEnergy",
    "Gradient",
    "LargestStretch",
    "LinearCritical",
    "LinearDrive",
    "LinearSoftening",
    "LocalDrive",
    "PiecewiseLinear",
    "PresentStretch",
    "SmoothDegradation",
]
