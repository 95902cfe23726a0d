"""Keys of a holder: which program this is to a hub, and whom the program takes for its hub.

A folder of keys has three files: ``ca.pem``, the certificate of the robot's authority; ``cert.pem``, the holder's
certificate; ``key.pem``, the private key, which the holder alone may read. ``skin keys`` makes such folders. Zenoh
uses the files; the standard library's `ssl` checks them, and tells why a hub refuses them, which zenoh does not.
"""

import os
import socket
import ssl
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from canskin.errors import InputError, reasoned, tell

CA: Final = "ca.pem"
CERTIFICATE: Final = "cert.pem"
KEY: Final = "key.pem"
#: Names the folder of keys of every connection that gets no other keys.
ENVIRONMENT: Final = "SKIN_KEYS"
#: Protocols of zenoh's links that use keys.
PROTOCOLS_WITH_KEYS: Final = ("tls", "quic")
#: Zenoh's protocol of Unix sockets.
UNIX: Final = "unixsock-stream"
#: A service says so when its keys end in less.
RENEWAL_DAYS: Final = 30
_DAY_S: Final = 86400.0
#: Role of whoever may listen.
HUB: Final = "hub"
#: Longest wait for each of three answers of a hub: to a connection, to TLS, to the certificate.
ANSWER_S: Final = 0.3
#: Offered to a hub, which ignores them: they make the greeting longer than what zenoh without TLS takes its first bytes
#: for, 790 bytes, so that such a hub hangs up at once, while a busy hub is silent.
_PROTOCOLS_OFFERED: Final = ("-" * 255,) * 3
#: OpenSSL's X509_V_FLAG_NO_CHECK_TIME, which `ssl` does not name: dates are checked here, with words of their own.
_NO_CHECK_TIME: Final = 0x200000
#: OpenSSL's codes for what is wrong with a hub's certificate.
_OF_HUB: Final = {
    10: "its certificate has ended: 'skin keys renew', and start the hub again with the new files",
    **dict.fromkeys((7, 18, 19, 20), "its certificate is of another authority"),
    **dict.fromkeys((62, 64), "its certificate has other names: 'skin keys renew --host' with that of this endpoint"),
}
#: Parts of OpenSSL's names for what a hub answers to a holder's certificate.
_OF_HOLDER: Final = {
    "UNKNOWN_CA": "the hub knows another authority",
    "DECRYPT_ERROR": "the hub knows another authority",
    "EXPIRED": "the hub's clock says that the certificate has ended",
    "CERTIFICATE_REQUIRED": "the hub asks for a certificate",
}


class Keys:
    """The keys of one holder, checked.

    Parameters
    ----------
    folder : str or pathlib.Path
        Has `CA`, `CERTIFICATE` and `KEY`.

    Attributes
    ----------
    folder : pathlib.Path
        Absolute: zenoh reads the files again whenever it connects.
    common_name : str
        Of the certificate: ``SKIN:ROLE``, or ``SKIN:ROLE:HOLDER``.
    skin, role, holder : str
        The parts of the common name; `holder` may be empty.
    ends_s : float
        End of the certificate, seconds since 1970.

    Raises
    ------
    InputError
        If a file is missing, others may read the private key, the files do not belong together, or the certificate
        does not count today.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).expanduser().absolute()
        for name in (CA, CERTIFICATE, KEY):
            with (
                reasoned(InputError, f"keys {self.folder}: expected the folder of one role: {name} cannot be read"),
                (self.folder / name).open("rb"),
            ):
                pass
        key = self.folder / KEY
        if os.name == "posix" and key.stat().st_mode & 0o077:
            raise InputError(
                f"{key} can be read by other users: chmod 600; if they may have, 'skin keys revoke', and add"
                " another holder"
            )
        try:
            about = self._certificate()
        except ssl.SSLError as error:
            why = error.reason or "a file is damaged"
            raise InputError(f"keys {self.folder}: the files do not belong together: {why}") from error
        names = [value for part in about["subject"] for name, value in part if name == "commonName"]
        self.common_name: str = names[0] if names else ""
        self.skin, self.role, self.holder = parts_of(self.common_name)
        if not self.role:
            raise InputError(f"keys {self.folder}: expected a name such as palm:client, got '{self.common_name}'")
        begins_s, self.ends_s = (ssl.cert_time_to_seconds(about[each]) for each in ("notBefore", "notAfter"))
        if time.time() > self.ends_s:
            raise InputError(f"keys {self.folder}: the certificate ended {about['notAfter']}: 'skin keys renew'")
        if time.time() < begins_s:
            raise InputError(f"keys {self.folder}: the certificate begins {about['notBefore']}: is this clock right?")

    def watch_end(self, service: str, closed: threading.Event) -> None:
        """Log in the name of a service, now and once a day until `closed`, that the keys end soon or have ended."""

        def look() -> float:
            if self.role != HUB:  # a hub reads its files when it starts, and never again
                with suppress(OSError, ssl.SSLError):
                    self.ends_s = ssl.cert_time_to_seconds(self._certificate()["notAfter"])
            left_s = self.ends_s - time.time()
            if left_s < RENEWAL_DAYS * _DAY_S:
                when = f"end in {left_s / _DAY_S:.0f} days" if left_s > 0 else "have ended"
                tell(service, f"the keys {self.folder} {when}: 'skin keys renew'")
            return min(left_s, _DAY_S) if left_s > 0 else _DAY_S

        def watch(wait_s: float) -> None:
            while not closed.wait(wait_s):
                wait_s = look()

        threading.Thread(target=watch, args=(look(),), name="keys", daemon=True).start()

    def settings(self, *, is_hub: bool) -> dict[str, Any]:
        """Return zenoh's settings: both sides show a certificate, and the hub's names its host."""
        sides = ("listen", "connect") if is_hub else ("connect",)  # a hub may join another
        values = {
            "root_ca_certificate": str(self.folder / CA),
            **{f"{side}_certificate": str(self.folder / CERTIFICATE) for side in sides},
            **{f"{side}_private_key": str(self.folder / KEY) for side in sides},
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
        }
        return {f"transport/link/tls/{name}": value for name, value in values.items()}

    def context(self, protocol: int) -> ssl.SSLContext:
        """Return a TLS context that shows this certificate, and takes those of the authority alone."""
        context = ssl.SSLContext(protocol)
        context.minimum_version = ssl.TLSVersion.TLSv1_3
        context.load_verify_locations(self.folder / CA)
        context.load_cert_chain(self.folder / CERTIFICATE, self.folder / KEY)
        context.verify_mode = ssl.CERT_REQUIRED
        return context

    def _certificate(self) -> dict[str, Any]:
        """Return what the certificate says, as `ssl` tells a peer's: this holder connects to itself, in memory."""
        verifies, shows = self.context(ssl.PROTOCOL_TLS_SERVER), self.context(ssl.PROTOCOL_TLS_CLIENT)
        verifies.verify_flags |= ssl.VerifyFlags(_NO_CHECK_TIME)
        shows.check_hostname = False
        shows.verify_mode = ssl.CERT_NONE  # a client's certificate is none for a server
        there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
        server, client = verifies.wrap_bio(there, back, server_side=True), shows.wrap_bio(back, there)
        for side in (client, server, client, server):
            with suppress(ssl.SSLWantReadError):
                side.do_handshake()
        return server.getpeercert() or {}


