"""The registry of cases, and how their answers are written down: exactly, bit for bit."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

INPUTS = Path(__file__).parent / "inputs"
RECORD = Path(__file__).parent / "record.json"
Answers = Mapping[str, object]
Case = Callable[[Path], Answers]
CASES: dict[str, Case] = {}


def case(name: str) -> Callable[[Case], Case]:
    """Register a function, which gets an empty folder, as a case."""

    def register(function: Case) -> Case:
        assert name not in CASES
        CASES[name] = function
        return function

    return register


def written(answer: object) -> object:
    """An answer as it stands in the record: numbers exactly, arrays and files by their type, shape and hash."""
    if isinstance(answer, np.generic):
        answer = answer.item()
    if answer is None or isinstance(answer, (bool, int)):
        return answer
    if isinstance(answer, float):
        return answer.hex()
    if isinstance(answer, bytes):
        return f"{len(answer)} bytes {hashlib.sha256(answer).hexdigest()}"
    array = np.asarray(answer)
    assert array.dtype != object, "an answer is a number, bytes, or an array of numbers"
    kind = f"{array.dtype.names or array.dtype.str} {array.shape}"
    return f"{kind} {hashlib.sha256(kind.encode() + _bits(array)).hexdigest()}"


def _bits(array: np.ndarray) -> bytes:
    """The bytes of an array in the order of its indices; every NaN as the same one."""
    if array.dtype.kind == "f" and np.isnan(array).any():
        array = np.where(np.isnan(array), array.dtype.type(np.nan), array)
    return array.tobytes()


def record_of(name: str, folder: Path) -> dict[str, object]:
    """What is recorded of a case."""
    return {key: written(answer) for key, answer in CASES[name](folder).items()}


def load_record() -> dict[str, dict[str, object]]:
    """The record, by case."""
    return json.loads(RECORD.read_text())


def save_record(record: Mapping[str, Mapping[str, object]]) -> None:
    """Write the record."""
    RECORD.write_text(json.dumps(record, indent=1) + "\n")


def named(prefix: str, answers: Answers) -> dict[str, object]:
    """The answers with a prefix before their names."""
    return {f"{prefix} {key}": answer for key, answer in answers.items()}
