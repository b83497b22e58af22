"""Fields of stress and strain: von Mises, principal values, triaxiality; and the dissipation of damage."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.errors import CaseError
from pdpetsc.post.solution import Solution, deformation_gradient, in_space, stress

# A stress is hydrostatic if its deviator is below this share of it.
HYDROSTATIC = 1e-12


def von_mises(solution: Solution) -> Float:
    """Return ``sqrt(3/2 s : s)`` of the deviator of the Cauchy stress (n_owned,) [stress].

    The stress is the mean over the points of each particle, with its part across a line or plane body.
    """
    sigma = in_space(stress)(solution)
    deviator = sigma - _mean_stress(sigma)[:, None, None] * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("pij,pij->p", deviator, deviator)))


def principal_stresses(solution: Solution) -> Float:
    """Return the principal Cauchy stresses, the largest first (n_owned, 3) [stress].

    ``x``, ``y`` and ``z`` are their components; they include the stress across a line or plane body.
    """
    return np.asarray(np.linalg.eigvalsh(in_space(stress)(solution))[:, ::-1])


def principal_strains(solution: Solution) -> Float:
    """Return the principal strains, the largest first (n_owned, 3) [-].

    Logarithms of the stretches of the mean F of each particle; in linear bodies, whose strain is small, the principal
    values of ``(F + F^T) / 2 - I``. They include the strain across a plane body, and both lateral strains of a line.
    """
    F = in_space(deformation_gradient)(solution)
    if solution.problem.material_term.linear:
        return np.asarray(np.linalg.eigvalsh(0.5 * (F + F.transpose(0, 2, 1)) - np.eye(3))[:, ::-1])
    return np.asarray(0.5 * np.log(np.linalg.eigvalsh(np.einsum("pki,pkj->pij", F, F))[:, ::-1]))


def triaxiality(solution: Solution) -> Float:
    """Return the mean stress over the von Mises stress (n_owned,) [-].

    0 if there is no stress, infinite if it is hydrostatic to round-off.
    """
    mean = _mean_stress(in_space(stress)(solution))
    equivalent = von_mises(solution)
    hydrostatic = equivalent <= HYDROSTATIC * np.abs(mean)
    ratio = mean / np.where(hydrostatic, 1.0, equivalent)
    return np.asarray(np.where(hydrostatic & (mean != 0.0), np.copysign(np.inf, mean), ratio))


def damage_dissipation(solution: Solution) -> Float:
    """Return the energy dissipated by failing bonds or points per volume (n_owned,) [energy / volume].

    Each end of a bond has half of its energy. The integral over the body is ``pd.DissipatedEnergy()``.

    Raises
    ------
    CaseError
        The damage laws do not define the energy: bonds that fail in a body of deformation gradients, and criteria for
        which bonds are not linear.
    """
    if solution.problem.damage is None:
        return np.zeros(len(solution.x))
    density = solution.problem.material_term.dissipation_density()
    if density is None:
        raise CaseError(
            "The field damage_dissipation is that of bodies whose damage laws give their energy; of this body only "
            "the whole is known, as the quantity DissipatedEnergy."
        )
    return density


def _mean_stress(sigma: Float) -> Float:
    return np.asarray(np.einsum("pii->p", sigma) / 3.0)
