"""What a case expects is compared where the run is asked to, and a run that is off does not end with status 0."""

import math

import pytest

import pdpetsc as pd
from pdpetsc.running.checks import compared, failure, lines
from tests.commands import called, run, summary

STRIP = """
import pdpetsc as pd


def case(unit=1.0, force_unit=1.0, off=1.0, name="force", expects=True, gives="force"):
    # A strip whose ends are held in two layers and moved apart: uniform strain, so E A times it.
    E, strain, dx = 1e3 * force_unit / unit**2, 0.01, unit
    left, right = pd.region.Slab("x", high=2.0 * dx), pd.region.Slab("x", low=10.0 * unit - 2.0 * dx)
    affine = {"x": lambda x, t: t * strain * x[:, 0]}
    expect = {name: pd.Expected(off * E * strain * 4.0 * unit, relative=1e-6, source="E A times the strain")}
    values = {"force": lambda h: h["force"][-1], "nan": lambda h: float("nan")}
    return pd.Case(
        particles=pd.Lattice((0.0, 0.0), (10.0 * unit, 4.0 * unit), dx),
        horizon=1.515 * dx,
        material=pd.LinearElastic(E=E, nu=0.0, plane="stress"),
        conditions=[
            pd.Displacement(left, **affine),
            pd.Displacement(right, **affine),
            pd.Displacement(pd.region.Nearest((0.0, 0.0)), y=0.0),
        ],
        history={"force": pd.Reaction("x", right)},
        results=lambda h: {"force": values[gives](h)},
        expect=expect if expects else {},
        fields=[],
        checkpoints=0,
    )
"""


@pytest.fixture
def strip(tmp_path):
    path = tmp_path / "strip.py"
    path.write_text(STRIP)
    return path


@pytest.fixture
def made():
    namespace = {}
    exec(STRIP, namespace)
    return namespace["case"]


@pytest.mark.parametrize(("unit", "force_unit"), [(1.0, 1.0), (1e-20, 1e20), (1e20, 1e-20)])
def test_a_result_that_is_right_passes_in_any_unit_and_a_wrong_one_in_none(made, unit, force_unit, tmp_path):
    found = pd.run(made(unit, force_unit), tmp_path, check=True)
    assert [check.name for check in found.check()] == ["force"]
    with pytest.raises(pd.CheckError, match=r"1 of 1 checks failed: force is .* is expected within .*E A times"):
        pd.run(made(unit, force_unit, off=1.0 + 1e-5), tmp_path, check=True)


def test_what_was_checked_is_on_record_and_a_second_run_in_the_folder_has_its_own(made, tmp_path):
    with pytest.raises(pd.CheckError):
        pd.run(made(off=2.0), tmp_path, check=True)
    found = summary(tmp_path)
    assert found["status"] == "converged"
    (check,) = found["checks"]
    assert (check["result"], check["ok"], check["value"]) == ("force", False, pytest.approx(800.0 / 10.0))
    assert check["difference"] == pytest.approx(-40.0)
    with pytest.raises(pd.CheckError, match="force is"):
        pd.open(tmp_path).check()
    pd.run(made(), tmp_path, check=True)
    assert [check["ok"] for check in summary(tmp_path)["checks"]] == [True]
    assert pd.open(tmp_path).check()[0].ok
    pd.run(made(off=2.0), tmp_path)
    assert "checks" not in summary(tmp_path)
    with pytest.raises(pd.CaseError, match="has no `expect` with these parameters"):
        pd.open(tmp_path).check()


def test_without_being_asked_nothing_is_compared_but_the_result_can_be(made, tmp_path):
    found = pd.run(made(off=2.0), tmp_path)
    with pytest.raises(pd.CheckError, match="1 of 1 checks failed"):
        found.check()


def test_a_result_that_is_nan_or_missing_fails(made, tmp_path):
    with pytest.raises(pd.RunError, match="finite numbers; 'force' is nan"):
        pd.run(made(gives="nan"), tmp_path, check=True)
    with pytest.raises(pd.CheckError, match=r"there is no result forces .did you mean force"):
        pd.run(made(name="forces"), tmp_path, check=True)
    expect = {"tip": pd.Expected(1.0, absolute=10.0, source="nothing")}
    for results in ({"tip": math.nan}, {"tip": math.inf}, {}):
        assert failure(compared(expect, results)) is not None
    assert "FAILED" in lines(compared(expect, {}))[1]


def test_where_nothing_is_expected_a_check_is_refused_before_the_run(made, tmp_path):
    with pytest.raises(pd.CaseError, match="has no `expect` with these parameters"):
        pd.run(made(expects=False), tmp_path / "out", check=True)
    assert not (tmp_path / "out" / "summary.json").exists()
    with pytest.raises(pd.CaseError, match="names the result 'force', and the case has no `results`"):
        pd.Case(
            particles=pd.Lattice((0.0,), (4.0,), 1.0), horizon=1.5, material=pd.Hencky(1.0, nu=0.0), conditions=[],
            expect={"force": pd.Expected(1.0, relative=0.1, source="nothing")},
        )  # fmt: skip


def test_a_run_goes_on_whatever_its_case_expects_by_now(made, tmp_path):
    from dataclasses import replace

    pd.run(replace(made(), checkpoints=1), tmp_path / "first")
    pd.run(replace(made(off=2.0), checkpoints=1), tmp_path / "second", restart=tmp_path / "first")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "one tolerance"),
        ({"relative": 0.1, "absolute": 0.1}, "one tolerance"),
        ({"relative": 1.0}, "between 0 and 1"),
        ({"relative": 0.0}, "between 0 and 1"),
        ({"relative": math.nan}, "a number"),
        ({"absolute": math.inf}, ">= 0 or None as absolute, not inf"),
        ({"absolute": -1.0}, ">= 0"),
        ({"relative": 0.1, "source": " "}, "source"),
        ({"relative": 0.1, "source": "two\nlines"}, "source"),
        ({"value": 0.0, "relative": 0.1}, "has no relative tolerance"),
        ({"value": math.inf, "relative": 0.1}, "finite"),
        ({"value": math.nan, "relative": 0.1}, "a finite number"),
    ],
)
def test_an_expectation_that_cannot_hold_or_cannot_fail_is_refused(words, message):
    with pytest.raises(pd.CaseError, match=message):
        pd.Expected(**({"value": 1.0, "source": "here"} | words))


def test_an_expectation_of_exactly_a_number_holds_for_it_alone():
    exactly = pd.Expected(2.0, absolute=0.0, source="two pieces")
    assert exactly.holds(2.0)
    assert not exactly.holds(2.0 + 1e-12)


@pytest.mark.parametrize(
    ("ranks", "words", "status", "said"),
    [
        (1, (), 0, ""),
        (2, ("off=2.0",), 1, "pdpetsc: 1 of 1 checks failed: force is 40"),
        (2, ("expects=false",), 2, "pdpetsc: The case has no `expect`"),
    ],
)
def test_the_command_line_ends_with_the_status_of_the_checks(strip, ranks, words, status, said, tmp_path):
    start = run if ranks == 1 else called
    finished = start(strip, *words, "--check", "-o", tmp_path / "out", ranks=ranks)
    assert finished.returncode == status, finished.stderr
    sentences = [line for line in finished.stderr.splitlines() if line.startswith("pdpetsc:")]
    assert len(sentences) == bool(said)
    assert all(sentence.startswith(said) for sentence in sentences)
    table = [line.split() for line in finished.stdout.splitlines() if line.strip().startswith("force  ")]
    assert [row[5] for row in table] == {0: ["ok"], 1: ["FAILED"], 2: []}[status]
