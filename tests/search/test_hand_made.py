"""Searches are no worse than a person: ten studies with rigs by hand, which are the witness."""

import pytest

from lidarcfg.requirements.verify import Verifier
from lidarcfg.search.cheapest import CheapestRun
from lidarcfg.search.combinations import distinct_combinations
from lidarcfg.search.start_rigs import points_by_combination
from tests.search.hand_made import HAND_MADE

EVALUATIONS = 20_000


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.nightly) for name in HAND_MADE])
def test_the_cheapest_rig_is_no_dearer_than_the_one_by_hand(name):
    made = HAND_MADE[name]
    study = made.study(evaluations=EVALUATIONS)
    ones = distinct_combinations(study)
    ((number, (x,)),) = points_by_combination(ones, [made.hand]).items()
    chosen = ones[number].study
    assert ones[number].price == made.price
    assert Verifier(chosen.requirements).verify(chosen.rig(chosen.space.poses(x[None])[0]).mounts).passed

    class FoundError(Exception):
        pass

    def stop(run):
        if run.found is not None and run.combinations[run.found].price <= made.price:
            raise FoundError

    run = CheapestRun(study, on_turn=stop)
    with pytest.raises(FoundError):  # whatever is found after that is cheaper still
        run.run()
    found = run.combinations[run.found].study
    record = run.records[run.found]
    assert Verifier(found.requirements).verify(found.rig(found.poses(record.x[None])[0]).mounts).passed
