"""Slab whose faces are cooled suddenly, against the series of its temperature. Units m, J, s, K.

A slab of thickness 1 and temperature 1 whose faces x = 0 and x = 1 are at 0 from the start, with diffusivity 1: in
``dim`` dimensions, all other faces insulated. With ``face=particles`` the outer particles lie on the faces and have
their temperature, with ``face=surface`` the faces are those of the outer cells and convect to surroundings at 0,
``biot`` times as well as the slab conducts. ``conduct=bonds`` lets heat flow along bonds. ``error`` is the largest at
the end.
"""

import numpy as np

import pdpetsc as pd


def series(x, time, terms=400):
    """Return the temperature (n,) at places (n,) and a time."""
    if time <= 0.0:
        return np.where((x > 1e-12) & (x < 1.0 - 1e-12), 1.0, 0.0)
    k = np.pi * (2.0 * np.arange(terms) + 1.0)
    return (4.0 / k * np.exp(-(k**2) * time)) @ np.sin(np.outer(k, x))


def case(
    n=40, dim=1, horizon=2.015, time=0.1, steps=100, rule="backward_euler", scheme="correspondence", conduct="gradient",
    control=0.5, face="surface", biot=1e6, weights="conforming", wide=3,
):  # fmt: skip
    dx = 1.0 / n
    wide = wide * dx
    x_of = "xyz"[:dim]
    over = {"particles": 0.5 * dx, "surface": 0.0}[face]
    low, high = [-over] + [0.0] * (dim - 1), [1.0 + over] + [wide] * (dim - 1)
    law = pd.BondBased(E=1.0) if conduct == "bonds" else pd.LinearElastic(E=1.0, nu=0.25)
    faces = pd.region.Slab("x", high=0.25 * dx) | pd.region.Slab("x", low=1.0 - 0.25 * dx)

    class Error(pd.Quantity):
        """The largest error of the temperature, over that at the start [-]."""

        def evaluate(self, solution):
            exact = series(solution.x[:, 0], solution.t * time)
            return solution.largest(float(np.abs(pd.temperature(solution) - exact).max(initial=0.0)))

    history = {
        "middle": pd.At((0.5,) + (0.5 * wide,) * (dim - 1), pd.temperature),
        "error": Error(),
    }
    return pd.Case(
        particles=pd.Lattice(low, high, dx),
        horizon=horizon * dx,
        material=pd.Thermal(law, conductivity=1.0, capacity=1.0),
        scheme=None
        if conduct == "bonds"
        else pd.choose("scheme", scheme, {"correspondence": pd.Correspondence, "sub_horizons": pd.SubHorizons})(),
        weights=None
        if conduct == "bonds"
        else pd.choose("weights", weights, {"standard": pd.Standard, "conforming": pd.Conforming})(),
        conditions=[
            pd.Displacement(pd.region.All(), **dict.fromkeys(x_of, 0.0)),
            pd.Temperature(faces, 0.0, schedule=pd.Hold()) if over else pd.Convection(faces, biot, 0.0),
        ],
        heat=pd.HeatConduction(
            duration=time, rule=rule, start=1.0, control=None if scheme == "sub_horizons" else control
        ),
        steps=pd.Steps(steps),
        history=history,
        results=lambda h: {"middle": h["middle"][-1], "error": h["error"][-1]},
        # With little convection the faces are not at 0.
        expect={"middle": pd.Expected(float(series(np.array([0.5]), time)[0]), relative=0.01, source="Fourier series")}
        if over or biot >= 1e4
        else {},
        fields=[pd.temperature, pd.heat_flux],
        picture=pd.Picture(pd.temperature, "") if dim > 1 else None,
        checkpoints=0,
    )
