"""What users do with a finished run: sampling, data frames, PyVista, a first case, the doctor."""

import contextlib
import importlib
import importlib.util
import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pdpetsc as pd
from pdpetsc.command_line import doctor
from pdpetsc.command_line.new import new
from pdpetsc.discrete.communicator import world
from pdpetsc.output import progress
from pdpetsc.output.pace import Pace
from pdpetsc.output.reading import StoredFields
from pdpetsc.output.scene import Settings, scene_of
from pdpetsc.post.point_location import inside_of
from pdpetsc.post.sampling import sampled
from pdpetsc.running.comparison import Comparison
from pdpetsc.running.result import Result
from tests.commands import ROOT, TIMEOUT, called, results, run


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    everywhere = pd.region.All()
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (6.0, 3.0), 0.5),
        horizon=1.0075,
        material=pd.LinearElastic(1.0, nu=0.0),
        scheme=pd.SubHorizons(),
        conditions=[
            pd.Displacement(
                everywhere, x=lambda x, t: t * (0.1 * x[:, 0] - 0.02 * x[:, 1]), y=lambda x, t: 0.03 * t * x[:, 0]
            )
        ],
        steps=pd.Steps(2),
        fields=[pd.displacement, pd.stress],
        history={"force": pd.Reaction("x")},
    )
    return pd.run(case, tmp_path_factory.mktemp("result"))


def test_a_linear_field_is_sampled_exactly(result):
    line = np.linspace((0.1, 0.3), (5.9, 2.8), 17)
    u = pd.open(result.folder).sample(line)
    assert u.shape == (17, 3)
    assert np.allclose(u[:, 0], 0.1 * line[:, 0] - 0.02 * line[:, 1], atol=1e-12)
    assert np.allclose(u[:, 1], 0.03 * line[:, 0], atol=1e-12)
    assert np.allclose(result.sample(np.c_[line, np.zeros(17)]), u, atol=1e-15)
    assert np.allclose(result.sample(line, step=1), 0.5 * u, atol=1e-12)
    assert result.sample(line, "stress").shape == (17, 3, 3)


