"""What the two slender beams of Hashim et al., sections 4.2 and 4.3, share. Units m, N."""

import strip

import pdpetsc as pd

LENGTH = 0.254
THICKNESS = 5.08e-3
E = 68.95e9
NU = 0.25
PRESSURE = 276e3


# One unit of length of the paper's G [m]. The text does not state it: with this one, the only number that is fitted,
# all 15 residual norms of its Table 2 that lie above round-off are met within 0.5 % (tables.py).
UNIT = 15.933e-3


def control_of(G, control, G_printed=0.0, unit=UNIT):
    """Return Silling's control of strength G, that with the paper's G and unit of length, or the one that is named."""
    if sum(map(bool, (G, control, G_printed))) > 1:
        raise pd.CaseError("Give one of G, G_printed and control; each is a control of zero-energy modes.")
    if control:
        return pd.choose("control", control, pd.CONTROLS)
    if G_printed:
        return pd.SillingMicromodulus(G_printed, unit)
    return pd.Silling(G) if G else None


def load_norm(ny):
    """Return the norm of the forces of the whole pressure on the particles of the top row [N]."""
    return PRESSURE * THICKNESS / ny * (25 * ny) ** 0.5


def half_beam(support, ny, horizon, scheme, steps, supports, control, weights="standard"):
    """Return the case of half a beam with the given supports at its fictitious end.

    The lattice has 25 ny columns of real particles and ``int(horizon)`` fictitious ones at x < 0; the last real column
    lies on the symmetry line. The pressure acts on the outer layer of real particles.
    """
    if ny < 1 or ny % 2 == 0:
        raise pd.CaseError(f"ny must be odd, so that particles lie on the middle of the beam, not {ny}.")
    dx = THICKNESS / ny
    half = 25 * ny * dx
    top = pd.region.Slab("y", low=THICKNESS / 2 - dx) & pd.region.Named("real")
    reference = strip.deflection(support, PRESSURE, LENGTH, THICKNESS, E, NU)

    def results(history):
        found = -history["w"][-1] / THICKNESS
        return {"deflection": found, "reference": reference, "error": found / reference - 1.0}

    return pd.Case(
        particles=pd.Lattice(
            (0.0, -THICKNESS / 2), (half, THICKNESS / 2), dx, fictitious={"-x": max(int(horizon), 1) * dx}
        ),
        horizon=horizon * dx,
        material=pd.Hencky(E=E, nu=NU, plane="strain"),
        scheme=pd.choose("scheme", scheme, pd.SCHEMES),
        weights=pd.choose("weights", weights, pd.WEIGHTS),
        control=control,
        conditions=[
            *supports(dx),
            pd.Displacement(pd.region.Slab("x", low=half - dx), x=0.0),
            pd.Pressure(top, PRESSURE, normal=(0.0, 1.0)),
        ],
        steps=pd.Steps(steps),
        history={"w": pd.At((half, 0.0), pd.displacement, "y"), "energy": pd.StrainEnergy()},
        results=results,
        expect={
            "deflection": pd.Expected(reference, relative=0.02, source="Timoshenko's strip with immovable ends"),
        },
        picture=pd.Picture(pd.stress, "xx", scale=5.0),
    )
