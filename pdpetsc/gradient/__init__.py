"""Gradient schemes: where deformation gradients are evaluated and with which weights, one file per published scheme."""

from pdpetsc.gradient.base import GradientOperator, Scheme
from pdpetsc.gradient.correspondence import Correspondence
from pdpetsc.gradient.sub_horizons import SubHorizons

__all__ = ["Correspondence", "GradientOperator", "Scheme", "SubHorizons"]
