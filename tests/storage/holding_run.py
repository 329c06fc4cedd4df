# SPDX-License-Identifier: MIT
"""A process that begins a run in an output folder when it is told to, and holds it until told.

::

    python holding_run.py OUT WEIGHTS [overwrite]
"""

import sys
from pathlib import Path

from salsanext_cli.errors import OutputError
from salsanext_cli.storage.output_run import output_run


def main(out: str, weights: str, overwrite: str = "") -> None:
    """Begin at the first line of stdin, end at the second."""
    _say("ready")
    sys.stdin.readline()
    run = (Path(out), "predict", {"weights": weights}, ("predictions",), ())
    try:
        with output_run(*run, overwrite=bool(overwrite)):
            _say("begun")
            sys.stdin.readline()
    except OutputError as error:
        _say(f"refused: {error}")


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
