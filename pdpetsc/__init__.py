"""pdpetsc: MPI-parallel implicit peridynamics on PETSc.

A case file defines ``case(...) -> Case`` from the names below; ``run`` runs it.
"""

from typing import TYPE_CHECKING, Any

from pdpetsc.bond_based import BondBased, LinearSolid
from pdpetsc.damage import (
    BilinearSoftening,
    Brittle,
    ConstantCritical,
    CriticalFunction,
    ExponentialSoftening,
    FractureEnergy,
    LargestStretch,
    LinearCritical,
    LinearSoftening,
    PresentStretch,
    SmoothDegradation,
)
from pdpetsc.errors import CaseError, Interrupted, OutputError, RunError, SolveError
from pdpetsc.gradient import (
    SCHEMES,
    BondAssociated,
    Corrected,
    Correspondence,
    HigherOrder,
    SmoothedDisplacement,
    StressPoints,
    SubHorizons,
)
from pdpetsc.material import J2, Graded, Hencky, LinearElastic, NeoHookean, SaintVenantKirchhoff
from pdpetsc.output.picture import Picture
from pdpetsc.quantities import (
    At,
    BrokenBonds,
    CellStrain,
    CellStress,
    ControlEnergy,
    CrackTip,
    DissipatedEnergy,
    ExternalWork,
    Largest,
    LargestError,
    Mean,
    Quantity,
    Reaction,
    RelativeError,
    StrainEnergy,
)
from pdpetsc.scene import influence, region
from pdpetsc.scene.cell import Cell
from pdpetsc.scene.choice import choose
from pdpetsc.scene.conditions import BodyForce, Displacement, Force, MeanStrain, MeanStress, Pressure, Traction
from pdpetsc.scene.cracks import Disc, PlaneCrack, PolygonCrack, Polyline, Segment
from pdpetsc.scene.files import Mesh, TextFile
from pdpetsc.scene.particles import Arrays, Lattice
from pdpetsc.scene.schedule import Hold, Ramp, Table
from pdpetsc.scene.solver import SOLVERS, BondStretch, DynamicRelaxation, EventDriven, Newton, Opening, PathFollowing
from pdpetsc.scene.steps import AdaptiveSteps, Steps
from pdpetsc.solution import (
    Solution,
    deformation_gradient,
    displacement,
    energy_density,
    first_piola_stress,
    local_damage,
    lost_bonds,
    plastic_strain,
    reaction,
    stress,
)
from pdpetsc.stabilisation import (
    CONTROLS,
    AveragedDisplacement,
    Littlewood,
    Penalty,
    RelativeAverage,
    RelativeSprings,
    Silling,
    SillingMicromodulus,
    Springs,
    Wan,
)

if TYPE_CHECKING:
    from pdpetsc.case import Case
    from pdpetsc.runner import run

__version__ = "0.1.0"

__all__ = [
    "CONTROLS",
    "J2",
    "SCHEMES",
    "SOLVERS",
    "AdaptiveSteps",
    "Arrays",
    "At",
    "AveragedDisplacement",
    "BilinearSoftening",
    "BodyForce",
    "BondAssociated",
    "BondBased",
    "BondStretch",
    "Brittle",
    "BrokenBonds",
    "Case",
    "CaseError",
    "Cell",
    "CellStrain",
    "CellStress",
    "ConstantCritical",
    "ControlEnergy",
    "Corrected",
    "Correspondence",
    "CrackTip",
    "CriticalFunction",
    "Disc",
    "Displacement",
    "DissipatedEnergy",
    "DynamicRelaxation",
    "EventDriven",
    "ExponentialSoftening",
    "ExternalWork",
    "Force",
    "FractureEnergy",
    "Graded",
    "Hencky",
    "HigherOrder",
    "Hold",
    "Interrupted",
    "Largest",
    "LargestError",
    "LargestStretch",
    "Lattice",
    "LinearCritical",
    "LinearElastic",
    "LinearSoftening",
    "LinearSolid",
    "Littlewood",
    "Mean",
    "MeanStrain",
    "MeanStress",
    "Mesh",
    "NeoHookean",
    "Newton",
    "Opening",
    "OutputError",
    "PathFollowing",
    "Penalty",
    "Picture",
    "PlaneCrack",
    "PolygonCrack",
    "Polyline",
    "PresentStretch",
    "Pressure",
    "Quantity",
    "Ramp",
    "Reaction",
    "RelativeAverage",
    "RelativeError",
    "RelativeSprings",
    "RunError",
    "SaintVenantKirchhoff",
    "Segment",
    "Silling",
    "SillingMicromodulus",
    "SmoothDegradation",
    "SmoothedDisplacement",
    "Solution",
    "SolveError",
    "Springs",
    "Steps",
    "StrainEnergy",
    "StressPoints",
    "SubHorizons",
    "Table",
    "TextFile",
    "Traction",
    "Wan",
    "choose",
    "deformation_gradient",
    "displacement",
    "energy_density",
    "first_piola_stress",
    "influence",
    "local_damage",
    "lost_bonds",
    "plastic_strain",
    "reaction",
    "region",
    "run",
    "stress",
]


def __getattr__(name: str) -> Any:
    """Import ``Case`` and ``run`` on first use: they load PETSc, which must first see the command line."""
    if name == "Case":
        from pdpetsc.case import Case

        return Case
    if name == "run":
        from pdpetsc.runner import run

        return run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
