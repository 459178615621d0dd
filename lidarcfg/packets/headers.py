"""The network headers of a sensor's packets, as its file says them: Ethernet, IP and UDP."""

import ipaddress
from typing import Annotated

from pydantic import AfterValidator, Field

from lidarcfg.config.models import Model, validation_error
from lidarcfg.sensors.sensor import Byte

MAC = "^[0-9a-f]{{2}}(:[0-9a-f]{{2}}){{{}}}$"


def _check_address(value: str) -> str:
    try:
        return str(ipaddress.IPv4Address(value))
    except ValueError:
        raise validation_error(f"{value!r} is not an IPv4 address such as 255.255.255.255") from None


class Header(Model):
    """The IP and UDP headers of a stream of datagrams."""

    ttl: Byte
    dont_fragment: bool
    numbered: bool  # the IP id counts up; else it is 0, but for datagrams that are sent in fragments
    checksum: bool  # UDP's; else it is 0, which says that there is none
    source_port: Annotated[int, Field(ge=1, le=65535)] | None = None  # none: the one it is sent to


class Network(Model):
    """The destination of the sensor's packets, and the maker's half of its MAC address."""

    source: str = ""
    mac_prefix: Annotated[str, Field(pattern=MAC.format(2))]  # the other half is its address's, but for the first byte
    destination_mac: Annotated[str, Field(pattern=MAC.format(5))]
    destination_ip: Annotated[str, AfterValidator(_check_address)]
