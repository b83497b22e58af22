"""Materials, one per file: energy, first Piola-Kirchhoff stress and tangent at a point."""

from pdpetsc.material import hardening, rate, split
from pdpetsc.material.anisotropic import AnisotropicElastic, Orthotropic
from pdpetsc.material.base import (
    ElasticMaterial,
    HistoryKernels,
    HistoryMaterial,
    IsotropicMaterial,
    Material,
    PointKernels,
)
from pdpetsc.material.drucker_prager import DruckerPrager
from pdpetsc.material.hardening import Hardening
from pdpetsc.material.hencky import Hencky
from pdpetsc.material.hyperelastic import Hyperelastic
from pdpetsc.material.j2 import J2
from pdpetsc.material.kinematic import KinematicJ2
from pdpetsc.material.lagrangian import LagrangianMaterial, TensorResponse
from pdpetsc.material.linear_elastic import LinearElastic
from pdpetsc.material.logarithmic import LogarithmicMaterial, Response
from pdpetsc.material.maxwell import Maxwell
from pdpetsc.material.named_laws import HolzapfelGasserOgden, MooneyRivlin, Ogden, Yeoh
from pdpetsc.material.neo_hookean import NeoHookean
from pdpetsc.material.rate import RateLaw
from pdpetsc.material.saint_venant_kirchhoff import SaintVenantKirchhoff

__all__ = [
    "J2",
    "AnisotropicElastic",
    "DruckerPrager",
    "ElasticMaterial",
    "Hardening",
    "Hencky",
    "HistoryKernels",
    "HistoryMaterial",
    "HolzapfelGasserOgden",
    "Hyperelastic",
    "IsotropicMaterial",
    "KinematicJ2",
    "LagrangianMaterial",
    "LinearElastic",
    "LogarithmicMaterial",
    "Material",
    "Maxwell",
    "MooneyRivlin",
    "NeoHookean",
    "Ogden",
    "Orthotropic",
    "PointKernels",
    "RateLaw",
    "Response",
    "SaintVenantKirchhoff",
    "TensorResponse",
    "Yeoh",
    "hardening",
    "rate",
    "split",
]
