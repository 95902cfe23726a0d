"""What a user is told: errors that a user can correct, and lines of the log.

Every deliberate error derives from one class. The message is one line: what was expected, what came, what to do::

    SkinError
    ├── LayoutError       a layout file is wrong; the message names the path of the key
    ├── InputError        a file, array or option from the user cannot be used
    ├── ModelError        a trained model cannot be read or belongs to another Φ
    ├── BusError          a CAN interface or the fabric cannot be opened or reached
    │   └── DeniedError   the role of the keys may not do that
    └── RunError          the input was right, but the run failed

The `skin` command prints the message and exits with code 2, after a `RunError` with 1, without a traceback.
Whatever takes a file, array or option of a user raises InputError or LayoutError, and says so only if the condition is
not plain from its parameters.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import msgspec

#: Name of the logger. Records have the attribute `service`.
LOG: Final = "canskin"

#: What msgspec raises for content that it cannot decode, such as text that is no UTF-8, or lists in lists in lists.
UNDECODABLE: Final = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)


class Stopped(Exception):  # noqa: N818 - no error
    """A stop signal came before the service had started; the command line ends with 0."""


class SkinError(Exception):
    """Base of every error whose message is meant for the user."""


class LayoutError(SkinError):
    """A layout file has a wrong, missing or unknown key; the message names the path of the key."""


class InputError(SkinError):
    """A file, array or option cannot be used; the message says what was expected."""


class ModelError(SkinError):
    """A model file cannot be read, is damaged, or was trained for another Φ."""


class RunError(SkinError):
    """A run failed for a reason that no other input would change."""


class BusError(SkinError):
    """A CAN interface or the fabric cannot be opened or reached."""


class DeniedError(BusError):
    """The role of the keys may not do an action on the fabric."""


@contextmanager
def reasoned(kind: type[SkinError], what: str) -> Iterator[None]:
    """Raise an OSError of the ``with`` block as `kind`: `what` says which file and what failed, the system why."""
    try:
        yield
    except OSError as error:
        raise kind(f"{what}: {error.strerror or error}") from error


def tell(service: str, text: str, level: int = logging.WARNING) -> None:
    """Log a line in the name of a service."""
    logging.getLogger(LOG).log(level, text, extra={"service": service})
