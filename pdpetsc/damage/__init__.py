"""Damage of bonds and of gradient points: criteria, damage laws, evolution and state."""

from typing import Any

from pdpetsc.damage import softening
from pdpetsc.damage.at_points import JohnsonCookFailure, MazarsStrain, PlasticStrain, PrincipalStress, VonMisesStrain
from pdpetsc.damage.criterion import (
    Criterion,
    DamageableBonds,
    DrivingVariable,
    EndpointMean,
    Gradient,
    LinearDrivingVariable,
    LocalDrivingVariable,
    NonlocalPart,
)
from pdpetsc.damage.critical import ConstantCritical, CriticalFunction, CriticalStretch, FractureEnergy, LinearCritical
from pdpetsc.damage.energy import BondEnergy
from pdpetsc.damage.evolution import DamageEvolution, LargestStretch, PresentStretch
from pdpetsc.damage.laws import (
    BilinearSoftening,
    BondDamage,
    Brittle,
    ExponentialSoftening,
    LinearSoftening,
    PiecewiseLinear,
    SmoothDegradation,
)
from pdpetsc.damage.point_damage import PointDamage
from pdpetsc.damage.several import DamageOf
from pdpetsc.damage.softening import SofteningCurve
from pdpetsc.renamed import warn

__all__ = [
    "BilinearSoftening",
    "BondDamage",
    "BondEnergy",
    "Brittle",
    "ConstantCritical",
    "Criterion",
    "CriticalFunction",
    "CriticalStretch",
    "DamageEvolution",
    "DamageOf",
    "DamageableBonds",
    "DrivingVariable",
    "EndpointMean",
    "ExponentialSoftening",
    "FractureEnergy",
    "Gradient",
    "JohnsonCookFailure",
    "LargestStretch",
    "LinearCritical",
    "LinearDrivingVariable",
    "LinearSoftening",
    "LocalDrivingVariable",
    "MazarsStrain",
    "NonlocalPart",
    "PiecewiseLinear",
    "PlasticStrain",
    "PointDamage",
    "PresentStretch",
    "PrincipalStress",
    "SmoothDegradation",
    "SofteningCurve",
    "VonMisesStrain",
    "softening",
]

# New names of renamed classes.
_RENAMED = {
    "Beyond": "NonlocalPart",
    "DamageEffect": "DamageEvolution",
    "Drive": "DrivingVariable",
    "DrivenBonds": "DamageableBonds",
    "LinearDrive": "LinearDrivingVariable",
    "LocalDrive": "LocalDrivingVariable",
    "OfEnds": "EndpointMean",
}


def __getattr__(name: str) -> Any:
    """Return a renamed class with a warning."""
    if name in _RENAMED:
        warn(f"pdpetsc.damage.{name}", _RENAMED[name])
        return globals()[_RENAMED[name]]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
