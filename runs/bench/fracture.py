"""Time load steps with a growing crack: [mpirun -n 2] python runs/bench/fracture.py [name=value ...] [-option ...].

A block of n x n/2 particles (in space n x n/2 x n/4) of unit spacing and E = 1, with a crack along its middle plane
from one end to a third of its length; n/2 is rounded to even, so that the crack lies between particles. Both halves of
this end are pulled apart, up to the opening at which beam theory has the crack at 0.6 of the length, in ``steps`` load
steps. Parameters and their defaults: dim=3 n=32 horizon=3.015 model=point steps=10 json=; model is ``point`` for damage
at gradient points, ``bonds`` for softening bonds, ``correspondence`` for gradients whose bonds soften; json is a file
for what was measured. Prints, in the mean of the load steps, seconds, sweeps, Newton and linear iterations, and at the
end broken bonds, the tip of the crack over the length, and the memory of all ranks [MiB].
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
import study

import pdpetsc as pd

ONSET, RATIO = 0.002, 4.0


def case(dim=3, n=32, horizon=3.015, model="point", steps=10):
    """Return the block."""
    sides = [1.0 * n, 2.0 * (n // 4), 1.0 * (n // 4)][:dim]
    half, tip, arm = 0.5 * sides[1], float(n // 3), 0.25 * n
    far = [sides[2] + 1.0] * 2 + [-1.0] * 2 if dim == 3 else []
    corners = [(-1.0, half), (tip, half), (tip, half), (-1.0, half)]
    crack = pd.PolygonCrack([(*xy, z) for xy, z in zip(corners, far, strict=True)]) if far else pd.Segment(*corners[:2])
    near = pd.region.Slab("y", low=half - horizon, high=half + horizon)
    energy = ONSET**2 * int(horizon) * RATIO
    laws = {
        "point": pd.PointDamage(pd.softening.Linear(), Gc=energy, onset=ONSET, protected=~near),
        "bonds": pd.LinearSoftening(pd.FractureEnergy(energy), RATIO, protected=~near),
        "correspondence": pd.LinearSoftening(pd.FractureEnergy(energy, share=0.4), RATIO, protected=~near),
    }
    damage = pd.choose("model", model, laws)
    bonds = model == "bonds"
    opening = 8.0 * (0.6 * n + 0.64 * arm) ** 2 * (energy / (12.0 * arm**3)) ** 0.5
    end, other = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=sides[0] - 1.0)
    upper = pd.region.Slab("y", low=half)
    held = dict.fromkeys("xyz"[:dim:2], 0.0)
    return pd.Case(
        particles=pd.Lattice([0.0] * dim, sides, 1.0),
        horizon=horizon,
        material=pd.BondBased(1.0) if bonds else pd.LinearElastic(1.0, 0.25),
        scheme=None if bonds else pd.Correspondence(),
        control=None if bonds else pd.Silling(0.5),
        weights=None if bonds else pd.Standard(),
        cracks=[crack],
        damage=damage,
        conditions=[
            pd.Displacement(other, **held),
            pd.Displacement(end & upper, y=0.5 * opening),
            pd.Displacement(end & ~upper, y=-0.5 * opening),
        ],
        steps=pd.Steps(steps),
        history={
            "load": pd.Reaction("y", end & upper),
            "tip": pd.CrackTip((1.0, *[0.0] * (dim - 1)), 0.5),
            "broken": pd.BrokenBonds(),
        },
        results=lambda h: {"tip": h["tip"][-1] / n, "load": h["load"][-1], "broken": h["broken"][-1]},
        fields=[pd.displacement, pd.local_damage],
    )


def main():
    """Run the case of the command line and print what its load steps took."""
    words = study.start()
    from pdpetsc.command_line.cli import arguments_of
    from pdpetsc.discrete.communicator import is_root, world

    given = dict(word.split("=", 1) for word in words)
    target = given.pop("json", "")
    result = pd.run(case(**arguments_of(case, given)), "out/bench_fracture")
    if not is_root(world()):
        return
    done, spent = result.summary["steps"], result.summary["timings"]

    def mean(name):
        return sum(step.get(name, 0) for step in done) / len(done)

    found = {
        "seconds_per_step": spent["solve"] / len(done), "sweeps": mean("sweeps"), "newton": mean("newton_iterations"),
        "linear": mean("linear_iterations"), "broken": result["broken"], "tip": result["tip"],
        "memory": sum(result.summary["peak_memory_bytes"]) / 2**20,
    }  # fmt: skip
    print(json.dumps(found, indent=1))
    if target:
        Path(target).write_text(json.dumps(found))


if __name__ == "__main__":
    main()
