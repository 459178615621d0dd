"""Searches are no worse than a person: ten studies with rigs by hand, which are the witness."""

import pytest

from lidarcfg.requirements.verify import Verifier
from lidarcfg.search.cheapest import CheapestRun
from lidarcfg.search.combinations import distinct_options
from lidarcfg.search.starts import starting_options
from tests.search.hand_made import HAND_MADE

EVALUATIONS = 20_000


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.nightly) for name in HAND_MADE])
def test_the_cheapest_rig_is_no_dearer_than_the_one_by_hand(name):
    made = HAND_MADE[name]
    study = made.study(evaluations=EVALUATIONS)
    options = distinct_options(study)
    ((number, (x,)),) = starting_options(options, [made.hand]).items()
    chosen = options[number].combination.study
    assert options[number].price == made.price
    assert Verifier(chosen.requirements).verify(chosen.rig(chosen.space.poses(x[None])[0]).mounts).passed
    run = CheapestRun(study)

    class FoundError(Exception):
        pass

    def stop(run, what):
        if run.found is not None and run.options[run.found].price <= made.price:
            raise FoundError

    with pytest.raises(FoundError):  # whatever is found after that is cheaper still
        run.run(stop)
    found = run.options[run.found].combination.study
    effort = run.efforts[run.found]
    assert Verifier(found.requirements).verify(found.rig(found.space.poses(effort.x[None])[0]).mounts).passed
