"""Sessions of zenoh with explicit endpoints and no multicast."""

import json
import math
import os
import re
import socket
import stat
import tempfile
import threading
import time
from collections.abc import Callable
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import zenoh

from canskin.errors import BusError, Stopped, reasoned, tell
from canskin.keys import ENVIRONMENT, HUB, PROTOCOLS_WITH_KEYS, UNIX, Keys, accepts, environment_keys, reason
from canskin.peers import EVERY_KEY, Peer, new_peer, peer_of_key


def user_folder() -> Path:
    """Return the folder of this user's sockets: below XDG_RUNTIME_DIR, else one per user."""
    if runtime := os.environ.get("XDG_RUNTIME_DIR"):
        return Path(runtime) / "canskin"
    return Path(tempfile.gettempdir()) / f"canskin-{os.getuid()}"


#: Longest path of a Unix socket, bytes.
SOCKET_PATH_MAX: Final = 107
#: A socket that only this user may open, so that other users of this machine are out; without Unix sockets loopback.
DEFAULT_ENDPOINT: Final = f"{UNIX}/{user_folder() / 'hub'}" if hasattr(socket, "AF_UNIX") else "tcp/127.0.0.1:7447"
#: With keys, in place of the default endpoint.
TLS_ENDPOINT: Final = "tls/127.0.0.1:7447"
#: After this time without a hub a service logs that it waits.
SILENT_S: Final = 3.0
#: A service that waits for the hub checks the stop signal at least this often.
TRY_S: Final = 1.0
#: The first time earlier, to find out whether the hub refuses.
FIRST_TRY_S: Final = 0.5
#: Period of a search for services.
LOOK_S: Final = 0.1
#: Threads of the hub, as zenoh reads them from ZENOH_RUNTIME. When a client has not read for its lease of 10 s, zenoh
#: closes the connection, which with unsent data blocks a thread for 10 s (SO_LINGER). With zenoh's one or two threads,
#: ten such clients stop the messages of all others. More than `MOST_STOPPED` clients still do.
MOST_STOPPED: Final = 128
_RUNTIME: Final = f"(rx: (worker_threads: {MOST_STOPPED}), net: (worker_threads: {MOST_STOPPED}))"
#: Protocols of zenoh's links; those before ``serial`` need a port.
PROTOCOLS: Final = ("tcp", "udp", "tls", "quic", "ws", "serial", "unixpipe", UNIX, "vsock")
PROTOCOLS_WITH_PORT: Final = PROTOCOLS[:5]
#: Whoever reaches the address may do everything.
PROTOCOLS_WITHOUT_KEYS: Final = ("tcp", "udp", "ws", "vsock")
HIGHEST_PORT: Final = 65535
#: How soon a client connects again after its hub is gone: zenoh's default waits up to 4 s.
RETRY: Final = {"period_init_ms": 50, "period_max_ms": 200, "period_increase_factor": 1.5}
#: Longest message that a process takes, bytes: without a limit one message of another fills the memory. The longest of
#: canskin is a layout of 2**16 taxels at positions, 9 MB.
MESSAGE_MAX: Final = 1 << 24
#: Longest wait of a client with keys for the first service that the hub lets it see: the hub itself.
SEE_S: Final = 0.5
#: Tokens of hubs: zenoh withdraws a token that nobody holds.
_TOKENS: Final[list[Any]] = []


class Stop(Protocol):
    """Tells whether to stop: a `threading.Event`, or a flag that signals set."""

    def is_set(self) -> bool:
        """Tell whether to stop."""
        ...


def checked(endpoint: str, keys: Keys | None) -> tuple[str, Keys | None]:
    """Return an endpoint and its keys: a socket needs none; raise BusError if the endpoint cannot be used."""
    if keys is not None and endpoint == DEFAULT_ENDPOINT:
        return TLS_ENDPOINT, keys
    protocol, _, address = endpoint.partition("/")
    port = address.rpartition(":")[2]
    has_port = re.fullmatch(r".+:\d+", address) and int(port) <= HIGHEST_PORT
    if protocol not in PROTOCOLS or not address or (protocol in PROTOCOLS_WITH_PORT and not has_port):
        raise BusError(f"expected an endpoint such as tcp/127.0.0.1:7447, got '{endpoint}'")
    if protocol == UNIX and len(os.fsencode(address)) > SOCKET_PATH_MAX:
        raise BusError(f"{address} is too long for a socket: expected up to {SOCKET_PATH_MAX} bytes")
    if protocol == UNIX and endpoint == DEFAULT_ENDPOINT:
        own_folder(Path(address).parent)
    if keys is None and protocol in PROTOCOLS_WITH_KEYS:
        raise BusError(f"{endpoint} needs keys: give --keys FOLDER, or {ENVIRONMENT} in the environment")
    if keys is not None and protocol not in (*PROTOCOLS_WITH_KEYS, UNIX):
        raise BusError(f"{endpoint} does not use the keys {keys.folder}: give tls/{address}, or leave the keys out")
    return endpoint, None if protocol == UNIX else keys


