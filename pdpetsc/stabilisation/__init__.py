"""Zero-energy controls: forces linear in the displacement, one file per published control."""

from pdpetsc.stabilisation.base import Control, Stabilisation
from pdpetsc.stabilisation.silling import Silling

__all__ = ["Control", "Silling", "Stabilisation"]
