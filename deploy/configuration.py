"""Writes what a host's configuration takes from a layout; `deploy/install` runs it in the environment of the skin.

The files go to a folder, at the paths that they have on the host: the environment of the services, the bit rates of the
CAN interfaces for systemd-networkd, names that stay and queues for udev, and the order of services after interfaces.
"""

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Final

from bus.ip_link import RESTART_MS, TRANSMIT_QUEUE_FRAMES, data_bit_rate_hz, sample_point
from bus.link import NAME_MAX, check_channels
from bus.options import BusOptions, channels
from canskin.errors import InputError, SkinError
from canskin.session import TLS_ENDPOINT
from shell.command import WRONG_INPUT
from skin.layout import SHIPPED, Bus, Layout, layout_text, load_layout

#: Services that open the CAN interfaces.
ON_THE_BUSES: Final = ("run", "gateway", "record")
#: With keys: the role of each service, after which its folder of keys is named. The page may ask as a person does.
ROLES: Final = {
    "hub": "hub",
    "run": "run",
    "gateway": "gateway",
    "reconstruct": "reconstructor",
    "classify": "classifier",
    "view": "operator",
    "record": "recorder",
    "ros2": "ros2",
    "metrics": "viewer",
}
#: Folders that the services cannot see (ProtectHome=, systemd.exec(5)).
HOMES: Final = ("/home", "/root", "/run/user")
#: Type of CAN devices, ARPHRD_CAN of linux/if_arp.h.
ARPHRD_CAN: Final = 280

ENVIRONMENT: Final = """\
# What the services of the skin are given. A change counts from their next start: systemctl restart skin.target
#
# The layout: a name that comes with canskin, or an absolute path that the user skin can read, best in /etc/canskin.
SKIN_LAYOUT={layout}
# More words of each verb; `skin VERB --help` lists all; skin@run has those of gateway and reconstruct. Models and
# calibration belong here, for example
#   SKIN_gateway=-i socketcan -c can0 --calibration /etc/canskin/palm.json
#   SKIN_reconstruct=--gains /etc/canskin/gains.json
#   SKIN_classify=--model /etc/canskin/palm.npz
SKIN_gateway=-i socketcan -c {channels}{keep_zero}{connect}
SKIN_reconstruct=
SKIN_classify=
SKIN_view=
SKIN_metrics=
SKIN_record=-i socketcan -c {channels}
# With keys (deploy/install --keys): where the hub listens.
SKIN_hub=--listen tls/0.0.0.0:7447
# Compiled kernels and trained models; another folder needs ReadWritePaths= in a drop-in.
#SKIN_CACHE=/var/cache/canskin
"""

NETWORK: Final = """\
# Bus {bus} of the layout. Made by deploy/install.
[Match]
Name={channel}
Type=can

[Link]
RequiredForOnline=no

[CAN]
BitRate={bit_rate_hz}
SamplePoint={sample_percent:g}%
RestartSec={restart_ms}ms
"""

NETWORK_FD: Final = """\
FDMode=yes
DataBitRate={bit_rate_hz}
DataSamplePoint={sample_percent:g}%
"""

DROP_IN: Final = """\
# Made by deploy/install: the CAN interfaces of the layout.
[Unit]
Wants={devices}
After={devices} systemd-networkd.service

[Service]
RestrictAddressFamilies=AF_CAN
"""

KEYS: Final = """\
# Made by deploy/install: who the service is to the hub.
[Service]
Environment=SKIN_KEYS=/etc/canskin/keys/{role}
"""

HUB_START: Final = """\
ExecStart=
ExecStart={venv}/bin/skin hub $SKIN_hub
"""

RUN: Final = """\
ExecStart=
ExecStart={venv}/bin/skin run --layout ${{SKIN_LAYOUT}} gateway $SKIN_gateway + reconstruct $SKIN_reconstruct

[Unit]
# In place of a process for each.
Conflicts=skin@gateway.service skin@reconstruct.service
"""

METRICS: Final = """\
# One service for all skins of the hub.
[Service]
ExecStart=
ExecStart={venv}/bin/skin metrics $SKIN_metrics
"""