def own_folder(folder: Path) -> None:
    """Make a folder that only this user may open; raise BusError if others may open the folder that is there."""
    with reasoned(BusError, f"{folder}: no folder for sockets"):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        about = folder.lstat()
    if not stat.S_ISDIR(about.st_mode) or about.st_uid != os.getuid() or about.st_mode & 0o077:
        raise BusError(f"{folder} can be opened by other users: expected a folder of your own, with mode 0700")


def is_loopback(host: str) -> bool:
    """Tell whether a server bound to `host` is seen by programs of this machine alone."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_open(endpoint: str) -> bool:
    """Tell whether a hub that listens on an endpoint serves other machines without asking for a key."""
    protocol, _, address = endpoint.partition("/")
    return protocol in PROTOCOLS_WITHOUT_KEYS and not is_loopback(address.rpartition(":")[0].strip("[]"))


def open_hub(
    endpoint: str,
    keys: Keys | None = None,
    rules: dict[str, Any] | None = None,
    service: str = HUB,
    *,
    joins: str | None = None,
) -> Any:
    """Open the session of the hub; log who may connect without keys, beside this user.

    Parameters
    ----------
    keys : Keys, optional
        Of role `HUB`: whoever connects needs keys of the same authority.
    rules : dict, optional
        Zenoh's ``access_control``: who may do what.
    service : str
        Name in the log.
    joins : str, optional
        Endpoint of another hub: each passes the messages of the other, also after one of them has started again.

    Raises
    ------
    BusError
        If an endpoint cannot be used.
    """
    endpoint, keys = checked(endpoint, keys)
    if joins is not None:
        joins = checked(joins, keys)[0]
    if keys is not None and keys.role != HUB:
        raise BusError(
            f"cannot listen on {endpoint} with keys of '{keys.common_name}': expected those of role '{HUB}', or"
            " --connect tls/HOST:PORT"
        )
    protocol = endpoint.partition("/")[0]
    if protocol in PROTOCOLS_WITHOUT_KEYS:
        who = "everybody on that network" if is_open(endpoint) else "every user of this machine"
        tell(service, f"{endpoint} has no keys: {who} can read the skin, tare it and send false images")
    is_ours = os.environ.setdefault("ZENOH_RUNTIME", _RUNTIME) == _RUNTIME
    mask = os.umask(0o077) if protocol == UNIX else None  # of the socket, which zenoh makes
    try:
        session = zenoh.open(_config(endpoint, keys, hub=True, rules=rules, joins=joins))
    except zenoh.ZError as error:
        # Zenoh locks a file beside a socket.
        why = "another hub listens there" if "EAGAIN" in str(error) else first_sentence(error)
        raise BusError(f"cannot listen on {endpoint}: {why}") from None  # the message says all
    finally:
        if mask is not None:
            os.umask(mask)
        if is_ours:
            del os.environ["ZENOH_RUNTIME"]  # the processes that this process starts are no hubs
    if keys is not None:  # whoever may connect sees the hub; whoever sees nothing is revoked
        _TOKENS.append(session.liveliness().declare_token(new_peer(keys.skin, HUB, "").key))
    return session


def print_denials() -> None:
    """Have zenoh print to stdout what the rules of this process deny, and more; call it before `open_hub`.

    Zenoh has no other way to tell of denials.
    """
    os.environ["RUST_LOG"] = "zenoh::net::routing::interceptor::access_control=trace"
    zenoh.init_log_from_env_or("off")


class Listener(NamedTuple):
    """Words of the messages about the process that listens on an endpoint: its name, who starts it, which option."""

    name: str = "hub"
    full_name: str = "the fabric's hub"
    starter: str = "'skin gateway'"
    option: str = "--connect"


def open_client(
    endpoint: str,
    service: str,
    stop: Stop | None,
    patience_s: float = math.inf,
    listener: Listener = Listener(),  # noqa: B008 - immutable
    *,
    keys: Keys | None = None,
) -> Any:
    """Open a client's zenoh session in short attempts: signals are handled only between attempts.

    Parameters
    ----------
    service : str
        Name in the log.
    stop : StopSignal or None
        If set while this function waits, `canskin.errors.Stopped` is raised.
    patience_s : float
        Longest wait.
    listener : Listener
        Who listens on the endpoint.
    keys : Keys, optional
        Shown to the hub; the hub must show keys of the same authority.

    Raises
    ------
    BusError
        If the endpoint cannot be used, the hub refuses, or nobody answered in time.
    """
    endpoint, keys = checked(endpoint, keys)
    started_s, said, try_s = time.monotonic(), False, FIRST_TRY_S
    while True:
        left_s = patience_s - (time.monotonic() - started_s)
        try:
            if keys is not None:  # before: zenoh waits 10 s for a hub that does not speak TLS
                _raise_refusal(endpoint, listener, keys)
            session = zenoh.open(_config(endpoint, keys, patience_s=max(0.0, min(try_s, left_s))))
        except zenoh.ZError:
            try_s = TRY_S
            _raise_refusal(endpoint, listener, keys)
            if stop is not None and stop.is_set():
                raise Stopped from None
            waited_s = time.monotonic() - started_s
            if waited_s >= patience_s:
                raise _silence(endpoint, listener) from None  # that of zenoh says no more, and has paths of its build
        else:
            if keys is not None and _is_blind(session):
                session.close()
                raise BusError(
                    f"the {listener.name} at {endpoint} lets '{keys.common_name}' do nothing: its keys are revoked or"
                    " unknown there, see 'skin keys list'"
                )
            if said:
                tell(service, f"the {listener.name} is there")
            return session
        if waited_s >= SILENT_S and not said:
            tell(service, f"waits for {listener.full_name} at {endpoint}, usually {listener.starter}")
            said = True


def _is_blind(session: Any) -> bool:
    """Tell whether the hub lets a session see no service, not even the hub itself; a hub that is late is no proof."""
    give_up_s = time.monotonic() + SEE_S
    while not any(session.liveliness().get(EVERY_KEY, timeout=TRY_S)):  # of a late hub zenoh gives an error
        if time.monotonic() >= give_up_s:
            return True
        time.sleep(LOOK_S)
    return False


def _silence(endpoint: str, listener: Listener) -> BusError:
    """Return the error of a program that got no answer in time."""
    if accepts(endpoint):
        return BusError(
            f"the {listener.name} at {endpoint} does not answer: it hangs, is busy with other connections, or another"
            " program listens there"
        )
    return BusError(f"no {listener.name} at {endpoint}: start {listener.starter}, or give another {listener.option}")


def _raise_refusal(endpoint: str, listener: Listener, keys: Keys | None) -> None:
    """Raise BusError with the reason if the hub refuses a connection, or would: its own keys have no role."""
    if keys is not None and keys.role == HUB:
        raise BusError(f"keys {keys.folder}: they are the hub's own: expected those of a role, see 'skin keys explain'")
    if why := reason(endpoint, keys):
        holder = f"'{keys.common_name}'" if keys else "a program without keys"
        raise BusError(f"the {listener.name} at {endpoint} refuses {holder}: {why}") from None


def _config(
    endpoint: str,
    keys: Keys | None,
    *,
    hub: bool = False,
    patience_s: float = 0.0,
    rules: dict[str, Any] | None = None,
    joins: str | None = None,
) -> Any:
    """Build a zenoh configuration that uses `endpoint` only."""
    config = zenoh.Config()
    settings = {
        "mode": "router" if hub else "client",
        "listen/endpoints": [endpoint] if hub else [],
        "connect/endpoints": [] if hub else [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # a router would wait for others, 0.5 s
        "transport/shared_memory/enabled": False,
        "connect/timeout_ms": round(patience_s * 1000),
        "connect/retry": RETRY,
        "transport/link/rx/max_message_size": MESSAGE_MAX,
    }
    if joins is not None:
        settings |= {"connect/endpoints": [joins], "connect/timeout_ms": -1, "connect/exit_on_failure": False}
    if keys is not None:
        settings |= keys.settings(is_hub=hub)
    if rules is not None:
        settings["access_control"] = rules
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def close_with_program(close: Callable[[], None]) -> None:
    """Call `close` when the main thread ends: the threads of an open session would keep the program alive."""

    def wait() -> None:
        threading.main_thread().join()
        close()

    threading.Thread(target=wait, name="canskin-end").start()  # no daemon: these are stopped in the middle of zenoh


def first_sentence(error: BaseException) -> str:
    """Return the cause from zenoh's nested message."""
    return str(error).split(" at ")[0].strip().rstrip(".")


