"""Beam on two rigid rollers that a third one bends: Timoshenko's beam. Any consistent units.

A beam of depth 1, E = 1e4, nu = 0.3, plane stress, with a span of 8 and ends 0.5 beyond the rollers, of radius 0.5. The
upper roller moves down by ``load``. Half of the beam is computed, on nodes, ``n`` over the depth. A very soft
foundation holds it, because a case refuses a body that only contact holds. With ``supports=points`` the means of the
displacements of small patches are prescribed instead of rollers.

Timoshenko: ``w / F = S^3 / (48 E I) + S / (4 k G A)``, k = 5/6, with w the difference of the deflections of the axis
above the support and below the load, which leaves the indentations out.

Results: ``force`` of the upper roller on the whole beam, ``deflection`` w, ``stiffness_over_timoshenko``, and
``support_over_force``, twice the reaction of a support over the force.
"""

import pdpetsc as pd

E, NU = 1e4, 0.3
SPAN, END, DEPTH, RADIUS = 8.0, 0.5, 1.0, 0.5


def timoshenko():
    """Return the force over the deflection."""
    inertia, shear = DEPTH**3 / 12.0, 5.0 / 6.0 * 0.5 * E / (1.0 + NU) * DEPTH
    return 1.0 / (SPAN**3 / (48.0 * E * inertia) + SPAN / (4.0 * shear))


def case(n=16, friction=0.0, load=0.02, supports="rollers"):
    dx = DEPTH / n
    rollers = pd.choose("supports", supports, {"rollers": True, "points": False})
    below = pd.RigidSphere((0.5 * SPAN, -RADIUS), RADIUS)
    above = pd.RigidSphere((0.0, DEPTH + RADIUS), RADIUS, move=(0.0, -load))
    feet, head = pd.region.Sphere((0.5 * SPAN, 0.0), 1.1 * dx), pd.region.Sphere((0.0, DEPTH), 1.1 * dx)
    if rollers:
        held = [pd.Contact("-y", below, friction, name="below"), pd.Contact("+y", above, friction, name="above")]
        soft, history = [pd.Foundation("-y", normal=1e-8 * E, tangential=1e-8 * E)], {}
    else:
        held = [pd.PointSupport(feet, y=0.0), pd.PointSupport(head, y=-load)]
        soft, history = [], {"below_y": pd.Reaction("y", feet), "above_y": pd.Reaction("y", head)}

    def results(h):
        force, w = -2.0 * h["above_y"][-1], h["support"][-1] - h["middle"][-1]
        return {
            "force": force,
            "deflection": w,
            "stiffness_over_timoshenko": force / w / timoshenko(),
            "support_over_force": 2.0 * h["below_y"][-1] / force,
        }

    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (0.5 * SPAN + END, DEPTH), dx),
        material=pd.LinearElastic(E=E, nu=NU, plane="stress"),
        conditions=[pd.Roller("-x"), *held, *soft],
        steps=pd.Steps(2),
        history={
            **history,
            "support": pd.At((0.5 * SPAN, 0.5 * DEPTH), pd.displacement, "y"),
            "middle": pd.At((0.0, 0.5 * DEPTH), pd.displacement, "y"),
        },
        results=results,
        expect={
            "stiffness_over_timoshenko": pd.Expected(1.0, relative=0.03, source="Timoshenko"),
            "support_over_force": pd.Expected(1.0, relative=0.01, source="equilibrium"),
        },
        picture=pd.Picture(pd.stress, "xx", scale=10.0),
    )
