"""Zero-energy controls: forces linear in the displacement, one file per published control."""

from pdpetsc.stabilisation.averaged_displacement import AveragedDisplacement, RelativeAverage
from pdpetsc.stabilisation.base import Control, Stabilisation
from pdpetsc.stabilisation.littlewood import Littlewood
from pdpetsc.stabilisation.penalty import Penalty
from pdpetsc.stabilisation.silling import Silling, SillingMicromodulus
from pdpetsc.stabilisation.springs import RelativeSprings, Springs
from pdpetsc.stabilisation.wan import Wan

__all__ = [
    "CONTROLS",
    "AveragedDisplacement",
    "Control",
    "Littlewood",
    "Penalty",
    "RelativeAverage",
    "RelativeSprings",
    "Silling",
    "SillingMicromodulus",
    "Springs",
    "Stabilisation",
    "Wan",
]

# Every control whose strength does not depend on units or spacing, by the word that cases and the command line use.
CONTROLS: dict[str, Stabilisation | None] = {
    "none": None,
    "silling": Silling(),
    "littlewood": Littlewood(),
    "wan": Wan(),
    "springs": RelativeSprings(),
    "averaged_displacement": RelativeAverage(),
}
