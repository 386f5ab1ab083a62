"""Help: one short page for each command, and everything on a second one."""

import os
import re
import subprocess
import sys

import pytest

from jaxmorph.cli import main
from jaxmorph.cli._entry import parser

MEASURES = ("aspect-ratio", "non-orthogonality", "skewness", "face-skewness", "face-aspect-ratio")
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
    return set(parser()[1][command].flags)


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


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("jaxmorph de", {"deform", "demo"}),
        ("jaxmorph deform a.su2 b.su2 --ma", {f"--max-{name}" for name in MEASURES}),
        ("jaxmorph deform a.su2 b.su2 --method p", {"published"}),
        ("jaxmorph deform a.su2 b.su2 --moving w", {"wall", "wake"}),
        ("jaxmorph deform a.su2 b.su2 --rotate 3 --moving wall --fixed ", {"wall", "wake", "far"}),
        ("jaxmorph deform none.su2 b.su2 --moving ", set()),
        ("jaxmorph demo ", {"naca0015", "-h", "--help", "-o", "--output"}),
    ],
)
def test_a_shell_completes(tmp_path, line, expected):
    """As bash asks through argcomplete: the words come back on descriptor 8."""
    tags = "MARKER_TAG= wall\n% MARKER_TAG= old\n MARKERTAG =wake % behind\nMARKER_TAG= far\n"
    (tmp_path / "a.su2").write_text(f"NDIME= 2\n{tags}")
    code = "import os, sys; from jaxmorph.cli import main; os.dup2(1, 8); sys.argv = ['jaxmorph']; main()"
    asked = {
        "_ARGCOMPLETE": "1",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "_ARGCOMPLETE_IFS": "\n",
    }
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | asked,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert {word.strip() for word in done.stdout.split("\n") if word.strip()} == expected
