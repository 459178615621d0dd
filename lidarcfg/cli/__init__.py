"""The command line.

To read in this order: `main` has the help page and the exit codes. A module for each command reads its inputs, makes
one library call and prints one table; `files` has the commands that write and check files, with its
`schemas`. All share `options`, `completion` and `progress`.
"""
