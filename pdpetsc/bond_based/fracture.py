"""Critical stretch from fracture energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.bond_based.base import Neighbourhood
from pdpetsc.damage import BondDamage, ConstantCritical, FractureEnergy
from pdpetsc.discrete.communicator import largest, total

# Families whose energy is within this share of the largest one count as whole.
WHOLE = 0.05


def resolve(damage: BondDamage, bonds: Neighbourhood, k: Float) -> BondDamage:
    """Return the law with a fracture energy turned into a critical stretch; other laws unchanged (collective).

    Breaking all bonds across a unit area with normal ``n`` takes ``G = 1 / V_i sum_j w_ij |xi . n|`` with the energy
    ``w_ij`` of a bond from one end, averaged over the axes and the whole families of the body.

    Parameters
    ----------
    damage : BondDamage
        The law.
    bonds : Neighbourhood
        The bonds.
    k : (n_bonds,) float64
        Their stiffness from one end [force / length].
    """
    if not isinstance(damage.critical, FractureEnergy):
        return damage
    cloud, families = bonds.cloud, bonds.families
    one = np.ones(1)
    share = float(damage.dissipated(0.0 * one, damage.final * one, one, one)[0])
    energy = share * k * bonds.length**2 * np.abs(families.bonds(cloud.x)).mean(axis=1)
    G = np.bincount(families.centres, energy, cloud.n_owned) / cloud.volume[: cloud.n_owned]
    whole = (1.0 - WHOLE) * largest(cloud.comm, float(G.max(initial=0.0))) <= G
    sums = total(cloud.comm, [float(G[whole].sum()), float(np.count_nonzero(whole))])
    return replace(damage, critical=ConstantCritical(float(np.sqrt(damage.critical.Gc * sums[1] / sums[0]))))
