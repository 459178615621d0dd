"""What a rig misses around the vehicle, for the page: counted at few of the fresh places, so that it follows a drag."""

from typing import Any

import numpy as np

from lidarcfg.geometry import Array
from lidarcfg.report.misses import colours
from lidarcfg.returns.missed_map import MissedMap, missed_map
from lidarcfg.returns.misses import FRESH, FRESH_PLACES, Misses
from lidarcfg.sensors.rig import Rig
from lidarcfg.viewer.bodies import packed_quads

PLACES = 1024  # of each object: the first of the fresh ones, which no search has seen
STEPS = 16  # of the square root of a share, each with a colour of its own
BELOW_M = 0.05  # the ground, so that points on it are seen
CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])


class MissCounter:
    """Counts what rigs miss; what is known of sensors that do not move is kept."""

    def __init__(self, misses: Misses) -> None:
        self._misses = misses
        self._known = misses.known(PLACES, FRESH)

    def count(self, rig: Rig) -> dict[str, Any]:
        """The shares by object, and squares on the ground. Raises ConfigError for sensors that lack facts."""
        found = self._misses.found_at(self._known, rig.mounts)
        return {
            "share": found.mean,
            "returns": found.returns,
            "objects": [{"name": one.name, "share": one.share} for one in found.objects],
            "places": PLACES,
            "places_of_reports": FRESH_PLACES,
            "squares": _squares(missed_map(found), float(found.objects[0].places[0, 2])),
        }


def _squares(cells: MissedMap, ground_m: float) -> list[dict[str, Any]]:
    """The cells in which something is missed as meshes of one colour each, from the least missed on."""
    step = np.ceil(STEPS * np.sqrt(cells.share))
    out = []
    for one in np.unique(step[step > 0]):
        at = cells.low_m + cells.side_m * (np.argwhere(step == one)[:, None] + CORNERS)
        faces_m: Array = np.concatenate([at, np.full((*at.shape[:2], 1), ground_m - BELOW_M)], axis=2)
        red, green, blue = colours(np.array([(one / STEPS) ** 2]))[0].tolist()
        out.append({"colour": f"#{red:02x}{green:02x}{blue:02x}", "mesh": packed_quads(faces_m)})
    return out
