"""A time step of dynamic relaxation that reads and writes each quantity of a particle once."""

from __future__ import annotations

from pdpetsc.kernels.compile import compiled

# Number of sums of ``compare``.
SUMS = 6


@compiled
def advance(residual, mass, dt, damping, first, u, velocity, moved):
    """Move ``u`` to ``moved`` by one time step of central differences; return the sum of squares of the change.

    ``v := ((2 - c dt) v + 2 dt r / m) / (2 + c dt)``, from rest ``v := dt r / (2 m)``, and ``u := u + dt v``. The
    velocity is overwritten.
    """
    square = 0.0
    forward = 2.0 * dt / (2.0 + damping * dt)
    kept = (2.0 - damping * dt) / (2.0 + damping * dt)
    if first:
        forward, kept = 0.5 * dt, 0.0
    for i in range(u.shape[0]):
        over = forward / mass[i]
        for m in range(u.shape[1]):
            v = kept * velocity[i, m] + over * residual[i, m]
            velocity[i, m] = v
            moved[i, m] = u[i, m] + dt * v
            square += (dt * v) ** 2
    return square


@compiled
def compare(unbalanced, external, free, mass, velocity, dt, start, moved, residual, sums):
    """Overwrite the residual with that after the step, ``unbalanced`` for free unknowns, and compute sums.

    The first of ``sums`` are ``k d^2`` and ``m d^2`` of the distance d from the start, the squares of external forces
    and of reactions, ``r^2`` and ``(r / m)^2``, where ``k = -(r_new - r_old) / (dt v)`` is the stiffness of an unknown
    from two successive residuals, 0 if it did not move.
    """
    sums[:SUMS] = 0.0
    for i in range(unbalanced.shape[0]):
        for m in range(unbalanced.shape[1]):
            r = unbalanced[i, m] if free[i, m] else 0.0
            reaction = 0.0 if free[i, m] else unbalanced[i, m]
            travelled = moved[i, m] - start[i, m]
            change = dt * velocity[i, m]
            if change != 0.0:
                sums[0] += (residual[i, m] - r) / change * travelled * travelled
            sums[1] += mass[i] * travelled * travelled
            sums[2] += external[i, m] ** 2
            sums[3] += reaction * reaction
            sums[4] += r * r
            sums[5] += (r / mass[i]) ** 2
            residual[i, m] = r
