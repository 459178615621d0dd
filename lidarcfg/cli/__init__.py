"""The command line.

To read in this order: `main` has the help page and the exit codes. Each command has a module of its name, which reads
the inputs, makes one library call and prints one table; `init` writes the `templates`, `schema` the `json_schemas`. All
use `options`, `completion` and `progress`.
"""
