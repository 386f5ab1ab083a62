"""The parser of one command: its errors, and its two pages of help."""

import argparse
import re
import sys
from collections.abc import Sequence


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with the arguments, and takes -1e-3 for a number.

    Where `everyday` names arguments, `--help` tells of these alone and ends with `short_epilog`, and `--help-all` of everything.
    """

    def __init__(self, *, everyday: Sequence[str] = (), short_epilog: str = "", **settings):
        super().__init__(**settings, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
        self._negative_number_matcher = re.compile(r"-\.?\d")
        self._everyday, self._short_epilog = (*everyday, "help", "help_all"), short_epilog
        if everyday:
            self.add_argument("--help-all", action=HelpAll, nargs=0, help="show all flags and more examples")

    def error(self, message):
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")

    def print_help(self, file=None):
        """What `--help` shows."""
        self._print_message(self.format_short() if self._short_epilog else self.format_help(), file or sys.stdout)

    def format_short(self) -> str:
        """The page of help with the everyday flags."""
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        for group in self._action_groups:
            formatter.start_section(group.title)
            formatter.add_arguments([action for action in group._group_actions if action.dest in self._everyday])
            formatter.end_section()
        formatter.add_text(self._short_epilog)
        return formatter.format_help()


class HelpAll(argparse.Action):
    """Prints all there is to tell, and ends."""

    def __init__(self, option_strings, dest, **settings):
        super().__init__(option_strings, dest, default=argparse.SUPPRESS, **settings)

    def __call__(self, parser, namespace, values, option_string=None):
        parser._print_message(parser.format_help(), sys.stdout)
        parser.exit()
