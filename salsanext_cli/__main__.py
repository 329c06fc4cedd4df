# SPDX-License-Identifier: MIT
"""Entry point of ``salsanext`` and ``python -m salsanext_cli``."""

import sys

from salsanext_cli.cli.interruption import end_line, handle_signals

ADVICE = "free some memory, allow more, or use fewer --jobs"


def main() -> None:
    """Run the command line."""
    handle_signals()
    try:
        from salsanext_cli.cli.app import main as run

        run()
    except KeyboardInterrupt:  # During the import, which takes tenths of a second
        line, status = end_line()
        sys.stderr.write(f"{line}\n")
        raise SystemExit(status) from None
    except Exception as error:
        from salsanext_cli.errors import error_text, out_of_memory

        if not out_of_memory(error):
            raise
        raise SystemExit(f"error: memory ran out · {error_text(error)} · {ADVICE}") from None


if __name__ == "__main__":
    main()