def peers_of(session: Any) -> list[Peer]:
    """Return the services of all skins on the hub of a session."""
    tokens = session.liveliness().get(EVERY_KEY, timeout=TRY_S)
    found = [peer_of_key(str(each.ok.key_expr)) for each in tokens if each.ok is not None]
    return [each for each in found if each is not None]


def peers_at(
    endpoint: str,
    patience_s: float,
    is_enough: Callable[[list[Peer]], bool],
    option: str = "address",
    stop: Stop | None = None,
    *,
    keys: Keys | None = None,
    service: str = "client",
) -> list[Peer]:
    """Return the services of all skins on a hub: as soon as `is_enough`, else those after `patience_s`.

    Parameters
    ----------
    option : str
        What gives the endpoint, for the message.
    stop : Stop, optional
        If set meanwhile, `canskin.errors.Stopped` is raised.
    keys : Keys, optional
        Default: see `environment_keys`.
    service : str
        Name in the log.

    Raises
    ------
    BusError
        If the endpoint cannot be used, or no hub answers in time.
    """
    give_up_s = time.monotonic() + patience_s
    listener = Listener(option=option)
    session = open_client(endpoint, service, stop, patience_s, listener, keys=keys or environment_keys())
    try:
        while True:
            peers = peers_of(session)
            if is_enough(peers) or time.monotonic() + LOOK_S > give_up_s:
                return peers
            if stop is not None and stop.is_set():
                raise Stopped
            time.sleep(LOOK_S)
    finally:
        session.close()


