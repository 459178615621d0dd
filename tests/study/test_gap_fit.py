"""Where an object can be unseen: by every place tried out, and in a region whose subspaces are known by hand."""

import itertools

import numpy as np
import pytest

from lidarcfg.study.detection import gap_fit
from lidarcfg.vsr.detection import DetectionObject, counted_places, from_point
from lidarcfg.vsr.region import Region
from lidarcfg.vsr.subspaces import Subspaces


def labelled(label, cuboid_m=(1.0, 1.0, 1.0)):
    """Subspaces with these labels; nothing but label, region and number is asked for."""
    label = np.asarray(label, np.int32)
    cuboid = np.array(cuboid_m)
    region = Region(np.zeros(3), label.shape * cuboid, label >= 0)
    none = np.zeros(0, np.int64)
    cuboids = np.bincount(label[label >= 0])
    return Subspaces(region, label, cuboids, none.reshape(0, 3), none.reshape(0, 1), none)


def tried(label, size_m, cuboid_m, on_ground):
    """The subspaces that a box fits into, with the middles of its places: it is tried off the grid too."""
    found = set()
    places = []
    for length, width in {size_m[:2], size_m[1::-1]}:
        box = np.array([length, width, size_m[2]])
        room = label.shape * np.array(cuboid_m) - box
        if (room < 0).any():
            continue
        steps = [
            np.unique([*np.arange(0, most + 1e-9, edge / 2), most]) for most, edge in zip(room, cuboid_m, strict=True)
        ]
        for corner in itertools.product(steps[0], steps[1], [0.0] if on_ground else steps[2]):
            first = np.floor(np.array(corner) / cuboid_m + 1e-9).astype(int)
            last = np.ceil((corner + box) / cuboid_m - 1e-9).astype(int)
            touched = set(label[tuple(map(slice, first, last))].ravel().tolist())
            if len(touched) == 1 and min(touched) >= 0:
                found |= touched
                places.append(np.array(corner[:2]) + box[:2] / 2)
    return found, places


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("size_m", [(1.0, 2.0, 1.0), (0.6, 0.6, 1.4), (2.0, 1.0, 0.5), (9.0, 1.0, 1.0)])
@pytest.mark.parametrize("on_ground", [True, False])
def test_every_place_tried_out(seed, size_m, on_ground):
    rng = np.random.default_rng(seed)
    cuboid_m = (1.0, 0.5, 0.7)
    label = np.repeat(np.repeat(rng.integers(-1, 5, (3, 4, 2)), 2, axis=0), 2, axis=1)
    vsr = rng.random(5)
    vehicle = np.array([2.0, 1.5])
    item = DetectionObject(name="box", size_m=size_m, on_ground=on_ground)
    ours = gap_fit(labelled(label, cuboid_m), vsr, item, from_point(vehicle))
    if size_m[0] <= 6.0:  # what was counted for the detection rate tells the same
        counted = counted_places(labelled(label, cuboid_m), item)
        assert gap_fit(labelled(label, cuboid_m), vsr, item, from_point(vehicle), counted) == ours
    found, places = tried(label, size_m, cuboid_m, on_ground)
    assert (ours.subspaces, ours.in_worst) == (len(found), int(np.argmax(vsr)) in found)
    assert (ours.nearest_m is None) == (not found)
    if found:
        assert ours.largest_vsr_m == max(vsr[list(found)])
        slack = np.hypot(*cuboid_m[:2])  # an object need not fill its cuboids, in whose middle it is taken to be
        assert ours.nearest_m == pytest.approx(min(np.hypot(*(at - vehicle)) for at in places), abs=slack)
        assert ours.nearest_m == pytest.approx(np.hypot(*(np.array(ours.nearest_at_m) - vehicle)))


def test_a_slab_above_a_pedestrian():
    """Below 2 m everything is cut every metre, above there is one slab: who stands on the ground cannot hide there."""
    label = np.indices((4, 4, 4))
    label = np.where(label[2] >= 2, 0, 1 + label[0] + 4 * label[1] + 16 * label[2])
    spaces = labelled(label)
    vsr = np.where(np.arange(64) == 0, 1.0, 0.1)
    standing, flying = (
        gap_fit(spaces, vsr, DetectionObject(name="p", size_m=(0.5, 0.5, 1.7), on_ground=on), from_point(np.zeros(2)))
        for on in (True, False)
    )
    assert (standing.in_worst, standing.subspaces, standing.nearest_m) == (False, 0, None)
    assert (flying.in_worst, flying.subspaces, flying.largest_vsr_m) == (True, 1, 1.0)
    assert (flying.nearest_at_m, flying.nearest_m) == ((0.5, 0.5), pytest.approx(0.5 * 2**0.5))


def test_a_mesh_is_not_judged():
    item = DetectionObject(name="m", mesh="x.ply", returns=1)
    assert gap_fit(labelled(np.zeros((2, 2, 2))), np.ones(1), item, from_point(np.zeros(2))) is None
