"""The discrete body: residual, tangent and energy, composed from the layers below."""

from pdpetsc.model.assembler import Assembler
from pdpetsc.model.base import Model
from pdpetsc.model.bonds import BondModel
from pdpetsc.model.correspondence import CorrespondenceModel
from pdpetsc.model.damaged import DamagedCorrespondenceModel
from pdpetsc.model.linearised import Linearised
from pdpetsc.model.near import NearAssembler

__all__ = [
    "Assembler",
    "BondModel",
    "CorrespondenceModel",
    "DamagedCorrespondenceModel",
    "Linearised",
    "Model",
    "NearAssembler",
]
