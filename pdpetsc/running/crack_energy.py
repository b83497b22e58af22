"""Warning about models whose running cracks dissipate another energy than the declared fracture energy."""

from __future__ import annotations

from pdpetsc.bond_based import BondBased
from pdpetsc.case import Case, ungraded

# Bonds that lose their force below this multiple of the stretch at onset behave as bonds that snap.
STEEP = 2.0
PAGE = "docs/reference/measured/fracture.md"
POINTS_PAGE = "docs/reference/measured/point_damage.md"


def missed_fracture_energy(case: Case) -> str | None:
    """Return a warning if running cracks dissipate another energy than Gc, else None (not collective).

    A fracture energy is the energy of breaking all bonds across a plane. Cracks in softening bond-based materials
    dissipate it. Laws with a ``share``, critical stretches and line bodies are not checked.
    """
    if getattr(case.particles, "dim", 2) == 1:
        return None
    if case.damage is not None and case.damage.point_laws:
        return _missed_by_points(case)
    laws = [law for law in case.damage_laws if law.criterion.assumes_share]
    steep = any(law.final < STEEP * law.onset for law in laws)
    if not laws:
        return None
    if not case.of_bonds:
        model, size = "deformation gradients", "0.3 to 0.8"
    elif steep:
        model, size = "bonds that snap", "1.2 to 2"
    elif any(not isinstance(ungraded(material), BondBased) for _, material in case.materials):
        model, size = "bonds with a dilatation", "1.05 to 1.1"
    else:
        return None
    return (
        f"A running crack through {model} dissipates {size} times the fracture energy Gc. Give share=... from {PAGE}, "
        "or share=1.0 for one plane of bonds."
    )


def _missed_by_points(case: Case) -> str | None:
    """Return the warning for damage at gradient points."""
    if case.gradients.patches is not None:
        model, size = "patches that share a dilatation", "0.8 to 1.2"
    elif case.control is None:
        model, size = "gradient points without a control", "0.85 to 0.95"
    else:
        return None
    return (
        f"A running crack through {model} dissipates {size} times Gc. For Gc use scheme=pd.Correspondence() and "
        f"control=pd.Silling(2.0) ({POINTS_PAGE})."
    )
