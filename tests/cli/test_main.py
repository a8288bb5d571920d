"""The command line finds its verbs, explains them, and turns errors into one line."""

import importlib
import inspect

from cli import main as command_line
from machine.errors import UsageError


def test_without_a_verb_the_overview_names_every_verb(capsys):
    assert command_line.main([]) == 0
    out = capsys.readouterr().out
    assert all(verb in out for verb in command_line.VERBS)


def test_an_unknown_verb_is_named_and_the_overview_follows(capsys):
    assert command_line.main(["trow"]) == 1
    err = capsys.readouterr().err
    assert "no verb 'trow'" in err
    assert "throw" in err


def test_every_verb_has_a_documented_function_with_typed_arguments():
    wrong = []
    for name, verb in command_line.VERBS.items():
        module = importlib.import_module(verb.module)
        actions = getattr(module, "ACTIONS", None) or {"run": module.run}
        for action in actions.values():
            arguments = inspect.signature(action).parameters.values()
            is_typed = all(a.annotation is not inspect.Parameter.empty for a in arguments)
            if len(inspect.getdoc(action) or "") <= 30 or not is_typed:
                wrong.append(f"{name} {action.__name__}")
    assert wrong == []


def test_an_error_of_ours_is_one_line_and_exit_code_one(monkeypatch, capsys):
    def run() -> None:
        """Fail."""
        raise UsageError("valve 3 is shut; open it")

    monkeypatch.setattr(importlib.import_module("cli.spec"), "run", run)
    assert command_line.main(["spec"]) == 1
    assert capsys.readouterr().err == "downrange spec: valve 3 is shut; open it\n"


def test_a_missing_package_says_how_to_get_it(monkeypatch, capsys):
    def absent(name: str) -> None:
        raise ModuleNotFoundError("No module named 'jax'", name="jax")

    monkeypatch.setattr(command_line.importlib, "import_module", absent)
    assert command_line.main(["train", "--help"]) == 1
    assert "'jax' is not installed" in capsys.readouterr().err
