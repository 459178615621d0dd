#!/usr/bin/env python3
"""Run time against error: every estimate of the project beside its truth, and the seconds it takes.

    .venv/bin/python tools/bench_accuracy.py                       all sections, some 20 minutes on two free cores
    .venv/bin/python tools/bench_accuracy.py optimum detection     some of them
    .venv/bin/python tools/bench_accuracy.py --quick capture       whether it runs: prints, leaves docs/ alone

Each section is accuracy_NAME.py beside this file. Writes the tables of docs/accuracy.md, and those of vsr into
docs/measure.md, between their markers, and the plots in docs/accuracy/. The table of stress tests is tools/stress.py's.
"""

import argparse
import tempfile
import time
from importlib import import_module
from pathlib import Path

from page import PAGE, heading, write_section

SECTIONS = [
    name
    for name in ("vsr", "optimum", "detection", "precision", "solvers", "capture")
    if Path(__file__).with_name(f"accuracy_{name}.py").is_file()
]


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="section", help=f"of {', '.join(SECTIONS)}; all without any")
    parser.add_argument("--quick", action="store_true", help="tiny sizes; prints only")
    given = parser.parse_args(arguments)
    if unknown := set(given.sections) - set(SECTIONS):
        parser.error(f"no section is called {', '.join(sorted(unknown))}; allowed: {', '.join(SECTIONS)}")
    with tempfile.TemporaryDirectory() as scratch:
        plots = Path(scratch) if given.quick else PAGE.with_suffix("")
        plots.mkdir(exist_ok=True)
        for name in given.sections or SECTIONS:
            section = import_module(f"accuracy_{name}")
            if name == "vsr":  # has a page of its own, docs/measure.md
                print("\n## vsr\n", flush=True)
                section.main(["--quick"] if given.quick else [])
                continue
            started = time.perf_counter()
            lines = section.run(given.quick, plots)
            lines = [heading(time.perf_counter() - started), "", *lines]
            print(f"\n## {name}\n", *lines, sep="\n", flush=True)
            if not given.quick:
                write_section(name, lines)


if __name__ == "__main__":
    main()
