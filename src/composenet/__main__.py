"""`python -m composenet`."""

from composenet.cli import main

main()
