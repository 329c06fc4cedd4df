# SPDX-License-Identifier: MIT
"""How messages of the command line spell arguments: by its options.

An option has the name of the argument, with hyphens. Only exceptions are listed here. Worker
processes get the spelling too, so this module imports nothing heavy.
"""

from collections.abc import Sequence
from shlex import quote

from salsanext_cli.core.wording import Spelling

OPTION_OF = {
    "colours": "--colour",
    "ids": "--map",
    "knn": "--knn-…",
    "names": "--from",
    "selection.limit": "--subset",  # Of the commands that spread the scans over the data
    "space": "--label-space",
    "tool": "--for",
}
"""Option by argument, where their names differ."""
OPTION_OF_EXTRA = {"uncertainty/error": "--error", "votes": "--fuse"}
"""Option of `predict` by the further result that it asks for, where their names differ."""
RECIPE = "recipe."
"""Begin of the argument for a key of a recipe, such as ``recipe.batch``."""


class CommandLine(Spelling):
    """Spelling of arguments by the options of the command line."""

    def name(self, argument: str) -> str:
        """Spell an argument: ``--min-range``; a field of a record gets both names: ``--knn-k``."""
        spelling = argument.replace(".", "-").replace("_", "-")
        return OPTION_OF.get(argument, f"--{spelling}")

    def setting(self, argument: str, value: object) -> str:
        """Spell an argument with a value as it is typed in a shell: ``--width 512``."""
        if argument == "extras" and isinstance(value, tuple):
            return " ".join(OPTION_OF_EXTRA.get(extra, self.name(extra)) for extra in value)
        if argument.startswith(RECIPE):
            return f"--set {argument.removeprefix(RECIPE)}={quote(str(value))}"
        option = self.name(argument)
        if isinstance(value, tuple):
            return f"{option} {quote(','.join(map(str, value)))}"
        return option if value is True else f"{option} {quote(str(value))}"

    def share(self, argument: str, value: float) -> str:
        """Spell an argument with a share, 0…1, in percent: ``--at-most 5%``."""
        return f"{self.name(argument)} {100 * value:g}%"

    def part(self, argument: str, source: object, name: str) -> str:
        """Spell the choice of a part of a source by an option: ``--topic /points``."""
        return self.setting(argument, name)

    def command(self, words: str, settings: Sequence[str]) -> str:
        """Spell a command as it is typed."""
        return " ".join([words, *settings])