RECORD: Final = """\
# Every start makes a new recording; a slow disk is no reason for one.
WatchdogSec=2min
ExecStart=
ExecStart=/bin/sh -c 'exec {venv}/bin/skin record --layout "$$SKIN_LAYOUT" $$SKIN_record \\
  --out "$$STATE_DIRECTORY/$$(date +%%Y%%m%%dT%%H%%M%%S).mcap"'
"""


@dataclass(frozen=True)
class Adapter:
    """A USB adapter's channel, and the name of its interface; `serial` is a serial number, or ``@`` and a USB port."""

    name: str
    serial: str
    channel: int

    @classmethod
    def from_text(cls, text: str) -> "Adapter":
        """Read ``NAME=SERIAL``, ``NAME=@PORT``, each with ``:CHANNEL`` or without."""
        found = re.fullmatch(rf"([a-z][a-z0-9_]{{0,{NAME_MAX - 1}}})=([\w.-]+|@\d+-\d+(?:\.\d+)*)(?::(\d+))?", text)
        if found is None:
            raise InputError(
                f"--adapter {text}: expected NAME=SERIAL or NAME=SERIAL:CHANNEL, for example skin0=0042A7:1, or with @"
                " and the USB port in place of SERIAL, skin0=@1-2.3"
            )
        if re.fullmatch(r"s?l?can\d+", found[1]):
            raise InputError(
                f"--adapter {text}: the kernel gives the name {found[1]} to any adapter: choose skin0 or so"
            )
        return cls(found[1], found[2], int(found[3] or 0))

    @property
    def rule(self) -> str:
        """The rule of udev that names the interface; drivers number the channels of an adapter by dev_id."""
        at = self.serial.removeprefix("@")
        device = f'ATTRS{{serial}}=="{at}"' if at == self.serial else f'KERNELS=="{at}"'
        of = f'{device}, ATTR{{dev_id}}=="{self.channel:#x}"'
        return f'ACTION=="add", SUBSYSTEM=="net", ATTR{{type}}=="{ARPHRD_CAN}", {of}, NAME="{self.name}"\n'


def network(bus: Bus, channel: str) -> str:
    """Return the file of systemd-networkd for the interface of a bus (systemd.network(5))."""
    text = NETWORK.format(
        bus=bus.name,
        channel=channel,
        bit_rate_hz=bus.bitrate,
        sample_percent=100 * sample_point(bus.bitrate),
        restart_ms=RESTART_MS,
    )
    data_hz = data_bit_rate_hz(bus)
    if data_hz is None:
        return text
    return text + NETWORK_FD.format(bit_rate_hz=data_hz, sample_percent=100 * sample_point(data_hz))


def rules(names: Sequence[str], adapters: Sequence[Adapter]) -> str:
    """Return the rules of udev: names of adapters, and the length of the transmit queues."""
    queues = (
        f'ACTION!="remove", SUBSYSTEM=="net", KERNEL=="{name}", ATTR{{type}}=="{ARPHRD_CAN}",'
        f' ATTR{{tx_queue_len}}="{TRANSMIT_QUEUE_FRAMES}"\n'
        for name in names
    )
    return "".join(["# Made by deploy/install.\n", *(each.rule for each in adapters), *queues])


def files(
    layout: Layout, where: str, names: Sequence[str], adapters: Sequence[Adapter], venv: str, *, has_keys: bool
) -> Iterator[tuple[str, str]]:
    """Find path and content of each file."""
    keep_zero = " --keep-zero /var/lib/canskin/zero.json" if layout.sends.in_cycles else ""
    connect = f" --connect {TLS_ENDPOINT}" if has_keys else ""
    yield (
        "etc/canskin/skin.env",
        ENVIRONMENT.format(layout=where, channels=" ".join(names), keep_zero=keep_zero, connect=connect),
    )
    for bus, name in zip(layout.bus, names, strict=True):
        yield f"etc/systemd/network/20-canskin-{name}.network", network(bus, name)
    yield "etc/udev/rules.d/76-canskin.rules", rules(names, adapters)
    order = DROP_IN.format(devices=" ".join(f"sys-subsystem-net-devices-{name}.device" for name in names))
    for verb in ON_THE_BUSES:
        own = {"run": RUN, "record": RECORD}.get(verb, "").format(venv=venv)
        yield f"etc/systemd/system/skin@{verb}.service.d/10-canskin.conf", order + own
    yield "etc/systemd/system/skin@metrics.service.d/10-canskin.conf", METRICS.format(venv=venv)
    for verb, role in ROLES.items() if has_keys else ():
        own = HUB_START.format(venv=venv) if verb == "hub" else ""
        yield f"etc/systemd/system/skin@{verb}.service.d/20-keys.conf", KEYS.format(role=role) + own


