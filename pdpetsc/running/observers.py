"""The observers of a run, in recording order."""

from __future__ import annotations

from collections.abc import Mapping

from pdpetsc.case import Case
from pdpetsc.errors import CaseError
from pdpetsc.output.broken import BrokenBonds
from pdpetsc.output.checkpoint import Checkpoints
from pdpetsc.output.crack import CrackLines
from pdpetsc.output.fields import Fields
from pdpetsc.output.final_picture import FinalPicture
from pdpetsc.output.history import History
from pdpetsc.output.observer import Observer, StepLines
from pdpetsc.post.of_terms import fields_of_terms, numbers_of_terms
from pdpetsc.problem.problem import Problem
from pdpetsc.running.doubts import Doubts
from pdpetsc.running.energy_balance import EnergyBalance
from pdpetsc.running.fragments import DetachedParticles, Fragments
from pdpetsc.running.large_strain import LargeStrain
from pdpetsc.running.modes import FoundModes
from pdpetsc.running.stabilisation_energy import StabilisationEnergy
from pdpetsc.running.stability import Stability
from pdpetsc.running.turned_regions import TurnedRegions
from pdpetsc.running.unbalanced_surface import UnbalancedForces
from pdpetsc.running.untouched_tools import UntouchedTools


def observers_of(case: Case, problem: Problem, declared: Mapping[str, str]) -> tuple[History, list[Observer]]:
    """Return the history, and all observers of a run in recording order."""
    damage, fields = problem.bond_damage, [*case.recorded, *fields_of_terms(problem)]
    of_terms = numbers_of_terms(problem)
    twice = set(of_terms) & set(case.quantities)
    if twice:
        raise CaseError(f"Two columns of the history are named {sorted(twice)[0]!r}. Rename the quantity of the case.")
    history = History({**of_terms, **case.quantities})
    # The energy of failing points includes their control.
    stabilises = case.control is not None and (problem.damage is None or not problem.damage.forces_have_energy)
    broken = [] if damage is None else [BrokenBonds(damage.bonds)]
    return history, [
        StepLines(),
        DetachedParticles(),
        *broken,
        *([Fields(fields, case.particles)] if fields else []),
        history,
        Doubts(case.history),
        *([StabilisationEnergy()] if stabilises else []),
        Checkpoints(case.checkpoints if case.solver.restarts else 0, declared, [history, *broken]),
        CrackLines(case.history.values()),
        Fragments(),
        UnbalancedForces(case),
        TurnedRegions(case),
        UntouchedTools(case),
        LargeStrain(case),
        EnergyBalance(case, problem),
        *([] if case.modes is None else [FoundModes(case, case.modes)]),
        Stability(case),
        FinalPicture(case.picture),
    ]
