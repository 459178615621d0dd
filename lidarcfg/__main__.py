"""`python -m lidarcfg` is the command line."""

from lidarcfg.cli.main import main

main()
