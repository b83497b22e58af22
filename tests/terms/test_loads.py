"""Loads add up to what was declared, whatever the cells are."""

import contextlib
import dataclasses

import h5py
import meshio
import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.declare import region
from tests.commands import called, history, results, script_on, summary

E = 1000.0


def grid(counts, sizes):
    """Return the centres and the volume of the cells of a box."""
    axes = [(np.arange(count) + 0.5) * size for count, size in zip(counts, sizes, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(counts))
    return x, float(np.prod(sizes))


def strip(particles, sizes, condition, scheme=None):
    """Return a box that is held at x = 0 and loaded by a condition."""
    return pd.Case(
        particles=particles,
        horizon=1.015 * max(sizes),
        material=pd.LinearElastic(E=E, nu=0.0),
        scheme=scheme or pd.Correspondence(),
        control=pd.Silling(),
        conditions=[
            pd.Displacement(region.Slab("x", high=sizes[0]), **dict.fromkeys("xyz"[: len(sizes)], 0.0)),
            condition,
        ],
        history={"reaction": pd.Reaction("x")},
        fields=[],
    )


def resultant(case, folder):
    """Return the force that supports exert along x and the resultant of the load that the summary names."""
    pd.run(case, output=folder)
    return -history(folder)["reaction"][-1], summary(folder)["loads"][0]["resultant"][0]


@pytest.mark.parametrize("distribution", ["layer", "consistent"])
@pytest.mark.parametrize(
    "counts, sizes",
    [((12, 8), (1.0, 0.5)), ((12, 8), (0.5, 1.0)), ((10, 5, 6), (1.0, 1.0, 0.5)), ((10, 5, 6), (0.5, 1.0, 1.0))],
)
def test_a_traction_is_traction_times_area_on_cells_that_are_not_square(counts, sizes, distribution, tmp_path):
    x, volume = grid(counts, sizes)
    area = volume * len(x) / (counts[0] * sizes[0])
    right = region.Slab("x", low=(counts[0] - 1) * sizes[0])
    traction = pd.Traction(right, x=2.0, normal=(1.0, 0.0, 0.0)[: len(sizes)], distribution=distribution)
    found, said = resultant(strip(pd.Arrays(x, volume), sizes, traction), tmp_path)
    assert found == pytest.approx(2.0 * area, rel=1e-9)
    assert said == pytest.approx(2.0 * area, rel=1e-12)


def test_thickness_counts_once(tmp_path):
    x, volume = grid((12, 6), (1.0, 0.5))
    traction = pd.Traction(region.Slab("x", low=11.0), x=2.0, normal=(1.0, 0.0))
    found, _ = resultant(strip(pd.Arrays(x, 0.1 * volume, thickness=0.1), (1.0, 0.5), traction), tmp_path)
    assert found == pytest.approx(2.0 * 3.0 * 0.1, rel=1e-9)


def test_only_free_faces_are_loaded():
    lattice = pd.Lattice((0.0, 0.0), (6.0, 6.0), 1.0, cut=region.Sphere((3.0, 3.0), 1.2), fictitious={"-x": 2.0})
    x = lattice.chunk(0, 1).x
    area = lattice.faces(0, 1, np.array([1.0, 0.0]))
    # The right side, and the two cells left of the hole that look into it.
    assert area.sum() == pytest.approx(6.0 + 2.0)
    assert np.all(x[area > 0.0, 0] > 1.0)
    # The left side is that of the fictitious layer.
    left = lattice.faces(0, 1, np.array([-1.0, 0.0]))
    assert sorted(x[left > 0.0, 0]) == [-1.5] * 6 + [4.5] * 2
    # A normal that is oblique sees the projection of both sides that look its way.
    oblique = lattice.faces(0, 1, np.array([0.6, 0.8]))
    assert oblique.sum() == pytest.approx(0.6 * 8.0 + 0.8 * (8.0 + 2.0))
    parts = np.concatenate([lattice.faces(part, 5, np.array([0.6, 0.8])) for part in range(5)])
    assert np.array_equal(parts, oblique)


def test_a_lattice_of_arrays_has_the_faces_of_a_lattice(rng):
    lattice = pd.Lattice((0.0, 1.0), (3.0, 4.0), 0.5, cut=region.Sphere((1.0, 2.0), 0.6), thickness=0.2)
    chunk = lattice.chunk(0, 1)
    order = rng.permutation(len(chunk.x))
    arrays = pd.Arrays(chunk.x[order], chunk.volume[order], thickness=0.2)
    for normal in ([1.0, 0.0], [0.0, -1.0], [-0.8, 0.6]):
        normal = np.array(normal)
        np.testing.assert_allclose(arrays.faces(0, 1, normal), lattice.faces(0, 1, normal)[order], rtol=1e-12)


def test_arrays_have_the_faces_of_their_facets():
    x = np.array([[0.5, 0.4], [1.6, 0.6]])
    facets = pd.Facets([[0.0, 0.5], [2.0, 0.5], [0.5, 1.0]], [[-1.0, 0.0], [0.8, 0.6], [0.0, 1.0]], [0, 1, 0])
    arrays = pd.Arrays(x, 1.0, facets=facets)
    assert arrays.faces(0, 1, np.array([1.0, 0.0])) == pytest.approx([0.0, 0.8])
    assert arrays.faces(0, 1, np.array([0.0, 1.0])) == pytest.approx([1.0, 0.6])
    assert arrays.faces(1, 2, np.array([1.0, 0.0])) == pytest.approx([0.8])


def test_two_layers_carry_the_load_of_one(tmp_path):
    x, volume = grid((12, 6), (1.0, 1.0))
    traction = pd.Traction(region.Slab("x", low=10.0), x=2.0, normal=(1.0, 0.0))
    found, _ = resultant(strip(pd.Arrays(x, volume), (1.0, 1.0), traction), tmp_path)
    assert found == pytest.approx(12.0, rel=1e-9)


def test_a_face_of_which_nothing_is_known_is_refused(rng, tmp_path):
    x, volume = grid((12, 6), (1.0, 1.0))
    shaken = pd.Arrays(x + rng.uniform(-0.1, 0.1, x.shape), volume)
    traction = pd.Traction(region.Slab("x", low=11.0), x=2.0, normal=(1.0, 0.0))
    with pytest.raises(pd.CaseError, match="give each Traction a normal and an area"):
        resultant(strip(shaken, (1.2, 1.2), traction), tmp_path)
    for distribution in ("layer", "consistent"):
        given = pd.Traction(
            region.Slab("x", low=10.8), x=2.0, normal=(1.0, 0.0), area=6.0, distribution=distribution
        )  # fmt: skip
        found, _ = resultant(strip(shaken, (1.2, 1.2), given), tmp_path)
        assert found == pytest.approx(12.0, rel=1e-8)


def test_a_region_without_a_free_face_is_refused(tmp_path):
    x, volume = grid((12, 6), (1.0, 1.0))
    inside = pd.Traction(region.Slab("x", 5.0, 6.0), x=2.0, normal=(1.0, 0.0))
    with pytest.raises(pd.CaseError, match=r"no free face with normal \[1\.0, 0\.0\]"):
        resultant(strip(pd.Arrays(x, volume), (1.0, 1.0), inside), tmp_path)


def test_a_schedule_multiplies_a_function(tmp_path):
    x, volume = grid((12, 6), (1.0, 1.0))
    up_and_down = pd.Table([0.0, 0.5, 1.0], [0.0, 1.0, 0.0])
    load = pd.BodyForce(region.All(), x=lambda x, t: np.full(len(x), 3.0), schedule=up_and_down)
    found, said = resultant(strip(pd.Arrays(x, volume), (1.0, 1.0), load), tmp_path)
    assert found == pytest.approx(0.0, abs=1e-9)
    assert said == pytest.approx(0.5 * 3.0 * 72.0)


@pytest.mark.parametrize(
    "function, sentence",
    [
        (lambda x, t: None, "is nan for 6 of 6 particles"),
        (lambda x, t: np.full(len(x), np.nan), "is nan for 6 of 6 particles"),
        (lambda x, t: np.zeros(3), r"must return \(6,\) numbers, not \(3,\)"),
        (lambda x, t: "a", "must return real numbers"),
        (lambda x, t: 1.0 / 0.0, r"failed at test_loads\.py:\d+: ZeroDivisionError"),
    ],
)
@pytest.mark.parametrize("kind", [pd.Displacement, pd.BodyForce])
def test_a_function_that_gives_no_numbers_is_named(kind, function, sentence, tmp_path):
    x, volume = grid((12, 6), (1.0, 1.0))
    condition = kind(region.Slab("x", low=11.0), x=function)
    with pytest.raises(pd.CaseError, match=f"The value of a {kind.__name__} condition <lambda> {sentence}"):
        pd.run(strip(pd.Arrays(x, volume), (1.0, 1.0), condition), output=tmp_path)


def test_a_function_that_fails_on_the_way_leaves_what_was_computed(tmp_path):
    x, volume = grid((12, 6), (1.0, 1.0))
    pull = pd.Displacement(region.Slab("x", low=11.0), x=lambda x, t: np.full(len(x), np.nan if t == 0.75 else t))
    case = strip(pd.Arrays(x, volume), (1.0, 1.0), pull)
    with pytest.raises(
        pd.SolveError, match=r"At step time 0\.75: The value of a Displacement condition <lambda> is nan"
    ):
        pd.run(dataclasses.replace(case, steps=pd.Steps(4)), output=tmp_path)
    assert len((tmp_path / "history.csv").read_text().splitlines()) == 4


def test_supports_that_cut_families_are_counted(tmp_path):
    """The outermost held column is named; one that is two horizons deep, with all its neighbours held, is not."""

    def held(depth):
        x, volume = grid((16, 6), (1.0, 1.0))
        ends = [region.Slab("x", high=depth), region.Slab("x", low=16.0 - depth)]
        return pd.Case(
            particles=pd.Arrays(x, volume),
            horizon=1.015,
            material=pd.LinearElastic(E=E, nu=0.0),
            conditions=[
                *(pd.Displacement(end, x=lambda x, t: 0.01 * t * x[:, 0]) for end in ends),
                pd.Displacement(region.Nearest((0.5, 2.5)), y=0.0),
            ],
            fields=[pd.stress],
        )

    found = {}
    for depth in (1.0, 3.0):
        pd.run(held(depth), output=tmp_path)
        with h5py.File(tmp_path / "fields.h5") as file:
            stress = np.asarray(file["step_00001/stress"])[:, 0].reshape(16, 6)
        found[depth] = (
            summary(tmp_path)["held_at_cut_families"],
            stress[0, 2] / stress[8, 2],
            np.abs(stress[3:-3] / 10.0 - 1.0),
        )
    assert found[1.0][0] == 12
    assert found[1.0][1] == pytest.approx(2.0 / 3.0, rel=1e-3)
    assert found[3.0][0] == 0
    assert found[3.0][2].max() < 1e-9


@pytest.mark.parametrize("distribution", ["layer", "consistent"])
@pytest.mark.parametrize("diagonal", ["one way", "alternating"])
def test_a_traction_on_triangles_is_traction_times_area(diagonal, distribution, tmp_path):
    nx, ny = 12, 6
    x = np.stack(np.meshgrid(np.arange(nx + 1.0), np.arange(ny + 1.0), indexing="ij"), axis=-1).reshape(-1, 2)
    cells = []
    for i in range(nx):
        for j in range(ny):
            a, b, c, d = (i * (ny + 1) + j, (i + 1) * (ny + 1) + j, (i + 1) * (ny + 1) + j + 1, i * (ny + 1) + j + 1)
            turned = diagonal == "alternating" and (i + j) % 2
            cells += [(a, b, d), (b, c, d)] if turned else [(a, b, c), (a, c, d)]
    path = tmp_path / "strip.vtu"
    meshio.write(path, meshio.Mesh(np.c_[x, np.zeros(len(x))], [("triangle", np.array(cells))]))
    traction = pd.Traction(region.Slab("x", low=11.0), x=2.0, normal=(1.0, 0.0), distribution=distribution)
    case = strip(pd.Mesh(path, thickness=0.5), (1.6, 1.6), traction)
    found, said = resultant(case, tmp_path / "out")
    assert found == pytest.approx(2.0 * ny * 0.5, rel=1e-8)
    assert said == pytest.approx(2.0 * ny * 0.5, rel=1e-10)


def test_a_dead_load_stays_when_bonds_break_near_it(tmp_path):
    """A consistent traction rests on the weights of the intact body."""
    x, volume = grid((16, 8), (1.0, 1.0))
    damage = pd.LinearSoftening(pd.ConstantCritical(0.002), 3.0)
    pull = pd.Displacement(
        region.Slab("x", low=14.0) & region.Slab("y", high=2.0), y=lambda x, t: np.full(len(x), -0.5 * t)
    )
    case = strip(
        pd.Arrays(x, volume),
        (1.0, 1.0),
        pd.Traction(region.Slab("x", low=15.0), x=0.5, normal=(1.0, 0.0), distribution="consistent"),
    )
    case = dataclasses.replace(case, conditions=[*case.conditions, pull], damage=damage, steps=pd.Steps(4))

    class Load(pd.Quantity):
        def evaluate(self, solution):
            return float(solution.sum(solution.problem.external_force(solution.state)[:, 0].sum()))

    broken = {"load": Load(), "broken": pd.BrokenBonds()}
    with contextlib.suppress(pd.SolveError):
        pd.run(dataclasses.replace(case, history=broken), output=tmp_path)
    h = history(tmp_path)
    assert h["broken"][-1] > 0
    np.testing.assert_allclose(h["load"], 0.5 * 8.0 * h["t"], rtol=1e-9)


def test_small_displacements_beside_large_forces_are_looked_at(tmp_path):
    """Whether conditions are proportional does not depend on the unit of the others."""
    x, volume = grid((12, 6), (1.0, 1.0))
    case = strip(pd.Arrays(x, volume), (1.0, 1.0), pd.Force(region.Slab("x", low=11.0), x=2e7))
    held = pd.Displacement(region.Nearest((5.5, 5.5)), y=1e-6, schedule=pd.Hold())
    for conditions, accepted in (([], True), ([held], False)):
        scene = dataclasses.replace(case, conditions=[*case.conditions, *conditions], solver=pd.EventDriven())
        if accepted:
            pd.run(scene, output=tmp_path)
        else:
            with pytest.raises(pd.CaseError, match="proportional to the step time"):
                pd.run(scene, output=tmp_path)


@pytest.mark.parametrize("kind", [pd.MeanStrain, pd.MeanStress])
@pytest.mark.parametrize("schedule, words", [(lambda t: 1 / 0, "ZeroDivisionError"), (lambda t: "a", "real numbers")])
def test_schedules_of_a_cell_are_named(kind, schedule, words, tmp_path):
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (4.0, 4.0), 1.0),
        horizon=1.5,
        material=pd.LinearElastic(E=E, nu=0.0),
        cell=pd.Cell((0.0, 0.0), (4.0, 4.0)),
        conditions=[pd.Displacement(region.Nearest((0.5, 0.5)), x=0.0, y=0.0), kind(xx=0.1, schedule=schedule)],
    )
    with pytest.raises(pd.CaseError, match=f"schedule of a {kind.__name__} condition .*{words}"):
        pd.run(case, output=tmp_path)


