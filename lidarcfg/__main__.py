"""`python -m lidarcfg` is the command line."""

from lidarcfg.cli import main

main()
