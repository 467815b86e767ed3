"""What each command of the `composenet` program does; cli.py parses and calls."""
