"""An analysis notebook of one's own: written once, run as it is, and with a model that is wrong."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from types import SimpleNamespace

import control
import IPython
import matplotlib.pyplot as plt
import numpy as np
import pytest
import sympy
from IPython.core.interactiveshell import InteractiveShell
from traitlets.config import Config

import statebook as sb
from statebook.__main__ import main
from statebook.analysis.new import new_notebook
from statebook.analysis.units import parsed


@pytest.fixture
def notebook(tmp_path, monkeypatch, capsys):
    """The template's code cells, and what runs them in order: what each printed, and names."""
    config = Config({"HistoryManager": {"enabled": False}})
    shell = InteractiveShell(config=config)
    monkeypatch.setattr(IPython, "get_ipython", lambda: shell)
    monkeypatch.setattr(plt, "show", lambda: plt.close("all"))
    monkeypatch.setattr(plt, "install_repl_displayhook", lambda: None)  # it would outlive the shell
    path = new_notebook("magnet", tmp_path)
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    sources = ["".join(c["source"]) for c in cells if c["cell_type"] == "code"]

    def run(model):
        capsys.readouterr()
        said = []
        for source in [sources[0], model, *sources[2:]]:
            assert shell.run_cell(source).success
            said.append(re.sub(r"Out\[\d+\]: ", "", capsys.readouterr().out))
        return said, shell.user_ns

    return SimpleNamespace(model=sources[1], run=run)


def test_the_template_analyses_its_magnet(notebook):
    said, names = notebook.run(notebook.model)
    # gap'' = -c (i / gap)^2 / m falls with 2 g / gap: s^2 = 2 * 9.81 / 0.01; the coil has R / L.
    fall = np.sqrt(2 * 9.81 / 0.01)
    assert names["verdict"].eigenvalues == pytest.approx([fall, -fall, -3.0 / 0.06])
    assert names["rest"].u == pytest.approx([3.0 * 0.01 * np.sqrt(9.81 * 0.05 / 5e-5)])
    assert names["margins"]["voltage"].stable
    assert not any("failed" in text or "waits" in text for text in said)
    plant, K = names["verdict"].linearization, names["controller"].K
    for factor, stable in ((0.99, True), (1.01, False)):
        held = sb.discretize(plant, factor * names["slowest_clock"])
        assert (np.abs(np.linalg.eigvals(held.A - held.B @ K)).max() < 1) == stable
    assert said[-1].strip() == "All checks hold (0)."


WRONG = {
    "a name": ("return [speed", "return [sped", "line 4: .*NameError: name 'sped'"),
    "no Python": ("current = x", "current = = x", "line 2: SyntaxError"),
    "too few rates": ("return [speed, ", "return [", r"one rate for each of the 3 states.*\(2,\)"),
    "nothing returned": ("    return [", "    [", r"one rate for each .* got shape \(\)"),
    "too few states": ("gap, speed, current = x", "gap, current = x", "too many values to unpack"),
    "no module": ("def f(", "import nonesuch\ndef f(", "No module named 'nonesuch'"),
    "millimetres": ('"gap": "m"', '"gap": "mm"', "gap' must be 1000 speed, and f says 1 speed"),
    "no rate": ('"speed": "m/s"', '"speed": "m"', "units are mixed up"),
    "a guess in mm": ('"gap": 0.01', '"gap": 10.0', "within its limits 0.004 to 0.016.*unit"),
    "a limit in kV": ("(0, 6)", "(0, 0.006)", "voltage must lie within its limits"),
    "a label": ('hold=["gap"]', 'hold=["gp"]', "'gp'"),
    "a parameter": ('"mass": 0.1', '"weight": 0.1', "one of mass, strength, resistance"),
    "a memory": ("    gap, sp", "    x[0] += 1\n    gap, sp", "leave its arguments alone"),
    "infinite": ('"gap": 0.01, ', "", "finite"),
}


@pytest.mark.parametrize("kind", WRONG)
@pytest.mark.filterwarnings("ignore:(divide by zero|invalid value):RuntimeWarning")
def test_a_wrong_model_says_so_in_its_cell_and_the_rest_waits(notebook, kind):
    old, new, words = WRONG[kind]
    assert old in notebook.model
    said, _ = notebook.run(notebook.model.replace(old, new, 1))
    assert len(said[1].splitlines()) == 1
    assert re.search(words, said[1])
    assert said[2] == "rest waits for model.\n"
    assert all("waits for model." in text for text in said[3:-1] if text)


def test_a_model_without_equilibrium_is_said_where_it_is_looked_for(notebook):
    said, names = notebook.run(notebook.model.replace("9.81 - pull", "9.81 + pull"))
    assert "it runs at the guess" in repr(names["model"])
    assert said[2].startswith("rest failed: no equilibrium found from x_guess")
    assert "waits for rest." in "".join(said[3:])


def test_a_wrong_model_does_not_leave_the_one_before(notebook):
    notebook.run("model = 3")
    said, _ = notebook.run("model = nonsense")
    assert "NameError" in said[1] and said[2] == "rest waits for model.\n"


def test_other_cells_fail_as_ever(notebook):
    notebook.run("model = 3")
    shell = IPython.get_ipython()
    assert not shell.run_cell("1 / 0").success


def test_an_operating_point_beyond_its_limits_is_said(notebook):
    said, _ = notebook.run(notebook.model.replace('"current": (0, 3)', '"current": (0.995, 3)'))
    assert "NOT within 0.995 to 3" in said[3]
    assert "current must rest within its limits" in said[5] + said[7]


