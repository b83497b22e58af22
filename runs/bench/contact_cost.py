"""What contact adds to a load step in 3D: python runs/bench/contact_cost.py [scene ...] [n=12] [repeat=3].

Elastic blocks of nodes at finite strain, pressed in ``steps`` load steps, with and without contact, in turn:

- ``bodies``: two blocks of unlike spacing with ``pd.BodyContact``; without it both interfaces are prescribed.
- ``tool``: a block whose whole surface may touch a ball that presses few facets; without it a traction on these.
- ``away``: the same ball, which moves but does not touch.

Prints, as medians, seconds of the process for a load step and Newton and linear iterations, each over those without.
"""

import dataclasses
import sys
import tempfile
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parent.parent))
import study

words = study.start("bench")

import numpy as np

import pdpetsc as pd

E, NU, DEEP = 1000.0, 0.3, 0.01


def bodies(n, steps):
    """Return two blocks that are pressed together, and the same without contact."""
    lower = pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1.0 / n)
    upper = pd.LatticeNodes((0.0, 0.0, 1.0), (1.0, 1.0, 2.0), 1.0 / (n + 2))
    top = pd.Displacement("upper +z", x=0.0, y=0.0, z=-DEEP)
    with_contact = pd.Case(
        particles=pd.Bodies({"lower": lower, "upper": upper}),
        material=pd.Hencky(E=E, nu=NU),
        conditions=[pd.Clamp("lower -z"), top, pd.BodyContact("lower +z", "upper -z", name="pair")],
        steps=pd.Steps(steps),
    )
    held = [pd.Displacement(side, z=-0.5 * DEEP) for side in ("lower +z", "upper -z")]
    return with_contact, dataclasses.replace(with_contact, conditions=[*with_contact.conditions[:2], *held])


def _block(n, steps, low, move):
    ball = pd.RigidSphere((0.5, 0.5, 1.0 + low + 1.0), 1.0, move=(0.0, 0.0, move))
    case = pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1.0 / n),
        material=pd.Hencky(E=E, nu=NU),
        conditions=[pd.Clamp("-z"), pd.Contact(pd.region.All(), ball, name="ball")],
        steps=pd.Steps(steps),
    )
    return case


def tool(n, steps):
    """Return a block that a ball presses, and the same with a traction."""
    case = _block(n, steps, 0.0, -DEEP)
    pressed = pd.region.Sphere((0.5, 0.5, 1.0), 0.1)
    return case, dataclasses.replace(case, conditions=[case.conditions[0], pd.Traction(pressed, z=-0.07 * E)])


def away(n, steps):
    """Return a block that is pressed by a plate, with and without a ball that does not touch."""
    case = _block(n, steps, 0.3, -0.1)
    pressed = pd.Traction("+z", z=-DEEP * E)
    return tuple(
        dataclasses.replace(case, conditions=[*some, pressed]) for some in (case.conditions, case.conditions[:1])
    )


SCENES = {"bodies": bodies, "tool": tool, "away": away}


class Spent(pd.Quantity):
    """Seconds of the processes of all ranks."""

    def evaluate(self, solution):
        return sum(solution.cloud.comm.allgather(time.process_time()))


def measured(case):
    """Return particles, and seconds of the processes, Newton and linear iterations, each of the mean load step."""
    with tempfile.TemporaryDirectory() as folder:
        # Without friction nothing is known of the second step that the first one does not know.
        run = pd.run(dataclasses.replace(case, history={"spent": Spent()}, fields=[]), folder)
    steps = run.summary["steps"]
    counts = [sum(one[name] for one in steps) for name in ("newton_iterations", "linear_iterations")]
    return run.summary["particles"], np.array([np.diff(run.history["spent"]).sum(), *counts]) / len(steps)


def main():
    """Print what contact costs."""
    given = dict(word.split("=", 1) for word in words if "=" in word)
    named = [word for word in words if "=" not in word and word != "all"]
    n, steps, repeat = (int(given.get(name, usual)) for name, usual in (("n", 12), ("steps", 3), ("repeat", 3)))
    for name in named or SCENES:
        found = []
        for _ in range(repeat):
            (particles, pressed), (_, bare) = (measured(case) for case in SCENES[name](n, steps))
            found.append([pressed, bare])
        pressed, bare = np.median(found, axis=0)
        print(
            f"{name:7s} {particles} particles: {pressed[0]:.2f} s a step, {pressed[0] / bare[0] - 1.0:+.1%}; Newton "
            f"{pressed[1]:.1f} over {bare[1]:.1f}; linear {pressed[2]:.1f} over {bare[2]:.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