def test_a_function_is_not_asked_about_no_particles(tmp_path):
    """A rank may have none of a region's."""
    case = tmp_path / "case.py"
    case.write_text(
        "import numpy as np\nimport pdpetsc as pd\n\ndef case():\n"
        "    only = np.vectorize(lambda y: 0.01)\n"
        "    return pd.Case(particles=pd.Lattice((0.0, 0.0), (8.0, 4.0), 1.0), horizon=1.5,\n"
        "        material=pd.Hencky(E=1.0, nu=0.0), fields=[],\n"
        "        conditions=[pd.Displacement(pd.region.Slab('x', high=1.0), x=0.0, y=0.0),\n"
        "            pd.Displacement(pd.region.Slab('x', low=7.0), x=lambda x, t: t * only(x[:, 1]))])\n"
    )
    assert results(case, ranks=2, output=tmp_path / "out")["status"] == "converged"


LEFT, BOTTOM = region.Slab("x", high=1.0), region.Slab("y", high=1.0)


def corner(*conditions, unit=1.0, modulus=E, **changes):
    """Return a square of 4 x 4 particles with conditions that may share particles of its edges."""
    declared = {
        "particles": pd.Lattice((0.0, 0.0), (4.0 * unit, 4.0 * unit), unit),
        "horizon": 2.015 * unit,
        "material": pd.LinearElastic(E=modulus, nu=0.0),
        "conditions": conditions,
        "fields": [pd.displacement],
    }
    return pd.Case(**(declared | changes))