class Words(NamedTuple):
    """Words about a skin that is looked for: what gives the address, the name, what else to do, and who looks."""

    address: str = "address"
    name: str = "skin=..."
    advice: str = "is 'skin gateway' running?"
    service: str = "client"


def find_skin(
    endpoint: str,
    wanted: str | None,
    patience_s: float,
    knows: Callable[[Peer], bool],
    *,
    words: Words = Words(),  # noqa: B008 - immutable
    stop: Stop | None = None,
    keys: Keys | None = None,
    is_one: bool = True,
) -> list[Peer]:
    """Return the services of a skin on a hub that know the skin.

    Parameters
    ----------
    wanted : str or None
        Name of the skin; None: the only skin there.
    patience_s : float
        Longest wait for the hub and the skin.
    knows : callable
        Tells whether a service knows its skin.
    stop : Stop, optional
        If set meanwhile, `canskin.errors.Stopped` is raised.
    keys : Keys, optional
        Default: see `environment_keys`.
    is_one : bool
        Whether several skins are an error where none is named; else the services of all skins are returned.

    Raises
    ------
    BusError
        If there is no such hub or skin in time, or several skins are there and none is named.
    """

    def known(peers: list[Peer]) -> list[str]:
        return sorted({peer.skin for peer in peers if knows(peer)})

    def is_found(peers: list[Peer]) -> bool:
        return wanted in known(peers) if wanted else bool(known(peers))

    peers = peers_at(endpoint, patience_s, is_found, words.address, stop, keys=keys, service=words.service)
    skins = known(peers)
    if wanted in skins or (wanted is None and skins and (len(skins) == 1 or not is_one)):
        return [peer for peer in peers if wanted in {None, peer.skin} and knows(peer)]
    found = ", ".join(f"'{name}'" for name in skins)
    if wanted is None and skins:
        raise BusError(f"several skins at {endpoint}: {found}; expected the name of one of them: {words.name}")
    looked_for = f"no skin '{wanted}'" if wanted else "no skin"
    found = found or ", ".join(sorted({f"{peer.service} of '{peer.skin}'" for peer in peers}))
    raise BusError(f"{looked_for} at {endpoint}, found {found or 'no service'}: {words.advice}")
