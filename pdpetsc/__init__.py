"""pdpetsc: MPI-parallel implicit peridynamics on PETSc.

A case file defines ``case(...) -> Case`` from the names below; ``run`` runs it.
"""

from typing import TYPE_CHECKING, Any

from pdpetsc import control, gradient, material
from pdpetsc.bond_based import BondBased, LinearSolid
from pdpetsc.control import *  # noqa: F403
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
from pdpetsc.declare import influence, region
from pdpetsc.declare.cell import Cell
from pdpetsc.declare.choice import choose
from pdpetsc.declare.conditions import BodyForce, Displacement, Force, MeanStrain, MeanStress, Pressure, Traction
from pdpetsc.declare.cracks import Disc, PlaneCrack, PolygonCrack, Polyline, Segment
from pdpetsc.declare.files import Mesh, TextFile
from pdpetsc.declare.particles import Arrays, Lattice
from pdpetsc.declare.schedule import Hold, Ramp, Table
from pdpetsc.declare.solvers import SOLVERS, BondStretch, DynamicRelaxation, EventDriven, Newton, Opening, PathFollowing
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.errors import CaseError, Interrupted, OutputError, RunError, SolveError
from pdpetsc.gradient import *  # noqa: F403
from pdpetsc.material import *  # noqa: F403
from pdpetsc.output.picture import Picture
from pdpetsc.post.quantities import (
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
from pdpetsc.post.solution import (
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
from pdpetsc.problem.state import State
from pdpetsc.problem.term import ExtraTerm, KeptArray, LinearisedTerm, PointTangent, Term

if TYPE_CHECKING:
    from pdpetsc.case import Case
    from pdpetsc.running.runner import run

__version__ = "0.2.0"

__all__ = [
    "SOLVERS",
    "AdaptiveSteps",
    "Arrays",
    "At",
    "BilinearSoftening",
    "BodyForce",
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
    "CrackTip",
    "CriticalFunction",
    "Disc",
    "Displacement",
    "DissipatedEnergy",
    "DynamicRelaxation",
    "EventDriven",
    "ExponentialSoftening",
    "ExternalWork",
    "ExtraTerm",
    "Force",
    "FractureEnergy",
    "Hold",
    "Interrupted",
    "KeptArray",
    "Largest",
    "LargestError",
    "LargestStretch",
    "Lattice",
    "LinearCritical",
    "LinearSoftening",
    "LinearSolid",
    "LinearisedTerm",
    "Mean",
    "MeanStrain",
    "MeanStress",
    "Mesh",
    "Newton",
    "Opening",
    "OutputError",
    "PathFollowing",
    "Picture",
    "PlaneCrack",
    "PointTangent",
    "PolygonCrack",
    "Polyline",
    "PresentStretch",
    "Pressure",
    "Quantity",
    "Ramp",
    "Reaction",
    "RelativeError",
    "RunError",
    "Segment",
    "SmoothDegradation",
    "Solution",
    "SolveError",
    "State",
    "Steps",
    "StrainEnergy",
    "Table",
    "Term",
    "TextFile",
    "Traction",
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
# What these rooms list is public: adding to one of them needs no line here.
__all__ += control.__all__
__all__ += gradient.__all__
__all__ += material.__all__


def __getattr__(name: str) -> Any:
    """Import ``Case`` and ``run`` on first use: they load PETSc, which must first see the command line."""
    if name == "Case":
        from pdpetsc.case import Case

        return Case
    if name == "run":
        from pdpetsc.running.runner import run

        return run
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