def test_conditions_that_prescribe_the_same_of_a_corner_act_as_one(tmp_path):
    """A number with its ramp, a function and a schedule, which agree up to round-off at every step time."""
    steps = {"steps": pd.Steps(3)}
    rest = region.Slab("x", low=1.0) & BOTTOM
    left = pd.Displacement(LEFT, x=lambda x, t: 0.1 * t * x[:, 1], y=lambda x, t: 0.3 * t + 0.0 * x[:, 0])
    doubled = corner(left, pd.Displacement(BOTTOM, y=0.1, schedule=lambda t: 3.0 * t), **steps)
    once = corner(left, pd.Displacement(rest, y=0.3), **steps)
    one, other = (pd.run(case, tmp_path / str(n)).solution.u for n, case in enumerate((doubled, once)))
    assert np.abs(one - other).max() < 1e-12
    assert np.abs(one).max() > 0.3


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
def test_conditions_that_prescribe_something_else_of_a_corner_are_named(unit):
    def held(y, schedule=None):
        return corner(
            pd.Displacement(region.Slab("x", high=unit), x=0.0, y=0.1 * unit),
            pd.Displacement(region.Slab("y", high=unit), y=y * unit, schedule=schedule), unit=unit, steps=pd.Steps(4),
        )  # fmt: skip

    pd.prepare(held(0.1 * (1.0 + 1e-14)))
    with pytest.raises(pd.CaseError) as refused:
        pd.prepare(held(0.1001))
    assert str(refused.value) == (
        f"At step time 0.25: Displacement condition 2 prescribes y of 1 particle a second time with another value: "
        f"{0.25 * 0.1001 * unit:.10g} for particle 0 at ({0.5 * unit:g}, {0.5 * unit:g}), where Displacement condition "
        f"1 has {0.25 * 0.1 * unit:.10g}; let both prescribe the same value, or leave these particles out of one of "
        f"them."
    )
    with pytest.raises(pd.CaseError, match=r"At step time 0.25: .* a second time"):
        pd.prepare(held(0.1, pd.Hold()))  # the same at the end only