def parts_of(common_name: str) -> tuple[str, str, str]:
    """Return skin, role and holder of a certificate's common name, each empty where the name has none."""
    skin, role, holder, *_ = [*common_name.split(":", 2), "", ""]
    return skin, role, holder


def environment_keys() -> Keys | None:
    """Return the keys that the variable `ENVIRONMENT` names; None without it."""
    folder = os.environ.get(ENVIRONMENT)
    return Keys(folder) if folder else None


def accepts(endpoint: str) -> bool:
    """Tell whether a program takes connections at an endpoint of TCP, TLS or a Unix socket; it may be hung."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    try:
        if protocol == UNIX:
            with socket.socket(socket.AF_UNIX) as link:
                link.settimeout(ANSWER_S)
                link.connect(address)
        elif protocol in {"tls", "tcp"}:
            socket.create_connection((host.strip("[]"), int(port)), ANSWER_S).close()
        else:
            return False
    except OSError:
        return False
    return True


def reason(endpoint: str, keys: Keys | None) -> str:
    """Return why a hub refuses a connection, after three times `ANSWER_S` at the latest.

    Empty if no hub is there, if the hub refuses nothing or is too busy to answer, and for QUIC, which `ssl` does not
    speak.
    """
    protocol, _, address = endpoint.partition("/")
    if protocol not in {"tls", "tcp"}:
        return ""
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    if keys is not None:
        context = keys.context(ssl.PROTOCOL_TLS_CLIENT)
    else:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.set_alpn_protocols(_PROTOCOLS_OFFERED)
    try:
        plain = socket.create_connection((host, int(port)), ANSWER_S)
    except OSError:
        return ""
    with plain:
        try:
            link = context.wrap_socket(plain, server_hostname=host)
        except ssl.SSLCertVerificationError as error:
            return _OF_HUB.get(error.verify_code, error.verify_message)
        except TimeoutError:
            return ""
        except OSError:  # hung up, or an answer that is not of TLS
            return "" if keys is None else "it does not speak TLS: give the hub its keys, or leave the keys out here"
        with link:
            return f"it asks for keys: give --keys FOLDER and tls/{address}" if keys is None else _refusal(link)


def _refusal(link: ssl.SSLSocket) -> str:
    """Return what a hub says of the certificate: of TLS 1.3 the answer comes after the handshake."""
    try:
        socket.socket.shutdown(link, socket.SHUT_WR)  # a hub without objection would wait for zenoh's first message
        link.recv(1)
    except ssl.SSLError as error:
        told = error.reason or str(error)
        return next((words for name, words in _OF_HOLDER.items() if name in told), told)
    except OSError:
        return ""
    return ""
