"""CAMs that on-board and roadside units forward in UDP datagrams: bare, or behind the headers that they had on the air.

There is no port for them, so a datagram is a CAM's only if its headers say so, or if it is one to its last bit.
"""

from __future__ import annotations

from laci_stereo.io.cam.etsi import DamagedError, OtherKindError
from laci_stereo.io.cam.geonetworking import CAM_PORT, ETHER_TYPE, Payload, cam_payload, looks_like_packet
from laci_stereo.io.cam.uper import decode_cam, is_whole_cam

_UDP = 17
_FRAGMENT = 0x3FFF
"""Bits of IPv4 that are set in a fragment: that more follow, and its offset."""

_ETHERNET_BYTES, _BTP_BYTES, _UDP_BYTES, _IPV6_BYTES = 14, 4, 8, 40


def datagram(packet: bytes) -> bytes | None:
    """Return the data of the UDP datagram in an IP packet; None for others, fragments, and what is cut off."""
    if len(packet) < _IPV6_BYTES // 2:
        return None
    if packet[0] >> 4 == 4:
        is_udp = packet[9] == _UDP and not int.from_bytes(packet[6:8], "big") & _FRAGMENT
        rest = packet[4 * (packet[0] & 15) :]
    else:
        is_udp = packet[0] >> 4 == 6 and packet[6] == _UDP
        rest = packet[_IPV6_BYTES:]
    size = int.from_bytes(rest[4:6], "big")
    return rest[_UDP_BYTES:size] if is_udp and _UDP_BYTES <= size <= len(rest) else None


def forwarded_cam(data: bytes) -> Payload:
    """Return the CAM in the data of a datagram, still encoded.

    Raises
    ------
    OtherKindError
        If the data are not for certain a CAM, or are another message behind its headers.
    """
    if data[_ETHERNET_BYTES - 2 : _ETHERNET_BYTES] == ETHER_TYPE.to_bytes(2, "big"):
        data = data[_ETHERNET_BYTES:]
    if looks_like_packet(data):
        try:
            sent = cam_payload(data)
            decode_cam(sent.data)
        except DamagedError:
            raise OtherKindError("UDP") from None
        return sent
    behind = data[_BTP_BYTES:] if data[:2] == CAM_PORT.to_bytes(2, "big") else data
    if not is_whole_cam(behind):
        raise OtherKindError("UDP")
    return Payload(behind)
