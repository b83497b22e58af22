"""Tables of parameters of which the default suite runs the rows that have every pair, and the long part all."""

import itertools

import pytest


def pairs(*factors):
    """Return the product of lists of values, for ``parametrize``; rows that add no pair of two values are long.

    The rows are chosen one after the other, always the first that has most pairs that no row before has.
    """
    factors = [list(values) for values in factors]
    rows = list(itertools.product(*(range(len(values)) for values in factors)))

    def pairs_of(row):
        return set(itertools.combinations(enumerate(row), 2))

    missing, chosen = set().union(*map(pairs_of, rows)), set()
    while missing:
        chosen.add(max(rows, key=lambda row: len(missing & pairs_of(row))))
        missing -= set().union(*map(pairs_of, chosen))
    return [
        pytest.param(
            *(values[n] for values, n in zip(factors, row, strict=True)),
            marks=[] if row in chosen else pytest.mark.long,
        )
        for row in rows
    ]
