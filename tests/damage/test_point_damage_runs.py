"""Case files with damage at gradient points: energies, loads and openings against references that know no horizon."""

import sys

import pytest

from tests.commands import ROOT

sys.path.append(str(ROOT / "runs/fracture"))
import point_damage
import separation


@pytest.mark.parametrize("horizon", [2.015, 3.015, 4.015])
@pytest.mark.parametrize("curve", point_damage.CURVES)
def test_halves_that_are_pulled_apart_take_the_declared_energy(curve, horizon):
    work, rest = separation.share_of_points(curve, horizon=horizon)
    assert work == pytest.approx(1.0, abs=2e-3)
    assert rest == pytest.approx(0.0, abs=1e-9)
