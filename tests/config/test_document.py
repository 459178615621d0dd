"""Every loader, given files made odd: each is an error in one line, or an answer that is right."""

import json

import pytest
from hypothesis import HealthCheck, example, given, settings

from tests.documents import GOOD, TEXTS, USES, documents, one_line, outcome, places, prepare, value_at


@pytest.fixture
def folder(tmp_path):
    """Where the files of one test lie."""
    prepare(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("name", USES)
def test_any_file_is_an_error_or_an_answer(name, folder):
    @settings(max_examples=50, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
    @given(documents(name))
    @example(TEXTS[name])
    def run(text):
        assert one_line(outcome(name, text, folder))

    run()
    assert outcome(name, TEXTS[name], folder) == "an answer"


@pytest.mark.slow
@pytest.mark.parametrize("name", USES)
def test_every_number_of_a_file_made_odd(name, folder):
    """One at a time: every key of a good file that holds a number, and the second number of every list."""
    at = [key for key in places(GOOD[name]) if type(value_at(GOOD[name], key)) in (int, float)]
    at = [key for key in at if not isinstance(key[-1], int) or key[-1] == 1]
    said = []
    for key in at:
        for number in (0, 5e-324, -1.7e308, 2**63):
            document = json.loads(json.dumps(GOOD[name]))
            value_at(document, key[:-1])[key[-1]] = number
            said.append(outcome(name, json.dumps(document), folder))
    assert len(said) == 4 * len(at) > 0
    assert all(map(one_line, said))
    assert any(one != "an answer" for one in said)
