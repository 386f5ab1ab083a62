"""Help: one short page for each command, and everything on a second one."""

import argparse
import re

import pytest

from jaxmorph.cli import main
from jaxmorph.cli._arguments import parser

COMMANDS = ("deform", "modes", "sensitivity", "quality", "info", "demo")


@pytest.fixture
def said(capsys, monkeypatch):
    """What a call prints on standard output, at 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("NO_COLOR", "1")

    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 0
        text, errors = capsys.readouterr()
        assert errors == ""
        assert max(map(len, text.split("\n"))) <= 80
        return text

    return call


def flags_of(command):
    """The long flags of a command, as its parser knows them."""
    commands = next(each for each in parser()._actions if isinstance(each, argparse._SubParsersAction)).choices
    return {flag for action in commands[command]._actions for flag in action.option_strings if flag.startswith("--")}


def described(text):
    """The long flags that have a line of their own."""
    return set(re.findall(r"^  (?:-\w(?: \w+)?, )?(--[\w-]+)", text, flags=re.MULTILINE))


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_is_one_short_page_with_examples(said, command):
    text = said(*command.split(), "--help")
    assert len(text.splitlines()) <= 50
    assert re.search(rf"^examples?:\n(.*\n)? +jaxmorph {command}", text, flags=re.MULTILINE)
    assert all(name in text for name in COMMANDS) or command


@pytest.mark.parametrize("command", COMMANDS)
def test_every_flag_is_described(said, command):
    flags = flags_of(command)
    short = described(said(command, "--help"))
    if "--help-all" in flags:
        assert {"--moving", "--fixed", "--help-all"} <= short < flags
        assert f"jaxmorph {command} --help-all" in said(command, "-h")
        short = described(said(command, "--help-all"))
    assert short == flags
