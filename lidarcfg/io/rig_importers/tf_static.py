"""The static transforms of a bag, which say where a vehicle's frames are."""

from collections.abc import Mapping
from pathlib import Path

from lidarcfg.errors import ConversionError
from lidarcfg.io.bag_reader import open_bag
from lidarcfg.io.rig_importers.sensor_kit import SensorKit, kit_of_tree
from lidarcfg.world.frame_tree import FrameTree, Joint, pose_of_quaternion

TF_STATIC = "/tf_static"


def read_tf_static(path: Path, models: Mapping[str, str]) -> SensorKit:
    """The kit of a bag's static transforms; of a frame that is sent again the last counts. Raises ConversionError."""
    joints: dict[str, Joint] = {}
    with open_bag(path) as bag:
        if TF_STATIC not in bag.topics:
            raise ConversionError(f"{path}: has no {TF_STATIC}; its topics: {', '.join(sorted(bag.topics)) or 'none'}")
        for message in bag.messages(TF_STATIC):
            for one in message.value.transforms:
                child = one.child_frame_id.strip("/")
                at = one.transform.translation
                turn = one.transform.rotation
                where = f"{path}: {TF_STATIC} of {child}"
                pose = pose_of_quaternion(where, (at.x, at.y, at.z), (turn.w, turn.x, turn.y, turn.z))
                joints[child] = Joint(one.header.frame_id.strip("/"), pose)
    if not joints:
        raise ConversionError(f"{path}: {TF_STATIC} has no transforms")
    return kit_of_tree(str(path), path.stem, FrameTree(str(path), joints), models, {})