def test_conditions_that_part_between_the_steps_end_the_run_there():
    """A step that is cut back meets times that nobody has named before."""
    off = pd.Displacement(BOTTOM, y=0.1, schedule=lambda t: t + 0.5 * (t % 0.25 > 0.0))
    problem = pd.prepare(corner(pd.Displacement(LEFT, x=0.0, y=0.1), off, steps=pd.Steps(4))).problem
    assert problem.supports.prescribed(0.5).max() == pytest.approx(0.05)
    with pytest.raises(pd.SolveError, match=r"At step time 0.375: .* a second time"):
        problem.supports.prescribed(0.375)


TWO_RANKS = """
import pdpetsc as pd
from tests.terms.test_loads import BOTTOM, LEFT, corner

same = corner(pd.Displacement(LEFT, x=0.0, y=0.1), pd.Displacement(BOTTOM, y=0.1))
found = pd.prepare(same)
print("held", sorted(found.comm.allreduce([int(gid) for gid in found.cloud.gid[: found.cloud.n_owned][
    found.problem.supports.fixed[: found.cloud.n_owned, 1]]])))
try:
    pd.prepare(corner(pd.Displacement(LEFT, x=0.0, y=0.1), pd.Displacement(BOTTOM, y=lambda x, t: 0.1 * x[:, 0])))
except pd.CaseError as error:
    print("refused", error)
"""


