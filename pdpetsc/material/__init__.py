"""Materials: one file each, giving energy, first Piola-Kirchhoff stress and tangent at a point."""

from pdpetsc.material.anisotropic import AnisotropicElastic, Orthotropic
from pdpetsc.material.base import (
    ElasticMaterial,
    HistoryKernels,
    HistoryMaterial,
    IsotropicMaterial,
    Material,
    PointKernels,
)
from pdpetsc.material.graded import Graded
from pdpetsc.material.hencky import Hencky
from pdpetsc.material.hyperelastic import Hyperelastic
from pdpetsc.material.j2 import J2
from pdpetsc.material.linear_elastic import LinearElastic
from pdpetsc.material.named_laws import HolzapfelGasserOgden, MooneyRivlin, Ogden, Yeoh
from pdpetsc.material.neo_hookean import NeoHookean
from pdpetsc.material.saint_venant_kirchhoff import SaintVenantKirchhoff
from pdpetsc.material.thermal import Thermal

__all__ = [
    "J2",
    "AnisotropicElastic",
    "ElasticMaterial",
    "Graded",
    "Hencky",
    "HistoryKernels",
    "HistoryMaterial",
    "HolzapfelGasserOgden",
    "Hyperelastic",
    "IsotropicMaterial",
    "LinearElastic",
    "Material",
    "MooneyRivlin",
    "NeoHookean",
    "Ogden",
    "Orthotropic",
    "PointKernels",
    "SaintVenantKirchhoff",
    "Thermal",
    "Yeoh",
]
