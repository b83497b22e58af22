"""Damage of bonds: when a bond fails, and how it loses its force."""

from pdpetsc.damage.bond import BondDamage, Brittle, LinearSoftening
from pdpetsc.damage.critical import ConstantCritical, CriticalFunction, CriticalStretch, LinearCritical

__all__ = [
    "BondDamage",
    "Brittle",
    "ConstantCritical",
    "CriticalFunction",
    "CriticalStretch",
    "LinearCritical",
    "LinearSoftening",
]