def test_conditions_on_a_corner_are_compared_alike_on_every_rank():
    one, two = (script_on(ranks, TWO_RANKS).splitlines() for ranks in (1, 2))
    assert "held [0, 1, 2, 3, 4, 8, 12]" in one
    assert set(two) == set(one)
    assert len(two) == 2 * len(one) == 4


@pytest.mark.parametrize("heat", [None, pd.HeatConduction()])
def test_temperatures_that_agree_on_a_corner_act_as_one(heat, tmp_path):
    law = pd.Thermal(pd.LinearElastic(E=E, nu=0.0), 1e-3, conductivity=2.0)
    held = [
        pd.Displacement(region.Nearest((0.5, 0.5)), x=0.0, y=0.0), pd.Displacement(region.Nearest((0.5, 3.5)), x=0.0)
    ]  # fmt: skip
    shared, rest = BOTTOM & region.Slab("x", high=3.0), BOTTOM & region.Slab("x", low=1.0, high=3.0)
    far = pd.Temperature(~(LEFT | shared) if heat is None else region.Slab("x", low=3.0), 0.0)

    def heated(*bottom):
        left = pd.Temperature(LEFT, lambda x, t: 40.0 * t + 0.0 * x[:, 0])
        changes = {"material": law, "heat": heat, "fields": [pd.temperature], "steps": pd.Steps(3)}
        return corner(*held, left, *bottom, far, **changes)

    one, other = (
        pd.run(heated(pd.Temperature(where, 40.0)), tmp_path / str(n)).field("temperature")
        for n, where in enumerate((shared, rest))
    )
    assert np.abs(one - other).max() < 1e-9
    assert one.max() == pytest.approx(40.0)
    with pytest.raises(pd.CaseError, match=r"the temperature of 1 particle a second time with another value: .* 0 at"):
        pd.prepare(heated(pd.Temperature(shared, 41.0)))


