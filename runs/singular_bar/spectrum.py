"""Energy of a sine of every wave number: python runs/singular_bar/spectrum.py [folder].

``e(k) = sum_i u_i f_i`` with the internal forces f of ``u = sin(k x)`` on a free bar with L = E = 1 and a horizon of
L / 100, up to the shortest wave of the lattice. A method with zero-energy modes has e near 0 there. Chowdhury et al.,
section 5.3, figures 10 and 11; every other method beside them.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

words = study.start("singular_bar")

import numpy as np

import pdpetsc as pd

METHODS = {
    "plain": {"scheme": pd.Correspondence()},
    "2 sub-horizons": {"scheme": pd.SubHorizons()},
    "4 sub-horizons": {"scheme": pd.SubHorizons(4)},
    "stress points": {"scheme": pd.StressPoints()},
    "bond-associated": {"scheme": pd.BondAssociated()},
    "corrected, order 4": {"scheme": pd.Corrected(4)},
    "higher order 3": {"scheme": pd.HigherOrder(3)},
    "Silling": {"scheme": pd.Correspondence(), "control": pd.Silling()},
    "Littlewood": {"scheme": pd.Correspondence(), "control": pd.Littlewood()},
    "Wan": {"scheme": pd.Correspondence(), "control": pd.Wan()},
    "relative springs": {"scheme": pd.Correspondence(), "control": pd.RelativeSprings()},
    "relative average": {"scheme": pd.Correspondence(), "control": pd.RelativeAverage()},
    "smoothed displacement": {"scheme": pd.SmoothedDisplacement()},
}
WAVES = 120


def energies(n, parameters, k=None):
    """Return wave numbers, up to the shortest wave of the lattice if not given, and e(k) on n particles."""
    case = pd.Case(
        particles=pd.Lattice((0.0,), (1.0,), 1.0 / n),
        horizon=0.01 * (1.0 + 1e-9),
        material=pd.LinearElastic(E=1.0, nu=0.0),
        conditions=[],
        **parameters,
    )
    problem = study.build(case)
    k = np.linspace(0.0, np.pi * n, WAVES + 1)[1:] if k is None else k
    x = problem.body.cloud.x[: problem.body.cloud.n_owned]
    found = []
    for wave in k:
        u = np.sin(wave * x)
        found.append(float(np.vdot(u, problem.internal_force(problem.state(u)))))
    return k, np.array(found)


FIGURES = {"plain": "10", "2 sub-horizons": "11a", "4 sub-horizons": "11b"}
REFINED = (1000, 2000, 4000)


def main():
    folder = study.folder_for(words, "out/spectrum")
    numbers = {}
    for name, figure in FIGURES.items():
        curves = {f"L/dx = {n}": energies(n, METHODS[name]) for n in REFINED}
        study.write_curves(folder, f"fig_{figure}", f"Fig. {figure}: {name}", ("k L", "e"), curves)
        # The least energy of the shorter waves of the coarsest lattice, and what the finest gives for the same waves.
        k, coarse = curves[f"L/dx = {REFINED[0]}"]
        short = slice(len(k) // 2, None)
        numbers[f"fig_{figure}.least"] = coarse[short].min() / coarse.max()
        numbers[f"fig_{figure}.finer"] = energies(REFINED[-1], METHODS[name], k)[1][short].mean() / coarse[short].mean()
    curves = {name: energies(1000, parameters) for name, parameters in METHODS.items()}
    study.write_curves(folder, "all_methods", "L/dx = 1000, horizon 10 dx", ("k L", "e"), curves, yscale="log")
    least = [(name, float(np.abs(e[len(e) // 2 :]).min() / e[0])) for name, (_, e) in curves.items()]
    study.write_table(
        folder, "least_energy", ("method", "least e(k) of the shorter waves over e of the longest"), least
    )
    study.write_numbers(folder, numbers | {f"least.{name}": value for name, value in least})


if __name__ == "__main__":
    main()
