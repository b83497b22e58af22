"""Zero-energy controls: forces linear in the displacement, one file per published control."""

from pdpetsc.control.averaged_displacement import AveragedDisplacement, RelativeAverage
from pdpetsc.control.base import Control, ZeroEnergyControl
from pdpetsc.control.by_shear import ByShear
from pdpetsc.control.littlewood import Littlewood
from pdpetsc.control.penalty import Penalty
from pdpetsc.control.silling import Silling, SillingMicromodulus
from pdpetsc.control.springs import RelativeSprings, Springs
from pdpetsc.control.tangent_scaled import TangentScaled
from pdpetsc.control.wan import Wan

__all__ = [
    "CONTROLS",
    "AveragedDisplacement",
    "ByShear",
    "Control",
    "Littlewood",
    "Penalty",
    "RelativeAverage",
    "RelativeSprings",
    "Silling",
    "SillingMicromodulus",
    "Springs",
    "TangentScaled",
    "Wan",
    "ZeroEnergyControl",
]

# Controls whose strength does not depend on units or spacing, by their name in case files.
CONTROLS: dict[str, ZeroEnergyControl | None] = {
    "none": None,
    "silling": Silling(),
    "littlewood": Littlewood(),
    "wan": Wan(),
    "springs": RelativeSprings(),
    "averaged_displacement": RelativeAverage(),
}