LOADED_END = """
import pdpetsc as pd

def case(end="slab", normal=False, function=False):
    load = (lambda x, t: -25.0 * t) if function else -25.0
    regions = {"slab": pd.region.Slab("x", low=9.0), "tag": pd.region.Named("+x")}
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 4.0), 0.5), horizon=1.0075, material=pd.LinearElastic(E=1000.0, nu=0.3),
        conditions=[
            pd.Displacement(pd.region.Slab("x", high=0.5), x=0.0, y=0.0),
            pd.Traction(regions[end], y=load, normal=(1.0, 0.0) if normal else (), distribution="surface"),
        ],
        history={"force": pd.Reaction("y")}, results=lambda h: {"force": h["force"][-1]},
    )
"""


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_traction_on_several_sides_of_a_box_is_refused(ranks, tmp_path):
    """A slab at the end of a bar holds facets of its top and bottom too: the resultant was 150 for 100."""
    path = tmp_path / "end.py"
    path.write_text(LOADED_END)
    for function in (0, 1):
        words = f"function={function}"
        refused = called(path, words, "-o", tmp_path / "refused", ranks=ranks, cwd=tmp_path)
        assert refused.returncode != 0
        said = " ".join(refused.stderr.split())
        assert "holds facets on 3 sides of the body" in said
        assert "write one of them, '+x', '-y', '+y'" in said
    for words in (["end=tag"], ["normal=1"]):
        done = results(path, *words, ranks=ranks, output=tmp_path / "run")
        assert done["results"]["force"] == pytest.approx(100.0, rel=1e-9)


def test_a_point_between_two_particles_that_are_held_is_told(tmp_path, caplog):
    """Two neighbours that are held resist rotation: a beam on such points is clamped there."""
    warned = {}
    for sides, height in (("even", 4.0), ("odd", 5.0)):
        case = pd.Case(
            particles=pd.Lattice((0.0, 0.0), (height, 4.0), 1.0), horizon=2.015, material=pd.LinearElastic(1.0, 0.3),
            conditions=[
                pd.Displacement(region.Slab("y", high=1.0), x=0.0, y=0.0),
                pd.Displacement(region.Nearest((0.5 * height, 4.0)), y=0.1),
            ],
        )  # fmt: skip
        caplog.clear()
        pd.run(case, output=tmp_path / sides)
        warned[sides] = "Displacement condition 2 holds 2 particles near (2, 3.5)" in caplog.text
    assert warned == {"even": True, "odd": False}


