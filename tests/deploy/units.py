"""What the units of `deploy/` mean (systemd.unit(5), systemd.exec(5)), for a machine that systemd does not run."""

import re
import shlex
import socket
import subprocess
from functools import cache
from pathlib import Path
from typing import Final

from tests.readonly import Confined, filter_of_calls

UNITS: Final = "etc/systemd/system"
SPECIFIERS: Final = {"%t": "/run", "%C": "/var/cache", "%S": "/var/lib", "%%": "%"}
#: Setting, parent of its folder, and the variable that systemd tells the folder by.
FOLDERS: Final = (
    ("RuntimeDirectory", "/run", "RUNTIME_DIRECTORY"),
    ("StateDirectory", "/var/lib", "STATE_DIRECTORY"),
    ("CacheDirectory", "/var/cache", "CACHE_DIRECTORY"),
)


class Unit:
    """A service of an installation below `root`; `settings` are those of [Service], in order."""

    def __init__(self, root: Path, verb: str) -> None:
        self.root, self.verb = root, verb
        self.settings: dict[str, list[str]] = {}
        units = root / UNITS
        for file in (units / "skin@.service", *sorted((units / f"skin@{verb}.service.d").glob("*.conf"))):
            section = file.read_text().replace("\\\n", " ").partition("[Service]\n")[2].partition("\n[")[0]
            for key, value in re.findall(r"^(\w+)=(.*)$", section, re.MULTILINE):
                meant = re.sub(r"%.", lambda found: {**SPECIFIERS, "%i": verb}[found[0]], value)
                self.settings[key] = [*self.settings.get(key, []), meant] if value else []

    def confined(self, folders: Path) -> Confined:
        """Return the surroundings of the service; the content of its folders is in `folders`."""
        assert self._last("ProtectSystem") == "strict"
        assert self._last("NoNewPrivileges") == "yes"
        assert self.settings["CapabilityBoundingSet"] == self.settings["AmbientCapabilities"] == []
        limit = self._last("WatchdogSec")
        limit_s = int(limit.removesuffix("min")) * (60 if limit.endswith("min") else 1)
        places = {variable: f"{parent}/{self._last(key)}" for key, parent, variable in FOLDERS}
        families = " ".join(self.settings["RestrictAddressFamilies"]).split()
        calls: set[str] = set()
        for names in self.settings["SystemCallFilter"]:
            expanded = {call for name in names.lstrip("~").split() for call in system_calls(name)}
            calls = calls - expanded if names.startswith("~") else calls | expanded
        return Confined(
            {
                "PATH": "/usr/bin:/bin",
                "HOME": "/var/lib/canskin",
                "WATCHDOG_USEC": f"{limit_s}000000",
                **places,
                **self._environment(),
            },
            {place: folders / place.lstrip("/") for place in places.values()},
            {"/etc/canskin": self.root / "etc/canskin"},
            rtprio=int(self._last("LimitRTPRIO")),
            system_calls=filter_of_calls(
                folders / f"{self.verb}.bpf", {int(getattr(socket, name)) for name in families}, calls
            ),
        )

    def command(self) -> list[str]:
        """Return the words of ExecStart=."""
        environment = self._environment()
        words = []
        for word in shlex.split(self._last("ExecStart")):
            if re.fullmatch(r"\$\w+", word):
                words += shlex.split(environment.get(word[1:], ""))
            else:
                whole = re.sub(r"\$\{(\w+)\}", lambda found: environment.get(found[1], ""), word)
                words.append(whole.replace("$$", "$"))
        return words

    def _environment(self) -> dict[str, str]:
        own = [word for line in self.settings["Environment"] for word in shlex.split(line)]
        lines = (self.root / self._last("EnvironmentFile").lstrip("/")).read_text().splitlines()
        return dict(word.split("=", 1) for word in [*own, *(line for line in lines if line and line[0] != "#")])

    def _last(self, key: str) -> str:
        return self.settings[key][-1]


@cache
def system_calls(name: str) -> frozenset[str]:
    """Return the calls of a set, such as ``@system-service``, or of a call's own name."""
    if not name.startswith("@"):
        return frozenset({name})
    listed = subprocess.run(["systemd-analyze", "syscall-filter", name], capture_output=True, text=True, check=True)
    members = [line.strip() for line in listed.stdout.splitlines()[1:]]
    return frozenset().union(*(system_calls(each) for each in members if each and each[0] != "#"))
