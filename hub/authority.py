"""The authority of a robot: a certificate of its own, with which it signs those of the holders.

The private key stays in the folder `AUTHORITY`, and is needed to issue certificates alone. Certificates are for
elliptic curve P-256. Those of the role `canskin.keys.HUB` name the hub's machine, and only they can be a server's: the
key of a reader cannot pass for the hub.
"""

import datetime as dt
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path
from typing import Final

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from canskin.errors import InputError, reasoned
from canskin.keys import CA, CERTIFICATE, HUB, KEY
from hub.holders import HOLDERS, Holder, Holders, read_holders
from shell.output import write_file

#: Folder of the authority's private key.
AUTHORITY: Final = "authority"
AUTHORITY_DAYS: Final = 3650
HOLDER_DAYS: Final = 365
#: Names of its own machine, which every hub has.
LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
#: A clock may be this much slower than that of the authority.
SLOW_CLOCK: Final = dt.timedelta(hours=1)
#: Longest common name (RFC 5280, upper bound of X520CommonName).
COMMON_NAME_CHARACTERS: Final = 64
_PEM: Final = serialization.Encoding.PEM
_HOST: Final = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


class Authority:
    """The authority of a folder, which has made it with `new_authority`.

    Attributes
    ----------
    folder : pathlib.Path
    list : Holders
        What the authority has issued.

    Raises
    ------
    InputError
        If the folder has no authority that can be read.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.list = read_holders(folder)
        with reasoned(InputError, f"{folder}: no authority that can issue certificates"):
            certificate, key = (folder / AUTHORITY / name for name in (CA, KEY))
            parts = certificate.read_bytes(), key.read_bytes()
        try:
            self._certificate = x509.load_pem_x509_certificate(parts[0])
            private = serialization.load_pem_private_key(parts[1], None)
        except (ValueError, TypeError):  # without its words: they may tell of the key
            raise InputError(f"{folder / AUTHORITY}: a file of the authority is damaged") from None
        if not isinstance(private, ec.EllipticCurvePrivateKey):
            raise InputError(f"{key}: expected a key of an elliptic curve")
        self._key = private

    def keys_of(self, common_name: str) -> Path:
        """Return the folder of a holder's keys: ``ROLE`` or ``ROLE.HOLDER``, of another skin with ``SKIN.`` before."""
        return self.folder / common_name.removeprefix(f"{self.list.skin}:").replace(":", ".")

    def issue(self, common_name: str, hosts: Sequence[str] = ()) -> Path:
        """Make a holder's key and certificate, in place of those before; return their folder.

        Raises
        ------
        InputError
            If the holder is revoked, or the folder cannot be written.
        """
        before = self.list.holders.get(common_name)
        if before is not None and before.is_revoked:
            raise InputError(f"'{common_name}' is revoked for good: add the holder with another name")
        if len(common_name) > COMMON_NAME_CHARACTERS:
            raise InputError(f"'{common_name}': expected up to {COMMON_NAME_CHARACTERS} characters")
        key, usage = ec.generate_private_key(ec.SECP256R1()), [ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = _builder(common_name, key, self._certificate.subject, HOLDER_DAYS)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        if common_name.split(":")[1] == HUB:
            usage.append(ExtendedKeyUsageOID.SERVER_AUTH)
            names = x509.SubjectAlternativeName([_general_name(host) for host in dict.fromkeys([*LOOPBACK, *hosts])])
            builder = builder.add_extension(names, critical=False)
        issuer = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key())
        certificate = (
            builder.add_extension(x509.ExtendedKeyUsage(usage), critical=False)
            .add_extension(issuer, critical=False)
            .sign(self._key, hashes.SHA256())
        )
        folder = self.keys_of(common_name)
        with reasoned(InputError, f"{folder}: cannot write keys there"), private_files():
            folder.mkdir(exist_ok=True)
            write_file(folder / CA, self._certificate.public_bytes(_PEM))
            write_file(folder / KEY, _private_pem(key))
            write_file(folder / CERTIFICATE, certificate.public_bytes(_PEM))
        self.list.holders[common_name] = Holder(f"{certificate.not_valid_after_utc:%Y-%m-%d}")
        return folder

    def write_list(self) -> None:
        """Write the list of holders, and its copy for the hub."""
        content = msgspec.json.format(msgspec.json.encode(self.list))
        hub = self.keys_of(f"{self.list.skin}:{HUB}")
        with reasoned(InputError, f"{self.folder}: cannot write the list of holders"), private_files():
            hub.mkdir(exist_ok=True)
            for folder in (self.folder, hub):
                write_file(folder / HOLDERS, content)


def new_authority(folder: Path, skin: str, hosts: Sequence[str]) -> Authority:
    """Make the authority of a robot in a new folder.

    Raises
    ------
    InputError
        If the folder is there already, or cannot be written, or a host is no name and no address.
    """
    if folder.exists():
        raise InputError(f"{folder}: is there already: no authority is written over; give another folder")
    for host in hosts:
        _general_name(host)
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"canskin {skin}"[:COMMON_NAME_CHARACTERS])])
    usage = dict.fromkeys(
        ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement"), False
    ) | {"key_cert_sign": True, "crl_sign": True, "encipher_only": False, "decipher_only": False}
    certificate = (
        _builder(f"canskin {skin}"[:COMMON_NAME_CHARACTERS], key, subject, AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(x509.KeyUsage(**usage), critical=True)
        .sign(key, hashes.SHA256())
    )
    with reasoned(InputError, f"{folder}: cannot write keys there"), private_files():
        (folder / AUTHORITY).mkdir(parents=True)
        (folder / AUTHORITY / CA).write_bytes(certificate.public_bytes(_PEM))
        (folder / AUTHORITY / KEY).write_bytes(_private_pem(key))
        (folder / HOLDERS).write_bytes(msgspec.json.encode(Holders(skin, list(hosts))))
    return Authority(folder)


@contextmanager
def private_files() -> Iterator[None]:
    """Make new files of the ``with`` block the user's alone, from their first byte on."""
    before = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(before)


def _builder(
    common_name: str, key: ec.EllipticCurvePrivateKey, issuer: x509.Name, days: int
) -> x509.CertificateBuilder:
    """Return what every certificate has: names, dates, the public key."""
    now = dt.datetime.now(dt.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)]))
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - SLOW_CLOCK)
        .not_valid_after(now + dt.timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        if not _HOST.fullmatch(host):
            raise InputError(f"--host {host}: expected the name or the address of the hub's machine") from None
        return x509.DNSName(host)


def _private_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(_PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
