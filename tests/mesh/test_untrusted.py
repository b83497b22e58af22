"""Texts that others wrote: malformed ones end soon, in one sentence, whatever they hold."""

import json
import random
import time

import pytest
import sympy

import pdpetsc as pd
from pdpetsc.bounds import real_number, refuse_deep, text_in, whole_number
from pdpetsc.command_line.arguments import Arguments
from pdpetsc.command_line.import_deck import import_deck
from pdpetsc.decks.expressions import parse, parse_peridigm
from pdpetsc.declare import abaqus
from pdpetsc.material.energy import SYMBOLS
from pdpetsc.material.energy_loops import _tidy as tidy
from pdpetsc.studies.reference_curve import read_curve
from pdpetsc.studies.sets import read_sets
from tests.decks.test_import import PERIDIGM, PERILAB

# What one text may take on a busy machine [s]; texts that are not bounded take minutes, or for ever.
SOON = 20.0
PLATE = "header: x y block_id volume\n" + "".join(
    f"{x + 0.5} {y + 0.5} {1 + (x > 2)} 1.0\n" for x in range(6) for y in range(5)
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plate.txt").write_text(PLATE)
    (tmp_path / "right.txt").write_text("26 27 28 29 30\n")
    return tmp_path


def ends_in_a_sentence(function, *arguments, match=None, **keywords):
    """Call what must raise CaseError with one sentence, soon."""
    before = time.monotonic()
    with pytest.raises(pd.CaseError, match=match) as error:
        function(*arguments, **keywords)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 1000
    assert time.monotonic() - before < SOON


def deck(folder, text, name="deck.yaml"):
    (folder / name).write_text(text, encoding="utf-8", errors="surrogateescape")
    return folder / name


# --- decks

LEFT, VALUE = '"1 5 9 13 17 21 25 29 33"', '"0.02*x*t/5.0"'
PERIDIGM = PERIDIGM.replace("value = 0.02*x*t/5.0;", "0.02*x*t/5.0")
DOUBLED = "".join(f"  a{k}: &a{k} {{x: *a{k - 1}, y: *a{k - 1}}}\n" for k in range(1, 41))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ((VALUE, '"0.02*x*\u0662*t"'), "not understood"),
        ((VALUE, '"9^9^9^9*t"'), "no finite number"),
        ((VALUE, f'"{"9" * 5000}*t"'), "no finite number"),
        ((VALUE, f'"{"+".join(["t"] * 20000)}"'), "more than 400 words"),
        ((VALUE, f'"{"(" * 100}t{")" * 100}"'), "nested too deeply"),
        ((LEFT, '"\u00b2"'), "not numbers of particles"),
        ((LEFT, '"1\u0661"'), "not numbers of particles"),
        ((LEFT, f'"{"9" * 30}"'), "not numbers of particles"),
        (("Horizon: 1.8", "Horizon: 1_8"), "not a number"),
        (("Horizon: 1.8", "Horizon: \u0661"), "not a number"),
        (("Horizon: 1.8", "Horizon: 1e999"), "not a number"),
        (("Number of Load Steps: 2", "Number of Load Steps: 1000000000"), "1 to 10000"),
        (("Number of Load Steps: 2", 'Time Steps: "0 nan"'), "not times"),
        (("Number Points X: 4", "Number Points X: 1e300"), "ten million"),
        (("Verbose: false", f"Verbose: {'[' * 5000}{']' * 5000}"), "nested more than 50 deep"),
        (("Verbose: false", f"Verbose: {'{a: ' * 5000}1{'}' * 5000}"), "nested more than 50 deep"),
        (("Verbose: false", "Verbose: \x00"), "special characters"),
        (("Verbose: false", "Verbose: &a {b: *a}"), "an alias in line 2"),
        (("  Verbose: false\n", f"  a0: &a0 {{x: 1}}\n{DOUBLED}"), "an alias in line 3"),
        (("  Verbose: false\n", "".join(f"  a{k}: 1\n" for k in range(10_001))), "more than 10000 entries"),
        (("  Verbose: false\n", "#" * 600_000 + "\n"), "more than 500000 bytes"),
    ],
    ids=range(21),
)
def test_malformed_decks_of_peridigm_end_in_a_sentence(folder, change, match):
    assert change[0] in PERIDIGM
    ends_in_a_sentence(import_deck, deck(folder, PERIDIGM.replace(*change)), match=match)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (("Corner: 1", "Corner: 1:100000000"), "from 1 to 30"),
        (("Corner: 1", "Corner: 5:2"), "from 1 to 30"),
        (("Corner: 1", "Corner: 1\u00b2"), "not understood"),
        (("Corner: 1", "Corner: x < 9**9**9"), "no finite number"),
        (("Corner: 1", f"Corner: {'9' * 400}"), "no finite number|true or false"),
        (("Number of Steps: 4", "Number of Steps: 1e18"), "1 to 10000"),
    ],
    ids=range(6),
)
def test_malformed_decks_of_perilab_end_in_a_sentence(folder, change, match):
    assert change[0] in PERILAB
    ends_in_a_sentence(import_deck, deck(folder, PERILAB.replace(*change)), match=match)