@pytest.mark.parametrize("ranks", [1, 2])
def test_rollers_on_nodes_leave_a_uniform_stress(ranks, tmp_path):
    text = """
import pdpetsc as pd

def case():
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (4.0, 2.0), 0.5), horizon=1.0075,
        material=pd.LinearElastic(E=1000.0, nu=0.3, plane="stress"),
        conditions=[pd.Roller("-x"), pd.Roller("-y"), pd.Traction("+x", x=1.0)],
        history={"x": pd.Mean(pd.displacement, "x", pd.region.Face("+x")),
                 "y": pd.Mean(pd.displacement, "y", pd.region.Face("+y"))},
        results=lambda h: {"x": h["x"][-1], "y": h["y"][-1]},
    )
"""
    path = tmp_path / "rollers.py"
    path.write_text(text)
    found = results(path, ranks=ranks, output=tmp_path / "run")["results"]
    assert found["x"] == pytest.approx(4.0e-3, rel=1e-9)
    assert found["y"] == pytest.approx(-0.3 * 2.0e-3, rel=1e-9)


def clamped(particles, support, **given):
    """Return a body with a support on one side."""
    return pd.Case(
        particles=particles, horizon=1.0, material=pd.LinearElastic(1000.0, 0.3),
        conditions=[support, pd.Traction("+x", x=1.0)], **given,
    )  # fmt: skip


def test_the_reaction_of_a_clamped_lattice_is_that_of_its_layers(tmp_path):
    """A bar of 10 x 2 pulled by 3 on its end: the side that Clamp holds carries the load."""
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0, 2.0), 0.5),
        horizon=1.5075,
        material=pd.LinearElastic(E=100.0, nu=0.3, plane="stress"),
        conditions=[pd.Clamp("-x"), pd.Traction("+x", x=3.0)],
        history={"support": pd.Reaction("x", "-x")},
    )
    assert pd.run(case, tmp_path).history["support"][-1] == pytest.approx(-6.0, rel=1e-9)


def test_a_lattice_has_layers_and_mirror_planes_beyond_its_supports():
    lattice = pd.Lattice((0.0, 0.0), (4.0, 2.0), 0.5)
    held = pd.prepare(clamped(lattice, pd.Clamp("-x")))
    assert held.case.particles.fictitious == {"-x": 1.0}
    x = held.cloud.x[: held.cloud.n_owned]
    fixed = held.problem.supports.fixed.reshape(-1, 2).all(axis=1)
    np.testing.assert_array_equal(fixed, x[:, 0] < 0.0)
    sliding = pd.prepare(clamped(lattice, pd.Roller("+y"), symmetry=[pd.Symmetry("x")])).case
    assert sliding.symmetry == [pd.Symmetry("x"), pd.Symmetry("y", 2.0)]


@pytest.mark.parametrize("support", [pd.Clamp("-x"), pd.Roller("-x")])
def test_a_side_that_no_particle_is_on_is_refused(support):
    x, volume = grid((8, 4), (0.5, 0.5))
    cloud = pd.Arrays(x, np.full(len(x), volume))
    with pytest.raises(pd.CaseError, match="are behind it"):
        pd.prepare(clamped(cloud, support))
    with pytest.raises(pd.CaseError, match="no side '-z'"):
        pd.prepare(clamped(pd.Lattice((0.0, 0.0), (4.0, 2.0), 0.5), pd.Clamp("-z")))
    with pytest.raises(pd.CaseError, match="requires either `axis`"):
        pd.Roller("a set")


BEND = """
import pdpetsc as pd

LENGTH, HEIGHT, E, NU = 40.0, 8.0, 1000.0, 0.3

def case(dx=1.0, deflection=0.1):
    ends = [pd.region.Sphere((x, 0.0), 2.1) for x in (0.0, LENGTH)]
    middle = pd.region.Sphere((0.5 * LENGTH, HEIGHT), 2.1)
    # Slender bending and shear of a beam that is simply supported.
    compliance = LENGTH**3 / (4.0 * E * HEIGHT**3) + LENGTH / (4.0 * 5.0 / 6.0 * E / (2.0 + 2.0 * NU) * HEIGHT)
    return pd.Case(
        particles=pd.LatticeNodes((0.0, 0.0), (LENGTH, HEIGHT), dx),
        material=pd.LinearElastic(E=E, nu=NU, plane="stress"),
        conditions=[
            pd.PointSupport(ends[0], x=0.0, y=0.0), pd.PointSupport(ends[1], y=0.0),
            pd.PointSupport(middle, y=-deflection),
        ],
        history={"force": pd.Reaction("y", middle), "left": pd.Reaction("y", ends[0]),
                 "mean": pd.Mean(pd.displacement, "y", ends[1]), "tip": pd.Mean(pd.displacement, "y", middle)},
        results=lambda h: {name: column[-1] for name, column in h.items()}
        | {"stiffness": -h["force"][-1] / deflection * compliance},
    )
"""


