"""Damage of bonds: what drives it, and how a bond loses its force."""

from pdpetsc.damage.at_points import JohnsonCookFailure, MazarsStrain, PlasticStrain, PrincipalStress, VonMisesStrain
from pdpetsc.damage.criterion import Beyond, Criterion, Drive, DrivenBonds, Gradient, LinearDrive, LocalDrive, OfEnds
from pdpetsc.damage.critical import ConstantCritical, CriticalFunction, CriticalStretch, FractureEnergy, LinearCritical
from pdpetsc.damage.effect import DamageEffect, LargestStretch, PresentStretch
from pdpetsc.damage.energy import BondEnergy
from pdpetsc.damage.laws import (
    BilinearSoftening,
    BondDamage,
    Brittle,
    ExponentialSoftening,
    LinearSoftening,
    PiecewiseLinear,
    SmoothDegradation,
)
from pdpetsc.damage.several import DamageOf

__all__ = [
    "Beyond",
    "BilinearSoftening",
    "BondDamage",
    "BondEnergy",
    "Brittle",
    "ConstantCritical",
    "Criterion",
    "CriticalFunction",
    "CriticalStretch",
    "DamageEffect",
    "DamageOf",
    "Drive",
    "DrivenBonds",
    "ExponentialSoftening",
    "FractureEnergy",
    "Gradient",
    "JohnsonCookFailure",
    "LargestStretch",
    "LinearCritical",
    "LinearDrive",
    "LinearSoftening",
    "LocalDrive",
    "MazarsStrain",
    "OfEnds",
    "PiecewiseLinear",
    "PlasticStrain",
    "PresentStretch",
    "PrincipalStress",
    "SmoothDegradation",
    "VonMisesStrain",
]