def host_path(given: str, root: str) -> tuple[str, bool]:
    """Return a layout's name or path on the host, and whether the layout must be copied there."""
    if given in SHIPPED:
        return given, False
    path = Path(given).resolve()
    if not root:
        return str(path), False
    if path.is_relative_to(root):
        return f"/{path.relative_to(root)}", False
    return f"/etc/canskin/{path.stem}.toml", True


def check_kept(kept: Path, where: str, names: Sequence[str]) -> None:
    """Refuse an environment that stays, for it was changed by hand, and is of another layout or other interfaces."""
    lines = re.findall(r"^(SKIN_\w+)=(.*)$", kept.read_text(errors="replace"), re.MULTILINE)
    given = {name: value.strip("\"' ") for name, value in lines}  # systemd.exec(5) allows quotes
    words = given.get("SKIN_gateway", "").split()
    # Another interface of python-can, such as slcan, is the user's own.
    flags = [place for place, word in enumerate(words) if word in {"-c", "--channel"} and "socketcan" in words]
    there = list(takewhile(lambda word: not word.startswith("-"), words[flags[0] + 1 :])) if flags else list(names)
    if given.get("SKIN_LAYOUT", where) != where:
        said, option = f"SKIN_LAYOUT={given['SKIN_LAYOUT']}, and the rest would be of {where}", "--layout"
    elif there != names[:1] and there != list(names):
        said, option = f"-c {' '.join(there)}, and the rest would be of {' '.join(names)}", "--interface"
    else:
        return
    raise InputError(f"{kept}: changed by hand, and stays: it has {said}: give its {option}, or change that line first")


def write(arguments: Sequence[str]) -> None:
    """Write the files that the command line asks for."""
    parser = argparse.ArgumentParser(prog="deploy/install")
    parser.add_argument("--layout", required=True)
    parser.add_argument("--interface", nargs="+", required=True)
    parser.add_argument("--adapter", nargs="*", default=[])
    parser.add_argument("--venv", required=True)
    parser.add_argument("--programs", nargs="*", default=[])
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--root", default="")
    parser.add_argument("--kept", type=Path)
    parser.add_argument("--keys", action="store_true")
    given = parser.parse_args(arguments)
    layout = load_layout(Path(given.layout))
    where, is_copied = host_path(given.layout, given.root)
    remedies = {where: "copy the layout to /etc/canskin, and give that path"}
    remedies |= dict.fromkeys(
        given.programs, "expected a Python of the system, PYTHON=/usr/bin/python3 deploy/install …"
    )
    for path, remedy in remedies.items():
        if path.startswith(tuple(f"{home}/" for home in HOMES)):
            raise InputError(f"{path}: the services see no home folders: {remedy}")
    names = channels(layout, BusOptions("socketcan", given.interface))
    adapters = [Adapter.from_text(text) for text in given.adapter]
    check_channels("socketcan", [each.name for each in adapters])
    if len({(each.serial, each.channel) for each in adapters}) < len(adapters):
        raise InputError(
            "--adapter: two names for one adapter: those with equal serial numbers, or none, need NAME=@PORT"
        )
    if unused := [each.name for each in adapters if each.name not in names]:
        raise InputError(f"--adapter {unused[0]}: expected a name of the interfaces, {', '.join(names)}")
    if given.kept is not None:
        check_kept(given.kept, where, names)
    # A copy has what the layout takes from other files in itself.
    copies = [(where[1:], layout_text(layout))] if is_copied else []
    for path, text in [*files(layout, where, names, adapters, given.venv, has_keys=given.keys), *copies]:
        file = given.folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)


if __name__ == "__main__":
    try:
        write(sys.argv[1:])
    except SkinError as error:
        print(f"deploy/install: {error}", file=sys.stderr)
        sys.exit(WRONG_INPUT)
