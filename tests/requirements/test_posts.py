"""Where posts are seen, on paper: a beam that points down meets posts up to where it meets the ground, and beyond not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lidarcfg.returns.post_visibility import STEP_M, PostPlaces, post_visibility
from lidarcfg.world.footprint import Footprint
from lidarcfg.world.tracer import NO_OBSTACLES
from tests.returns_cases import box, mount

BODY = Footprint.of(box(2.0, 2.0, 1.0))


def cones(*elevation_deg):
    """A sensor 2 m above the body's middle with beams at these elevations, all starting at one point."""
    one = mount("vlp-16", (0.0, 0.0, 2.0), (0, 0, 0))
    table = (*elevation_deg, *(elevation_deg[-1] for _ in range(16 - len(elevation_deg))))
    beams = one.sensor.beams.model_copy(update={"elevation_deg": table, "vertical_offset_mm": ()})
    return (replace(one, sensor=one.sensor.model_copy(update={"beams": beams})),)


def test_a_post_is_seen_where_a_cone_is_between_its_ends():
    """A post of 0.5 m meets the cone at -20° from 1.5 / tan 20° to 2 / tan 20° from the axis, plus half its width."""
    posts = PostPlaces.around(BODY, 0.0, (0.0, 8.0))
    seen = post_visibility(posts, 0.5, cones(-20.0), NO_OBSTACLES)
    first, last = (height / math.tan(math.radians(20)) for height in (1.5, 2.0))
    assert seen.first_seen_m[0] == pytest.approx(first - 1.0, abs=STEP_M + 0.05)
    assert seen.longest_gap_m[0] == pytest.approx(9.0 - last, abs=2 * STEP_M + 0.05)
    assert seen.longest_gap_at_m[0] == pytest.approx(last - 1.0, abs=STEP_M + 0.06)
    assert seen.seen_to_m[0] == pytest.approx(last - 1.0, abs=STEP_M + 0.06)
    assert 0 < seen.gap_share < 1


def test_nothing_is_seen_above_all_posts():
    posts = PostPlaces.around(BODY, 0.0, (0.0, 8.0))
    seen = post_visibility(posts, 0.5, cones(0.0), NO_OBSTACLES)
    assert np.isinf(seen.first_seen_m).all()
    assert (seen.seen_to_m == 0).all()


def test_with_one_lost_of_two():
    posts = PostPlaces.around(BODY, 0.0, (0.0, 8.0))
    alone = cones(-20.0)
    both = (*cones(-20.0), *cones(-12.0))
    one = post_visibility(posts, 0.5, alone, NO_OBSTACLES).seen
    other = post_visibility(posts, 0.5, cones(-12.0), NO_OBSTACLES).seen
    assert (post_visibility(posts, 0.5, both, NO_OBSTACLES).seen == (one | other)).all()
    assert (post_visibility(posts, 0.5, both, NO_OBSTACLES, lost=1).seen == (one & other)).all()