# What a model may be


def rates(t, x, u, params):
    return [x[1], (u[0] - params["k"] * x[0]) / params["m"]]


def test_a_control_system_keeps_its_labels_and_parameters():
    plant = control.nlsys(
        rates, states=["place", "speed"], inputs=["force"], params={"k": 4.0, "m": 1.0}
    )
    model = sb.own_model(plant, states={"place": "m", "speed": "m/s"}, uncertain={"k": 0.2})
    assert model.system.states == ("place", "speed") and model.hold == ("force",)
    assert model.uncertain == {"k": (4.0, 0.2)}
    assert model.at(k=9.0).dynamics([1.0, 0.0], [0.0]).tolist() == [0.0, -9.0]


def test_a_library_model_has_its_parameters_as_fields():
    model = sb.own_model(sb.CartPole(), guess={"theta": 1.5}, uncertain={"m_pole": 0.1})
    assert model.uncertain["m_pole"] == (sb.CartPole().m_pole, 0.1)
    assert model.at(m_pole=0.5).source.m_pole == 0.5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"states": {"a": "rad", "b": "rad/s"}, "guess": {"a": 90.0}},
            r"14.3 turns.*np.radians\(90\)",
        ),
        ({"states": {"a": "deg", "b": "rad/s"}}, "a' must be 57.2958 b"),
        ({"states": {"a": "rad", "b": "rpm"}}, "a' must be 0.10472 b"),
        ({"states": {"a": "m", "b": "rad/s"}}, "not those of a quantity and its rate"),
        ({"states": {"a": "m"}}, "f does not run at the guess"),
        ({}, "states must name the states"),
        ({"states": {"a": "", "b": ""}, "limits": {"a": (1.0, -1.0)}}, r"must be \(low, high\)"),
        ({"states": {"a": "", "b": ""}, "sample_time": 0.0}, "sample_time must be greater than 0"),
    ],
)
def test_what_is_odd_about_a_model_is_said(options, words):
    with pytest.raises(ValueError, match=words):
        sb.own_model(lambda x: [x[1], -x[0]], **options)


def test_a_function_of_a_single_number_is_told_how_to_be_called():
    with pytest.raises(ValueError, match=r"give lambda x, u: f\(x, u\[0\]\)"):
        sb.own_model(lambda x, u: np.array([x[1], u]), states=["a", "b"], inputs=["u"])


def test_symbols_instead_of_numbers_are_said():
    with pytest.raises(ValueError, match=r"objects of the types Float.* from numpy"):
        sb.own_model(
            lambda x: np.array([x[1], -sympy.sin(x[0])]), states=["a", "b"], guess={"a": 1}
        )


@pytest.mark.parametrize("units", [("m", "m/s"), ("mm", "mm/s"), ("furlong", "m/s"), ("", "")])
def test_units_that_agree_or_are_not_known_pass(units):
    a, b = units
    model = sb.own_model(lambda x: [x[1], -x[0]], states={"a": a, "b": b}, guess={"a": 0.1})
    assert repr(model).endswith(f"a = 0.1 {a}".rstrip() + f", b = 0 {b}".rstrip())


def test_a_gear_is_no_slip_of_units():
    sb.own_model(lambda x: [0.2 * x[1], -x[0]], states={"load": "rad", "rate": "rad/s"})


def test_units_by_their_definitions():
    assert parsed("N m")[1] == parsed("J")[1] == parsed("kg m^2/s^2")[1]
    assert parsed("V")[1] == parsed("W/A")[1]
    assert parsed("km/h")[0] == pytest.approx(1 / 3.6)
    assert parsed("m") == (1.0, (1, 0, 0, 0, 0, 0)) and parsed("mm")[0] == 1e-3


@pytest.mark.parametrize(
    ("unit", "same", "factor"),
    [
        ("N", "kg m/s^2", 1),
        ("Pa", "N/m^2", 1),
        ("J", "N m", 1),
        ("W", "J/s", 1),
        ("C", "A s", 1),
        ("V", "J/C", 1),
        ("Hz", "1/s", 1),
        ("rpm", "rad/s", np.pi / 30),
        ("deg", "rad", np.pi / 180),
        ("L", "m^3", 1e-3),
        ("min", "s", 60),
        ("h", "min", 60),
        ("g", "kg", 1e-3),
        ("degC", "K", 1),
        ("kmol", "mol", 1e3),
    ],
)
def test_units_are_those_of_the_international_system(unit, same, factor):
    (size, dimension), (base, wanted) = parsed(unit), parsed(same)
    assert dimension == wanted and size == pytest.approx(factor * base, rel=1e-14)


# The command


def test_the_command_writes_once_and_never_over(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "quarter_car"]) == 0
    path = tmp_path / "analyses" / "quarter_car.ipynb"
    written = path.read_text(encoding="utf-8")
    assert "MODEL_NAME" not in written and "# quarter_car" in written
    path.write_text("mine")
    assert main(["new", "quarter_car.ipynb"]) == 1
    assert path.read_text() == "mine"
    assert "exists already and is left alone" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["", ".", "../x", "a/b", "a b", "-x", "con", "NUL", "é", "x" * 90])
def test_a_bad_name_is_one_sentence(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    assert main(["new", name]) == 1
    said = capsys.readouterr().err
    assert said.startswith("statebook: NAME must be letters") and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_command_without_a_name_shows_its_use(tmp_path):
    command = [sys.executable, "-m", "statebook"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2 and "new NAME" in done.stderr
