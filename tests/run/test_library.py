"""Use from Python: results, runs opened again, problems driven by hand, groups of ranks, options, logging."""

import logging
import textwrap

import numpy as np
import pytest

import pdpetsc as pd
from tests.commands import ROOT, Stop, python_on, script_on, summary

LENGTH, WIDTH, PULL, E = 4.0, 1.0, 5.0, 1000.0


def bar(dx=0.25, pull=PULL, **changes):
    left, right = pd.region.Slab("x", high=dx), pd.region.Slab("x", low=LENGTH - dx)
    parts = {
        "particles": pd.Lattice((0.0, 0.0), (LENGTH, WIDTH), dx),
        "horizon": 2.015 * dx,
        "material": pd.LinearElastic(E=E, nu=0.0),
        "conditions": [
            pd.Displacement(left, x=0.0, y=0.0),
            pd.Traction(right, x=pull, normal=(1.0, 0.0), distribution="consistent"),
        ],
        "steps": pd.Steps(2),
        "history": {"u": pd.Mean(pd.displacement, "x", right), "energy": pd.StrainEnergy()},
        "results": lambda h: {"u": h["u"][-1]},
    }
    return pd.Case(**{**parts, **changes})


def test_a_result_has_names_history_fields_and_the_last_solution(tmp_path):
    result = pd.run(bar(), output=tmp_path)
    assert set(result) == {"u"}
    # The held layer is half a spacing deep where the bar begins to stretch.
    assert result["u"] == pytest.approx(PULL / E * LENGTH, rel=0.1)
    assert result.history["t"].tolist() == [0.0, 0.5, 1.0]
    assert result.history["u"][-1] == result["u"]
    assert result.summary["status"] == "converged"
    assert result.solution.t == 1.0
    stored, gathered = result.field("displacement"), result.gathered(pd.displacement)
    assert stored.shape == (64, 3)
    np.testing.assert_array_equal(stored[:, :2], gathered)
    assert result.field("stress", step=1).shape == (64, 3, 3)
    assert result.gathered(pd.energy_density).shape == (64,)
    with pytest.raises(KeyError, match=r"The run has no result 'v'; it has u\."):
        result["v"]
    with pytest.raises(KeyError, match=r"The history has no 'enrgy'; did you mean energy\?"):
        result.history["enrgy"]
    with pytest.raises(pd.RunError, match=r"KeyError: .The history has no 'enrgy'; did you mean energy\?"):
        pd.run(bar(results=lambda h: {"e": h["enrgy"][-1]}), output=tmp_path / "misspelt")


def test_a_finished_folder_gives_the_same(tmp_path):
    result = pd.run(bar(), output=tmp_path)
    opened = pd.open(tmp_path)
    assert dict(opened) == dict(result)
    assert opened.history.keys() == result.history.keys()
    for name, column in result.history.items():
        np.testing.assert_array_equal(opened.history[name], column)
    assert opened.summary == result.summary
    np.testing.assert_array_equal(opened.field("stress"), result.field("stress"))
    assert opened.fields.steps == [0, 1, 2]
    assert opened.solution is None
    with pytest.raises(pd.CaseError, match=r"Use field\(name\)"):
        opened.gathered(pd.displacement)
    with pytest.raises(pd.CaseError, match="no field 'strain'; it has displacement, stress"):
        opened.field("strain")
    with pytest.raises(pd.CaseError, match="no fields of step 7"):
        opened.field("stress", step=7)


def test_a_run_that_failed_can_be_opened(tmp_path):
    with pytest.raises(pd.Interrupted):
        pd.run(bar(steps=pd.Steps(4), history={"stop": Stop(0.6)}, results=None), output=tmp_path)
    opened = pd.open(tmp_path)
    assert opened.summary["error"] == "Interrupted"
    assert dict(opened) == {}
    assert opened.history["t"].tolist() == [0.0, 0.25, 0.5]


@pytest.mark.parametrize("text", [None, "not json", "[1]"])
def test_a_folder_without_a_run_is_refused(text, tmp_path):
    if text is not None:
        (tmp_path / "summary.json").write_text(text)
    with pytest.raises(pd.CaseError, match=r"summary\.json"):
        pd.open(tmp_path)


def test_a_prepared_problem_can_be_driven_by_hand(tmp_path):
    prepared = pd.prepare(bar())
    problem = prepared.problem
    # A uniform stretch has the energy of the continuum, and the forces of its stress at the ends only.
    u = np.zeros((64, 2))
    u[:, 0] = 1e-3 * prepared.cloud.x[:64, 0]
    solution = prepared.solution(u)
    assert solution.energies["strain"] == pytest.approx(0.5 * E * 1e-6 * LENGTH * WIDTH, rel=1e-10)
    force = problem.internal_force(problem.state(u))
    assert np.abs(force.sum(axis=0)).max() < 1e-10
    solver = prepared.make_solver()
    found = [converged.t for converged in prepared.march(solver)]
    solver.destroy()
    assert found == [0.5, 1.0]
    # Driving it by hand ends where a run of the same case does.
    result = pd.run(bar(), output=tmp_path)
    solver = prepared.make_solver()
    *_, last = prepared.march(solver)
    solver.destroy()
    np.testing.assert_allclose(last.u, result.solution.unknowns, atol=1e-14)


