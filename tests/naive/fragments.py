"""A plain-loop twin of reassembly, after RFC 815's list of what is missing."""


def reassembled(fragments: list[tuple[int, bool, bytes]]) -> bytes | None:
    """The datagram of fragments (offset, whether more follow, data), each of them once; None while some is missing."""
    end = next((offset + len(data) for offset, more, data in fragments if not more), None)
    if end is None:
        return None
    octets: list[int | None] = [None] * end
    for offset, _, data in fragments:
        for i, octet in enumerate(data):
            octets[offset + i] = octet
    return None if None in octets else bytes(octet for octet in octets if octet is not None)
