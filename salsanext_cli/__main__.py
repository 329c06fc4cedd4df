# SPDX-License-Identifier: MIT
"""Entry point of ``salsanext`` and ``python -m salsanext_cli``."""

from salsanext_cli.commands.line.output.interruption import handle_signals

ADVICE = "free some memory, allow more, or use fewer --jobs"


def main() -> None:
    """Run the command line."""
    handle_signals()
    try:
        from salsanext_cli.commands.line.app import main as run

        run()
    except Exception as error:
        from salsanext_cli.core.engines.memory import out_of_memory
        from salsanext_cli.core.texts import error_text

        if not out_of_memory(error):
            raise
        raise SystemExit(f"error: memory ran out: {error_text(error)}\nhint: {ADVICE}") from None


if __name__ == "__main__":
    main()
