"""What a crack that runs takes of the fracture energy that its bonds were given: shares that have been measured.

A fracture energy fixes what pulling two rigid halves apart takes. A crack that runs takes another share of it, which
depends on the model, on how bonds fail and on how many a family has. ``MEASURED`` holds the shares of the strip in
``runs/fracture/surfing.py``, along which the field of a crack tip moves: its work less what it stores, for each length
of crack, which repeats from spacing to spacing to a few thousandths. What is not in it has not been measured, or has no
such share: with sub-horizons, and with exponential and bilinear softening of correspondence, no crack of that strip
takes the same energy from one spacing to the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from pdpetsc.bond_based import BondBased, LinearSolid
from pdpetsc.case import Case, ungraded
from pdpetsc.control import Silling
from pdpetsc.damage import (
    BilinearSoftening,
    BondDamage,
    Brittle,
    ConstantCritical,
    ExponentialSoftening,
    FractureEnergy,
    LinearSoftening,
    SmoothDegradation,
)
from pdpetsc.declare.influence import Constant
from pdpetsc.declare.particles import Lattice
from pdpetsc.gradient import Correspondence
from pdpetsc.gradient.weights import Standard
from pdpetsc.material import Hencky, LinearElastic

# Horizons over the spacing that differ by less, relatively, have the same families on a square lattice.
SAME_HORIZON = 0.005
# The numbers of a law that a share was measured with and those of a case differ by less, relatively.
SAME_LAW = 1e-9
_ANY = ConstantCritical(1.0)
LAWS: dict[str, BondDamage] = {
    "brittle": Brittle(_ANY),
    "linear": LinearSoftening(_ANY, 3.0),
    "short": LinearSoftening(_ANY, 2.0),
    "exponential": ExponentialSoftening(_ANY),
    "bilinear": BilinearSoftening(_ANY),
    "smooth": SmoothDegradation(_ANY),
}


@dataclass(frozen=True)
class MeasuredShare:
    """A share that was measured.

    Attributes
    ----------
    model, law : str
        As ``runs/fracture/surfing.py`` calls them.
    horizon : float
        Over the spacing of a square lattice [-].
    nu : (float, float)
        Poisson's ratios in plane stress from and to which it holds [-].
    share : float
        What a crack that runs takes of the energy that pulling rigid halves apart takes [-].
    within : float
        By how much lattices with another number of particles across, these Poisson's ratios and, of bonds, cracks at 45
        degrees to the lattice differ from it, as far as they were measured [-].
    """

    model: str
    law: str
    horizon: float
    nu: tuple[float, float]
    share: float
    within: float

    @property
    def command(self) -> str:
        """Return what measures it again: ``taken_over_Gc`` is 1 with it."""
        return (
            f"python -m pdpetsc runs/fracture/surfing.py model={self.model} law={self.law} horizon={self.horizon:g} "
            f"nu={0.5 * sum(self.nu):g} share={self.share:g}"
        )


_BONDS, _SOLID = (1.0 / 3.0, 1.0 / 3.0), (0.1, 0.4)
_FIFTH, _QUARTER, _THREE_TENTHS, _THIRD = (0.19, 0.21), (0.24, 0.26), (0.29, 0.31), (0.32, 0.34)
MEASURED: tuple[MeasuredShare, ...] = (
    MeasuredShare("bonds", "linear", 3.015, _BONDS, 1.0, 0.03),
    MeasuredShare("bonds", "short", 3.015, _BONDS, 1.05, 0.04),
    MeasuredShare("bonds", "exponential", 3.015, _BONDS, 1.0, 0.03),
    MeasuredShare("bonds", "bilinear", 3.015, _BONDS, 1.0, 0.03),
    MeasuredShare("bonds", "brittle", 3.015, _BONDS, 1.47, 0.06),
    MeasuredShare("bonds", "smooth", 3.015, _BONDS, 1.27, 0.04),
    MeasuredShare("bonds", "linear", 2.015, _BONDS, 1.06, 0.04),
    MeasuredShare("bonds", "exponential", 2.015, _BONDS, 1.09, 0.04),
    MeasuredShare("bonds", "bilinear", 2.015, _BONDS, 1.03, 0.03),
    MeasuredShare("bonds", "brittle", 2.015, _BONDS, 2.01, 0.06),
    MeasuredShare("bonds", "linear", 4.015, _BONDS, 1.0, 0.03),
    MeasuredShare("bonds", "brittle", 4.015, _BONDS, 1.26, 0.07),
    MeasuredShare("linear_solid", "linear", 3.015, _SOLID, 1.08, 0.03),
    MeasuredShare("linear_solid", "short", 3.015, _QUARTER, 1.09, 0.04),
    MeasuredShare("linear_solid", "exponential", 3.015, _QUARTER, 1.08, 0.03),
    MeasuredShare("linear_solid", "bilinear", 3.015, _QUARTER, 1.08, 0.03),
    MeasuredShare("linear_solid", "brittle", 3.015, _QUARTER, 1.54, 0.07),
    MeasuredShare("correspondence", "short", 3.015, _QUARTER, 0.435, 0.05),
    MeasuredShare("correspondence", "linear", 3.015, _FIFTH, 0.34, 0.05),
    MeasuredShare("correspondence", "linear", 3.015, _QUARTER, 0.365, 0.04),
    MeasuredShare("correspondence", "linear", 3.015, _THREE_TENTHS, 0.396, 0.04),
    MeasuredShare("correspondence", "linear", 3.015, _THIRD, 0.415, 0.04),
    MeasuredShare("correspondence", "linear", 2.015, _QUARTER, 0.397, 0.05),
    MeasuredShare("correspondence", "brittle", 3.015, _QUARTER, 0.79, 0.05),
)


@dataclass(frozen=True)
class CrackShare:
    """What is known of the share of a fracture energy that the cracks of a case take.

    Attributes
    ----------
    share : float or None
        What the energy of the bonds is divided by [-]; None where nobody has measured it.
    within : float or None
        How well it is known [-].
    said : str
        A sentence about it for the log.
    grave : bool
        Whether the crack may take a fraction of the energy that was declared, or a multiple, for all that is known.
    """

    share: float | None
    within: float | None
    said: str
    grave: bool

    @property
    def record(self) -> dict[str, Any]:
        """Return it for the summary."""
        return {"share": self.share, "within": self.within, "known": self.share is not None, "note": self.said}


def crack_share(case: Case) -> CrackShare | None:
    """Return what is known of the share that cracks of a case take; None where none is assumed (not collective).

    A share that the case gives is its own affair, and so is a critical stretch; along a line there is no crack.
    """
    if case.damage is None or not case.damage.assumes_share or getattr(case.particles, "dim", 2) == 1:
        return None
    found, why = _found(case)
    if found is not None:
        share = found.share * _of_plane(_materials(case)[0])
        said = (
            f"fracture energy: a running crack takes {share:.4g} of what pulling two halves apart takes, known to "
            f"{100.0 * found.within:.0f} % ({found.model}, {found.law} at {found.horizon:g} spacings); bonds have Gc / "
            f"{share:.4g}"
        )
        return CrackShare(share, found.within, said, False)
    if case.of_bonds:
        said = (
            f"fracture energy: it is that of two halves pulled apart, and what a running crack takes is not known "
            f"here, because {why}; where it was measured that is 1 to 1.1 of it for bonds that soften, and 1.2 to "
            f"2 for bonds that snap; measure it with runs/fracture/surfing.py and give FractureEnergy(Gc, share=...)"
        )
        return CrackShare(None, None, said, False)
    said = (
        f"The fracture energy is that of a body of bonds with the same modulus, and a crack through deformation "
        f"gradients takes another one, a third of it or more; what it takes is not known here, because {why}. Measure "
        f"the share with runs/fracture/surfing.py and give it, FractureEnergy(Gc, share=...): without it loads at "
        f"which cracks grow are wrong by its root."
    )
    return CrackShare(None, None, said, True)


def with_crack_share(case: Case) -> Case:
    """Return the case with the measured share of its fracture energy, where one is assumed and known."""
    found = crack_share(case)
    if found is None or found.share is None:
        return case
    assert isinstance(case.damage, BondDamage)
    assert isinstance(case.damage.criterion, FractureEnergy)
    return replace(case, damage=replace(case.damage, criterion=replace(case.damage.criterion, share=found.share)))


def _found(case: Case) -> tuple[MeasuredShare | None, str]:
    """Return the share of a case, or why there is none."""
    particles, damage = case.particles, case.damage
    if not isinstance(particles, Lattice) or particles.dim != 2:
        return None, "it was measured on square lattices alone"
    if not isinstance(damage, BondDamage):
        return None, "it was measured for one law, not for DamageOf"
    if type(damage.criterion) is not FractureEnergy:
        return None, f"it was measured for FractureEnergy, not for {type(damage.criterion).__name__}"
    materials = _materials(case)
    models = {_model(case, one) for one in materials}
    model = models.pop()
    if models or model is None:
        return None, "it was not measured for this material, scheme, weights, control and influence"
    law = next((name for name, one in LAWS.items() if _same(one, damage)), None)
    if law is None:
        return None, f"it was not measured for {type(damage).__name__} with these numbers"
    if not isinstance(case.horizon, int | float):
        return None, "it was measured for one horizon"
    # A share does not depend on the modulus, so that one of several materials is that of each.
    if len({_of_plane(one) for one in materials}) > 1:
        return None, "it is another one in each material"
    ratio, ratios = case.horizon / particles.spacing, [_ratio_in_plane_stress(one) for one in materials]
    for row in MEASURED:
        alike = (row.model, row.law) == (model, law) and math.isclose(ratio, row.horizon, rel_tol=SAME_HORIZON)
        if alike and row.nu[0] - SAME_LAW <= min(ratios) and max(ratios) <= row.nu[1] + SAME_LAW:
            return row, ""
    return None, (
        f"it was not measured for {model} with {law} at a horizon of {ratio:.6g} spacings and a Poisson's ratio that "
        f"is {' or '.join(f'{nu:.3g}' for nu in sorted(set(ratios)))} in plane stress"
    )


def _materials(case: Case) -> list[Any]:
    """Return what the parts of a body are made of, graded or not."""
    return [ungraded(material) for _, material in case.materials]


def _model(case: Case, material: Any) -> str | None:
    """Return the model of a material in a case as the measurements call it; None for others."""
    if case.influence != Constant() or case.expands:
        return None
    if type(material) is BondBased:
        return "bonds"
    if type(material) is LinearSolid:
        return "linear_solid"
    elastic = type(material) in (LinearElastic, Hencky) and type(case.chosen_weights) is Standard
    whole = case.gradients == Correspondence() and case.control == Silling(0.5)
    return "correspondence" if elastic and whole else None


def _ratio_in_plane_stress(material: Any) -> float:
    """Return Poisson's ratio of the same body in plane stress [-]: ``nu / (1 - nu)`` of one in plane strain."""
    if type(material) is BondBased:
        return 1.0 / 3.0
    nu = float(material.nu)
    return nu if material.plane == "stress" else nu / (1.0 - nu)


def _of_plane(material: Any) -> float:
    """Return what multiplies the share in plane strain.

    A body in plane strain is one in plane stress with ``E / (1 - nu^2)``, and takes the same energy. The bonds whose
    plane tells the fracture energy stand for E alone, and are ``16 / 15`` as stiff in plane strain.
    """
    if type(material) is BondBased or material.plane == "stress":
        return 1.0
    return 15.0 / 16.0 / (1.0 - float(material.nu) ** 2)


def _same(law: BondDamage, other: BondDamage) -> bool:
    """Return whether two laws fail alike, whatever drives them and wherever bonds are protected."""
    return replace(law, criterion=other.criterion, protected=other.protected, closes=other.closes) == other
