"""``skin hub``: the fabric's hub as a process of its own."""

import threading
import time
from contextlib import closing

from canskin.errors import InputError
from canskin.keys import environment_keys
from canskin.session import DEFAULT_ENDPOINT, LOOK_S, checked, open_hub, print_denials
from hub.denials import Denials, ignore_stdout, read_stdout
from hub.holders import read_holders
from hub.rules import access_control
from shell.pulse import Pulse
from shell.service import StopSignal, request_real_time, say
from shell.skin_options import Insecure, check_listen


def hub(*, listen: str = DEFAULT_ENDPOINT, join: str | None = None, insecure: Insecure = False) -> None:
    """Pass the messages of one skin or of many, so that a gateway that stops cuts nobody else off.

    With ``--keys`` of role hub every program needs keys, and does what its role may: see ``skin keys explain``. What
    is denied is logged once an hour. After ``skin keys add``, ``renew`` or ``revoke`` start the hub again with its new
    folder: programs come back by themselves, 0.2 s later.

    Parameters
    ----------
    listen
        Endpoint; default: a socket that only this user may open, with keys tls/127.0.0.1:7447.
    join
        Endpoint of the hub of another machine: the skins of both are then on both. With keys both are of one authority.
    insecure
        Listen to a network without keys: everybody there can read the skin, tare it and send false images.

    Examples
    --------
    skin hub
    skin hub --listen tls/0.0.0.0:7447 --keys keys/hub
    skin hub --join tls/10.0.0.5:7447 --keys keys/hub
    """
    pulse = Pulse(StopSignal().install())
    check_listen(listen, insecure=insecure)
    given = environment_keys()
    endpoint, keys = checked(listen, given)
    if given is not keys:
        raise InputError(
            f"--listen {listen}: a socket of this user has no keys: give tls/HOST:PORT, or leave --keys out"
        )
    rules = None
    if keys is not None:
        keys.watch_end("hub", threading.Event())
        rules = access_control(keys.folder)
        revoked = read_holders(keys.folder).revoked
        read_stdout(Denials(lambda text: say("hub", text), revoked).take)
        print_denials()
    with closing(open_hub(endpoint, keys, rules, joins=join)):
        address = endpoint.replace("/0.0.0.0:", "/HOST:").replace("/[::]:", "/HOST:")
        say("hub", f"listens on {endpoint}: give {address} to 'skin gateway' and all others as --connect")
        request_real_time("hub")
        while not pulse.is_set():
            time.sleep(LOOK_S)
        if rules is not None:
            ignore_stdout()  # while zenoh closes, Python might read no more, and zenoh would wait