def test_xml_is_bounded_as_yaml_is(folder):
    lists = '<ParameterList name="a">'
    ends_in_a_sentence(import_deck, deck(folder, lists * 5000 + "</ParameterList>" * 5000, "d.xml"), match="50 deep")
    many = "".join(f'<Parameter name="a{k}" value="1"/>' for k in range(10_001))
    ends_in_a_sentence(import_deck, deck(folder, f"{lists}{many}</ParameterList>", "d.xml"), match="10000 entries")
    bomb = '<!DOCTYPE a [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>' + lists + "</ParameterList>"
    ends_in_a_sentence(import_deck, deck(folder, bomb, "d.xml"), match="entities")


def test_numbers_of_decks_that_python_would_read_otherwise_are_read_as_written(folder):
    path, _ = import_deck(deck(folder, PERIDIGM.replace(VALUE, '"007*t + 00.5*t"')))
    assert "7 * t" in path.read_text().replace("time(t)", "t")
    assert parse("010", "a value", set()).value({}) == 10.0
    emoji = PERILAB.replace("Corner", "Ecke \U0001f600 \u00e4")
    assert "Ecke \U0001f600 \u00e4" in import_deck(deck(folder, emoji), folder / "b.py")[0].read_text()


# --- parameter sets, curves, clouds, meshes, command lines


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        ("a.json", "[" * 100_000, "nested more than 50"),
        ("a.json", json.dumps({"grids": {f"p{k}": list(range(10)) for k in range(12)}}), "more than 100000"),
        (
            "a.json",
            json.dumps({"samples": {"method": "sobol", "n": 2**40, "ranges": {"a": [0, 1]}}}),
            "more than 100000",
        ),
        (
            "a.json",
            '{"samples": {"method": "sobol", "n": 2, "ranges": {"a": [0, 1' + "0" * 400 + "]}}}",
            "a finite number as high",
        ),
        ("a.json", '{"samples": {"method": "sobol", "n": 2, "ranges": {"a": [-1.7e308, 1.7e308]}}}', "low < high"),
        ("a.json", '[{"a": ' + "9" * 10_000 + "}]", "is no JSON file"),
        ("a.json", '[{"a": NaN}', "is no JSON file"),
        ("a.toml", "sets = " + "[" * 100_000, "nested more than 50"),
        ("a.toml", "a = {" * 500, "nested more than 50"),
        ("a.csv", "a\n" + "1\n" * 100_001, "more than 100000"),
        ("a.csv", 'a\n"' + "1" * 200_000, "is no CSV file"),
        ("a.csv", "\u00b2\n1\n", "names of parameters"),
    ],
    ids=range(12),
)
def test_malformed_parameter_sets_end_in_a_sentence(folder, name, text, match):
    ends_in_a_sentence(read_sets, deck(folder, text, name), match=match)


def test_malformed_curves_clouds_and_numbers_end_in_a_sentence(folder):
    ends_in_a_sentence(read_curve, deck(folder, "u,F\n1,\u00b2\n", "c.csv"), ("u", "F"), match="must have a number")
    ends_in_a_sentence(read_curve, deck(folder, "u,F\n1,1e999\n", "c.csv"), ("u", "F"), match="finite")
    ends_in_a_sentence(pd.TextFile(deck(folder, "1 2 \u00b2 1\n", "x.txt")).chunk, 0, 1, match="not a table")
    many = "".join(f"{k} 0 {k} 1\n" for k in range(10_002))
    ends_in_a_sentence(pd.TextFile(deck(folder, many, "x.txt")).chunk, 0, 1, match="10002 different blocks")
    for members, match in (([10**400], "takes a file"), ("\u00b2.txt", "Cannot read")):
        ends_in_a_sentence(pd.TextFile(folder / "plate.txt", node_sets={"a": members}).chunk, 0, 1, match=match)
    for words in ("\u00b2", "9" * 5000, "-1", "0"):
        ends_in_a_sentence(Arguments(values={"--jobs": [words]}).count, "--jobs", match="positive number")
    ends_in_a_sentence(text_in, deck(folder, "a" * 11, "a.txt"), "table", 10, match="more than 10 bytes")
    ends_in_a_sentence(refuse_deep, "[" * 51, match="50 deep")
    refuse_deep("[]" * 1000 + '"' + "[" * 1000 + '"')
    assert [whole_number(text) for text in ("12", "\u00b2", "\u0661", "1_0", "-1", "", "9" * 19)] == [12] + 6 * [None]
    assert [real_number(text) for text in ("1.", "-.5e3", "nan", "1_0", "\u0661", "")] == [1.0, -500.0] + 4 * [None]