def snes_rtol(solver):
    return solver.snes.getTolerances()[0]


def test_two_problems_do_not_see_the_options_of_each_other():
    from petsc4py import PETSc

    before = PETSc.Options().getAll()
    strict = pd.prepare(bar(), options={"snes_rtol": 1e-11, "snes_max_it": 7})
    loose = pd.prepare(bar(), options={"snes_rtol": 1e-4})
    plain = pd.prepare(bar())
    solvers = [prepared.make_solver() for prepared in (strict, loose, plain)]
    assert [snes_rtol(solver) for solver in solvers[:2]] == [1e-11, 1e-4]
    assert snes_rtol(solvers[2]) not in (1e-11, 1e-4)
    assert solvers[0].snes.max_it == 7
    assert solvers[1].snes.max_it == solvers[2].snes.max_it != 7
    # In turns, as two marches side by side go on.
    marches = [prepared.march(solver) for prepared, solver in zip((strict, loose, plain), solvers, strict=True)]
    for steps in zip(*marches, strict=True):
        assert len({step.t for step in steps}) == 1
        assert PETSc.Options().getAll() == before
    for solver in solvers:
        solver.destroy()


class RunsAnother(pd.Quantity):
    """A quantity that runs a case of its own inside the run it belongs to."""

    def __init__(self, folder):
        self.folder = folder

    def evaluate(self, solution):
        inner = pd.run(bar(), output=self.folder)
        return float(inner.summary["options"].get("snes_rtol", {}).get("value", 0.0))


def test_a_run_inside_another_does_not_see_its_options(tmp_path):
    history = {"inner": RunsAnother(tmp_path / "inner")}
    outer = pd.run(bar(history=history, results=None), tmp_path / "outer", options={"snes_rtol": 1e-11})
    assert outer.summary["options"]["snes_rtol"] == {"value": "1e-11", "from": "case"}
    assert 1e-11 not in outer.history["inner"]
    assert outer.summary["unused_options"] == []


def test_an_option_that_nothing_used_is_named_in_each_run(tmp_path, caplog):
    for name in ("a", "b"):
        result = pd.run(bar(), tmp_path / name, options={"no_such_thing": 3, "pd_jacobian": "assembled"})
        assert result.summary["unused_options"] == ["no_such_thing"]
    assert (
        sum(
            "No solver used the option -no_such_thing. Check the spelling, or remove it." in record.message
            for record in caplog.records
        )
        == 2
    )


def test_a_library_run_logs_and_prints_nothing(tmp_path, caplog, capfd):
    with caplog.at_level(logging.INFO, logger="pdpetsc"):
        pd.run(bar(), output=tmp_path)
    said = [record.message for record in caplog.records if record.name == "pdpetsc"]
    assert said[0].startswith("64 particles in 2D")
    assert sum(text.startswith("step ") for text in said) == 2
    assert capfd.readouterr() == ("", "")


def test_something_else_than_a_communicator_is_refused(tmp_path):
    with pytest.raises(pd.CaseError, match="comm takes a communicator"):
        pd.prepare(bar(), comm=3)
    with pytest.raises(pd.CaseError, match="comm takes a communicator"):
        pd.run(bar(), tmp_path / "never", comm="world")
    assert not (tmp_path / "never").exists()


GROUPS = """
    import sys
    sys.path.insert(0, {root!r})
    import numpy as np
    from mpi4py import MPI
    from petsc4py import PETSc
    import pdpetsc as pd
    from tests.run.test_library import bar

    world = MPI.COMM_WORLD
    number = 2 * world.rank // world.size
    group = world.Split(number)
    # Groups do different things: other loads, other numbers of steps, one fails, one is given by petsc4py.
    pulls = [5.0, 7.0]
    result = pd.run(bar(pull=pulls[number], steps=pd.Steps(2 + number)), f"{folder}/group_{{number}}", comm=group)
    u = result.gathered(pd.displacement)
    if group.rank == 0:
        np.save(f"{folder}/group_{{number}}.npy", u)
    else:
        assert u is None
    if number == 1:
        try:
            pd.run(bar(horizon=1e-9), f"{folder}/wrong", comm=group)
        except pd.CaseError as error:
            assert "horizon" in str(error), error
        else:
            raise SystemExit("not refused")
        prepared = pd.prepare(bar(), comm=PETSc.Comm(group))
        assert prepared.comm.size == world.size // 2
    # Afterwards all of them together.
    result = pd.run(bar(pull=9.0), f"{folder}/all")
    u = result.gathered(pd.displacement)
    if world.rank == 0:
        np.save(f"{folder}/all.npy", u)
"""


