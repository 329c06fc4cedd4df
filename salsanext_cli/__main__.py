# SPDX-License-Identifier: MIT
"""Entry point of ``salsanext`` and ``python -m salsanext_cli``."""

try:
    from salsanext_cli.cli.interruption import end_on_signals
except KeyboardInterrupt:
    raise SystemExit(130) from None

ADVICE = "free some memory, allow more, or use fewer --jobs"


def main() -> None:
    """Run the command line; its imports take a while, in which signals arrive too."""
    end_on_signals()
    try:
        from salsanext_cli.cli.app import main as run

        run()
    except Exception as error:
        from salsanext_cli.errors import error_text, out_of_memory

        if not out_of_memory(error):
            raise
        raise SystemExit(f"error: memory ran out · {error_text(error)} · {ADVICE}") from None


if __name__ == "__main__":
    main()
