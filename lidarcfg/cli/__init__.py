"""The command line.

`main` has the help page and the exit codes; each other module is a command, or what several commands share. A command
reads its inputs, makes one library call and prints one table.
"""
