from .decode import decode_pcap as decode_pcap
from .export import simulated_packets as simulated_packets
from .manifest import load_manifest as load_manifest
from .pcap import read_datagrams as read_datagrams
from .pcap import write_pcap as write_pcap
from .reader import CaptureReader as CaptureReader
from .selection import Selection as Selection
from .stream import Packets as Packets
