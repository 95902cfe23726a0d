"""Runs a command as a container or a hardened unit runs it: on a read-only root, as a user without rights (bwrap(1)).

Not covered: this machine's user has another number in the box and keeps the rights to files. Of the settings of
systemd.exec(5), only those that `Confined` lists are in force.
"""

import ctypes
import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from numba.core.caching import UserProvidedCacheLocator

from shell.output import cache_folder

ROOT: Final = Path(__file__).parents[1]
#: What every command of this machine needs.
SHOWN: Final = ("/usr", "/bin", "/lib", "/lib64", "/sys", "/etc/alternatives", "/etc/ld.so.cache", "/etc/localtime")
#: seccomp(2): let a call through, or answer it with an error number.
_ALLOW: Final = ctypes.c_uint32(0x7FFF0000)
_ERRNO: Final = 0x00050000
_EQUAL: Final = 4
#: Above all address families of Linux (socket(2)).
_FAMILIES: Final = 48


@dataclass(frozen=True)
class Confined:
    """The surroundings of a process.

    Attributes
    ----------
    environment : mapping
        All of the process's environment.
    writable : mapping
        Folders that the process can write, by name, and where their content is.
    readable : mapping
        Folders that the process can read beside those of the system and of the tests, by name.
    user_id : int
        User and group.
    rtprio : int
        Limit of the real-time priority, where this machine can give any.
    system_calls : Path, optional
        A filter that `filter_of_calls` wrote.
    """

    environment: Mapping[str, str]
    writable: Mapping[str, Path]
    readable: Mapping[str, Path] = field(default_factory=dict)
    user_id: int = 10001
    rtprio: int = 0
    system_calls: Path | None = None

    def words(self, *command: str) -> list[str]:
        """Return the words that run `command` here."""
        number = str(self.user_id)
        box = ["bwrap", "--die-with-parent", "--unshare-user", "--uid", number, "--gid", number, "--cap-drop", "ALL"]
        box += ["--dev", "/dev", "--proc", "/proc", "--tmpfs", "/tmp"]  # noqa: S108 - the process's own
        readable = {each: Path(each) for each in (*SHOWN, str(ROOT), sys.prefix, sys.base_prefix)} | {**self.readable}
        for kind, folders in (("--ro-bind-try", readable), ("--bind", self.writable)):
            for name, folder in folders.items():
                box += [kind, str(folder), name]
        for folder in self.writable.values():
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        box += ["--remount-ro", "/", "--chdir", "/", "--clearenv"]
        for name, value in self.environment.items():
            box += ["--setenv", name, value]
        limit = ["prlimit", f"--rtprio={self.rtprio}"] if self.rtprio else []
        if limit and subprocess.run([*limit, "true"], check=False, capture_output=True).returncode:
            limit = []  # only root with CAP_SYS_RESOURCE raises the limit
        if self.system_calls is None:
            return [*limit, *box, *command]
        opened = ["sh", "-c", 'exec "$@" 9<"$0"', str(self.system_calls)]
        return [*opened, *limit, *box, "--seccomp", "9", *command]


def not_here() -> str:
    """Return why this machine cannot confine a process, empty if it can."""
    if shutil.which("bwrap") is None or subprocess.run(Confined({}, {}).words("true"), check=False).returncode:
        return "NOT TESTED: needs bubblewrap (bwrap) and user namespaces"
    return ""


def gives_real_time() -> bool:
    """Tell whether a limit of 1 gives a process of this machine real time."""
    words = Confined({}, {}, rtprio=1).words("chrt", "--rr", "1", "true")
    return len(os.sched_getaffinity(0)) > 1 and not subprocess.run(words, check=False, capture_output=True).returncode


def give_compiled(cache: Path, but: str = "") -> None:
    """Give a service's cache the kernels and classifiers that are made here, as an image gives those of its build.

    `but` names a module whose kernels the service has to make.
    """
    for source in {path.parent for path in ROOT.glob("[a-z]*/**/__pycache__/*.nbi")}:
        place = UserProvidedCacheLocator.get_suitable_cache_subpath(str(source.parent / "kernel.py"))
        given = cache / "numba" / place
        given.mkdir(parents=True)
        for path in source.glob("*.nb?"):
            if path.name.split(".")[0] != but:
                shutil.copy(path, given)
    for path in cache_folder().glob("model-*.npz"):
        shutil.copy(path, cache)


class _Argument(ctypes.Structure):
    """A comparison of an argument of a system call (struct scmp_arg_cmp of libseccomp)."""

    _fields_ = (("arg", ctypes.c_uint), ("op", ctypes.c_int), ("value", ctypes.c_uint64), ("mask", ctypes.c_uint64))


def filter_of_calls(path: Path, families: Iterable[int], system_calls: Iterable[str]) -> Path:
    """Write what RestrictAddressFamilies= and SystemCallFilter= of systemd.exec(5) mean, and return the path."""
    library = ctypes.CDLL("libseccomp.so.2")
    library.seccomp_init.restype = ctypes.c_void_p
    number = library.seccomp_syscall_resolve_name
    context = ctypes.c_void_p(library.seccomp_init(ctypes.c_uint32(_ERRNO | errno.EPERM)))
    for name in set(system_calls) - {"socket"}:
        if (call := number(name.encode())) >= 0:  # calls of other processors have numbers below 0
            _done(library.seccomp_rule_add_array(context, _ALLOW, call, 0, None))
    for family in range(_FAMILIES):
        action = _ALLOW if family in families else ctypes.c_uint32(_ERRNO | errno.EAFNOSUPPORT)
        same = _Argument(0, _EQUAL, family, 0)
        _done(library.seccomp_rule_add_array(context, action, number(b"socket"), 1, ctypes.byref(same)))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        _done(library.seccomp_export_bpf(context, file.fileno()))
    return path


def _done(status: int) -> None:
    if status:
        raise OSError(-status, f"libseccomp: {os.strerror(-status)}")
