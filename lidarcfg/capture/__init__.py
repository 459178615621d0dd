"""Captures: files of packets, read and written.

To read in this order: `pcap` and `pcapng` have records, `frames` and `fragments` datagrams, `stream` the packets of one
sensor, `decode` the cloud of all. `selection` leaves out what is not asked for, `manifest` says what a capture was made
of, `replay` sends it.
"""
