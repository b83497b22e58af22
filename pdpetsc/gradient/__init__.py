"""Gradient schemes: gradient points and their weights, one file per published scheme."""

from pdpetsc.gradient.base import GradientOperator, Scheme
from pdpetsc.gradient.bond_associated import BondAssociated
from pdpetsc.gradient.corrected import Corrected
from pdpetsc.gradient.correspondence import Correspondence
from pdpetsc.gradient.higher_order import HigherOrder
from pdpetsc.gradient.mean_dilatation import MeanDilatation
from pdpetsc.gradient.smoothed import SmoothedDisplacement
from pdpetsc.gradient.stress_points import StressPoints
from pdpetsc.gradient.sub_horizons import SubHorizons
from pdpetsc.gradient.weights import WEIGHTS, Conforming, Standard, Weights

__all__ = [
    "SCHEMES",
    "WEIGHTS",
    "BondAssociated",
    "Conforming",
    "Corrected",
    "Correspondence",
    "GradientOperator",
    "HigherOrder",
    "MeanDilatation",
    "Scheme",
    "SmoothedDisplacement",
    "Standard",
    "StressPoints",
    "SubHorizons",
    "Weights",
]

# Every scheme with its default options, under the word by which a case or the command line selects it.
SCHEMES: dict[str, Scheme] = {
    "correspondence": Correspondence(),
    "stress_points": StressPoints(),
    "sub_horizons": SubHorizons(),
    "corrected": Corrected(),
    "higher_order": HigherOrder(),
    "bond_associated": BondAssociated(),
}
