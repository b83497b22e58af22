"""Wan's control, which needs no parameter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pdpetsc.arrays import Float
from pdpetsc.control.base import Control, Stiffness, ZeroEnergyControl
from pdpetsc.control.non_uniform import Directed
from pdpetsc.control.projection import gradient_weights
from pdpetsc.discrete.cloud import Cloud
from pdpetsc.discrete.families import Families
from pdpetsc.errors import CaseError

# Indices of A that are contracted with the inverse shape tensor.
_CONTRACTIONS = {"gradient": "imkn,pmn->pik", "stress": "ikmn,pmn->pik"}


@dataclass(frozen=True)
class Wan(ZeroEnergyControl):
    """Wan's control, ``T_z = omega C_i z`` with ``C_i,ik = A_imkn (K_i^-1)_mn`` and ``z = eta - (F - I) xi``.

    A is the small-strain stiffness of the material and K the shape tensor, so there is no parameter. On a regular
    lattice it is Silling's control with ``G kappa = dim (lambda + (dim + 1) mu)``: at nu = 1/4, G = 4 in plane strain
    and 9 in 3D, too stiff for the bending of thin bodies.

    Parameters
    ----------
    contraction : {"gradient", "stress"}
        ``"gradient"``: as above. ``"stress"``: ``C_i = A : K_i^-1``, ``C_i,ik = A_ikmn (K_i^-1)_mn``, which PeriLab
        calls *Global*: on a regular lattice Silling's control with ``G kappa = dim (dim lambda + 2 mu)``.

    Raises
    ------
    CaseError
        The contraction is unknown.

    References
    ----------
    Wan2019.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> control = pd.Wan()
    """

    contraction: Literal["gradient", "stress"] = "gradient"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.contraction not in _CONTRACTIONS:
            raise CaseError(f'Wan takes contraction="gradient" or "stress", not {self.contraction!r}.')

    def build(self, cloud: Cloud, families: Families, omega: Float, stiffness: Stiffness) -> Control:
        """Build the control (collective); raise CaseError if a family is too small or flat."""
        g, K_inverse = gradient_weights(cloud, families, omega, "Wan's control")
        C = np.zeros((cloud.n_owned, cloud.dim, cloud.dim))
        for number, A in enumerate(stiffness.moduli):
            mine = stiffness.material_of == number
            C[mine] = np.einsum(_CONTRACTIONS[self.contraction], A, K_inverse[mine])
        C *= stiffness.factor[:, None, None]
        centres = families.centres
        weight = omega * cloud.volume[families.neighbours] * cloud.volume[centres]
        return Directed(cloud, families, weight[:, None, None] * C[centres], g)
