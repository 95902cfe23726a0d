"""What the application 'canskin' offers to programs, where it is installed in their environment."""

from importlib.metadata import entry_points
from typing import Any

from canskin.errors import InputError


def from_application(group: str, name: str, otherwise: str = "") -> Any:
    """Return the function of an entry point of the application.

    Parameters
    ----------
    otherwise : str
        What else a user can do, for the error.

    Raises
    ------
    InputError
        If the application is not installed here.
    """
    found = list(entry_points(group=group, name=name))
    if not found:
        raise InputError(
            f"canskin.{name}() needs the application 'canskin', and this environment has the client only: install"
            f" the application here{otherwise}"
        )
    return found[0].load()
