"""Pieces that nothing holds stay where they are: round-off does not move them, and loads on them end the run."""

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import field, results

pytestmark = pytest.mark.processors

CASE = """
from dataclasses import dataclass

import numpy as np

import pdpetsc as pd


class Push(pd.Term):
    load = True

    def __init__(self, body, force):
        x = body.cloud.x[: body.cloud.n_owned]
        self.force = np.where(np.abs(x - [5.0, 2.5]).max(axis=1) < 0.6, force, 0.0)

    def add_row_force(self, state, r):
        r[: len(self.force), 1] -= state.t * self.force

    def linearise(self, state):
        return []


@dataclass(frozen=True)
class Pushed(pd.ExtraTerm):
    force: float

    def build(self, body):
        return Push(body, self.force)


def case(force=0.0, kinematics="small", solver="newton", steps=6, softens=False):
    # Bonds across x = 3 and x = 7 are weak: the middle third comes free when they snap.
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=9.0)
    weak = pd.CriticalFunction(lambda s, middle: np.where(np.abs(np.abs(middle[:, 0] - 5.0) - 2.0) < 0.6, 0.02, 1.0))
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 3.0), 1.0),
        horizon=1.515,
        material=pd.BondBased(E=10.0, kinematics=kinematics),
        damage=pd.LinearSoftening(weak, 2.0) if softens else pd.Brittle(weak),
        conditions=[pd.Displacement(left, x=0.0, y=0.0), pd.Displacement(right, x=0.6, y=0.0)],
        steps=pd.Steps(steps),
        solver=pd.Newton() if solver == "newton" else pd.PathFollowing(
            pd.Opening("x", right, step=0.6 / steps, end=0.6), until=0.0
        ),
        terms=[Pushed(force)],
        fields=[pd.displacement],
    )
"""


@pytest.fixture(scope="module")
def case_file(tmp_path_factory):
    """Return the file of a strip whose middle comes free, with a force on one of its particles."""
    path = tmp_path_factory.mktemp("loose") / "strip.py"
    path.write_text(CASE)
    return path


def drift(case_file, folder, *words, ranks=1):
    """Return by how much a force of 1e-14 of those of the bonds moves any particle."""
    found = []
    for force in (0.0, 1e-14):
        results(case_file, f"force={force}", *words, ranks=ranks, output=folder / f"{force}")
        found.append(field(folder / f"{force}", "displacement"))
    assert np.abs(found[0]).max() > 0.5
    return np.abs(found[1] - found[0]).max()


# The search for a zero of the residual along the step takes the push for part of it, and goes on a little further.
@pytest.mark.parametrize(
    "words", [[], ["kinematics=finite", "-snes_linesearch_type", "basic"]], ids=["small", "finite"]
)
def test_round_off_does_not_move_a_free_piece(words, case_file, tmp_path):
    assert drift(case_file, tmp_path, *words) < 1e-11


@pytest.mark.parametrize(("softens", "least"), [(0, 1e-11), (1, 1e-9)])
def test_round_off_moves_no_free_piece_without_a_matrix(softens, least, case_file, tmp_path):
    """Sweeps of bonds that soften are solved less accurately."""
    words = [f"softens={softens}", "-pd_jacobian", "matfree", "-ksp_rtol", "1e-12"]
    assert drift(case_file, tmp_path, *words) < least


def test_round_off_moves_no_free_piece_on_two_ranks(case_file, tmp_path):
    assert drift(case_file, tmp_path, ranks=2) < 1e-11


def test_round_off_moves_no_free_piece_along_a_path(case_file, tmp_path):
    assert drift(case_file, tmp_path, "solver=path") < 1e-11


def test_a_small_load_on_a_free_piece_is_reported(case_file, tmp_path):
    """It is far below the forces of the bonds, and far above their round-off."""
    with pytest.raises(pd.SolveError, match="nothing holds a piece that has come free against its load"):
        results(case_file, "force=2e-9", output=tmp_path)