def test_there_is_nothing_outside_of_the_body(result):
    outside = result.sample([(-1.0, 1.0), (3.0, 4.0), (3.0, 1.0)])
    assert np.isnan(outside[:2]).all() and np.isfinite(outside[2]).all()
    with pytest.raises(pd.CaseError, match="2 or 3 coordinates"):
        result.sample([(1.0,)])
    with pytest.raises(pd.CaseError, match="no field"):
        result.sample([(1.0, 1.0)], "temperature")


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_sampling_in_other_units_and_shaken_clouds_is_exact_for_linear_fields(dim, rng):
    grid = np.stack(np.meshgrid(*[np.arange(7.0)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x = np.zeros((len(grid), 3))
    x[:, :dim] = (grid + rng.uniform(-0.2, 0.2, grid.shape)) * 1e-9
    slope = rng.normal(size=dim)
    at = rng.uniform(1.0, 5.0, (20, dim)) * 1e-9
    found = sampled(x, x[:, :dim] @ slope, at, inside_of(x[:, :dim], np.full(len(x), 1e-9**dim), 1.0))
    assert np.allclose(found, at @ slope, rtol=1e-9, atol=1e-9 * np.abs(at @ slope).max())


@pytest.mark.parametrize(
    "spacing", [(1.0, 1 / 6), (1.0, 0.1), (1.0, 0.03), (1.0, 1.0, 4.0), (1e-6, 6e-6, 1e-6)], ids=lambda s: str(s)
)
def test_particles_in_rows_and_layers_far_apart_are_sampled_between_them(spacing):
    """The nearest particles of a point then lie in one row or layer, which says nothing of the slope across it."""
    dim = len(spacing)
    counts = [5 if h == max(spacing) else 15 for h in spacing]
    axes = [h * np.arange(n) for n, h in zip(counts, spacing, strict=True)]
    x = np.zeros((np.prod(counts), 3))
    x[:, :dim] = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    body = inside_of(x[:, :dim], np.full(len(x), np.prod(spacing)), 1.0)
    at = np.random.default_rng(2).uniform(0.0, 1.0, (300, dim)) * [axis[-1] for axis in axes]
    slope = np.array([1.0, -2.0, 3.0])[:dim]
    assert np.allclose(sampled(x, x[:, :dim] @ slope, at, body), at @ slope, rtol=0.0, atol=1e-9 * np.max(spacing))
    low = np.array(at)
    short = int(np.argmin(spacing))
    low[:, short] = -0.51 * spacing[short]
    assert np.isnan(sampled(x, x[:, 0], low, body)).all()
    low[:, short] = -0.49 * spacing[short]
    assert np.allclose(sampled(x, x[:, 0], low, body), low[:, 0], rtol=0.0, atol=1e-9 * np.max(spacing))


def test_a_change_of_size_of_the_cells_is_no_hole():
    """Fine particles to the left of coarse ones; a hole of many cells is one still."""
    fine = np.stack(np.meshgrid(np.arange(-0.195, 0.0, 0.01), np.arange(0.005, 1.0, 0.01)), axis=-1).reshape(-1, 2)
    coarse = np.stack(np.meshgrid(np.arange(0.05, 1.0, 0.1), np.arange(0.05, 1.0, 0.1)), axis=-1).reshape(-1, 2)
    coarse = coarse[np.hypot(*(coarse - 0.5).T) > 0.31]
    x = np.zeros((len(fine) + len(coarse), 3))
    x[:, :2] = np.concatenate([fine, coarse])
    body = inside_of(x[:, :2], np.repeat([1e-4, 1e-2], [len(fine), len(coarse)]), 1.0)
    at = np.array([[0.005, 0.5], [0.015, 0.43], [0.02, 0.5], [0.03, 0.27], [0.04, 0.9]])
    assert np.allclose(sampled(x, x[:, 0], at, body), at[:, 0])
    outside = [(0.5, 0.5), (-0.3, 0.5), (-0.207, 0.5), (1.02, 0.5)]
    assert np.isnan(sampled(x, x[:, 0], outside, body)).all()


def test_places_of_a_line_are_points():
    x = np.zeros((6, 3))
    x[:, 0] = np.arange(6.0)
    body = inside_of(x[:, :1], np.full(6, 2.0), 2.0)
    for places in ([0.5, 1.5, 4.2], [0.5], 0.5, [0.5, 4.0]):
        assert np.allclose(sampled(x, 2.0 * x[:, 0], places, body), 2.0 * np.atleast_1d(places))
    assert np.allclose(sampled(x, 2.0 * x[:, 0], [[1.5, 0.0, 0.0]], body), 3.0)
    assert np.isnan(sampled(x, 2.0 * x[:, 0], [[1.5, 0.0, 1.1], [5.51, 0.0, 0.0], [-0.51, 0.0, 0.0]], body)).all()


def test_one_particle_has_a_value_where_it_is():
    x, values = np.array([[1.0, 2.0, 0.0]]), np.array([[7.0, 8.0]])
    body = inside_of(x[:, :2], np.ones(1), 1.0)
    for points in ([(1.0, 2.0)], [(1.0, 2.0, 0.0)], (1.0, 2.0)):
        assert np.array_equal(sampled(x, values, points, body), values)
    with pytest.raises(pd.CaseError, match="one particle"):
        sampled(x, values, [(1.0, 2.0), (1.5, 2.0)], body)


def test_odd_points_are_answered_or_refused(result):
    assert result.sample([]).shape == (0, 3) and result.sample(np.empty((0, 2)), "stress").shape == (0, 3, 3)
    with pytest.raises(pd.CaseError, match="1 points are not finite"):
        result.sample([(1.0, 1.0), (np.nan, 1.0)])
    with pytest.raises(pd.CaseError, match="not 1x2x2"):
        result.sample(np.ones((1, 2, 2)))
    off = result.sample([(3.0, 1.0, 0.4), (3.0, 1.0, 0.6)])
    assert np.isfinite(off[0]).all() and np.isnan(off[1]).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_shaken_clouds_have_values_everywhere_inside(dim):
    rng = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(*[np.arange(9.0)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    x = np.zeros((len(grid), 3))
    x[:, :dim] = grid + rng.uniform(-0.2, 0.2, grid.shape)
    body = inside_of(x[:, :dim], np.ones(len(x)), 1.0)
    found = sampled(x, x[:, 0], rng.uniform(1.0, 7.0, (3000, dim)), body)
    assert np.isfinite(found).all()


def test_results_come_as_frames_and_clouds_where_the_libraries_are(result):
    for call, name in ((result.frame, "pandas"), (result.to_pyvista, "pyvista")):
        try:
            importlib.import_module(name)
        except ImportError:
            with pytest.raises(pd.CaseError, match=f"pip install {name}"):
                call()
            continue
        found = call()
        if name == "pandas":
            assert list(found["step"]) == [0.0, 1.0, 2.0] and found["force"].iloc[-1] == result.history["force"][-1]
        else:
            assert found.n_cells == 72 and found.cell_data["stress"].shape == (72, 9)
            assert np.allclose(found.cell_data["displacement"], result.field("displacement"))
    assert result.results == dict(result)


def test_a_new_case_runs_as_it_is(tmp_path):
    finished = called("new", "bar.py", cwd=tmp_path)
    assert finished.returncode == 0 and finished.stdout.strip() == "bar.py"
    assert called(tmp_path / "bar.py", "dx=0.5", "-o", tmp_path / "out").returncode == 0
    history = pd.open(tmp_path / "out").history
    assert history["force"][-1] == pytest.approx(-100.0 * 4.0)
    # Hencky's stress of a bar that is free to contract, but for its clamped end.
    assert history["u_end"][-1] == pytest.approx(100.0 / 200e3 * 20.0, rel=0.01)
    with pytest.raises(pd.CaseError, match="is there already"):
        new(tmp_path / "bar.py")
    with pytest.raises(pd.CaseError, match=r"ends in \.py"):
        new(tmp_path / "bar.txt")
    with pytest.raises(pd.CaseError, match="Cannot write"):
        new(tmp_path / "nowhere" / "bar.py")


def test_the_doctor_finds_nothing_broken_where_tests_run(capsys):
    assert doctor.doctor(world()) == 0
    said = capsys.readouterr().out
    assert "MUMPS" in said and "broken" not in said


def test_the_doctor_tells_processes_that_do_not_hear_each_other(monkeypatch):
    monkeypatch.setenv("SLURM_STEP_NUM_TASKS", "4")
    (found,) = doctor.ranks(world())
    assert found.verdict == "broken" and "4 processes, each alone" in found.found and found.advice
    monkeypatch.setattr(doctor, "_factored", lambda comm: 0.5)
    assert [one.verdict for one in doctor.petsc(world())] == ["ok", "broken"]

    def fails(comm):
        raise RuntimeError("no such library")

    monkeypatch.setattr(doctor, "CHECKS", (fails,))
    assert doctor.doctor(world()) == 1


ONE_RANK = """
import sys
from pdpetsc.command_line import doctor
from pdpetsc.discrete.communicator import world
from pdpetsc.output import progress
from pdpetsc.output.pace import Pace
from pdpetsc.output.reading import StoredFields
from pdpetsc.output.scene import scene_of

def looks(comm):
    if comm.rank == 1:
        raise RuntimeError("no such library")
    return [doctor.Finding("ok", "library", "there")]

doctor.CHECKS = (looks,)
sys.exit(doctor.doctor(world()))
"""


def test_the_doctor_tells_what_is_broken_on_another_rank(tmp_path):
    (tmp_path / "one.py").write_text(ONE_RANK)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    words = [str(ROOT / ".ci" / "mpirun"), "2", sys.executable, str(tmp_path / "one.py")]
    finished = subprocess.run(
        words, capture_output=True, text=True, timeout=TIMEOUT, cwd=ROOT, env=environment, check=False
    )
    assert finished.returncode == 1
    first, second, third = finished.stdout.splitlines()[:3]
    assert first.split() == ["ok", "library", "there"]
    assert second.startswith("broken  looks on rank 1") and "no such library" in second
    assert "install it anew" in third


def test_words_that_are_nearly_right_are_named(tmp_path):
    assert called("docter").stderr == "pdpetsc: No command docter; did you mean doctor?\n"
    assert called("plt", tmp_path, "scale=2").stderr == "pdpetsc: No command plt; did you mean plot?\n"
    new(tmp_path / "bar.py")
    finished = called(tmp_path / "bar.py", "stres=0.1", "-o", tmp_path / "out")
    assert finished.returncode == 2 and "did you mean stress?" in finished.stderr
    said = called(tmp_path / "bar.py", "-h").stdout
    assert "A bar that is clamped" in said and "stress=100.0  float" in said


# Files that other programs open.


def test_pyvista_opens_the_cells_with_time_steps_and_tensors_by_component(result):
    pyvista = pytest.importorskip("pyvista")
    reader = pyvista.get_reader(result.folder / "fields.xdmf")
    assert list(reader.time_values) == [0.0, 0.5, 1.0]
    for step, t in enumerate(reader.time_values):
        reader.set_active_time_value(t)
        mesh = reader.read()
        assert mesh.n_cells == 72 and np.allclose(mesh.cell_centers().points, result.x)
        stress = result.field("stress", step)
        assert np.array_equal(mesh["stress"], stress.reshape(-1, 9))
        assert np.array_equal(mesh["displacement"], result.field("displacement", step))
        for name, i, j in (("xx", 0, 0), ("xy", 0, 1), ("yx", 1, 0), ("yy", 1, 1), ("zz", 2, 2)):
            assert np.array_equal(mesh[f"stress_{name}"], stress[:, i, j])
            assert np.array_equal(result.field(f"stress_{name}", step), stress[:, i, j])


NAMES = """
import pdpetsc as pd

def case(dim=2, end=""):
    left, right = pd.region.Slab("x", high=1.0), pd.region.Slab("x", low=5.0)

    class Ends(pd.Quantity):
        def evaluate(self, solution):
            if end == "killed" and solution.t > 0.6:
                import os, signal
                os.kill(os.getpid(), signal.SIGKILL)
            return 0.0

    return pd.Case(
        particles=pd.Lattice((0.0,) * dim, (6.0, 2.0, 2.0)[:dim], 0.5), horizon=1.0075,
        material=pd.LinearElastic(1.0, 0.0),
        scheme=pd.SubHorizons(), steps=pd.Steps(4), history={"ends": Ends()},
        conditions=[pd.Displacement(left, **dict.fromkeys("xyz"[:dim], 0.0)), pd.Displacement(right, x=0.1)],
    )
"""


@pytest.mark.parametrize(("dim", "n"), [(1, 3), (2, 5), (3, 9)])
def test_a_tensor_has_the_entries_that_its_body_may_have(dim, n, tmp_path):
    (tmp_path / "case.py").write_text(NAMES)
    results(tmp_path / "case.py", f"dim={dim}", output=tmp_path / "out")
    opened = pd.open(tmp_path / "out")
    named = [name for name in opened.fields.names() if name.startswith("stress_")]
    assert len(named) == n
    stress = opened.field("stress")
    for name in named:
        i, j = ("xyz".index(letter) for letter in name[-2:])
        assert np.array_equal(opened.field(name), stress[:, i, j])
    other = np.ones((3, 3), dtype=bool)
    other[tuple(np.transpose([["xyz".index(letter) for letter in name[-2:]] for name in named]))] = False
    assert not stress[:, other].any()
    # Of the stress: s = sqrt(3/2 dev : dev), in the words of the axes.
    s = 0.5 * (stress + stress.transpose(0, 2, 1))
    spread = (s[:, 0, 0] - s[:, 1, 1]) ** 2 + (s[:, 1, 1] - s[:, 2, 2]) ** 2 + (s[:, 2, 2] - s[:, 0, 0]) ** 2
    shear = s[:, 0, 1] ** 2 + s[:, 1, 2] ** 2 + s[:, 2, 0] ** 2
    assert np.allclose(opened.field("von_mises"), np.sqrt(0.5 * spread + 3.0 * shear), atol=1e-12)


def test_a_field_of_the_case_keeps_the_name_of_a_component(tmp_path):
    def stress_xx(solution):
        return solution.x[:, 0]

    case = pd.Case(
        particles=pd.Lattice((0.0,), (4.0,), 0.5), horizon=1.0075, material=pd.LinearElastic(1.0, nu=0.0),
        conditions=[pd.Displacement(pd.region.All(), x=0.0)], fields=[pd.stress, stress_xx],
    )  # fmt: skip
    result = pd.run(case, tmp_path)
    assert np.array_equal(result.field("stress_xx"), result.x[:, 0])
    assert result.fields.names() == ["stress", "stress_xx", "stress_yy", "stress_zz"]
    text = (tmp_path / "fields.xdmf").read_text()
    assert text.count('Name="stress_xx"') == 2  # once in each of two steps


@pytest.mark.long
def test_what_a_killed_run_left_opens_and_a_restart_makes_it_whole(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    (tmp_path / "case.py").write_text(NAMES)
    whole, out = tmp_path / "whole", tmp_path / "out"
    results(tmp_path / "case.py", output=whole)
    assert run(tmp_path / "case.py", "end=killed", output=out).returncode == -9
    reader = pyvista.get_reader(out / "fields.xdmf")
    assert list(reader.time_values)[:3] == [0.0, 0.25, 0.5]
    for t in reader.time_values:
        reader.set_active_time_value(t)
        assert np.isfinite(reader.read()["stress_xx"]).all()
    assert called(tmp_path / "case.py", "--restart", out, "--restart-anyway", "-o", out, ranks=2).returncode == 0
    assert (out / "fields.xdmf").read_text() == (whole / "fields.xdmf").read_text()
    reader = pyvista.get_reader(out / "fields.xdmf")
    assert list(reader.time_values) == [0.0, 0.25, 0.5, 0.75, 1.0]
    for step, t in enumerate(reader.time_values):
        reader.set_active_time_value(t)
        for name in ("stress_xx", "von_mises", "displacement"):
            exact = pd.open(whole).field(name, step)
            assert np.allclose(reader.read()[name], exact, atol=1e-9 * np.abs(exact).max(initial=1e-300))


# Comparing, sampling on lines and grids, xarray, notebooks.


def bar(folder, dx=0.5, steps=2, **given):
    everywhere = pd.region.All()
    case = pd.Case(
        particles=pd.Lattice((0.0, 0.0), (6.0, 3.0), dx), horizon=2.015 * dx, material=pd.BondBased(E=1000.0),
        conditions=[pd.Displacement(everywhere, x=lambda x, t: t * 0.1 * x[:, 0], y=lambda x, t: t * 0.02 * x[:, 1])],
        steps=pd.Steps(steps), history={"end": pd.Mean(pd.displacement, "x", pd.region.Slab("x", low=5.0))},
        results=lambda h: {"end": h["end"][-1]}, **given,
    )  # fmt: skip
    return pd.run(case, folder, parameters={"dx": dx, "steps": steps, "name": "bar"})


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    place = tmp_path_factory.mktemp("two")
    return bar(place / "coarse"), bar(place / "fine", dx=0.25, steps=4)


def test_runs_stand_beside_each_other(two):
    coarse, fine = two
    both = pd.compare([coarse, str(fine.folder)])
    table = both.table
    # What both have in common tells nothing.
    assert list(table) == ["run", "dx", "steps", "end", "seconds", "MiB", "status"]
    assert table["run"] == ["coarse", "fine"] and table["dx"] == [0.5, 0.25] and table["steps"] == [2, 4]
    assert table["end"] == [coarse["end"], fine["end"]] and table["status"] == ["converged"] * 2
    assert all(seconds > 0.0 for seconds in table["seconds"])
    first, second, third = str(both).splitlines()
    assert first.split() == list(table) and second.split()[:3] == ["coarse", "0.5", "2"] and "fine" in third
    assert both._repr_html_().count("<tr>") == 3
    if importlib.util.find_spec("pandas"):
        frame = both.frame()
        assert frame.loc["fine", "end"] == fine["end"] and list(frame.index) == ["coarse", "fine"]
    figure = both.figure()
    assert [axis.get_ylabel() for axis in figure.axes] == ["end"] and len(figure.axes[0].lines) == 2
    assert np.array_equal(figure.axes[0].lines[1].get_ydata(), fine.history["end"])


def test_fields_of_runs_are_compared_at_the_same_points_and_step_times(two):
    both = pd.compare({"a": two[0], "b": two[1]})
    # A linear field is met exactly whatever the spacing.
    found = both.difference("displacement")
    assert list(found) == ["b"] and found["b"].shape == (72, 3) and np.allclose(found["b"], 0.0, atol=1e-12)
    assert np.allclose(both.difference("displacement", t=0.5)["b"], 0.0, atol=1e-12)
    line = pd.line((-1.0, 1.5), (5.0, 1.5), 7)
    found = both.difference("displacement", points=line)["b"]
    assert np.isnan(found[0]).all() and np.allclose(found[1:], 0.0, atol=1e-12)
    with pytest.raises(pd.CaseError, match=r"a has no fields at step time 0\.25; it has some at 0, 0\.5, 1"):
        both.difference("displacement", t=0.25)
    with pytest.raises(pd.CaseError, match="no field 'nothing'"):
        both.difference("nothing")


def test_what_cannot_be_compared_is_refused(two, tmp_path):
    with pytest.raises(pd.CaseError, match="at least two runs, not 1"):
        pd.compare([two[0]])
    with pytest.raises(pd.CaseError, match="requires a list of runs"):
        pd.compare(two[0])
    with pytest.raises(pd.CaseError, match="given twice"):
        pd.compare([two[0], two[0].folder])
    with pytest.raises(pd.CaseError, match=r"holds no summary\.json"):
        pd.compare([two[0], tmp_path])
    one, other = (bar(tmp_path / unit, units=pd.Units(unit, "N")) for unit in ("mm", "m"))
    with pytest.raises(pd.CaseError, match="mm is in mm and N, m is in m and N"):
        pd.compare([one, other])
    pd.compare([one, two[0]])
    given = {"m": {"length": "m", "force": "N", "temperature": "K"}, "also": {"length": "m", "force": "N"}}
    given["other"] = {**given["m"], "temperature": "degC"}
    runs = {name: Result(Path(name), {}, {}, {"units": units}) for name, units in given.items()}
    Comparison({name: runs[name] for name in ("also", "m")})
    with pytest.raises(pd.CaseError, match="m has temperatures in K, other has temperatures in degC"):
        Comparison({name: runs[name] for name in ("also", "m", "other")})
    short = bar(tmp_path / "short", steps=2)
    short.fields  # noqa: B018
    (short.folder / "fields" / "step_00002.h5").unlink()
    with pytest.raises(pd.CaseError):
        pd.compare([short, two[1]]).difference("displacement")


def test_a_step_time_that_a_path_comes_to_again_is_refused(two, tmp_path, monkeypatch):
    both = pd.compare({"a": two[0], "b": two[1]})
    turn = {0: 0.0, 1: 0.5, 2: 1.0, 3: 0.5, 4: 0.25}
    monkeypatch.setattr(StoredFields, "time", lambda self, step=None: turn[self.steps[-1] if step is None else step])
    with pytest.raises(pd.CaseError, match=r"b has step time 0\.5 in steps 1, 3\. Compare"):
        both.difference("displacement", t=0.5)
    assert both.difference("displacement", t=1.0)["b"].shape == (72, 3)


def test_forces_on_particles_have_no_values_between_them(tmp_path):
    def pulled(name, n):
        case = pd.Case(
            particles=pd.Lattice((0.0, 0.0), (3.0, 1.0), 1.0 / n), horizon=2.015 / n, material=pd.BondBased(E=1000.0),
            conditions=[pd.Displacement(pd.region.Slab("x", high=1.0), x=0.0, y=0.0),
                        pd.Displacement(pd.region.Slab("x", low=2.0), x=0.01)],
            fields=[pd.displacement, pd.reaction],
        )  # fmt: skip
        return pd.run(case, tmp_path / name)

    both = pd.compare([pulled("coarse", 2), pulled("fine", 4)])
    coarse, fine = both.runs.values()
    # The share of a particle changes with the spacing.
    shares = [np.abs(run.field("reaction")[:, 0]).max() for run in (coarse, fine)]
    assert shares[1] < 0.8 * shares[0]
    for asked in (
        lambda: both.difference("reaction"),
        lambda: both.difference("reaction", points=[(2.5, 0.5)]),
        lambda: coarse.sample([(2.5, 0.5)], "reaction"),
    ):
        with pytest.raises(pd.CaseError, match=r"force per particle.*Sum field\('reaction'\) over a region"):
            asked()
    # Of the same particles they are compared one by one.
    again = pulled("again", 2)
    assert np.allclose(pd.compare([coarse, again]).difference("reaction")["again"], 0.0, atol=1e-12)
    assert np.isfinite(both.difference("displacement")["fine"]).all()


def test_no_column_of_a_table_takes_that_of_another():
    results = {"seconds": 123.0, "MiB": 5.0, "status": 7.0, "n": 4.5, "error": 0.1}
    costs = {"status": "converged", "timings": {"solve": 0.5, "compile": 9.0}, "peak_memory_bytes": [10 * 2**20]}
    one = Result(Path("one"), results, {}, {"parameters": {"n": 4, "seconds": 3}, **costs})
    other = Result(Path("other"), {}, {}, {"parameters": {"n": 5, "seconds": 2}, **costs})
    assert Comparison({"one": one, "other": other}).table == {
        "run": ["one", "other"], "n": [4, 5], "seconds (parameter)": [3, 2], "seconds (result)": [123.0, None],
        "MiB (result)": [5.0, None], "status (result)": [7.0, None], "n (result)": [4.5, None], "error": [0.1, None],
        "seconds": [0.5, 0.5], "MiB": [10.0, 10.0], "status": ["converged", "converged"],
    }  # fmt: skip
    # The name of a run is not that of its folder's parameter.
    runs = {name: Result(Path(name), {}, {}, {"parameters": {"run": n}}) for n, name in enumerate("ab")}
    table = Comparison(runs).table
    assert table["run"] == ["a", "b"] and table["run (parameter)"] == [0, 1]


def test_lines_and_grids_are_points(two):
    points = pd.grid((0.5, 0.5), (5.5, 2.5), (11, 5))
    u = two[1].sample(points).reshape(11, 5, 3)
    assert np.allclose(u[:, :, 0], 0.1 * np.linspace(0.5, 5.5, 11)[:, None], atol=1e-12)
    assert np.allclose(u[:, :, 1], 0.02 * np.linspace(0.5, 2.5, 5), atol=1e-12)
    u = two[0].sample(pd.line((1.0, 1.0, 0.0), (5.0, 1.0, 0.0), 5))
    assert np.allclose(u[:, 0], 0.1 * np.arange(1.0, 6.0), atol=1e-12)
    assert pd.line((0.0,), (1.0,), 3).shape == (3, 1) and pd.grid([0.0], [1.0], [4]).shape == (4, 1)
    for wrong in (((0.0, 0.0), (1.0,), 3), ((0.0,), (np.nan,), 3), ((0.0,), (1.0,), 1), ((0.0,), (1.0,), 2.5)):
        with pytest.raises(pd.CaseError, match="A line"):
            pd.line(*wrong)
    for wrong in (((0.0, 0.0), (1.0, 1.0), 3), ((0.0,), (1.0,), [0]), ((0.0,), (1.0,), [2.5])):
        with pytest.raises(pd.CaseError, match="A grid"):
            pd.grid(*wrong)


def test_all_steps_come_as_an_xarray_data_set(two):
    if importlib.util.find_spec("xarray") is None:
        with pytest.raises(pd.CaseError, match="pip install xarray"):
            two[0].to_xarray()
        pytest.skip("xarray is not installed")
    data = two[1].to_xarray()
    assert data["displacement"].dims == ("step", "particle", "component") and data.sizes["step"] == 5
    assert data["stress"].dims == ("step", "particle", "component", "along") and "stress_xx" not in data
    assert list(data["t"].values) == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert np.array_equal(data["X"], two[1].x)
    sigma = data["stress"].sel(step=3, component="x", along="y")
    assert np.array_equal(sigma, two[1].field("stress", 3)[:, 0, 1])


def test_fields_of_any_name_come_as_xarray_with_their_units(tmp_path):
    pytest.importorskip("xarray")
    names = ("t", "step", "particle", "component", "X", "t_field")
    fields = {name: (lambda s, n=n: n + s.volume) for n, name in enumerate(names)}
    run = bar(
        tmp_path, units=pd.Units("mm", "N"),
        fields={**fields, "displacement": pd.displacement, "principal_stresses": pd.principal_stresses},
    )  # fmt: skip
    data = run.to_xarray()
    own = ("t_field_field", "step_field", "particle_field", "component_field", "X_field", "t_field")
    for name, stored in zip(own, names, strict=True):
        assert np.array_equal(data[name].sel(step=2), run.field(stored)) and data[name].attrs["long_name"]
    assert data["t"].values.tolist() == [0.0, 0.5, 1.0] and list(data["step"].values) == [0, 1, 2]
    assert "particle" not in data.coords
    u = data["displacement"].attrs
    assert (u["long_name"], u["units"]) == ("displacement", "mm")
    assert data["principal_stresses"].dims == ("step", "particle", "principal")
    first = data["principal_stresses"].sel(step=2, principal=1)
    assert np.array_equal(first, run.field("principal_stresses").max(axis=1)) and first.attrs["units"] == "MPa"
    assert scene_of(run.folder, Settings("principal_stresses", "x")).label == "principal stresses 1 [MPa]"


def test_a_notebook_shows_a_table_and_a_picture(two, tmp_path):
    shown = two[0]._repr_html_()
    assert "converged" in shown and f"{two[0]['end']:.8g}" in shown and "data:image/png;base64," in shown
    # Also without fields, and where a later run has taken the folder.
    bare = bar(tmp_path / "bare", fields=[])
    assert "<img" not in bare._repr_html_() and "converged" in bare._repr_html_()
    first = bar(tmp_path / "taken", picture=pd.Picture(pd.displacement, "x"))
    assert "<img" in first._repr_html_()
    bar(tmp_path / "taken", steps=1, picture=pd.Picture(pd.displacement, "x"))
    assert "<img" not in first._repr_html_()


# How a run goes on.


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


def test_the_pace_tells_what_a_step_takes_and_when_the_run_ends():
    clock = Clock()
    pace = Pace(clock)
    assert np.isnan(pace.per_step) and np.isnan(pace.left)
    clock.now += 50.0  # set-up is no step
    pace.begin()
    for step in range(1, 4):
        clock.now += 2.0
        pace.step(0.1 * step)
    assert (pace.steps, pace.per_step) == (3, pytest.approx(2.0)) and pace.left == pytest.approx(14.0)
    clock.now += 5.0
    assert pace.since == pytest.approx(5.0) and pace.left == pytest.approx(9.0)
    assert pace.words().startswith("step 3, t = 0.3, 2 s a step, ends in 9 s (")
    # Where the run is quicker now than before, the last steps count.
    pace = Pace(clock)
    pace.begin(0.5, 10)
    clock.now += 100.0
    pace.step(0.5001)
    for step in range(20):
        clock.now += 1.0
        pace.step(0.51 + 0.01 * step)
    assert pace.steps == 31 and pace.per_step == pytest.approx(1.0) and pace.left == pytest.approx(30.0)
    # A load that is sought may fall.
    pace.step(0.3)
    assert np.isnan(pace.left) and "ends in" not in pace.words()


@pytest.mark.long
def test_a_line_at_the_bottom_of_a_terminal_tells_how_the_run_goes_on(tmp_path):
    new(tmp_path / "bar.py")
    words = [sys.executable, "-m", "pdpetsc", "bar.py", "dx=0.5", "-o", "out"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "100"}
    here, there = pty.openpty()
    process = subprocess.Popen(words, cwd=tmp_path, env=environment, stdout=there, stderr=there)
    os.close(there)
    said = b""
    with contextlib.suppress(OSError):  # the end of a terminal is an error
        while part := os.read(here, 4096):
            said += part
    os.close(here)
    assert process.wait(timeout=TIMEOUT) == 0
    assert "a step, " in said.decode() and "MiB" in said.decode()
    # What is no terminal has the lines alone.
    plain = called(tmp_path / "bar.py", "dx=0.5", "-o", tmp_path / "piped").stdout
    assert "assembled matrix of" in plain and "a step, " not in plain and "\x1b" not in plain
    # So has one behind mpirun, which gives every rank a terminal of its own.
    plain = run(tmp_path / "bar.py", "dx=0.5", output=tmp_path / "two", ranks=2).stdout
    assert "step    1" in plain and "a step, " not in plain and "\x1b" not in plain


def test_a_log_tells_from_time_to_time_how_the_run_goes_on(monkeypatch, caplog):
    monkeypatch.setattr(progress, "EVERY", 0.0)
    with caplog.at_level("INFO", "pdpetsc"), progress.LogReport(world()) as report:
        report.begin(0.0, 0)
        report.step(0.5, "one")
        report.step(1.0, "two")
    lines = [record.message for record in caplog.records]
    assert [line.split(",")[0] for line in lines] == ["one", "step 1", "two", "step 2"]
