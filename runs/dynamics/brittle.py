"""Brittle bodies of two models: points that fail, and bonds."""

import pdpetsc as pd


def parts(model, E, nu, density, Gc, strength, friction=0.0):
    """Return material and damage of a case.

    ``model`` is points (``PointDamage`` with correspondence and Silling's control) or bonds (``Brittle`` bonds with the
    fracture energy of a plane; nu is 1/4, and there is no strength). ``friction`` is that of closed cracks of points;
    with None their faces do not slide.
    """
    if pd.choose("model", model, {"points": True, "bonds": False}):
        return {
            "material": pd.LinearElastic(E=E, nu=nu, density=density),
            "scheme": pd.Correspondence(),
            "control": pd.Silling(1.0),
            "damage": pd.PointDamage(
                pd.softening.Linear(), Gc=Gc, strength=strength, split=pd.split.NoTension(friction=friction)
            ),
        }
    return {
        "material": pd.BondBased(E=E, plane="strain", density=density),
        "damage": pd.Brittle(pd.FractureEnergy(Gc, share=1.0)),
    }