@pytest.mark.parametrize("ranks", [2, pytest.param(4, marks=pytest.mark.long)])
def test_groups_of_ranks_run_side_by_side(ranks, tmp_path):
    script_on(ranks, textwrap.dedent(GROUPS).format(root=str(ROOT), folder=tmp_path))
    for name, pull in (("group_0", 5.0), ("group_1", 7.0), ("all", 9.0)):
        alone = pd.run(bar(pull=pull), tmp_path / "alone").gathered(pd.displacement)
        np.testing.assert_allclose(np.load(tmp_path / f"{name}.npy"), alone, atol=1e-12)
    assert len(pd.open(tmp_path / "group_1").history["t"]) == 4


def test_a_result_does_not_show_the_fields_of_a_later_run(tmp_path):
    first = pd.run(bar(), tmp_path)
    u = first.field("displacement").copy()
    second = pd.run(bar(pull=2.0 * PULL), tmp_path)
    with pytest.raises(pd.CaseError, match="fields of a later run"):
        first.field("displacement")
    np.testing.assert_allclose(second.field("displacement"), 2.0 * u, atol=1e-12)
    np.testing.assert_allclose(first.gathered(pd.displacement), u[:, :2], atol=1e-15)


def test_an_opened_run_does_not_show_the_fields_of_a_later_run(tmp_path):
    pd.run(bar(), tmp_path / "a")
    pd.run(bar(), tmp_path / "b")
    opened, both = pd.open(tmp_path / "a"), pd.compare([tmp_path / "b", tmp_path / "a"])
    assert np.all(both.difference("displacement")["a"] == 0.0)
    pd.run(bar(dx=0.125, steps=pd.Steps(3)), tmp_path / "a")
    for asked in (lambda: opened.x, lambda: opened.field("displacement"), lambda: both.difference("displacement")):
        with pytest.raises(pd.CaseError, match="fields of a later run"):
            asked()
    assert len(opened.history["t"]) == 3 and len(pd.open(tmp_path / "a").x) > len(pd.open(tmp_path / "b").x)
    # A run that goes on in its own folder is the same one.
    stopped = pd.open(tmp_path / "b")
    pd.run(bar(steps=pd.Steps(2)), tmp_path / "b", restart=tmp_path / "b")
    assert len(stopped.x) == len(stopped.field("displacement"))


def test_a_run_opened_without_fields_does_not_show_those_of_a_later_run(tmp_path):
    pd.run(bar(fields=[]), tmp_path)
    opened = pd.open(tmp_path)
    with pytest.raises(pd.CaseError, match="no such file"):
        opened.field("displacement")
    pd.run(bar(), tmp_path)
    with pytest.raises(pd.CaseError, match="had no fields when this run was opened"):
        opened.field("displacement")
    assert "<img" not in opened._repr_html_()
    assert len(pd.open(tmp_path).field("displacement")) == 64


@pytest.mark.parametrize("found", ['{"a": null}', "[1, 2]", '{"a": "x"}'])
def test_a_summary_with_damaged_results_is_refused(found, tmp_path):
    (tmp_path / "summary.json").write_text(f'{{"status": "converged", "results": {found}}}')
    with pytest.raises(pd.CaseError, match=r"results are not numbers|results is \[1, 2\]"):
        pd.open(tmp_path)


def test_an_option_for_the_end_of_petsc_is_not_that_of_a_run(tmp_path):
    """The options of a run have left PETSc when that ends, so nothing reads ``log_view``."""
    result = pd.run(bar(), tmp_path, options={"log_view": None})
    assert result.summary["unused_options"] == ["log_view"]


NESTED = """
    import sys
    sys.path.insert(0, {root!r})
    from mpi4py import MPI
    import pdpetsc as pd
    from tests.run.test_library import bar

    world = MPI.COMM_WORLD
    halves = world.Split(world.rank // {size})

    class Inner(pd.Quantity):
        # One group fails inside the run of all; its ranks agree with each other, not with the others.
        def evaluate(self, solution):
            if solution.t > 0.6 and world.rank // {size} == 1:
                pd.run(bar(horizon=1e-9), {folder!r} + "/inner", comm=halves)
            return 0.0

    pd.run(bar(history={{"inner": Inner()}}, results=None), {folder!r} + "/outer")
"""


@pytest.mark.long
@pytest.mark.parametrize("size", [1, 2])
def test_a_group_that_fails_inside_the_run_of_all_ends_that(size, tmp_path):
    script = tmp_path / "nested.py"
    script.write_text(textwrap.dedent(NESTED).format(root=str(ROOT), folder=str(tmp_path), size=size))
    finished = python_on(2 * size, script)
    assert finished.returncode != 0
    assert "horizon" in finished.stderr
    assert summary(tmp_path / "outer")["status"] != "running"
