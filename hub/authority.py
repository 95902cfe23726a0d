"""The authority of a robot: signs the certificates of the holders, of elliptic curve P-256.

The authority's private key stays in the folder `AUTHORITY`; only new certificates need the key. Only certificates of
the role `canskin.keys.HUB` can be a server's, and name the hub's machine: a reader cannot pass for the hub.
"""

import datetime as dt
import re
from collections.abc import Sequence
from ipaddress import ip_address
from pathlib import Path
from typing import Final

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from canskin.errors import InputError, reasoned
from canskin.keys import CA, CERTIFICATE, HUB, KEY, parts_of
from hub.holders import HOLDERS, Holders, read_holders
from shell.output import write_file

#: Folder of the authority's private key.
AUTHORITY: Final = "authority"
AUTHORITY_DAYS: Final = 3650
HOLDER_DAYS: Final = 365
#: Names of its own machine, which every hub has.
LOOPBACK: Final = ("localhost", "127.0.0.1", "::1")
#: A clock may be this much slower than that of the authority.
SLOW_CLOCK: Final = dt.timedelta(hours=1)
_PEM: Final = serialization.Encoding.PEM
_HOST: Final = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


class Authority:
    """The authority in a folder, see `new_authority`.

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
        self.folder, self.list = folder, read_holders(folder)
        with reasoned(InputError, f"{folder}: no authority that can issue certificates"):
            certificate, key = ((folder / AUTHORITY / name).read_bytes() for name in (CA, KEY))
        try:
            self._certificate = x509.load_pem_x509_certificate(certificate)
            private = serialization.load_pem_private_key(key, None)
        except (ValueError, TypeError):
            private = None
        if not isinstance(private, ec.EllipticCurvePrivateKey):  # without more words: they may tell of the key
            raise InputError(f"{folder / AUTHORITY}: a file of the authority is damaged")
        self._key = private

    def keys_of(self, common_name: str) -> Path:
        """Return the folder of a holder's keys: ``ROLE`` or ``ROLE.HOLDER``, of another skin with ``SKIN.`` before."""
        return self.folder / common_name.removeprefix(f"{self.list.skin}:").replace(":", ".")

    def issue(self, common_name: str) -> Path:
        """Make a holder's key and certificate, in place of those before; return their folder.

        Raises
        ------
        InputError
            If the holder is revoked, or the folder cannot be written.
        """
        if common_name in self.list.revoked:
            raise InputError(f"'{common_name}' is revoked for good: add the holder with another name")
        key, usage = ec.generate_private_key(ec.SECP256R1()), [ExtendedKeyUsageOID.CLIENT_AUTH]
        builder = _builder(common_name, key, self._certificate.subject, HOLDER_DAYS)
        if parts_of(common_name)[1] == HUB:
            usage.append(ExtendedKeyUsageOID.SERVER_AUTH)
            names = [_general_name(host) for host in dict.fromkeys([*LOOPBACK, *self.list.hosts])]
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        builder = builder.add_extension(x509.ExtendedKeyUsage(usage), critical=False)
        certificate = builder.sign(self._key, hashes.SHA256())
        folder = self.keys_of(common_name)
        with reasoned(InputError, f"{folder}: cannot write keys there"):
            folder.mkdir(mode=0o700, exist_ok=True)
            folder.chmod(0o700)  # others may have been let in, and would see the key while it is written
            write_file(folder / CA, self._certificate.public_bytes(_PEM))
            _write_private(folder / KEY, key)
            write_file(folder / CERTIFICATE, certificate.public_bytes(_PEM))
        self.list.until[common_name] = f"{certificate.not_valid_after_utc:%Y-%m-%d}"
        self.write_list()
        return folder

    def write_list(self) -> None:
        """Write the list of holders, and its copy for the hub."""
        for folder in (self.folder, self.keys_of(f"{self.list.skin}:{HUB}")):
            with reasoned(InputError, f"{folder}: cannot write the list of holders"):
                write_file(folder / HOLDERS, msgspec.json.format(msgspec.json.encode(self.list)))


def new_authority(folder: Path, skin: str, hosts: Sequence[str]) -> Authority:
    """Make the authority of a robot in a new folder; its hub gets the first keys.

    Raises
    ------
    InputError
        If the folder is there already, or cannot be written, or a host is no name and no address.
    """
    if folder.exists():
        raise InputError(f"{folder}: is there already: no authority is written over; give another folder")
    for host in hosts:
        _general_name(host)
    key, name = ec.generate_private_key(ec.SECP256R1()), "authority of a canskin robot"
    builder = _builder(name, key, _name(name), AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    with reasoned(InputError, f"{folder}: cannot write keys there"):
        folder.mkdir(mode=0o700, parents=True)
        (folder / AUTHORITY).mkdir(mode=0o700)
        write_file(folder / AUTHORITY / CA, builder.sign(key, hashes.SHA256()).public_bytes(_PEM))
        _write_private(folder / AUTHORITY / KEY, key)
        write_file(folder / HOLDERS, msgspec.json.encode(Holders(skin, list(hosts))))
    return Authority(folder)


def _builder(
    common_name: str, key: ec.EllipticCurvePrivateKey, issuer: x509.Name, days: int
) -> x509.CertificateBuilder:
    now = dt.datetime.now(dt.UTC)
    return x509.CertificateBuilder(
        issuer,
        _name(common_name),
        key.public_key(),
        x509.random_serial_number(),
        now - SLOW_CLOCK,
        now + dt.timedelta(days),
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        if not _HOST.fullmatch(host):
            raise InputError(f"--host {host}: expected the name or the address of the hub's machine") from None
        return x509.DNSName(host)


def _write_private(path: Path, key: ec.EllipticCurvePrivateKey) -> None:
    """Write a private key, in a folder that nobody else may open."""
    write_file(path, key.private_bytes(_PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()))
    path.chmod(0o600)
