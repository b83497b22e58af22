"""pdpetsc: MPI-parallel implicit peridynamics on PETSc.

A case file defines ``case(...) -> Case`` from the names below; ``run`` runs it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import pdpetsc.loading  # noqa: F401 - first: it says what cannot be loaded
from pdpetsc import control, gradient, material
from pdpetsc.bond_based import BondBased, LinearSolid
from pdpetsc.case import Case
from pdpetsc.control import *  # noqa: F403
from pdpetsc.damage import (
    BilinearSoftening,
    BondEnergy,
    Brittle,
    ConstantCritical,
    CriticalFunction,
    DamageOf,
    ExponentialSoftening,
    FractureEnergy,
    JohnsonCookFailure,
    LargestStretch,
    LinearCritical,
    LinearSoftening,
    MazarsStrain,
    PlasticStrain,
    PointDamage,
    PresentStretch,
    PrincipalStress,
    SmoothDegradation,
    VonMisesStrain,
    softening,
)
from pdpetsc.declare import influence, region
from pdpetsc.declare.bodies import Bodies
from pdpetsc.declare.body_contact import BodyContact, ParticleContact, Tied
from pdpetsc.declare.cell import Cell
from pdpetsc.declare.choice import choose
from pdpetsc.declare.conditions import (
    Acceleration,
    BodyForce,
    Centrifugal,
    CrackPressure,
    Displacement,
    FollowerPressure,
    Force,
    InitialVelocity,
    MeanStrain,
    MeanStress,
    Pressure,
    SurfacePressure,
    Traction,
    Velocity,
)
from pdpetsc.declare.cracks import Disc, PlaneCrack, PolygonCrack, Polyline, Segment
from pdpetsc.declare.damping import AbsorbingBoundary, BulkViscosity, RayleighDamping
from pdpetsc.declare.expected import Expected
from pdpetsc.declare.files import Mesh, MeshNodes
from pdpetsc.declare.horizon import Horizon
from pdpetsc.declare.modes import FrequencyResponse, Modes
from pdpetsc.declare.particles import Arrays, Lattice, LatticeNodes
from pdpetsc.declare.rigid_surface import RigidSurface
from pdpetsc.declare.schedule import Hold, Ramp, Table
from pdpetsc.declare.solvers import (
    SOLVERS,
    ArcLength,
    BondStretch,
    Dissipation,
    DynamicRelaxation,
    EventDriven,
    Explicit,
    Implicit,
    Newton,
    Opening,
    PathFollowing,
    SnapThrough,
)
from pdpetsc.declare.steps import AdaptiveSteps, Steps
from pdpetsc.declare.supports import Clamp, Foundation, PointSupport, RigidRegion, Roller
from pdpetsc.declare.surface import Facets
from pdpetsc.declare.symmetry import Symmetry
from pdpetsc.declare.text_file import TextFile
from pdpetsc.declare.thermal import (
    Convection,
    Eigenstrain,
    HeatConduction,
    HeatFlux,
    HeatSource,
    Temperature,
)
from pdpetsc.declare.tools import Contact, RigidBox, RigidCylinder, RigidPlane, RigidSphere, RigidTool
from pdpetsc.declare.units import Units
from pdpetsc.declared import meant
from pdpetsc.errors import CaseError, CheckError, Interrupted, OutputError, RunError, SolveError
from pdpetsc.gradient import *  # noqa: F403
from pdpetsc.gradient.products import PointBlocks, Product
from pdpetsc.material import *  # noqa: F403
from pdpetsc.material.graded import Graded
from pdpetsc.material.thermal import Thermal
from pdpetsc.post.invariants import damage_dissipation, principal_strains, principal_stresses, triaxiality, von_mises
from pdpetsc.post.picture import Picture
from pdpetsc.post.quantities import (
    At,
    BrokenBonds,
    CellStrain,
    CellStress,
    ControlEnergy,
    CrackSpeed,
    CrackTip,
    DissipatedEnergy,
    EnergyError,
    ExternalWork,
    KineticEnergy,
    Largest,
    LargestError,
    Mean,
    OnSurface,
    Quantity,
    Reaction,
    ReactionMoment,
    RelativeError,
    Smallest,
    StrainEnergy,
)
from pdpetsc.post.sampling import grid, line
from pdpetsc.post.solution import (
    Solution,
    deformation_gradient,
    displacement,
    energy_density,
    first_piola_stress,
    heat_flux,
    local_damage,
    local_horizon,
    lost_bonds,
    plastic_strain,
    reaction,
    stress,
    temperature,
    velocity,
)
from pdpetsc.problem.state import State
from pdpetsc.problem.term import ExtraTerm, KeptArray, Term
from pdpetsc.renamed import warn

if TYPE_CHECKING:
    from pdpetsc.post.crack_path import CrackLength, crack_faces, crack_lines
    from pdpetsc.post.fracture import EnergyReleaseRate, JIntegral, StressIntensity
    from pdpetsc.post.opening import CrackOpening
    from pdpetsc.running.comparison import Comparison, compare
    from pdpetsc.running.prepare import Prepared, prepare
    from pdpetsc.running.result import Result, open_run
    from pdpetsc.running.runner import run
    from pdpetsc.studies.fit import fit
    from pdpetsc.studies.study import Refinement, study

    open = open_run

__version__ = "0.2.0"

__all__ = [
    "SOLVERS",
    "AbsorbingBoundary",
    "Acceleration",
    "AdaptiveSteps",
    "ArcLength",
    "Arrays",
    "At",
    "BilinearSoftening",
    "Bodies",
    "BodyContact",
    "BodyForce",
    "BondBased",
    "BondEnergy",
    "BondStretch",
    "Brittle",
    "BrokenBonds",
    "BulkViscosity",
    "Case",
    "CaseError",
    "Cell",
    "CellStrain",
    "CellStress",
    "Centrifugal",
    "CheckError",
    "Clamp",
    "Comparison",
    "ConstantCritical",
    "Contact",
    "ControlEnergy",
    "Convection",
    "CrackLength",
    "CrackOpening",
    "CrackPressure",
    "CrackSpeed",
    "CrackTip",
    "CriticalFunction",
    "DamageOf",
    "Disc",
    "Displacement",
    "DissipatedEnergy",
    "Dissipation",
    "DynamicRelaxation",
    "Eigenstrain",
    "EnergyError",
    "EnergyReleaseRate",
    "EventDriven",
    "Expected",
    "Explicit",
    "ExponentialSoftening",
    "ExternalWork",
    "ExtraTerm",
    "Facets",
    "FollowerPressure",
    "Force",
    "Foundation",
    "FractureEnergy",
    "FrequencyResponse",
    "Graded",
    "HeatConduction",
    "HeatFlux",
    "HeatSource",
    "Hold",
    "Horizon",
    "Implicit",
    "InitialVelocity",
    "Interrupted",
    "JIntegral",
    "JohnsonCookFailure",
    "KeptArray",
    "KineticEnergy",
    "Largest",
    "LargestError",
    "LargestStretch",
    "Lattice",
    "LatticeNodes",
    "LinearCritical",
    "LinearSoftening",
    "LinearSolid",
    "MazarsStrain",
    "Mean",
    "MeanStrain",
    "MeanStress",
    "Mesh",
    "MeshNodes",
    "Modes",
    "Newton",
    "OnSurface",
    "Opening",
    "OutputError",
    "ParticleContact",
    "PathFollowing",
    "Picture",
    "PlaneCrack",
    "PlasticStrain",
    "PointBlocks",
    "PointDamage",
    "PointSupport",
    "PolygonCrack",
    "Polyline",
    "Prepared",
    "PresentStretch",
    "Pressure",
    "PrincipalStress",
    "Product",
    "Quantity",
    "Ramp",
    "RayleighDamping",
    "Reaction",
    "ReactionMoment",
    "Refinement",
    "RelativeError",
    "Result",
    "RigidBox",
    "RigidCylinder",
    "RigidPlane",
    "RigidRegion",
    "RigidSphere",
    "RigidSurface",
    "RigidTool",
    "Roller",
    "RunError",
    "Segment",
    "Smallest",
    "SmoothDegradation",
    "SnapThrough",
    "Solution",
    "SolveError",
    "State",
    "Steps",
    "StrainEnergy",
    "StressIntensity",
    "SurfacePressure",
    "Symmetry",
    "Table",
    "Temperature",
    "Term",
    "TextFile",
    "Thermal",
    "Tied",
    "Traction",
    "Units",
    "Velocity",
    "VonMisesStrain",
    "choose",
    "compare",
    "crack_faces",
    "crack_lines",
    "damage_dissipation",
    "deformation_gradient",
    "displacement",
    "energy_density",
    "first_piola_stress",
    "fit",
    "grid",
    "heat_flux",
    "influence",
    "line",
    "local_damage",
    "local_horizon",
    "lost_bonds",
    "open",
    "plastic_strain",
    "prepare",
    "principal_strains",
    "principal_stresses",
    "reaction",
    "region",
    "run",
    "softening",
    "stress",
    "study",
    "temperature",
    "triaxiality",
    "velocity",
    "von_mises",
]
# What these rooms list is public: adding to one of them needs no line here.
__all__ += control.__all__
__all__ += gradient.__all__
__all__ += material.__all__


# Imported on first use: what runs a case loads PETSc, which must first see the command line, and a satellite is a room
# that nothing else needs.
_LAZY = {
    "CrackLength": ("pdpetsc.post.crack_path", "CrackLength"),
    "CrackOpening": ("pdpetsc.post.opening", "CrackOpening"),
    "EnergyReleaseRate": ("pdpetsc.post.fracture", "EnergyReleaseRate"),
    "JIntegral": ("pdpetsc.post.fracture", "JIntegral"),
    "StressIntensity": ("pdpetsc.post.fracture", "StressIntensity"),
    "crack_faces": ("pdpetsc.post.crack_path", "crack_faces"),
    "crack_lines": ("pdpetsc.post.crack_path", "crack_lines"),
    "Comparison": ("pdpetsc.running.comparison", "Comparison"),
    "compare": ("pdpetsc.running.comparison", "compare"),
    "Prepared": ("pdpetsc.running.prepare", "Prepared"),
    "Refinement": ("pdpetsc.studies.study", "Refinement"),
    "Result": ("pdpetsc.running.result", "Result"),
    "open": ("pdpetsc.running.result", "open_run"),
    "prepare": ("pdpetsc.running.prepare", "prepare"),
    "run": ("pdpetsc.running.runner", "run"),
    "fit": ("pdpetsc.studies.fit", "fit"),
    "study": ("pdpetsc.studies.study", "study"),
}


# New name of each old one.
_RENAMED = {
    "Following": "TangentScaled",
    "LinearisedTerm": "Product",
    "PointTangent": "PointBlocks",
    "reach": "local_horizon",
}


def __getattr__(name: str) -> Any:
    """Import on first use, and return a renamed object with a warning."""
    if name in _LAZY:
        module, of_module = _LAZY[name]
        return getattr(import_module(module), of_module)
    if name in _RENAMED:
        warn(f"pd.{name}", f"pd.{_RENAMED[name]}")
        return globals()[_RENAMED[name]]
    near = "" if name.startswith("_") else meant(name, __all__, "; did you mean {}?")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{near}", name=name)
