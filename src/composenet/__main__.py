"""The `composenet` program, also as `python -m composenet`. Little is imported before ctrl-C is
handled."""

import sys


def main() -> None:
    """Entry point."""
    try:
        from composenet.cli import main as run
    except KeyboardInterrupt:
        print("composenet: interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
