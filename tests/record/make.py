"""Write record.json: the answers of every case, or of those that are named.

python -m tests.record.make [CASE ...]

Real recordings are read where LIDARCFG_CAPTURES says; without it, what is recorded of them stays as it is.
"""

import sys
import tempfile
import time
from pathlib import Path

from tests.record.answers import RECORD, load_record, record_of, save_record
from tests.record.cases import CASES, RECORDING


def main(names: list[str]) -> None:
    """Record the cases with these names, or all."""
    record = load_record() if RECORD.exists() else {}
    for name in names or CASES:
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            found = record_of(name, Path(folder))
        print(f"{time.perf_counter() - began:6.2f} s  {name}: {len(found)} answers")
        record[name] = found
    order = [*CASES, *(name for name in record if name.startswith(RECORDING) and name not in CASES)]
    save_record({name: record[name] for name in order if name in record})


if __name__ == "__main__":
    main(sys.argv[1:])
