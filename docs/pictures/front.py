"""Pictures of the front page: python docs/pictures/front.py [NAME ...] runs their cases and draws deformed bodies.

Every particle is drawn as its cell, a square of its volume, deformed by its own deformation gradient. It takes some
five minutes.
"""

import dataclasses
import runpy
import sys
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

import pdpetsc as pd

HERE = Path(__file__).parent
RUNS = HERE.parent.parent / "runs"
SQUARE = 0.5 * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])


def beam():
    return (
        "beams/cantilever.py",
        {"ny": 9, "scheme": "sub_horizons", "horizon": 1.5, "steps": 10},
        1.0,
        -1,
        "magma",
        "von_mises",
        "von Mises stress [MPa]",
        1e-6,
    )


def plate():
    return (
        "fracture/plate_with_hole.py",
        {"nx": 90, "law": "brittle", "steps": 10},
        10.0,
        -1,
        "viridis",
        "local_damage",
        "local damage",
        1.0,
    )


def notch():
    return (
        "fracture/mixed_mode_beam.py",
        {"n": 48, "end": 0.1},
        60.0,
        -1,
        "viridis",
        "local_damage",
        "local damage",
        1.0,
    )


PICTURES = {"front_beam": beam, "front_plate": plate, "front_notch": notch}


def run(name):
    """Return the result of the case of a picture."""
    path, parameters, *_ = PICTURES[name]()
    sys.path.insert(0, str((RUNS / path).parent))
    sys.path.insert(0, str(RUNS))
    case = runpy.run_path(str(RUNS / path))["case"](**parameters)
    fields = [pd.displacement, pd.deformation_gradient, pd.von_mises]
    fields += [pd.local_damage] if case.damage is not None else []
    folder = Path("out") / name
    pd.run(dataclasses.replace(case, fields=fields, picture=None), folder)
    return pd.open(folder)


def draw(name, result):
    """Draw the deformed cells; those that are torn keep their shape."""
    _, _, scale, step, colours, field, label, unit = PICTURES[name]()
    step = result.fields.steps[step]
    u, F = result.field("displacement", step)[:, :2], result.field("deformation_gradient", step)[:, :2, :2]
    value = result.field(field, step) * unit
    edge = np.median(cKDTree(result.x).query(result.x, k=2)[0][:, 1])
    H = scale * (F - np.eye(2))
    torn = np.abs(H - np.mean(H, axis=0)).max(axis=(1, 2)) > 1.5
    H[torn] = 0.0
    cells = (result.x[:, :2] + scale * u)[:, None, :] + edge * np.einsum("pim,cm->pci", np.eye(2) + H, SQUARE)
    figure = Figure(figsize=(4.8, 2.9), layout="constrained")
    axes = figure.subplots()
    drawn = PolyCollection(cells, array=value, cmap=colours, edgecolors="face", linewidths=0.2)
    drawn.set_clim(np.quantile(value, 0.002), np.quantile(value, 0.998))
    axes.add_collection(drawn)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.axis("off")
    tall = np.ptp(cells[..., 1]) > np.ptp(cells[..., 0])
    figure.colorbar(drawn, ax=axes, label=label, shrink=0.6, location="right" if tall else "bottom", pad=0.03)
    figure.savefig(HERE / f"{name}.png", dpi=180, bbox_inches="tight", pad_inches=0.03)


if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        draw(name, run(name))
