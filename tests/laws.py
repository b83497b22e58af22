"""One of every law with history, and a small body of any of them, pulled, sheared and let go in part."""

import dataclasses
import re
from pathlib import Path

import pdpetsc as pd
from tests.commands import Stop

PAGE = Path(__file__).parent.parent / "docs/theory/materials.md"
hard, rates = pd.hardening, pd.rate
E, NU, Y = 10.0, 0.3, 0.3
DURATION = 4.0
ISOTROPIC = {
    "linear": hard.Linear(1.0),
    "voce": hard.Linear(0.4) + hard.Voce(0.4, 8.0),
    "swift": hard.Power(0.8, 0.4, 0.01),
    "ludwik": hard.Power(0.8, 0.4),
    "table": hard.Tabular([0.0, 0.02, 0.1, 0.6], [0.0, 0.05, 0.1, 0.2]),
}
LAWS = {name: pd.J2(E, NU, yield_stress=Y, hardening=law) for name, law in ISOTROPIC.items()}
LAWS["perzyna"] = pd.J2(
    E, NU, yield_stress=Y, hardening=ISOTROPIC["voce"], rate=rates.Perzyna(DURATION, rate_0=0.5, drag=0.3, exponent=2.0)
)
LAWS["johnson_cook"] = pd.J2(
    E, NU, yield_stress=Y, hardening=hard.Power(0.8, 0.4, 0.01),
    rate=rates.JohnsonCook(DURATION, C=0.1, rate_0=0.02, temperature=500.0, room=300.0, melting=1300.0, m=1.1),
)  # fmt: skip
SOIL = pd.DruckerPrager(E, NU, cohesion=0.15, friction=0.5, hardening=hard.Linear(0.4) + hard.Voce(0.1, 8.0))
LAWS |= {"drucker_prager": SOIL, "not_associated": dataclasses.replace(SOIL, dilatancy=0.15, fit="plane strain")}
LAWS["kinematic"] = pd.KinematicJ2(E, NU, yield_stress=Y, kinematic=0.8, hardening=ISOTROPIC["voce"])
LAWS["kinematic_perzyna"] = dataclasses.replace(LAWS["kinematic"], rate=LAWS["perzyna"].rate)
LAWS["maxwell"] = pd.Maxwell(E, NU, shear=[3.0, 1.0], times=[0.5, 5.0], duration=DURATION)
OWN: dict = {}
exec(re.search(r"```python\n(from dataclasses.*?)```", PAGE.read_text(), re.DOTALL).group(1), OWN)
LAWS["own"] = OWN["Norton"](E, NU, q_0=0.5, rate_0=0.2, n=3.0, duration=DURATION)


def case(law="voce", plane="stress", steps=6, stop=2.0, growth=0.0, solver="newton", cell=1.0):
    """Return a strip of one of the laws."""
    left, right = pd.region.Slab("x", high=2.0 * cell), pd.region.Slab("x", low=8.0 * cell)
    path = pd.Table((0.0, 0.7, 1.0), (0.0, 1.0, 0.8))
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0 * cell, 4.0 * cell), cell),
        horizon=1.515 * cell,
        material=dataclasses.replace(LAWS[law], plane=plane),
        control=pd.Silling(0.2),
        scheme=pd.Correspondence(),
        conditions=[
            pd.Displacement(left, x=0.0, y=0.0),
            pd.Displacement(right, x=0.6 * cell, y=0.4 * cell, schedule=path),
        ],
        steps=pd.Steps(steps, plastic_growth=growth or None),
        solver=pd.SOLVERS[solver] if solver != "path" else pd.PathFollowing(pd.Opening("x", right, step=0.1, end=1.0)),
        history={"force": pd.Reaction("x", right), "plastic": pd.Largest(pd.plastic_strain), "stop": Stop(stop)},
        results=lambda h: {"force": h["force"][-1], "plastic": h["plastic"][-1]},
        fields=[pd.displacement, pd.stress, pd.plastic_strain],
    )
