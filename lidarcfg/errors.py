"""What can go wrong by the user's hand: each error is one line that says where, what, and what is allowed."""


def one_line(text: str) -> str:
    """With control characters written out, as a name may hold them."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class LidarcfgError(Exception):
    """The user's mistake, told in one line. The command line prints it and ends with 2."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class ConfigError(LidarcfgError):
    """A file of ours (sensor, rig, study, scene) does not say something that is allowed."""


class SceneError(LidarcfgError):
    """A scene cannot be built, for example one without anything in it."""


class PacketError(LidarcfgError):
    """A capture is not what it should be: no pcap, no LiDAR packets, another model."""


class CloudError(LidarcfgError):
    """A point cloud cannot be read, written or shown."""


class HandoverError(LidarcfgError):
    """What is to be handed over cannot be said in the format that is asked for."""
