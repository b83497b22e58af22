"""Materials whose forces act along bonds: one file each."""

from pdpetsc.bond_based.base import BondMaterial, BondStiffness, Neighbourhood, combine
from pdpetsc.bond_based.linear_solid import LinearSolid
from pdpetsc.bond_based.microelastic import BondBased

__all__ = ["BondBased", "BondMaterial", "BondStiffness", "LinearSolid", "Neighbourhood", "combine"]
