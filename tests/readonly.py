"""Runs a command as a container or a hardened unit runs it: on a read-only root, as a user without rights.

`Confined.words` turns a command into words that any starter of processes can start. They run this file, as root, in a
mount namespace of its own: it makes the root, gives up root's rights, and becomes the command.
"""

import contextlib
import ctypes
import errno
import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
#: prctl(2).
PR_CAPBSET_DROP: Final = 24
PR_SET_NO_NEW_PRIVS: Final = 38
#: seccomp(2): let a call through, or answer it with an error number.
_ALLOW: Final = 0x7FFF0000
_ERRNO: Final = 0x00050000
_EQUAL: Final = 4
#: Above all address families of Linux (socket(2)).
_FAMILIES: Final = 48


def not_here() -> str:
    """Return why this machine cannot confine a process, empty if it can."""
    if sys.platform != "linux" or os.geteuid() != 0:
        return "NOT TESTED: a read-only root is made by root on Linux"
    mount = "mount -t tmpfs tmpfs /mnt && mount -t overlay overlay -o lowerdir=/mnt:/ /mnt"
    words = ["unshare", "--mount", "sh", "-c", mount]
    if not shutil.which("unshare") or subprocess.run(words, check=False, capture_output=True).returncode:
        return "NOT TESTED: this machine allows no mount namespace with an overlay"
    return ""


def gives_real_time() -> bool:
    """Tell whether a limit of 1 gives a process of this machine real time."""
    words = ["prlimit", "--rtprio=1", "setpriv", "--reuid=10001", "--bounding-set=-all", "chrt", "--rr", "1", "true"]
    return len(os.sched_getaffinity(0)) > 1 and not subprocess.run(words, check=False, capture_output=True).returncode


@dataclass(frozen=True)
class Confined:
    """The surroundings of a process.

    Attributes
    ----------
    root : Path
        Files that are laid over those of this machine; folders to mount on are made here.
    environment : mapping
        All of the process's environment.
    writable : mapping
        Folders that the process can write, by name, and where their content is; they are made the user's own.
    user_id : int
        User and group.
    rtprio : int
        Limit of the real-time priority.
    families : tuple of int
        Address families of sockets; empty: all.
    system_calls : tuple of str
        Allowed system calls; empty: all.
    """

    root: Path
    environment: Mapping[str, str]
    writable: Mapping[str, Path] = field(default_factory=dict)
    user_id: int = 10001
    rtprio: int = 0
    families: tuple[int, ...] = ()
    system_calls: tuple[str, ...] = ()

    def words(self, *command: str) -> list[str]:
        """Return the words that run `command` here; its first word is an absolute path."""
        shown = {str(ROOT)} | ({sys.base_prefix} if not sys.base_prefix.startswith("/usr") else set())
        for folder in (*shown, *self.writable):
            (self.root / folder.lstrip("/")).mkdir(parents=True, exist_ok=True)
        for folder in self.writable.values():
            folder.mkdir(parents=True, exist_ok=True)
            shutil.chown(folder, self.user_id, self.user_id)
        mounted = self.root.with_name(f"{self.root.name}.mounted")
        mounted.mkdir(exist_ok=True)
        of_process = {**asdict(self), "mounted": mounted, "shown": sorted(shown), "command": command}
        return ["unshare", "--mount", sys.executable, "-I", __file__, json.dumps(of_process, default=str)]


def _become(want: dict[str, Any]) -> None:
    """Make the root, give up all rights, and become the command."""
    # Layers of an overlay must not contain each other: the files go to a file system of their own.
    _mount("-t", "tmpfs", "-o", "mode=755", "tmpfs", want["mounted"])
    files, mounted = f"{want['mounted']}/files", f"{want['mounted']}/root"
    shutil.copytree(want["root"], files, symlinks=True)
    Path(files).chmod(0o755)  # a temporary folder is its maker's alone
    Path(mounted).mkdir()
    _mount("-t", "overlay", "overlay", "-o", f"lowerdir={files}:/", mounted)  # no upper layer: read-only
    for folder in ("/dev", "/proc", "/sys"):
        _mount("--rbind", folder, mounted + folder)
    _mount("-t", "tmpfs", "-o", "mode=1777", "tmpfs", f"{mounted}/tmp")  # noqa: S108 - the process's own
    for folder in want["shown"]:
        _mount("--bind", "-o", "ro", folder, mounted + folder)
    for name, folder in want["writable"].items():
        _mount("--bind", folder, mounted + name)
    os.chroot(mounted)
    os.chdir("/")
    with contextlib.suppress(ValueError):  # root without CAP_SYS_RESOURCE cannot raise it: see `gives_real_time`
        resource.setrlimit(resource.RLIMIT_RTPRIO, (want["rtprio"], want["rtprio"]))
    libc = ctypes.CDLL(None, use_errno=True)
    last = int(Path("/proc/sys/kernel/cap_last_cap").read_text())
    for capability in range(last + 1):
        libc.prctl(PR_CAPBSET_DROP, capability, 0, 0, 0)
    os.setgroups([])
    os.setresgid(*[want["user_id"]] * 3)
    os.setresuid(*[want["user_id"]] * 3)
    libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    if want["families"] or want["system_calls"]:
        _filter(want["families"], want["system_calls"])
    # What tests/processes.py asks every process of: to end with the tests.
    kept = {name: os.environ[name] for name in ("SKIN_PARENT",) if name in os.environ}
    os.execve(want["command"][0], want["command"], {**want["environment"], **kept})  # noqa: S606


def _mount(*words: str) -> None:
    subprocess.run(["mount", *words], check=True)


class _Argument(ctypes.Structure):
    """A comparison of an argument of a system call (struct scmp_arg_cmp of libseccomp)."""

    _fields_ = (("arg", ctypes.c_uint), ("op", ctypes.c_int), ("value", ctypes.c_uint64), ("mask", ctypes.c_uint64))


def _filter(families: list[int], system_calls: list[str]) -> None:
    """Load what RestrictAddressFamilies= and SystemCallFilter= of systemd.exec(5) mean."""
    library = ctypes.CDLL("libseccomp.so.2")
    library.seccomp_init.restype = ctypes.c_void_p
    number = library.seccomp_syscall_resolve_name
    if families:
        context = ctypes.c_void_p(library.seccomp_init(ctypes.c_uint32(_ALLOW)))
        refused = ctypes.c_uint32(_ERRNO | errno.EAFNOSUPPORT)
        for family in set(range(_FAMILIES)) - set(families):
            same = _Argument(0, _EQUAL, family, 0)
            _done(library.seccomp_rule_add_array(context, refused, number(b"socket"), 1, ctypes.byref(same)))
        _done(library.seccomp_load(context))
    if system_calls:
        context = ctypes.c_void_p(library.seccomp_init(ctypes.c_uint32(_ERRNO | errno.EPERM)))
        for name in system_calls:
            if (call := number(name.encode())) >= 0:  # calls of other processors have numbers below 0
                _done(library.seccomp_rule_add_array(context, ctypes.c_uint32(_ALLOW), call, 0, None))
        _done(library.seccomp_load(context))


def _done(status: int) -> None:
    if status:
        raise OSError(-status, f"libseccomp: {os.strerror(-status)}")


if __name__ == "__main__":
    _become(json.loads(sys.argv[1]))
