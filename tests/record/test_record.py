"""Every answer of the package is, bit for bit, what it was when the record was made."""

import pytest

from tests.record.answers import load_record, record_of
from tests.record.cases import CASES, RECORDING

pytestmark = pytest.mark.slow

RECORD = load_record()


@pytest.mark.parametrize("name", CASES)
def test_answers_are_the_recorded_ones(name, tmp_path):
    found = record_of(name, tmp_path)
    recorded = RECORD[name]
    assert list(found) == list(recorded)
    changed = [key for key in found if found[key] != recorded[key]]
    assert not changed, f"{len(changed)} of {len(found)} answers changed, first {changed[:5]}"


def test_every_recorded_case_is_known():
    """Those of real recordings are missing where there are none."""
    assert {name for name in RECORD if not name.startswith(RECORDING)} <= set(CASES)
