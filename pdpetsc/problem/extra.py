"""Build the extra terms of a case, and check that none of their forces can be lost."""

from __future__ import annotations

import numpy as np

from pdpetsc.arrays import GlobalIndex, LocalIndex, Lookup, starts_of
from pdpetsc.declared import called, shown
from pdpetsc.discrete.communicator import agreed
from pdpetsc.errors import CaseError
from pdpetsc.problem.body import Body
from pdpetsc.problem.term import ExtraTerm, Term

# Pairs of members of stencils per block of the search.
BLOCK = 1_000_000
# Largest number of horizons: ghosts cover the families of own particles, whose members are at most two horizons apart.
FURTHEST = 2


def build_extra(declared: ExtraTerm, number: int, body: Body) -> Term:
    """Build the extra term with number ``number`` of a case (collective).

    Raises
    ------
    CaseError
        The result is not a ``Term``, its forces would never be used, or it couples particles without a common family.
        Or its arrays are copies, which a restart could not fill.
    """
    name = type(declared).__name__
    term: Term = called(f"term {number}, {name}: its function", declared.build, body)
    with agreed(body.cloud.comm):
        if not isinstance(term, Term):
            raise CaseError(f"{name} must build a Term, not {shown(term)}.")
        if type(term).add_force is not Term.add_force and not term.horizons:
            raise CaseError(
                f"The term of {name} gives add_force, but couples particles over no horizon; let its horizons be 1 or "
                f"2, or give add_row_force."
            )
        if term.horizons > FURTHEST:
            raise CaseError(
                f"The term of {name} couples particles over {term.horizons} horizons; other ranks know of each other's "
                f"particles within families, which is {FURTHEST} at most."
            )
        if term.stencils is not None and not lie_in_families(body, *term.stencils):
            raise CaseError(
                f"The term of {name} couples particles that are in no common family; let every stencil hold an own "
                f"particle and bonded neighbours of it, or widen the horizon."
            )
        again = term.arrays()
        for of, array in term.arrays().items():
            if array.values.size and not np.shares_memory(array.values, again[of].values):
                raise CaseError(f"The array {of} of the term of {name} is a copy; give the array that the term reads.")
    return term


def lie_in_families(body: Body, point_ptr: GlobalIndex, members: LocalIndex) -> bool:
    """Return True if each stencil has an own particle whose family contains all its members (not collective)."""
    cloud, families = body.cloud, body.families
    n = np.int64(cloud.n_local)
    own = np.arange(cloud.n_owned, dtype=np.int64)
    bonds = Lookup(np.concatenate([families.centres.astype(np.int64) * n + families.neighbours, own * n + own]))
    sizes = np.diff(point_ptr).astype(np.int64)
    pairs = starts_of(sizes**2)
    first = 0
    while first < len(sizes):
        last = max(int(np.searchsorted(pairs, pairs[first] + BLOCK, side="right")) - 1, first + 1)
        size = sizes[first:last]
        # Test every member against every member of its stencil; the first is the centre.
        of = np.repeat(np.arange(len(size)), size**2)
        within = np.arange(len(of)) - (pairs[first:last] - pairs[first])[of]
        start = point_ptr[first:last][of]
        centre = members[start + within // size[of]].astype(np.int64)
        member = members[start + within % size[of]]
        known = (bonds.of(centre * n + member) >= 0) & (centre < cloud.n_owned)
        row = (pairs[first:last] - pairs[first])[of] + within // size[of] * size[of]
        whole = np.bincount(row, known, minlength=len(of)) == size[of]
        if len(of) and not np.bincount(of, whole & (within % size[of] == 0), minlength=len(size)).all():
            return False
        first = last
    return True
