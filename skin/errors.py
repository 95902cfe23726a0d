"""Errors a user can mend.

Every error raised on purpose derives from one class, and its message is one line that says what was
expected, what came, and what to do::

    SkinError
    ├── LayoutError       a skin's TOML is wrong; names the path of the key
    ├── InputError        a file, array or option a user gave cannot be used
    ├── ModelError        a trained model cannot be read or belongs to another Φ
    ├── BusError          a CAN interface or the fabric cannot be opened or reached
    └── RunError          nothing was wrong with the input, but a run failed

The command line prints the message and exits with code 2, after a `RunError` with 1, without a traceback.
"""


class SkinError(Exception):
    """Base of every error whose message is meant for the person at the terminal."""


class LayoutError(SkinError):
    """A layout file has a wrong, missing or unknown key; the message names its path."""


class InputError(SkinError):
    """A file, array or option cannot be used; the message says what was expected."""


class ModelError(SkinError):
    """A model file cannot be read, is damaged, or was trained for another Φ."""


class RunError(SkinError):
    """A run failed for a reason that no other input would change."""


class BusError(SkinError):
    """A CAN interface or the fabric cannot be opened or reached."""
