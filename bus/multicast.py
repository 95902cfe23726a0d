"""Multicast (udp_multicast) for several buses and programs of one machine."""

import socket
from typing import Any, Final

from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.bus import GeneralPurposeUdpMulticastBus

#: IP_MULTICAST_ALL of ``linux/in.h`` and IPV6_MULTICAST_ALL of ``linux/in6.h``, and the option of the hops.
_OPTIONS: Final = {
    socket.AF_INET: (socket.IPPROTO_IP, 49, socket.IP_MULTICAST_TTL),
    socket.AF_INET6: (socket.IPPROTO_IPV6, 29, socket.IPV6_MULTICAST_HOPS),
}


class _Group(GeneralPurposeUdpMulticastBus):
    """One group, without the others that the machine has joined; a port of its own tells what it has sent itself."""

    def __init__(self, group: str, port: int, hop_limit: int) -> None:
        super().__init__(group, port, hop_limit)
        level, all_groups, hops = _OPTIONS[self._socket.family]
        self._socket.setsockopt(level, all_groups, 0)
        self._out = socket.socket(self._socket.family, socket.SOCK_DGRAM)
        self._out.setsockopt(level, hops, hop_limit)
        self._out.connect(self._send_destination)
        self._own = self._out.getsockname()[:2]

    def send(self, data: bytes, timeout: float | None = None) -> None:
        self._out.settimeout(timeout)
        self._out.send(data)

    def recv(self, timeout: float | None = None) -> Any:
        received = super().recv(timeout)
        return None if received is None or received[1][:2] == self._own else received

    def shutdown(self) -> None:
        super().shutdown()
        self._out.close()


class OneGroup(UdpMulticastBus):
    """python-can's udp_multicast, which takes frames of other groups and its own for those of its bus."""

    def __init__(self, *given: Any, **options: Any) -> None:
        super().__init__(*given, **options)
        whole = self._multicast
        self._multicast = _Group(whole.group, whole.port, whole.hop_limit)
        whole.shutdown()