def test_a_point_support_holds_the_mean_and_turns(tmp_path):
    path = tmp_path / "bend.py"
    path.write_text(BEND)
    forces = []
    for name, options, ranks in (
        ("one", [], 1),
        ("two", [], 2),
        ("free", ["-pd_jacobian", "matfree", "-ksp_rtol", "1e-11"], 1),
    ):
        found = results(path, *options, ranks=ranks, output=tmp_path / name)["results"]
        assert abs(found["mean"]) < 1e-12
        assert found["tip"] == pytest.approx(-0.1, rel=1e-12)
        assert found["left"] == pytest.approx(-0.5 * found["force"], rel=1e-7)
        forces.append(found["force"])
        # The reactions act at the middles of the patches, nearer to each other than the ends. Clamps: more than 2.
        assert 1.0 < found["stiffness"] < 1.2
        run = pd.open(tmp_path / name)
        patch = np.linalg.norm(run.x[:, :2], axis=1) < 2.1
        turned = np.polyfit(run.x[patch, 0], run.field("displacement")[patch, 1], 1)[0]
        assert turned == pytest.approx(-1.5 * 0.1 / 20.0, rel=0.2)
    np.testing.assert_allclose(forces, forces[0], rtol=1e-7)


@pytest.mark.parametrize("tagged", [False, True])
def test_nodes_of_a_mesh_are_clamped_themselves(tagged, tmp_path):
    """A bar of triangles with its own uniform stress: rollers by side and by the name of a set of the mesh."""
    n, m = 8, 4
    points = np.stack(np.meshgrid(0.5 * np.arange(n + 1), 0.5 * np.arange(m + 1), indexing="ij"), axis=-1).reshape(
        -1, 2
    )
    low = (np.arange(n)[:, None] * (m + 1) + np.arange(m)).ravel()
    cells = np.concatenate([np.stack([low, low + m + 1, low + m + 2], 1), np.stack([low, low + m + 2, low + 1], 1)])
    left = np.stack([np.arange(m), np.arange(1, m + 1)], 1)
    path = tmp_path / "bar.vtu" if not tagged else tmp_path / "bar.msh"
    tags = {
        "gmsh:physical": [np.ones(len(cells), int), np.full(m, 7)],
        "gmsh:geometrical": [np.ones(len(cells), int), np.full(m, 7)],
    }
    mesh = meshio.Mesh(
        points,
        [("triangle", cells), ("line", left)],
        cell_data=tags,
        field_data={"left": np.array([7, 1]), "body": np.array([1, 2])},
    )
    if tagged:
        mesh.write(path, file_format="gmsh22", binary=False)
    else:
        meshio.Mesh(points, [("triangle", cells)]).write(path)
    support = pd.Roller("left", axis="x") if tagged else pd.Roller("-x")
    case = pd.Case(
        particles=pd.MeshNodes(path), material=pd.LinearElastic(E=E, nu=0.3, plane="stress"),
        conditions=[support, pd.Roller("-y"), pd.Traction("+x", x=1.0)],
        history={"x": pd.Mean(pd.displacement, "x", "+x"), "y": pd.Mean(pd.displacement, "y", "+y")},
    )  # fmt: skip
    history = pd.run(case, tmp_path / "run").history
    assert history["x"][-1] == pytest.approx(4.0 / E, rel=1e-8)
    assert history["y"][-1] == pytest.approx(-0.3 * 2.0 / E, rel=1e-8)
    clamped = dataclasses.replace(case, conditions=[pd.Clamp("left" if tagged else "-x"), pd.Traction("+x", x=1.0)])
    prepared = pd.prepare(clamped)
    fixed = prepared.problem.supports.fixed[: prepared.cloud.n_owned].all(axis=1)
    np.testing.assert_array_equal(fixed, prepared.cloud.x[: prepared.cloud.n_owned, 0] == 0.0)