def test_sets_of_sets_and_files_of_files_do_not_double_without_end(folder):
    nodes = "*NODE\n1, 0, 0, 0\n*NSET, NSET=A0\n1\n"
    doubled = "".join(f"*NSET, NSET=A{k}\nA{k - 1}, A{k - 1}\n" for k in range(1, 41))
    ends_in_a_sentence(abaqus.read, deck(folder, nodes + doubled, "a.inp"), match="more than 10000000 members")
    itself = deck(folder, "*INCLUDE, INPUT=b.inp\n" * 50, "b.inp")
    assert abaqus.files(itself) == [itself]


# --- energies


def within(text, times, inner):
    for _ in range(times):
        inner = text.format(inner)
    return inner


@pytest.mark.parametrize(
    ("more", "match"),
    [
        (within("exp({})", 90, "I1"), "more than 3000 operations"),
        (within("exp({})", 6, "I1"), "no finite number at F = I"),
        (within("({0})**({0})", 4, "I1"), "no finite number at F = I"),
        (within("exp(c*{})", 6, "I1"), "no finite stress"),
        ("*".join(f"(I1 + {k}*J)" for k in range(100)), "more than 3000 operations"),
        ("+".join(f"I1**{k}" for k in range(500)), "more than 3000 operations"),
        ("9**9**9", "too large"),
        (f"{'9' * 3000}", "too many digits|cannot be read"),
    ],
    ids=range(8),
)
def test_energies_that_would_take_for_ever_end_in_a_sentence(more, match):
    constants = {"mu": 1.0} | ({"c": 9.0} if "c" in more else {})
    ends_in_a_sentence(pd.Hyperelastic, f"mu/2*(I1 - 3 - 2*log(J)) + {more}", match=match, **constants)


def test_products_of_sums_are_not_multiplied_out_without_end():
    I1, J = SYMBOLS["I1"], SYMBOLS["J"]
    few, many = (sympy.Mul(*(I1 + k * J for k in range(2, n))) for n in (4, 24))
    assert tidy(few) == few
    assert tidy(few - I1**2) == 5 * I1 * J + 6 * J**2
    # Two to the power of 22 terms.
    assert tidy(many - I1**22) == many - I1**22


# --- all of them, drawn at random

PIECES = [
    "1", "007", "\u00b2", "\u0661", "9**9**9", "1e999", "nan", "-", "*", "^", "(", ")", "[", "]", "{", "}", ":", ",",
    "\n", "  ", "&a", "*a", "if(t<1)", "else", "value", "=", ";", "x", "t", "\\", '"', "'", "#", "\x00", "\ufeff",
    "\U0001f600", "!!python/object:os.system", "<<", "|", "%", "- ", "? ", "1:100000000", "true", "All", "exp", "log",
    "I1", "mu", "$", "@",
]  # fmt: skip


def damaged(draw, text):
    """Return a text with some places cut out, doubled or replaced by other words."""
    for _ in range(draw.randint(1, 4)):
        at = draw.randrange(len(text) + 1)
        end = min(len(text), at + draw.choice([0, 1, 3, 10, 40]))
        piece = draw.choice(PIECES) * draw.choice([1, 1, 1, 2, 300])
        text = text[:at] + draw.choice([piece, "", text[at:end] * 2]) + text[end:]
    return text


@pytest.mark.parametrize("kind", ["peridigm", "perilab", "expression", "sets", "energy", "cloud"])
def test_damaged_texts_are_read_or_refused_in_a_sentence(folder, kind):
    draw = random.Random(f"malformed {kind}")
    sets = json.dumps({"grids": {"a": [1, 2]}, "samples": {"method": "sobol", "n": 4, "ranges": {"b": [0, 1]}}})
    texts = {
        "peridigm": (PERIDIGM, lambda text: import_deck(deck(folder, text), overwrite=True), 15),
        "perilab": (PERILAB, lambda text: import_deck(deck(folder, text), overwrite=True), 15),
        "expression": ("if(t <= 0.5){ value = 2*x^2; } else{ value = -sin(x*t)/7; }",
                       lambda text: parse_peridigm(text, "a value", set("xt")), 300),
        "sets": (sets, lambda text: read_sets(deck(folder, text, "a.json")), 100),
        "energy": ("mu/2*(I1 - 3 - 2*log(J)) + exp(I1 - 3)**2", lambda text: pd.Hyperelastic(text, mu=1.0), 40),
        "cloud": (PLATE, lambda text: pd.TextFile(deck(folder, text, "x.txt")).chunk(0, 1), 60),
    }  # fmt: skip
    text, read, times = texts[kind]
    refused = 0
    for _ in range(times):
        drawn = damaged(draw, text)
        before = time.monotonic()
        try:
            read(drawn)
        except pd.CaseError as error:
            refused += 1
            assert "\n" not in str(error), drawn
        assert time.monotonic() - before < SOON, drawn
    assert refused > 0.3 * times
